"""Proof that a synchronous block converges at every speed of an interval, between the speeds as
well.

What is proved: Herm(T R) > 0 for the response R of the block's mode, the convex sufficient
condition under which every small gain is stable (core/synchronous.py), for the full plant with the
controller as it is sampled, its delay and its hold. The loop is written as a pencil in the distance
d of the speed from the middle of a cell,

    [ j W - A(W)     -B_w D_p       0          -g(W) B   ] [x]     [  0  ]
    [ -C_z           I - D_zw D_p   0          -g(W) D_zu] [v]  =  [  0  ] d_o,    e = C x + d_o
    [  B_k C           0          z(W) - A_k     0       ] [x_k]   [-B_k ]
    [  D_k C           0          -C_k           1       ] [u]     [-D_k ]

R is S = 1 + C P^-1 Q for mode current-free. The other modes have C P^-1 Q alone: vibration-free and
damping with C of y, force-free with y and u below each other: the block that runs reads both, by a
D = T Z that is linear between the speeds of its table, and Herm(D R) > 0 is proved of that D. (T Z
at every speed would be another block, by a difference of second order in the speeds' distance.)

Here z = exp(j W Ts), g = (1 - exp(-j W Ts))/(j W Ts) and D_p = diag(p) of the tolerances, |p| <= 1.
z and g are entire, so that their Taylor remainders are known; the machine's matrices are a
quadratic through three speeds, and twice what they are off at the quarter points is allowed for.
A(W) is affine where only gyroscopic forces depend on the speed: the quadratic is then exact.

Not in the pencil: aliasing beyond the base band of the hold. It is measured at the ends and in the
middle of every segment and allowed for twice over. Floating point is used without directed
rounding.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from ambrose.core.checks import InvalidInput
from ambrose.core.interval_proof import Enclosure, IntervalProof, Pencil, enclose, prove
from ambrose.core.lft import GeneralizedPlant
from ambrose.core.sampling import delayed
from ambrose.core.statespace import StateSpace, series, static_gain
from ambrose.law.scheduling import SPEED
from ambrose.law.synchronous import Condition, SynchronousLoop
from ambrose.machine.description import Tolerance
from ambrose.model.plant import Plant
from ambrose.model.static_load import magnet_coefficients
from ambrose.model.uncertainty import tolerances_around, uncertain

_SEGMENTS = 12  # speeds between which the machine's matrices are a quadratic
_WIDTH = 1 / 48  # of the interval: the first cells
_ALLOWED = 2.0  # times what was seen, of curvature and of aliasing


@dataclass(frozen=True, slots=True, eq=False)
class _Segment:
    """Matrices [A, B_w, B; C_z, D_zw, D_zu] = base + s (first) + s^2 (second), s the speed from the
    middle [rad/s]; rest: bound of what is off; aliasing: of S, in its 2-norm.
    """

    low: float
    high: float
    base: np.ndarray
    first: np.ndarray
    second: np.ndarray
    rest: np.ndarray
    aliasing: float

    def around(self, middle: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The same quadratic about another speed."""
        # base + (s + d) first + (s + d)^2 second, by powers of d
        s = middle - (self.low + self.high) / 2
        return (
            self.base + s * self.first + s * s * self.second,
            self.first + 2 * s * self.second,
            self.second,
        )


