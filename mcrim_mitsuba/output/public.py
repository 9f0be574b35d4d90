"""The public functions: what the verbs of the command do, from Python.

    import mcrim_mitsuba as mcrim

Every function takes a `Run` (``run=``) or fields that differ from it (``photons=2_000_000,
seed=1``; left out or None, they do not), and gives a typed `registry.Result`: numbers as fields,
and every way to show them. Errors are `InputError`: one line that says what is wrong, where, and
how to mend it.
"""

from __future__ import annotations

import dataclasses
import functools
import inspect
import time
from collections.abc import Callable, Collection, Mapping, Sequence
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any, ParamSpec, TypedDict, TypeVar, Unpack, overload

import numpy as np

from mcrim_mitsuba.core.errors import InputError, closest, did_you_mean
from mcrim_mitsuba.core.files import refuse_to_replace, write_text
from mcrim_mitsuba.core.numbers import number_of, whole_of
from mcrim_mitsuba.core.run import LARGEST_PRECISION, MOST_PHOTONS, Progress, Run
from mcrim_mitsuba.output.registry import fields_of
from mcrim_mitsuba.scene.scene_file import SceneFile, read_scene

if TYPE_CHECKING:
    from mcrim_mitsuba.campaign.campaign import Campaign
    from mcrim_mitsuba.inference.diagnose import RepairStep
    from mcrim_mitsuba.inference.plan import Conditions
    from mcrim_mitsuba.output import campaign_results, scene_results
    from mcrim_mitsuba.output.photograph import Rendering
    from mcrim_mitsuba.transport.simulation import Simulation

__all__ = [
    "add",
    "arrival_times",
    "budget",
    "calibrate",
    "check",
    "compare",
    "crosscheck",
    "diagnose",
    "eta_map",
    "eta_spectrum",
    "plan",
    "reduce",
    "render",
    "repair",
    "report",
    "simulate",
    "table",
]
Scene = str | Path | SceneFile
#: A number of any kind, NumPy's too, or its text.
Number = float | str | np.number[Any]
_Parameters = ParamSpec("_Parameters")
_Result = TypeVar("_Result")
_FIELDS_OF_RUN = tuple(field.name for field in dataclasses.fields(Run))
#: Depths (mm) and times (ns) above this are none.
_LONGEST = 1e9


class RunFields(TypedDict, total=False):
    """Fields of a run that differ from it, where no scene parameters stand beside them."""

    photons: Number | None
    precision: Number | None
    seed: Number | None
    threads: Number | None
    variant: str | None
    progress: Progress | None
    check: bool | None


def _run_of(
    run: Run | None,
    photons: Number | None = None,
    precision: Number | None = None,
    seed: Number | None = None,
    threads: Number | None = None,
    variant: str | None = None,
    progress: Progress | None = None,
    check: bool | None = None,
) -> Run:
    """A run with the fields that were given; one by one, so that editors complete `RunFields`."""
    fields = {n: value for n, value in locals().items() if n != "run" and value is not None}
    return dataclasses.replace(run or Run(), **fields)


_RAISES = """

Raises
------
InputError
    If a file or a value is wrong, a scene is not sound or lacks what is asked of it, readings do
    not determine what is fitted, or a file cannot be written. It says in one line what is wrong,
    where, and how to mend it.
"""


def _is_texts(value: object) -> bool:
    several: Any = [value] if isinstance(value, str) else value
    is_list = isinstance(several, Collection) and getattr(several, "ndim", 1) == 1
    return is_list and all(isinstance(text, str) for text in several)


#: What annotations ask for, and in words; numbers are looked at where they are used.
_KINDS: dict[str, tuple[Callable[[Any], bool], str]] = {
    "str": (lambda value: isinstance(value, str), "a text"),
    "str | Path": (lambda value: isinstance(value, str | PathLike), "a file's name or Path"),
    "str | Sequence[str]": (_is_texts, "a name, or a list of names"),
    "Sequence[str]": (_is_texts, "a list of names"),
    "Mapping[str, float | str]": (lambda value: isinstance(value, Mapping), "a dictionary"),
    "bool": (lambda value: isinstance(value, bool | int | np.bool_), "True or False"),
    "Run": (lambda value: isinstance(value, Run), "a Run"),
    "Callable[[RepairStep], None]": (callable, "a function"),
    "Conditions": (dataclasses.is_dataclass, "Conditions"),
}


