"""A figure of one plot area as plain data: what our figures say to plotly's, kept without its
validation, thirty times faster.

It takes the few calls that ``theme`` and the figures make, and is read as plotly's figures are:
``data`` and ``layout``, each with ``to_plotly_json``. ``theme.bare`` decides who gets it.
"""

from __future__ import annotations

from typing import Any


class Plain(dict[str, Any]):
    """A dictionary that is read like an object of plotly."""

    def to_plotly_json(self) -> dict[str, Any]:
        """Itself."""
        return self


class PlainFigure:
    """One plot area with the axes x and y; rows and columns of a place are (1, 1)."""

    def __init__(self) -> None:
        self.data: list[Plain] = []
        self.layout = Plain(xaxis={"anchor": "y"}, yaxis={"anchor": "x"}, annotations=[])

    def add_trace(self, trace: dict[str, Any], **place: int) -> PlainFigure:
        """One more trace."""
        self.data.append(Plain(trace))
        return self

    def add_annotation(self, row: int = 1, col: int = 1, **note: Any) -> PlainFigure:
        """Words at a place."""
        self.layout["annotations"].append(note)
        return self

    def update_layout(self, **values: Any) -> PlainFigure:
        """Values of the layout; those of tables are merged."""
        _merge(self.layout, values)
        return self

    def update_xaxes(self, row: int = 1, col: int = 1, **values: Any) -> PlainFigure:
        """Values of the axis along; ``title_text`` is the text of its title."""
        _merge(self.layout["xaxis"], values)
        return self

    def update_yaxes(self, row: int = 1, col: int = 1, **values: Any) -> PlainFigure:
        """Values of the axis upwards."""
        _merge(self.layout["yaxis"], values)
        return self


def _merge(table: dict[str, Any], values: dict[str, Any]) -> None:
    for key, value in values.items():
        outer, underscore, inner = key.partition("_")
        if underscore:
            _merge(table, {outer: {inner: value}})
        elif isinstance(value, dict) and isinstance(table.get(key), dict):
            _merge(table[key], value)
        else:
            table[key] = value
