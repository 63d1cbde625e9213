"""Everything that the generated code of a scheduled controller contains, as numbers: sampled matrices on the grid of speeds.

    v  = speed within the grid's range, moved by at most rate_limit * sample_time a sample
    M  = (1 - s) M_i + s M_i+1 for every matrix, between the neighbouring grid points, s = (v - v_i) / (v_i+1 - v_i)
    u  = C x + D e                         the current asked for
    us = min(max(u, -limit), limit)        the current given
    x += increment x + B e + unwind (us - u)

Linear in v between grid points and continuous across them; at a frozen speed the law of block/fixed.py, other gains.
With L = unwind, x[k+1] = (A - L C) x + (B - L D) e + L us holds whatever is limited. Peak gains of that system bound the states
at every grid point and three speeds in every interval, frozen: within +-1 in the scaled states. For any motion of the speed the
states are bounded where one quadratic Lyapunov function serves all speeds, which is examined (``motion``;
discretisation/motion.py).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.linalg as sla
from numpy.typing import ArrayLike

from ambrose.core.checks import NumericalFailure, UnstableSystem, check_positive, check_shape, invalid
from ambrose.core.peak_gain import peak_gains
from ambrose.core.scheduled import ScheduledSystem, interval_points
from ambrose.core.statespace import StateSpace
from ambrose.deployment.block.fixed import HOLD_SAMPLES, WINDUP_TIME, check_limits
from ambrose.deployment.block.names import check_identifiers
from ambrose.deployment.discretisation.motion import Motion, motion
from ambrose.deployment.discretisation.scheduled import ScheduledDeployment

_EXAMINED = 3  # speeds in every interval at which the anti-windup is examined
_SLOW = 5.0  # times the windup time: as in control_block
_HEADROOM = 1.02
_BEYOND = 2.0  # times the highest speed of the grid: beyond it a speed is implausible, if nobody says otherwise
_TRANSFER = 0.3  # largest miss of one pass of the transfer, relative, that is repeated until it is gone
_LEFT = 1e-14


@dataclass(frozen=True, slots=True, eq=False)
class ScheduledBlock:
    """What runs: see the module's formulas; states within +-1, errors e (m,) [m], currents u (p,) [A], k grid points.

    grid (k,) [rad/s]; increment (k, n, n), B (k, n, m) [1/m], C (k, p, n) [A], D (k, p, m) [A/m], unwind (k, n, p) [1/A];
    steady (k, n, m) [1/m]: where fast states stand for constant errors, pick (k, n, p) [1/A]: states for a current, applied
    ``passes`` times in a transfer (0: none); error_limit (m,) [m], current_limit (p,) [A], raw_limit (p,) [A], hold_samples,
    windup_time [s], delay [samples]: as in ``ControlBlock``. speed_limit [rad/s]: a larger magnitude is implausible; rate_limit
    [rad/s^2]: of the schedule (inf: none); motion: what is proved of the states while the speed moves.
    """

    name: str
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    sample_time: float
    delay: int
    grid: np.ndarray
    increment: np.ndarray
    B: np.ndarray
    C: np.ndarray
    D: np.ndarray
    unwind: np.ndarray
    steady: np.ndarray
    pick: np.ndarray
    passes: int
    error_limit: np.ndarray
    current_limit: np.ndarray
    raw_limit: np.ndarray
    hold_samples: int
    windup_time: float
    speed_limit: float
    rate_limit: float
    motion: Motion

    @property
    def n_states(self) -> int:
        return self.increment.shape[1]

    @property
    def range(self) -> tuple[float, float]:
        """The lowest and the highest speed [rad/s] of the schedule."""
        return float(self.grid[0]), float(self.grid[-1])

    @property
    def speed_step(self) -> float:
        """The largest move of the schedule in a sample [rad/s] (inf: any)."""
        return self.rate_limit * self.sample_time

    def at(self, speed: float) -> StateSpace:
        """The block between its limits at a frozen speed [rad/s], clamped to the range, as a sampled system."""
        eye = np.eye(self.n_states)
        points = [
            StateSpace(eye + E, B, C, D, self.inputs, self.outputs, self.sample_time)
            for E, B, C, D in zip(self.increment, self.B, self.C, self.D, strict=True)
        ]
        return ScheduledSystem(self.grid, points, outside="clamp").at(speed)


def scheduled_block(
    deployment: ScheduledDeployment,
    name: str,
    error_limit: ArrayLike,
    current_limit: ArrayLike,
    *,
    windup_time: float = WINDUP_TIME,
    hold_samples: int = HOLD_SAMPLES,
    speed_limit: float | None = None,
    rate_limit: float | None = None,
) -> ScheduledBlock:
    """The block of a scheduled deployment.

    name, error_limit [m], current_limit [A], windup_time [s], hold_samples: as in ``control_block``. speed_limit [rad/s]: a
    speed of larger magnitude is implausible and replaced by the last good one (None: twice the highest of the grid); within it,
    a speed beyond the grid is clamped. rate_limit [rad/s^2]: how fast the schedule follows the speed (None: at once). Raises
    InvalidInput, UnstableSystem for a controller whose states have no bound at a frozen speed.
    """
    K = deployment.sampled
    check_identifiers(name, K.inputs, K.outputs)
    errors = check_limits(error_limit, len(K.inputs), "error_limit", "the bearing's gap is the largest")
    currents = check_limits(current_limit, len(K.outputs), "current_limit", "give the amplifier's largest control current in A")
    check_positive(windup_time, "windup_time", f"give it in seconds, e.g. {WINDUP_TIME:g}")
    if isinstance(hold_samples, bool) or not isinstance(hold_samples, int) or not 0 <= hold_samples <= 32767:
        raise invalid("hold_samples", hold_samples, "a whole number from 0 to 32767", f"{HOLD_SAMPLES} is usual")
    farthest, rate = check_speed_limits(K.grid, speed_limit, rate_limit)
    dt = float(K.dt or 0.0)
    law = _Points.of(deployment)
    unwind = _unwinding(law, currents, dt / windup_time)
    bound, raw = _bounds(law, unwind, errors, currents)
    scale = np.exp2(np.ceil(np.log2(bound)))
    slow = _slow_states(deployment, dt, windup_time)
    steady, pick, passes = _transfer(law, slow, currents)
    rows = scale[:, None]
    increment, B, C, L = law.increment * scale / rows, law.B / rows, law.C * scale, unwind / rows
    return ScheduledBlock(
        name, K.inputs, K.outputs, dt, deployment.delay, K.grid,
        increment, B, C, law.D, L,
        steady / rows, pick / rows, passes, errors, currents, np.maximum(raw, currents),
        hold_samples, windup_time, farthest, rate, motion(increment, B, C, law.D, L, np.r_[errors, currents]),
    )  # fmt: skip


def check_speed_limits(grid: np.ndarray, speed_limit: float | None, rate_limit: float | None) -> tuple[float, float]:
    """speed_limit [rad/s] and rate_limit [rad/s^2] as they apply to a grid (k,) [rad/s]. Raises InvalidInput."""
    largest = float(np.abs(grid).max())
    limit = _BEYOND * largest if speed_limit is None else float(check_shape(speed_limit, "speed_limit", "()"))
    if not limit >= largest:
        raise invalid("speed_limit", f"{limit:g} rad/s", f"at least {largest:g} rad/s, the grid's largest", "raise it")
    rate = np.inf if rate_limit is None else check_positive(rate_limit, "rate_limit", "give it in rad/s^2, or leave it out")
    return limit, rate


@dataclass(frozen=True, slots=True, eq=False)
class _Points:
    """The sampled matrices stacked over the grid: increment (k, n, n), B (k, n, m), C (k, p, n), D (k, p, m)."""

    grid: np.ndarray
    increment: np.ndarray
    B: np.ndarray
    C: np.ndarray
    D: np.ndarray

    @classmethod
    def of(cls, deployment: ScheduledDeployment) -> _Points:
        B, C, D = (np.array([getattr(s, x) for s in deployment.sampled.systems]) for x in "BCD")
        return cls(deployment.sampled.grid, deployment.increments, B, C, D)

    def examined(self) -> np.ndarray:
        """Places (s, k): weights of the grid points at every speed that is looked at."""
        return weights(self.grid, interval_points(self.grid, _EXAMINED))


def weights(grid: np.ndarray, speeds: np.ndarray) -> np.ndarray:
    """The shares (s, k) of the grid points (k,) at speeds (s,) within their range."""
    i = np.clip(np.searchsorted(grid, speeds, side="right") - 1, 0, len(grid) - 2)
    share = (speeds - grid[i]) / (grid[i + 1] - grid[i])
    result = np.zeros((len(speeds), len(grid)))
    rows = np.arange(len(speeds))
    result[rows, i], result[rows, i + 1] = 1 - share, share
    return result


def _slow_states(deployment: ScheduledDeployment, dt: float, windup_time: float) -> np.ndarray:
    """Which states (n,) are slower than five times the windup time at the middle grid point, block by block."""
    middle = deployment.increments[len(deployment.increments) // 2]
    slow = np.zeros(len(middle), bool)
    start = 0
    for size in deployment.sizes:
        block = slice(start, start + size)
        slow[block] = 1 - np.abs(np.linalg.eigvals(middle[block, block]) + 1).max() < dt / (_SLOW * windup_time)
        start += size
    return slow


def _unwinding(law: _Points, currents: np.ndarray, rate: float) -> np.ndarray:
    """L (k, n, p) [1/A]: at every grid point a filter's gain, from the Riccati equation, that stabilises A - L C there.

    As in control_block, but over all states, which are common to the speeds and so are not parted into slow and fast: states
    are weighted by their effect on the outputs, outputs by their limits, so that a state slower than the windup time is led at
    ``rate`` = dt / windup_time per sample and a faster one hardly at all.
    """
    k, n, p = law.C.shape[0], law.C.shape[2], law.C.shape[1]
    gain = np.zeros((k, n, p))
    C = law.C / currents[:, None]
    size = np.linalg.norm(C, axis=1).max(axis=0)
    size[size == 0] = 1.0
    for i in range(k if n else 0):
        E, c = law.increment[i] * size[:, None] / size, C[i] / size
        A = np.eye(n) + E
        try:
            P = sla.solve_discrete_are(A.T, c.T, rate**2 * np.eye(n), np.eye(p))
            L = A @ np.linalg.solve(np.eye(p) + c @ P @ c.T, c @ P).T
        except np.linalg.LinAlgError as error:
            where = f"at {law.grid[i]:.4g} rad/s ({error})"
            message = f"no anti-windup gain was found {where}: an integrator that no output sees, or too long a windup_time"
            raise NumericalFailure(message) from error
        gain[i] = L / size[:, None] / currents
    return gain


def _bounds(law: _Points, unwind: np.ndarray, errors: np.ndarray, currents: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Bounds on states (n,) and currents asked for (p,) at frozen speeds, whatever is limited (the module's formula)."""
    n = law.increment.shape[1]
    bound, raw = np.full(n, np.finfo(float).tiny), np.abs(law.D[0]) @ errors
    for share in law.examined():
        E, B, C, D, L = (np.tensordot(share, X, 1) for X in (law.increment, law.B, law.C, law.D, unwind))
        found = peak_gains(E - L @ C, np.hstack([(B - L @ D) * errors, L * currents])).sum(axis=1) if n else np.zeros(0)
        if not np.isfinite(found).all():
            raise UnstableSystem(
                f"a state of the controller has no bound at {share @ law.grid:.4g} rad/s: it is unstable there, or an "
                "integrator that no output sees; design a stable controller for code, or a finer grid"
            )
        bound = np.maximum(bound, _HEADROOM * found)
        raw = np.maximum(raw, np.abs(C) @ (_HEADROOM * found) + np.abs(D) @ errors)
    return bound, raw


