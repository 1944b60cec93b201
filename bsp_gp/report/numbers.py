"""Numbers as people read them: as many digits as the interval supports, powers of ten, units."""

import math
import re
import sys

NOT_KNOWN = "–"
"""What stands in place of a number that there is not."""
FINEST_RATIO = 1e-4
"""Of errors: what is closer is the same to any reader."""
LEAST = sys.float_info.min
"""What is smaller has no whole number of digits any more."""

_MAX_DIGITS = 13
_MANY, _TOO_MANY = 1e4, 1e9
"""Metres that are told in kilometres."""
_PLAIN = (1e-3, 1e5)  # sizes written without a power of ten
_SUPERSCRIPTS = str.maketrans("0123456789-+", "⁰¹²³⁴⁵⁶⁷⁸⁹⁻⁺")
_POWER = re.compile(r"(?:\^|\*\*)(?:([-+]?\d+)(?![\d.])|\(([-+]?\d+)\))")


def is_number(value):
    """Whether `value` is a finite real number."""
    return (
        not isinstance(value, str | bool | bytes)
        and hasattr(value, "__float__")
        and getattr(value, "ndim", 0) == 0
        and math.isfinite(value)
    )


def pretty_unit(unit):
    """Write a unit with raised powers; "" and "1" are no unit.

    Examples
    --------
    >>> pretty_unit("kg*m/s^2")
    'kg·m/s²'
    """
    text = str(unit or "").strip()
    if text in ("", "1"):
        return ""
    return _POWER.sub(lambda m: (m[1] or m[2]).translate(_SUPERSCRIPTS), text).replace("*", "·")


def with_unit(text, unit):
    """Append a unit to a number that is already written."""
    unit = pretty_unit(unit)
    return f"{text} {unit}" if unit and text != NOT_KNOWN else text


def power_of_ten(exponent):
    """``" × 10⁶"``; nothing for a power of zero."""
    return f" × 10{str(exponent).translate(_SUPERSCRIPTS)}" if exponent else ""


def _exponent(size):
    """Power of ten to take out of a number of this size; 0 where it is written plainly."""
    if size == 0 or _PLAIN[0] <= size < _PLAIN[1]:
        return 0
    return math.floor(math.log10(size))


def _fixed(value, decimals):
    text = f"{value:.{max(decimals, 0)}f}" if decimals >= 0 else f"{round(value, decimals):.0f}"
    return text.replace("-", "−") if float(text) else text.replace("-", "")


def format_number(value, digits=3):
    """Write a number with `digits` significant digits.

    Examples
    --------
    >>> format_number(0.18342), format_number(-6.1e-8, 2), format_number(float("nan"))
    ('0.183', '−6.1 × 10⁻⁸', '–')
    """
    if not is_number(value):
        return NOT_KNOWN
    value = float(value)
    if abs(value) < LEAST:
        return "0"
    value = float(f"{value:.{digits - 1}e}")
    exponent = _exponent(abs(value))
    size = abs(value) / 10.0**exponent
    decimals = digits - 1 - math.floor(math.log10(size) + 1e-12)
    return _fixed(value / 10.0**exponent, max(decimals, 0)) + power_of_ten(exponent)


def rounded(value, low, high):
    """Round an estimate and its interval to one or two digits of the interval.

    Returns
    -------
    value, low, high : str
        Without the power of ten; low and high are `NOT_KNOWN` if the interval is.
    power : str
        " × 10ⁿ", or "".
    """
    if not is_number(value):
        return NOT_KNOWN, NOT_KNOWN, NOT_KNOWN, ""
    value = float(value)
    if not (is_number(low) and is_number(high)):
        text = format_number(value, 4)
        mantissa, times, power = text.partition(" × ")
        return mantissa, NOT_KNOWN, NOT_KNOWN, times + power
    value, low, high = (x if abs(x) > LEAST else 0.0 for x in (value, float(low), float(high)))
    size = max(abs(value), abs(low), abs(high))
    exponent = _exponent(size)
    scale = 10.0**exponent
    half = (high - low) / 2 / scale
    leading = math.floor(math.log10(size / scale)) if size else 0
    decimals = 3 - leading
    if half > LEAST:  # two digits of a half-width that begins with 1 or 2, else one
        place = math.floor(math.log10(half))
        decimals = (1 if half / 10.0**place < 2.95 else 0) - place
    decimals = min(max(decimals, -leading), _MAX_DIGITS - 1 - leading)
    parts = [_fixed(part / scale, decimals) for part in (value, low, high)]
    return (*parts, power_of_ten(exponent))


def format_value(value, low=math.nan, high=math.nan, unit=""):
    """Write an estimate with its interval and unit, rounded as the interval supports.

    Examples
    --------
    >>> format_value(9.80665, 9.7912, 9.8221, "m/s^2")
    '9.807 [9.791, 9.822] m/s²'
    >>> format_value(0.5, unit="1/s")
    '0.5000 1/s'
    """
    middle, low, high, power = rounded(value, low, high)
    if NOT_KNOWN in (low, high):
        return with_unit(middle + power, unit)
    return with_unit(f"{middle} [{low}, {high}]{power}", unit)


def format_constant(constant):
    """Write a `ConstantEstimate`, in words where there is no number to be told."""
    c = constant
    if c.state == "undetermined":
        return "undetermined by these data"
    if c.state == "unfinished":
        return f"{format_value(c.value, unit=c.unit)}, where its fit stood when it was ended"
    text = format_value(c.value, c.low, c.high, c.unit)
    if c.state == "at_bound":
        return f"{format_value(c.value, unit=c.unit)}, at its bound"
    return text


def format_ratio(ratio):
    """Write a `Ratio` with its interval, no finer than `FINEST_RATIO`; None is not known."""
    if ratio is None:
        return NOT_KNOWN
    low, high = ratio.low, ratio.high
    if is_number(low) and is_number(high) and high - low < FINEST_RATIO:
        low = max(min(low, ratio.value - FINEST_RATIO), min(low, 0.0))
        high = max(high, ratio.value + FINEST_RATIO)
    return format_value(ratio.value, low, high)


def format_level(alpha):
    """Write a level of significance as it was chosen."""
    return f"α = {alpha:g}" if is_number(alpha) else "α not known"


def format_p(p):
    """Write a p-value as a statement.

    Examples
    --------
    >>> format_p(0.0312), format_p(0.0)
    ('p = 0.031', 'p < 0.0001')
    """
    if not is_number(p):
        return "p not known"
    if p < 1e-4:
        return "p < 0.0001"
    return f"p = {p:.2g}" if p < 0.995 else "p = 1"


def length_text(value, unit):
    """A length with its unit, many metres in km.

    Examples
    --------
    >>> length_text(0.25, "m"), length_text(5e4, "m"), length_text(5e4, "px")
    ('0.250 m', '50.0 km', '50000 px')
    """
    if unit == "m" and is_number(value) and _MANY <= abs(value) < _TOO_MANY:
        return with_unit(format_number(value / 1000), "km")
    return with_unit(format_number(value), unit)
