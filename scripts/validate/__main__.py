"""The command: `python scripts/validate`."""

from __future__ import annotations

import dataclasses
import datetime
import math
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

import click

sys.path.insert(0, str(Path(__file__).parents[1]))
from geant4 import is_installed, refuse_bench
from shared import fraction_error

from mcrim_mitsuba.cli import options, terminal
from mcrim_mitsuba.core.errors import InputError
from mcrim_mitsuba.core.files import refuse_outputs
from mcrim_mitsuba.core.run import processors
from mcrim_mitsuba.efficiency.polished_box import solve_box
from mcrim_mitsuba.output.description import table
from validate.benches import Case, cases
from validate.formulas import Formula, formulas
from validate.judging import Judgement, agree, judge
from validate.report import SUMMARY_HEAD, Row, summary, verdict, write_report
from validate.units import (
    BLOCK,
    FORMULA,
    GEANT4,
    MITSUBA,
    NUMPY,
    SOLVER,
    Results,
    Unit,
    code,
    do,
    do_all,
)

PAGE = Path(__file__).parents[2] / "docs" / "validation.md"
#: Of Mitsuba's eta: its photons are cheap.
OUR_PRECISION = 0.0007
#: Photons of a bench: Mitsuba's at most and for closed forms, the others' at most.
MOST_MITSUBA, FORMULA_PHOTONS, TRAPPED_PHOTONS, MOST = 40_000_000, 1_000_000, 200_000, 2_500_000
#: Photons of a beam, whose lives are short, in the other programs at most.
MOST_OF_BEAM = 20_000_000
#: A fate that fewer photons of the other program met has no normal distribution yet.
FEWEST_COUNTS = 25
PHASE = "its polarisation leaves out the phase of total reflection: another model"


@click.command()
@click.option(
    "--precision",
    type=options.Precision(),
    default="0.2%",
    show_default=True,
    help="Of eta in the independent tracer and in Geant4.",
)
@options.seed
@click.option(
    "--processes",
    type=options.Whole(1, 1024),
    default=processors(),
    help="How many units are done at a time (default: one per core).",
)
@click.option(
    "-o",
    "--output",
    "page",
    default=str(PAGE),
    metavar="FILE.md",
    show_default="docs/validation.md",
    help="The page; a .png and a .csv go beside it.",
)
@click.option(
    "--only",
    multiple=True,
    metavar="KIND",
    help="Compare benches of this kind alone: plain, polarised, wrapped, effect, beam or "
    "an effect's name (repeatable; no closed forms then; needs --output).",
)
@click.option(
    "--units",
    "units_file",
    default="validation_units.jsonl",
    show_default=True,
    metavar="FILE",
    help="Finished units; made if it is not there.",
)
@click.option("--log", metavar="FILE", help="Append the progress to this file.")
@options.json_output
def main(precision, seed, processes, page, only, units_file, log, json_file) -> int:
    """Compare Mitsuba with closed forms, the noise-free solver, the independent tracer and Geant4.

    Geant4 is left out where it is not installed.
    """
    refuse_outputs({"--output": page, "--json": json_file}, suffixes={"--output": (".md",)})
    screen = terminal.console(json_file)
    results = Results(Path(units_file))
    chosen, closed = cases(), formulas()
    if only:
        chosen, closed = [case for case in chosen if {case.group, case.effect} & {*only}], []
        refuse_partial(chosen, only, page)
    compared = Comparison(precision, seed, chosen, closed, results)
    try:
        with terminal.photon_progress(log=log) as report:
            compared.run(processes, report)
    except KeyboardInterrupt:
        screen.say(f"interrupted; the same line goes on from what is in {units_file}")
        return terminal.INTERRUPTED
    rows = compared.rows()
    judged = judge_all(rows)
    provenance = {
        "command": " ".join(
            [
                "python scripts/validate",
                f"--precision {100 * precision:g}%",
                *(f"--only {kind}" for kind in only),
            ]
        ),
        "date": datetime.datetime.now(datetime.UTC).strftime("%Y-%m-%d"),
        "seed": seed,
        "precision": precision,
        "most_photons": MOST,
        "most_photons_of_beam": MOST_OF_BEAM,
        "versions": compared.versions(),
        "refused": compared.refused,
    }
    write_report(Path(page), rows, judged, provenance)
    found = {
        "agrees": agree(judged),
        "programs": {name: dataclasses.asdict(one) for name, one in judged.items()},
        "rows": [dataclasses.asdict(row) | {"z": row.z} for row in rows],
    }
    terminal.write_json(json_file, found | provenance)
    screen.show(table("", SUMMARY_HEAD, summary(judged)))
    screen.line(verdict(judged))
    for program, bench, why in compared.refused:
        screen.line(f"not compared with {program}: {bench}: {why}")
    return 0 if agree(judged) else 1


