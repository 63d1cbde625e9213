"""A loop with a synchronous block in it: what the block sees, and what is left once it has
converged.

The block adds c before the controller, which then sees r - (y - c). Over the sampled loop, with the
controller's delay and hold on the full plant at a speed W and a seal pressure:

    y = G u' + G_f f,   u = -K (y - c),   u' = u, held and late      (f: the force of the unbalance)

| mode | signal z driven to zero | consequence |
|---|---|---|
| current-free | y - c: no 1x of the control current | the housing still feels k_s q |
| force-free | y_b + (k_i/k_s) i at the bearings | the rotor turns about its axis of inertia |
| vibration-free | y | the bearings take the whole unbalance force |
| damping | none: c = D y, a 1x force against velocity | a bounded orbit where others have none |

y_b are the displacements at the bearings as a stiff rotor would have them from y; the real ones are
used where forces and orbits are reported. The response R of a mode is the transfer from c to -z.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import product
from typing import Any, TypeVar

import numpy as np

from ambrose.core.checks import InvalidInput, invalid, named_failure
from ambrose.core.interval_proof import Enclosure, IntervalProof, Pencil, enclose, prove
from ambrose.core.lft import GeneralizedPlant
from ambrose.core.sampling import c2d, delayed, hold
from ambrose.core.statespace import StateSpace, connect, rename, select, series, static_gain
from ambrose.law.law import SPEED, Law, LawLike, law_of
from ambrose.law.loop import DEFAULT, Timing, match_controller, timing_of
from ambrose.law.pid import modes
from ambrose.law.synchronous_block import BlockLaw, SynchronousLaw
from ambrose.machine.description import Tolerance
from ambrose.machine.machine import Machine
from ambrose.machine.part import Synchronous
from ambrose.machine.units import listed
from ambrose.machine.validation.controller import synchronous_problems
from ambrose.model.assemble import assemble
from ambrose.model.plant import Plant, at_bearings
from ambrose.model.static_load import magnet_coefficients
from ambrose.model.uncertainty import perturbed, tolerances_around, uncertain

# T of a synchronous block over speed, on the machine's axes, however its table is written.


@dataclass(frozen=True, slots=True, eq=False)
class BlockTable:
    """T (s, n, n), or D (s, n, m), complex at speeds (s,) [rad/s], linear between and constant
    beyond.
    """

    speeds: np.ndarray
    T: np.ndarray

    def at(self, speed: float) -> np.ndarray:
        """T at a speed [rad/s]."""
        if len(self.speeds) == 1:
            return np.asarray(self.T[0])
        speed = min(max(speed, float(self.speeds[0])), float(self.speeds[-1]))
        k = min(int(np.searchsorted(self.speeds, speed, side="right")) - 1, len(self.speeds) - 2)
        share = (speed - self.speeds[k]) / (self.speeds[k + 1] - self.speeds[k])
        return np.asarray((1 - share) * self.T[k] + share * self.T[k + 1])


def block_table(block: Synchronous, machine: Machine) -> BlockTable:
    """The table of a block on the machine's axes. Raises InvalidInput for a T that does not fit the
    machine.
    """
    check_blocks((block,), machine)
    speeds, T = block.table(len(machine.axes))
    if block.coordinates == "tilt-translate" and block.real is not None:
        # channels = into y, c = into^-1 T (into y)
        into = modes(machine)[0]
        T = np.linalg.inv(into) @ T @ into
    return BlockTable(speeds, T)


def running_table(table: BlockTable, loop: SynchronousLoop, mode: str) -> BlockTable:
    """D = T Z (s, n, m) at a table's speeds: what runs is linear between them, and not T Z."""
    at = conditions(loop.machine)[0]
    weighed = [
        T @ loop.weights(mode, float(w), at) for w, T in zip(table.speeds, table.T, strict=True)
    ]
    return BlockTable(table.speeds, np.array(weighed))


def check_blocks(blocks: Sequence[Synchronous], machine: Machine) -> None:
    """Raises InvalidInput for blocks that do not fit the machine's axes, cover their bands or
    exclude each other.
    """
    lines = tuple(
        synchronous_problems(
            tuple(blocks), len(machine.axes), len(machine.bearings), "synchronous block"
        )
    )
    if lines:
        raise invalid(
            "the synchronous blocks",
            listed("", lines).lstrip(": "),
            "blocks for this machine",
            "correct them",
        )


