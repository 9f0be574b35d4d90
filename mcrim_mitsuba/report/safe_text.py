"""Texts that users typed, made harmless in a page: shown as they are, never interpreted."""

from __future__ import annotations

import re

from markupsafe import Markup, escape

from mcrim_mitsuba.characters import visible
from mcrim_mitsuba.figures.style import shortened

#: Characters of a text in a table or a sentence; files are shown in full.
MOST_IN_A_TABLE = 80

_RIGHT_TO_LEFT = (
    r"[\u0590-\u08ff\ufb1d-\ufdff\ufe70-\ufefe\U00010800-\U00010fff\U0001e800-\U0001efff]"
)
_RUN = re.compile(rf"{_RIGHT_TO_LEFT}+(?:[ ]+{_RIGHT_TO_LEFT}+)*")


def brief(text: object, most: int = MOST_IN_A_TABLE) -> str:
    """A text for a table, an attribute or a sentence: in one line, visible and not too long."""
    return shortened(str(text), most)


def said(text: object, most: int = MOST_IN_A_TABLE) -> Markup:
    """The same as markup: isolated, so that its direction of writing stays its own."""
    return Markup("<bdi>{}</bdi>").format(brief(text, most))


def in_full(text: object) -> Markup:
    """A file's text for ``<pre>``: what runs from right to left is isolated word by word."""
    shown = str(escape(visible(text, keep="\n\t")))
    return Markup(_RUN.sub(r"<bdi>\g<0></bdi>", shown))
