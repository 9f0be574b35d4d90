"""Refractive indices of materials, gammas' attenuation, and scenes that name materials."""

import pickle
import re

import numpy as np
import pytest
import xraydb
from measured import read_measurements
from places import cases_of
from refusals import refusal
from scipy.integrate import trapezoid

import mcrim_mitsuba as mcrim
from mcrim_mitsuba.campaign.campaign import read_campaign
from mcrim_mitsuba.inference.repair import mended_scene, scene_text, text_for_folder
from mcrim_mitsuba.optics.dispersion import Dispersion, NumberedFormula
from mcrim_mitsuba.optics.emission_band import index_over
from mcrim_mitsuba.optics.gammas import attenuation_length_mm
from mcrim_mitsuba.optics.materials import NAMES, catalogue, chemical_formula, density_of, material
from mcrim_mitsuba.optics.spectrum import Spectrum
from mcrim_mitsuba.scene.scene_file import read_scene

cases = cases_of(__file__)

D_NM, F_NM, C_NM, SODIUM_NM = 587.5618, 486.1327, 656.2725, 589.29


def index(name: str, wavelength_nm) -> np.ndarray:
    return material(name).index(wavelength_nm)


def emission(center_nm=540.0, width_nm=60.0, first_nm=380, last_nm=800, step_nm=5.0) -> Spectrum:
    wavelength_nm = np.arange(first_nm, last_nm + step_nm / 2, step_nm)
    return Spectrum(wavelength_nm, np.exp(-0.5 * ((wavelength_nm - center_nm) / width_nm) ** 2))


@cases("name", "wavelength_nm", "published", "tolerance", "source")
def test_formulas_give_published_values(name, wavelength_nm, published, tolerance, source):
    assert index(name, wavelength_nm) == pytest.approx(published, abs=tolerance), source


def test_water_against_air_is_the_refractometers_value():
    # CRC Handbook of Chemistry and Physics, 20 C, sodium line; the formula is against vacuum
    relative = index("water", SODIUM_NM) / index("air", SODIUM_NM)
    assert relative == pytest.approx(1.33299, abs=2e-5)


def test_matching_liquids_match_their_glass():
    assert index("Cargille_BK7", D_NM) == pytest.approx(index("BK7", D_NM), abs=1e-4)
    for liquid in ("Cargille_06350", "Cargille_50350"):
        assert index(liquid, D_NM) == pytest.approx(index("fused_silica", D_NM), abs=5e-4)


def test_bonds_formula_by_hand():
    # 1 + 2.784 l^2 / (l^2 - 0.1483^2) + 1.2425 l^2 / (l^2 - 11.576^2) at l = 0.54 um
    assert index("CaMoO4_o", 540.0) ** 2 == pytest.approx(1 + 3.011101 - 0.0027096, abs=2e-6)


def test_a_birefringent_name_alone_is_the_mean_of_directions_and_polarisations():
    wavelength_nm = np.array([450.0, 540.0, 3800.0])
    for name in ("CaMoO4", "CaWO4", "sapphire"):
        ordinary, extraordinary = (index(f"{name}_{ray}", wavelength_nm) for ray in "oe")
        assert index(name, wavelength_nm) == pytest.approx((2 * ordinary + extraordinary) / 3)
        difference = material(name).birefringence(wavelength_nm)
        assert difference == pytest.approx(extraordinary - ordinary)
    assert material("CaMoO4").birefringence(540.0) == pytest.approx(0.0106, abs=1e-4)
    assert np.all(material("BK7").birefringence(wavelength_nm[:2]) == 0)


def test_every_material_is_whole():
    for known in catalogue():
        shortest, longest = known.range_nm
        wavelength_nm = np.linspace(shortest, min(longest, 1e4), 50)[1:]
        values = known.index(wavelength_nm)
        assert values.shape == wavelength_nm.shape and values.dtype == np.float64
        assert np.all((values >= 1) & (values < 2.5)), known.name
        assert known.source and known.what and known.sigma >= 0
        assert (known.formula is None) or (known.density_g_per_cm3 is not None)
        assert index(known.name, float(wavelength_nm[0])).shape == ()


@cases("name", "wavelength_nm", "says")
def test_what_is_not_known_is_refused(name, wavelength_nm, says):
    assert says in refusal(index, name, wavelength_nm)


def test_names_do_not_depend_on_capitals_and_belong_to_one_material_each():
    assert material("camoo4_O") == material("CaMoO4_o")
    assert len({name.lower() for name in NAMES}) == len(NAMES)


