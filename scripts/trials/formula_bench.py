"""A bench in formulas: log(eta) of the standard campaign with effects, for tests of the diagnosis.

Not the physics of `bench.md`, but like it in what matters to a diagnosis: how many readings, free
parameters and effects there are, that they act through filling, aperture, gap and height, that some
are nearly alike, bounded or strongly nonlinear, and that the model has a simulation's own error.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import SimpleNamespace

import numpy as np

from mcrim_mitsuba.campaign.campaign import LightYieldInput
from mcrim_mitsuba.campaign.measurements import Reading
from mcrim_mitsuba.campaign.parameter import CampaignParameter, CommonErrors
from mcrim_mitsuba.effects.catalogue import catalogue
from mcrim_mitsuba.effects.effect import Rows
from mcrim_mitsuba.effects.readings import reading_nonlinearity
from mcrim_mitsuba.inference.drivers import find_minima
from mcrim_mitsuba.inference.explanations import Explanations
from mcrim_mitsuba.inference.model import Prediction
from mcrim_mitsuba.inference.statistic import Statistic

SIGMA = 0.007
PRIOR, PRIOR_SIGMA = 0.039, 0.012
SIMULATION_ERROR, BATCHES = 0.0007, 16


def _rows() -> list[dict[str, float]]:
    plain = {"n_gap": 1.0, "gap_mm": 0.05, "aperture_radius_mm": 14.0, "crystal_height_mm": 10.0}
    rows = [
        {**plain, "n_gap": n, "aperture_radius_mm": r}
        for n in (1.0, 1.333, 1.46, 1.515)
        for r in (14.0, 7.0)
    ]
    rows += [{**plain, "n_gap": n, "crystal_height_mm": h} for h in (5.0, 2.0) for n in (1.0, 1.46)]
    rows += [{**plain, "n_gap": n, "gap_mm": 0.5} for n in (1.0, 1.46)]
    return rows + [{**plain, "n_gap": n, "aperture_radius_mm": 4.0} for n in (1.0, 1.46)]


ROWS = _rows()
COLUMNS = {name: np.array([row[name] for row in ROWS]) for name in ROWS[0]}


_GAP, _RADIUS = COLUMNS["gap_mm"], COLUMNS["aperture_radius_mm"]
_HEIGHT = COLUMNS["crystal_height_mm"]
_FILLED = (COLUMNS["n_gap"] > 1.0005).astype(float)
# a nonlinear readout knows nothing of them
_NO_ROWS = Rows(np.zeros(0), np.zeros(0, dtype=bool))


EFFECTS = {n: e for n, e in catalogue().items() if not (e.of_beam or e.lacks)}
SCENE = {"n_crystal": 2.01}


def _log_eta(v: Mapping[str, np.ndarray], on: frozenset[str]) -> np.ndarray:
    """(points, readings) log(eta); `v` holds (points, 1) values of all parameters, complex too."""
    gap, radius, height = _GAP, _RADIUS, _HEIGHT
    filled = _FILLED
    n_gap = COLUMNS["n_gap"] + v["gap_index_offset"] * filled
    n = v["n_crystal"]
    h = height / 10.0
    a = v["alpha_scat_per_cm"] * (1.0 - v["scattering_g"]) ** 0.9
    a = a * (1.0 + 0.3 * v["scattering_gradient"] * (1.0 - h) * np.sign(0.5 - filled))
    if "rayleigh_scattering" in on:
        a = a * (1.0 + 0.02 * filled)
    k = v["alpha_abs_per_cm"] + 0.9 * v["surface_loss"] * (1.0 + 2.0 / h) * (0.8 + 0.2 * filled)
    # light through the bottom, direct and turned into its cone by scattering
    window = np.where(np.real(n_gap) < 1.52, n_gap, 1.52)
    cone = 0.5 * (1.0 - np.sqrt(1.0 - (window / n) ** 2))
    four_sides = 0.5 * (1.0 - np.sqrt(1.0 - 1.0 / n**2))
    turned = a * h / (a * h + 0.12 + 2.2 * k * (0.4 + h))
    caught = np.exp(-k * h * 3.0 * (1.0 - 0.5 * filled))
    rough = v["roughness_alpha"]
    turned = turned + (1.0 - turned) * (1.0 - np.exp(-3.0 * rough)) * 0.5
    trapped = 1.0 - 2.0 * cone - 4.0 * four_sides
    bottom = cone + trapped * turned * cone / (cone + 5.0 * four_sides * (1.0 + v["chamfer_mm"]))
    up = four_sides * v["top_reflectance"] * (0.4 + 0.6 * h)
    gap_here = gap + v["gap_offset_mm"]
    side = 4.0 * four_sides * (0.25 + 0.3 * turned) * 0.35
    seen = 1.0 - np.exp(-((radius / 6.0) ** 2) / h) * (1.0 + 0.5 * gap_here)
    if "aperture_at_detector" in on:
        seen = seen * (1.0 - 0.15 * (radius < 13.0) * (1.0 + filled))
    inner = 1.0 - np.exp(-((radius / 4.0) ** 2)) * (1.0 + 0.2 * gap_here * filled)
    eta = (bottom + up) * inner * caught + side * seen * np.exp(-2.0 * k)
    bubble = v["bubble_fraction"] * filled
    in_air = 0.5 * (1.0 - np.sqrt(1.0 - 1.0 / n**2)) * (1.0 + 2.5 * turned)
    eta = (1.0 - bubble) * eta + bubble * in_air * caught
    log = np.log(eta)
    log = log + v["scattering_g"] * (0.05 * filled * h - 0.03 * (radius < 8)) * (0.5 + turned)
    log = log + rough * (0.3 * filled - 0.25 * (h < 0.9)) + 0.04 * v["chamfer_mm"] * filled / h
    # uniform emission is depth -> infinity: the share born near the top
    near_top = 1.0 / (1.0 + v["source_depth_mm"] / 3.0)
    log = log + near_top * (-0.25 * h + 0.12 * filled * h + 0.05 * np.log1p(a) * (1.0 - h))
    log = log - v["gap_absorption_per_cm"] * gap_here / 10.0 * filled * (1.6 + 0.5 * cone)
    log = log + v["detector_reflectance"] * (-1.0 + 0.35 * filled + 0.25 * turned * h)
    log = log - v["angular_falloff"] * (0.12 + 0.25 * filled * (n_gap - 1.0) + 0.1 * (radius > 5))
    spread = 0.06 + 0.2 * (1.0 - np.exp(-((radius / 9.0) ** 2))) * (1.0 - 0.6 * filled)
    log = log - v["radial_falloff"] * spread * (0.6 + 0.4 * h)
    if "polarization" in on:
        log = log + 0.004 * (1.0 - 2.0 * filled) + 0.003 * (radius < 8)
    return log


_PLAIN = {p.name: p.absent or 0.0 for e in EFFECTS.values() for p in e.parameters}
_PLAIN |= SCENE


def signals(values: Mapping[str, float], effects: tuple[str, ...] = ()) -> np.ndarray:
    """(readings,) without any error; `values` by name, absent ones left out."""
    v = {**_PLAIN, **values}
    true = values["scale"] * np.exp(_log_eta(v, frozenset(effects)).real)
    return true / (1.0 + v["nonlinearity"] * true) + v["background"]


def readings(signal: np.ndarray, sigma: float = SIGMA) -> tuple[Reading, ...]:
    """The standard campaign's rows with these signals."""
    return readings_of(np.arange(len(ROWS)), signal, sigma)


