"""A scene, loaded and ready to be simulated: the package's front door to Mitsuba."""

from __future__ import annotations

import itertools
import re
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from lxml import etree

from mcrim_mitsuba.core.errors import InputError, closest, did_you_mean, said_by
from mcrim_mitsuba.core.numbers import Value
from mcrim_mitsuba.core.run import Provenance, signals_wait
from mcrim_mitsuba.scene.check_text import CheckReport, SceneProblem, problems_of_text
from mcrim_mitsuba.scene.mesh_file import EXPORT_AGAIN, refuse_broken_meshes
from mcrim_mitsuba.scene.scene_file import SceneFile, read_scene
from mcrim_mitsuba.scene.xml_tree import PLUGIN_TYPES
from mcrim_mitsuba.transport.launch_plan import FateTally
from mcrim_mitsuba.transport.plugins import properties_of_plugins
from mcrim_mitsuba.transport.variants import DEFAULT_VARIANT, use_variant, versions

if TYPE_CHECKING:
    from mcrim_mitsuba.transport.collection import Launcher

DEFAULT_PHOTONS = 2_000_000
#: Mitsuba has one log and one list of folders for all threads.
_ONE_AT_A_TIME = threading.Lock()
_PLACE = re.compile(r"(?P<file>\S+\.xml)? ?\(line (?P<line>\d+), col (?P<column>\d+)\):? ?")
_NO_PLUGIN = re.compile(r'(?P<kind>\w+) plugin of type "(?P<type>[^"]*)": .*Plugin .* not found')
_NAME = re.compile(
    r'(?P<kind>\w+) plugin of type "(?P<type>\w+)": (\w+|.* property named) "(?P<name>\w+)"'
)
_PLUGIN_SAYS = re.compile(
    r'failed to instantiate (?P<kind>\w+) plugin of type "(?P<type>\w+)": (\[\w+\] )?(?P<says>.+)'
)
_SOURCE = re.compile(r"\[[\w.]+\.(cpp|h):\d+\] ?")


@dataclass(frozen=True)
class SimulationResult(Provenance):
    """The light collection efficiency of one configuration, with every photon accounted for.

    `photons` are those that were followed, fewer than `requested` after an interrupt; `seconds`
    count kernel compilation, and of photons of an earlier run the time that they took then.
    """

    requested: int
    interrupted: bool
    #: Energy that reaches the detector over energy emitted, and its standard error. Where the
    #: detector detects a part only of light that arrives head-on, with which it was calibrated,
    #: what is detected over that part: eta is then not the fate ``detected``, and may exceed 1.
    eta: float
    eta_sigma: float
    #: Fraction of the energy per fate (they sum to 1) and its standard error: ``detected``,
    #: ``absorbed_<medium>``, ``absorbed_aperture``, ``absorbed_reflector``,
    #: ``absorbed_surface`` (lost by a surface that is none of these), ``escaped``,
    #: ``truncated`` (still under way after the depth limit), ``lost`` (left a volume without
    #: crossing a face, by rounding).
    budget: dict[str, float]
    budget_sigma: dict[str, float]
    #: Effective scene parameters.
    parameters: dict[str, Value]
    #: Whether polarisation was followed.
    polarization: bool
    #: Which path of the transport was taken.
    transport: str
    #: Eta of each of several detectors by the id of its shape; empty where there is one. Their sum
    #: is eta, unless the integrator counts one of them alone.
    eta_by_detector: dict[str, float] = field(default_factory=dict)
    eta_by_detector_sigma: dict[str, float] = field(default_factory=dict)

    @property
    def photons_per_second(self) -> float:
        """Photons followed per second of wall time."""
        return self.photons / self.seconds


