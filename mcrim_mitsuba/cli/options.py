"""Options that verbs share, with their units and checks."""

from __future__ import annotations

import math
import re

import click

from mcrim_mitsuba.errors import InputError
from mcrim_mitsuba.files.scene_xml import parse_define
from mcrim_mitsuba.files.values import parse_number, refuse_decimal_comma

LARGEST_SEED = 2**63 - 1
_THOUSANDS = re.compile(r"\d{1,3}(,\d{3})+")
_COUNT = re.compile(r"\d+(\.\d+)?(e\+?\d+)?", re.IGNORECASE)


class Photons(click.ParamType):
    """A number of photons: 2000000, 2e6 or 2_000_000."""

    name = "count"

    def convert(self, value, param, ctx) -> int:
        if isinstance(value, int):
            return value
        text = value.strip().replace("_", "")
        if _THOUSANDS.fullmatch(text):
            text = text.replace(",", "")
        refuse_decimal_comma(param.opts[0], text)
        if not _COUNT.fullmatch(text) or not 1 <= float(text) <= 1e13:
            self.fail(f"{value!r} is no number of photons; give 1 to 1e13, such as 2e6")
        return round(float(text))


class Precision(click.ParamType):
    """A relative precision: 0.2% or 0.002."""

    name = "fraction"

    def convert(self, value, param, ctx) -> float:
        if isinstance(value, float):
            return value
        text = value.strip()
        refuse_decimal_comma(param.opts[0], text)
        try:
            number = float(text.removesuffix("%")) * (0.01 if text.endswith("%") else 1.0)
        except ValueError:
            number = math.nan
        if not 1e-6 <= number <= 0.5:
            self.fail(f"{value!r} is no precision; give 0.0001% to 50%, such as 0.2%")
        return number


class Number(click.ParamType):
    """A finite number within bounds, both included.

    Parameters
    ----------
    least, most : float
        Bounds, in the option's unit.
    """

    name = "number"

    def __init__(self, least: float = -math.inf, most: float = math.inf) -> None:
        self.least, self.most = least, most

    def convert(self, value, param, ctx) -> float:
        if isinstance(value, int | float):
            return float(value)
        what = param.opts[0]
        number = parse_number(what, value)
        if not self.least <= number <= self.most:
            raise InputError(
                f"{what} = {value.strip()} is out of range",
                f"give a number from {self.least:g} to {self.most:g}",
            )
        return number


class Whole(click.IntRange):
    """A whole number within bounds."""

    def convert(self, value, param, ctx) -> int:
        try:
            return super().convert(value, param, ctx)
        except click.BadParameter:
            most = "2^63 - 1" if self.max == LARGEST_SEED else self.max
            self.fail(f"{value!r} is not a whole number from {self.min} to {most}", param, ctx)


def defines(function):
    """``-D name=value``, as a dictionary called `overrides`."""
    return click.option(
        "-D", "overrides", multiple=True, metavar="NAME=VALUE", callback=read_defines,
        help="Override a scene parameter (may be repeated); mm, 1/cm.",
    )(function)  # fmt: skip


def read_defines(ctx, param, values) -> dict[str, str]:
    """The dictionary of all ``-D``, as a callback of click."""
    found: dict[str, str] = {}
    for text in values:
        name, value = parse_define(text)
        if name in found:
            raise InputError(f"-D {name} is given twice", "give it once")
        found[name] = value
    return found


def json_output(function):
    return click.option(
        "--json", "json_file", metavar="FILE", help="Write the result as JSON; - for the screen."
    )(function)


def seed(function):
    return click.option(
        "--seed", type=Whole(0, LARGEST_SEED), default=0, show_default=True,
        help="Seed of the random numbers: the same seed gives the same result.",
    )(function)  # fmt: skip


def photons(default: str, *, at_most: bool = False, further: str = ""):
    """``--photons``, with a description of its default; `at_most` beside ``--precision``.

    `further` are sentences on what else may be spent.
    """
    return click.option(
        "--photons", type=Photons(), metavar="COUNT",
        help=f"Photons to follow, such as 2e6 (default: {default})"
        + ("; with --precision, at most." if at_most else ".")
        + (further and f" {further}"),
    )  # fmt: skip


def figure(what: str):
    """``--figure``, for a picture of `what`; its numbers go beside it."""
    return click.option(
        "--figure", metavar="FILE",
        help=f"Draw {what} (.png or .pdf); the numbers go beside it as .csv.",
    )  # fmt: skip


def precision(function):
    return click.option(
        "--precision", type=Precision(), metavar="FRACTION",
        help="Relative standard error to reach, such as 0.2%; photons are spent until then.",
    )(function)  # fmt: skip


def machine(function):
    """``--threads`` and ``--variant``."""
    function = click.option(
        "--threads", type=Whole(1, 1024), help="Processor threads (default: all)."
    )(function)
    return click.option(
        "--variant", default="llvm_ad_rgb", show_default=True, callback=_read_variant,
        help="Mitsuba variant; cuda_ad_rgb needs an NVIDIA GPU.",
    )(function)  # fmt: skip


def _read_variant(ctx, param, value) -> str:
    """A variant that can be used here, as a callback of click: refused before all else."""
    from mcrim_mitsuba.kernel.variants import refuse_unusable

    refuse_unusable(value)
    return value


scene_argument = click.argument("scene", type=click.Path(path_type=str))