def readings_of(rows: np.ndarray, signal: np.ndarray, sigma: float) -> tuple[Reading, ...]:
    """Readings of some of its rows, perhaps several times each."""
    return tuple(
        Reading(f"row{i + 1}", float(s), sigma * float(s), dict(ROWS[row]), line=int(row) + 2)
        for i, (row, s) in enumerate(zip(rows, signal, strict=True))
    )


@dataclass(eq=False)
class Model:
    """With the interface of `inference.model.Model`."""

    readings: tuple[Reading, ...]
    effects: tuple[str, ...] = ()
    noise: np.ndarray = field(default_factory=lambda: np.zeros((BATCHES, len(ROWS))))
    prior: float = PRIOR
    light_yield: LightYieldInput | None = None
    prior_sigma: float = PRIOR_SIGMA

    def __post_init__(self) -> None:
        free = [
            CampaignParameter("alpha_scat_per_cm", 0.5, 0.02, 10.0),
            CampaignParameter(
                "alpha_abs_per_cm",
                0.039,
                0.0,
                0.3,
                prior=self.prior,
                prior_sigma=self.prior_sigma,
            ),
        ]
        for effect in self.effects:
            for p in EFFECTS[effect].parameters:
                base = SCENE[p.nominal] if p.nominal else 0.0
                start, low, high = base + p.start, base + p.minimum, base + p.maximum
                free.append(CampaignParameter(p.name, start, low, high))
        free.append(CampaignParameter("scale", np.nan, 0.0, np.inf))
        self.free = tuple(free)
        self._at = np.array([r.line - 2 for r in self.readings])
        self._error = self.noise.mean(axis=0)[self._at]
        self._error_sigma = self.noise.std(axis=0, ddof=1)[self._at] / np.sqrt(BATCHES)
        self._names = [p.name for p in free]
        known = self.light_yield
        self.campaign = SimpleNamespace(
            path=None,
            measurements=SimpleNamespace(columns=tuple(self.readings[0].parameters)),
            cells=lambda reading: reading.parameters,
            tolerances=(),
            light_yield=known,
            switched_on=[EFFECTS[name] for name in self.effects],
            effects=(),
            parameters={},
            scale=None,
            notes=(),
            raw=None,
            common_errors=CommonErrors(),
            values=SCENE,
            # of one crystal
            light_yields={} if known is None else {"scale": ("light_yield_ph_per_keV", known)},
            parameter_of=lambda reading, name: name,
            stands_for=lambda name: name,
        )

    def predict(self, theta, *, check=False, covariance=False) -> Prediction:
        k = len(self.free)
        step = 1e-20
        points = np.asarray(theta, float) + 1j * step * np.vstack([np.zeros(k), np.eye(k)])
        v = _PLAIN | {name: points[:, [i]] for i, name in enumerate(self._names)}
        scale = v.pop("scale")
        log = _log_eta(v, frozenset(self.effects))[:, self._at] + self._error
        true = scale * np.exp(log)
        read, by_signal, _ = reading_nonlinearity(true, v["nonlinearity"], _NO_ROWS)
        signal = read + v["background"]
        eta = np.exp(log[0].real)
        return Prediction(
            scale=float(theta[-1]),
            eta=eta,
            eta_slopes=(np.exp(log).imag[1:] / step).T,
            eta_errors=np.diag(self._error_sigma * eta) if covariance else None,
            eta_sigma=self._error_sigma * eta,
            interpolation_error=np.zeros(len(eta)),
            signal=signal[0].real,
            signal_slopes=(signal[1:].imag / step).T,
            signal_per_eta=scale[0, 0].real * by_signal[0].real,
        )

    def predict_many(self, thetas) -> np.ndarray:
        v = _PLAIN | {name: thetas[:, [i]] for i, name in enumerate(self._names)}
        true = v.pop("scale") * np.exp(
            _log_eta(v, frozenset(self.effects))[:, self._at] + self._error
        )
        return reading_nonlinearity(true, v["nonlinearity"], _NO_ROWS)[0] + v["background"]

    def eta_batches(self, theta) -> np.ndarray:
        return (self.noise - self.noise.mean(axis=0))[:, self._at]


def explanations_of(models, effects, scales=None) -> Explanations:
    """What effects make of the campaign whose models these are."""
    baseline = find_minima(Statistic(models(())))[0]
    return Explanations(models, effects, baseline, scales or {})


def simulation_noise(seed: int) -> np.ndarray:
    """(batches, readings) errors of log(eta), shared by all models of a campaign."""
    rng = np.random.default_rng([seed, 99])
    return rng.normal(0.0, SIMULATION_ERROR * np.sqrt(BATCHES), (BATCHES, len(ROWS)))
