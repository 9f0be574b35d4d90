"""Spectra: means over an emission, the detector's efficiency, absorption from transmittance."""

import math
import shutil
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from places import cases_of, raw_copy
from refusals import refusal
from scipy.integrate import quad

from mcrim_mitsuba.campaign.campaign import read_campaign
from mcrim_mitsuba.campaign.editor import beam_notes
from mcrim_mitsuba.laboratory.light_yield import detector_efficiency
from mcrim_mitsuba.optics.absorption import absorption_from_transmittance as absorption
from mcrim_mitsuba.optics.emission_band import index_over
from mcrim_mitsuba.optics.slab_transmittance import (
    absorption_derivatives,
    apparent_absorption,
    clear_limit,
    measured_transmittance,
)
from mcrim_mitsuba.optics.spectrum import Spectrum, average_over, detected_light, weighted_mean
from mcrim_mitsuba.optics.spectrum_file import read_spectrum
from mcrim_mitsuba.output import laboratory_figures as figures

cases = cases_of(__file__)


def gaussian(mean=540.0, width=30.0, low=400.0, high=700.0, points=601, **more):
    places = np.linspace(low, high, points)
    return Spectrum(places, np.exp(-(((places - mean) / width) ** 2) / 2), **more)


# ---- means over an emission ------------------------------------------------------------------


def test_a_constant_s_mean_is_the_constant():
    emission = gaussian()
    mean = weighted_mean(emission, Spectrum([300, 800], [0.25, 0.25], [0.01, 0.01]))
    assert mean.value == pytest.approx(0.25, rel=1e-14) and mean.spread < 1e-8
    assert mean.quantity_derivatives.sum() == pytest.approx(1, rel=1e-13)
    # a constant does not care for the emission's shape
    assert np.abs(mean.emission_derivatives).max() < 1e-15 and mean.notes == ()


def test_a_line_under_a_gaussian_has_its_value_at_the_mean():
    line = Spectrum([400, 700], [0.3, 0.0])
    mean = weighted_mean(gaussian(), line)
    assert mean.value == pytest.approx(0.16, rel=2e-6)
    # the spread is slope times width
    assert mean.spread == pytest.approx(30 * 0.001, rel=1e-3)
    assert average_over(gaussian(), lambda nm: nm) == pytest.approx((540, 30), rel=1e-3)


def test_means_are_exact_on_coarse_grids_that_share_no_point():
    emission = Spectrum([400, 437, 511, 602, 690], [0.1, 2.0, 5.0, 1.0, 0.0])
    curve = Spectrum([350, 420, 495, 555, 700], [0.05, 0.3, 0.1, 0.2, 0.02])
    breaks = np.union1d(emission.wavelength_nm, curve.wavelength_nm).tolist()

    def integral(power, about=0.0):
        def integrand(nm):
            return float(emission.at(nm)) * (float(curve.at(nm)) - about) ** power

        inside = [nm for nm in breaks if 400 <= nm <= 690]
        return sum(quad(integrand, a, b)[0] for a, b in pairwise(inside))

    mean = weighted_mean(emission, curve)
    assert mean.value == pytest.approx(integral(1) / integral(0), rel=1e-12)
    assert mean.spread**2 == pytest.approx(integral(2, mean.value) / integral(0), rel=1e-12)
    value, spread = average_over(emission, lambda nm: nm**2)
    area = quad(emission.at, 400, 690, points=breaks[1:-1])[0]
    assert value == pytest.approx(
        quad(lambda nm: emission.at(nm) * nm**2, 400, 690, points=breaks[1:-1])[0] / area, rel=1e-12
    )
    assert spread > 0


def test_derivatives_are_those_of_the_mean():
    rng = np.random.default_rng(3)
    emission = gaussian(points=23)
    emission = replace(emission, sigmas=rng.uniform(0.01, 0.05, 23))
    curve = Spectrum(np.linspace(380, 720, 9), rng.uniform(0, 0.3, 9), rng.uniform(0, 0.02, 9))
    mean = weighted_mean(emission, curve)
    for which, derivatives, sigma in (
        (0, mean.emission_derivatives, mean.emission_sigma),
        (1, mean.quantity_derivatives, mean.quantity_sigma),
    ):
        curves = [emission, curve]
        numerical = np.zeros_like(derivatives)
        for i in range(derivatives.size):
            ends = []
            for step in (1e-5, -1e-5):
                moved = curves[which].values.copy()
                moved[i] += step
                changed = list(curves)
                changed[which] = replace(curves[which], values=moved)
                ends.append(weighted_mean(*changed).value)
            numerical[i] = (ends[0] - ends[1]) / 2e-5
        assert derivatives == pytest.approx(numerical, abs=1e-9)
        assert sigma == pytest.approx(math.hypot(*(numerical * curves[which].sigmas)), rel=1e-6)
    # the emission's scale cancels
    assert mean.emission_derivatives @ emission.values == pytest.approx(0, abs=1e-15)


