"""What a landing will be like: whirl before any simulation, one drop, and many of them."""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
import scipy.linalg as sla

from ambrose.annexes.touchdown.campaign import (
    AxialDrop,
    Campaign,
    Row,
    axial_drops,
    drops as many_drops,
    judge_landing,
    thrust_rows,
)
from ambrose.annexes.touchdown.drop import (
    Drop,
    Fall,
    FallenRotor,
    brake_of,
    build,
    case_of,
    fallen_rotor,
    run,
    slip_of,
)
from ambrose.annexes.touchdown.drop_kernel import Rig, SampledLaw
from ambrose.annexes.touchdown.whip import (
    Edge,
    Whip,
    WhipCurve,
    alone,
    beyond_stop,
    edge_alone,
    edge_at_stop,
    receptances,
    together,
)
from ambrose.core.checks import InvalidInput, names_wrong_types
from ambrose.core.presentation import Presented
from ambrose.core.sampling import c2d
from ambrose.core.statespace import StateSpace
from ambrose.law.law import LawLike, law_of
from ambrose.law.loop import timing_of
from ambrose.machine.description import OperatingPoint
from ambrose.machine.machine import Machine
from ambrose.machine.parameters import operating_point
from ambrose.machine.units import listed
from ambrose.machine.validation.ranges import implausible
from ambrose.model.effects import magnet
from ambrose.model.effects.rotor import STANDARD_GRAVITY
from ambrose.model.effects.touchdown import Bearing
from ambrose.model.static_load import magnet_coefficients, residual_unbalance
from ambrose.record.record import Record
from ambrose.rig.engine.controller import of_one_type

# The state of a rotor at the moment of a trip, from a record of the rig or of a machine: a drop
# then begins where the run left off.
#
# Displacements q_<port> at all ports of the record and their slopes are fitted by the coordinates
# of the fallen rotor, least squares; the phase of the unbalance is not in a record, and stays as
# drawn.


_AROUND = 4  # samples on either side of the trip that are fitted, at least
_TURN = 0.5  # of a turn on either side, so that the orbit of unbalance is told from the fall


def speed_at(record: Record, time: float) -> float:
    """The rotor's speed [rad/s] at a time [s] of a record: its signal, else that of its point."""
    if "speed" not in record.signals:
        return record.point.speed
    return float(np.interp(time, record.time, record["speed"]))


def state_at(
    machine: Machine, fallen: FallenRotor, record: Record, time: float
) -> tuple[np.ndarray, np.ndarray]:
    """Coordinates and velocities (n,) of the fallen rotor at a time [s] of a record, without the
    orbit that its unbalance makes.

    Raises InvalidInput where the time is not in the record, or it has no displacements at the
    bearings (q_<axis>, else what its sensors read, y_<axis>).
    """
    at = round(time * record.sample_rate_hz)
    speed = speed_at(record, time)
    around = _AROUND
    if speed:
        around = max(around, round(_TURN * 2 * np.pi / speed * record.sample_rate_hz))
    if not around <= at < len(record.time) - around:
        raise InvalidInput(
            f"the trip at {time:g} s is not within the record, 0 to {record.time[-1]:g} s; give "
            "the time at which the power is lost"
        )
    kind = "q" if all(f"q_{axis}" in record.signals for axis in machine.axes) else "y"
    names = [f"{kind}_{axis}" for axis in machine.axes]
    missing = [name for name in names if name not in record.signals]
    if missing:
        raise InvalidInput(
            f"the record has no {', '.join(missing)}, so that the rotor's position is unknown; "
            "record displacements at every bearing"
        )
    rows = fallen.sensor_rows
    if kind == "q":
        rows = _along_magnets(machine, fallen)
    # around it a parabola and the orbit: a + b t + c t^2 + d cos W t + e sin W t
    window = slice(at - around, at + around + 1)
    t = record.time[window] - record.time[at]
    values = np.array([record[name][window] for name in names])
    columns = [np.ones_like(t), t, t**2, np.cos(speed * t) - 1, np.sin(speed * t)]
    shapes = np.column_stack(columns if speed else columns[:3])
    size = np.abs(shapes).max(axis=0)
    fitted = np.linalg.lstsq(shapes / size, values.T, rcond=None)[0] / size[:, None]
    # cos - 1 is zero at the trip: d, the orbit's part there, off the place; e W off the slope
    place, slope = fitted[0] - (fitted[3] if speed else 0.0), fitted[1]
    # the rigid coordinates alone: as many as there are axes
    rigid = rows[:, :4]
    q, v = np.zeros(rows.shape[1]), np.zeros(rows.shape[1])
    q[:4] = np.linalg.lstsq(rigid, place, rcond=None)[0]
    v[:4] = np.linalg.lstsq(rigid, slope, rcond=None)[0]
    return q, v


