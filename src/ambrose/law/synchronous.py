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

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import product
from typing import Any, TypeVar

import numpy as np

from ambrose.core.checks import InvalidInput, invalid, named_failure
from ambrose.core.sampling import c2d, delayed, hold
from ambrose.core.statespace import StateSpace, connect, rename, select, static_gain
from ambrose.law.law import Law, LawLike, law_of
from ambrose.law.loop import match_controller
from ambrose.law.timing import DEFAULT, Timing, timing_of
from ambrose.machine.description import Tolerance
from ambrose.machine.machine import Machine
from ambrose.model.assemble import assemble
from ambrose.model.plant import Plant
from ambrose.model.ports import measured_ports, sensor_turn
from ambrose.model.static_load import magnet_coefficients
from ambrose.model.uncertainty import perturbed, tolerances_around

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


def at_bearings(machine: Machine) -> np.ndarray:
    """(a, a) real: displacements at the bearings of a stiff rotor from those measured, both along
    the axes.

    Between and beyond the sensors by a straight line; with one bearing, or sensors in one plane, as
    measured.
    """
    turned = sensor_turn(machine)
    place = np.array([port.position for port in measured_ports(machine)[0::2]])
    target = np.array([bearing.position for bearing in machine.bearings])
    angle = np.array([bearing.angle for bearing in machine.bearings])
    if len(place) < 2 or np.ptp(place) == 0:
        return turned
    # least-squares line through the sensors, read at the bearings, in the common directions x, y
    line = np.column_stack([target, np.ones_like(target)]) @ np.linalg.pinv(
        np.column_stack([place, np.ones_like(place)])
    )
    result = np.zeros((2 * len(place), 2 * len(place)))

    # pair s, along the axes of bearing s, into the axes of bearing b: turned by their difference
    for b in range(len(target)):
        for s in range(len(place)):
            c, d = np.cos(angle[s] - angle[b]), np.sin(angle[s] - angle[b])
            result[2 * b : 2 * b + 2, 2 * s : 2 * s + 2] = line[b, s] * np.array([[c, -d], [d, c]])
    return result @ turned


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
