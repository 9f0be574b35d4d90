"""Peaks of histograms: honest errors, windows, warnings, repeated mountings, files, commands."""

import math

import numpy as np
import pytest
from places import cases_of
from refusals import refusal
from scipy.optimize import curve_fit
from scipy.special import ndtr
from scipy.stats import chi2, norm, poisson

from mcrim_mitsuba.campaign.measurements import read_table
from mcrim_mitsuba.core.errors import InputError
from mcrim_mitsuba.laboratory.histogram import read_histogram
from mcrim_mitsuba.laboratory.peak import combine, fit_peak
from mcrim_mitsuba.laboratory.peak_shapes import Below, PhotonSpectrum, counting

cases = cases_of(__file__)

#: Chance of a failure where nothing is wrong, of each statistical test (two-sided).
FALSE_ALARM = 1e-3


def fit_of(spectrum, **options):
    """Fit of the expected counts."""
    return fit_peak(spectrum.photons(), spectrum.expected(spectrum.photons()), **options)


def warned(peak, text):
    return [warning for warning in peak.warnings if text in warning]


def assert_honest(fits, mean, bias):
    """Pulls of the centroids are standard normal, but for the bias that is allowed; the pulls."""
    pulls = np.array([(fit.centroid - mean) / fit.centroid_sigma for fit in fits])
    assert abs(pulls.mean()) < bias + norm.isf(FALSE_ALARM / 2) / math.sqrt(len(pulls))
    low, high = chi2.ppf([FALSE_ALARM / 2, 1 - FALSE_ALARM / 2], len(pulls) - 1)
    assert low < (len(pulls) - 1) * pulls.var(ddof=1) < high
    return pulls


# ---- the fit ---------------------------------------------------------------------------------


@pytest.mark.parametrize("mean", [14.3, 24.5])
def test_errors_are_honest_over_200_repeats(mean):
    spectrum, random = PhotonSpectrum(mean, 20_000), np.random.default_rng(2013)
    fits = [
        fit_peak(spectrum.photons(), spectrum.sample(random), shape="counting") for _ in range(200)
    ]
    pulls = assert_honest(fits, mean, bias=0.2)
    assert 0.9 < pulls.std(ddof=1) < 1.1
    # p-values are right: at most so many are below 1 % (binomial, 200 repeats)
    assert sum(fit.p_value < 0.01 for fit in fits) <= 8


@pytest.mark.parametrize("mean", [14.3, 24.5])
def test_expected_counts_give_the_mean(mean):
    peak = fit_of(PhotonSpectrum(mean), shape="counting")
    assert abs(peak.centroid - mean) < 0.1 * peak.centroid_sigma
    assert peak.chi2 < 0.1 and not peak.warnings
    assert peak.intrinsic_spread == pytest.approx(0.1, abs=0.02)
    assert peak.events == pytest.approx(20_000, rel=0.05)
    # what a Gaussian finds is the top
    assert 0.5 < mean - peak.other.centroid < 0.8
    auto = fit_of(PhotonSpectrum(mean))
    assert (auto.shape, auto.centroid, auto.warnings) == ("counting", peak.centroid, ())
    assert fit_of(PhotonSpectrum(mean), shape="gaussian").other.centroid == peak.centroid
    # dark counts are photons like others
    dark = fit_of(PhotonSpectrum(mean, dark_photons=0.3), shape="counting")
    assert abs(dark.centroid - mean - 0.3) < 0.2 * dark.centroid_sigma


BINS = np.arange(1024.0)


def low_side(step, share, kept=0.918):
    """Expected counts: 20,000 events at 500 ± 30, an escape line of 54 of 661.7 keV, a step."""
    bell = norm.pdf(BINS, 500, 30) + share * norm.pdf(BINS, 500 * kept, 30 * math.sqrt(kept))
    return 20_000 * bell + 5.0 + step * 266.0 * ndtr(-(BINS - 500) / 30)


