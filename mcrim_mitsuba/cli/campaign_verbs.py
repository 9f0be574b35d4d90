"""Verbs on campaigns, in the order of their use: ``reduce`` to ``budget``, and ``app``."""

from __future__ import annotations

import sys
import webbrowser
from pathlib import Path

import click
from rich.console import Group

import mcrim_mitsuba as mcrim
from mcrim_mitsuba.cli import options, showing, terminal
from mcrim_mitsuba.cli.options import option
from mcrim_mitsuba.cli.terminal import console
from mcrim_mitsuba.core.files import refuse_to_replace
from mcrim_mitsuba.output.description import rich_tables


@click.command(short_help="Reduce a campaign's raw data, every step with its errors.")
@options.campaign
@options.output("NEW.toml", "The campaign in plain numbers, its readings beside it (NEW.csv).")
@options.figure(
    "the histograms with their peaks (and NAME_calibration, from channels to photoelectrons, "
    "NAME_spectra, the detector's efficiency, and NAME_transmittance, the absorption)"
)
@options.json_output
def reduce(campaign, path, figure, json_file) -> None:
    """Reduce the raw data of CAMPAIGN (TOML), every step with its errors.

    Histograms become readings (photons per event, of a digitiser's channels by [calibration];
    repeated mountings their mean), emission and quantum efficiency the detector's efficiency,
    transmittance the absorption (1/cm), the source's gammas the depth of the source (mm). All
    commands do this by themselves; here it is shown.
    """
    from mcrim_mitsuba.campaign.editor import plain_texts, readings_beside

    written, pictures = {}, ("calibration", "spectra", "transmittance")
    if path is not None:
        beside = readings_beside(Path(path))
        written = {"--output": (path, (".toml",))}
        written["the readings of --output"] = (str(beside), (".csv",))
    read = showing.read_campaign(campaign, json_file, figure, *pictures, written=written)
    if path is not None and read.raw is not None:
        texts = plain_texts(read, Path(path), beside)
        refuse_to_replace(dict(zip((Path(path), beside), texts, strict=True)))
    screen = showing.answer(mcrim.reduce(read, path), json_file, figure)
    if path is not None:
        screen.line(f"{path} and {beside} were written", style="bold")
    screen.line(f"Next: {showing.command('calibrate', path or campaign)}", style="bold")


@click.command(short_help="Fit a campaign: scattering coefficient and light yield.")
@options.campaign
@options.figure(
    "readings with their pulls (and NAME_profiles, the profile likelihoods, and "
    "NAME_budget, the error budget)"
)
@options.photons(options.PHOTONS, at_most=True, further=options.FURTHER_PHOTONS)
@options.precision
@options.work
def calibrate(campaign, figure, json_file, work) -> None:
    """Fit CAMPAIGN (TOML): scattering coefficient (1/cm), light yield (photons per keV).

    --precision is that of the light collection efficiency of every configuration, where the fit
    ends.
    """
    read = showing.read_campaign(campaign, json_file, figure, "profiles", "budget")
    with work.begin() as run:
        fit = mcrim.calibrate(read, run=run)
    from mcrim_mitsuba.output.sentences import fails

    screen = showing.answer(fit, json_file, figure)
    budget = f"{showing.command('budget', campaign)} for where the errors come from"
    next_step = f"{showing.command('diagnose', campaign)} for what could be missing, or {budget}"
    if fails(fit):
        next_step = f"{showing.command('compare', campaign)} for where the model fails"
    screen.line(f"Next: {next_step}", style="bold")