def _public(function: Callable[_Parameters, _Result]) -> Callable[_Parameters, _Result]:
    """The function, which says what it raises, and refuses what is no argument in the same way.

    Its signature, as help shows it, has the fields of a run one by one.
    """
    whole = inspect.signature(function)
    signature = dict(whole.parameters)
    if signature.pop("fields", None) is not None:
        fields = list(inspect.signature(_run_of).parameters.values())[1:]
        signature |= {p.name: p.replace(kind=p.KEYWORD_ONLY) for p in fields}
    open_ended = any(p.kind is p.VAR_KEYWORD for p in signature.values())
    shown = whole.replace(parameters=list(signature.values()))

    @functools.wraps(function)
    def refusing(*args: _Parameters.args, **given: _Parameters.kwargs) -> _Result:
        for name in () if open_ended else given:
            if name not in signature:
                mend = did_you_mean(name, sorted({*_FIELDS_OF_RUN, *signature}))
                raise InputError(f"{name} is no field of a run", mend)
        try:
            bound = shown.bind(*args, **given)
        except TypeError as error:
            called = f"mcrim.{function.__name__}"
            raise InputError(f"{called}: {error}", f"see help({called})") from None
        for name, value in bound.arguments.items():
            kind = signature[name].annotation
            if value is None and kind.endswith("None"):
                continue
            fits, words = _KINDS.get(kind.removesuffix(" | None"), (None, ""))
            if fits is not None and not fits(value):
                raise InputError(f"{name} is {value!r}", f"give {words}")
        return function(*args, **given)

    refusing.__signature__ = shown  # type: ignore[attr-defined]
    refusing.__doc__ = inspect.cleandoc(function.__doc__ or "") + _RAISES
    return refusing


def _with_parameters(scene: Scene, parameters: Mapping[str, Any]) -> SceneFile:
    """A scene with parameters changed; one that it has not may be a misspelt field of a run."""
    file = read_scene(scene)
    for name in parameters:
        meant = None if name in file.defaults else closest(name, [*file.defaults, *_FIELDS_OF_RUN])
        if meant in _FIELDS_OF_RUN:
            problem = f"{name} is neither a parameter of this scene nor a field of a run"
            raise InputError(problem, f"did you mean {meant}?", path=file.path)
    return read_scene(file, parameters)


def _loaded(file: SceneFile, run: Run) -> Simulation:
    """A scene, loaded into Mitsuba."""
    from mcrim_mitsuba.transport.simulation import Simulation

    return Simulation(file, variant=run.variant, threads=run.threads, check=run.check)


def _read(campaign: str | Path | Campaign) -> Campaign:
    """The campaign; its reader takes a while to import, which scenes can do without."""
    from mcrim_mitsuba.campaign.campaign import as_campaign

    return as_campaign(campaign)


def _above_0(name: str, value: object, kind: str) -> float:
    number = number_of(name, value, "give a number above 0")
    if not 0.0 < number <= _LONGEST:
        raise InputError(f"{name} = {number:g} is no {kind}", "give one above 0")
    return number


def _names(given: str | Sequence[str]) -> tuple[str, ...]:
    """Names of effects as they are today, also of a text with commas between them."""
    from mcrim_mitsuba.effects.effect import with_new_names

    several = given.split(",") if isinstance(given, str) else given
    return tuple(with_new_names(name.strip()) for name in several if name.strip())


# ---------------------------------------------------------------- of a scene