@pytest.mark.parametrize(
    ("step", "share", "given", "plain_bias"),
    [(0.1, 0.0, None, 0.8), (0.0, 0.1, None, 2.5), (0.1, 0.1, 0.1, 3.0)],
)
def test_steps_and_escape_lines_take_the_bias_away(step, share, given, plain_bias):
    random, expected = np.random.default_rng(54), low_side(step, share)
    below = Below(((54.0, given),) if share else (), step > 0, 661.7)
    options = {"shape": "gaussian", "below": below}
    fits = [fit_peak(BINS, random.poisson(expected).astype(float), **options) for _ in range(30)]
    assert_honest(fits, 500.0, bias=0.1)
    # of expected counts
    fit = fit_peak(BINS, expected, **options)
    assert abs(fit.centroid - 500.0) < 0.1 * fit.centroid_sigma
    assert fit.step == pytest.approx(266.0 * step, abs=3.0)
    assert [line.share for line in fit.lines] == pytest.approx([share] * (share > 0), abs=0.01)
    plain = fit_peak(BINS, expected, shape="gaussian")
    assert plain.centroid < 500.0 - plain_bias * plain.centroid_sigma
    # drawn as it was fitted
    inside = (fit.low <= BINS) & (fit.high >= BINS)
    assert np.allclose(fit.counts_at(BINS[inside]), expected[inside], rtol=0.01, atol=0.5)


def test_escape_lines_of_counted_photons_and_those_that_are_not_there():
    photons = np.arange(60.0)
    full, escaped = (counting(photons, kept * 14.3, kept * 2.0, 1)[0] for kept in (1.0, 0.7))
    counts = 20_000 * (full + 0.1 * escaped) + 3.0
    below = Below(((0.3 * 59.5, 0.1), (511.0, None)), energy_keV=59.5)
    assert len(below.lines) == 1  # no quantum of 511 keV leaves 59.5 keV
    fit = fit_peak(photons, counts, shape="counting", below=below)
    assert abs(fit.centroid - 14.3) < 0.3 * fit.centroid_sigma and fit.lines[0].share == 0.1
    plain = fit_peak(photons, counts, shape="counting")
    assert plain.centroid < 14.3 - 3.0 * plain.centroid_sigma
    free = fit_peak(photons, counts, below=Below(((5.0, None),), energy_keV=59.5))
    assert warned(free, "give its share") and free.centroid_sigma > 10 * fit.centroid_sigma
    far = fit_peak(BINS, low_side(0.0, 0.0), below=Below(((511.0, None),), energy_keV=661.7))
    assert not far.lines and warned(far, "1 escape line below the fitted bins")


@pytest.mark.parametrize(
    ("pedestal", "pedestal_photons", "bias"), [(0.75, 2.5, 0.4), (3.0, 1.5, 0.8)]
)
def test_a_pedestal_that_reaches_in_makes_no_gaussian(pedestal, pedestal_photons, bias):
    spectrum = PhotonSpectrum(14.3, pedestal=pedestal, pedestal_photons=pedestal_photons)
    expected = fit_of(spectrum)
    assert abs(expected.centroid - 14.3) < bias * expected.centroid_sigma
    random = np.random.default_rng(2026)
    fits = [fit_peak(spectrum.photons(), spectrum.sample(random)) for _ in range(100)]
    # 0.3 % are narrow by chance (binomial)
    assert sum(fit.shape == "gaussian" for fit in fits) <= 3
    assert_honest(fits, 14.3, bias)


def test_a_continuum_that_ends_under_the_peak_is_said():
    """Its photons are counted too: no fit sees where it ends, but its fall is seen."""
    spectrum = PhotonSpectrum(14.3, continuum=0.0)
    photons = spectrum.photons()
    light = (np.arange(1000) + 0.5) / 1000 * 14.3
    continuum = 6000 * poisson.pmf(photons[:, None], light).mean(axis=1)
    peak = fit_peak(photons, spectrum.expected(photons) + continuum)
    assert peak.shape == "counting" and peak.p_value > 0.9
    (warning,) = peak.warnings
    assert "the background falls by 20 % of the peak's height" in warning
    # what it is said to be, and what it is
    assert "off by some 0.23 (2 %), too low if a continuum ends" in warning
    assert 14.3 - peak.centroid == pytest.approx(0.23, abs=0.03)


