"""Many drops: friction, mount, unbalance and speed as nobody knows them, and what comes of it.

The cases are drawn at once from one seed, so that they do not depend on how many processors work on
them. A drop that turns three times against its spin without going back is said to whirl: a count on
the simulated motion, not a statement on stability.
"""

import math
import os
from collections.abc import Callable
from concurrent.futures import FIRST_COMPLETED, ThreadPoolExecutor, wait
from dataclasses import dataclass, replace
from threading import Event
from typing import Any

import numpy as np

from ambrose.annexes.touchdown.drop import (
    FIGURES,
    Drop,
    FallenRotor,
    brake_of,
    build,
    case_of,
    compiled,
    run,
    slip_of,
)
from ambrose.core.checks import NumericalFailure
from ambrose.machine.description import OperatingPoint
from ambrose.machine.machine import Machine
from ambrose.machine.part import Touchdown, TouchdownLimits
from ambrose.machine.thrust import ThrustBearing
from ambrose.model.effects.touchdown import Bearing

# What landings cost a touchdown bearing, against the limits of its file.


@dataclass(frozen=True, slots=True)
class Row:
    """One quantity of one place. value and limit [SI]; relation "<=" or ">="; passed None: for
    information.
    """

    name: str
    place: str
    title: str
    value: float
    unit: str
    relation: str = "<="
    limit: float | None = None
    note: str = ""

    @property
    def passed(self) -> bool | None:
        """Whether the limit holds; None without one."""
        if self.limit is None:
            return None
        return self.value <= self.limit if self.relation == "<=" else self.value >= self.limit

    def to_dict(self) -> dict[str, Any]:
        """Plain data; what is not finite is null."""
        value = self.value if math.isfinite(self.value) else None
        return {
            "name": self.name,
            "place": self.place,
            "value": value,
            "unit": self.unit,
            "relation": self.relation,
            "limit": self.limit,
            "passed": self.passed,
            "note": self.note,
        }


def judge_landing(
    machine: Machine,
    fallen: FallenRotor,
    force: np.ndarray,
    load: np.ndarray,
    slip: np.ndarray,
    reach: np.ndarray,
    seals: np.ndarray,
    after: float,
) -> tuple[Row, ...]:
    """Rows of one drop or of a campaign. force, load [N] and slip [J] (d, b), until the races turn
    with the rotor; reach (d, b) [m]: largest displacement; seals (d, s): displacement over the gap;
    after [J]: slip of the run-down at every bearing that was met.
    """
    rows = []
    for k, bearing in enumerate(machine.bearings):
        table = bearing.touchdown or Touchdown()
        limits = table.limits or TouchdownLimits()
        race, name = table.race, bearing.name
        largest = float(force[:, k].max())
        cost = slip[:, k] + after * (force[:, k] > 0)
        rows.append(
            Row("force", name, "largest contact force", largest, "N", "<=", limits.max_force)
        )
        if bearing.gap is not None:
            far = float(reach[:, k].max()) / bearing.gap
            title = "largest displacement over the magnet's gap"
            rows.append(Row("magnet_gap", name, title, far, "-", "<=", 1.0))
        mass = race.mass if race is not None else table.mount.mass if table.mount else 0.0
        if mass:
            heat = race.specific_heat if race is not None else 460.0
            start = race.temperature if race is not None else 293.15
            # all slip into the race, none out of it
            hottest = start + float(cost.max()) / (mass * heat)
            note = "adiabatic: all slip energy of one landing into the race"
            row = Row(
                "temperature",
                name,
                "race temperature",
                hottest,
                "K",
                "<=",
                limits.temperature,
                note,
            )
            rows.append(row)
        mean = float(cost.mean())
        factor = math.inf
        if race is not None and race.static_capacity is not None:
            factor = race.static_capacity / max(float(load[:, k].max()), 1e-9)
            rows.append(
                Row(
                    "static_factor",
                    name,
                    "C_0 over the largest load",
                    factor,
                    "-",
                    ">=",
                    limits.static_factor,
                )
            )
        rows.append(Row("slip_energy", name, "slip energy per landing, mean", mean, "J"))
        allowed = _allowed(limits, mean, factor)
        if allowed is not None:
            note = "energy of its life over the mean slip energy; none where C_0 is exceeded"
            wanted = None if limits.landings is None else float(limits.landings)
            rows.append(Row("landings", name, "landings allowed", allowed, "-", ">=", wanted, note))
    for s, name in enumerate(fallen.seal_names):
        rows.append(
            Row(
                "penetration",
                name,
                "largest displacement over the clearance",
                float(seals[:, s].max()),
                "-",
                "<=",
                1.0,
            )
        )
    return tuple(rows)


