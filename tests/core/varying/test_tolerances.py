"""Proofs over tolerances while a parameter moves: against every frozen member, and motions that are
worse than any of them.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ambrose.annexes.scheduled.varying_cells import Cell, proved_over_tolerances
from ambrose.core.checks import NumericalFailure
from ambrose.core.norms import hinf_norm
from ambrose.core.statespace import StateSpace

C, Z = np.array([[1.0, 0.0]]), np.array([[1.0, 0.0], [0.0, 1.0]])
MOVES = 0.3
DAMPING = 0.15
STIFFNESS = 0.1
DRAG = 0.04


def matrix(p: float, stiffness: float = 0.0, drag: float = 0.0) -> np.ndarray:
    """An oscillator whose stiffness follows p, with tolerances of stiffness and damping."""
    return np.array(
        [[0.0, 1.0], [-(1 + MOVES * p + STIFFNESS * stiffness), -(2 * DAMPING + DRAG * drag)]]
    )


B = np.array([[0.0, 0.0, 0.0], [-STIFFNESS, -DRAG, 0.4]])
CELLS = [
    Cell(np.array([[matrix(low)], [matrix(high)]]), B[None, None], np.array([[low], [high]]))
    for low, high in ((-1.0, -0.3), (-0.3, 0.3), (0.3, 1.0))
]


def worst_at_rest() -> float:
    ends = (-1.0, 0.0, 1.0)
    loops = (
        StateSpace(matrix(p, s, c), B[:, 2:], C, np.eye(1))
        for p in np.linspace(-1, 1, 9)
        for s in ends
        for c in ends
    )
    return max(hinf_norm(loop).value for loop in loops)


def test_what_stands_still_is_proved_just_above_the_worst_member_and_what_moves_above_that() -> (
    None
):
    rest = worst_at_rest()
    still, moving = (
        proved_over_tolerances(CELLS, C, Z, 1e-3, pole=pole, degree=2) for pole in (1.0, None)
    )
    assert rest < still.gamma < 1.05 * rest  # measured 1.007
    assert still.gamma < moving.gamma and min(still.slack, moving.slack) > 10 * max(
        still.rounding, moving.rounding
    )


def test_a_stiffness_that_may_move_as_it_likes_is_not_proved_where_a_square_wave_pumps() -> None:
    """Switched between 1.5 and 0.5 twice a period an oscillator of 2 % damping grows; at rest it is
    stable at either.
    """
    light = [
        Cell(
            np.array([[[[0.0, 1.0], [-1.0, -0.04]]]]),
            np.array([[[[0.0, 0.0], [-0.5, 1.0]]]]),
            np.array([[-1.0], [1.0]]),
        )
    ]
    with pytest.raises(NumericalFailure, match="over its tolerances"):
        proved_over_tolerances(light, C, Z[:1], pole=None)
    assert (
        proved_over_tolerances(light, C, Z[:1], pole=1.0).gamma
        < 1.1
        * hinf_norm(
            StateSpace(
                np.array([[0.0, 1.0], [-0.5, -0.04]]), np.array([[0.0], [1.0]]), C, np.eye(1)
            )
        ).value
    )


def test_a_tolerance_that_nothing_shows_changes_nothing() -> None:
    """A row of zeros in Z, of a coefficient that acts on no state: w = 0."""
    silent = np.vstack([Z, np.zeros((1, 2))])
    wide = [
        replace(cell, B=np.concatenate([cell.B[..., :2], cell.B[..., 1:]], axis=-1))
        for cell in CELLS[1:2]
    ]
    with_it, without = (
        proved_over_tolerances(cells, C, rows, pole=None).gamma
        for cells, rows in ((wide, silent), (CELLS[1:2], Z))
    )
    assert with_it == pytest.approx(without, rel=1e-6)
