"""Eta as a function: simulated, tabulated, reweighted from photon records, with effects.

Photons that were followed once answer for all scattering and absorption coefficients, by weights
on a grid (`eta_grid`): of one configuration until a precision is reached (`eta_surface`), and of a
campaign's readings with effects (`response_maker`, `responses`). Other rooms may take

- `simulate` (`collect`), `table` (`eta_table`), `lighting` (`follow_light`, `map_eta`: where light
  arrives and is born);
- `eta_surface` (`record_surface`, `record_surfaces`, `EtaRequest`, `EtaSurface`);
- `response_maker` (`ResponseMaker`), `responses` (`Responses`, `Anchor`);
- `noise_free` (the method ``modes``: scenes solved without photons, by `polished_box.solve_box`;
  `bench_of`: the bench that a loaded scene is), `bench` (`Bench`: a bench told by its parameters).
"""
