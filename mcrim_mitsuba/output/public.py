"""The public functions: what the verbs of the command do, from Python.

    import mcrim_mitsuba as mcrim

Every function takes a `Run` (``run=``) or fields of one (``photons=2_000_000, seed=1``), and gives
an `Answer`: what was found, and every way to show it. Errors are `InputError`: one line that says
what is wrong, where, and how to mend it.
"""

from __future__ import annotations

import dataclasses
import importlib
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cached_property, partial
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any

import numpy as np

from mcrim_mitsuba.core.errors import InputError, closest, did_you_mean
from mcrim_mitsuba.core.files import json_text, plain, write_text
from mcrim_mitsuba.core.numbers import number_of, said, unit_of, whole_of
from mcrim_mitsuba.core.run import MOST_PHOTONS, Run
from mcrim_mitsuba.output import describe_scene, description, documents
from mcrim_mitsuba.output.description import Description
from mcrim_mitsuba.scene.scene_file import SceneFile, read_scene

if TYPE_CHECKING:
    import pandas
    import xarray
    from matplotlib.figure import Figure

    from mcrim_mitsuba.campaign.campaign import Campaign
    from mcrim_mitsuba.inference.estimates import ParameterEstimate
    from mcrim_mitsuba.output.figure_style import Drawing
    from mcrim_mitsuba.transport.simulation import Simulation, SimulationResult

Scene = str | Path | SceneFile
_OF_RUN = frozenset(field.name for field in dataclasses.fields(Run))
#: Parts of what was found whose fields an answer has too.
_INNER = ("comparison", "diagnosis", "calibration", "diagnosed", "sections", "repaired")


class Answer:
    """What a function found, and every way to show it.

    Fields of what was found are the answer's own: ``light.eta``, ``fit.chi2``,
    ``found.verdict``; so are fitted parameters, with their errors: ``fit.alpha_scat_per_cm.sigma``.
    ``print(answer)`` shows what the command shows, a notebook the same as tables.
    """

    #: What was found.
    found: Any
    #: How it is shown.
    described: Description
    #: As ``--json`` writes it.
    document: Mapping[str, Any]

    def __init__(
        self,
        found: Any,
        described: Description,
        document: Mapping[str, Any],
        pictures: Mapping[str, Callable[[], Drawing | Figure]] | None = None,
    ) -> None:
        self.found, self.described, self.document = found, described, document
        self._pictures = dict(pictures or {})

    def __getattr__(self, name: str) -> Any:
        if not name.startswith("_") and "found" in self.__dict__:  # not while it is copied
            for part in _parts(self.found):
                parameters = getattr(part, "parameters", None)
                if isinstance(parameters, Mapping) and name in parameters:
                    known = parameters[name]
                    return Fitted(name, known) if hasattr(known, "at_bound") else known
                if hasattr(part, name):
                    return getattr(part, name)
        raise AttributeError(f"{type(self.__dict__.get('found')).__name__} has no {name}")

    def __dir__(self) -> list[str]:
        names = {name for part in _parts(self.found) for name in dir(part) if name[0] != "_"}
        fitted = (getattr(part, "parameters", None) for part in _parts(self.found))
        names |= {name for each in fitted if isinstance(each, Mapping) for name in each}
        return sorted({*super().__dir__(), *names})

    def __str__(self) -> str:
        return description.text(self.described)

    def __repr__(self) -> str:
        return f"<Answer: {self.described.title}; print it to read it>"

    def _repr_html_(self) -> str:
        return str(description.html(self.described))

    def to_json(self, path: str | Path | None = None) -> str:
        """The document of ``--json`` as text; written to a file too, if one is named."""
        text = json_text(self.document, indent=2)
        if path is not None:
            write_text(path, text + "\n")
        return text

    def to_dataframe(self, title: str | None = None) -> pandas.DataFrame:
        """A table of what is shown, with errors in columns of their own (``NAME_sigma``).

        Parameters
        ----------
        title : str, optional
            Of the table; the first one by default.

        Raises
        ------
        InputError
            If there is no such table.
        """
        shown = _chosen(self.described.tables, title, "table", "nothing of this is a table", repr)
        return shown.frame()

    def to_xarray(self) -> xarray.Dataset:
        """As a dataset with units; its attributes say what makes it reproducible.

        Tables of eta lie over their axes, simulations, fits and diagnoses as converted files do; of
        other results it is `to_dataframe`.
        """
        from mcrim_mitsuba.output.codec import dataset, is_convertible, table_of_document

        if hasattr(self.found, "to_xarray"):
            return self.found.to_xarray()
        document = plain(self.document)
        if not is_convertible(document):
            import xarray

            return xarray.Dataset.from_dataframe(self.to_dataframe())
        return dataset(table_of_document(document, self.described.title))

    def plot(self, picture: str | None = None) -> Figure:
        """A figure of it, by matplotlib.

        Parameters
        ----------
        picture : str, optional
            Which one, where there are several; the first by default.

        Raises
        ------
        InputError
            If there is none of this name, or none at all.
        """
        return _chosen(self._pictures, picture, "picture", "there is no picture")().figure

    def draw(self, path: str | Path) -> tuple[Path, ...]:
        """Write all pictures (PNG or PDF) with their numbers (CSV): NAME, NAME_profiles, ...

        Raises
        ------
        InputError
            If a file cannot be written.
        """
        from mcrim_mitsuba.output.figure_style import Drawing, save

        path = Path(path)
        written: list[Path] = []
        for place, (name, make) in enumerate(self._pictures.items()):
            ending = f"_{name}" if place else ""
            to, drawing = path.with_name(f"{path.stem}{ending}{path.suffix}"), make()
            written += drawing.save(to) if isinstance(drawing, Drawing) else [save(drawing, to)]
        return tuple(written)