def _allowed(limits: TouchdownLimits, mean: float, factor: float) -> float | None:
    """How many landings the energy allows; None where the file states no energy."""
    if limits.static_factor is not None and factor < limits.static_factor:
        return 0.0
    if limits.energy is None:
        return None
    return float(math.floor(limits.energy / mean)) if mean > 0 else math.inf


# Landing on one thrust face: the motion along the axis when the thrust bearing loses its power with
# the others.
#
# From rest at the middle the process thrust F_0 pushes the rotor (mass m) along z, against the
# coupling (k_c, d_c), until the collar meets a stop at c:
#
#     m z'' = F_0 - k_c z - d_c z' - N,    N = max(0, k (z - c) + d z') beyond the stop, else 0:
#
# the stop's spring and damper of the machine file, which never pull (as the rig has them). Without
# coupling and damping F_0 (c + z) = k z^2 / 2 at the turning point z beyond the stop, so that N is
# there
#
#     F_0 (1 + sqrt(1 + 2 k c / F_0)).
#
# Between two changes of N the equation is linear; each such phase is integrated up to the next.
# Left out: what the magnets still pull as their flux decays (the rig has it, scenario power-loss of
# the axis), friction on the face, and a weight along the axis beyond what the file's load says.


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
    for part in machine.parts(ThrustBearing):
        thrust = sum(load.force for load in part.loads if load.point == point.label)
        if thrust and part.touchdown_gap is not None:
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


WHIRLS = 3.0  # whole turns against the spin
# factors on the file's values, lowest and highest: friction evenly, mount by its logarithm
FRICTION, MOUNT = (0.5, 1.5), (0.5, 2.0)
SPEED = (0.5, 1.0)  # of the operating point's, evenly
_CHUNK = 8  # drops between two looks at whether to go on
_QUANTILES = (0.05, 0.5, 0.95, 1.0)  # of the drops, in the table


@dataclass(frozen=True, slots=True, eq=False)
class Campaign:
    """Drops d of one machine at b bearings.

    cases (d, 4): factors on friction, mount stiffness and damping, and speed [rad/s]; angles (d, b)
    of the unbalance [rad]. figures (d, b, 14) as in ``drop.Fall``; slip (d, b) [J]; seals (d, s):
    largest displacement over the gap. duration [s] of every drop; wall [s] that all took.
    """

    seed: int
    duration: float
    cases: np.ndarray
    angles: np.ndarray
    figures: np.ndarray
    slip: np.ndarray
    seals: np.ndarray
    wall: float
    workers: int

    @property
    def count(self) -> int:
        return len(self.cases)

    @property
    def force(self) -> np.ndarray:
        """The largest contact force (d, b) [N]."""
        return np.asarray(self.figures[:, :, 2])

    @property
    def load(self) -> np.ndarray:
        """The largest load of the rolling elements (d, b) [N]."""
        return np.asarray(self.figures[:, :, 3])

    @property
    def turns(self) -> np.ndarray:
        """Most turns against the spin without going back (d,), at any bearing."""
        return np.asarray(self.figures[:, :, 6].max(axis=1) / (2 * np.pi))

    @property
    def whirls(self) -> np.ndarray:
        """Which drops (d,) whirl."""
        return np.asarray(self.turns >= WHIRLS)

    @property
    def whirl_frequency(self) -> np.ndarray:
        """Of the drops that whirl, the frequency [rad/s] of their fastest turn."""
        turn = np.where(self.figures[:, :, 8] > 0, self.figures[:, :, 8], np.inf).min(axis=1)
        return np.asarray(2 * np.pi / turn[self.whirls])

    def quantiles(self, values: np.ndarray) -> dict[str, float]:
        """5 %, median, 95 % and the largest, of values (d,)."""
        found = np.quantile(values, _QUANTILES)
        return dict(zip(("5 %", "median", "95 %", "largest"), map(float, found), strict=True))

    def to_dict(self) -> dict[str, Any]:
        """Plain data, SI."""
        whirls = self.whirls
        return {
            "drops": self.count,
            "seed": self.seed,
            "duration": self.duration,
            "wall_time": self.wall,
            "workers": self.workers,
            "friction_factor": list(FRICTION),
            "mount_factor": list(MOUNT),
            "speed_factor": list(SPEED),
            "whirl": "three whole turns against the spin without going back, at any bearing",
            "share_that_whirls": float(whirls.mean()),
            "whirl_frequency": self.quantiles(self.whirl_frequency) if whirls.any() else None,
            "force_0p": [self.quantiles(column) for column in self.force.T],
            "slip_energy": [self.quantiles(column) for column in self.slip.T],
            "penetration_0p": [self.quantiles(column) for column in self.seals.T],
        }