def test_over_a_band_it_is_the_integral():
    band = emission(width_nm=30.0, first_nm=460, step_nm=1.0)
    found = index_over("CaMoO4", band)

    fine_nm = np.arange(460, 800.001, 0.01)
    weights = np.interp(fine_nm, band.wavelength_nm, band.values)

    def integral(function):
        return trapezoid(weights * function(fine_nm), fine_nm)

    area = integral(np.ones_like)
    mean = integral(lambda each: index("CaMoO4", each)) / area
    variance = integral(lambda each: (index("CaMoO4", each) - mean) ** 2) / area
    assert found.mean == pytest.approx(mean, abs=1e-7)
    assert found.spread == pytest.approx(variance**0.5, rel=1e-4)
    assert found.mean == pytest.approx(
        (2 * found.ordinary_mean + found.extraordinary_mean) / 3, abs=1e-12
    )
    assert found.mean_wavelength_nm == pytest.approx(integral(lambda each: each) / area)
    assert found.notes == () and found.sigma == material("CaMoO4").sigma


def test_light_below_the_range_gets_the_index_at_its_end_and_is_told():
    band = emission(width_nm=60.0)  # 6.7 % below 450 nm
    found = index_over("CaMoO4", band)
    below = band.wavelength_nm <= 450
    light = [
        trapezoid(band.values[part], band.wavelength_nm[part]) for part in (below, slice(None))
    ]
    assert found.outside == pytest.approx(light[0] / light[1], rel=1e-9)
    assert "outside 450 to 3800 nm" in found.notes[0]
    # what a straight line on would have added: far below what the crystal is known to
    assert 1e-4 < found.outside_sigma < material("CaMoO4").sigma
    assert found.sigma == pytest.approx(
        np.hypot(found.outside_sigma, material("CaMoO4").sigma), rel=1e-12
    )


def test_too_much_light_outside_is_refused():
    blue = emission(center_nm=400.0, width_nm=10.0, first_nm=350, last_nm=449)
    refused = refusal(index_over, "CaMoO4", blue)
    assert "100 % of the emission is outside 450 to 3800 nm" in refused
    assert "did you mean" in refusal(index_over, "CaMo4", emission())


def test_one_number_has_no_spread():
    found = index_over("Cargille_0607", emission(width_nm=30.0, first_nm=420, last_nm=690))
    assert (found.mean, found.birefringence) == (pytest.approx(1.46), 0.0)
    assert found.spread == pytest.approx(0.0, abs=1e-9) and found.extraordinary_mean is None


def test_dispersion_of_formulas():
    assert NumberedFormula(5, (1.5, 0.01, -2.0))(np.array([0.5])) == pytest.approx(1.54)
    one = Dispersion(NumberedFormula(5, (1.4,)), 400.0, 700.0)
    assert one.index([[400.0, 700.0]], "gel").shape == (1, 2)


def test_americium_in_calcium_molybdate():
    found = attenuation_length_mm("CaMoO4", 59.5)
    assert found.per_cm == pytest.approx(9.7, abs=0.1)
    assert found.length_mm == pytest.approx(1.03, abs=0.01)
    assert found.without_coherent_mm > found.length_mm
    assert found.sigma_mm == pytest.approx(
        np.hypot(0.02 * found.length_mm, found.without_coherent_mm - found.length_mm)
    )
    assert 0.85 < found.photoelectric_per_cm / found.per_cm < 0.95
    assert found.stopped_within([0.0, found.length_mm]) == pytest.approx([0.0, 1 - np.exp(-1)])
    twice = attenuation_length_mm("CaMoO4", 59.5, 2 * density_of("CaMoO4"))
    assert twice.length_mm == pytest.approx(found.length_mm / 2)


def test_the_tables_agree_with_hubbell_and_seltzer():
    # NISTIR 5632: liquid water at 60 keV, 0.2059 cm2/g; error as stated there, 2 %
    assert attenuation_length_mm("H2O", 60.0, 1.0).per_cm == pytest.approx(0.2059, rel=0.02)


