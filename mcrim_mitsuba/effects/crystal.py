"""Effects inside the crystal: where light is born, how it is polarised and scattered."""

from __future__ import annotations

import math
from functools import partial

import numpy as np

from mcrim_mitsuba.effects.effect import (
    Columns,
    Effect,
    EffectParameter,
    Parameters,
    Values,
    one_parameter,
)
from mcrim_mitsuba.effects.scene_edits import WAVELENGTH, set_numbers, set_phase, wavelength_of
from mcrim_mitsuba.optics.emission_band import USUAL_NM, USUAL_WIDTH_NM, scattering_of_colours
from mcrim_mitsuba.scene.editor import SceneEditor
from mcrim_mitsuba.scene.scene_file import SceneFile
from mcrim_mitsuba.scene.xml_tree import transform_matrix


def edit_polarization(editor: SceneEditor) -> None:
    """Set the ``<default>`` polarization to true."""
    if not isinstance(editor.scene.parameters.get("polarization"), bool):
        mend = 'add <default name="polarization" value="false"/> and use it in the integrator'
        raise editor.refusal("the scene has no parameter polarization", mend)
    if editor.scene.parameters["polarization"]:
        raise editor.refusal("polarization is true already", "there is nothing to add")
    editor.set_default("polarization", True)


def there_polarization(scene: SceneFile) -> bool:
    """Whether a scene has it."""
    return scene.parameters.get("polarization") is True


POLARIZATION = Effect(
    name="polarization",
    title="polarisation of the light",
    family="light",
    look="It is always there: switch it on; nothing needs to be looked for.",
    always_there=True,
    physics=(
        "A face reflects the two polarisations of a photon differently, and total internal "
        "reflection shifts their phases against each other: light that was reflected once is "
        "polarised and meets the next face with other odds than unpolarised light. Emission is "
        "unpolarised, and each scattering in the bulk and each diffuse reflection depolarises."
    ),
    source="M. Born and E. Wolf, Principles of Optics, 7th ed., Cambridge 1999, section 1.5",
    there=there_polarization,
    edit=edit_polarization,
)


ANISOTROPIC_SCATTERING = Effect(
    name="anisotropic_scattering",
    title="anisotropic scattering",
    family="bulk",
    look=(
        "Look at a laser beam in the crystal from the side, and at its spot behind the "
        "crystal: inclusions scatter forwards and give the spot a halo."
    ),
    physics=(
        "Inclusions and bubbles as large as the wavelength or larger scatter mostly forwards, "
        "which turns the light less than isotropic scattering with the same coefficient. The "
        "phase function of Henyey and Greenstein, (1 - g^2) / (4 pi (1 + g^2 - 2 g cos)^(3/2)), "
        "has the mean cosine g."
    ),
    source="L. G. Henyey and J. L. Greenstein, Astrophysical Journal 93 (1941) 70",
    parameters=one_parameter(
        name="scattering_g",
        meaning="Mean cosine of the scattering angle in the crystal, 0 if isotropic",
        minimum=-0.5,
        maximum=0.95,
        start=0.3,
        plausible=(0.0, 0.9),
        nodes=(-0.5, 0.3, 0.6, 0.8, 0.9, 0.95),
        # light forgets its direction with alpha_scat (1 - g)
        coordinate="logarithmic",
        scale=-1.0,
    ),
    excludes=("rayleigh_scattering",),
    edit=partial(
        set_phase, xml='<phase type="hg">\n  <float name="g" value="$scattering_g"/>\n</phase>'
    ),
)


def weight_rayleigh(columns: Columns, values: Values, parameters: Parameters) -> np.ndarray:
    """exp(sum over scatterings of log(3/4 (1 + cos^2))): density over that of isotropy."""
    return np.exp(columns["log_rayleigh"].astype(np.float64))


def there_rayleigh(scene: SceneFile) -> bool:
    """Whether a scene has it."""
    return any(phase.get("type") == "rayleigh" for phase in scene.root.iter("phase"))


RAYLEIGH_SCATTERING = Effect(
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
    there=there_rayleigh,
    edit=partial(
        set_phase,
        xml="<!-- Scatterers far smaller than the wavelength: 3/4 (1 + cos^2) -->\n"
        '<phase type="rayleigh"/>',
    ),
    columns=("log_rayleigh",),
    weight=weight_rayleigh,
)


def edit_scattering_gradient(editor: SceneEditor) -> None:
    """Let the crystal's scattering change along its height."""
    set_numbers(editor, editor.crystal, "scattering_gradient")


