"""A family of generalized plants over a parameter, made ready for computing: one scaling and one state basis for all of them.

The inequalities couple all points through common matrices, so that nothing may be scaled point by point. In order: states
diagonally, u and y to unit direct terms, states in which the H-infinity solutions X and Y of the reference plant are equal and
diagonal, time to the plants' own pace, w and z to gamma = 1.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ambrose.core.balancing import balance_system
from ambrose.core.checks import InvalidInput, NumericalFailure, invalid
from ambrose.core.lft import GeneralizedPlant
from ambrose.core.scheduled import check_alike
from ambrose.synthesis.hinf_assumptions import Assumptions, check_assumptions, full_regularisation
from ambrose.synthesis.hinf_riccati import Level, balancing_states, normal_form, search_gamma
from ambrose.synthesis.hinf_scaling import ScaledPlant, scale_plant

_EPSILON = 1e-3  # of a regularisation, in the scaled plants' units
_DISTURBANCES = tuple(10.0**-k for k in range(7))  # of every state and output, tried for the sake of good coordinates
_HARDLY = 1.01


@dataclass(frozen=True, slots=True, eq=False)
class Family:
    """plants in scaled states x_s and time t rate; x = T x_s for the original plants; T (n, n) and its inverse, rate [rad/s].

    unit: gamma of the original plants that is 1 here. notes: what was regularised.
    """

    grid: np.ndarray
    plants: tuple[ScaledPlant, ...]
    T: np.ndarray
    inverse: np.ndarray
    rate: float
    unit: float
    notes: tuple[str, ...] = ()

    @property
    def n(self) -> int:
        """The number of states."""
        return len(self.T)

    @property
    def relative(self) -> np.ndarray:
        """The grid (k,) mapped to -1 .. 1, in which polynomials are written."""
        return self.to_relative(self.grid)

    def to_relative(self, values: np.ndarray) -> np.ndarray:
        """Parameter values mapped to -1 .. 1 over the range."""
        return 2 * (values - self.grid[0]) / (self.grid[-1] - self.grid[0]) - 1

    def relative_rate(self, rate: float) -> float:
        """A rate of the parameter [its unit per s] in units of the relative parameter and of scaled time."""
        return 2 * rate / (self.grid[-1] - self.grid[0]) / self.rate

    def in_states(self, T: np.ndarray, inverse: np.ndarray) -> Family:
        """In the states x_s = T x'."""
        plants = tuple(
            replace(p, A=inverse @ p.A @ T, B1=inverse @ p.B1, B2=inverse @ p.B2, C1=p.C1 @ T, C2=p.C2 @ T) for p in self.plants
        )
        return replace(self, plants=plants, T=self.T @ T, inverse=inverse @ self.inverse)

    def in_units(self, gamma: float) -> Family:
        """With w and z in units in which ``gamma`` (1 so far) is 1."""
        root = np.sqrt(gamma)
        plants = tuple(
            replace(p, B1=p.B1 / root, C1=p.C1 / root, D11=p.D11 / gamma, D12=p.D12 / root, D21=p.D21 / root)
            for p in self.plants
        )
        return replace(self, plants=plants, unit=self.unit * gamma)


