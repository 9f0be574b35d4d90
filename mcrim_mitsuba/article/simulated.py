"""The simulations behind the article's numbers, and the curves of Figs. 3 and 4.

Main results follow the photons' polarisation, as the article's ZEMAX does; the couplings exist
without it as well.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from mcrim_mitsuba.article import published as p
from mcrim_mitsuba.article.published import Table1Line
from mcrim_mitsuba.campaign.campaign import Campaign, read_campaign
from mcrim_mitsuba.campaign.parameter import SCALE
from mcrim_mitsuba.core.descent import Array
from mcrim_mitsuba.core.errors import InputError
from mcrim_mitsuba.core.numbers import ALPHA_ABS, ALPHA_SCAT, Value
from mcrim_mitsuba.core.run import Run
from mcrim_mitsuba.efficiency.eta_surface import EtaRequest, record_surfaces
from mcrim_mitsuba.efficiency.responses import Responses, stack
from mcrim_mitsuba.efficiency.simulate import collect_whole
from mcrim_mitsuba.inference.corrections import Quantities, at, fitted
from mcrim_mitsuba.inference.estimates import ParameterEstimate
from mcrim_mitsuba.inference.fit import Calibration, fit_model
from mcrim_mitsuba.inference.model import ResponseModel
from mcrim_mitsuba.scene.scene_file import read_scene
from mcrim_mitsuba.scene.shipped import scene_path
from mcrim_mitsuba.transport.simulation import SimulationResult

AIR = "air"
GEL = "gel"
COUPLINGS = {AIR: p.N_AIR.value, GEL: p.N_GEL.value}

#: Scenes: the article's bench, and its relatives.
BENCH = "camoo4.xml"
_THIN = "camoo4_thin.xml"
_CAWO4 = "cawo4.xml"
_WRAPPED = "camoo4_wrapped.xml"
_SCENES = (BENCH, _THIN, _CAWO4, _WRAPPED)

#: Photons of each of the four surfaces. The Monte Carlo error of alpha_scat is then 0.005 /cm.
DEFAULT_PHOTONS = 8_000_000
FEWEST_PHOTONS = 200_000

#: Absorptions that fits of the article's readings may try.
_ABSORPTION_PER_CM = (0.005, 0.2)
#: Photons of a single bench, as a share of a surface's.
_SINGLE_SHARE = 0.1
#: Free flights of Eq. 6's photons. Light in an escape cone needs a few; after 300, less than
#: 1e-5 of it is left, and all that is left is trapped.
_BARE_MAX_DEPTH = 300

#: The scene's reflectance of the wrapping, and the range that the article gives for Teflon tape.
DEFAULT_WRAP_REFLECTANCE = 0.97
WRAP_REFLECTANCES = (p.TEFLON_LOW.value, DEFAULT_WRAP_REFLECTANCE, p.TEFLON_HIGH.value)


@dataclass(frozen=True, eq=False)
class Couplings:
    """The article's bench with air and with gel in the gap, at any coefficients of the crystal.

    Both draw the same random numbers, so that a part of their errors cancels in the ratio.
    """

    polarised: bool
    #: Of `article_campaign`'s two readings, over the article's range.
    responses: Responses

    def fit(self, campaign: Campaign) -> Calibration:
        """The fit of a campaign with the article's two configurations."""
        return fit_model(ResponseModel(campaign, self.responses, []))

    @cached_property
    def _model(self) -> ResponseModel:
        """Both coefficients are free."""
        return ResponseModel(article_campaign(), self.responses, [])

    def at(self, alpha_scat_per_cm: float, alpha_abs_per_cm: float) -> Quantities:
        """Efficiencies of air and gel, and their ratio, at coefficients in 1/cm."""
        values = {ALPHA_SCAT: alpha_scat_per_cm, ALPHA_ABS: alpha_abs_per_cm, SCALE: 1.0}
        return at(self._model, values)


