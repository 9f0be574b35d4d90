"""Eta as a function: simulated, tabulated, reweighted from photon records, with effects."""
