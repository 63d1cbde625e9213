"""A plain figure is drawn as plotly's would be."""

import numpy as np

from ambrose.annexes.workbench.svg import nyquist_figure, svg
from ambrose.judge.checks import Curve
from ambrose.report import theme
from ambrose.report.figures.curves import figure
from ambrose.report.theme import PlainFigure


def pictures():
    omega = np.geomspace(1, 1e4, 300)
    limits = (("zone A/B", 3.0), ("zone B/C", 4.0))
    curves = []
    for k in (1, 2):
        y = k / np.abs(1 - (omega / 300) ** 2 + 0.4j * omega / 300)[None]
        curve = Curve("sensitivity", "S", "frequency", omega, y, ("largest",), "rad/s", "-", limits)
        curves.append((f"point {k} <b>", curve))
    loci = [("point", np.exp(1j * omega[:, None] / 1e3) - 0.5)]
    return [figure(curves), nyquist_figure(loci, 3.0)]


def test_both_figures_give_the_same_picture():
    theirs = pictures()
    with theme.bare():
        ours = pictures()
    assert all(isinstance(item, PlainFigure) for item in ours)
    assert not any(isinstance(item, PlainFigure) for item in theirs)
    for one, other in zip(ours, theirs, strict=True):
        assert svg(one, 640, "", "k") == svg(other, 640, "", "k")
