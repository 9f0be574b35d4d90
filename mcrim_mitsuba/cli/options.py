"""Options of long commands: who does their units, and where their progress is written."""

from __future__ import annotations

import contextlib
import dataclasses
import functools
import math
import os
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click
from click.core import ParameterSource
from rich.console import RenderableType

from mcrim_mitsuba.cli import terminal
from mcrim_mitsuba.core.errors import InputError
from mcrim_mitsuba.core.files import sha256
from mcrim_mitsuba.core.numbers import parse_number, refuse_decimal_comma
from mcrim_mitsuba.core.rounding import counted
from mcrim_mitsuba.core.run import DEFAULT_VARIANT, LARGEST_PRECISION, Parts, Run, processors
from mcrim_mitsuba.runs import array_job
from mcrim_mitsuba.runs.cache import record_versions
from mcrim_mitsuba.runs.executors import Executor, current_executor, use_executor
from mcrim_mitsuba.scene.scene_file import parse_define
from mcrim_mitsuba.transport.variants import refuse_unusable

LARGEST_SEED = 2**63 - 1
_THOUSANDS = re.compile(r"\d{1,3}(,\d{3})+")
_COUNT = re.compile(r"\d+(\.\d+)?(e\+?\d+)?", re.IGNORECASE)
#: A number and its error.
_BETWEEN = re.compile(r"±|\+/-|\+-")


class Written(click.ParamType):
    """What is read from a text; defaults are what they are."""

    def convert(self, value, param, ctx):
        return self.read(param.opts[0], value) if isinstance(value, str) else value

    def read(self, what: str, text: str) -> Any:
        """The value of a text; `what` is the option."""
        raise NotImplementedError


class PhotonCount(Written):
    """A number of photons: 2000000, 2e6 or 2_000_000."""

    name = "count"

    def read(self, what: str, text: str) -> int:
        bare = text.strip().replace("_", "")
        if _THOUSANDS.fullmatch(bare):
            bare = bare.replace(",", "")
        refuse_decimal_comma(what, bare)
        if not _COUNT.fullmatch(bare) or not 1 <= float(bare) <= 1e13 or float(bare) % 1:
            self.fail(f"{text!r} is no number of photons; give 1 to 1e13, such as 2e6")
        return round(float(bare))


class Precision(Written):
    """A relative precision: 0.2% or 0.002."""

    name = "fraction"

    def read(self, what: str, text: str) -> float:
        number = float_of(what, text, percent=True)
        if not 1e-6 <= number <= LARGEST_PRECISION:
            self.fail(f"{text!r} is no precision; give 0.0001% to 50%, such as 0.2%")
        return number


def float_of(what: str, text: str, *, percent: bool) -> float:
    """Number of a text, which may be in per cent; nan of what is none."""
    bare = text.strip()
    refuse_decimal_comma(what, bare)
    share = percent and bare.endswith("%")
    try:
        return float(bare.removesuffix("%") if share else bare) * (0.01 if share else 1.0)
    except ValueError:
        return math.nan


class Number(Written):
    """A finite number within bounds in the option's unit, both included; helps show `metavar`."""

    def __init__(self, metavar: str, least: float = -math.inf, most: float = math.inf) -> None:
        self.name, self.least, self.most = metavar, least, most

    def read(self, what: str, text: str) -> float:
        number = parse_number(what, text)
        if not self.least <= number <= self.most:
            problem = f"{what} = {text.strip()} is out of range"
            raise InputError(problem, f"give a number from {self.least:g} to {self.most:g}")
        return number


class Whole(click.IntRange):
    """A whole number within bounds."""

    def convert(self, value, param, ctx) -> int:
        try:
            return super().convert(value, param, ctx)
        except click.BadParameter:
            most = "2^63 - 1" if self.max == LARGEST_SEED else self.max
            self.fail(f"{value!r} is not a whole number from {self.min} to {most}", param, ctx)


