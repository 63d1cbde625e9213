"""Quantities as people write them: a plain SI number, or a string with a unit ("0.5 mm", "31500
rpm") -> a float in SI.

The units of everyday use are a table with exact factors; any other unit is left to pint, which is
imported only then.
"""

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from decimal import Context, Decimal
from difflib import get_close_matches
from fractions import Fraction
from functools import lru_cache
from tokenize import TokenError
from typing import Any, TypeVar
from unicodedata import category

_NUMBER = re.compile(r"([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d{1,3})?)\s*(.*)", re.DOTALL)
_UNIT = re.compile(r"[A-Za-z%°][A-Za-z%°_]*-?\d?(?:[ /][A-Za-z%°(][A-Za-z%°_()]*-?\d?\)?)*")
# what stands within digits as people write them: groups of three, a decimal comma
_GROUPED = re.compile(r"([+-]?\d{1,3})((?:[ ,'_\u2019\u00a0\u2009\u202f]\d{3})+)(\.\d+)?(?!\d)")
_DECIMAL_COMMA = re.compile(r"[+-]?\d*,\d+(?![\d,.])")
_DASHES = "\u2212\u2010\u2011\u2012\u2013"  # signs that look like a minus
_LONGEST_TEXT = 200  # characters of a quantity
_LONGEST_UNIT = 40  # characters of its unit
_PI = Fraction("3.14159265358979323846264338327950288419716939937511")
_FLOAT_DIGITS = 17  # tell any two floats apart
_MOST_DIGITS = 50  # of a number that is converted exactly, at most
Values = TypeVar("Values", bound=Any)  # a number, or an array of them


@dataclass(frozen=True, slots=True)
class Dimension:
    """What a number measures: the SI unit it is stored in, an example as written in a file, and its
    everyday units.

    ``units`` maps a unit to its factor to SI: a number, followed by "pi" or "/pi" where pi is a
    factor, or by "+" and what is added. A closed dimension takes these units only: to pint ratio
    and angle are both "dimensionless", a turn, a radian and a count per second the same rate.
    """

    name: str
    unit: str
    example: str
    units: dict[str, str]
    closed: bool = False

    @property
    def phrase(self) -> str:
        """ "a length [m]", for messages."""
        if not self.units:
            return f"a {self.name}"
        return f"{'an' if self.name[0] in 'aeiou' else 'a'} {self.name} [{self.unit}]"

    @property
    def remedy(self) -> str:
        """How to write it, for messages."""
        if not self.units:
            return "write a number without quotes and unit"
        if self.unit == "-":
            return f'write a plain number or a string such as "{self.example}"'
        return f'write a plain number in {self.unit} or a string such as "{self.example}"'


def _dimension(
    name: str, unit: str, example: str, units: str, *, closed: bool = False
) -> tuple[str, Dimension]:
    """``units`` lists "unit=factor" pairs, separated by commas."""
    pairs = (entry.split("=") for entry in units.split(",") if entry)
    return name, Dimension(
        name, unit, example, {key.strip(): factor for key, factor in pairs}, closed
    )


_LENGTHS = "m=1,cm=1e-2,mm=1e-3,um=1e-6,in=0.0254,mil=2.54e-5"  # a mil: 0.001 in
_TORQUES = "N m=1,mN m=1e-3,N mm=1e-3,kN m=1e3"

# Rates as data sheets, rotor codes and spreadsheets write them: the turn, and the radian. A bare
# 1/s or s^-1 is both, and neither: it is not among them.
_TURNS = {"rpm": "1/60", "krpm": "100/6", "Hz": "1", "kHz": "1e3", "MHz": "1e6"}
_RADIANS = {"rad/s": "1", "rad/min": "1/60"}
_DEGREES = {"deg/s": "1/180"}
_SAME = {  # other spellings
    **dict.fromkeys(("1/min", "min-1", "r/min", "rev/min", "turn/min", "U/min", "tr/min"), "rpm"),
    **dict.fromkeys(("cpm", "cycles/min"), "rpm"),
    **dict.fromkeys(("cps", "rps", "r/s", "rev/s", "turn/s", "cycles/s"), "Hz"),
    **dict.fromkeys(("rad s-1", "rad/sec"), "rad/s"),
    "rad/minute": "rad/min",
    "°/s": "deg/s",
    "mils": "mil",
    "in.": "in",
    # a pound times seconds squared can only be one of force
    "lb s2/in": "lbf s2/in",
    "lb s2/in4": "lbf s2/in4",
    **dict.fromkeys(("lb s2 in", "lb in s2"), "lbf s2 in"),
    **{f"{prefix}Nm": f"{prefix}N m" for prefix in ("", "m", "k")},
    "Nmm": "N mm",
}


