"""What a command reads is never what it writes, and what it writes is whole or not there."""

import json
import os
import shutil
import signal
import subprocess
import sys
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace

import pytest
from matplotlib.figure import Figure

import mcrim_mitsuba
from mcrim_mitsuba.campaign.campaign import read_campaign
from mcrim_mitsuba.campaign.editor import plain_texts, readings_beside, reduce
from mcrim_mitsuba.core.errors import InputError
from mcrim_mitsuba.core.files import refuse_outputs, refuse_to_replace, write_text
from mcrim_mitsuba.inference import repair
from mcrim_mitsuba.inference.repair import refuse_others_work
from mcrim_mitsuba.output.cross_section import write_cross_section
from mcrim_mitsuba.output.figure_style import save
from mcrim_mitsuba.scene.shipped import copy_scenes
from mcrim_mitsuba.transport.collection import Launcher

resource = pytest.importorskip("resource", reason="Windows has no limits of files")

#: By verb: what it needs besides its campaign or scene, and its outputs.
OF_CAMPAIGN = {
    "calibrate": ([], ["--json", "--log", "--figure"]),
    "compare": ([], ["--json", "--log", "--figure"]),
    "diagnose": ([], ["--json", "--log", "--figure"]),
    "repair": (["-o", "new.toml"], ["--json", "--log", "--figure"]),
    "report": (["-o", "new.html"], ["--json", "--log"]),
    "reduce": ([], ["--json", "--figure"]),
    "budget": ([], ["--json", "--log", "--figure"]),
    "lab plan": ([], ["--json", "--log"]),
}
OF_SCENE = {
    "check": ([], ["--json", "-o"]),
    "simulate": ([], ["--json", "--log", "--figure", "--map", "--times"]),
    "table": (["--alpha-scat", "0.5"], ["--json", "--log", "--figure", "-o"]),
    "render": (["-o", "new.png"], ["--json"]),
    "crosscheck": ([], ["--json"]),
}
#: What an output's name ends in.
ENDINGS = {
    "--log": ".log",
    "--figure": ".png",
    "--map": ".nc",
    "--times": ".csv",
    "--json": ".json",
}


@pytest.fixture
def bench(here, scenes):
    """A campaign that names a file of every kind; one that everything reads is its spectrum."""
    shutil.copytree(scenes / "camoo4_raw", here / "raw")
    shutil.copytree(scenes / "own_effects", here / "own")
    events = here / "raw/air_2.csv"  # one a line, of which a tenth do here
    events.write_text("".join(events.read_text().splitlines(keepends=True)[:4000]))
    text = (scenes / "camoo4.xml").read_text()
    beginning = text.index("  <medium")
    (here / "part.xml").write_text(f'<scene version="3.0.0">\n{text[beginning:]}')
    (here / "white.spd").write_text("400 1\n700 1\n")
    light = '<emitter type="constant"><spectrum name="radiance" filename="white.spd"/></emitter>'
    (here / "bench.xml").write_text(
        text[:beginning].replace('n_crystal" value="2.01"', 'n_crystal" value="CaMoO4@light.csv"')
        + f'<include filename="part.xml"/>\n{light}\n</scene>\n'
    )
    for name in ("light.csv", "row.csv"):
        shutil.copy(scenes / "camoo4_raw/emission.csv", here / name)
    readings = (here / "raw/mountings.csv").read_text()
    (here / "raw/mountings.csv").write_text(
        readings.replace("n_gap", "n_gap,n_window")
        .replace("1.00\n", "1.00,1.52\n")
        .replace("1.46\n", "1.46,BK7@../row.csv\n")
    )
    campaign = (here / "raw/campaign.toml").read_text()
    campaign = campaign.replace('scene = "../camoo4.xml"', 'scene = "../bench.xml"')
    (here / "raw/campaign.toml").write_text(f'effects_folder = "../own"\n{campaign}')
    (here / "raw/campaign_source_depth.toml").unlink()
    return here / "raw/campaign.toml"


def test_a_campaign_knows_all_files_that_are_read_for_it(bench):
    opened: list[Path] | None = []

    def hook(event, arguments):
        if opened is not None and event == "open" and isinstance(arguments[0], (str, Path)):
            opened.append(Path(arguments[0]).resolve())

    sys.addaudithook(hook)
    campaign = read_campaign(bench)
    read, opened = set(opened), None
    here = bench.parents[1]
    read = {path for path in read if path.is_relative_to(here) and path.suffix != ".pyc"}
    read.add(here / "white.spd")  # by Mitsuba
    known = {path.resolve() for path in campaign.files}
    assert {path.name for path in read} > {"part.xml", "light.csv", "row.csv", "air_1.csv"}
    assert known == read == {p for p in here.rglob("*.*") if p.suffix != ".pyc"}


