"""One drop: the magnets lose their power, the rotor falls into its touchdown bearings and coasts
down; perhaps the magnets come on again.

Modelled: rotor in a few bending modes with gyroscopics, seals and couplings linear about the
centre; weight; unbalance W^2; contact with stiffness, damping and friction (Stribeck); race that
spins up, rolling elements after Hertz with preload, ring on its mount with a stop; drive, windage
and friction that slow the rotor. Not modelled: wear, oil films, heat that changes friction or
clearance, motion along the axis (campaign.py has it), the reaction of unbalance on the spin.
"""

import hashlib
import math
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from ambrose.annexes.touchdown.drop_kernel import Case, Rig, SampledLaw, Work
from ambrose.core.checks import InvalidInput, NumericalFailure
from ambrose.machine.description import OperatingPoint
from ambrose.machine.machine import Machine
from ambrose.model.assemble import attached_rotor, modes_of
from ambrose.model.effects import magnet, touchdown as contact_law
from ambrose.model.effects.rotor import (
    STANDARD_GRAVITY,
    displacement_row,
    finite_element_rotor,
    gravity_load,
    mass_properties,
)
from ambrose.model.effects.stations import Clearance
from ambrose.model.effects.touchdown import (
    Bearing,
    element_force,
    inverses,
    longest_steps,
    parameters,
)
from ambrose.model.plant import measured_ports, top_speed
from ambrose.model.static_load import magnet_coefficients

# The rotor as it falls: no magnets, in modes of the free rotor, and the touchdown bearings that it
# meets, as numbers.
#
# The rotor is that of the plant (``model.assemble.attached_rotor``) with the magnets' negative
# stiffness taken out again: shaft, discs, gyroscopics, seals and couplings at an operating point,
# and the supports. Seals with states have their static part here.


def stator_receptance(numbers: Bearing, w: float, load: float = 0.0) -> complex:
    """Displacement per force [m/N] of what the rotor touches, at w [rad/s]: race, elements, ring,
    mount. The elements count by their secant stiffness under a load [N] that turns with the whirl;
    at zero load by that of a thousandth of the contact's penetration.
    """
    behind = 0.0j  # of the ring
    if numbers.ring_mass:
        stiffness = numbers.mount_stiffness - numbers.ring_mass * w**2
        behind = 1 / (stiffness + 1j * w * numbers.mount_damping)
    if not numbers.race_mass:
        return behind
    # secant of the elements at their load; the race's own inertia is small beside it
    deflection = elements_deflection(numbers, max(load, 1.0))
    elements = max(load, 1.0) / deflection + 1j * w * numbers.element_damping
    return 1 / (1 / (behind + 1 / elements) - numbers.race_mass * w**2)


def elements_deflection(numbers: Bearing, load: float) -> float:
    """The deflection [m] of the rolling elements under a load [N] above zero, the inverse of
    ``element_force``.
    """
    K, p = numbers.hertz, numbers.preload
    alone = (load / K) ** (2 / 3) - p  # the row behind is off: F = K (p + d)^1.5
    if alone >= p:
        return alone
    # both rows: Newton's method from the slope at the centre, 3 K sqrt(p)
    deflection = load / (3 * K * math.sqrt(p))
    for _ in range(8):
        front, back = p + deflection, max(p - deflection, 0.0)
        slope = 1.5 * K * (math.sqrt(front) + math.sqrt(back))
        deflection -= (element_force(deflection, K, p) - load) / slope
    return deflection