# What follows the drop: the rotor slows down in its touchdown bearings until it stands.
#
# J W' = -brake - windage W^2 - sum of the bearings' moments, each under its share of the weight F:
# on a race that has spun up its friction moment M_0 + mu_b F d/2, in a fixed bush mu F R, whose
# work is slip.


_STEPS = 4000  # of the speed


@dataclass(frozen=True, slots=True)
class RunDown:
    """time [s] to stand still (inf: nothing slows the rotor); slip [J] in all fixed bushes; taken
    [J]: by drive, windage and constant friction.
    """

    time: float
    slip: float
    taken: float

    def to_dict(self) -> dict[str, Any]:
        """Plain data, SI; a time that never ends is null."""
        time = self.time if np.isfinite(self.time) else None
        return {"time": time, "slip_energy": self.slip, "taken_by_drive_and_windage": self.taken}


def _along_magnets(machine: Machine, fallen: FallenRotor) -> np.ndarray:
    """Displacements (axes, n) at the bearings along the magnets, from the rotor's coordinates."""
    turned = []
    for bearing, (x, y) in zip(machine.bearings, fallen.rows, strict=True):
        c, s = math.cos(bearing.angle), math.sin(bearing.angle)
        turned += [c * x + s * y, c * y - s * x]
    return np.array(turned)


def run_down(fallen: FallenRotor, speed: float, brake: float, windage: float) -> RunDown:
    """From a speed [rad/s] to rest; brake [N m], windage [N m s2]: torque over speed squared."""
    load = STANDARD_GRAVITY * fallen.mass / len(fallen.bearings)
    if not fallen.weight.any():
        load = 0.0  # what lies on the axial stop is not known here
    rubbing, rolling = 0.0, 0.0
    for bearing in fallen.bearings:
        if bearing.race_mass:
            rolling += bearing.drag + bearing.drag_arm * load
        else:
            rubbing += bearing.friction * load * bearing.radius
    # dt = J dW / torque(W); energies by their share of the torque
    edges = np.linspace(0.0, speed, _STEPS + 1)
    W = (edges[1:] + edges[:-1]) / 2
    torque = brake + windage * W**2 + rubbing + rolling
    if not torque.all():
        return RunDown(np.inf, 0.0, 0.0)
    energy = fallen.polar_inertia * W * np.diff(edges)
    return RunDown(
        float(np.sum(fallen.polar_inertia * np.diff(edges) / torque)),
        float(np.sum(energy * rubbing / torque)),
        float(np.sum(energy * (brake + windage * W**2) / torque)),
    )


# The magnets come on again while the rotor lies in its touchdown bearings.
#
# The controller runs sampled, with its computing delay, its currents and the sensors' readings at
# their limits. Its slow states (below 1 Hz: integrators) hold what carried the weight before the
# loss, and rest as long as the rotor touches; synchronous blocks are off. Magnets pull with their
# nonlinear force through the bandwidth of the amplifier; its voltage has no limit here.


_SLOW = 2 * np.pi  # [rad/s] up to which a state counts as an integrator
_IDEAL = 3e4  # [rad/s] of an amplifier that the file states as ideal


@dataclass(frozen=True, slots=True)
class Recovery:
    """time [s] from power to the last contact, inf where the rotor touches in the last tenth of
    what was simulated; force [N]: largest contact force with the magnets on.
    """

    start: float
    time: float
    force: float

    def to_dict(self) -> dict[str, Any]:
        """Plain data, SI; a recovery that never came is null."""
        time = self.time if math.isfinite(self.time) else None
        return {"power_back": self.start, "time": time, "largest_force_0p": self.force}


