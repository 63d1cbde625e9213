"""What the numbers of a machine file may be: ``ranges.toml``, one row for every numeric key.

``impossible`` is asked whenever a machine is made: what physics forbids is refused, before powers
of it overflow. ``implausible`` is asked by ``ambrose check``: what hardly any machine has is
doubted.
"""

import tomllib
from collections.abc import Container, Iterator, Mapping
from dataclasses import dataclass, fields
from functools import lru_cache, singledispatch
from importlib.resources import files
from math import log
from typing import Any

import numpy as np

from ambrose.core.checks import InvalidInput
from ambrose.machine.attachment import by_table
from ambrose.machine.description import MachineDescription, Tolerance
from ambrose.machine.kinds import Count
from ambrose.machine.parameters import parse_parameter
from ambrose.machine.part import Material, Part, SealTable, hints_of
from ambrose.machine.units import DIMENSIONS, Dimension, called, number, read_quantity
from ambrose.machine.validation.parts import dimensional

_MOST = 1e60  # in SI: what is larger overflows in its powers
_LEAST = 1e-30  # in SI: what is nearer to zero is no figure, and a division by its square overflows
COUNT = "plain number"  # what a whole number is to this table
_SEAL_TABLE = {
    "pressure": "pressure",
    "speed": "angular rate",
    "frequency": "angular rate",
    "K": "stiffness",
    "k": "stiffness",
    "C": "damping",
    "c": "damping",
    "M": "mass",
}
# the keys that hold what a tolerance names otherwise
_HELD_IN = {
    **{f"rotor.{name}": f"bending_mode.{name}" for name in ("frequency", "damping")},
    "seal.pressure": "operation.point.seal_pressure",
    "thrust_bearing.force_per_current": "bearing.force_per_current",
    "thrust_bearing.negative_stiffness": "bearing.negative_stiffness",
}


@dataclass(frozen=True, slots=True)
class Entry:
    """A numeric key of a machine: where it stands in words, its path ("bearing.iron.turns"), its
    dimension, its numbers in SI; of a tolerance in its parameter's unit the key of that.
    """

    where: str
    path: str
    dimension: str
    values: tuple[float, ...]
    of: str = ""

    @property
    def said(self) -> str:
        """ "[[bearing]] A: gap"."""
        return f"{self.where}: {self.path.rpartition('.')[2]}"


@lru_cache
def ranges() -> tuple[Mapping[str, Any], Mapping[str, Any]]:
    """The rows of the file, as written: (usual, physics) by path."""
    return rows("usual"), rows("physics")


@lru_cache
def rows(table: str) -> Mapping[str, Any]:
    """The rows of one of the file's tables, as written, by path: "usual", "width" (of tolerances,
    relative), "relation", "physics".
    """
    text = files("ambrose.machine.validation").joinpath("ranges.toml").read_text(encoding="utf-8")
    return dict(_rows(tomllib.loads(text)[table]))


def _rows(table: Mapping[str, Any], above: str = "") -> Iterator[tuple[str, Any]]:
    for key, value in table.items():
        if isinstance(value, dict):
            yield from _rows(value, f"{above}{key}.")
        else:
            yield f"{above}{key}", value


@lru_cache(maxsize=1024)
def usual(path: str, dimension: str, table: str = "usual") -> tuple[float, float] | None:
    """[least, most] in SI that a key usually has; None where the file says nothing."""
    row = rows(table).get(path)
    if not isinstance(row, list):
        return None
    kind = DIMENSIONS[dimension]
    return read_quantity(row[0], kind), read_quantity(row[1], kind)


@lru_cache(maxsize=1024)
def _most(path: str, dimension: str) -> tuple[float, str]:
    """The largest size of a key in SI, and why it has that."""
    kind, row = DIMENSIONS[dimension], ranges()[1].get(path)
    return (_MOST, "no machine has more") if row is None else (read_quantity(row[0], kind), row[1])


def numbers_of(machine: MachineDescription, among: Container[str] | None = None) -> Iterator[Entry]:
    """Every numeric key that a machine gives, its defaults included. among: of these fields and the
    machine's own numbers alone.
    """
    seen: set[int] = set()
    for item in fields(machine):
        if among is not None and item.name not in among:
            continue
        value, key = getattr(machine, item.name), item.metadata.get("key", item.name)
        for path, held in by_table(value).items() if key == "effects" else ((key, value),):
            yield from _entries(held, path, "", seen)
    yield from _own(machine, "machine", "[machine]")


@singledispatch
def _entries(value: Any, path: str, above: str, seen: set[int]) -> Iterator[Entry]:
    """The numeric keys of the parts that a key holds, and of all below them; a material that
    sections share once.

    above: the entry in double brackets that the part is or is in, "" for none.
    """
    yield from ()


@_entries.register
def _(value: tuple | list, path: str, above: str, seen: set[int]) -> Iterator[Entry]:
    for i, part in enumerate(value if value and isinstance(value[0], Part) else ()):
        names = {key: getattr(part, key, None) for key in ("name", "label", "bearing", "parameter")}
        heading = f"[[{path}]] {called(names, path.rpartition('.')[2], i + 1)}"
        yield from _entries(part, path, f"{above}, {heading}" if above else heading, seen)


@_entries.register
def _of_part(part: Part, path: str, above: str, seen: set[int]) -> Iterator[Entry]:
    yield from _own(part, path, _place(path, above))
    for item in fields(part):  # type: ignore[arg-type]  # every Part is a dataclass
        below = f"{path}.{item.metadata.get('key', item.name)}"
        yield from _entries(getattr(part, item.name), below, above, seen)


