"""From channels to photoelectrons: closed forms, drawn spectra, files of instruments, refusals."""

import gzip
import math
import re
from pathlib import Path

import numpy as np
import pytest
from refusals import refusal
from scipy.stats import chi2, norm
from trials.digitiser import (
    COMMON,
    SILICON,
    TUBE,
    fit_common,
    fit_photoelectrons,
    fit_subtracted,
    spectrum,
)
from trials.digitiser import background as room

from mcrim_mitsuba.core.errors import InputError
from mcrim_mitsuba.laboratory import digitiser
from mcrim_mitsuba.laboratory.calibration import (
    ChannelCalibration,
    Gain,
    background_noise,
    calibrated,
    fit_histogram,
    photons_of,
    window_of,
    with_live_time,
)
from mcrim_mitsuba.laboratory.digitiser import read_channels
from mcrim_mitsuba.laboratory.energy_scale import intrinsic_width, lines_of
from mcrim_mitsuba.laboratory.histogram import read_histogram
from mcrim_mitsuba.laboratory.single_photoelectron import (
    Pedestal,
    chances,
    fit_pedestal,
    fit_single_photoelectrons,
    gain_by_excess_noise,
)

#: Chance of a failure where nothing is wrong, of each statistical test (two-sided).
FALSE_ALARM = 1e-3
SPECTRA = Path(__file__).parent / "spectra"
TWO = ChannelCalibration(gain=Gain(value=2.0, sigma=0.02), pedestal=Pedestal(100.0, 0.5))


def assert_honest(pulls):
    """Pulls are standard normal."""
    pulls = np.asarray(pulls)
    assert abs(pulls.mean()) < norm.isf(FALSE_ALARM / 2) / math.sqrt(len(pulls))
    low, high = chi2.ppf([FALSE_ALARM / 2, 1 - FALSE_ALARM / 2], len(pulls) - 1)
    assert low < (len(pulls) - 1) * pulls.var(ddof=1) < high


# ---- single photoelectrons -------------------------------------------------------------------


@pytest.mark.parametrize("lam", [0.0, 0.15, 0.4])
def test_generalised_poisson_has_its_moments(lam):
    """Mean mu / (1 - lam), variance mu / (1 - lam)^3 (Vinogradov 2012)."""
    p, n = chances(1.7, lam, 200), np.arange(200)
    mean = p @ n
    assert p.sum() == pytest.approx(1) and mean == pytest.approx(1.7 / (1 - lam))
    assert p @ (n - mean) ** 2 == pytest.approx(1.7 / (1 - lam) ** 3)


@pytest.mark.parametrize("kind", [SILICON, TUBE])
def test_gain_mean_and_crosstalk_have_honest_errors(kind):
    pulls = np.concatenate([fit_photoelectrons(kind, 3, number) for number in range(3)])
    for of in pulls.T[:3]:
        assert_honest(of)


def test_a_tube_and_too_little_light(tmp_path):
    random = np.random.default_rng(4)
    n = random.poisson(0.5, 40_000)
    charge = 80 + 30 * n + random.normal(size=len(n)) * np.sqrt(3**2 + n * 12**2)
    counts = np.bincount(np.round(charge).astype(int), minlength=512).astype(float)
    channels = np.arange(512.0)
    fit = fit_single_photoelectrons(channels[: len(counts)], counts)
    # not told apart: a tube, without crosstalk
    assert fit.crosstalk is None and abs(fit.gain - 30) < 4 * fit.gain_sigma < 1.5
    assert fit.excess_noise_factor == pytest.approx(1 + 0.4**2, abs=0.03)
    dark = np.bincount(np.round(random.normal(80, 3, 20_000)).astype(int), minlength=200)
    with pytest.raises(InputError, match="next to nothing lies above the pedestal"):
        fit_single_photoelectrons(np.arange(200.0), dark.astype(float))
    flat = np.zeros(200)
    flat[50:] = 100.0
    with pytest.raises(InputError, match="no pedestal stands out"):
        fit_single_photoelectrons(np.arange(200.0), flat)


