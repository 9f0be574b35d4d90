"""MCRIM on Mitsuba 3: light collection efficiency and absolute light yield of scintillators."""

from importlib.metadata import version

from mcrim_mitsuba.transport.llvm import claim_llvm

__version__ = version("mcrim-mitsuba")

# Before anybody imports Mitsuba: Dr.Jit opens LLVM at that moment.
claim_llvm()
