"""Searches and bounds of worst cases against brute force: a few of the systems of
benchmarks/worst_case_truth.
"""

from __future__ import annotations

import numpy as np
import pytest
from benchmarks import worst_case_truth

from ambrose.core.lft import RealBlock
from ambrose.core.norms import hinf_norm
from ambrose.core.statespace import StateSpace
from ambrose.core.worst_case import proved_gain, worst_gain
from ambrose.core.worst_case_loop import box_loop, box_margin


@pytest.mark.parametrize(
    "seed", [47, *(pytest.param(seed, marks=pytest.mark.study) for seed in (27, 37))]
)
def test_between_search_and_bound_lies_the_truth(seed, monkeypatch):
    """27: crossings between the nominal poles' grid points; 37 and 47: poles that leave through
    zero.
    """
    monkeypatch.setattr(worst_case_truth, "_GRID", {1: 301, 2: 21})
    monkeypatch.setattr(worst_case_truth, "_POINTS", 200)
    row = worst_case_truth.compare(seed)
    assert row.proved <= row.margin_truth * (1 + 1e-9)
    assert row.margin_truth <= row.margin <= 1.01 * row.margin_truth
    # 37: a real pole; one per cent of complex parameter costs a third there
    assert 0.6 * row.margin_truth < row.proved
    assert row.worst >= 0.99 * row.gain_truth
    assert max(row.worst, row.gain_truth) <= row.bound * (1 + 1e-9)
    assert np.isfinite(row.bound)


def test_a_member_whose_pole_is_sharper_than_the_nominal_ones():
    """One parameter. A grid made from the nominal poles found 20.5 here and "bounded" it by 32.2;
    the truth is 68.4.
    """
    loop = worst_case_truth.loop_of(34)
    box = worst_case_truth.scaled(loop, 0.9 * box_margin(loop).factor)
    norms = [
        hinf_norm(
            StateSpace(*(part[0] for part in worst_case_truth.members(box, np.array([[delta]]))))
        ).value
        for delta in np.linspace(-1, 1, 201)
    ]
    worst = worst_gain(box)
    assert max(norms) > 60
    assert worst.value >= max(norms) * (1 - 1e-6)
    bound = proved_gain(box, worst.value)
    assert max(norms) < bound.value < 1.02 * worst.value


@pytest.mark.parametrize(("seed", "least"), [(186, 0.165265549), (264, 0.932697167)])
def test_an_eigenvalue_that_turns_fast_between_two_grid_points_is_a_crossing(seed, least):
    """Newton's iteration left the interval and dropped these: margins 0.449 and 2.98 were found;
    the truth is by bisection.
    """
    loop = worst_case_truth.loop_of(seed)
    found = box_margin(loop)
    assert found.factor == pytest.approx(least, rel=1e-8)
    below, above = worst_case_truth.abscissa(loop, found.delta * np.array([[1 - 1e-6], [1 + 1e-6]]))
    assert below < 0 < above
    inside = np.linspace(-found.factor, found.factor, 2001)[1:-1, None]
    assert (worst_case_truth.abscissa(loop, inside) < 0).all()


def test_a_loop_through_which_nothing_passes_has_no_gain():
    """A ZeroDivisionError of the search before, met by one of 500 random systems."""
    loop = box_loop(
        StateSpace([[-1.0]], [[0.5, 1.0]], [[1.0], [0.0]], np.zeros((2, 2))), [RealBlock("p", 1)]
    )
    assert worst_gain(loop).value == 0.0


def test_the_response_is_level_at_infinity():
    """An invalid division before, met by the search where a random loop has its largest gain at
    infinity.
    """
    loop = worst_case_truth.loop_of(2)
    (_, slope), (values, level) = (loop.model.with_slope(omega) for omega in (1.0, np.inf))
    assert np.abs(slope).max() > 0 and not level.any()
    np.testing.assert_array_equal(values, loop.model.D)