def _chosen(
    known: Mapping[str, Any],
    name: str | None,
    what: str,
    nothing: str,
    quoted: Callable[[str], str] = str,
) -> Any:
    """The one of this name, or the first; refuses what is not there."""
    if not known:
        raise InputError(nothing, "print it")
    name = next(iter(known)) if name is None else name
    if name not in known:
        mend = f"ask for one of {', '.join(map(quoted, known))}"
        raise InputError(f"there is no {what} {name!r}", mend)
    return known[name]


class Fitted:
    """A fitted parameter with its errors, which says its unit: ``7.5 ± 0.8 ph/keV``.

    It has the fields of `inference.estimates.ParameterEstimate`.
    """

    def __init__(self, name: str, known: ParameterEstimate) -> None:
        self._name, self._known = name, known

    def __getattr__(self, field: str) -> Any:
        if field.startswith("_"):
            raise AttributeError(field)
        return getattr(self._known, field)

    def __str__(self) -> str:
        from mcrim_mitsuba.inference.estimates import LIGHT_YIELD
        from mcrim_mitsuba.output.sentences import estimate_text

        unit = "ph/keV" if self._name == LIGHT_YIELD else unit_of(self._name)
        return " ".join(filter(None, (estimate_text(self._known), unit)))

    def __repr__(self) -> str:
        return f"<{self._name} = {self}>"


def _parts(found: Any) -> Iterator[Any]:
    """What was found, and what it holds that has fields of its own."""
    yield found
    for name in _INNER:
        inner = getattr(found, name, None)
        if inner is not None:
            yield from _parts(inner)


def _answer(
    result: str, found: Any, pictures: Mapping[str, Callable[[], Any]] | None = None, **told: Any
) -> Answer:
    """Of a result; the sentences on campaigns are imported when they are needed."""
    words: ModuleType = describe_scene
    if not hasattr(words, f"of_{result}"):
        words = importlib.import_module("mcrim_mitsuba.output.describe_campaign")
    described, document = (
        getattr(module, f"of_{result}")(found, **told) for module in (words, documents)
    )
    return Answer(found, described, document, pictures)


def _read(campaign: str | Path | Campaign) -> Campaign:
    """The campaign; its reader takes a while to import, which scenes can do without."""
    from mcrim_mitsuba.campaign.campaign import as_campaign

    return as_campaign(campaign)


def _drawn(place: str, *found: Any, **options: Any) -> Any:
    """What a function draws; its module takes a while, and is imported when it is needed."""
    module, _, name = place.partition(".")
    draw = getattr(importlib.import_module(f"mcrim_mitsuba.output.{module}"), name)
    return draw(*found, **options)


def _of_campaign(
    campaign: Campaign, pictures: Mapping[str, Callable[[], Drawing]]
) -> dict[str, Callable[[], Drawing]]:
    """Pictures that carry the campaign's title."""
    return {n: partial(_entitled, campaign.title, p) for n, p in pictures.items()}


def _entitled(title: str, picture: Callable[[], Drawing]) -> Drawing:
    return picture().entitled(title)


def _split(run: Run | None, given: Mapping[str, Any]) -> tuple[Run, dict[str, Any]]:
    """A run with the fields that were given, and what was given besides: scene parameters."""
    others = dict(given)
    own = {name: others.pop(name) for name in given if name in _OF_RUN}
    return dataclasses.replace(run or Run(), **own), others


