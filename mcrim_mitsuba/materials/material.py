"""What is known of one material."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mcrim_mitsuba.physics.dispersion import Dispersion


@dataclass(frozen=True)
class Material:
    """Indices of refraction, and for solids and liquids of one formula the density.

    Attributes
    ----------
    name : str
        As scenes write it.
    what : str
        What it is, and at which temperature.
    source : str
        Citation of the dispersion.
    ordinary : Dispersion
        The ordinary ray's; the only one where there is no birefringence.
    extraordinary : Dispersion or None
    sigma : float
        Standard error of the index, estimated: of the formula, and of one sample against another.
    formula : str or None
        Chemical formula.
    density_g_per_cm3 : float or None
    """

    name: str
    what: str
    source: str
    ordinary: Dispersion
    extraordinary: Dispersion | None = None
    sigma: float = 0.0
    formula: str | None = None
    density_g_per_cm3: float | None = None

    @property
    def range_nm(self) -> tuple[float, float]:
        """Shortest and longest wavelength at which all of its indices are known."""
        both = [self.ordinary, self.extraordinary or self.ordinary]
        return max(each.shortest_nm for each in both), min(each.longest_nm for each in both)

    def index(self, wavelength_nm: ArrayLike) -> NDArray[np.float64]:
        """Index of refraction; of a birefringent crystal the mean (2 n_o + n_e) / 3.

        Light of all directions and polarisations meets the ordinary index in two of three
        directions of the field and the extraordinary one in the third; a scene has one index
        per volume.

        Parameters
        ----------
        wavelength_nm : float or array

        Returns
        -------
        ndarray of float64
            Of the same shape.

        Raises
        ------
        InputError
            If a wavelength is outside the range of the formula.
        """
        ordinary = self.ordinary.index(wavelength_nm, self.name)
        if self.extraordinary is None:
            return ordinary
        return (2.0 * ordinary + self.extraordinary.index(wavelength_nm, self.name)) / 3.0

    def birefringence(self, wavelength_nm: ArrayLike) -> NDArray[np.float64]:
        """n_e - n_o; 0 where there is none. Parameters and errors as `index`."""
        ordinary = self.ordinary.index(wavelength_nm, self.name)
        if self.extraordinary is None:
            return np.zeros_like(ordinary)
        return self.extraordinary.index(wavelength_nm, self.name) - ordinary

    def ray(self, suffix: str) -> Material:
        """One ray of a birefringent crystal, which it must be, as a material of its own.

        Parameters
        ----------
        suffix : str
            ``o`` or ``e``.
        """
        assert self.extraordinary is not None
        kind = {"o": "ordinary", "e": "extraordinary"}[suffix]
        return Material(
            f"{self.name}_{suffix}",
            f"{self.what}, {kind} ray",
            self.source,
            self.ordinary if suffix == "o" else self.extraordinary,
            None,
            self.sigma,
            self.formula,
            self.density_g_per_cm3,
        )
