"""The directives ``effects-table``, of all effects, and ``effects-sections``, one on each.

``not-modelled`` is the table of what is in no effect and in no error, as `mcrim budget` prints it.
Everything is read from the package itself, so the pages cannot fall behind it.
"""

import math
import re

from sphinx.util.docutils import SphinxDirective

from mcrim_mitsuba.core.rounding import capital
from mcrim_mitsuba.effects.catalogue import catalogue
from mcrim_mitsuba.effects.effect import Effect, EffectParameter
from mcrim_mitsuba.output.describe_campaign import not_modelled

_SPECIAL = re.compile(r"([\\`*_\[\]<>$|])")


def plain(text: str) -> str:
    """Text that Markdown takes as it is."""
    return _SPECIAL.sub(r"\\\1", text)


def number(value: float | None) -> str:
    if value is None:
        return "none"
    if math.isinf(value):
        return "∞" if value > 0 else "−∞"
    return f"{value:g}".replace("-", "−")


def span(low: float, high: float, unit: str) -> str:
    if math.isinf(low) and math.isinf(high):
        return "any"
    return f"{number(low)} to {number(high)} {unit}".strip()


def prediction(effect: Effect) -> str:
    """How a campaign's readings are predicted with the effect."""
    if effect.reading is not None:
        return "exactly, from the readings"
    if effect.weight is not None:
        return "weights of photon records"
    return "simulation"


def overview(effects: list[Effect]) -> list[str]:
    lines = [
        "| effect | parameter | range | absent at | predicted by |",
        "|---|---|---|---|---|",
    ]
    for effect in effects:
        name = f"[{effect.name}](#{effect.name.replace('_', '-')})"
        rows = effect.parameters or (None,)
        for parameter in rows:
            lines.append(f"| {name} | {parameter_cells(parameter)} | {prediction(effect)} |")
    return lines


def parameter_cells(parameter: EffectParameter | None) -> str:
    if parameter is None:
        return "on or off | | off"
    reach = span(parameter.minimum, parameter.maximum, parameter.unit)
    absent = number(parameter.absent)
    if parameter.nominal:
        reach, absent = f"offset of {reach}", "0"
    return f"`{parameter.name}` | {reach} | {absent}"


def section(effect: Effect) -> list[str]:
    lines = [
        f"## {effect.name}",
        "",
        f"**{plain(capital(effect.title))}.** {plain(effect.physics)}",
        "",
    ]
    for parameter in effect.parameters:
        usual = span(*parameter.plausible, parameter.unit)
        lines += [f"`{parameter.name}`", f": {plain(parameter.meaning)}. Usual: {usual}."]
        if parameter.nominal:
            lines += [f"  Numbers are offsets from the scene's `{parameter.nominal}`."]
        lines += [f"  A fit begins at {number(parameter.start)}.", ""]
    if effect.filled_only:
        lines += ["Does nothing where the gap is not filled: `n_gap` at most 1.0005.", ""]
    if effect.excludes:
        others = ", ".join(f"`{other}`" for other in effect.excludes)
        lines += [f"Excludes {others}.", ""]
    return [*lines, f"Source: {plain(effect.source)}.", ""]


class EffectsTable(SphinxDirective):
    def run(self):
        return self.parse_text_to_nodes("\n".join(overview(list(catalogue().values()))))


class EffectsSections(SphinxDirective):
    def run(self):
        lines = [line for effect in catalogue().values() for line in section(effect)]
        return self.parse_text_to_nodes("\n".join(lines), allow_section_headings=True)


class NotModelled(SphinxDirective):
    def run(self):
        rows = (("what", "what it does", "how much"), ("---",) * 3, *not_modelled())
        lines = (f"| {' | '.join(cells)} |" for cells in rows)
        return self.parse_text_to_nodes("\n".join(lines))


def setup(app) -> dict[str, bool]:
    app.add_directive("effects-table", EffectsTable)
    app.add_directive("effects-sections", EffectsSections)
    app.add_directive("not-modelled", NotModelled)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
