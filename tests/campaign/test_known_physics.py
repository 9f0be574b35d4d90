"""What a campaign's material and energy tell is in its model at no odds, and said; no more."""

from dataclasses import replace

import pytest
from places import cases_of
from refusals import refusal

from mcrim_mitsuba.campaign.campaign import read_campaign
from mcrim_mitsuba.campaign.editor import plain_texts
from mcrim_mitsuba.campaign.known_physics import KnownCrystal
from mcrim_mitsuba.core.run import Run
from mcrim_mitsuba.inference.budget import budget
from mcrim_mitsuba.inference.simulations import CampaignSimulations, calibrate
from mcrim_mitsuba.optics.gammas import attenuation_length_mm
from mcrim_mitsuba.output.report_sections import sources_of
from mcrim_mitsuba.scene.scene_file import read_scene

cases = cases_of(__file__)

NAMED = 'energy_keV = 59.5\nmaterial = "CaMoO4"'

# the same bench is asked several times
pytestmark = pytest.mark.usefixtures("kept_records")


@pytest.fixture
def three(scenes):
    return (scenes / "camoo4_three.toml").read_text()


@pytest.fixture
def campaign_of(scenes, tmp_path):
    """The campaign of a text that lies beside the package's scenes."""

    def read(text, table="camoo4_three.csv"):
        text = text.replace("camoo4_three.csv", table)
        for name in ("camoo4.xml", table):
            if not (tmp_path / name).exists():
                (tmp_path / name).write_bytes((scenes / name).read_bytes())
        (tmp_path / "c.toml").write_text(text)
        return read_campaign(tmp_path / "c.toml")

    return read


def test_polarisation_and_depth_are_in_the_scene_and_said(campaign_of, three):
    campaign = campaign_of(three)
    assert set(campaign.known_physics) == {"source_depth", "polarization"}
    depth = attenuation_length_mm("CaMoO4", 59.5).length_mm
    assert depth == pytest.approx(1.03, abs=0.005)
    assert campaign.scene.parameters["source_depth_mm"] == pytest.approx(depth, abs=1e-5)
    assert campaign.scene.parameters["polarization"] is True
    # held: no parameter of the fit, and no prior
    assert campaign.free == ("alpha_scat_per_cm", "alpha_abs_per_cm", "scale")
    note, *of_detector = campaign.notes
    assert note == campaign.physics_note and len(of_detector) == 2
    for words in ("CaMoO4", "source_depth_mm = 1.026", "59.5 keV", "polarisation"):
        assert words in note
    # no hypotheses any more, nor is what they exclude
    bench = CampaignSimulations(campaign, Run(1024))
    assert not {"source_depth", "polarization", "side_source"} & set(bench.possible())
    assert "wrong:n_crystal" in bench.possible() and bench.notes == []
    # a report has the file as it is
    (scene,) = (source for source in sources_of(campaign) if source.role == "scene")
    assert "source_depth_mm" not in scene.text


@pytest.mark.parametrize("name", ["misfit", "spot", "campaign", "cawo4", "table1"])
def test_campaigns_that_name_no_material_stay_as_they_are(scenes, name):
    campaign = read_campaign(scenes / f"camoo4_{name}.toml")
    assert campaign.known_physics == () and campaign.physics_note == ""
    assert campaign.scene.content_hash == read_scene(campaign.scene.path).content_hash


def test_the_articles_convention_has_none_of_it(campaign_of, scenes, three):
    campaign = campaign_of(f'convention = "article"\n{three}')
    assert campaign.known_physics == () and campaign.physics_note == ""
    assert campaign.scene.content_hash == read_scene(campaign.scene.path).content_hash
    # it names a formula and a spectrum
    assert read_campaign(scenes / "camoo4_raw" / "campaign.toml").known_physics == ()


@cases("old", "new", "known", "reason")
def test_what_a_user_says_otherwise_is_left(campaign_of, three, old, new, known, reason):
    campaign = campaign_of(three.replace(old, new, 1))
    assert list(campaign.known_physics) == known
    assert ("source_depth_mm" in campaign.scene.parameters) == ("source_depth" in known)
    # what is not in it for another reason than the user's choice is said
    assert reason in campaign.physics_note and ("but not" in campaign.physics_note) == bool(reason)


def test_what_a_repair_wrote_into_the_scene_is_not_put_in_twice(campaign_of, three, tmp_path):
    campaign = campaign_of(three)
    (tmp_path / "camoo4.xml").write_text(campaign.scene.unwritten_text)
    again = campaign_of(three)
    assert again.known_physics == () and again.physics_note == ""
    assert again.scene.content_hash == campaign.scene.content_hash


def test_a_column_sets_the_polarisation(campaign_of, three, tmp_path, scenes):
    table = (scenes / "camoo4_three.csv").read_text()
    table = table.replace(",n_gap", ",n_gap,polarization").replace("1.00\n", "1.00,false\n")
    table = table.replace("1.46\n", "1.46,true\n").replace("0.012,", "0.012,,")
    (tmp_path / "mine.csv").write_text(table)
    assert campaign_of(three, "mine.csv").known_physics == ("source_depth",)