def test_afterpulses_are_told_where_there_are_some():
    """One an event at most, its charge exponential: 8 % of each cell that fired."""
    pulls = []
    for seed in range(6):
        random = np.random.default_rng(seed)
        n = random.poisson(1.2, 40_000)
        after = (random.random(len(n)) < 1 - 0.92**n) * random.exponential(25, len(n))
        charge = 100 + 50 * n + after + 3.5 * np.sqrt(1 + n) * random.normal(size=len(n))
        counts = np.bincount(np.round(charge).astype(int)).astype(float)
        fit = fit_single_photoelectrons(np.arange(float(len(counts))), counts)
        pulls += [(fit.gain - 50) / fit.gain_sigma, (fit.mean - 1.2) / fit.mean_sigma]
        pulls += [(fit.afterpulsing - 0.08) / fit.afterpulsing_sigma]
    assert_honest(pulls)


def test_excess_noise_tells_the_gain():
    """M = gain mu, V = gain^2 mu F + noise^2."""
    random = np.random.default_rng(5)
    n = random.poisson(20, 50_000)
    charge = 100 + 8 * n + random.normal(size=len(n)) * np.sqrt(6**2 + n * 3**2)
    counts = np.bincount(np.round(charge).astype(int)).astype(float)
    factor = 1 + (3 / 8) ** 2
    fit = gain_by_excess_noise(
        np.arange(float(len(counts))), counts, Pedestal(100, 0.05, 6), factor, 0.02
    )
    assert abs(fit.gain - 8) < 4 * fit.gain_sigma and fit.gain_sigma > 8 * 0.02 / factor
    assert abs(fit.mean - 20) < 4 * fit.mean_sigma and "less sure" in fit.warnings[0]


def test_the_pedestal_is_found_below_its_continuum():
    pulls = []
    for seed in range(40):
        random = np.random.default_rng(seed)
        shape = 20_000 * norm.pdf(np.arange(600), 119.5, 3) + 25.0 * (np.arange(600) > 119)
        pedestal = fit_pedestal(np.arange(600.0), random.poisson(shape).astype(float))
        pulls.append((pedestal.position - 119.5) / pedestal.sigma)
    assert abs(np.mean(pulls)) < 1.0 and np.std(pulls) < 1.5
    assert fit_pedestal(np.arange(600.0), np.full(600, 25.0)) is None


# ---- spectra of light ------------------------------------------------------------------------


def peak_of(mean: float, seed: int = 1) -> np.ndarray:
    random = np.random.default_rng(seed)
    photoelectrons = random.poisson(mean, 20_000)
    charge = 100 + 2.0 * photoelectrons + random.normal(0.0, 2.0, 20_000)
    return np.bincount(np.round(charge).astype(int), minlength=1024).astype(float)[:1024]


def test_channels_become_photoelectrons():
    """(channel - pedestal) / gain, of a Poisson's mean; every spectrum's own pedestal is its."""
    histogram = calibrated(spectrum(peak_of(150.0)), TWO)
    peak = fit_histogram(histogram)
    value, sigma = photons_of(histogram, peak)
    assert peak.shape == "counting" and abs(value - 150.0) < 4 * sigma < 1.2
    assert sigma == peak.centroid_sigma and TWO.scale_sigma == 0.01 and TWO.offset_sigma == 0.25
    # windows are in channels
    low, high = window_of(histogram, (350.0, 450.0))
    assert (low, high) == (125.0, 175.0)
    assert abs(fit_histogram(histogram, window=(low, high)).centroid - 150.0) < 1.0
    assert "give two ascending channels from 0 to" in refusal(window_of, histogram, (350.0, 9e9))
    # k of reading = true / (1 + k true)
    bent = ChannelCalibration(gain=TWO.gain, pedestal=TWO.pedestal, nonlinearity=1e-3)
    assert bent.light(150.0 / 1.15)[0] == pytest.approx(150.0)
    with pytest.raises(InputError, match="it has no answer"):
        bent.light(1e4)
    ranges = ChannelCalibration(gain=TWO.gain, pedestal=None, range_ratio=20.0)
    assert ranges.per_channel == 10.0 and ranges.offset_sigma == 0.0
    with pytest.raises(InputError, match="no pedestal stands out"):
        calibrated(spectrum(peak_of(150.0)), ranges)


@pytest.mark.parametrize("signal_to_background", ["5", "0.5"])
def test_subtracted_backgrounds_have_honest_errors(signal_to_background):
    pulls = np.concatenate([fit_subtracted(signal_to_background, 8, n) for n in range(4)])
    assert_honest(pulls.T[0])