def test_errors_of_the_points_are_honest():
    """400 repeats: the scatter is the propagated error within 4.5 standard errors."""
    rng = np.random.default_rng(11)
    emission = gaussian(points=31, sigmas=np.full(31, 0.03))
    curve = Spectrum(np.linspace(400, 700, 7), np.linspace(0.3, 0.0, 7), np.full(7, 0.01))
    mean = weighted_mean(emission, curve)
    values = []
    for _ in range(400):
        noisy = (
            replace(each, values=each.values + rng.normal(0, each.sigmas))
            for each in (emission, curve)
        )
        values.append(weighted_mean(*noisy).value)
    sigma = math.hypot(mean.quantity_sigma, mean.emission_sigma)
    assert abs(np.std(values) / sigma - 1) < 4.5 / math.sqrt(800)
    assert abs(np.mean(values) - mean.value) < 4.5 * sigma / math.sqrt(400)


def test_nothing_is_extrapolated_silently():
    emission = gaussian()
    short = Spectrum([500, 800], [0.1, 0.1], name="qe.csv")
    assert refusal(weighted_mean, emission, short, "the quantum efficiency").startswith(
        "qe.csv: the quantum efficiency ends where the crystal still emits: of the emission 9.1 % "
        "below 500 nm; extend the curve"
    )
    # 3.5 widths out: 0.02 % of the light is left out, and it is said
    mean = weighted_mean(emission, Spectrum([300, 645], [0.1, 0.1]))
    assert 1e-4 < mean.outside < 1e-3 and "above 645 nm" in mean.notes[0]
    assert mean.value == pytest.approx(0.1, rel=1e-12)
    assert "ends where" in refusal(weighted_mean, emission, Spectrum([100, 200], [0.1, 0.1]))
    dark = replace(emission, values=-emission.values)
    assert "no area" in refusal(weighted_mean, dark, emission)


@cases("arguments", "says")
def test_curves_that_are_none_are_refused(arguments, says):
    assert says in refusal(Spectrum, *arguments)


# ---- detector efficiency ---------------------------------------------------------------------


def test_the_detector_s_efficiency_and_its_errors():
    emission = gaussian(points=61, sigmas=np.full(61, 0.02))
    curve = Spectrum(np.linspace(350, 700, 8), np.linspace(0.28, 0.0, 8), np.full(8, 0.01))
    found = detector_efficiency(emission, curve)
    assert found.value == pytest.approx(0.28 * 160 / 350, rel=1e-4)
    assert found.contributions["tube scale"] == pytest.approx(0.05 * found.value)
    assert list(found.contributions) == [
        "tube scale",
        "quantum efficiency curve",
        "emission spectrum",
    ]
    assert found.sigma == pytest.approx(math.hypot(*found.contributions.values()))
    # eight points with an error of their own each, or one error for all of them
    assert 0.003 < found.contributions["quantum efficiency curve"] < 0.01
    assert "if all points share them they are worth 7.8 %" in found.notes[-1]
    bare = detector_efficiency(
        replace(emission, sigmas=None), replace(curve, sigmas=None), scale_sigma=0.0
    )
    assert bare.sigma == 0 and bare.value == found.value
    assert sum("none is counted" in note for note in bare.notes) == 2
    cut = detector_efficiency(gaussian(high=560.0), curve)
    assert any("still has 80 % of its maximum at 560 nm" in note for note in cut.notes)
    assert "0.05 for 5 %" in refusal(detector_efficiency, emission, curve, scale_sigma=5)
    blind = replace(curve, values=np.zeros(8))
    assert "0 wherever the crystal emits" in refusal(detector_efficiency, emission, blind)


# ---- absorption ------------------------------------------------------------------------------