@_public
def simulate(
    scene: Scene,
    *,
    method: str = "photons",
    run: Run | None = None,
    photons: Number | None = None,
    precision: Number | None = None,
    seed: Number | None = None,
    threads: Number | None = None,
    variant: str | None = None,
    progress: Progress | None = None,
    check: bool | None = None,
    **parameters: Any,
) -> scene_results.LightResult:
    """Light collection efficiency of one configuration, with every photon's fate.

    Parameters
    ----------
    method : str
        ``modes`` follows no photons: a polished box is solved for, without statistical noise, as
        well as it can be or, sooner, to the run's precision.
    run, photons, precision, seed, threads, variant, progress, check
        How it is simulated, see `Run`: 2 million photons, with a precision as many as it takes.
    **parameters
        Scene parameters that differ from the file's (``n_gap=1.46``).

    Returns
    -------
    LightResult
        Pictures ``arrival`` and ``fates`` follow its photons again, the first 4 million of more
        (none of the method ``modes``).
    """
    from mcrim_mitsuba.efficiency.noise_free import refuse_method, solve_simulation
    from mcrim_mitsuba.efficiency.simulate import collect
    from mcrim_mitsuba.output.scene_results import LightResult

    run = _run_of(run, photons, precision, seed, threads, variant, progress, check)
    refuse_method(method, run)
    file = _with_parameters(scene, parameters)
    simulation = _loaded(file, run)
    light = solve_simulation(simulation, run) if method == "modes" else collect(simulation, run=run)
    fields = fields_of(light) | {"notes": (*file.notes, *light.notes)}
    return LightResult(**fields, scene=file, run=run, simulation=simulation)


@_public
def eta_map(
    scene: Scene,
    *,
    cells: Sequence[int] | None = None,
    depth_mm: Number = 1.0,
    deposits: str | Path | None = None,
    run: Run | None = None,
    photons: Number | None = None,
    precision: Number | None = None,
    seed: Number | None = None,
    threads: Number | None = None,
    variant: str | None = None,
    progress: Progress | None = None,
    check: bool | None = None,
    **parameters: Any,
) -> scene_results.MapResult:
    """Light collection efficiency by where light is born, and what its spread adds to a peak.

    Parameters
    ----------
    cells : sequence of int, optional
        Of the map along x, y and z of the crystal's bounding box; 10 each.
    depth_mm : float
        1/e depth of gammas that stop near a face.
    deposits : str or Path, optional
        Table of x_mm, y_mm, z_mm and energy_keV, a deposit a row, to spread light as they do.
    run, photons, precision, seed, threads, variant, progress, check
        How it is simulated, see `Run`: 100,000 photons per cell.
    **parameters
        Scene parameters that differ from the file's (``n_gap=1.46``).

    Returns
    -------
    MapResult
        Picture ``map``; `to_xarray` gives the map.
    """
    from mcrim_mitsuba.efficiency.lighting import CELLS, all_spreads, map_eta
    from mcrim_mitsuba.output.scene_results import MapResult

    run = _run_of(run, photons, precision, seed, threads, variant, progress, check)
    depth_mm = _above_0("depth_mm", depth_mm, "depth")
    simulation = _loaded(_with_parameters(scene, parameters), run)
    mapped = map_eta(simulation, CELLS if cells is None else cells, run=run)
    return MapResult(**fields_of(mapped), gamma_spreads=all_spreads(mapped, depth_mm, deposits))