class Simulation:
    """A scene file with its parameters, loaded into Mitsuba.

    A `scene` that has been read already is not read again. `overrides` are scene parameters that
    differ from the file's defaults, e.g. ``{"n_gap": 1.46}``. All processor threads work when none
    are given. To `check` whether the scene is sound takes a few tenths of a second.

    Raises InputError if the scene cannot be read or loaded, is not sound (see `transport.check`),
    or lacks an integrator, an emitter or a detector.
    """

    @signals_wait()
    def __init__(
        self,
        scene: str | Path | SceneFile,
        overrides: Mapping[str, Value] | None = None,
        *,
        variant: str = DEFAULT_VARIANT,
        threads: int | None = None,
        check: bool = True,
    ) -> None:
        self.file = read_scene(scene, overrides)
        if check:
            _refuse(problems_of_text(self.file))
        mi = use_variant(variant, threads)
        self.variant = variant
        from mcrim_mitsuba.transport.bulk import read_crystal

        self.scene, warnings = load_scene(mi, self.file)
        self.integrator = self.scene.integrator()
        if not hasattr(self.integrator, "depth_limit"):
            problem = "the scene has no light collection integrator"
            raise self._lacks(problem, 'add <integrator type="light_collection"/>')
        with said_by(self._lacks):
            self.crystal = read_crystal(self.scene)
        self.model = self.crystal.model
        turned = self.model.turned_from((self.crystal.lower + self.crystal.upper) / 2.0)
        turn_round = "turns its black back to the crystal: turn it round, or make it twosided"
        #: What is possible, but seldom meant.
        self.notes = (
            *self.model.notes,
            *(f"{name} reflects at its front alone, and {turn_round}" for name in turned),
            *warnings,
        )
        if check:
            from mcrim_mitsuba.transport.check import problems_of_scene

            _refuse(problems_of_scene(self))

    def _lacks(self, problem: str, mend: str) -> InputError:
        return InputError(problem, mend, path=self.file.path)

    @property
    def polarization(self) -> bool:
        """Whether the scene asks for polarisation to be followed."""
        return self.integrator.polarization

    @property
    def depth_limit(self) -> int:
        """Free flights after which a photon is given up."""
        return self.integrator.depth_limit(self.crystal.scatters)

    def launcher(self, general: bool = False, *, fold: bool = True) -> Launcher:
        """What launches photons into this scene: see `transport.collection.Launcher`."""
        from mcrim_mitsuba.transport.collection import Launcher

        return Launcher(self.crystal, self.polarization, general, fold=fold)

    def collect(
        self,
        photons: int = DEFAULT_PHOTONS,
        *,
        precision: float | None = None,
        seed: int = 0,
        progress: Callable[[int, int, float, float], None] | None = None,
        general: bool = False,
        fold: bool = True,
        max_depth: int | None = None,
    ) -> SimulationResult:
        """Light collection efficiency and the fates of all photons.

        The run ends when `precision`, a relative standard error of eta, is reached, or after so
        many `photons`; ``progress(done, total, eta, eta_sigma)`` is called after each launch. A
        photon is given up after `max_depth` free flights, `depth_limit` when not given.

        For cross-checks: `general` uses Mitsuba's own intersection even where the fast path would
        do; without `fold` light does not pass over total reflections (see `transport.folding`) but
        flies from one to the next.

        Raises InputError if an argument is out of range or the scene leaks light.
        """
        from mcrim_mitsuba.transport.collection import collect

        max_depth = max_depth or self.depth_limit
        start, launcher = time.perf_counter(), self.launcher(general, fold=fold)
        interrupted = collect(
            launcher,
            photons,
            seed=seed,
            max_depth=max_depth,
            precision=precision,
            progress=progress,
        )
        return self.result(
            launcher.tally,
            photons,
            seed,
            precision,
            seconds=time.perf_counter() - start,
            path_name=launcher.path.name,
            interrupted=interrupted,
            max_depth=max_depth,
        )

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
        truncated, lost = tally.fraction("truncated"), tally.fraction("lost")
        missed = precision is not None and not interrupted and not tally.reaches(precision)
        notes_if = {
            f"interrupted after {tally.photons:,} of {requested:,} photons": interrupted,
            f"{100 * truncated:.3g} % of the light was still under way after "
            f"{max_depth} flights and was cut off; eta could be up to that "
            "much higher (max_depth of the integrator sets the limit)": truncated > 0,
            f"{100 * lost:.2g} % of the light was lost by rounding at the edges of faces": lost > 0,
            f"the wanted precision of {100 * (precision or 0):g} % was not reached with "
            f"{tally.photons:,} photons": missed,
        }
        return SimulationResult(
            seed=seed,
            photons=tally.photons,
            cached_photons=cached_photons,
            scene_hash=self.file.content_hash,
            versions=versions(self.variant),
            seconds=seconds,
            notes=(
                *calibration_notes(tally.head_on),
                *self.notes,
                *(note for note, holds in notes_if.items() if holds),
                *notes,
            ),
            requested=requested,
            interrupted=interrupted,
            eta=tally.eta,
            eta_sigma=tally.eta_sigma,
            eta_by_detector={name: eta for name, (eta, _) in tally.by_detector.items()},
            eta_by_detector_sigma={name: error for name, (_, error) in tally.by_detector.items()},
            budget=tally.budget,
            budget_sigma=tally.budget_sigma,
            parameters=dict(self.file.parameters),
            polarization=self.polarization,
            transport=path_name,
        )


