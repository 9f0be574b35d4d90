"""Numbers that were chosen: the settings and thresholds of this room, with a word on each.

One frozen class for each algorithm, in the order of a campaign's walk from its fit to the advice;
its one value stands below it. What a run sets, its photons and its precision, is no setting.
"""

from __future__ import annotations

from dataclasses import dataclass

#: A fit with a lower p-value does not describe the readings.
ACCEPTABLE_P = 0.01
#: Rises of chi2 that hold 68.3 %, 95 % and 95.4 % of a Gaussian likelihood.
ONE_SIGMA = 1.0
RISE_95 = 3.841
TWO_SIGMA = 4.0
#: Rise at 95 % confidence where a parameter sits at a bound without the effect that it measures.
ONE_SIDED_95 = 2.706


@dataclass(frozen=True, kw_only=True)
class LinearTheory:
    """Where errors propagated to first order are rounding, or no longer believed."""

    #: Smallest eigenvalue of the Fisher information (of parameters scaled to unit diagonal) that
    #: still tells the parameters apart.
    least_information: float = 1e-10
    #: Distance from a bound, in standard errors, that counts as being there.
    at_bound: float = 0.02
    #: Readings up to which a matrix of all of them weighs faster than their few common sources.
    few_readings: int = 200
    #: Parts of an error smaller than this, relative to it, are rounding.
    rounding: float = 1e-9
    #: Part of a reading's weight that must be left once the parameters have followed it, for the
    #: other readings to predict it at all.
    least_leverage: float = 1e-9
    #: Error on left out readings, in their standard errors, from which the others do not tell them.
    largest_error: float = 1e3
    #: Powers of 2 that readings are from 1 before their scale is searched in units of its own.
    usual_size: int = 15


LINEAR = LinearTheory()


@dataclass(frozen=True, kw_only=True)
class SearchSettings:
    """How minima are searched."""

    #: Points of the scan in alpha_scat that finds starts, and how many of its minima to follow.
    scan_points: int = 31
    most_starts: int = 3
    #: Rise of chi2 over the whole scan from which the readings know of alpha_scat.
    flat: float = 1e-6
    #: Longest step in the logarithm of a scattering coefficient.
    longest_log_step: float = 1.5
    #: Updates of the covariance, and the shift (in standard errors, squared) that ends them.
    most_updates: int = 6
    settled: float = 1e-7
    #: Relative difference in chi2 of two descents that ended in one minimum.
    same_height: float = 1e-3
    #: Squared distance, in standard errors, of minima that count as two.
    apart: float = 0.01
    #: Fall of chi2, still to be expected, that ends a minimum that MINUIT goes on from.
    newton_precision: float = 1e-8
    #: MINUIT stops at an expected distance to the minimum of 0.002 times this.
    minuit_tolerance: float = 1e-4


SEARCH = SearchSettings()


@dataclass(frozen=True, kw_only=True)
class Pace:
    """How far and how closely a profile is followed."""

    #: Rise of chi2 where it ends.
    end: float = 9.0
    #: Points on either side of the solution, of a parabola; and of whatever else at most.
    points: int = 12
    most_points: int = 36
    #: Least curvature that is believed, of that at the solution: it limits the steps on a plain.
    least_curvature: float = 1e-3
    #: Fall of chi2, still to be expected, that ends the fit of the other parameters.
    precision: float = 1e-12
    #: Part of a rise that a crossing may miss, and how often it is looked for between more points.
    miss: float = 0.001
    most_refinements: int = 8
    #: Rise of chi2 from point to point that its slopes do not account for.
    jump: float = 0.05


#: For curves that are drawn.
CURVE = Pace()
#: Limits need one height of a profile only, and go as far as the range does.
TO_LIMITS = Pace(end=1.3 * RISE_95, points=5, most_points=40, least_curvature=1e-9, precision=1e-4)


