"""Loci of the loops opened axis by axis, around the point -1 that they must go around."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ambrose.report import theme

_HEIGHT = 320  # [px]
_VIEW = ((-3.2, 1.2), (-1.8, 1.8))
_NEAR = 6.0  # from zero, beyond which nothing is seen


def nyquist_figure(loci: Sequence[tuple[str, np.ndarray]], peak: float | None = None) -> Any:
    """Loci of several loops in the plane, near -1.

    loci: label and L (w, a), a curve for each axis in the look of the label. peak: a sensitivity
    that is not to be exceeded; |1/(1 + L)| = peak is the circle of radius 1/peak around -1. Returns
    a plotly Figure.
    """
    figure = theme.subplots(rows=1, cols=1)
    place = {"row": 1, "col": 1}
    style = theme.styles([label for label, _ in loci])
    for label, values in loci:
        for i in range(values.shape[1]):
            # what lies outside the view, and so do the points around it, is no part of the picture
            inside = np.abs(values[:, i]) < _NEAR
            near = inside.copy()
            near[1:] |= inside[:-1]
            near[:-1] |= inside[1:]
            L = np.where(near, values[:, i], np.nan)
            theme.scatter(
                figure, place, L.real, L.imag, label, shown=i == 0, line=style[label].line
            )
    turn = np.linspace(0, 2 * np.pi, 73)
    theme.guide(figure, place, np.cos(turn), np.sin(turn), color=theme.FAINT, width=1.2)
    if peak is not None:
        x, y = np.cos(turn) / peak - 1, np.sin(turn) / peak
        theme.guide(figure, place, x, y, color=theme.LIMIT, width=1.2, dash="1.5px,2px")
        words = f"|S| = {peak:g}"
        at = 1 / peak + 0.03
        theme.note(figure, place, words, -1, at, "center", "bottom", colour=theme.LIMIT)
    marker = {"color": theme.LIMIT, "size": 7, "symbol": "x-thin", "line": {"width": 2}}
    theme.scatter(figure, place, [-1], [0], mode="markers", marker=marker)
    theme.dress(figure, _HEIGHT, legend=len(loci) > 1)
    figure.update_xaxes(title_text="Real part", range=list(_VIEW[0]))
    figure.update_yaxes(title_text="Imaginary part", range=list(_VIEW[1]), scaleanchor="x")
    return figure
