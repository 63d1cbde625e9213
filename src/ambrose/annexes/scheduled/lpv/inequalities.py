"""The linear matrix inequalities of gridded LPV synthesis: R and S common to all points, or one of
them a polynomial in every parameter whose rate is bounded.

They are those of hinf/lmi.py at every grid point and for all signs of the largest rates, with A R +
R A^T - R' and A^T S + S A + S' in the corners. R' and S' are the time derivatives, zero for
constant matrices, which therefore allow any rate. Two passes: gamma is made as small as it gets;
then, a little above it, R S is driven away from I while R, S and the slack stay bounded, which
keeps the controller's poles slow. Sources: Apkarian & Adams 1998, IEEE Trans. Control Systems
Technology 6 (projected form); Wu, Yang, Packard & Becker 1996, Int. J. Robust Nonlinear Control 6
(rate bounds).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import product
from typing import Literal

import numpy as np

from ambrose.annexes.scheduled.lpv.family import Family
from ambrose.core.checks import NumericalFailure
from ambrose.core.hinf.lmi import coupling, existence
from ambrose.core.hinf.scaling import ScaledPlant
from ambrose.core.matrix_inequalities.semidefinite import (
    Inequality,
    Minimum,
    minimise,
    side,
    smat,
    svec,
)

Varying = Literal["none", "R", "S"]
# R and S while gamma is minimised, in balanced states: the next one where gamma rests on it, by
# more than a share of gamma for each factor of e
_LARGEST = (1e6, 1e8, 1e10)
_RESTS = 1e-3
_TOLERANCE = 1e-5  # of gamma
_TIGHT = 1e-4  # residual of an iterate that is looked at although the method ended early
# (slack, largest R and S) of the second pass
_MARGINS = ((1e-4, 1e3), (1e-4, 1e4), (1e-5, 1e5), (1e-6, 1e6), (1e-6, 1e8), (1e-6, 1e10))


@dataclass(frozen=True, slots=True, eq=False)
class Lyapunov:
    """R(p) = sum_j f_j(p) R_j and S(p) = sum_j f_j(p) S_j of the relative parameters p (d,), with
    the functions f_j of the ``shape``; R (a, n, n), S (b, n, n), of a constant one term.
    """

    R: np.ndarray
    S: np.ndarray
    shape: Shape

    def at(self, p: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """R and S (n, n) at the relative parameters."""
        f = self.shape.functions(p)
        R, S = (np.tensordot(f[: len(X)], X, 1) for X in (self.R, self.S))
        return R, S

    def moved(self, p: np.ndarray, rates: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """dR/dt and dS/dt (n, n) while the parameters move at ``rates`` (d,)."""
        f = self.shape.moved(p, rates)
        R, S = (np.tensordot(f[: len(X)], X, 1) for X in (self.R, self.S))
        return R, S


@dataclass(frozen=True, slots=True, eq=False)
class Shape:
    """Which matrix varies, as a polynomial of which degree in every parameter by itself, and at
    which relative rates at most; None: at any, so that it does not vary with that parameter.
    """

    varying: Varying
    degree: int
    largest: tuple[float | None, ...]

    @property
    def powers(self) -> list[tuple[int, int]]:
        """(parameter, power) of every function but the first, which is 1."""
        return [
            (i, j)
            for i, rate in enumerate(self.largest)
            if rate is not None
            for j in range(1, self.degree + 1)
        ]

    def functions(self, p: np.ndarray) -> np.ndarray:
        """1, p_1, p_1^2 .., p_2 .. (f,) at the relative parameters (d,)."""
        return np.array([1.0, *(p[i] ** j for i, j in self.powers)])

    def moved(self, p: np.ndarray, rates: np.ndarray) -> np.ndarray:
        """Their time derivatives (f,) while the parameters move at ``rates`` (d,)."""
        return np.array([0.0, *(j * p[i] ** (j - 1) * rates[i] for i, j in self.powers)])

    def terms(self, name: str) -> int:
        return 1 + len(self.powers) if self.varying == name else 1

    @property
    def rates(self) -> list[np.ndarray]:
        """The corners of the largest rates (d,), zero for parameters with which nothing varies."""
        ends = [(-rate, rate) if rate else (0.0,) for rate in self.largest]
        return [np.array(corner) for corner in product(*ends)]


def smallest_gamma(
    family: Family, shape: Shape, time_limit: float
) -> tuple[tuple[float, ...], float]:
    """The smallest gamma in the family's units within wider and wider bounds of R and S, ascending,
    and the bound that the first of them rests on all the same (0: none). Raises NumericalFailure.
    """
    minimum, rests = _within(family, shape, _LARGEST[0], time_limit)
    found, active = _usable(minimum), _LARGEST[0] if rests else 0.0
    values = [minimum.value]
    for largest in _LARGEST[1:]:
        if not (found and active):
            break
        wider, rests = _within(family, shape, largest, time_limit)
        if not _usable(wider):
            break
        values.append(wider.value)
        active = largest if rests else 0.0
    # an inexact end will do: everything is recomputed at the end
    if not found:
        what = f"gamma cannot be minimised over the {len(family.plants)} grid points"
        if minimum.status == "time limit":
            raise NumericalFailure(
                f"{what} within {time_limit:.3g} s; take fewer grid points (in Python a function's "
                "time_limit gives it more)"
            )
        raise NumericalFailure(
            f"{what} (the solver ended {minimum.status} with a residual of "
            f"{minimum.primal_error:.2g})"
        )
    return tuple(sorted(values)), active


def _within(
    family: Family, shape: Shape, largest: float, time_limit: float
) -> tuple[Minimum, bool]:
    """The minimum with R and S at most ``largest``, and whether it rests on that bound."""
    cost, items = program(family, shape, largest=largest)
    minimum = minimise(cost, items, tolerance=_TOLERANCE, time_limit=time_limit)

    # d gamma / d ln largest = -largest tr Z, Z the multipliers of largest I - R >= 0 and of S alike
    n = family.n
    ceiling = largest * svec(np.eye(n))
    share = sum(
        largest * float(np.trace(Z))
        for item, Z in zip(
            [item for item in items if len(item.constant)], minimum.multipliers, strict=True
        )
        if np.array_equal(item.constant, ceiling)
    )
    return minimum, share > _RESTS * abs(minimum.value)


def _usable(minimum: Minimum) -> bool:
    inexact = minimum.status == "inexact" and minimum.primal_error < _TIGHT and minimum.value > 0
    return minimum.status == "optimal" or inexact


def well_conditioned(family: Family, shape: Shape, time_limit: float) -> Lyapunov:
    """R and S strictly feasible at gamma = 1 with R S far from I. Raises NumericalFailure."""
    reasons = []
    for strict, largest in _MARGINS:
        cost, items = program(family, shape, 1.0, strict, largest)
        minimum = minimise(cost, items, tolerance=1e-3, time_limit=time_limit, hopeless=-1.0)
        reason = (
            f"slack {strict:g}, R and S up to {largest:g}: {minimum.status}, "
            f"t = {-minimum.value:.4g}"
        )
        # what is found is verified at every point; wide bounds leave a solver fewer digits
        if minimum.primal_error < max(1e-8, 1e-14 * largest) and -minimum.value > 1:
            return _lyapunov(minimum.x, family.n, shape)
        reasons.append(reason)
    raise NumericalFailure(
        f"no well-conditioned solution at this gamma ({reasons[-1]}); increase the back-off"
    )


def _lyapunov(x: np.ndarray, n: int, shape: Shape) -> Lyapunov:
    count, a = n * (n + 1) // 2, shape.terms("R")
    matrices = smat(x[:-1].reshape(-1, count))
    return Lyapunov(matrices[:a], matrices[a:], shape)


def program(
    family: Family,
    shape: Shape,
    gamma: float | None = None,
    strict: float = 0.0,
    largest: float = _LARGEST[0],
) -> tuple[np.ndarray, list[Inequality]]:
    """Cost and inequalities of the first pass (gamma None), or the second; variables svec(R_j),
    svec(S_j), then gamma or t.
    """
    n = family.n
    count = n * (n + 1) // 2
    a = shape.terms("R")
    b = shape.terms("S")

    # Places of svec(R_j), of svec(S_j), and of gamma or t.
    last = np.array([(a + b) * count])
    of_R, of_S = np.arange(a * count), np.arange(a * count, (a + b) * count)
    items = []

    # At every point, for R and for S, at every corner of the rates (a constant matrix has none).
    for plant, p in zip(family.plants, family.relative, strict=True):
        for dual, columns, terms in ((False, of_R, a), (True, of_S, b)):
            of_matrix, of_gamma, constant, of_rate = _existence(plant, dual)
            for rates in shape.rates if terms > 1 else (np.zeros(len(p)),):
                # R(p) = sum f_j R_j, R' = sum f_j' R_j
                factors = zip(
                    shape.functions(p)[:terms], shape.moved(p, rates)[:terms], strict=True
                )
                rows = np.hstack(
                    [f * of_matrix + (moved * of_rate if moved else 0.0) for f, moved in factors]
                )

                # gamma is a variable, or a number and the inequality holds with a slack
                if gamma is None:
                    items.append(
                        Inequality(
                            np.column_stack([rows, of_gamma]), constant, np.append(columns, last)
                        )
                    )
                else:
                    slack = strict * svec(np.eye(side(len(constant))))
                    items.append(Inequality(rows, constant + gamma * of_gamma - slack, columns))

    # the smallest gamma, or the largest t
    cost = np.append(np.zeros((a + b) * count), 1.0 if gamma is None else -1.0)
    return cost, items + _coupling(family, shape, gamma, largest, (of_R, of_S, last))


def _existence(
    plant: ScaledPlant, dual: bool
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """``existence`` for R, or for S; and what the derivative of the matrix adds, (k, n(n+1)/2)."""
    P = plant.dual() if dual else plant

    # A R + R A^T = -R for A = -I/2 and A^T S + S A = S for A = I/2: with the rest zero, what -R'
    # and S' add.
    half = (1 if dual else -1) / 2 * np.eye(len(P.A))
    of_rate = existence(replace(P, A=half, B1=0 * P.B1, C1=0 * P.C1, D11=0 * P.D11))[0]
    return *existence(P), of_rate


def _coupling(
    family: Family,
    shape: Shape,
    gamma: float | None,
    largest: float,
    columns: tuple[np.ndarray, np.ndarray, np.ndarray],
) -> list[Inequality]:
    """[R I; I S] >= 0 or [R tI; tI S] >= 0, and R and S at most ``largest``, at every point where
    that is needed.

    Both are affine in R and S: for polynomials of degree 1 they hold everywhere when they hold at
    the corners of the range.
    """
    n = family.n
    of_R, of_S, last = columns
    up, low, off = coupling(n)
    bound, items = largest * svec(np.eye(n)), []
    every = family.relative

    # Constant: any one point; affine: the corners; of higher degree: every point of the grid.
    where = (
        every[:1]
        if shape.varying == "none"
        else every[(np.abs(every) == 1).all(axis=1)]
        if shape.degree == 1
        else every
    )
    for p in where:
        powers_R, powers_S = (shape.functions(p)[: shape.terms(name)] for name in "RS")
        # [R(p) tI; tI S(p)] >= 0, t = 1 in the first pass
        rows = np.hstack([np.kron(powers_R, up), np.kron(powers_S, low)])
        if gamma is None:
            items.append(Inequality(rows, off, np.concatenate([of_R, of_S])))
        else:
            items.append(
                Inequality(
                    np.column_stack([rows, off]), 0 * off, np.concatenate([of_R, of_S, last])
                )
            )

        # largest I - R(p) >= 0, and S(p) alike
        items += [
            Inequality(-np.kron(powers, np.eye(len(bound))), bound, variables)
            for powers, variables in ((powers_R, of_R), (powers_S, of_S))
        ]
    return items
