"""Everything that the generated code of a scheduled controller contains, as numbers: sampled matrices on a grid of speeds or
pressures.

    v  = speed or pressure within the grid's range, moved by at most rate_limit * sample_time a sample
    M  = (1 - s) M_i + s M_i+1 for every matrix, between the neighbouring grid points, s = (v - v_i) / (v_i+1 - v_i)
    u  = C x + D e                         the current asked for
    us = min(max(u, -limit), limit)        the current given
    x += increment x + B e + unwind (us - u)

Linear in v between grid points and continuous across them; what changes is computed as few signals (block/changes.py). At a
frozen v the law of block/fixed.py, other gains.
With L = unwind, x[k+1] = (A - L C) x + (B - L D) e + L us holds whatever is limited. Peak gains of that system bound the states
at every grid point and three values in every interval, frozen: within +-1 in the scaled states. For any motion of v the
states are bounded where one quadratic Lyapunov function serves all its values, which is examined (block/motion.py).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from numpy.typing import ArrayLike

from ambrose.core.checks import UnstableSystem, check_positive, check_shape, invalid
from ambrose.core.peak_gain import peak_gains
from ambrose.core.scheduled import ScheduledSystem, interval_points
from ambrose.core.statespace import StateSpace
from ambrose.deployment.block.block import (
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
from ambrose.deployment.block.changes import Changes, beside_blocks, changes_of
from ambrose.deployment.block.motion import Motion, bound_motion
from ambrose.deployment.block.names import names_in_code
from ambrose.deployment.discretisation.deployment import ScheduledDeployment
from ambrose.plant.scheduling import SPEED, Scheduling, scheduling_of

_EXAMINED = 3  # values in every interval at which the anti-windup is examined
_BEYOND = 2.0  # times the highest of the grid: beyond it a value is implausible, if nobody says otherwise
_TRANSFER = 0.3  # largest miss of one pass of the transfer, relative, that is repeated until it is gone
_LEFT = 1e-14


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class ScheduledBlock(Block):
    """What runs: see the module's formulas; every matrix at k grid points.

    along: what it is scheduled over; grid (k,) in its unit; steady (k, n, m) [1/m]: where fast states stand for a constant
    error, pick (k, n, p) [1/A]: states for a current, applied ``passes`` times in a transfer (0: none). told_limit: a larger
    magnitude is implausible; rate_limit [per s]: of the schedule (inf: none); motion: what is proved while it moves.
    """

    grid: np.ndarray
    steady: np.ndarray
    pick: np.ndarray
    passes: int
    told_limit: float
    rate_limit: float
    motion: Motion
    changes: Changes
    along: Scheduling = SPEED

    @property
    def transfers(self) -> bool:
        return self.passes > 0

    @property
    def range(self) -> tuple[float, float]:
        """The lowest and the highest value of the schedule."""
        return float(self.grid[0]), float(self.grid[-1])

    @property
    def told_step(self) -> float:
        """The largest move of the schedule in a sample (inf: any)."""
        return self.rate_limit * self.sample_time

    def at(self, value: float) -> StateSpace:
        """The block between its limits at a frozen speed or pressure, clamped to the range, as a sampled system."""
        eye = np.eye(self.n_states)
        points = [
            StateSpace(eye + E, B, C, D, self.inputs, self.outputs, self.sample_time)
            for E, B, C, D in zip(self.increment, self.B, self.C, self.D, strict=True)
        ]
        return ScheduledSystem(self.grid, points, self.along.name, self.along.unit, "clamp").at(value)

    def single(self) -> Self:
        """The block with limits and grid that single precision holds. Raises InvalidInput where grid points fall together."""
        grid = np.float32(self.grid).astype(float)
        if not (np.diff(grid) > 0).all():
            raise invalid("the grid", self.grid.tolist(), "apart in single precision", 'use arithmetic="double"')
        rate, limit = float(np.float32(self.told_step)) / self.sample_time, float(np.float32(self.told_limit))
        return replace(Block.single(self), grid=grid, told_limit=limit, rate_limit=rate, changes=self.changes.single())


def build_scheduled_block(
    deployment: ScheduledDeployment,
    name: str,
    error_limit: ArrayLike,
    current_limit: ArrayLike,
    *,
    windup_time: float = WINDUP_TIME,
    hold_samples: int = HOLD_SAMPLES,
    told_limit: float | None = None,
    rate_limit: float | None = None,
) -> ScheduledBlock:
    """The block of a scheduled deployment.

    name, error_limit [m], current_limit [A], windup_time [s], hold_samples: as in ``build_block``. told_limit [rad/s] or
    [Pa]: a value of larger magnitude is implausible and replaced by the last good one (None: twice the highest of the grid);
    within it, one beyond the grid is clamped. rate_limit [per s]: how fast the schedule follows (None: at once). Raises
    InvalidInput, UnstableSystem for a controller whose states have no bound at a frozen speed.
    """
    K = deployment.sampled
    settings = check_settings(K, name, error_limit, current_limit, windup_time, hold_samples)
    errors, currents = settings.error_limit, settings.current_limit
    along = scheduling_of(K) or SPEED
    told_limit, rate_limit = check_told_limits(K.grid, along, told_limit, rate_limit)
    dt = float(K.dt or 0.0)
    law = _Points.of(deployment)
    unwind = _unwinding(law, currents, dt / windup_time)
    bound, raw = _bounds(law, unwind, settings)
    scale = np.exp2(np.ceil(np.log2(bound)))
    middle = deployment.increments[len(deployment.increments) // 2]
    steady, pick, passes = _transfer(law, slow_states(middle, deployment.sizes, dt, windup_time), currents)
    rows = scale[:, None]
    increment, B, C, L = law.increment * scale / rows, law.B / rows, law.C * scale, unwind / rows
    changes = _changes(increment, B, C, law.D, beside_blocks(law.increment, deployment.sizes) * scale / rows)
    n, whole = len(scale), changes.tables()  # what the code computes
    increment, B, C, D = whole[:, :n, :n], whole[:, :n, n:], whole[:, n:, :n], whole[:, n:, n:]
    return ScheduledBlock(
        name=name, inputs=names_in_code(K.inputs), outputs=names_in_code(K.outputs),
        sample_time=dt, delay=deployment.delay, grid=K.grid,
        increment=increment, B=B, C=C, D=D, unwind=L, steady=steady / rows, pick=pick / rows, passes=passes,
        error_limit=errors, current_limit=currents, raw_limit=np.maximum(raw, currents), hold_samples=hold_samples,
        windup_time=windup_time, told_limit=told_limit, rate_limit=rate_limit, along=along,
        changes=changes,
        motion=bound_motion(increment, B, C, D, L, np.r_[errors, currents]),
    )  # fmt: skip


def _changes(increment: np.ndarray, B: np.ndarray, C: np.ndarray, D: np.ndarray, beside: np.ndarray) -> Changes:
    whole = np.concatenate([np.concatenate([increment, B], axis=2), np.concatenate([C, D], axis=2)], axis=1)
    zero = np.zeros(whole.shape[1:])
    zero[: len(beside), : len(beside)] = beside
    return changes_of(whole, zero)


def check_told_limits(
    grid: np.ndarray, along: Scheduling, told_limit: float | None, rate_limit: float | None
) -> tuple[float, float]:
    """The limit of what is plausible and of the schedule's rate as they apply to a grid (k,). Raises InvalidInput."""
    largest, name, unit = float(np.abs(grid).max()), along.name, along.unit
    limit = _BEYOND * largest if told_limit is None else float(check_shape(told_limit, f"{name}_limit", "()"))
    if not limit >= largest:
        raise invalid(f"{name}_limit", f"{limit:g} {unit}", f"at least {largest:g} {unit}, the grid's largest", "raise it")
    remedy = f"give it in {along.rate_unit}, or leave it out"
    rate = np.inf if rate_limit is None else check_positive(rate_limit, f"{name}_rate", remedy)
    return limit, rate