UNDER = 400 * room(512, 1.0)
RUN_S, LIGHT_S = 200.0, 600.0


def subtracted(run, counts):
    """A peak of one photoelectron per channel, its background subtracted, and its fit."""
    calibration = ChannelCalibration(
        gain=Gain(value=1.0, sigma=0.0),
        pedestal=Pedestal(100.0, 0.0),
        background=spectrum(run, RUN_S),
    )
    histogram = calibrated(spectrum(counts, LIGHT_S), calibration)
    return histogram, fit_histogram(histogram, shape="gaussian")


def test_the_noise_of_a_common_background_is_correlated():
    """Pulls of difference and sum of readings of one run; and as the fit moves with the run."""
    assert_honest(np.ravel([pulls[:2] for pulls in fit_common(COMMON, 1, 0)]))
    peak = 8000 * norm.pdf(np.arange(512), 300, 18.5)
    run = UNDER / 3
    histogram, fit = subtracted(run, UNDER + peak)
    noise, centroids = background_noise(histogram, fit), []
    for sign in (1, -1):
        more = run + sign * np.sqrt(run) * (np.arange(512) > 290)
        centroids.append(subtracted(more, UNDER + peak)[1].centroid)
    moved = 0.5 * (centroids[0] - centroids[1])
    assert noise[291:].sum() == pytest.approx(moved, rel=0.15)


def test_dead_time_is_taken_off():
    """Live time = real time - N tau (Knoll)."""
    counts = peak_of(150.0)
    seen = with_live_time(spectrum(counts), 100.0, 50.0)
    assert seen.live_time_s == pytest.approx(100.0 - 50e-6 * counts.sum())
    assert with_live_time(spectrum(counts, 60.0), 100.0, 50.0).live_time_s == 60.0
    with pytest.raises(InputError, match="its events were dead for"):
        with_live_time(spectrum(counts), 0.5, 50.0)


def test_lines_tell_light_per_energy_and_the_intrinsic_width():
    random, energies, light = np.random.default_rng(2), (59.5, 511.0, 1274.5), (2.2, 2.0, 1.95)
    charge = []
    for energy, of_line in zip(energies, light, strict=True):
        mean = energy * of_line
        n = random.poisson(random.normal(mean, 0.02 * mean, 25_000))
        charge += [100 + 1.2 * (n + 0.3 * np.sqrt(n) * random.normal(size=len(n)))]
        charge += [100 + 1.2 * random.uniform(0, 0.7 * mean, 15_000)]
    counts = np.bincount(np.round(np.concatenate(charge)).astype(int), minlength=4096)
    calibration = ChannelCalibration(gain=Gain(value=1.2, sigma=0.0), pedestal=Pedestal(100, 0))
    histogram = calibrated(spectrum(counts[:4096].astype(float)), calibration)
    lines = lines_of(histogram, energies)
    for line, of_line in zip(lines, light, strict=True):
        assert abs(line.relative - of_line / 1.95) < 4 * math.hypot(line.relative_sigma, 3e-4)
    width, counted = intrinsic_width(lines)
    assert abs(width.fwhm - 2.355 * 0.02) < 4 * width.sigma < 0.03
    assert counted == pytest.approx(1.09, abs=0.15)
    assert "none at the ratios" in refusal(lines_of, histogram, (10.0, 3000.0))


# ---- files -----------------------------------------------------------------------------------


def unpacked(tmp_path: Path, name: str) -> Path:
    path = tmp_path / name
    path.write_bytes(gzip.decompress((SPECTRA / f"{name}.gz").read_bytes()))
    return path


