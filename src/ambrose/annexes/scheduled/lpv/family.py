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
from typing import Any

import numpy as np

from ambrose.core.checks import InvalidInput, NumericalFailure, invalid
from ambrose.core.hinf.assumptions import check_assumptions, full_regularisation
from ambrose.core.hinf.riccati import Level, balancing_states, normal_form, search_gamma
from ambrose.core.hinf.scaling import ScaledPlant, scale_plant
from ambrose.core.lft import GeneralizedPlant
from ambrose.core.realisation.balancing import balance_system
from ambrose.core.scheduled import check_alike, grid_points

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
    for side in "wuzy":
        if any(getattr(p, side) != getattr(plants[0], side) for p in plants):
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
