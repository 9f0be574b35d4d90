"""The page's session without a browser: what its fits use, and what it keeps."""

import base64
import io
import json
import threading
import time
import zipfile
from contextlib import contextmanager
from dataclasses import replace
from functools import partial

import pytest
from places import cases_of

from mcrim_mitsuba.app import access, exchange, layout
from mcrim_mitsuba.app.jobs import Jobs, PageJob
from mcrim_mitsuba.app.page import make_page
from mcrim_mitsuba.app.session import Session
from mcrim_mitsuba.app.state import HELD, PRIOR, History, Known, Settings, State
from mcrim_mitsuba.campaign.campaign import read_campaign
from mcrim_mitsuba.core.errors import InputError
from mcrim_mitsuba.core.run import Run

cases = cases_of(__file__)

PHOTONS = 16384
LONGEST_S = 300


@contextmanager
def opened(campaign, folder):
    """A session whose bench is simulated."""
    session = Session(read_campaign(campaign), Run(photons=PHOTONS), folder)
    try:
        wait(session)
        yield session
    finally:
        session.jobs.close(60)


def wait(session):
    """Until all that was asked for is done."""
    end = time.monotonic() + LONGEST_S
    while session.jobs.status.job or session.jobs.status.waiting or not session.state.steps:
        assert time.monotonic() < end
        assert not session.jobs.status.failures, session.jobs.status.failures
        time.sleep(0.01)
    assert not session.jobs.status.failures, session.jobs.status.failures


def downloaded(session, folder):
    """The campaign's file of those that the page offers, unpacked."""
    session.offer("campaign", session.state.settings)
    wait(session)
    with zipfile.ZipFile(io.BytesIO(session.state.file[1])) as packed:
        packed.extractall(folder)
    [written] = folder.rglob("*.toml")
    return written


def fitted(session, **changes):
    """The calibration of a fit at changed settings."""
    settings = replace(session.state.settings, **changes)
    session.fit(session.history.remember(settings, session.history.settings_number))
    wait(session)
    return session.state.steps[-1].calibration


@pytest.fixture
def files(scenes, tmp_path, shared_cache, monkeypatch):
    """A folder with the misfit's campaign, and its text."""
    monkeypatch.setenv("MCRIM_CACHE", str(shared_cache))
    text = (scenes / "camoo4_misfit.toml").read_text()
    text = text.replace('"camoo4.xml"', f"'{scenes / 'camoo4.xml'}'")
    (tmp_path / "camoo4_misfit.csv").write_text((scenes / "camoo4_misfit.csv").read_text())
    (tmp_path / "bench.toml").write_text(text)
    return tmp_path, text


def test_jobs_come_one_after_the_other_and_are_taken_back():
    begun, undone, changed = [], [], []
    jobs = Jobs(lambda: changed.append(1))

    def work(name):
        begun.append(name)
        while name == "slow":
            jobs.report("halfway", 1, 2)
            time.sleep(0.001)

    for name in ("slow", "other", "last", "last"):  # one that waits is not asked for twice
        undo = partial(undone.append, name)
        jobs.start(PageJob(name, name, partial(work, name), undo=undo))
    while "halfway" not in jobs.status.stage:
        time.sleep(0.001)
    assert [job.key for job in jobs.status.waiting] == ["other", "last"]
    assert jobs.status.words == "slow: halfway, 47 %"  # more parts may come
    jobs.stop("other")
    jobs.stop()
    while jobs.status.job or jobs.status.waiting:
        time.sleep(0.001)
    assert (begun, undone) == (["slow", "last"], ["other", "slow"])
    # said until the user begins something else
    assert jobs.status.stopped == "slow: stopped; what was simulated is kept"
    assert jobs.status.failures == ()  # it is no error
    jobs.start(PageJob("last", "last", lambda: None))
    assert jobs.status.stopped == "" and len(changed) >= 6
    jobs.close(5)