@click.command(short_help="Show where a campaign's model fails.")
@options.campaigns
@options.figure("readings, predictions and pulls")
@options.effect_photons
@options.work
def compare(campaigns, figure, json_file, work) -> None:
    """Show where the model of CAMPAIGN (TOML) fails to describe its readings.

    Pulls are (reading - prediction) in standard errors; those from the others compare with a
    fit to all other readings. Suspect readings are named before physics is blamed.

    With two or three campaigns of the same readings: which of these hypotheses the readings
    prefer, side by side, and at which readings they differ most. Scenes, effects and priors may
    differ.
    """
    read = [showing.read_campaign(path, json_file, figure) for path in campaigns]
    with work.begin() as run:
        compared = mcrim.compare(*read, run=run)
    screen = showing.answer(compared, json_file, figure)
    one_alone = (campaigns[0], read[0].measurements.path, compared)
    next_step = _after_comparison(*one_alone) if len(read) == 1 else _after_hypotheses(compared)
    screen.line(f"Next: {next_step}", style="bold")


def _after_hypotheses(compared) -> str:
    """What to do next, by the verdict on the hypotheses."""
    from mcrim_mitsuba.inference.judgement import AMBIGUOUS, UNEXPLAINED
    from mcrim_mitsuba.output.sentences import most_apart

    best = compared.named[compared.leading[0]].campaign
    if compared.verdict == UNEXPLAINED:
        return f"{showing.command('diagnose', best)} for what else could be missing"
    if compared.verdict == AMBIGUOUS:
        where = f"measure {most_apart(compared)[0]} again, with a smaller error"
        return f"{where}; or {showing.command('diagnose', best)} for what else would tell"
    return f"{showing.command('calibrate', best)} for the light yield"


def _after_comparison(campaign: str, measurements: Path, comparison) -> str:
    """What to do next, by what is suspected."""
    from mcrim_mitsuba.output.sentences import fails, together

    diagnose = showing.command("diagnose", campaign)
    explained = [suspect for suspect in comparison.suspects if suspect.explains]
    if explained:
        swapped = explained[0].kind.startswith("swapped")
        mend = "swap them back" if swapped else "repeat it, or leave it out with use = 0"
        again = f"then {showing.command('compare', campaign)} again; or {diagnose}"
        return f"check {together(explained[0].labels)} in {measurements} ({mend}), {again}"
    if comparison.p_value is None or fails(comparison):
        return diagnose
    calibrate = f"{showing.command('calibrate', campaign)} for the light yield"
    return f"{calibrate}, or {diagnose} for limits on what could be missing"


@click.command(short_help="Rank effects as explanations of a campaign's misfit.")
@options.campaign
@options.effects("--without", "Leave these out.")
@options.effects("--only", "Try these alone.")
@options.option(
    "--sure", options.Number("P", 0.5, 1.0), "Probability from which it is named.", default=0.9
)
@options.figure(
    "the ranking of the effects (and the light yield's error after further readings, NAME_next)"
)
@options.effect_photons
@options.work
def diagnose(campaign, figure, json_file, work, without, only, sure) -> None:
    """Rank the catalogue's effects as explanations of a misfit of CAMPAIGN (TOML).

    The campaign is fitted with each effect added in turn; all sets of up to three are weighed.
    """
    from mcrim_mitsuba.inference.diagnose import PARTS

    read = showing.read_campaign(campaign, json_file, figure)
    with work.begin(parts=PARTS) as run:
        diagnosis = mcrim.diagnose(read, without=without, only=only, sure=sure, run=run)
    screen = showing.answer(diagnosis, json_file, figure)
    screen.line(f"Next: {_after_diagnosis(campaign, diagnosis)}", style="bold")


