"""How complaints about a machine are worded: values as they stand in the file, and the word that
was probably meant.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from difflib import get_close_matches
from unicodedata import category

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