def with_magnets(machine: Machine, fallen: FallenRotor, rig: Rig, point: OperatingPoint) -> Rig:
    """The rig with its magnets, at the point's bias current."""
    amplifier = machine.amplifier
    known = (amplifier.bandwidth, amplifier.natural_frequency, _IDEAL)
    bandwidth = next(value for value in known if value is not None)
    angles = [bearing.angle for bearing in machine.bearings]
    bias = point.bias_current
    return rig._replace(
        axes=np.column_stack([np.cos(angles), np.sin(angles)]),
        magnets=np.array([magnet.parameters(bearing, bias) for bearing in machine.bearings]),
        sensors=np.ascontiguousarray(fallen.sensor_rows),
        bandwidth=min(float(bandwidth), _IDEAL),
    )


def sampled_law(
    machine: Machine, law: LawLike, point: OperatingPoint, dt: float
) -> tuple[SampledLaw, float]:
    """(the controller between samples, the step [s] that divides its sample time). Raises
    InvalidInput where nothing says its rate.
    """
    timing = timing_of(machine, law)
    if timing is None:
        raise InvalidInput(
            "the controller's sample rate is unknown; give sample_time in [controller] of "
            "the machine file"
        )
    system = law_of(law).at(point)
    period = math.ceil(timing.sample_time / dt)
    late = timing.delay_samples * timing.sample_time
    if system.dt is None:
        sampled = c2d(system, timing.sample_time, "tustin", late)
    else:
        sampled = _late(system, timing.delay_samples)
    parts, slow = slow_first(sampled, timing.sample_time)
    currents = [b.max_current or b.bias_current for b in machine.bearings]
    gaps = [b.gap or 2 * (b.touchdown_gap or math.inf) for b in machine.bearings]
    law_arrays = SampledLaw(*parts, slow, period, float(min(currents)), float(min(gaps)))
    return law_arrays, timing.sample_time / period


def _late(system: StateSpace, samples: int) -> StateSpace:
    """A sampled system whose inputs arrive so many samples later."""
    m = system.B.shape[1]
    for _ in range(samples):
        A = np.block([[system.A, system.B], [np.zeros((m, len(system.A))), np.zeros((m, m))]])
        B = np.vstack([np.zeros((len(system.A), m)), np.eye(m)])
        C = np.hstack([system.C, system.D])
        system = StateSpace(
            A, B, C, np.zeros_like(system.D), system.inputs, system.outputs, system.dt
        )
    return system


def slow_first(
    system: StateSpace, sample_time: float
) -> tuple[tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray], int]:
    """((A, B, C, D), how many): the same system with its slow poles apart and first."""
    if not len(system.A):
        a, b, c, d = of_one_type(system.A, system.B, system.C, system.D)
        return (a, b, c, d), 0
    least = math.exp(-_SLOW * sample_time)
    T, Z, count = sla.schur(
        system.A, output="real", sort=lambda re, im=0.0: math.hypot(re, im) > least
    )
    # T = [T1 T12; 0 T2]; x = [I X; 0 I] z with T1 X - X T2 = -T12 parts the two
    turn, back = np.eye(len(T)), np.eye(len(T))
    if 0 < count < len(T):
        X = sla.solve_sylvester(T[:count, :count], -T[count:, count:], -T[:count, count:])
        turn[:count, count:] = X
        back[:count, count:] = -X
        T = sla.block_diag(T[:count, :count], T[count:, count:])
    a, b, c, d = of_one_type(T, back @ Z.T @ system.B, system.C @ Z @ turn, system.D)
    return (a, b, c, d), int(count)