@dataclass(frozen=True, kw_only=True)
class FitNotes:
    """What a fit tells the reader."""

    #: A second minimum this close in chi2 (2 standard errors) is a second answer.
    rival: float = 4.0
    #: Interpolation error, in units of a reading's sigma, from which the reader is told.
    interpolation: float = 0.3
    #: Part of a parameter's error that the Monte Carlo may make before the reader is told. At a
    #: third of it, 1000 synthetic campaigns had pulls 5 % too wide (`scripts/trials closure`).
    monte_carlo: float = 0.25
    #: Where there is no p-value, a chi2 above the square of this says that the model does not
    #: describe the readings; a prior that is pulled less is not named.
    largest_pull: float = 3.0
    #: Times that a reading is off what the others ask for from which it is no effect, but a slip of
    #: writing; and the same of each of two readings, from their middle.
    far_off: float = 5.0
    two_apart: float = 1.8
    #: Relative difference of predictions below which what tells two readings apart changes nothing.
    alike: float = 1e-4
    #: Part of alpha_scat's range, in its logarithm, next to an end that counts as being there.
    edge: float = 0.03


FIT_NOTES = FitNotes()


@dataclass(frozen=True, kw_only=True)
class SuspicionSettings:
    """When `compare` suspects readings, a bench parameter or a fitted parameter."""

    #: Suspects of each kind that are fitted exactly, after all were judged to first order.
    to_the_end: int = 6
    #: By this much a reading's variance grows when it is left out.
    left_out: float = 1e8
    #: Treatments of which any two may have been exchanged, at most.
    most_treatments: int = 6
    #: Suspects as good as the best, within this in chi2.
    rival: float = 4.0
    #: Factors of levels that the free parameters follow but for this part are absorbed.
    absorbed: float = 1e-6
    #: A prior counts as pulled from here, in its standard errors.
    pulled: float = 2.0
    #: Part of alpha_scat's range, in its logarithm, next to an end that is suspicious.
    edge: float = 0.05


SUSPICION = SuspicionSettings()


@dataclass(frozen=True, kw_only=True)
class ExtentSettings:
    """How much is simulated."""

    #: Photons times precision squared of a usual eta (a quarter), weights included.
    photons_per_precision: float = 4.0
    #: Scattering over that at an end of what is simulated, or under it, that is near the end.
    near_end: float = 1.3
    #: How far, in its standard errors, a parameter may move when the effects are simulated
    #: together before they are simulated once more where it went; and how often.
    settled: float = 0.5
    most_anchors: int = 2
    #: Standard errors of what is plausible from which the readings leave a size open.
    open: float = 2.0
    #: How much worse than by responses chi2 may be where effects are simulated together before a
    #: note tells: by this factor and by this much.
    not_adding_up: float = 2.0
    worse: float = 10.0
    #: Most leading sets of effects that a diagnosis simulates together; and how many of the
    #: likeliest effects it simulates together with each other one, where none alone explains it,
    #: and their least probability.
    most_together: int = 3
    most_centres: int = 2
    least_of_centre: float = 0.3
    #: Part of the photons that simulations of proposed measurements get: they decide nothing; and
    #: most configurations that are simulated to see what they would tell.
    proposed_part: float = 0.25
    most_proposals: int = 40
    #: Time that a mounting takes.
    minutes_per_mounting: float = 30.0
    #: Relative error of a proposed reading, where the campaign's readings do not say.
    usual_sigma: float = 0.01


EXTENT = ExtentSettings()


@dataclass(frozen=True, kw_only=True)
class UsualBench:
    """What may be proposed where a campaign does not say, in proportion to its own bench.

    Liquids and masks with each other, and other gaps and crystals with each of two couplings.
    """

    liquids: tuple[float, ...] = (1.0, 1.333, 1.46, 1.515, 1.74)
    #: Where a campaign has one coupling only, the other one for its gaps and crystals.
    other_end: tuple[float, ...] = (1.46,)
    #: A liquid whose index is this near to one that the campaign has is the same.
    alike: float = 0.02
    #: Radii of masks, in widths of the crystal, up to this part of the window's width: beyond, a
    #: hole has nothing but the window's corners to cut off.
    masks: tuple[float, ...] = (0.7, 0.4)
    widest_mask: float = 0.5
    #: Factors on the bench's gap, and on the crystal's length.
    gaps: tuple[float, ...] = (10.0,)
    crystals: tuple[float, ...] = (2.0, 0.2)
    #: Transmittances, where there is one already: within other angles, and through a crystal that
    #: is so many times as long.
    acceptances_deg: tuple[float, ...] = (1.0, 30.0)
    long_crystal: float = 2.0