@_public
def eta_spectrum(
    scene: Scene,
    spectrum: str | Path,
    *,
    quantum_efficiency: str | Path | None = None,
    method: str = "photons",
    run: Run | None = None,
    photons: Number | None = None,
    precision: Number | None = None,
    seed: Number | None = None,
    threads: Number | None = None,
    variant: str | None = None,
    progress: Progress | None = None,
    check: bool | None = None,
    **parameters: Any,
) -> scene_results.SpectrumResult:
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
    run, photons, precision, seed, threads, variant, progress, check
        How it is simulated, see `Run`: 2 million photons of each simulation, of which there is
        one, four where an index varies, 14 where a film's wavelength does.
    **parameters
        Scene parameters that differ from the file's (``n_gap=1.46``).

    Returns
    -------
    SpectrumResult
        Picture ``spectrum``; `to_xarray`.
    """
    from mcrim_mitsuba.efficiency.eta_spectrum import eta_over
    from mcrim_mitsuba.efficiency.noise_free import refuse_method, solve_benches
    from mcrim_mitsuba.output.scene_results import SpectrumResult
    from mcrim_mitsuba.scene.emitted_light import read_light

    run = _run_of(run, photons, precision, seed, threads, variant, progress, check)
    refuse_method(method, run)
    file = _with_parameters(scene, parameters)
    light = read_light(spectrum, file, quantum_efficiency)
    solver = solve_benches if method == "modes" else None
    return SpectrumResult(**fields_of(eta_over(file, light, solver=solver, run=run)))


@_public
def arrival_times(
    scene: Scene,
    *,
    group_index: Mapping[str, float | str] | None = None,
    decay_ns: Number | None = None,
    detected: Number = 1000,
    run: Run | None = None,
    photons: Number | None = None,
    precision: Number | None = None,
    seed: Number | None = None,
    threads: Number | None = None,
    variant: str | None = None,
    progress: Progress | None = None,
    check: bool | None = None,
    **parameters: Any,
) -> scene_results.TimesResult:
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
    run, photons, precision, seed, threads, variant, progress, check
        How it is simulated, see `Run`: 2 million photons, 40 million at most.
    **parameters
        Scene parameters that differ from the file's (``n_gap=1.46``).

    Returns
    -------
    TimesResult
        Picture ``times``; `to_xarray` gives the histogram.
    """
    from mcrim_mitsuba.efficiency.arrival_times import follow_times
    from mcrim_mitsuba.output.scene_results import TimesResult

    run = _run_of(run, photons, precision, seed, threads, variant, progress, check)
    if decay_ns is not None:
        decay_ns = _above_0("decay_ns", decay_ns, "decay time")
    detected = whole_of("detected", detected, "give a whole number from 1", 1, MOST_PHOTONS)
    simulation = _loaded(_with_parameters(scene, parameters), run)
    times = follow_times(
        simulation, group_index=group_index, decay_ns=decay_ns, detected=detected, run=run
    )
    return TimesResult(**fields_of(times))


@_public
def table(
    scene: Scene,
    *,
    method: str = "photons",
    run: Run | None = None,
    photons: Number | None = None,
    precision: Number | None = None,
    seed: Number | None = None,
    threads: Number | None = None,
    variant: str | None = None,
    progress: Progress | None = None,
    check: bool | None = None,
    **parameters: Any,
) -> scene_results.TableResult:
    """Light collection efficiency over any parameters of a scene.

    Values of ``alpha_scat_per_cm`` and ``alpha_abs_per_cm`` are answered by one simulation of each
    configuration; values of every other parameter make configurations.

    Parameters
    ----------
    method : str
        ``modes`` follows no photons: polished boxes are solved for, without statistical noise, as
        well as they can be or, sooner, to the run's precision.
    run, photons, precision, seed, threads, variant, progress, check
        How it is simulated, see `Run`: 2 million photons of each configuration, with a precision
        as many as it takes.
    **parameters
        Axes (``gap_mm=[0.02, 0.05]``), and single values of parameters (``n_gap=1.46``).

    Returns
    -------
    TableResult
        Picture ``eta``; `to_xarray` gives eta over the axes.
    """
    from mcrim_mitsuba.efficiency.noise_free import noise_free_table, refuse_method
    from mcrim_mitsuba.efficiency.table import eta_table
    from mcrim_mitsuba.output.scene_results import TableResult

    run = _run_of(run, photons, precision, seed, threads, variant, progress, check)
    refuse_method(method, run)
    axes = {
        name: list(values)
        for name, values in parameters.items()
        if np.iterable(values) and not isinstance(values, str | bytes)
    }
    file = _with_parameters(scene, {n: v for n, v in parameters.items() if n not in axes})
    start = time.perf_counter()
    tabulated = (noise_free_table if method == "modes" else eta_table)(file, axes, run=run)
    fields = fields_of(tabulated) | {"notes": (*file.notes, *tabulated.notes)}
    return TableResult(**fields, seconds=time.perf_counter() - start)


