"""Effect ``photocathode_film``: the detector is an absorbing film, thinner than a wavelength."""

from __future__ import annotations

from mcrim_mitsuba.effects._bench import (
    WAVELENGTH,
    sends_back,
    set_detector,
    wavelength_of,
)
from mcrim_mitsuba.effects.effect import Effect, EffectParameter
from mcrim_mitsuba.scene.editor import SceneEditor


def edit(editor: SceneEditor) -> None:
    """Let the detectors be films on the window."""
    set_detector(editor, "cathode_nm", "$cathode_nm")
    set_detector(editor, WAVELENGTH, wavelength_of(editor))
    for detector in editor.detectors:
        editor.insert_last(
            detector, f'<float name="window_index" value="{editor.index_before(detector)}"/>'
        )
    sends_back(editor)


EFFECT = Effect(
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
    parameters=(
        EffectParameter(
            name="cathode_nm",
            unit="nm",
            meaning="Thickness of the photocathode, a film between window and vacuum",
            minimum=10.0,
            maximum=35.0,
            start=15.5,
            # no thickness makes of a film the ideal absorber
            absent=None,
            plausible=(10.0, 30.0),
            nodes=(10.0, 13.0, 18.0, 24.0, 30.0, 35.0),
        ),
    ),
    excludes=("detector_reflection", "detector_specular", "detector_angle"),
    edit=edit,
)
