"""Effects of the detector: light that it sends back, or takes more or less readily."""

from __future__ import annotations

from functools import partial

import numpy as np

from mcrim_mitsuba.effects.effect import (
    Columns,
    Effect,
    EffectParameter,
    Parameters,
    Values,
    one_parameter,
    reflections,
)
from mcrim_mitsuba.effects.scene_edits import WAVELENGTH, set_detector, wavelength_of
from mcrim_mitsuba.scene.editor import SceneEditor
from mcrim_mitsuba.scene.scene_file import SceneFile


def falloff(
    name: str, meaning: str, least: float = 0.0, nodes: tuple[float, ...] = ()
) -> tuple[EffectParameter]:
    """How far sensitivity falls, or rises below 0: 1 - this times what `meaning` says."""
    return one_parameter(
        name=name,
        meaning=f"Detection falls as 1 - this {meaning}",
        minimum=least,
        maximum=1.0,
        start=0.2,
        plausible=(0.6 * least, 0.6),
        nodes=(*nodes, 0.15, 0.3, 0.5, 0.75, 1.0),
    )


def edit_photocathode_film(editor: SceneEditor) -> None:
    """Let the detectors be films on the window."""
    set_detector(editor, "cathode_nm", "$cathode_nm", sends_back=True)
    set_detector(editor, WAVELENGTH, wavelength_of(editor))
    for detector in editor.detectors:
        index = editor.index_before(detector)
        editor.insert_last(detector, f'<float name="window_index" value="{index}"/>')


PHOTOCATHODE_FILM = Effect(
    name="photocathode_film",
    title="thin-film photocathode",
    family="detector reflects",
    look=(
        "Turn a narrow polarised beam about the middle of the tube's window, with a glass "
        "half-cylinder on it in oil, and read the tube and the reflected light: beyond 41 degrees "
        "in the glass both are much stronger."
    ),
    physics=(
        "A photocathode is a film of some 20 nm between the window and vacuum. Waves to and fro in "
        "it interfere, and beyond the glass's critical angle nothing gets through: light that "
        "arrives slanted is absorbed up to twice as well as light head-on, and reflected like from "
        "a mirror. Tubes are calibrated head-on, so readings count A(theta) / A(0), which may "
        "exceed 1: a gel lets slanted light into the window, air does not. What is transmitted is "
        "lost. The index is that of K-Cs-Sb at the scene's wavelength_nm, from 380 to 680 nm: "
        "3.22 + 0.706i at 540 nm, which it is unless another one is given; 15.5 nm thick films "
        "were measured. Green-extended and multialkali tubes have other films: give the scene's "
        "detector their n and k as cathode_n and cathode_k. Effects that say the same in another "
        "way exclude it."
    ),
    source="D. Motta and S. Schönert, Nucl. Instrum. Meth. A 539 (2005) 217",
    parameters=one_parameter(
        name="cathode_nm",
        meaning="Thickness of the photocathode, a film between window and vacuum",
        minimum=10.0,
        maximum=35.0,
        start=15.5,
        # no thickness makes of a film the ideal absorber
        absent=None,
        plausible=(10.0, 30.0),
        nodes=(10.0, 13.0, 18.0, 24.0, 30.0, 35.0),
    ),
    excludes=("detector_reflection", "detector_specular", "detector_angle"),
    edit=edit_photocathode_film,
)


#: Photons that the detector sends back some times and detects then.
_SENT_BACK = partial(reflections, column="detector_hits", simulated_at=0.5, then_absorbed=True)


def sends_back_no_more(scene: SceneFile, others: tuple[str, ...]) -> bool:
    """Whether detectors have none of some numbers: records count all that detectors send back."""
    detectors = scene.parts.all("bsdf", "photodetector")
    return not any(detector.named(name) is not None for detector in detectors for name in others)


DETECTOR_REFLECTION = Effect(
    name="detector_reflection",
    title="diffusely reflecting detector",
    family="detector reflects",
    look=(
        "Measure with another detector. Put a black ring around the crystal on the window: the "
        "readings fall if light went to and fro."
    ),
    physics=(
        "A photocathode absorbs a third to a half of the light, transmits some, and reflects the "
        "rest; what is behind it, and a silicon detector's surface, reflect too. Light "
        "that comes back into the window (Lambertian, depolarised) may re-enter the crystal and "
        "return. It is reflected before anything else is decided about it."
    ),
    source="D. Motta and S. Schönert, Nucl. Instrum. Meth. A 539 (2005) 217",
    parameters=one_parameter(
        name="detector_reflectance",
        meaning="Fraction of the light that the detector sends back into the window",
        maximum=0.5,
        start=0.1,
        plausible=(0.0, 0.3),
        nodes=(0.05, 0.1, 0.2, 0.3, 0.4, 0.5),
    ),
    excludes=("photocathode_film",),
    edit=partial(set_detector, name="reflectance", value="$detector_reflectance", sends_back=True),
    weighs_in=partial(sends_back_no_more, others=("specular", "cathode_nm")),
    **_SENT_BACK("detector_reflectance"),
)


