"""Verification of one closed loop: everything that holds without uncertainty, on the plant given.

Give it the full plant: a controller designed on a reduced one can destabilise a bending mode. The
checks are listed in the tables of campbell.py, campbell.py, loop_response.py, margins.py,
unbalance.py and nominal.py; limits come from criteria.py, overridden by the requirements. The
loop diagram is in core/lft.py.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import ArrayLike

from ambrose.core.checks import check_shape, invalid, named_failure
from ambrose.core.response import pulses, simulate
from ambrose.core.sampling import c2d
from ambrose.core.statespace import StateSpace, select
from ambrose.judge.campbell import (
    follow,
    modes,
    pole_checks,
    pole_curve,
    speed_stability_check,
    threshold_check,
)
from ambrose.judge.checks import Check, Checks, Curve, information, judge
from ambrose.judge.loop_response import (
    Evaluator,
    LoopResponse,
    Peak,
    add_poles,
    frequency_grid,
    loop_evaluator,
    sensitivity_checks,
    solid_cores,
)
from ambrose.judge.margins import margin_checks
from ambrose.judge.unbalance import (
    assembled_check,
    axis_limit_check,
    unbalance_checks,
    unbalance_curve,
)
from ambrose.law.law import LawLike
from ambrose.law.loop import closed_loop, loop_alone, match_controller
from ambrose.law.pid import channel_chains
from ambrose.machine.criteria import (
    CURRENT_PULSE,
    SENSITIVITY_RANGE,
    SPEED_RANGE_FACTOR,
    TWO_PI,
    Pulse,
    demand,
    machine_limit,
)
from ambrose.machine.description import Requirements
from ambrose.machine.machine import Machine
from ambrose.model.axial import Loaded, at_point, loaded, sides
from ambrose.model.effect import speed_knots
from ambrose.model.plant import Plant, top_speed
from ambrose.model.static_load import Unbalance, magnet_coefficients, residual_unbalance

# The magnets of the axis along the shaft against their process thrust: at rest, and while it
# changes.
#
# | check | what | unit |
# |---|---|---|
# | axial.capacity | process thrust over the largest static force against it | - |
# | axial.current | static control current that holds it | A |
# | axial.change.displacement_0p | largest motion while the thrust goes from end to end | m |
# | axial.change.current_0p | largest control current on the way, the static one with it | A |
# | axial.change.voltage_0p | slew: L di/dt of a coil on the way, L at rest if none is given | V |
#
# The change is from the least to the largest thrust of all operating points within load_time, or
# back; the loop is the linear one of the point. Rows of the change are absent where there is none.


_STEP = 2e-5  # [s] of a continuous loop
_RECORD = 0.25  # [s] after the change


def thrust_checks(closed: StateSpace, plant: Plant) -> tuple[list[Check], list[Curve]]:
    """The checks and curves of this file's table; closed: ``law.loop.closed_loop``."""
    machine = plant.machine
    part, at = machine.thrust, at_point(machine, plant.point)
    side = "right" if at.load < 0 else "left"
    largest = at.capacity[at.load < 0]
    checks = [
        judge(
            "axial.capacity",
            "Process thrust over static capacity",
            abs(at.load) / largest if largest > 0 else np.inf,
            "-",
            machine_limit(1.0, "the magnet's largest force at its place"),
            f"{abs(at.load):.4g} N, carried to the {side}, of {largest:.4g} N",
        ),
        judge(
            "axial.current",
            "Static control current",
            abs(at.current),
            "A",
            machine_limit(part.max_current, "max_current"),
            f"bias {part.bias_current[0]:g} and {part.bias_current[1]:g} A",
        ),
    ]
    loads = [item.load for item in machine.conditions] or [0.0]
    low, high = min(loads), max(loads)
    if high <= low:
        return checks, []
    time, moved, current = _change(closed, plant, high - low, part.load_time)
    return [*checks, *_change_checks(machine, at, (low, high), time, moved, current)], [
        Curve(
            f"axial.change.{name}",
            f"{title} while the thrust changes",
            "time",
            time,
            values[None],
            plant.axes,
            "s",
            unit,
        )
        for name, title, values, unit in (
            ("displacement", "Displacement", moved, "m"),
            ("current", "Control current", current, "A"),
        )
    ]


