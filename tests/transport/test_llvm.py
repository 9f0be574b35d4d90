"""Where LLVM comes from: the wheels of all systems, by the lists of files that they bring.

The lists are those of the wheels in the package index. This machine's library stands for theirs.
"""

import os
import platform
import subprocess
import sys
import tomllib

import pytest
from packaging.requirements import Requirement
from places import ROOT, SCENES, cases_of
from refusals import refusal

import mcrim_mitsuba as mcrim
from mcrim_mitsuba.transport import variants as llvm

cases = cases_of(__file__)

LIBRARY = "the library"
KARELLEN, NANOBIND = "karellen_llvm_core-23.1.4", "llvm_nanobind-21.1.6.3"
X86 = {"../../libLLVM.so.23.1": LIBRARY, "../../libLLVM.so": ""}
LINUX = {
    "llvm/__init__.abi3.so": "",
    "llvm_nanobind.libs/liblzma-6f9d2abe.so.5.2.4": "",
    "llvm_nanobind.libs/libLLVM-15bf2ffe.so.21.1": LIBRARY,
    "llvm_nanobind.libs/libzstd-28866717.so.1.4.4": "",
}
MACOS = {"llvm/__init__.abi3.so": "", "llvm_nanobind.dylibs/l99c09c.dylib": LIBRARY}
WINDOWS = {"llvm/__init__.pyd": "", "llvm/LLVM.dll": LIBRARY}


@pytest.fixture
def installed(tmp_path, monkeypatch):
    """Installs wheels, by their lists of files, where no other brings an LLVM."""
    real = llvm.selected_llvm().path

    def install(wheels):
        site = tmp_path / "lib" / "python3.12" / "site-packages"
        # a wheel without files hides the one that is further on the path
        for wheel, files in ({NANOBIND: {}, KARELLEN: {}} | wheels).items():
            records = site / f"{wheel}.dist-info"
            records.mkdir(parents=True)
            name, version = wheel.split("-")
            (records / "METADATA").write_text(f"Name: {name}\nVersion: {version}\n")
            (records / "RECORD").write_text("".join(f"{file},,\n" for file in files))
            for file, content in files.items():
                place = site / file
                place.parent.mkdir(parents=True, exist_ok=True)
                place.symlink_to(real) if content == LIBRARY else place.write_text("no library")
        monkeypatch.syspath_prepend(site)
        monkeypatch.setattr(sys, "prefix", str(tmp_path / "elsewhere"))
        monkeypatch.delitem(sys.modules, "drjit", raising=False)
        monkeypatch.setenv(llvm.ENVIRONMENT_VARIABLE, "")
        monkeypatch.setattr(llvm.glob, "glob", lambda pattern: [])
        monkeypatch.setattr(llvm.ctypes.util, "find_library", lambda name: None)
        return llvm.selected_llvm.__wrapped__()

    return install


@pytest.mark.parametrize(
    "wheels",
    [{NANOBIND: LINUX}, {NANOBIND: MACOS}, {NANOBIND: WINDOWS}, {KARELLEN: X86}],
    ids=["Linux aarch64", "macOS arm64", "Windows x64", "Linux x86-64"],
)
def test_the_library_of_every_systems_wheel_is_found(installed, wheels):
    found = installed(wheels)
    assert isinstance(found, llvm.LlvmLibrary), found
    assert found.origin == "wheel" and found.version[0] >= llvm.OLDEST_LLVM


def test_without_a_wheel_the_line_names_that_of_every_system(installed):
    line = refusal(installed, {})
    assert all(f"pip install {wheel}" in line for wheel in llvm.WHEELS)


@cases("system", "machine", "python", "wheels")
def test_one_wheel_brings_llvm_to_every_system(system, machine, python, wheels):
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    here = {"sys_platform": system, "platform_machine": machine, "python_version": python}
    needed = [Requirement(text) for text in project["dependencies"]]
    asked = [r.name for r in needed if "llvm" in r.name and r.marker.evaluate(here)]
    assert asked == wheels


#: Of every process on a system that has no libatomic.
LACKING = """
import ctypes, sys
real = ctypes.CDLL
def lacking(name, *further, **given):
    if "libatomic" in str(name):
        raise OSError(f"{name}: no such file")
    return real(name, *further, **given)
ctypes.CDLL = lacking
class OnlyWithLibatomic:
    def find_spec(self, name, *further):
        if name == "drjit" and "/memfd:libatomic" not in open("/proc/self/maps").read():
            raise ImportError("libatomic.so.1: no such file")
sys.meta_path.insert(0, OnlyWithLibatomic())
"""
PHOTONS = 300_000
#: Benches by processes, and one by threads that wait for each other.
BENCHES = f"""
import mcrim_mitsuba as mcrim, sys
from mcrim_mitsuba.runs.executors import ProcessExecutor, more_units_follow, use_executor
with use_executor(ProcessExecutor(2)), more_units_follow():
    mcrim.calibrate(sys.argv[2], photons=100_000, check=False)
assert "drjit" not in sys.modules
print(mcrim.simulate(sys.argv[1], photons={PHOTONS}, threads=3).eta)
"""


@pytest.mark.skipif(
    (sys.platform, platform.machine()) != ("linux", "x86_64"), reason="one is made for x86-64 alone"
)
def test_a_system_without_libatomic_gives_the_same_digits(tmp_path):
    (tmp_path / "sitecustomize.py").write_text(LACKING)
    scene, campaign = (str(SCENES / name) for name in ("camoo4.xml", "camoo4_campaign.toml"))
    done = subprocess.run(
        [sys.executable, "-c", BENCHES, scene, campaign],
        env=os.environ | {"PYTHONPATH": str(tmp_path)},
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert done.returncode == 0, done.stderr
    assert float(done.stdout) == mcrim.simulate(scene, photons=PHOTONS).eta


def test_without_libatomic_and_where_none_can_be_made_a_line_says_so(monkeypatch):
    def lacking(name):
        raise OSError(f"{name}: wrong machine")

    monkeypatch.delitem(sys.modules, "drjit", raising=False)
    monkeypatch.setattr(llvm.sys, "platform", "linux")
    monkeypatch.setattr(llvm.ctypes, "CDLL", lacking)
    line = refusal(llvm.selected_llvm.__wrapped__)
    assert "libatomic.so.1" in line and "apt-get install libatomic1" in line
