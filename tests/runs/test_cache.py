"""The cache of photon records: what was written comes back unchanged or not at all."""

import errno
import gc
import hashlib
import inspect
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from places import cases_of
from refusals import refusal

from mcrim_mitsuba.runs import cache_files as housekeeping
from mcrim_mitsuba.runs.cache import RecordCache, cache_folder, record_versions, size_limit_bytes

cases = cases_of(__file__)

KEY = {"scene": "0a1b", "seed": 7, "plan": {"alpha_scat_per_mm": [0.01, 0.1], "lanes": 65536}}


def records(number, photons=20_000):
    """Arrays that belong to a chunk's number and to no other."""
    rng = np.random.default_rng(number)
    return {
        "k": rng.integers(0, 9, photons).astype(np.uint16),
        "path_cm": rng.random(photons, dtype=np.float32),
        "proposal": rng.integers(0, 9, photons + 1).astype(np.uint8),
    }


def is_chunk(chunk, number):
    """Whether a chunk holds exactly what `records` gives for this number."""
    wanted = records(number)
    return (
        chunk.number == number
        and chunk.metadata == {"photons": number}
        and list(chunk.arrays) == list(wanted)
        and all(chunk.arrays[name].dtype == wanted[name].dtype for name in wanted)
        and all(np.array_equal(chunk.arrays[name], wanted[name]) for name in wanted)
    )


def filled(folder, chunks=1, key=KEY):
    cache = RecordCache(key, folder)
    for number in range(chunks):
        cache.write(number, records(number), {"photons": number})
    assert cache.trouble is None
    return cache


def unfinished(folder):
    """What writers and removers have not brought to an end."""
    return [*Path(folder).glob(".mcrim-*"), *Path(folder).glob("[0-9a-f]*/.mcrim-*")]


def start_python(*functions, call):
    """Run functions of this file in a process of its own, without all that tests import."""
    lines = [
        "import json, os, random, shutil, signal, sys, time",
        "from pathlib import Path",
        "import numpy as np",
        "from mcrim_mitsuba.runs.cache import RecordCache",
        f"KEY = {KEY!r}",
        *(inspect.getsource(function) for function in functions),
        call,
    ]
    return subprocess.Popen([sys.executable, "-c", "\n".join(lines)])


def test_what_is_written_comes_back(tmp_path):
    arrays = {
        "bool": np.array([True, False]),
        "empty": np.empty(0, np.float32),
        "strided": np.arange(9, dtype=np.int64)[::2],
        "big_endian": np.arange(3, dtype=">f8"),
        "complex": np.array([1 + 2j, np.nan]),
    }
    metadata = {"photons": [3, 4], "dose": 0.1, "path": "flach – schnell"}
    filled(tmp_path).write(12, arrays, metadata)
    chunk = RecordCache(dict(reversed(KEY.items())), tmp_path).read(12)
    assert (chunk.number, chunk.metadata) == (12, metadata)
    assert list(chunk.arrays) == list(arrays)
    for name, array in arrays.items():
        assert chunk.arrays[name].dtype == array.dtype
        np.testing.assert_array_equal(chunk.arrays[name], array)
    assert RecordCache(KEY, tmp_path).read(1) is None
    assert RecordCache(KEY | {"seed": 8}, tmp_path).read(12) is None


@pytest.mark.parametrize("bad", [np.zeros((2, 2)), np.float64(1), np.array([{}]), np.array(["a"])])
def test_arrays_that_would_not_come_back_are_refused(tmp_path, bad):
    with pytest.raises(ValueError, match="w has shape"):
        filled(tmp_path).write(1, {"w": bad}, {})