def test_files_of_instruments_are_read_to_the_count(tmp_path):
    pytest.importorskip("SpecUtils")
    path = SPECTRA / "digibase_5min_30_1.spe"
    text = path.read_text().split("0 1023")[1].split("$")[0]
    read = read_channels(path)
    assert np.array_equal(read.counts, np.array(text.split(), float)) and read.live_time_s == 296.0
    path = SPECTRA / "minix_20kV_15uA_sdd.mca"
    text = path.read_text(errors="ignore").split("<<DATA>>")[1].split("<<END>>")[0]
    read = read_channels(path)
    assert np.array_equal(read.counts, np.array(text.split(), float))
    assert read.live_time_s == pytest.approx(8994.994673)
    chn = unpacked(tmp_path, "Alcatraz14.chn")
    counts = np.frombuffer(chn.read_bytes(), "<i4", 8192, 32)
    # SpecUtils leaves out the last channel of this format, of what lies beyond the others
    assert np.array_equal(read_channels(chn).counts[:-1], counts[:-1])
    assert np.array_equal(read_channels(SPECTRA / "Alcatraz14.n42").counts, counts)
    cnf = unpacked(tmp_path, "falcon5000.cnf")
    read = read_channels(cnf)
    assert np.array_equal(read.counts, np.frombuffer(cnf.read_bytes(), "<i4", 4096, 165888))
    assert read.live_time_s == pytest.approx(841.42)


def test_histograms_of_root_are_read(tmp_path):
    uproot = pytest.importorskip("uproot")
    read = read_channels(SPECTRA / "uproot-issue66.root")
    assert len(read.counts) == 200 and read.counts.sum() == 100_000
    path, edges = tmp_path / "h.root", np.arange(65) - 0.5
    with uproot.recreate(path) as file:
        file["h"] = np.histogram(np.arange(64).repeat(np.arange(64)), edges)
    read = read_channels(path)
    assert np.array_equal(read.counts, np.arange(64)) and np.array_equal(read.channels, read.counts)


def test_histograms_of_root_are_named_where_there_are_several(tmp_path):
    uproot = pytest.importorskip("uproot")
    path, edges = tmp_path / "runs.root", np.arange(65) - 0.5
    with uproot.recreate(path) as file:
        for place, name in enumerate(("dry", "wet/far")):
            file[name] = np.histogram(np.arange(64).repeat(np.arange(64) + place), edges)
    for separator in ":#":
        read = read_channels(f"{path}{separator}wet/far")
        assert read.counts[0] == 1 and read.comments == ("wet/far",)
    assert read_channels(f"{path}:dry").counts[0] == 0
    for named, says in (("", "none of them named; "), (":wett", "none of them wett; ")):
        says += "name one, as runs.root:dry, of dry, wet/far"
        assert ".root files hold channels" in refusal(read_histogram, f"{path}{named}")
        assert f"2 histograms (TH1) in one file, {says}" in refusal(read_channels, f"{path}{named}")


def test_what_is_missing_is_said_with_what_to_install(monkeypatch):
    def missing(name):
        raise ImportError(name)

    monkeypatch.setattr(digitiser.importlib, "import_module", missing)
    for name in ("digibase_5min_30_1.spe", "uproot-issue66.root"):
        assert "pip install 'mcrim-mitsuba[formats]'" in refusal(read_channels, SPECTRA / name)


@pytest.mark.parametrize("pedestal", [Pedestal(100.0, 0.0), None], ids=["known", "own"])
def test_a_pedestal_however_large_is_not_the_peak(pedestal):
    """With more than four times the peak's events it was: 0.8 photoelectrons for 300."""
    random = np.random.default_rng(3)
    light = 100.0 + 3.0 * random.poisson(random.normal(300.0, 18.0, 8000))
    events = [light + random.normal(0, 5, 8000), random.normal(100.0, 4.0, 60_000)]
    counts = np.histogram(np.concatenate(events), np.arange(-0.5, 2048.5))[0].astype(float)
    calibration = ChannelCalibration(gain=Gain(value=3.0, sigma=0.0), pedestal=pedestal)
    histogram = calibrated(spectrum(counts), calibration)
    centroid, sigma = photons_of(histogram, fit_histogram(histogram))
    assert abs(centroid - 300.0) < 4.0 * sigma < 6.0
    # a pedestal above all light: no peak, where it was a traceback
    above = ChannelCalibration(gain=calibration.gain, pedestal=Pedestal(1500.0, 0.0))
    assert fit_histogram(calibrated(spectrum(counts), above)) is None


