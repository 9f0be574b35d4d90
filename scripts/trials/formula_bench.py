"""A bench in formulas: log(eta) of the standard campaign with effects, for tests of the diagnosis.

Not the physics of `bench.md`, but like it in what matters to a diagnosis: how many readings, free
parameters and effects there are, that they act through filling, aperture, gap and height, that some
are nearly alike, bounded or strongly nonlinear, and that the model has a simulation's own error.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from types import SimpleNamespace

import numpy as np

from mcrim_mitsuba.campaign.campaign import LightYieldInput
from mcrim_mitsuba.campaign.measurements import Reading
from mcrim_mitsuba.campaign.parameter import CampaignParameter, CommonErrors
from mcrim_mitsuba.effects.catalogue import catalogue
from mcrim_mitsuba.effects.effect import Rows
from mcrim_mitsuba.effects.readings import reading_nonlinearity
from mcrim_mitsuba.inference.displacement import NullDistribution
from mcrim_mitsuba.inference.drivers import find_minima
from mcrim_mitsuba.inference.explanations import Explanations
from mcrim_mitsuba.inference.judgement import Judgement
from mcrim_mitsuba.inference.model import Prediction
from mcrim_mitsuba.inference.simulations import MeasurementProposals
from mcrim_mitsuba.inference.statistic import Statistic
from mcrim_mitsuba.inference.weighing import weigh_hypotheses

SIGMA = 0.007
PRIOR, PRIOR_SIGMA = 0.039, 0.012
SIMULATION_ERROR, BATCHES = 0.0007, 16
#: Of slopes, along the imaginary axis.
_STEP = 1e-20


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
_N_GAP, _H = COLUMNS["n_gap"], COLUMNS["crystal_height_mm"] / 10.0
_FILLED = (_N_GAP > 1.0005).astype(float)
_SMALL, _LOW = (_RADIUS < 8.0).astype(float), (_H < 0.9).astype(float)
# a nonlinear readout knows nothing of them
_NO_ROWS = Rows(np.zeros(0), np.zeros(0, dtype=bool))


EFFECTS = {n: e for n, e in catalogue().items() if not (e.of_beam or e.lacks)}
SCENE = {"n_crystal": 2.01}
_PLAIN = {p.name: p.absent or 0.0 for e in EFFECTS.values() for p in e.parameters}
_PLAIN |= SCENE


def _cones(n_gap: np.ndarray, n: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Parts of isotropic light in the bottom's cone, and in that of a face in air."""
    window = np.where(np.real(n_gap) < 1.52, n_gap, 1.52)
    return tuple(0.5 * (1.0 - np.sqrt(1.0 - (x / n) ** 2)) for x in (window, 1.0))


def _into_cone(cone: np.ndarray, four_sides: np.ndarray, chamfer_mm) -> np.ndarray:
    """Part of the light that scattering turns into the bottom's cone, of what is trapped."""
    trapped = 1.0 - 2.0 * cone - 4.0 * four_sides
    return trapped * cone / (cone + 5.0 * four_sides * (1.0 + chamfer_mm))


_SEEN, _INNER = np.exp(-((_RADIUS / 6.0) ** 2) / _H), np.exp(-((_RADIUS / 4.0) ** 2))