def test_bins_of_two_photons_have_the_same_mean():
    spectrum = PhotonSpectrum(24.5)
    photons = np.arange(80.0)
    pairs = spectrum.expected(photons).reshape(-1, 2).sum(axis=1)
    peak = fit_peak(photons[::2] + 0.5, pairs, shape="counting")
    assert abs(peak.centroid - 24.5) < 0.1 * peak.centroid_sigma
    assert peak.counts_at(photons[::2] + 0.5)[12] == pytest.approx(pairs[12], rel=0.01)


@pytest.mark.parametrize(("mean", "variance"), [(14.3, 2.0), (24.5, 0.0), (9.0, 1.5), (60, 60)])
def test_the_counting_shape_is_a_probability_with_its_derivatives(mean, variance):
    numbers = np.arange(300.0)
    chance, slopes = counting(numbers, mean, variance, 1)
    assert chance.sum() == pytest.approx(1, abs=1e-6)
    assert chance @ numbers == pytest.approx(mean, rel=1e-5)
    assert chance @ (numbers - mean) ** 2 == pytest.approx(mean + variance, rel=1e-5)
    for slope, step in zip(slopes, ((1e-4, 0.0), (0.0, 1e-4)), strict=True):
        there, _ = counting(numbers, mean + step[0], variance + step[1], 1)
        assert (there - chance) / 1e-4 == pytest.approx(slope, abs=2e-5)


def test_a_million_photons_are_counted_as_hundreds_are():
    """Sums of as many chances took minutes; where they end, the two ways say the same."""
    bins = np.arange(4.96e5, 5.04e5, 50.0)
    below, above = (counting(bins, 5e5, 5e5 + step, 50) for step in (-1.0, 1.0))
    for summed, gaussian in zip((below[0], *below[1]), (above[0], *above[1]), strict=True):
        assert summed == pytest.approx(gaussian, abs=2e-3 * np.abs(summed).max())
    photons = np.arange(0.0, 2e6, 1000.0)
    expected = 5e4 * counting(photons, 9e5, 3e4**2, 1000)[0] * 1000
    counts = np.random.default_rng(3).poisson(expected).astype(float)
    peak = fit_peak(photons, counts, shape="counting", photoelectrons=True)
    assert abs(peak.centroid - 9e5) < 3 * peak.centroid_sigma < 1200


def test_a_gaussian_peak_is_found_beside_pedestal_and_escape_peak():
    photons = np.arange(0.25, 80, 0.5)

    def bell(events, mean, width):
        return events * 0.5 * np.exp(-(((photons - mean) / width) ** 2) / 2) / (2.5066 * width)

    expected = bell(4e4, 1, 0.8) + bell(9e3, 18, 4.2) + bell(2e4, 40, 6) + 10
    counts = np.random.default_rng(3).poisson(expected).astype(float)
    peak = fit_peak(photons, counts)
    assert (peak.shape, peak.other) == ("gaussian", None)
    # 40 with a width of 6: the bins do not say that these are no photoelectrons
    assert len(peak.warnings) == 1 and warned(peak, "the mean lies some 0.43 (1 %) higher")
    assert abs(peak.centroid - 40) < 4 * peak.centroid_sigma < 0.6
    assert abs(peak.width - 6) < 4 * peak.width_sigma
    # flat noise has no peak
    assert fit_peak(photons, np.random.default_rng(4).poisson(20, 160).astype(float)) is None


def test_numbers_that_cannot_be_photons_are_said():
    numbers = np.arange(60.0)
    bell = 2e4 * np.exp(-(((numbers - 25) / 4) ** 2) / 2) / (2.5066 * 4) + 20
    peak = fit_peak(numbers, np.random.default_rng(5).poisson(bell).astype(float))
    assert peak.shape == "gaussian" and peak.other.shape == "counting"
    assert abs(peak.centroid - 25) < 4 * peak.centroid_sigma
    assert warned(peak, "its bins are no photon numbers")
    # whoever names a shape has chosen
    for shape in ("counting", "gaussian"):
        forced = fit_peak(numbers, bell.round(), shape=shape)
        assert forced.shape == shape and not warned(forced, "photon numbers")