def _of_rate(kinds: dict[str, str], factor: Fraction, pi: str) -> str:
    """Entries of ``_dimension``: the units of a kind of rate, each times a factor and pi."""
    return ",".join(f"{unit}={Fraction(own) * factor}{pi}" for unit, own in kinds.items())


_ANGULAR = (
    _of_rate(_TURNS, Fraction(2), " pi"),
    _of_rate(_RADIANS, Fraction(1), ""),
    _of_rate(_DEGREES, Fraction(1), " pi"),
)
_CYCLIC = (
    _of_rate(_TURNS, Fraction(1), ""),
    _of_rate(_RADIANS, Fraction(1, 2), " /pi"),
    _of_rate(_DEGREES, Fraction(1, 2), ""),
)

DIMENSIONS: dict[str, Dimension] = dict(
    (
        _dimension("length", "m", "0.5 mm", _LENGTHS),
        _dimension("mass", "kg", "1.2 kg", "kg=1,g=1e-3"),
        _dimension(
            "moment of inertia",
            "kg m^2",
            "0.0021 kg m^2",
            "kg m2=1,kg mm2=1e-6,kg cm2=1e-4,g mm2=1e-9",
        ),
        _dimension("density", "kg/m^3", "7850 kg/m^3", "kg/m3=1,g/cm3=1e3,kg/dm3=1e3"),
        _dimension("area", "m^2", "480 mm^2", "m2=1,cm2=1e-4,mm2=1e-6"),
        _dimension(
            "angle", "rad", "45 deg", "rad=1,mrad=1e-3,deg=1/180 pi,°=1/180 pi", closed=True
        ),
        _dimension("angular rate", "rad/s", "31500 rpm", ",".join(_ANGULAR), closed=True),
        _dimension("frequency", "Hz", "15 kHz", ",".join(_CYCLIC), closed=True),
        _dimension("time", "s", "0.2 ms", "s=1,ms=1e-3,us=1e-6"),
        _dimension("current", "A", "4.5 A", "A=1,mA=1e-3"),
        _dimension("voltage", "V", "150 V", "V=1,mV=1e-3,kV=1e3"),
        _dimension("inductance", "H", "20 mH", "H=1,mH=1e-3,uH=1e-6"),
        _dimension("resistance", "ohm", "1.2 ohm", "ohm=1,mohm=1e-3"),
        _dimension("magnetic flux density", "T", "1.6 T", "T=1,mT=1e-3"),
        _dimension("power", "W", "1.5 MW", "W=1,kW=1e3,MW=1e6"),
        _dimension("torque", "N m", "0.5 N m", _TORQUES),
        _dimension("energy", "J", "2 kJ", "J=1,kJ=1e3,MJ=1e6"),
        _dimension("force", "N", "7.5 kN", "N=1,kN=1e3"),
        _dimension("pressure", "Pa", "2.04 bar", "Pa=1,kPa=1e3,MPa=1e6,bar=1e5,mbar=1e2"),
        _dimension("elastic modulus", "Pa", "210 GPa", "Pa=1,MPa=1e6,GPa=1e9,N/mm2=1e6"),
        _dimension("force per current", "N/A", "180 N/A", "N/A=1"),
        _dimension(
            "stiffness", "N/m", "2.4 N/um", "N/m=1,N/mm=1e3,N/um=1e6,kN/m=1e3,kN/mm=1e6,MN/m=1e6"
        ),
        _dimension(
            "damping",
            "N s/m",
            "300 N s/m",
            "N s/m=1,Ns/m=1,kN s/m=1e3,kNs/m=1e3,N s/mm=1e3,Ns/mm=1e3",
        ),
        _dimension(
            "pressure per time",
            "Pa/s",
            "20 bar/s",
            "Pa/s=1,kPa/s=1e3,MPa/s=1e6,bar/s=1e5,mbar/s=1e2",
        ),
        _dimension("velocity", "m/s", "2.5 mm/s", "m/s=1,mm/s=1e-3"),
        _dimension("compliance", "m/N", "0.1 um/N", "m/N=1,mm/N=1e-3,um/N=1e-6"),
        _dimension("current per displacement", "A/m", "18 A/mm", "A/m=1,A/mm=1e3,A/um=1e6"),
        _dimension("temperature", "K", "17.4 degC", "K=1,degC=1 +273.15,°C=1 +273.15", closed=True),
        _dimension("specific heat", "J/(kg K)", "460 J/(kg K)", "J/(kg K)=1,kJ/(kg K)=1e3"),
        _dimension(
            "specific gas constant", "J/(kg K)", "287.05 J/(kg K)", "J/(kg K)=1,kJ/(kg K)=1e3"
        ),
        _dimension("viscosity", "Pa s", "18 uPa s", "Pa s=1,mPa s=1e-3,uPa s=1e-6"),
        _dimension("ratio", "-", "40 %", "%=1e-2", closed=True),
        _dimension("plain number", "-", "", "", closed=True),
    )
)