def _with_parameters(scene: Scene, parameters: Mapping[str, Any]) -> SceneFile:
    """A scene with parameters changed; one that it has not may be a misspelt field of a run."""
    file = read_scene(scene)
    for name in parameters:
        meant = None if name in file.defaults else closest(name, [*file.defaults, *_OF_RUN])
        if meant in _OF_RUN:
            problem = f"{name} is neither a parameter of this scene nor a field of a run"
            raise InputError(problem, f"did you mean {meant}?", path=file.path)
    return read_scene(file, parameters)


def _run(run: Run | None, given: Mapping[str, Any]) -> Run:
    """A run with the fields that were given, where nothing else may be."""
    made, others = _split(run, given)
    if others:
        problem = f"{next(iter(others))} is no field of a run"
        raise InputError(problem, did_you_mean(next(iter(others)), sorted(_OF_RUN)))
    return made


#: Depths (mm) and times (ns) above this are none.
_LONGEST = 1e9


def _above_0(name: str, value: object, kind: str) -> float:
    number = number_of(name, value, "give a number above 0")
    if not 0.0 < number <= _LONGEST:
        raise InputError(f"{name} = {number:g} is no {kind}", "give one above 0")
    return number


def _names(given: str | Sequence[str]) -> tuple[str, ...]:
    """Names, also as a text with commas between them."""
    several = given.split(",") if isinstance(given, str) else given
    return tuple(name.strip() for name in several if name.strip())


# ---------------------------------------------------------------- of a scene


def simulate(
    scene: Scene, *, run: Run | None = None, method: str = "photons", **given: Any
) -> Answer:
    """Light collection efficiency of one configuration, with every photon's fate.

    Parameters
    ----------
    run : Run, optional
        2 million photons, with a precision as many as it takes.
    method : str
        ``modes`` follows no photons: a polished box is solved for, without statistical noise, as
        well as it can be or, sooner, to the run's precision.
    **given
        Scene parameters that differ from the file's (``n_gap=1.46``), and fields of the run.

    Returns
    -------
    Answer
        With the fields of `transport.simulation.SimulationResult`; pictures ``arrival`` and
        ``fates``, which follow its photons again, the first 4 million of more (none of the method
        ``modes``).

    Raises
    ------
    InputError
        If the scene is not sound, a parameter is wrong, or the method does not know such a bench.
    """
    from mcrim_mitsuba.efficiency.noise_free import refuse_method, solve_simulation
    from mcrim_mitsuba.efficiency.simulate import collect
    from mcrim_mitsuba.transport.simulation import Simulation

    run, parameters = _split(run, given)
    refuse_method(method, run)
    file = _with_parameters(scene, parameters)
    simulation = Simulation(file, variant=run.variant, threads=run.threads, check=run.check)
    if method == "modes":
        return _answer("simulation", _noted(solve_simulation(simulation, run), file))
    found = _noted(collect(simulation, run=run), file)
    light = _Followed(simulation, found, run)
    pictures = {
        name: partial(light.draw, f"light_figures.draw_{name}") for name in ("arrival", "fates")
    }
    return _answer("simulation", found, pictures)


class _Followed:
    """Figures of a simulation, for which its photons are followed again."""

    def __init__(self, simulation: Simulation, found: SimulationResult, run: Run) -> None:
        self._simulation: Simulation | None = simulation
        self._file, self._found, self._run = simulation.file, found, run

    def __getstate__(self) -> dict[str, Any]:
        # Mitsuba's scene stays in its process
        return {**self.__dict__, "_simulation": None}

    @cached_property
    def _light(self) -> list[tuple[str, Any]]:
        from mcrim_mitsuba.efficiency.lighting import follow_light
        from mcrim_mitsuba.transport.simulation import Simulation

        file, found, run = self._file, self._found, self._run
        simulation = self._simulation or Simulation(
            file, variant=run.variant, threads=run.threads, check=False
        )
        photons = min(found.photons, MOST_FOR_FIGURES)
        light = follow_light(simulation, run=dataclasses.replace(run, photons=photons))
        # the run's own numbers, also where it has more photons than are followed again
        names = ("eta", "eta_sigma", "budget", "budget_sigma", "photons")
        light = dataclasses.replace(light, **{name: getattr(found, name) for name in names})
        changed = [said(name, file.parameters[name]) for name in file.overrides]
        return [(", ".join([file.path.name, *changed]), light)]

    def draw(self, place: str) -> Any:
        """One of them."""
        return _drawn(place, self._light)


def _noted(found: Any, file: SceneFile) -> Any:
    """A result on a scene, with what the reader must know of the scene."""
    return dataclasses.replace(found, notes=(*file.notes, *found.notes)) if file.notes else found