@dataclass(frozen=True, slots=True, eq=False)
class _Points:
    """The sampled matrices stacked over the grid: increment (k, n, n), B (k, n, m), C (k, p, n), D (k, p, m)."""

    grid: np.ndarray
    increment: np.ndarray
    B: np.ndarray
    C: np.ndarray
    D: np.ndarray
    unit: str

    @classmethod
    def of(cls, deployment: ScheduledDeployment) -> _Points:
        B, C, D = (np.array([getattr(s, x) for s in deployment.sampled.systems]) for x in "BCD")
        return cls(deployment.sampled.grid, deployment.increments, B, C, D, deployment.sampled.unit)

    def examined(self) -> np.ndarray:
        """Shares (s, k) of the grid points at every value that is looked at."""
        values = interval_points(self.grid, _EXAMINED)
        low, share = places(self.grid, values)
        shares, rows = np.zeros((len(values), len(self.grid))), np.arange(len(values))
        shares[rows, low], shares[rows, low + 1] = 1 - share, share
        return shares


def places(grid: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The grid point (s,) below each of the values (s,) within the range, and the share (s,) of the next one."""
    low = np.clip(np.searchsorted(grid, values, side="right") - 1, 0, len(grid) - 2)
    return low, (values - grid[low]) / (grid[low + 1] - grid[low])


def _unwinding(law: _Points, currents: np.ndarray, rate: float) -> np.ndarray:
    """L (k, n, p) [1/A] at every grid point.

    As in build_block, but over all states, which are common to all points and so are not parted into slow and fast: a state
    slower than the windup time is led at ``rate`` = dt / windup_time per sample and a faster one hardly at all.
    """
    C = law.C / currents[:, None]
    size = np.linalg.norm(C, axis=1).max(axis=0)
    size[size == 0] = 1.0
    if not len(size):
        return np.zeros(law.C.transpose(0, 2, 1).shape)
    return np.array([
        anti_windup_gain(E, c, size, currents, rate, f"at {value:.4g} {law.unit}")
        for E, c, value in zip(law.increment, C, law.grid, strict=True)
    ])  # fmt: skip


def _bounds(law: _Points, unwind: np.ndarray, settings: Settings) -> tuple[np.ndarray, np.ndarray]:
    """Bounds on states (n,) and currents asked for (p,) at frozen values, whatever is limited (the module's formula)."""
    n, errors = law.increment.shape[1], settings.error_limit
    bound, raw = np.full(n, np.finfo(float).tiny), np.abs(law.D[0]) @ errors
    for share in law.examined():
        E, B, C, D, L = (np.tensordot(share, X, 1) for X in (law.increment, law.B, law.C, law.D, unwind))
        inputs = np.hstack([(B - L @ D) * errors, L * settings.current_limit])
        states = HEADROOM * peak_gains(E - L @ C, inputs).sum(axis=1) if n else np.zeros(0)
        if not np.isfinite(states).all():
            raise UnstableSystem(
                f"a state of the controller has no bound at {share @ law.grid:.4g} {law.unit}: it is unstable there, or an "
                "integrator that no output sees; design a stable controller for code, or a finer grid"
            )
        bound = np.maximum(bound, states)
        raw = np.maximum(raw, np.abs(C) @ states + np.abs(D) @ errors)
    return bound, raw


def _transfer(law: _Points, slow: np.ndarray, currents: np.ndarray) -> tuple[np.ndarray, np.ndarray, int]:
    """``transfer_gains`` and the passes; 0 where the states do not reach every output at every point.

    A pass is exact at the grid points; between them it leaves ``miss`` of what was missing.
    """
    gains = transfer_gains(law.increment, law.B, law.C, slow, currents)
    if gains is None:
        return np.zeros(law.B.shape), np.zeros(law.C.transpose(0, 2, 1).shape), 0
    steady, pick = gains
    C = law.C / currents[:, None]
    left = [
        np.eye(len(currents)) - np.tensordot(s, C, 1) @ np.tensordot(s, pick, 1) * currents for s in law.examined()
    ]  # fmt: skip
    miss = max(float(np.linalg.norm(x, 2)) for x in left)
    if miss > _TRANSFER:
        return steady, pick, 0
    return steady, pick, 1 + int(np.ceil(np.log(_LEFT) / np.log(max(miss, _LEFT))))
