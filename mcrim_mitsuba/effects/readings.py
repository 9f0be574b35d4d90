"""Effects of the readout: they act on the readings, whatever the photons did."""

from __future__ import annotations

import math
from functools import partial

import numpy as np

from mcrim_mitsuba.effects.effect import Effect, Predicted, Rows, one_parameter


def reading_background(signals: np.ndarray, value: float, rows: Rows) -> Predicted:
    """reading = signal + background."""
    ones = np.ones_like(signals)
    return signals + value, ones, ones


def beside_background(part: float, signals: np.ndarray) -> tuple[float, float]:
    """Up to a part of the weakest signal; more than a tenth is seen with the crystal out.

    What is subtracted too much or too little is less than the weakest signal itself.
    """
    largest = part * float(signals.min())
    return -largest, largest


BACKGROUND = Effect(
    name="background",
    title="constant background",
    family="readings",
    look=("Take the crystal out, and then the source away: what is still read is background."),
    physics=(
        "A pedestal that was not quite subtracted, stray light, or light that is born in the "
        "window adds the same to every reading. It weighs most on the weakest reading, which is "
        "that of the air gap. It is added after a nonlinear readout acts."
    ),
    source="E. H. Bellamy et al., Nucl. Instrum. Meth. A 339 (1994) 468",
    parameters=one_parameter(
        name="background",
        meaning="Added to every reading, in the unit of the readings",
        minimum=-math.inf,
        maximum=math.inf,
        start=0.0,
        plausible=(-math.inf, math.inf),
        nodes=(),
        plausible_beside=partial(beside_background, 0.1),
        range_beside=partial(beside_background, 1.0),
    ),
    reading=reading_background,
    order=1,
)


def reading_nonlinearity(signals: np.ndarray, value: float, rows: Rows) -> Predicted:
    """reading = signal / (1 + k signal), straight on along its slope before that divides by 0."""
    # there a negative k makes readings of ten times the light, which no readout comes near
    bent = np.minimum(signals, 0.9 / np.maximum(-value, 1e-300))
    damped = 1.0 + value * bent
    return bent / damped + (signals - bent) / damped**2, damped**-2.0, -((bent / damped) ** 2)


def plausible_beside_nonlinearity(signals: np.ndarray) -> tuple[float, float]:
    """A detector that reads its strongest signal a fifth too low or a tenth too high is noticed."""
    largest = float(signals.max())
    return -0.1 / largest, 0.2 / largest


def range_beside_nonlinearity(signals: np.ndarray) -> tuple[float, float]:
    """Wide enough for signals of many units and of a part of one: 1 / k is what is never read."""
    largest = float(signals.max())
    if plausible_beside_nonlinearity(signals)[1] <= 0.05:
        return -0.05, 0.05
    return -0.5 / largest, 1.5 / largest


NONLINEARITY = Effect(
    name="nonlinearity",
    title="nonlinear readout",
    family="readings",
    look=(
        "Put a grey filter of known transmittance before the detector: strong and weak signals "
        "must fall by just that part. Read a second gamma line: light is in proportion to its "
        "energy, a bent readout is not, whatever the bench does."
    ),
    physics=(
        "Space charge in a photomultiplier, the finite number of a silicon detector's cells, an "
        "amplifier near its limit or dead time read strong signals too low: reading = true / "
        "(1 + k true), the form of a non-paralyzable dead time. Where k is below 0 they are read "
        "too high: a tube's current raises the voltages of its first dynodes, an amplifier bends "
        "upwards, or a threshold takes more of the weak ones. It acts before background is added."
    ),
    source=(
        "G. F. Knoll, Radiation Detection and Measurement, 4th ed., Wiley 2010, chapter 4; "
        "Hamamatsu Photonics, Photomultiplier Tubes, 3rd ed., 2007, chapter 5"
    ),
    parameters=one_parameter(
        name="nonlinearity",
        meaning="k of reading = true / (1 + k true), per unit of the readings",
        minimum=-0.05,
        maximum=0.05,
        start=0.002,
        plausible=(-0.01, 0.01),
        nodes=(),
        plausible_beside=plausible_beside_nonlinearity,
        range_beside=range_beside_nonlinearity,
    ),
    reading=reading_nonlinearity,
)


def reading_cell_saturation(signals: np.ndarray, value: float, rows: Rows) -> Predicted:
    """reading = cells (1 - exp(-signal / cells))."""
    share = np.maximum(signals, 0.0) / value
    dark = np.exp(-share)
    below = np.minimum(signals, 0.0)
    return value * (1.0 - dark) + below, dark, 1.0 - dark - share * dark


