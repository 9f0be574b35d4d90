"""Changes an input as its reader sees it: words, numbers, lines and signs instead of bits."""

from __future__ import annotations

import random
import re

#: What stands between the files of an input that has more than one.
SEPARATOR = b"\n%%%%\n"
_TOKEN = re.compile(r"[^\W\d]\w*|[0-9.]+(?:[eE][+-]?[0-9]+)?|[ \t]+|\n|.", re.DOTALL)
#: Numbers at which something ends, and what is nearly one.
_NUMBERS = (
    "0",
    "-0",
    "1",
    "-1",
    "1e-300",
    "4.9e-324",
    "1e308",
    "1e999",
    "-1e999",
    "nan",
    "inf",
    "-inf",
    "1,5",
    "1.5",
    "1.",
    ".5",
    "1e",
    "0x10",
    "1_000",
    "١٢",
    "１２",
    "1/3",
    "50%",
    "9" * 400,
    "9" * 5000,
    "0." + "0" * 400 + "1",
    "2147483648",
    "9223372036854775808",
    "1e5000",
    "true",
    "",
)
#: Signs that steer terminals, end lines, or are not what they look like.
_SIGNS = (
    "\0",
    "\x1b[31m",
    "\x1b]0;t\x07",
    "\r",
    "\r\n",
    "\u2028",
    "\u202e",
    "\ufeff",
    "\x85",
    "\x0c",
    "\udcff",
    "µ",
    "Å",
    "±",
    "\u2212",
    "\u00a0",
    "\U0001f600",
    '"',
    "'",
    "<",
    ">",
    "&",
    "$",
    "#",
    "=",
    ",",
    ";",
    "\t",
    "[",
    "]",
    "{",
    "}",
    "\\",
    "/",
    ":",
    "@",
    "..",
    "\n",
    "\n\n",
)
_MOST_COPIES = 100


def mutate(data: bytes, size: int, seed: int, words: tuple[str, ...]) -> bytes:
    """A changed input of `size` bytes at most, with `words` that the format knows.

    The same seed makes the same change.
    """
    rng = random.Random(seed)
    text = data.decode("utf-8", errors="surrogateescape")
    for _ in range(rng.choice((1, 1, 1, 2, 3, 6))):
        text = rng.choice(_CHANGES)(text, rng, words)
    return text.encode("utf-8", errors="surrogateescape")[:size]


def _new(rng: random.Random, words: tuple[str, ...]) -> str:
    return rng.choice(rng.choice((_NUMBERS, _SIGNS, words or _SIGNS)))


def _replace_token(text: str, rng: random.Random, words: tuple[str, ...]) -> str:
    tokens = _TOKEN.findall(text) or [""]
    place = rng.randrange(len(tokens))
    tokens[place] = rng.choice(tokens) if rng.random() < 0.3 else _new(rng, words)
    return "".join(tokens)


def _replace_number(text: str, rng: random.Random, words: tuple[str, ...]) -> str:
    tokens = _TOKEN.findall(text)
    numbers = [i for i, token in enumerate(tokens) if token[:1].isdecimal()]
    if numbers:
        tokens[rng.choice(numbers)] = rng.choice(_NUMBERS)
    return "".join(tokens)


def _insert(text: str, rng: random.Random, words: tuple[str, ...]) -> str:
    place = rng.randint(0, len(text))
    return text[:place] + _new(rng, words) + text[place:]


def _delete_tokens(text: str, rng: random.Random, words: tuple[str, ...]) -> str:
    tokens = _TOKEN.findall(text)
    start = rng.randint(0, len(tokens))
    del tokens[start : start + rng.choice((1, 1, 2, 5, 20))]
    return "".join(tokens)


def _repeat_tokens(text: str, rng: random.Random, words: tuple[str, ...]) -> str:
    tokens = _TOKEN.findall(text)
    start = rng.randint(0, len(tokens))
    some = tokens[start : start + rng.choice((1, 2, 5))]
    copies = rng.choice((1, 2, 10, _MOST_COPIES))
    return "".join([*tokens[:start], *some * copies, *tokens[start:]])


def _change_lines(text: str, rng: random.Random, words: tuple[str, ...]) -> str:
    lines = text.split("\n")
    first, second = rng.randrange(len(lines)), rng.randrange(len(lines))
    way = rng.randrange(4)
    if way == 0:
        del lines[first]
    elif way == 1:
        lines.insert(second, lines[first])
    elif way == 2:
        lines[first], lines[second] = lines[second], lines[first]
    else:
        lines[second:second] = [lines[first]] * rng.choice((2, 20, _MOST_COPIES))
    return "\n".join(lines)


_CHANGES = (
    _replace_token,
    _replace_token,
    _replace_number,
    _replace_number,
    _insert,
    _delete_tokens,
    _repeat_tokens,
    _change_lines,
)
