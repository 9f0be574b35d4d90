"""Raw data to numbers, each with its errors by origin.

`histogram` and `peak` (photons per event to a centroid; `peak_shapes` and `peak_band` are what it
fits), `light_yield` (Eqs. 2, 3 and 7) and `error_budget`.
"""
