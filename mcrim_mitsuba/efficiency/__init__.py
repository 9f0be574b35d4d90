"""Eta as a function: simulated, tabulated, reweighted from photon records, with effects.

Photons that were followed once answer for all scattering and absorption coefficients, by weights.
Two engines do that (`docs/architecture.md` says why two): cells of records, simulated where they
are asked (`recording`, `cells`, `reweighting`), for tables and campaigns; and grids, one per
reading and value of an effect (`response_maker`, `eta_grid`, `responses`). Other rooms may take

- `simulate` (`collect`), `table` (`eta_table`), `lighting` (`follow_light`, `map_eta`: where light
  arrives and is born);
- `recording` (`record_surface`, `record_surfaces`, `EtaRequest`), `reweighting` (`EtaSurface`),
  `surface` (what all surfaces can be asked);
- `response_maker` (`ResponseMaker`), `responses` (`Responses`, `Anchor`);
- `noise_free` (the method ``modes``: scenes solved without photons, by `polished_box.solve_box`;
  `bench_of`: the bench that a loaded scene is), `bench` (`Bench`: a bench told by its parameters).
"""