def test_what_a_fit_takes_as_known_of_a_size_counts_in_what_is_shown(scenes, tmp_path, files):
    """Three numbers leave the depth of the source open; what is plausible is its prior then."""
    folder, _ = files
    text = (scenes / "camoo4_three.toml").read_text().replace("camoo4", f"{scenes}/camoo4")
    # without a material nothing says where the gammas stop
    (folder / "open.toml").write_text(text.replace('material = "CaMoO4"', ""))
    with opened(folder / "open.toml", tmp_path) as session:
        found = fitted(session, effects=("source_depth",))
        assert any("the readings leave sizes open" in note for note in found.notes)
        shown = session.model.show(session.state.settings)
        assert shown.chi2 == pytest.approx(found.chi2, rel=1e-4) and shown.ndf == found.ndf


def test_readings_are_edited_in_the_table(files):
    folder, text = files
    with opened(folder / "bench.toml", folder) as session:
        place = 15  # gel hole 4, which the bench explains worst
        before = session.model.live
        session.edit(exchange.with_cell, place, "use", "0")
        session.edit(exchange.with_cell, 0, "signal", "13.5")
        assert session.jobs.status.job is None and session.model.live is before
        found = fitted(session)
        assert session.state.steps[-1].words == "air 13.5 ± 0.0924, without gel hole 4"
        for column, cell, said in (
            ("sigma", "-1", "^sigma = -1 is not above 0; give"),
            ("signal", "0", "^signal = 0, but a light signal is above 0"),
            ("n_gap", "0.5", "^n_gap = 0.5: this is no refractive index; give a number from 1"),
            ("n_gap", "treacle", "^n_gap = 'treacle' is not a finite number"),
            ("label", "water", "^the label water is on line .* already"),
        ):
            with pytest.raises(InputError, match=said):
                session.edit(exchange.with_cell, 0, column, cell)
        shown = session.model.show(session.state.settings)
        assert shown.chi2 == pytest.approx(found.chi2, rel=1e-5)
    # the same file, written by hand, says the same
    rows = (folder / "camoo4_misfit.csv").read_text().replace("air,12.963", "air,13.5")
    lines = [line for line in rows.splitlines() if not line.startswith("gel hole 4")]
    (folder / "edited.csv").write_text("\n".join(lines) + "\n")
    (folder / "edited.toml").write_text(text.replace("camoo4_misfit.csv", "edited.csv"))
    with opened(folder / "edited.toml", folder) as other:
        same = fitted(other)
        assert (same.chi2, same.ndf) == (pytest.approx(found.chi2, rel=1e-5), found.ndf)


def test_files_that_change_beside_an_open_page_change_nothing_in_it(files, scenes):
    folder, text = files
    table = (folder / "camoo4_misfit.csv").read_text()
    (folder / "bench.xml").write_text((scenes / "camoo4.xml").read_text())
    text = text.replace(str(scenes / "camoo4.xml"), "bench.xml")
    (folder / "bench.toml").write_text(text)
    with opened(folder / "bench.toml", folder) as session:
        (folder / "camoo4_misfit.csv").write_text(table.replace("air,12.963", "air,99.963"))
        (folder / "bench.toml").write_text(text.replace("energy_keV = 59.5", "energy_keV = 662"))
        packed = read_campaign(downloaded(session, folder / "got"))
        assert packed.measurements.readings[0].signal == 12.963
        assert packed.light_yield.energy_keV == 59.5
        session.edit(exchange.with_cell, 0, "label", "dry")
        assert session.state.campaign.light_yield.energy_keV == 59.5
        # what was simulated is of the bench as it was
        scene = (folder / "bench.xml").read_text()
        (folder / "bench.xml").write_text(scene.replace("1.52", "1.6"))
        with pytest.raises(InputError, match=r"^bench\.xml, .* changed since the page was opened"):
            session.edit(exchange.with_cell, 0, "label", "air")
        with pytest.raises(InputError, match=r"^bench\.xml, .* changed since the page was opened"):
            exchange.campaign_archive(session.state.campaign, (), {})
        (folder / "bench.xml").write_text(scene + "\n")
        session.edit(exchange.with_cell, 0, "label", "air")


