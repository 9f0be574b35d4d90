"""MCRIM on Mitsuba 3: light collection efficiency and absolute light yield of scintillators."""

from importlib.metadata import version

__version__ = version("mcrim-mitsuba")