def test_a_gaussian_that_fits_better_is_only_said():
    numbers = np.arange(80.0)
    bell = 2e6 * np.exp(-(((numbers - 40) / 8) ** 2) / 2) / (2.5066 * 8) + 20
    peak = fit_peak(numbers, bell.round())
    assert peak.shape == "counting" and peak.p_value < 0.01 < peak.other.p_value
    assert warned(peak, f"centroid of 40 instead of {peak.centroid:.4g}")


def test_peaks_of_odd_histograms_do_not_fail():
    odd = [np.zeros(20), np.eye(20)[7] * 1e6, np.arange(20.0), np.arange(20.0)[::-1] * 1e9]
    odd += [np.random.default_rng(i).poisson(0.3, 20).astype(float) for i in range(20)]
    for counts in odd:
        for window in (None, (2.0, 17.0)):
            peak = fit_peak(np.arange(20.0), counts, window=window)
            if peak is not None:
                assert 0 <= peak.centroid <= 19 and 0 <= peak.centroid_sigma < math.inf
                assert np.all(np.isfinite(peak.counts_at(np.arange(20.0))))


# ---- windows and warnings --------------------------------------------------------------------


def test_a_window_is_taken_as_given():
    spectrum = PhotonSpectrum(24.5)
    for window in ((10.0, 45.0), (14.5, 38.2)):
        peak = fit_of(spectrum, window=window, shape="counting")
        assert (peak.low, peak.high) == (math.ceil(window[0]), math.floor(window[1]))
        assert abs(peak.centroid - 24.5) < 0.6 * peak.centroid_sigma
    # there is no peak
    assert fit_of(spectrum, window=(48.0, 60.0)) is None


@cases("options", "says")
def test_windows_and_shapes_that_cannot_be_are_refused(options, says):
    assert says in refusal(fit_of, PhotonSpectrum(14.3), **options)


def test_counting_needs_whole_numbers():
    spectrum = PhotonSpectrum(14.3)
    photons, counts = spectrum.photons(), spectrum.expected(spectrum.photons())
    with pytest.raises(InputError, match="not of whole photon numbers"):
        fit_peak(1.3 * photons, counts, shape="counting")
    halves = fit_peak(photons + 0.5, counts)
    assert halves.shape == "gaussian" and warned(halves, "0.5 too high")


def test_a_peak_that_is_cut_is_said():
    photons = np.arange(18.0)
    short = fit_peak(photons, PhotonSpectrum(14.3).expected(photons))
    assert warned(short, "cut by the end of the histogram") and short.high == 17
    photons = np.arange(49.0)
    counts = PhotonSpectrum(14.3).expected(photons)
    threshold = fit_peak(photons[11:], counts[11:])
    assert warned(threshold, "cut by the end of the histogram")
    window = fit_peak(photons, counts, window=(12.0, 30.0))
    assert warned(window, "cut by the window")
    # nothing is below no photon
    weak = PhotonSpectrum(3.0, pedestal=0.0)
    assert not warned(fit_of(weak, shape="counting"), "cut")


def test_merged_peaks_are_said():
    # the pedestal reaches into the peak, which then looks like a Gaussian
    low = fit_of(PhotonSpectrum(9.0, pedestal_photons=2.0))
    assert warned(low, "merged with what lies below") and low.shape == "counting"
    assert abs(low.centroid - 9) < 0.1
    photons = np.arange(80.0)
    first = PhotonSpectrum(30.0).expected(photons)
    merged = fit_peak(
        photons, first + PhotonSpectrum(52.0, 15_000, pedestal=1.0, continuum=0.2).expected(photons)
    )
    assert warned(merged, "merged with what lies above")
    apart = PhotonSpectrum(14.3).expected(photons) + PhotonSpectrum(44.0).expected(photons)
    assert not fit_peak(photons, apart).warnings


