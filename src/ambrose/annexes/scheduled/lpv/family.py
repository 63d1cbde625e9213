"""A family of generalized plants over parameters, made ready for computing: one scaling and one
state basis for all of them.

The inequalities couple all points through common matrices, so that nothing may be scaled point by
point. In order: states diagonally, u and y to unit direct terms, states in which the H-infinity
solutions X and Y of the reference plant are equal and diagonal, time to the plants' own pace, w and
z to gamma = 1.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import Any, Literal

import numpy as np

from ambrose.core.checks import InvalidInput, NumericalFailure, invalid
from ambrose.core.hinf_lmi import coupling, existence
from ambrose.core.hinf_riccati import (
    Level,
    ScaledPlant,
    balancing_states,
    check_assumptions,
    full_regularisation,
    normal_form,
    scale_plant,
    search_gamma,
)
from ambrose.core.lft import GeneralizedPlant
from ambrose.core.matrix_inequalities import Inequality, Minimum, minimise, side, smat, svec
from ambrose.core.scheduled import check_alike, grid_points
from ambrose.core.statespace import balance_system

_EPSILON = 1e-3  # of a regularisation, in the scaled plants' units
# of every state and output, tried for the sake of good coordinates
_DISTURBANCES = tuple(10.0**-k for k in range(7))
_HARDLY = 1.01  # times the gamma without it: what the disturbance may cost


@dataclass(frozen=True, slots=True, eq=False)
class Family:
    """plants at the points of a grid, in scaled states x_s and time t rate; x = T x_s for the
    original plants; T (n, n) and its inverse, rate [rad/s].

    axes: of the grid. unit: gamma of the original plants that is 1 here. t, reference: diagonal
    scaling of the states, and of u and y. notes: what was regularised.
    """

    axes: tuple[np.ndarray, ...]
    plants: tuple[ScaledPlant, ...]
    T: np.ndarray
    inverse: np.ndarray
    rate: float
    unit: float
    t: np.ndarray
    reference: ScaledPlant
    notes: tuple[str, ...] = ()

    def scaled(self, plant: GeneralizedPlant) -> ScaledPlant:
        """A further plant of the same kind in this family's states, time and units."""
        plant_signals = _channels(plant, self.reference, self.t)
        if self.notes:
            plant_signals = _extended(plant_signals)

        # given is in the states x / t already: only what comes after t is left of T.
        T, inverse = self.T / self.t[:, None], self.inverse * self.t

        # time t rate: A / rate, B and C / sqrt(rate) each; w and z: sqrt(unit) each, so that gamma
        # = unit becomes 1
        a = self.rate
        b = np.sqrt(self.rate * self.unit)
        g = np.sqrt(self.unit)
        return replace(
            plant_signals,
            A=inverse @ plant_signals.A @ T / a,
            B1=inverse @ plant_signals.B1 / b,
            B2=inverse @ plant_signals.B2 / np.sqrt(a),
            C1=plant_signals.C1 @ T / b,
            C2=plant_signals.C2 @ T / np.sqrt(a),
            D11=plant_signals.D11 / self.unit,
            D12=plant_signals.D12 / g,
            D21=plant_signals.D21 / g,
        )

    @property
    def n(self) -> int:
        """The number of states."""
        return len(self.T)

    @property
    def values(self) -> list[Any]:
        """The points of the grid."""
        return grid_points(self.axes)

    @property
    def relative(self) -> np.ndarray:
        """The points of the grid (k, d) mapped to -1 .. 1, in which polynomials are written."""
        return np.array([self.to_relative(value) for value in self.values])

    def to_relative(self, value: Any) -> np.ndarray:
        """A point mapped to -1 .. 1 (d,) over the ranges."""
        low, high = (np.array([axis[end] for axis in self.axes]) for end in (0, -1))
        return np.asarray(2 * (np.atleast_1d(value) - low) / (high - low) - 1)

    def relative_rates(self, rates: Sequence[float | None]) -> tuple[float | None, ...]:
        """Rates of the parameters [their units per s] in units of the relative ones and of scaled
        time.
        """
        ranges = [float(axis[-1] - axis[0]) for axis in self.axes]
        return tuple(
            None if r is None else 2 * r / wide / self.rate
            for r, wide in zip(rates, ranges, strict=True)
        )

    def on_grid(self, value: Any) -> bool:
        """Whether a point is one of the grid."""
        inside = zip(self.axes, np.atleast_1d(value), strict=True)
        return all(bool(np.isclose(v, axis, rtol=1e-12).any()) for axis, v in inside)

    def in_states(self, T: np.ndarray, inverse: np.ndarray) -> Family:
        """In the states x_s = T x'."""
        plants = tuple(plant.in_states(T, inverse) for plant in self.plants)
        return replace(self, plants=plants, T=self.T @ T, inverse=inverse @ self.inverse)

    def in_units(self, gamma: float) -> Family:
        """With w and z in units in which ``gamma`` (1 so far) is 1."""
        return replace(
            self,
            plants=tuple(plant.in_units(gamma) for plant in self.plants),
            unit=self.unit * gamma,
        )