USUAL = UsualBench()


@dataclass(frozen=True, kw_only=True)
class ScreeningSettings:
    """When an effect deserves more photons than a first look."""

    #: How far behind the best in chi2 it may be: this, and this part of what the best gains. A
    #: first look has few nodes.
    behind: float = 12.0
    part_behind: float = 0.2
    #: What it must gain where the campaign as it is describes the readings.
    least_gain: float = 6.0
    #: Standard errors of the simulation by which both are eased.
    errors: float = 1.0
    #: Least change of log(eta), of any reading, with which an effect counts as one.
    acts: float = 1e-4
    #: Probability of all sets with an effect from which it deserves more, where no effect alone
    #: explains the readings.
    included: float = 0.02


SCREENING = ScreeningSettings()


@dataclass(frozen=True, kw_only=True)
class ExplanationSettings:
    """How effects are fitted, and which of them lead."""

    #: Most nodes of a single effect's profile; of more than one parameter, a coarser product.
    most_nodes: int = 27
    #: Nodes in standard errors, where the catalogue has none.
    sizes: tuple[float, ...] = (-60.0, -20.0, -6.0, -2.0, 2.0, 6.0, 20.0, 60.0)
    #: Explanations this close to the best in twice the logarithm of their evidence lead together
    #: with it; twice the simulation's error of their difference in chi2 is added.
    leading: float = 6.0
    #: Deviance above that of the best from which a few points tell an effect's evidence.
    hopeless: float = 20.0


EXPLAINING = ExplanationSettings()


@dataclass(frozen=True, kw_only=True)
class StripSettings:
    """How the prior of a size is cut into strips, in each of which effects are straight.

    Edges are standard normal numbers of the prior. Toward an absence inside or at an end of the
    range strips become narrow, so that the Gaussian of none reaches far beyond it.
    """

    one_sided: tuple[float, ...] = (-8.0, -0.8, 0.1, 0.8, 1.5, 2.3, 3.2)
    two_sided: tuple[float, ...] = (-3.0, -1.7, -0.8, 0.0, 0.8, 1.7, 3.0)


STRIPS = StripSettings()


@dataclass(frozen=True, kw_only=True)
class ChanceSettings:
    """How it is found what chance alone would gain."""

    #: Campaigns drawn under the null hypothesis.
    draws: int = 4000
    #: The quantile beyond which the draws are too few, and the tail of chi-squared goes on.
    tail: float = 0.02


CHANCE = ChanceSettings()


@dataclass(frozen=True, kw_only=True)
class EvidenceSettings:
    """How a likelihood is averaged over plausible parameters."""

    #: Points that an evidence is averaged over; its error is then a few hundredths of its
    #: logarithm. Of a model that matters little, few tell enough, unless that error is larger
    #: than is still of use.
    points: int = 4096
    few_points: int = 1024
    unsure: float = 0.3
    #: Points that are kept of them.
    draws: int = 256
    #: Degrees of freedom of a size's density: tails that let data speak for unusual sizes.
    tails: float = 3.0
    #: Part of the density inside the plausible range.
    plausible_part: float = 0.95
    #: Degrees of freedom of the sampled densities, and how much wider than the maximum they are.
    sampled_tails: float = 5.0
    wider: float = 1.3
    #: Rounds of sampling; each shows the next one where the weight lies.
    rounds: int = 4
    few_rounds: int = 2
    #: Distance of maxima that count as two, and the narrowest that is sampled, in standard normals.
    apart: float = 0.05
    narrowest: float = 0.003
    #: Part of the points that are drawn from the prior.
    from_prior: float = 0.15
    #: The scale's prior covers this factor either way, evenly in its logarithm.
    scale_factor: float = 30.0
    #: Beyond which a standard normal number is not followed.
    farthest: float = 8.0
    #: max / min of a range from which it is taken evenly in the logarithm.
    wide: float = 15.0
    #: Step of slopes, in standard normals, and steps towards a maximum.
    step: float = 1e-3
    descents: int = 12


