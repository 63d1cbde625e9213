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
(block/scheduled.py). At a frozen v the law of block/block.py, other gains. With L = unwind, x[k+1]
= (A - L C) x + (B - L D) e + L us holds whatever is limited. Peak gains of that system bound the
states at every grid point and three values in every interval, frozen: within +-1 in the scaled
states. For any motion of v the states are bounded where one quadratic Lyapunov function serves all
its values, which is examined (block/scheduled.py).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, fields, replace
from itertools import combinations
from typing import Any, Self

import numpy as np
import scipy.linalg as sla
from numpy.typing import ArrayLike

from ambrose.code.block.block import (
    BYTES,
    HEADROOM,
    HOLD_SAMPLES,
    STATE_AT,
    WINDUP_TIME,
    Block,
    ControlBlock,
    Cost,
    Settings,
    anti_windup_gain,
    check_settings,
    diagonals_of,
    names_in_code,
    slow_states,
    transfer_gains,
)
from ambrose.code.sampled import ScheduledDeployment
from ambrose.core.checks import (
    NumericalFailure,
    UnstableSystem,
    check_positive,
    check_shape,
    invalid,
)
from ambrose.core.frequency import peak_gains
from ambrose.core.matrix_inequalities import Inequality, minimise, smat, svec
from ambrose.core.scheduled import ScheduledSystem, corners, grid_points, interval_points
from ambrose.core.statespace import StateSpace
from ambrose.law.law import SPEED, Scheduling, law_of
from ambrose.law.supervision import Limits, Matrices, State, SupervisedLaws, SupervisedProgram

# What changes over the grid of a schedule, as few signals: seals and speed enter a rotor at few
# places.
#
#     [[A - I, B], [C, D]] at grid point i = fixed + left core_i right
#
# A plant whose states see the parameter through r forces has, by the closed form of the synthesis
# and by Tustin's map, a controller that changes in a matrix of rank 2 r between the same two spaces
# at every point. The code then takes the fixed part, which is in modal form, once, and interpolates
# ``core`` alone. Nothing is assumed: the spaces are found from the matrices.


_ROUNDING = 1e-11  # of the rows' and columns' own sizes: what transforms to modal states leave
_SWEEPS = 8


@dataclass(frozen=True, slots=True, eq=False)
class Changes:
    """fixed (n + p, n + m), left (n + p, r), core (k, r, q), right (q, n + m): of states and
    errors, to states and currents.
    """

    fixed: np.ndarray
    left: np.ndarray
    core: np.ndarray
    right: np.ndarray

    @property
    def ranks(self) -> tuple[int, int]:
        """r and q."""
        return self.left.shape[1], len(self.right)

    def single(self) -> Self:
        """In numbers that single precision holds."""
        parts = {
            name: np.float32(getattr(self, name)).astype(float)
            for name in ("fixed", "left", "core", "right")
        }
        return replace(self, **parts)

    def tables(self) -> np.ndarray:
        """The whole matrix (k, n + p, n + m) at every grid point."""
        return np.asarray(self.fixed + self.left @ self.core @ self.right)


