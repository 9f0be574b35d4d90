"""Numbers with errors, rounded as the Particle Data Group does."""

from __future__ import annotations

import math
from decimal import Decimal, localcontext

# beyond these the digits are followed by a common power of ten
_LARGEST_PLAIN = 1e6
_SMALLEST_PLAIN = 1e-4


def pdg(value: float, sigma: float | None) -> str:
    """``value ± sigma``, with as many digits as the error deserves.

    Review of Particle Physics, Introduction, section 5.3: where the three highest-order
    digits of the error lie in 100-354, keep two; in 355-949, keep one; in 950-999, round
    up to 1000 and keep two. The value gets the same last place.

    Parameters
    ----------
    value : float
        The number.
    sigma : float or None
        Its standard error in the same unit. None or nan: not known, the value alone is
        given to four digits; 0: exact, the value is not rounded.

    Returns
    -------
    str
        ``7.5 ± 1.2``, or ``(1.23 ± 0.05)e7`` for very large or small numbers.

    Raises
    ------
    ValueError
        If `sigma` is negative.
    """
    if sigma is None or not math.isfinite(sigma) or not math.isfinite(value):
        unknown = sigma is None or math.isnan(sigma)
        return f"{value:.4g}" if unknown else f"{value:.4g} ± {sigma:.2g}"
    if sigma < 0:
        raise ValueError(f"the error {sigma} is negative")
    if sigma == 0:
        return f"{value:.15g} ± 0"
    with localcontext() as context:
        context.prec = 1000  # any two floats fit, whatever their exponents
        exact_value, exact_sigma = Decimal(repr(float(value))), Decimal(repr(float(sigma)))
        power = _common_power(abs(exact_value), exact_sigma)
        exact_value, exact_sigma = exact_value.scaleb(-power), exact_sigma.scaleb(-power)
        place = Decimal(1).scaleb(_last_place(exact_sigma))
        # + 0 turns -0.00 into 0.00
        value_text = f"{exact_value.quantize(place) + 0:f}"
        sigma_text = f"{exact_sigma.quantize(place):f}"
    pair = f"{value_text} ± {sigma_text}"
    return f"({pair})e{power}" if power else pair


def pdg_parts(value: float, *sigmas: float) -> str:
    """``value ± first ± second``: one number with errors of several origins.

    All get the last place that `pdg` would give the errors in quadrature, and one more where an
    error would vanish; an error of 0 is written as ``0``.

    Raises
    ------
    ValueError
        If an error is negative or nothing is finite.
    """
    total = math.hypot(*sigmas)
    if not (math.isfinite(value) and math.isfinite(total)) or min(sigmas, default=0.0) < 0:
        raise ValueError(f"{value} ± {sigmas} cannot be rounded")
    if total == 0:
        return pdg(value, 0.0)
    with localcontext() as context:
        context.prec = 1000
        numbers = [Decimal(repr(float(number))) for number in (value, *sigmas)]
        power = _common_power(abs(numbers[0]), Decimal(repr(total)))
        numbers = [number.scaleb(-power) for number in numbers]
        last = _last_place(Decimal(repr(total)).scaleb(-power))
        least = min(sigma for sigma in numbers[1:] if sigma > 0)
        if not least.quantize(Decimal(1).scaleb(last)):
            last -= 1
        place = Decimal(1).scaleb(last)
        value_text, *errors = (f"{number.quantize(place) + 0:f}" for number in numbers)
        texts = [value_text, *(t if s > 0 else "0" for t, s in zip(errors, sigmas, strict=True))]
    together = " ± ".join(texts)
    return f"({together})e{power}" if power else together


def _last_place(sigma: Decimal) -> int:
    """Power of ten of the last digit that PDG's rule keeps."""
    highest = sigma.adjusted()
    three_digits = int(sigma.scaleb(2 - highest))
    return highest - 1 if three_digits < 355 else highest


def _common_power(value: Decimal, sigma: Decimal) -> int:
    """Power of ten to take out of both numbers: 0 where they read well as they are."""
    largest = max(value, sigma)
    if _SMALLEST_PLAIN <= largest < _LARGEST_PLAIN:
        return 0
    return largest.adjusted()
