"""Where the article contradicts itself, and where it leaves something open.

Found by reading it; the numbers in the sentences are computed from its own. The rows that
they concern carry the verdict ``article inconsistent``."""

from __future__ import annotations

from scipy.optimize import brentq

from mcrim_mitsuba.article import published as p
from mcrim_mitsuba.article.arithmetic import article_ratio
from mcrim_mitsuba.article.simulated import DEFAULT_WRAP_REFLECTANCE, Simulated
from mcrim_mitsuba.laboratory.peak import GAUSSIAN, fit_peak
from mcrim_mitsuba.laboratory.peak_shapes import PhotonSpectrum
from mcrim_mitsuba.optics.attenuation import (
    absorption_coefficient,
    internal_transmittance,
    transmittance,
)
from mcrim_mitsuba.optics.fresnel import escape_fraction


def mean_of_centroid(centroid: float) -> float:
    """Mean number of photons of a band in which a Gaussian finds a centroid.

    The band's intrinsic spread, pedestal and continuum are those that `PhotonSpectrum` takes as
    usual; spreads of 5 and 15 % move the mean by 0.9 %.
    """

    def apart(mean: float) -> float:
        spectrum = PhotonSpectrum(mean)
        photons = spectrum.photons()
        peak = fit_peak(photons, spectrum.expected(photons), shape=GAUSSIAN)
        assert peak is not None  # a clear one was drawn
        return peak.centroid - centroid

    return brentq(apart, 0.97 * centroid, 1.15 * centroid, xtol=1e-4)


def inconsistencies() -> tuple[str, ...]:
    """One sentence for each contradiction within the article."""
    path = p.CRYSTAL_MM.value
    measured = p.MEASURED_TRANSMITTANCE.value / 100
    corrected = 100 * internal_transmittance(measured, p.N_CRYSTAL.value)
    from_t = absorption_coefficient(p.NOMINAL.transmittance_percent.value / 100, path)
    from_alpha = 100 * transmittance(p.NOMINAL.alpha_abs_per_cm.value, path)
    gel_index = p.N_CRYSTAL.value / p.N_GEL.value
    relative = p.SIGNAL_AIR.value / p.CAWO4_SIGNAL.value * p.CAWO4_YIELD.value
    per_eta = relative * p.CAWO4_EFFICIENCY.value / p.EFFICIENCY.value * p.CAWO4_ETA.value / 100
    ratio = article_ratio()
    return (
        f"Eq. 4: T = 96.0 % over 10 mm is {from_t:.4f} /cm; the article writes 0.039, which is "
        f"T = {from_alpha:.1f} %.",
        f"Sec. 4: 76 % corrected for multiple reflection at n = 2.01 is T = {corrected:.1f} % "
        f"({absorption_coefficient(corrected / 100, path):.3f} /cm), not 96 % (0.039 /cm).",
        'Eq. 5: the right-hand side reads "eta_1/eta_1"; it means eta_1/eta_2.',
        f"Eq. 6: with the stated n = 1.38 it gives "
        f"{100 * escape_fraction(p.RELATIVE_INDEX_GEL.value):.1f} %; the printed 15.6 % is that "
        f"of n = 2.01/1.46 = {gel_index:.4f}.",
        'Sec. 6.2: "Fig. 2" for the curves of eta means Fig. 3.',
        f"Sec. 6.2: 14.3/24.5 is {ratio.value:.4f} ± {ratio.sigma:.4f}; printed is "
        "0.583 ± 0.012, both cut off instead of rounded.",
        f"Eq. 7: evaluated with eta = 0.23 for CaMoO4 ({per_eta / p.RELATIVE_ETA.value:.1f} "
        f"ph/keV), while Table 1 has 25 % for the same air gap "
        f"({100 * per_eta / p.NOMINAL.eta_air_percent.value:.1f} ph/keV).",
        'Sec. 6.4: "alpha_scat" of CaWO4 appears twice, as 0.065 and 0.061 /cm; the first is its '
        "absorption coefficient.",
        f'Sec. 6.4: "5.6 ph/keV" for equal light collection: 14.3/40.1 x 16.2 is {relative:.1f}, '
        f"and {relative * p.CAWO4_EFFICIENCY.value / p.EFFICIENCY.value:.2f} with the two "
        "detector efficiencies.",
    )


def open_points(simulated: Simulated) -> tuple[str, ...]:
    """One sentence for each number that the article does not specify, or that ours contradicts."""
    wrapped = [100 * result.eta for result in simulated.wrapped.values()]
    middle = 100 * simulated.wrapped[DEFAULT_WRAP_REFLECTANCE].eta
    path = p.CRYSTAL_MM.value
    out_of_beam = 100 * (1 - transmittance(p.ALPHA_SCAT.value, path))
    of_beam = absorption_coefficient(p.CORRECTED_TRANSMITTANCE.value / 100, path)
    air, gel = (mean_of_centroid(signal.value) for signal in (p.SIGNAL_AIR, p.SIGNAL_GEL))
    return (
        "Sec. 6.1: counted photons lean towards small numbers, and a Gaussian fitted to their band "
        f"finds its top, not its mean, which Eq. 2 needs: centroids of {p.SIGNAL_AIR.value:g} and "
        f"{p.SIGNAL_GEL.value:g} are those of {air:.1f} and {gel:.1f} photons per event (10 % "
        f"intrinsic spread), and the ratio is {air / gel:.3f}; see `mcrim lab peak`.",
        f"Secs. 4, 6.2: isotropic scattering of {p.ALPHA_SCAT.value:g} /cm takes "
        f"{out_of_beam:.0f} % out of a beam through {path:g} mm, yet the transmittance of 96 % "
        f"leaves {of_beam:.3f} /cm for absorption and scattering together: the spectrophotometer "
        "collects scattered light, or scattering is forward, or alpha_scat stands for something "
        "else that redirects light, such as surfaces and edges.",
        f"Sec. 6.2: a thin sample with gel: the article says 63 %, this bench gives "
        f"{100 * simulated.thin.eta:.1f} %.",
        "Secs. 6.2, 6.4: dimensions and index of the CaWO4 crystal are not given; a 10 mm cube of "
        f"n = 1.92 gives {100 * simulated.cawo4.eta:.1f} %, the article has 16.2 %.",
        f"Sec. 6.5: the wrapped cube (56 %) is not specified; a Lambertian reflector behind air "
        f"gives {middle:.1f} % ({min(wrapped):.1f} to {max(wrapped):.1f} % for reflectances of "
        f"{p.TEFLON_LOW.text} to {p.TEFLON_HIGH.text}), and [13] then "
        f"{p.KIM_MEASURED.value / (middle * p.KIM_EFFICIENCY.value / 1e4):.1f} instead of "
        "7.8 ph/keV.",
        "Figs. 2-4: their data are not in the text; our curves carry Table 1's values and the "
        "band of the measured R instead, and our Fig. 2 shows synthetic histograms. Eq. 3 cannot "
        "be evaluated without the spectra.",
    )
