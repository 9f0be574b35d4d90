"""The fit: surfaces of light collection efficiency, a campaign's likelihood, its solution.

Knows nothing of any renderer: photons' histories come in as `PhotonRecords`, and
``calibrate(campaign, surfaces)`` turns a campaign into a `Calibration`.
"""

from mcrim_mitsuba.fit.calibration import TooLittleSimulatedError, calibrate
from mcrim_mitsuba.fit.interpolation import InterpolatedSurface, axes_for
from mcrim_mitsuba.fit.ratio import RatioSolution, alpha_scat_from_ratio
from mcrim_mitsuba.fit.records import PhotonRecords
from mcrim_mitsuba.fit.result import Calibration, FittedRow, ParameterEstimate
from mcrim_mitsuba.fit.reweighting import EtaSurface
from mcrim_mitsuba.fit.surface import EtaPoint, Surface

__all__ = [
    "Calibration",
    "EtaPoint",
    "EtaSurface",
    "FittedRow",
    "InterpolatedSurface",
    "ParameterEstimate",
    "PhotonRecords",
    "RatioSolution",
    "Surface",
    "TooLittleSimulatedError",
    "alpha_scat_from_ratio",
    "axes_for",
    "calibrate",
]
