"""What is fuzzed: every reader of what users give, each with sound inputs to begin from.

A target takes any bytes. It returns where the input was read or refused by an `InputError`, as
users see it in one line; whatever else it raises is a finding.
"""

from __future__ import annotations

import contextlib
import hashlib
import io
import os
import shutil
import tempfile
import tomllib
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

import click
import convert_results
import numpy as np
from convert_results import csv_text, dataset, latex_text, netcdf_bytes, read_results
from shared import SCENES

from fuzz.mutation import SEPARATOR
from mcrim_mitsuba.campaign.campaign import Campaign, read_campaign
from mcrim_mitsuba.campaign.editor import campaign_with_effects, campaign_with_measurements
from mcrim_mitsuba.campaign.measurements import read_table
from mcrim_mitsuba.campaign.raw_data import (
    read_efficiency,
    read_source_depth,
    refuse_misplaced,
    with_numbers,
)
from mcrim_mitsuba.cli import options, terminal

# readers that commands import late are imported here, so that their coverage counts
from mcrim_mitsuba.cli.main import main as mcrim
from mcrim_mitsuba.core.data_table import read_data_table
from mcrim_mitsuba.core.errors import InputError
from mcrim_mitsuba.core.numbers import parse_number, unit_of, value_text
from mcrim_mitsuba.core.toml_document import read_toml
from mcrim_mitsuba.effects.catalogue import BrokenEffectError, add, catalogue
from mcrim_mitsuba.laboratory.histogram import read_histogram
from mcrim_mitsuba.laboratory.light_yield import read_comparison
from mcrim_mitsuba.optics.gammas import attenuation_length_mm
from mcrim_mitsuba.optics.spectrum_file import read_spectrum
from mcrim_mitsuba.runs import cache_files as chunk_file
from mcrim_mitsuba.runs.cache import RecordCache
from mcrim_mitsuba.scene import check_text
from mcrim_mitsuba.scene.scene_file import parse_define, read_scene
from mcrim_mitsuba.scene.values import parse_list, parse_value

RAW = SCENES / "camoo4_raw"
_EFFECTS = tuple(name for name, effect in catalogue().items() if effect.edit is not None)


class Target(NamedTuple):
    """One reader, sound inputs to begin from, and words that the format knows.

    `run` takes the input; it works in the folder that it is called in, see `workplace`.
    """

    run: Callable[[bytes], object]
    seeds: tuple[bytes, ...]
    words: tuple[str, ...]


@contextlib.contextmanager
def workplace() -> Iterator[Path]:
    """A folder to work in, deep enough that ``..`` of a few levels meets nothing of anybody."""
    memory = Path("/dev/shm") if Path("/dev/shm").is_dir() else None
    with tempfile.TemporaryDirectory("mcrim_fuzz", dir=memory, ignore_cleanup_errors=True) as home:
        folder = Path(home, "a/b/c/d/e/f")
        folder.mkdir(parents=True)
        shutil.copy(SCENES / "camoo4.xml", folder / "bench.xml")
        shutil.copy(SCENES / "camoo4_measured.csv", folder / "readings.csv")
        for file in RAW.glob("*.csv"):
            shutil.copy(file, folder)
        os.environ["MCRIM_CACHE"] = "off"
        with contextlib.chdir(folder):
            yield folder


def _files(data: bytes, *names: str) -> tuple[Path, ...]:
    """Writes the parts of an input as files; a part that is missing is no file."""
    parts = data.split(SEPARATOR)
    paths = tuple(map(Path, names))
    for place, path in enumerate(paths):
        if place < len(parts):
            path.write_bytes(parts[place])
        else:
            path.unlink(missing_ok=True)
    return paths


def _joined(*parts: bytes) -> bytes:
    return SEPARATOR.join(parts)


def _executes(path: Path) -> bool:
    """Whether a campaign names a folder of effects, which are programs: fuzzing runs none."""
    try:
        return "effects_folder" in tomllib.loads(path.read_text("utf-8-sig"))
    except (ValueError, RecursionError):
        return False


