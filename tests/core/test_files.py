"""Files: read with care, written whole or not at all."""

import os
import subprocess
import sys
import threading
from pathlib import Path

import pytest
from places import cases_of
from refusals import refusal

from mcrim_mitsuba.core import files
from mcrim_mitsuba.core.errors import InputError

cases = cases_of(__file__)


def test_what_is_read_and_written_is_collected(here):
    path = Path("a.txt")
    with files.collected(files.WRITES) as written:
        files.write_text(path, "one\n")
        files.write_bytes(Path("b.bin"), b"\0")
    with files.collected(files.READS) as read:
        assert files.read_text(path, 1) == "one\n"
        assert files.read_bytes(Path("b.bin"), 1) == b"\0"
    files.read_text(path, 1)
    assert written == read == [path, Path("b.bin")]


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (b"", "the file is empty; name another file or fill this one"),
        (b" \n\t", "the file is empty"),
        (b"x" * 1_000_001, "larger than 1 MB; is this the file you meant?"),
        (b"a\nb\xff", "line 2: not a UTF-8 text file; save it as UTF-8"),
        (b"a\n\0", "line 2: not a text file (it holds zero bytes)"),
    ],
)
def test_what_is_no_text_is_refused_with_its_line(here, content, says):
    Path("a.txt").write_bytes(content)
    assert refusal(files.read_text, Path("a.txt"), 1).startswith("a.txt") and says in refusal(
        files.read_text, Path("a.txt"), 1
    )


def test_a_file_that_is_not_there_is_guessed(here):
    Path("bench.xml").touch()
    Path("bench.toml").touch()
    assert "did you mean bench.xml?" in refusal(files.read_bytes, Path("bensh.xml"), 1)
    assert files.look_around(Path("zzz.xml"), "look elsewhere") == "look elsewhere"
    assert "the folder no does not exist" in refusal(files.read_bytes, Path("no/a.xml"), 1)
    assert "this is a folder; name a file in it" in refusal(files.read_bytes, here, 1)
    assert files.is_there(Path("bench.xml")) and not files.is_there(Path("x\0"))
    assert not files.is_there(Path("a" * 5000))


def test_line_ends_marks_and_encodings_of_tables(here):
    path = Path("a.csv")
    utf_8, code_page = b"\xef\xbb\xbf\xc2\xb5;1\r\n2\r3\n", b"\xb5;1\n2\n3\n"
    for content in (utf_8, "µ;1\n2\n3\n".encode("utf-16"), code_page):
        path.write_bytes(content)
        assert files.read_table_text(path, 1) == "µ;1\n2\n3\n"
    path.write_bytes(b"PK\x03\x04...")
    assert "this is a spreadsheet (.xlsx, .ods) or a ZIP archive" in refusal(
        files.read_table_text, path, 1
    )


def test_paths_name_histograms_in_root_files():
    for text in ("/a/runs.root:far/dry", "/a/runs.root#far/dry"):
        assert files.inside(Path(text)) == (Path("/a/runs.root"), "far/dry")
    for text in ("runs.root", "a:b.csv", "a.root/b.csv"):
        assert files.inside(Path(text)) == (Path(text), "")


def test_links_loops_and_files_beside(here):
    Path("folder").mkdir()
    Path("folder/campaign.toml").touch()
    Path("folder/bench.xml").touch()
    Path("link.toml").symlink_to("folder/campaign.toml")
    # a name in a file is relative to the file, or to what a link leads to
    assert files.beside(Path("link.toml"), "bench.xml") == here / "folder" / "bench.xml"
    Path("bench.xml").touch()
    assert files.beside(Path("link.toml"), "bench.xml") == Path("bench.xml")
    Path("loop").symlink_to("loop")
    assert files.resolved(Path("loop")) == here / "loop"
    assert files.resolved(Path("link.toml")) == here / "folder" / "campaign.toml"