def held_states(
    machine: Machine, fallen: FallenRotor, law: SampledLaw, point: OperatingPoint
) -> np.ndarray:
    """The controller's states (s,) before the loss: slow ones that carry the weight, least in size.

    Forces f at the axes balance the weight in the rotor's four rigid coordinates: N^T f = -w; the
    currents are f/k_i, and C x = f/k_i of the slow states.
    """
    states = np.zeros(len(law.A))
    if not law.slow:
        return states
    rigid = _along_magnets(machine, fallen)[:, :4]
    force = np.linalg.lstsq(rigid.T, -fallen.weight[:4], rcond=None)[0]
    currents = force / magnet_coefficients(machine, point)[0]
    states[: law.slow] = np.linalg.lstsq(law.C[:, : law.slow], currents, rcond=None)[0]
    return states


def recovery_of(fall: Fall, start: float, duration: float) -> Recovery:
    """What a drop with power from ``start`` [s] on ended with."""
    last = float(fall.figures[:, 12].max())
    free = last < duration - 0.1 * (duration - start)
    time = max(last - start, 0.0) if free else math.inf
    return Recovery(start, time, float(fall.figures[:, 13].max()))


WHIP_MODEL = (
    "linear rotor without its magnets, touchdown bearing at its clearance and in steady slip, one "
    "friction coefficient (that of high sliding speed), mount without its stop"
)
HEADS = (
    ("architecture", "the tables of the machine file"),
    ("functional requirements", "[bearing.touchdown.limits]"),
    ("rotordynamic design", "whip map, drops"),
    ("environment", "not covered"),
    ("events that cause contact", "loss of power alone; others not covered"),
    ("failure modes", "whirl, overload, heat; wear not covered"),
    ("sizing and simulation", "drops, landings allowed"),
    ("acceptance test plan with instrumentation", "not covered"),
    ("inspection in service", "landings allowed; inspection not covered"),
)
LONGEST = 30.0  # [s] of a drop
_USUAL = (0.4, 1.0)  # [s]
# the keys that a landing rests on, beside the rotor's own
_RESTS_ON = (
    "bearing.touchdown",  # its gap and its tables
    "bearing.gap",
    "coast_down.",
    "thrust_bearing.touchdown_gap",
    "thrust_bearing.stop_",
)
_LOG = 6000  # rows of the one drop
_LOWEST = 2 * np.pi  # [rad/s]
_HIGHEST = 6000 * np.pi  # [rad/s] unless the rotor rolls at less
_POINTS = 240  # of a curve
_FRICTIONS = np.geomspace(0.02, 1.0, 25)
_SCALES = np.geomspace(0.1, 10.0, 13)  # of the mount's stiffness
_DAMPINGS = (0.3, 1.0, 3.0)  # of the mount's damping
# a mount for the map of a machine that has none: what polymer rings and corrugated strips reach
_MOUNT = (0.3, 2e7, 5e3)


