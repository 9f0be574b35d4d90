"""Helps with mistyped names: what was probably meant, and what there is."""

from __future__ import annotations

import difflib
from collections.abc import Iterable

#: Longer names are no slips, and comparing them takes long.
_LONGEST = 200


def closest(name: str, known: Iterable[str]) -> str | None:
    """The known name most like `name`, or None if nothing comes close."""
    if len(name) > _LONGEST:
        return None
    return next(iter(difflib.get_close_matches(name, list(known), n=1)), None)


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """Phrase for the second half of an `InputError` about an unknown name.

    Parameters
    ----------
    name : str
        The name as typed.
    known : iterable of str
        The names that would have been right, in the order to list them.

    Returns
    -------
    str
        ``did you mean n_gap? Known are: gap_mm, n_gap``; without the guess if nothing
        comes close.
    """
    known = list(known)
    if not known:
        return "there are no names to choose from"
    listing = f"nown are: {', '.join(known)}"
    guess = closest(name, known)
    return f"did you mean {guess}? K{listing}" if guess else f"k{listing}"
