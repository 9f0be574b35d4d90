"""What a campaign file may hold: every entry once, as readers and editors need it.

Entries are fragments of a JSON schema by name. The reader takes names and limits from here, and
refuses others; `json_schema` is the whole, for completion in editors.
"""

from __future__ import annotations

import operator
from typing import Any

from mcrim_mitsuba.core.errors import did_you_mean
from mcrim_mitsuba.core.numbers import (
    ALPHA_ABS,
    ALPHA_SCAT,
    COUNTED,
    ENERGIES_KEV,
    IN_KEV,
    PER_KEV,
    YIELDS_PER_KEV,
)
from mcrim_mitsuba.core.toml_document import TomlTable
from mcrim_mitsuba.effects.catalogue import catalogue
from mcrim_mitsuba.laboratory.peak import SHAPES

Entries = dict[str, dict[str, Any]]

#: Signal of a reading / eta: light yield x energy x detector efficiency.
SCALE = "scale"
#: The parameter that the source's gammas give.
SOURCE_DEPTH = "source_depth_mm"
#: Tables.
#: Names the light over wavelengths.
SPECTRUM = "spectrum"
#: Whose conventions and physics are taken, and the only one besides those of this package: V.
#: Alenkov et al., JINST 8 (2013) P06002.
CONVENTION = "convention"
ARTICLE = "article"
YIELD_TABLE = "light_yield"
HISTOGRAMS = "histograms"
NEXT = "next_measurements"
BEAM_TABLE = "beam"
#: What turns channels into photoelectrons.
CALIBRATION_TABLE = "calibration"
SCALE_SIGMA = "scale_sigma"
OFFSET_SIGMA = "offset_sigma"
#: Crystals that are measured beside the campaign's own, and their scene parameters.
SAMPLES = "samples"
SAMPLE_SCENE = "scene"
#: Light yield of a sample that is known, its error; the efficiency's error that samples share.
KNOWN_YIELD = "light_yield_ph_per_keV"
KNOWN_YIELD_SIGMA = "light_yield_ph_per_keV_sigma"
SHARED_SIGMA = "shared_efficiency_sigma"
#: Relative error of a further measurement, beside the lists of values.
NEXT_SIGMA = "sigma_relative"
#: What it takes to change a scene parameter, beside the mounting itself.
NEXT_MINUTES = "minutes"

#: Standard uncertainties of the scene's numbers, that all are exact, and of one number: its
#: standard uncertainty, and whether every value of a column is a part of its own.
TOLERANCES = "tolerances"
NONE = "none"
SIGMA = "sigma"
EACH = "each"
EACH_VALUE = "value"

#: That a parameter has the value of another one.
SAME_AS = "same_as"

#: Characters of a title or a unit, at most: they stand in one line of a figure.
LONGEST_WORDS = 100
#: The same of a remark.
LONGEST_REMARK = 1000
#: The light yield to quote of a campaign, if it is another one than that of its own fit.
TO_QUOTE = "yield_to_quote"

_FILE: dict[str, Any] = {"type": "string", "minLength": 1}
_VALUES = {"type": "array", "items": {"type": "number"}, "minItems": 1}


def _number(meaning: str, **limits: float) -> dict[str, Any]:
    return {"type": "number", "description": meaning, **limits}


def _share(meaning: str) -> dict[str, Any]:
    return _number(meaning, minimum=0, exclusiveMaximum=1)


def _words(meaning: str, longest: int = LONGEST_WORDS) -> dict[str, Any]:
    return {"type": "string", "minLength": 1, "maxLength": longest, "description": meaning}


def _file(meaning: str) -> dict[str, Any]:
    return {**_FILE, "description": f"{meaning}; paths are relative to the campaign"}


def _file_or(meaning: str, **limits: float) -> dict[str, Any]:
    return {"description": meaning, "anyOf": [_FILE, {"type": "number", **limits}]}


def _table(meaning: str, *entries: Entries) -> dict[str, Any]:
    """The schema of a table that holds nothing but these entries."""
    return {
        "type": "object",
        "description": meaning,
        "properties": {name: entry for part in entries for name, entry in part.items()},
        "additionalProperties": False,
    }