def _transfer(law: _Points, slow: np.ndarray, currents: np.ndarray) -> tuple[np.ndarray, np.ndarray, int]:
    """steady (k, n, m), pick (k, n, p) and the passes, so that x = steady e; x += pick (u - C x - D e), passes times, goes on
    with u; passes 0 where the states do not reach every output.

    pick = W C' (C W C')^-1 with the weights W of control_block: fast modes stay in their steady state where the slow ones span
    the outputs. It is exact at the grid points; between them a pass leaves ``miss`` of what was missing.
    """
    k, p, n = law.C.shape
    m = law.B.shape[2]
    steady, pick, fast = np.zeros((k, n, m)), np.zeros((k, n, p)), ~slow
    C = law.C / currents[:, None]
    size = np.maximum(np.linalg.norm(C, axis=1).max(axis=0, initial=0.0), np.finfo(float).tiny)
    spans = slow.any() and all(np.linalg.matrix_rank(c[:, slow] / size[slow], tol=1e-3) == p for c in C)
    weight = np.where(slow | (not spans), 1 / size**2, 0.0)
    for i in range(k):
        gram = (C[i] * weight) @ C[i].T
        if n == 0 or np.linalg.matrix_rank(gram, tol=1e-9 * max(np.trace(gram), 1e-300)) < p:
            return steady, pick, 0
        steady[i, fast] = np.linalg.solve(-law.increment[i][np.ix_(fast, fast)], law.B[i, fast])
        pick[i] = weight[:, None] * np.linalg.solve(gram, C[i]).T / currents
    shares = law.examined()
    left = [np.eye(p) - np.tensordot(s, C, 1) @ np.tensordot(s, pick, 1) * currents for s in shares]
    miss = max(float(np.linalg.norm(x, 2)) for x in left)
    if miss > _TRANSFER:
        return steady, pick, 0
    return steady, pick, 1 + int(np.ceil(np.log(_LEFT) / np.log(max(miss, _LEFT))))


def transfers(block: ScheduledBlock) -> bool:
    """Whether the block can go on from given currents at every speed."""
    return block.passes > 0
