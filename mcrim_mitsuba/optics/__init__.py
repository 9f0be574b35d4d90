"""Closed forms that need no renderer: Fresnel, slabs, spectra, dispersion, materials, gammas."""
