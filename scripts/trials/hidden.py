"""Does a diagnosis find what is missing? The NumPy tracer's campaigns, with an effect in them.

    python scripts/trials hidden                                             # all kinds
    python scripts/trials hidden --kind single --trials 64 --only gap_bubble

A campaign has ten to sixteen readings at 0.7 %, with the tracer's own error on top. The design (out
of what a laboratory can mount: liquids, masks, crystals, gaps), the bench's coefficients, the light
yield and the absorption's prior are drawn for every trial; the package sees a CSV and a campaign
file with the plain scene, as a laboratory's.

Tracing what is hidden takes a quarter of an hour on two cores, once: the histories are kept
(--histories). A trial then takes some seconds, the first ones more: they fill the package's cache.
"""

from __future__ import annotations

import json
import statistics
from pathlib import Path

import click
import platformdirs

from mcrim_mitsuba.cli import options, terminal
from mcrim_mitsuba.core.errors import InputError
from mcrim_mitsuba.core.files import make_folder, refuse_outputs, write_text
from trials.executor import Trial, Trials, executor_options
from trials.hidden_histories import PHOTONS, HistoryStore
from trials.hidden_scores import as_markdown, rates
from trials.hidden_trials import EFFECTS, KINDS, TABLES, TOO_SMALL, draw_and_run, trial_maker
from trials.truth import unfinished

#: Trials of every kind, if not asked otherwise.
TRIALS = {
    "single": 120,
    "none": 100,
    "pairs": 60,
    "instrument": 60,
    "outsiders": 20,
    "too_small": 7,
    "beam": 12,
    "left_out": 100,
    "family_out": 40,
    "advice": 60,
    "edge": 60,
    "numbers": 60,
    "numbers_out": 60,
}
_ORDER = (*EFFECTS, *TOO_SMALL)
_COLUMNS = (
    ("trial", 13),
    ("hidden", 44),
    ("excess", 6),
    ("verdict", 14),
    ("first", 22),
    ("p after", 8),
    ("pulls of alpha_scat, light yield: before", 14),
    ("after", 14),
)


def _as_line(trial: dict) -> str:
    """A trial in one line, what is amiss at its end."""
    hidden = ", ".join(f"{name} {size:.3g}" for name, size in trial["hidden"])
    cells = (
        f"{trial['kind']} {trial['number']}",
        hidden or " ".join([trial["what"], *trial["spoiled"]]),
        f"{trial['expected_excess']:.0f}",
        trial["verdict"],
        trial["first"] or "",
        f"{trial['p_after'] or 0.0:.2g}",
        *("{:+.1f} {:+.1f}".format(*trial[f"pulls_{at}"].values()) for at in ("before", "after")),
    )
    line = "  ".join(f"{cell:<{_COLUMNS[i][1]}}" for i, cell in enumerate(cells))
    if len(trial["leading"]) > 1:
        line += f"  leading: {', '.join(trial['leading'])}"
    if trial["suspects"]:
        line += f"  suspects: {'; '.join(' and '.join(labels) for labels in trial['suspects'])}"
    if trial["added"] and trial["added"] != trial["leading"]:
        line += f"  added: {', '.join(trial['added'])}"
    return line


@click.command()
@click.option(
    "--trials",
    "number",
    type=options.Whole(1, 100_000),
    default=None,
    help="Trials of every kind; default: "
    + ", ".join(f"{count} {kind}" for kind, count in TRIALS.items())
    + ".",
)
@click.option(
    "--kind",
    "kinds",
    type=click.Choice([*KINDS, "all"]),
    multiple=True,
    default=("all",),
    help="What is hidden; may be given several times.",
)
@click.option(
    "--only",
    type=click.Choice(list(EFFECTS)),
    multiple=True,
    help="Single effects to hide, instead of all.",
)
@options.seed
@click.option(
    "--json",
    "json_file",
    type=click.Path(dir_okay=False, path_type=str),
    help="Write all trials, one a line.",
)
@click.option(
    "--histories",
    type=click.Path(file_okay=False, path_type=Path),
    default=None,
    help="Folder of the traced histories; default: in the user's cache.",
)
@click.option(
    "--photons",
    type=options.Whole(100, 10**9),
    default=PHOTONS,
    show_default=True,
    help="Traced per configuration and scattering coefficient, fewer for a quick look.",
)
@click.option(
    "--campaigns",
    type=click.Path(file_okay=False, path_type=Path),
    default=None,
    help="Folder to keep the campaigns in, to look at one by hand.",
)
@executor_options
def main(number, kinds, only, seed, json_file, histories, photons, campaigns, executor, log) -> int:
    """Hide effects in campaigns, let the package diagnose and repair them, and count.

    Exit status 1 if a rate is not as wanted.
    """
    refuse_outputs({"--json": json_file})
    if histories is None:
        histories = platformdirs.user_cache_path("mcrim_mitsuba", appauthor=False) / "histories"
    kinds = KINDS if "all" in kinds else tuple(dict.fromkeys(kinds))
    wanted = [Trial(kind, n) for kind in kinds for n in range(number or TRIALS[kind])]
    parameters = {"seed": seed, "only": list(only), "photons": photons, "tables": TABLES}
    here = Path(__file__).parent
    code = [*here.glob("hidden*.py"), here / "truth.py"]
    trials = Trials("hidden_effects", parameters, wanted, code, executor)
    screen = terminal.console(json_file)
    failures = []
    if trials.missing:
        maker = (histories, photons, seed, only)
        if campaigns is not None:
            make_folder(campaigns)
        screen.line("  ".join(f"{name:<{width}}" for name, width in _COLUMNS))
        with terminal.photon_progress(log=log) as report:
            cases = trial_maker(*maker).cases(kinds)
            HistoryStore(histories, photons).produce(cases, report, executor)
            # the first one has all threads, and fills the cache for the others
            first, others = trials.missing[:1], trials.missing[1:]
            for those, threads in ((first, None), (others, 1)):
                arguments = {
                    trial: (maker, trial.kind, trial.number, campaigns, threads) for trial in those
                }
                failures += trials.do(
                    draw_and_run, arguments, report, lambda _, line: screen.line(_as_line(line))
                )
    ended = unfinished(screen, "hidden", failures, trials, lacking=bool(trials.elsewhere))
    if ended is not None:
        return ended
    found = [trials.results[trial] for trial in wanted if trial in trials.results]
    if not found:
        raise InputError("no trial came to an end", "see the reasons above")
    screen.line(as_markdown(found, _ORDER))
    excess = [trial["expected_excess"] for trial in found]
    seconds = sorted(trial["seconds"] for trial in found)
    screen.line(
        f"expected excess {min(excess):.0f} to {max(excess):.0f}; diagnosis and repair took "
        f"{seconds[len(seconds) // 2]:.1f} s in the median trial, {seconds[-1]:.0f} s at most"
    )
    if json_file is not None:
        write_text(json_file, "".join(json.dumps(line) + "\n" for line in found))
    spread = {
        kind: [t["averaged"]["relative_sigma"] for t in found if t["kind"] == kind]
        for kind in kinds
    }
    screen.line(
        "averaged light yield, median error: "
        + ", ".join(
            f"{kind} {100 * statistics.median(own):.2g} %" for kind, own in spread.items() if own
        )
    )
    good = not failures and all(rate.met is not False for rate in rates(found))
    return terminal.DONE if good else terminal.OUR_FAULT
