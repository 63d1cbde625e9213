"""What is recomputed for a scheduled controller on the original plants before it is returned.

At every grid point and at frozen points between: stability and H-infinity norm of the closed loop;
and the inequality that holds along every trajectory of the parameter, with the Lyapunov matrix X(p)
that the synthesis found (bounded real lemma),

    [A^T X + X A + X'   X B      C^T   ]
    [B^T X             -gamma I  D^T   ]  < 0     with A, B, C, D of the closed loop as it will run.
    [C                  D       -gamma I]

Where the plant and the controller are linear in the parameter (in each of several) between
neighbouring points, B2, C2, D12, D21 constant and X constant, it holds in between when it holds at
these points, for it is affine in A, B, C and D, which are the same mean of theirs; a plant that
bends between its grid points is checked at the points in between.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ambrose.annexes.scheduled.lpv.controller import Factors
from ambrose.annexes.scheduled.lpv.family import Family, named
from ambrose.core.checks import NumericalFailure
from ambrose.core.lft import GeneralizedPlant, lft
from ambrose.core.scheduled import ScheduledSystem
from ambrose.core.statespace import StateSpace
from ambrose.judge.certificate import generalized_certificate

_RAISED = 1.5  # how far above the designed gamma a guarantee between grid points is looked for
_STEPS = 20  # halvings of the interval, at most


@dataclass(frozen=True, slots=True)
class Frozen:
    """The closed loop held at one point of the parameters.

    guaranteed: smallest gamma, at least the designed one, for which the inequality holds there; inf
    where none does. slack: largest eigenvalue of the inequality at the designed gamma, with X = I
    and time in the family's units (negative: it holds).
    """

    value: Any
    on_grid: bool
    stable: bool
    spectral_abscissa: float
    norm: float
    fastest_pole: float
    slack: float
    guaranteed: float

    def row(self) -> dict[str, float]:
        """For the history of a Synthesis."""
        names = ("spectral_abscissa", "norm", "fastest_pole", "slack", "guaranteed")
        where = {"parameter": self.value}
        if isinstance(self.value, tuple):
            where = {f"parameter_{i}": part for i, part in enumerate(self.value, start=1)}
        return {
            **where,
            "on_grid": float(self.on_grid),
            **{name: getattr(self, name) for name in names},
        }


def frozen(
    plant_at: Callable[[Any], GeneralizedPlant],
    controller: ScheduledSystem,
    family: Family,
    point: Factors,
    values: Sequence[Any],
    relative_rates: Sequence[np.ndarray],
) -> tuple[Frozen, ...]:
    """The closed loop at every one of the points ``values``; the family's unit is the designed
    gamma.
    """
    result = []
    for value in values:
        plant, K = plant_at(value), controller.at(value)
        certificate = generalized_certificate(plant, K)
        p = family.to_relative(value)
        slacks = [_BoundedReal(lft(plant, K), family, point, p, rates) for rates in relative_rates]
        worst = max(slacks, key=lambda item: item.largest(1.0))
        result.append(
            Frozen(
                value,
                family.on_grid(value),
                certificate.stable,
                certificate.spectral_abscissa,
                certificate.closed_loop_norm,
                certificate.fastest_pole,
                worst.largest(1.0),
                worst.smallest() * family.unit,
            )
        )
    return tuple(result)


class _BoundedReal:
    """The inequality at one point, in states in which X is I, gamma in units of the designed
    one.
    """

    def __init__(
        self, loop: StateSpace, family: Family, point: Factors, p: np.ndarray, rates: np.ndarray
    ) -> None:
        n = family.n
        X = point.certificate(p)
        try:
            L = np.linalg.cholesky(X)
        except np.linalg.LinAlgError as error:
            raise NumericalFailure(
                f"the Lyapunov matrix is not positive definite at the relative parameter {named(p)}"
            ) from error

        # States (plant, controller): x = T x_s for the plant's, the controller's are those of X.
        T, inverse = np.eye(2 * n), np.eye(2 * n)
        T[:n, :n], inverse[:n, :n] = family.T, family.inverse

        # x = T L^-T x' makes X = I
        to_whole, back = np.linalg.solve(L, T.T).T, L.T @ inverse  # X = L L^T

        # time t rate, and w and z in which the designed gamma is 1
        A = back @ loop.A @ to_whole / family.rate
        B = back @ loop.B / np.sqrt(family.rate * family.unit)
        C = loop.C @ to_whole / np.sqrt(family.rate * family.unit)

        # A^T X + X A + X' becomes A^T + A + L^-1 X' L^-T
        moved = np.linalg.solve(L, np.linalg.solve(L, point.certificate_moved(p, rates)).T)
        q, r = B.shape[1], len(C)
        D = loop.D / family.unit

        # gamma is still missing: zeros in its two blocks
        self.n = 2 * n
        self.matrix = np.block(
            [[A + A.T + moved, B, C.T], [B.T, np.zeros((q, q)), D.T], [C, D, np.zeros((r, r))]]
        )

    def largest(self, gamma: float) -> float:
        """The largest eigenvalue at a relative gamma."""
        matrix = self.matrix.copy()
        diagonal = np.arange(self.n, len(matrix))
        matrix[diagonal, diagonal] = -gamma
        return float(np.linalg.eigvalsh(matrix)[-1])

    def smallest(self) -> float:
        """The smallest relative gamma from 1 to _RAISED, where the inequality holds; inf when there
        is none.
        """
        if self.largest(1.0) < 0:
            return 1.0
        low, high = 1.0, _RAISED
        if self.largest(high) >= 0:
            return np.inf
        for _ in range(_STEPS):
            middle = (low + high) / 2
            low, high = (low, middle) if self.largest(middle) < 0 else (middle, high)
        return high


def between(
    plants: Sequence[GeneralizedPlant], axes: tuple[np.ndarray, ...], parameter: str, unit: str
) -> Callable[[Any], GeneralizedPlant]:
    """The plants with matrices linear between the grid points, for want of others."""
    schedule = ScheduledSystem(axes, [plant.system for plant in plants], parameter, unit)
    first = plants[0]
    return lambda value: GeneralizedPlant(
        schedule.at(value), first.w, first.u, first.z, first.y, first.blocks
    )