@pytest.mark.parametrize("verb", [*OF_CAMPAIGN, *OF_SCENE])
def test_no_output_goes_onto_a_file_that_is_read(mcrim, bench, monkeypatch, verb):
    """By a link to it; what a campaign or a scene names is not typed.

    Reading a campaign takes a second: each output takes two of its files, in turn.
    """
    of_campaign = verb in OF_CAMPAIGN
    further, outputs = OF_CAMPAIGN[verb] if of_campaign else OF_SCENE[verb]
    bench = bench if of_campaign else Path("bench.xml")
    files = sorted(p for p in Path().rglob("*.*") if p.suffix != ".pyc")
    if not of_campaign:
        files = [Path(name) for name in ("bench.xml", "part.xml", "light.csv", "white.spd")]
    before = {file: file.read_bytes() for file in files}

    def worked(*_, **__):
        raise AssertionError("work was done before the outputs were looked at")

    for place in ("runs.executors.Executor.do", "transport.simulation.Simulation.__init__"):
        monkeypatch.setattr(f"mcrim_mitsuba.{place}", worked)
    for option in outputs:
        ending = ENDINGS.get(option, ".png" if verb == "check" else ".nc")
        for number, file in enumerate(files):
            if (
                of_campaign
                and number % 12 != (5 * list(OF_CAMPAIGN).index(verb) + len(option)) % 12
            ):
                continue
            link = Path(f"{verb}{option}{number}{ending}".replace(" ", "-"))
            link.symlink_to(file.resolve())
            said = mcrim.refused(*verb.split(), bench, *further, option, link)
            name = "--output" if option == "-o" else option
            assert f"{name} would replace what this command reads" in said
    assert before == {file: file.read_bytes() for file in files}


def test_a_table_without_a_picture_is_not_taken_for_the_numbers_of_one(here, mcrim, scenes):
    """Somebody's readings, whose name a figure happens to have; a table that is named is meant."""
    shutil.copy(scenes / "camoo4_measured.csv", "fit.csv")
    before = Path("fit.csv").read_bytes()
    scene = scenes / "camoo4.xml"
    said = mcrim.refused("simulate", scene, "--photons", "1e4", "--figure", "fit.png")
    assert said == (
        "mcrim: fit.csv: a figure's numbers would replace this table, which lies there without "
        "one; name another figure, or move the table\n"
    )
    light = mcrim_mitsuba.simulate(scene, photons=10_000)
    with pytest.raises(InputError, match="lies there without one"):
        light.draw("fit.png")
    assert Path("fit.csv").read_bytes() == before and os.listdir() == ["fit.csv"]
    for _ in range(2):
        assert {file.name for file in light.draw("other.png")} >= {"other.png", "other.csv"}
    assert light.draw("fit.png", replace=True) and Path("fit.csv").read_bytes() != before
    for figure in ([], ["--figure", "T.png"], ["--figure", "./T.png"]):
        mcrim("table", scene, "--alpha-scat", "0.1,0.5", "--photons", "1e4", "-o", "T.csv", *figure)
    assert Path("T.csv").read_text().startswith("alpha_scat_per_cm,eta,eta_sigma\n")


def test_a_link_stays_and_what_it_leads_to_is_written(here):
    (here / "results").mkdir()
    (here / "results/old.json").write_text("old")
    Path("further.json").symlink_to("results/link.json")
    Path("results/link.json").symlink_to("old.json")
    Path("new.json").symlink_to("results/new.json")
    for name, written in (("further.json", "old.json"), ("new.json", "new.json")):
        refuse_outputs({"--json": name})
        write_text(name, "{}")
        assert Path(name).is_symlink() and (here / "results" / written).read_text() == "{}"
    assert (
        sorted(path.name for path in here.rglob("*.*"))
        == "further.json link.json new.json new.json old.json".split()
    )


@pytest.mark.skipif(not Path("/dev/fd").exists(), reason="descriptors have no names here")
@pytest.mark.parametrize(
    "redirected",
    ["--json /dev/fd/1 >> f", "--json /proc/self/fd/3 3>> f >&2", "--json link.json 3>> f >&2"],
)
def test_results_are_appended_to_what_is_open_to_append(here, redirected):
    Path("f").write_text("what was there\n")
    Path("link.json").symlink_to("/dev/fd/3")
    verb = f"{sys.executable} -m mcrim_mitsuba lab index BK7 --nm 540"
    subprocess.run(f"{verb} {redirected}", shell=True, check=True)
    old, _, result = Path("f").read_text().partition("\n")
    assert old == "what was there" and json.loads(result)


@pytest.mark.parametrize("ending", ["png", "pdf"])
def test_a_picture_replaces_the_old_one_when_it_is_whole(here, monkeypatch, ending):
    """While it is drawn, and where that is interrupted or the disk full, the old one is there."""
    path, figure = Path(f"picture.{ending}"), Figure()
    path.write_text("old")
    savefig = Figure.savefig

    def interrupted(*arguments, **how):
        savefig(*arguments, **how)
        assert path.read_text() == "old"
        raise KeyboardInterrupt

    for write in (save, write_cross_section):
        with monkeypatch.context() as drawing, pytest.raises(KeyboardInterrupt):
            drawing.setattr(Figure, "savefig", interrupted)
            write(figure, path)
        with limited(1000), pytest.raises(InputError, match="cannot be written"):
            write(figure, path)
        assert path.read_text() == "old" and os.listdir() == [path.name]
    save(figure, path)
    assert path.stat().st_size > 1000