SCATTERING_GRADIENT = Effect(
    name="scattering_gradient",
    title="scattering gradient in the crystal",
    family="bulk",
    look=("Turn the crystal over and measure again: the readings change if one end scatters more."),
    physics=(
        "Impurities and inclusions are distributed along a boule as it grows from the melt, so "
        "one end of a crystal cut from it can scatter more than the other: alpha_scat(z) = "
        "alpha_scat (1 + q (2 z / H - 1)), with its mean kept."
    ),
    source="J. A. Burton, R. C. Prim and W. P. Slichter, J. Chem. Phys. 21 (1953) 1987",
    parameters=one_parameter(
        name="scattering_gradient",
        meaning="Relative change of alpha_scat from the middle to the top of the crystal",
        minimum=-1.0,
        maximum=1.0,
        start=0.3,
        plausible=(-0.5, 0.5),
        nodes=(-1.0, -0.5, 0.5, 1.0),
    ),
    edit=edit_scattering_gradient,
    # the path on which a photon can be scattered is not its length here
    columns=("scattering_path_cm",),
)


_EXPONENT = "scattering_exponent"
_BANDWIDTH = "bandwidth_nm"


def edit_spectral_scattering(editor: SceneEditor) -> None:
    """Let the crystal's scattering fall with the wavelength, and light have many of them."""
    wavelength_of(editor)
    if _BANDWIDTH not in editor.scene.parameters:
        meaning = "Full width at half maximum of the light's band, as the detector sees it, nm"
        editor.declare(_BANDWIDTH, USUAL_WIDTH_NM, meaning)
    set_numbers(editor, editor.crystal, _EXPONENT, WAVELENGTH, _BANDWIDTH)


def colours_in_band(values: Values, parameters: Parameters) -> tuple[np.ndarray, np.ndarray]:
    """Parts of the light, and their scattering over that at the band's maximum."""
    of_band = ((WAVELENGTH, USUAL_NM), (_BANDWIDTH, USUAL_WIDTH_NM))
    maximum, width = (float(parameters.get(name, usual)) for name, usual in of_band)
    return scattering_of_colours(values[_EXPONENT], maximum, width)


SPECTRAL_SCATTERING = Effect(
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
    parameters=one_parameter(
        name=_EXPONENT,
        meaning="Exponent p of the scattering's fall with the wavelength",
        maximum=4.0,
        start=2.0,
        plausible=(0.0, 4.0),
        nodes=(1.0, 2.0, 3.0, 4.0),
    ),
    edit=edit_spectral_scattering,
    colours=colours_in_band,
)


def edit_crystal_index(editor: SceneEditor) -> None:
    """Change the ``<default>`` of the crystal's index."""
    editor.set_default("n_crystal", editor.values["n_crystal"])


CRYSTAL_INDEX = Effect(
    name="crystal_index",
    title="wrong index of the crystal",
    family="bulk",
    look=(
        "Measure the deviation of a laser in a prism of the same boule, or take the index "
        "from tables at the wavelength of the emission."
    ),
    physics=(
        "Tabulated indices hold for one wavelength, one polarisation and one sample; molybdates "
        "and tungstates are birefringent (uniaxial), and dispersion is steep near their emission. "
        "The index decides how much light is trapped and how much a gel frees."
    ),
    source="W. L. Bond, J. Appl. Phys. 36 (1965) 1674",
    parameters=one_parameter(
        name="n_crystal",
        meaning="Refractive index of the crystal, as an offset from the scene's",
        minimum=-0.1,
        maximum=0.1,
        start=0.03,
        plausible=(-0.05, 0.05),
        nodes=(-0.1, 0.1),
        nominal="n_crystal",
    ),
    edit=edit_crystal_index,
)


_GAMMAS = (
    "J. H. Hubbell and S. M. Seltzer, Tables of X-Ray Mass Attenuation Coefficients, NISTIR 5632 "
    "(1995)"
)


def births_behind(name: str, what: str) -> tuple[EffectParameter]:
    """How deep radiation goes behind a face; `what` begins the parameter's meaning."""
    return one_parameter(
        name=name,
        meaning=f"{what} in which the radiation is absorbed to 1/e",
        minimum=0.2,
        maximum=100.0,
        start=2.0,
        absent=math.inf,
        plausible=(0.3, 20.0),
        nodes=(0.2, 0.6, 1.3, 2.5, 5.0, 12.0, 40.0),
        coordinate="reciprocal",
        scale=2.0,
    )


