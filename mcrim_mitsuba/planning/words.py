"""What a planning found, in sentences."""

from __future__ import annotations

import math

from mcrim_mitsuba.findings import together
from mcrim_mitsuba.fit.surface import ALPHA_ABS
from mcrim_mitsuba.planning.plans import (
    EFFICIENCY,
    EVENTS_ORIGIN,
    MOUNTINGS_ORIGIN,
    PRIOR,
    STATISTICAL,
    ExpectedError,
    Plan,
    Planning,
)

# Parts of an error that make less than this of its square are not named.
_NAMED = 0.03
_MENDS = {
    EFFICIENCY: (
        "a detector whose quantum efficiency is calibrated better, or a comparison with a crystal "
        "of known light yield (mcrim lab relative)"
    ),
    "quantum efficiency curve": (
        "a quantum-efficiency curve of this very tube, measured better, or a comparison with a "
        "crystal of known light yield (mcrim lab relative)"
    ),
    "emission spectrum": "an emission spectrum measured better",
    EVENTS_ORIGIN: "more events in each histogram",
    MOUNTINGS_ORIGIN: "more mountings of each coupling",
    PRIOR + ALPHA_ABS: (
        "a transmittance measured better (mcrim lab absorption), or more couplings, which "
        "determine the absorption themselves"
    ),
}


def verdict(found: Planning) -> tuple[str, ...]:
    """The cheapest plan, or what forbids the wanted error and by what that is reduced.

    Parameters
    ----------
    found : Planning
    """
    wanted, plan = percent(found.wanted), found.cheapest
    if plan is not None:
        return (f"Cheapest plan for a light yield to {wanted}: {plan_text(found, plan)}",)
    sets, floor = found.lowest_floor
    lines = [
        _forbidden(found, sets, floor) if floor.total > found.wanted else _not_among_these(found)
    ]
    statistical = found.cheapest_statistical
    if statistical is not None:
        lines.append(
            f"The statistical part alone reaches {wanted} with {plan_text(found, statistical)}"
        )
    else:
        least = min(found.plans, key=lambda p: p.light_yield.statistical)
        lines.append(f"Nor does the statistical part alone: the least is {plan_text(found, least)}")
    return tuple(lines)


def plan_text(found: Planning, plan: Plan, more: int = 0) -> str:
    """``n_gap = 1, 1.46; 4 mountings of 10,000 events each: 5 h, light yield to 10.6 % (...)``.

    `more` digits of the light yield's error may be asked for.
    """
    light, scattering = plan.light_yield, plan.alpha_scat
    count = "1 mounting" if plan.mountings == 1 else f"{plan.mountings} mountings"
    text = (
        f"{found.name(plan.configurations)}; {count} of {plan.events:,.0f} events each: "
        f"{plan.hours:.1f} h, light yield to {percent(light.total, more)} (statistical "
        f"{percent(light.statistical)}, systematic {percent(light.systematic)})"
    )
    if scattering is None:
        return text
    return f"{text}, alpha_scat to {percent(scattering.total)}"


def _forbidden(found: Planning, sets: tuple[int, ...], floor: ExpectedError) -> str:
    """Readings without error would not do."""
    named = sorted(
        ((part, name) for name, part in floor.parts.items() if part**2 > _NAMED * floor.total**2),
        reverse=True,
    )
    origin = named[0][1]
    more = _digits_apart(found.wanted, floor.total)
    makes = together([f"{name} {percent(part)}" for part, name in named])
    text = (
        f"A light yield to {percent(found.wanted, more)} cannot be reached, however many events "
        f"and mountings: readings without error ({found.name(sets)}) would leave "
        f"{percent(floor.total, more)} ({makes}). What forbids it first is the {origin}"
    )
    rest = min(p.light_yield.total**2 - p.light_yield.parts[origin] ** 2 for p in found.plans)
    if rest < found.wanted**2:
        needed = percent(math.sqrt(found.wanted**2 - rest))
        text += f": with the most precise of these plans it would have to fall to {needed}"
    else:
        text += ", and it is not the only part that is too large"
    return f"{text}. It is reduced by {_mend(origin)}"


def _not_among_these(found: Planning) -> str:
    """More statistics would do."""
    least = min(found.plans, key=lambda p: p.light_yield.total)
    of_plan = {
        name: part
        for name, part in least.light_yield.parts.items()
        if name in STATISTICAL or name.startswith(PRIOR)
    }
    origin = max(of_plan, key=of_plan.__getitem__)
    more = _digits_apart(found.wanted, least.light_yield.total)
    return (
        f"A light yield to {percent(found.wanted, more)} is not among these plans; the most "
        f"precise is {plan_text(found, least, more)}. What it would take first: {_mend(origin)}"
    )


def _mend(origin: str) -> str:
    if origin.startswith(PRIOR):
        name = origin.removeprefix(PRIOR)
        return _MENDS.get(origin, f"{name} measured better by other means")
    return _MENDS.get(origin, _MENDS[EFFICIENCY])


def percent(fraction: float, more: int = 0) -> str:
    """``0.50 %``, ``10.0 %``: two digits, three from 10 % on, and `more` where asked for."""
    number = 100 * fraction
    if 0 < number < 0.01:
        return "< 0.01 %"
    if number >= 99.95:
        return f"{number:.{more}f} %"
    return f"{number:#.{2 + more}g} %" if number < 9.95 else f"{number:#.{3 + more}g} %"


def _digits_apart(first: float, second: float) -> int:
    """Digits that `percent` needs besides the usual ones to tell two fractions apart."""
    return next((more for more in range(6) if percent(first, more) != percent(second, more)), 0)
