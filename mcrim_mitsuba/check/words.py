"""Says in sentences what a scene means."""

from __future__ import annotations

import numpy as np

from mcrim_mitsuba.units import MM_PER_CM


def describe(file, model, interfaces, crystal, polarization: bool, transport: str) -> list[str]:
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
        boxes = [model.scene.shapes()[i].bbox() for i in owned]
        lower = np.min([np.array(b.min, dtype=float) for b in boxes], axis=0)
        upper = np.max([np.array(b.max, dtype=float) for b in boxes], axis=0)
        size = " x ".join(f"{v:.4g}" for v in upper - lower)
        text = f"{volume.name}: {size} mm, z from {_tidy(lower[2])} to {_tidy(upper[2])} mm"
        if volume.name in indices:
            text += f", index {indices[volume.name]:g}"
        if volume.alpha_scat_per_mm or volume.alpha_abs_per_mm:
            text += (
                f", scatters {MM_PER_CM * volume.alpha_scat_per_mm:.4g} /cm and absorbs "
                f"{MM_PER_CM * volume.alpha_abs_per_mm:.4g} /cm"
            )
        else:
            text += ", clear"
        if number == crystal.volume:
            text += "; photons are born in it, uniformly and in all directions"
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
    words.append(
        "Fresnel reflection follows each photon's polarisation"
        if polarization
        else "Fresnel reflection is that of unpolarised light"
    )
    words.append(f"transport: {transport}")
    return words


def volume_indices(interfaces) -> dict[str, float]:
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
