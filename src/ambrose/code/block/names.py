"""Names that become identifiers in generated code, and text that becomes a comment."""

from __future__ import annotations

import re
from collections.abc import Sequence

from ambrose.core.checks import invalid

_IDENTIFIER = re.compile(r"[A-Za-z][A-Za-z0-9_]*")
_LONGEST = 24  # of C99's 31 significant characters, 7 are left for _track and the like
_WORDS = """
auto break case char const continue default do double else enum extern float for goto if inline int
long register restrict return short signed sizeof static struct switch typedef union unsigned void
volatile while asm bool catch class delete explicit export false friend main mutable namespace new
NULL nullptr operator private protected public template this throw true try typename using virtual
"""  # C99's and, as the header is meant for C++ as well, the commonest of C++'s
KEYWORDS = frozenset(_WORDS.split())
# no file can be called so on Windows
_DEVICES = re.compile(r"(con|prn|aux|nul|com\d|lpt\d)", re.IGNORECASE)


def names_in_code(signals: Sequence[str]) -> tuple[str, ...]:
    """Signals as generated code calls them: names of a machine file may have hyphens, which become
    underscores.
    """
    return tuple(signal.replace("-", "_") for signal in signals)


def check_identifiers(name: str, inputs: Sequence[str], outputs: Sequence[str]) -> None:
    """Refuse names that cannot stand in C: the block's ``name``, and those of its signals. Raises
    InvalidInput.
    """
    check_identifier(name, "the name of the block", "choose letters, digits and underscores")
    for side, signals in (("input", inputs), ("output", outputs)):
        for signal in signals:
            check_identifier(
                signal,
                f"the {side} signal",
                "rename the bearing in the machine file, or give the signals other names",
            )
    upper = [signal.upper() for signal in (*inputs, *outputs)]
    for signal in upper:
        if upper.count(signal) > 1:
            raise invalid(
                "a signal's name",
                signal,
                "unique in capitals",
                "give the controller's signals other names",
            )


def check_identifier(name: str, what: str, remedy: str) -> str:
    """``name`` if it is a C identifier of at most 24 characters and no keyword. Raises
    InvalidInput.
    """
    if (
        not isinstance(name, str)
        or not _IDENTIFIER.fullmatch(name)
        or name in KEYWORDS
        or len(name) > _LONGEST
    ):
        wanted = (
            f"a C identifier of at most {_LONGEST} characters that starts with a letter and is no "
            "keyword"
        )
        raise invalid(what, repr(name), wanted, remedy)
    if _DEVICES.fullmatch(name):
        wanted = "unlike a device of Windows, where no file can be called so"
        raise invalid(what, repr(name), wanted, remedy)
    return name


def as_comment(text: str) -> str:
    """``text`` made safe inside a C comment: printable ASCII on one line, without comment ends,
    trigraphs and backslashes.
    """
    plain = "".join(c if " " <= c <= "~" and c != "\\" else "_" for c in text)
    return plain.replace("*/", "* /").replace("/*", "/ *").replace("??", "? ?")
