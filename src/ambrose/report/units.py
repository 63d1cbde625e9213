"""Numbers and units as people read them: the only place that leaves SI for the page.

Everything arrives in SI (rad/s, m, A, N, Pa); ``scale`` says which unit is shown and by which
factor, the rest is text.
"""

from __future__ import annotations

import math
import re

TWO_PI = 2.0 * math.pi  # rad/s per Hz
RPM = 60.0 / TWO_PI  # rpm per rad/s

# SI unit -> shown units as (magnitude from which it is used, factor, name); the first row is the
# smallest.
_SHOWN: dict[str, tuple[tuple[float, float, str], ...]] = {
    "m": ((0.0, 1e6, "µm"), (1e-2, 1e3, "mm")),
    "rad/s": ((0.0, 1 / TWO_PI, "Hz"),),
    "rad": ((0.0, 180 / math.pi, "°"),),
    "s": ((0.0, 1e3, "ms"), (1.0, 1.0, "s")),
    "Pa": ((0.0, 1e-5, "bar"),),
    "m/N": ((0.0, 1e6, "µm/N"),),
    "m/A": ((0.0, 1e6, "µm/A"),),
    "A/m": ((0.0, 1e-3, "A/mm"),),
    "N/m": ((0.0, 1e-3, "N/mm"),),
    "m/s": ((0.0, 1e3, "mm/s"),),
    "kg m": ((0.0, 1e6, "g mm"),),
    "kg m2": ((0.0, 1.0, "kg m²"),),
    "": ((0.0, 1.0, ""),),
    "-": ((0.0, 1.0, ""),),
    "1": ((0.0, 1.0, ""),),
}

_SUPERSCRIPTS = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
_GREEK = {"zeta": "ζ", "eta": "η", "sigma": "σ", "omega": "ω", "mu": "µ"}


def scale(unit: str, magnitude: float = 0.0) -> tuple[float, str]:
    """The factor and the name of the unit in which a quantity of that SI unit and magnitude is
    shown.
    """
    rows = _SHOWN.get(unit, ((0.0, 1.0, unit),))
    size = abs(magnitude) if math.isfinite(magnitude) else 0.0
    _, factor, name = max((row for row in rows if row[0] <= size), key=lambda row: row[0])
    return factor, name


def coefficient_scale(letter: str) -> tuple[float, str]:
    """Factor and unit in which a coefficient K, k, C, c of a seal is shown: what seals have."""
    return (1e-3, "kN/m") if letter in "Kk" else (1.0, "N s/m")


def number(value: float, digits: int = 3) -> str:
    """A number with that many significant digits: 0.0312, 4.1, 6 905, 1.2×10⁻⁷; never 1e-07."""
    if math.isnan(value):
        return "n/a"
    if math.isinf(value):
        return "∞" if value > 0 else "−∞"
    if value == 0:
        return "0"
    mantissa, exponent = f"{value:.{digits - 1}e}".split("e")
    power = int(exponent)
    if -4 < power < 6:
        text = f"{float(f'{value:.{digits - 1}e}'):,.{max(digits - 1 - power, 0)}f}".replace(
            ",", "\u202f"
        )
        text = text.rstrip("0").rstrip(".") if "." in text else text
    else:
        short = mantissa.rstrip("0").rstrip(".") if "." in mantissa else mantissa
        text = f"{short}×10{str(power).translate(_SUPERSCRIPTS)}"
    return text.replace("-", "−", 1) if text.startswith("-") else text


def quantity(value: float, unit: str, digits: int = 3) -> str:
    """A value of that SI unit as text with its shown unit, e.g. quantity(4.1e-5, "m") = "41 µm"."""
    factor, name = scale(unit, value)
    return join(number(value * factor, digits), name)


def join(text: str, unit: str) -> str:
    """A number's text and its unit; the degree sign sits close, all others after a no-break
    space.
    """
    return text + ("" if unit in {"", "°"} else "\u00a0") + unit


def pair(value: float, limit: float, unit: str) -> tuple[str, str]:
    """Value and limit in one shown unit, with as many digits as it takes to tell them apart (3.0004
    is not "3").
    """
    factor, name = scale(
        unit, max((abs(x) for x in (value, limit) if math.isfinite(x)), default=0.0)
    )
    for digits in range(3, 9):
        left, right = number(value * factor, digits), number(limit * factor, digits)
        if left != right or value == limit:
            break
    return join(left, name), join(number(limit * factor, max(digits, 3)), name)


def decibel(value: float) -> str:
    """A positive ratio in dB, e.g. "12.3 dB"; empty where there is none."""
    return f"{20 * math.log10(value):.1f}\u00a0dB".replace("-", "−") if 0 < value < math.inf else ""


def seconds_or_milliseconds(span: float) -> tuple[float, str]:
    """Factor and unit of a time axis of that length [s]."""
    return (1.0, "s") if span >= 1.0 else (1e3, "ms")


def axis_name(name: str) -> str:
    """A signal's name as people write it: "y_A_zeta" -> "y A ζ"."""
    words = re.split(r"[_\s]+", name.strip())
    return " ".join(_GREEK.get(word, word) for word in words)


def prose(text: str) -> str:
    """Text with the axes written as people do: "loop A_zeta" -> "loop A ζ"."""
    return re.sub(r"(?<=[A-Za-z0-9])_(zeta|eta)\b", lambda found: "\u00a0" + _GREEK[found[1]], text)


def fixed(value: float, half: float) -> str:
    """A number with as many digits as its half-width makes sense of: two of the half-width's."""
    if not (math.isfinite(value) and math.isfinite(half)) or half <= 0 or value == 0:
        return number(value, 5)
    digits = 2 + math.floor(math.log10(abs(value))) - math.floor(math.log10(half))
    return number(value, min(max(digits, 1), 9))


def plus_minus(value: float, half: float, unit: str) -> str:
    """ "3.10 ± 0.04 kN/m", all in the shown unit."""
    return f"{fixed(value, half)} ± {number(half, 2)} {unit}"
