"""Independent answers to compare with: the NumPy tracer, Geant4; crosscheck."""
