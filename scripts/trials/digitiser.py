"""Are photoelectrons that come of a digitiser's channels right, and their errors honest?

    python scripts/trials digitiser [--repeats 500] [--json FILE]

Five kinds of trials, with pulls, a deviation in its own errors, whose mean should be 0 and whose
standard deviation 1:

- single photoelectrons of silicon and of tubes: mean 0.3 to 3, gain 10 to 100 channels, crosstalk 0
  to 20 %, spread 5 to 12 % (resolved) or 30 to 50 % of the gain (not resolved), noise 6 to 12 %;
- peaks on a background that is subtracted, signal to background 5 to 0.5 within the peak;
- pairs of peaks alike, from which one background run is subtracted, a third as long as they are:
  their difference and their sum, with the covariance that its noise makes;
- peaks on a continuum that ends under them, with a line of events that lost 54 of 661.7 keV, both a
  tenth of the peak;
- campaigns from channels to the light yield: six spectra, a run in the dark, single photoelectrons,
  a background, all drawn anew; is the true light yield within two errors?

Cascades of crosstalk are drawn cell by cell (Borel), not from the law that is fitted.
"""

from __future__ import annotations

import math
import tempfile
from itertools import chain
from pathlib import Path

import click
import numpy as np
from scipy.special import ndtr

from mcrim_mitsuba.cli import options, terminal
from mcrim_mitsuba.core.rounding import pdg
from mcrim_mitsuba.laboratory.calibration import (
    ChannelCalibration,
    Gain,
    calibrated,
    combined_photons,
    fit_histogram,
)
from mcrim_mitsuba.laboratory.digitiser import ChannelSpectrum
from mcrim_mitsuba.laboratory.peak import fit_peak
from mcrim_mitsuba.laboratory.peak_shapes import Below
from mcrim_mitsuba.laboratory.single_photoelectron import Pedestal, fit_single_photoelectrons
from mcrim_mitsuba.output.description import table
from trials.executor import Trial, Trials, executor_options
from trials.truth import do_missing

SCENE = Path(__file__).resolve().parents[2] / "scenes" / "camoo4.xml"
BLOCK = 10
EVENTS = 50_000
SIGNAL_TO_BACKGROUND = (5.0, 2.0, 1.0, 0.5)
LIVE_TIME_S, BACKGROUND_S = 600.0, 900.0
#: Of campaigns: true coefficients, 1/cm, photons per keV, and what turns them into channels.
ALPHA_SCAT, ALPHA_ABS, ABS_SIGMA = 0.5, 0.04, 0.006
LIGHT_YIELD, ENERGY_KEV, EFFICIENCY = 25.0, 661.7, 0.2
GAIN, RANGE_RATIO, RATIO_SIGMA, PEDESTAL = 45.0, 25.0, 0.075, 100.0
SILICON, TUBE = "resolved", "not-resolved"
COMMON, BELOW = "common-background", "step-and-escape"


def single_photoelectrons(
    random: np.random.Generator,
    mean: float,
    gain: float,
    crosstalk: float,
    spread: float,
    noise: float,
    events: int = EVENTS,
) -> np.ndarray:
    """Counts by channel of a few photoelectrons; spread and noise are parts of the gain."""
    fired = random.poisson(mean, events)
    total, last = fired.copy(), fired
    while last.any():
        last = random.poisson(-math.log1p(-crosstalk) * last)
        total += last
    widths = gain * np.sqrt(noise**2 + total * spread**2)
    charge = PEDESTAL + gain * total + widths * random.normal(size=events)
    return counts_of(charge)


def counts_of(charge: np.ndarray, channels: int | None = None) -> np.ndarray:
    """Counts by channel; a channel's middle is its number."""
    numbers = np.floor(charge + 0.5).astype(int)
    counts = np.bincount(numbers[numbers >= 0], minlength=channels or 0)
    return counts[:channels].astype(float)


def spectrum(counts: np.ndarray, live_time_s: float | None = None) -> ChannelSpectrum:
    """A spectrum that no file holds."""
    channels = np.arange(len(counts), dtype=float)
    return ChannelSpectrum(Path("drawn"), (), channels, counts, live_time_s=live_time_s)