def _scene(data: bytes) -> None:
    """Main file, an included one, an emission spectrum; what `check` says without rendering."""
    read = read_scene(_files(data, "scene.xml", "part.xml", "band.csv")[0])
    assert read.content_hash == read.with_overrides(read.parameters).content_hash
    check_text.problems_of_text(read)


def _measurements(data: bytes) -> None:
    (path,) = _files(data, "measured.csv")
    parameters = read_scene("bench.xml").parameters if data[:1] == b"#" else {}
    table = read_table(path, parameters)
    assert all(np.isfinite(row.signal) for row in table.readings if row.histogram is None)


def _campaign_of(data: bytes) -> Campaign | None:
    """Of a file and its readings; None where it names effects, which are programs."""
    path, _ = _files(data, "campaign.toml", "measured.csv")
    if _executes(path):
        return None
    read = read_campaign(path)
    for known in read.parameters.values():
        assert known.minimum <= known.start <= known.maximum
    return read


def _raw_campaign(data: bytes) -> None:
    """Entries that name raw data; their files are sound."""
    (path,) = _files(data, "raw.toml")
    if not _executes(path):
        document = read_toml(path)
        refuse_misplaced(document)
        read_efficiency(document.table("light_yield"))
        read_source_depth(document)
        with_numbers(document, {})
        _campaign_of(data)


def _campaign_writing(data: bytes) -> None:
    """A campaign that can be read can be gone on from."""
    read = _campaign_of(data)
    if read is None:
        return
    effects = [name for name in ("background", "nonlinearity") if name not in read.effects]
    target = Path("next.toml")
    texts = [campaign_with_measurements(read, target, Path("measured.csv"))]
    with contextlib.suppress(InputError):  # these effects do not fit this campaign
        mended = read.with_effects(effects)
        starts = {n: p.start for n, p in mended.parameters.items()}
        texts.append(campaign_with_effects(mended, target, Path("bench.xml"), starts))
    for text in texts:
        target.write_text(text)
        again = read_campaign(target)
        assert again.measurements.readings == read.measurements.readings


def _table(data: bytes) -> None:
    (path,) = _files(data, "table.csv")
    table = read_data_table(path, roles=("bin centre", "counts"))
    assert np.isfinite(table.values).all() and len(table.lines) == len(table.values)


def _spectrum(data: bytes) -> None:
    (path,) = _files(data, "spectrum.csv")
    for kind in ("emission", "quantum_efficiency", "transmittance"):
        with contextlib.suppress(InputError):
            spectrum = read_spectrum(path, kind)
            assert np.isfinite(spectrum.values).all()


def _histogram(data: bytes) -> None:
    (path,) = _files(data, "histogram.csv")
    read = read_histogram(path)
    assert np.isfinite(read.photons).all() and (np.diff(read.photons) > 0).all()


def _relative(data: bytes) -> None:
    (path,) = _files(data, "relative.toml")
    assert np.isfinite(read_comparison(path).light_yield.value)


def _typed(data: bytes) -> None:
    """Values of options, a line each."""
    parameter = click.Option(["--value"])
    kinds = (
        options.PhotonCount(),
        options.Precision(),
        options.Number("MM", 0, 1e3),
        options.Whole(0, 9),
        options.Share(),
        options.WithError(),
        options.WithError(fraction=True),
    )
    readers = [
        lambda text: [np.isfinite(number) for number in parse_list("--n-gap", text, "n_gap")],
        parse_define,
        lambda text: parse_number("x", text),
        lambda text: attenuation_length_mm(text, 59.5, 4.0),
        *(lambda text, kind=kind: kind.convert(text, parameter, None) for kind in kinds),
    ]
    for text in data.decode(errors="replace").split("\n")[:_MOST_LINES]:
        for name in ("n_x", "x_mm", "x"):
            with contextlib.suppress(InputError):
                value = parse_value(name, text)
                as_before = parse_value(name, value_text(value))
                assert as_before == value or unit_of(name) is None
        for read in readers:
            with contextlib.suppress(InputError, click.UsageError):
                read(text)


