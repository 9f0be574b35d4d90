"""What the article's simulation leaves out: where the gammas stop, and all indices but one."""

from __future__ import annotations

from dataclasses import replace

from mcrim_mitsuba.article import published as p
from mcrim_mitsuba.article import sections
from mcrim_mitsuba.article.budget_rows import article_campaign
from mcrim_mitsuba.article.rows import ArticleRow, compare
from mcrim_mitsuba.fit.result import LIGHT_YIELD
from mcrim_mitsuba.fit.surface import ALPHA_SCAT
from mcrim_mitsuba.neglect.crystal import KnownCrystal
from mcrim_mitsuba.neglect.quantities import Shift
from mcrim_mitsuba.neglect.result import Neglected
from mcrim_mitsuba.neglect.work import NeglectWork
from mcrim_mitsuba.recording import DEFAULT_VARIANT, RunOptions
from mcrim_mitsuba.work import Progress

_MATERIAL = "CaMoO4"
#: Photons of a simulation with another index, as a share of a surface's.
_SHARE = 1 / 32


def left_out(
    photons: int,
    seed: int,
    variant: str | None = None,
    threads: int | None = None,
    progress: Progress | None = None,
) -> tuple[Neglected, ...]:
    """Pieces of physics put into the article's bench one by one, polarisation followed.

    Parameters as `simulated.simulate_article`.
    """
    campaign = article_campaign(p.NOMINAL.alpha_abs_per_cm.value, None)
    scene = campaign.scene.with_overrides({"polarization": True})
    work = NeglectWork(
        replace(campaign, scene=scene),
        KnownCrystal.of(campaign, _MATERIAL, None, None),
        RunOptions(seed, variant or DEFAULT_VARIANT, threads),
        max(1, round(_SHARE * photons)),
        progress,
    )
    return work.neglected()


def neglected_rows(pieces: tuple[Neglected, ...]) -> list[ArticleRow]:
    """Shifts by what can be corrected, and sizes of what one index cannot describe.

    Efficiencies at the fitted coefficients, alpha_scat and the light yield fitted again.
    """
    rows = []
    for piece in pieces:
        of_eta = [(f"eta_{name}", piece.at_fixed[f"eta {name}"]) for name in ("air", "gel")]
        scattering, light = piece.refitted[ALPHA_SCAT], piece.refitted[LIGHT_YIELD]
        if piece.correction:
            rows += [
                *(_shift(piece, name, "%", moved, 100 / moved.before) for name, moved in of_eta),
                _shift(piece, "alpha_scat", "1/cm", scattering),
                _shift(piece, "Y", "ph/keV", light, remark=piece.put_in),
            ]
        else:
            rows += [
                *(_error(piece, name, moved) for name, moved in of_eta),
                _error(piece, "alpha_scat", scattering, remark=piece.put_in),
            ]
    return rows


def _shift(
    piece: Neglected, quantity: str, unit: str, moved: Shift, per: float = 1.0, remark: str = ""
) -> ArticleRow:
    return compare(
        sections.LIGHT_YIELD, f"shift of {quantity} by {piece.title}", None, per * moved.shift,
        sigma=per * moved.monte_carlo_sigma, systematic=per * moved.size_sigma or None, unit=unit,
        remark=remark,
    )  # fmt: skip


def _error(piece: Neglected, quantity: str, moved: Shift, remark: str = "") -> ArticleRow:
    per = 100 / moved.before
    return compare(
        sections.LIGHT_YIELD, f"error of {quantity} by {piece.title}", None, per * moved.as_error,
        sigma=per * moved.monte_carlo_sigma, unit="%", remark=remark,
    )  # fmt: skip