def test_k_x_rays_escape_as_single_ones_do():
    """Depths, directions and paths drawn one by one; molybdenum's lines by its two mean energies.

    4 million events, so that the binomial error of 2.2 % is 0.007 %; the two lines in the place of
    all of them cost less than 0.02 %.
    """
    random, events = np.random.default_rng(38), 4_000_000
    edge, masses = xraydb.xray_edge("Mo", "K"), {"Ca": 40.078, "Mo": 95.95, "O": 4 * 15.999}

    def per_cm(energy_keV, kind="total", elements=tuple(masses)):
        parts = (masses[e] * xraydb.mu_elam(e, 1e3 * energy_keV, kind=kind) for e in elements)
        return 4.25 * float(sum(parts)) / sum(masses.values())

    gammas = per_cm(59.5)
    vacancy = per_cm(59.5, "photo", ("Mo",)) / gammas * (1 - 1 / edge.jump_ratio)
    radiates = random.random(events) < vacancy * edge.fyield
    alpha = random.random(events) < 0.83
    depth = random.exponential(1 / gammas, events)
    up, path = random.uniform(-1, 1, events), random.exponential(1.0, events)
    path /= np.where(alpha, per_cm(17.44), per_cm(19.65))
    out = radiates & (up * path > depth)
    found = attenuation_length_mm("CaMoO4", 59.5)
    sigma = np.sqrt(found.escaping / events)
    assert out.mean() == pytest.approx(found.escaping, abs=4 * sigma + 2e-4)
    lost = np.where(alpha, 17.44, 19.65)[out].mean()
    assert found.escaping_keV == pytest.approx(lost, abs=0.1)
    assert found.escape_loss == pytest.approx(0.0065, abs=2e-4)
    # 59.5 keV are below the K edge of tungsten
    assert attenuation_length_mm("CaWO4", 59.5).escape_loss < 1e-6


@cases("arguments", "says")
def test_impossible_gammas_are_refused(arguments, says):
    assert says in refusal(attenuation_length_mm, *arguments)


def test_brackets_with_a_count_belong_to_the_formula():
    with_brackets = attenuation_length_mm("Bi4(GeO4)3", 59.5, 7.13)
    assert with_brackets.per_cm == pytest.approx(
        attenuation_length_mm("Bi4Ge3O12", 59.5, 7.13).per_cm
    )


def test_a_materials_name_stands_for_its_formula():
    assert chemical_formula("fused_silica") == "SiO2" and chemical_formula(" PbWO4 ") == "PbWO4"
    silica = attenuation_length_mm("fused_silica", 59.5)
    assert (silica.formula, silica.density_g_per_cm3) == ("SiO2", 2.20)
    # of one formula, two densities; the database has formulas alone
    assert (density_of("EJ-200"), density_of("BC-408"), density_of("C9H10")) == (
        1.023,
        1.032,
        1.023,
    )
    assert attenuation_length_mm("rii:main/CaMoO4/Bond-o", 59.5) == attenuation_length_mm(
        "CaMoO4", 59.5
    )


@pytest.fixture
def bench(scenes, tmp_path):
    """Writes the article's bench with other indices."""

    def write(name="bench.xml", **indices):
        text = (scenes / "camoo4.xml").read_text(encoding="utf-8")
        for parameter, value in indices.items():
            text, count = re.subn(
                rf'(name="{parameter}" value=")[^"]*', rf"\g<1>{value}", text, count=1
            )
            assert count == 1
        (tmp_path / name).write_text(text, encoding="utf-8")
        return tmp_path / name

    return write


@pytest.fixture
def spectrum_file(tmp_path):
    band = emission()
    rows = "".join(f"{x:g},{y:.6f}\n" for x, y in zip(band.wavelength_nm, band.values, strict=True))
    (tmp_path / "emission.csv").write_text("wavelength_nm,intensity (photons/nm)\n" + rows)
    return tmp_path / "emission.csv"


def test_a_material_gives_the_scene_that_its_number_gives(bench):
    named = read_scene(bench(n_crystal="CaMoO4@540nm", n_window="bk7@540 nm"))
    typed = read_scene(bench("typed.xml", n_crystal="2.00562", n_window="1.51904"))
    assert named.parameters == typed.parameters
    assert named.content_hash == typed.content_hash
    assert named.overrides == {}
    numbers = {"n_crystal": "2.00562", "n_window": "1.51904"}
    assert named.overrides_for_mitsuba() == numbers
    assert named.defaults["n_crystal"].value == "CaMoO4@540nm"
    copy = pickle.loads(pickle.dumps(named))
    assert copy.content_hash == named.content_hash and copy.overrides_for_mitsuba() == numbers
    other = read_scene(bench(n_crystal="CaMoO4@600nm", n_window="BK7@540nm"))
    assert other.content_hash != named.content_hash