def test_the_same_measurement_under_two_names_is_found(here):
    for name, text in (("a", "1"), ("b", "2"), ("c", "1")):
        Path(name).write_text(text)
    Path("d").symlink_to("b")
    paths = [Path(name) for name in "abcd"]
    assert files.first_duplicates(paths) == (0, 2)
    assert files.first_duplicates([paths[1], paths[3]]) == (0, 1)
    assert files.first_duplicates(paths[:2]) is None
    assert files.sha256(b"1") == files.sha256(Path("c").read_bytes()) != files.sha256(b"2")


def test_a_write_that_fails_leaves_what_was_there(here, monkeypatch):
    Path("a.txt").write_text("old")

    def full(descriptor):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(files.os, "fsync", full)
    line = refusal(files.write_text, "a.txt", "new")
    assert line.endswith(
        "cannot be written (No space left on device); free some space, or name a "
        "file on another disk"
    )
    assert [p.name for p in here.iterdir()] == ["a.txt"] and Path("a.txt").read_text() == "old"
    with pytest.raises(OSError, match="No space"):
        files.write_whole(Path("a.txt"), [b"new"], Path("temporary"))
    assert not Path("temporary").exists()


def test_writing_through_a_link_keeps_the_link(here):
    Path("a.txt").write_text("old")
    Path("link").symlink_to("a.txt")
    files.write_text("link", "new")
    assert Path("link").is_symlink() and Path("a.txt").read_text() == "new"


def test_standard_output_is_a_dash(capsys):
    files.write_text("-", "η\n")
    assert capsys.readouterr().out == "η\n"


def test_a_pipe_needs_its_reader(here):
    os.mkfifo("pipe")
    assert "nobody reads from this pipe" in refusal(files.write_bytes, "pipe", b"x")
    got = []
    reader = threading.Thread(target=lambda: got.append(Path("pipe").read_bytes()))
    reader.start()
    while True:
        try:
            descriptor = files.open_to_write(Path("pipe"), 0)
            break
        except OSError:
            continue
    with os.fdopen(descriptor, "wb") as stream:
        stream.write(b"x")
    reader.join(10)
    assert got == [b"x"]


def test_nothing_of_others_is_replaced(here):
    Path("a.txt").write_text("same")
    files.refuse_to_replace({Path("a.txt"): "same", Path("new.txt"): "x"})
    assert "this file exists already" in refusal(files.refuse_to_replace, {Path("a.txt"): "other"})
    assert files.differs(Path("a.txt"), b"other") and not files.differs(Path("none"), b"x")
    assert files.make_folder("deep/er") == Path("deep/er") and Path("deep/er").is_dir()
    assert "the folder cannot be made" in refusal(files.make_folder, "a.txt/x")


@cases("outputs", "inputs", "says")
def test_outputs_are_refused_before_the_work(here, outputs, inputs, says):
    Path("in.csv").touch()
    Path("raw").mkdir()
    assert says in refusal(files.refuse_outputs, outputs, inputs)


def test_outputs_that_may_be(here):
    files.refuse_outputs({"-o": None, "--json": "-", "--figure": "a.png"})
    files.refuse_outputs({"-o": "/dev/null", "--json": "/dev/null"})
    files.refuse_suffix("a.PNG", (".png", ".pdf"), "mcrim cannot draw")
    assert refusal(files.refuse_suffix, "a.gif", (".png",), "mcrim cannot draw") == (
        "a.gif: mcrim cannot draw .gif; let the name end in .png"
    )
    with pytest.raises(InputError, match=r"-o cannot write a file without suffix; .* in \.nc"):
        files.refuse_outputs({"-o": "a"}, suffixes={"-o": (".nc",)})


def test_attributes_go_by_their_own_names_or_others():
    error = InputError("p", "m", line=3)
    error.more, error.both = InputError("q", "n"), lambda: {"mend": "of both", "column": 4}
    assert files.attributes(error, "problem mend at=line") == {"problem": "p", "mend": "m", "at": 3}
    named = files.attributes(error, "mend line=more.mend **both")
    assert list(named.items()) == [("mend", "of both"), ("line", "n"), ("column", 4)]


def test_a_reader_that_has_seen_enough_is_no_error():
    code = "from mcrim_mitsuba.core.files import silence_stdout; silence_stdout(); print(2)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True)
    assert (done.returncode, done.stdout, done.stderr) == (0, b"", b"")
