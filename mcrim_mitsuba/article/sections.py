"""Headings under which the article's numbers are shown, in its order."""

TRANSMITTANCE = "Sec. 3-4, Eq. 4: transmittance and absorption"
BARE_CRYSTAL = "Sec. 5, Eq. 6: light that leaves a bare crystal"
BENCH = "Sec. 4-5: the bench, as the article states it and as the scene has it"
RATIO = "Sec. 6.1-6.2, Eq. 5: the measured ratio"
TABLE_1 = "Sec. 6.2-6.3, Table 1 and Fig. 4: scattering coefficient from the ratio"
EFFICIENCY = "Sec. 6.2-6.3, Table 1 and Fig. 3: light collection efficiency"
OTHER_CRYSTALS = "Sec. 6.2, 6.4, 6.5: other crystals"
LIGHT_YIELD = "Sec. 6.3, Eqs. 1-2: absolute light yield"
RELATIVE = "Sec. 6.4, Eq. 7: relative method"
TABLE_2 = "Sec. 6.5, Table 2: other measurements"
QUOTED = "Quoted or measured by the article, and used or kept as they are"

ORDER = (
    TRANSMITTANCE,
    BARE_CRYSTAL,
    BENCH,
    RATIO,
    TABLE_1,
    EFFICIENCY,
    OTHER_CRYSTALS,
    LIGHT_YIELD,
    RELATIVE,
    TABLE_2,
    QUOTED,
)