def read_quantity(value: object, dimension: Dimension) -> float:
    """``value`` as written in a file (number or string with unit) in SI.

    Raises ValueError whose text goes after the name of the key: 'is "5 kg", but must be a length
    [m]; write ...'.
    """
    if isinstance(value, str):
        number = _read_text(value, dimension)
    elif isinstance(value, (int, float)) and not isinstance(value, bool):
        number = _as_float(value)
    else:
        raise _unreadable(value, dimension)
    if not math.isfinite(number):
        raise ValueError(f"is {shown(value)}, but must be finite; {dimension.remedy}")
    return number


def rewrite_quantity(old: str, value: float, dimension: Dimension) -> str:
    """``value`` [SI] in the unit of ``old``, such as "0.5 mm", with the fewest digits that read
    back as the very same number.

    Where no number in an uncommon unit does, it is written in the SI unit.
    """
    match = _NUMBER.fullmatch(old.strip())
    assert match is not None, "a quantity that was read"
    unit = old.strip()[match.end(1) :]
    factor, pi, offset = _conversion(canonical_unit(match[2]), dimension)
    exact = (Fraction(value) - offset) / factor / _PI**pi
    for digits in range(1, _MOST_DIGITS):
        context = Context(prec=digits)
        rounded = context.divide(Decimal(exact.numerator), Decimal(exact.denominator)).normalize(
            context
        )
        text = f"{rounded:f}" if -6 < rounded.adjusted() < 16 else str(rounded)
        if read_quantity(f"{text}{unit}", dimension) == value:
            return f"{text}{unit}"
    return f"{value!r} {dimension.unit}"


def canonical_unit(text: str) -> str:
    """One spelling for "kg*m**2", "kg·m^2", "kg m²" and "kg m2": the last; micro is "u".

    The sign of the ohm is "ohm"; a turn a minute is "rpm", however it is written.
    """
    for old, new in (
        ("**", ""),
        ("^", ""),
        ("²", "2"),
        ("³", "3"),
        ("⁻", "-"),
        ("¹", "1"),
        ("*", " "),
        ("·", " "),
        ("μ", "u"),
        ("µ", "u"),
        ("Ohm", "ohm"),
        ("\u03a9", "ohm"),
        ("\u2126", "ohm"),
    ):
        text = text.replace(old, new)
    text = re.sub(r"(?<=\w)-(?=[A-Za-z])", " ", text)  # lbf-s2/in
    text = re.sub(r"\s*/\s*", "/", " ".join(text.split()))
    text = re.sub(r"\blbm\b", "lb", text)
    return _SAME.get(text, text)


def _read_text(text: str, dimension: Dimension) -> float:
    text_read = text.strip()
    match = _NUMBER.fullmatch(text_read) if len(text) <= _LONGEST_TEXT else None
    if (match is None or not _starts_a_unit(match[2])) and (why := _foreign_digits(text_read)):
        raise ValueError(f"is {shown(text)}, but {why}")
    if match is None:
        raise _unreadable(text, dimension)
    digits, unit = match[1], canonical_unit(match[2])
    if not unit:
        raise ValueError(f"is {shown(text)}, a string without a unit; {dimension.remedy}")
    try:
        factor, pi, offset = _conversion(unit, dimension)
    except LookupError as error:
        requirement = error.args[0] or f"must be {dimension.phrase}"
        raise ValueError(f"is {shown(text)}, but {requirement}; {dimension.remedy}") from error
    if unit not in dimension.units:
        return float(digits) * float(factor)
    if not pi:
        return _as_float(Fraction(digits) * factor + offset)
    # written by rewrite_quantity: round once, to the very number
    if len(re.sub(r"[eE].*|[^0-9]", "", digits)) > _FLOAT_DIGITS:
        return _as_float(Fraction(digits) * factor * _PI**pi)
    return _as_float(Fraction(digits) * factor) * math.pi**pi