def eta_map(
    scene: Scene,
    *,
    cells: Sequence[int] | None = None,
    depth_mm: float = 1.0,
    deposits: str | Path | None = None,
    run: Run | None = None,
    **given: Any,
) -> Answer:
    """Light collection efficiency by where light is born, and what its spread adds to a peak.

    Parameters
    ----------
    cells : sequence of int, optional
        Of the map along x, y and z of the crystal's bounding box; 10 each.
    depth_mm : float
        1/e depth of gammas that stop near a face.
    deposits : str or Path, optional
        Table of x_mm, y_mm, z_mm and energy_keV, a deposit a row, to spread light as they do.
    run : Run, optional
        100,000 photons per cell.
    **given
        Scene parameters that differ from the file's (``n_gap=1.46``), and fields of the run.

    Returns
    -------
    Answer
        With the fields of `efficiency.lighting.EtaMap`; picture ``map``; `to_xarray` gives the map.

    Raises
    ------
    InputError
        If the scene is not sound, a parameter is wrong, photons are too few, or a deposit is
        outside the crystal.
    """
    from mcrim_mitsuba.efficiency.lighting import CELLS, all_spreads, map_eta
    from mcrim_mitsuba.transport.simulation import Simulation

    run, parameters = _split(run, given)
    depth_mm = _above_0("depth_mm", depth_mm, "depth")
    file = _with_parameters(scene, parameters)
    simulation = Simulation(file, variant=run.variant, threads=run.threads, check=run.check)
    found = map_eta(simulation, CELLS if cells is None else cells, run=run)
    spreads = all_spreads(found, depth_mm, deposits)
    pictures = {"map": partial(_drawn, "light_figures.draw_map", found, spreads)}
    return _answer("map", found, pictures, spreads=spreads)


def eta_spectrum(
    scene: Scene,
    spectrum: str | Path,
    *,
    quantum_efficiency: str | Path | None = None,
    method: str = "photons",
    run: Run | None = None,
    **given: Any,
) -> Answer:
    """Light collection efficiency over the emission's wavelengths, and its means over the light.

    Parameters
    ----------
    spectrum : str or Path
        Table of wavelength_nm and emission (per nm), and if known efficiency (the detector's) and
        any parameters of the scene at these wavelengths; or an emission spectrum. Indices that
        name a material follow its dispersion.
    quantum_efficiency : str or Path, optional
        Spectrum of the detector's efficiency, where the table has none.
    method : str
        As of `simulate`.
    run : Run, optional
        2 million photons of each simulation: one, or four where an index varies.
    **given
        Scene parameters that differ from the file's (``n_gap=1.46``), and fields of the run.

    Returns
    -------
    Answer
        With the fields of `efficiency.eta_spectrum.EtaSpectrum`; picture ``spectrum``; `to_xarray`.

    Raises
    ------
    InputError
        If a file or the scene is not sound, a parameter is wrong, photons cannot answer a
        wavelength, or the method does not know such a bench.
    """
    from mcrim_mitsuba.efficiency.eta_spectrum import eta_over
    from mcrim_mitsuba.efficiency.noise_free import refuse_method, solve_benches
    from mcrim_mitsuba.scene.emitted_light import read_light

    run, parameters = _split(run, given)
    refuse_method(method, run)
    file = _with_parameters(scene, parameters)
    light = read_light(spectrum, file, quantum_efficiency)
    solver = solve_benches if method == "modes" else None
    found = eta_over(file, light, solver=solver, run=run)
    pictures = {"spectrum": partial(_drawn, "light_figures.draw_spectrum", found)}
    return _answer("spectrum", found, pictures)


def arrival_times(
    scene: Scene,
    *,
    group_index: Mapping[str, float | str] | None = None,
    decay_ns: float | None = None,
    detected: int = 1000,
    run: Run | None = None,
    **given: Any,
) -> Answer:
    """When detected photons arrive: by their paths and the group index of every part.

    Parameters
    ----------
    group_index : mapping, optional
        By medium (``outside`` is what lies around all of them): numbers, or materials
        (``{"crystal": "CaMoO4@540nm"}``). By default that of the scene's materials at their
        wavelengths; of indices that are plain numbers the index, which a note says.
    decay_ns : float, optional
        Decay time of the scintillation, folded in; all light is emitted at once without it.
    detected : int
        Detected photons of an event: when the first ten of them arrive is computed.
    run : Run, optional
        2 million photons, 40 million at most.
    **given
        Scene parameters that differ from the file's (``n_gap=1.46``), and fields of the run.

    Returns
    -------
    Answer
        With the fields of `efficiency.arrival_times.ArrivalTimes`; picture ``times``; `to_xarray`
        gives the histogram.

    Raises
    ------
    InputError
        If the scene is not sound, a parameter is wrong, no light is detected, or a group index is
        not known.
    """
    from mcrim_mitsuba.efficiency.arrival_times import follow_times
    from mcrim_mitsuba.transport.simulation import Simulation

    run, parameters = _split(run, given)
    if decay_ns is not None:
        decay_ns = _above_0("decay_ns", decay_ns, "decay time")
    detected = whole_of("detected", detected, "give a whole number from 1", 1, MOST_PHOTONS)
    file = _with_parameters(scene, parameters)
    simulation = Simulation(file, variant=run.variant, threads=run.threads, check=run.check)
    found = follow_times(
        simulation, group_index=group_index, decay_ns=decay_ns, detected=detected, run=run
    )
    return _answer("times", found, {"times": partial(_drawn, "light_figures.draw_times", found)})


