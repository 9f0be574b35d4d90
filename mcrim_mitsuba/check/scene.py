"""Check a scene from its text to its light."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from mcrim_mitsuba.check import books, contacts, indices, plausibility, words
from mcrim_mitsuba.check.report import CheckReport, Interface, Problem
from mcrim_mitsuba.errors import InputError
from mcrim_mitsuba.files.scene_xml import SceneFile, read_scene
from mcrim_mitsuba.files.values import Value

if TYPE_CHECKING:
    from mcrim_mitsuba.kernel.scene_model import SceneModel
    from mcrim_mitsuba.kernel.simulation import Simulation

#: Photons that look for the detector.
SCOUTS = 200_000


def check_scene(
    scene: str | Path | SceneFile,
    overrides: Mapping[str, Value] | None = None,
    *,
    variant: str = "llvm_ad_rgb",
    threads: int | None = None,
    light: bool = True,
) -> CheckReport:
    """Find out whether a scene is sound, and what it means.

    Parameters
    ----------
    scene : str, Path or SceneFile
    overrides : mapping, optional
        Scene parameters that differ from the file's defaults.
    variant, threads
        As for `kernel.simulation.Simulation`.
    light : bool
        Whether to send photons to see that the detector can be reached.

    Returns
    -------
    CheckReport
        Problems are returned, not raised; a file that cannot be read is a problem too.
    """
    try:
        if isinstance(scene, SceneFile):
            file = scene.with_overrides(overrides) if overrides else scene
        else:
            file = read_scene(scene, overrides)
        problems = _of_the_text(file)
        if problems:
            return CheckReport(tuple(problems), dict(file.parameters))
        from mcrim_mitsuba.kernel.simulation import Simulation

        simulation = Simulation(file, variant=variant, threads=threads, check=False)
    except InputError as error:
        problem = Problem("file", error.problem, error.mend, error.path, error.line, error.column)
        return CheckReport((problem,), {})
    return check_simulation(simulation, light=light)


def _of_the_text(file: SceneFile) -> list[Problem]:
    """Problems that can be seen without loading the scene."""
    return [
        *plausibility.problems_of_parameters(file),
        *plausibility.problems_of_rotations(file),
        *indices.problems_of_surfaces(file),
    ]


def check_simulation(simulation: Simulation, *, light: bool = True) -> CheckReport:
    """Check a loaded scene (`kernel.simulation.Simulation`), whose text has been checked.

    See `check_scene`.
    """
    file, model = simulation.file, simulation.model
    faces = interfaces_of(file, model)
    problems = [
        *plausibility.problems_of_media(file, model.volumes),
        *plausibility.problems_of_crystal(
            file, simulation.crystal.lower, simulation.crystal.upper,
            model.volumes[simulation.crystal.volume].name,
        ),
        *contacts.problems_of_contacts(file, model),
    ]  # fmt: skip
    problems = problems or _geometry(file, model, faces)
    if light and not problems:
        problems = _detector(simulation)
    from mcrim_mitsuba.kernel.collection import choose_path

    path = choose_path(model, simulation.polarization)
    sentences = words.describe(
        file, model, faces, simulation.crystal, simulation.polarization, path.name
    )
    return CheckReport(tuple(problems), dict(file.parameters), faces, tuple(sentences))


def interfaces_of(file: SceneFile, model: SceneModel) -> tuple[Interface, ...]:
    """Every face with the volumes and indices on its two sides, in the order of the surfaces."""
    from mcrim_mitsuba.kernel.scene_model import KIND_NAMES, OTHER

    elements = {e.get("id"): e for e in indices.shape_elements(file)}
    faces = []
    for surface in model.surfaces:
        path, line = file.place_of(elements[surface.name])
        pair = indices.indices_of(file, elements[surface.name])
        inside, outside = pair or (None, None)
        faces.append(
            Interface(
                surface.name,
                surface.plugin if surface.kind == OTHER else KIND_NAMES[surface.kind],
                model.volumes[surface.interior].name,
                model.volumes[surface.exterior].name,
                inside,
                outside,
                path,
                line,
            )
        )
    return tuple(faces)


def _geometry(file: SceneFile, model: SceneModel, faces: tuple[Interface, ...]) -> list[Problem]:
    from mcrim_mitsuba.kernel.crossings import probe_lines, trace_crossings

    crossings = trace_crossings(model, *probe_lines(model))
    found = books.problems_of_books(file, model, faces, crossings)
    # Index claims come first where the geometry itself is sound: they name the faces best.
    return books.problems_of_named_volumes(faces) or found


def _detector(simulation: Simulation) -> list[Problem]:
    try:
        result = simulation.collect(SCOUTS)
    except InputError as error:
        return [Problem("leak", error.problem, error.mend, simulation.file.path)]
    if result.budget["detected"] > 0:
        return []
    from mcrim_mitsuba.kernel.scene_model import DETECTOR

    detector = next(s for s in simulation.model.surfaces if s.kind == DETECTOR)
    return [
        Problem(
            "detector",
            f"no light can reach the detector {detector.name}: none of {SCOUTS:,} photons did",
            "look for something opaque before it, or for a detector in the wrong place",
            *simulation.file.place_of_id(detector.name),
        )
    ]


def refuse_unsound(simulation: Simulation) -> None:
    """Raise the first problem of a loaded scene, whose text has been checked, if it has one.

    Raises
    ------
    InputError
        With the place in the scene, what is wrong and how to mend it.
    """
    problems = check_simulation(simulation, light=False).problems
    if problems:
        raise problems[0].error()


def refuse_wrong_text(file: SceneFile) -> None:
    """Raise the first problem that a scene's text has, before anything is loaded.

    Raises
    ------
    InputError
        As `refuse_unsound`.
    """
    problems = _of_the_text(file)
    if problems:
        raise problems[0].error()
