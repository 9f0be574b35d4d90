"""Every effect of the catalogue, Mitsuba against the NumPy tracer: two sizes, two configurations.

    python scripts/crosscheck_effects.py --precision 0.3%

The effect is put into the scene as `mcrim add` does, and into the tracer's bench, which shares no
code with it. Prints a z-score of eta each, and one test of them all at a family-wise 1 %.
"""

from __future__ import annotations

import json
import math
import sys
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import click
from scipy.stats import norm

from mcrim_mitsuba.cli.options import Precision
from mcrim_mitsuba.crosscheck import FAMILY_LEVEL
from mcrim_mitsuba.effects import add, catalogue
from mcrim_mitsuba.errors import InputError
from mcrim_mitsuba.files.scene_xml import read_scene
from mcrim_mitsuba.tracer import Bench, trace

SCENE = Path(__file__).parents[1] / "scenes" / "camoo4.xml"
#: Two sizes of every effect; {} for those that are there or not.
SIZES = {
    "polarization": ({"polarization": True},),
    "anisotropic_scattering": ({"scattering_g": -0.4}, {"scattering_g": 0.8}),
    "rayleigh_scattering": ({},),
    "scattering_gradient": ({"scattering_gradient": -0.5}, {"scattering_gradient": 1.0}),
    "source_depth": ({"source_depth_mm": 1.0}, {"source_depth_mm": 6.0}),
    "surface_roughness": ({"roughness_alpha": 0.05}, {"roughness_alpha": 0.3}),
    "surface_absorption": ({"surface_loss": 0.005}, {"surface_loss": 0.05}),
    "crystal_index": ({"n_crystal": 1.92}, {"n_crystal": 2.1}),
    "gap_index": ({"gap_index_offset": -0.08}, {"gap_index_offset": 0.1}),
    "gap_thickness": ({"gap_offset_mm": -0.03}, {"gap_offset_mm": 0.5}),
    "gap_absorption": ({"gap_absorption_per_cm": 3.0}, {"gap_absorption_per_cm": 20.0}),
    "gap_bubble": ({"bubble_fraction": 0.1}, {"bubble_fraction": 0.6}),
    "top_reflector": ({"top_reflectance": 0.4}, {"top_reflectance": 0.97}),
    "detector_reflection": ({"detector_reflectance": 0.1}, {"detector_reflectance": 0.5}),
    "detector_angle": ({"angular_falloff": 0.3}, {"angular_falloff": 1.0}),
    "detector_radius": ({"radial_falloff": 0.3}, {"radial_falloff": 1.0}),
    "aperture_at_detector": ({},),
    "edge_chamfer": ({"chamfer_mm": 0.2}, {"chamfer_mm": 0.9}),
}
#: Two configurations, and those of effects that need a filled gap.
_ANY = ({"n_gap": 1.0}, {"n_gap": 1.46, "crystal_height_mm": 5.0, "aperture_radius_mm": 7.0})
_FILLED = (_ANY[1], {"n_gap": 1.333, "gap_mm": 0.5})
#: Photons of Mitsuba for one of the tracer's.
_MITSUBA_FACTOR = 8


def cases() -> list[tuple[str, dict[str, float], dict[str, float]]]:
    """Effect, its size, and the configuration."""
    known = catalogue()
    return [
        (name, size, configuration)
        for name, sizes in SIZES.items()
        for size in sizes
        for configuration in (_FILLED if known[name].filled_only else _ANY)
    ]


def mitsuba_eta(name: str, size, configuration, photons: int, seed: int) -> tuple[float, float]:
    """Eta and its error of the scene with the effect."""
    from mcrim_mitsuba.kernel.simulation import Simulation

    scene = read_scene(SCENE)
    if not size or not set(size) <= set(scene.parameters):
        scene = scene.edited(add(name, scene, size))
    scene = scene.with_overrides({**configuration, **size})
    found = Simulation(scene, check=False).collect(photons, seed=seed)
    return found.eta, found.eta_sigma


def numpy_eta(name: str, size, configuration, photons: int, seed: int) -> tuple[float, float]:
    """Eta and its error of the tracer's bench with the effect."""
    switch = {} if size else {name: True}
    found = trace(Bench(**configuration, **size, **switch), photons, seed, max_depth=200_000)
    return found.eta, found.eta_sigma


@click.command()
@click.option("--precision", type=Precision(), default=0.003, help="Of eta in the NumPy tracer.")
@click.option("--seed", type=int, default=0)
@click.option("--only", help="One effect.")
@click.option("--processes", type=int, default=2, help="Of the NumPy tracer.")
@click.option("--json", "json_file", help="Write the rows as JSON.")
def main(precision: float, seed: int, only: str | None, processes: int, json_file) -> None:
    """Cross-check all effects."""
    chosen = [case for case in cases() if only in (None, case[0])]
    if not chosen:
        raise InputError(f"there is no effect {only}", f"name one of {', '.join(SIZES)}")
    etas = [mitsuba_eta(*case, 200_000, seed)[0] for case in chosen]
    photons = [round((1 - eta) / eta / precision**2) for eta in etas]
    rows = []
    with ProcessPoolExecutor(processes) as pool:
        traced = [
            pool.submit(numpy_eta, *case, count, seed + number)
            for number, (case, count) in enumerate(zip(chosen, photons, strict=True))
        ]
        for number, (case, count, future) in enumerate(zip(chosen, photons, traced, strict=True)):
            ours, ours_sigma = mitsuba_eta(*case, _MITSUBA_FACTOR * count, seed + number)
            reference, reference_sigma = future.result()
            z = (ours - reference) / math.hypot(ours_sigma, reference_sigma)
            name, size, configuration = case
            rows.append(
                {"effect": name, **size, "configuration": configuration, "mitsuba": ours,
                 "mitsuba_sigma": ours_sigma, "numpy": reference,
                 "numpy_sigma": reference_sigma, "z": z}
            )  # fmt: skip
            words = ", ".join(f"{k} = {v:g}" for k, v in {**size, **configuration}.items())
            print(f"{name:<22} {words:<72} {ours:.5f} / {reference:.5f}  z {z:+.2f}", flush=True)
    if json_file:
        Path(json_file).write_text(json.dumps(rows, indent=1) + "\n")
    worst = max(abs(row["z"]) for row in rows)
    p_value = min(1.0, len(rows) * 2 * float(norm.sf(worst)))
    print(
        f"{len(rows)} comparisons, largest z {worst:.2f}: family-wise p = {p_value:.3g}, tested "
        f"at {FAMILY_LEVEL:g}"
    )
    sys.exit(0 if p_value >= FAMILY_LEVEL else 1)


if __name__ == "__main__":
    try:
        main()
    except InputError as error:
        sys.exit(f"crosscheck_effects: {error}")