#: Photons of figures, at most: more would not be seen.
MOST_FOR_FIGURES = 4_000_000


def table(scene: Scene, *, run: Run | None = None, method: str = "photons", **given: Any) -> Answer:
    """Light collection efficiency over any parameters of a scene.

    Values of ``alpha_scat_per_cm`` and ``alpha_abs_per_cm`` are answered by one simulation of each
    configuration; values of every other parameter make configurations.

    Parameters
    ----------
    run : Run, optional
        2 million photons of each configuration, with a precision as many as it takes.
    method : str
        ``modes`` follows no photons: polished boxes are solved for, without statistical noise, as
        well as they can be or, sooner, to the run's precision.
    **given
        Axes (``gap_mm=[0.02, 0.05]``), single values of parameters (``n_gap=1.46``), and fields
        of the run.

    Returns
    -------
    Answer
        With the fields of `efficiency.table.EtaTable`; picture ``eta``.

    Raises
    ------
    InputError
        If the scene is not sound or lacks one of the parameters, a value is out of range, or the
        method does not know such a bench.
    """
    from mcrim_mitsuba.efficiency.noise_free import noise_free_table, refuse_method
    from mcrim_mitsuba.efficiency.table import eta_table

    run, parameters = _split(run, given)
    refuse_method(method, run)
    axes = {
        name: list(values)
        for name, values in parameters.items()
        if np.iterable(values) and not isinstance(values, str | bytes)
    }
    file = _with_parameters(scene, {n: v for n, v in parameters.items() if n not in axes})
    start = time.perf_counter()
    tabulated = noise_free_table if method == "modes" else eta_table
    made = _noted(tabulated(file, axes, run=run), file)
    seconds = time.perf_counter() - start
    pictures = {"eta": partial(_drawn, "light_figures.draw_table", made)}
    return _answer("table", made, pictures, seconds=seconds)


def check(scene: Scene, *, run: Run | None = None, **given: Any) -> Answer:
    """Whether a scene is sound, and what it means in words.

    Parameters
    ----------
    run : Run, optional
        Its variant and threads count.
    **given
        Scene parameters that differ from the file's, and fields of the run.

    Returns
    -------
    Answer
        With the fields of `scene.check_text.CheckReport`: ``ok``, ``problems``, ...; a file that
        cannot be read is a problem too. Picture ``cross_section``, of a sound scene.
    """
    from mcrim_mitsuba.transport.simulation import check_scene

    run, parameters = _split(run, given)
    found = check_scene(scene, parameters, variant=run.variant, threads=run.threads)
    section = partial(_cross_section, scene, parameters, run, found.interfaces)
    return _answer("check", found, {"cross_section": section} if found.ok else {})


def _cross_section(
    scene: Scene, parameters: Mapping[str, Any], run: Run, interfaces: Any
) -> Figure:
    from mcrim_mitsuba.transport.simulation import Simulation

    loaded = Simulation(scene, parameters, variant=run.variant, threads=run.threads, check=False)
    return _drawn("cross_section.cross_section_figure", loaded, interfaces)


def crosscheck(scene: Scene, *, run: Run | None = None, **given: Any) -> Answer:
    """Mitsuba against the independent NumPy tracer, fate by fate.

    Parameters
    ----------
    run : Run, optional
        1 million photons in the tracer, four times as many in Mitsuba.
    **given
        Scene parameters that differ from the file's, and fields of the run.

    Returns
    -------
    Answer
        With the fields of `reference.crosscheck.Crosscheck`: ``rows``, ``agrees``, ...

    Raises
    ------
    InputError
        If the scene is not sound, or of a form that the tracer does not know.
    """
    from mcrim_mitsuba.reference.crosscheck import crosscheck as compared

    run, parameters = _split(run, given)
    found = compared(scene, parameters, run=run)
    return Answer(
        found, describe_scene.of_crosscheck(found), documents.of_crosscheck(found, run.seed)
    )