def scaled_family(plants: Sequence[GeneralizedPlant], axes: tuple[np.ndarray, ...]) -> Family:
    """The plants at the points of the grid, scaled together. Raises InvalidInput where they differ
    in signals or states.
    """
    check_alike([plant.system for plant in plants], "plant")
    for group in "wuzy":
        if any(getattr(p, group) != getattr(plants[0], group) for p in plants):
            raise invalid(
                f"{side} of the plants",
                "different",
                "the same at every grid point",
                "build them the same way",
            )
    middle = len(plants) // 2
    reference = scale_plant(plants[middle])
    q, r = len(plants[0].w), len(plants[0].z)

    # One diagonal scaling t for all: from the largest entry of each place over the points.
    u, y = reference.u_scale, reference.y_scale
    B = [np.hstack([p.system.B[:, :q], p.system.B[:, q:] * u]) for p in plants]
    C = [np.vstack([p.system.C[:r], p.system.C[r:] * y[:, None]]) for p in plants]
    largest = (np.abs(X).max(axis=0) for X in ([p.system.A for p in plants], B, C))
    t = balance_system(*largest)[3]
    regular, notes = _regularised(
        [_channels(plant, reference, t) for plant in plants], grid_points(axes)
    )
    identity = np.eye(len(t))
    bare = Family(axes, regular, identity * t, identity / t, 1.0, 1.0, t, reference, notes)
    return _balanced(bare, middle)


def _channels(plant: GeneralizedPlant, reference: ScaledPlant, t: np.ndarray) -> ScaledPlant:
    """A plant with the reference's scaled u and y, in the states x / t."""
    s = plant.system
    q = len(plant.w)
    r = len(plant.z)
    B = s.B / t[:, None]
    C = s.C * t
    u = reference.u_scale
    y = reference.y_scale[:, None]
    return replace(
        reference,
        A=s.A * t / t[:, None],
        B1=B[:, :q],
        B2=B[:, q:] * u,
        C1=C[:r],
        C2=C[r:] * y,
        D11=s.D[:r, :q],
        D12=s.D[:r, q:] * u,
        D21=s.D[r:, :q] * y,
        D22=s.D[r:, q:],
    )


def _regularised(
    plants: Sequence[ScaledPlant], values: Sequence[Any]
) -> tuple[tuple[ScaledPlant, ...], tuple[str, ...]]:
    """The plants, with small outputs and disturbances added to all where one of them violates an
    assumption.
    """
    findings: tuple[str, ...] = ()
    for plant, value in zip(plants, values, strict=True):
        try:
            findings = findings or check_assumptions(plant).findings
        except InvalidInput as error:
            raise InvalidInput(f"grid point {named(value)}: {error}") from error
    if not findings:
        return tuple(plants), ()
    notes = (
        f"{'; '.join(findings)}: every state, control and measurement is weighted with "
        f"{_EPSILON:g} instead",
    )
    return tuple(_extended(plant) for plant in plants), notes


def named(value: Any) -> str:
    """A point of a grid in a message."""
    return ", ".join(f"{part:g}" for part in np.atleast_1d(value).tolist())


def _extended(plant: ScaledPlant) -> ScaledPlant:
    regularisation = full_regularisation(plant)
    return plant.extended(regularisation.rows, regularisation.columns, _EPSILON)


def _balanced(family: Family, middle: int) -> Family:
    """Time, states and gamma in units suggested by the reference plant's own H-infinity problem."""
    # Pace: the geometric mean of the poles' moduli, those far slower than the fastest left out.
    moduli = np.abs(np.linalg.eigvals(family.plants[middle].A)) if family.n else np.ones(1)
    moduli = moduli[moduli > 1e-6 * moduli.max(initial=1e-300)]
    rate = float(np.exp(np.log(moduli).mean())) if moduli.size else 1.0
    try:
        # states in which X and Y of the middle plant, near its own optimum, are equal and diagonal
        best = best_level(family.plants[middle])
        T, inverse = balancing_states(_disturbed(family.plants[middle], best))
    except NumericalFailure as failure:
        raise NumericalFailure(
            f"the plant at {named(family.values[middle])} alone has no H-infinity controller "
            f"({failure}); design that one first"
        ) from failure
    slow = tuple(plant.in_time(rate) for plant in family.plants)
    return replace(family, plants=slow, rate=rate).in_states(T, inverse).in_units(best.gamma)


def best_level(plant: ScaledPlant) -> Level:
    """The smallest gamma of one plant that H-infinity control reaches. Raises NumericalFailure."""
    return search_gamma(normal_form(plant)[0], 1e-3, lambda _: None).best


def _disturbed(plant: ScaledPlant, best: Level) -> Level:
    """X and Y with every state disturbed and weighted as much as gamma hardly notices.

    A state that is known exactly, as that of a weight driven by a measurement, has Y = 0: in states
    that balance such a Y, S would be unbounded.
    """
    regularisation = full_regularisation(plant)
    for epsilon in _DISTURBANCES:
        level = best_level(plant.extended(regularisation.rows, regularisation.columns, epsilon))
        if level.gamma <= _HARDLY * best.gamma:
            return level
    return best


# The linear matrix inequalities of gridded LPV synthesis: R and S common to all points, or one of
# them a polynomial in every parameter whose rate is bounded.
#
# They are those of core/hinf_lmi.py at every grid point and for all signs of the largest rates,
# with A R + R A^T - R' and A^T S + S A + S' in the corners. R' and S' are the time derivatives,
# zero for constant matrices, which therefore allow any rate. Two passes: gamma is made as small as
# it gets; then, a little above it, R S is driven away from I while R, S and the slack stay bounded,
# which keeps the controller's poles slow. Sources: Apkarian & Adams 1998, IEEE Trans. Control
# Systems Technology 6 (projected form); Wu, Yang, Packard & Becker 1996, Int. J. Robust Nonlinear
# Control 6 (rate bounds).


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