def _after_diagnosis(campaign: str, diagnosis) -> str:
    """What to do next, by the verdict and by what is proposed."""
    from mcrim_mitsuba.inference.judgement import ADEQUATE, AMBIGUOUS, MISSING_EFFECT

    path = Path(campaign)
    chosen = ["--effect", ",".join(diagnosis.set_aside)] if diagnosis.set_aside else []
    target = path.with_name(f"{path.stem}_mended.toml")
    repair = showing.command("repair", campaign, *chosen, "-o", target)
    if diagnosis.verdict == MISSING_EFFECT:
        return f"look for it on the bench; then {repair}" if chosen else repair
    if diagnosis.verdict == ADEQUATE:
        return showing.command("calibrate", campaign)
    if diagnosis.verdict == AMBIGUOUS and diagnosis.next_measurements:
        if not any(proposal.separates for proposal in diagnosis.next_measurements):
            return (
                "nothing that was looked at tells the leading effects apart: look at "
                f"the bench itself, or allow others in [next_measurements]; or {repair}"
            )
        return f"{_first_proposed(diagnosis)}; or {repair}"
    if diagnosis.suspect_readings:
        return f"check the readings named above, then {showing.command('diagnose', campaign)}"
    if diagnosis.next_measurements:
        return _first_proposed(diagnosis)
    if diagnosis.verdict == AMBIGUOUS:
        return f"measure more configurations and diagnose again; or {repair}"
    compare = showing.command("compare", campaign)
    return f"measure more configurations; {compare} shows the pattern of the misfit"


def _first_proposed(diagnosis) -> str:
    """What is proposed first, and what becomes of it."""
    first = diagnosis.next_measurements[0]
    if first.is_of_readings:
        return f"measure {first.words}, add it to the readings and diagnose again"
    return f"{first.words}, and diagnose again with what it says"


@click.command(short_help="Add effects to a campaign while the data justify it.")
@options.campaign
@options.output(
    "NEW.toml",
    "The mended campaign; its scene is written beside it, as NEW.xml. Never replaces a file.",
    required=True,
)
@options.effects(
    "--effect", "Add these, whatever the verdict (default: what it names, if of usual size)."
)
@options.figure("how the error falls (and readings and pulls before and after, NAME_readings)")
@options.effect_photons
@options.work
def repair(campaign, path, figure, json_file, work, effect) -> None:
    """Add effects to CAMPAIGN (TOML) one by one while the data justify it.

    Writes a campaign and a scene with the effects in them, to go on from.
    """
    from mcrim_mitsuba.inference.diagnose import PARTS
    from mcrim_mitsuba.inference.repair import refuse_others_work
    from mcrim_mitsuba.output import describe_campaign

    scene = Path(path).parent / f"{Path(path).stem}.xml"
    written = {"--output": (path, (".toml",)), "the scene of --output": (str(scene), (".xml",))}
    read = showing.read_campaign(campaign, json_file, figure, "readings", written=written)
    refuse_others_work(Path(path))
    screen = terminal.console(json_file)
    # a table that grows in a terminal, lines elsewhere
    live = sys.stdout.isatty() and sys.stderr.isatty() and not screen.quiet
    steps: list = []
    growing = Group()

    def show(step) -> None:
        steps.append(step)
        growing.renderables[:] = rich_tables(describe_campaign.steps_table(steps), screen.room)
        if not live:
            screen.line(describe_campaign.step_text(step))

    with work.begin(growing if live else None, PARTS) as run:
        repaired = mcrim.repair(read, path, effect=effect, on_step=show, run=run)
    description = describe_campaign.of_repair(repaired, with_steps=live)
    showing.answer(repaired, json_file, figure, description)
    diagnose_again = f"{showing.command('diagnose', campaign)} says more"
    next_step = diagnose_again if repaired.undetermined else _after_diagnosis(campaign, repaired)
    next_step = f"Next: {next_step}"
    if repaired.campaign_path is not None:
        calibrate = showing.command("calibrate", repaired.campaign_path)
        both = f"{repaired.campaign_path} and {repaired.scene_path}"
        next_step = f"{both} were written. Next: {calibrate}"
    screen.line(next_step, style="bold")