def block_of(
    mode: str,
    band: tuple[float, float],
    time_constant: float,
    table: BlockTable,
    **more: float | str | None,
) -> Synchronous:
    """A block with the part of a table that covers its band; more: further fields of
    ``Synchronous``.
    """
    low, high = band
    inside = [float(w) for w in table.speeds if low < w < high]
    speeds = (low, *inside, high)
    T = np.array([table.at(w) for w in speeds])
    return Synchronous(
        mode=mode,
        band=(float(low), float(high)),
        time_constant=float(time_constant),
        speeds=speeds,
        real=_nested(T.real),
        imaginary=_nested(T.imag),
        **more,  # type: ignore[arg-type]
    )


def _nested(values: np.ndarray) -> tuple[tuple[tuple[float, ...], ...], ...]:
    return tuple(tuple(tuple(float(x) + 0.0 for x in row) for row in matrix) for matrix in values)


def running_law(
    blocks: Sequence[Synchronous], loop: SynchronousLoop, fastest: float = 1e4
) -> SynchronousLaw:
    """The blocks as they run beside the loop's controller, D = T Z over speed at the design point's
    pressure.

    fastest [rad/s^2]: the fastest run-up. Raises InvalidInput for blocks that do not fit the
    machine.
    """
    machine = loop.machine
    check_blocks(blocks, machine)
    gaps = [bearing.touchdown_gap or bearing.gap for bearing in machine.bearings]
    usual = 0.25 * min((gap for gap in gaps if gap), default=4e-4)
    laws = []
    for block in blocks:
        at = replace(loop, harmonic=block.harmonic)
        table = running_table(block_table(block, machine), at, block.mode)
        laws.append(
            BlockLaw(
                table.speeds,
                table.T,
                block.band,
                block.gain,
                np.full(len(machine.axes), block.limit or usual),
                block.harmonic,
                block.leak,
                block.hysteresis,
                block.hold,
                block.release,
                block.time_constant,
                block.mode == "current-free",
                block.update == "turn",
            )
        )
    return SynchronousLaw(tuple(laws), loop.timing.sample_time, fastest)


MODES = ("current-free", "force-free", "vibration-free", "damping")
_KEPT, _LOOPS = 32, 64  # plants, and what is made of them, that are remembered
_T = TypeVar("_T")


@dataclass(frozen=True, slots=True)
class Condition:
    """What stands still while the speed changes: seal pressure [Pa], and parameters moved within
    tolerances.
    """

    pressure: float
    delta: tuple[tuple[str, float], ...] = ()

    @property
    def label(self) -> str:
        """In words."""
        moved = "".join(f", {name} {value:+.3g}" for name, value in self.delta)
        return f"{self.pressure / 1e5:.4g} bar{moved}"


@dataclass(frozen=True, slots=True, eq=False)
class Converged:
    """1x phasors per force pattern (patterns in the last axis) once a block has converged, or
    without one.

    u (a, f) [A] controller; i (a, f) [A] coil; q (a, f) [m] at the bearings; y (a, f) [m] measured;
    force (a, f) [N] of the magnets, k_i i + k_s q; c (a, f) [m] what the block adds.
    """

    u: np.ndarray
    i: np.ndarray
    q: np.ndarray
    y: np.ndarray
    force: np.ndarray
    c: np.ndarray