@contextmanager
def limited(size):
    """Files of this process may not become larger than so many bytes."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    ignored = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    try:
        resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
        signal.signal(signal.SIGXFSZ, ignored)


class Killed(BaseException):
    """As good as kill -9 for who looks at the files."""


@contextmanager
def killed_after(files):
    """The process is killed when it has written so many files."""
    left = files

    def replace(source, target):
        nonlocal left
        if not left:
            raise Killed
        left -= 1
        shutil.move(source, target)

    with pytest.MonkeyPatch.context() as patch, pytest.raises(Killed):
        patch.setattr("mcrim_mitsuba.core.files.os.replace", replace)
        yield


def contents(folder):
    return {path.relative_to(folder): path.read_bytes() for path in folder.rglob("*.*")}


@pytest.mark.parametrize("files", range(4))
def test_what_was_killed_between_its_files_goes_on(here, scenes, files):
    """With the same line; what somebody has changed meanwhile is refused and stays."""
    campaign = read_campaign(scenes / "camoo4_misfit.toml")
    raw = read_campaign(scenes / "camoo4_raw/campaign.toml")
    fitted = SimpleNamespace(
        parameters={"bubble_fraction": SimpleNamespace(value=0.1)},
        names=(),
        model=SimpleNamespace(campaign=campaign.with_effects(["gap_bubble"])),
    )

    def mend(target):
        refuse_others_work(target)
        repair.write_mended(campaign, fitted, target)

    def reduced(target):
        target = target.with_suffix(".toml")
        texts = plain_texts(raw, target, readings_beside(target))
        refuse_to_replace(dict(zip((target, readings_beside(target)), texts, strict=True)))
        reduce(raw, target)

    def copied(target):
        copy_scenes(target.parent)

    for make, written in ((mend, 2), (reduced, 2), (copied, 41)):
        whole, killed = here / make.__name__ / "x.toml", here / f"{make.__name__}_killed" / "x.toml"
        for path in (whole, killed):
            path.parent.mkdir()
        make(whole)
        if files < written:
            with killed_after(files):
                make(killed)
            assert len(contents(killed.parent)) == files
        for _ in range(2):
            make(killed)
            assert contents(killed.parent) == contents(whole.parent)
        for path in killed.parent.rglob("*.*"):
            before = path.read_bytes()
            path.write_bytes(before + b"\n<!-- mine -->")
            with pytest.raises(InputError, match=r"(there|exists) already"):
                make(killed)
            assert path.read_bytes() != before
            path.write_bytes(before)


@pytest.mark.parametrize("verb", ["simulate", "table", "crosscheck"])
def test_what_was_interrupted_writes_no_result(mcrim, here, scenes, monkeypatch, verb):
    """It had a part of the photons, wrote it over the complete file, and ended with status 0."""
    launch = Launcher.launch

    def interrupted(launcher, *arguments, **how):
        if launcher.tally.photons > 0:
            raise KeyboardInterrupt
        return launch(launcher, *arguments, **how)

    Path("a.json").write_text("complete")
    words = {
        "simulate": ["--figure", "f.png", "--times", "t.csv", "--photons", "1e6"],
        "table": ["--alpha-scat", "0.5", "-o", "t.csv", "--precision", "0.05%"],
        "crosscheck": ["--photons", "1e6"],
    }[verb]
    monkeypatch.setattr(Launcher, "launch", interrupted)
    status, out, err = mcrim(verb, scenes / "camoo4.xml", *words, "--json", "a.json")
    assert status == 130 and err.count("\n") <= 2 and "mcrim: interrupted" in err
    assert Path("a.json").read_text() == "complete" and os.listdir() == ["a.json"]
    assert verb != "simulate" or "interrupted after 65,536 of 1,000,000 photons" in out


def test_what_had_been_written_is_said(mcrim, here, monkeypatch):
    """When a command is interrupted between its results."""

    def interrupted(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr("mcrim_mitsuba.cli.showing.show", interrupted)
    status, _, err = mcrim("lab", "index", "BK7", "--nm", "540", "--json", "a.json")
    assert status == 130 and err.strip() == "mcrim: interrupted when a.json had been written"


def test_the_status_of_an_interrupt_is_that_of_its_signal(here):
    """Where it left code that was executed from text, as of dataclasses, Python ended by SIGINT."""
    code = (
        "import os, sys\n"
        "from mcrim_mitsuba.cli import main, showing\n"
        "showing.show = lambda *_: exec('os.kill(os.getpid(), 15); 0', {'os': os})\n"
        "sys.argv[1:] = ['lab', 'index', 'BK7', '--nm', '540']\n"
        "sys.exit(main.main())"
    )
    Path("interrupted.py").write_text(code)
    words = [sys.executable, "-m", "interrupted"]
    done = subprocess.run(words, stderr=subprocess.PIPE, check=False)
    assert done.returncode == 143 and b"interrupted before there was a result" in done.stderr
