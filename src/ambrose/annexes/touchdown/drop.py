"""One drop: the magnets lose their power, the rotor falls into its touchdown bearings and coasts
down; perhaps the magnets come on again.

Modelled: rotor in a few bending modes with gyroscopics, seals and couplings linear about the
centre; weight; unbalance W^2; contact with stiffness, damping and friction (Stribeck); race that
spins up, rolling elements after Hertz with preload, ring on its mount with a stop; drive, windage
and friction that slow the rotor. Not modelled: wear, oil films, heat that changes friction or
clearance, motion along the axis (thrust_face.py has it), the reaction of unbalance on the spin.
"""

from __future__ import annotations

import hashlib
import math
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from ambrose.annexes.touchdown.arrays import Case, Rig, SampledLaw, Work
from ambrose.annexes.touchdown.fallen import FallenRotor
from ambrose.core.checks import InvalidInput, NumericalFailure
from ambrose.machine.machine import Machine
from ambrose.model.effects import magnet
from ambrose.model.effects import touchdown as contact_law
from ambrose.model.effects.rotor import STANDARD_GRAVITY
from ambrose.model.effects.touchdown import inverses, longest_steps
from ambrose.model.plant import top_speed

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
