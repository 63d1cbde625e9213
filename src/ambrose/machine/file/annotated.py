"""A machine as a file for people: every number in an everyday unit, every key with its meaning,
what is assumed marked.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from ambrose.machine.file.tables import Table, machine_file, table_below
from ambrose.machine.file.toml import written, written_key
from ambrose.machine.machine import Machine
from ambrose.machine.units import DIMENSIONS, rewrite_quantity

# (from which size on, unit); other dimensions in SI
_UNITS: Mapping[str, tuple[tuple[float, str], ...]] = {
    "length": ((0.0, "um"), (1e-4, "mm")),
    "angle": ((0.0, "deg"),),
    "angular rate": ((0.0, "Hz"),),
    "time": ((0.0, "us"), (1e-3, "ms"), (1.0, "s")),
    "area": ((0.0, "mm^2"),),
    "current": ((0.0, "A"),),
    "voltage": ((0.0, "V"),),
    "force": ((0.0, "N"),),
    "elastic modulus": ((0.0, "GPa"),),
    "stiffness": ((0.0, "N/um"),),
    "current per displacement": ((0.0, "A/mm"),),
    "velocity": ((0.0, "mm/s"),),
    "pressure": ((0.0, "bar"),),
}
_RPM = {"speed", "speed_range", "balance_speed", "unbalance_to"}
_COMMENT = 46  # column of comments


def annotated_machine(machine: Machine, title: str) -> str:
    """The machine as TOML text that reads back as an equal one; the first entry of every kind has
    comments.

    title: the comment at its head, a line or several.
    """
    document = machine.to_dict()
    end = 0.0
    for table, section in zip(document["shaft"], machine.shaft, strict=True):
        if section.start == end:
            del table["start"]
        end = section.start + section.length
    writer = _Writer(tuple(name for name, _ in machine.assumed), set())
    text = [f"# {line}".rstrip() for line in title.splitlines()]
    for key, value in document.items():
        text += writer.table(machine_file(), key, key, value)
    return "\n".join(text) + "\n"


def in_everyday_unit(value: float, dimension: str, key: str = "") -> Any:
    """What a file holds for ``value`` [SI]: a text with a unit that reads back as the very same
    number, or the number.
    """
    rows = ((0.0, "rpm"),) if key in _RPM else _UNITS.get(dimension)
    if rows is None or value == 0:
        unit = DIMENSIONS[dimension].unit
        return (
            rewrite_quantity(f"1 {unit}", value, DIMENSIONS[dimension])
            if value and unit not in {"", "-"}
            else value
        )
    unit = max(row for row in rows if row[0] <= abs(value) or row is rows[0])[1]
    return rewrite_quantity(f"1 {unit}", value, DIMENSIONS[dimension])


@dataclass(frozen=True, slots=True)
class _Writer:
    """assumed: keys of [machine.assumed]; seen: tables and keys that have their comment already."""

    assumed: tuple[str, ...]
    seen: set[str]

    def table(self, model: type[Table], key: str, path: str, value: Any) -> Iterator[str]:
        below = table_below(model, key)
        if below is None:  # [machine.assumed]
            yield from [
                "",
                f"[{path}]",
                *(f"{written_key(name)} = {written(reason)}" for name, reason in value.items()),
            ]
        elif str(model.model_fields[key].annotation).startswith("dict"):
            for name, entry in value.items():
                yield from self._entry(below, f"[{path}.{written_key(name)}]", path, entry)
        else:
            for entry in value if isinstance(value, list) else [value]:
                yield from self._entry(
                    below, f"[[{path}]]" if isinstance(value, list) else f"[{path}]", path, entry
                )

    def _entry(
        self, model: type[Table], header: str, path: str, entry: Mapping[str, Any]
    ) -> Iterator[str]:
        meaning = " ".join((model.__doc__ or "").split()).partition(". ")[0].rstrip(".")
        yield from ["", *([f"# {meaning}."] if path not in self.seen else []), header]
        self.seen.add(path)
        names = {field.alias or name: name for name, field in model.model_fields.items()}
        tables = [
            key
            for key, value in entry.items()
            if table_below(model, names[key]) or isinstance(value, dict)
        ]
        for key, value in entry.items():
            if key not in tables:
                field = model.model_fields[names[key]]
                yield self._line(
                    f"{path}.{key}",
                    f"{key} = {written(_valued(field.metadata, key, value))}",
                    field.description or "",
                )
        for key in tables:
            yield from self.table(model, names[key], f"{path}.{key}", entry[key])

    def _line(self, path: str, line: str, meaning: str) -> str:
        if path in self.seen or not meaning:
            return line
        self.seen.add(path)
        guess = any(path == name or path.startswith(f"{name}.") for name in self.assumed)
        return (
            f"{line:<{_COMMENT}} # "
            f"{'assumed: ' if guess else ''}{meaning.partition('; default')[0]}"
        )


def _valued(kinds: list[Any], key: str, value: Any) -> Any:
    dimension = getattr(kinds[0], "dimension", "") if kinds else ""
    if (
        isinstance(value, list)
        and value
        and getattr(kinds[0], "scalar", False)
        and all(item == value[0] for item in value)
    ):
        value = value[0]  # one number stands for all
    if isinstance(value, list):
        return [_valued(kinds, key, item) for item in value]
    return (
        in_everyday_unit(value, dimension, key) if dimension and isinstance(value, float) else value
    )