def test_overrides_name_materials_and_keep_them(bench):
    scene = read_scene(bench(n_crystal="CaMoO4@540nm"), {"n_gap": "water@540nm"})
    assert scene.parameters["n_gap"] == 1.33506
    later = scene.with_overrides({"gap_mm": 0.1})
    assert later.overrides == {"n_gap": "water@540nm", "gap_mm": "0.1"}
    assert later.overrides_for_mitsuba() == {
        "n_gap": "1.33506",
        "gap_mm": "0.1",
        "n_crystal": "2.00562",
    }
    assert later.read_again().content_hash == later.content_hash
    typed = later.with_overrides({"n_crystal": 1.9})
    assert list(typed.materials) == ["n_gap"]
    assert typed.overrides_for_mitsuba()["n_crystal"] == "1.9"
    same = later.with_overrides({"n_crystal": 2.00562})
    assert "n_crystal" in same.materials and same.content_hash == later.content_hash


def test_a_wavelength_may_be_a_parameter(bench):
    path = bench(n_crystal="CaMoO4@$wavelength_nm nm")
    text = path.read_text(encoding="utf-8").replace(
        '  <default name="n_crystal"',
        '  <default name="wavelength_nm" value="540"/>\n  <default name="n_crystal"',
    )
    path.write_text(text, encoding="utf-8")
    assert read_scene(path).parameters["n_crystal"] == 2.00562
    longer = read_scene(path, {"wavelength_nm": 600})
    assert longer.overrides_for_mitsuba() == {
        "wavelength_nm": "600.0",
        "n_crystal": str(round(index("CaMoO4", 600.0), 5)),
    }


def test_a_spectrum_beside_the_scene_gives_the_mean_over_it(bench, spectrum_file):
    scene = read_scene(bench(n_crystal="CaMoO4@emission.csv"))
    expected = index_over("CaMoO4", emission()).mean
    assert scene.parameters["n_crystal"] == pytest.approx(expected, abs=1e-5)
    assert scene.included == (spectrum_file,)
    assert scene.source(spectrum_file) == spectrum_file.read_bytes()
    spectrum_file.write_text("nm,photons\n500,0\n510,1\n520,0\n")
    # what was read stays; reading again sees the change
    assert scene.with_overrides({"gap_mm": 0.1}).parameters["n_crystal"] == pytest.approx(
        expected, abs=1e-5
    )
    assert scene.read_again().content_hash != scene.content_hash


@cases("text", "says")
def test_bad_materials_are_one_line_with_their_place(bench, text, says):
    path = bench(n_crystal=text)
    refused = refusal(read_scene, path)
    line = 1 + path.read_text(encoding="utf-8").split('name="n_crystal" value')[0].count("\n")
    assert refused.startswith(f"{path}, line {line}: n_crystal = '{text}'") and says in refused
    refused = refusal(read_scene, bench(), {"n_crystal": text})
    assert refused.startswith(f"{path}: the value given for n_crystal, '{text}'")
    assert says in refused


def test_only_indices_can_be_materials(bench):
    refused = refusal(read_scene, bench(gap_mm="air@540nm"))
    assert "gap_mm = 'air@540nm' is not a finite number" in refused


@cases("text", "says")
def test_a_surface_takes_numbers_only(bench, mcrim, text, says):
    path = bench()
    old = '<float name="int_ior" value="$n_crystal"/>'
    scene = path.read_text(encoding="utf-8")
    line = scene[: scene.index(old)].count("\n") + 1
    path.write_text(scene.replace(old, old.replace("$n_crystal", text), 1), encoding="utf-8")
    err = mcrim.refused("check", path)
    assert f"{path}, line {line}: " in err and says in err


def test_a_bad_spectrum_is_refused_by_its_own_name(bench, tmp_path):
    (tmp_path / "bad.csv").write_text("wavelength_nm,intensity\n540,1\n530,x\n550,1\n")
    assert "bad.csv, line 3" in refusal(read_scene, bench(n_crystal="CaMoO4@bad.csv"))
    (tmp_path / "blue.csv").write_text("wavelength_nm,photons\n400,0\n420,1\n440,0\n")
    refused = refusal(read_scene, bench(n_crystal="CaMoO4@blue.csv"))
    assert "100 % of the emission is outside" in refused


def campaign_of(folder, rows):
    (folder / "readings.csv").write_text("label,signal,sigma,n_gap\n" + rows)
    (folder / "campaign.toml").write_text(
        'scene = "bench.xml"\nmeasurements = "readings.csv"\n'
        "[parameters.alpha_scat_per_cm]\nstart = 0.5\n"
    )
    return folder / "campaign.toml"


