"""Curves as plotly figures, whatever their kind.

    figure([("standstill", curve), ("nominal seal", curve)])       any Curve of ambrose.verification.checks, overlaid
    figure([("full", curve), ("8 states", curve)], overlay=True)   "is it the same?": the first broad and pale, the rest on top

Give the same ``order`` (all operating points of a report) to every figure and a label has one colour, dash and symbol
throughout. Figures convert from SI to the units of the page; they are never downsampled, and a view that hides part of the
data says so. plotly is imported inside the functions.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ambrose.core.checks import InvalidInput, invalid
from ambrose.report import theme
from ambrose.report.figures.curves import line_figure
from ambrose.report.figures.poles import pole_figure
from ambrose.verification.checks import Curve

_KINDS = ("frequency", "speed", "time", "poles")


def figure(curves: Sequence[tuple[str, Curve]], *, order: Sequence[str] = (), overlay: bool = False) -> Any:
    """One figure of the same curve at several operating points (or of several models).

    curves: (label, Curve) pairs, all of one kind and one unit. order: the labels in the order that fixes their colours
    (default: as they come). overlay: compare models, the first label is the reference drawn broad and pale. Several lines
    per curve become small panels; a line named "max..." or "worst..." gets the large one. Returns a plotly Figure.
    Raises InvalidInput.
    """
    _check(curves)
    labels = [*order, *(label for label, _ in curves)]
    style = theme.overlay_styles(labels) if overlay else theme.styles(labels)
    return pole_figure(curves, style) if curves[0][1].kind == "poles" else line_figure(curves, style, overlay=overlay)


def _check(curves: Sequence[tuple[str, Curve]]) -> None:
    if not curves:
        raise InvalidInput("a figure was asked for without curves; give at least one (label, Curve)")
    first = curves[0][1]
    if first.kind not in _KINDS:
        raise invalid(f"the kind of curve {first.name}", repr(first.kind), f"one of {', '.join(_KINDS)}", "set Curve.kind")
    for label, curve in curves:
        here = f"curve {curve.name} at {label}"
        if (curve.kind, curve.x_unit, curve.y_unit) != (first.kind, first.x_unit, first.y_unit):
            given = f"{curve.kind} in {curve.y_unit or '-'} over {curve.x_unit}"
            wanted = f"{first.kind} in {first.y_unit or '-'} over {first.x_unit} like the first one"
            raise invalid(here, given, wanted, "put different quantities into different figures")
        shape = (len(curve.labels), len(curve.x))
        if np.shape(curve.y) != shape or np.iscomplexobj(curve.y):
            given = f"of shape {np.shape(curve.y)}{' and complex' if np.iscomplexobj(curve.y) else ''}"
            raise invalid(
                f"y of {here}", given, f"real, of shape {shape} (lines, points)", "give magnitudes, one row per label"
            )