def light(random: np.random.Generator, mean: float, spread: float, per_photoelectron: float):
    """Charges of a peak of photoelectrons whose mean number varies by a part of it."""
    photoelectrons = random.poisson(random.normal(mean, spread * mean, 20_000))
    noise = 0.3 * np.sqrt(photoelectrons) * random.normal(size=len(photoelectrons))
    return PEDESTAL + per_photoelectron * (photoelectrons + noise)


def background(channels: int, scale: float) -> np.ndarray:
    """Expected counts of a background: a fall, and a line of its own."""
    channel = np.arange(channels)
    line = 0.2 * np.exp(-0.5 * ((channel - 0.55 * channels) / (0.04 * channels)) ** 2)
    return scale * (np.exp(-channel / (0.3 * channels)) + line)


def fit_photoelectrons(kind: str, seed: int, number: int) -> list[list[float]]:
    """Pulls of gain, mean and crosstalk of a block, and p."""
    random = np.random.default_rng((seed, number, kind == SILICON))
    pulls = []
    for _ in range(BLOCK):
        mean, gain = random.uniform(0.3, 3.0), random.uniform(10.0, 100.0)
        crosstalk, noise = random.uniform(0.0, 0.2), random.uniform(0.06, 0.12)
        spread = random.uniform(0.05, 0.12) if kind == SILICON else random.uniform(0.3, 0.5)
        drawn = spectrum(single_photoelectrons(random, mean, gain, crosstalk, spread, noise))
        fit = fit_single_photoelectrons(drawn.channels, drawn.counts, crosstalk=True)
        pulls.append(
            [
                (fit.gain - gain) / fit.gain_sigma,
                (fit.mean - mean) / fit.mean_sigma,
                (fit.crosstalk - crosstalk) / fit.crosstalk_sigma,
                fit.p_value,
            ]
        )
    return pulls


def fit_subtracted(kind: str, seed: int, number: int) -> list[list[float]]:
    """Pulls of a peak's centroid on a background that is subtracted."""
    random, ratio = np.random.default_rng((seed, number, round(10 * float(kind)))), float(kind)
    mean, channels, per_photoelectron = 450.0, 2048, 2.0
    pulls = []
    for _ in range(BLOCK):
        peak = counts_of(light(random, mean, 0.045, per_photoelectron), channels)
        near = np.abs(np.arange(channels) - PEDESTAL - mean * per_photoelectron) < 100
        under = background(channels, 1.0)
        under *= peak[near].sum() / ratio / under[near].sum()
        seen = spectrum(peak + random.poisson(under), LIVE_TIME_S)
        dark = random.poisson(under * BACKGROUND_S / LIVE_TIME_S).astype(float)
        calibration = ChannelCalibration(
            gain=Gain(value=per_photoelectron, sigma=0.0),
            pedestal=Pedestal(PEDESTAL, 0.0),
            background=spectrum(dark, BACKGROUND_S),
        )
        fit = fit_histogram(calibrated(seen, calibration))
        pulls.append([(fit.centroid - mean) / fit.centroid_sigma, fit.p_value])
    return pulls


def fit_common(kind: str, seed: int, number: int) -> list[list[float]]:
    """Pulls of difference and sum of two peaks alike that share a background's run."""
    random, pulls = np.random.default_rng((seed, number, 4)), []
    under = 400.0 * background(512, 1.0)
    peak = (
        8000.0
        / (18.5 * math.sqrt(2.0 * math.pi))
        * np.exp(-0.5 * ((np.arange(512) - 300.0) / 18.5) ** 2)
    )
    for _ in range(BLOCK):
        calibration = ChannelCalibration(
            gain=Gain(value=1.0, sigma=0.0),
            pedestal=Pedestal(PEDESTAL, 0.0),
            background=spectrum(random.poisson(under / 3).astype(float), LIVE_TIME_S / 3),
        )
        seen = [spectrum(random.poisson(under + peak).astype(float), LIVE_TIME_S) for _ in range(2)]
        histograms = [calibrated(one, calibration) for one in seen]
        fits = [fit_histogram(one, shape="gaussian") for one in histograms]
        means, owns, noises = zip(
            *(combined_photons([one]) for one in zip(histograms, fits, strict=True)), strict=True
        )
        covariance = np.diag(np.square(owns)) + np.array(noises) @ np.array(noises).T
        off = np.array([mean.mean - 200.0 for mean in means])
        signs = np.array([[1.0, -1.0], [1.0, 1.0]])
        sigmas = np.sqrt(np.einsum("ij,jk,ik->i", signs, covariance, signs))
        pulls.append([*(signs @ off / sigmas), fits[0].p_value])
    return pulls