def article_campaign(
    alpha_abs_per_cm: float | None = None, sigma_per_cm: float | None = None
) -> Campaign:
    """The article's two readings, with its prior on the absorption or another one.

    An absorption without an error is held.
    """
    campaign = read_campaign(scene_path("camoo4_campaign.toml"))
    if alpha_abs_per_cm is None:
        return campaign
    absorption = replace(
        campaign.parameters[ALPHA_ABS],
        start=alpha_abs_per_cm,
        prior=None if sigma_per_cm is None else alpha_abs_per_cm,
        prior_sigma=sigma_per_cm,
        fixed=sigma_per_cm is None,
    )
    return replace(campaign, parameters={**campaign.parameters, ALPHA_ABS: absorption})


@dataclass(frozen=True, kw_only=True)
class Simulated:
    """Everything that was simulated for the article."""

    #: By whether polarisation was followed.
    couplings: dict[bool, Couplings]
    #: Eq. 6: crystals without scattering and absorption by their index relative to the
    #: surroundings; what is not ``truncated`` left the crystal.
    bare: dict[float, SimulationResult]
    #: ``thin_clear`` is the thin sample without absorption.
    thin: SimulationResult
    thin_clear: SimulationResult
    cawo4: SimulationResult
    #: By the reflectance of the wrapping.
    wrapped: dict[float, SimulationResult]
    #: Scene parameters of the article's bench.
    parameters: dict[str, Value]

    @cached_property
    def lines(self) -> tuple[SimulatedLine, ...]:
        """Table 1, with polarisation and without."""
        of_all = itertools.product(self.couplings.values(), p.TABLE_1)
        return tuple(SimulatedLine(couplings, line) for couplings, line in of_all)

    @property
    def nominal(self) -> SimulatedLine:
        """The polarised line of the nominal transmittance."""
        return next(line for line in self.lines if line.polarised and line.printed == p.NOMINAL)

    @property
    def scene_hashes(self) -> dict[str, str]:
        """SHA-256 of each scene that was used, at its defaults."""
        return {name: read_scene(scene_path(name)).content_hash for name in _SCENES}


def simulate_article(*, run: Run = Run()) -> Simulated:
    """Run every simulation that the article's numbers need.

    The run's photons are those of each of the four surfaces; single benches get a tenth.

    Raises InputError if there are too few photons, or a scene cannot be used; KeyboardInterrupt if
    the user interrupts: half of the numbers are of no use.
    """
    photons = run.photons_or(DEFAULT_PHOTONS)
    if photons < FEWEST_PHOTONS:
        problem = f"{photons:,} photons are too few for the article"
        raise InputError(problem, f"give {FEWEST_PHOTONS:,} or more")
    couplings = _couplings(replace(run, photons=photons, precision=None))
    run = replace(run, photons=round(_SINGLE_SHARE * photons), precision=None)
    clear = {ALPHA_SCAT: 0.0, ALPHA_ABS: 0.0, "n_gap": 1.0}
    polarised = {"polarization": True}
    bare, wrapped, thin = {}, {}, scene_path(_THIN)
    for n in (p.N_CRYSTAL.value, p.N_CRYSTAL.value / p.N_GEL.value):
        what = f"bare crystal, n = {n:.4g}"
        bare[n] = collect_whole(
            scene_path(BENCH), {**clear, "n_crystal": n}, what, run, _BARE_MAX_DEPTH
        )
    for reflectance in WRAP_REFLECTANCES:
        film = {**polarised, "wrap_reflectance": reflectance}
        what = f"wrapped cube, reflectance {reflectance:g}"
        wrapped[reflectance] = collect_whole(scene_path(_WRAPPED), film, what, run)
    return Simulated(
        couplings=couplings,
        bare=bare,
        thin=collect_whole(thin, polarised, "thin sample", run),
        thin_clear=collect_whole(thin, {**polarised, ALPHA_ABS: 0.0}, "thin sample, clear", run),
        cawo4=collect_whole(scene_path(_CAWO4), polarised, "CaWO4", run),
        wrapped=wrapped,
        parameters=dict(read_scene(scene_path(BENCH)).parameters),
    )