@click.command(short_help="Diagnose and mend a campaign, and write it all as a page.")
@options.campaign
@options.output("REPORT.html", "The page; replaces only another HTML file.", required=True)
@options.effect_photons
@options.work
def report(campaign, path, json_file, work) -> None:
    """Diagnose and mend CAMPAIGN (TOML), and write all that was found as one HTML file.

    It needs no network and opens in any browser; print it to have it as PDF.
    """
    from mcrim_mitsuba.inference.diagnose import PARTS
    from mcrim_mitsuba.output.report import SUFFIXES, refuse_output

    read = showing.read_campaign(campaign, json_file, written={"--output": (path, SUFFIXES)})
    refuse_output(path, read.files)
    with work.begin(parts=(*PARTS, ("report", 40))) as run:
        page = mcrim.report(read, path, run=run)
    screen = showing.answer(page, json_file)
    screen.line(f"{page.path} was written: open it in a browser", style="bold")


@click.command(short_help="Show where a campaign's errors come from.")
@options.campaign
@option(
    "--material",
    "NAME",
    "What the crystal is made of, such as CaMoO4 (default: what the campaign says): "
    "its indices, and how it stops gammas, are then known.",
)
@options.file("--emission", "Emission spectrum (default: the campaign's, else a Gaussian band).")
@option(
    "--wavelength-nm",
    options.Number("NM", 200, 2000),
    "Maximum of that Gaussian band (default: the material's).",
)
@options.file(
    "--map",
    "Map of eta by `mcrim simulate --map`, of a reading's bench: say what it does to eta and the "
    "light yield where gammas stop.",
    "map_file",
    metavar="FILE.nc",
)
@options.depth(1e-6, " (default: the material's, else 1).")
@options.deposits
@options.figure("the budget, with what the model leaves out")
@options.photons(
    "5e5 of each simulation with another index, fewer for many configurations",
    further=options.FURTHER_PHOTONS,
)
@options.work
def budget(campaign, figure, json_file, work, map_file, **crystal) -> None:
    """Show where the errors of CAMPAIGN (TOML) come from, and which can be reduced.

    The fit is repeated with every piece of physics that the model leaves out: where the source's
    gammas stop, polarisation, the index of the material, its spread over the emission band, and
    birefringence. What the model can take is a correction, to be made; what one index cannot
    describe is added to the errors.
    """
    inputs = [file for file in (crystal["emission"], map_file, crystal["deposits"]) if file]
    options.refuse_without_map()
    read = showing.read_campaign(campaign, json_file, figure, inputs=inputs)
    with work.begin() as run:
        errors = mcrim.budget(read, run=run, eta_map=map_file, **crystal)
    showing.answer(errors, json_file, figure)


#: How long the job that is under way may take to notice that the page is closed.
_PATIENCE_SECONDS = 5.0


@click.command(short_help="Open a campaign in the browser, with sliders and switches.")
@options.campaign
@option(
    "--port",
    options.Whole(1, 65535),
    "Where the page is (default: one that is free).",
    metavar="NUMBER",
)
@click.option("--no-browser", is_flag=True, help="Only print the page's address.")
@options.effect_photons
@options.run
def app(campaign, port, no_browser, run) -> None:
    """Open CAMPAIGN (TOML) as a page in the browser, with sliders and switches.

    Every change redraws predictions, pulls, chi2 and the light yield. The page is reached from
    this machine alone, by the address that is printed; Ctrl-C ends it.
    """
    from mcrim_mitsuba.app.access import new_key, serve
    from mcrim_mitsuba.app.exchange import page_folder
    from mcrim_mitsuba.app.page import make_page
    from mcrim_mitsuba.app.session import Session

    read, key, screen = showing.read_campaign(campaign, None), new_key(), console()

    def ready(address: str) -> None:
        screen.line(f"the page is at {address}")
        screen.line("Ctrl-C ends it")
        if not no_browser:
            # other users see the arguments of a browser, but not what is in this file
            door = folder / "open.html"
            door.touch(0o600)
            door.write_text(f'<meta http-equiv="refresh" content="0;url={address}">')
            webbrowser.open(door.as_uri())

    with page_folder() as folder:
        session = Session(read, run, folder)
        try:
            serve(make_page(session, f"/{key}/"), port=port, key=key, on_ready=ready)
        finally:
            session.jobs.close(_PATIENCE_SECONDS)
