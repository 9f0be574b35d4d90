"""Does a diagnosis find what is missing? The NumPy tracer's campaigns, with an effect in them.

    python scripts/hidden_effect_trial.py --json trials.jsonl                # all kinds
    python scripts/hidden_effect_trial.py --kind single --trials 64 --only gap_bubble

A campaign is the standard one of shared/effects.md: sixteen readings at 0.7 %, with the tracer's
own error on top. The bench's coefficients, the light yield and the absorption's prior are drawn for
every trial; the package sees a CSV and a campaign file with the plain scene, as a laboratory's.

Tracing what is hidden takes half an hour on one core, once: the histories are kept (--histories).
A trial then takes some seconds, the first one two minutes more: it fills the package's cache.
What is in the file of --json is not done again, as long as the code is the same.
"""

from __future__ import annotations

import json
import multiprocessing
import multiprocessing.pool
import signal
import sys
import tempfile
import traceback
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import click
import platformdirs
from hidden_campaigns import EFFECTS, TOO_SMALL
from hidden_histories import HistoryStore, package_hash
from hidden_scores import confusion, excess_range, markdown, rates, verdicts
from hidden_trials import KINDS, TrialMaker, run_trial

from mcrim_mitsuba.cli import options, output
from mcrim_mitsuba.errors import InputError
from mcrim_mitsuba.files.writing import refuse_outputs, write_text

#: Trials of every kind, if not asked otherwise.
TRIALS = {"single": 64, "none": 60, "pairs": 24, "outsiders": 21, "mimic": 6, "too_small": 6}
_ORDER = (*EFFECTS, *TOO_SMALL)

_worker: dict[str, object] = {}


def _set_up(histories: Path, photons: int | None, seed: int, only, campaigns: Path) -> None:
    """What a process needs to make and judge trials."""
    # Ctrl-C is the parent's
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    store = HistoryStore(histories) if photons is None else HistoryStore(histories, photons)
    _worker.update(maker=TrialMaker(store, seed, only), campaigns=campaigns)


def _try(work: tuple[str, int, int | None]) -> dict | str:
    """One trial's line, or why there is none."""
    kind, number, threads = work
    try:
        return run_trial(_worker["maker"].draw(kind, number), _worker["campaigns"], threads)
    except Exception as error:  # an error of the package's is a result too
        where = traceback.extract_tb(error.__traceback__)[-1]
        return f"{kind} {number}: {error} ({Path(where.filename).name}, line {where.lineno})"


class Lines:
    """Trials that a file has, one a line, and those that are added.

    Parameters
    ----------
    file : Path or None
        None: nothing is kept.
    key : dict
        What all trials of this run have in common; lines of another key are left alone.
    """

    def __init__(self, file: Path | None, key: dict) -> None:
        self._file, self._key = file, key
        self.done: dict[tuple[str, int], dict] = {}
        if file is None or not file.is_file():
            return
        for line in file.read_text(encoding="utf-8").splitlines():
            try:
                trial = json.loads(line)
            except json.JSONDecodeError:  # an interrupted line
                continue
            if isinstance(trial, dict) and trial.get("key") == key:
                self.done[trial["kind"], trial["number"]] = trial

    def add(self, trial: dict) -> None:
        """Keep a trial."""
        self.done[trial["kind"], trial["number"]] = trial
        if self._file is not None:
            # begins with an end of line: the one before may have been interrupted
            with self._file.open("a", encoding="utf-8") as stream:
                stream.write("\n" + json.dumps(trial | {"key": self._key}) + "\n")


def _run_all(
    pool: multiprocessing.pool.Pool, wanted: Sequence[tuple[str, int]]
) -> Iterator[dict | str]:
    """Trials as they end. The first one has all threads, and fills the cache for the others."""
    if wanted:
        yield pool.apply(_try, ((*wanted[0], None),))
        yield from pool.imap_unordered(_try, [(*each, 1) for each in wanted[1:]])