def _stiffest(bearing: Bearing) -> Bearing:
    return bearing._replace(
        mount_stiffness=MOUNT[1] * bearing.mount_stiffness,
        mount_damping=MOUNT[1] * bearing.mount_damping,
    )


def draw(fallen: FallenRotor, count: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Cases (d, 4) and angles (d, b) of a campaign."""
    generator = np.random.default_rng(seed)
    b = len(fallen.names)
    even = generator.random((count, 4 + b))
    friction = FRICTION[0] + (FRICTION[1] - FRICTION[0]) * even[:, 0]
    mount = MOUNT[0] * (MOUNT[1] / MOUNT[0]) ** even[:, 1:3]
    speed = fallen.speed * (SPEED[0] + (SPEED[1] - SPEED[0]) * even[:, 3])
    return np.column_stack([friction, mount, speed]), 2 * np.pi * even[:, 4:]


def drops(
    machine: Machine,
    fallen: FallenRotor,
    unbalance: tuple[float, ...],
    count: int,
    *,
    duration: float,
    seed: int,
    workers: int | None = None,
    progress: Callable[[str], None] = lambda text: None,
) -> Campaign:
    """``count`` drops of ``duration`` [s] on all processors (or ``workers``). unbalance (b,) [kg m]
    at the bearings. Raises NumericalFailure where one overflows.
    """
    from time import perf_counter

    cases, angles = draw(fallen, count, seed)
    rig, _ = build(machine, fallen)
    brake = brake_of(machine)
    b, seals = len(fallen.names), len(fallen.seal_names)
    figures, slip = np.zeros((count, b, FIGURES)), np.zeros((count, b))
    met = np.zeros((count, seals))
    compiled()
    threads = workers or os.cpu_count() or 1
    stop = Event()
    # mounts up to twice as stiff and damped: steps as short as that asks for
    _, dt = build(machine, replace(fallen, bearings=tuple(map(_stiffest, fallen.bearings))))

    def chunk(first: int) -> int:
        last = min(first + _CHUNK, count)
        for d in range(first, last):
            if stop.is_set():
                return d - first
            one(d)
        return last - first

    def one(d: int) -> None:
        drop = Drop(float(cases[d, 3]), unbalance, tuple(angles[d]), *map(float, cases[d, :3]))
        case, state = case_of(fallen, rig, drop, brake)
        try:
            fall = run(rig, case, state, duration, dt)
        except NumericalFailure as error:
            raise NumericalFailure(f"drop {d + 1} of seed {seed}: {error}") from None
        figures[d], met[d] = fall.figures, fall.seals
        slip[d] = slip_of(fallen, fall)

    began = perf_counter()
    with ThreadPoolExecutor(threads) as pool:
        waiting = {pool.submit(chunk, first) for first in range(0, count, _CHUNK)}
        done, told = 0, 0
        try:
            while waiting:
                finished, waiting = wait(waiting, timeout=0.5, return_when=FIRST_COMPLETED)
                done += sum(future.result() for future in finished)
                if 10 * done // count > told:
                    told = 10 * done // count
                    progress(f"{done:,} of {count:,} drops, {perf_counter() - began:.0f} s")
        except BaseException:
            stop.set()
            pool.shutdown(wait=True, cancel_futures=True)
            raise
    wall = perf_counter() - began
    return Campaign(seed, duration, cases, angles, figures, slip, met, wall, threads)