def test_poor_and_bad_fits_are_said():
    few = PhotonSpectrum(14.3, 300)
    poor = fit_peak(few.photons(), few.sample(4))
    assert warned(poor, "poor, some") and poor.centroid_sigma > 0.02 * poor.centroid
    rich = PhotonSpectrum(14.3, 2e6, pedestal=0.0075, continuum=0.0015)
    counts = rich.expected(rich.photons())
    counts[::2] *= 1.03
    bad = fit_peak(rich.photons(), counts, shape="counting")
    assert warned(bad, "the fit is bad") and bad.p_value < 0.01
    good = fit_of(rich, shape="counting")
    assert not good.warnings
    assert bad.centroid_sigma == pytest.approx(
        math.sqrt(bad.chi2 / bad.ndf) * good.centroid_sigma, rel=0.05
    )


# ---- repeated mountings ----------------------------------------------------------------------


def test_the_error_of_a_mean_is_the_larger():
    scattered = combine([14.1, 14.5, 14.0, 14.6], [0.07] * 4)
    assert scattered.mean == pytest.approx(14.3)
    assert scattered.sigma == scattered.scatter_sigma == pytest.approx(0.29439 / 2, rel=1e-4)
    assert scattered.internal_sigma == pytest.approx(0.035)
    # mountings scatter: no fault
    assert scattered.p_value < 1e-6 and scattered.consistent and not scattered.warnings
    alike = combine([14.30, 14.31], [0.1, 0.1])
    assert alike.sigma == alike.internal_sigma == pytest.approx(0.1 / math.sqrt(2))
    assert (alike.ndf, alike.p_value > 0.9, alike.consistent) == (1, True, True)
    # 1 / sqrt(2 (n - 1))
    assert "the scatter of only 2 values is itself known to 71 %" in alike.warnings[0]
    three = combine([14.1, 14.5, 14.3], [0.07] * 3)
    assert three.consistent and "known to 50 %" in three.warnings[0]
    one = combine([14.3], [0.2])
    assert (one.mean, one.sigma, one.scatter_sigma, one.p_value) == (14.3, 0.2, None, None)
    for values, sigmas in (([], []), ([1.0], [0.0]), ([1.0], [1.0, 1.0]), ([math.nan], [1.0])):
        with pytest.raises(InputError):
            combine(values, sigmas)


def test_an_inconsistent_set_is_flagged():
    outlier = combine([14.30, 14.32, 14.31, 15.6], [0.02] * 4)
    assert outlier.outliers == (3,) and not outlier.consistent
    assert "value 4, 15.6, is an outlier" in outlier.warnings[0]
    # with large errors it is none
    assert combine([14.30, 14.32, 14.31, 15.6], [0.8] * 4).consistent
    mixed = combine([14.3, 24.5], [0.1, 0.1])
    assert not mixed.consistent and mixed.outliers == ()
    assert "are they all of one configuration?" in mixed.warnings[0]
    both = combine([14.2, 14.4, 24.4, 24.6], [0.1] * 4)
    assert not both.consistent


@pytest.mark.parametrize("count", [3, 4, 8])
def test_outliers_are_rarely_called_so_by_mistake(count):
    """1 % of 500 sets at most (binomial, 0.1 %)."""
    random = np.random.default_rng(count)
    values = 14.3 + random.normal(0, 0.4, (500, count))
    alarms = sum(not combine(set_, [0.07] * count).consistent for set_ in values)
    assert alarms <= 13


def test_synthetic_histograms_have_the_mean_that_they_say():
    spectrum = PhotonSpectrum(14.3, 1e5, 0.1, 0.0, continuum=0.0, dark_photons=0.5)
    photons = spectrum.photons()
    expected = spectrum.expected(photons)
    assert expected.sum() == pytest.approx(1e5, rel=1e-6)
    assert expected @ photons / 1e5 == pytest.approx(14.8, rel=1e-6)
    variance = 14.3 + 1.43**2 + 0.5
    assert expected @ (photons - 14.8) ** 2 / 1e5 == pytest.approx(variance, rel=1e-4)
    assert np.array_equal(spectrum.sample(3), spectrum.sample(3))
    events = spectrum.events(3)
    assert np.array_equal(
        np.bincount(events.astype(int), minlength=len(photons)), spectrum.sample(3)
    )
    with_pedestal = PhotonSpectrum(14.3).expected(np.arange(400.0))
    assert with_pedestal.sum() == pytest.approx(38_000, rel=1e-6)


