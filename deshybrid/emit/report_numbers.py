"""Numbers as a reader wants them: few digits, a true minus sign, powers of ten, units.

In: numbers of any stage.  Out: short texts for pages; never for files that are read back.
"""

import math
from collections.abc import Iterable

_SUPERSCRIPTS = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
_MINUS = "\N{MINUS SIGN}"


def number(value: float, digits: int = 4) -> str:
    """Return `value` with `digits` significant digits.

    >>> number(-0.25), number(1234567.0), number(2.5e-7), number(float("inf")), number(-0.0)
    ('−0.25', '1.235·10⁶', '2.5·10⁻⁷', '∞', '0')
    """
    if math.isnan(value):
        return "undefined"
    sign = _MINUS if value < 0 else ""
    if math.isinf(value):
        return f"{sign}∞"
    mantissa, _, exponent = f"{abs(value):.{digits - 1}e}".partition("e")
    if value == 0 or -4 <= int(exponent) < digits + 1:
        text = f"{abs(value):.{max(0, digits - 1 - int(exponent))}f}" if value else "0"
        return sign + (text.rstrip("0").rstrip(".") if "." in text else text)
    mantissa = mantissa.rstrip("0").rstrip(".")
    power = "10" + str(int(exponent)).translate(_SUPERSCRIPTS)
    return sign + (power if mantissa == "1" else f"{mantissa}·{power}")


def seconds(value: float) -> str:
    """Return a duration, in milliseconds where it is short.

    >>> seconds(0.012), seconds(1.5), seconds(0.0), seconds(float("inf"))
    ('12 ms', '1.5 s', '0 s', '∞')
    """
    if math.isinf(value):
        return number(value)
    return f"{number(value * 1000, 3)} ms" if 0 < abs(value) < 0.1 else f"{number(value)} s"


def quantity(value: float, unit: str | None) -> str:
    """Return a number with its unit; none is written where the unit is empty, missing or 1.

    >>> quantity(2.0, "rad/s"), quantity(2.0, "1")
    ('2 rad/s', '2')
    """
    return f"{number(value)} {unit}" if unit and unit != "1" else number(value)


def roots(values: Iterable[complex]) -> str:
    """Return eigenvalues in the order given, conjugate pairs joined.

    >>> roots([-1 + 2j, -1 - 2j, -3 + 0j]), roots([])
    ('−1 ± 2i, −3', 'none')
    """
    texts = []
    for value in values:
        small = abs(value.imag) <= 1e-9 * abs(value)
        if small:
            texts.append(number(value.real))
        elif value.imag > 0:
            texts.append(f"{number(value.real)} ± {number(value.imag)}i")
    return ", ".join(texts) or "none"


def count(value: int, singular: str, plural: str = "") -> str:
    """Return how many there are, in words of the right number; small numbers are spelt.

    >>> count(1, "state"), count(12, "state"), count(0, "copy", "copies"), count(42_000, "byte")
    ('one state', 'twelve states', 'no copies', '42,000 bytes')
    """
    words = ("no", "one", "two", "three", "four", "five", "six", "seven", "eight", "nine", "ten", "eleven", "twelve")
    amount = words[value] if value < len(words) else f"{value:,}"
    return f"{amount} {singular if value == 1 else plural or singular + 's'}"