def fit_below(kind: str, seed: int, number: int) -> list[list[float]]:
    """Pulls of the centroid of a peak with a step and an escape line below it."""
    random, channels = np.random.default_rng((seed, number, 5)), np.arange(1024.0)
    kept = 1.0 - 54.0 / 661.7
    widths = 30.0, 30.0 * math.sqrt(kept)
    full, escaped = (
        np.exp(-0.5 * ((channels - 500.0 * part) / width) ** 2) / (width * math.sqrt(2 * math.pi))
        for part, width in zip((1.0, kept), widths, strict=True)
    )
    events = 20_000.0 * (full + 0.1 * escaped)
    expected = events + 0.1 * 20_000.0 * full.max() * ndtr((500.0 - channels) / 30.0) + 5.0
    below, pulls = Below(((54.0, None),), True, 661.7), []
    for _ in range(BLOCK):
        fit = fit_peak(
            channels, random.poisson(expected).astype(float), shape="gaussian", below=below
        )
        pulls.append([(fit.centroid - 500.0) / fit.centroid_sigma, fit.p_value])
    return pulls


def fit_campaigns(kind: str, seed: int, number: int, eta: list[float]) -> list[list[float]]:
    """Pulls of the light yield and of the ratio of two readings of campaigns in channels."""
    import mcrim_mitsuba as mcrim

    pulls = []
    for place in range(BLOCK):
        random = np.random.default_rng((seed, number, place))
        with tempfile.TemporaryDirectory() as name:
            path = write_campaign(Path(name), random, eta)
            fit = mcrim.calibrate(path, photons=2**20, seed=1 + number)
        found = fit.parameters["light_yield_ph_per_keV"]
        first, *_, last = fit.rows
        ratio = first.measured / last.measured
        errors = math.hypot(first.sigma / first.measured, last.sigma / last.measured)
        true = eta[0] / eta[-1]
        pulls.append(
            [(found.value - LIGHT_YIELD) / found.sigma, (ratio / true - 1.0) / errors, fit.p_value]
        )
    return pulls


#: Configurations of a campaign: the coupling's index, the crystal's height in mm.
CONFIGURATIONS = [(n_gap, height) for height in (10.0, 5.0) for n_gap in (1.0, 1.3, 1.46)]


def true_eta() -> list[float]:
    """Efficiencies of the configurations, by a simulation of their own."""
    import mcrim_mitsuba as mcrim

    true = {"alpha_scat_per_cm": ALPHA_SCAT, "alpha_abs_per_cm": ALPHA_ABS}
    scene = mcrim.read_scene(SCENE)
    return [
        float(
            mcrim.simulate(
                scene, n_gap=n_gap, crystal_height_mm=height, **true, photons=2**24, seed=1000
            ).eta
        )
        for n_gap, height in CONFIGURATIONS
    ]


def write_campaign(
    folder: Path,
    random: np.random.Generator,
    eta: list[float],
    configurations: list[tuple[float, float]] = CONFIGURATIONS,
) -> Path:
    """A campaign of spectra of 4,096 channels, and all that calibrates them."""
    channels = 4096

    def write(name: str, counts: np.ndarray, seconds: float | None = None) -> None:
        head = f"# live time: {seconds:g} s\n" if seconds else ""
        rows = "".join(f"{i},{n:g}\n" for i, n in enumerate(counts))
        (folder / name).write_text(f"{head}channel,counts\n{rows}")

    per_photoelectron = GAIN / RANGE_RATIO
    noise = PEDESTAL + random.normal(0.0, 3.0, 20_000)
    write("dark.csv", counts_of(noise, channels))
    few = single_photoelectrons(random, 0.8, GAIN, 0.0, 0.1, 0.09)
    write("few.csv", few)
    under = background(channels, 4.0)
    write("room.csv", random.poisson(under * BACKGROUND_S / LIVE_TIME_S), BACKGROUND_S)
    rows = ["label,histogram,n_gap,crystal_height_mm"]
    scale = LIGHT_YIELD * ENERGY_KEV * EFFICIENCY
    for place, ((n_gap, height), of_bench) in enumerate(zip(configurations, eta, strict=True)):
        peak = light(random, scale * of_bench, 0.03, per_photoelectron)
        counts = counts_of(peak, channels) + random.poisson(under)
        write(f"{place}.csv", counts, LIVE_TIME_S)
        rows.append(f"reading {place},{place}.csv,{n_gap},{height}")
    (folder / "readings.csv").write_text("\n".join(rows) + "\n")
    known = random.normal(ALPHA_ABS, ABS_SIGMA)
    ratio = random.normal(RANGE_RATIO, RATIO_SIGMA)
    path = folder / "campaign.toml"
    path.write_text(f"""
scene = "{SCENE}"
measurements = "readings.csv"
[parameters.alpha_scat_per_cm]
start = 0.6
min = 0.1
max = 3.0
[parameters.alpha_abs_per_cm]
start = {known:.5f}
prior = {known:.5f}
prior_sigma = {ABS_SIGMA}
[calibration]
single_photoelectron = "few.csv"
pedestal = "dark.csv"
range_ratio = {ratio:.5f}
range_ratio_sigma = {RATIO_SIGMA}
background = "room.csv"
[light_yield]
energy_keV = {ENERGY_KEV}
detector_efficiency = {EFFICIENCY}
efficiency_of = "inside the window"
[tolerances]
none = true
""")
    return path