class Folder(click.Path):
    """A folder; the empty name, often a variable that is not set, would be the one one is in."""

    def __init__(self, metavar: str = "FOLDER") -> None:
        super().__init__()
        self.name = metavar

    def convert(self, value, param, ctx):
        if not value:
            problem = f"{param.opts[-1]} names no folder"
            raise InputError(problem, "give its name; . is the one you are in")
        return super().convert(value, param, ctx)


class Share(Written):
    """``0.05`` or ``5%``: a number from 0 up to, but not including, 1."""

    name = "fraction"

    def read(self, what: str, text: str) -> float:
        number = parse_share(what, text)
        if not 0 <= number < 1:
            raise InputError(f"{what} = {text}", "give 0 or more, below 1: 0.05 or 5%")
        return number


def parse_share(what: str, text: str) -> float:
    """Number of ``0.76`` or ``76%``; raises InputError if it is neither."""
    bare = text.strip()
    number = parse_number(what, bare.removesuffix("%"))
    return number / 100 if bare.endswith("%") else number


@dataclass(frozen=True)
class NumberWithError:
    """A positive number and its standard error in the same unit; 0 where none was given."""

    value: float
    sigma: float


class WithError(Written):
    """``14.3±0.2``, ``14.3+-0.2``, ``14.3 ± 1.4%``, or 14.3 for a number without error.

    A `fraction` is at most 1; without an error it may be in per cent: 25%.
    """

    name = "number±error"

    def __init__(self, *, fraction: bool = False) -> None:
        self.fraction = fraction

    def read(self, what: str, text: str) -> NumberWithError:
        first, *errors = map(str.strip, _BETWEEN.split(text))
        if len(errors) > 1:
            problem = f"{what} = '{text}' has {len(errors)} errors"
            raise InputError(problem, "write one, such as 14.3±0.2")
        in_percent = self.fraction and first.endswith("%")
        number = parse_share(what, first) if in_percent else parse_number(what, first)
        if in_percent and errors:
            # 25%±3%: three of a hundred, or three of the 25?
            problem = f"{what} is in per cent and has an error, which may mean two things"
            mend = f"write {number:g} and its error, in the same unit (±0.01) or relative (±4%)"
            raise InputError(problem, mend)
        if number <= 0:
            raise InputError(f"{what} = {number:g}", "give a number above 0")
        if self.fraction and number > 1:
            raise InputError(f"{what} = {number:g} is above 1", "give a fraction: 0.25 for 25 %")
        if not errors:
            return NumberWithError(number, 0.0)
        error = parse_number(f"the error of {what}", errors[0].removesuffix("%"))
        sigma = error / 100 * number if errors[0].endswith("%") else error
        if sigma < 0:
            raise InputError(f"the error of {what} is {error:g}", "give one that is not negative")
        if sigma >= number:
            problem = f"the error of {what} is as large as the number itself"
            mend = "errors are propagated to first order: give one well below it"
            raise InputError(problem, mend)
        return NumberWithError(number, sigma)


#: What is no value of an option, but another one; a file of such a name is ``./--name``.
_FLAG = re.compile("-[a-zA-Z]|--.+")


class Option(click.Option):
    """An option that is refused where click takes the last of two, or an option for its value."""

    def add_to_parser(self, parser, ctx) -> None:
        if self.multiple or self.is_flag:
            super().add_to_parser(parser, ctx)
        else:
            parser.add_option(self, self.opts, self.name, action="append", nargs=self.nargs)

    def consume_value(self, ctx, opts):
        texts = opts[self.name] if isinstance(opts.get(self.name), list) else []
        taken = next(filter(_FLAG.fullmatch, texts), None)
        if taken is not None and not ctx.resilient_parsing:
            raise InputError(f"{self.opts[-1]} has no value before {taken}", "give it one")
        if texts and not self.multiple:
            if len(texts) > 1 and not ctx.resilient_parsing:
                raise InputError(f"{self.opts[-1]} is given {len(texts)} times", "give it once")
            opts = {**opts, self.name: texts[0]}
        return super().consume_value(ctx, opts)


