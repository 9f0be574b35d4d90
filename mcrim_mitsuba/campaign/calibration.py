"""``[calibration]``: what a campaign, or a file of that table alone, says of a digitiser."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mcrim_mitsuba.campaign import entries as schema
from mcrim_mitsuba.campaign.entries import number_within
from mcrim_mitsuba.campaign.raw_data import file_in
from mcrim_mitsuba.core.descent import Array
from mcrim_mitsuba.core.errors import InputError, placed, said_by
from mcrim_mitsuba.core.toml_document import TomlDocument, TomlTable, is_plain_number, read_toml
from mcrim_mitsuba.laboratory.calibration import ChannelCalibration, Gain, with_live_time
from mcrim_mitsuba.laboratory.digitiser import ChannelSpectrum, read_channels
from mcrim_mitsuba.laboratory.single_photoelectron import (
    Pedestal,
    fit_pedestal,
    fit_single_photoelectrons,
    gain_by_excess_noise,
)

_GAIN = "single_photoelectron"
_NOISE = "excess_noise_factor"


def calibration_of_file(path: str | Path) -> ChannelCalibration:
    """The ``[calibration]`` of a campaign, or of a file that holds nothing else.

    Raises InputError, with the line, if it is not there or cannot be used.
    """
    calibration = read_calibration(read_toml(Path(path), "a calibration"))
    if calibration is None:
        mend = f'write [{schema.CALIBRATION_TABLE}] with {_GAIN} = "spe.csv"'
        raise InputError(f"it has no [{schema.CALIBRATION_TABLE}]", mend, path=path)
    return calibration


def read_calibration(document: TomlDocument) -> ChannelCalibration | None:
    """What turns channels into photoelectrons; None where the document says nothing of it.

    Raises InputError, with the line, if an entry or a spectrum that it names cannot be used.
    """
    entries = {**schema.CALIBRATION, **schema.COMMON}
    table = document.table(schema.CALIBRATION_TABLE, entries)
    if not any(name in table for name in schema.CALIBRATION):
        return None
    for name in (schema.SCALE_SIGMA, schema.OFFSET_SIGMA):
        if name in table:
            problem = f"{name} beside spectra, which give it"
            raise table.refusal(name, problem, "remove one of the two")
    if _GAIN not in table:
        mend = f'add {_GAIN} = "spe.csv", or channels per photoelectron as a number'
        raise table.refusal("", f"[{schema.CALIBRATION_TABLE}] has no {_GAIN}", mend)
    number = partial(number_within, table, entries=entries)
    for name in (_GAIN, "pedestal", "range_ratio", "nonlinearity", _NOISE):
        if f"{name}_sigma" in table and not is_plain_number(table.get(name)):
            problem = f"{name}_sigma without {name} as a number: a spectrum gives its own"
            raise table.refusal(f"{name}_sigma", problem, f"write {name} as a number, or remove it")
    pedestal, run = _pedestal(table)
    times = number("live_time_s"), number("dead_time_us")
    background = None
    if "background" in table:
        background = read_channels(file_in(table, "background", table["background"]))
        background = with_live_time(background, number("background_live_time_s"), times[1])
    return ChannelCalibration(
        gain=_gain(table, pedestal),
        pedestal=pedestal,
        pedestal_run=run,
        range_ratio=number("range_ratio") or 1.0,
        range_ratio_sigma=number("range_ratio_sigma") or 0.0,
        nonlinearity=number("nonlinearity") or 0.0,
        nonlinearity_sigma=number("nonlinearity_sigma") or 0.0,
        background=background,
        live_time_s=times[0],
        dead_time_us=times[1],
    )


def _pedestal(table: TomlTable) -> tuple[Pedestal | None, ChannelSpectrum | None]:
    """The pedestal of all spectra and the run that it comes of; None: every spectrum's own."""
    if "pedestal" not in table:
        return None, None
    if not isinstance(table["pedestal"], str):
        sigma = number_within(table, "pedestal_sigma", schema.CALIBRATION)
        return Pedestal(table.known_number("pedestal"), sigma or 0.0), None
    run = read_channels(file_in(table, "pedestal", table["pedestal"]))
    pedestal = fit_pedestal(run.channels, run.counts)
    if pedestal is None:
        problem = "no pedestal stands out at the low end"
        raise InputError(problem, "take a run in the dark, or give the channel", path=run.path)
    return pedestal, run


def _gain(table: TomlTable, pedestal: Pedestal | None) -> Gain:
    """Channels per photoelectron, as a number or of a spectrum."""
    if not isinstance(table[_GAIN], str):
        value = number_within(table, _GAIN, schema.CALIBRATION)
        sigma = number_within(table, f"{_GAIN}_sigma", schema.CALIBRATION)
        assert value is not None
        return Gain(value=value, sigma=sigma or 0.0)
    crosstalk = table.get("crosstalk")
    if crosstalk is not None and not isinstance(crosstalk, bool):
        raise table.refusal("crosstalk", "crosstalk is not true or false", "write crosstalk = true")
    spectrum = read_channels(file_in(table, _GAIN, table[_GAIN]))
    factor = number_within(table, _NOISE, schema.CALIBRATION)
    if factor is None:
        with placed(path=spectrum.path):
            fit = fit_single_photoelectrons(spectrum.channels, spectrum.counts, crosstalk=crosstalk)
        return Gain(value=fit.gain, sigma=fit.gain_sigma, spectrum=spectrum, fit=fit)
    if pedestal is None:
        problem = f"{_NOISE} without a pedestal, from which the charge is counted"
        raise table.refusal(_NOISE, problem, 'add pedestal = "dark.csv", of the same range')
    sigma = number_within(table, f"{_NOISE}_sigma", schema.CALIBRATION) or 0.0
    with said_by(partial(table.refusal, _GAIN), placed_too=False):
        fit = gain_by_excess_noise(spectrum.channels, spectrum.counts, pedestal, factor, sigma)
    return Gain(value=fit.gain, sigma=fit.gain_sigma, spectrum=spectrum, fit=fit)


@dataclass(frozen=True, kw_only=True)
class CommonErrors:
    """Errors that all readings of light share, by the calibration of a digitiser's channels.

    That of the scale is the light yield's alone; the others move readings against each other.
    """

    #: Relative standard error of the scale.
    scale_sigma: float = 0.0
    #: Of what is subtracted of all readings, in their unit; of k in true = read / (1 - k read),
    #: one over their unit.
    offset_sigma: float = 0.0
    nonlinearity_sigma: float = 0.0

    def moved(self, signals: Array, of_light: NDArray[np.bool_]) -> Array:
        """(readings, sources) what standard errors do to readings, of the sources that there are.

        `signals`, (readings,), are what they read; a transmittance is not moved.
        """
        sources = (
            np.full(len(signals), self.offset_sigma),
            self.nonlinearity_sigma * np.square(signals),
        )
        moved = [np.where(of_light, source, 0.0) for source in sources if source.any()]
        return np.stack(moved, axis=1) if moved else np.zeros((len(signals), 0))


def read_common_errors(document: TomlDocument) -> CommonErrors:
    """``[calibration]`` in plain numbers; raises InputError with the line."""
    table = document.table(schema.CALIBRATION_TABLE)
    errors = {name: number_within(table, name, schema.COMMON) or 0.0 for name in schema.COMMON}
    return CommonErrors(**errors)