@contextmanager
def _campaign_folder(given: Path | None) -> Iterator[Path]:
    if given is not None:
        given.mkdir(parents=True, exist_ok=True)
        yield given
        return
    with tempfile.TemporaryDirectory(prefix="hidden-effects-") as folder:
        yield Path(folder)


_COLUMNS = (
    ("trial", 13), ("hidden", 44), ("excess", 6), ("verdict", 14), ("first", 22),
    ("p after", 8), ("pulls of alpha_scat, light yield: before", 14), ("after", 14),
)  # fmt: skip


def _headings() -> str:
    return "  ".join(f"{name:<{width}}" for name, width in _COLUMNS)


def _as_line(trial: dict) -> str:
    """A trial in one line, what is amiss at its end."""
    hidden = ", ".join(f"{name} {size:.3g}" for name, size in trial["hidden"])
    hidden = hidden or " ".join([trial["what"], *trial["spoiled"]])
    pulls = (
        "{:+.1f} {:+.1f}".format(*trial[f"pulls_{when}"].values()) for when in ("before", "after")
    )
    cells = (
        f"{trial['kind']} {trial['number']}", hidden, f"{trial['expected_excess']:.0f}",
        trial["verdict"], trial["first"] or "",
        f"{trial['p_after'] or 0.0:.2g}", *pulls,
    )  # fmt: skip
    line = "  ".join(f"{cell:<{_COLUMNS[i][1]}}" for i, cell in enumerate(cells))
    if len(trial["leading"]) > 1:
        line += f"  leading: {', '.join(trial['leading'])}"
    if trial["suspects"]:
        line += f"  suspects: {'; '.join(' and '.join(labels) for labels in trial['suspects'])}"
    if trial["added"] and trial["added"] != trial["leading"]:
        line += f"  added: {', '.join(trial['added'])}"
    return line


def _show(screen, trials: list[dict]) -> None:
    """Rates, verdicts and the confusion matrix."""
    shown = output.table("hidden-effect trials", "point", "found", "wanted", "verdict")
    for rate in rates(trials):
        wanted = "" if rate.least is None else f"≥ {100 * rate.least:.0f} %"
        verdict = {None: "", True: "met", False: "NOT met"}[rate.met]
        shown.add_row(rate.point, str(rate), wanted, verdict)
    screen.print(shown)
    found = verdicts(trials)
    words = list(dict.fromkeys(word for counts in found.values() for word in counts))
    shown = output.table("verdicts", "hidden", *words)
    for name, counts in found.items():
        shown.add_row(name, *(str(counts[word] or "") for word in words))
    screen.print(shown)
    matrix = confusion(trials, _ORDER)
    if matrix.hidden:
        shown = output.table(
            "first place (columns, numbered as listed) by what was hidden",
            "hidden", "leading", *(str(1 + n) for n in range(len(matrix.first))),
        )  # fmt: skip
        for name, counts, number, leading in zip(
            matrix.hidden, matrix.counts, matrix.trials, matrix.leading, strict=True
        ):
            shown.add_row(name, f"{leading}/{number}", *(str(n) if n else "·" for n in counts))
        screen.print(shown)
        named = ", ".join(f"{1 + n} {name}" for n, name in enumerate(matrix.first))
        screen.print(f"first place: {named}", markup=False)
    low, high = excess_range(trials)
    seconds = sorted(trial["seconds"] for trial in trials)
    screen.print(
        f"expected excess {low:.0f} to {high:.0f}; diagnosis and repair took "
        f"{seconds[len(seconds) // 2]:.1f} s in the median trial, {seconds[-1]:.0f} s at most",
        markup=False,
    )


@click.command()
@click.option("--trials", "number", type=options.Whole(1, 100_000), default=None,
              help="Trials of every kind; default: "
              + ", ".join(f"{count} {kind}" for kind, count in TRIALS.items()) + ".")  # fmt: skip