def test_a_mesh_goes_with_the_campaign(scenes, tmp_path):
    box = "v -9 -9 -5\nv 9 -9 -5\nv 9 9 -5\nv -9 9 -5\nf 1 2 3\nf 1 3 4\n"
    (tmp_path / "here" / "parts").mkdir(parents=True)
    (tmp_path / "here" / "parts" / "plate.obj").write_text(box)
    plate = '<shape type="obj"><string name="filename" value="parts/plate.obj"/></shape></scene>'
    for name in ("camoo4.xml", "camoo4_campaign.toml", "camoo4_measured.csv"):
        text = (scenes / name).read_text().replace("</scene>", plate)
        (tmp_path / "here" / name).write_text(text)
    campaign = read_campaign(tmp_path / "here" / "camoo4_campaign.toml")
    _, content = exchange.campaign_archive(campaign, (), {})
    with zipfile.ZipFile(io.BytesIO(content)) as packed:
        packed.extractall(tmp_path / "there")
    [mesh] = (tmp_path / "there").rglob("plate.obj")
    assert mesh.read_text() == box and mesh.parent.name == "parts"


def test_the_kind_of_a_reading_is_chosen_in_the_table(files, scenes):
    folder, _ = files
    text = (scenes / "camoo4_three.toml").read_text()
    text = text.replace('"camoo4.xml"', f"'{scenes / 'camoo4.xml'}'").split("[beam]")
    text = text[0] + "[parameters" + text[1].partition("[parameters")[2]
    text += "\n[tolerances]\nnone = true\n"  # numbers of the bench would take most of the time
    (folder / "three.toml").write_text(text)
    table = (scenes / "camoo4_three.csv").read_text()
    table = table.replace("signal,sigma,n_gap", "signal,sigma,n_gap,beam_axis")
    table = table.replace("1.00\n", "1.00,\n").replace("1.46\n", "1.46,\n")
    (folder / "camoo4_three.csv").write_text(table.replace("0.012,", "0.012,,z"))
    with opened(folder / "three.toml", folder) as session:

        def cells(place):
            reading = layout.state(session, -1)["readings"][place]
            return [reading[name] for name in ("kind", "n_gap", "beam_axis")]

        assert '<select data-column="kind"' in layout.page(session)
        assert [cells(0), cells(2)] == [["light", 1.0, ""], ["transmittance", "", "z"]]
        for kind, said in (
            ("transmittance", "^signal = 14.3 of a transmittance; give the fraction"),
            ("dark", "^kind = 'dark' is neither light nor transmittance; write one"),
        ):
            with pytest.raises(InputError, match=said):
                session.edit(exchange.with_cell, 0, "kind", kind)
        with session.history.lock:
            session.edit(exchange.with_cell, 2, "kind", "light")
            assert cells(2) == ["light", 1.0, ""]
            assert '<select data-column="kind"' in layout.page(session)  # the way back
            session.edit(exchange.with_cell, 2, "kind", "transmittance")
            assert cells(2) == ["transmittance", "", "x"]
            session.edit(exchange.with_cell, 2, "kind", "light")
        wait(session)
        found = fitted(session)
        assert session.state.steps[-1].words == "transmittance as light"
        assert [row.of_beam for row in found.rows] == [False] * 3


def test_samples_are_fitted_and_shown_side_by_side(files, scenes):
    folder, _ = files
    with opened(scenes / "camoo4_cawo4.toml", folder) as session:
        asked, found = session.state.settings, session.state.steps[0].calibration
        titles = [control.title for control in session.model.live.controls.parameters]
        assert titles == [
            "scattering",
            "absorption",
            "scattering of cawo4",
            "absorption of cawo4",
            "scale of cawo4",
            "scale",
        ]
        assert asked.known == {} and session.model.live.controls.parameters[2].known.how == HELD
        shown = session.model.show(asked)
        assert (shown.chi2, shown.ndf) == (pytest.approx(found.chi2, rel=1e-4), found.ndf)
        light = found.parameters["light_yield_ph_per_keV"]
        assert shown.light_yield == pytest.approx(light.value, rel=1e-4)
        # the scale that follows is that of the campaign's own readings
        moved = replace(asked, values={**asked.values, "alpha_scat_per_cm": 0.3})
        best = session.model.show(moved)
        # they share the bench's numbers, and how far off these are
        assert best.rows[2].model == pytest.approx(shown.rows[2].model, rel=2e-3)
        assert best.rows[0].model != shown.rows[0].model
        for part in (0.999, 1.001):
            values = {**moved.values, "scale": part * best.scale}
            shown = session.model.show(replace(moved, values=values, fit_scale=False))
            assert shown.chi2 > best.chi2
        assert layout.state(session, -1)["readings"][2]["sample"] == "cawo4"
        assert "<dt>sample</dt><dd>cawo4</dd>" in layout.reading(session, 2)
        assert '<select data-column="sample"' in layout.page(session)
        panel = layout.state(session, -1)["parts"]["fitted"]
        assert "absorption of cawo4 (1/cm) <small>alpha_abs_cawo4_per_cm</small>" in panel

        known = {"alpha_abs_cawo4_per_cm": Known(HELD), "scale_cawo4": Known(PRIOR, 230.0, 5.0)}
        held = fitted(session, known=known)
        assert session.state.steps[-1].words == (
            "absorption of cawo4 held at 0.05736, scale of cawo4 known to be 230.0 ± 5.0"
        )
        written = downloaded(session, folder / "got")
    with opened(written, folder) as other:  # each in its sample's table
        same = other.state.steps[0].calibration
        assert (same.chi2, same.ndf) == (pytest.approx(held.chi2, rel=1e-3), held.ndf)
        assert same.fixed.keys() == held.fixed.keys()