def in_si(values: Values, unit: str, dimension: Dimension) -> Values:
    """Numbers of a column in ``unit``, in SI: value times factor, plus offset ("degC"). ``unit`` as
    in a file, "mm"; the SI unit itself changes nothing.

    Raises ValueError whose text goes after the name of the unit: 'is "mph", but must be a unit of
    length; ...'.
    """
    if unit == dimension.unit:
        return values
    try:
        factor, pi, offset = _conversion(canonical_unit(unit), dimension)
    except LookupError as error:
        why = error.args[0] or f"must be a unit of {dimension.name}"
        known = list(dict.fromkeys((dimension.unit, *dimension.units)))[:8]
        raise ValueError(f'is "{unit}", but {why}; write one of {", ".join(known)}') from None
    scaled: Values = values * (float(factor) * math.pi**pi)
    return scaled + float(offset) if offset else scaled


def _starts_a_unit(text: str) -> bool:
    return not text or text[0].isalpha() or text[0] in "%°("


def _foreign_digits(text: str) -> str:
    """What of a number as people write it cannot be read, and how to write it; "" where the digits
    are not at fault.
    """
    if len(text) > _LONGEST_TEXT:
        return ""
    if text[:1] and text[0] in _DASHES:
        return f'its sign is no hyphen; write "-{text[1:]}"'
    if grouped := _GROUPED.match(text):
        first, groups = grouped[1], grouped[2]
        decimals = grouped[3] or ""
        kind = {",": "a comma", " ": "a blank"}.get(groups[0], f'"{groups[0]}"')
        rest = text[grouped.end() :]
        joined = first + re.sub(r"\D", "", groups) + decimals
        said = f'its digits are set apart by {kind}; write "{joined}{rest}"'
        if groups.count(",") == 1 and len(groups) == 4 and not decimals:
            said += f', or "{first}.{groups[1:]}{rest}" if it is the decimal mark'
        return said
    if decimal := _DECIMAL_COMMA.match(text):
        rest = text[decimal.end() :]
        return f'its decimal mark is a comma; write "{decimal[0].replace(",", ".")}{rest}"'
    return ""


def _conversion(unit: str, dimension: Dimension) -> tuple[Fraction, int, Fraction]:
    """The factor from a unit to SI, the power of pi in it, and what is added. Raises
    LookupError.
    """
    if unit not in dimension.units:
        return Fraction(_factor_by_pint(unit, dimension.name)), 0, Fraction(0)
    rational, _, rest = dimension.units[unit].partition(" ")
    return (
        Fraction(rational),
        {"pi": 1, "/pi": -1}.get(rest, 0),
        Fraction(rest[1:]) if rest.startswith("+") else Fraction(0),
    )


def _as_float(number: float | Fraction) -> float:
    try:
        return float(number)
    except OverflowError:
        return math.inf


def _unreadable(value: object, dimension: Dimension) -> ValueError:
    return ValueError(f"is {shown(value)}, but must be {dimension.phrase}; {dimension.remedy}")


@lru_cache(maxsize=256)
def _factor_by_pint(unit: str, dimension_name: str) -> float:
    """The factor from a less common unit to SI; raises LookupError saying what is wrong (nothing:
    the wrong dimension).
    """
    dimension = DIMENSIONS[dimension_name]
    if len(unit) > _LONGEST_UNIT or not _UNIT.fullmatch(unit):
        raise LookupError("its unit cannot be read")
    registry, errors = _registry()
    try:
        source = registry.Unit(re.sub(r"([A-Za-z])(-?\d)", r"\1**\2", unit))
    except (
        errors.PintError,
        TokenError,
        AttributeError,
        TypeError,
        ValueError,
        KeyError,
        AssertionError,
    ) as error:
        close = meant(unit, dimension.units)
        raise LookupError(
            "its unit is unknown" + (f' (did you mean "{close}"?)' if close else "")
        ) from error
    if dimension.closed or not source.is_compatible_with(canonical_for_pint(dimension.unit)):
        raise LookupError("")
    quantity = registry.Quantity(1.0, source)
    for name, _ in quantity.unit_items():
        own = dict(registry.Unit(name).dimensionality)
        # to pint a newton metre per degree is a torque, a bar times hertz a pressure per second
        if not own or own == {"[time]": -1}:
            raise LookupError(f"its unit has an angle, a share or a rate in it ({name})")
    return float(quantity.to(canonical_for_pint(dimension.unit)).magnitude)