def changes_of(tables: np.ndarray, beside: np.ndarray) -> Changes:
    """Of the matrices (k, n + p, n + m) at every grid point; beside (n + p, n + m): what of the
    middle one is rounding.
    """
    middle = tables[len(tables) // 2]

    # differences from the middle point, entries of all about 1: rounding is then of one size
    moved = tables - middle
    rows, columns = _sizes(np.abs(tables).max(axis=0))
    scaled = moved / rows[:, None] / columns
    size = _ROUNDING * max(1.0, np.abs(scaled).max(initial=0.0))

    # columns that span those of every difference, and the same of their rows
    left, right = _space(np.hstack(list(scaled)), size), _space(np.vstack(list(scaled)).T, size)

    # moved_i = rows left (left' scaled_i right) right' columns
    return Changes(
        middle - beside, left * rows[:, None], left.T @ scaled @ right, right.T * columns
    )


def _sizes(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """rows (n,) and columns (m,) by whose products the entries of x (n, m), none negative, are at
    most about 1.
    """
    rows, columns = np.ones(len(x)), np.ones(x.shape[1])
    for _ in range(_SWEEPS if x.size else 0):
        for sizes, axis in ((rows, 1), (columns, 0)):
            # half of each row's excess, then half of each column's: the product tends to 1
            largest = (x / rows[:, None] / columns).max(axis=axis)
            np.multiply(sizes, np.sqrt(np.where(largest > 0, largest, 1.0)), out=sizes)
    return rows, columns


def _space(moved: np.ndarray, size: float) -> np.ndarray:
    """Orthonormal columns (n, r) that span those of ``moved`` but for what is smaller than
    ``size``.
    """
    U, s, _ = np.linalg.svd(moved, full_matrices=False)
    return U[:, s > size * np.sqrt(max(moved.shape))]


def beside_blocks(increments: np.ndarray, sizes: tuple[int, ...]) -> np.ndarray:
    """What the matrix (k, n, n) of the middle point has beside blocks of these sizes (n, n), where
    it is rounding; else 0.
    """
    middle = increments[len(increments) // 2]

    # entries between different blocks; where they are more than rounding they stay
    owner = np.repeat(np.arange(len(sizes)), sizes)
    outside = np.where(owner[:, None] == owner, 0.0, middle)
    small = np.abs(outside).max(initial=0.0) <= _ROUNDING * np.abs(middle).max(initial=0.0)
    return outside if small else np.zeros_like(outside)


# States of a scheduled block while its parameter moves: a common quadratic Lyapunov function, and
# the bound that it gives.
#
# Between grid points A - L C = sum over i, j of s_i s_j (A_i - L_i C_j) with shares that add up to
# one, so that every such matrix is a convex combination of its values at these points and of the
# means of the two mixed terms of every pair. What contracts in one norm |x|_P at these vertices of
# all intervals (cells, of two parameters) contracts in it along every motion of it, jumps included
# (Boyd, El Ghaoui, Feron & Balakrishnan 1994, Linear Matrix Inequalities in System and Control
# Theory, sec. 5.1).


_TIME_LIMIT = 20.0  # s
_LARGEST = 30  # states; beyond, only the candidate of the middle grid point is tried


@dataclass(frozen=True, slots=True, eq=False)
class Motion:
    """contraction [-]: of |x|_P in a sample at every point and across every move; states (n,):
    bounds on the states with every input at its limit, for any motion; infinite where contraction
    is not below 1, so that nothing is proved.
    """

    contraction: float
    states: np.ndarray

    @property
    def proved(self) -> bool:
        return self.contraction < 1


def bound_motion(
    increment: np.ndarray,
    B: np.ndarray,
    C: np.ndarray,
    D: np.ndarray,
    unwind: np.ndarray,
    inputs: np.ndarray,
    pairs: list[tuple[int, int]],
) -> Motion:
    """The common Lyapunov function of A - L C over a grid, and the states' bounds.

    increment (k, n, n): A - I; B (k, n, m), C (k, p, n), D (k, p, m), unwind (k, n, p): L; inputs
    (m + p,): the largest errors and the largest currents given; pairs: of neighbouring points.
    Examined, never assumed: the contraction is recomputed from the function that was found.
    """
    n = increment.shape[1]
    if n == 0:
        return Motion(0.0, np.zeros(0))
    A = np.eye(n) + increment
    vertices = _vertices(A, unwind, C, pairs)
    best = np.inf
    for P in _candidates(vertices):
        try:
            root = np.linalg.cholesky((P + P.T) / 2)  # P = R R^T, |x|_P = |R^T x|
        except np.linalg.LinAlgError:
            continue

        # |N|_P = |R^T N R^-T|_2, the largest over the vertices
        contraction = max(float(np.linalg.norm(_in_norm(root, N), 2)) for N in vertices)
        if contraction < 1:
            # |x|_P <= push/(1 - contraction) with push the sum of the columns' |b|_P times their
            # limits, and |x_i| <= sqrt((P^-1)_ii) |x|_P
            push = max(
                float(np.linalg.norm(root.T @ b, axis=0) @ inputs)
                for b in _driving(B, unwind, D, pairs)
            )
            # sqrt of the diagonal of P^-1
            reach = np.linalg.norm(sla.solve_triangular(root, np.eye(n), lower=True), axis=0)
            return Motion(contraction, reach * push / (1 - contraction))
        best = min(best, contraction)
    return Motion(best, np.full(n, np.inf))


def _in_norm(root: np.ndarray, N: np.ndarray) -> np.ndarray:
    """R^T N R^-T: N in states in which |x|_P is the Euclidean norm."""
    return root.T @ sla.solve_triangular(root, N.T, lower=True).T


def _vertices(
    A: np.ndarray, L: np.ndarray, C: np.ndarray, pairs: list[tuple[int, int]]
) -> list[np.ndarray]:
    """A - L C at the grid points, then the mean of the mixed terms of every pair of neighbours."""
    # sum s_i s_j (A_i - L_i C_j) = sum s_i^2 V_ii + sum_(i<j) 2 s_i s_j (V_ij + V_ji)/2
    own = [a - gain @ c for a, gain, c in zip(A, L, C, strict=True)]
    mixed = [(A[i] + A[j] - L[i] @ C[j] - L[j] @ C[i]) / 2 for i, j in pairs]
    return own + mixed


def _driving(
    B: np.ndarray, L: np.ndarray, D: np.ndarray, pairs: list[tuple[int, int]]
) -> list[np.ndarray]:
    """[B - L D, L] at the same vertices: what errors and given currents add to the states."""
    gains = [*L, *((L[i] + L[j]) / 2 for i, j in pairs)]
    return [np.hstack([b, gain]) for b, gain in zip(_vertices(B, L, D, pairs), gains, strict=True)]


def _candidates(vertices: list[np.ndarray]) -> Iterator[np.ndarray]:
    """Lyapunov functions, the cheap one first: of the middle vertex, then of all of them by matrix
    inequalities.
    """
    n = len(vertices[0])
    middle = vertices[(len(vertices) // 2) // 2]
    try:
        P = sla.solve_discrete_lyapunov(middle.T, np.eye(n))
        root = np.linalg.cholesky((P + P.T) / 2)
    except (np.linalg.LinAlgError, ValueError):
        return
    yield P
    if n > _LARGEST:
        return

    # the rest in the first candidate's norm, where the vertices are of order one: P = R X R^T
    found = _common([_in_norm(root, N) for N in vertices])
    if found is not None:
        yield root @ found @ root.T


def _common(vertices: list[np.ndarray]) -> np.ndarray | None:
    """P <= I with P - N^T P N >= t I at every vertex, t as large as possible; None where none was
    found.
    """
    n = len(vertices[0])

    # P = sum of x_k basis_k; the last unknown is t
    basis = smat(np.eye(n * (n + 1) // 2))
    count = len(basis)
    every = np.arange(count + 1)
    one = svec(np.eye(n))

    # I - P >= 0, then P - N^T P N - t I >= 0 at every vertex
    items = [Inequality(-np.eye(count), one, every[:-1])]
    for N in vertices:
        items.append(
            Inequality(
                np.column_stack([svec(basis - N.T @ basis @ N).T, -one]), np.zeros(count), every
            )
        )
    try:
        found = minimise(
            np.r_[np.zeros(count), -1.0],
            items,
            tolerance=1e-4,
            time_limit=_TIME_LIMIT,
            hopeless=-1e-12,
        )
    except NumericalFailure:
        return None
    return smat(found.x[:-1]) if found.x[-1] > 0 else None


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
    none); motion: what is proved while it moves. grid, told_limit, rate_limit: of the one
    parameter, where there is no other.
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
    def over(self) -> tuple[tuple[Scheduling, np.ndarray, float, float], ...]:
        columns = (self.along.each, self.axes, self.told_limits, self.rate_limits)
        return tuple(zip(*columns, strict=True))

    @property
    def transfers(self) -> bool:
        return self.passes > 0

    @property
    def fixed_increment(self) -> np.ndarray:
        return self.changes.fixed[: self.n_states, : self.n_states]

    @property
    def winding(self) -> int:
        """How many states wind up: all."""
        return self.n_states

    def said(self) -> dict[str, Any]:
        """What the templates ask of its form; nr, nq: ranks of what changes between grid points in
        the states and in the outputs.
        """
        nr, nq = self.changes.ranks
        return {"ng": len(self.B), "passes": self.passes, "nr": nr, "nq": nq}

    def tables(self) -> dict[str, np.ndarray]:
        """The numbers of the code, as they lie in memory."""
        n, changes = self.n_states, self.changes
        return {
            "error_limit": self.error_limit,
            "current_limit": self.current_limit,
            "grid": self.axes[0],
            "D": changes.fixed[n:, n:].T,
            "B": changes.fixed[:n, n:].T,
            "C": changes.fixed[n:, :n].T,
            "unwind": self.unwind.transpose(0, 2, 1),
            "of_error": changes.right[:, n:].T,
            "core": changes.core.transpose(0, 2, 1),
            "on_current": changes.left[n:].T,
            "of_state": changes.right[:, :n].T,
            "on_state": changes.left[:n].T,
            "steady": self.steady.transpose(0, 2, 1),
            "pick": self.pick.transpose(0, 2, 1),
        }

    def cost(self, arithmetic: str) -> Cost:
        """Of a step as the code does it: whole diagonals of the fixed A - I, dense B, C and D, and
        few signals for what changes.
        """
        n, k = self.n_states, len(self.B)
        m, p = len(self.inputs), len(self.outputs)
        (r, q), size = self.changes.ranks, BYTES[arithmetic][0]
        d, places = len(self.axes), sum(len(axis) for axis in self.axes)
        points = 2**d  # around a value
        fixed = len(diagonals_of(self.fixed_increment)) * n + n * m + n * p + m * p

        # left (n + p, r) and right (q, n + m); core (r, q) at every corner of the cell
        around = r * (n + p) + q * (n + m)
        transfer = k * n * (m + p) * self.transfers
        return Cost(
            multiplications=fixed + around + points * q * (r + 1) + 4 * (d - 1),
            additions=fixed + around + points * q * r + 3 * n + 4 * d,
            limited=points * p * (n + 1),
            state_bytes=(2 * n + sum(self.padding) + m + 2 * d) * size + 2 * (m + 3 * d),
            table_bytes=(fixed + around + k * (r * q + n * p) + places + transfer + m + p + 2 * d)
            * size,
        )

    @property
    def grid(self) -> np.ndarray:
        return self.alone[0][1]

    @property
    def told_limit(self) -> float:
        return self.alone[0][2]

    @property
    def rate_limit(self) -> float:
        return self.alone[0][3]

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

    def known(self, told: Any) -> Any:
        """Where the law is taken for what a step is told: where that is nothing, which is no error
        of a supervised block, at the lowest value.
        """
        return self.range[0] if self.watch and np.isnan(told) else told

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


# A schedule over pressure with a fixed controller to fall back to, as one block: both laws in every
# sample, one in charge.
#
#   u_i = C_i x_i + D_i e                       what either asks for
#   us  = limited(u_charge + share left)        what acts; ``left`` of the difference at the last
#                                               change fades with ``share``
#   x_i += increment_i x_i + B_i e + L_i cut    cut = us - u_i of the one that waits,
#                                               limited(us - share left) - u_i of the one in charge:
#                                               zero within the limits
#
# L is the anti-windup gain of either block: to wait is to have what one asks for replaced by what
# acts. Therefore the bounds on the states of block/block.py and block/scheduled.py hold, whoever is
# in charge: what replaces u never leaves the limits. Who is in charge, and why: law/supervision.py,
# which is also the block's twin in Python (``supervised_twin``).


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class SupervisedBlock(ScheduledBlock):
    """What runs: a scheduled block, the fixed one that takes over, and what a reading has to keep
    to.
    """

    fallback: ControlBlock
    watch: Limits = field()

    @property
    def told(self) -> tuple[str, ...]:
        return (*(one.name for one in self.along.each), "estimate", "half_width")

    def middle(self) -> tuple[float, ...]:
        return (*ScheduledBlock.middle(self), np.nan, np.nan)

    @property
    def transfers(self) -> bool:
        return self.passes > 0 and self.fallback.transfers

    def single(self) -> Self:
        """The block with limits and grid that single precision holds. Raises InvalidInput where
        grid points fall together.
        """
        return replace(
            ScheduledBlock.single(self), fallback=self.fallback.single(), watch=_single(self.watch)
        )

    def in_charge(self, status: int) -> bool:
        return status >> STATE_AT & 3 == State.SCHEDULED

    def cost(self, arithmetic: str) -> Cost:
        """Of a step: the fixed law besides, whichever of the two is led because it waits, and what
        is left of the difference.
        """
        cost, size = ScheduledBlock.cost(self, arithmetic), BYTES[arithmetic][0]
        fixed, n = self.fallback, self.fallback.n_states
        m, p = len(self.inputs), len(self.outputs)
        products = len(diagonals_of(fixed.increment)) * n + n * (m + p) + m * p
        led, numbers = max(fixed.winding * p, 2 * p * (self.n_states + 1)), 12
        transfer = n * (m + p) * self.transfers
        return Cost(
            multiplications=cost.multiplications + products + led + 2 * p + 2,
            additions=cost.additions + products + 3 * n + led + 6 * p + 12,
            limited=cost.limited,
            state_bytes=cost.state_bytes + (2 * n + sum(fixed.padding) + p + 2) * size + 26,
            table_bytes=cost.table_bytes
            + (products + fixed.winding * p + transfer + numbers) * size,
        )

    def samples(self, duration: float) -> int | None:
        """The least number of samples that last so long [s]; None where that is for ever."""
        if not np.isfinite(duration):
            return None

        # counted up by the product itself: the rounded quotient may be one off
        count = max(0, round(duration / self.sample_time) - 2)
        while count * self.sample_time < duration:
            count += 1
        return count


def supervise(block: ScheduledBlock, fallback: ControlBlock, watch: Limits) -> SupervisedBlock:
    """One block of two with the same signals, rate and delay. Raises InvalidInput."""
    for what, own, other in (
        ("inputs", ", ".join(block.inputs), ", ".join(fallback.inputs)),
        ("outputs", ", ".join(block.outputs), ", ".join(fallback.outputs)),
        ("sample time", f"{block.sample_time:g} s", f"{fallback.sample_time:g} s"),
        ("delay", f"{block.delay} samples", f"{fallback.delay} samples"),
    ):
        if own != other:
            raise invalid(
                f"the {what} of the fallback",
                other,
                f"the schedule's, {own}",
                "make both for one machine and loop",
            )
    if np.isfinite(block.rate_limits).any():
        raise invalid(
            "rate_limit of a supervised block",
            block.rate_limit,
            "left out",
            "its readings have another sample rate",
        )
    parts = {item.name: getattr(block, item.name) for item in fields(ScheduledBlock)}
    return SupervisedBlock(**parts, fallback=fallback, watch=watch)


def supervised_twin(block: SupervisedBlock, kind: Any = np.float64) -> SupervisedProgram:
    """The block as a program in Python: what the code is compared with. kind: of its numbers.
    Raises NumericalFailure.
    """
    fixed, axes = block.fallback, tuple(name.removeprefix("err_") for name in block.inputs)
    points = zip(block.increment, block.B, block.C, block.D, block.unwind, strict=True)
    pair = SupervisedLaws(
        block.grid,
        tuple(_law(point, kind) for point in points),
        _law((fixed.increment, fixed.B, fixed.C, fixed.D, fixed.unwind), kind),
        (
            fixed.from_error.astype(kind) * block.transfers,
            fixed.from_output.astype(kind) * block.transfers,
        ),
        block.current_limit.astype(kind),
        axes,
        block.sample_time,
        block.delay,
        True,
    )
    return SupervisedProgram(pair, block.watch)


def _law(matrices: tuple[np.ndarray, ...], kind: Any) -> Matrices:
    return tuple(x.astype(kind) for x in matrices)


def _single(limits: Limits) -> Limits:
    times = {"dwell", "fade", "stuck"}  # counted in samples
    values = {
        item.name: getattr(limits, item.name) for item in fields(Limits) if item.name not in times
    }
    return replace(limits, **{name: float(np.float32(value)) for name, value in values.items()})
