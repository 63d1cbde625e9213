"""A system that depends on measured parameters: matrices on a grid of their values, interpolated
linearly between them.

A grid of several parameters is rectangular, and its matrices are linear in each of them between two
neighbours (bilinear of two). A point of one parameter is a number, of several a tuple; the points
of a grid are counted with the last parameter first.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise, product
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from ambrose.core.checks import InvalidInput, check_positive, check_shape, invalid
from ambrose.core.presentation import Presented
from ambrose.core.statespace import StateSpace, as_statespace

AND = " and "  # between the names of several parameters
_EDGE = 1e-9  # of the range: rounding of its ends is no excursion


@dataclass(frozen=True, slots=True, eq=False, init=False, repr=False)
class ScheduledSystem(Presented):
    """x' = A(p) x + B(p) u, y = C(p) x + D(p) u with every matrix piecewise linear in the parameter
    p, or in each of several.

    axes: ascending values (k,) of the parameter; of "a and b" an array for each. systems: a
    StateSpace for each point of the grid, all in the same states, with the same signals and sample
    time. ``outside``: what ``at`` does with a value beyond the grid, "refuse" it or "clamp" it to
    the nearest end. parameter, unit: what p is; "speed and pressure", "rad/s and Pa" of two. Called
    with a value it returns the StateSpace there, as the simulations expect of a controller that
    changes with speed. Raises InvalidInput.
    """

    axes: tuple[np.ndarray, ...]
    systems: tuple[StateSpace, ...]
    parameter: str
    unit: str
    outside: Literal["refuse", "clamp"]

    def __init__(
        self,
        axes: ArrayLike | Sequence[ArrayLike],
        systems: Sequence[Any],
        parameter: str = "speed",
        unit: str = "rad/s",
        outside: Literal["refuse", "clamp"] = "refuse",
    ) -> None:
        values = check_axes(axes, parameter)
        members, count = (
            tuple(as_statespace(system) for system in systems),
            int(np.prod([len(axis) for axis in values])),
        )
        if len(members) != count:
            raise invalid(
                "the number of systems",
                len(members),
                f"{count}, one per grid point",
                "give one for each",
            )
        check_alike(members, "system")
        if outside not in ("refuse", "clamp"):
            raise invalid(
                "outside", repr(outside), '"refuse" or "clamp"', "refuse is the safe choice"
            )
        for axis in values:
            axis.setflags(write=False)
        for name, value in zip(
            self.__slots__, (values, members, parameter, unit, outside), strict=True
        ):
            object.__setattr__(self, name, value)

    def facts(self) -> Mapping[str, Any]:
        """The parameters and their ranges, and the size of the system."""
        return {
            "over": f"{self.words()}, {' x '.join(str(len(axis)) for axis in self.axes)} points",
            "states": self.n_states,
            "time": "continuous" if self.dt is None else f"sampled, dt = {self.dt:g} s",
            "outside": self.outside,
            "inputs": self.inputs,
            "outputs": self.outputs,
        }

    def words(self) -> str:
        """Its range: "speed 100 to 500 rad/s and pressure 0 to 2e+05 Pa"."""
        named = zip(self.parameter.split(AND), self.axes, self.unit.split(AND), strict=True)
        return AND.join(
            f"{name} {axis[0]:.4g} to {axis[-1]:.4g} {unit}" for name, axis, unit in named
        )

    def to_dict(self) -> dict[str, Any]:
        """Grid, parameter, unit, what happens outside and systems, ready for JSON; a second
        parameter as "second".
        """
        return {**self.scheduling(), "systems": [system.to_dict() for system in self.systems]}

    def scheduling(self) -> dict[str, Any]:
        """``to_dict`` without the systems."""
        named = zip(self.parameter.split(AND), self.unit.split(AND), self.axes, strict=True)
        first, *others = [
            {"parameter": name, "unit": unit, "grid": axis.tolist()} for name, unit, axis in named
        ]
        head = {"parameter": "", "unit": "", "interpolation": "linear", "outside": self.outside}
        return head | first | ({"second": others[0]} if others else {})

    @property
    def grid(self) -> np.ndarray:
        """The values (k,) of its one parameter. Raises InvalidInput where there are several."""
        if len(self.axes) > 1:
            raise InvalidInput(
                f"a schedule over {self.parameter} was given where one over a single parameter "
                "can be taken"
            )
        return self.axes[0]

    @property
    def values(self) -> list[Any]:
        """The points of the grid, in the systems' order."""
        return grid_points(self.axes)

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
    def range(self) -> tuple[Any, Any]:
        """The smallest and the largest value of the parameter; of several tuples."""
        values = self.values
        return values[0], values[-1]

    def at(self, value: ArrayLike) -> StateSpace:
        """The system at one value of the parameter, or a tuple of several. Raises InvalidInput
        outside the range, unless it clamps.
        """
        names, d = self.parameter.split(AND), len(self.axes)
        clipped = np.atleast_1d(
            check_shape(value, self.parameter, "()" if d == 1 else f"({d})")
        ).astype(float)
        for i, (name, unit, axis) in enumerate(
            zip(names, self.unit.split(AND), self.axes, strict=True)
        ):
            low = float(axis[0])
            high = float(axis[-1])
            coordinate = float(clipped[i])
            slack = _EDGE * (high - low)
            if not low - slack <= coordinate <= high + slack and self.outside == "refuse":
                raise invalid(
                    f"the {name}",
                    f"{coordinate:g} {unit}",
                    f"between {low:g} and {high:g} {unit}",
                    'design over a wider range; outside="clamp" holds the controller of the '
                    "nearest end, without any guarantee",
                )
            clipped[i] = min(max(coordinate, low), high)
        index, share = (part[0].tolist() for part in corners(self.axes, clipped[None]))
        A, B, C, D = (
            sum(part * getattr(self.systems[i], x) for i, part in zip(index, share, strict=True))
            for x in "ABCD"
        )
        first = self.systems[0]
        return StateSpace(A, B, C, D, first.inputs, first.outputs, first.dt)

    __call__ = at