@dataclass(frozen=True, slots=True, eq=False)
class LoopPencils:
    """The pencils of a loop over an interval of speed, at a condition; tolerances: those in the box
    (empty: none); mode: whose response they enclose; units (m,): what the signals that it reads are
    multiplied by there, so that currents and displacements are alike; given: of mode force-free,
    the controller without its delay, whose states come first in ``controller``.
    """

    loop: SynchronousLoop
    condition: Condition
    tolerances: tuple[Tolerance, ...]
    controller: StateSpace
    C: np.ndarray
    states: int
    owners: tuple[str, ...]
    segments: tuple[_Segment, ...]
    mode: str
    units: np.ndarray
    given: StateSpace | None = None
    _known: dict[tuple[float, float], Enclosure | None] = field(default_factory=dict, init=False)

    def enclosure(self, low: float, high: float) -> Enclosure | None:
        """The enclosure of S between two speeds of one segment, remembered: no T is in it."""
        cell = low, high
        if cell not in self._known:
            self._known[cell] = enclose(self.pencil(low, high))
        return self._known[cell]

    def pencil(self, low: float, high: float) -> Pencil:
        """The cell between two speeds of one segment."""
        middle, h = (low + high) / 2, (high - low) / 2
        segment = next(s for s in self.segments if s.low - 1e-9 <= middle <= s.high + 1e-9)
        K = self.controller
        n = self.states
        q = len(self.owners)
        a = len(self.loop.axes)
        k = K.n_states
        M0, M1, M2 = segment.around(middle)
        size = n + q + k + a
        P0, P1, P2 = (np.zeros((size, size), complex) for _ in range(3))
        rest = np.zeros((size, size))

        # Unknowns (x, v, x_k, u) as in the module's matrix; rows of M: x', then the outputs z.
        # P(d) = P0 + d P1 + d^2 P2, |d| <= h, up to rest entry by entry
        x = slice(0, n)
        v = slice(n, n + q)
        c = slice(n + q, n + q + k)
        u = slice(n + q + k, n + q + k + a)

        # the machine: j W - A in the states, -C_z in the deviations' outputs
        harmonic = self.loop.harmonic
        P0[x, x] = 1j * harmonic * middle * np.eye(n) - M0[:n, :n]
        P1[x, x] = 1j * harmonic * np.eye(n) - M1[:n, :n]
        P2[x, x] = -M2[:n, :n]
        P0[v, x] = -M0[n:, :n]
        P1[v, x] = -M1[n:, :n]
        P2[v, x] = -M2[n:, :n]
        # v = z: D_zw p goes to the members
        P0[v, v] = np.eye(q)
        rest[: n + q, x] += segment.rest[:, :n]

        # the hold and the delay of whole samples: g(W) = int_0^1 exp(-j (W + d) Ts s) ds
        dt = (
            harmonic * self.loop.timing.sample_time
        )  # z and g are functions of the harmonic's frequency
        g = _hold_series(middle, dt)
        drive = [np.vstack([M[:n, n + q :], M[n:, n + q :]]) for M in (M0, M1, M2)]

        # -g(W + d) (M0 + d M1 + d^2 M2) in the columns of u, by powers of d
        P0[: n + q, u] = -g[0] * drive[0]
        P1[: n + q, u] = -(g[0] * drive[1] + g[1] * drive[0])
        P2[: n + q, u] = -(g[0] * drive[2] + g[1] * drive[1] + g[2] * drive[0])

        # |g| <= 1, |g''' d^3/6| <= (Ts h)^3/24 and the products beyond the second power
        left = h**3 * (
            abs(g[1]) * np.abs(drive[2])
            + abs(g[2]) * np.abs(drive[1])
            + h * abs(g[2]) * np.abs(drive[2])
        )
        cubic = (dt * h) ** 3 / 24
        rest[: n + q, u] += (
            left
            + cubic * (np.abs(drive[0]) + h * np.abs(drive[1]) + h * h * np.abs(drive[2]))
            + (1 + cubic) * segment.rest[:, n + q :]
        )

        # the controller: z(W) = z0 exp(j d Ts)
        z0 = np.exp(1j * middle * dt)
        P0[c, c] = z0 * np.eye(k) - K.A
        P1[c, c] = 1j * dt * z0 * np.eye(k)
        P2[c, c] = -(dt**2) / 2 * z0 * np.eye(k)
        rest[c, c] += (dt * h) ** 3 / 6 * np.eye(k)

        # (z - A_k) x_k + B_k C x = -B_k d_o,   u - C_k x_k + D_k C x = -D_k d_o
        P0[c, x], P0[u, x] = K.B @ self.C, K.D @ self.C
        P0[u, c], P0[u, u] = -K.C, np.eye(a)

        # members: -B_w and -D_zw in the columns of each parameter; that they depend on d goes to
        # the rest
        members = []
        for name in dict.fromkeys(self.owners):
            columns = [i for i, owner in enumerate(self.owners) if owner == name]
            member = np.zeros((size, size), complex)
            for i in columns:
                member[: n + q, n + i] = -M0[:, n + i]
                slope = h * np.abs(M1[:, n + i]) + h * h * np.abs(M2[:, n + i])
                rest[: n + q, n + i] += slope + segment.rest[:, n + i]
            members.append(member)

        # e = C x + d_o, other modes without d_o; Q: the right side's columns of d_o
        read = len(self.units)
        C, Q = np.zeros((read, size), complex), np.zeros((size, a), complex)
        C[:a, x] = self.C
        Q[c] = -K.B
        Q[u] = -K.D
        D = np.eye(read, a, dtype=complex) * (self.mode == "current-free")
        if self.given is not None:
            # the currents before their delay: C_0 x_0 - D_0 (C x + d_o)
            first = slice(c.start, c.start + self.given.n_states)
            units = self.units[a:, None]
            C[a:, first], C[a:, x] = units * self.given.C, -units * self.given.D @ self.C
            D[a:] = -units * self.given.D
        return Pencil(P0, P1, P2, tuple(members), rest, C, Q, D, h)

    def aliasing(self, low: float, high: float) -> float:
        """The allowance for aliasing between two speeds, in the 2-norm of the response."""
        middle = (low + high) / 2
        return next(s.aliasing for s in self.segments if s.low - 1e-9 <= middle <= s.high + 1e-9)