def _change(
    closed: StateSpace, plant: Plant, height: float, duration: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Time [s], displacement [m] and change of the control current [A] (k,) while a force rises by
    so much [N] in so long [s].
    """
    (axis,) = plant.axes
    part = select(closed, [f"f_{axis}"], [f"q_{axis}", f"i_{axis}"])
    sampled = c2d(part, _STEP) if part.dt is None else part
    dt = sampled.dt or _STEP
    time = np.arange(int(np.ceil((_RECORD + duration) / dt))) * dt
    ramp = np.ones(len(time)) if duration <= 0 else np.clip((time + dt / 2) / duration, 0, 1)
    moved, current = simulate(sampled, height * ramp[None])
    return time, moved, current


def _change_checks(
    machine: Machine,
    at: Loaded,
    ends: tuple[float, float],
    time: np.ndarray,
    moved: np.ndarray,
    change: np.ndarray,
) -> list[Check]:
    part, amplifier = machine.thrust, machine.amplifier
    words = f"{ends[0]:.4g} to {ends[1]:.4g} N " + (
        f"in {1e3 * part.load_time:g} ms" if part.load_time else "at once"
    )
    # from the static current of one end: up with the force, or down with its mirror image
    starts = [loaded(part, end, at.place).current for end in ends]
    peak = max(
        float(np.abs(start + way * change).max())
        for start, way in zip(starts, (1.0, -1.0), strict=True)
    )
    stops = part.touchdown_gap
    # the nearer stop
    left = None if stops is None else min(stops[0] + at.place, stops[1] - at.place)
    slope = float(np.abs(np.diff(change)).max() / (time[1] - time[0]))
    # without a stated inductance N^2/R of the coil whose flux meets least
    inductance = amplifier.inductance or max(
        side.turns**2 / side.met(0.0, side.gap) for side in sides(part)
    )
    return [
        judge(
            "axial.change.displacement_0p",
            "Largest displacement while the thrust changes",
            float(np.abs(moved).max()),
            "m",
            machine_limit(left, "way to the nearer stop"),
            words,
        ),
        judge(
            "axial.change.current_0p",
            "Largest control current while the thrust changes",
            peak,
            "A",
            machine_limit(part.max_current, "max_current"),
            words,
        ),
        information(
            "axial.change.voltage_0p",
            "Coil voltage while the thrust changes",
            inductance * slope,
            "V",
            words,
        )
        if amplifier.max_voltage is None
        else judge(
            "axial.change.voltage_0p",
            "Coil voltage while the thrust changes",
            inductance * slope,
            "V",
            machine_limit(amplifier.max_voltage, "the amplifier's max_voltage"),
            words,
        ),
    ]


# Whether a reference controller's gains outweigh the magnets' negative stiffness at rest.


def stiffness_margin(machine: Machine) -> float | None:
    """The least K_p k_i / k_s of the channels of the reference controller; below 1 a bearing pushes
    away at rest.
    """
    if machine.reference is None:
        return None
    k_i, k_s = magnet_coefficients(machine, machine.operation.design)
    gains = np.array([gain for gain, _ in channel_chains(machine.reference, machine.axes)])
    if machine.reference.coordinates != "axes":
        k_i, k_s = np.full(len(gains), k_i.min()), np.full(len(gains), k_s.max())
    with np.errstate(divide="ignore"):
        return float((gains * k_i / k_s).min())


def below_stiffness(margin: float) -> str:
    """What to say of a margin below one."""
    return (
        f"K_p k_i is below k_s ({margin:.3g} of it): the [controller] leaves negative stiffness "
        "and holds nothing; raise gain "
        f"{1.5 / margin:.2g} times or more"
    )


# Response to a short pulse of excitation current: settling time, peak displacements, currents and
# forces.
#
# | check | what | unit |
# |---|---|---|
# | impulse.settling | time after the pulse until all displacements stay in the band | s |
# | impulse.displacement_0p | largest measured displacement | m |
# | impulse.current_0p | largest control current of the axis nearest to its limit | A |
# | impulse.force_0p | largest magnetic force k_i i + k_s q of the axis nearest to its limit | N |
#
# Curves: "impulse.displacement" and "impulse.current", the response to the pulse on the axis that
# settles last.


_STEP_TRANSIENT = 1e-4  # s; a 550 Hz mode has 18 samples a period
_FIRST_RECORD = 0.25  # s
_LONGEST_RECORD = 4.0  # s


@dataclass(frozen=True, slots=True, eq=False)
class PulseResponse:
    """time (k,) [s] from the start of the pulse; displacement, current and bearing displacement
    (pulsed axis, axis, k).
    """

    time: np.ndarray
    displacement: np.ndarray
    current: np.ndarray
    bearing_displacement: np.ndarray
    pulse: Pulse

    def settling(self) -> np.ndarray:
        """Per pulsed axis the time [s] from the end of the pulse until every displacement stays
        inside the band; inf when it has not, or not for the last tenth of the record.
        """
        size = np.abs(self.displacement)
        outside = (size > self.pulse.band * size.max(axis=(1, 2), keepdims=True)).any(axis=1)
        last = np.where(
            outside.any(axis=1), outside.shape[1] - 1 - np.argmax(outside[:, ::-1], axis=1), 0
        )
        settled = np.maximum(self.time[last] - self.pulse.duration, 0.0)
        return np.where(last < 0.9 * len(self.time), settled, np.inf)


def pulse_response(
    closed: StateSpace,
    plant: Plant,
    pulse: Pulse = CURRENT_PULSE,
    longest: float = _LONGEST_RECORD,
) -> PulseResponse:
    """The closed loop's exact response to the pulse on every axis in turn, recorded until it has
    settled (a quarter of a second at least, ``longest`` [s] at most).

    closed: ``law.loop.closed_loop``; sampled loops keep their own sample time. Raises
    NumericalFailure when unstable.
    """
    axes = plant.axes
    outputs = [*plant.named("y"), *plant.named("i"), *plant.bearing_named("q")]
    part = select(closed, [f"e_{axis}" for axis in axes], outputs)
    sampled = c2d(part, _STEP_TRANSIENT) if part.dt is None else part
    dt = sampled.dt or _STEP_TRANSIENT
    record = _FIRST_RECORD
    while True:
        samples = int(np.ceil((record + pulse.duration) / dt))
        pulse_samples = max(1, round(pulse.duration / dt))
        answers = pulses(sampled, pulse.amplitude, pulse_samples, samples)
        stacked = answers.reshape(len(axes), 3, len(axes), samples)
        response = PulseResponse(
            np.arange(samples) * dt, stacked[:, 0], stacked[:, 1], stacked[:, 2], pulse
        )
        if record >= longest or np.isfinite(response.settling()).all():
            return response
        record = min(4 * record, longest)


def pulse_checks(
    response: PulseResponse, plant: Plant, requirements: Requirements
) -> tuple[list[Check], list[Curve]]:
    """The checks and curves of this file's table."""
    axes, pulse = plant.axes, response.pulse
    settling = response.settling()
    worst = int(np.argmax(settling))
    words = (
        f"{pulse.amplitude:g} A for {pulse.duration * 1e3:g} ms on one axis after the other, band "
        f"{pulse.band:.0%}"
    )
    open_end = (
        "" if np.isfinite(settling[worst]) else f"; not settled after {response.time[-1]:.3g} s"
    )
    k_i, k_s = magnet_coefficients(plant.machine, plant.point)
    force = k_i[:, None] * response.current + k_s[:, None] * response.bearing_displacement
    largest = np.abs(response.displacement).max(axis=2)
    at = np.unravel_index(np.argmax(largest), largest.shape)
    checks = [
        judge(
            "impulse.settling",
            "Settling time after a current pulse",
            settling[worst],
            "s",
            demand("settling time", requirements),
            f"pulse on {axes[worst]}: {words}{open_end}",
        ),
        information(
            "impulse.displacement_0p",
            "Largest displacement after a current pulse",
            largest[at],
            "m",
            f"axis {axes[at[1]]}, pulse on {axes[at[0]]}",
        ),
        axis_limit_check(
            plant,
            "impulse.current_0p",
            "Largest control current after a current pulse",
            _peaks(response.current),
            requirements,
        ),
        axis_limit_check(
            plant,
            "impulse.force_0p",
            "Largest magnetic force after a current pulse",
            _peaks(force),
            requirements,
        ),
    ]
    curves = [
        Curve(
            f"impulse.{name}",
            f"{title}, pulse on {axes[worst]}",
            "time",
            response.time,
            values[worst],
            axes,
            "s",
            unit,
        )
        for name, title, values, unit in (
            ("displacement", "Displacement", response.displacement, "m"),
            ("current", "Control current", response.current, "A"),
        )
    ]
    return checks, curves


def _peaks(values: np.ndarray) -> list[Peak]:
    """Largest modulus per axis of values (pulsed axis, axis, k)."""
    return [Peak(float(value), np.nan, False) for value in np.abs(values).max(axis=(0, 2))]


_LOWEST = 0.5 * TWO_PI  # rad/s, start of the default grid
# speeds at which the rotor is assembled anew for unbalance, and for stability, to begin with
_SPEEDS, _STABILITY_SPEEDS = 40, 11
_BEYOND = 5.0  # the default grid reaches this many times past the standard's range

Progress = Callable[[str, float], None]


@named_failure("the nominal checks")
def check(
    plant: Plant,
    controller: LawLike,
    requirements: Requirements | None = None,
    omega: ArrayLike | None = None,
    progress: Progress | None = None,
    plant_at: Callable[[float], Plant] | None = None,
    law_at: Callable[[Plant], StateSpace] | None = None,
    covered: tuple[float, float] | None = None,
    small_at: Callable[[float], Plant] | None = None,
) -> Checks:
    """The verdict on ``controller`` (err -> u, continuous or sampled) around ``plant``.

    requirements: default those of the plant's machine. omega (w,) [rad/s]: ascending, positive;
    points around lightly damped closed-loop poles are added (default: 0.5 Hz to five times the
    range of ISO 14839-3). progress(stage, fraction) is called between stages. plant_at(speed
    [rad/s]) -> Plant: with it stability and unbalance are checked along the machine's speed range
    with the rotor assembled anew at every speed, under law_at(plant) (None: ``controller``), over
    the speeds covered [rad/s] (None: the whole range); small_at: a smaller plant at a speed, which
    says where speeds are added (None: plant_at does). An unstable loop yields stable=False, the
    check "stability.abscissa" that names its poles, and the pole curve. Raises InvalidInput for a
    controller of the wrong size or a grid that does not ascend from a positive frequency.
    """
    tell = progress or (lambda stage, fraction: None)
    requirements = plant.machine.requirements if requirements is None else requirements
    controller = match_controller(controller, plant)
    tell("closed-loop poles", 0.0)
    closed = closed_loop(plant, controller)
    eigenmodes = modes(closed, plant.ports, plant.system)
    speed = max(top_speed(plant.machine), plant.point.speed)
    checks: list[Check] = pole_checks(eigenmodes, requirements, speed)
    curves: list[Curve] = [pole_curve(eigenmodes)]
    label = plant.point.label or f"{plant.point.speed / TWO_PI:.4g} Hz"
    notes = _notes(plant, controller.dt)
    if eigenmodes.poles.real.max() >= 0:
        return Checks(label, False, tuple(checks[:1]), tuple(curves), notes)

    highest = sensitivity_range(speed, controller.dt)
    grid = _grid(eigenmodes.poles, omega, highest, controller.dt)
    tell("frequency response", 0.15)
    evaluator = loop_evaluator(plant, controller)
    response = evaluator(grid)
    tell("sensitivity and compliance", 0.35)
    within = (float(grid[0]), min(highest, float(grid[-1])))
    _extend(checks, curves, _sensitivities(plant, response, evaluator, within, requirements))
    tell("margins", 0.55)
    _extend(checks, curves, margin_checks(response, evaluator, requirements))
    tell("unbalance", 0.7)
    residual = residual_unbalance(plant.machine, requirements)
    if not plant.machine.lateral:
        notes += ("No unbalance response: unbalance does not act along the shaft.",)
        _extend(checks, curves, thrust_checks(closed, plant))
    elif residual is None:
        notes += (
            "No unbalance response: no balancing speed is known; set requirements.balance_speed "
            "or a speed range.",
        )
    else:
        _extend(
            checks, curves, unbalance_checks(plant, response, evaluator, requirements, residual)
        )
    if plant_at is not None and plant.machine.operation.running[1] > 0:
        span = covered or plant.machine.operation.running
        under = law_at or (lambda other: controller)
        _extend(
            checks,
            curves,
            _assembled(plant_at, plant, controller, under, span, requirements, residual, small_at),
        )
    tell("time response", 0.85)
    _extend(checks, curves, pulse_checks(pulse_response(closed, plant), plant, requirements))
    tell("done", 1.0)
    return Checks(label, True, tuple(checks), tuple(curves), notes)


@named_failure("the sensitivity")
def check_sensitivity(plant: Plant, controller: LawLike) -> Checks:
    """Poles and sensitivities of ``check`` alone, the same to the last digit: what is cheap enough
    for every operating point. Raises InvalidInput for a controller of the wrong size.
    """
    requirements = plant.machine.requirements
    controller = match_controller(controller, plant)
    eigenmodes = modes(closed_loop(plant, controller), plant.ports)
    speed = max(top_speed(plant.machine), plant.point.speed)
    checks: list[Check] = pole_checks(eigenmodes, requirements, speed)
    label = plant.point.label or f"{plant.point.speed / TWO_PI:.4g} Hz"
    if eigenmodes.poles.real.max() >= 0:
        return Checks(label, False, tuple(checks[:1]), ())
    highest = sensitivity_range(speed, controller.dt)
    grid = _grid(eigenmodes.poles, None, highest, controller.dt)
    evaluator = loop_evaluator(plant, controller)
    within = (float(grid[0]), min(highest, float(grid[-1])))
    found, _ = _sensitivities(plant, evaluator(grid), evaluator, within, requirements)
    return Checks(label, True, (*checks, *found), ())


def _sensitivities(
    plant: Plant,
    response: LoopResponse,
    evaluator: Evaluator,
    within: tuple[float, float],
    requirements: Requirements,
) -> tuple[list[Check], list[Curve]]:
    """``sensitivity_checks``, which say where solid cores count with their half order itself."""
    checks, curves = sensitivity_checks(response, evaluator, requirements, within)
    if solid_cores(plant):
        words = ", with the cores' exact half order"
        checks = [replace(check, detail=check.detail + words) for check in checks]
    return checks, curves


def sensitivity_range(speed: float, dt: float | None) -> float:
    """Up to where ISO 14839-3 evaluates the sensitivity [rad/s], within what a sampled law has."""
    highest = max(SENSITIVITY_RANGE.limits[0].value, SPEED_RANGE_FACTOR * speed)
    return highest if dt is None else min(highest, np.pi / dt)


def _extend(
    checks: list[Check], curves: list[Curve], extra: tuple[list[Check], list[Curve]]
) -> None:
    checks += extra[0]
    curves += extra[1]


def _grid(
    poles: np.ndarray, omega: ArrayLike | None, highest: float, dt: float | None
) -> np.ndarray:
    top = np.inf if dt is None else np.pi / dt
    if omega is None:
        return frequency_grid(poles, _LOWEST, min(_BEYOND * highest, top))
    frequencies = check_shape(omega, "omega", "(w)").astype(float)
    if frequencies.size < 2 or frequencies[0] <= 0 or (np.diff(frequencies) <= 0).any():
        raise invalid(
            "omega",
            "not an ascending grid of positive frequencies",
            "ascending, from above 0 rad/s",
            "sort it",
        )
    return add_poles(frequencies, poles)


def _notes(plant: Plant, dt: float | None) -> tuple[str, ...]:
    notes: tuple[str, ...] = ()
    if plant.bending_modes is not None:
        notes += (
            f"The plant is reduced to {plant.bending_modes} bending modes per plane: spillover "
            "into others is not seen.",
        )
    if dt is not None:
        notes += (
            f"Sampled controller (dt = {dt:g} s): poles and time responses of the plant sampled "
            "with a zero-order hold, its free modes above half the rate at their own frequency; "
            "frequency curves use the base band of the hold, so aliasing near the Nyquist "
            "frequency is not in them.",
        )
    return notes


def _assembled(
    plant_at: Callable[[float], Plant],
    plant: Plant,
    controller: LawLike,
    law_at: Callable[[Plant], StateSpace],
    span: tuple[float, float],
    requirements: Requirements,
    residual: Unbalance | None,
    small_at: Callable[[float], Plant] | None = None,
) -> tuple[list[Check], list[Curve]]:
    """Stability and the unbalance curve along speeds [rad/s], with the rotor assembled anew at
    every speed; small_at: a smaller plant there, that shows where to look.
    """
    low, high = span
    even = np.linspace(low, high, _STABILITY_SPEEDS)
    knots = speed_knots(plant.machine, low, high)

    def loop_at(w: float, plant_at: Callable[[float], Plant] = plant_at) -> StateSpace:
        return loop_alone(at := plant_at(w), law_at(at))

    along = follow(
        loop_at if small_at is None else partial(loop_at, plant_at=small_at),
        np.unique([*even, *knots]),
        critical=residual is not None,
        whole_at=None if small_at is None else loop_at,
    )
    stability = [speed_stability_check(along, plant.point)]
    if plant.machine.rotating_share:
        stability += [threshold_check(loop_at, *span)]
    if residual is None or not stability[0].passed:
        return stability, []
    low = max(low, 0.02 * high)
    speeds = np.unique([*np.linspace(low, high, _SPEEDS), *speed_knots(plant.machine, low, high)])
    if requirements.unbalance_to is not None and speeds[0] < requirements.unbalance_to < high:
        speeds = np.unique(np.append(speeds, requirements.unbalance_to))
    curve = replace(
        unbalance_curve(plant_at, speeds, controller, residual, along.critical, law_at),
        name="unbalance.assembled_0p",
    )
    return [*stability, assembled_check(curve, requirements)], [curve]
