"""What a campaign's readings and priors were made of, every step with its errors."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from mcrim_mitsuba.files.measurement_table import Row
from mcrim_mitsuba.files.measurements import Reading
from mcrim_mitsuba.files.raw_entries import EfficiencyEntry, GammasEntry, TransmittanceEntry
from mcrim_mitsuba.files.reading import read_bytes

if TYPE_CHECKING:
    from mcrim_mitsuba.files.histogram import Histogram
    from mcrim_mitsuba.physics.absorption import Absorption
    from mcrim_mitsuba.physics.detector_efficiency import DetectorEfficiency
    from mcrim_mitsuba.physics.gammas import AttenuationLength
    from mcrim_mitsuba.physics.peak import Peak
    from mcrim_mitsuba.physics.repeats import Repeated
    from mcrim_mitsuba.physics.slab import Index
    from mcrim_mitsuba.physics.spectrum import Spectrum

#: Lists of some million events.
LIMIT_MB = 50
#: Digits of a SHA-256 that are shown where all of them would be in the way.
SHORT_HASH = 12


@dataclass(frozen=True)
class RawFile:
    """A file with raw data.

    Attributes
    ----------
    role : str
        What it is for the campaign, such as ``histogram of air``.
    path : Path
    sha256 : str
        Of its bytes, hexadecimal.
    """

    role: str
    path: Path
    sha256: str


@dataclass(frozen=True, eq=False)
class Mounting:
    """One mounting's histogram and its peak.

    Attributes
    ----------
    row : Row
        Where the measurement file names it.
    histogram : Histogram
    peak : Peak or None
        None where no peak stands out; such a mounting is not used.
    consistent : bool
        Whether it agrees with the others; True where it is not used.
    """

    row: Row
    histogram: Histogram
    peak: Peak | None
    consistent: bool

    @property
    def use(self) -> bool:
        """Whether the reading rests on it."""
        return self.row.use

    @property
    def file(self) -> Path:
        """The histogram's."""
        assert self.row.histogram is not None
        return self.row.histogram


@dataclass(frozen=True, eq=False)
class ReducedReading:
    """A reading from histograms.

    Attributes
    ----------
    reading : Reading
        What the campaign has, with the error of `combined`.
    mountings : tuple of Mounting
        All of them, those that are not used included.
    combined : Repeated
        Mean and errors of the mountings that are used.
    """

    reading: Reading
    mountings: tuple[Mounting, ...]
    combined: Repeated


@dataclass(frozen=True, eq=False)
class ReducedEfficiency:
    """The detector's efficiency from spectra.

    Attributes
    ----------
    entry : EfficiencyEntry
    emission, quantum_efficiency : Spectrum
    found : DetectorEfficiency
    """

    entry: EfficiencyEntry
    emission: Spectrum
    quantum_efficiency: Spectrum
    found: DetectorEfficiency


@dataclass(frozen=True, eq=False)
class ReducedAbsorption:
    """The absorption coefficient from transmittances.

    Attributes
    ----------
    entry : TransmittanceEntry
    spectra : tuple of Spectrum
        One per orientation; empty where one number was measured.
    light : Spectrum or None
        What they are weighted with: the light as the detector sees it.
    n : float or callable
        The crystal's index, or a function of the wavelength in nm.
    found : Absorption
    """

    entry: TransmittanceEntry
    spectra: tuple[Spectrum, ...]
    light: Spectrum | None
    n: Index
    found: Absorption


@dataclass(frozen=True)
class ReducedSourceDepth:
    """How deep the source's gammas get.

    Attributes
    ----------
    entry : GammasEntry
    found : AttenuationLength
    """

    entry: GammasEntry
    found: AttenuationLength


@dataclass(frozen=True, eq=False)
class RawData:
    """All raw data of a campaign, reduced.

    Attributes
    ----------
    readings : dict of str to ReducedReading
        By label; readings that the file gives as numbers are not among them.
    efficiency : ReducedEfficiency or None
    absorption : ReducedAbsorption or None
    source_depth : ReducedSourceDepth or None
    numbers : dict of str to float
        What stands in the place of raw entries, by its dotted name in the campaign, such as
        ``parameters.alpha_abs_per_cm.prior``.
    files : tuple of RawFile
    notes : tuple of str
        What the reader must know before using the numbers.
    """

    readings: dict[str, ReducedReading]
    efficiency: ReducedEfficiency | None
    absorption: ReducedAbsorption | None
    source_depth: ReducedSourceDepth | None
    numbers: dict[str, float]
    files: tuple[RawFile, ...]
    notes: tuple[str, ...]


def raw_file(role: str, path: Path) -> RawFile:
    """A file with its hash.

    Raises
    ------
    InputError
        If it cannot be read.
    """
    return RawFile(role, path, hashlib.sha256(read_bytes(path, LIMIT_MB)).hexdigest())