CELL_SATURATION = Effect(
    name="cell_saturation",
    title="finite number of cells",
    family="readings",
    look="Put a grey filter of known transmittance between crystal and detector, and read again.",
    physics=(
        "A cell of a silicon photomultiplier that has fired is dead for tens of nanoseconds. Of a "
        "flash that is shorter, n photoelectrons (crosstalk included) on evenly lit cells fire "
        "cells (1 - exp(-n / cells)) of them, fewer than n. Readings must be in fired cells. In "
        "light that lasts longer, cells recover and count again: more than there are, to be "
        "calibrated with a filter. The number is known of a detector, so no diagnosis tries it: "
        "name it in effects, and hold it with fixed = true or a prior. What bends readings "
        "unknown is found as nonlinearity, 1/(2 cells) of this to first order."
    ),
    source="P. Buzhan et al., Nucl. Instrum. Meth. A 504 (2003) 48",
    parameters=one_parameter(
        name="cells",
        meaning="Cells that the light falls on, in the unit of the readings: fired cells",
        minimum=50.0,
        maximum=1e7,
        start=3600.0,
        absent=None,
        plausible=(100.0, 1e6),
        nodes=(),
    ),
    excludes=("nonlinearity",),
    reading=reading_cell_saturation,
    offered=False,
)


def reading_in_proportion(name: str, signals: np.ndarray, value: float, rows: Rows) -> Predicted:
    """reading = signal (1 + value x), x being what rows have under this name."""
    x = getattr(rows, name)
    factor = 1.0 + value * x
    return signals * factor, np.broadcast_to(factor, signals.shape), signals * x


GAIN_DRIFT = Effect(
    name="gain_drift",
    title="drift of the gain",
    family="readings",
    look=(
        "Measure the first row again after the last one, or a light pulser between the rows; "
        "measure the rows in another order."
    ),
    physics=(
        "A photomultiplier's gain changes by per cents in hours, with temperature, high voltage "
        "and its own current, and after it has seen daylight. Rows that were measured one after "
        "the other are then read too high at one end and too low at the other: by this from first "
        "to last row of the file, linearly, and not at all in the middle. It acts on what is read "
        "in the end, a background included."
    ),
    source="G. F. Knoll, Radiation Detection and Measurement, 4th ed., Wiley 2010, chapter 9",
    parameters=one_parameter(
        name="gain_drift",
        meaning="Relative change of the readings from the first to the last row",
        minimum=-0.1,
        maximum=0.1,
        start=0.02,
        plausible=(-0.03, 0.03),
        nodes=(-0.1, -0.04, 0.04, 0.1),
    ),
    reading=partial(reading_in_proportion, "position"),
    order=2,
)


SAMPLE_SCALE = Effect(
    name="sample_scale",
    title="yield difference between crystals",
    family="readings",
    look=(
        "Measure all pieces wrapped in the same reflector, where the yield decides and size hardly "
        "does; ask from which part of the boule each was cut."
    ),
    physics=(
        "Crystals of other sizes are other pieces, and doping, stoichiometry and annealing change "
        "along a boule: their light yield is not quite that of the crystal of the scene. Readings "
        "of every crystal whose width or height differs from the scene's are multiplied by one "
        "plus this, before a nonlinear readout acts. Transmittances know no light yield."
    ),
    source="V. Alenkov et al., JINST 8 (2013) P06002, section 1 (samples of other thickness)",
    parameters=one_parameter(
        name="sample_scale",
        meaning="Relative excess of the yield of crystals of other sizes than the scene's",
        minimum=-0.2,
        maximum=0.2,
        start=0.05,
        plausible=(-0.1, 0.1),
        nodes=(-0.2, -0.08, 0.08, 0.2),
    ),
    reading=partial(reading_in_proportion, "other_sample"),
    order=-1,
)


def reading_non_proportionality(signals: np.ndarray, value: float, rows: Rows) -> Predicted:
    """reading = signal (energy / that of the light yield)^p."""
    share = rows.energy_ratio**value
    more = signals * share
    return more, np.broadcast_to(share, signals.shape), more * np.log(rows.energy_ratio)


NON_PROPORTIONALITY = Effect(
    name="non_proportionality",
    title="scintillator that is not proportional",
    family="readings",
    look=(
        "Read more gamma lines with one coupling, weak ones behind a grey filter: what depends on "
        "the energy and not on the signal is the scintillator's."
    ),
    physics=(
        "Light per keV is not the same for all energies: where an electron ionises densely, at the "
        "end of its track, excitations quench each other. In most oxides light per keV rises with "
        "the energy, in alkali halides it falls. It is taken as a power of the energy, relative to "
        "that of the light yield, or of the first row. It acts before a nonlinear readout."
    ),
    source=(
        "P. Dorenbos, J. T. M. de Haas and C. W. E. van Eijk, IEEE Transactions on Nuclear "
        "Science 42 (1995) 2190"
    ),
    parameters=one_parameter(
        name="non_proportionality",
        meaning="Power of the energy with which light per keV rises",
        minimum=-0.3,
        maximum=0.3,
        start=0.02,
        plausible=(-0.05, 0.08),
        nodes=(-0.3, -0.1, 0.1, 0.3),
    ),
    reading=reading_non_proportionality,
    order=-1,
)
