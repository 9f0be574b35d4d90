"""Numbers and texts as people read them: rounded by errors, or to the digits that matter."""

from __future__ import annotations

import math
from decimal import Decimal, localcontext

#: Beyond these the digits are followed by a common power of ten.
_LARGEST_PLAIN = 1e6
_SMALLEST_PLAIN = 1e-4


def pdg(value: float, sigma: float | None) -> str:
    """``value ± sigma``, with as many digits as the error deserves.

    Review of Particle Physics, Introduction, section 5.3: where the three highest-order
    digits of the error lie in 100-354, keep two; in 355-949, keep one; in 950-999, round
    up to 1000 and keep two. The value gets the same last place: ``7.5 ± 1.2``, or
    ``(1.23 ± 0.05)e7`` for very large or small numbers.

    The value alone, to four digits, where the error is not known, None or nan, or 0 but for a
    sum's rounding: of what is exact, such as a closed form. Raises ValueError if it is negative.
    """
    if sigma is None or not math.isfinite(sigma) or not math.isfinite(value):
        unknown = sigma is None or math.isnan(sigma)
        return f"{value:.4g}" if unknown else f"{value:.4g} ± {sigma:.2g}"
    return f"{value:.4g}" if 0 <= sigma <= 1e-13 * abs(value) else pdg_parts(value, sigma)


def pdg_parts(value: float, *sigmas: float) -> str:
    """``value ± first ± second``: one number with errors of several origins.

    All get the last place that `pdg` would give the errors in quadrature, and one more where an
    error would vanish; an error of 0 is written as ``0``.

    Raises ValueError if an error is negative or nothing is finite.
    """
    total = math.hypot(*sigmas)
    if not (math.isfinite(value) and math.isfinite(total)) or min(sigmas, default=0.0) < 0:
        raise ValueError(f"{value} ± {sigmas} cannot be rounded")
    if total == 0:
        return f"{value:.15g} ± 0"
    with localcontext() as context:
        context.prec = 1000  # any two floats fit, whatever their exponents
        numbers = [Decimal(repr(float(number))) for number in (value, *sigmas)]
        whole = Decimal(repr(total))
        largest = max(abs(numbers[0]), whole)
        # of ten, to take out of all numbers: 0 where they read well as they are
        power = 0 if _SMALLEST_PLAIN <= largest < _LARGEST_PLAIN else largest.adjusted()
        numbers = [number.scaleb(-power) for number in numbers]
        # of the error one digit is kept, two where its first three are below 355
        two_digits = int(whole.scaleb(2 - whole.adjusted())) < 355
        last = whole.adjusted() - power - two_digits
        least = min(sigma for sigma in numbers[1:] if sigma > 0)
        if not least.quantize(Decimal(1).scaleb(last)):
            last -= 1
        place = Decimal(1).scaleb(last)
        # + 0 turns -0.00 into 0.00
        rounded, *errors = (f"{number.quantize(place) + 0:f}" for number in numbers)
        texts = [rounded, *(t if s > 0 else "0" for t, s in zip(errors, sigmas, strict=True))]
    together = " ± ".join(texts)
    return f"({together})e{power}" if power else together


def number(value: float | None, digits: int = 3) -> str:
    """A number in so many digits at least, whole ones in full; ``-`` where it is not known."""
    if value is None or not math.isfinite(value):
        return "-"
    return f"{value:.0f}" if abs(value) >= 10**digits else f"{value:.{digits}g}"


def p_text(p_value: float | None) -> str:
    """A p-value in two digits; ``-`` where there is none."""
    if p_value is None:
        return "-"
    return f"{p_value:.2g}" if p_value >= 1e-99 else "< 1e-99"


def p_equals(p_value: float | None) -> str:
    """A p-value in a sentence: ``p = 0.33``, ``p < 1e-99``, ``no p-value``."""
    if p_value is None:
        return "no p-value"
    text = p_text(p_value)
    return f"p {text}" if text.startswith("<") else f"p = {text}"


def percent(fraction: float, more: int = 0) -> str:
    """``0.50 %``, ``10.0 %``: two digits, three from 10 % on, and `more` where asked for."""
    value = 100 * fraction
    if 0 < value < 0.01:
        return "< 0.01 %"
    if value >= 99.95:
        return f"{value:.{more}f} %"
    return f"{value:#.{2 + more}g} %" if value < 9.95 else f"{value:#.{3 + more}g} %"


def probability(p: float) -> str:
    """``70 %``, ``0.3 %``, ``< 0.1 %``: no more digits than a probability deserves."""
    value = 100 * p
    if 0 < value < 0.095:
        return "< 0.1 %"
    if 99.905 < value < 100:
        return "> 99.9 %"
    return f"{value:.1f} %" if 0 < value < 0.95 or 99.05 < value < 100 else f"{value:.0f} %"


def capital(words: str) -> str:
    """Words at the beginning of a line."""
    return words[:1].upper() + words[1:]


def counted(number: int, what: str) -> str:
    """``1 reading``, ``2 readings``."""
    return f"{number} {what}" if number == 1 else f"{number} {what}s"


def unbroken(text: object) -> object:
    """A text whose numbers stay on one line with their errors; what is no text as it is."""
    return text.replace(" ± ", "\xa0±\xa0") if isinstance(text, str) else text


def short_text(value: object) -> str:
    """A scene parameter's value, numbers to six digits."""
    if isinstance(value, float):
        return f"{value:g}"
    return str(value).lower() if isinstance(value, bool) else str(value)