def canonical_for_pint(unit: str) -> str:
    """The SI unit of a dimension in pint's notation."""
    return unit.replace("^", "**")


@lru_cache(maxsize=1)
def _registry() -> tuple[Any, Any]:
    """pint's unit registry, made when the first uncommon unit is met (it takes a few tenths of a
    second).
    """
    import pint
    import pint.errors

    return pint.UnitRegistry(), pint.errors


# How complaints about a machine are worded: values as they stand in the file, and the word that was
# probably meant.


_LONGEST = 60  # characters of a value in a message
SHOWN = 20  # problems, or known names, in one message
_LABELS = ("name", "label", "bearing", "parameter")  # keys that tell entries of a table apart
BULLET = "\n  - "  # before each further line of a message


def one_line(text: str) -> str:
    """``text`` as one line that steers no terminal: what is neither printed nor a space stands as
    its escape, ``\\x1b``.

    These are control characters (line ends and tabs among them), marks of the reading direction,
    halves of a character.
    """
    if text.isprintable():
        return text
    characters = (
        c if c.isprintable() or category(c) == "Zs" else c.encode("unicode_escape").decode()
        for c in text
    )
    return "".join(characters)


def shown(value: object) -> str:
    """A value as it stands in the file, shortened."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, dict):
        return "a table"
    try:
        text = f'"{value}"' if isinstance(value, str) else repr(value)
    except ValueError:  # Python refuses to print integers of thousands of digits
        text = "an integer of thousands of digits"
    return text if len(text) <= _LONGEST else f"{text[: _LONGEST - 10]} ..."


def quoted(value: object) -> str:
    """A value that somebody else wrote, as Python writes it, shortened."""
    text = repr(value)
    return text if len(text) <= _LONGEST else f"{text[: _LONGEST - 10]} ..."


def meant(word: str, known: Iterable[str]) -> str:
    """The known word that ``word`` probably is, in other spelling or case; "" where none is
    close.
    """
    spelled = {name.lower(): name for name in known}
    close = get_close_matches(word.lower(), spelled, n=1, cutoff=0.6)
    return spelled[close[0]] if close else ""


def suggestion(word: str, known: Iterable[str], nothing: str = "there is none") -> str:
    """What to do about an unknown word: the close one, else all of them."""
    names = sorted(known)
    close = meant(word, names)
    if close:
        return f'did you mean "{close}"?'
    rest = f" and {len(names) - SHOWN} more" if len(names) > SHOWN else ""
    return f"known: {', '.join(names[:SHOWN])}{rest}" if names else nothing


def listed(name: str, problems: Sequence[str]) -> str:
    """One message out of one problem or many."""
    if len(problems) == 1:
        return f"{name}: {problems[0]}"
    rest = [f"and {len(problems) - SHOWN} more; mend these first"] if len(problems) > SHOWN else []
    return BULLET.join([f"{name} has {len(problems)} problems:", *problems[:SHOWN], *rest])


def complaint(where: str, key: str, value: object, requirement: str, remedy: str) -> str:
    """The one form of a complaint about a key of a table."""
    return f"{where}: {key} is {value}, but must be {requirement}; {remedy}"


def as_written(value: float, quantity: str, unit: bool = True) -> str:
    """A pressure [Pa], a speed or a frequency [rad/s] in the unit in which people write it: bar
    (below 0.01 bar Pa), rpm, Hz.
    """
    if quantity == "pressure" and 0 < abs(value) < 1e3:
        return f"{value:.6g} Pa" if unit else f"{value / 1e5:.6g}"
    factor, name = {
        "pressure": (1e-5, "bar"),
        "speed": (30 / math.pi, "rpm"),
        "frequency": (0.5 / math.pi, "Hz"),
    }[quantity]
    return f"{value * factor:.6g} {name}" if unit else f"{value * factor:.6g}"


def number(value: float | None, unit: str) -> str:
    """A number with its unit."""
    return "missing" if value is None else f"{value:g} {unit}".strip()


def called(entry: object, table: str, number: int) -> str:
    """An entry by its name where it has one, else by its number; labels are free text and stand
    after the number.
    """
    name = (
        next((entry[key] for key in _LABELS if isinstance(entry.get(key), str)), "")
        if isinstance(entry, Mapping)
        else ""
    )
    if table in {"shaft", "point"} and name:
        return f'{number} "{name}"'
    return f"{number} {name}".rstrip() if table == "tolerance" else name or str(number)