def _couplings(run: Run) -> dict[bool, Couplings]:
    """Both couplings, polarised and not."""
    file = read_scene(scene_path(BENCH))
    scanned = p.SCANNED_FROM.value, p.SCANNED_TO.value
    absorptions = [line.alpha_abs_per_cm.value for line in p.TABLE_1]
    points = [(scattering, absorption) for absorption in absorptions for scattering in scanned]
    requests = []
    for polarised, (name, n_gap) in itertools.product((True, False), COUPLINGS.items()):
        what = f"{name}, {'polarised' if polarised else 'unpolarised'}"
        scene = file.with_overrides({"n_gap": n_gap, "polarization": polarised})
        requests.append(EtaRequest(what, scene, points, run, scanned, _ABSORPTION_PER_CM))
    surfaces = record_surfaces(requests)
    grid, tables = surfaces[0][0].grid, [surface.table for surface, _ in surfaces]
    return {
        polarised: Couplings(polarised, Responses(grid, grid, *stack(pair)))
        for polarised, pair in ((True, tables[:2]), (False, tables[2:]))
    }


# Table 1, and the curves of Figs. 3 and 4.

#: (25,) points of a curve, equally spaced in log(alpha_scat).
CURVE_PER_CM = np.geomspace(p.SCANNED_FROM.value, p.SCANNED_TO.value, 25)


#: Error of a reading that is taken as exact, beside the other one's 2 %.
_EXACT = 1e-4


@dataclass(frozen=True, eq=False)
class SimulatedLine:
    """A line of Table 1 as simulated here: its T and alpha_abs are the article's."""

    couplings: Couplings
    printed: Table1Line

    @property
    def polarised(self) -> bool:
        """Whether the photons carried their polarisation."""
        return self.couplings.polarised

    def at(self, alpha_scat_per_cm: float) -> Quantities:
        """Efficiencies of air and gel, and their ratio."""
        return self.couplings.at(alpha_scat_per_cm, self.printed.alpha_abs_per_cm.value)

    # where eta_air / eta_gel is the measured R

    @cached_property
    def fit(self) -> Calibration:
        """Of the measured R: the signal of air in units of gel's."""
        campaign = article_campaign(self.printed.alpha_abs_per_cm.value)
        air, gel = campaign.measurements.readings
        readings = (
            replace(air, signal=p.RATIO.value, sigma=p.RATIO.stated_sigma),
            replace(gel, signal=1.0, sigma=_EXACT),
        )
        measured = replace(campaign.measurements, readings=readings)
        return self.couplings.fit(replace(campaign, measurements=measured))

    @property
    def alpha_scat(self) -> ParameterEstimate:
        """The fitted one, 1/cm."""
        return self.fit.parameters[ALPHA_SCAT]

    @cached_property
    def _fitted(self) -> tuple[Array, Array, Array]:
        """(3,) efficiencies and R, their Monte Carlo errors, and slopes by alpha_scat in cm."""
        quantities = fitted(self.fit)
        slopes = quantities.slopes[-3:, self.fit.names.index(ALPHA_SCAT)]
        return quantities.values[-3:], quantities.sigmas[-3:], slopes

    @property
    def etas(self) -> Array:
        """(2,) efficiencies of air and gel."""
        return self._fitted[0][:2]

    @property
    def eta_sigmas(self) -> tuple[Array, Array]:
        """(2,) errors of the efficiencies: from the signals' ratio, and Monte Carlo."""
        _, monte_carlo, slopes = self._fitted
        return np.abs(slopes[:2]) * self.alpha_scat.contributions["statistical"], monte_carlo[:2]

    @property
    def ratio_slope_cm(self) -> float:
        """dR / d alpha_scat."""
        return float(self._fitted[2][2])

    # curves of Figs. 3 and 4

    @cached_property
    def curves(self) -> tuple[Array, Array]:
        """(3, points) efficiencies of air and gel and R at `CURVE_PER_CM`, and their errors."""
        points = [self.at(float(a)) for a in CURVE_PER_CM]
        return np.array([q.values for q in points]).T, np.array([q.sigmas for q in points]).T

    def smooth(self, alpha_scat_per_cm: Array) -> Array:
        """(3, points) at many values, for drawing."""
        responses, alpha_abs = self.couplings.responses, self.printed.alpha_abs_per_cm.value
        weights = responses.grid.weights_at(alpha_scat_per_cm, np.array([alpha_abs]))
        air, gel = np.exp(responses.log_eta.reshape(2, -1) @ weights.T)
        return np.array([air, gel, air / gel])
