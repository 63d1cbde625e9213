"""Landing on one thrust face: the motion along the axis when the thrust bearing loses its power
with the others.

From rest at the middle the process thrust F_0 pushes the rotor (mass m) along z, against the
coupling (k_c, d_c), until the collar meets a stop at c:

    m z'' = F_0 - k_c z - d_c z' - N,    N = max(0, k (z - c) + d z') beyond the stop, else 0:

the stop's spring and damper of the machine file, which never pull (as the rig has them). Without
coupling and damping F_0 (c + z) = k z^2 / 2 at the turning point z beyond the stop, so that N is
there

    F_0 (1 + sqrt(1 + 2 k c / F_0)).

Between two changes of N the equation is linear; each such phase is integrated up to the next.
Left out: what the magnets still pull as their flux decays (the rig has it, scenario power-loss of
the axis), friction on the face, and a weight along the axis beyond what the file's load says.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from ambrose.annexes.touchdown.verdict import Row
from ambrose.machine.attachment import attached
from ambrose.machine.description import OperatingPoint
from ambrose.machine.machine import Machine
from ambrose.machine.thrust import ThrustBearing

_NOTE = "along the axis: from rest at the middle, under the point's process thrust"
_BETWEEN = 24  # samples of a step of the integration
_PHASES = 400  # bounces end long before
_AT_REST = 1e-2  # of the way: within it of where it ends, the rotor has come to rest


@dataclass(frozen=True, slots=True, eq=False)
class AxialDrop:
    """The motion along the axis after the thrust bearing has lost its power.

    bearing: its name; side: the stop that is met; thrust [N], signed along z; way [m]: from the
    middle to that stop; gap [m]: the magnet's air gap there; bound [N]: the largest force of a stop
    without damping, of a rotor without coupling. time [s], place [m] along z and force [N] of the
    stop, one row each (t,). settled [s]: from when on it stays within 1 % of the way of where it
    rests (None: not within the time looked at).
    """

    bearing: str
    side: str
    thrust: float
    way: float
    gap: float
    bound: float
    time: np.ndarray
    place: np.ndarray
    force: np.ndarray
    settled: float | None

    @property
    def first_contact(self) -> float | None:
        """[s]; None: the stop is not met."""
        beyond = np.flatnonzero(self.force > 0)
        return float(self.time[beyond[0]]) if len(beyond) else None

    @property
    def largest_force(self) -> float:
        """[N]."""
        return float(self.force.max())

    @property
    def reach(self) -> float:
        """The largest displacement [m]."""
        return float(np.abs(self.place).max())

    def to_dict(self) -> dict[str, Any]:
        """Plain data, SI; the time of what never came is null."""
        return {
            "side": self.side,
            "thrust": self.thrust,
            "first_contact": self.first_contact,
            "largest_force_0p": self.largest_force,
            "largest_force_0p_without_damping": self.bound,
            "largest_displacement_0p": self.reach,
            "settled": self.settled,
        }


def axial_drops(
    machine: Machine, mass: float, point: OperatingPoint, duration: float
) -> tuple[AxialDrop, ...]:
    """Of every thrust bearing that states its stops and has a thrust at the point; mass [kg]: the
    rotor's; duration [s]: looked at.
    """
    found = []
    for _, part in attached(machine):
        if not isinstance(part, ThrustBearing) or part.touchdown_gap is None:
            continue
        thrust = sum(load.force for load in part.loads if load.point == point.label)
        if thrust:
            found.append(axial_drop(part, mass, thrust, duration))
    return tuple(found)


def axial_drop(part: ThrustBearing, mass: float, thrust: float, duration: float) -> AxialDrop:
    """The motion of a rotor of this mass [kg] under a constant thrust [N] along z, from rest at the
    middle, for at most ``duration`` [s].
    """
    assert part.touchdown_gap is not None
    right = thrust > 0
    way = part.touchdown_gap[right]
    # along the thrust: only the stop that it pushes towards is met
    time, place, force = _motion(part, mass, abs(thrust), way, duration)
    sign = 1.0 if right else -1.0
    return AxialDrop(
        part.name,
        "right" if right else "left",
        thrust,
        way,
        part.gap[right],
        landing_force(abs(thrust), way, part.stop_stiffness),
        time,
        sign * place,
        force,
        _settled(part, abs(thrust), way, time, place),
    )


def _motion(
    part: ThrustBearing, mass: float, thrust: float, way: float, duration: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(time, place along the thrust, force of the stop)."""
    from scipy.integrate import solve_ivp

    k, d = part.stop_stiffness, part.stop_damping

    def stop(place: Any, velocity: Any) -> Any:
        """N of a rotor beyond the stop, were the stop able to pull."""
        return k * (place - way) + d * velocity

    def slope(_: float, z: np.ndarray, touching: bool) -> list[float]:
        spring = part.coupling_stiffness * z[0] + part.coupling_damping * z[1]
        met = stop(z[0], z[1]) if touching else 0.0
        return [z[1], (thrust - spring - met) / mass]

    def change(_: float, z: np.ndarray, touching: bool) -> float:
        # beyond the stop, and pushed by it: the sign of this changes with N
        return float(min(z[0] - way, stop(z[0], z[1]) / k))

    change.terminal = True  # type: ignore[attr-defined]
    parts: list[tuple[np.ndarray, np.ndarray, np.ndarray]] = []
    now, state = 0.0, np.zeros(2)
    touching = False
    for _phase in range(_PHASES):
        # a contact that lasts dies out as e^(-d t / 2 m), after twenty such times to 2e-9
        lasts = 40 * mass / d if touching and d else duration
        change.direction = -1.0 if touching else 1.0  # type: ignore[attr-defined]
        done = solve_ivp(
            slope,
            (now, min(duration, now + lasts)),
            state,
            events=change,
            args=(touching,),
            dense_output=True,
            rtol=1e-9,
            atol=[1e-13, 1e-10],
        )
        steps = np.arange(len(done.t) * _BETWEEN - _BETWEEN + 1) / _BETWEEN
        at = np.interp(steps, np.arange(len(done.t)), done.t)
        place, velocity = done.sol(at)
        force = np.maximum(stop(place, velocity), 0.0) if touching else np.zeros(len(at))
        parts.append((at, place, force))
        now, state = float(done.t[-1]), done.y[:, -1]
        if done.status != 1:
            break
        touching = not touching
        # just past the change, so that the next phase does not end where it begins
        state = state + np.array([state[1], 0.0]) * 1e-12
    together = [np.concatenate(item) for item in zip(*parts, strict=True)]
    return together[0], together[1], together[2]