def test_other_configurations_are_simulated(files):
    folder, text = files
    lines = (folder / "camoo4_misfit.csv").read_text().splitlines()
    rows = [lines[place] for place in (2, 3, 5, 17, 18)]
    (folder / "four.csv").write_text("\n".join(rows) + "\n")
    (folder / "bench.toml").write_text(text.replace("camoo4_misfit.csv", "four.csv"))
    with opened(folder / "bench.toml", folder) as session:
        asked, first = session.state.settings, session.model.live
        with session.history.lock:  # nothing is shown of readings that are not simulated yet
            session.edit(exchange.with_cell, 3, "aperture_radius_mm", "3")
            assert session.model.show(asked) is None
            # nor is the former waited for
            session.edit(exchange.with_cell, 3, "aperture_radius_mm", "5.5")
        wait(session)
        # one more for the mask's radius, which may be wrong as others may
        assert session.model.live is not first and session.history.bench_number == 2
        eta = session.model.show(asked).rows[3].eta
        session.edit(exchange.with_copy, 3)
        wait(session)
        shown = session.model.show(asked)
        assert [row.label for row in shown.rows[2:]] == [
            "air hole 4",
            "gel hole 4",
            "gel hole 4 (2)",
        ]
        assert [one.eta for one in shown.rows[3:5]] == pytest.approx([eta] * 2, rel=1e-12)
        assert not shown.rows[4].use
        session.edit(exchange.without_row, 0)
        wait(session)
        found = fitted(session)
        assert session.state.steps[-1].words == "without air, gel hole 4 at mask radius 5.5 mm"
        assert [row.label for row in found.rows][-1] == "gel hole 4 (2)"
        session.compare_with(session.state.steps[0].number)
        assert "Pulls of both" in layout.state(session, -1)["parts"]["fitted"]
        session.offer("session", session.state.settings)
        wait(session)
        file = session.state.file

        # what is not to be simulated is not in the table
        going_on = threading.Event()
        session.jobs.start(PageJob("other", "other", going_on.wait))
        session.edit(exchange.with_cell, 0, "gap_mm", "0.0731")  # of water now
        assert session.state.campaign.measurements.readings[0].parameters["gap_mm"] == 0.0731
        session.jobs.stop("readings")
        assert session.state.campaign.measurements.readings[0].parameters["gap_mm"] == 0.05
        going_on.set()
        for _ in range(5):  # fitted, removed, added, edited twice
            session.undo()
        wait(session)
        assert not session.history.can_undo and len(session.model.show(asked).rows) == 4
        with pytest.raises(InputError, match="not there any more"):
            session.edit(exchange.without_row, 4)

        session.take_session(*file)
        wait(session)
        again = session.state.steps[-1]
        assert again.words == "without air, gel hole 4 at mask radius 5.5 mm"
        assert again.calibration.chi2 == pytest.approx(found.chi2, rel=1e-4)
        assert len(session.model.show(session.state.settings).rows) == 4