def render(scene: Scene, *, run: Run | None = None, **given: Any) -> Any:
    """A photograph of the bench: as it stands, taken apart, its lower edge enlarged.

    Parameters
    ----------
    **given
        Scene parameters that differ from the file's, fields of the run, and ``samples``: light
        paths per pixel.

    Returns
    -------
    output.photograph.Rendering
        With ``save(path)``; a notebook shows it.

    Raises
    ------
    InputError
        If the scene is not sound.
    """
    from mcrim_mitsuba.output.photograph import render as photographed

    samples = given.pop("samples", None)
    if samples is not None:
        samples = whole_of("samples", samples, "give a whole number from 1", 1, MOST_PHOTONS)
    run, parameters = _split(run, given)
    return photographed(scene, parameters, samples=samples, run=run)


def add(
    effect: str,
    scene: Scene,
    output: str | Path | None = None,
    *,
    effects_folder: str | Path | None = None,
    trust_effects: bool = False,
    **values: float | str,
) -> SceneFile:
    """A scene with a physical effect of the catalogue in it.

    Parameters
    ----------
    effect : str
        Its id, such as ``gap_bubble``.
    scene : str, Path or SceneFile
        It stays as it is.
    output : str or Path, optional
        File to write the new scene to (``.xml``).
    effects_folder : str or Path, optional
        Of effects of your own: Python, which is executed.
    trust_effects : bool
        Execute it; without, only files that were allowed before.
    **values
        Of the effect's parameters; the catalogue's start where not given.

    Raises
    ------
    InputError
        If the effect is not known, is one of the readings, or cannot be put into this scene; if
        nobody has allowed the folder's Python to be executed.
    """
    from mcrim_mitsuba.effects.catalogue import add as added
    from mcrim_mitsuba.effects.trust import execute_allowed

    file = read_scene(scene)
    execute_allowed(effects_folder, trusted=trust_effects)
    text = added(effect, file, values, effects_folder)
    if output is None:
        return file.edited(text)
    write_text(output, text)
    return read_scene(output)


# ---------------------------------------------------------------- of a campaign


def reduce(campaign: str | Path | Campaign, output: str | Path | None = None) -> Answer:
    """Reduce a campaign's raw data, every step with its errors.

    Parameters
    ----------
    output : str or Path, optional
        Where the campaign is written in plain numbers (``.toml``), its readings beside it
        (``.csv``). Files that are there are replaced.

    Returns
    -------
    Answer
        With the fields of `campaign.reduction.RawData`: ``readings``, ``efficiency``, ...;
        pictures are its ``kinds``: ``histograms``, ``spectra``, ``transmittance``.

    Raises
    ------
    InputError
        If a file cannot be used or written, or if the campaign has no raw data.
    """
    from mcrim_mitsuba.campaign import editor
    from mcrim_mitsuba.output.describe_laboratory import of_reduction

    campaign = editor.reduce(campaign, output)
    raw = campaign.raw
    assert raw is not None  # refused otherwise
    draw = partial(_drawn, "laboratory_figures.draw_raw_data", raw)
    pictures = {kind: partial(draw, kind) for kind in raw.kinds}
    document = {"campaign": campaign.path, **editor.to_json(raw), "plain_campaign": output}
    return Answer(raw, of_reduction(raw), document, _of_campaign(campaign, pictures))


def calibrate(campaign: str | Path | Campaign, *, run: Run | None = None, **given: Any) -> Answer:
    """Fit a campaign: scattering coefficient and light yield, with all their errors.

    Parameters
    ----------
    run : Run, optional
        27 million photons for all configurations together; with a precision, at most.

    Returns
    -------
    Answer
        With the fields of `inference.fit.Calibration`, and the fitted parameters:
        ``fit.light_yield_ph_per_keV``. Pictures ``readings``, ``profiles`` and ``budget``.

    Raises
    ------
    InputError
        If a file is wrong, a scene is not sound, or the readings do not determine the parameters.
    """
    from mcrim_mitsuba.inference.calibrate import calibrate as fitted

    start = time.perf_counter()
    campaign = _read(campaign)
    found = fitted(campaign, run=_run(run, given))
    seconds = time.perf_counter() - start
    fit, unit = found.calibration, campaign.unit
    pictures: dict[str, Callable[[], Any]] = {
        "readings": partial(_drawn, "fit_figures.draw_comparison", fit, unit=unit),
        "profiles": partial(_drawn, "fit_figures.draw_profiles", found.profiles),
        "budget": partial(_drawn, "budget_figures.draw_budget", fit),
    }
    pictures = _of_campaign(campaign, pictures)
    return _answer("calibration", found, pictures, seconds=seconds)


