"""A scene, loaded and ready to be simulated: the package's front door to Mitsuba."""

from __future__ import annotations

import platform
from collections.abc import Mapping, Sequence
from pathlib import Path

from mcrim_mitsuba.errors import InputError
from mcrim_mitsuba.files.scene_xml import SceneFile, read_scene
from mcrim_mitsuba.files.values import Value
from mcrim_mitsuba.kernel.llvm import platform_line
from mcrim_mitsuba.kernel.loading import load_scene
from mcrim_mitsuba.kernel.tally import FateTally
from mcrim_mitsuba.kernel.variants import (
    DEFAULT_VARIANT,
    software_versions,
    thread_count,
    use_variant,
)
from mcrim_mitsuba.results import SimulationResult

DEFAULT_PHOTONS = 2_000_000


class Simulation:
    """A scene file with its parameters, loaded into Mitsuba.

    Parameters
    ----------
    scene : str, Path or SceneFile
        The scene, or one that has been read already.
    overrides : mapping, optional
        Scene parameters that differ from the file's defaults, e.g. ``{"n_gap": 1.46}``.
    variant : str
        Mitsuba variant.
    threads : int, optional
        Processor threads; all when not given.
    check : bool
        Whether to refuse a scene that is not sound (see `mcrim_mitsuba.check`); it takes a few
        tenths of a second.

    Attributes
    ----------
    file : SceneFile
    scene : mitsuba.Scene
    model : kernel.scene_model.SceneModel
    crystal : kernel.births.CrystalVolume
        Where photons are born.
    integrator : the scene's ``light_collection`` integrator

    Raises
    ------
    InputError
        If the scene cannot be read or loaded, is not sound, or lacks an integrator, an emitter or
        a detector.
    """

    def __init__(
        self,
        scene: str | Path | SceneFile,
        overrides: Mapping[str, Value] | None = None,
        *,
        variant: str = DEFAULT_VARIANT,
        threads: int | None = None,
        check: bool = True,
    ) -> None:
        if isinstance(scene, SceneFile):
            self.file = scene.with_overrides(overrides) if overrides else scene
        else:
            self.file = read_scene(scene, overrides)
        if check:
            from mcrim_mitsuba.check.scene import refuse_unsound, refuse_wrong_text

            refuse_wrong_text(self.file)
        mi = use_variant(variant, threads)
        self.variant = variant
        from mcrim_mitsuba.kernel.scene_model import DETECTOR, read_scene_model

        self.scene = load_scene(mi, self.file)
        self.integrator = self.scene.integrator()
        if not hasattr(self.integrator, "collect"):
            raise InputError(
                "the scene has no light collection integrator",
                'add <integrator type="light_collection"/>',
                path=self.file.path,
            )
        emitters = [e for e in self.scene.emitters() if hasattr(e, "volume")]
        if len(emitters) != 1:
            raise InputError(
                f"the scene has {len(emitters)} scintillation emitters, not one",
                'write one <emitter type="scintillation"><ref id="crystal"/></emitter>',
                path=self.file.path,
            )
        try:
            self.model = read_scene_model(self.scene)
        except InputError as error:
            raise InputError(error.problem, error.mend, path=self.file.path) from None
        if not any(surface.kind == DETECTOR for surface in self.model.surfaces):
            raise InputError(
                "no shape of the scene is a detector",
                'give the detecting face <bsdf type="photodetector"/>',
                path=self.file.path,
            )
        self.crystal = emitters[0].volume(self.model)
        if check:
            refuse_unsound(self)

    @property
    def polarization(self) -> bool:
        """Whether the scene asks for polarisation to be followed."""
        return self.integrator.polarization

    @property
    def depth_limit(self) -> int:
        """Free flights after which a photon is given up."""
        return self.integrator.depth_limit(self.crystal.scatters)

    def collect(
        self,
        photons=DEFAULT_PHOTONS,
        *,
        precision=None,
        seed=0,
        progress=None,
        general=False,
        max_depth=None,
    ) -> SimulationResult:
        """Light collection efficiency and the fates of all photons.

        Parameters
        ----------
        photons : int
            Photons to follow; with `precision`, at most.
        precision : float, optional
            Wanted relative standard error of eta; the run ends when it is reached.
        seed : int
        progress : callable, optional
            ``progress(done, total, eta, eta_sigma)`` after each chunk.
        general : bool
            Use Mitsuba's own intersection even where the fast path would do.
        max_depth : int, optional
            Free flights after which a photon is given up; `depth_limit` when not given.

        Raises
        ------
        InputError
            If an argument is out of range or the scene leaks light.
        """
        max_depth = max_depth or self.depth_limit
        found = self.integrator.collect(
            self.model, self.crystal, photons=photons, precision=precision, seed=seed,
            progress=progress, general=general, max_depth=max_depth,
        )  # fmt: skip
        return self.result(
            found.tally, photons, seed, precision, seconds=found.seconds,
            path_name=found.path_name, interrupted=found.interrupted, max_depth=max_depth,
        )  # fmt: skip

    def result(
        self,
        tally: FateTally,
        requested: int,
        seed: int,
        precision: float | None,
        *,
        seconds: float,
        path_name: str,
        interrupted: bool,
        max_depth: int,
        cached_photons: int = 0,
        notes: Sequence[str] = (),
    ) -> SimulationResult:
        """What a tally of this scene's photons says; parameters as those of `collect`."""
        budget = {name: tally.fraction(name) for name in tally.sums}
        budget_sigma = {name: tally.sigma(name) for name in tally.sums}
        return SimulationResult(
            eta=budget["detected"],
            eta_sigma=budget_sigma["detected"],
            photons=tally.photons,
            requested=requested,
            seed=seed,
            seconds=seconds,
            budget=budget,
            budget_sigma=budget_sigma,
            parameters=dict(self.file.parameters),
            polarization=self.polarization,
            transport=path_name,
            versions=versions(self.variant),
            scene_hash=self.file.content_hash,
            interrupted=interrupted,
            cached_photons=cached_photons,
            notes=(*_notes(tally, requested, precision, interrupted, max_depth), *notes),
        )


def _notes(tally, photons, precision, interrupted, max_depth) -> tuple[str, ...]:
    """What the reader must know before using the number."""
    notes = []
    if interrupted:
        notes.append(f"interrupted after {tally.photons:,} of {photons:,} photons")
    truncated = tally.fraction("truncated")
    if truncated > 0:
        notes.append(
            f"{100 * truncated:.3g} % of the light was still under way after "
            f"{max_depth} flights and was cut off; eta could be up to that "
            "much higher (max_depth of the integrator sets the limit)"
        )
    lost = tally.fraction("lost")
    if lost > 0:
        notes.append(f"{100 * lost:.2g} % of the light was lost by rounding at the edges of faces")
    eta, sigma = tally.fraction("detected"), tally.sigma("detected")
    if precision is not None and not interrupted and not sigma <= precision * eta:
        notes.append(
            f"the wanted precision of {100 * precision:g} % was not reached with "
            f"{tally.photons:,} photons"
        )
    return tuple(notes)


def versions(variant: str, threads: int | None = None) -> dict[str, str]:
    """Versions of everything that a result depends on.

    Parameters
    ----------
    variant : str
    threads : int, optional
        That were asked for; those that Dr.Jit has when not given.
    """
    return software_versions(variant) | {
        "python": platform.python_version(),
        "variant": variant,
        "threads": str(threads or thread_count()),
        "platform": platform_line(),
    }
