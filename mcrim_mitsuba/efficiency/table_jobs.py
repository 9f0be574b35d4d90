"""Tables of eta for many scenes and many values of their parameters, each a CSV of its own."""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from mcrim_mitsuba import __version__
from mcrim_mitsuba.core.errors import InputError
from mcrim_mitsuba.core.files import (
    is_there,
    json_text,
    make_folder,
    read_text,
    refuse_outputs,
    write_text,
)
from mcrim_mitsuba.core.numbers import Value, value_text
from mcrim_mitsuba.core.run import Progress, Run
from mcrim_mitsuba.efficiency.table import EtaTable, eta_table
from mcrim_mitsuba.runs.cache import key_of
from mcrim_mitsuba.scene.scene_file import SceneFile, read_scene
from mcrim_mitsuba.scene.values import parse_list, refuse_many_points

_LIMIT_MB = 200
_KEY = "# key: "
#: Axes of a table, as `eta_table` takes them.
AXES = ("alpha_scat_per_cm", "alpha_abs_per_cm", "n_gap")


@dataclass(frozen=True)
class TableJob:
    """One table that is wanted."""

    #: With its changed parameters.
    scene: SceneFile
    #: Values of `AXES`.
    axes: dict[str, list[float]]
    #: The CSV.
    path: Path
    #: Threads and progress are no part of what a table is.
    run: Run

    @property
    def key(self) -> str:
        """Of everything that the table's numbers depend on."""
        run = self.run
        return key_of(
            scene=self.scene.content_hash, axes=self.axes, photons=run.photons,
            precision=run.precision, seed=run.seed, variant=run.variant,
        )  # fmt: skip

    @property
    def is_done(self) -> bool:
        """Whether this table, and no other, is there."""
        return f"{_KEY}{self.key}" in _lines(self.path)

    def refuse_place(self) -> None:
        """Refuse, by an InputError, to replace a file that none of these tables is in."""
        there = is_there(self.path) and self.path.is_file()
        if there and not any(line.startswith(_KEY) for line in _lines(self.path)):
            problem = "there is a file of this name, and no table of this script"
            raise InputError(problem, "name another folder, or move the file away", path=self.path)

    def make(self, progress: Progress | None = None) -> EtaTable:
        """Simulate the table and write it, whole or not at all.

        Raises InputError as `tables.eta_table`, or if the file cannot be written.
        """
        made = eta_table(self.scene, self.axes, run=replace(self.run, progress=progress))
        write_text(self.path, "\n".join([*self._provenance(made), *made.csv_lines()]) + "\n")
        return made

    def _provenance(self, made: EtaTable) -> list[str]:
        """Comments that say what the numbers are and how they came about."""
        from mcrim_mitsuba.transport.variants import versions

        known = {
            "source": f"mcrim_mitsuba {__version__}",
            "units": "coefficients in 1/cm; eta, a fraction, with its standard error",
            "scene": self.scene.path,
            "parameters": json_text(
                {n: v for n, v in self.scene.parameters.items() if n not in AXES}
            ),
            "scene_hash": self.scene.content_hash,
            "photons": made.photons,
            "seed": made.seed,
            "versions": json_text(versions(self.run.variant, self.run.threads)),
            **({"notes": json_text(list(made.notes))} if made.notes else {}),
        }
        comments = [f"# {name}: {' '.join(str(value).split())}" for name, value in known.items()]
        return [*comments, f"{_KEY}{self.key}"]


def table_jobs(
    scenes: Sequence[str | Path],
    axes: Mapping[str, Sequence[float]],
    variations: Mapping[str, str],
    folder: str | Path,
    run: Run,
) -> list[TableJob]:
    """One table for each scene and each combination of the varied parameters.

    Parameters
    ----------
    scenes : sequence of str or Path
    axes : mapping of str to sequence of float
        Values of `AXES`.
    variations : mapping of str to str
        Values of scene parameters as they are typed: ``0.02,0.05`` or ``log:0.01:1:5``; of
        indices also ``CaMoO4@540nm``; of parameters that are no numbers ``true,false``.
    folder : str or Path
        Where the tables go; made if it is not there.
    run : Run

    Raises
    ------
    InputError
        If a scene cannot be read or lacks a parameter, if a parameter is both varied and an
        axis, if two tables would have the same name or one would replace what is none, or if
        there are very many points; before anything is simulated.
    """
    folder = Path(folder)
    for name in variations:
        if name in AXES:
            option = "--" + name.removesuffix("_per_cm").replace("_", "-")
            raise InputError(f"-D {name}: a table varies it", f"give its values to {option}")
    jobs: dict[Path, TableJob] = {}
    points = 0
    for path in scenes:
        scene = read_scene(path)
        if missing := [name for name in AXES if name not in scene.parameters]:
            problem = f"the scene has no parameter {missing[0]}"
            raise InputError(problem, "declare it as a <default>", path=path)
        values = {name: _values(scene, name, text) for name, text in variations.items()}
        points += math.prod(map(len, (*values.values(), *(axes[name] for name in AXES))))
        refuse_many_points(points)
        for combination in itertools.product(*values.values()):
            changes = dict(zip(values, combination, strict=True))
            place = folder / f"{_file_name(scene.path.stem, changes)}.csv"
            if place in jobs:
                problem = f"two tables would be written to {place}"
                raise InputError(problem, "give scenes different names", path=path)
            jobs[place] = TableJob(
                scene.with_overrides(changes), {n: list(axes[n]) for n in AXES}, place, run
            )
    make_folder(folder)
    for place, job in jobs.items():
        refuse_outputs({"--output": str(place)}, scenes)
        job.refuse_place()
    return list(jobs.values())


def _lines(path: Path) -> list[str]:
    """Lines of a file; none where it cannot be read."""
    try:
        return read_text(path, _LIMIT_MB).split("\n")
    except InputError:
        return []


def _values(scene: SceneFile, name: str, text: str) -> list[Value]:
    """Values of a varied parameter, each once."""
    known = scene.parameters.get(name)
    if isinstance(known, float | int) and not isinstance(known, bool):
        return list(dict.fromkeys(parse_list(f"-D {name}", text, name, scene.path.parent)))
    return list(dict.fromkeys(part.strip() for part in text.split(",")))


def _file_name(stem: str, changes: Mapping[str, Value]) -> str:
    parts = [stem, *(f"{name}={value_text(value)}" for name, value in changes.items())]
    return re.sub(r"[^\w.+=,-]", "-", "_".join(parts))