def loop_pencils(
    loop: SynchronousLoop,
    condition: Condition,
    low: float,
    high: float,
    tolerances: Sequence[Tolerance] | None = (),
    edges: Sequence[float] = (),
    mode: str = "current-free",
) -> LoopPencils:
    """The pencils of a loop between two speeds [rad/s].

    tolerances: in the box (None: all that hold around the condition); edges: further speeds at
    which a segment ends; mode: whose signals are enclosed. Raises InvalidInput for a law that is
    scheduled over the speed.
    """
    if loop.law.follows(SPEED):
        raise InvalidInput(
            "a controller scheduled over speed is not proved with a synchronous block; give one "
            "that is fixed over speed"
        )
    plant = loop.plant((low + high) / 2, condition)
    held = tolerances_around(plant) if tolerances is None else tuple(tolerances)
    given = loop.controller(plant) if mode == "force-free" else None
    if given is None:
        law = loop.timing.in_loop(loop.controller(plant))
    else:
        # the delay after the controller: the block reads what goes into it
        chain = static_gain(np.eye(len(loop.axes)), given.outputs, given.outputs, given.dt)
        law = series(given, delayed(chain, loop.timing.delay_samples))
    units = _units(loop, plant, mode)

    def matrices(speed: float) -> tuple[np.ndarray, np.ndarray, tuple[str, ...]]:
        at = loop.plant(speed, condition)
        if held:
            model: GeneralizedPlant = uncertain(at, held)
            system = model.system
            owners = tuple(block.name for block in model.blocks for _ in range(block.n_w))
        else:
            system, owners = at.system, ()
        w = list(range(len(owners)))
        u = [system.inputs.index(name) for name in at.named("u")]
        y = [system.outputs.index(name) for name in at.named("y")]
        if system.D[np.ix_(y, w + u)].any():
            raise InvalidInput(
                "the currents reach the sensors at once; give the amplifier a bandwidth in the "
                "machine file"
            )

        # [A, B_w, B; C_z, D_zw, D_zu]
        block = np.block(
            [[system.A, system.B[:, w + u]], [system.C[w], system.D[np.ix_(w, w + u)]]],
        )
        return block, system.C[y], owners

    knots = np.unique(
        np.concatenate(
            [np.linspace(low, high, _SEGMENTS + 1), [e for e in edges if low < e < high]]
        )
    )

    segments = []
    for start, end in itertools.pairwise(knots):
        middle, half = (start + end) / 2, (end - start) / 2
        # the quadratic through both ends and the middle
        left, centre, right = (matrices(w)[0] for w in (start, middle, end))
        first, second = (right - left) / (2 * half), (right + left - 2 * centre) / (2 * half * half)

        # how far it is off at the quarter points
        off = np.zeros(centre.shape)
        for s in (-half / 2, half / 2):
            off = np.maximum(
                off, np.abs(matrices(middle + s)[0] - centre - s * first - s * s * second)
            )

        # rounding of the assembly is not curvature
        off[off < 1e-12 * np.abs(centre).max(axis=1, keepdims=True)] = 0.0

        seen = max(_aliasing(loop, condition, w, mode, units) for w in (start, middle, end))
        segments.append(
            _Segment(start, end, centre, first, second, _ALLOWED * off, _ALLOWED * seen)
        )

    _, C, owners = matrices((low + high) / 2)
    return LoopPencils(
        loop, condition, held, law, C, len(C[0]), owners, tuple(segments), mode, units, given
    )


