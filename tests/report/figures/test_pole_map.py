"""Pole-zero maps hold every pole and zero in view, count the unstable ones and refuse what they
cannot show.
"""

import numpy as np
import pytest

from ambrose.core.checks import InvalidInput
from ambrose.core.statespace import StateSpace, transfer_function
from ambrose.report.figures.curves import describe, pole_zero_map

UNSTABLE = transfer_function(np.poly([-30.0]), np.poly([20.0, -25.0, -4000.0]))
STABLE = transfer_function([1.0], np.poly([-10 + 40j, -10 - 40j]).real)


def test_poles_and_zeros_in_their_panels():
    figure = pole_zero_map({"G <b>": UNSTABLE, "S": STABLE})
    poles, zeros, others, none = figure.data
    np.testing.assert_allclose(sorted(poles.x), [-25, 20], rtol=1e-6)
    np.testing.assert_allclose(zeros.x, [-30], rtol=1e-6)
    np.testing.assert_allclose(sorted(others.y), [-40, 40], rtol=1e-6)
    assert len(none.x) == 0
    assert poles.xaxis == "x" and others.xaxis == "x2"
    shown = {trace.name for trace in figure.data if trace.showlegend}
    assert shown == {"poles", "zeros"}
    texts = " ".join(note.text for note in figure.layout.annotations)
    assert "G &lt;b&gt;" in texts and "1 of 3 poles right of the axis (1 beyond the edge)" in texts
    assert "all 2 poles left of the axis" in texts and texts.count("no finite zero") == 1


def test_reach_shows_more():
    figure = pole_zero_map({"G": UNSTABLE}, reach=5000.0)
    np.testing.assert_allclose(sorted(figure.data[0].x), [-4000, -25, 20], rtol=1e-6)
    assert "beyond" not in " ".join(note.text for note in figure.layout.annotations)


def test_in_words():
    assert describe("G", UNSTABLE) == "G: 1 of 3 poles right of the axis, rightmost 20 +0j rad/s"
    assert (
        describe("K", StateSpace([], np.zeros((0, 1)), np.zeros((1, 0)), [[1.0]])) == "K: no pole"
    )


def test_refusals():
    sampled = StateSpace([[0.5]], [[1.0]], [[1.0]], [[0.0]], dt=0.1)
    with pytest.raises(InvalidInput, match="is sampled"):
        pole_zero_map({"S": sampled})
    with pytest.raises(InvalidInput, match="number of systems"):
        pole_zero_map({})
    with pytest.raises(InvalidInput, match="reach"):
        pole_zero_map({"S": STABLE}, reach=-1.0)
