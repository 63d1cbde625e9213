"""A system that depends on a measured parameter: matrices on a grid of its values, interpolated linearly between them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from ambrose.core.checks import check_positive, check_shape, invalid
from ambrose.core.presentation import Presented
from ambrose.core.statespace import StateSpace, as_statespace

_EDGE = 1e-9  # of the range: rounding of its ends is no excursion


@dataclass(frozen=True, slots=True, eq=False, init=False, repr=False)
class ScheduledSystem(Presented):
    """x' = A(p) x + B(p) u, y = C(p) x + D(p) u with every matrix piecewise linear in the parameter p.

    grid (k,): ascending values of the parameter; systems: one StateSpace each, all in the same states, with the same signals
    and sample time. ``outside``: what ``at`` does with a value beyond the grid, "refuse" it or "clamp" it to the nearest end.
    parameter, unit: what p is. Called with a value it returns the StateSpace there, as the simulations expect of a controller
    that changes with speed. Raises InvalidInput.
    """

    grid: np.ndarray
    systems: tuple[StateSpace, ...]
    parameter: str
    unit: str
    outside: Literal["refuse", "clamp"]

    def __init__(
        self,
        grid: ArrayLike,
        systems: Sequence[Any],
        parameter: str = "speed",
        unit: str = "rad/s",
        outside: Literal["refuse", "clamp"] = "refuse",
    ) -> None:
        values = check_grid(grid, parameter)
        members = tuple(as_statespace(system) for system in systems)
        if len(members) != len(values):
            raise invalid("the number of systems", len(members), f"{len(values)}, one per grid point", "give one for each")
        check_alike(members, "system")
        if outside not in ("refuse", "clamp"):
            raise invalid("outside", repr(outside), '"refuse" or "clamp"', "refuse is the safe choice")
        values.setflags(write=False)
        for name, value in zip(self.__slots__, (values, members, parameter, unit, outside), strict=True):
            object.__setattr__(self, name, value)

    def facts(self) -> Mapping[str, Any]:
        """The parameter and its range, and the size of the system."""
        low, high = self.range
        return {
            self.parameter: f"{low:.4g} to {high:.4g} {self.unit}, {len(self.grid)} points", "states": self.n_states,
            "time": "continuous" if self.dt is None else f"sampled, dt = {self.dt:g} s", "outside": self.outside,
            "inputs": self.inputs, "outputs": self.outputs,
        }  # fmt: skip

    def to_dict(self) -> dict[str, Any]:
        """Grid, systems, parameter, unit and what happens outside, ready for JSON."""
        systems = [system.to_dict() for system in self.systems]
        fields = {"parameter": self.parameter, "unit": self.unit, "outside": self.outside}
        return {"grid": self.grid.tolist(), "systems": systems, **fields}

    @property
    def inputs(self) -> tuple[str, ...]:
        """Names of the inputs."""
        return self.systems[0].inputs

    @property
    def outputs(self) -> tuple[str, ...]:
        """Names of the outputs."""
        return self.systems[0].outputs

    @property
    def dt(self) -> float | None:
        """Sample time [s], None when continuous."""
        return self.systems[0].dt

    @property
    def n_states(self) -> int:
        """The number of states, the same at every point."""
        return self.systems[0].n_states

    @property
    def range(self) -> tuple[float, float]:
        """The smallest and the largest value of the parameter."""
        return float(self.grid[0]), float(self.grid[-1])

    def at(self, value: float) -> StateSpace:
        """The system at one value of the parameter. Raises InvalidInput outside the range, unless it clamps."""
        value = float(check_shape(value, self.parameter, "()"))
        low, high = self.range
        slack = _EDGE * (high - low)
        if not low - slack <= value <= high + slack and self.outside == "refuse":
            raise invalid(
                f"the {self.parameter}", f"{value:g} {self.unit}", f"between {low:g} and {high:g} {self.unit}",
                'design over a wider range; outside="clamp" holds the controller of the nearest end, without any guarantee',
            )  # fmt: skip
        value = min(max(value, low), high)
        i = min(int(np.searchsorted(self.grid, value, side="right")) - 1, len(self.grid) - 2)
        share = (value - self.grid[i]) / (self.grid[i + 1] - self.grid[i])
        first, last = self.systems[i], self.systems[i + 1]
        A, B, C, D = ((1 - share) * getattr(first, x) + share * getattr(last, x) for x in "ABCD")
        return StateSpace(A, B, C, D, first.inputs, first.outputs, first.dt)

    __call__ = at


def check_grid(grid: ArrayLike, parameter: str) -> np.ndarray:
    """The grid as an array (k,) after checking k >= 2 and that it ascends. Raises InvalidInput."""
    values = check_shape(grid, f"the grid of the {parameter}", "(k)").astype(float)
    if len(values) < 2:
        raise invalid(
            f"the number of grid points of the {parameter}",
            len(values),
            "at least 2",
            "one point needs no scheduling: use hinf",
        )
    if not (np.diff(values) > 0).all():
        raise invalid(f"the grid of the {parameter}", values.tolist(), "ascending without repetition", "sort it")
    return values


def check_alike(systems: Sequence[StateSpace], what: str) -> None:
    """Same states, signals and sample time throughout. Raises InvalidInput that names the first difference."""
    for i, (first, other) in enumerate(pairwise(systems)):
        for name in ("n_states", "inputs", "outputs", "dt"):
            if getattr(first, name) != getattr(other, name):
                raise invalid(
                    f"{name} of {what} {i + 2}", getattr(other, name), f"that of {what} {i + 1}, {getattr(first, name)}",
                    "scheduling needs the same signals and a state basis that does not depend on the parameter",
                )  # fmt: skip


def interval_points(grid: ArrayLike, between: int) -> np.ndarray:
    """The grid (k,) with ``between`` further points evenly in every interval, ascending ((k - 1) (between + 1) + 1,)."""
    values = check_grid(grid, "parameter")
    check_positive(between, "between", "0 gives the grid itself", zero_allowed=True)
    inner = [np.linspace(a, b, int(between) + 1, endpoint=False) for a, b in pairwise(values)]
    return np.append(np.concatenate(inner), values[-1])