def _apertures(gap: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Parts of the light from the sides, and of that from the bottom, that a mask lets through."""
    return 1.0 - _SEEN * (1.0 + 0.5 * gap), 1.0 - _INNER * (1.0 + 0.2 * gap * _FILLED)


# where nothing changes them
_CONES = _cones(_N_GAP, SCENE["n_crystal"])
_TURNED_INTO = _into_cone(*_CONES, 0.0)
_APERTURES = _apertures(_GAP)
_LOST, _CAUGHT = 2.2 * (0.4 + _H), _H * (1.5 * _FILLED - 3.0)


def _log_eta(given: Mapping[str, np.ndarray], on: frozenset[str]) -> np.ndarray:
    """(points, readings) log(eta); `given` holds (points, 1) values of parameters, complex too.

    What is not given changes nothing, and is not worked out: diagnoses ask ten thousand times.
    """
    v, n_gap, gap, apertures = _PLAIN | given, _N_GAP, _GAP, _APERTURES
    a, k = v["alpha_scat_per_cm"], v["alpha_abs_per_cm"]
    if "scattering_g" in given:
        a = a * (1.0 - v["scattering_g"]) ** 0.9
    if "scattering_gradient" in given:
        a = a * (1.0 + v["scattering_gradient"] * (0.3 * (1.0 - _H) * np.sign(0.5 - _FILLED)))
    if "rayleigh_scattering" in on:
        a = a * (1.0 + 0.02 * _FILLED)
    if "surface_loss" in given:
        k = k + v["surface_loss"] * (0.9 * (1.0 + 2.0 / _H) * (0.8 + 0.2 * _FILLED))
    if "gap_index_offset" in given:
        n_gap = _N_GAP + v["gap_index_offset"] * _FILLED
    if "gap_offset_mm" in given:
        gap = _GAP + v["gap_offset_mm"]
        apertures = _apertures(gap)
    # light through the bottom, direct and turned into its cone by scattering
    (cone, four_sides), turned_into = _CONES, _TURNED_INTO
    if not given.keys().isdisjoint(("n_crystal", "gap_index_offset", "chamfer_mm")):
        cone, four_sides = _cones(n_gap, v["n_crystal"])
        turned_into = _into_cone(cone, four_sides, v["chamfer_mm"])
    turned = a * _H
    turned = turned / (turned + k * _LOST + 0.12)
    caught = np.exp(k * _CAUGHT)
    if "roughness_alpha" in given:
        turned = turned + (1.0 - turned) * (1.0 - np.exp(-3.0 * v["roughness_alpha"])) * 0.5
    bottom = cone + turned_into * turned
    if "top_reflectance" in given:
        bottom = bottom + four_sides * v["top_reflectance"] * (0.4 + 0.6 * _H)
    side = (0.35 + 0.42 * turned) * four_sides
    seen, inner = apertures
    if "aperture_at_detector" in on:
        seen = seen * (1.0 - 0.15 * (_RADIUS < 13.0) * (1.0 + _FILLED))
    eta = bottom * inner * caught + side * seen * np.exp(-2.0 * k)
    if "bubble_fraction" in given:
        bubble = v["bubble_fraction"] * _FILLED
        eta = (1.0 - bubble) * eta + bubble * four_sides * (1.0 + 2.5 * turned) * caught
    log = np.log(eta)
    if "scattering_g" in given:
        log = log + v["scattering_g"] * (0.05 * _FILLED * _H - 0.03 * _SMALL) * (0.5 + turned)
    if "roughness_alpha" in given:
        log = log + v["roughness_alpha"] * (0.3 * _FILLED - 0.25 * _LOW)
    if "chamfer_mm" in given:
        log = log + 0.04 * v["chamfer_mm"] * _FILLED / _H
    if "source_depth_mm" in given:
        # uniform emission is depth -> infinity: the share born near the top
        near_top = 1.0 / (1.0 + v["source_depth_mm"] / 3.0)
        depth = -0.25 * _H + 0.12 * _FILLED * _H + 0.05 * np.log1p(a) * (1.0 - _H)
        log = log + near_top * depth
    if "gap_absorption_per_cm" in given:
        way = gap / 10.0 * _FILLED * (1.6 + 0.5 * cone)
        log = log - v["gap_absorption_per_cm"] * way
    if "detector_reflectance" in given:
        log = log + v["detector_reflectance"] * (0.35 * _FILLED - 1.0 + 0.25 * turned * _H)
    if "angular_falloff" in given:
        steep = 0.12 + 0.25 * _FILLED * (n_gap - 1.0) + 0.1 * (_RADIUS > 5)
        log = log - v["angular_falloff"] * steep
    if "radial_falloff" in given:
        spread = 0.06 + 0.2 * (1.0 - np.exp(-((_RADIUS / 9.0) ** 2))) * (1.0 - 0.6 * _FILLED)
        log = log - v["radial_falloff"] * spread * (0.6 + 0.4 * _H)
    if "polarization" in on:
        log = log + 0.004 * (1.0 - 2.0 * _FILLED) + 0.003 * _SMALL
    return log


def _read(light: np.ndarray, given: Mapping[str, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """What is read of light, and its slope, with the readings' own effects where they are given."""
    by_light = np.ones((1, 1))
    if "nonlinearity" in given:
        light, by_light, _ = reading_nonlinearity(light, given["nonlinearity"], _NO_ROWS)
    if "background" in given:
        light = light + given["background"]
    return light, by_light


def signals(values: Mapping[str, float], effects: tuple[str, ...] = ()) -> np.ndarray:
    """(readings,) without any error; `values` by name, absent ones left out."""
    v = {**_PLAIN, **values}
    true = values["scale"] * np.exp(_log_eta(values, frozenset(effects)).real)
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
        self._names, self._on = [p.name for p in free], frozenset(self.effects)
        self._steps = 1j * _STEP * np.vstack([np.zeros(len(free)), np.eye(len(free))])
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
        points = np.asarray(theta, float) + self._steps
        given = {name: points[:, [i]] for i, name in enumerate(self._names)}
        scale = given["scale"]
        log = _log_eta(given, self._on)[:, self._at] + self._error
        all_eta = np.exp(log)
        eta = all_eta[0].real
        signal, by_light = _read(scale * all_eta, given)
        return Prediction(
            scale=float(theta[-1]),
            eta=eta,
            eta_slopes=(all_eta.imag[1:] / _STEP).T,
            eta_errors=np.diag(self._error_sigma * eta) if covariance else None,
            eta_sigma=self._error_sigma * eta,
            interpolation_error=np.zeros(len(eta)),
            signal=signal[0].real,
            signal_slopes=(signal[1:].imag / _STEP).T,
            signal_per_eta=scale[0, 0].real * by_light[0].real + np.zeros(len(eta)),
        )

    def predict_many(self, thetas) -> np.ndarray:
        given = {name: thetas[:, [i]] for i, name in enumerate(self._names)}
        eta = np.exp(_log_eta(given, self._on)[:, self._at] + self._error)
        return _read(given["scale"] * eta, given)[0]

    def eta_batches(self, theta) -> np.ndarray:
        return (self.noise - self.noise.mean(axis=0))[:, self._at]


def explanations_of(models, effects, scales=None) -> Explanations:
    """What effects make of the campaign whose models these are."""
    baseline = find_minima(Statistic(models(())))[0]
    return Explanations(models, effects, baseline, scales or {})


def sizes(
    explanations: Explanations, effects: tuple[str, ...], rng: np.random.Generator
) -> dict[str, float]:
    """Values of effects' parameters, drawn from what is known of them beforehand."""
    priors = explanations.priors(effects)
    return {
        parameter: float(priors[parameter].value(rng.standard_normal(1))[0])
        for name in effects
        for parameter in explanations.free_parameters((name,), name)
    }


def simulation_noise(seed: int) -> np.ndarray:
    """(batches, readings) errors of log(eta), shared by all models of a campaign."""
    rng = np.random.default_rng([seed, 99])
    return rng.normal(0.0, SIMULATION_ERROR * np.sqrt(BATCHES), (BATCHES, len(ROWS)))


#: What is true of a campaign that is followed, but for the values it says.
TRUTH = {"alpha_scat_per_cm": 0.54, "alpha_abs_per_cm": 0.039, "scale": 40.0}
#: A scale of 5 is 1 photon per keV; the efficiency has no error, which would blur what is scored.
LIGHT = LightYieldInput(50.0, 0.1, 0.0)


@dataclass
class Followed:
    """A campaign whose truth is known, and what is measured later on its bench."""

    values: dict
    effects: tuple
    known: tuple
    rows: tuple  # places of its readings among those of the bench
    seed: int = 0
    wrong: dict = field(default_factory=dict)  # factors, by place
    more: tuple = ()  # places of readings that are made later
    numbers: int = 1  # times that the absorption was measured

    def judged(self) -> Judgement:
        """What a diagnosis makes of it."""
        explanations = explanations_of(self.models, {name: EFFECTS[name] for name in self.known})
        null = NullDistribution(explanations, explanations.singles())
        return Judgement(explanations, null, weigh_hypotheses(explanations, null))

    def models(self, added: tuple) -> Model:
        """Its model with some effects."""
        rng, truth = np.random.default_rng(self.seed), {**TRUTH, **self.values}
        true = signals(truth, self.effects)
        once = true * (1.0 + SIGMA * rng.standard_normal(len(true)))
        later = true * (1.0 + SIGMA * rng.standard_normal(len(true)))
        for place, factor in self.wrong.items():
            once[place] *= factor
        first, second = readings(once), readings(later)
        rows = [first[place] for place in self.rows]
        rows += [replace(second[place], label=f"{place} later") for place in self.more]
        measured = truth["alpha_abs_per_cm"] + PRIOR_SIGMA * rng.standard_normal(2)
        return Model(
            tuple(rows),
            tuple(added),
            simulation_noise(self.seed),
            measured[: self.numbers].mean(),
            LIGHT,
            prior_sigma=PRIOR_SIGMA / np.sqrt(self.numbers),
        )

    def proposals(self, new: Sequence[int] = ()) -> MeasurementProposals:
        """What may be measured next: readings of these rows, and what may be done once more."""
        nobodys = readings(np.ones(len(ROWS)))
        rows, noise = tuple(nobodys[place] for place in new), simulation_noise(self.seed)
        return MeasurementProposals(
            [ROWS[place] for place in new],
            [lambda added: Model(rows, added, noise)] if rows else [],
            self.models,
            SIGMA,
        )