def test_no_damage_goes_unnoticed(tmp_path):
    cache = filled(tmp_path)
    file = next(cache.folder.glob("*.chunk"))
    intact = file.read_bytes()
    rng = random.Random(1)
    damaged = [intact + b"\0"]
    # half of the flips in the first bytes: magic, digest and header are small
    for position in [rng.randrange(n) for n in (512, len(intact)) for _ in range(25)]:
        flipped = bytearray(intact)
        flipped[position] ^= 1 << rng.randrange(8)
        damaged.append(bytes(flipped))
    lengths = [rng.randrange(n) for n in (512, len(intact)) for _ in range(9)]
    damaged += [intact[:length] for length in [0, len(intact) - 1, *lengths]]
    for content in damaged:
        file.write_bytes(content)
        assert cache.read(0) is None
        assert not file.exists(), "damage is removed"
    cache.write(0, records(0), {"photons": 0})
    assert is_chunk(cache.read(0), 0)


def test_a_chunk_under_another_name_is_not_believed(tmp_path):
    cache, other = filled(tmp_path), filled(tmp_path, key=KEY | {"seed": 8})
    shutil.copy(cache.folder / "000000.chunk", cache.folder / "000001.chunk")
    shutil.copy(cache.folder / "000000.chunk", other.folder / "000000.chunk")
    assert cache.read(1) is None
    assert other.read(0) is None
    assert is_chunk(cache.read(0), 0)


@pytest.mark.parametrize("change", ["edited", "removed", "not text"])
def test_a_chunk_whose_key_is_not_ours_is_not_believed(tmp_path, change):
    file = filled(tmp_path).folder / "000000.chunk"
    content = file.read_bytes()[32:]
    if change == "edited":
        content = content.replace(b'"seed": 7', b'"seed": 8')
    elif change == "removed":
        content = content.replace(b'"key":', b'"kee":')
    else:
        content = content.replace(b'"key":', b'"\xff\xfey":')
    file.write_bytes(hashlib.sha256(content).digest() + content)
    assert RecordCache(KEY, tmp_path).read(0) is None
    assert is_chunk(filled(tmp_path).read(0), 0)
    assert is_chunk(RecordCache(KEY, tmp_path).read(0), 0)


def test_files_of_an_older_layout_are_ignored_and_removed_when_room_is_needed(
    tmp_path, monkeypatch
):
    monkeypatch.setenv("MCRIM_CACHE_GB", str(1.5 * chunk_bytes(tmp_path) / 1e9))
    text = json.dumps(KEY, sort_keys=True, indent=1).encode()
    old = tmp_path / "cache" / hashlib.sha256(text).hexdigest()
    old.mkdir(parents=True)
    (old / "key.json").write_bytes(text)
    body = (64).to_bytes(8, "little") + b"{}".ljust(64) + bytes(200_000)
    (old / "000000.chunk").write_bytes(b"mcrim records 1\n" + hashlib.sha256(body).digest() + body)
    cache = RecordCache(KEY, tmp_path / "cache")
    assert cache.read(0) is None and not cache.notes
    assert old.exists()
    cache.write(0, records(0), {"photons": 0})
    assert is_chunk(cache.read(0), 0) and not cache.notes
    assert not old.exists()


def write_often(folder):
    for _ in range(6):
        shutil.rmtree(RecordCache(KEY, folder).folder, ignore_errors=True)
        for number in range(10):
            cache = RecordCache(KEY, folder)
            cache.write(number, records(number), {"photons": number})
            assert cache.trouble is None, cache.trouble


def test_two_processes_write_the_same_chunks_and_remove_them_at_once(tmp_path):
    writers = [
        start_python(records, write_often, call=f"write_often({str(tmp_path)!r})") for _ in "ab"
    ]
    cache = RecordCache(KEY, tmp_path)
    while any(writer.poll() is None for writer in writers):
        for number in range(10):
            chunk = cache.read(number)
            assert chunk is None or is_chunk(chunk, number)
    assert [writer.returncode for writer in writers] == [0, 0]
    assert not unfinished(tmp_path)