@cases("numbers")
def test_spectra_that_cannot_be_are_refused(numbers):
    with pytest.raises(InputError):
        PhotonSpectrum(**numbers)


# ---- files -----------------------------------------------------------------------------------

GOOD = "".join(f"{i},{i * (20 - i)}\n" for i in range(20))


@cases(
    "text",
    "says",
    more=[
        (GOOD.replace("\n5,75\n", "\n"), "line 6: the bin at 6 is 2 from the one before, not 1"),
        ("n,m,k\n" + GOOD.replace(",", ",1,"), "line 2: 3 columns, not 2"),
        ("3\n5\n" * 200, "fill 3 bins"),
        ("3\n500000\n" * 200, "fill 499998 bins"),
        ("3\n5\n" * 200 + "-1\n", "line 401: -1 photons in an event"),
        ("0.25\n" * 400, "fill 0 bins"),
        ("1e30\n3\n" * 200, "line 1, column bin centre: 1e+30 is too large"),
        ("14,3\n9,1\n16,2\n" * 200, "a list of events with decimal commas"),
    ],
)
def test_histograms_that_cannot_be_used_are_refused(tmp_path, text, says):
    path = tmp_path / "h.csv"
    path.write_text(text.replace("GOOD", GOOD))
    refused = refusal(read_histogram, path)
    assert says in refused and str(path) in refused


@pytest.mark.parametrize(
    "content",
    [
        GOOD.encode(),
        GOOD.replace(",", "  ").encode(),
        (
            "\ufeff# from the counter\r\nphotons;events\r\n"
            + GOOD.replace(",", ",0;").replace("\n", "\r\n")
        ).encode(),
        ("sep=;\r\nphotons;events\r\n" + GOOD.replace(",", ";")).encode("utf-16"),
        ("Live time 600 s\nphotons\tcounts\n" + GOOD.replace(",", "\t")).encode(),
        "".join(
            sorted(GOOD.splitlines(keepends=True), key=lambda row: -int(row.split(",")[0]))
        ).encode(),
    ],
    ids=["csv", "blanks", "excel", "unicode text", "tabs", "descending"],
)
def test_histograms_are_read_as_programs_write_them(tmp_path, content):
    path = tmp_path / "h.txt"
    path.write_bytes(content)
    histogram = read_histogram(path)
    assert np.array_equal(histogram.photons, np.arange(20.0))
    assert np.array_equal(histogram.counts, np.arange(20.0) * (20 - np.arange(20.0)))


def test_lists_of_events_are_sorted_into_bins(tmp_path):
    spectrum = PhotonSpectrum(14.3, 2000)
    path = tmp_path / "events.txt"
    path.write_text("photons\n" + "".join(f"{n:g}\n" for n in spectrum.events(8)))
    read, counts = read_histogram(path), spectrum.sample(8)
    assert read.photons[0] == 0 and read.photons[1] == 1
    assert np.array_equal(read.counts, counts[: len(read.counts)])
    # Freedman and Diaconis: 2 IQR / n^(1/3)
    values = np.random.default_rng(1).normal(40, 6, 8000)
    path.write_text("charge\n" + "".join(f"{value:.6f}\n" for value in values))
    read = read_histogram(path)
    low, high = np.percentile(values, (25, 75))
    assert read.photons[1] - read.photons[0] == pytest.approx(2 * (high - low) / 20, rel=1e-4)
    assert read.counts.sum() == 8000
    peak = fit_peak(read.photons, read.counts)
    assert abs(peak.centroid - 40) < 4 * peak.centroid_sigma < 0.8
    # steps of the electronics make no comb
    path.write_text("charge\n" + "".join(f"{0.25 * round(4 * value):.2f}\n" for value in values))
    read = read_histogram(path)
    assert read.photons[1] - read.photons[0] == pytest.approx(0.75)
    assert fit_peak(read.photons, read.counts).p_value > 0.001


