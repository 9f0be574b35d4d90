"""From readings to answers: model, fit, compare, explain, judge, repair; and budgets and plans.

The path of a campaign, a module per step:

- `model`: its readings as functions of the free parameters (`CampaignModel`, `ResponseModel`);
- `likelihood`: the statistic, its minima and intervals by MINUIT; `least_squares`: the same
  statistic for the hundreds of fits of a diagnosis, by `core.descent`;
- `estimates`: what a fit says (`ParameterEstimate`, `FittedRow`, `LIGHT_YIELD`), and statistics of
  it; `fit`: the fit of a model with all its errors (`Calibration`, `fit_model`); `profiles` of its
  chi2;
- `calibrate`: simulate, then fit (`calibrate`, `CampaignResult`);
- `workbench`: a campaign with the responses of its readings, from which models are made;
- `compare`: where a model fails (`compare`, `Comparison`, `find_suspects`, `find_trends`);
- `explanations`: fits with effects added, and what chance gains; `candidates`: every
  effect as an explanation, limits, what to measure next;
- `diagnose`: what all this says, and the steps in their order (`diagnose`, `Judgement`);
- `hypotheses`: campaigns of the same readings side by side (`compare_hypotheses`, `SideBySide`);
- `repair`: the mended campaign and scene, written.

Besides: `budget` (where errors come from, with what is `neglected`), `plan` (what to measure), and
`ratio` (the article's own method).
"""
