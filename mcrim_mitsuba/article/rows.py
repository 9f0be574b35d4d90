"""One number of the article beside ours, and the rule that judges the two."""

from __future__ import annotations

import math
from dataclasses import dataclass

from mcrim_mitsuba.article.published import Printed

AGREES = "agrees"
DIFFERS = "differs"
INCONSISTENT = "article inconsistent"
REFERENCE = "reference only"

#: Standard errors of the difference within which two numbers agree.
AGREEMENT_SIGMAS = 2.0
RULE = (
    f"'agrees': the difference is within {AGREEMENT_SIGMAS:g} of its standard errors plus the "
    "rounding of the printed digits, those of the numbers that ours is computed from included. "
    "An error that both numbers share does not count. Numbers that the article simulated carry "
    "the binomial error of its 100,000 rays."
)


@dataclass(frozen=True)
class ArticleRow:
    """One number of the article and ours.

    Attributes
    ----------
    section : str
        Heading that it belongs under.
    quantity : str
        What it is and where the article has it.
    unit : str
        Of every number of the row; empty for a pure number.
    paper : float or None
        The article's number; None where it gives none.
    paper_sigma : float or None
        The standard error printed with it.
    paper_text : str
        Its characters; empty where there is none.
    ours : float or None
        None where nothing here recomputes it.
    sigma : float or None
        Statistical standard error of ours, counting and Monte Carlo.
    systematic : float or None
        Systematic standard error of ours; None where there is none.
    verdict : str
        ``agrees``, ``differs``, ``article inconsistent`` or ``reference only``.
    remark : str
        What the reader must know to judge the row.
    """

    section: str
    quantity: str
    unit: str
    paper: float | None
    paper_sigma: float | None
    paper_text: str
    ours: float | None
    sigma: float | None
    systematic: float | None
    verdict: str
    remark: str = ""


def verdict(difference: float, sigma: float, rounding: float) -> str:
    """Judge a difference.

    Parameters
    ----------
    difference : float
        Ours minus the article's.
    sigma : float
        Standard error of the difference; errors that both share excluded.
    rounding : float
        By how much the rounding of printed digits may have moved the two, at most.
    """
    # a hair for numbers that lie exactly on the limit, such as 0.5 - 0.45 against 0.05
    limit = (rounding + AGREEMENT_SIGMAS * sigma) * (1 + 1e-9)
    return AGREES if abs(difference) <= limit else DIFFERS


def compare(
    section: str,
    quantity: str,
    paper: Printed | None,
    ours: float | None,
    *,
    sigma: float | None = None,
    systematic: float | None = None,
    difference_sigma: float | None = None,
    rounding: float = 0.0,
    unit: str | None = None,
    inconsistent: bool = False,
    judged: bool = True,
    remark: str = "",
) -> ArticleRow:
    """A row with its verdict.

    Parameters
    ----------
    section, quantity, remark : str
    paper : Printed or None
    ours : float or None
    sigma, systematic : float, optional
        Errors of ours.
    difference_sigma : float, optional
        Standard error of the difference where it is not all three errors in quadrature,
        because the two numbers share some.
    rounding : float
        What the rounding of printed numbers that ours is computed from may move it by.
    unit : str, optional
        The printed number's when not given.
    inconsistent : bool
        The article's own numbers contradict this one: a finding of the reader, recorded in
        `inconsistencies`, which overrules the rule.
    judged : bool
        False where the two numbers stand side by side and need not agree.
    """
    if difference_sigma is None:
        parts = (paper.sigma if paper else None, sigma, systematic)
        difference_sigma = math.hypot(*(part or 0.0 for part in parts))
    if paper is None or ours is None or not judged:
        found = REFERENCE
    elif inconsistent:
        found = INCONSISTENT
    else:
        found = verdict(ours - paper.value, difference_sigma, paper.rounding + rounding)
    return ArticleRow(
        section=section,
        quantity=quantity,
        unit=unit if unit is not None else (paper.unit if paper else ""),
        paper=paper.value if paper else None,
        paper_sigma=paper.sigma if paper else None,
        paper_text=paper.text if paper else "",
        ours=None if ours is None else float(ours),
        sigma=None if sigma is None else float(sigma),
        systematic=None if systematic is None else float(systematic),
        verdict=found,
        remark=remark,
    )
