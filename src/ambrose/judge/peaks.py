"""Peaks of frequency curves, refined between grid points: what is reported must not depend on the
grid.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from ambrose.judge.loop_response import Evaluator, LoopResponse

Rows = Callable[[LoopResponse], np.ndarray]  # a LoopResponse -> (k, w) real, non-negative

_INSIDE = 7  # points inside a bracket per round: each round narrows it fourfold
_ROUNDS = 4  # refinements of the grid around a peak
_CANDIDATES = 4  # local maxima followed per curve
_WORTH = 0.5  # of the largest grid value: a lower local maximum is not followed


@dataclass(frozen=True, slots=True)
class Peak:
    """The largest value of a curve and where it lies [rad/s]; at_edge: on the end of the range, so
    it may rise beyond.
    """

    value: float
    frequency: float
    at_edge: bool


@dataclass(slots=True)
class _Bracket:
    row: int
    omega: np.ndarray  # (3,) left, middle, right
    value: np.ndarray  # (3,)


def peaks_of(
    quantities: Sequence[Rows],
    response: LoopResponse,
    evaluator: Evaluator,
    within: tuple[float, float] | None = None,
) -> list[tuple[Peak, ...]]:
    """The peak of every row of several quantities over the response's grid, refined around the best
    local maxima.

    within: frequency range [rad/s], default the whole grid; its ends are evaluated too. All
    brackets share each round's evaluation of the loop and are narrowed 256 times; the error left is
    the non-parabolic part of the curve within them.
    """
    values = [rows(response) for rows in quantities]
    sizes = [len(v) for v in values]
    stacked = np.vstack(values)
    low, high = within or (response.omega[0], response.omega[-1])
    inside = (response.omega > low) & (response.omega < high)
    ends = evaluator(np.array([low, high]))
    left, right = np.hsplit(np.vstack([rows(ends) for rows in quantities]), 2)
    omega, stacked = (
        np.concatenate([[low], response.omega[inside], [high]]),
        np.hstack([left, stacked[:, inside], right]),
    )
    brackets = [b for row in range(len(stacked)) for b in _brackets(row, omega, stacked[row])]
    owner = np.repeat(np.arange(len(sizes)), sizes)
    first = np.concatenate([[0], np.cumsum(sizes)])
    for _ in range(_ROUNDS if brackets else 0):
        _narrow(brackets, quantities, owner, first, evaluator)
    peaks = [_grid_peak(omega, row) for row in stacked]
    for bracket in brackets:
        frequency, value = _vertex(bracket)
        if value >= peaks[bracket.row].value:
            peaks[bracket.row] = Peak(value, frequency, False)
    return [tuple(peaks[first[k] : first[k + 1]]) for k in range(len(sizes))]


def _brackets(row: int, omega: np.ndarray, values: np.ndarray) -> list[_Bracket]:
    middle = values[1:-1]
    top = (
        np.flatnonzero(
            (middle >= values[:-2]) & (middle >= values[2:]) & (middle >= _WORTH * values.max())
        )
        + 1
    )
    top = top[np.argsort(values[top])[::-1][:_CANDIDATES]]
    return [_Bracket(row, omega[i - 1 : i + 2].copy(), values[i - 1 : i + 2].copy()) for i in top]


def _narrow(
    brackets: list[_Bracket],
    quantities: Sequence[Rows],
    owner: np.ndarray,
    first: np.ndarray,
    evaluator: Evaluator,
) -> None:
    """Replace every bracket by the neighbours of the best of its own and the new points."""
    fraction = np.arange(1, _INSIDE + 1) / (_INSIDE + 1)
    points = np.array([b.omega[0] + (b.omega[2] - b.omega[0]) * fraction for b in brackets])
    # the old middle stays: it replaces its nearest new point
    for bracket, line in zip(brackets, points, strict=True):
        line[np.argmin(np.abs(line - bracket.omega[1]))] = bracket.omega[1]
    response = evaluator(points.ravel())
    new = [rows(response) for rows in quantities]
    for k, bracket in enumerate(brackets):
        group = owner[bracket.row]
        line = new[group][bracket.row - first[group], k * _INSIDE : (k + 1) * _INSIDE]
        omega = np.concatenate([bracket.omega[:1], points[k], bracket.omega[2:]])
        value = np.concatenate([bracket.value[:1], line, bracket.value[2:]])
        i = int(np.clip(np.argmax(value), 1, _INSIDE))
        bracket.omega, bracket.value = omega[i - 1 : i + 2], value[i - 1 : i + 2]


def _vertex(bracket: _Bracket) -> tuple[float, float]:
    """Vertex of the parabola through the three points; the best point itself where the parabola has
    none inside.
    """
    (a, b, c), (fa, fb, fc) = bracket.omega, bracket.value
    left, right = (b - a) * (fb - fc), (b - c) * (fb - fa)
    if left == right or fb < max(fa, fc):
        best = int(np.argmax(bracket.value))
        return float(bracket.omega[best]), float(bracket.value[best])
    x = b - 0.5 * ((b - a) * left - (b - c) * right) / (left - right)
    if not a <= x <= c:
        return float(b), float(fb)
    curvature = ((fc - fb) / (c - b) - (fb - fa) / (b - a)) / (c - a)
    return float(x), float(fb - curvature * (x - b) ** 2)


def _grid_peak(omega: np.ndarray, values: np.ndarray) -> Peak:
    i = int(np.argmax(values))
    return Peak(float(values[i]), float(omega[i]), i in {0, len(omega) - 1})