@click.option("--kind", "kinds", type=click.Choice([*KINDS, "all"]), multiple=True,
              default=("all",), help="What is hidden; may be given several times.")  # fmt: skip
@click.option("--only", type=click.Choice(list(EFFECTS)), multiple=True,
              help="Single effects to hide, instead of all.")  # fmt: skip
@options.seed
@click.option("--json", "json_file", type=click.Path(dir_okay=False, path_type=Path),
              help="One line per trial; those that are in the file are not done again.",
              )  # fmt: skip
@click.option("--markdown", "markdown_file", type=click.Path(dir_okay=False, path_type=Path),
              help="The tables at the end, for a README.")  # fmt: skip
@click.option("--histories", type=click.Path(file_okay=False, path_type=Path), default=None,
              help="Folder of the traced histories; default: in the user's cache.")  # fmt: skip
@click.option("--photons", type=options.Whole(100, 10**9), default=None,
              help="Traced per configuration and scattering coefficient, fewer for a quick look.",
              )  # fmt: skip
@click.option("--campaigns", type=click.Path(file_okay=False, path_type=Path), default=None,
              help="Folder to keep the campaigns in, to look at one by hand.")  # fmt: skip
@click.option("--processes", type=options.Whole(1, 64), default=2, show_default=True)
def main(
    number, kinds, only, seed, json_file, markdown_file, histories, photons, campaigns, processes
) -> None:
    """Hide effects in campaigns, let the package diagnose and repair them, and count.

    Exit status 1 if a rate is not as wanted.
    """
    refuse_outputs({"--markdown": markdown_file and str(markdown_file)})
    if histories is None:
        histories = platformdirs.user_cache_path("mcrim_mitsuba", appauthor=False) / "histories"
    kinds = KINDS if "all" in kinds else tuple(dict.fromkeys(kinds))
    wanted = [(kind, n) for kind in kinds for n in range(number or TRIALS[kind])]
    key = {"seed": seed, "only": list(only), "photons": photons, "code": package_hash()}
    lines = Lines(json_file, key)
    missing = [each for each in wanted if each not in lines.done]
    screen = output.console()
    failures = []
    if missing:
        store = HistoryStore(histories) if photons is None else HistoryStore(histories, photons)
        with output.photon_progress() as report:
            store.produce(TrialMaker(store, seed, only).cases(kinds), report, processes)
        with _campaign_folder(campaigns) as folder:
            # processes started anew: a fork of one whose threads run could hang
            workers = multiprocessing.get_context("spawn").Pool(
                processes, _set_up, (histories, photons, seed, only, folder)
            )
            screen.print(_headings(), markup=False, soft_wrap=True)
            with output.photon_progress() as report, workers as pool:
                report("trials", len(wanted) - len(missing), len(wanted))
                for found in _run_all(pool, missing):
                    if isinstance(found, str):
                        failures.append(found)
                        screen.print(found, markup=False, soft_wrap=True)
                        continue
                    lines.add(found)
                    screen.print(_as_line(found), markup=False, soft_wrap=True)
                    report("trials", len(lines.done), len(wanted))
    trials = [lines.done[each] for each in wanted if each in lines.done]
    if not trials:
        raise InputError("no trial came to an end", "see the reasons above")
    _show(screen, trials)
    if markdown_file is not None:
        write_text(markdown_file, markdown(trials, _ORDER))
    for failure in failures:
        print(f"hidden_effect_trial: {failure}", file=sys.stderr)
    sys.exit(1 if failures or any(rate.met is False for rate in rates(trials)) else 0)


if __name__ == "__main__":
    try:
        main(standalone_mode=False)
    except InputError as wrong:
        print(f"hidden_effect_trial: {wrong}", file=sys.stderr)
        sys.exit(2)
    except click.ClickException as wrong:
        print(f"hidden_effect_trial: {wrong.format_message()}", file=sys.stderr)
        sys.exit(2)
    except (click.Abort, KeyboardInterrupt):
        sys.exit("hidden_effect_trial: interrupted; what --json has is kept")
