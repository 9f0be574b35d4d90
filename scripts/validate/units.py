"""Work of the validation in units that are done once: photons of one program on one bench.

A unit is a pure function of what it is keyed by. Finished ones are lines of a file, each appended
with one write: an interrupt, or a kill, costs only the units under way.
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import importlib.metadata
import json
import os
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from geant4 import trace_geant4
from shared import GEANT4_CODE, TRACER_CODE, source_hash
from trials.executor import TrialExecutor

from mcrim_mitsuba.core.errors import InputError
from mcrim_mitsuba.reference.tracer import trace
from mcrim_mitsuba.scene.scene_file import SceneFile, read_scene
from validate import formulas
from validate.benches import Case
from validate.formulas import Formula

MITSUBA, FORMULA, NUMPY, GEANT4 = "Mitsuba", "closed form", "NumPy", "Geant4"
#: Worked out when the rows are: it takes milliseconds.
SOLVER = "solver"
#: Photons of one unit: some seconds of one core.
BLOCK = {NUMPY: 250_000, GEANT4: 100_000}
#: Free flights after which a photon is given up. Light that is trapped for ever ends so.
MAX_DEPTH, MAX_DEPTH_TRAPPED = 200_000, 2000
VARIANT = "llvm_ad_rgb"


@dataclass(frozen=True)
class Unit:
    """One piece of work: photons of `MITSUBA`, `FORMULA`, `NUMPY` or `GEANT4` on one bench.

    `MITSUBA` takes so many photons at most, and ends at a `precision` of eta; a formula takes 0.
    Every unit of a validation's seed draws numbers of its own, each `number` of a block too.
    """

    program: str
    case: Case | Formula
    photons: int
    seed: int
    number: int = 0
    precision: float | None = None

    @property
    def own_seed(self) -> int:
        """Seed that no other unit has, but for one chance in 10^9."""
        return int(_hash(self.program, self.seed, self.number, self.case.described)[:15], 16)

    @functools.cached_property
    def key(self) -> str:
        """SHA-256 (hexadecimal) of all that the result depends on."""
        work = [self.program, self.own_seed, self.photons, self.precision]
        if self.program == MITSUBA:
            return _hash(*work, scene_of(self.case).content_hash, MAX_DEPTH, code(MITSUBA))
        return _hash(*work, self.case.described, code(self.program))


class Results:
    """Finished units, in a file that is made if it is not there.

    What a kill left unfinished at its end is taken away. Raises InputError if the file is none of
    ours, or cannot be read or written.
    """

    def __init__(self, path: Path) -> None:
        self.path, self._found, whole = path, {}, 0
        try:
            content = path.read_bytes() if path.exists() else b""
            for line in content.splitlines(keepends=True):
                if line.endswith(b"\n"):
                    unit = json.loads(line)
                    self._found[unit["key"]] = unit["result"]
                    whole += len(line)
            with path.open("ab") as stream:
                stream.truncate(whole)
        except (OSError, ValueError, KeyError, TypeError) as error:
            what = "is no file of finished units"
            if isinstance(error, OSError):
                what = f"cannot be used ({error.strerror})"
            raise InputError(what, "name another file", path=path) from None

    def __contains__(self, unit: Unit) -> bool:
        return unit.key in self._found

    def __getitem__(self, unit: Unit) -> dict[str, Any]:
        return self._found[unit.key]

    def add(self, unit: Unit, result: dict[str, Any]) -> None:
        """Keep a result, at once and for good."""
        named = {"program": unit.program, "bench": unit.case.name, "number": unit.number}
        line = json.dumps({"key": unit.key, **named, "result": result}) + "\n"
        try:
            with self.path.open("ab", buffering=0) as stream:
                stream.write(line.encode())
                os.fsync(stream.fileno())
        except OSError as error:
            raise InputError(
                f"cannot be written ({error.strerror})",
                "make room; finished units are kept",
                path=self.path,
            ) from None
        self._found[unit.key] = result


def do(unit: Unit) -> dict[str, Any]:
    """The result of a unit, as JSON can hold it."""
    if unit.program == FORMULA:
        value, sigma = unit.case.exact()
        return {"value": value, "sigma": sigma}
    if unit.program == MITSUBA:
        return _do_mitsuba(unit)
    if unit.program == NUMPY:
        scene = scene_of(unit.case)
        found = trace(scene, unit.photons, unit.own_seed, max_depth=MAX_DEPTH, threads=1)
        return {"photons": found.photons, "counts": found.counts}
    # the light of the other programs is unpolarised
    bench = unit.case.bench()
    found = trace_geant4(bench, unit.photons, unit.own_seed, threads=1, depolarize=True)
    return {"photons": found.photons, "counts": found.counts, "version": found.version}


def do_all(
    units: Iterable[Unit], results: Results, processes: int, done: Callable[[Unit], None]
) -> None:
    """Do the units that are not done yet, in processes; tell `done` of every unit that is there.

    Raises RuntimeError if one cannot be done.
    """
    missing: dict[str, Unit] = {}
    for unit in units:
        if unit in results:
            done(unit)
        else:
            missing[unit.key] = unit
    work = {key: (unit,) for key, unit in missing.items()}
    with contextlib.closing(TrialExecutor(processes).outcomes(do, work)) as outcomes:
        for key, result, failure in outcomes:
            if failure is not None:
                raise RuntimeError(f"{missing[key].case.name}: {failure}")
            results.add(missing[key], result)
            done(missing[key])


def scene_of(case: Case | Formula) -> SceneFile:
    """The bench for Mitsuba."""
    if isinstance(case, Case):
        return case.scene_file()
    if not case.ball:
        group = "beam" if case.form == formulas.BEAM else "plain"
        return Case(group, case.parameters).scene_file()
    return read_scene(formulas.BALL, case.parameters)


@functools.cache
def code(program: str) -> dict[str, str]:
    """What of the software a program's units depend on."""
    if program == MITSUBA:
        from mcrim_mitsuba.runs.cache import record_versions

        return record_versions(VARIANT, "mcrim_mitsuba.transport.simulation")
    if program == FORMULA:
        return {"source_hash": source_hash([Path(formulas.__file__)])}
    if program == NUMPY:
        return {"numpy": np.__version__, "source_hash": source_hash(TRACER_CODE)}
    return {
        "geant4_pybind": importlib.metadata.version("geant4_pybind"),
        "source_hash": source_hash(GEANT4_CODE),
    }


def _do_mitsuba(unit: Unit) -> dict[str, Any]:
    from mcrim_mitsuba.transport.simulation import Simulation

    trapped = isinstance(unit.case, Formula) and unit.case.fate == "truncated"
    simulation = Simulation(scene_of(unit.case), variant=VARIANT, check=False)
    found = simulation.collect(
        unit.photons,
        precision=unit.precision,
        seed=unit.own_seed,
        max_depth=MAX_DEPTH_TRAPPED if trapped else MAX_DEPTH,
    )
    if found.interrupted:
        raise KeyboardInterrupt
    return {
        "photons": found.photons,
        "budget": found.budget,
        "sigma": found.budget_sigma,
        "scene_hash": found.scene_hash,
        "versions": found.versions,
        "path": found.transport,
    }


def _hash(*parts: Any) -> str:
    return hashlib.sha256(json.dumps(parts, sort_keys=True).encode()).hexdigest()