def _settled(
    part: ThrustBearing, thrust: float, way: float, time: np.ndarray, place: np.ndarray
) -> float | None:
    """From when on [s] the rotor stays near where it rests; None: not within the time."""
    # F_0 = k_c z, short of the stop where the coupling holds it, else F_0 = k_c z + k (z - c)
    held, k = part.coupling_stiffness, part.stop_stiffness
    resting = thrust / held if held else math.inf
    if resting > way:
        resting = (thrust + k * way) / (held + k)
    away = np.flatnonzero(np.abs(place - resting) > _AT_REST * way)
    if not len(away) or away[-1] == len(time) - 1:
        return None
    return float(time[away[-1] + 1])


def thrust_rows(drops: tuple[AxialDrop, ...]) -> tuple[Row, ...]:
    """What the motion along the axis costs: the force on the face, and how near the collar comes to
    its magnet.
    """
    rows = []
    for drop in drops:
        place = f"{drop.bearing} {drop.side}"
        bound = f"{_NOTE}; at most {drop.bound / 1e3:.3g} kN without the stop's damping"
        force = Row(
            "thrust_face", place, "force on the thrust face", drop.largest_force, "N", note=bound
        )
        title = "largest displacement over the magnet's gap"
        rows += [force, Row("thrust_gap", place, title, drop.reach / drop.gap, "-", "<=", 1.0)]
    return tuple(rows)


def landing_force(thrust: float, way: float, stiffness: float) -> float:
    """F_0 (1 + sqrt(1 + 2 k c / F_0)) [N] at a thrust [N], a way [m] and a stiffness [N/m]."""
    return thrust * (1 + math.sqrt(1 + 2 * stiffness * way / thrust))
