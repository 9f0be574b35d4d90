"""Results as a LaTeX table (booktabs), rounded as the Particle Data Group does."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence

from mcrim_mitsuba.characters import visible
from mcrim_mitsuba.converting.result_table import (
    AT_BOUND,
    DIAGNOSIS,
    ETA_TABLE,
    LOWER,
    RESULT,
    SIGMA,
    SIMULATION,
    UPPER,
    Cell,
    ResultTable,
    columns_of,
)
from mcrim_mitsuba.fit.result import LIGHT_YIELD
from mcrim_mitsuba.physics.rounding import pdg

_HEADINGS = {
    LIGHT_YIELD: r"light yield (ph\,keV$^{-1}$)",
    "alpha_scat_per_cm": r"$\alpha_{\mathrm{scat}}$ (cm$^{-1}$)",
    "alpha_abs_per_cm": r"$\alpha_{\mathrm{abs}}$ (cm$^{-1}$)",
    "n_gap": r"$n_{\mathrm{gap}}$",
    "n_crystal": r"$n_{\mathrm{crystal}}$",
    "eta": r"$\eta$",
    "chi2": r"$\chi^2$",
    "delta_chi2": r"$\Delta\chi^2$",
    "p_value": "$p$",
}
_LEFT_OUT = {
    DIAGNOSIS: ("p_global", "left_out_error", "aicc", "plausible", "verdict"),
    SIMULATION: ("photons",),
}
_SPECIAL = {
    "\\": r"\textbackslash{}", "{": r"\{", "}": r"\}", "$": r"\$", "&": r"\&", "#": r"\#",
    "%": r"\%", "_": r"\_", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}",
    "<": r"\textless{}", ">": r"\textgreater{}", "|": r"\textbar{}", '"': r"\textquotedbl{}",
    "±": r"$\pm$", "\u2212": "$-$",
}  # fmt: skip
_POWER = re.compile(r"\((.*)\)e([+-]?\d+)")


def latex_text(table: ResultTable) -> str:
    """A ``tabular``; its document needs the package booktabs.

    Values get the places that their errors deserve; what makes the results reproducible is in
    the JSON and in NetCDF, not here.
    """
    columns = _columns(table)
    lines = [
        r"% needs \usepackage{booktabs}; made by mcrim_mitsuba from "
        + ", ".join(visible(" ".join(name.split())) for name in table.provenance),
        r"\begin{tabular}{" + "".join(map(_alignment(table.rows), columns)) + "}",
        r"\toprule",
        _line([_HEADINGS.get(name) or escaped(name.replace("_", " ")) for name in columns]),
        r"\midrule",
        *(_line([_cell(row, name) for name in columns]) for row in table.rows),
        r"\bottomrule",
        r"\end{tabular}",
    ]
    return "\n".join(lines) + "\n"


def escaped(text: str) -> str:
    """A text that LaTeX shows as it is."""
    shown = visible(" ".join(text.split()))
    return "".join(_SPECIAL.get(character, character) for character in shown)


def _columns(table: ResultTable) -> list[str]:
    """Columns of a table that is read: errors stand beside values, what is alike is left out."""
    names = columns_of(table.rows)
    endings = (SIGMA, LOWER, UPPER, AT_BOUND)
    found = []
    for name in names:
        cells = [row.get(name) for row in table.rows]
        own = any(name.endswith(end) and name.removesuffix(end) in names for end in endings)
        if own or name in _LEFT_OUT.get(table.kind, ()) or all(c in (None, "") for c in cells):
            continue
        if name == RESULT and table.kind in (ETA_TABLE, DIAGNOSIS) and len(table.provenance) == 1:
            continue
        # parameters of scenes, and fates that no light met
        of_scene = table.kind == SIMULATION and name not in (RESULT, "eta")
        if of_scene and (all(c == 0 for c in cells) or _alike(cells, name + SIGMA in names)):
            continue
        found.append(name)
    return found


def _alike(cells: Sequence[Cell], measured: bool) -> bool:
    """Whether a column says nothing; what was simulated always says something."""
    return not measured and all(cell == cells[0] for cell in cells)


def _alignment(rows: Sequence[dict[str, Cell]]) -> Callable[[str], str]:
    def letter(name: str) -> str:
        return "l" if any(isinstance(row.get(name), str | bool) for row in rows) else "r"

    return letter


def _cell(row: dict[str, Cell], name: str) -> str:
    value = row.get(name)
    if value is None or value == "":
        return "--"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, str):
        return escaped(value)
    if row.get(name + AT_BOUND):
        return f"{_number(value)} (at its bound)"
    sigma = row.get(name + SIGMA)
    if sigma is not None and float(sigma) > 0:
        return _rounded(pdg(float(value), float(sigma)))
    return _number(value)


def _rounded(text: str) -> str:
    r"""``7.5 ± 1.2`` as ``$7.5 \pm 1.2$``."""
    power = _POWER.fullmatch(text)
    body = (power[1] if power else text).replace("±", r"\pm")
    return rf"$({body}) \times 10^{{{power[2]}}}$" if power else f"${body}$"


def _number(value: float | int) -> str:
    """A number without an error: an integer as it is, others in four digits."""
    if isinstance(value, int):
        return f"${value}$"
    mantissa, _, power = f"{value:.4g}".partition("e")
    return rf"${mantissa} \times 10^{{{int(power)}}}$" if power else f"${mantissa}$"


def _line(cells: Sequence[str]) -> str:
    return " & ".join(cells) + r" \\"