def scaled_family(plants: Sequence[GeneralizedPlant], grid: np.ndarray) -> Family:
    """The plants at the grid's values, scaled together. Raises InvalidInput where they differ in signals or states."""
    if len(plants) != len(grid):
        raise invalid("the number of plants", len(plants), f"{len(grid)}, one per grid point", "give one for each")
    check_alike([plant.system for plant in plants], "plant")
    for side in "wuzy":
        if any(getattr(p, side) != getattr(plants[0], side) for p in plants):
            raise invalid(f"{side} of the plants", "different", "the same at every grid point", "build them the same way")
    middle = len(plants) // 2
    reference = scale_plant(plants[middle])
    q, r = len(plants[0].w), len(plants[0].z)
    u, y = reference.u_scale, reference.y_scale
    B = [np.hstack([p.system.B[:, :q], p.system.B[:, q:] * u]) for p in plants]
    C = [np.vstack([p.system.C[:r], p.system.C[r:] * y[:, None]]) for p in plants]
    largest = (np.abs(X).max(axis=0) for X in ([p.system.A for p in plants], B, C))
    t = balance_system(*largest)[3]
    scaled = []
    for plant, b, c in zip(plants, [X / t[:, None] for X in B], [X * t for X in C], strict=True):
        A, D = plant.system.A * t / t[:, None], plant.system.D
        scaled.append(replace(
            reference, A=A, B1=b[:, :q], B2=b[:, q:], C1=c[:r], C2=c[r:], D11=D[:r, :q], D12=D[:r, q:] * u,
            D21=D[r:, :q] * y[:, None], D22=D[r:, q:],
        ))  # fmt: skip
    regular, notes = _regularised(scaled, grid)
    return _balanced(Family(grid, regular, np.diag(t), np.diag(1 / t), 1.0, 1.0, notes), middle)


def _regularised(plants: Sequence[ScaledPlant], grid: np.ndarray) -> tuple[tuple[ScaledPlant, ...], tuple[str, ...]]:
    """The plants, with small outputs and disturbances added to all where one of them violates an assumption."""
    found = []
    for plant, value in zip(plants, grid, strict=True):
        try:
            found.append(check_assumptions(plant))
        except InvalidInput as error:
            raise InvalidInput(f"grid point {value:g}: {error}") from error
    wanting = [a for a in found if not a.hold]
    if not wanting:
        return tuple(plants), ()
    return _extended(plants, full_regularisation(plants[0]), wanting[0].findings)


def _extended(
    plants: Sequence[ScaledPlant], more: Assumptions, findings: Sequence[str]
) -> tuple[tuple[ScaledPlant, ...], tuple[str, ...]]:
    epsilon = _EPSILON
    notes = (f"{'; '.join(findings)}: every state, control and measurement is weighted with {epsilon:g} instead",)
    return tuple(plant.extended(more.rows, more.columns, epsilon) for plant in plants), notes


def _balanced(family: Family, middle: int) -> Family:
    """Time, states and gamma in units suggested by the reference plant's own H-infinity problem."""
    moduli = np.abs(np.linalg.eigvals(family.plants[middle].A)) if family.n else np.ones(1)
    moduli = moduli[moduli > 1e-6 * moduli.max(initial=1e-300)]
    rate = float(np.exp(np.log(moduli).mean())) if moduli.size else 1.0
    try:
        best = _level(family.plants[middle])
        T, inverse = balancing_states(_disturbed(family.plants[middle], best))
    except NumericalFailure as failure:
        raise NumericalFailure(
            f"the plant at {family.grid[middle]:g} alone has no H-infinity controller ({failure}); design that one first"
        ) from failure
    root = np.sqrt(rate)
    slow = tuple(
        replace(p, A=p.A / rate, B1=p.B1 / root, B2=p.B2 / root, C1=p.C1 / root, C2=p.C2 / root) for p in family.plants
    )
    return replace(family, plants=slow, rate=rate).in_states(T, inverse).in_units(best.gamma)


def _level(plant: ScaledPlant) -> Level:
    return search_gamma(normal_form(plant)[0], 1e-3, lambda _: None).best


def _disturbed(plant: ScaledPlant, best: Level) -> Level:
    """X and Y with every state disturbed and weighted as much as gamma hardly notices.

    A state that is known exactly, as that of a weight driven by a measurement, has Y = 0: in states that balance such a Y, S
    would be unbounded.
    """
    more = full_regularisation(plant)
    for epsilon in _DISTURBANCES:
        level = _level(plant.extended(more.rows, more.columns, epsilon))
        if level.gamma <= _HARDLY * best.gamma:
            return level
    return best