@dataclass(frozen=True, slots=True, eq=False)
class WhipMap:
    """Edges over friction (f,), mount stiffness (k,) [N/m] and damping (d,) [N s/m] of the first
    bearing (all bearings' scale alike). frequency and force (d, k, f): [rad/s] and [N] of the worst
    kind, 0 where there is no whip, inf where only rolling ends it. place: friction, stiffness,
    damping of the machine; None where it has no mount.
    """

    kind: str
    friction: np.ndarray
    stiffness: np.ndarray
    damping: np.ndarray
    frequency: np.ndarray
    force: np.ndarray
    place: tuple[float, float, float] | None

    def to_dict(self) -> dict[str, Any]:
        """Plain data, SI; what is not finite is null."""

        def plain(values: np.ndarray) -> Any:
            finite = np.isfinite(values)
            return np.where(finite, values, np.array(None, dtype=object)).tolist()

        return {
            "kind": self.kind,
            "friction": self.friction.tolist(),
            "mount_stiffness": self.stiffness.tolist(),
            "mount_damping": self.damping.tolist(),
            "frequency": plain(self.frequency),
            "force_0p": plain(self.force),
            "place": None if self.place is None else list(self.place),
        }


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Landing(Presented):
    """A machine's landing at an operating point.

    whips: where whip settles at the machine's friction, by kind. curves: what whip needs over its
    frequency. whip_map: edges over friction and mount. drop, fall: the machine as written down,
    with its residual unbalance; down: until it stands. recovery: with the magnets on
    again, None where no controller was given. campaign: many drops, None where none were
    asked for. rows: what landings cost, over the campaign or else over the one drop. along: the
    motion along the axis, of every thrust bearing with stops and a thrust at the point.
    controller: what a page calls the one of the recovery.
    """

    _FACTS: ClassVar = ("machine=machine_name", "point=point_name", "worst=worst_whip")

    machine: Machine
    point: OperatingPoint
    fallen: FallenRotor
    whips: tuple[Whip, ...]
    curves: tuple[WhipCurve, ...]
    whip_map: WhipMap
    drop: Drop
    duration: float
    fall: Fall
    down: RunDown
    recovery: Recovery | None
    campaign: Campaign | None
    rows: tuple[Row, ...]
    along: tuple[AxialDrop, ...] = ()
    controller: str = ""

    @property
    def passed(self) -> bool | None:
        """Whether every row with a limit holds; None where the file states no limit."""
        judged = [row.passed for row in self.rows if row.passed is not None]
        return all(judged) if judged else None

    @property
    def machine_name(self) -> str:
        return self.machine.name

    @property
    def point_name(self) -> str:
        return self.point.label or f"{self.point.speed * 30 / np.pi:.6g} rpm"

    @property
    def worst_whip(self) -> str:
        """The kind of whip with the largest force, in words."""
        worst = worst_of(self.whips)
        if worst.frequency == 0:
            return "no whip at this friction"
        if not np.isfinite(worst.frequency):
            return f"{worst.kind}: up to rolling"
        force = max(worst.force)
        size = f"{force:.4g} N" if np.isfinite(force) else "force not bounded"
        return f"{worst.kind}: {worst.frequency / (2 * np.pi):.4g} Hz, {size}"

    def to_dict(self) -> dict[str, Any]:
        """Plain data, SI."""
        return {
            "machine": self.machine.name,
            "point": self.point_name,
            "speed": self.point.speed,
            "mass": self.fallen.mass,
            "whip_model": WHIP_MODEL,
            "whips": [whip.to_dict() for whip in self.whips],
            "whip_map": self.whip_map.to_dict(),
            "drop": fall_data(self),
            "run_down": self.down.to_dict(),
            "recovery": None if self.recovery is None else self.recovery.to_dict(),
            "along": {item.bearing: item.to_dict() for item in self.along},
            "campaign": None if self.campaign is None else self.campaign.to_dict(),
            "rows": [row.to_dict() for row in self.rows],
            "passed": self.passed,
            "iso_14839_5": [dict(zip(("head", "here"), head, strict=True)) for head in HEADS],
        }


def fall_data(result: Landing) -> dict[str, Any]:
    """The one drop as plain data, SI; times of what never came are null."""
    plain: dict[str, Any] = {
        "duration": result.duration,
        "speed": result.drop.speed,
        "speed_at_end": float(result.fall.log[-1, 1]),
    }
    for name, row, slip in zip(
        result.fallen.names, result.fall.figures, result.fall.energy, strict=False
    ):
        plain[name] = {
            "first_contact": float(row[0]) if row[0] >= 0 else None,
            "first_force_0p": float(row[1]),
            "largest_force_0p": float(row[2]),
            "largest_element_load_0p": float(row[3]),
            "time_in_contact": float(row[4]),
            "largest_displacement_0p": float(row[5]),
            "turns_against_spin": float(row[6] / (2 * np.pi)),
            "turns_with_spin": float(row[7] / (2 * np.pi)),
            "largest_race_speed": float(row[10]),
            "slip_energy": float(slip),
        }
    for name, share in zip(result.fallen.seal_names, result.fall.seals, strict=True):
        plain[name] = {"largest_displacement_0p_over_gap": float(share)}
    return plain


def worst_of(whips: tuple[Whip, ...]) -> Whip:
    """The whip with the largest force."""
    return max(whips, key=lambda whip: max(whip.force))


