"""The output error of one record: residual and normal equations, with initial state, offsets and
synchronous waves eliminated.

All enter linearly, y = y(theta, u) + O(theta) x0 + b W, O = [C; C A; C A^2; ...] and W the rows of
waves, a constant among them, so they are eliminated at every theta (variable projection, Golub &
Pereyra 1973, in Kaufman's form): what is left is a problem in theta alone. O is never formed for
the whole record: O'O follows from doubling, O' times a signal from blocks. Records are only looked
at in pieces: the memory does not grow with their length.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from ambrose.core.checks import InvalidInput, NumericalFailure
from ambrose.core.response import SystemDerivative
from ambrose.core.statespace import StateSpace
from ambrose.identification.output_error.synchronous import Synchronous

# Levenberg-Marquardt with a guard: a step that leaves the set where the model may be used (a stable
# loop) is shortened.
#
# Marquardt's scaling by the diagonal of J'J (1963); the gain ratio steers the damping as in Nielsen
# (1999), who lets it fall to a third in a step; here a ninth, for most starts are close.


@dataclass(frozen=True, slots=True, eq=False)
class Linearised:
    """The normal equations at a point: cost = r'r, H = J'J (q, q), g = J'r (q,); model(theta +
    step) = model + J step.

    parts: whatever else was found there, handed on to the Minimum.
    """

    cost: float
    H: np.ndarray
    g: np.ndarray
    parts: tuple[Any, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class Minimum:
    """Where the iteration ended: x (q,), the cost there, whether it converged, its number of steps,
    and the refused ones.

    parts: of the last point that was computed, which is x or a negligible step before it.
    """

    x: np.ndarray
    cost: float
    converged: bool
    iterations: int
    refused: int
    parts: tuple[Any, ...] = ()


def minimise(
    linearise: Callable[[np.ndarray], Linearised],
    x: np.ndarray,
    scale: np.ndarray,
    allowed: Callable[[np.ndarray], bool],
    max_iterations: int = 50,
    tolerance: float = 1e-9,
    floor: float = 0.0,
    negligible: float = 0.0,
    cost: Callable[[np.ndarray], float] | None = None,
) -> Minimum:
    """The least of r(x)'r(x) near x (q,).

    scale (q,): the size of a parameter, for the stopping rule |step| <= tolerance * max(|x|,
    scale); a step whose predicted gain is below 1e-12 of the cost, or a cost below ``floor``, also
    ends it. One below ``negligible`` of the cost is taken and ends it, without a look at where it
    leads. cost(x): what linearise says of it, where that alone is much cheaper. allowed(x): steps
    are shortened until true, and until ``linearise`` does not raise InvalidInput (a point at which
    nothing can be told); at the start that is raised. Raises
    NumericalFailure where J has a zero column.
    """
    damping = 1e-6
    growth = 2.0
    refused = 0
    state = linearise(x)
    for iteration in range(max_iterations):
        size = np.sqrt(np.diag(state.H))
        if not (size > 0).all():
            raise NumericalFailure(
                f"the outputs do not depend on parameter number {int(np.argmin(size)) + 1}; leave "
                "it out"
            )

        # unit diagonal: Marquardt's scaling
        H, g = state.H / size / size[:, None], state.g / size
        while True:
            scaled = np.linalg.solve(H + damping * np.eye(len(x)), g)
            step = scaled / size

            # 2 s'g - s'H s with (H + damping) s = g:   s'(damping s + g)
            predicted = float(scaled @ (damping * scaled + g))
            small = bool((np.abs(step) <= tolerance * np.maximum(np.abs(x), scale)).all())

            # a step that is small only because the damping is large is no minimum
            if small or predicted <= 1e-12 * state.cost or state.cost <= floor:
                return Minimum(x, state.cost, damping < 1e3, iteration, refused, state.parts)
            trial = x + step
            if predicted <= negligible * state.cost and damping < 1e-3 and allowed(trial):
                return Minimum(
                    trial, state.cost - predicted, True, iteration + 1, refused, state.parts
                )
            following = None
            if allowed(trial):
                # where a trial says nothing, as at the edge of stability
                with suppress(InvalidInput):
                    if cost is None or cost(trial) < state.cost:
                        following = linearise(trial)

            # a trial that is not allowed, or tells nothing, counts as one that lost
            gain = (state.cost - following.cost) / predicted if following is not None else -1.0
            if following is not None and gain > 0:
                damping, growth = max(damping * max(1 / 9, 1 - (2 * gain - 1) ** 3), 1e-12), 2.0
                break
            refused += 1

            # refused in a row: the damping grows by 2, 4, 8, ...
            damping, growth = max(damping, 1e-6) * growth, growth * 2
            if damping > 1e12:
                return Minimum(x, state.cost, False, iteration, refused, state.parts)
        x, state = trial, following
    return Minimum(x, state.cost, False, max_iterations, refused, state.parts)


# Outputs and all their parameter derivatives of a sampled loop at once, in blocks and in pieces of
# a record.
#
# The same sums as simulate_derivative of tests/whole_records.py, the oracle. There every parameter
# is a system of twice the size; here all share the loop's own lifted matrices (Chen & Francis 1995,
# ch. 8) and one sequential pass, and only a piece of the record is held at a time. No eigenvectors
# are formed: this is the exact way that never fails.


BLOCK = 16  # samples of a block
_GROUP = 4  # blocks between which the states are not stepped
_PIECE = 256  # blocks held at a time


@dataclass(frozen=True, slots=True, eq=False)
class Lifted:
    """A sampled loop without feedthrough, and its q derivatives, over blocks of L samples.

    With X the states at the starts of the blocks and S_j their derivatives: X+ = P X + R u, S_j+ =
    P S_j + dP_j X + dR_j u; y = O X + T u, dy_j = O S_j + dO_j X + dT_j u. Transposed, for rows of
    signals: powers (g + 1, n, n) of P', and of them triangle (g n, g n), for groups of g blocks;
    pushed (mL, n) = R'; forced (n + mL, qn) of dP and dR; shown (n, pL) = O'; maps (1 + q, n + mL,
    pL) of O and T, then of dO_j and dT_j.
    """

    powers: np.ndarray
    triangle: np.ndarray
    pushed: np.ndarray
    forced: np.ndarray
    shown: np.ndarray
    maps: np.ndarray
    outputs: int


def lift(system: StateSpace, directions: Sequence[SystemDerivative], length: int = BLOCK) -> Lifted:
    """The lifted loop over blocks of ``length`` samples; C and D = 0 do not depend on the
    parameters.
    """
    A = system.A
    B = system.B
    C = system.C
    p, n = C.shape
    m = B.shape[1]
    L = length
    q = len(directions)
    dA = np.stack([d.A for d in directions]) if q else np.zeros((0, n, n))
    dB = np.stack([d.B for d in directions]) if q else np.zeros((0, n, m))
    O_, dO = np.empty((L, p, n)), np.empty((L, q, p, n))
    R, dR = np.empty((L, n, m)), np.empty((L, q, n, m))
    O_[0] = C
    dO[0] = 0.0
    R[0] = B
    dR[0] = dB
    P, dP = A, dA
    for i in range(1, L):  # C A^i, A^i B, A^i and their derivatives
        O_[i], dO[i] = O_[i - 1] @ A, dO[i - 1] @ A + O_[i - 1] @ dA
        R[i], dR[i] = A @ R[i - 1], A @ dR[i - 1] + dA @ R[i - 1]
        P, dP = A @ P, A @ dP + dA @ P

    # transposed for rows [X, u]; R[::-1]: the input s of a block comes out by A^(L - 1 - s) B
    by_state = dP.transpose(2, 0, 1).reshape(n, q * n)
    by_input = dR[::-1].transpose(3, 0, 1, 2).reshape(m * L, q * n)
    # (L, 1 + q, p, m): one sample later
    h = np.concatenate([(O_ @ B)[:, None], dO @ B + O_[:, None] @ dB], axis=1)

    # rows: state, then L samples of each input; columns: L samples of each output. O, T; dO_j, dT_j
    maps = np.empty((1 + q, n + m * L, p * L))
    maps[0, :n] = shown = O_.transpose(2, 1, 0).reshape(n, p * L)
    maps[1:, :n] = dO.transpose(1, 3, 2, 0).reshape(q, n, p * L)
    maps[:, n:] = _toeplitz(h).reshape(1 + q, m * L, p * L)
    pushed = R[::-1].transpose(2, 0, 1).reshape(m * L, n)
    powers = powers_of(P.T, _GROUP + 1)
    return Lifted(
        powers, _triangle(powers), pushed, np.vstack([by_state, by_input]), shown, maps, p
    )


def stream(
    lifted: Lifted,
    u: Sequence[np.ndarray],
    x0: np.ndarray,
    dx0: np.ndarray | None = None,
    piece: int = _PIECE,
) -> Iterator[tuple[int, np.ndarray]]:
    """Pieces of the record, one after the other: the first sample, and outputs and derivatives F (1
    + q, blocks, p, L).

    u: m signals (k,), held between the samples; x0 (n,) the first state and dx0 (q, n) its
    derivatives (None: none); piece: blocks at a time. The last block goes on past the end of the
    record with the input zero.
    """
    n, (q1, width, pL) = len(x0), lifted.maps.shape
    p = lifted.outputs
    q = q1 - 1
    k = len(u[0])
    L = pL // p
    x, s = x0, np.zeros((q, n)) if dx0 is None else dx0
    for start in range(0, k, piece * L):
        stop = min(start + piece * L, k)
        count = -(-(stop - start) // L)

        # rows [X, u], one per block
        XU = np.zeros((count, width))
        for i, signal in enumerate(u):
            XU[:, n + i * L : n + (i + 1) * L] = blocks(signal[start:stop], L)

        # X+ = P X + R u
        driven = XU[:, n:] @ lifted.pushed
        X, x = _states(lifted, driven[None], x[None])
        XU[:, :n], x = X[0], x[0]

        # y = O X + T u, and of dy_j the part dO_j X + dT_j u
        F = np.matmul(XU, lifted.maps)
        if q:
            # S_j+ = P S_j + dP_j X + dR_j u,   dy_j += O S_j
            forced = (XU @ lifted.forced).reshape(count, q, n).transpose(1, 0, 2)
            S, s = _states(lifted, forced, s)
            F[1:] += S @ lifted.shown
        yield start, F.reshape(1 + q, count, p, L)


def _states(lifted: Lifted, driven: np.ndarray, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The states (c, count, n) at the starts of blocks, and (c, n) after the last: x+ = x P' +
    driven (c, count, n).

    In groups of blocks, within which one product with powers of P' takes the place of the
    recursion.
    """
    powers, (c, count, n) = lifted.powers, driven.shape
    group = len(powers) - 1
    groups = -(-count // group)
    padded = np.zeros((c, groups * group, n))
    padded[:, :count] = driven
    # what a group's own inputs do by each of its ends
    inside = padded.reshape(c * groups, group * n) @ lifted.triangle
    inside = inside.reshape(c, groups, group, n)
    states = np.empty((c, groups, group, n))
    spread = powers[:group].transpose(1, 0, 2).reshape(n, group * n)

    # x at the groups' starts: x+ = x P'^group + what the group's own inputs do by its end
    starts = np.empty((c, groups, n))
    for g in range(groups):
        starts[:, g] = x
        x = x @ powers[group] + inside[:, g, -1]

    # inside a group, t blocks after its start: x P'^t + what its first t inputs do
    states[:] = (starts @ spread).reshape(states.shape)
    states[:, :, 1:] += inside[:, :, :-1]
    states = states.reshape(c, -1, n)

    # the last group may be short: its state after ``rest`` blocks, not after the padding
    rest = count - (groups - 1) * group
    if rest < group:
        x = starts[:, -1] @ powers[rest] + inside[:, -1, rest - 1]
    return states[:, :count], x


def _triangle(powers: np.ndarray) -> np.ndarray:
    """(group n, group n): inputs of block s (rows) to the state after block t >= s, P'^(t - s)."""
    group, n = len(powers) - 1, powers.shape[1]
    lag = np.arange(group)[None] - np.arange(group)[:, None]
    blocks = np.where((lag >= 0)[:, :, None, None], powers[np.maximum(lag, 0)], 0.0)
    return blocks.transpose(0, 2, 1, 3).reshape(group * n, group * n)


def powers_of(P: np.ndarray, count: int) -> np.ndarray:
    """I, P, P^2, ... (count, n, n)."""
    powers = np.empty((count, *P.shape))
    powers[0] = np.eye(len(P))
    for i in range(1, count):
        powers[i] = powers[i - 1] @ P
    return powers


def blocks(signal: np.ndarray, length: int) -> np.ndarray:
    """A signal (k,) in rows (count, length), the last one filled up with zeros."""
    count = -(-len(signal) // length)
    if count * length == len(signal):
        return signal.reshape(count, length)
    padded = np.zeros(count * length)
    padded[: len(signal)] = signal
    return padded.reshape(count, length)


def _toeplitz(h: np.ndarray) -> np.ndarray:
    """(c, m, L, p, L): what an input at sample s of a block does at sample t > s, h (L, c, p, m)[t
    - s - 1].
    """
    L = len(h)
    padded = np.concatenate([np.zeros((1, *h.shape[1:])), h])
    lag = np.maximum(np.arange(L)[None] - np.arange(L)[:, None], 0)  # (s, t); 0 picks the zeros
    return padded[lag].transpose(2, 4, 0, 3, 1)


# directions of the initial state seen weaker than this (squared) are left at zero: rounding rules
# there
_INVISIBLE = 1e-10
_BLIND = 1e-9  # part of a parameter's effect (squared) that must remain beside them
_GONE = 1e-24  # of a unit state: what is left of it later counts no more
_STEPS = 8  # towards the rotor's angle, at most
_ROWS = 256  # blocks of the waves at a time
_LONG = 12_288  # samples at a time, about, where pieces are compared with each other


@dataclass(frozen=True, slots=True, eq=False)
class Task:
    """A record: the r distinct excitations e, each (k,), and mix (m, r) of them; the p measured
    signals y, each (k,), and what else is estimated. unit (p,): what y is still to be divided by to
    stand over its weights (None: it does already). place: which of several models made the record.
    tail: the loop's last states, as far as they are known; alike: how many before them are old
    commands, of one size, some of which may hardly be seen. synchronous: what turns with the rotor,
    eliminated from every signal (None: nothing). e and y may be views of the record: only looked
    at.
    """

    e: Sequence[np.ndarray] | np.ndarray
    mix: np.ndarray
    y: Sequence[np.ndarray] | np.ndarray
    initial_state: bool
    offset: bool
    unit: np.ndarray | None = None
    place: int = 0
    tail: np.ndarray = field(default_factory=lambda: np.zeros(0))
    alike: int = 0
    synchronous: Synchronous | None = None

    @property
    def samples(self) -> int:
        return len(self.y[0])

    def measured(self, i: int, start: int, stop: int) -> np.ndarray:
        """Samples of the measured signal number i over its weight."""
        part = np.asarray(self.y[i][start:stop])
        return part if self.unit is None else part / self.unit[i]

    @property
    def waves(self) -> int:
        """How many waves every signal may hold: a constant, and those that turn with the rotor."""
        return int(self.offset) + (0 if self.synchronous is None else self.synchronous.count)

    def waves_at(self, start: int, stop: int) -> np.ndarray:
        """Samples of them (waves, length)."""
        rows = [np.ones((int(self.offset), stop - start))]
        if self.synchronous is not None:
            rows.append(self.synchronous.waves(start, stop))
        return np.vstack(rows)

    def differs(self, other: Task) -> bool:
        """Whether the rotor's angle is another, by more than what a signal shows."""
        if (
            self.synchronous is None
            or other.synchronous is None
            or self.synchronous is other.synchronous
        ):
            return False
        return self.synchronous.differs(other.synchronous, self.samples)

    def first(self, samples: int) -> Task:
        """The same record, ended after ``samples``."""
        return replace(self, e=[x[:samples] for x in self.e], y=[x[:samples] for x in self.y])


@dataclass(frozen=True, slots=True, eq=False)
class RecordSolution:
    """The normal equations of a record at one theta, with the initial state x0 (n,) and the waves'
    amplitudes b (p, waves) over the weights that fit best, and how they would follow a parameter:
    dx0 (q, n), db (q, p, waves).
    """

    equations: Linearised
    x0: np.ndarray
    b: np.ndarray
    dx0: np.ndarray
    db: np.ndarray


def distinct(e: Sequence[np.ndarray]) -> tuple[tuple[np.ndarray, ...], np.ndarray]:
    """The r signals (k,) and mix (m, r) with e (m, k) = mix signals: equal, opposite and absent
    excitations are taken once.
    """
    rows: list[np.ndarray] = []
    mix = np.zeros((len(e), len(e)))
    for i, row in enumerate(e):
        if not row.any():
            continue
        for j, other in enumerate(rows):
            sign = next((s for s in (1.0, -1.0) if _same(row, s, other)), 0.0)
            if sign:
                mix[i, j] = sign
                break
        else:
            mix[i, len(rows)] = 1.0
            rows.append(row)
    return tuple(rows), mix[:, : len(rows)]


def _same(one: np.ndarray, sign: float, other: np.ndarray, piece: int = 8192) -> bool:
    return all(
        np.array_equal(one[i : i + piece], sign * other[i : i + piece])
        for i in range(0, len(one), piece)
    )


def _driven(
    system: StateSpace, directions: list[SystemDerivative], task: Task
) -> tuple[StateSpace, list[SystemDerivative]]:
    """The loop and its derivatives from the distinct signals."""
    mixed = StateSpace(
        system.A,
        system.B @ task.mix,
        system.C,
        system.D @ task.mix,
        None,
        system.outputs,
        system.dt,
    )
    return mixed, [SystemDerivative(d.A, d.B @ task.mix, d.C, d.D @ task.mix) for d in directions]


def fit(system: StateSpace, task: Task) -> tuple[np.ndarray, RecordSolution]:
    """The residual (p, k) of a whole record with the best initial state, offsets and waves, and
    those; ``system`` as in ``normal_equations``.
    """
    best = normal_equations(system, [], task)
    pieces = [piece[: len(system.outputs)] for piece in residual_pieces(system, task, best)]
    return np.concatenate(pieces, axis=1), best


def synchronised(system: StateSpace, task: Task) -> Task:
    """The record with the rotor's angle under which most of what ``system`` leaves of the signals
    turns with it.
    """
    if task.synchronous is None:
        return task
    best, p = normal_equations(system, [], task), len(system.outputs)

    # only the offset stays out: what turns is left in the residual
    still = replace(best, b=best.b * (np.arange(task.waves) < int(task.offset)))
    refined = task.synchronous.refined(
        (piece[:p] for piece in residual_pieces(system, task, still)), task.samples
    )
    if refined is None:
        return task
    task = replace(task, synchronous=refined)
    for _ in range(_STEPS):
        before, task = task, turned(system, [], task, np.zeros((0, 0)))
        if not task.differs(before):
            break
    return task


def turned(
    system: StateSpace, directions: list[SystemDerivative], task: Task, H: np.ndarray
) -> Task:
    """The record with the rotor's angle one step of Gauss and Newton further, as if the parameters,
    of which H (q, q) = J'J is left of all records, went along.
    """
    if task.synchronous is None:
        return task
    best = normal_equations(system, directions, task, with_angle=True)
    H_all = best.equations.H.copy()
    g = best.equations.g
    q = len(H)

    # the parameters' block is that of all records; the angle is this record's own
    H_all[:q, :q] = H

    # lstsq: where no wave has an amplitude the angle's columns are zero
    size = np.sqrt(np.maximum(np.diag(H_all), 1e-300))
    step = np.linalg.lstsq(H_all / size / size[:, None], g / size)[0] / size
    return replace(task, synchronous=task.synchronous.turned(step[q:], task.samples))


def normal_equations(
    system: StateSpace, directions: list[SystemDerivative], task: Task, with_angle: bool = False
) -> RecordSolution:
    """r'r, J'J and J'r of the record for theta alone; ``system`` from all excitations to outputs
    over their weights. with_angle: and for the two coefficients of the rotor's angle, which come
    last.

    Two passes: the first finds initial state and waves, on which the derivatives depend.
    """
    system, directions = _driven(system, directions, task)
    n = system.n_states
    p = len(system.outputs)
    q = len(directions)

    # First pass: r at x0 = (0, tail), b = 0; the best nuisances are basis basis' [O, W]' r.
    still = lift(system, [])
    basis = _nuisance_basis(system, still, task)
    x0, b = np.concatenate([np.zeros(n - len(task.tail)), task.tail]), np.zeros((p, task.waves))
    if basis.size:
        _, N = _products(still, task, x0, b, with_nuisance=True)
        best = basis @ (basis.T @ N[:, 0])
        x0, b = x0 + best[:n], best[n:].reshape(b.shape)

    # Second pass, with these: F = [r, J], G = F F', N = [O, W]' F'.
    q += 2 * with_angle
    G, N = _products(
        lift(system, directions), task, x0, b, with_nuisance=bool(basis.size), with_angle=with_angle
    )

    # M: the components of r and J in the nuisances' space
    M = basis.T @ N

    # dx0, db: the nuisances that take those components out of J again
    shift = -(basis @ M).T[1:]

    # J'(I - P) J; J'r needs no projection, r has none of the nuisances left
    H, g = G[1:, 1:] - M[:, 1:].T @ M[:, 1:], G[1:, 0]
    # what is left is rounding: the nuisances explain it all
    blind = np.diag(H) <= _BLIND * np.diag(G)[1:]
    H[blind] = 0.0
    H[:, blind] = 0.0
    g[blind] = 0.0
    return RecordSolution(
        Linearised(float(G[0, 0]), H, g), x0, b, shift[:, :n], shift[:, n:].reshape(q, *b.shape)
    )


def _products(
    lifted: Lifted,
    task: Task,
    x0: np.ndarray,
    b: np.ndarray,
    with_nuisance: bool,
    with_angle: bool = False,
) -> tuple[np.ndarray, np.ndarray]:
    """F F' (1 + q, 1 + q) and [O, W]' F' (n + p waves, 1 + q) of F = [r, J], summed over the
    record.
    """
    q1 = len(lifted.maps) + 2 * with_angle
    early = _Early(lifted, q1)
    G, N = np.zeros((q1, q1)), np.zeros((q1, *b.shape))
    for start, F in stream(lifted, list(task.e), x0):
        W = _measured_less(F, task, start, b)
        if with_angle:
            F = np.concatenate([F, _slopes(F, task, start, b)])  # noqa: PLW2901
        flat = F.reshape(q1, -1)
        G += flat @ flat.T
        if with_nuisance:
            for i in range(len(b)):
                N[:, i] += F[:, :, i].reshape(q1, -1) @ W.T
            early.add(F)
    return G, np.hstack([early.total, N.reshape(q1, -1)]).T


class _Early:
    """O' times signals, piece by piece: total (c, n), until what is left of an initial state is
    rounding.
    """

    def __init__(self, lifted: Lifted, count: int) -> None:
        n = len(lifted.shown)
        self.lifted, self.total = lifted, np.zeros((count, n))
        self.powers, self.ahead = np.zeros((0, n, n)), np.eye(n)

    def add(self, F: np.ndarray) -> None:
        """The next pieces F (c, count, p, L) of the signals."""
        c, count, _, _ = F.shape
        if self.ahead.any():
            self.add_seen(F.reshape(c * count, -1) @ self.lifted.shown.T, count)

    def add_seen(self, seen: np.ndarray, count: int) -> None:
        """The same from what every block says of the state at its start (c * count, n)."""
        n = len(self.ahead)
        if count >= len(self.powers):
            self.powers = powers_of(self.lifted.powers[1].T, count + 1)
        self.total += (
            # O'f = sum over blocks i of P'^i O_L' f_i, as rows; ``ahead`` = P^(blocks before)
            seen.reshape(-1, count * n) @ self.powers[:count].reshape(count * n, n) @ self.ahead
        )
        self.ahead = self.powers[count] @ self.ahead
        if np.abs(self.ahead).max() < _GONE:
            self.ahead = np.zeros_like(self.ahead)


def _measured_less(F: np.ndarray, task: Task, start: int, b: np.ndarray) -> np.ndarray:
    """Turn the simulated outputs F[0] (count, p, L) of a piece into the residual; nothing counts
    past the record's end.

    Returns the waves there (waves, count L), zero past the end.
    """
    _, count, _, L = F.shape
    stop = min(start + count * L, task.samples)
    rest = count * L - (stop - start)
    W = np.pad(task.waves_at(start, stop), ((0, 0), (0, rest)))

    # r = y - y(theta) - b W
    for i in range(len(task.y)):
        F[0, :, i] = (
            blocks(task.measured(i, start, stop), L) - F[0, :, i] - (b[i] @ W).reshape(count, L)
        )
    if rest:
        F[:, -1, :, L - rest :] = 0.0
    return W


def _slopes(F: np.ndarray, task: Task, start: int, b: np.ndarray) -> np.ndarray:
    """The derivatives (2, count, p, L) of a piece F by the coefficients of the rotor's angle."""
    _, count, p, L = F.shape
    stop = min(start + count * L, task.samples)
    assert task.synchronous is not None
    rows = task.synchronous.slopes(start, stop, b[:, int(task.offset) :], task.samples)
    padded = np.pad(rows, ((0, 0), (0, 0), (0, count * L - (stop - start))))
    return padded.reshape(2, p, count, L).transpose(0, 2, 1, 3)


def residual_pieces(
    system: StateSpace, task: Task, solution: RecordSolution
) -> Iterator[np.ndarray]:
    """The residual over the weights and below it the distinct excitations, (p + r, length) piece by
    piece.
    """
    loop, _ = _driven(system, [], task)
    for start, F in stream(lift(loop, []), list(task.e), solution.x0, None, _long(task)):
        _measured_less(F, task, start, solution.b)
        stop = min(start + F.shape[1] * F.shape[3], task.samples)
        yield np.vstack([_in_time(F, stop - start)[0], *(e[None, start:stop] for e in task.e)])


def jacobian_pieces(
    system: StateSpace, directions: list[SystemDerivative], task: Task, solution: RecordSolution
) -> Iterator[np.ndarray]:
    """J (q, p, length) piece by piece, without the part that initial state and waves could
    explain.
    """
    loop, directions = _driven(system, directions, task)
    for start, piece in _pieces(loop, directions, task, solution.x0, solution.dx0):
        yield piece + solution.db @ task.waves_at(start, start + piece.shape[2])


def explained_columns(system: StateSpace, task: Task) -> np.ndarray:
    """Orthonormal columns (r, p, k) of all that initial state and waves can explain in a short
    record.
    """
    loop, _ = _driven(system, [], task)
    n = loop.n_states
    p = len(loop.outputs)
    still = lift(loop, [])
    basis = _nuisance_basis(loop, still, task)

    # O x0 for each column x0 of the basis: the derivative of a loop that does not move, dx0 = x0
    nothing = SystemDerivative(
        np.zeros_like(loop.A), np.zeros_like(loop.B), np.zeros_like(loop.C), np.zeros_like(loop.D)
    )
    x0, b = basis[:n].T, basis[n:].T.reshape(basis.shape[1], p, task.waves)
    seen = [piece for _, piece in _pieces(loop, [nothing] * len(x0), task, np.zeros(n), x0)]
    return np.concatenate(seen, axis=2) + b @ task.waves_at(0, task.samples)


def _pieces(
    loop: StateSpace,
    directions: list[SystemDerivative],
    task: Task,
    x0: np.ndarray,
    dx0: np.ndarray,
) -> Iterator[tuple[int, np.ndarray]]:
    """The first sample and the derivatives (q, p, length) piece by piece."""
    for start, F in stream(lift(loop, directions), list(task.e), x0, dx0, _long(task)):
        yield start, _in_time(F[1:], min(F.shape[1] * F.shape[3], task.samples - start))


def _long(task: Task) -> int:
    """Blocks at a time, so that the pieces are equally long."""
    count = max(round(task.samples / _LONG), 1)
    return -(-task.samples // (count * BLOCK))


def _in_time(F: np.ndarray, length: int) -> np.ndarray:
    """(c, count, p, L) as (c, p, length)."""
    # blocks one after the other
    c, count, p, L = F.shape
    return F.transpose(0, 2, 1, 3).reshape(c, p, count * L)[:, :, :length]


def _nuisance_basis(system: StateSpace, still: Lifted, task: Task) -> np.ndarray:
    """(n + p waves, r) such that [O, W] basis has orthonormal columns, which span all that x0 and b
    can explain; rows of what is not estimated are zero.
    """
    n = system.n_states
    p = len(system.outputs)
    k = task.samples
    w = task.waves
    if not (task.initial_state or w):
        return np.zeros((n + p * w, 0))

    # O' times each wave in each output alone, and W W'
    early = _Early(still, p * w)
    WW = np.zeros((w, w))
    L = still.shown.shape[1] // p
    for start in range(0, k, BLOCK * _ROWS):
        W = task.waves_at(start, min(start + BLOCK * _ROWS, k))
        WW += W @ W.T
        if not early.ahead.any():
            continue
        rows = np.array([blocks(row, L) for row in W]).reshape(w, -1, L)
        seen = rows @ still.shown.reshape(n, p, L).transpose(1, 2, 0)[:, None]  # (p, w, count, n)
        early.add_seen(seen.reshape(-1, n), rows.shape[1])

    # [O, W]'[O, W] = [[O'O, O'W], [W'O, I (x) W W']]
    Q, F = _gramian(system.A, system.C, k)[0], early.total.T
    G = np.block([[Q, F], [F.T, np.kron(np.eye(p), WW)]])
    known = len(task.tail)

    # of the state the tail is known; the rest only where it is estimated
    free = np.r_[
        np.full(n - known, task.initial_state), np.full(known, False), np.full(p * w, True)
    ]
    seen_by = np.diag(G).copy()
    old = slice(n - known - task.alike, n - known)

    # old commands share one scale: one hardly seen is not blown up to a unit
    seen_by[old] = seen_by[old].max(initial=0.0)
    used = free & (seen_by > 0)

    # G = D V diag(values) V' D with D = diag(size): basis = D^-1 V values^-1/2
    size = np.sqrt(np.where(used, seen_by, 1.0))
    scaled = np.where(used[:, None] & used, G / size / size[:, None], 0.0)
    values, V = np.linalg.eigh(scaled)
    keep = values > _INVISIBLE * values[-1]
    return V[:, keep] / np.sqrt(values[keep]) / size[:, None]


def _gramian(A: np.ndarray, C: np.ndarray, k: int) -> tuple[np.ndarray, np.ndarray]:
    """sum A'^t C'C A^t over t = 0..k - 1, and A^k, by doubling."""
    if k == 1:
        return C.T @ C, A

    # Q_2h = Q_h + P_h' Q_h P_h;   odd k: one more term C A^(k-1)
    Q, P = _gramian(A, C, k // 2)
    Q, P = Q + P.T @ Q @ P, P @ P
    return (Q + P.T @ C.T @ C @ P, P @ A) if k % 2 else (Q, P)
