"""Effect ``spectral_scattering``: short wavelengths scatter more than long ones."""

from __future__ import annotations

import numpy as np

from mcrim_mitsuba.effects._bench import WAVELENGTH, wavelength_of
from mcrim_mitsuba.effects.effect import Effect, EffectParameter, Parameters, Values
from mcrim_mitsuba.optics.emission_band import USUAL_NM, USUAL_WIDTH_NM, scattering_of_colours
from mcrim_mitsuba.scene.editor import SceneEditor

_EXPONENT, _BANDWIDTH = "scattering_exponent", "bandwidth_nm"


def edit(editor: SceneEditor) -> None:
    """Let the crystal's scattering fall with the wavelength, and light have many of them."""
    names = [_EXPONENT, WAVELENGTH, _BANDWIDTH]
    wavelength_of(editor)
    if _BANDWIDTH not in editor.scene.parameters:
        meaning = "Full width at half maximum of the light's band, as the detector sees it, nm"
        editor.declare(_BANDWIDTH, USUAL_WIDTH_NM, meaning)
    for name in names:
        editor.insert_last(editor.crystal, f'<float name="{name}" value="${name}"/>')


def colours(values: Values, parameters: Parameters) -> tuple[np.ndarray, np.ndarray]:
    """Parts of the light, and their scattering over that at the band's maximum."""
    maximum, width = (
        float(parameters.get(name, usual))
        for name, usual in ((WAVELENGTH, USUAL_NM), (_BANDWIDTH, USUAL_WIDTH_NM))
    )
    return scattering_of_colours(values[_EXPONENT], maximum, width)


EFFECT = Effect(
    name="spectral_scattering",
    title="scattering that falls with the wavelength",
    family="bulk",
    look=(
        "Measure the transmittance over the emission band: what scattering takes falls with the "
        "wavelength. Or read through a blue and through a red filter."
    ),
    physics=(
        "A scintillator's band is wide, and what scatters in it is often small: alpha_scat goes as "
        "(wavelength_nm / wavelength)^p, with p from 0, inclusions larger than the wavelength, to "
        "4, Rayleigh's law. alpha_scat_per_cm is that at wavelength_nm, the maximum of a Gaussian "
        "band of the width bandwidth_nm, cut off at 1.5 widths (540 and 150 nm unless the scene "
        "says otherwise). Light that scatters more gets out sooner, and less of it: the mean is "
        "not that of the mean coefficient."
    ),
    source=(
        "C. F. Bohren and D. R. Huffman, Absorption and Scattering of Light by Small Particles, "
        "Wiley 1983, chapters 4 and 5"
    ),
    parameters=(
        EffectParameter(
            name=_EXPONENT,
            unit="",
            meaning="Exponent p of the scattering's fall with the wavelength",
            minimum=0.0,
            maximum=4.0,
            start=2.0,
            absent=0.0,
            plausible=(0.0, 4.0),
            nodes=(1.0, 2.0, 3.0, 4.0),
        ),
    ),
    edit=edit,
    colours=colours,
)