_KEY = {"layout": 2, "seed": 1}


def _chunk(data: bytes) -> None:
    """A file of the cache, with a digest that fits in half the inputs."""
    flags, body = data[:1] or b"\0", data[1:]
    if flags[0] & 1:
        body = hashlib.sha256(body[32:]).digest() + body[32:]
    chunk = chunk_file.decode(np.frombuffer(body, np.uint8), _KEY, 0)
    if chunk is not None:
        again = chunk_file.encode(_KEY, 0, chunk.arrays, chunk.metadata)
        assert b"".join(again) == body
    cache = RecordCache({"seed": 1}, Path("cache").absolute())
    cache.folder.mkdir(parents=True, exist_ok=True)
    (cache.folder / "000000.chunk").write_bytes(body)
    cache.read(0)


def _results(data: bytes) -> None:
    for path in filter(Path.is_file, _files(data, "result.json", "table.csv")):
        with contextlib.suppress(InputError):
            table = read_results([path])
            csv_text(table)
            latex_text(table)
            netcdf_bytes(dataset(table))


def _adding(data: bytes) -> None:
    """An effect put into any scene that can be read gives one that can be read."""
    effect = _EFFECTS[data[0] % len(_EFFECTS)] if data else _EFFECTS[0]
    read = read_scene(_files(data[1:], "scene.xml", "part.xml")[0])
    try:
        text = add(effect, read)
    except BrokenEffectError as error:
        raise AssertionError(str(error)) from error
    assert read.parameters.keys() <= read.edited(text).parameters.keys()


_MOST_LINES = 20
_COMMANDS = (
    "lab peak",
    "lab efficiency",
    "lab absorption",
    "lab yield",
    "lab relative",
    "lab index",
    "lab gammas",
    "lab histogram",
    "add",
    "reduce",
    "convert",
)
_PLACES = ("/dev/full", "/dev/null", "/dev/stdout")
_OURS = ("in.xml", "in.toml", "in.csv", "in.json")


def _commands(data: bytes) -> None:
    """A command line (its verb by number, an argument a line) and its files."""
    head, *_ = data.split(SEPARATOR)
    _files(data[len(head) + len(SEPARATOR) :], *_OURS)
    number, *typed = head[:4000].decode(errors="replace").split("\n")
    verb = _COMMANDS[int(number) % len(_COMMANDS) if number.isdigit() and number.isascii() else 0]
    # nothing is written outside of this folder
    arguments = [
        text if text in _PLACES else text.replace("/", "_").replace("..", "_")
        for text in typed
        if "\0" not in text
    ]
    if "in.toml" in arguments and Path("in.toml").is_file() and _executes(Path("in.toml")):
        return
    before = set(os.listdir())
    out, complaints = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(complaints):
        if verb == "convert":
            status = terminal.run(convert_results.main, "convert_results", arguments)
        else:
            status = mcrim([*verb.split(), *arguments])
    for name in set(os.listdir()) - before:
        Path(name).unlink()
    said = complaints.getvalue()
    lines = {terminal.DONE: said.count("\n"), terminal.YOUR_INPUT: 1}.get(status)
    if said.count("\n") != lines:
        raise UnclearEndError(status, said)
    if not all(each.isprintable() for each in said.replace("\n", "")):
        raise UnclearEndError(status, repr(said))


class UnclearEndError(Exception):
    """A command ended otherwise than done, or refused in one line of printable text."""

    def __init__(self, status: int, said: str) -> None:
        frames = [line.strip() for line in said.splitlines() if line.strip().startswith("File ")]
        super().__init__(f"exit status {status}, {frames[-1:]} {said[-300:]}")
        self.place = frames[-1] if frames else f"status {status}: {said[:60]}"


def _bytes(*paths: Path) -> tuple[bytes, ...]:
    return tuple(path.read_bytes() for path in paths)