EVIDENCE = EvidenceSettings()


@dataclass(frozen=True, kw_only=True)
class HypothesisSettings:
    """How sets of causes are weighed."""

    #: Effects that are expected before the readings, of all that may be missing.
    expected_effects: float = 0.5
    #: Odds of every number of the bench that it is wrong, not inexact.
    wrong_number: float = 0.02
    #: Sets that are averaged over in full, besides single effects, at most; and the part of all
    #: probability below which the next one is not worth it.
    in_full: int = 30
    worth: float = 0.003
    #: Probability of a set, in closed form, from which its evidence is taken from all points.
    precise: float = 0.02
    #: Single effects around whose own fit sets with them are weighed: those that have this part of
    #: the weight of the likeliest, and how many.
    centred: float = 0.01
    most_centres: int = 3
    #: Difference of the logarithms of odds up to which the closed form counts as exact, and what it
    #: has to decide for the reader to be told.
    exact: float = 0.5
    decides: float = 0.2
    #: Least probability of a set that is listed by itself.
    listed: float = 1e-3


HYPOTHESES = HypothesisSettings()


@dataclass(frozen=True, kw_only=True)
class RehearsalSettings:
    """How a campaign's design is tried on causes that are known."""

    #: Probability of a set below which it is left out of a rehearsal's light yield.
    least_share: float = 1e-6
    #: Sizes of every effect that are drawn to see what a campaign can say.
    draws: int = 12
    #: Probability that what is there has no name from which intervals are rehearsed: a part of the
    #: 5 % that are outside of the wide one anyway.
    likely: float = 0.02


REHEARSALS = RehearsalSettings()


@dataclass(frozen=True, kw_only=True)
class DiscrepancySettings:
    """What is known, before the readings, of what no cause explains; see `rival_causes`."""

    #: Its odds, and its amplitudes: those of a usual effect are 1. Their prior is
    #: 1 / (1 + amplitude^2).
    odds: float = 0.15
    amplitudes: tuple[float, ...] = (0.1, 0.2, 0.4, 0.8, 1.6)
    #: Part of what effects have in common that the kernel takes away with the distance.
    kernel_part: float = 0.3
    #: Variances that follow the kernel, and that every reading has alone, over that of effects.
    kernel_variance: float = 0.1
    lone_variance: float = 0.1
    #: Ranges of the configurations over which the kernel falls.
    length: float = 1.0
    #: A usual size, as a standard normal number of its prior.
    usual_size: float = 0.7
    #: Added to the kernel where it carries effects to further configurations.
    smoothing: float = 0.01


DISCREPANCY = DiscrepancySettings()


@dataclass(frozen=True, kw_only=True)
class RivalSettings:
    """How likely it is, before the readings, that these are wrong."""

    #: Odds that some reading is wrong, each as likely as the next, and that two rows are exchanged.
    bad_odds: float = 0.1
    swapped_odds: float = 0.1
    #: Relative errors of a wrong reading, each as likely as the next.
    bad_sizes: tuple[float, ...] = (0.04, 0.15)
    #: Readings, and exchanges, that are looked at: of more those that would explain most.
    most_readings: int = 16
    most_swaps: int = 3
    #: Odds that all stated errors are too small, the width of the half-normal prior of the
    #: factor's logarithm, and how many values stand for it.
    understated_odds: float = 0.25
    error_factor_sigma: float = 0.6
    error_factors: int = 4


RIVALS = RivalSettings()


@dataclass(frozen=True, kw_only=True)
class CandidateSettings:
    """How an effect is told from those that look like it."""

    #: How far behind the best, in chi2, an effect's mimics are found by fits; the others' to first
    #: order.
    within_reach: float = 12.0
    #: The first-order separation, in chi2, up to which a fit is worth its time.
    worth_a_fit: float = 80.0
    #: Standard errors of plausible sizes beyond which that of a fit says that nothing determines
    #: it.
    undetermined: float = 5.0
    #: Cosine of directions that are alike, for effects too small to be separated from anything.
    alike: float = 0.9


