"""Raw data to numbers, each with its errors by origin.

`digitiser`, `single_photoelectron` and `calibration` (channels to photoelectrons), `histogram` and
`peak` (photons per event to a centroid; `peak_shapes` and `peak_band` are what it fits),
`energy_scale` (lines of known energies), `light_yield` (Eqs. 2, 3 and 7) and `error_budget`.
"""