@dataclass(frozen=True, slots=True, eq=False)
class FallenRotor:
    """M q'' + (D + W G) q' + K q = f in n coordinates, at touchdown bearings b.

    rows (b, 2, n): displacement along the global x and y at every touchdown bearing; weight (n,)
    [N] along its coordinates (zero without gravity); mass [kg] and polar_inertia [kg m2] of the
    rotor. speed [rad/s] of the operating point. seal_names, seal_gaps (s,) [m] (radial) and
    seal_rows (s, 2, n): where else it must not touch. sensor_rows (2b, n): what the sensors of
    every axis read.
    """

    names: tuple[str, ...]
    bearings: tuple[Bearing, ...]
    mass_matrix: np.ndarray
    damping: np.ndarray
    gyroscopic: np.ndarray
    stiffness: np.ndarray
    rows: np.ndarray
    weight: np.ndarray
    mass: float
    polar_inertia: float
    speed: float
    seal_names: tuple[str, ...]
    seal_gaps: np.ndarray
    seal_rows: np.ndarray
    sensor_rows: np.ndarray

    def receptance(self, w: float) -> np.ndarray:
        """Backward receptances (b, b) [m/N] at w [rad/s]: forces and displacements that circle
        against the spin.

        Against the spin: x = cos wt, y = -sin wt, the phasors (1, j). Of a rotor and stator alike
        in all directions the answer circles as well; else this is its part that does.
        """
        dynamic = (
            self.stiffness
            - w**2 * self.mass_matrix
            + 1j * w * (self.damping + self.speed * self.gyroscopic)
        )
        backward = self.rows[:, 0] + 1j * self.rows[:, 1]  # (1, j) of a force, as a row
        answer = np.linalg.solve(dynamic, backward.T)
        return 0.5 * backward.conj() @ answer


def fallen_rotor(
    machine: Machine, point: OperatingPoint, bending_modes: int | None = None
) -> FallenRotor:
    """The rotor of a machine at an operating point, without its magnets. bending_modes: per plane
    (None: the full model). Raises InvalidInput where a bearing has no touchdown_gap, or a seal is
    narrower than the touchdown gap.
    """
    refuse(machine)
    rotor = finite_element_rotor(machine)
    free = attached_rotor(machine, point, rotor, bending_modes)
    outputs = dict(zip(free.outputs, free.C, strict=True))
    axes = np.array([outputs[f"q_{axis}"] for axis in machine.axes])

    # the plant's -k_s N^T N out again
    k_s = magnet_coefficients(machine, point)[1]
    stiffness = free.stiffness + axes.T @ (k_s[:, None] * axes)

    # zeta, eta of each bearing to the global x, y
    rows = []
    for bearing, (zeta, eta) in zip(
        machine.bearings, axes.reshape(-1, 2, axes.shape[1]), strict=True
    ):
        c, s = math.cos(bearing.angle), math.sin(bearing.angle)
        rows.append([c * zeta - s * eta, s * zeta + c * eta])
    modes = modes_of(machine, rotor, bending_modes)
    count = free.n
    weight = np.zeros(count)
    weight[: modes.shapes.shape[1]] = modes.shapes.T @ gravity_load(
        rotor, machine.gravity_direction
    )
    seals = seal_gaps(machine)
    seal_rows = np.zeros((len(seals), 2, count))
    for i, (_, position, _) in enumerate(seals):
        for k, angle in enumerate((0.0, math.pi / 2)):
            line = displacement_row(rotor, position, angle) @ modes.shapes
            seal_rows[i, k, : len(line)] = line
    sensors = np.zeros((len(machine.axes), count))
    for i, port in enumerate(measured_ports(machine)):
        line = displacement_row(rotor, port.position, port.direction) @ modes.shapes
        sensors[i, : len(line)] = line
    properties = mass_properties(rotor)
    return FallenRotor(
        tuple(bearing.name for bearing in machine.bearings),
        tuple(parameters(machine, bearing) for bearing in machine.bearings),
        free.mass,
        free.damping,
        free.gyroscopic,
        stiffness,
        np.array(rows),
        weight,
        properties.mass,
        properties.polar_inertia,
        point.speed,
        tuple(name for name, _, _ in seals),
        np.array([gap for _, _, gap in seals]),
        seal_rows,
        sensors,
    )


def seal_gaps(machine: Machine) -> list[tuple[str, float, float]]:
    """(name, position [m], radial clearance [m]) of seals and of [[clearance]] whose file states
    one.
    """
    found = []
    for seal in machine.seals:
        part = seal if seal.geometry is None else seal.geometry
        sides = (getattr(part, "inlet_clearance", None), getattr(part, "exit_clearance", None))
        gaps = [gap for gap in sides if gap]
        if gaps:
            found.append((f"seal {seal.name}", seal.position, min(gaps)))
    for room in machine.parts(Clearance):
        found.append((f"clearance {room.name}", room.position, room.diametral / 2))
    return found