def test_the_article_s_transmittance():
    found = absorption(
        [0.76], 2.01, 10.0, transmittance_sigma=0.005, n_sigma=0.01, thickness_sigma_mm=0.05
    )
    assert round(found.alpha_abs_per_cm, 3) == 0.047
    assert round(100 * found.internal_transmittance, 1) == 95.4
    assert found.spread_band_per_cm is None and found.spread_orientations_per_cm is None
    moved = {
        "transmittance": apparent_absorption(0.755, 2.01, 10)
        - apparent_absorption(0.765, 2.01, 10),
        "index": apparent_absorption(0.76, 2.02, 10) - apparent_absorption(0.76, 2.00, 10),
        "thickness": apparent_absorption(0.76, 2.01, 9.95) - apparent_absorption(0.76, 2.01, 10.05),
    }
    for origin, difference in moved.items():
        assert found.contributions[origin] == pytest.approx(abs(difference) / 2, rel=1e-3), origin
    assert found.sigma == pytest.approx(math.hypot(*found.contributions.values()))
    # the thickness does not change what is between the faces
    assert found.internal_transmittance_sigma == pytest.approx(
        found.internal_transmittance
        * math.hypot(found.contributions["transmittance"], found.contributions["index"])
    )


def test_derivatives_of_the_correction():
    for measured, n in ((0.76, 2.01), (0.3, 1.5), (0.82, 1.9), (0.05, 2.4)):
        by_measured, by_n = absorption_derivatives(measured, n, 7.0)
        step = 1e-6
        ends = apparent_absorption([measured - step, measured + step], n, 7.0)
        assert by_measured == pytest.approx(np.diff(ends)[0] / (2 * step), rel=1e-6)
        ends = apparent_absorption(measured, [n - step, n + step], 7.0)
        assert by_n == pytest.approx(np.diff(ends)[0] / (2 * step), rel=1e-6)


def transmitted(alpha_per_cm, n=2.0, thickness_mm=10.0):
    return measured_transmittance(np.exp(-np.asarray(alpha_per_cm) * thickness_mm / 10), n)


def test_spectra_give_the_mean_over_the_emission():
    places = np.linspace(380, 720, 171)
    alpha = 0.05 + 2e-4 * (540 - places)

    def n(nm):
        return 1.95 + 15_000 / np.asarray(nm) ** 2

    measured = Spectrum(places, transmitted(alpha, n(places)), np.full(171, 0.002))
    found = absorption([measured], n, 10.0, emission=gaussian())
    assert found.alpha_abs_per_cm == pytest.approx(0.05, rel=1e-6)
    assert found.spread_band_per_cm == pytest.approx(2e-4 * 30, rel=1e-3)
    assert found.n == pytest.approx(average_over(gaussian(), n)[0])
    straight = 0.05 + 2e-4 * (540 - found.curves[0].wavelength_nm)
    assert found.curves[0].values == pytest.approx(straight, abs=1e-12)
    # 0.002 in each of some 50 independent points: 0.0026 /cm in each
    assert 1e-4 < found.contributions["transmittance"] < 6e-4
    assert "if all points share them they are worth 0.0026 /cm" in found.notes[0]
    shared = absorption(
        [replace(measured, sigmas=None)], n, 10.0, emission=gaussian(), transmittance_sigma=0.002
    )
    assert shared.contributions["transmittance"] == pytest.approx(0.0026, rel=0.05)
    assert shared.notes == ()
    stated = absorption([measured], n, 10.0, emission=gaussian(), transmittance_sigma=0.002)
    assert stated.notes == ()
    silent = absorption([0.76], 2.01, 10.0, n_sigma=0.01)
    assert "the transmittance comes without errors: none" in silent.notes[0]
    # an absorbance of 0.12 that was taken for a transmittance
    dark = absorption([0.12], 2.01, 10.0, transmittance_sigma=0.005)
    assert "only 15 % of the light crosses" in dark.notes[0]
    at = absorption([measured], n, 10.0, wavelength_nm=541.0)
    assert at.alpha_abs_per_cm == pytest.approx(0.0498, rel=1e-3)
    assert at.contributions["transmittance"] == pytest.approx(0.0026 / math.sqrt(2), rel=0.05)