@names_wrong_types
def landing(
    machine: Machine,
    point: OperatingPoint | str | None = None,
    *,
    drops: int = 0,
    duration: float | None = None,
    seed: int = 1,
    bending_modes: int = 2,
    law: LawLike | None = None,
    power_back: float = 0.1,
    record: Record | None = None,
    trip: float | None = None,
    workers: int | None = None,
    progress: Callable[[str], None] = lambda text: None,
) -> Landing:
    """How a machine lands in its touchdown bearings after its magnets have lost their power.

    point: the operating point at which they do, or its label; default: the fastest one. drops: how
    many with other friction, mount, unbalance and speed, drawn from ``seed``. duration [s] of each
    drop (None: until the races turn with the rotor, ``usual_duration``), after which the rest of
    the run-down is estimated. bending_modes: per plane in drops.
    law: a controller under which the magnets come on again ``power_back`` [s] after they were lost,
    in another drop that goes on for ``duration`` after that. record, trip [s]: the one drop begins
    with the rotor's place, motion and speed at that time of a record (``trip.state_at``).
    workers: processors (None: all).
    progress: is told every stage. Raises InvalidInput where a bearing has no touchdown_gap, a seal
    is narrower than it, the rotor does not turn, or a number that a landing rests on is outside of
    its usual range: no limit that is met says anything then.
    """
    if drops < 0 or bending_modes < 0:
        raise InvalidInput("drops and bending_modes must not be negative; 0 drops are none")
    if not 0 <= power_back <= LONGEST:
        raise InvalidInput(
            f"power_back is {power_back:g} s, but must be from 0, at once, to {LONGEST:g} s; give "
            "the time after the loss"
        )
    if duration is not None and not 0 < duration <= LONGEST:
        raise InvalidInput(
            f"the duration of a drop is {duration:g} s, but must be above 0 and at most "
            f"{LONGEST:g} s; leave it out"
        )
    if point is None:
        chosen = max(machine.operation.envelope, key=lambda item: item.speed)
    else:
        chosen = operating_point(machine, point)
    if chosen.speed == 0:
        raise InvalidInput(
            f"{machine.name} does not turn at the operating point {chosen.label!r}, so that "
            "friction whirls nothing; give a point with a speed"
        )
    if (record is None) != (trip is None):
        raise InvalidInput(
            "a record and the time of its trip belong together; give both or neither"
        )
    if record is not None and trip is not None:
        chosen = replace(chosen, speed=speed_at(record, trip))
        if chosen.speed == 0:
            raise InvalidInput(
                f"the rotor of the record does not turn at {trip:g} s; give the time of a trip"
            )
    if absurd := list(implausible(machine, _RESTS_ON)):
        raise InvalidInput(
            listed(f"{machine.name} has values with which a landing cannot be checked", absurd)
        )
    progress("the rotor without its magnets")
    fallen = fallen_rotor(machine, chosen)
    _check_races(fallen)
    moving = fallen_rotor(machine, chosen, bending_modes)
    rig, dt = build(machine, moving)
    lasts = usual_duration(moving) if duration is None else duration
    progress("whip over frequency")
    frequency = np.geomspace(_LOWEST, min(_HIGHEST, max(_rolling(fallen))), _POINTS)
    rotor = receptances(fallen, frequency)
    curves = whip_curves(fallen, frequency, rotor)
    whips = _different([_settled(fallen, curve, frequency, rotor) for curve in curves])
    progress("whip over friction and mount")
    worst = worst_of(whips)
    whip_map = _mapped(fallen, worst.kind, frequency[::3], rotor[::3])
    progress("one drop (compiled once per computer)")
    left = residual_unbalance(machine)
    b = len(moving.names)
    shares = (0.0,) * b if left is None else tuple(left.moment * part for part in left.share)
    drop = Drop(chosen.speed, shares, (0.0,) * b)
    case, state = case_of(moving, rig, drop, brake_of(machine))
    if record is not None and trip is not None:
        n = len(moving.mass_matrix)
        place, motion = state_at(machine, moving, record, trip)
        # beside the orbit that its own unbalance makes
        state[:n] += place
        own = state[n : 2 * n] if moving.weight.any() else 0.0
        state[n : 2 * n] = own + motion
    fall = run(rig, case, state, lasts, dt, rows=_LOG)
    down = run_down(moving, float(fall.log[-1, 1]), brake_of(machine), rig.windage)
    recovery = None
    if law is not None:
        progress("the magnets come on again")
        recovery = _recovered(machine, moving, chosen, law, drop, power_back, lasts)
    campaign = None
    if drops:
        progress(f"{drops:,} drops")
        campaign = many_drops(
            machine,
            moving,
            shares,
            drops,
            duration=lasts,
            seed=seed,
            workers=workers,
            progress=progress,
        )
    figures, slip = fall.figures[None], slip_of(moving, fall)[None]
    seals = fall.seals[None]
    if campaign is not None:
        figures, slip = campaign.figures, campaign.slip
        seals = campaign.seals
    force, load = figures[:, :, 2], figures[:, :, 3]
    rows = judge_landing(machine, moving, force, load, slip, figures[:, :, 5], seals, down.slip / b)
    along = axial_drops(machine, moving.mass, chosen, lasts)
    rows = (*rows, *thrust_rows(along))
    if recovery is not None:
        title = "power to the last contact"
        rows = (*rows, Row("recovery", "all", title, recovery.time, "s", "<=", lasts))
    return Landing(
        machine,
        chosen,
        moving,
        whips,
        curves,
        whip_map,
        drop,
        lasts,
        fall,
        down,
        recovery,
        campaign,
        rows,
        along,
        "" if law is None else law_of(law).named,
    )


