"""Materials of the bench: refractive indices with dispersion, densities, sources."""

from mcrim_mitsuba.materials.band import IndexOverBand, index_over
from mcrim_mitsuba.materials.catalogue import (
    NAMES,
    chemical_formula,
    density_of,
    index,
    is_known,
    material,
)
from mcrim_mitsuba.materials.data import MATERIALS
from mcrim_mitsuba.materials.material import Material

__all__ = [
    "MATERIALS",
    "NAMES",
    "IndexOverBand",
    "Material",
    "chemical_formula",
    "density_of",
    "index",
    "index_over",
    "is_known",
    "material",
]