@_entries.register
def _(part: SealTable, path: str, above: str, seen: set[int]) -> Iterator[Entry]:
    known = [item for item in (*part.axes, *part.values) if item[0] in _SEAL_TABLE]
    for key, values in known:  # one that is unknown is named by the table itself
        yield Entry(_place(path, above), f"{path}.{key}", _SEAL_TABLE[key], _flat(values))


@_entries.register
def _(part: Material, path: str, above: str, seen: set[int]) -> Iterator[Entry]:
    if id(part) not in seen:
        seen.add(id(part))
        yield from _own(part, "material", f"[material.{part.name}]")


@_entries.register
def _(part: Tolerance, path: str, above: str, seen: set[int]) -> Iterator[Entry]:
    yield from _of_part(part, path, above, seen)
    try:
        parameter = parse_parameter(part.parameter)
    except InvalidInput:
        return  # the path itself is refused
    held = f"{parameter.table}.{parameter.quantity}"
    held = _HELD_IN.get(held, held)
    for key, of, dimension in (
        ("relative", f"width.{held}", "ratio"),
        ("absolute", held, parameter.dimension),
    ):
        if (value := getattr(part, key)) is not None:
            yield Entry(_place(path, above), f"{path}.{key}", dimension, (value,), of)


def _place(path: str, above: str) -> str:
    """Where a part stands in words."""
    if above.rpartition("[[")[2].startswith(f"{path}]]"):
        return above
    return f"{above}, [{path}]" if above else f"[{path}]"


def _own(part: Any, path: str, where: str) -> Iterator[Entry]:
    for name, key, dimension in _numeric(type(part)):  # type: ignore[arg-type]  # hashable
        value = getattr(part, name)
        if value is not None:
            yield Entry(where, f"{path}.{key}", dimension, _flat(value))


@lru_cache(maxsize=256)
def _numeric(part: type) -> tuple[tuple[str, str, str], ...]:
    """(field, key, dimension) of the numeric keys of a kind of part, tables below it left out."""
    found, hints = [], hints_of(part)
    for item in fields(part):
        hint = hints[item.name]
        counted = any(isinstance(kind, Count) for kind in getattr(hint, "__metadata__", ()))
        kind = next(dimensional(hint), None)
        if counted or kind is not None:
            dimension = COUNT if kind is None else kind.dimension
            found.append((item.name, item.metadata.get("key", item.name), dimension))
    return tuple(found)


def _flat(value: Any) -> tuple[float, ...]:
    if isinstance(value, tuple | list):
        return tuple(number for element in value for number in _flat(element))
    if isinstance(value, np.ndarray):
        return tuple(value.ravel().tolist())
    return (value,) if isinstance(value, int | float) else ()


def impossible(machine: MachineDescription, among: Container[str] | None = None) -> Iterator[str]:
    """Every number that no machine can have, a line each; among: as of ``numbers_of``."""
    for entry in numbers_of(machine, among):
        most, why = _most(entry.path, entry.dimension)
        unit = DIMENSIONS[entry.dimension].unit.strip("-")
        for value in entry.values:
            if abs(value) > most:
                yield (
                    f"{entry.said} is {number(value, unit)}, but must be at most "
                    f"{number(most, unit)}: {why}; correct its unit or its exponent"
                )
                break
            if 0 < abs(value) < _LEAST:
                yield (
                    f"{entry.said} is {number(value, unit)}, nearer to zero than any figure; "
                    "correct its exponent, or write 0"
                )
                break


def implausible(machine: MachineDescription, under: tuple[str, ...] = ("",)) -> Iterator[str]:
    """Every key with a number that hardly any machine has, a doubt each; zero passes. under: starts
    of the paths that are asked, such as "bearing.touchdown.".
    """
    found: dict[str, list[str]] = {}
    for entry in numbers_of(machine):
        if not entry.path.startswith(under):
            continue
        kind = DIMENSIONS[entry.dimension]
        table, path = "usual", entry.of or entry.path
        if path.startswith("width."):
            table, path = "width", path.removeprefix("width.")
            table, path = (table, path) if path in rows(table) else ("usual", entry.path)
        row, span = rows(table).get(path), usual(path, entry.dimension, table)
        if span is None or row is None:
            continue
        low, high = (-span[1], span[1]) if entry.of == path else span
        outside = [value for value in entry.values if value and not low <= value <= high]
        if outside:
            found.setdefault(entry.path, []).append(
                f"{entry.said} is {number(outside[0], kind.unit.strip('-'))}, where "
                f"{_said(row[0])} to {_said(row[1])} is usual; {_remedy(outside[0], kind, span)}"
            )
    for lines in found.values():
        yield lines[0] + (f" (and {len(lines) - 1} more)" if len(lines) > 1 else "")


def _said(bound: str | float) -> str:
    return bound if isinstance(bound, str) else f"{bound:g}"


def _remedy(value: float, kind: Dimension, span: tuple[float, float]) -> str:
    """What to write: the bare number in the unit that takes it into its range, as near to the
    middle as can be.
    """
    low, high = span
    if value < 0 <= low:
        return "correct its sign"
    units = [unit for unit, factor in kind.units.items() if factor != "1"]
    middle = 0.5 * (log(low) + log(high)) if low > 0 else log(high) - 2.3
    meant = {unit: read_quantity(f"{abs(value):.17g} {unit}", kind) for unit in units}
    fitting = {unit: size for unit, size in meant.items() if max(low, 0.0) <= size <= high}
    if fitting:
        unit = min(fitting, key=lambda name: abs(log(fitting[name]) - middle))
        return f'write "{value:g} {unit}" if that is meant'
    bare = f", a bare number is in {kind.unit}" if kind.unit not in {"", "-"} else ""
    return f"check it{' and its unit' if bare else ''}{bare}"