def _seed(name: str) -> bytes:
    return Path(__file__).with_name("seeds").joinpath(name).read_bytes()


def _table_of(name: str) -> dict:
    return tomllib.loads(Path(__file__).with_name(f"{name}.toml").read_text(encoding="utf-8"))


_XML_WORDS, _TOML_WORDS, _CSV_WORDS, _JSON_WORDS = (
    (*known["spaced"], *known["words"].split()) for known in _table_of("words").values()
)
_MEASURED = (SCENES / "camoo4_measured.csv").read_bytes()
_CAMPAIGN = (SCENES / "camoo4_campaign.toml").read_bytes().replace(b"camoo4.xml", b"bench.xml")
_CAMPAIGN = _CAMPAIGN.replace(b"camoo4_measured.csv", b"measured.csv")
_EFFECTS_ON = (
    _CAMPAIGN.replace(b"effects = []", b'effects = ["background", "crystal_index"]')
    + b"\n[parameters.scale]\nstart = 1\nfixed = true\n[next_measurements]\n"
    b"n_gap = [1.0, 1.5]\nsigma_relative = 0.01\n"
)
_FEW_MORE = _MEASURED + b"water,19.5,0.2,1.33\noil,23.7,0.2,1.51\nglass,23.9,0.2,1.52\n"
_RAW_TOML = (RAW / "campaign_source_depth.toml").read_bytes().replace(b"../camoo4", b"bench")
_RAW_TOML = _RAW_TOML.replace(b"mountings.csv", b"readings.csv")


_A_CHUNK = b"".join(
    chunk_file.encode(
        _KEY,
        0,
        {"weights": np.linspace(0, 1, 5), "kinds": np.arange(3, dtype=np.uint8)},
        {"photons": 5, "names": ["a"]},
    )
)


def _line(text: str, file: str | None = None) -> bytes:
    verb = next(verb for verb in _COMMANDS if text.startswith(f"{verb} "))
    arguments = text.removeprefix(verb).split()
    head = "\n".join((str(_COMMANDS.index(verb)), *arguments)).encode()
    if file is None:
        return head
    place = next(number for number, name in enumerate(_OURS) if name in arguments)
    return _joined(head, *[b""] * place, (SCENES / file).read_bytes())


_COMMAND_LINES = (
    *(_line(*line) for line in _table_of("commands")["lines"]),
    _joined(_line("reduce in.toml --json -"), b"", _RAW_TOML),
)
_SCENES = _bytes(*sorted(SCENES.glob("*.xml")))
_HISTOGRAMS = _bytes(RAW / "air_1.csv", RAW / "gel_1.csv", RAW / "gel_2.csv")
_SPECTRA = _bytes(RAW / "emission.csv", RAW / "quantum_efficiency.csv", RAW / "transmittance_1.csv")
_TYPED = (
    b"0.1,0.5\nlog:0.01:2:40\n1:2:3\n1.0,BK7@540nm\nn_gap=1.46\n2e6\n0.2%\n14.3\xc2\xb10.2\nCaMoO4",
)