@_public
def check(
    scene: Scene,
    *,
    run: Run | None = None,
    threads: Number | None = None,
    variant: str | None = None,
    **parameters: Any,
) -> scene_results.CheckResult:
    """Whether a scene is sound, and what it means in words.

    Parameters
    ----------
    run, threads, variant
        Of a `Run` only these two count.
    **parameters
        Scene parameters that differ from the file's.

    Returns
    -------
    CheckResult
        With ``ok``, ``problems``, ...; a file that cannot be read is a problem too. Picture
        ``cross_section``, what is wrong in red.
    """
    from mcrim_mitsuba.output.scene_results import CheckResult
    from mcrim_mitsuba.transport.simulation import check_scene

    run = _run_of(run, threads=threads, variant=variant)
    report = check_scene(scene, parameters, variant=run.variant, threads=run.threads)
    return CheckResult(**fields_of(report), scene=scene, overrides=parameters, run=run)


@_public
def crosscheck(
    scene: Scene,
    *,
    run: Run | None = None,
    photons: Number | None = None,
    precision: Number | None = None,
    seed: Number | None = None,
    threads: Number | None = None,
    variant: str | None = None,
    progress: Progress | None = None,
    check: bool | None = None,
    **parameters: Any,
) -> scene_results.CrosscheckResult:
    """Mitsuba against the independent tracer, fate by fate.

    Parameters
    ----------
    run, photons, precision, seed, threads, variant, progress, check
        How it is simulated, see `Run`: 1 million photons in the tracer, four times as many in
        Mitsuba.
    **parameters
        Scene parameters that differ from the file's.
    """
    from mcrim_mitsuba.output.scene_results import CrosscheckResult
    from mcrim_mitsuba.reference.crosscheck import crosscheck as compare_programs

    run = _run_of(run, photons, precision, seed, threads, variant, progress, check)
    compared = compare_programs(scene, parameters, run=run)
    return CrosscheckResult(**fields_of(compared), seed=run.seed)


@_public
def render(
    scene: Scene,
    *,
    samples: Number | None = None,
    run: Run | None = None,
    photons: Number | None = None,
    precision: Number | None = None,
    seed: Number | None = None,
    threads: Number | None = None,
    variant: str | None = None,
    progress: Progress | None = None,
    check: bool | None = None,
    **parameters: Any,
) -> Rendering:
    """A photograph of the bench: as it stands, taken apart, its lower edge enlarged.

    Parameters
    ----------
    samples : int, optional
        Light paths per pixel.
    run, photons, precision, seed, threads, variant, progress, check
        See `Run`; a picture follows no photons.
    **parameters
        Scene parameters that differ from the file's.

    Returns
    -------
    output.photograph.Rendering
        With ``save(path)``; a notebook shows it.
    """
    from mcrim_mitsuba.output.photograph import render as photograph

    run = _run_of(run, photons, precision, seed, threads, variant, progress, check)
    if samples is not None:
        samples = whole_of("samples", samples, "give a whole number from 1", 1, MOST_PHOTONS)
    return photograph(scene, parameters, samples=samples, run=run)