def survive_kills(folder, kills):
    """Kill a process that fills the cache, again and again, and look at what it left.

    Each begins with some of the last chunks there are, and what it left is read: to go through all
    of them after every kill would take as many reads as kills squared.
    """

    def fill(tell, first):
        cache = RecordCache(KEY, folder)
        for number in range(first, 10**6):
            if cache.read(number) is None:
                os.write(tell, b".")
                cache.write(number, records(number), {"photons": number})

    rng = random.Random(1)
    finished = {}
    for _ in range(kills):
        listen, tell = os.pipe()
        process = os.fork()
        if process == 0:
            fill(tell, max(len(finished) - 5, 0))
        for _ in range(rng.randint(1, 4)):
            os.read(listen, 1)  # waits until it begins to write one more
        time.sleep(rng.uniform(0.0, 0.01))
        os.kill(process, signal.SIGKILL)
        os.waitpid(process, 0)
        os.close(listen)
        os.close(tell)
        cache = RecordCache(KEY, folder)
        found = {}
        for file in cache.folder.glob("*.chunk"):
            number = int(file.stem)
            found[number] = (file.stat().st_ino, file.stat().st_mtime_ns)
            # one that is the same file was read before
            assert finished.get(number) == found[number] or is_chunk(cache.read(number), number)
        assert sorted(found) == list(range(len(found)))
        assert finished.items() <= found.items(), "a finished chunk was written again"
        finished = found
    for number in finished:
        assert is_chunk(cache.read(number), number)
    assert len(finished) > kills, "runs go on where the last one was killed"
    assert unfinished(folder), "no kill fell into a write"


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork and kill")
def test_kill_at_any_moment(tmp_path):
    call = f"survive_kills({str(tmp_path)!r}, 60)"
    assert start_python(records, is_chunk, unfinished, survive_kills, call=call).wait(60) == 0

    young, *old = unfinished(tmp_path)
    grave = tmp_path / ".mcrim-removed-0"
    grave.mkdir()
    for path in old:
        os.utime(path, (time.time() - 7 * 3600,) * 2)
    cache = RecordCache(KEY, tmp_path)
    assert unfinished(tmp_path) == [young], "it may be of a process that still writes"
    assert is_chunk(cache.read(0), 0)


def chunk_bytes(tmp_path):
    cache = filled(tmp_path / "elsewhere")
    return sum(file.stat().st_size for file in cache.folder.iterdir())


def test_the_least_recently_used_key_goes(tmp_path, monkeypatch):
    size_bytes = chunk_bytes(tmp_path)
    monkeypatch.setenv("MCRIM_CACHE_GB", str(3.5 * size_bytes / 1e9))
    folder = tmp_path / "cache"
    folders = [filled(folder, key={"seed": seed}).folder for seed in range(3)]
    for age_s, key_folder in zip((300, 200, 100), folders, strict=True):
        os.utime(key_folder, (time.time() - age_s,) * 2)
    bystander = folder / "photos"
    bystander.mkdir()
    gc.collect()

    in_use = RecordCache({"seed": 1}, folder)  # opening is using
    assert filled(folder, key={"seed": 3}).folder.exists()
    assert [f.exists() for f in folders] == [False, True, True]
    reader = RecordCache({"seed": 2}, folder)
    for cache in (in_use, reader):
        os.utime(cache.folder, (0, 0))
    assert reader.read(0)
    del cache, reader
    gc.collect()
    filled(folder, key={"seed": 4})
    assert [f.exists() for f in folders] == [False, True, True], "1 is in use, 2 was just read"
    assert bystander.exists()
    total = sum(path.stat().st_size for path in folder.rglob("*.*"))
    assert total <= size_limit_bytes()


def test_a_cache_with_room_is_not_looked_through_at_every_write(tmp_path, monkeypatch):
    """Of a thousand files that took longer than what they were made of."""
    look, looked = housekeeping._key_folders, []
    monkeypatch.setattr(
        housekeeping, "_key_folders", lambda cache: looked.append(cache) or look(cache)
    )
    monkeypatch.setattr(housekeeping, "_TRUSTED_S", 1e9)
    size_bytes = chunk_bytes(tmp_path)
    monkeypatch.setenv("MCRIM_CACHE_GB", str(100 * size_bytes / 1e9))
    cache = RecordCache({"scene": "a"}, tmp_path / "cache")
    looked.clear()
    for number in range(40):
        cache.write(number, records(number), {"photons": number})
    assert len(looked) == 1
    # the fuller it is, the less is taken for granted: what others wrote counts
    for number in range(40, 110):
        cache.write(number, records(number), {"photons": number})
    assert len(looked) > 40 and "MCRIM_CACHE_GB" in cache.trouble
    total = sum(path.stat().st_size for path in cache.folder.iterdir())
    assert 0.95 * size_limit_bytes() < total <= size_limit_bytes()