@dataclass(frozen=True, slots=True, eq=False)
class SynchronousLoop:
    """The loop of a machine and a law, sampled as it runs, at any speed [rad/s] and condition.

    law: fixed or scheduled; timing: when it acts; harmonic: the multiple of the speed at which the
    block acts (1: the unbalance; all "at 1x" below is at this multiple). Plants are kept, the
    latest ones.
    """

    machine: Machine
    law: Law
    timing: Timing
    harmonic: int = 1
    _plants: dict[Any, Plant] = field(default_factory=dict)
    _loops: dict[Any, Any] = field(default_factory=dict)

    @property
    def axes(self) -> tuple[str, ...]:
        return self.machine.axes

    def plant(self, speed: float, condition: Condition) -> Plant:
        """The full plant there."""
        key = (float(speed), condition)
        if key not in self._plants:
            if condition.delta:
                nominal = self.plant(speed, replace(condition, delta=()))
                held = _held(self.machine, condition.delta)
                plant = perturbed(nominal, dict(condition.delta), held)
            else:
                point = replace(
                    self.machine.operation.design,
                    speed=float(speed),
                    seal_pressure=condition.pressure,
                    label="",
                )
                plant = assemble(self.machine, point)
            while len(self._plants) >= _KEPT:
                self._plants.pop(next(iter(self._plants)))
            self._plants[key] = plant
        return self._plants[key]

    def controller(self, plant: Plant) -> StateSpace:
        """The law at the plant, sampled, without its delay. Raises InvalidInput for another sample
        time.
        """
        fixed = match_controller(self.law, plant)
        return replace(self.timing, delay_samples=0).in_loop(fixed)

    def sampled(self, speed: float, condition: Condition) -> StateSpace:
        """The loop from c_<axis> [m] to e_<axis> = y - c, y_<axis> [m] and u_<axis> [A]: exact,
        sampled.
        """
        key = ("sampled", float(speed), condition)
        return self.remembered(key, lambda: self._sampled(self.plant(speed, condition)))

    def remembered(self, key: tuple[str, float, Condition], make: Callable[[], _T]) -> _T:
        """What was made for a kind, speed [rad/s] and condition; made anew where it is too long
        ago.
        """
        if key not in self._loops:
            made = make()
            while len(self._loops) >= _LOOPS:
                self._loops.pop(next(iter(self._loops)))
            self._loops[key] = made
        kept: _T = self._loops[key]
        return kept

    def _sampled(self, plant: Plant) -> StateSpace:
        axes, dt = self.axes, self.timing.sample_time
        held = c2d(select(plant.system, plant.named("u"), plant.named("y")), dt)
        late = delayed(
            static_gain(np.eye(len(axes)), [f"u_{a}" for a in axes], [f"v_{a}" for a in axes], dt),
            self.timing.delay_samples,
        )
        return connect(
            [
                rename(held, [f"v_{a}" for a in axes], [f"g_{a}" for a in axes]),
                self.controller(plant),
                late,
            ],
            inputs=[f"c_{a}" for a in axes],
            outputs=[f"{kind}_{a}" for kind in "eyu" for a in axes],
            sums={
                **{f"err_{a}": [f"c_{a}", f"-g_{a}"] for a in axes},
                **{f"e_{a}": [f"g_{a}", f"-c_{a}"] for a in axes},
                **{f"y_{a}": [f"g_{a}"] for a in axes},
            },
        )

    def reads(self, mode: str) -> tuple[str, ...]:
        """The outputs of ``sampled`` that a mode reads."""
        kinds = {"current-free": "e", "force-free": "yu"}.get(mode, "y")
        return tuple(f"{kind}_{a}" for kind in kinds for a in self.axes)

    def weights(self, mode: str, speed: float, condition: Condition) -> np.ndarray:
        """Z (a, m) complex: the mode's z from the signals that it reads (``reads``), at 1x."""
        n = len(self.axes)
        if mode not in MODES:
            raise invalid(
                "the mode", repr(mode), f"one of {', '.join(MODES)}", "choose one of them"
            )
        if mode != "force-free":
            return np.eye(n, dtype=complex)
        plant = self.plant(speed, condition)
        k_i, k_s = magnet_coefficients(self.machine, plant.point)
        coil = response_at(
            select(plant.system, plant.named("u"), plant.named("i")), self.harmonic * speed
        )
        return np.hstack([at_bearings(self.machine), np.diag(k_i / k_s) @ coil * self._late(speed)])

    def response(self, mode: str, speed: float, condition: Condition) -> np.ndarray:
        """R (a, a) complex: from c to -z, exact for the sampled loop at 1x. The block of a member
        of the tolerances weighs its signals as it was designed, without them.
        """
        weights = self.weights(mode, speed, replace(condition, delta=()))
        return weights @ self.signals(mode, speed, condition)

    def signals(self, mode: str, speed: float, condition: Condition) -> np.ndarray:
        """(m, a) complex: from c to minus the signals that a mode reads, exact for the sampled loop
        at 1x; ``response`` weighs them.
        """
        loop = select(self.sampled(speed, condition), None, self.reads(mode))
        z = np.exp(1j * self.harmonic * speed * self.timing.sample_time)
        return -_sampled_at(loop, z)

    def base_band(
        self, speed: float, condition: Condition, mode: str = "current-free"
    ) -> np.ndarray:
        """``signals`` (m, a) with the base band of the hold alone: the exact ones but for
        aliasing.
        """
        plant = self.plant(speed, condition)

        # S = (I + G K)^-1, G = P(j n W) hold delay
        G = response_at(
            select(plant.system, plant.named("u"), plant.named("y")), self.harmonic * speed
        ) * self._late(speed)
        K = _sampled_at(
            self.controller(plant), np.exp(1j * self.harmonic * speed * self.timing.sample_time)
        )
        S = np.linalg.inv(np.eye(len(G)) + G @ K)
        if mode == "current-free":
            return np.asarray(S)
        # y = (1 - S) c, u = K S c
        return -np.vstack([np.eye(len(G)) - S, K @ S])[: len(self.reads(mode))]

    def _late(self, speed: float) -> complex:
        """Hold and delay at 1x."""
        dt, frequency = self.timing.sample_time, self.harmonic * speed
        late = np.exp(-1j * frequency * dt * self.timing.delay_samples)
        return complex(hold(np.array([frequency]), dt)[0] * late)

    @named_failure("the converged response")
    def converged(
        self,
        mode: str | None,
        speed: float,
        condition: Condition,
        forces: np.ndarray,
        drive: np.ndarray | None = None,
    ) -> Converged:
        """The 1x phasors under forces f (a, patterns) [N] at the bearings, with the block
        converged.

        mode None: without a block. drive D (a, a) complex: of a block that leaks, which settles at
        c = D z, (eps/(2 leak)) T, with z what the mode drives to zero (of mode "damping" y); None:
        one that does not leak, z = 0.
        """
        plant, n = self.plant(speed, condition), len(self.axes)

        # P: (u', f) -> (y, q, i) of the full plant at 1x, rows and columns in blocks of n
        names = [*plant.named("u"), *plant.bearing_named("f")]
        rows = [*plant.named("y"), *plant.bearing_named("q"), *plant.named("i")]
        P = response_at(select(plant.system, names, rows), self.harmonic * speed)

        late = self._late(speed)
        K = _sampled_at(
            self.controller(plant), np.exp(1j * self.harmonic * speed * self.timing.sample_time)
        )

        # u' = u, held and late: the columns of u
        Gu, Gf = P[:, :n] * late, P[:, n:] @ forces
        G = Gu[:n]
        Gq = Gu[n : 2 * n]
        Gi = Gu[2 * n :]

        k_i, k_s = magnet_coefficients(self.machine, plant.point)
        one = np.eye(n)
        # unknowns (u, c): u + K G u - K c = -K y_f, and the mode's z = 0
        top = np.hstack([one + K @ G, -K])
        right = -K @ Gf[:n]

        # z = Z_u u + Z_c c + z_f, what the mode drives to zero (of "damping": what it feeds back)
        Zu, Zc = G, 0 * one
        z_f = Gf[:n]
        if mode == "current-free":  # K (y - c) = -u, and y - c = 0
            Zc = -one
        elif mode == "force-free":
            # y_b + (k_i/k_s) i with y_b = B y, i = G_i u + its part from f
            B = at_bearings(self.machine)
            Zu = B @ G + np.diag(k_i / k_s) @ Gi
            z_f = B @ Gf[:n] + np.diag(k_i / k_s) @ Gf[2 * n :]

        if mode is None:
            bottom, z = np.hstack([0 * one, one]), 0 * Gf[:n]
        elif drive is not None:
            # c = D z: (1 - D Z_c) c - D Z_u u = D z_f
            bottom, z = np.hstack([-drive @ Zu, one - drive @ Zc]), drive @ z_f
        elif mode == "damping":
            raise InvalidInput("mode damping has no gain D; give the one of its table")
        else:
            bottom, z = np.hstack([Zu, Zc]), -z_f

        solution = np.linalg.solve(np.vstack([top, bottom]), np.vstack([right, z]))
        u, c = solution[:n], solution[n:]
        q, i = Gq @ u + Gf[n : 2 * n], Gi @ u + Gf[2 * n :]
        return Converged(u, i, q, G @ u + Gf[:n], k_i[:, None] * i + k_s[:, None] * q, c)


