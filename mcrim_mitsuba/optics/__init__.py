"""Closed forms that need no renderer.

`fresnel`, `thin_film` (a photocathode), `attenuation` and `absorption` (what a polished slab's
transmittance says of its absorption), `dispersion`, `materials` (the catalogue, with sources),
`refractiveindex_info` (any entry of that database by its name), `emission_band` (an index over all
of a scintillator's light), `spectrum` and `spectrum_file`, and `gammas` (where they stop).
"""