#: Of every ``[parameters.NAME]``.
PARAMETER: Entries = {
    "start": _number("Where the fit begins; the scene's value unless given"),
    "min": _number("Lowest value that the fit may take"),
    "max": _number("Highest value that the fit may take"),
    "prior": _number("What is known of it from elsewhere: the mean of a Gaussian"),
    "prior_sigma": _number("Standard error of the prior", exclusiveMinimum=0),
    "fixed": {"type": "boolean", "description": "Whether it is held at its start"},
    SAME_AS: {"type": "string", "description": "Parameter whose value it has, in place of its own"},
}
#: Of the absorption coefficient, in the place of its prior.
TRANSMITTANCE: Entries = {
    "transmittance": {
        "description": "Spectra of the transmittance, one per orientation, or a single fraction",
        "anyOf": [
            _FILE,
            {"type": "array", "items": _FILE, "minItems": 1},
            {"type": "number", "exclusiveMinimum": 0, "exclusiveMaximum": 1},
        ],
    },
    "transmittance_sigma": _share("Error that all readings share, a part of full transmission"),
    "thickness_mm": _number("Thickness of the sample, mm", exclusiveMinimum=0),
    "thickness_sigma_mm": _number("Standard error of the thickness, mm", minimum=0),
    "n": {
        "description": "Index of the crystal, or a material such as CaMoO4; else the scene's",
        "anyOf": [{"type": "number", "minimum": 1}, {"type": "string", "minLength": 1}],
    },
    "n_sigma": _number("Standard error of the index", minimum=0),
}
#: Of the depth of the source, in the place of its prior.
GAMMAS: Entries = {
    "gammas_in": {"type": "string", "description": "Formula of the crystal that gammas stop in"},
    "density_g_per_cm3": _number("Density of the crystal, g/cm3", exclusiveMinimum=0),
}
#: Of ``[light_yield]``.
YIELD: Entries = {
    "energy_keV": _number(
        "Energy deposited per event, keV", minimum=ENERGIES_KEV[0], maximum=ENERGIES_KEV[1]
    ),
    "detector_efficiency": _number(
        "Efficiency of the detector for the emission, a fraction", exclusiveMinimum=0, maximum=1
    ),
    "detector_efficiency_sigma": _number("Standard error of the efficiency", minimum=0),
}
#: Of ``[light_yield]`` of the campaign's own crystal.
CRYSTAL: Entries = {
    "material": {"type": "string", "description": "What the crystal is made of, such as CaMoO4"}
}
#: What a detector's efficiency is measured with.
EFFICIENCY_OF = "efficiency_of"
IN_AIR = "in air"
IN_WINDOW = "inside the window"
COLLECTION = "collection_efficiency"
COLLECTION_SIGMA = "collection_efficiency_sigma"
CROSSTALK = "crosstalk"
AFTERPULSING = "afterpulsing"
#: Of ``[light_yield]``, of the detector.
DETECTOR: Entries = {
    EFFICIENCY_OF: {
        "enum": [IN_AIR, IN_WINDOW],
        "description": "Light that the efficiency is a part of: in air, head-on, it contains what "
        "the window reflects",
    },
    COLLECTION: _number("Part of photoelectrons that is counted", exclusiveMinimum=0, maximum=1),
    COLLECTION_SIGMA: _share("Standard error of the collection efficiency"),
    CROSSTALK: _number(
        "Probability that a cell of an SiPM fires others at once", minimum=0, exclusiveMaximum=0.6
    ),
    f"{CROSSTALK}_sigma": _share("Its standard error"),
    AFTERPULSING: _share("Mean number of afterpulses of a fired cell, within the integration"),
    f"{AFTERPULSING}_sigma": _share("Its standard error"),
}
#: Of ``[light_yield]`` of a campaign with samples.
SHARED: Entries = {
    SHARED_SIGMA: _number(
        "Relative error of the efficiency that all samples share, such as the tube's scale",
        exclusiveMinimum=0,
        exclusiveMaximum=1,
    )
}
#: Of ``[samples.NAME.light_yield]``, besides `YIELD`.
KNOWN: Entries = {
    KNOWN_YIELD: _number(
        "Light yield of a reference, photons per keV", exclusiveMinimum=0, maximum=YIELDS_PER_KEV[1]
    ),
    KNOWN_YIELD_SIGMA: _number("Its standard error", exclusiveMinimum=0),
}
#: Of ``[light_yield]``, in the place of the efficiency.
EFFICIENCY: Entries = {
    "emission": _file("Emission spectrum of the crystal"),
    "quantum_efficiency": _file("Quantum efficiency of the detector by wavelength"),
    "quantum_efficiency_scale_sigma": _share("Relative error of the whole efficiency curve"),
}
#: Of ``[samples.NAME]``.
SAMPLE: Entries = {
    SAMPLE_SCENE: {"type": "object", "description": "Scene parameters of its readings"},
    "parameters": _table(
        "What it does not share with the campaign's own crystal",
        {name: _table("Its own", PARAMETER) for name in (ALPHA_SCAT, ALPHA_ABS, SCALE)},
    ),
    YIELD_TABLE: _table("What turns its own scale into photons per keV", YIELD, KNOWN),
}
#: Of ``[beam]``.
BEAM: Entries = {
    "beam_diameter_mm": _number("Diameter of the beam, mm", exclusiveMinimum=0),
    "acceptance_deg": _number(
        "Largest angle to the beam that the detector takes, degrees", exclusiveMinimum=0, maximum=90
    ),
    "beam_axis": {"enum": ["x", "y", "z"], "description": "Axis that the beam flies along"},
}
#: Of ``[histograms]``.
PEAKS: Entries = {
    "shape": {"enum": list(SHAPES), "description": "How the peaks of histograms are described"},
    "step": {"type": "boolean", "description": "Whether a continuum that ends under them is too"},
    "escape_keV": {**_VALUES, "description": "Quanta that leave the crystal: lines below a peak"},
    "escape_share": {**_VALUES, "description": "Their events over the peak's; else fitted"},
}
#: Of ``[calibration]``, of histograms in channels.
CALIBRATION: Entries = {
    "single_photoelectron": _file_or("Its spectrum, or channels per one", exclusiveMinimum=0),
    "single_photoelectron_sigma": _number("Standard error of that number", minimum=0),
    "crosstalk": {"type": "boolean", "description": "Whether it is fitted; else if resolved"},
    "excess_noise_factor": _number("Mean and variance then tell the gain of a tube", minimum=1),
    "excess_noise_factor_sigma": _number("Its standard error", minimum=0),
    "pedestal": _file_or("Run in the dark, or the pedestal's channel; else every spectrum's own"),
    "pedestal_sigma": _number("Standard error of that channel", minimum=0),
    "range_ratio": _number("Of its range's gain to that of the light", exclusiveMinimum=0),
    "range_ratio_sigma": _number("Its standard error", minimum=0),
    "nonlinearity": _number("k of reading = true / (1 + k true), per photoelectron"),
    "background": _file("Spectrum of the background, subtracted by live times"),
    "background_live_time_s": _number("Its live time, s", exclusiveMinimum=0),
    "live_time_s": _number("Live time of the readings' spectra, s", exclusiveMinimum=0),
    "dead_time_us": _number("For how long an event makes blind; times are real ones", minimum=0),
}
#: Of ``[calibration]``: errors that all readings of light share, which the above make.
COMMON: Entries = {
    SCALE_SIGMA: _share("Relative error of the scale of all readings of light"),
    OFFSET_SIGMA: _number("Error of what is subtracted of all of them, in their unit", minimum=0),
    "nonlinearity_sigma": _number("Error of their nonlinearity, one over their unit", minimum=0),
}
#: Of an entry of ``[tolerances]``.
TOLERANCE: Entries = {
    SIGMA: _number("Standard uncertainty, in the unit of the name; 0: exact", minimum=0),
    EACH: {
        "enum": [EACH_VALUE, "all"],
        "description": "Whether every value of a column has an offset of its own, or all have one",
    },
}
#: Of ``[next_measurements]``, beside the lists of values.
NEXT_ENTRIES: Entries = {
    NEXT_SIGMA: _number(
        "Relative error of a further measurement", exclusiveMinimum=0, exclusiveMaximum=1
    ),
    NEXT_MINUTES: {
        "type": "object",
        "description": "Minutes to change a scene parameter, beside half an hour for the mounting",
        "additionalProperties": {"type": "number", "minimum": 0},
    },
}
#: The file itself; `json_schema` adds the names of effects and of their parameters.
CAMPAIGN: Entries = {
    "title": _words("What the campaign is called; figures carry it. The file's name unless given"),
    "unit": _words("Unit of the signals of light, such as photoelectrons per event"),
    "remark": _words(
        "What every verb that fits repeats among its notes; repair writes one", LONGEST_REMARK
    ),
    TO_QUOTE: _words(
        "The light yield over all that the readings allow, in words, as repair writes it",
        LONGEST_REMARK,
    ),
    CONVENTION: {
        "enum": [ARTICLE],
        "description": "Conventions and physics of V. Alenkov et al., JINST 8 (2013) P06002",
    },
    "scene": _file("The scene (XML)"),
    "measurements": _file("The readings (CSV)"),
    SPECTRUM: _file("Light over wavelengths, and how the coefficients vary over them (CSV)"),
    "effects": {
        "type": "array",
        "description": "Effects that are switched on, their parameters fitted",
    },
    "effects_folder": _file("A folder with effects of your own, which are executed"),
    "parameters": {"type": "object", "description": "What is known of fitted parameters"},
    YIELD_TABLE: _table(
        "What turns the fitted scale into photons per keV",
        YIELD,
        EFFICIENCY,
        CRYSTAL,
        DETECTOR,
        SHARED,
    ),
    SAMPLES: {
        "type": "object",
        "description": "Other crystals among the readings, by name",
        "additionalProperties": _table("A crystal and what it does not share", SAMPLE),
    },
    NEXT: {
        "type": "object",
        "description": "Values of scene parameters among which further measurements are proposed",
        "properties": {**NEXT_ENTRIES, COUNTED: _VALUES | {"items": {"type": "string"}}},
        "additionalProperties": _VALUES,
    },
    TOLERANCES: {
        "type": "object",
        "description": "Standard uncertainties of the scene's numbers, by name",
        "properties": {NONE: {"const": True, "description": "Numbers not named are exact"}},
        "additionalProperties": {
            "anyOf": [TOLERANCE[SIGMA], _table("Of a column of the readings", TOLERANCE)]
        },
    },
    HISTOGRAMS: _table("How histograms become readings", PEAKS),
    CALIBRATION_TABLE: _table("What channels of a digitiser stand for", CALIBRATION, COMMON),
    BEAM_TABLE: _table("The spectrophotometer, of readings of the kind transmittance", BEAM),
}

