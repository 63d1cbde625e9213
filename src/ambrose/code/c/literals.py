"""Numbers and tables as C writes them; text broken into lines."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from ambrose.code.block.cost import diagonals_of
from ambrose.core.checks import invalid

_WIDTH = 118


def digits(value: float, arithmetic: str) -> str:
    """A number with all the digits of double or single precision. Raises InvalidInput where it is
    larger than that precision holds.
    """
    if arithmetic == "double":
        return f"{value:.17g}"
    largest = float(np.finfo(np.float32).max)
    if abs(value) > largest:
        raise invalid(
            "a number of the controller",
            f"{value:.3g}",
            f"at most {largest:.3g} in single precision",
            "export it in double precision, or correct the exponent in its file",
        )
    return f"{float(np.float32(value)):.9g}"


def literal(value: float, arithmetic: str) -> str:
    """A floating-point number as C writes it."""
    text = digits(value, arithmetic)
    if not any(c in text for c in ".en"):
        text += ".0"
    return text if arithmetic == "double" else f"{text}f"


def real_table(arithmetic: str) -> Callable[[np.ndarray], str]:
    """The function that writes an array as a C initialiser of floating-point numbers."""
    return lambda x: _initialiser(x, lambda v: literal(float(v), arithmetic))


def integer_table(x: np.ndarray) -> str:
    """An array as a C initialiser of whole numbers."""
    return _initialiser(x, lambda v: str(int(v)))


def _initialiser(x: np.ndarray, form: Callable[[float], str], indent: str = "    ") -> str:
    if x.ndim > 1:
        rows = ",\n".join(f"{indent}{_initialiser(row, form, indent + '    ')}" for row in x)
        return "{\n" + rows + "\n" + indent[4:] + "}"
    return (
        "{"
        + f"\n{indent}    ".join(lines_of([form(value) for value in x], _WIDTH - len(indent)))
        + "}"
    )


def lines_of(items: Sequence[str], width: int = _WIDTH) -> list[str]:
    """Items with commas between them in lines of at most ``width`` characters."""
    lines, line = [], ""
    for i, text in enumerate(items):
        item = text + (", " if i + 1 < len(items) else "")
        if line and len(line) + len(item) > width:
            lines.append(line.rstrip())
            line = ""
        line += item
    return [*lines, line]


def diagonals(x: np.ndarray, pattern: np.ndarray) -> list[dict[str, Any]]:
    """The diagonals of x (n, n) that are not zero in ``pattern`` (n, n): offset k, name, how they
    index the states (i + k), and the entries x[i, i + k] row by row, zero outside the rows
    first..last that they reach.
    """
    n = len(x)
    listed = []
    for k in diagonals_of(pattern):
        entries = np.zeros(n, x.dtype)
        rows = np.arange(max(0, -k), min(n, n - k))
        entries[rows] = x[rows, rows + k]
        listed.append(
            {
                "offset": k,
                "name": f"{'below' if k < 0 else 'above'}_{abs(k)}" if k else "own",
                "shift": f" {'-' if k < 0 else '+'} {abs(k)}" if k else "",
                "entries": entries,
                "first": int(rows[0]),
                "last": int(rows[-1]),
            }
        )
    return listed
