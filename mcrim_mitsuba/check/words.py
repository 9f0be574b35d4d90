"""Says in sentences what a scene means."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

import numpy as np

from mcrim_mitsuba.units import MM_PER_CM

if TYPE_CHECKING:
    from mcrim_mitsuba.check.report import Interface
    from mcrim_mitsuba.files.scene_xml import SceneFile
    from mcrim_mitsuba.kernel.births import CrystalVolume
    from mcrim_mitsuba.kernel.scene_model import SceneModel, Surface, Volume


def describe(
    file: SceneFile,
    model: SceneModel,
    interfaces: Sequence[Interface],
    crystal: CrystalVolume,
    polarization: bool,
    transport: str,
) -> list[str]:
    """What light can do in this scene, for someone who has never seen Mitsuba.

    Parameters
    ----------
    file : SceneFile
    model : kernel.scene_model.SceneModel
    interfaces : sequence of Interface
    crystal : kernel.births.CrystalVolume
    polarization : bool
    transport : str
        Name of the transport path that `simulate` will take.
    """
    words = []
    indices = volume_indices(interfaces)
    for number, volume in enumerate(model.volumes[1:], start=1):
        owned = [i for i, s in enumerate(model.surfaces) if number in (s.interior, s.exterior)]
        boxes = [model.shapes[i].bbox() for i in owned]
        lower = np.min([np.array(b.min, dtype=float) for b in boxes], axis=0)
        upper = np.max([np.array(b.max, dtype=float) for b in boxes], axis=0)
        size = " x ".join(f"{v:.4g}" for v in upper - lower)
        text = f"{volume.name}: {size} mm, z from {_tidy(lower[2])} to {_tidy(upper[2])} mm"
        if volume.name in indices:
            text += f", index {indices[volume.name]:g}"
        if volume.alpha_scat_per_mm or volume.alpha_abs_per_mm:
            text += (
                f", scatters {MM_PER_CM * volume.alpha_scat_per_mm:.4g} /cm{_scattering(volume)} "
                f"and absorbs {MM_PER_CM * volume.alpha_abs_per_mm:.4g} /cm"
            )
        else:
            text += ", clear"
        if number == crystal.volume:
            where = "uniformly"
            if np.isfinite(crystal.source_depth_mm):
                where = f"falling to 1/e every {crystal.source_depth_mm:g} mm below its top"
            text += f"; photons are born in it, {where} and in all directions"
        words.append(text)
    detectors = [f.surface for f in interfaces if f.kind == "detector"]
    words.append(f"detected is what reaches {' or '.join(detectors)}")
    for surface in model.surfaces:
        if surface.aperture_radius_mm < np.inf:
            words.append(
                f"{surface.name} wears a black mask with a hole of radius "
                f"{surface.aperture_radius_mm:g} mm"
            )
        if surface.reflectance > 0:
            words.append(f"{surface.name} reflects {100 * surface.reflectance:g} % diffusely")
        if surface.plugin:
            words.append(f"{surface.name} does what Mitsuba's {surface.plugin} does")
    imperfect: dict[str, list[str]] = {}
    for surface in model.surfaces:
        for what in _imperfections(surface):
            imperfect.setdefault(what, []).append(surface.name)
    words += [f"{what}: {', '.join(names)}" for what, names in imperfect.items()]
    words.append(
        "Fresnel reflection follows each photon's polarisation"
        if polarization
        else "Fresnel reflection is that of unpolarised light"
    )
    words += [f"{name} = {known.value}: {known.words}" for name, known in file.materials.items()]
    words.append(f"transport: {transport}")
    return words


def _scattering(volume: Volume) -> str:
    """How a volume (`kernel.scene_model.Volume`) scatters, where it is not evenly."""
    phases = {"hg": f"Henyey-Greenstein with g = {volume.scattering_g:g}", "rayleigh": "Rayleigh"}
    said = [phases[volume.phase]] if volume.phase in phases else []
    if volume.scattering_gradient:
        said.append(f"{100 * volume.scattering_gradient:+g} % of it at the top")
    return f" ({', '.join(said)})" if said else ""


def _imperfections(surface: Surface) -> list[str]:
    """What a surface (`kernel.scene_model.Surface`) does less well than an ideal one."""
    said = []
    if surface.roughness > 0:
        said.append(f"rough (GGX, alpha = {surface.roughness:g})")
    if surface.surface_loss > 0:
        said.append(f"{100 * surface.surface_loss:g} % of what is reflected inwards is lost")
    if surface.angular_falloff > 0:
        said.append(
            f"detection falls by {100 * surface.angular_falloff:g} % towards grazing incidence"
        )
    if surface.radial_falloff_per_mm2 > 0:
        said.append(
            f"detection falls by {100 * surface.radial_falloff_per_mm2:.3g} % of (r / mm)^2 away "
            "from the axis"
        )
    return said


def volume_indices(interfaces: Iterable[Interface]) -> dict[str, float]:
    """Index of every named volume, from its faces."""
    found: dict[str, float] = {}
    for face in interfaces:
        for volume, index in ((face.interior, face.n_interior), (face.exterior, face.n_exterior)):
            if index is not None and volume != "outside":
                found.setdefault(volume, index)
    return found


def _tidy(position_mm: float) -> str:
    """A coordinate without the rounding of single precision."""
    return f"{round(position_mm, 5) + 0.0:.5g}"