def test_a_run_that_fills_the_cache_goes_on_without(tmp_path, monkeypatch):
    monkeypatch.setenv("MCRIM_CACHE_GB", str(2.5 * chunk_bytes(tmp_path) / 1e9))
    folder = tmp_path / "cache"
    other = filled(folder, key={"seed": 8}).folder
    cache = RecordCache(KEY, folder)
    for number in range(4):
        cache.write(number, records(number), {"photons": number})
    assert "MCRIM_CACHE_GB" in cache.trouble and "\n" not in cache.trouble
    assert [cache.read(number) is not None for number in range(4)] == [True, True, False, False]
    assert not other.exists()


def test_a_folder_that_vanishes_is_made_again(tmp_path, monkeypatch):
    cache = filled(tmp_path)
    shutil.rmtree(tmp_path)
    assert cache.read(0) is None
    rename = os.replace

    def remove_and_rename(source, target):
        monkeypatch.setattr(os, "replace", rename)
        shutil.rmtree(cache.folder)
        rename(source, target)

    cache.write(0, records(0), {"photons": 0})
    monkeypatch.setattr(os, "replace", remove_and_rename)
    cache.write(1, records(1), {"photons": 1})
    assert cache.trouble is None
    assert cache.read(0) is None
    assert is_chunk(RecordCache(KEY, tmp_path).read(1), 1)


def test_a_full_disk_costs_the_cache_and_nothing_else(tmp_path):
    resource = pytest.importorskip("resource")
    cache = filled(tmp_path)
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (50_000, limits[1]))
    try:
        cache.write(1, records(1), {"photons": 1})
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert os.strerror(errno.EFBIG) in cache.trouble and "MCRIM_CACHE" in cache.trouble
    assert "\n" not in cache.trouble and str(tmp_path) in cache.trouble
    assert not unfinished(tmp_path)
    cache.write(2, records(2), {"photons": 2})
    assert cache.read(2) is None, "switched off for the rest of the run"
    assert is_chunk(cache.read(0), 0), "what is there is still of use"


def test_a_place_that_cannot_be_written_is_told_and_not_raised(tmp_path):
    folder = tmp_path / "cache"
    folder.write_text("a file")
    cache = RecordCache(KEY, folder)
    assert cache.read(1) is None
    cache.write(1, records(1), {"photons": 1})
    assert "cannot be kept" in cache.trouble
    assert cache.read(1) is None
    assert folder.read_text() == "a file" and not unfinished(tmp_path)


OCCUPIED = {"key's folder": ".", "chunk": "000001.chunk"}


@pytest.mark.parametrize("kind", ["file", "folder", "pipe", "link", "dead link", "endless link"])
@pytest.mark.parametrize("place", OCCUPIED)
def test_what_has_the_name_of_a_key_or_a_chunk_makes_way(tmp_path, place, kind):
    folder, elsewhere = tmp_path / "cache", tmp_path / "elsewhere"
    elsewhere.mkdir()
    (elsewhere / "photo").touch()
    occupied = filled(folder, 2).folder / OCCUPIED[place]
    occupied.rename(tmp_path / "moved")
    if kind == "file":
        occupied.write_text("a file")
    elif kind == "folder":
        occupied.mkdir()
        (occupied / "file").touch()
    elif kind == "pipe":
        os.mkfifo(occupied)
    else:
        leads_to = {"link": elsewhere, "dead link": tmp_path / "nowhere"}
        occupied.symlink_to(leads_to.get(kind, "/dev/zero"))
    cache = RecordCache(KEY, folder)
    assert cache.read(1) is None
    cache.write(1, records(1), {"photons": 1})
    assert cache.trouble is None
    assert is_chunk(cache.read(1), 1)
    assert [*folder.iterdir()] == [cache.folder] and not unfinished(folder)
    assert (elsewhere / "photo").exists(), "what a link leads to is not ours"


