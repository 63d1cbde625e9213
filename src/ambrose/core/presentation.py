"""How results show themselves: one line at a prompt, a table in a notebook, plain data for a
file.
"""

import dataclasses
import json
import math
from collections.abc import Iterable, Mapping
from html import escape
from typing import Any, ClassVar

from ambrose.core.checks import InvalidInput

_LONGEST = 190  # characters of a repr


def with_unit(value: float, unit: str, digits: int = 4) -> str:
    """A number and its unit; a plain number, of unit "-", stands alone."""
    return f"{value:.{digits}g} {'' if unit == '-' else unit}".rstrip()


class Presented:
    """A result with a one-line ``repr`` and a table for notebooks, both made from its ``facts``.

    A subclass is a dataclass with ``repr=False``. Where its fields are not what it is, it names the
    fields and properties that are, as ``name`` or ``key=name``: ``_FACTS`` those of ``facts``,
    ``_DATA`` those of ``to_dict``; or it has a ``facts`` or ``to_dict`` of its own.
    """

    __slots__ = ()
    _FACTS: ClassVar[tuple[str, ...]] = ()
    _DATA: ClassVar[tuple[str, ...]] = ()

    def facts(self) -> Mapping[str, Any]:
        """What a reader wants to know first, most important first (SI); else the fields that are
        not at their default.
        """
        if self._FACTS:
            return dict(_chosen(self, self._FACTS))
        fields = dataclasses.fields(self)  # type: ignore[arg-type]  # every subclass is a dataclass
        values = {field.name: getattr(self, field.name) for field in fields}
        names = [
            f.name
            for f in fields
            if hasattr(values[f.name], "shape") or values[f.name] not in ((), f.default)
        ]
        return {name: _fact(values[name]) for name in names}

    def to_dict(self) -> dict[str, Any]:
        """What belongs to it, ready for JSON (``to_plain``): all fields of the dataclass, where it
        names nothing else.
        """
        if self._DATA:
            return {key: _as_data(value) for key, value in _chosen(self, self._DATA)}
        names = (field.name for field in dataclasses.fields(self))  # type: ignore[arg-type]
        plain: dict[str, Any] = to_plain({name: getattr(self, name) for name in names})
        return plain

    def __repr__(self) -> str:
        words = ", ".join(f"{name}={in_words(value)}" for name, value in self.facts().items())
        text = f"{type(self).__name__}({words})"
        return text if len(text) <= _LONGEST else f"{text[: _LONGEST - 4]}...)"

    def _repr_html_(self) -> str:
        return html_table(
            [(name.replace("_", " "), in_words(value)) for name, value in self.facts().items()],
            type(self).__name__,
        )


def _chosen(thing: Any, names: Iterable[str]) -> Iterable[tuple[str, Any]]:
    """(key, value) of attributes that are named "attribute" or "key=attribute"."""
    pairs = (name.partition("=") for name in names)
    return ((key, getattr(thing, attribute or key)) for key, _, attribute in pairs)


def _as_data(value: Any) -> Any:
    """Plain data of a value, of results by their own ``to_dict``."""
    if isinstance(value, Presented):
        return value.to_dict()
    if isinstance(value, list | tuple):
        return [_as_data(item) for item in value]
    return to_plain(value)


def _fact(value: Any) -> Any:
    if hasattr(value, "shape") and value.shape:
        return f"array {value.shape}"
    nested = isinstance(value, tuple) and any(dataclasses.is_dataclass(item) for item in value)
    return len(value) if nested else value


def in_words(value: Any) -> str:
    """A number with four digits, a text as it is, a list by its elements."""
    if isinstance(value, float):
        return f"{value:.4g}"
    if isinstance(value, list | tuple):
        return f"[{', '.join(in_words(item) for item in value)}]"
    return str(value)


def html_table(
    rows: Iterable[Iterable[str]], caption: str = "", heading: Iterable[str] = ()
) -> str:
    """Rows of texts as an HTML table; every text is escaped."""
    head = "".join(f"<th>{escape(text)}</th>" for text in heading)
    body = "".join(
        "<tr>" + "".join(f"<td>{escape(text)}</td>" for text in row) + "</tr>" for row in rows
    )
    title = f"<caption><b>{escape(caption)}</b></caption>" if caption else ""
    top = f"<thead><tr>{head}</tr></thead>" if head else ""
    return f"<table>{title}{top}<tbody>{body}</tbody></table>"


def data_frame(columns: Mapping[str, Any], index: str | None = None) -> Any:
    """A pandas.DataFrame of columns of equal length; index: the column that names the rows.

    Raises InvalidInput where pandas is not installed.
    """
    try:
        import pandas as pd
    except ImportError as error:
        raise InvalidInput(
            "to_frame() needs pandas, which is not installed; pip install pandas, or use to_dict()"
        ) from error
    frame = pd.DataFrame(dict(columns))
    return frame if index is None else frame.set_index(index)


def json_text(content: Any, **form: Any) -> str:
    """Any content as JSON text that every reader takes: ``to_plain``, so that no Infinity and no
    NaN stands in it. form: indent and the like, of json.dumps.
    """
    return json.dumps(to_plain(content), allow_nan=False, **form)


def to_plain(value: Any) -> Any:
    """Nested data with JSON types only: NaN and infinities as strings, complex numbers as [real,
    imaginary].
    """
    if isinstance(value, Mapping):
        return {str(key): to_plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [to_plain(item) for item in value]
    if hasattr(value, "tolist"):
        return to_plain(value.tolist())
    if isinstance(value, complex):
        return [to_plain(value.real), to_plain(value.imag)]
    if isinstance(value, float) and not math.isfinite(value):
        return str(value)
    if isinstance(value, str | int | float | bool) or value is None:
        return value
    if dataclasses.is_dataclass(value):
        return {
            field.name: to_plain(getattr(value, field.name)) for field in dataclasses.fields(value)
        }
    raise TypeError(f"{type(value).__name__} is not plain data")