def _units(loop: SynchronousLoop, plant: Plant, mode: str) -> np.ndarray:
    """Metres per unit of the signals (m,) that a mode reads: of a current k_i/k_s."""
    ones = np.ones(len(loop.axes))
    if mode != "force-free":
        return ones
    k_i, k_s = magnet_coefficients(loop.machine, plant.point)
    return np.concatenate([ones, k_i / k_s])


def prove_interval(
    pencils: LoopPencils,
    table: Callable[[float], np.ndarray],
    knots: Sequence[float],
    low: float,
    high: float,
) -> IntervalProof:
    """Herm(D R) > 0 between two speeds, for every value of the tolerances in the box of
    ``pencils``.

    table: speed -> D (a, m) of the signals that the mode reads, as it runs (``running_table``), T
    (a, a) but for mode force-free; knots: where it bends, linear between.
    """

    def drive(speed: float) -> np.ndarray:
        return np.asarray(table(speed) / pencils.units)

    # no cell crosses a segment's end or a bend of the table
    edges = sorted({low, high, *(s.low for s in pencils.segments), *knots})
    edges = [w for w in edges if low <= w <= high]
    angle = np.pi / 2
    worst = low
    cells = 0
    for start, end in itertools.pairwise(edges):
        if end - start < 1e-9 * high:
            continue
        part = prove(pencils.enclosure, drive, start, end, (high - low) * _WIDTH, pencils.aliasing)
        if not part.proved:
            return part
        cells += part.cells
        if part.angle < angle:
            angle, worst = part.angle, part.worst
    return IntervalProof(True, float(angle), worst, cells)


def _hold_series(middle: float, dt: float) -> tuple[complex, complex, complex]:
    """Taylor coefficients of g(W + d) in d: int_0^1 exp(-j W Ts s) (-j Ts s)^k/k! ds, by Gauss's
    rule of 16 points.
    """
    nodes, weights = np.polynomial.legendre.leggauss(16)
    # from [-1, 1] to [0, 1]
    s, weights = (nodes + 1) / 2, weights / 2
    turn = np.exp(-1j * middle * dt * s)
    first = complex((weights * turn * (-1j * dt * s)).sum())
    return (
        complex((weights * turn).sum()),
        first,
        complex((weights * turn * (-1j * dt * s) ** 2).sum() / 2),
    )


def _aliasing(
    loop: SynchronousLoop, condition: Condition, speed: float, mode: str, units: np.ndarray
) -> float:
    """By how much a mode's signals with the base band of the hold alone are off the exact sampled
    ones, in units, in the 2-norm.
    """
    off = loop.signals(mode, speed, condition) - loop.base_band(speed, condition, mode)
    return float(np.linalg.norm(units[:, None] * off, 2))