def refuse(machine: Machine) -> None:
    """What cannot land. Raises InvalidInput."""
    fall = "let it fall in ambrose simulate with the scenario power-loss"
    machine.across_the_shaft("landing is of the radial axes", fall)
    if not machine.bearings:
        raise InvalidInput(
            f"{machine.name} has no magnetic bearing to fall out of; give [[bearing]] with a "
            "touchdown_gap"
        )
    for bearing in machine.bearings:
        if bearing.touchdown_gap is None:
            raise InvalidInput(
                f"[[bearing]] {bearing.name} has no touchdown_gap to land in; add it to the "
                "machine file"
            )
    widest = max(machine.bearings, key=lambda bearing: bearing.touchdown_gap or 0.0)
    for name, _, gap in seal_gaps(machine):
        if widest.touchdown_gap is not None and widest.touchdown_gap > gap:
            raise InvalidInput(
                f"[[bearing]] {widest.name}: touchdown_gap {widest.touchdown_gap:g} m is above the "
                f"clearance {gap:g} m of {name}, in which the rotor would land first; make "
                "the touchdown gap smaller or that clearance larger"
            )


FIGURES = 14  # per bearing, see drop_kernel
_LOSSES = 7
_TURN = 0.5  # [rad] per step of the rotor's own fastest oscillation
# [s]: as closely as a first contact is timed; and a flight in which gravity moves nothing much
_LONGEST_STEP, _LONGEST_FLIGHT = 2e-5, 1e-4
LEAST_STEP = 1e-8  # [s]: a drop takes seconds then
_FAR = 1 << 60  # steps: never


@dataclass(frozen=True, slots=True)
class Drop:
    """How the magnets are lost. speed [rad/s]; unbalance (b,) [kg m] at the bearings and its angles
    (b,) [rad] from x; friction, mount_stiffness, mount_damping: factors on the file's values.
    """

    speed: float
    unbalance: tuple[float, ...]
    angles: tuple[float, ...]
    friction: float = 1.0
    mount_stiffness: float = 1.0
    mount_damping: float = 1.0


@dataclass(frozen=True, slots=True, eq=False)
class Fall:
    """What a drop gave.

    figures (b, 14) and seals (s,), as the kernel has them (squares as lengths); energy (b + 7,)
    [J]: slip per bearing, contact, elements, mounts, rotor, drag, coast-down, magnets. state: the
    last one. log (t, 2 + 8 b): time, speed, and per bearing x, y, normal force, spin of the race,
    x, y of what is met, slip energy, load of the elements.
    """

    figures: np.ndarray
    seals: np.ndarray
    energy: np.ndarray
    state: np.ndarray
    log: np.ndarray


def slip_of(fallen: FallenRotor, fall: Fall) -> np.ndarray:
    """Slip energy (b,) [J] until the races turn with the rotor: that of the drop, and what is left.

    A race of inertia I at w, driven by friction F at R while the rotor keeps W: I w' = F R, so that
    the slip takes the integral of F R (W - w) = I (W - w)^2 / 2 until w = W.
    """
    b = len(fallen.bearings)
    spin = fall.state[2 * len(fallen.mass_matrix) + 8 * b :]
    inertia = np.array([item.race_inertia * bool(item.race_mass) for item in fallen.bearings])
    left = inertia * np.maximum(spin[b] - spin[:b], 0.0) ** 2 / 2
    touched = fall.figures[:, 0] >= 0
    return np.asarray(fall.energy[:b] + left * touched)


@cache
def compiled() -> Any:
    """The compiled kernel; the first run on a computer compiles it."""
    from ambrose.annexes.touchdown import drop_kernel

    digest = hashlib.sha256()
    for module in (drop_kernel, contact_law, magnet):
        digest.update(Path(str(module.__file__)).read_bytes())
    return drop_kernel.entry_point(int.from_bytes(digest.digest()[:6], "big"))


