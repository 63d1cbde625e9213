"""What a page gives, looked at before it is used. Each raises InvalidInput."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from ambrose.core.checks import InvalidInput, invalid

_LONGEST = 200  # characters of a word
_WIDE = (280, 1600)  # [px] of a picture


def word(given: Mapping[str, Any], name: str, longest: int = _LONGEST) -> str:
    """A text, "" where there is none."""
    value = given.get(name, "")
    if not isinstance(value, str) or len(value) > longest:
        wanted = f"a text of at most {longest} characters"
        raise invalid(name, str(value)[:40], wanted, "shorten it")
    return value


def number(given: Mapping[str, Any], name: str, default: float | None = None) -> float:
    """A finite number."""
    value = given.get(name, default)
    if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) < 1e15:
        raise invalid(name, str(value)[:40], "a finite number", "give it in SI units")
    return float(value)


def width(given: Mapping[str, Any]) -> int:
    """How wide a picture may be [px]."""
    return int(min(max(number(given, "width", 900), _WIDE[0]), _WIDE[1]))


def texts(given: Mapping[str, Any], most: int) -> dict[str, str]:
    """All fields of a form that are texts."""
    if len(given) > most:
        raise InvalidInput(f"a form has {most} fields at most; reload the page")
    return {name: value for name, value in given.items() if isinstance(value, str)}