def test_orientations_enter_with_their_whole_spread():
    found = absorption(
        [float(transmitted(a)) for a in (0.04, 0.05, 0.06)], 2.0, 10.0, transmittance_sigma=0.003
    )
    assert found.alpha_abs_per_cm == pytest.approx(0.05)
    assert found.each_per_cm == pytest.approx((0.04, 0.05, 0.06))
    assert found.contributions["orientations"] == pytest.approx(0.01)
    # what the readings share is not averaged
    one = absorption([float(transmitted(0.05))], 2.0, 10.0, transmittance_sigma=0.003)
    assert found.contributions["transmittance"] == pytest.approx(
        one.contributions["transmittance"], rel=1e-3
    )
    weighted = absorption(
        [Spectrum([400, 550, 700], np.full(3, float(transmitted(a)))) for a in (0.04, 0.06)],
        2.0,
        10.0,
        emission=gaussian(points=61, sigmas=np.full(61, 0.05)),
    )
    assert weighted.contributions["orientations"] == pytest.approx(0.01 * math.sqrt(2))
    assert weighted.contributions["emission spectrum"] < 1e-12


def test_a_crystal_cannot_transmit_more_than_a_clear_one():
    limit = float(clear_limit(2.01))
    assert limit == pytest.approx(0.7976, abs=5e-5)
    found = absorption([limit], 2.01, 10.0)
    assert found.alpha_abs_per_cm == 0 and not any("held" in note for note in found.notes)
    found = absorption([limit + 0.004], 2.01, 10.0, transmittance_sigma=0.005)
    assert found.alpha_abs_per_cm == 0 > found.apparent_per_cm
    assert 0.005 < found.sigma < 0.007 and "the coefficient is held at 0" in found.notes[0]
    for sigma in (0.0, 0.005):
        refused = refusal(absorption, [0.82], 2.01, 10.0, transmittance_sigma=sigma)
        says = "82 % transmitted is more than the 79.76 % of a slab with n = 2.01 that absorbs"
        assert refused.startswith(says)
    places = np.linspace(400, 700, 31)
    high = Spectrum(places, np.where(places == 520, 0.9, 0.82), name="t.csv")
    refused = refusal(absorption, [high], 2.01, 10.0, emission=gaussian())
    assert "t.csv: at 520 nm, 90 % transmitted is more than" in refused


def test_noise_about_the_limit_is_not_clipped():
    """A clear crystal with noisy readings: half of the means are below 0, and none is biased."""
    rng = np.random.default_rng(17)
    places = np.linspace(400, 700, 61)
    clear = float(clear_limit(2.0))
    apparent = [
        absorption(
            [Spectrum(places, clear + rng.normal(0, 0.01, 61), np.full(61, 0.01))],
            2.0,
            10.0,
            emission=gaussian(points=61),
        ).apparent_per_cm
        for _ in range(100)
    ]
    assert abs(np.mean(apparent)) < 4.5 * np.std(apparent) / 10
    assert 20 < np.count_nonzero(np.array(apparent) < 0) < 80


def test_light_that_does_not_get_through_is_no_trouble_outside_the_emission():
    places = np.linspace(200, 800, 301)
    measured = np.where(places < 360, -1e-4, 0.76)
    wide = gaussian(low=250, high=750, points=501)
    opaque = Spectrum(places, measured, name="t.csv")
    found = absorption([opaque], 2.01, 10.0, emission=wide)
    assert round(found.alpha_abs_per_cm, 3) == 0.047 and found.curves[0].first_nm == 360
    for says, where in (
        ("ends where the crystal still emits", {"emission": gaussian(mean=420, low=300)}),
        ("t.csv: no light gets through the sample at 300 nm", {"wavelength_nm": 300}),
        ("no value at 900 nm", {"wavelength_nm": 900}),
    ):
        assert says in refusal(absorption, [opaque], 2.01, 10.0, **where)


def test_a_material_serves_the_whole_emission():
    # the formula of CaMoO4 begins at 450 nm
    emission = gaussian(mean=520, width=45, points=301)
    band = index_over("CaMoO4", emission)
    found = absorption(
        [Spectrum([390, 550, 710], [0.76] * 3)],
        band.material.held_index,
        10.0,
        n_sigma=band.sigma,
        emission=emission,
    )
    assert found.contributions["index"] > 0 and 1.9 < found.n < 2.1
    assert "outside 450" in band.notes[0]