def test_parameters_are_held_or_known(files):
    folder, _ = files
    with opened(folder / "bench.toml", folder) as session:
        values = {**session.state.settings.values, "alpha_abs_per_cm": 0.05}
        known = {"alpha_abs_per_cm": Known(HELD), "alpha_scat_per_cm": Known(PRIOR, 0.4, 0.01)}
        found = fitted(session, values=values, known=known)
        assert found.fixed == {"alpha_abs_per_cm": 0.05}
        shown = session.model.show(session.state.settings)
        assert (shown.chi2, shown.ndf) == (pytest.approx(found.chi2, rel=1e-5), found.ndf)
        assert session.state.steps[-1].words == (
            "scattering known to be 0.4 ± 0.01, absorption held at 0.05"
        )
        written = downloaded(session, folder / "got")
    assert written.name == "bench_as_shown.toml"  # no effect was added: nothing is mended
    given = read_campaign(written).parameters
    assert given["alpha_abs_per_cm"].fixed and given["alpha_abs_per_cm"].start == 0.05
    assert (given["alpha_scat_per_cm"].prior, given["alpha_scat_per_cm"].prior_sigma) == (0.4, 0.01)
    with opened(written, folder) as other:
        same = other.state.steps[0].calibration
        assert (same.chi2, same.ndf) == (pytest.approx(found.chi2, rel=1e-4), found.ndf)


def test_a_size_that_is_held_is_simulated_where_it_is_held(files):
    folder, _ = files
    with opened(folder / "bench.toml", folder) as session:
        settings = session.state.settings
        values = {**settings.values, "bubble_fraction": 0.4}
        found = fitted(
            session,
            effects=("gap_bubble", "surface_absorption"),
            values=values,
            known={"bubble_fraction": Known(HELD)},
        )
        assert found.fixed == {"bubble_fraction": 0.4} and "surface_loss" in found.names
        [anchor] = session.state.anchors.values()
        assert anchor.values["bubble_fraction"] == 0.4
        settings = session.state.settings
        shown = session.model.show(settings)
        assert (shown.chi2, shown.ndf) == (pytest.approx(found.chi2, rel=1e-5), found.ndf)
        moved = replace(settings, values={**settings.values, "bubble_fraction": 0.2})
        assert abs(session.model.show(moved).chi2 - shown.chi2) > 1  # it can be moved still


def test_fits_are_kept_compared_removed_and_undone(files):
    folder, _ = files
    with opened(folder / "bench.toml", folder) as session:
        first = session.state
        assert 'class="air"' not in layout.reading(session, 4)
        fitted(session, effects=("gap_bubble",))
        assert layout.reading(session, 4).count('class="air"') == 1  # the bubble in the gel
        session.edit(exchange.with_cell, 15, "use", "0")
        fitted(session, effects=())
        names = [layout.step_name(step) for step in session.state.steps]
        assert names == ["as it came", "with air bubble in the gap", "without gel hole 4"]
        one, two, three = (step.number for step in session.state.steps)
        session.compare_with(two)
        step, shown = session.model.shown_beside()
        assert step.number == two and not shown.rows[15].use  # beside the readings as they are now
        panel = layout.state(session, -1)["parts"]["fitted"]
        assert "Two hypotheses side by side" in panel and " ± " not in panel  # on one line
        for words in (  # those of the command's tables
            "scattering (1/cm) <small>alpha_scat_per_cm</small>",
            "bubble fraction <small>bubble_fraction</small>",
        ):
            assert words in panel
        assert 'title="alpha_scat_per_cm">scattering (1/cm)</label>' in layout.page(session)

        session.show_step(two)  # with the readings that it had
        assert session.state.campaign.measurements.readings[15].use
        assert session.state.settings.effects == ("gap_bubble",)
        session.remove_step(three)
        assert len(session.state.steps) == 2
        with pytest.raises(InputError, match="as it came stays"):
            session.remove_step(one)
        for steps in (3, 3, 2, 2, 1):  # undone: removed, shown, fitted, edited, fitted
            session.undo()
            assert len(session.state.steps) == steps
        assert not session.history.can_undo and session.state.campaign is first.campaign
        assert session.state.settings.effects == ("gap_bubble",)  # it was switched on before
        for steps in (2, 2, 3, 3, 2):
            session.undo(again=True)
            assert len(session.state.steps) == steps
        assert not session.history.can_redo