def refuse_partial(chosen: Sequence[Case], only: Sequence[str], page: str) -> None:
    """Refuse kinds that no bench is of, and a part of the benches on the page of all."""
    for kind in only:
        if not any(kind in (case.group, case.effect) for case in chosen):
            raise InputError(f"no bench is of the kind {kind!r}", "name a group or an effect")
    if Path(page) == PAGE:
        problem = "a part of the benches would overwrite the page of all"
        raise InputError(problem, "name another one with --output")


class Comparison:
    """All units of a validation, and the comparisons they make.

    The `precision` is that of eta in the other programs. `refused` (after that): program, bench
    and why it is not compared.
    """

    def __init__(
        self,
        precision: float,
        seed: int,
        benches: Sequence[Case],
        closed: Sequence[Formula],
        results: Results,
    ) -> None:
        self.precision, self.seed, self.results = precision, seed, results
        self._benches, self._closed = list(benches), list(closed)
        self.refused: list[tuple[str, str, str]] = []
        self._of_geant4 = [case for case in self._benches if self._goes_to_geant4(case)]
        self._ours = {case.name: self._our_unit(case) for case in [*closed, *benches]}

    def run(self, processes: int, report: Callable[..., None]) -> None:
        """Do what is not done yet."""
        photons = 0
        for number, unit in enumerate(self._ours.values(), start=1):
            if unit not in self.results:
                self.results.add(unit, do(unit))
            photons += self.results[unit]["photons"]
            expected = photons * len(self._ours) // number
            report("Mitsuba", photons, expected, f"{number} of {len(self._ours)} units")
        others = [Unit(FORMULA, case, 0, self.seed) for case in self._closed]
        others += [unit for pair in self._pairs() for unit in self._blocks(*pair)]
        total, finished = sum(unit.photons for unit in others), []

        def done(unit: Unit) -> None:
            finished.append(unit.photons)
            report("others", sum(finished), total, f"{len(finished)} of {len(others)} units")

        do_all(others, self.results, processes, done)

    def rows(self) -> list[Row]:
        """All comparisons; everything must be done."""
        found = [self._closed_row(case) for case in self._closed]
        found += [row for case in self._benches for row in self.solved_row(case)]
        return found + [row for pair in self._pairs() for row in self._rows_of(*pair)]

    def _pairs(self) -> list[tuple[str, Case]]:
        """Benches, and who traces them beside Mitsuba."""
        of_programs = ((NUMPY, self._benches), (GEANT4, self._of_geant4))
        return [(program, case) for program, benches in of_programs for case in benches]

    def versions(self) -> dict[str, str]:
        """Versions of everything, in words."""
        ours = self.results[next(iter(self._ours.values()))]["versions"]
        found = {
            "Mitsuba": ", ".join(f"{key} {value}" for key, value in ours.items()),
            "NumPy": code(NUMPY)["numpy"],
        }
        if self._of_geant4:
            (unit, *_) = self._blocks(GEANT4, self._of_geant4[0])
            pybind = code(GEANT4)["geant4_pybind"]
            found["Geant4"] = f"{self.results[unit]['version']} (geant4_pybind {pybind})"
        programs = (
            MITSUBA,
            *([FORMULA] if self._closed else []),
            NUMPY,
            *([GEANT4] if self._of_geant4 else []),
        )
        sources = (f"{program} {code(program)['source_hash'][:12]}" for program in programs)
        return found | {"our code": ", ".join(sources)}

    def _goes_to_geant4(self, case: Case) -> bool:
        why = PHASE
        if not is_installed():
            why = "it is not installed"
        elif not case.parameters.get("polarization"):
            try:
                refuse_bench(case.bench())
                return True
            except InputError as error:
                why = error.problem
        self.refused.append((GEANT4, case.name, why))
        return False

    def _our_unit(self, case: Case | Formula) -> Unit:
        if isinstance(case, Case):
            return Unit(MITSUBA, case, MOST_MITSUBA, self.seed, precision=OUR_PRECISION)
        photons = TRAPPED_PHOTONS if case.fate == "truncated" else FORMULA_PHOTONS
        return Unit(MITSUBA, case, photons, self.seed)

    def _blocks(self, program: str, case: Case) -> list[Unit]:
        eta = self.results[self._ours[case.name]]["budget"]["detected"]
        most = MOST_OF_BEAM if case.group == "beam" else MOST
        photons = min((1 - eta) / eta / self.precision**2, most)
        count = math.ceil(photons / BLOCK[program])
        return [Unit(program, case, BLOCK[program], self.seed, number) for number in range(count)]

    def _closed_row(self, case: Formula) -> Row:
        ours = self.results[self._ours[case.name]]
        exact = self.results[Unit(FORMULA, case, 0, self.seed)]
        return Row(
            FORMULA,
            case.form,
            case.name,
            case.fate.replace("detected", "eta"),
            ours["budget"][case.fate],
            ours["sigma"][case.fate],
            exact["value"],
            exact["sigma"],
            ours["photons"],
            0,
            ours["scene_hash"],
            True,
        )

    def solved_row(self, case: Case) -> list[Row]:
        """Of a plain bench that can be solved without photons: its eta."""
        if case.group != "plain":
            return []
        try:
            exact = solve_box(case.bench())
        except InputError as error:
            self.refused.append((SOLVER, case.name, error.problem))
            return []
        ours = self.results[self._ours[case.name]]
        eta, sigma = ours["budget"]["detected"], ours["sigma"]["detected"]
        return [
            Row(
                SOLVER,
                case.group,
                case.name,
                "eta",
                eta,
                sigma,
                float(exact.eta),
                float(exact.error),
                ours["photons"],
                0,
                ours["scene_hash"],
                True,
            )
        ]

    def _rows_of(self, program: str, case: Case) -> list[Row]:
        ours = self.results[self._ours[case.name]]
        blocks = [self.results[unit] for unit in self._blocks(program, case)]
        n = sum(block["photons"] for block in blocks)
        found = []
        for fate in blocks[0]["counts"]:
            k = sum(block["counts"][fate] for block in blocks)
            # Geant4 counts all light that ends elsewhere together
            our_fate = "escaped" if fate == "elsewhere" else fate
            if fate == "elsewhere" and ours["budget"].get("absorbed_gap", 0.0) > 0:
                continue
            budget, sigma = (ours[what].get(our_fate, 0.0) for what in ("budget", "sigma"))
            if min(k, n - k) < FEWEST_COUNTS and budget * n < FEWEST_COUNTS:
                continue
            quantity = "eta" if fate == "detected" else our_fate
            found.append(
                Row(
                    program,
                    case.group,
                    case.name,
                    quantity,
                    budget,
                    sigma,
                    k / n,
                    fraction_error(k, n),
                    ours["photons"],
                    n,
                    ours["scene_hash"],
                    fate == "detected",
                )
            )
        return found


def judge_all(rows: Sequence[Row]) -> dict[str, Judgement]:
    """The z-scores of every program, tested."""
    found = {}
    programs = list(dict.fromkeys(row.program for row in rows))
    for program in programs:
        own = [row for row in rows if row.program == program]
        leading = [row for row in own if row.leading]
        sigmas = [row.sigma / row.other for row in leading]
        scores = [row.z for row in leading], sigmas, [row.z for row in own]
        found[program] = judge(*scores, len(programs))
    return found


if __name__ == "__main__":
    sys.exit(terminal.run(main, "validate"))