@cases(
    "arguments",
    "more",
    "says",
    more=[
        (([0.7], lambda nm: 2 + 0 * nm, 10.0), {}, "an index that is no number"),
        (([gaussian()], 2.0, 10.0), {}, "a transmittance spectrum says nothing"),
        (([gaussian()], 2.0, 10.0), {"emission": gaussian(), "wavelength_nm": 5.0}, "both"),
    ],
)
def test_impossible_numbers_are_refused(arguments, more, says):
    assert says in refusal(absorption, *arguments, **more)


# ---- files -----------------------------------------------------------------------------------


def read(tmp_path, text, kind):
    path = tmp_path / "spectrum.csv"
    path.write_text(text, encoding="utf-8")
    return read_spectrum(path, kind)


THREE = {"wavelength_nm": [500.0, 550.0, 600.0], "values": [0.1, 0.4, 0.2]}


@cases("text", "kind")
def test_spectra_are_read_in_their_units(tmp_path, text, kind):
    found = read(tmp_path, text, kind)
    assert found.wavelength_nm == pytest.approx(THREE["wavelength_nm"], rel=1e-14)
    assert found.values == pytest.approx(THREE["values"], rel=1e-14)
    assert found.sigmas is None and found.notes == ()


@cases("text", "kind", "sigmas")
def test_errors_are_read_in_their_units(tmp_path, text, kind, sigmas):
    found = read(tmp_path, text, kind)
    assert found.sigmas == pytest.approx(sigmas) and found.values == pytest.approx(THREE["values"])


@pytest.mark.parametrize(("name", "constant"), [("energy (eV)", 1239.841984), ("k (1/cm)", 1e7)])
def test_emission_over_energy_becomes_one_per_nm(tmp_path, name, constant):
    """Photons do not get more or fewer by another axis: Gaussian over energy, mean wavelength."""
    width, centre = 0.05 * constant / 540, constant / 540
    places = np.linspace(centre - 6 * width, centre + 6 * width, 601)
    light = np.exp(-(((places - centre) / width) ** 2) / 2)
    rows = "\n".join(f"{x!r},{y!r}" for x, y in zip(places.tolist(), light.tolist(), strict=True))
    found = read(tmp_path, f"{name},photons\n{rows}\n", "emission")
    mean, _ = average_over(found, lambda nm: nm)
    expected = np.average(constant / places, weights=light)
    assert mean == pytest.approx(expected, rel=1e-6)
    # without the conversion it would be off by the square of the width
    assert abs(expected / 540 - 1) > 1e-3 and "converted to intensities per nm" in found.notes[0]


@pytest.mark.parametrize("title", ["P (mW/nm)", "radiance", "I [W m-2 nm-1]"])
def test_power_becomes_photons(tmp_path, title):
    """A photon's energy goes as 1 / wavelength: as photons, power over it has another centre."""
    at, width = np.linspace(350.0, 750.0, 401), 60.0
    photons = np.exp(-(((at - 540.0) / width) ** 2) / 2)
    rows = "\n".join(
        f"{x!r},{y!r},{0.1 * y!r}"
        for x, y in zip(at.tolist(), (photons / at).tolist(), strict=True)
    )
    of_power, of_photons = (
        read(tmp_path, f"nm,{name},sigma\n{rows}\n", "emission") for name in (title, "photons")
    )
    assert average_over(of_power, lambda nm: nm)[0] == pytest.approx(540.0, abs=0.2)
    # taken as photons, bluer by width^2 / 540
    assert average_over(of_photons, lambda nm: nm)[0] == pytest.approx(
        540 - width**2 / 540, abs=0.3
    )
    assert of_power.sigmas == pytest.approx(0.1 * of_power.values)
    assert of_power.notes == ("spectrum.csv: power was converted to numbers of photons",)


def test_noise_of_an_emission_is_kept_and_gaps_are_said(tmp_path):
    text = "".join(
        f"{nm},{-0.5 if nm in (402, 598) else 50}\n"
        for nm in range(400, 602, 2)
        if not 500 < nm < 522
    )
    found = read(tmp_path, f"nm,counts\n{text}", "emission")
    assert found.values.min() == -0.5
    assert found.notes == (
        "spectrum.csv: no points from 500 to 522 nm: the curve is a straight line there",
    )
    # three standard errors of its own are noise too
    noisy = "nm,counts,sigma\n500,-5,2\n510,50,2\n520,9,2\n"
    assert read(tmp_path, noisy, "emission").values[0] == -5
    dark = "nm,I,sigma\n500,-20,20\n510,50,20\n520,9,20\n"
    assert "-20 is below 0" in refusal(read, tmp_path, dark, "emission")


