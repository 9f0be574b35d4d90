"""An independent reference: an analog photon tracer in NumPy, with analytic geometry.

It shares no code with the Mitsuba engine that it checks. ``trace(Bench(), 10**6, seed=1)``
gives the light collection efficiency of the paper's bench.
"""

from mcrim_mitsuba.tracer.bench import Bench
from mcrim_mitsuba.tracer.result import DetectedHistories, TracerResult
from mcrim_mitsuba.tracer.trace import trace

__all__ = ["Bench", "DetectedHistories", "TracerResult", "trace"]