def option(
    flag: str, kind: click.ParamType | str, explained: str, *name: str, **further: Any
) -> Callable[..., Any]:
    """An option of a kind, or a text that helps show as this metavar; its default is shown.

    `name` is the verb's for it, if not that of the flag; `further` what else click takes.
    """
    settings: dict[str, Any] = {"metavar": kind} if isinstance(kind, str) else {"type": kind}
    settings |= {"help": explained, "show_default": "default" in further, **further}
    return click.option(flag, *name, cls=Option, **settings)


def defined(flag: str, metavar: str, explained: str, name: str, example: str = "n_gap=1.46"):
    """An option like ``-D``, which may be repeated: the verb gets a dictionary."""

    def read(ctx, param, texts) -> dict[str, str]:
        values: dict[str, str] = {}
        for text in texts:
            key, value = parse_define(text, flag, example)
            if key in values:
                raise InputError(f"{flag} {key} is given twice", "give it once")
            values[key] = value
        return values

    return option(flag, metavar, explained, name, multiple=True, callback=read)


defines = defined(
    "-D", "NAME=VALUE", "Override a scene parameter (may be repeated); mm, 1/cm.", "overrides"
)


def file(flag: str, explained: str, *name: str, metavar: str = "FILE", **further: Any):
    """An option that names a file; parameters as of `option`."""
    return option(flag, metavar, explained, *name, type=click.Path(), **further)


def output(metavar: str, explained: str, name: str = "path", **further: Any):
    """``--output``; `name` is the verb's for it, `further` what else click takes."""
    return file("-o", explained, "--output", name, metavar=metavar, **further)


def folder(explained: str, **further: Any):
    """``--output`` of a verb that writes several files."""
    return option("-o", Folder(), explained, "--output", "folder", **further)


json_output = file("--json", "Write the result as JSON; - for the screen.", "json_file")
#: For the verbs that have ``--map``.
_DEPOSITS = "Where gammas stop, for --map: x_mm, y_mm, z_mm, energy_keV, a deposit a row."
deposits = file("--deposits", _DEPOSITS, metavar="FILE.csv")


def depth(least: float, end: str = ".", **further: Any):
    """``--depth``, `least` mm or more; `end` of its help, `further` what else click takes."""
    words = f"1/e depth of gammas that stop near a face, for --map{end}"
    return option("--depth", Number("MM", least), words, "depth_mm", **further)


def refuse_without_map() -> None:
    """Refuse ``--depth`` and ``--deposits`` where nothing is spread over a map."""
    context = click.get_current_context()
    typed = [context.get_parameter_source(name) for name in ("depth_mm", "deposits")]
    if ParameterSource.COMMANDLINE in typed and context.params["map_file"] is None:
        problem = "--depth and --deposits say where gammas stop on a map"
        raise InputError(problem, "give --map FILE.nc too")


_OF_SEED = "Seed of the random numbers: the same seed gives the same result."
seed = option("--seed", Whole(0, LARGEST_SEED), _OF_SEED, default=0)
_OF_PRECISION = "Relative standard error to reach, such as 0.2%; photons are spent until then."
precision = option("--precision", Precision(), _OF_PRECISION)


def photons(default: str, *, at_most: bool = False, further: str = ""):
    """``--photons``, with a description of its default; `at_most` beside ``--precision``.

    `further` are sentences on what else may be spent.
    """
    words = f"Photons to follow, such as 2e6 (default: {default})"
    words += "; with --precision, at most." if at_most else "."
    return option("--photons", PhotonCount(), words + (further and f" {further}"))


method = option(
    "--method",
    click.Choice(("photons", "modes")),
    "Follow photons, or solve for a polished box by modes: in milliseconds, without noise, "
    "to --precision or as well as it can be.",
    default="photons",
)


def figure(what: str):
    """``--figure``, for a picture of `what`; its numbers go beside it."""
    return file("--figure", f"Draw {what} (.png or .pdf); the numbers go beside it as .csv.")


def machine(function):
    """``--threads`` and ``--variant``."""
    words = "Processor threads (default: all)."
    threads = option("--threads", Whole(1, 1024), words, callback=_read_threads)
    words = "Mitsuba variant; cuda_ad_rgb needs an NVIDIA GPU."
    variant = option("--variant", "TEXT", words, default=DEFAULT_VARIANT, callback=_read_variant)
    return variant(threads(function))