@cases("text", "kind", "says")
def test_spectra_that_may_be_meant_otherwise_are_refused(tmp_path, text, kind, says):
    refused = refusal(read, tmp_path, text, kind)
    assert says in refused and "spectrum.csv" in refused


# ---- commands and figures --------------------------------------------------------------------


@pytest.fixture
def folder(here):
    """Tables as a laboratory has them, noise included."""
    rng = np.random.default_rng(1)
    places = np.arange(390, 741, 2.0)
    light = np.exp(-(((places - 535) / 45) ** 2) / 2) + rng.normal(0, 0.003, places.size)
    rows = (f"{a:g};{b:.4f};0,003\n" for a, b in zip(places, light, strict=True))
    (here / "emission.csv").write_text(
        "wavelength (nm);photons (a.u.);sigma\n" + "".join(rows).replace(".", ",")
    )
    (here / "qe.csv").write_text(
        "wavelength (nm),QE (%),sigma (%)\n350,27.5,1\n400,27,1\n450,23,1\n500,17.5,1\n550,9.5,.5\n"
        "600,4.5,.3\n650,1.2,.1\n700,.2,.02\n750,.01,.01\n"
    )
    down = np.arange(800, 340, -1.0)
    for i, alpha in enumerate((0.04, 0.045, 0.055), start=1):
        measured = 100 * transmitted(alpha + 0.4 * np.exp((330 - down) / 35), 2.0)
        rows = (
            f"{a:g},{b + rng.normal(0, 0.1):.3f},\n" for a, b in zip(down, measured, strict=True)
        )
        (here / f"t_{i}.csv").write_text("Cube,,\nWavelength (nm),%T,\n" + "".join(rows))
    return here


def test_the_absorption_command(folder, mcrim):
    usual = ["--n", "2.01", "--thickness-mm", "10"]
    said = mcrim.shown("lab", "absorption", "0.76", *usual)
    assert "alpha_abs 0.04714 /cm, internal transmittance 95.4 %" in said
    assert "the article (Sec. 4) has 96 % and 0.039 /cm" in said and "no error is given" in said
    assert "the article" not in mcrim.shown(
        "lab", "absorption", "76%", "--n", "2.02", "--thickness-mm", "10", "--sigma", "0.5%"
    )
    named = ["--n", "CaMoO4", "--thickness-mm", "10"]
    # the spectra go to wavelengths at which the material's index is not known
    mcrim.shown("lab", "absorption", "t_1.csv", *named, "--nm", "540", "--figure", "b.png")
    shutil.copy("t_1.csv", "copy.csv")
    twice = mcrim.refused("lab", "absorption", "t_1.csv", "copy.csv", *usual, "--nm", "540")
    assert "copy.csv: the same data as t_1.csv" in twice


def test_figures_show_what_was_computed(folder):
    emission = read_spectrum("emission.csv", "emission")
    curve = read_spectrum("qe.csv", "quantum_efficiency")
    found = detector_efficiency(emission, curve)
    axes = figures.draw_efficiency(found).figure.axes[0]
    mean = next(line for line in axes.lines if "weighted mean" in line.get_label())
    assert mean.get_ydata()[0] == pytest.approx(100 * found.value)
    product = next(line for line in axes.lines if "×" in line.get_label())
    inside = product.get_xdata() == 550
    assert product.get_ydata()[inside] == pytest.approx(
        9.5 * emission.at(550) / emission.values.max()
    )
    spectra = [read_spectrum(f"t_{i}.csv", "transmittance") for i in (1, 2, 3)]
    spectra = [replace(curve, name=f"$t_{i}") for i, curve in enumerate(spectra, start=1)]
    absorbed = absorption(spectra, 2.0, 10.0, emission=emission)
    figure = figures.draw_absorption(absorbed).figure
    figure.draw_without_rendering()
    above, below = figure.axes
    assert above.lines[0].get_ydata()[0] == pytest.approx(
        100 * spectra[0].at(absorbed.curves[0].first_nm)
    )
    assert below.lines[3].get_ydata()[0] == absorbed.alpha_abs_per_cm
    limit = next(line for line in above.lines if "absorbs nothing" in line.get_label())
    assert limit.get_ydata() == pytest.approx(80.0)