def test_a_diagnosis_stays_with_its_readings_when_things_are_undone():
    def settings(value):
        return Settings(values={"a": value})

    def now():
        state = history.state
        return state.campaign, state.settings.values["a"], state.diagnosis

    history = History(State("first", settings=settings(0)))
    history.remember(settings(1), 0)
    history.change(diagnosis="of first")
    history.keep()
    history.change(campaign="second", diagnosis=None)
    history.bring_back()
    assert now() == ("first", 1, "of first")
    history.bring_back()
    assert now() == ("first", 0, "of first") and not history.can_undo
    history.bring_back(undone=True)
    history.bring_back(undone=True)
    assert now() == ("second", 1, None) and not history.can_redo
    history.bring_back()
    history.remember(settings(2), history.settings_number)
    assert history.can_undo and not history.can_redo  # what is done anew cannot be done again


def test_what_is_slid_typed_and_ticked_is_undone(files):
    folder, _ = files
    with opened(folder / "bench.toml", folder) as session:

        def say(**changes):
            """What a page says of its controls."""
            settings = replace(session.state.settings, **changes)
            session.history.remember(settings, session.history.settings_number)

        def move(**values):
            say(values={**session.state.settings.values, **values})

        def chi2():
            shown = session.model.show(session.state.settings).chi2
            return pytest.approx(shown, rel=1e-5)  # the scale follows from where it was

        fit = session.state.settings
        as_it_came = chi2()
        say(known=session.model.live.controls.known(fit))  # as pages do when they open
        # the scale that follows is moved by the page, not by its user
        move(scale=60.0)
        assert not session.history.can_undo
        for value in (0.3, 0.31, 0.32):
            move(alpha_scat_per_cm=value)
        assert session.model.fit_at(session.state.settings) is None
        texts = layout.predictions(session, session.state.settings)["texts"]
        assert texts["light-yield-words"] == "moved by hand: press Fit"
        assert "moved by hand, does not explain these readings: p = " in texts["answer"]
        move(alpha_abs_per_cm=0.07)
        say(known={**session.state.settings.known, "alpha_abs_per_cm": Known(HELD)})
        session.undo()
        session.undo()
        assert session.state.settings.values["alpha_scat_per_cm"] == 0.32
        session.undo()  # all of a slider's way
        assert session.state.settings.values["alpha_scat_per_cm"] == fit.values["alpha_scat_per_cm"]
        assert not session.history.can_undo and chi2().expected == as_it_came

        # a tick is a fit, and one step back
        say(effects=("gap_bubble",))
        session.switch("gap_bubble")
        wait(session)
        with_it = chi2()
        assert with_it.expected < as_it_came.expected - 15
        step = session.model.fit_at(session.state.settings)
        assert step is session.state.steps[-1]
        texts = layout.predictions(session, session.state.settings)["texts"]
        assert texts["answer"].startswith("The bench with air bubble in the gap explains these")
        assert texts["light-yield"].endswith(" ph/keV") and " ± " in texts["light-yield"]
        say(effects=())
        session.switch("gap_bubble")
        wait(session)
        session.undo()
        assert (session.state.settings.effects, chi2().expected) == (("gap_bubble",), with_it)
        session.undo()
        assert (session.state.settings.effects, chi2().expected) == ((), as_it_came)

        # a fit corrects the model by a joint simulation; that is undone with it
        two = ("gap_bubble", "surface_absorption")
        say(effects=two)
        session.model.make_ready(two)
        before = chi2()
        fitted(session)
        assert len(session.state.anchors) == 1
        session.undo()
        assert (session.state.settings.effects, chi2().expected) == (two, before)