def _read_threads(ctx, param, value) -> int | None:
    """Threads of which none waits for another's processor, as a callback of click."""
    available = processors()
    if value is None or value <= available:
        return value
    note = f"--threads {value}: of {counted(available, 'processor')} no more can be used"
    terminal.console("-").say_notes([note])
    return available


def _read_variant(ctx, param, value) -> str:
    """A variant that can be used here, as a callback of click: refused before all else."""
    refuse_unusable(value)
    return value


scene = click.argument("scene", type=click.Path(path_type=str))


def complete_effects(ctx, param, incomplete: str) -> list[str]:
    """Effects that a shell proposes, the last of a list with commas between."""
    from mcrim_mitsuba.effects.catalogue import BUILT_IN

    before, comma, last = incomplete.rpartition(",")
    return [before + comma + name for name in sorted(BUILT_IN) if name.startswith(last)]


def effects(flag: str, explained: str):
    """An option that names effects."""
    empty = {"default": "", "show_default": False}
    return option(flag, "EFFECT[,EFFECT]", explained, shell_complete=complete_effects, **empty)


#: Where the command's context keeps whether effects may be executed unasked.
TRUST = "trust_effects"
#: Where it keeps which files the command reads.
FILES = "files"


def trust_effects(where: str):
    """``--trust-effects`` for `showing.when_trusted`; `where` the effects are."""

    def remember(ctx, param, value) -> None:
        ctx.meta[TRUST] = value

    words = f"Execute the Python in {where} without being asked."
    return click.option(
        "--trust-effects", is_flag=True, expose_value=False, callback=remember, help=words
    )


def _reads_campaigns(argument: Callable) -> Callable:
    """An argument, with ``--trust-effects`` for `showing.read_campaign`."""
    return lambda function: argument(trust_effects("the campaign's effects_folder")(function))


_PATH = click.Path(path_type=str)
campaign = _reads_campaigns(click.argument("campaign", type=_PATH))
_FORM = "CAMPAIGN [CAMPAIGN [CAMPAIGN]]"
campaigns = _reads_campaigns(
    click.argument("campaigns", nargs=-1, required=True, type=_PATH, metavar=_FORM)
)

#: How ``--photons`` is explained where effects are tried: the default, and what it counts.
PHOTONS = "up to 2.6e5 of each simulation with an effect in the scene"
FURTHER_PHOTONS = "Configurations as they are get four times as many."
effect_photons = photons(PHOTONS, further=FURTHER_PHOTONS)


def run(function: Callable[..., Any]) -> Callable[..., Any]:
    """``--seed``, ``--variant`` and ``--threads``, as one argument `run`.

    It has what ``--photons`` and ``--precision`` say too, where the verb has these.
    """

    @functools.wraps(function)
    def with_run(**given: Any) -> Any:
        fields = {name: given.pop(name) for name in _OF_RUN if name in given}
        return function(run=Run(**fields), **given)

    return seed(machine(with_run))


# Options of long commands: who does their units, and where their progress is written.

_OF_RUN = ("photons", "precision", "seed", "threads", "variant")
#: Suffixes of files that lines of a log would spoil.
_NO_LOGS = (".xml", ".toml", ".csv", ".json")