def test_a_sample_of_another_material_is_not_given_this_ones_depth(campaign_of, scenes):
    text = (scenes / "camoo4_cawo4.toml").read_text().replace('convention = "article"', "")
    text = text.replace("energy_keV = 59.5", NAMED, 1)
    campaign = campaign_of(text, "camoo4_cawo4.csv")
    assert campaign.known_physics == ("polarization",)
    assert "cawo4 may be of another material" in campaign.physics_note


def test_rows_of_another_line_are_not_given_this_ones_depth(campaign_of, scenes, three, tmp_path):
    """Gammas of 662 keV go through most of the crystal: light of 59.5 keV is born near the top."""
    table = (scenes / "camoo4_three.csv").read_text().replace(",n_gap", ",n_gap,energy_keV")
    one = table.replace("1.00\n", "1.00,59.5\n").replace("1.46\n", "1.46,59.5\n")
    one = one.replace("0.012,", "0.012,,")
    (tmp_path / "one.csv").write_text(one)
    assert set(campaign_of(three, "one.csv").known_physics) == {"source_depth", "polarization"}
    (tmp_path / "two.csv").write_text(f"{one.rstrip()}\n662 keV,light,270,3,1.46,662\n")
    campaign = campaign_of(three, "two.csv")
    assert campaign.known_physics == ("polarization",)
    assert "gammas of 662 keV, which rows are of, stop at another depth" in campaign.physics_note
    reasons = budget(replace(campaign, tolerances=()), run=Run(2048)).not_estimated
    assert "662 keV" in reasons["source_depth"]


def test_a_spectrum_brings_the_index_over_it(scenes, tmp_path):
    """From raw data; and in numbers, as `mcrim reduce` writes them, the model is the same."""
    folder = tmp_path / "scenes" / "raw"
    folder.mkdir(parents=True)
    (folder.parent / "camoo4.xml").write_bytes((scenes / "camoo4.xml").read_bytes())
    for file in (scenes / "camoo4_raw").iterdir():
        (folder / file.name).write_bytes(file.read_bytes())
    path = folder / "campaign.toml"
    path.write_text(path.read_text().replace('convention = "article"', ""))
    campaign = read_campaign(path)
    assert set(campaign.known_physics) == {"source_depth", "crystal_index", "polarization"}
    mean = KnownCrystal.of(campaign).band.over.mean
    # the tube sees the blue side of the band, where the index is higher
    assert mean > 2.01 and campaign.scene.parameters["n_crystal"] == pytest.approx(mean, abs=1e-5)
    texts = plain_texts(campaign, folder / "plain.toml", folder / "plain.csv")
    for name, text in zip(("plain.toml", "plain.csv"), texts, strict=True):
        (folder / name).write_text(text)
    plain = read_campaign(folder / "plain.toml")
    assert set(plain.known_physics) == {"source_depth", "polarization"}
    held = plain.parameters["n_crystal"]
    assert held.fixed and held.start == pytest.approx(mean, abs=1e-5)


def test_an_unknown_material_is_refused_where_it_stands(campaign_of, three):
    refused = refusal(campaign_of, three.replace('"CaMoO4"', '"CaMo04"'))
    line = three[: three.index('material = "')].count("\n") + 1
    assert f"line {line}" in refused and "did you mean CaMoO4?" in refused


def test_a_budget_does_not_list_what_is_in_the_model(campaign_of, three):
    """And puts into others what `material` puts into this one: the numbers are the same."""
    run, three = Run(8192, seed=3), f"{three}\n[tolerances]\nnone = true\n"
    inside = budget(campaign_of(three), run=run)
    assert {piece.name for piece in inside.neglected} == {
        "crystal_index",
        "index_spread",
        "birefringence",
    }
    assert inside.not_estimated == dict.fromkeys(
        ("source_depth", "polarization"), "it is in the model"
    )
    article = budget(campaign_of(f'convention = "article"\n{three}'), run=run)
    assert {"source_depth", "polarization"} < {piece.name for piece in article.neglected}
    # all corrections together: the index's, which is the same in both, on top of the two
    for name in ("eta air", "eta gel"):
        one, two = (found.together.refitted[name] for found in (inside, article))
        assert one.after == pytest.approx(two.after, rel=1e-4)


def test_the_articles_three_numbers_count_once(scenes):
    """The prior on the absorption has no pull: chi2 is that of readings and numbers.

    With the prior from the transmittance it was 8.4 to 9.0 (p = 0.003). The Monte Carlo error of
    chi2 is 0.3 here.
    """
    fit = calibrate(CampaignSimulations(read_campaign(scenes / "camoo4_three.toml"), Run(seed=1)))
    squares = sum(((row.measured - row.model) / row.sigma) ** 2 for row in fit.rows)
    squares += sum((number.offset / number.tolerance.sigma) ** 2 for number in fit.offsets)
    assert fit.ndf == 1 and fit.chi2 == pytest.approx(squares, rel=0.02)
    assert fit.chi2 == pytest.approx(4.1, abs=1.0)
    assert 0.02 < fit.p_value < 0.08