def test_live_times_are_read_from_comments(tmp_path):
    path = tmp_path / "h.txt"
    rows = "".join(f"{i}\t{n:g}\n" for i, n in enumerate(peak_of(150.0)))
    path.write_text(f"Live Time (s): 600.5\nchannel\tcounts\n{rows}")
    assert read_channels(path).live_time_s == 600.5
    for said in ("1,200.5 s", "600,5 s", "10 min", "0:10:00", "0.98 (fraction)", "98 %", "1 200"):
        path.write_text(f"# live time: {said}\nchannel\tcounts\n{rows}")
        assert read_channels(path).live_time_s is None, said
    for said in (" [ms]: 600000", " (%): 98"):
        path.write_text(f"# live time{said}\nchannel\tcounts\n{rows}")
        assert read_channels(path).live_time_s is None, said
    same = "=600s", " 600 Real Time 612", ",600,real time,612", " in seconds: 6e2", "_s: 600"
    for said in (*same, ": 600 s (dead time 2 %)", ": 600.", " of this run: 600 s / real 650 s"):
        path.write_text(f"# live time{said}\nchannel\tcounts\n{rows}")
        assert read_channels(path).live_time_s == 600.0, said
    path.write_text(f"Live Time (s): 0\nchannel\tcounts\n{rows}")
    assert "its live time is 0 s" in refusal(read_channels, path)


GOOD = "".join(f"{i},{n:g}\n" for i, n in enumerate(peak_of(150.0)))
HEAD = "channel,counts\n"


@pytest.mark.parametrize(
    ("name", "content", "says"),
    [
        ("h.csv", "counts,channel\n" + GOOD, "the names are swapped"),
        ("h.csv", re.sub(r"(\d+),(\d+)", r"\2,\1", GOOD), "the columns are swapped"),
        ("h.csv", HEAD + GOOD[:-3] + "\n", "line 1025"),
        ("h.csv", HEAD + GOOD.replace("\n400,", "\n400,-"), "line 402: -"),
        ("h.csv", HEAD + GOOD + HEAD + GOOD, "text between rows of numbers"),
        ("h.csv", HEAD + GOOD + GOOD, "does not follow"),
        ("h.csv", HEAD + GOOD.replace("\n400,", "\nfour hundred,"), "line 402"),
        ("h.csv", HEAD + GOOD.replace("\n400,", "\n400,nan"), "line 402"),
        ("h.csv", HEAD + re.sub(r"\n400,\d+", "", GOOD), "the bin at 401 is 2 from the one before"),
        ("h.csv", HEAD + re.sub(r",(\d+)", r",\1.5", GOOD), "counts are not a number of events"),
        ("h.csv", HEAD + re.sub(r",\d+", ",0", GOOD), "all bins are empty"),
        ("h.csv", "photoelectrons,counts\n" + GOOD, "is calibrated already"),
        ("h.csv", "", "empty"),
        ("h.csv", "a laboratory's diary\n", "no row of numbers"),
        ("h.csv", "channel,counts,x\n" + GOOD.replace("\n", ",1\n"), "3 columns, not 2"),
        ("h.csv", re.sub(r"\d+,", "", GOOD), "may be counts by channel, or photoelectrons"),
        ("h.csv", "# live time: 0 s\n" + HEAD + GOOD, "its live time is 0 s"),
        ("h.spe", "$SPEC_ID:\n$DATA:\n0 1023\n", "SpecUtils finds no spectrum"),
        ("h.n42", "<?xml version='1.0'?><N42InstrumentData/>", "SpecUtils finds no spectrum"),
        ("h.mca", "\0" * 100, "SpecUtils finds no spectrum"),
        ("h.root", "a laboratory's diary", "uproot cannot read it"),
        ("h.cnf", "", "empty"),
    ],
)
def test_broken_files_are_refused_in_a_line(tmp_path, name, content, says):
    if not name.endswith(".csv"):
        pytest.importorskip("uproot" if name.endswith("root") else "SpecUtils")
    path = tmp_path / name
    path.write_text(content)
    said = refusal(read_channels, path)
    assert says in said and str(path) in said


def test_a_background_of_another_length_or_without_live_time_is_said():
    short = spectrum(peak_of(150.0)[:512], 600.0)
    for background, of, says in (
        (short, spectrum(peak_of(150.0), 600.0), "its channels are not those of the background"),
        (spectrum(peak_of(150.0)), spectrum(peak_of(150.0), 600.0), "does not say its live time"),
        (spectrum(peak_of(150.0), 600.0), spectrum(peak_of(150.0)), "give live_time_s"),
    ):
        calibration = ChannelCalibration(
            gain=TWO.gain, pedestal=TWO.pedestal, background=background
        )
        assert says in refusal(calibrated, of, calibration)