def check_axes(axes: ArrayLike | Sequence[ArrayLike], parameter: str) -> tuple[np.ndarray, ...]:
    """The values (k,) of every parameter as ``check_grid`` takes them; ``axes``: an array of one
    alone. Raises InvalidInput.
    """
    names = parameter.split(AND)
    grids: Any = (
        axes
        if len(names) > 1 or (isinstance(axes, tuple) and len(axes) == 1 and np.ndim(axes[0]))
        else (axes,)
    )
    if len(grids) != len(names):
        raise invalid(
            "the number of the grid's axes",
            len(grids),
            f"{len(names)}, for {parameter}",
            "give one for each",
        )
    return tuple(check_grid(axis, name) for axis, name in zip(grids, names, strict=True))


def grid_points(axes: Sequence[np.ndarray]) -> list[Any]:
    """The points of a rectangular grid: numbers of one axis, tuples of several."""
    points = list(product(*(axis.tolist() for axis in axes)))
    return [point[0] for point in points] if len(axes) == 1 else points


def corners(axes: Sequence[np.ndarray], values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The points of the grid around each of the values (s, d) within it: their indices (s, 2^d),
    and their shares (s, 2^d).
    """
    index, share = np.zeros((len(values), 1), int), np.ones((len(values), 1))

    # Axis by axis; every corner so far splits in two, and the last axis counts fastest.
    for axis, v in zip(axes, values.T, strict=True):
        # The last value of an axis belongs to the interval below it.
        low = np.clip(np.searchsorted(axis, v, side="right") - 1, 0, len(axis) - 2)
        far = (v - axis[low]) / (axis[low + 1] - axis[low])
        index = (len(axis) * index[:, :, None] + np.stack([low, low + 1], axis=1)[:, None]).reshape(
            len(v), -1
        )
        share = (share[:, :, None] * np.stack([1 - far, far], axis=1)[:, None]).reshape(len(v), -1)
    return index, share


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
        raise invalid(
            f"the grid of the {parameter}",
            values.tolist(),
            "ascending without repetition",
            "sort it",
        )
    return values


def check_alike(systems: Sequence[StateSpace], what: str) -> None:
    """Same states, signals and sample time throughout. Raises InvalidInput that names the first
    difference.
    """
    for i, (first, other) in enumerate(pairwise(systems)):
        for name in ("n_states", "inputs", "outputs", "dt"):
            if getattr(first, name) != getattr(other, name):
                raise invalid(
                    f"{name} of {what} {i + 2}",
                    getattr(other, name),
                    f"that of {what} {i + 1}, {getattr(first, name)}",
                    "scheduling needs the same signals and a state basis that does not depend on "
                    "the parameter",
                )


def interval_points(grid: ArrayLike, between: int) -> np.ndarray:
    """The grid (k,) with ``between`` further points evenly in every interval, ascending ((k - 1)
    (between + 1) + 1,).
    """
    values = check_grid(grid, "parameter")
    check_positive(between, "between", "0 gives the grid itself", zero_allowed=True)
    inner = [np.linspace(a, b, int(between) + 1, endpoint=False) for a, b in pairwise(values)]
    return np.append(np.concatenate(inner), values[-1])