def test_a_column_may_name_materials(bench, tmp_path, spectrum_file):
    bench(n_crystal="CaMoO4@540nm")
    campaign = read_campaign(
        campaign_of(
            tmp_path,
            "air,14.3,0.2,1.0\nwater,20,0.3,water@540nm\ngel,24.5,0.4,Cargille_06350@emission.csv\n",
        )
    )
    found = [each.parameters["n_gap"] for each in campaign.measurements.readings]
    over = index_over("Cargille_06350", emission()).mean
    assert found == [1.0, 1.33506, pytest.approx(over, abs=1e-5)]
    refused = refusal(read_campaign, campaign_of(tmp_path, "water,20,0.3,watr@540nm\n"))
    assert "readings.csv, line 2, column n_gap: n_gap = 'watr" in refused
    # without a campaign too
    campaign_of(tmp_path, "water,20,0.3,water@540nm\n")
    loose = read_measurements(tmp_path / "readings.csv", {"n_gap": 1.0})
    assert loose.readings[0].parameters["n_gap"] == 1.33506


def test_a_mended_scene_keeps_the_name_of_what_did_not_change(bench, tmp_path):
    bench(n_crystal="CaMoO4@540nm", n_window="BK7@540nm")
    campaign = read_campaign(campaign_of(tmp_path, "air,14.3,0.2,1.0\ngel,24.5,0.4,1.46\n"))
    values = {"alpha_scat_per_cm": 0.4, "n_crystal": 2.00562, "n_window": 1.53}
    mended = mended_scene(campaign, (), values)
    assert 'name="n_crystal" value="CaMoO4@540nm"' in scene_text(mended)
    assert 'name="n_window" value="1.53"' in scene_text(mended)
    assert mended.overrides_for_mitsuba() == {"n_crystal": "2.00562"}


def test_a_scene_written_elsewhere_finds_its_spectrum(bench, tmp_path, spectrum_file):
    scene = read_scene(bench(n_crystal="CaMoO4@emission.csv"))
    (tmp_path / "new").mkdir()
    moved = tmp_path / "new" / "bench.xml"
    moved.write_text(text_for_folder(scene, moved.parent), encoding="utf-8")
    assert 'value="CaMoO4@../emission.csv"' in moved.read_text(encoding="utf-8")
    assert read_scene(moved).content_hash == scene.content_hash
    assert text_for_folder(scene, tmp_path) == scene_text(scene)


def test_a_scene_whose_parts_stay_behind_is_not_written_elsewhere(
    bench, scenes, tmp_path, monkeypatch
):
    bar = read_scene(scenes / "plastic_bar.xml")
    assert "luag_fibre.xml" in text_for_folder(bar, scenes)
    line = refusal(text_for_folder, bar, tmp_path)
    assert "names luag_fibre.xml, which is not found from another folder; write the new" in line
    line = refusal(mcrim.add, "polarization", bar, tmp_path / "new.xml")
    assert "names luag_fibre.xml, which" in line and not (tmp_path / "new.xml").exists()
    monkeypatch.setattr("mcrim_mitsuba.inference.repair.diagnose", None)  # before all work
    line = refusal(mcrim.repair, scenes / "plastic_bar.toml", tmp_path / "new.toml")
    assert "names luag_fibre.xml, which" in line
    alone = read_scene(bench())
    assert text_for_folder(alone, tmp_path / "new") == scene_text(alone)


def test_check_says_where_an_index_comes_from(bench, mcrim):
    path = bench(n_crystal="CaMoO4@540nm")
    result = mcrim.json("check", path, "-D", "n_window=BK7@540nm")
    assert result["parameters"]["n_crystal"] == 2.00562
    crystal, window = (words for words in result["words"] if words.startswith("n_"))
    assert crystal.startswith("n_crystal = 2.00562: CaMoO4 (calcium molybdate")
    assert "at 540 nm" in crystal and "W. L. Bond" in crystal
    assert "SCHOTT" in window


def test_lab_index(mcrim, spectrum_file):
    # outside its range: listed without a number
    assert "CaMoO4" in mcrim.shown("lab", "index", "--nm", "405")
    assert mcrim("lab", "index", "BK7@540nm") == mcrim("lab", "index", "BK7")
    result = mcrim.json("lab", "index", "CaMoO4", "--emission", spectrum_file)
    assert mcrim.json("lab", "index", f"CaMoO4@{spectrum_file}") == result