def calibration_notes(head_on: float) -> tuple[str, ...]:
    """What the user must know of a detector that detects such a part of light head-on."""
    if head_on == 1.0:
        return ()
    relation = f"the detector detects {100 * head_on:.4g} % of light that arrives head-on, and eta"
    return (f"{relation} counts relative to that; the fate detected does not",)


def _refuse(problems: Sequence[SceneProblem]) -> None:
    """Raise the first one, if any."""
    for problem in problems:
        raise problem.error()


def load_scene(mi, file: SceneFile):
    """The scene, loaded into the active variant, and what Mitsuba warns of.

    Raises InputError with the file, line and column that Mitsuba names; if the scene on the disk is
    no longer the one that was read; or if a GPU lacks what traces its rays.
    """
    refuse_broken_meshes(file)
    try:
        loaded = _load(mi, file)
    except InputError:
        raise
    except (RuntimeError, ValueError, TypeError, KeyError) as error:
        raise _refusal(str(error), file) from None
    # Results are labelled, and photon records kept, by the text that was read; Mitsuba reads
    # the files a second time, and someone may have edited them in between.
    if not file.is_unchanged():
        problem = "the scene, or a file that it names, changed while it was being used"
        raise InputError(problem, "run the command again", path=file.path)
    return loaded


def _refusal(text: str, file: SceneFile) -> InputError:
    """Mitsuba's complaint, without lines of its source and without a plugin's traceback."""
    if "initialize OptiX" in text:
        return InputError(
            "NVIDIA's ray tracing library OptiX (libnvoptix.so.1) does not start here",
            "install a complete NVIDIA driver (a container needs its capability graphics), or use "
            "--variant llvm_ad_rgb",
        )
    place = _PLACE.search(text)
    lines = [line.strip() for line in text[place.end() if place else 0 :].splitlines()]
    lines = [line for line in lines if line]
    traceback = "Traceback (most recent call last):"
    if any(line.endswith(traceback) for line in lines):
        cause = f"{lines[0].removesuffix(traceback).rstrip(': ')}: {_clean(lines[-1])}"
    else:
        cause = _clean(" ".join(lines)).replace(" - ", " ")
    refused, at_this_place = _PLUGIN_SAYS.match(cause), "mend the element at this place"
    problem, mend = f"Mitsuba refuses the scene: {cause}", at_this_place
    if unknown := _NO_PLUGIN.search(cause):
        problem = f"there is no {unknown['kind']} of type {unknown['type']!r}"
        mend = did_you_mean(unknown["type"], PLUGIN_TYPES.get(unknown["kind"], ()))
    elif refused:
        wrong, _, how = refused["says"].rstrip(".").partition("; ")
        mend = EXPORT_AGAIN if refused["type"] in ("obj", "ply") else mend
        problem, mend = f"{_plugin_words(refused)}: {wrong}", how or mend
    named = place["file"] if place and place["file"] else ""
    # of a name with blanks this is the end
    path = next((p for p in file.files if named and str(p).endswith(named)), file.path)
    line = int(place["line"]) if place else None
    if place and (told := _refusal_of_names(cause, file, (path, line))) is not None:
        return told
    column = int(place["column"]) if place else None
    if line and refused and mend == at_this_place:
        following = file.source(path).decode(errors="replace").split("\n", line - 1)[-1]
        element = following.partition(f"</{refused['kind']}>")[0]
        given = [
            f"{n} than {v}" for n, v in file.overrides.items() if re.search(rf"\${n}\b", element)
        ]
        mend = f"give another {' or '.join(given)}, or {mend}" if given else mend
    return InputError(problem, mend, path=path, line=line, column=column)