def test_files_that_only_look_like_keys_stay(tmp_path, monkeypatch):
    monkeypatch.setenv("MCRIM_CACHE_GB", str(1.5 * chunk_bytes(tmp_path) / 1e9))
    folder = tmp_path / "cache"
    filled(folder, key={"seed": 8})
    gc.collect()
    blob = folder / ("0" * 64)
    blob.write_text("another program names its files by a SHA-256")
    filled(folder)
    assert blob.exists() and len([*folder.iterdir()]) == 2


def test_trouble_names_its_place(tmp_path, monkeypatch):
    cache = filled(tmp_path)
    file = cache.folder / "000001.chunk"

    def refuse(old, new):
        raise PermissionError(errno.EACCES, "Permission denied", str(old), None, str(new))

    monkeypatch.setattr(os, "replace", refuse)
    cache.write(1, records(1), {"photons": 1})
    assert f"(Permission denied: {file})" in cache.trouble and "\n" not in cache.trouble


@pytest.mark.skipif(
    not Path("/proc/self").is_dir(), reason="needs a file system that takes no files"
)
def test_a_file_system_that_takes_no_files_is_called_that(monkeypatch):
    """There the operating system says "No such file or directory", of what was to be made."""
    monkeypatch.setenv("MCRIM_CACHE", "/proc")
    cache = RecordCache(KEY)
    cache.write(0, records(0), {"photons": 0})
    words = "/proc: photon records cannot be kept (no file can be made in this file system);"
    assert cache.trouble.startswith(words)
    monkeypatch.setenv("MCRIM_CACHE", "/proc/mcrim")
    assert "no file can be made in this file system" in refusal(RecordCache, KEY)


@pytest.mark.skipif(
    not hasattr(os, "geteuid") or os.geteuid() == 0, reason="root may write anywhere"
)
def test_a_read_only_cache_still_gives_what_it_holds(tmp_path):
    cache = filled(tmp_path)
    cache.folder.chmod(0o555)
    try:
        cache.write(1, records(1), {"photons": 1})
        assert "cannot be kept" in cache.trouble
        assert is_chunk(cache.read(0), 0)
    finally:
        cache.folder.chmod(0o755)


def test_where_the_cache_lies(tmp_path, monkeypatch):
    monkeypatch.delenv("MCRIM_CACHE", raising=False)
    assert cache_folder().name == "mcrim_mitsuba"
    monkeypatch.setenv("MCRIM_CACHE", str(tmp_path / "new" / "cache"))
    cache = RecordCache(KEY)
    assert cache_folder().is_dir() and cache.folder.parent == cache_folder()
    for off in ("", "off", "OFF"):
        monkeypatch.setenv("MCRIM_CACHE", off)
        cache = RecordCache(KEY)
        cache.write(0, records(0), {})
        assert cache.read(0) is cache.folder is cache.trouble is None


@cases("name", "value", "problem")
def test_a_wrong_setting_is_refused_in_one_line(tmp_path, monkeypatch, name, value, problem):
    (tmp_path / "file").touch()
    monkeypatch.setenv("MCRIM_CACHE", str(tmp_path))
    monkeypatch.setenv(name, value.replace("FILE", str(tmp_path / "file")))
    refused = refusal(RecordCache, KEY)
    assert refused.startswith(name) and problem in refused


def test_versions_say_what_records_depend_on():
    versions = record_versions("llvm_ad_rgb")
    assert {"mcrim-mitsuba", "mitsuba", "drjit", "llvm", "variant", "source_hash"} <= set(versions)