@_public
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
        File to write the new scene to (``.xml``); one that holds something else is refused.
    effects_folder : str or Path, optional
        Of effects of your own: Python, which is executed.
    trust_effects : bool
        Execute it; without, only files that were allowed before.
    **values
        Of the effect's parameters; the catalogue's start where not given.
    """
    from mcrim_mitsuba.effects.catalogue import add as text_with_effect
    from mcrim_mitsuba.effects.trust import execute_allowed
    from mcrim_mitsuba.inference.repair import text_for_folder

    file = read_scene(scene)
    execute_allowed(effects_folder, trusted=trust_effects)
    new = file.edited(text_with_effect(effect, file, values, effects_folder))
    if output is None:
        return new
    text = text_for_folder(new, Path(output).parent)
    refuse_to_replace({Path(output): text})
    write_text(output, text)
    return read_scene(output)


# ---------------------------------------------------------------- of a campaign


@_public
def reduce(
    campaign: str | Path | Campaign, output: str | Path | None = None
) -> campaign_results.ReductionResult:
    """Reduce a campaign's raw data, every step with its errors.

    Parameters
    ----------
    output : str or Path, optional
        Where the campaign is written in plain numbers (``.toml``), its readings beside it
        (``.csv``). Files that are there are replaced.

    Returns
    -------
    ReductionResult
        With ``readings``, ``efficiency``, ...; pictures are its ``kinds``: ``histograms``,
        ``calibration``, ``spectra``, ``transmittance``.
    """
    from mcrim_mitsuba.campaign.editor import reduce as reduce_campaign
    from mcrim_mitsuba.output.campaign_results import ReductionResult

    campaign = reduce_campaign(campaign, output)
    assert campaign.raw is not None  # refused otherwise
    fields = fields_of(campaign.raw) | {"campaign_path": campaign.path, "plain_path": output}
    return ReductionResult(**fields, title=campaign.title)


@_public
def calibrate(
    campaign: str | Path | Campaign, *, run: Run | None = None, **fields: Unpack[RunFields]
) -> campaign_results.FitResult:
    """Fit a campaign: scattering coefficient and light yield, with all their errors.

    Parameters
    ----------
    run, photons, precision, seed, threads, variant, progress, check
        How it is simulated, see `Run`; the photons (260,000) are those of a simulation with an
        effect, configurations as they are get four times as many. The precision is that of eta in
        every configuration.

    Returns
    -------
    FitResult
        Fitted parameters are fields, ``fit.light_yield_ph_per_keV``, and stand in
        ``fit.parameters``. Pictures ``readings``, ``profiles`` and ``budget``.
    """
    from mcrim_mitsuba.inference.simulations import CampaignSimulations
    from mcrim_mitsuba.inference.simulations import calibrate as fit_campaign
    from mcrim_mitsuba.output.campaign_results import FitResult

    start = time.perf_counter()
    campaign = _read(campaign)
    run = _run_of(run, **fields)
    simulations = CampaignSimulations(campaign, run)
    fit, seconds = fit_campaign(simulations), time.perf_counter() - start
    return FitResult.of(fit, campaign, simulations.provenance(), fit.notes, seconds=seconds)


@overload  # an editor looks for fields here, and not what becomes of `RunFields`
def compare(
    campaign: str | Path | Campaign,
    /,
    *,
    run: Run | None = None,
    photons: Number | None = None,
    precision: Number | None = None,
    seed: Number | None = None,
    threads: Number | None = None,
    variant: str | None = None,
    progress: Progress | None = None,
    check: bool | None = None,
) -> campaign_results.ComparisonResult: ...


@overload
def compare(
    campaign: str | Path | Campaign,
    other: str | Path | Campaign,
    /,
    *others: str | Path | Campaign,
    run: Run | None = None,
    **fields: Unpack[RunFields],
) -> campaign_results.HypothesesResult: ...


@_public
def compare(
    campaign: str | Path | Campaign,
    *others: str | Path | Campaign,
    run: Run | None = None,
    **fields: Unpack[RunFields],
) -> campaign_results.ComparisonResult | campaign_results.HypothesesResult:
    """A campaign beside its model, or hypotheses on the same readings side by side.

    Parameters
    ----------
    *others : str, Path or Campaign
        One or two more campaigns of the same readings.
    run, photons, precision, seed, threads, variant, progress, check
        How it is simulated, see `Run`.

    Returns
    -------
    ComparisonResult or HypothesesResult
        Of one campaign where its model fails, with the fields of `calibrate`; picture
        ``readings``. Of several which the readings prefer: ``verdict``, ``leading``,
        ``hypotheses``, ...; picture ``pulls``.
    """
    from mcrim_mitsuba.output.campaign_results import ComparisonResult, HypothesesResult

    campaign = _read(campaign)
    run = _run_of(run, **fields)
    if others:
        from mcrim_mitsuba.inference.hypotheses import compare_hypotheses

        compared, provenance, scenes = compare_hypotheses((campaign, *others), run=run)
        return HypothesesResult.of(compared, campaign, provenance, scenes=scenes)
    from mcrim_mitsuba.inference.compare import comparison_of
    from mcrim_mitsuba.inference.simulations import CampaignSimulations

    simulations = CampaignSimulations(campaign, run)
    comparison = comparison_of(simulations.fit())
    return ComparisonResult.of(comparison, campaign, simulations.provenance(), comparison.notes)


@_public
def diagnose(
    campaign: str | Path | Campaign,
    *,
    without: str | Sequence[str] = (),
    only: str | Sequence[str] = (),
    sure: Number = 0.9,
    run: Run | None = None,
    **fields: Unpack[RunFields],
) -> campaign_results.DiagnosisResult:
    """Which effects of the catalogue explain a campaign's misfit.

    Parameters
    ----------
    without, only : str or sequence of str
        Effects that are left out, and those that alone are tried: ``"background,nonlinearity"``.
    sure : float
        Probability, 0.5 to 1, from which a family of effects, or a wrong reading, is named.
    run, photons, precision, seed, threads, variant, progress, check
        How it is simulated, see `Run`: 260,000 photons of every simulation with an effect;
        configurations as they are get four times as many.

    Returns
    -------
    DiagnosisResult
        With ``verdict``, ``candidates``, ``leading``, ...; picture ``ranking``.
    """
    from mcrim_mitsuba.inference.diagnose import diagnose as diagnose_campaign
    from mcrim_mitsuba.inference.simulations import CampaignSimulations
    from mcrim_mitsuba.output.campaign_results import DiagnosisResult

    campaign = _read(campaign)
    run = _run_of(run, **fields)
    sure = number_of("sure", sure, mend := "give a probability from 0.5 to 1")
    if not 0.5 <= sure <= 1.0:
        raise InputError(f"sure = {sure:g}", mend)
    simulations = CampaignSimulations(campaign, run)
    diagnosis = diagnose_campaign(
        simulations, without=_names(without), only=_names(only), sure=sure
    )
    notes = diagnosis.baseline.notes
    return DiagnosisResult.of(diagnosis, campaign, simulations.provenance(), notes)


@_public
def repair(
    campaign: str | Path | Campaign,
    output: str | Path | None = None,
    *,
    effect: str | Sequence[str] = (),
    on_step: Callable[[RepairStep], None] | None = None,
    run: Run | None = None,
    **fields: Unpack[RunFields],
) -> campaign_results.RepairResult:
    """Add effects to a campaign one by one while the data justify it.

    Parameters
    ----------
    output : str or Path, optional
        Where the mended campaign is written (``.toml``), its scene beside it.
    effect : str or sequence of str
        What is added, whatever the verdict; by default what it names, where its size is one that
        a laboratory meets.
    on_step : callable, optional
        Called with every `inference.diagnose.RepairStep` as soon as it is known.
    run, photons, precision, seed, threads, variant, progress, check
        As for `diagnose`.

    Returns
    -------
    RepairResult
        With ``effects`` (what was added), ``campaign_path``, ``scene_path``, the fitted
        parameters, and all of `diagnose`; pictures ``staircase`` and ``readings``.
    """
    from mcrim_mitsuba.inference.repair import repair as repair_campaign
    from mcrim_mitsuba.output.campaign_results import RepairResult

    campaign = _read(campaign)
    run = _run_of(run, **fields)
    repaired = repair_campaign(campaign, output, effect=_names(effect), run=run, on_step=on_step)
    return RepairResult.of_repair(repaired, campaign)


@_public
def budget(
    campaign: str | Path | Campaign,
    *,
    material: str | None = None,
    emission: str | Path | None = None,
    wavelength_nm: Number | None = None,
    eta_map: str | Path | None = None,
    depth_mm: Number | None = None,
    deposits: str | Path | None = None,
    run: Run | None = None,
    **fields: Unpack[RunFields],
) -> campaign_results.BudgetResult:
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
    run, photons, precision, seed, threads, variant, progress, check
        As for `diagnose`.

    Returns
    -------
    BudgetResult
        With ``contributions``, ``neglected``, ``totals``, ...; picture ``neglected``.
    """
    from mcrim_mitsuba.inference.budget import budget as budget_of
    from mcrim_mitsuba.output.campaign_results import BudgetResult

    campaign = _read(campaign)
    if wavelength_nm is not None:
        wavelength_nm = _above_0("wavelength_nm", wavelength_nm, "wavelength")
    if depth_mm is not None:
        depth_mm = _above_0("depth_mm", depth_mm, "depth")
    run = _run_of(run, **fields)
    errors = budget_of(
        campaign,
        material=material,
        emission=emission,
        wavelength_nm=wavelength_nm,
        eta_map=eta_map,
        depth_mm=depth_mm,
        deposits=deposits,
        run=run,
    )
    return BudgetResult.of(errors, campaign, errors.provenance, errors.fit.notes)