def mobilities(fallen: FallenRotor) -> np.ndarray:
    """What a radial force at every bearing makes the rotor do at once (b,) [1/kg]."""
    inverse = np.linalg.inv(fallen.mass_matrix)
    return np.einsum("bn,nm,bm->b", fallen.rows[:, 0], inverse, fallen.rows[:, 0])


def build(machine: Machine, fallen: FallenRotor, *, tally: bool = False) -> tuple[Rig, float]:
    """(the rig, its step [s]) of a machine's fallen rotor."""
    windage = 0.0
    down = machine.coast_down
    if down is not None and down.windage_torque:
        at = down.windage_speed or top_speed(machine)
        windage = down.windage_torque / at**2
    return rig_of(fallen, windage=windage, tally=tally)


def rig_of(fallen: FallenRotor, *, windage: float = 0.0, tally: bool = False) -> tuple[Rig, float]:
    """(the rig without magnets, its step [s])."""
    inverse = np.linalg.inv(fallen.mass_matrix)
    mobility = mobilities(fallen)
    heavy = fallen.mass * 10 * 9.81 / len(fallen.bearings)  # usual first peaks
    steps = [longest_steps(*pair, heavy) for pair in zip(fallen.bearings, mobility, strict=True)]
    # the rotor's own fastest mode
    fastest = math.sqrt(max(np.abs(np.linalg.eigvals(inverse @ fallen.stiffness)).max(), 1.0))
    turning = np.abs(np.linalg.eigvals(inverse @ fallen.gyroscopic)).max() * fallen.speed
    own = _TURN / max(fastest + turning, 1.0)
    dt = min(own, _LONGEST_STEP, *(contact for contact, _ in steps))
    if dt < LEAST_STEP:
        raise InvalidInput(
            f"a drop would need steps of {dt:.2g} s; make stiffness or damping in "
            "[bearing.touchdown] smaller, or the masses of .race and .mount larger"
        )
    free = min(own, _LONGEST_FLIGHT, *(flight for _, flight in steps))
    n, b = len(fallen.mass_matrix), len(fallen.bearings)
    count, gaps = len(fallen.seal_gaps), fallen.seal_gaps
    rows = np.ascontiguousarray(fallen.rows)
    return Rig(
        inverse @ fallen.stiffness,
        inverse @ fallen.damping,
        inverse @ fallen.gyroscopic,
        rows,
        np.ascontiguousarray(inverse @ rows.reshape(2 * b, n).T),
        inverse @ fallen.weight,
        np.ascontiguousarray(fallen.seal_rows.reshape(count, 2, n) / gaps[:, None, None]),
        np.array(fallen.bearings, dtype=float),
        np.array([inverses(*pair) for pair in zip(fallen.bearings, mobility, strict=True)]),
        fallen.polar_inertia,
        windage,
        max(int(free / dt), 1),
        np.ascontiguousarray(fallen.damping),
        tally,
        np.zeros((b, 2)),
        np.zeros((b, 10)),
        np.zeros((2 * b, n)),
        0.0,
    ), dt


def no_law(axes: int) -> SampledLaw:
    """A controller that is never asked."""
    return SampledLaw(
        np.zeros((0, 0)),
        np.zeros((0, axes)),
        np.zeros((axes, 0)),
        np.zeros((axes, axes)),
        0,
        _FAR,
        0.0,
        0.0,
    )


def brake_of(machine: Machine) -> float:
    """The torque [N m] of drive and friction that slows the rotor."""
    down = machine.coast_down
    return 0.0 if down is None else down.brake_torque + down.friction_torque


