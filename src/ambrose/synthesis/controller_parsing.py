"""Strict reading of JSON from strangers: each function returns a checked value or raises InvalidInput naming the key."""

from __future__ import annotations

import json
import math
import stat
from collections.abc import Sequence
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np

from ambrose.core.checks import InvalidInput, invalid
from ambrose.core.scheduled import ScheduledSystem
from ambrose.core.statespace import StateSpace

_LARGEST = 64_000_000  # bytes; a controller with 500 states and 4 axes takes 6 MB
_AGAIN = "write the file again"


def read_json(path: Path) -> Any:
    """The parsed content of a UTF-8 JSON file; NaN, Infinity and repeated keys are refused. Raises InvalidInput."""
    try:
        status = path.stat()
        if not stat.S_ISREG(status.st_mode):
            raise InvalidInput("is no ordinary file; give the path of a file")
        if status.st_size > _LARGEST:
            raise invalid("the file's size", f"{status.st_size} bytes", f"at most {_LARGEST}", "is this the right file?")
        text = path.read_bytes().decode("utf-8")
    except OSError as error:
        raise InvalidInput(f"cannot be read ({error.strerror or error}); check the path") from error
    except UnicodeDecodeError as error:
        raise InvalidInput(f"is not text (byte {error.start} is no UTF-8); is this the right file?") from error
    try:
        return json.loads(text, parse_constant=_no_constant, object_pairs_hook=_unique)
    except json.JSONDecodeError as error:
        where = f"line {error.lineno}, column {error.colno}"
        raise InvalidInput(f"is not complete JSON ({error.msg} at {where}); {_AGAIN}, it may be truncated") from error
    except (RecursionError, ValueError) as error:
        if isinstance(error, InvalidInput):
            raise
        raise InvalidInput(f"is not JSON that can be read ({error}); {_AGAIN}") from error


def _no_constant(text: str) -> float:
    raise invalid("a number", text, "finite", f"{_AGAIN} from a controller without NaN")


def _unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    result = dict(pairs)
    if len(result) != len(pairs):
        names = [name for name, _ in pairs]
        twice = next(name for name in names if names.count(name) > 1)
        raise invalid(f"key {twice!r}", "given twice", "given once", _AGAIN)
    return result


def parse_keys(content: Any, keys: Sequence[str], where: str) -> None:
    """Refuse anything but a table with exactly these keys."""
    if not isinstance(content, dict):
        raise invalid(where, type(content).__name__, f"a table with {', '.join(keys)}", _AGAIN)
    unknown, missing = sorted(set(content) - set(keys)), [key for key in keys if key not in content]
    if unknown:
        raise InvalidInput(f"{where} has the unknown key {unknown[0]!r}; it may have {', '.join(keys)}")
    if missing:
        raise InvalidInput(f"{where} lacks the key {missing[0]!r}; {_AGAIN}, it may come from another version")


def parse_text(value: Any, name: str, *, empty: bool = False) -> str:
    if not isinstance(value, str) or not (value or empty):
        raise invalid(name, repr(value), "text", _AGAIN)
    return value


def parse_number(value: Any, name: str, *, any_value: bool = False) -> float:
    """A finite number; with ``any_value`` also the texts "nan", "inf" and "-inf"."""
    if any_value and value in ("nan", "inf", "-inf"):
        return float(value)
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise invalid(name, repr(value), "a number", _AGAIN)
    try:
        number = float(value)
    except OverflowError:
        number = math.inf
    if not math.isfinite(number):
        raise invalid(name, repr(number), "finite", _AGAIN)
    return number


def parse_matrix(value: Any, name: str, rows: int | None, columns: int | None) -> np.ndarray:
    """A list of equally long lists of numbers as an array (rows, columns); None for both: square."""
    if not isinstance(value, list):
        raise invalid(name, type(value).__name__, "a list of rows", _AGAIN)
    rows = len(value) if rows is None else rows
    columns = rows if columns is None else columns
    if len(value) != rows:
        raise invalid(f"the number of rows of {name}", len(value), str(rows), "its sizes must fit A and the signals")
    result = np.zeros((rows, columns))
    for i, row in enumerate(value):
        if not isinstance(row, list) or len(row) != columns:
            found = len(row) if isinstance(row, list) else type(row).__name__
            raise invalid(f"the length of row {i + 1} of {name}", found, str(columns), "its sizes must fit A and the signals")
        for j, item in enumerate(row):
            result[i, j] = parse_number(item, f"{name}[{i + 1}][{j + 1}]")
    return result


def parse_signals(value: Any, name: str, prefix: str, unit: str) -> list[str]:
    """Signal names from a list of {"name": prefix + axis, "unit": unit}."""
    if not isinstance(value, list) or not value:
        raise invalid(name, repr(value), "a list of signals", _AGAIN)
    names = []
    for i, item in enumerate(value):
        where = f"{name}[{i + 1}]"
        parse_keys(item, ("name", "unit"), where)
        signal = parse_text(item["name"], f"{where}.name")
        if not signal.startswith(prefix):
            raise invalid(f"{where}.name", repr(signal), f"{prefix}<axis>", "rename the signals and write the file again")
        if item["unit"] != unit:
            raise invalid(f"{where}.unit", repr(item["unit"]), repr(unit), f"convert the controller to {unit} and {_AGAIN}")
        names.append(signal)
    return names


def parse_scheduling(content: Any, controller: StateSpace) -> ScheduledSystem:
    """The schedule of a controller file: matrices of the controller's sizes at every point of an ascending grid."""
    parse_keys(content, ("parameter", "unit", "interpolation", "outside", "grid", "points"), "scheduling")
    for key, known in (("interpolation", ("linear",)), ("outside", ("refuse", "clamp"))):
        if content[key] not in known:
            raise invalid(f"scheduling.{key}", repr(content[key]), " or ".join(known), "it needs another version of ambrose")
    if not isinstance(content["grid"], list) or not isinstance(content["points"], list):
        raise invalid("scheduling.grid and points", "no lists", "lists of equal length", _AGAIN)
    grid = [parse_number(value, f"scheduling.grid[{i + 1}]") for i, value in enumerate(content["grid"])]
    n, m, p = controller.n_states, len(controller.inputs), len(controller.outputs)
    sizes = {"A": (n, n), "B": (n, m), "C": (p, n), "D": (p, m)}
    systems = []
    for i, point in enumerate(content["points"]):
        where = f"scheduling.points[{i + 1}]"
        parse_keys(point, tuple(sizes), where)
        A, B, C, D = (parse_matrix(point[letter], f"{where}.{letter}", *size) for letter, size in sizes.items())
        systems.append(StateSpace(A, B, C, D, controller.inputs, controller.outputs, controller.dt))
    parameter, unit = (parse_text(content[key], f"scheduling.{key}") for key in ("parameter", "unit"))
    return ScheduledSystem(grid, systems, parameter, unit, content["outside"])


def parse_date(value: Any, name: str) -> str:
    """An ISO 8601 date and time, returned as it is written."""
    text = parse_text(value, name)
    try:
        datetime.fromisoformat(text)
    except ValueError as error:
        raise invalid(name, repr(text), "a date such as 2026-01-31T12:00:00+00:00", _AGAIN) from error
    return text
