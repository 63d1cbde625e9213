"""Everything that the generated code of a scheduled controller contains, as numbers: sampled
matrices on a grid of speeds, pressures or both.

    v  = speed or pressure within the grid's range, moved by at most rate_limit * sample_time
    M  = (1 - s) M_i + s M_i+1 for every matrix, between the neighbouring grid points,
         s = (v - v_i) / (v_i+1 - v_i);
         of both the same in each of them, between the four points around
    u  = C x + D e                         the current asked for
    us = min(max(u, -limit), limit)        the current given
    x += increment x + B e + unwind (us - u)

Linear in v between grid points and continuous across them; what changes is computed as few signals
(block/changes.py). At a frozen v the law of block/fixed.py, other gains. With L = unwind, x[k+1] =
(A - L C) x + (B - L D) e + L us holds whatever is limited. Peak gains of that system bound the
states at every grid point and three values in every interval, frozen: within +-1 in the scaled
states. For any motion of v the states are bounded where one quadratic Lyapunov function serves all
its values, which is examined (block/motion.py).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import combinations
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike

from ambrose.code.block.block import (
    HEADROOM,
    HOLD_SAMPLES,
    WINDUP_TIME,
    Block,
    Settings,
    anti_windup_gain,
    check_settings,
    slow_states,
    transfer_gains,
)
from ambrose.code.block.changes import Changes, beside_blocks, changes_of
from ambrose.code.block.motion import Motion, bound_motion
from ambrose.code.block.names import names_in_code
from ambrose.code.sampled import ScheduledDeployment
from ambrose.core.checks import InvalidInput, UnstableSystem, check_positive, check_shape, invalid
from ambrose.core.peak_gain import peak_gains
from ambrose.core.scheduled import ScheduledSystem, corners, grid_points, interval_points
from ambrose.core.statespace import StateSpace
from ambrose.law.law import law_of
from ambrose.law.scheduling import SPEED, Scheduling

_EXAMINED = 3  # values in every interval at which the anti-windup is examined
# times the highest of the grid: beyond it a value is implausible, if nobody says otherwise
_BEYOND = 2.0
# largest miss of one pass of the transfer, relative, with which it is used at all; n passes leave
# miss^n, and are repeated until that is at most _LEFT, some fifty times the rounding of doubles
_TRANSFER = 0.3
_LEFT = 1e-14


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class ScheduledBlock(Block):
    """What runs: see the module's formulas; every matrix at k grid points.

    along: what it is scheduled over; axes: the values of each of its parameters, whose points are k
    in all; steady (k, n, m) [1/m]: where fast states stand for a constant error, pick (k, n, p)
    [1/A]: states for a current, applied ``passes`` times in a transfer (0: none). told_limits: of
    each parameter, a larger magnitude is implausible; rate_limits [per s]: of the schedule (inf:
    none); motion: what is proved while it moves. grid, told_limit, rate_limit, told_step: of the
    one parameter, where there is no other.
    """

    axes: tuple[np.ndarray, ...]
    steady: np.ndarray
    pick: np.ndarray
    passes: int
    told_limits: tuple[float, ...]
    rate_limits: tuple[float, ...]
    motion: Motion
    changes: Changes
    along: Scheduling = SPEED

    @property
    def transfers(self) -> bool:
        return self.passes > 0

    @property
    def grid(self) -> np.ndarray:
        return _only(self.axes)

    @property
    def told_limit(self) -> float:
        return _only(self.told_limits)

    @property
    def rate_limit(self) -> float:
        return _only(self.rate_limits)

    @property
    def told_step(self) -> float:
        return _only(self.told_steps)

    @property
    def range(self) -> tuple[Any, Any]:
        """The lowest and the highest value of the schedule; tuples of several parameters."""
        values = grid_points(self.axes)
        return values[0], values[-1]

    @property
    def told_steps(self) -> tuple[float, ...]:
        """The largest moves of the schedule in a sample (inf: any)."""
        return tuple(rate * self.sample_time for rate in self.rate_limits)

    def at(self, value: Any) -> StateSpace:
        """The block between its limits at a frozen speed or pressure, clamped to the range, as a
        sampled system.
        """
        eye = np.eye(self.n_states)
        points = [
            StateSpace(eye + E, B, C, D, self.inputs, self.outputs, self.sample_time)
            for E, B, C, D in zip(self.increment, self.B, self.C, self.D, strict=True)
        ]
        return ScheduledSystem(self.axes, points, self.along.name, self.along.unit, "clamp").at(
            value
        )

    def single(self) -> Self:
        """The block with limits and grid that single precision holds. Raises InvalidInput where
        grid points fall together.
        """
        axes = tuple(np.float32(axis).astype(float) for axis in self.axes)
        for axis, given in zip(axes, self.axes, strict=True):
            if not (np.diff(axis) > 0).all():
                raise invalid(
                    "the grid",
                    given.tolist(),
                    "apart in single precision",
                    'use arithmetic="double"',
                )
        rates = tuple(float(np.float32(step)) / self.sample_time for step in self.told_steps)
        limits = tuple(float(np.float32(limit)) for limit in self.told_limits)
        return replace(
            Block.single(self),
            axes=axes,
            told_limits=limits,
            rate_limits=rates,
            changes=self.changes.single(),
        )


def _only(items: tuple[Any, ...]) -> Any:
    """What there is one of. Raises InvalidInput for two."""
    if len(items) > 1:
        raise InvalidInput(
            "this takes a block scheduled over one parameter; one over speed and pressure is "
            "written as C"
        )
    return items[0]


def build_scheduled_block(
    deployment: ScheduledDeployment,
    name: str,
    error_limit: ArrayLike,
    current_limit: ArrayLike,
    *,
    windup_time: float = WINDUP_TIME,
    hold_samples: int = HOLD_SAMPLES,
    told_limit: float | tuple[float | None, ...] | None = None,
    rate_limit: float | tuple[float | None, ...] | None = None,
) -> ScheduledBlock:
    """The block of a scheduled deployment.

    name, error_limit [m], current_limit [A], windup_time [s], hold_samples: as in ``build_block``.
    told_limit [rad/s] or [Pa]: a value of larger magnitude is implausible and replaced by the last
    good one (None: twice the highest of the grid); within it, one beyond the grid is clamped.
    rate_limit [per s]: how fast the schedule follows (None: at once). Of both a tuple. Raises
    InvalidInput, UnstableSystem for a controller whose states have no bound at a frozen speed.
    """
    K = deployment.sampled
    settings = check_settings(K, name, error_limit, current_limit, windup_time, hold_samples)
    errors, currents = settings.error_limit, settings.current_limit
    along = law_of(K).scheduled_over or SPEED
    limits, rates = check_told_limits(K.axes, along, told_limit, rate_limit)
    dt = float(K.dt or 0.0)

    # bounds at frozen values, then states within +-1: x = scale z
    law = _Points.of(deployment)
    unwind = _unwinding(law, currents, dt / windup_time)
    bound, raw = _bounds(law, unwind, settings)
    scale = np.exp2(np.ceil(np.log2(bound)))

    # transfer by the slow states of the grid's middle
    middle = deployment.increments[len(deployment.increments) // 2]
    steady, pick, passes = _transfer(
        law, slow_states(middle, deployment.sizes, dt, windup_time), currents
    )

    # A - I, B, C and L in scaled states
    rows = scale[:, None]
    increment = law.increment * scale / rows
    B = law.B / rows
    C = law.C * scale
    L = unwind / rows

    # the code holds one matrix and its changes: the tables are read back from those
    changes = _changes(
        increment, B, C, law.D, beside_blocks(law.increment, deployment.sizes) * scale / rows
    )
    n, whole = len(scale), changes.tables()  # what the code computes
    increment = whole[:, :n, :n]
    B = whole[:, :n, n:]
    C = whole[:, n:, :n]
    D = whole[:, n:, n:]
    return ScheduledBlock(
        name=name,
        inputs=names_in_code(K.inputs),
        outputs=names_in_code(K.outputs),
        sample_time=dt,
        delay=deployment.delay,
        axes=K.axes,
        increment=increment,
        B=B,
        C=C,
        D=D,
        unwind=L,
        steady=steady / rows,
        pick=pick / rows,
        passes=passes,
        error_limit=errors,
        current_limit=currents,
        raw_limit=np.maximum(raw, currents),
        hold_samples=hold_samples,
        windup_time=windup_time,
        told_limits=limits,
        rate_limits=rates,
        along=along,
        changes=changes,
        motion=bound_motion(increment, B, C, D, L, np.r_[errors, currents], neighbours(K.axes)),
    )


def _changes(
    increment: np.ndarray, B: np.ndarray, C: np.ndarray, D: np.ndarray, beside: np.ndarray
) -> Changes:
    whole = np.concatenate(
        [np.concatenate([increment, B], axis=2), np.concatenate([C, D], axis=2)], axis=1
    )
    zero = np.zeros(whole.shape[1:])
    zero[: len(beside), : len(beside)] = beside
    return changes_of(whole, zero)


def neighbours(axes: tuple[np.ndarray, ...]) -> list[tuple[int, int]]:
    """All pairs of grid points at the corners of a cell between neighbouring values."""
    middles = np.array(grid_points([(axis[1:] + axis[:-1]) / 2 for axis in axes])).reshape(
        -1, len(axes)
    )

    # every cell by its middle
    cells = corners(axes, middles)[0].tolist()
    return sorted({pair for cell in cells for pair in combinations(cell, 2)})


def check_told_limits(
    axes: tuple[np.ndarray, ...], along: Scheduling, told_limit: Any, rate_limit: Any
) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """The limits of what is plausible and of the schedule's rates as they apply to the axes of a
    grid. Raises InvalidInput.
    """
    given = (
        item if isinstance(item, tuple) else (item,) * len(axes)
        for item in (told_limit, rate_limit)
    )
    found = [_check_told(*item) for item in zip(axes, along.each, *given, strict=True)]
    return tuple(limit for limit, _ in found), tuple(rate for _, rate in found)


def _check_told(
    grid: np.ndarray, along: Scheduling, told_limit: float | None, rate_limit: float | None
) -> tuple[float, float]:
    largest = float(np.abs(grid).max())
    name = along.name
    unit = along.unit
    limit = (
        _BEYOND * largest
        if told_limit is None
        else float(check_shape(told_limit, f"{name}_limit", "()"))
    )
    if not limit >= largest:
        raise invalid(
            f"{name}_limit",
            f"{limit:g} {unit}",
            f"at least {largest:g} {unit}, the grid's largest",
            "raise it",
        )
    remedy = f"give it in {along.rate_unit}, or leave it out"
    rate = np.inf if rate_limit is None else check_positive(rate_limit, f"{name}_rate", remedy)
    return limit, rate


@dataclass(frozen=True, slots=True, eq=False)
class _Points:
    """The sampled matrices stacked over the grid: increment (k, n, n), B (k, n, m), C (k, p, n), D
    (k, p, m).
    """

    axes: tuple[np.ndarray, ...]
    increment: np.ndarray
    B: np.ndarray
    C: np.ndarray
    D: np.ndarray
    along: Scheduling

    @classmethod
    def of(cls, deployment: ScheduledDeployment) -> _Points:
        B, C, D = (np.array([getattr(s, x) for s in deployment.sampled.systems]) for x in "BCD")
        return cls(deployment.sampled.axes, deployment.increments, B, C, D, deployment.along)

    def examined(self) -> np.ndarray:
        """Shares (s, k) of the grid points at every value that is looked at."""
        values = np.array(
            grid_points([interval_points(axis, _EXAMINED) for axis in self.axes])
        ).reshape(-1, len(self.axes))
        index, share = corners(self.axes, values)
        shares = np.zeros((len(values), len(self.B)))
        np.put_along_axis(shares, index, share, axis=1)
        return shares

    def words(self, share: np.ndarray) -> str:
        """Where these shares (k,) of the grid points are."""
        where = share @ np.array(grid_points(self.axes)).reshape(len(share), -1)
        return ", ".join(
            f"{value:.4g} {one.unit}" for value, one in zip(where, self.along.each, strict=True)
        )


def _unwinding(law: _Points, currents: np.ndarray, rate: float) -> np.ndarray:
    """L (k, n, p) [1/A] at every grid point.

    As in build_block, but over all states, which are common to all points and so are not parted
    into slow and fast: a state slower than the windup time is led at ``rate`` = dt / windup_time
    per sample and a faster one hardly at all.
    """
    C = law.C / currents[:, None]
    size = np.linalg.norm(C, axis=1).max(axis=0)

    # a state that no output sees at any point is scaled by 1, not by 0
    size[size == 0] = 1.0
    if not len(size):
        return np.zeros(law.C.transpose(0, 2, 1).shape)
    return np.array(
        [
            anti_windup_gain(E, c, size, currents, rate, f"at {law.words(here)}")
            for E, c, here in zip(law.increment, C, np.eye(len(C)), strict=True)
        ]
    )


def _bounds(law: _Points, unwind: np.ndarray, settings: Settings) -> tuple[np.ndarray, np.ndarray]:
    """Bounds on states (n,) and currents asked for (p,) at frozen values, whatever is limited (the
    module's formula).
    """
    n, errors = law.increment.shape[1], settings.error_limit
    bound, raw = np.full(n, np.finfo(float).tiny), np.abs(law.D[0]) @ errors
    for share in law.examined():
        # the code's interpolation: matrices linear in the shares;
        # x[k+1] = (A - L C) x + (B - L D) e + L us
        E, B, C, D, L = (
            np.tensordot(share, X, 1) for X in (law.increment, law.B, law.C, law.D, unwind)
        )
        inputs = np.hstack([(B - L @ D) * errors, L * settings.current_limit])
        states = HEADROOM * peak_gains(E - L @ C, inputs).sum(axis=1) if n else np.zeros(0)
        if not np.isfinite(states).all():
            raise UnstableSystem(
                f"a state of the controller has no bound at {law.words(share)}: it is unstable "
                "there, or an "
                "integrator that no output sees; design a stable controller for code, or a finer "
                "grid"
            )

        # the largest over all values; currents |C| x + |D| e
        bound = np.maximum(bound, states)
        raw = np.maximum(raw, np.abs(C) @ states + np.abs(D) @ errors)
    return bound, raw


def _transfer(
    law: _Points, slow: np.ndarray, currents: np.ndarray
) -> tuple[np.ndarray, np.ndarray, int]:
    """``transfer_gains`` and the passes; 0 where the states do not reach every output at every
    point.

    A pass is exact at the grid points; between them it leaves ``miss`` of what was missing.
    """
    gains = transfer_gains(law.increment, law.B, law.C, slow, currents)
    if gains is None:
        return np.zeros(law.B.shape), np.zeros(law.C.transpose(0, 2, 1).shape), 0
    steady, pick = gains
    C = law.C / currents[:, None]

    # I - C pick, currents in parts of their limits: what of the missing currents a pass leaves
    left = [
        np.eye(len(currents)) - np.tensordot(s, C, 1) @ np.tensordot(s, pick, 1) * currents
        for s in law.examined()
    ]

    # passes until miss^n is at most _LEFT; a pass that leaves too much is not used
    miss = max(float(np.linalg.norm(x, 2)) for x in left)
    if miss > _TRANSFER:
        return steady, pick, 0
    return steady, pick, 1 + int(np.ceil(np.log(_LEFT) / np.log(max(miss, _LEFT))))