def compare(
    campaign: str | Path | Campaign,
    *others: str | Path | Campaign,
    run: Run | None = None,
    **given: Any,
) -> Answer:
    """A campaign beside its model, or hypotheses on the same readings side by side.

    Parameters and errors as for `calibrate`.

    Parameters
    ----------
    *others : str, Path or Campaign
        One or two more campaigns of the same readings.

    Returns
    -------
    Answer
        Of one campaign where its model fails: the fields of `calibrate` and of
        `inference.compare.Comparison`; picture ``readings``. Of several which the readings prefer:
        those of `inference.hypotheses.SideBySide`: ``verdict``, ``leading``, ``hypotheses``, ...;
        picture ``pulls``.
    """
    campaign = _read(campaign)
    if others:
        from mcrim_mitsuba.inference.hypotheses import compare_hypotheses

        several = compare_hypotheses((campaign, *others), run=_run(run, given))
        pulls = {"pulls": partial(_drawn, "fit_figures.draw_hypotheses", several.comparison)}
        return _answer("hypotheses", several, _of_campaign(campaign, pulls))
    from mcrim_mitsuba.inference.compare import compare as compared

    found, unit = compared(campaign, run=_run(run, given)), campaign.unit
    drawn = "fit_figures.draw_comparison", found.comparison
    pictures = {"readings": partial(_drawn, *drawn, unit=unit)}
    return _answer("comparison", found, _of_campaign(campaign, pictures))


def diagnose(
    campaign: str | Path | Campaign,
    *,
    without: str | Sequence[str] = (),
    only: str | Sequence[str] = (),
    run: Run | None = None,
    **given: Any,
) -> Answer:
    """Which effects of the catalogue explain a campaign's misfit.

    Other parameters and errors as for `calibrate`; the photons (260,000) are those of every
    simulation with an effect, configurations as they are get four times as many.

    Parameters
    ----------
    without, only : str or sequence of str
        Effects that are left out, and those that alone are tried: ``"background,saturation"``.

    Returns
    -------
    Answer
        With the fields of `inference.diagnose.Diagnosis`: ``verdict``, ``candidates``,
        ``leading``, ...; picture ``ranking``.
    """
    from mcrim_mitsuba.inference.diagnose import diagnose as diagnosed

    campaign = _read(campaign)
    found = diagnosed(campaign, without=_names(without), only=_names(only), run=_run(run, given))
    pictures = {"ranking": partial(_drawn, "diagnosis_figures.draw_ranking", found.diagnosis)}
    return _answer("diagnosis", found, _of_campaign(campaign, pictures))


def repair(
    campaign: str | Path | Campaign,
    output: str | Path | None = None,
    *,
    effect: str | Sequence[str] = (),
    run: Run | None = None,
    on_step: Callable[[Any], None] | None = None,
    **given: Any,
) -> Answer:
    """Add effects to a campaign one by one while the data justify it.

    Parameters
    ----------
    output : str or Path, optional
        Where the mended campaign is written (``.toml``), its scene beside it.
    effect : str or sequence of str
        What is added, whatever the verdict; by default what it names, where its size is one that
        a laboratory meets.
    run : Run, optional
        As for `diagnose`.
    on_step : callable, optional
        Called with every `inference.diagnose.RepairStep` as soon as it is known.

    Returns
    -------
    Answer
        With ``effects`` (what was added), ``campaign_path``, ``scene_path``, the fitted
        parameters, and all of `diagnose`; pictures ``staircase`` and ``readings``.

    Raises
    ------
    InputError
        As for `diagnose`, or if the files cannot be written.
    """
    from mcrim_mitsuba.inference.repair import repair as repaired
    from mcrim_mitsuba.output.sentences import in_words

    campaign = _read(campaign)
    found = repaired(campaign, output, effect=_names(effect), run=_run(run, given), on_step=on_step)
    diagnosis = found.diagnosed.diagnosis
    after = found.calibration if found.effects else None
    added = in_words(diagnosis, found.effects) if found.effects else ""
    unit = campaign.unit
    compared = "fit_figures.draw_comparison", diagnosis.baseline, after
    pictures = {
        "staircase": partial(_drawn, "diagnosis_figures.draw_staircase", diagnosis.repair, after),
        "readings": partial(_drawn, *compared, added=added, unit=unit),
    }
    return _answer("repair", found, _of_campaign(campaign, pictures))


