"""What the page's session holds and shows: plain, frozen, replaced as a whole."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from mcrim_mitsuba.diagnosing import Diagnosed
from mcrim_mitsuba.fit import Calibration
from mcrim_mitsuba.fit.response_model import ResponseModel
from mcrim_mitsuba.fit.result import FittedRow


@dataclass(frozen=True)
class Settings:
    """What the page's controls say.

    Attributes
    ----------
    effects : tuple of str
        Switched on, besides the campaign's own.
    values : dict of str to float
        By parameter; the scale is among them where it is not fitted.
    fit_scale : bool
        Whether the scale follows the readings.
    """

    effects: tuple[str, ...] = ()
    values: Mapping[str, float] = field(default_factory=dict)
    fit_scale: bool = True


@dataclass(frozen=True)
class Shown:
    """What the page shows of the model at some settings.

    Attributes
    ----------
    rows : tuple of FittedRow
    chi2 : float
        Readings in use and priors.
    ndf : int
        Of a fit of all that is shown.
    p_value : float or None
    scale : float
        Signal at an efficiency of 1.
    light_yield : tuple of float or None
        Photons per keV: value, statistical error with all else held, systematic error.
    pending : tuple of str
        Effects that are switched on but not simulated yet.
    """

    rows: tuple[FittedRow, ...]
    chi2: float
    ndf: int
    p_value: float | None
    scale: float
    light_yield: tuple[float, float, float] | None
    pending: tuple[str, ...]


@dataclass(frozen=True)
class Step:
    """A fit that was made on the page.

    Attributes
    ----------
    effects : tuple of str
    calibration : Calibration
    """

    effects: tuple[str, ...]
    calibration: Calibration


@dataclass(frozen=True)
class State:
    """All that jobs change, replaced as a whole.

    Attributes
    ----------
    number : int
        Rises with every change.
    ready : frozenset of str or None
        Effects that were simulated; None before the bench as it is was.
    baseline : Calibration or None
        Of the campaign as it came.
    settled : dict of tuple of str to ResponseModel
        By the effects switched on: models that were simulated where their fit ended.
    steps : tuple of Step
    diagnosed : Diagnosed or None
    settings : Settings
        What the controls should say; pages take them over when `settings_number` rises.
    settings_number : int
    file : tuple of (str, bytes) or None
        Name and content of what is to be downloaded.
    file_number : int
        Rises with every file: a page downloads one that it has not had.
    """

    number: int = 0
    ready: frozenset[str] | None = None
    baseline: Calibration | None = None
    settled: Mapping[tuple[str, ...], ResponseModel] = field(default_factory=dict)
    steps: tuple[Step, ...] = ()
    diagnosed: Diagnosed | None = None
    settings: Settings = field(default_factory=Settings)
    settings_number: int = 0
    file: tuple[str, bytes] | None = None
    file_number: int = 0