def _check_races(fallen: FallenRotor) -> None:
    """Raises InvalidInput for a race that is heavier than the rotor that is to spin it up."""
    for name, item in zip(fallen.names, fallen.bearings, strict=True):
        for key, own, whole, unit in (
            ("mass", item.race_mass, fallen.mass, "kg"),
            ("inertia", item.race_inertia, fallen.polar_inertia, "kg m^2"),
        ):
            if item.race_mass and own >= whole:
                raise InvalidInput(
                    f"[[bearing]] {name}, [bearing.touchdown.race]: {key} is {own:.4g} {unit}, but "
                    f"must be below that of the whole rotor, {whole:.4g} {unit}; correct its unit "
                    "or its exponent"
                )


def _recovered(
    machine: Machine,
    moving: FallenRotor,
    point: OperatingPoint,
    law: LawLike,
    drop: Drop,
    start: float,
    duration: float,
) -> Recovery:
    """One drop with the magnets on again."""
    rig, dt = build(machine, moving)
    arrays, dt = sampled_law(machine, law, point, dt)
    case, state = case_of(moving, rig, drop, brake_of(machine))
    rig = with_magnets(machine, moving, rig, point)
    held = held_states(machine, moving, arrays, point)
    fall = run(rig, case, state, start + duration, dt, law=arrays, held=held, start=start)
    return recovery_of(fall, start, start + duration)


def usual_duration(fallen: FallenRotor) -> float:
    """How long [s] a drop is followed: until friction under the weight has spun the slowest race
    up, t = I W / (mu N R), from 0.4 to 1 s. Whirl comes while a race slips; a bush slips until the
    rotor stands, and is followed for a second.
    """
    load = STANDARD_GRAVITY * fallen.mass / len(fallen.bearings)
    times = [
        item.race_inertia * fallen.speed / (item.friction * load * item.radius)
        if item.race_mass and item.friction
        else _USUAL[1]
        for item in fallen.bearings
    ]
    return min(max(*times, _USUAL[0]), _USUAL[1])


def _rolling(fallen: FallenRotor) -> list[float]:
    """Whirl [rad/s] without slip in each fixed bearing: speed times radius over clearance."""
    return [fallen.speed * item.radius / item.clearance for item in fallen.bearings]


def whip_curves(
    fallen: FallenRotor, frequency: np.ndarray, rotor: np.ndarray
) -> tuple[WhipCurve, ...]:
    """What whip needs: of every bearing alone, of all together in one phase, of two in opposite
    ones. rotor (w, b, b): receptances at the frequencies (w,) [rad/s].
    """
    return tuple(curve_of(fallen, kind, frequency, rotor) for kind in kinds_of(fallen))


def kinds_of(fallen: FallenRotor) -> tuple[str, ...]:
    """The kinds of whip that are looked at."""
    single = tuple(f"{name} alone" for name in fallen.names)
    if len(single) == 1:
        return single
    return (*single, "together, in phase", *(["together, in opposition"] * (len(single) == 2)))