TARGETS = {
    # scene XML, its includes and spectra
    "scene": Target(
        _scene,
        (
            *(scene.replace(b"camoo4.xml", b"bench.xml") for scene in _SCENES),
            _joined(_seed("scene.xml"), _seed("part.xml"), (RAW / "emission.csv").read_bytes()),
        ),
        _XML_WORDS,
    ),
    "measurements": Target(
        _measurements,
        (
            *_bytes(*sorted(SCENES.glob("*.csv"))),
            (RAW / "mountings.csv").read_bytes(),
            b"#" + b"\nlabel,signal,sigma,use,group,group_sigma,n_gap\na,1,0.1,1,x,0.02,1\n",
        ),
        _CSV_WORDS,
    ),
    # a campaign with its readings, one with raw data, and one that goes on from another
    "campaign": Target(
        _campaign_of,
        (_joined(_CAMPAIGN, _MEASURED), _joined(_EFFECTS_ON, _FEW_MORE)),
        (*_TOML_WORDS, *_CSV_WORDS),
    ),
    "raw_campaign": Target(
        _raw_campaign,
        (
            _RAW_TOML,
            _RAW_TOML.replace(
                b'["transmittance_1.csv", "transmittance_2.csv", "transmittance_3.csv"]',
                b"0.76\ntransmittance_sigma = 0.005",
            ),
        ),
        _TOML_WORDS,
    ),
    "campaign_writing": Target(
        _campaign_writing,
        (_joined(_CAMPAIGN, _FEW_MORE), _joined(_EFFECTS_ON, _FEW_MORE)),
        _TOML_WORDS,
    ),
    "table": Target(_table, (*_SPECTRA, *_HISTOGRAMS), _CSV_WORDS),
    "spectrum": Target(_spectrum, _SPECTRA, _CSV_WORDS),
    # or a list of events
    "histogram": Target(_histogram, _HISTOGRAMS, _CSV_WORDS),
    "relative": Target(
        _relative,
        _bytes(SCENES / "cawo4_reference.toml"),
        (*_TOML_WORDS, "sample", "reference", "shared", "signal", "eta"),
    ),
    "typed": Target(
        _typed, _TYPED, ("log:", ":", ",", "%", "±", "+-", "BK7@", "nm", "=", "n_", "CaMoO4", "e")
    ),
    "chunk": Target(
        _chunk,
        (b"\x01" + _A_CHUNK, b"\0" + _A_CHUNK),
        ("|O", "<f8", "<M8", "|V0", "<U9", "number", "metadata", "arrays", "null", "["),
    ),
    "results": Target(
        _results,
        (
            *map(_seed, ("calibrated.json", "diagnosed.json", "simulated.json", "tabled.json")),
            _joined(b"{}", _seed("table.csv")),
        ),
        _JSON_WORDS,
    ),
    "adding": Target(
        _adding,
        (
            *(bytes([n]) + (SCENES / "camoo4.xml").read_bytes() for n in range(len(_EFFECTS))),
            b"\0"
            + _joined(
                (SCENES / "camoo4_thin.xml").read_bytes().replace(b"camoo4.", b"part."),
                (SCENES / "camoo4.xml").read_bytes(),
            ),
        ),
        _XML_WORDS,
    ),
    "commands": Target(
        _commands,
        _COMMAND_LINES,
        (
            *(
                f"--{n}"
                for n in (
                    "json",
                    "figure",
                    "help",
                    "n",
                    "nm",
                    "sigma",
                    "eta",
                    "signal",
                    "label",
                    "emission",
                    "thickness-mm",
                    "energy-keV",
                    "shape",
                )
            ),
            "-o",
            "-D",
            "-",
            "in.xml",
            "in.toml",
            "in.csv",
            "in.json",
            "bench.xml",
            "out.json",
            "out.png",
            "/dev/full",
            "/dev/null",
            *_CSV_WORDS,
            *_TOML_WORDS,
        ),
    ),
}


def place_of(error: BaseException) -> str:
    """Where something broke, so that the same breakage is told once."""
    if isinstance(error, UnclearEndError):
        return error.place
    frames, trace = [], error.__traceback__
    while trace is not None:
        frames.append(f"{Path(trace.tb_frame.f_code.co_filename).name}:{trace.tb_lineno}")
        trace = trace.tb_next
    return f"{type(error).__name__} at {' < '.join(frames[::-1][:3])}"


def attempt(target: Target, data: bytes) -> BaseException | None:
    """Run a target; what it should not have raised, or None."""
    with warnings.catch_warnings():
        # a number that overflows is wrong in silence
        warnings.simplefilter("error", RuntimeWarning)
        try:
            target.run(data)
        except InputError as error:
            if "\n" in str(error):
                return AssertionError("a refusal of more than one line")
        except (Exception, SystemExit) as error:
            return error
    return None
