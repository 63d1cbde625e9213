"""Numbers of a part that must be positive: complaints with the unit that the part's field
states.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import lru_cache
from typing import Any, get_args

from ambrose.machine.kinds import PairOf
from ambrose.machine.messages import complaint, number
from ambrose.machine.part import Part, hints_of
from ambrose.machine.units import DIMENSIONS


def not_positive(
    where: str, part: Part, remedy: str, *keys: str, zero: bool = False
) -> Iterator[str]:
    """Complaints about the numbers under these keys that are not above zero (or not at it); None
    passes, and a pair of equal numbers is named once.
    """
    requirement = "zero or positive" if zero else "positive"
    for key in keys:
        unit, names = unit_and_names(type(part), key)  # type: ignore[arg-type]  # a class is hashable
        value = getattr(part, key)
        several = isinstance(value, (tuple, list))
        values = value if several else (value,)
        if names and several and len(set(values)) == 1:  # one number for both
            values, several = values[:1], False
        for i, entry in enumerate(values):
            if entry is not None and (entry < 0 or (entry == 0 and not zero)):
                name = f" ({names[i] if names else f'element {i + 1}'})" if several else ""
                yield complaint(where, f"{key}{name}", number(entry, unit), requirement, remedy)


@lru_cache(maxsize=256)
def unit_and_names(part: type, key: str) -> tuple[str, list[str]]:
    """The unit of a field ("" for a ratio or a count), and the names of a pair's two values."""
    kind = next(dimensional(hints_of(part)[key]), None)
    unit = "" if kind is None else DIMENSIONS[kind.dimension].unit
    return "" if unit == "-" else unit, kind.names.split(", ") if isinstance(kind, PairOf) else []


def dimensional(hint: Any) -> Iterator[Any]:
    """The kinds with a dimension that an annotation holds, at any depth."""
    yield from (kind for kind in getattr(hint, "__metadata__", ()) if hasattr(kind, "dimension"))
    for inner in get_args(hint):
        yield from dimensional(inner)