@click.command()
@click.option("--repeats", default=500, show_default=True, type=click.IntRange(BLOCK))
@click.option("--campaigns", default=100, show_default=True, type=click.IntRange(0))
@options.seed
@options.json_output
@executor_options
def main(repeats: int, campaigns: int, seed: int, json_file: str | None, executor, log) -> int:
    """Means and widths of the pulls: single photoelectrons, subtracted peaks, light yields."""
    screen = terminal.console(json_file)
    kinds = {
        **dict.fromkeys((SILICON, TUBE), (repeats // 2, fit_photoelectrons)),
        **{f"{ratio:g}": (2 * repeats // 20, fit_subtracted) for ratio in SIGNAL_TO_BACKGROUND},
        COMMON: (2 * repeats // 5, fit_common),
        BELOW: (repeats, fit_below),
        "campaign": (campaigns, fit_campaigns),
    }
    eta = true_eta() if campaigns else []
    rows = []
    for kind, (count, function) in kinds.items():
        wanted = [Trial(kind, block) for block in range(math.ceil(count / BLOCK))]
        trials = Trials(f"digitiser-{kind}", {"seed": seed}, wanted, [Path(__file__)], executor)
        further = (eta,) if function is fit_campaigns else ()
        arguments = {one: (kind, seed, one.number, *further) for one in trials.missing}
        ended = do_missing(screen, "digitiser", trials, function, arguments, log)
        if ended is not None:
            return ended
        found = np.array(list(chain(*(trials.results[one] for one in wanted))), float)
        rows += judge(kind, found) if len(found) else []
    terminal.write_json(json_file, {"rows": rows, "repeats": repeats, "seed": seed})
    head = ("trials", "of", "number", "mean pull", "pull width", "within 2", "p < 1 %")
    cells = [
        (
            row["kind"],
            row["of"],
            row["number"],
            pdg(row["mean"], row["mean_error"]),
            pdg(row["width"], row["width_error"]),
            f"{100 * row['within']:.1f} %",
            f"{100 * row['bad']:.1f} %",
        )
        for row in rows
    ]
    screen.show(table("from channels to photoelectrons", head, cells))
    return terminal.DONE


def judge(kind: str, found: np.ndarray) -> list[dict]:
    """A row for each of the numbers whose pulls were found; the last column is p."""
    names = {SILICON: "gain mean crosstalk", TUBE: "gain mean crosstalk", "campaign": "yield ratio"}
    names[COMMON] = "difference sum"
    rows = []
    for of, pulls in zip(names.get(kind, "centroid").split(), found.T[:-1], strict=True):
        width, count = pulls.std(ddof=1), len(pulls)
        rows.append(
            {
                "kind": kind,
                "of": of,
                "number": str(count),
                "mean": pulls.mean(),
                "mean_error": width / math.sqrt(count),
                "width": width,
                "width_error": width / math.sqrt(2 * count),
                "within": np.mean(np.abs(pulls) < 2.0),
                "bad": np.mean(found[:, -1] < 0.01),
            }
        )
    return rows
