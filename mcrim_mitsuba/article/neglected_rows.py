"""What the article's simulation leaves out: where the gammas stop, and all indices but one."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from mcrim_mitsuba.article import published as p
from mcrim_mitsuba.article import sections
from mcrim_mitsuba.article.budget_rows import article_campaign
from mcrim_mitsuba.article.rows import ArticleRow, compare
from mcrim_mitsuba.fit.result import LIGHT_YIELD
from mcrim_mitsuba.fit.surface import ALPHA_SCAT
from mcrim_mitsuba.neglect.crystal import KnownCrystal
from mcrim_mitsuba.neglect.result import Neglected
from mcrim_mitsuba.neglect.work import NeglectWork
from mcrim_mitsuba.recording import DEFAULT_VARIANT, RunOptions

_MATERIAL = "CaMoO4"
#: Photons of a simulation with another index, as a share of a surface's.
_SHARE = 1 / 32


def left_out(
    photons: int,
    seed: int,
    variant: str | None = None,
    threads: int | None = None,
    progress: Callable[[str, int, int], None] | None = None,
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
    """Shifts of the efficiencies at the fitted coefficients, of alpha_scat and of the yield."""
    return [
        row
        for piece in pieces
        for row in (
            *(
                _row(piece, f"eta_{name}", piece.at_fixed[f"eta {name}"], "%", of_value=True)
                for name in ("air", "gel")
            ),
            _row(piece, "alpha_scat", piece.refitted[ALPHA_SCAT], "1/cm"),
            _row(piece, "Y", piece.refitted[LIGHT_YIELD], "ph/keV", remark=f"{piece.put_in}"),
        )
    ]


def _row(
    piece: Neglected, quantity: str, shift, unit: str, *, of_value: bool = False, remark: str = ""
) -> ArticleRow:
    per = 100 / shift.before if of_value else 1.0
    return compare(
        sections.LIGHT_YIELD, f"shift of {quantity} by {piece.title}", None, per * shift.shift,
        sigma=per * shift.monte_carlo_sigma, systematic=per * shift.size_sigma or None, unit=unit,
        remark=remark,
    )  # fmt: skip