@_public
def plan(
    campaign: str | Path | Campaign,
    wanted: Number,
    *,
    n_gap: Any = None,
    mountings: Any = None,
    events: Any = None,
    conditions: Conditions | None = None,
    anew: bool = False,
    run: Run | None = None,
    **fields: Unpack[RunFields],
) -> campaign_results.PlanResult:
    """How to measure for a wanted error of the light yield: couplings, mountings, events.

    Parameters
    ----------
    campaign : str, Path or Campaign
        Its readings, photons per event, tell where it stands, and count.
    wanted : float
        Relative error of the light yield.
    n_gap, mountings, events : number or sequence of numbers, optional
        Couplings that can be measured, mountings of each, and events of each mounting. Without
        couplings: what ``[next_measurements]`` lists, or the configurations of the readings.
    conditions : inference.plan.Conditions, optional
        Rates and scatter of the laboratory; by default those of the campaign's histograms.
    anew : bool, default False
        Whether plans do without the readings so far, except transmittances.
    run, photons, precision, seed, threads, variant, progress, check
        As for `calibrate`.

    Returns
    -------
    PlanResult
        With ``cheapest``, ``plans``, ``capability``, ...; picture ``plan``.
    """
    from mcrim_mitsuba.inference.plan import plan as plan_of
    from mcrim_mitsuba.output.campaign_results import PlanResult

    campaign = _read(campaign)
    whole = functools.partial(whole_of, mend="give whole numbers from 1", least=1)
    readers: dict[str, tuple[Any, Callable[[str, Any], float]]] = {
        "n_gap": (n_gap, functools.partial(number_of, mend="give a list of indices")),
        "mountings": (mountings, whole),
        "events": (events, functools.partial(_above_0, kind="number of events")),
    }
    choices: dict[str, Any] = {
        name: [read(name, value) for value in np.atleast_1d(np.asarray(values, object))]
        for name, (values, read) in readers.items()
        if values is not None
    }
    for name in (name for name, values in choices.items() if not values):
        raise InputError(f"there is no value of {name}", "give one at least")
    run = _run_of(run, **fields)
    wanted = _above_0("wanted", wanted, "relative error")
    if wanted > LARGEST_PRECISION:
        raise InputError(f"wanted = {wanted:g} is no relative error", "give 0.09 for 9 %")
    planning = plan_of(campaign, wanted, conditions=conditions, anew=anew, run=run, **choices)
    return PlanResult(**fields_of(planning), title=campaign.title, seed=run.seed)


@_public
def report(
    campaign: str | Path | Campaign,
    output: str | Path,
    *,
    effects: Sequence[str] | None = None,
    run: Run | None = None,
    **fields: Unpack[RunFields],
) -> campaign_results.ReportResult:
    """Diagnose and mend a campaign, and write all that was found as one HTML file.

    Parameters
    ----------
    output : str or Path
        Ends in ``.html``; replaces only another HTML file.
    effects : sequence of str, optional
        What the campaign is mended with; by default what `repair` adds.
    run, photons, precision, seed, threads, variant, progress, check
        As for `diagnose`.

    Returns
    -------
    ReportResult
        With ``path``, and what `repair` gives.
    """
    from mcrim_mitsuba.output.campaign_results import ReportResult
    from mcrim_mitsuba.output.report import report as write_report

    run = _run_of(run, **fields)
    sections = write_report(campaign, output, effects=effects and _names(effects), run=run)
    return ReportResult.of_report(Path(output), sections)