# ---- what is no histogram, counted twice, or leans -------------------------------------------


def test_a_band_of_photoelectrons_leans():
    def lean(peak):
        (said,) = warned(peak, "the Gaussian finds its top, and the mean lies some")
        return float(said.split("lies some ")[1].split()[0])

    # the counting model on an axis of another unit
    for mean, gain in ((14.94, 1.3), (14.94, 0.37), (24.5, 2.7)):
        spectrum = PhotonSpectrum(mean)
        expected = spectrum.expected(spectrum.photons())
        peak = fit_peak(gain * spectrum.photons(), expected)
        assert peak.shape == "gaussian" and mean - peak.centroid / gain > 0.5
        assert (peak.centroid + lean(peak)) / gain == pytest.approx(mean, rel=0.005)
    # charges of photoelectrons that vary by 30 %: somewhat more
    random = np.random.default_rng(14)
    photons = random.poisson(14.94 * random.normal(1, 0.1, 400_000))
    charge = photons + 0.3 * np.sqrt(photons) * random.normal(size=len(photons))
    edges = np.arange(0.0, 40.0, 0.5)
    peak = fit_peak(edges[:-1] + 0.25, np.histogram(charge, edges)[0].astype(float))
    assert 0.65 * (14.94 - peak.centroid) < lean(peak) < 14.94 - peak.centroid
    assert warned(peak, "or more where the charge of a single one varies")
    narrow = 1000 * norm.pdf(np.arange(0.25, 80, 0.5), 50, 1)
    assert not fit_peak(np.arange(0.25, 80, 0.5), np.round(narrow)).warnings


def test_columns_that_are_no_histogram_are_refused(tmp_path):
    path = tmp_path / "h.csv"
    for header, says in (
        ("nm,intensity", "the first column, nm, is not what an event gave"),
        ("wavelength_nm,counts", "the first column, wavelength"),
        ("time (s),photons", "the first column, time"),
        ("trigger,amplitude", "list of numbered events; keep the column amplitude alone"),
        ("No.,n_pe", "the second column, n_pe"),
        ("n,charge (pC)", "the second column, charge"),
    ):
        path.write_text(f"{header}\n{GOOD}")
        assert says in refusal(read_histogram, path)
    for header in ("photons,intensity", "charge (pC),entries", "n_pe,N", "x,pulses"):
        path.write_text(f"{header}\n{GOOD}")
        assert len(read_histogram(path).photons) == 20


@pytest.mark.parametrize("mean", [14.3, 24.5])
def test_numbered_events_are_no_histogram(tmp_path, mean):
    path = tmp_path / "h.csv"
    events = PhotonSpectrum(mean, 2000).events(3)
    for header, count in (("", 300), ("", len(events)), ("No.,N\n", len(events))):
        path.write_text(header + "".join(f"{i},{n:g}\n" for i, n in enumerate(events[:count])))
        with pytest.raises(InputError, match="in no order: this looks like a list of numbered"):
            read_histogram(path)
    # a histogram of many bins is one, be it poor or of uneven bins, with a pedestal in one bin
    random, bins = np.random.default_rng(5), np.arange(4096.0)
    shape = 20 * norm.pdf(bins, 2000, 200) * 501 + 5 * np.exp(-bins / 300)
    shape[0] = 1e5
    for scale, uneven in ((1, 0), (1, 0.2), (100, 0.1)):
        counts = random.poisson(scale * shape * np.abs(random.normal(1, uneven, len(bins))))
        path.write_text("".join(f"{i:g},{n}\n" for i, n in zip(bins, counts, strict=True)))
        assert len(read_histogram(path).counts) == 4096