@dataclass(frozen=True, kw_only=True)
class Work:
    """What the options say."""

    #: Address of a Dask scheduler.
    cluster: str | None
    #: Of an array job.
    part: array_job.ArrayPart | None
    #: Folder of the array job.
    units: str
    #: File for the progress.
    log: str | None
    #: What the options say of simulations; the progress is added.
    run: Run

    @contextlib.contextmanager
    def begin(self, above: RenderableType | None = None, parts: Parts = ()) -> Iterator[Run]:
        """Let what follows be done by whom options name; `above` stands over the bar of `parts`.

        Raises InputError if the cluster does not answer, or the array job's folder cannot be used;
        PartDoneError at the end of a part of an array job.
        """
        with (
            terminal.photon_progress(above, self.log, parts) as report,
            self._executor() as executor,
            use_executor(executor),
        ):
            run = dataclasses.replace(self.run, progress=report)
            if not isinstance(executor, array_job.PartExecutor):
                yield run
                return
            try:
                yield run
                # a part has no result, even where it finds all units made
                raise executor.done
            except array_job.PartDoneError:
                executor.finish()
                raise

    @contextlib.contextmanager
    def _executor(self) -> Iterator[Executor]:
        """Who does the units: a Dask cluster, a part of an array job, or this process."""
        if self.cluster is not None and self.part is not None:
            problem = "--cluster and --unit are two ways to share the work out"
            raise InputError(problem, "give one of them")
        if self.cluster is not None:
            from mcrim_mitsuba.runs.cluster import ClusterExecutor

            with contextlib.closing(ClusterExecutor(self.cluster)) as executor:
                if not executor.workers:
                    waiting = f"no workers at {self.cluster} yet: the work begins with the first"
                    terminal.console("-").say_notes([waiting])
                yield executor
        elif self.part is not None:
            folder = array_job.UnitFolder(self.units)
            folder.begin(_command(), self.part)
            yield array_job.PartExecutor(folder, self.part)
        else:
            if isinstance(merging := current_executor(), array_job.MergingExecutor):
                merging.folder.refuse_other_files(_hashes())
            yield current_executor()


def work(function: Callable[..., Any]) -> Callable[..., Any]:
    """``--cluster``, ``--unit``, ``--units`` and ``--log``, as one argument `work`.

    Options of `run` come before them, and ``--json`` after them.
    """

    @functools.wraps(function)
    def with_work(*, cluster, unit, units, log, run, **given: Any) -> Any:
        part = None if unit is None else array_job.ArrayPart.parse(unit)
        if part is None and units != array_job.DEFAULT_FOLDER:
            problem = "--units without --unit: nobody shares this folder"
            raise InputError(problem, "give --unit K/N too")
        if log is not None and (log == "-" or Path(log).suffix.lower() in _NO_LOGS):
            problem = "--log would write its lines there"
            raise InputError(problem, "let the name end in .log", path=log)
        if part is not None and run.precision is not None:
            problem = "--precision with --unit: nobody knows beforehand how many units it takes"
            raise InputError(problem, "give --photons")
        work = Work(cluster=cluster, part=part, units=units, log=log, run=run)
        return function(work=work, **given)

    of_part = "Do part K of N only, as one job of an array; `mcrim merge` puts them together."
    shared = "Folder that the parts of --unit share."
    of_cluster = "Let the workers of a Dask scheduler do the work (tcp://host:8786)."
    command: Callable[..., Any] = with_work
    for decorate in (
        json_output,
        file("--log", "Append the progress, unit by unit, to this file."),
        option("--units", Folder(), shared, default=array_job.DEFAULT_FOLDER),
        option("--unit", "K/N", of_part),
        option("--cluster", "ADDRESS", of_cluster),
        run,
    ):
        command = decorate(command)
    return command


def _command() -> dict[str, Any]:
    """The command of this process without what differs from part to part."""
    from mcrim_mitsuba.effects.catalogue import BUILT_IN
    from mcrim_mitsuba.effects.effect import modules_of

    context = click.get_current_context()
    variant = context.params.get("variant") or DEFAULT_VARIANT
    effects = modules_of(BUILT_IN.values())
    arguments, skip, own_options = [], False, ("--unit", "--units", "--log")
    for word in (context.find_root().obj or {}).get("arguments", ()):
        if skip or word in own_options:
            skip = not skip
        elif word.partition("=")[0] not in own_options:
            arguments.append(word)
    versions = record_versions(variant, context.command.callback.__module__, *effects)
    return {"arguments": arguments, "folder": os.getcwd(), "versions": versions, "files": _hashes()}


def _hashes() -> dict[str, str]:
    """SHA-256 (hexadecimal) of all files that the command reads, by their names for it."""
    files = {str(file): file for file in click.get_current_context().meta[FILES] if file.is_file()}
    return {name: sha256(file.read_bytes()) for name, file in files.items()}