def synchronous_loop(
    machine: Machine,
    controller: LawLike,
    rate: float | None = None,
    delay_samples: int | None = None,
) -> SynchronousLoop:
    """The loop of a machine and a controller (a Synthesis or a law), sampled as it runs; 10 kHz and
    one sample late where nothing says it. Raises InvalidInput.
    """
    law = law_of(controller)
    timing = timing_of(machine, law, rate, delay_samples) or DEFAULT
    return SynchronousLoop(machine, law, timing)


def conditions(machine: Machine) -> tuple[Condition, ...]:
    """The different seal pressures of the machine's operating points, the design point's first."""
    points = [machine.operation.design, *machine.operation.envelope]
    return tuple(
        Condition(pressure) for pressure in dict.fromkeys(point.seal_pressure for point in points)
    )


def extreme_conditions(
    loop: SynchronousLoop, condition: Condition, speed: float
) -> tuple[Condition, ...]:
    """A condition with its tolerances at corners of their box: all of them for two at most, else
    all up and all down.
    """
    names = [item.parameter for item in tolerances_around(loop.plant(speed, condition))]
    if not names:
        return ()
    corners = (
        product((-1.0, 1.0), repeat=len(names))
        if len(names) <= 2
        else [(s,) * len(names) for s in (-1.0, 1.0)]
    )
    return tuple(
        Condition(condition.pressure, tuple(zip(names, corner, strict=True))) for corner in corners
    )


