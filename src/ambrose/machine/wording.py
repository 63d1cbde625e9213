"""How complaints about a machine are worded: values as they stand in the file, and the word that was probably meant."""

from __future__ import annotations

from collections.abc import Iterable
from difflib import get_close_matches

_LONGEST = 60


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


def meant(word: str, known: Iterable[str]) -> str:
    """The known word that ``word`` probably is, in other spelling or case; "" where none is close."""
    spelled = {name.lower(): name for name in known}
    close = get_close_matches(word.lower(), spelled, n=1, cutoff=0.6)
    return spelled[close[0]] if close else ""


def suggestion(word: str, known: Iterable[str], nothing: str = "there is none") -> str:
    """What to do about an unknown word: the close one, else all of them."""
    names = sorted(known)
    close = meant(word, names)
    if close:
        return f'did you mean "{close}"?'
    return f"known: {', '.join(names)}" if names else nothing