#: Tables that may have raw entries, with these.
RAW_TABLES = (
    (f"parameters.{ALPHA_ABS}", TRANSMITTANCE),
    (f"parameters.{SOURCE_DEPTH}", GAMMAS),
    (YIELD_TABLE, EFFICIENCY),
    (CALIBRATION_TABLE, CALIBRATION),
)
#: Entries that name files, by table.
FILE_ENTRIES = (
    (f"parameters.{ALPHA_ABS}", "transmittance"),
    (YIELD_TABLE, "emission"),
    (YIELD_TABLE, "quantum_efficiency"),
    (CALIBRATION_TABLE, "single_photoelectron"),
    (CALIBRATION_TABLE, "pedestal"),
    (CALIBRATION_TABLE, "background"),
)


_LIMITS = {
    "minimum": operator.ge,
    "exclusiveMinimum": operator.gt,
    "maximum": operator.le,
    "exclusiveMaximum": operator.lt,
}
_ERROR = "give a standard error"
_BETWEEN = "is not between 0 and 1"
#: What is wrong with a number beyond its limits, and how to mend it.
_BEYOND = {
    "prior_sigma": ("is not above 0", "give the prior's standard error, or fixed = true"),
    "transmittance": (_BETWEEN, "give a fraction: 0.76 for 76 %"),
    "thickness_sigma_mm": ("is below 0", _ERROR),
    "n": ("is below 1", "a solid has an index above 1"),
    "energy_keV": ("is no energy of a line in keV", IN_KEV),
    "detector_efficiency": ("is not above 0 and at most 1", "give a fraction: 0.127 for 12.7 %"),
    COLLECTION: ("is not above 0 and at most 1", "give a fraction: 0.9 for 90 %"),
    CROSSTALK: ("is not from 0 to 0.6", "give a probability: 0.05 for 5 %"),
    AFTERPULSING: ("is not from 0 to 1", "give a fraction: 0.02 for 2 %"),
    "quantum_efficiency_scale_sigma": (_BETWEEN, "it is a relative error: write 0.05 for 5 %"),
    NEXT_SIGMA: (_BETWEEN, "it is a relative error: write 0.007 for 0.7 %"),
    SHARED_SIGMA: (_BETWEEN, "it is a relative error: write 0.05 for 5 %"),
    KNOWN_YIELD: ("is no light yield", PER_KEV),
    KNOWN_YIELD_SIGMA: ("is not above 0", "give the standard error of the light yield"),
    "single_photoelectron": ("is not above 0", "give channels per photoelectron, or a spectrum"),
    "excess_noise_factor": (
        "is below 1",
        "it is 1 + (spread / gain)^2 of a photoelectron's charge",
    ),
    "range_ratio": ("is not above 0", "give 20 where the light's range is 20 times coarser"),
    "background_live_time_s": ("is not above 0", "give seconds"),
    "live_time_s": ("is not above 0", "give seconds"),
    "dead_time_us": ("is below 0", "give microseconds"),
}
_SHARE = "is below 0 or above 1", "give a fraction: 0.03 for 3 %"
_BEYOND |= {
    name: _SHARE if "exclusiveMaximum" in entry else ("is below 0", _ERROR)
    for part in (TRANSMITTANCE, YIELD, DETECTOR, CALIBRATION, COMMON)
    for name, entry in part.items()
    if name.endswith("_sigma")
}


