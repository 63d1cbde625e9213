"""The loop with the motion of the whole shaft: responses, and modes as roots of

    T(s) x = 0,    T(s) = s I - A + B K(s) C,

with the plant x' = A x + B u, y = C x at one operating point and K(s) the law as it runs: a sampled
one with its delay acts through the base band of its hold, K(e^{s T}) (1 - e^{-s T})/(s T), exact
but for aliasing. The rotor's modal displacements are the plant's first states, so that any place
of the shaft can be read, and pulled at, without a port there.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import lu_factor, lu_solve

from ambrose.annexes.rotordynamics.stations import Layout
from ambrose.core.checks import NumericalFailure
from ambrose.core.frequency import frequency_response
from ambrose.core.statespace import StateSpace
from ambrose.judge.campbell import Modes, modes
from ambrose.law.law import LawLike, law_of
from ambrose.law.loop import Timing, closed_loop, running_law
from ambrose.machine.description import OperatingPoint
from ambrose.machine.machine import Machine
from ambrose.model.assemble import (
    assemble,
    attached_rotor,
    bending_modes_of,
    constant_coefficients,
    modes_of,
    rows_in,
    seal_model,
    state_scales,
)
from ambrose.model.effect import reactions
from ambrose.model.effects import amplifier, seal as seals, seal_rational, sensor
from ambrose.model.effects.rotor import finite_element_rotor, free_modes
from ambrose.model.plant import Plant, Port
from ambrose.model.static_load import magnet_coefficients

_STEPS = 30  # of the iteration for a mode
_CLOSE = 1e-10  # of |s|: where it ends
_TURNS = 4  # of inverse iteration at a fixed shift, for a mode whose shape is not known yet
_NUDGE = 1e-6  # of |s|: the step of K's derivative


@dataclass(frozen=True, slots=True, eq=False)
class ShaftLoop:
    """The loop at one operating point.

    A (n, n), B (n, a), C (a, n): the plant from currents [A] to measured displacements [m];
    D (a, a) its direct part. read (2 s, n): states -> displacements of the stations in x and y [m],
    station after station. pull (n, 2 s): forces [N] there -> state rates. current (a, n) and
    direct (a, a): states and commands -> coil currents [A]. law: None without magnets.
    """

    plant: Plant
    A: np.ndarray
    B: np.ndarray
    C: np.ndarray
    D: np.ndarray
    read: np.ndarray
    pull: np.ndarray
    law: StateSpace | None

    @property
    def point(self) -> OperatingPoint:
        return self.plant.point

    def gain(self, s: complex) -> np.ndarray:
        """K(s) (a, a) [A/m] as it acts in the loop; u = -K y."""
        law = self.law
        if law is None:
            return np.zeros((0, 0), complex)
        z = s if law.dt is None else np.exp(s * law.dt)
        inner = np.linalg.solve(z * np.eye(law.n_states) - law.A, law.B.astype(complex))
        K = law.C @ inner + law.D
        if law.dt is None:
            return np.asarray(K)
        x = s * law.dt
        return np.asarray(K * (-np.expm1(-x) / x if x else 1.0))

    def matrix(self, s: complex) -> np.ndarray:
        """T(s) (n, n)."""
        n = len(self.A)
        T = s * np.eye(n) - self.A.astype(complex)
        if self.law is not None:
            # u = -K (C x + D u)
            K = self.gain(s)
            T += self.B @ np.linalg.solve(np.eye(len(K)) + K @ self.D, K @ self.C)
        return T

    def states(self, s: complex, forces: np.ndarray) -> np.ndarray:
        """States (n,) or (n, k) under forces (2 s,) or (2 s, k) [N] at the stations, at s."""
        return np.linalg.solve(self.matrix(s), self.pull @ forces)

    def currents(self, s: complex, states: np.ndarray) -> np.ndarray:
        """Coil currents (a,) or (a, k) [A] that belong to states."""
        K = self.gain(s)
        return self.coil(
            states, -np.linalg.solve(np.eye(len(K)) + K @ self.D, K @ (self.C @ states))
        )

    def coil(self, states: np.ndarray, u: np.ndarray) -> np.ndarray:
        """Coil currents (a,) or (a, k) [A] of states and control currents u (a,) or (a, k) [A]."""
        system = self.plant.system
        rows = [system.outputs.index(name) for name in self.plant.named("i")]
        columns = [system.inputs.index(name) for name in self.plant.named("u")]
        return np.asarray(system.C[rows] @ states + system.D[np.ix_(rows, columns)] @ u)

    def coupled(self, station: int, q: float) -> ShaftLoop:
        """With a cross-coupled stiffness q [N/m] at a station: f_x = -q y, f_y = +q x."""
        x, y = 2 * station, 2 * station + 1
        extra = -np.outer(self.pull[:, x], self.read[y]) + np.outer(self.pull[:, y], self.read[x])
        return replace(self, A=self.A + q * extra)

    def mode_near(
        self, s: complex, x: np.ndarray | None = None, turn: complex = -1j
    ) -> tuple[complex, np.ndarray]:
        """The root s [1/s] of T nearest along Newton's path, and its states x (n,).

        x: states to begin with; without them forces along the shaft begin, y over x being ``turn``:
        -j forward, +j backward.

        Inverse iteration of the nonlinear eigenvalue problem (Unger 1950; Mehrmann & Voss 2004,
        sec. 4): T(s) w = T'(s) x, s <- s - (v^H x)/(v^H w), x <- w/|w|. Raises NumericalFailure
        where it does not settle.
        """
        if x is None:
            # the vector first, with the shift held: w = T(s)^-1 x turns towards the nearest mode
            factors = lu_factor(self.matrix(s))
            x = self.pull[:, 0::2].sum(axis=1) + turn * self.pull[:, 1::2].sum(axis=1)
            for _ in range(_TURNS):
                x = lu_solve(factors, x / np.linalg.norm(x))
        x = x / np.linalg.norm(x)
        for _ in range(_STEPS):
            v = x
            step = _NUDGE * abs(s)
            # T'(s) x by a central difference: only the pace of the iteration depends on it
            slope = (self.matrix(s + step) - self.matrix(s - step)) @ x / (2 * step)
            w = lu_solve(lu_factor(self.matrix(s)), slope)
            change = (v.conj() @ x) / (v.conj() @ w)
            s, x = s - change, w / np.linalg.norm(w)
            if abs(change) < _CLOSE * abs(s):
                return complex(s), x
        raise NumericalFailure(
            f"the mode near {abs(s):.4g} rad/s could not be followed within {_STEPS} steps; "
            "take a finer sweep, or check that the mode exists at both ends"
        )

    def all_modes(self) -> Modes:
        """The modes of the loop as it runs, by ascending modulus."""
        system = replace_system(self.plant.system, self.A)
        loop = system
        if self.law is not None:
            loop = closed_loop(replace(self.plant, system=system), self.law)
        return modes(loop, self.plant.ports, system)


def replace_system(system: StateSpace, A: np.ndarray) -> StateSpace:
    """The same signals around other dynamics."""
    return StateSpace(A, system.B, system.C, system.D, system.inputs, system.outputs, system.dt)


LoopAt = Callable[[OperatingPoint], ShaftLoop]


def shaft_loop(
    layout: Layout, point: OperatingPoint, given: LawLike | None, timing: Timing | None
) -> ShaftLoop:
    """The loop at an operating point. Raises InvalidInput where a seal's or bearing's table does
    not reach the point, and where the law is not one for the machine.
    """
    machine = layout.machine
    plant = assemble(machine, point)
    rotor = plant.rotor_model
    modes = modes_of(machine, rotor, None)
    places = tuple(
        Port(f"s{k}_{axis}", float(x), turn)
        for k, x in enumerate(layout.positions)
        for axis, turn in (("x", 0.0), ("y", np.pi / 2))
    )
    rows = rows_in(rotor, modes, places)

    # M q'' = ... + N^T f in the states q and q'/s: B = [0; diag(1/s) M^-1 N^T]
    attached = attached_rotor(machine, point, rotor)
    scales = state_scales(machine, rotor)
    count = len(attached.mass)
    N = np.hstack([rows, np.zeros((len(rows), count - rows.shape[1]))])
    system = plant.system
    read = np.zeros((len(rows), system.n_states))
    read[:, :count] = N
    pull = np.zeros((system.n_states, len(rows)))
    pull[count : 2 * count] = np.linalg.solve(attached.mass, N.T) / scales[:, None]

    u = [system.inputs.index(name) for name in plant.named("u")]
    y = [system.outputs.index(name) for name in plant.named("y")]
    law = None if given is None or not u else running_law(law_of(given), plant, timing)
    return ShaftLoop(
        plant, system.A, system.B[:, u], system.C[y], system.D[np.ix_(y, u)], read, pull, law
    )


# The force of every component on the rotor that moves as x e^{s t}: magnets, seals, stages,
# bearings and couplings.


@dataclass(frozen=True, slots=True, eq=False)
class ComponentForce:
    """Force [N] and motion [m] (p,) of a component at its p ports, complex amplitudes; station:
    where it stands.
    """

    name: str
    station: str
    motion: np.ndarray
    force: np.ndarray


def forces_of_components(loop: ShaftLoop, s: complex, x: np.ndarray) -> Iterator[ComponentForce]:
    """The force of every component for states x (n,) at s; components without one are left out."""
    plant = loop.plant
    machine, point = plant.machine, plant.point

    def motion(names: list[str]) -> np.ndarray:
        rows = [plant.system.outputs.index(f"q_{name}") for name in names]
        return np.asarray(plant.system.C[rows] @ x)

    # magnets: k_i i + k_s q along each axis
    if machine.bearings:
        k_i, k_s = magnet_coefficients(machine, point)
        at = motion(list(plant.axes))
        current = loop.currents(s, x) if loop.law is not None else np.zeros(len(at))
        force = k_i * current + k_s * at
        for k, bearing in enumerate(machine.bearings):
            axes = slice(2 * k, 2 * k + 2)
            yield ComponentForce(f"magnet {bearing.name}", bearing.name, at[axes], force[axes])

    # registered effects: -(K + s D + s^2 M) q + H (s I - A)^-1 B q
    for names, reaction in reactions(machine, point):
        at = motion(list(names))
        dynamic = reaction.stiffness + s * reaction.damping + s**2 * reaction.mass
        force = -dynamic @ at
        if reaction.n_states:
            inner = np.linalg.solve(s * np.eye(reaction.n_states) - reaction.A, reaction.B @ at)
            force = force + reaction.H @ inner
        matrices = (reaction.stiffness, reaction.damping, reaction.mass)
        if reaction.n_states or any(matrix.any() for matrix in matrices):
            station = names[0].rpartition("_")[0]
            yield ComponentForce(station, station, at, force)

    # seals: -(K + s C + s^2 M) q, and the states of those that depend on the frequency
    for item in machine.seals:
        at = motion([f"{item.name}_x", f"{item.name}_y"])
        rational = seal_rational.has_states(item)
        stiff, damping, mass = seals.matrices(constant_coefficients(machine, item, point))
        force = -(stiff + s * damping + s**2 * mass) @ at
        if rational and point.seal_pressure > 0:
            system = seal_rational.system(seal_model(machine, item, point), item.name)
            given = [system.inputs.index(f"q_{item.name}_{axis}") for axis in "xy"]
            taken = [system.outputs.index(f"h_{item.name}_{axis}") for axis in "xy"]
            inner = np.linalg.solve(s * np.eye(system.n_states) - system.A, system.B[:, given] @ at)
            force = force + system.C[taken] @ inner + system.D[np.ix_(taken, given)] @ at
        yield ComponentForce(f"seal {item.name}", item.name, at, force)


# Who costs what phase: the signal from the shaft's displacement to the current that makes force,
# element after element, at every bending mode.
#
#    sensor lag    1/(1 + s/b) of the machine file (demodulation and what filters the signal)
#    controller    K(e^{sT}) on its own axis, as it is sampled
#    computing     e^{-s n T}, n whole samples; where [[chain]] says what they are made of, its
#                  elements (filters by their delay at low frequencies, as in the loop) and the rest
#    hold          (1 - e^{-sT})/(s T), half a sample late
#    amplifier     i/u of the coil's current, at standstill
#    eddy currents e/(s + e), of order "twice-first"
#
# The modes are the free rotor's at rest: what no controller moves. Phases are those of each axis'
# own path; all others at rest.


_MOST = 6  # bending modes
CONTROLLER = "controller"


@dataclass(frozen=True, slots=True, eq=False)
class PhaseBudget:
    """Phases [rad] of a control axis, elements (e,) by frequencies (m,) [rad/s].

    axes: those that have it, alike to 1e-9. phases (e, m): negative late; ``total`` (m,) is that
    of the whole path but for the sign of the feedback. notes: on filters that the loop has as dead
    time.
    """

    axes: tuple[str, ...]
    frequencies: np.ndarray
    elements: tuple[str, ...]
    phases: np.ndarray
    notes: tuple[str, ...] = ()

    @property
    def total(self) -> np.ndarray:
        return np.asarray(self.phases.sum(axis=0))

    @property
    def cost(self) -> np.ndarray:
        """What all but the controller take (m,) [rad]."""
        own = self.elements.index(CONTROLLER)
        return np.asarray(self.total - self.phases[own])


def phase_budgets(loop: ShaftLoop, timing: Timing | None) -> tuple[PhaseBudget, ...]:
    """The budget of every axis, axes with the same one together; () without a controller.

    timing: the loop's, None for a continuous one.
    """
    law, machine = loop.law, loop.plant.machine
    if law is None:
        return ()
    omega = free_bending(machine, None if law.dt is None else np.pi / law.dt)
    if not len(omega):
        return ()
    rows: dict[str, np.ndarray] = {}
    drive = machine.amplifier
    sensed = frequency_response(sensor.linearised(machine.sensor_pairs, machine.axes), omega)
    acting = np.array([np.diag(loop.gain(1j * w)) for w in omega])
    rows["sensor lag"] = np.angle(sensed.values.sum(axis=2))

    # the law as it acts holds delay and hold, which are known exactly
    ones = np.ones((1, len(machine.axes)))
    late = np.zeros((2, len(omega)))
    if law.dt is not None:
        samples = 0 if timing is None else timing.delay_samples
        late = -np.array([samples, 0.5])[:, None] * omega * law.dt
    rest = acting * np.exp(-1j * late.sum(axis=0))[:, None]
    rows[CONTROLLER] = np.angle(rest)
    if law.dt is not None:
        for name, row in _computing(machine, timing, omega, late[0]):
            rows[name] = row[:, None] * ones
        rows["hold"] = late[1][:, None] * ones
    coil = drive
    if drive.order == "twice-first":
        coil = replace(drive, order="first", eddy_bandwidth=None)
    current = frequency_response(amplifier.linearised(coil, ["a"]), omega).values[:, 0, 0]
    rows["amplifier"] = np.unwrap(np.angle(current))[:, None] * ones
    if drive.order == "twice-first":
        eddy = -np.arctan(omega / float(drive.eddy_bandwidth or np.inf))
        rows["eddy currents"] = eddy[:, None] * ones

    names = tuple(rows)
    phases = np.array([rows[name] for name in names])  # (e, m, a)
    budgets: list[PhaseBudget] = []
    for a, axis in enumerate(machine.axes):
        own = phases[:, :, a]
        for k, known in enumerate(budgets):
            if np.allclose(known.phases, own, rtol=0.0, atol=1e-9):
                budgets[k] = replace(known, axes=(*known.axes, axis))
                break
        else:
            budgets.append(PhaseBudget((axis,), omega, names, own, _filters(machine, omega)))
    return tuple(budgets)


def _computing(
    machine: Machine, timing: Timing | None, omega: np.ndarray, whole: np.ndarray
) -> list[tuple[str, np.ndarray]]:
    """(name, phase (m,)) of what the loop's whole samples (phase ``whole``) are made of.

    Delays that were given by the caller, or that a controller has of its own, are not the file's
    chain.
    """
    total = sum(element.dead_time for element in machine.chain)
    told = timing is not None and timing.source.startswith("machine file")
    if not machine.chain or not told:
        return [("computing", whole)]
    named = [
        (f"{element.kind}: {element.name}", -omega * element.dead_time) for element in machine.chain
    ]
    return [*named, ("rest of the whole samples", whole + omega * total)]


def _filters(machine: Machine, omega: np.ndarray) -> tuple[str, ...]:
    """What a filter's own phase is beside the dead time that stands for it, at the last mode below
    its corner.
    """
    found = []
    for element in machine.chain:
        if element.corner is None:
            continue
        below = omega[omega < element.corner]
        w = float(below[-1] if len(below) else omega[0])
        own, counted = np.degrees([element.phase(w), -w * element.dead_time])
        found.append(
            f"{element.name}: {own:.3g} deg of its own at {w / (2 * np.pi):.4g} Hz, where the loop "
            f"has {counted:.3g} deg; its roll-off is not in the loop"
        )
    return tuple(found)


def free_bending(machine: Machine, highest: float | None = None) -> np.ndarray:
    """Bending frequencies (m,) [rad/s] of the free rotor at rest, below ``highest`` [rad/s]."""
    rotor = finite_element_rotor(machine)
    count = min(_MOST, bending_modes_of(rotor))
    frequencies = np.asarray(free_modes(rotor, count).frequencies)[4::2]
    return frequencies if highest is None else frequencies[frequencies < highest]