def test_a_session_is_kept_in_a_file(files, scenes):
    folder, _ = files
    with opened(folder / "bench.toml", folder) as session:
        fitted(session, effects=("gap_bubble",))
        session.edit(exchange.with_cell, 15, "use", "0")
        fitted(session, known={"alpha_abs_per_cm": Known(HELD)})
        session.compare_with(session.state.steps[1].number)
        session.offer("session", session.state.settings)
        wait(session)
        name, content = session.state.file
        before = session.state
    assert name == "bench_session.json"
    with opened(folder / "bench.toml", folder) as other:
        number = other.history.bench_number
        other.take_session(name, content)
        wait(other)
        assert other.history.bench_number == number + 1
        again = other.state
        for old, new in zip(before.steps, again.steps, strict=True):
            assert layout.step_name(old) == layout.step_name(new)
            assert new.calibration.chi2 == pytest.approx(old.calibration.chi2, rel=1e-4)
        assert again.beside.settings.effects == ("gap_bubble",)
        assert not again.campaign.measurements.readings[15].use
        assert again.settings.known["alpha_abs_per_cm"].how == HELD

        older = exchange.read_session(
            name, content.replace(b"gap_bubble", b"saturation"), other.state.campaign.scene
        )
        assert older["fits"][1]["settings"]["effects"] == ["nonlinearity"]

        changed = json.loads(content) | {"fits": [{"settings": {}}]}
        number = json.loads(content) | {"measurements": 5}
        documents = [json.dumps(document).encode() for document in (changed, number)]
        for bad in (b"{}", b"PNG", b"[1]", b"[" * 100_000, *documents):
            with pytest.raises(InputError, match=r"mine.json: this is not a session of the page"):
                other.take_session("mine.json", bad)
        strange = json.dumps(json.loads(content) | {"scene_hash": "other"}).encode()
        with pytest.raises(InputError, match=r"the session is of another scene, camoo4\.xml"):
            other.take_session("mine.json", strange)


@pytest.fixture
def post(scenes, tmp_path):
    """Send the page of a session that simulates nothing a body; status and text of the answer."""
    session = Session(read_campaign(scenes / "camoo4_misfit.toml"), Run(), tmp_path)
    session.jobs.close(60)
    page = make_page(session, "/key/")
    page.register_error_handler(Exception, access.in_one_line)
    sent = {"settings": session.state.settings.to_json(), "settings_number": 1}

    def send(address, body, **more):
        text = body if isinstance(body, str) else json.dumps(sent | body | more)
        kind = "application/json"
        answer = page.test_client().post(f"/key/{address}", data=text, content_type=kind)
        return answer.status_code, answer.get_data(as_text=True)

    return send


def no_settings(**changes):
    return {"settings": {"effects": [], "values": {}, "fit_scale": True, "known": {}} | changes}


@pytest.mark.parametrize(
    "body",
    [
        "{}",
        "[]",
        "[[]]",
        "null",
        "5",
        '"do"',
        "",
        "{",
        "[" * 100_000,
        {"settings": []},
        {"settings": {}},
        no_settings(values=[]),
        no_settings(known={"alpha_scat_per_cm": 5}),
        no_settings(effects=5),
        no_settings(effects=[[]]),
    ],
    ids=lambda body: str(body)[:40],
)
def test_bodies_that_no_page_sends_are_bad_requests(post, capsys, body):
    for address in ("do", "predictions"):
        assert post(address, body) == (400, "mcrim app: Bad Request\n")
    assert capsys.readouterr() == ("", "")


@cases("asked", more=[{"what": "drop", "name": "1" * 5000}, {"what": "compare", "name": None}])
def test_what_no_page_asks_for_is_a_bad_request(post, capsys, asked):
    assert post("do", asked) == (400, "mcrim app: Bad Request\n")
    assert capsys.readouterr() == ("", "")


@pytest.mark.parametrize(
    ("name", "content", "slip"),
    [
        ("mine.json", b"[" * 100_000, "mine.json: this is not a session of the page"),
        ("mine.csv", b"[" * 100_000, "mine.csv, line 1"),
        ("mine.csv", None, "the file did not arrive whole"),
    ],
)
def test_uploads_of_rubbish_are_refused_in_a_line(post, capsys, name, content, slip):
    coded = "é" if content is None else base64.b64encode(content).decode()
    status, text = post("do", {"what": "upload", "name": name, "content": f"data:,{coded}"})
    assert status == 200 and json.loads(text)["slip"].startswith(slip)
    assert capsys.readouterr() == ("", "")


def test_a_number_beyond_all_is_left_alone(post):
    assert post("predictions", no_settings(values={"alpha_scat_per_cm": 10**400}))[0] == 200
