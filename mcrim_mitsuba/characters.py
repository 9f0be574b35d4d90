"""Characters that steer what shows them: terminals, pages, figures."""

from __future__ import annotations

import unicodedata

# Joiners shape letters and emoji; what else is invisible, or reorders a line, is shown as its code.
_JOINERS = "\u200c\u200d"
_INVISIBLE = {"Cc", "Cf", "Cs", "Co", "Cn", "Zl", "Zp"}


def visible(text: object, keep: str = "") -> str:
    """A text with every control and other invisible character as its code, such as <U+202E>.

    Parameters
    ----------
    text : object
    keep : str
        Control characters that stay, such as line ends.
    """
    return "".join(
        f"<U+{ord(c):04X}>"
        if unicodedata.category(c) in _INVISIBLE and c not in _JOINERS and c not in keep
        else c
        for c in str(text)
    )
