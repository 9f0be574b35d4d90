"""The bench in Geant4, by the PyPI package ``geant4_pybind``: a second opinion and a yardstick.

``trace_geant4(Bench(), 10**6, seed=1)`` gives the light collection efficiency of the paper's
bench. Geant4 runs in a process of its own, so it can run many times, and nothing here needs it
to be installed until then.
"""

from mcrim_mitsuba.geant4.result import Geant4Error, Geant4Result
from mcrim_mitsuba.geant4.trace import is_installed, refuse_bench, trace_geant4

__all__ = ["Geant4Error", "Geant4Result", "is_installed", "refuse_bench", "trace_geant4"]
