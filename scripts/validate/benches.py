"""The benches on which Mitsuba is compared with other programs."""

from __future__ import annotations

import functools
import tomllib
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from scipy.stats import qmc

from mcrim_mitsuba.effects.catalogue import add, catalogue
from mcrim_mitsuba.efficiency.bench import Bench
from mcrim_mitsuba.scene.scene_file import SceneFile, read_scene
from mcrim_mitsuba.scene.spectrophotometer import spectrophotometer_of

SCENES = Path(__file__).parents[2] / "scenes"
#: Benches of the space-filling design, and its seed.
_FILLING, _FILLING_SEED = 40, 1
#: Between these the design's coefficients are drawn.
_ALPHA_SCAT, _ALPHA_ABS = (0.03, 2.0), (0.005, 0.2)
#: Axes of the design, its corners, polarised benches, and sizes of every effect.
_TABLES = tomllib.loads(Path(__file__).with_suffix(".toml").read_text(encoding="utf-8"))
#: Two configurations, and those of effects that need a filled gap.
_ANY = ({"n_gap": 1.0}, {"n_gap": 1.46, "crystal_height_mm": 5.0, "aperture_radius_mm": 7.0})
_FILLED = (_ANY[1], {"n_gap": 1.333, "gap_mm": 0.5})


#: The article's bench.
_PLAIN = "camoo4.xml"


def home(effect: str) -> SceneFile:
    """The article's bench, or where that has nothing for an effect to act on one that has."""
    name, *others = _TABLES["homes"].get(effect, [_PLAIN])
    scene = read_scene(SCENES / name)
    for other, size in (each for effects in others for each in effects.items()):
        scene = scene.edited(add(other, scene, size))
    return scene


@dataclass(frozen=True)
class Case:
    """A bench, a scene for Mitsuba and for the tracer, which reads its text.

    `parameters` differ from those of the scene file. An effect may be added to it, of a `size`
    (the effect's parameters). Groups: ``plain``, ``polarised``, ``wrapped``, ``effect`` and
    ``beam``, in which the crystal is taken from its bench into a spectrophotometer.
    """

    group: str
    parameters: dict[str, float | str]
    scene: str = _PLAIN
    effect: str = ""
    size: dict[str, float] = field(default_factory=dict)

    @property
    def name(self) -> str:
        """The bench in words."""
        values = [
            f"{key} {value}" if isinstance(value, str) else f"{key} {value:g}"
            for key, value in {**self.size, **self.parameters}.items()
        ]
        what = [self.effect or self.group] if self.group != "plain" else []
        if self.group == "beam" and self.effect:
            what = ["beam,", self.effect]
        return " ".join([*what, ", ".join(values) or "as in the article"])

    @functools.cached_property
    def described(self) -> str:
        """Tells the bench from all others."""
        return self.scene_file().content_hash

    def scene_file(self) -> SceneFile:
        """The bench."""
        scene = home(self.effect) if self.scene == _PLAIN else read_scene(SCENES / self.scene)
        if self.effect and not (self.size and set(self.size) <= set(scene.parameters)):
            scene = scene.edited(add(self.effect, scene, self.size))
        if self.group == "beam":
            scene = spectrophotometer_of(scene)
        return scene.with_overrides({**self._of_group, **self.parameters, **self.size})

    def bench(self) -> Bench:
        """The bench for programs that know no scenes; InputError if it is more than they know."""
        return Bench.from_parameters({**self.parameters, **self.size})

    @property
    def _of_group(self) -> dict[str, float]:
        """What all benches of the group have and the article's has not."""
        return _TABLES["beams"]["all"] if self.group == "beam" else {}


def cases() -> list[Case]:
    """All benches: a space-filling design, corners, polarised and wrapped ones, effects."""
    plain = [*_TABLES["corners"], *filling_design()]
    return [
        *(Case("plain", parameters) for parameters in plain),
        *(Case("polarised", {**own, "polarization": True}) for own in _TABLES["polarised"]),
        Case("wrapped", {}, scene="camoo4_wrapped.xml"),
        Case("wrapped", {"n_gap": 1.0}, scene="camoo4_wrapped.xml"),
        *effect_cases(),
        *beam_cases(),
    ]


def filling_design() -> list[dict[str, float]]:
    """A Latin hypercube, optimised for even filling, over all parameters of a plain bench."""
    levels = _TABLES["levels"]
    design = qmc.LatinHypercube(len(levels) + 2, optimization="random-cd", rng=_FILLING_SEED)
    benches = []
    for point in design.random(_FILLING):
        bench = {
            name: values[int(place * len(values))]
            for place, (name, values) in zip(point, levels.items(), strict=False)
        }
        scattering, absorption = point[len(levels) :]
        # many crystals scatter little: even in the square root of the one, the log of the other
        low, high = np.sqrt(_ALPHA_SCAT)
        bench["alpha_scat_per_cm"] = round(float(low + scattering * (high - low)) ** 2, 3)
        low, high = np.log(_ALPHA_ABS)
        bench["alpha_abs_per_cm"] = round(float(np.exp(low + absorption * (high - low))), 4)
        benches.append(bench)
    return benches


def effect_cases() -> list[Case]:
    """Every effect of the catalogue, in two sizes and two configurations."""
    return [
        Case("effect", configuration, effect=name, size=size)
        for name, sizes in _TABLES["effect_sizes"].items()
        for size in sizes
        for configuration in (_FILLED if catalogue()[name].filled_only else _ANY)
    ]


def beam_cases() -> list[Case]:
    """The crystal in a beam: polished, rough, hazy or scattering forwards."""
    beams = _TABLES["beams"]
    rows = [
        (effect, size, {"acceptance_deg": angle, **own})
        for effect, size, own in beams["effects"]
        for angle in beams["acceptance_deg"]
    ]
    return [
        Case("beam", own, effect=effect, size=size) for effect, size, own in [*rows, *beams["more"]]
    ]