def curve_of(fallen: FallenRotor, kind: str, frequency: np.ndarray, rotor: np.ndarray) -> WhipCurve:
    """The curve of one kind."""
    if kind.endswith(" alone"):
        i = fallen.names.index(kind.removesuffix(" alone"))
        return alone(fallen.names[i], i, frequency, rotor[:, i, i], fallen.bearings[i])
    angles = np.zeros(len(fallen.names))
    angles[1:] = np.pi * kind.endswith("opposition")
    return together(kind, angles, frequency, rotor, fallen.bearings)


def _settled(
    fallen: FallenRotor, curve: WhipCurve, frequency: np.ndarray, rotor: np.ndarray
) -> Whip:
    """Where whip settles at the largest friction of the bearings that take part, at the mounts'
    stops where these are met; ``curve`` is that of the mounts alone.
    """
    taking = curve.bearings
    mu = max(fallen.bearings[i].friction for i in taking)
    rolling = min(_rolling(fallen)[i] for i in taking)

    def edge(bearings: tuple[Bearing, ...]) -> Edge:
        whole = list(fallen.bearings)
        for i, item in zip(taking, bearings, strict=True):
            whole[i] = item
        same = tuple(whole) == fallen.bearings
        other = fallen if same else replace(fallen, bearings=tuple(whole))
        its = curve if same else curve_of(other, curve.kind, frequency, rotor)
        if len(taking) > 1:
            return its.edge_of_each(mu)
        w, force = edge_alone(other, taking[0], mu, its)
        return w, (force,)

    mounted = tuple(fallen.bearings[i] for i in taking)
    w, forces = edge(mounted)
    stop = any(beyond_stop(item, w, f, mu) for item, f in zip(mounted, forces, strict=True))
    met = edge_at_stop(edge, mounted, mu) if stop else None
    if met is not None:
        w, forces = met
    if w > rolling:
        w, forces = np.inf, (np.inf,) * len(taking)
    names = tuple(fallen.names[i] for i in taking)
    with_stop = not stop or met is not None
    return Whip(curve.kind, names, mu, w, forces, rolling, stop, with_stop)


def _different(whips: list[Whip]) -> tuple[Whip, ...]:
    """Without a second kind that settles where the first one does: the two are one branch."""
    kept: list[Whip] = []
    for whip in whips:
        same = (other for other in kept if other.bearings == whip.bearings)
        twice = any(
            other.frequency == whip.frequency
            or abs(other.frequency - whip.frequency) < 1e-4 * other.frequency
            for other in same
        )
        if not twice:
            kept.append(whip)
    return tuple(kept)


def _mapped(fallen: FallenRotor, kind: str, frequency: np.ndarray, rotor: np.ndarray) -> WhipMap:
    """Edges of one kind over friction, stiffness and damping of the mounts."""
    first = fallen.bearings[0]
    mounted = tuple(
        item
        if item.ring_mass
        else item._replace(ring_mass=_MOUNT[0], mount_stiffness=_MOUNT[1], mount_damping=_MOUNT[2])
        for item in fallen.bearings
    )
    shape = (len(_DAMPINGS), len(_SCALES), len(_FRICTIONS))
    at, force = np.zeros(shape), np.zeros(shape)
    for d, damping in enumerate(_DAMPINGS):
        for k, stiffness in enumerate(_SCALES):
            scaled = tuple(
                item._replace(
                    mount_stiffness=stiffness * item.mount_stiffness,
                    mount_damping=damping * item.mount_damping,
                )
                for item in mounted
            )
            curve = curve_of(replace(fallen, bearings=scaled), kind, frequency, rotor)
            for f, mu in enumerate(_FRICTIONS):
                at[d, k, f], force[d, k, f] = curve.edge(mu)
    place = (first.friction, first.mount_stiffness, first.mount_damping)
    return WhipMap(
        kind,
        _FRICTIONS,
        _SCALES * mounted[0].mount_stiffness,
        np.array(_DAMPINGS) * mounted[0].mount_damping,
        at,
        force,
        place if first.ring_mass else None,
    )
