"""What every part of a machine can do: show itself in a line, and give its plain data under the
keys of a machine file.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import MISSING, fields
from functools import lru_cache
from typing import Any, get_type_hints

import numpy as np

from ambrose.core.presentation import Presented


@lru_cache(maxsize=256)
def hints_of(part: type) -> dict[str, Any]:
    """The types of a part's fields with what their annotations say, once for each kind of part."""
    return get_type_hints(part, include_extras=True)


class Part(Presented):
    """A noun of the machine file. A field whose key in the file differs names it in its metadata;
    what is not compared is no key of the file.
    """

    __slots__ = ()

    def __post_init__(self) -> None:
        """Arrays, which have no truth value and no hash, become the tuples that a file gives."""
        for item in fields(self):  # type: ignore[arg-type]  # every Part is a dataclass
            value = getattr(self, item.name)
            if isinstance(value, np.ndarray):
                object.__setattr__(self, item.name, _tuples(value.tolist()))

    def facts(self) -> Mapping[str, Any]:
        return {key: _named(value) for key, value in self.to_dict().items()}

    def to_dict(self, *, defaults: bool = False) -> dict[str, Any]:
        """The values by their keys in a machine file, SI, as plain data; those at their default
        only with ``defaults``.
        """
        table = {}
        for item in fields(self):  # type: ignore[arg-type]  # every Part is a dataclass
            value = getattr(self, item.name)
            default = (
                item.default_factory() if item.default_factory is not MISSING else item.default
            )
            if (
                item.compare
                and value is not None
                and (defaults or default is MISSING or value != default)
            ):
                key = item.metadata.get("key", item.name)
                table[key] = (
                    int(value)
                    if str(item.type).startswith("Annotated[int")
                    else to_plain_values(value, defaults=defaults)
                )
        return table


def to_plain_values(value: Any, *, defaults: bool = False) -> Any:
    """A value of a field as a file holds it: parts as tables, tuples and arrays as lists, every
    number a float.
    """
    if isinstance(value, Part):
        return value.to_dict(defaults=defaults)
    if isinstance(value, np.ndarray):
        return to_plain_values(value.tolist())
    if isinstance(value, (tuple, list)):
        return [to_plain_values(element, defaults=defaults) for element in value]
    return value if isinstance(value, str) else float(value) + 0.0  # no negative zero


def _tuples(value: Any) -> Any:
    return tuple(map(_tuples, value)) if isinstance(value, list) else value


def _named(value: Any) -> Any:
    """A table by its label or name, to keep a line short."""
    if isinstance(value, list):
        return [_named(element) for element in value]
    return value.get("label") or value.get("name") or "{...}" if isinstance(value, dict) else value
