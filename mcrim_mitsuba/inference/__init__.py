"""From readings to answers: model, fit, compare, explain, judge, repair; and budgets and plans.

The path of a campaign, a module per step:

- `simulations`: a campaign with what was simulated of its readings, from which models are made,
  and its own fit (`calibrate`);
- `model`: its readings as functions of the free parameters (`Model`, `ResponseModel`);
- `statistic`: chi2 of a model's parameters; `drivers`: two ways to its minimum, MINUIT and the
  fast descent; `profiles` of it, from which intervals and limits are read;
- `fit`: the fit of a model with all its errors (`Calibration`, `fit_model`); `estimates`: what a
  minimum says (`ParameterEstimate`, `FittedRow`, `LIGHT_YIELD`), and statistics of it;
- `compare`: where a model fails (`Comparison`, `find_suspects`, `find_trends`);
- `screening`: which effects deserve more photons;
- `explanations`: fits with effects added, and what chance gains; `candidates`: every
  effect as an explanation, and limits; `evidence`: how likely each is; `rival_causes`: wrong
  readings, and something that is in no catalogue;
- `judgement`: what all this says; `next_measurements`: what to measure next; `diagnose`: the steps
  in their order;
- `hypotheses`: campaigns of the same readings side by side (`compare_hypotheses`, `SideBySide`);
- `repair`: the mended campaign and scene, written.

Besides: `budget` (where errors come from, with what the model leaves out: `corrections`, and
`deposit_shift` for the places where gammas stop), and `plan` (what to measure).
"""