def edit_births(editor: SceneEditor, name: str, face: str) -> None:
    """Let the births fall with the depth below a face, by the effect's parameter of this name."""
    if name == _DEPTH_MM and editor.emitter.named("source_width_mm") is not None:
        problem = "light is born in a slab, and does not fall with the depth below the top"
        raise editor.refusal(problem, "take source_width_mm away", editor.emitter)
    for other in (_DEPTH_MM, _SIDE_MM, *(["source_across_mm"] if name == _SIDE_MM else [])):
        if editor.emitter.named(other) is not None:
            problem = f"{other} says where light is born, beside which {name} cannot"
            raise editor.refusal(problem, f"take {other} away", editor.emitter)
    set_numbers(editor, editor.emitter, name)
    editor.reword(editor.emitter, "everywhere in the crystal", f"near the {face} of the crystal")


def weight_births(
    columns: Columns, values: Values, parameters: Parameters, *, name: str, column: str, length: str
) -> np.ndarray:
    """Density exp(-t/d) / (d (1 - exp(-L/d))) at the depth t below a face, over 1/L.

    d is the effect's parameter of this `name`, t a column of the records, L the scene's `length`.
    """
    depth_mm = values[name]
    lengths = float(parameters[length]) / depth_mm
    if lengths < 1e-9:
        return np.ones(len(columns[column]))
    births = np.exp(-columns[column].astype(np.float64) / depth_mm)
    return lengths / -np.expm1(-lengths) * births


def is_even_along(scene: SceneFile, axis: int, length: str) -> bool:
    """Whether the crystal has one cross-section along x or z, and the length of a parameter.

    Of births in others, and of bevelled ones, `weight_births` does not know the mean.
    """
    parts, ends = scene.parts, list[float]()
    crystals = {m for e in scene.root.iter("emitter") for m in parts.targets(e, "medium")}
    walls = ("cylinder", "prism_sides") if axis == 2 else ()
    kinds = ("rectangle", "panel", *walls, *(("disk", "polygon") if axis == 2 else ()))
    for face in (shape for shape in parts.shapes if crystals & {*parts.media(shape)}):
        if face.type not in kinds or face.named("top_width") is not None:
            return False
        matrix = transform_matrix(face.named("to_world"))
        normal = np.abs(matrix[:3, 2]) / np.linalg.norm(matrix[:3, 2])
        if normal[2 if face.type in walls else normal.argmax()] < 1.0 - 1e-9:
            return False
        if face.type not in walls and normal.argmax() == axis:
            ends.append(float(matrix[axis, 3]))
    return bool(ends) and math.isclose(np.ptp(ends), float(scene.parameters[length]), rel_tol=1e-6)


_DEPTH_MM = "source_depth_mm"
_SIDE_MM = "side_depth_mm"

SOURCE_DEPTH = Effect(
    name="source_depth",
    title="source near the top face",
    family="source",
    look=(
        "Turn the crystal over, or put the source beside it: the readings change if light "
        "is born near one face."
    ),
    physics=(
        "Gammas that enter through the top are absorbed exponentially with depth: 59.5 keV "
        "gammas stop in the first millimetre or so of a molybdate or tungstate, and in the "
        "surface where it is an alpha source. The light is then born at a depth t below the top "
        "with a density proportional to exp(-t / depth), not everywhere alike."
    ),
    source=_GAMMAS,
    parameters=births_behind(_DEPTH_MM, "Depth below the top"),
    excludes=("side_source",),
    needs=("crystal_height_mm",),
    edit=partial(edit_births, name=_DEPTH_MM, face="top"),
    columns=("birth_depth_mm",),
    weight=partial(
        weight_births, name=_DEPTH_MM, column="birth_depth_mm", length="crystal_height_mm"
    ),
    weighs_in=partial(is_even_along, axis=2, length="crystal_height_mm"),
)


SIDE_SOURCE = Effect(
    name="side_source",
    title="source beside the crystal",
    family="source",
    look=(
        "See where the source stands. Turn the crystal by a right angle, or put the source above "
        "it: the readings change if light is born near one side."
    ),
    physics=(
        "Gammas that enter through a side are absorbed exponentially with the distance from it: "
        "59.5 keV gammas stop in the first millimetre or so of a molybdate or tungstate. The light "
        "is then born with a density proportional to exp(-(x + W/2) / depth), not everywhere "
        "alike, and nearer to one edge of a mask's hole than to the other."
    ),
    source=_GAMMAS,
    parameters=births_behind(_SIDE_MM, "Depth behind the left side"),
    excludes=("source_depth",),
    needs=("crystal_width_mm",),
    edit=partial(edit_births, name=_SIDE_MM, face="left side"),
    columns=("birth_side_mm",),
    weight=partial(weight_births, name=_SIDE_MM, column="birth_side_mm", length="crystal_width_mm"),
    weighs_in=partial(is_even_along, axis=0, length="crystal_width_mm"),
)