def number_within(table: TomlTable, name: str, entries: Entries) -> float | None:
    """A number within its entry's limits, None without it; raises InputError with the line."""
    value = table.number(name)
    kinds = entries[name].get("anyOf", [entries[name]])
    limits = next(kind for kind in kinds if kind.get("type") == "number")
    if value is None or all(
        within(value, limits[limit]) for limit, within in _LIMITS.items() if limit in limits
    ):
        return value
    problem, mend = _BEYOND[name]
    raise table.refusal(name, f"{name} = {value:g} {problem}", mend)


def choice(table: TomlTable, name: str, entries: Entries) -> str | None:
    """One of the words that an entry takes, None without it; raises InputError with the line."""
    word, words = table.get(name), entries[name]["enum"]
    if word is None or word in words:
        return word
    raise table.refusal(name, f'{name} = "{word}" is not known', did_you_mean(str(word), words))


def json_schema() -> dict[str, Any]:
    """JSON schema (draft 7) of a campaign file, for completion in editors.

    It has the effects of the package; names of other effects and of scene parameters are taken
    as they are. What a file holds is checked in full by `campaign.read_campaign` only.
    """
    effects = catalogue()
    parameters = {
        ALPHA_ABS: _table("Absorption coefficient of the crystal, 1/cm", PARAMETER, TRANSMITTANCE),
        SCALE: _table("Signal over eta, common to all readings", PARAMETER),
    }
    for effect in effects.values():
        for parameter in effect.parameters:
            meaning = f"{parameter.meaning}; parameter of {effect.name}"
            raw = GAMMAS if parameter.name == SOURCE_DEPTH else {}
            parameters[parameter.name] = _table(meaning, PARAMETER, raw)
    other = _table("A scene parameter, in its name's unit", PARAMETER)
    completed = {
        "effects": {"items": {"anyOf": [{"enum": list(effects)}, {"type": "string"}]}},
        "parameters": {"properties": parameters, "additionalProperties": other},
    }
    entries = {name: {**entry, **completed.get(name, {})} for name, entry in CAMPAIGN.items()}
    return {
        "$schema": "http://json-schema.org/draft-07/schema#",
        "title": "Campaign of mcrim",
        "required": ["scene", "measurements"],
        **_table("A scene, its measurements and what is known beforehand", entries),
    }