def case_of(fallen: FallenRotor, rig: Rig, drop: Drop, brake: float) -> tuple[Case, np.ndarray]:
    """(the case, its first state): at the centre, on the orbit that unbalance makes of the free
    rotor, as it is levitated softly above its rigid modes. A rotor without weight across its axis
    is pushed along x, as fast as it would have fallen through the clearance (assumed).

    Unbalance u at the angle a, in complex notation u W^2 e^{j (W t + a)}: cosine and sine parts of
    the generalised force.
    """
    n, b = len(fallen.mass_matrix), len(fallen.bearings)
    u, angle = np.array(drop.unbalance), np.array(drop.angles)
    x, y = fallen.rows[:, 0], fallen.rows[:, 1]
    a = u * np.cos(angle) @ x + u * np.sin(angle) @ y
    s = -u * np.sin(angle) @ x + u * np.cos(angle) @ y
    state = np.zeros(2 * n + 11 * b + 2 + b + _LOSSES)
    W = drop.speed
    if u.any() and W:
        # q = Re((a - j s) W^2 e^{j W t}) filtered by the dynamic stiffness
        turning = fallen.damping + W * fallen.gyroscopic
        dynamic = fallen.stiffness - W**2 * fallen.mass_matrix + 1j * W * turning
        q = np.linalg.solve(dynamic, (a - 1j * s) * W**2)
        state[:n], state[n : 2 * n] = q.real, (1j * W * q).real
    if not fallen.weight.any():
        # v = sqrt(2 g c) of the whole rotor along x: least squares over the bearings
        pushed = math.sqrt(2 * STANDARD_GRAVITY * max(item.clearance for item in fallen.bearings))
        wanted = np.tile([pushed, 0.0], b)
        state[n : 2 * n] += np.linalg.lstsq(fallen.rows.reshape(2 * b, n), wanted, rcond=None)[0]
    state[2 * n + 9 * b] = W
    inverse = np.linalg.inv(fallen.mass_matrix)
    return Case(
        inverse @ a,
        inverse @ s,
        drop.friction,
        drop.mount_stiffness,
        drop.mount_damping,
        brake,
    ), state


def room(rig: Rig, states: int = 0) -> Work:
    """Room for one drop."""
    n, b = len(rig.stiffness), len(rig.bearings)
    return Work(
        np.zeros((3, 2 * n + 11 * b + 2 + b + _LOSSES)),
        np.zeros((n, n)),
        np.zeros((b, 3)),
        np.zeros((b, 6)),
        np.zeros((b, 4)),
        np.zeros((2, states)),
        np.zeros(2 * b),
        np.zeros(2 * b),
    )


def run(
    rig: Rig,
    case: Case,
    state: np.ndarray,
    duration: float,
    dt: float,
    *,
    rows: int = 0,
    law: SampledLaw | None = None,
    held: np.ndarray | None = None,
    start: float = math.inf,
) -> Fall:
    """One drop of ``duration`` [s]; rows: of its log, at most. law: from ``start`` [s] on, with its
    states ``held``. Raises
    NumericalFailure where the motion overflows.
    """
    b = len(rig.bearings)
    steps = math.ceil(duration / dt)
    every = -(-steps // rows) if rows else 0
    control = no_law(2 * b) if law is None else law
    work = room(rig, len(control.A))
    if held is not None:
        work.states[0] = held
    figures, seals = np.zeros((b, FIGURES)), np.zeros(len(rig.seals))
    figures[:, 0] = -1.0
    log = np.full((rows, 2 + 8 * b), np.nan)
    n = len(rig.stiffness)
    work.place[:, :2] = rig.rows @ state[:n]
    work.place[:, 4:6] = rig.rows @ state[n : 2 * n]
    z = state.copy()
    first = _FAR if not math.isfinite(start) else round(start / dt)
    done = compiled()(rig, control, case, z, steps, dt, first, every, work, figures, seals, log)
    if done < steps:
        raise NumericalFailure(
            f"the drop overflowed after {done * dt:.4g} s; look for a mass or inertia in "
            "[bearing.touchdown.race] or .mount that is far too small"
        )
    figures[:, [5, 11]] = np.sqrt(figures[:, [5, 11]])
    lost = len(z) - b - _LOSSES
    return Fall(figures, np.sqrt(seals), z[lost:], z, log[np.isfinite(log[:, 0])])
