"""JSON that somebody wrote -> plain data, by one gate: every number is one that a calculation
bears.

NaN, infinities, numbers whose square overflows, keys given twice and endless nesting are refused;
``check_form`` holds the data against its JSON schema.
"""

from __future__ import annotations

import json
import math
import re
from collections import Counter
from collections.abc import Iterator, Mapping
from itertools import accumulate
from typing import Any

from ambrose.core.checks import InvalidInput, invalid
from ambrose.machine.limits import JSON_DEPTH, JSON_KEYS, LARGEST_NUMBER
from ambrose.machine.messages import quoted

_TYPES: Mapping[str, tuple[type, ...]] = {
    "object": (Mapping,),
    "array": (list, tuple),
    "string": (str,),
    "boolean": (bool,),
    "number": (int, float),
    "integer": (int,),
    "null": (type(None),),
}


def parse_json(text: str | bytes, again: str, largest: float = LARGEST_NUMBER) -> Any:
    """The content of a JSON text. again: how to make it anew, for the refusals; largest: size of a
    number. Raises InvalidInput, which names no file.
    """

    def number(digits: str) -> float:
        value = float(digits)
        if not abs(value) <= largest:
            most = f"finite, at most {largest:g} in size"
            raise invalid("a number", quoted(digits), most, again)
        return value

    def whole(digits: str) -> int:
        number(digits)
        return int(digits)

    def unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        result = dict(pairs)
        if len(pairs) > JSON_KEYS:
            most = f"at most {JSON_KEYS}"
            raise invalid(
                "the number of keys of a table", len(pairs), most, "is this the right file?"
            )
        if len(result) != len(pairs):
            (twice, _), *_ = Counter(name for name, _ in pairs).most_common(1)
            raise invalid(f"key {quoted(twice)}", "given twice", "given once", again)
        return result

    content = text.decode("utf-8", "replace") if isinstance(text, bytes) else text
    if _depth(content) > JSON_DEPTH:
        raise InvalidInput(f"is JSON that is nested more than {JSON_DEPTH} times; {again}")
    try:
        return json.loads(
            content,
            parse_constant=number,
            parse_float=number,
            parse_int=whole,
            object_pairs_hook=unique,
        )
    except json.JSONDecodeError as error:
        where = f"line {error.lineno}, column {error.colno}"
        raise InvalidInput(
            f"is not complete JSON ({error.msg} at {where}); {again}, it may be truncated"
        ) from error
    except (RecursionError, ValueError) as error:
        if isinstance(error, InvalidInput):
            raise
        raise InvalidInput(f"is not JSON that can be read ({error}); {again}") from error


def _depth(text: str) -> int:
    if text.count("[") + text.count("{") <= JSON_DEPTH:
        return 0
    marks = re.findall(r"[][{}]", re.sub(r'"(?:[^"\\]|\\.)*+"?', "", text))
    return max(accumulate(1 if mark in "[{" else -1 for mark in marks), default=0)


def check_form(data: Any, schema: Mapping[str, Any], again: str) -> None:
    """Raises InvalidInput for the first place at which data is not what its schema says (type,
    enum, const, required, properties, additionalProperties, items, minimum, exclusiveMinimum).
    """
    for place, problem in _faults(data, schema, ""):
        raise InvalidInput(f"{place or 'the whole'} {problem}; {again}")


def _faults(data: Any, schema: Mapping[str, Any], place: str) -> Iterator[tuple[str, str]]:
    allowed = schema.get("type", ())
    names = [allowed] if isinstance(allowed, str) else allowed
    if names and not any(_is(data, name) for name in names):
        yield place, f"is {_shown(data)}, but must be {' or '.join(names)}"
    elif "const" in schema and data != schema["const"]:
        yield place, f"is {_shown(data)}, but must be {_shown(schema['const'])}"
    elif "enum" in schema and data not in schema["enum"]:
        yield place, f"is {_shown(data)}, but must be one of {', '.join(schema['enum'])}"
    elif isinstance(data, Mapping):
        properties, rest = schema.get("properties", {}), schema.get("additionalProperties", True)
        for key in schema.get("required", ()):
            if key not in data:
                yield f"{place}.{key}".lstrip("."), "is missing"
        for key, value in data.items():
            below = properties.get(key, rest)
            if below is False:
                yield f"{place}.{key}".lstrip("."), "is unknown"
            elif isinstance(below, Mapping):
                yield from _faults(value, below, f"{place}.{key}".lstrip("."))
    elif isinstance(data, list | tuple):
        for i, value in enumerate(data):
            yield from _faults(value, schema.get("items", {}), f"{place}[{i}]")
    elif isinstance(data, int | float) and not isinstance(data, bool):
        least, above = schema.get("minimum", -math.inf), schema.get("exclusiveMinimum", -math.inf)
        if not math.isfinite(data) or abs(data) > LARGEST_NUMBER:
            yield place, f"is {data}, but must be finite, at most {LARGEST_NUMBER:g} in size"
        elif data < least or data <= above:
            yield place, f"is {data:g}, but must be {'at least' if data < least else 'above'} 0"


def _is(data: Any, name: str) -> bool:
    if isinstance(data, bool):
        return name == "boolean"
    return isinstance(data, _TYPES[name])


def _shown(data: Any) -> str:
    if isinstance(data, Mapping | list | tuple):
        return "a table" if isinstance(data, Mapping) else "a list"
    return quoted(data)
