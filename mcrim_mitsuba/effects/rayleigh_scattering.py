"""Effect ``rayleigh_scattering``: the phase function of small scatterers."""

import numpy as np

from mcrim_mitsuba.effects._bench import set_phase
from mcrim_mitsuba.effects.effect import Columns, Effect, Parameters, Values
from mcrim_mitsuba.scene.editor import SceneEditor
from mcrim_mitsuba.scene.scene_file import SceneFile


def edit(editor: SceneEditor) -> None:
    """Give the crystal's medium Rayleigh's phase function."""
    set_phase(
        editor,
        "<!-- Scatterers far smaller than the wavelength: 3/4 (1 + cos^2) -->\n"
        '<phase type="rayleigh"/>',
    )


def weight(columns: Columns, values: Values, parameters: Parameters) -> np.ndarray:
    """exp(sum over scatterings of log(3/4 (1 + cos^2))): density over that of isotropy."""
    return np.exp(columns["log_rayleigh"].astype(np.float64))


def there(scene: SceneFile) -> bool:
    """Whether a scene has it."""
    return any(phase.get("type") == "rayleigh" for phase in scene.root.iter("phase"))


EFFECT = Effect(
    name="rayleigh_scattering",
    title="Rayleigh scattering",
    family="bulk",
    look=(
        "Measure the transmittance at several wavelengths: what is lost by Rayleigh "
        "scattering falls with the fourth power of the wavelength."
    ),
    physics=(
        "Scatterers far smaller than the wavelength radiate as dipoles: unpolarised light is "
        "scattered with the density 3/4 (1 + cos^2) relative to isotropy, forwards and backwards "
        "alike, and twice as strongly as to the side."
    ),
    source=(
        "C. F. Bohren and D. R. Huffman, Absorption and Scattering of Light by Small Particles, "
        "Wiley 1983, chapter 5"
    ),
    excludes=("anisotropic_scattering",),
    there=there,
    edit=edit,
    columns=("log_rayleigh",),
    weight=weight,
)