def budget(
    campaign: str | Path | Campaign,
    *,
    material: str | None = None,
    emission: str | Path | None = None,
    wavelength_nm: float | None = None,
    eta_map: str | Path | None = None,
    depth_mm: float | None = None,
    deposits: str | Path | None = None,
    run: Run | None = None,
    **given: Any,
) -> Answer:
    """Where all errors of a campaign come from, and what its model leaves out.

    Parameters
    ----------
    material : str, optional
        What the crystal is made of, as the catalogue of materials names it.
    emission : str or Path, optional
        File with the emission spectrum; the campaign's own by default.
    wavelength_nm : float, optional
        Maximum of a Gaussian band, where there is no spectrum.
    eta_map : str or Path, optional
        File that ``simulate --map`` wrote, of the bench of a reading: what it does to the light
        yield where gammas stop is then said.
    depth_mm : float, optional
        1/e depth of gammas that stop near a face; by default the material's, or 1 mm.
    deposits : str or Path, optional
        Table of where gammas stop, as for `eta_map`.
    run : Run, optional
        As for `diagnose`.

    Returns
    -------
    Answer
        With the fields of `inference.budget.Budget`; picture ``neglected``.

    Raises
    ------
    InputError
        As for `calibrate`, or if a material or a spectrum is wrong.
    """
    from mcrim_mitsuba.inference.budget import budget as budgeted

    campaign = _read(campaign)
    if wavelength_nm is not None:
        wavelength_nm = _above_0("wavelength_nm", wavelength_nm, "wavelength")
    if depth_mm is not None:
        depth_mm = _above_0("depth_mm", depth_mm, "depth")
    found = budgeted(
        campaign,
        material=material,
        emission=emission,
        wavelength_nm=wavelength_nm,
        eta_map=eta_map,
        depth_mm=depth_mm,
        deposits=deposits,
        run=_run(run, given),
    )
    pictures = {"neglected": partial(_drawn, "budget_figures.draw_neglected", found)}
    return _answer("budget", found, _of_campaign(campaign, pictures))


#: Choices of a plan, each one of several numbers.
_OF_PLAN: dict[str, Callable[[str, Any], float]] = {
    "n_gap": partial(number_of, mend="give a list of indices"),
    "mountings": partial(whole_of, mend="give whole numbers from 1", least=1),
    "events": partial(_above_0, kind="number of events"),
}


def plan(
    campaign: str | Path | Campaign, wanted: float, *, run: Run | None = None, **given: Any
) -> Answer:
    """How to measure for a wanted error of the light yield: couplings, mountings, events.

    Parameters
    ----------
    campaign : str, Path or Campaign
        Its readings, photons per event, tell where it stands.
    wanted : float
        Relative error of the light yield.
    **given
        ``n_gap``, ``mountings``, ``events`` and ``conditions`` of `inference.plan.plan`, and
        fields of the run.

    Returns
    -------
    Answer
        With the fields of `inference.plan.Planning`; picture ``plan``.

    Raises
    ------
    InputError
        As for `calibrate`.
    """
    from mcrim_mitsuba.inference.plan import plan as planned
    from mcrim_mitsuba.output import describe_campaign

    campaign = _read(campaign)
    choices = {name: given.pop(name) for name in ("conditions", *_OF_PLAN) if name in given}
    for name in _OF_PLAN.keys() & choices.keys():
        several = choices[name] if np.ndim(choices[name]) else [choices[name]]
        choices[name] = [_OF_PLAN[name](name, value) for value in several]
    run, wanted = _run(run, given), _above_0("wanted", wanted, "relative error")
    found = planned(campaign, wanted, run=run, **choices)
    return Answer(
        found,
        describe_campaign.of_plan(found),
        documents.of_planning(found, run.seed),
        _of_campaign(campaign, {"plan": partial(_drawn, "budget_figures.draw_plan", found)}),
    )


def report(
    campaign: str | Path | Campaign,
    output: str | Path,
    *,
    effects: Sequence[str] | None = None,
    run: Run | None = None,
    **given: Any,
) -> Answer:
    """Diagnose and mend a campaign, and write all that was found as one HTML file.

    Parameters
    ----------
    output : str or Path
        Ends in ``.html``; replaces only another HTML file.
    effects : sequence of str, optional
        What the campaign is mended with; by default what `repair` adds.
    run : Run, optional
        As for `diagnose`.

    Returns
    -------
    Answer
        With ``path``, and what `repair` gives.

    Raises
    ------
    InputError
        As for `diagnose`, or if the file cannot be written.
    """
    from mcrim_mitsuba.output.report import report as reported

    found = reported(campaign, output, effects=effects, run=_run(run, given))
    return _answer("report", found)