@pytest.mark.parametrize("width", [0.1, 1.0, 5.0])
def test_a_pedestal_far_away_makes_no_wide_bins(tmp_path, width):
    random = np.random.default_rng(12)
    events = np.concatenate([random.normal(50, width, 20_000), random.exponential(3, 10_000)])
    path = tmp_path / "events.txt"
    path.write_text("charge\n" + "".join(f"{event:.4f}\n" for event in events))
    read = read_histogram(path)
    assert read.photons[1] - read.photons[0] < 0.6 * width
    assert read.counts.sum() == 30_000
    peak = fit_peak(read.photons, read.counts)
    assert abs(peak.centroid - 50) < 4 * peak.centroid_sigma
    assert abs(peak.width - width) < 4 * peak.width_sigma < 0.2 * width


def test_the_same_mounting_twice_is_refused(here, mcrim):
    mcrim.shown("lab", "histogram", "--mean", "14.3", "-o", "a.csv")
    (here / "link.csv").symlink_to("a.csv")
    (here / "copy.csv").write_bytes((here / "a.csv").read_bytes())
    for other, says in (
        ("link.csv", "link.csv: the file is given twice"),
        ("copy.csv", "copy.csv: it holds the same bytes as a.csv; name each mounting once"),
    ):
        assert says in mcrim.refused("lab", "peak", "a.csv", other)
    for name, says in (
        ("./a.csv", "a.csv is named on line 2 already"),
        ("link.csv", "link.csv is named on line 2 already"),
        ("copy.csv", "copy.csv holds the same bytes as a.csv on line 2"),
    ):
        (here / "m.csv").write_text(f"label,histogram\nair,a.csv\ngel,{name}\n")
        refused = refusal(read_table, here / "m.csv", {})
        assert "line 3, column histogram" in refused and says in refused


def test_a_peak_that_is_missing_and_one_that_does_not_belong_are_said(here, mcrim):
    for mean, name in (("14.3", "h.csv"), ("40", "gel.csv")):
        mcrim.shown("lab", "histogram", "--mean", mean, "-o", name)
    (here / "flat.csv").write_text("".join(f"{i},50\n" for i in range(40)))
    # the other's peak is shown
    status, _, error = mcrim("lab", "peak", "flat.csv", "h.csv")
    assert status == 2 and "flat.csv: no peak stands out; measure longer" in error
    assert error.count("\n") == 1
    assert "the set is inconsistent" in mcrim.shown("lab", "peak", "h.csv", "gel.csv")
    for lines in ("0.0595,0.511", "511,511", "0"):
        said = mcrim.refused("lab", "peak", "h.csv", "--lines", lines)
        assert "are no energies; give each once, in keV, not MeV" in said


def test_own_histograms_are_replaced(here, mcrim):
    made = ["lab", "histogram", "--mean", "14", "-o", "x.csv", "--spread"]
    mcrim.shown(*made, "0.1")
    first = (here / "x.csv").read_text()
    mcrim.shown(*made, "10%")
    assert (here / "x.csv").read_text() == first


def test_how_far_below_the_mean_a_gaussian_lies():
    """Counted photons of the mean 14.3 whose mean varies by 6 %, without noise.

    0.3 to 0.4 photons within 1.5 widths; 0.6 with a straight background that is fitted too.
    """
    numbers, mean, spread = np.arange(60), 14.3, 0.06
    deviations = np.linspace(-4, 4, 801)
    weights = norm.pdf(deviations) / norm.pdf(deviations).sum()
    expected = poisson.pmf(numbers[:, None], mean * (1 + spread * deviations)) @ weights * 1e6
    half = 1.5 * math.hypot(math.sqrt(mean), spread * mean)
    used = abs(numbers - mean) <= half
    x, y = numbers[used], expected[used]

    def gaussian(x, height, top, width):
        return height * np.exp(-0.5 * ((x - top) / width) ** 2)

    fitted, _ = curve_fit(gaussian, x, y, [y.max(), mean, 4.0], sigma=np.sqrt(y))
    assert 0.3 < mean - fitted[1] < 0.4
    with_background = fit_peak(numbers.astype(float), np.round(expected), shape="gaussian")
    assert 0.5 < mean - with_background.centroid < 0.7