# ---- the light that is detected, and the beam ----------------------------------------------------


def test_light_counts_as_it_is_detected():
    emission = Spectrum(np.array([400.0, 500.0, 600.0]), np.array([1.0, 1.0, 1.0]))
    efficiency = Spectrum(np.array([450.0, 500.0, 700.0]), np.array([0.2, 0.3, 0.1]))
    seen = detected_light(emission, efficiency)
    np.testing.assert_array_equal(seen.wavelength_nm, [400, 450, 500, 600])
    # nothing is detected where the curve has no points
    np.testing.assert_allclose(seen.values, [0.0, 0.2, 0.3, 0.2])
    # alpha falls with the wavelength: weighted with what is seen it is nearer to the blue's
    at = np.linspace(400, 600, 201)
    alpha = Spectrum(at, 1e-4 * (800 - at))
    assert weighted_mean(seen, alpha, "alpha").value == pytest.approx(
        1e-4 * (800 - average_over(seen, lambda nm: nm)[0])
    )


def test_an_error_that_tilts_the_emission_is_told():
    at = np.linspace(450, 650, 41)
    emission = Spectrum(at, np.exp(-(((at - 540) / 60) ** 2)), sigmas=np.full(41, 0.03))
    efficiency = Spectrum(np.array([400.0, 700.0]), np.array([0.3, 0.0]), sigmas=np.zeros(2))
    notes = detector_efficiency(emission, efficiency).notes
    assert any("runs over the band" in note for note in notes)
    exact = Spectrum(at, emission.values, sigmas=np.full(41, 1e-4))
    assert not any("runs over" in note for note in detector_efficiency(exact, efficiency).notes)


@pytest.mark.parametrize(("alpha_scat_per_cm", "told"), [(0.54, True), (0.02, False)])
def test_scattering_that_a_beam_does_not_show_is_told(scenes, alpha_scat_per_cm, told):
    raw = read_campaign(scenes / "camoo4_raw" / "campaign.toml").raw
    notes = beam_notes(raw, alpha_scat_per_cm)
    assert bool(notes) == told
    if told:
        assert "takes 42 % out of a beam through 10 mm" in notes[0]


# ---- transmittances of a campaign ----------------------------------------------------------------


@pytest.fixture
def raw(tmp_path, scenes):
    """The shipped raw campaign with one spectrum, to be changed; its scene beside it."""
    rows = "label,histogram,n_gap\nair,air_1.csv,1.00\ngel,gel_1.csv,1.46\n"
    path = raw_copy(scenes, tmp_path, rows)

    def changed(spectra, *more, n=None, scene=None):
        lines = path.read_text().splitlines()
        lines = [line for line in lines if not line.startswith(("n = ", "thickness_mm"))]
        at = next(i for i, line in enumerate(lines) if line.startswith("transmittance = "))
        lines[at] = f"transmittance = {spectra}"
        lines[at + 1 : at + 1] = [*more] if n is None else [*more, f"n = {n}"]
        path.write_text("\n".join(lines))
        if scene is not None:
            place = tmp_path / "camoo4.xml"
            known = place.read_text()
            assert known.count(scene[0]) == 1
            place.write_text(known.replace(*scene))
        return path

    return changed


ONE, THICK = '["transmittance_1.csv"]', "thickness_mm = 10.0"


def test_spectra_of_a_campaign_share_an_error(raw):
    found = read_campaign(raw(ONE, THICK, "transmittance_sigma = 0.005")).raw.absorption
    assert found.contributions["transmittance"] == pytest.approx(0.0066, rel=0.05)
    assert not any("without errors" in note for note in found.notes)


def test_the_scene_s_material_has_its_error_and_silence_on_readings_is_told(raw):
    material = ('name="n_crystal" value="2.01"', 'name="n_crystal" value="CaMoO4@540nm"')
    found = read_campaign(raw(ONE, THICK, scene=material)).raw.absorption
    assert found.contributions["index"] > 1e-4
    assert any("the transmittance comes without errors" in note for note in found.notes)


@cases("spectra", "more", "says")
def test_transmittances_of_a_campaign_that_are_refused(raw, spectra, more, says):
    path = raw(spectra, *more)
    shutil.copy(path.parent / "transmittance_1.csv", path.parent / "copy.csv")
    assert says in refusal(read_campaign, path) + "\n"