CANDIDATES = CandidateSettings()


@dataclass(frozen=True, kw_only=True)
class VerdictSettings:
    """When a diagnosis gives which verdict."""

    #: Probability that something which matters is missing, below which a campaign is adequate.
    harmless: float = 0.2
    #: Probability of a family from which it is named.
    named: float = 0.9
    #: What the leading hypotheses hold together.
    credible: float = 0.95
    #: Part of the misfit that an effect which is named may leave where its fit still fails: another
    #: is missing besides it, and not in place of it.
    left: float = 0.05
    #: Explanations that a sentence names.
    most_named: int = 4
    #: Of a fit's misfit by chance, below which its effects do not lead beside others that explain
    #: the readings.
    refused: float = 1e-3
    #: Probability from which an effect counts as one that the diagnosis rests on.
    likely: float = 0.01


JUDGING = VerdictSettings()


@dataclass(frozen=True, kw_only=True)
class AdviceSettings:
    """Which further measurements are proposed."""

    #: An expected difference in chi2 from which two explanations count as separated.
    separated: float = 6.0
    #: Configurations handed back, two together counting as one.
    most: int = 10
    #: Readings that are looked at together with each other: the best ones alone.
    together: int = 12
    #: Leading explanations that are told apart.
    most_rivals: int = 3
    #: Sets of effects that are simulated for it besides, and the probability from which one is.
    most_sets: int = 5
    likely: float = 0.01
    #: Time that a number takes that is measured again: a transmittance with its reference, and
    #: what is made of it.
    number_minutes: float = 60.0
    #: Time that a look at the bench takes, that of a mounting: most of those of the catalogue turn,
    #: cover or take off something; and how often it tells rightly whether an effect is there: small
    #: ones are overlooked.
    look_minutes: float = 30.0
    look_right: float = 0.95
    #: Points that further readings are made at.
    outcomes: int = 128
    #: An error that is promised counts as kept within this part of it.
    kept: float = 0.3
    #: What a reading buys counts by the part of the outcomes that keep it, to this power: what may
    #: buy nearly all or nothing is no advice.
    discount: int = 2


ADVICE = AdviceSettings()


@dataclass(frozen=True, kw_only=True)
class PlanSettings:
    """What a plan is made of where its user does not say."""

    #: Couplings: air, water, the article's gel, a usual immersion oil.
    n_gap: tuple[float, ...] = (1.0, 1.333, 1.46, 1.515)
    events: tuple[float, ...] = (1e3, 1e4, 1e5, 1e6)
    mountings: tuple[int, ...] = (1, 2, 4, 8, 16)
    #: Configurations among which sets are chosen: 2^8 sets take seconds.
    most_configurations: int = 8
    #: Relative scatter of one mounting. The article's 0.2 of 14.3 photons is the error of the mean
    #: of four.
    mounting_scatter: float = 0.2 / 14.3 * 4**0.5
    #: Relative standard deviation of an event's light, besides the counting of its photons.
    intrinsic_spread: float = 0.10
    #: A plan is more precise than another if its error is less than this part of the other's.
    better: float = 0.98
    #: Relative error of readings that counts as none, and keeps the information's inverse exact.
    perfect: float = 1e-5


PLANNING = PlanSettings()


@dataclass(frozen=True, kw_only=True)
class BudgetSettings:
    """How the errors of a light yield are taken apart."""

    #: Parts of an error smaller than this, relative to the largest, are rounding.
    rounding: float = 1e-6
    #: Part of a quantity's error from which a number of the bench has a row of its own.
    matters: float = 0.1
    #: Standard uncertainties of a number from which it is worth telling how far off it is.
    off: float = 1.0
    #: Photons of a simulation with another index, shared out among the configurations, and the
    #: fewest of each. Simulations with one index get `responses.PLAIN_FACTOR` times as many.
    photons: int = 1_572_864
    fewest_photons: int = 196_608
    #: 1/e depth of gammas where nothing tells it.
    usual_depth_mm: float = 1.0


BUDGETING = BudgetSettings()