def _refusal_of_names(
    cause: str, file: SceneFile, place: tuple[Path, int | None]
) -> InputError | None:
    """A property that a plugin does not know, or lacks, told where it is written."""
    told = _NAME.search(cause)
    elements = (e for e in file.root.iter(etree.Element) if file.place_of(e) == place)
    element = next((e for e in elements if told and e.type == told["type"]), None)
    if told is None or element is None:
        return None
    kind, name, properties = _plugin_words(told), told["name"], properties_of_plugins()
    proper, nameless = properties.get(told["type"], []), itertools.count()
    # Mitsuba numbers objects without a name
    written = {e.get("name") or f"_arg_{next(nameless)}": e for e in element.elements}
    problem, mend = f"{kind} knows no {name}", did_you_mean(name, proper)
    if name.startswith("_arg_"):
        problem, mend = f"{kind} has no use for this", "take it away"
    elif name not in written:  # but perhaps something in its place
        problem, mend = f"this {kind} has no {name}", f'write <float name="{name}" value="..."/>'
        if slip := closest(name, written.keys() - set(proper)):
            problem, mend, name = f"{kind} knows no {slip}", f"did you mean {name}?", slip
    elif closest(name, proper) is None:
        others = [t for t in PLUGIN_TYPES.get(told["kind"], ()) if name in properties.get(t, ())]
        mend = f'write type="{others[0]}", which knows it, or take it away' if others else mend
    path, line = file.place_of(written.get(name, element))
    return InputError(problem, mend, path=path, line=line)


def _plugin_words(told: re.Match[str]) -> str:
    return f'<{told["kind"]} type="{told["type"]}">'


def _clean(line: str) -> str:
    return re.sub(r"^\w*Error: ", "", _SOURCE.sub("", line)).strip()


def _load(mi, file: SceneFile):
    """What Mitsuba makes of the file, or of the text that stands for it, and what it warns of."""
    from mcrim_mitsuba.transport.conversion import Listener

    overrides = file.overrides_for_mitsuba()
    with _ONE_AT_A_TIME:
        outside, logger = mi.file_resolver(), mi.logger()
        folder, heard = mi.FileResolver(outside), mi.Logger(logger.log_level())
        folder.prepend(str(file.path.parent))
        heard.set_formatter(logger.formatter())
        heard.add_appender(listener := Listener())
        mi.set_file_resolver(folder)
        mi.set_logger(heard)  # Mitsuba's own would write into standard output
        try:
            # Optimising merges shapes, and with that their ids and faces. Mitsuba 3.9 races with
            # itself when it makes the first plugins of a process in parallel: one load of some 300
            # was refused for garbage in a name ("basic_string::_M_create").
            options = {"parallel": False, "optimize": False, **overrides}
            if file.unwritten_text is None:
                scene = mi.load_file(str(file.path), **options)
            else:
                scene = mi.load_string(file.unwritten_text.removeprefix("\ufeff"), **options)
        finally:
            mi.set_file_resolver(outside)
            mi.set_logger(logger)
    lines = [line for line in listener.lines if "performance warning" not in line]
    says = (re.sub(r".* WARN +", "", " ".join(line.split())) for line in lines)
    return scene, tuple(f"Mitsuba warns: {line}" for line in dict.fromkeys(says))


def check_scene(
    scene: str | Path | SceneFile,
    overrides: Mapping[str, Value] | None = None,
    *,
    variant: str = "llvm_ad_rgb",
    threads: int | None = None,
    light: bool = True,
) -> CheckReport:
    """Find out whether a scene is sound, and what it means; parameters as for `Simulation`.

    With `light` photons are sent to see that the detector can be reached. Problems are returned,
    not raised; a file that cannot be read is a problem too.
    """
    from mcrim_mitsuba.transport import check

    try:
        file = read_scene(scene, overrides)
        problems = problems_of_text(file)
        if problems:
            return CheckReport(tuple(problems), dict(file.parameters))
        simulation = Simulation(file, variant=variant, threads=threads, check=False)
    except InputError as error:
        slips = (error, *error.others)
        told = (SceneProblem("file", s.problem, s.mend, s.path, s.line, s.column) for s in slips)
        return CheckReport(tuple(told), {})
    return check.check_simulation(simulation, light=light)