DETECTOR_SPECULAR = Effect(
    name="detector_specular",
    title="mirror-like detector",
    family="detector reflects",
    look=(
        "Look at the reflection of a lamp in the tube's window: the image behind that of the "
        "glass is the photocathode's. Measure with another tube."
    ),
    physics=(
        "The face of a photocathode or of a silicon detector is smooth, and so is what is behind "
        "it: what it reflects leaves at the angle at which it came, and in total reflection "
        "goes on in the window. With this probability light is reflected so, whatever its angle "
        "(polarised light as by a metal), else it is detected. Diffuse reflection, if there is "
        "some too, is decided before."
    ),
    source="D. Motta and S. Schönert, Nucl. Instrum. Meth. A 539 (2005) 217",
    parameters=one_parameter(
        name="detector_specular",
        meaning="Fraction of the light that the detector reflects as a mirror does",
        maximum=0.5,
        start=0.1,
        plausible=(0.0, 0.4),
        nodes=(0.05, 0.1, 0.2, 0.3, 0.4, 0.5),
    ),
    excludes=("photocathode_film",),
    edit=partial(set_detector, name="specular", value="$detector_specular", sends_back=True),
    weighs_in=partial(sends_back_no_more, others=("reflectance", "cathode_nm")),
    **_SENT_BACK("detector_specular"),
)


def weight_angular_falloff(columns: Columns, values: Values, parameters: Parameters) -> np.ndarray:
    """1 - a (1 - cos theta), theta inside the window, to the normal: above 1 for a below 0."""
    return 1.0 - values["angular_falloff"] * (1.0 - columns["arrival_cosine"].astype(np.float64))


DETECTOR_ANGLE = Effect(
    name="detector_angle",
    title="angle-dependent detection",
    family="detector accepts",
    look=(
        "Turn a narrow beam of light about the middle of the detector's window, and read the "
        "detector at each angle."
    ),
    physics=(
        "Reflection and absorption in a photocathode, a thin film on glass, depend on the angle "
        "of incidence. A gel lets more oblique light through than air does, so it is seen with "
        "another mean efficiency: 1 - a (1 - cos theta) of what arrives at the angle theta "
        "inside the window is detected, the rest absorbed. Negative a is a detector that sees "
        "slanted light better. Readings are relative to light head-on, with which tubes are "
        "calibrated, so that such light counts more than 1; the probabilities themselves, "
        "(1 - a (1 - cos theta)) / (1 - a), do not exceed 1."
    ),
    source="D. Motta and S. Schönert, Nucl. Instrum. Meth. A 539 (2005) 217",
    parameters=falloff(
        "angular_falloff",
        "(1 - cos theta), theta inside the window",
        least=-1.0,
        nodes=(-1.0, -0.7, -0.35),
    ),
    excludes=("photocathode_film",),
    edit=partial(set_detector, name="angular_falloff", value="$angular_falloff"),
    columns=("arrival_cosine",),
    weight=weight_angular_falloff,
)


_RADIUS_MM = 14.0


def weight_radial_falloff(columns: Columns, values: Values, parameters: Parameters) -> np.ndarray:
    """1 - b (r / 14 mm)^2, at least 0."""
    part = columns["arrival_radius_mm"].astype(np.float64) / _RADIUS_MM
    return np.clip(1.0 - values["radial_falloff"] * part**2, 0.0, 1.0)


DETECTOR_RADIUS = Effect(
    name="detector_radius",
    title="position-dependent detection",
    family="detector accepts",
    look=("Move a narrow beam of light across the detector's window, and read it at each place."),
    physics=(
        "The collection of photoelectrons, and the photocathode itself, get worse towards the "
        "edge of a photomultiplier. Of the light that arrives at the radius r the part "
        "1 - b (r / 14 mm)^2 is detected, the rest absorbed; 14 mm whatever the mask."
    ),
    source="Hamamatsu Photonics, Photomultiplier Tubes: Basics and Applications, chapter 4",
    parameters=falloff("radial_falloff", "(r / 14 mm)^2 from the axis outwards"),
    edit=partial(set_detector, name="radial_falloff", value="$radial_falloff"),
    columns=("arrival_radius_mm",),
    weight=weight_radial_falloff,
)