def forward_patterns(machine: Machine) -> np.ndarray:
    """(a, bearings) complex: a force of 1 N that turns forward, at every bearing alone."""
    turned = np.exp(-1j * np.array([bearing.angle for bearing in machine.bearings]))
    pattern = np.zeros((2 * len(turned), len(turned)), complex)
    for b, phase in enumerate(turned):
        pattern[2 * b : 2 * b + 2, b] = phase * np.array([1.0, -1j])
    return pattern


def orbits(values: np.ndarray) -> np.ndarray:
    """Semi-major axis (bearings, ...) of the ellipses of phasors (a, ...) in pairs of axes."""
    x, y = values[0::2], values[1::2]
    # radii of the forward and of the backward circle, added
    return np.asarray(0.5 * (np.abs(x + 1j * y) + np.abs(x - 1j * y)))


def _held(machine: Machine, delta: Sequence[tuple[str, float]]) -> tuple[Tolerance, ...]:
    known: Mapping[str, Tolerance] = {item.parameter: item for item in machine.tolerances}
    return tuple(known[name] for name, _ in delta)


def response_at(system: StateSpace, omega: float) -> np.ndarray:
    """A continuous system at j omega."""
    inner = 1j * omega * np.eye(system.n_states) - system.A
    return np.asarray(system.C @ np.linalg.solve(inner, system.B.astype(complex)) + system.D)


def _sampled_at(system: StateSpace, z: complex) -> np.ndarray:
    """A sampled system at z."""
    inner = z * np.eye(system.n_states) - system.A
    return np.asarray(system.C @ np.linalg.solve(inner, system.B.astype(complex)) + system.D)


# Proof that a synchronous block converges at every speed of an interval, between the speeds as
# well.
#
# What is proved: Herm(T R) > 0 for the response R of the block's mode, the convex sufficient
# condition under which every small gain is stable (core/synchronous.py), for the full plant with
# the controller as it is sampled, its delay and its hold. The loop is written as a pencil in the
# distance d of the speed from the middle of a cell,
#
#     [ j W - A(W)     -B_w D_p       0          -g(W) B   ] [x]     [  0  ]
#     [ -C_z           I - D_zw D_p   0          -g(W) D_zu] [v]  =  [  0  ] d_o,    e = C x + d_o
#     [  B_k C           0          z(W) - A_k     0       ] [x_k]   [-B_k ]
#     [  D_k C           0          -C_k           1       ] [u]     [-D_k ]
#
# R is S = 1 + C P^-1 Q for mode current-free. The other modes have C P^-1 Q alone: vibration-free
# and damping with C of y, force-free with y and u below each other: the block that runs reads both,
# by a D = T Z that is linear between the speeds of its table, and Herm(D R) > 0 is proved of that
# D. (T Z at every speed would be another block, by a difference of second order in the speeds'
# distance.)
#
# Here z = exp(j W Ts), g = (1 - exp(-j W Ts))/(j W Ts) and D_p = diag(p) of the tolerances, |p| <=
# 1. z and g are entire, so that their Taylor remainders are known; the machine's matrices are a
# quadratic through three speeds, and twice what they are off at the quarter points is allowed for.
# A(W) is affine where only gyroscopic forces depend on the speed: the quadratic is then exact.
#
# Not in the pencil: aliasing beyond the base band of the hold. It is measured at the ends and in
# the middle of every segment and allowed for twice over. Floating point is used without directed
# rounding.


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
            "stability of a controller scheduled over speed is not proved with a synchronous "
            "block; use a controller that does not change with speed"
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
