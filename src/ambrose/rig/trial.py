"""One controller in time: a scenario on the linear loop or on the virtual rig, and run-ups of
several.

trace = simulate_scenario(machine, controller, "levitation")
                    what the front door and `ambrose simulate` call
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np

from ambrose.core.checks import InvalidInput, check_positive, invalid, names_wrong_types
from ambrose.core.response import settling_time
from ambrose.core.scheduled import ScheduledSystem
from ambrose.core.statespace import StateSpace
from ambrose.judge.checks import CONTINUOUS, Check, Checks
from ambrose.judge.plants import Progress, chosen_point, split_covered
from ambrose.judge.result import Synthesis
from ambrose.judge.verdict import verify_points, verify_ranges, verify_tolerances
from ambrose.law.law import (
    PRESSURE,
    SPEED,
    Law,
    LawLike,
    Scheduling,
    extension,
    law_of,
)
from ambrose.law.loop import (
    DEFAULT,
    Timing,
    closed_loop,
    laws_of,
    machine_timing,
    match_controller,
    running_law,
    timing_of,
)
from ambrose.law.supervision import check_pair, supervised, supervision_limits
from ambrose.machine.description import OperatingPoint, Tolerance
from ambrose.machine.machine import Machine
from ambrose.machine.part import Synchronous
from ambrose.model.assemble import assemble, bending_modes_of, judged_bending
from ambrose.model.effects.rotor import mass_properties
from ambrose.model.plant import Plant, beyond_top_speed
from ambrose.model.uncertainty import free_mode_reduction, reduce
from ambrose.options import Simulating
from ambrose.registry import registered, resolve
from ambrose.rig import all_axes, linear, virtual_rig
from ambrose.rig.engine.controller import sample_time
from ambrose.rig.engine.state import RIG_MODES
from ambrose.rig.scenario import Scenario, load_scenario
from ambrose.rig.trace import Trace

ALL_MODES = 10**6  # of the linear loop
RUN_UP = "spin-up-steps"  # P3: 20 to 300 Hz in 1 s, a step of force or set point every 50 ms


@dataclass(frozen=True, slots=True, eq=False)
class RunUp:
    """One controller while the machine runs up: on the linear loop and on the rig, with what
    followed each step.
    """

    name: str
    linear: Trace
    rig: Trace
    linear_steps: tuple[Step, ...]
    rig_steps: tuple[Step, ...]


@names_wrong_types
def simulate_scenario(
    machine: Machine | Plant,
    controller: LawLike,
    scenario: str | Scenario,
    *,
    point: str | OperatingPoint | None = None,
    thrust: LawLike | None = None,
    progress: Progress = lambda stage: None,
    **options: Any,
) -> Trace:
    """One scenario on the nonlinear virtual rig or, ``linear``, on the linear closed loop.

    machine: or a Plant, whose operating point is then the default. controller: what controls, as a
    law or as anything that ``law.law.law_of`` makes one of. scenario: bundled, a file, or a
    Scenario. point: operating point or label (None: the nominal one). options: of
    ``ambrose.options.Simulating``; the rig takes 10 kHz and one sample where nobody says a rate.
    With ``axial``, as with a program of all axes, all of them run together (``rig.all_axes``). So
    they do with ``thrust``, or the thrust axis' controller that ``controller`` holds, where they
    can; where not, the radial axes run and ``text`` says why. Synchronous blocks of the controller,
    else of the machine file, run beside it (rig only, without the thrust axis). ``estimate`` is
    registered by the annex of schedules. Raises InvalidInput.
    """
    asked = Simulating(**options)
    # those of virtual_rig.run
    names = ("bending_modes", "seed", "path", "every", "dt", "computing_delay")
    rig = {name: getattr(asked, name) for name in names}
    law, along = law_of(controller), thrust if asked.axial is None else asked.axial
    plant, described = (machine, machine.machine) if isinstance(machine, Plant) else (None, machine)
    events = scenario if isinstance(scenario, Scenario) else load_scenario(scenario)
    alone = ""
    if plant is None:
        (described, law), *others = laws_of(described, law, along, asked.axes).values()
        along = others[0][1] if others else None
        if asked.axes is None and len(described.groups) > 1:
            alone = _why_alone(described, law, along, events, asked)
    if alone and (asked.axial is not None or law.all_axes is not None):
        raise InvalidInput(f"all axes do not run together: {alone}; leave it or the axial law out")
    parts = all_axes.parts_of(law, None if alone else along)
    if parts is None:
        trace = _one_group(described, plant, law, events, point, asked, progress, rig)
    else:
        trace = _all_axes(described, parts, events, point, asked, progress, rig)
    text = f"{trace.text}; radial axes alone: {alone}" if alone else trace.text
    given = {"Controller": controller, "Second controller": asked.second}
    given |= {"Fallback controller": asked.fallback, "Axial controller": None if alone else along}
    laws = ((part, law_of(one).named) for part, one in given.items() if one is not None)
    return replace(trace, text=text, laws=tuple(laws))


def _why_alone(
    machine: Machine, law: Law, along: LawLike | None, events: Scenario, asked: Simulating
) -> str:
    """Why the radial axes run without the thrust axis, whose law is ``along``; "" where all axes
    run together.
    """
    laws = [law, *([] if along is None else [law_of(along)])]
    second = asked.second or asked.fallback
    reasons = {
        "the linear model is of one group of axes": asked.linear,
        "a second controller is of one": second is not None or events.switch_at is not None,
    }
    if law.all_axes is None:
        reasons |= {
            "no controller of the thrust axis is known": along is None,
            "a scheduled controller is of one group": any(one.scheduled_over for one in laws),
            "synchronous blocks are of one group": bool(_blocks(machine, law)),
            "a program is of one group": any(one.program is not None for one in laws),
        }
    return next((words for words, holds in reasons.items() if holds), "")


def _blocks(machine: Machine, law: Law) -> tuple[Synchronous, ...]:
    """The blocks that run beside a law; none beside a program of its own."""
    return () if law.program is not None else law.blocks_on(machine)


def _one_group(
    described: Machine,
    plant: Plant | None,
    law: Law,
    events: Scenario,
    point: str | OperatingPoint | None,
    asked: Simulating,
    progress: Progress,
    rig: dict[str, Any],
) -> Trace:
    """``simulate_scenario`` of one group of axes."""
    fallback = asked.fallback
    rig["second"] = asked.second
    across = () if described.lateral else events.across
    events, where = events.on(described), chosen_point(described, point)
    timing = timing_of(described, law, asked.rate, asked.delay_samples)
    blocks = _blocks(described, law)
    if blocks and (asked.linear or fallback is not None or asked.second is not None):
        raise invalid(
            "the simulation of a controller with synchronous blocks",
            "linear" if asked.linear else "with a second controller",
            "on the virtual rig, the controller alone",
            "leave that out, or the blocks out of the controller's file",
        )
    if asked.linear:
        if plant is None or where is not None:
            progress("assembling the plant")
            plant = assemble(described, where or described.operation.nominal)
        progress(f"simulating {events.name}")
        trace = simulate_linear(plant, law, events, timing)
        return _warned(trace, described, events, plant.point, across=across)
    if timing is not None:
        events, rig = _timed(events, rig, timing, asked)
    progress(
        f"running {events.name} on the virtual rig (the first run on a computer compiles it, half "
        "a minute)"
    )
    start = where or (plant.point if plant is not None else None)
    if blocks:
        begin = start or described.operation.nominal
        if events.speed is None:  # the key phasor's
            events = replace(events, speed=begin.speed)
        both = extension("program")(described, law, blocks, events, begin, timing or DEFAULT)
        trace = virtual_rig.run(described, both, events, point=start, progress=progress, **rig)
        return replace(trace, text=f"{trace.text}; {both.words()}")
    if fallback is not None:
        described.across_the_shaft("no law along it follows a pressure", "leave the fallback out")
    if fallback is None:
        trace = virtual_rig.run(described, law, events, point=start, progress=progress, **rig)
        return _warned(trace, described, events, start, asked.bending_modes, across=across)
    sample = sample_time(law, described, events.sample_time)
    schedule, other = check_pair(law, fallback)
    stuck = math.inf if asked.stuck_after is None else asked.stuck_after
    # a mean of the past moves by steps
    fastest = math.inf if asked.estimate == "alone" else asked.pressure_rate
    limits = supervision_limits(schedule, described, fastest, asked.pressure_error, stuck)
    program: Any = supervised(law, other, described, sample, limits)
    if asked.estimate is not None:
        at = start or described.operation.nominal
        program = _companion()(
            program, described, events, other, at, asked.estimate, asked.pressure_rate
        )
    trace = virtual_rig.run(described, program, events, point=start, progress=progress, **rig)
    trace = replace(trace, text=f"{trace.text}; {program.words()}")
    return _warned(trace, described, events, start, asked.bending_modes)


def _all_axes(
    machine: Machine,
    parts: all_axes.Parts,
    events: Scenario,
    point: str | OperatingPoint | None,
    asked: Simulating,
    progress: Progress,
    rig: dict[str, Any],
) -> Trace:
    """A scenario on the rig of all axes."""
    where = chosen_point(machine, point)
    timing = timing_of(machine, parts.radial, asked.rate, asked.delay_samples)
    if timing is not None:
        events, rig = _timed(events, rig, timing, asked)
    trace = all_axes.run(machine, parts, events, point=where, progress=progress, **rig)
    return _warned(trace, machine, events.parted(machine)[0], where, asked.bending_modes)


def _timed(
    events: Scenario, rig: dict[str, Any], timing: Timing, asked: Simulating
) -> tuple[Scenario, dict[str, Any]]:
    """The scenario and the rig's arguments with a timing, where they state none themselves."""
    if rig["computing_delay"] is None:
        rig = {**rig, "computing_delay": timing.delay_samples}
    if events.sample_time is None or asked.rate is not None:
        events = replace(events, sample_time=timing.sample_time)
    return events, rig


def _warned(
    trace: Trace,
    machine: Machine,
    events: Scenario,
    point: OperatingPoint | None,
    bending_modes: int | None = ALL_MODES,
    across: Sequence[str] = (),
) -> Trace:
    """The trace, its text with what a reader should know: a speed beyond the machine's own; the
    lowest bending mode that the rig lacks though the sensitivity is judged there (bending_modes as
    for ``virtual_rig.run``); what is across the axis that ran.
    """
    at = point or machine.operation.nominal
    fastest = max(events.speed_knots[1], default=at.speed)
    words = [beyond] if (beyond := beyond_top_speed(machine, fastest)) else []
    if across:
        words.append(f"along the shaft, without the scenario's {', '.join(across)}")
    count = RIG_MODES if bending_modes is None else bending_modes
    judged = judged_bending(machine)
    if len(judged) > count:
        mode = f"bending mode {count + 1} ({judged[count] / (2 * math.pi):.4g} Hz)"
        words.append(
            f"{mode} is checked but not on the rig; --bending-modes {len(judged)} takes them in"
        )
    return replace(trace, text="; ".join([trace.text, *words])) if words else trace


def _companion() -> Any:
    """The seal monitor that an annex registered to run beside a supervised program.

    Raises InvalidInput where this installation has none.
    """
    place = registered("companion").get("seal monitor")
    if place is None:
        raise invalid("estimate", "given", "left out", "this installation has no seal monitor")
    return resolve(place)


def simulate_linear(
    plant: Plant, controller: LawLike, scenario: str | Scenario, timing: Timing | None = None
) -> Trace:
    """One scenario on the linear closed loop, with a timing as it runs; stops where the rotor would
    touch down.

    Where the scenario changes the speed or the pressure, the plant changes with it
    (``run_up.spin_up``); a fixed controller then has the mean delay of its sampled loop, a
    scheduled one runs as it was designed.
    """
    events = scenario if isinstance(scenario, Scenario) else load_scenario(scenario)
    events = events.on(plant.machine)
    linear.check_scenario(events)
    if events.runs_up or events.pressures:
        if not events.runs_up and events.speed is not None:
            plant = replace(plant, point=replace(plant.point, speed=events.speed_at(0.0)))
        law = law_of(controller)
        if law.schedule is not None:
            return spin_up(plant, law, events)
        fixed = match_controller(law, plant)
        with_delay = timing is not None and fixed.dt is None
        return spin_up(
            plant, timing.late(fixed) if with_delay and timing is not None else fixed, events
        )
    # the plant turns as the record will say
    if events.speed is not None and events.speed_at(0.0) != plant.point.speed:
        turning = assemble(plant.machine, replace(plant.point, speed=events.speed_at(0.0)))
        plant = turning if plant.bending_modes is None else reduce(turning, plant.bending_modes)
    known = [b.touchdown_gap for b in plant.machine.axis_bearings if b.touchdown_gap is not None]
    gaps = [float(np.min(gap)) for gap in known]  # along the shaft (left, right)
    return linear.run(
        closed_loop(plant, running_law(controller, plant, timing)),
        events,
        machine=plant.machine.name,
        point=plant.point,
        mass=mass_properties(plant.rotor_model).mass,
        displacement_limit=min(gaps, default=None),
    )


def run_on_rig(plant: Plant, program: LawLike, scenario: str, timing: Timing | None) -> Trace:
    """One scenario on the virtual rig with the controller as it would be deployed; touchdown is an
    outcome.

    Only the measured displacements are kept: the currents carry the rotor's weight and hide the
    response beside it.
    """
    rate, delay_samples = (None, None) if timing is None else (timing.rate, timing.delay_samples)
    trace = simulate_scenario(plant, program, scenario, rate=rate, delay_samples=delay_samples)
    measured = trace.record.select(plant.named("y"))
    return replace(trace, record=measured, scenario=f"{scenario} on the virtual rig")


# A run-up through a range of speeds, or of pressures, with disturbances on the way: the linear
# time-varying loop, and how each step settles.
#
# The plant is computed at a few speeds in states that mean the same at all of them (modes of the
# free rotor) and is linear in between; speeds are added until half-way between two of them it
# agrees with the plant computed there. The controller is taken at every speed as it is. The linear
# simulation then holds both over short intervals, as many as its answer needs (rig/linear.py).


_COARSEST, _FINEST = 9, 513  # speeds at which a plant is computed
_STRAIGHT = 1e-3  # of a row's largest entry: how far the plant may bend between two of them


@dataclass(frozen=True, slots=True)
class Step:
    """One window of a run-up. start [s] and speed [rad/s] at its start; peak of |signal| in the
    signals' unit; settling [s] until it stays within the band of the peak around zero (inf: not
    within the window); crossings: sign changes of the largest signal before that, beyond the band
    (two or more ring).
    """

    start: float
    speed: float
    peak: float
    settling: float
    crossings: int


def loops_along(
    plant: Plant,
    controller: LawLike,
    low: float,
    high: float,
    along: Scheduling = SPEED,
    *,
    bending_modes: int = 12,
    points: int | None = None,
) -> linear.LoopAt:
    """The closed loop as a function of speed [rad/s] or pressure [Pa] from low to high, in the same
    states, for ``linear.run``.

    controller: fixed or scheduled (ScheduledSystem), continuous or sampled. bending_modes: kept per
    plane, fewer where the mesh has fewer; a turboexpander's run-up is good to 2 % of the peak with
    2, 0.4 % with 4 and 0.01 % with 12, for what is cut off also gives way statically. points:
    values at which the plant is computed, evenly; None: as many as it takes for every row of its
    matrix to be good to 0.1 % of the row's largest entry half-way between them. Raises
    InvalidInput.
    """
    if not low < high:
        raise invalid(
            f"the {along.name}s",
            f"{low:g} to {high:g} {along.unit}",
            "a range that ascends",
            "exchange them",
        )
    kept = min(bending_modes, bending_modes_of(plant.rotor_model))

    def plant_at(value: float) -> Plant:
        return free_mode_reduction(replace(plant, point=along.moved(plant.point, value)), kept)

    if points is None:
        members = _refined(plant_at, low, high)
    else:
        count = max(int(check_positive(points, "points", "leave it out")), 2)
        members = {float(value): plant_at(float(value)) for value in np.linspace(low, high, count)}
    first = members[low]
    grid = sorted(members)
    between = ScheduledSystem(
        grid, [members[value].system for value in grid], along.name, along.unit
    )

    law = law_of(controller)

    def loop_at(value: float) -> StateSpace:
        at_value = replace(
            first, system=between.at(value), point=along.moved(plant.point, float(value))
        )
        return closed_loop(at_value, law)

    return loop_at


def _refined(plant_at: Callable[[float], Plant], low: float, high: float) -> dict[float, Plant]:
    """Plants from low to high, intervals halved where the plant half-way is not the mean of those
    at the ends.
    """
    members = {float(value): plant_at(float(value)) for value in np.linspace(low, high, _COARSEST)}
    open_ = list(pairwise(sorted(members)))
    while open_ and len(members) < _FINEST:
        following = []
        for left, right in open_:
            middle = (left + right) / 2
            members[middle] = plant_at(middle)
            # each row in units of its largest entry
            A = members[middle].system.A
            mean = (members[left].system.A + members[right].system.A) / 2
            if (np.abs(A - mean).max(axis=1) > _STRAIGHT * np.abs(A).max(axis=1)).any():
                following += [(left, middle), (middle, right)]
        open_ = following
    return members


def spin_up(
    plant: Plant,
    controller: LawLike,
    scenario: Scenario,
    *,
    bending_modes: int = 12,
    points: int | None = None,
) -> Trace:
    """The scenario's run-up or changes of pressure on the linear loop of a full plant; see
    ``loops_along`` and ``linear.run``.

    Raises InvalidInput where neither changes, or both.
    """
    scenario = scenario.on(plant.machine)
    linear.check_scenario(scenario)
    along = SPEED if scenario.runs_up or not scenario.pressures else PRESSURE
    if along is SPEED:
        values = (
            [scenario.speed_at(0.0), scenario.speed_at(scenario.duration)]
            if scenario.runs_up
            else [0.0, 0.0]
        )
    else:
        values = [plant.point.seal_pressure, *(change.pressure for change in scenario.pressures)]
    if min(values) == max(values):
        what = "one whose speed or pressure changes"
        raise invalid(
            "the scenario",
            repr(scenario.name),
            what,
            'the bundled "spin-up-steps" and "pressure-steps" are such',
        )
    loop_at = loops_along(
        plant,
        controller,
        min(values),
        max(values),
        along,
        bending_modes=bending_modes,
        points=points,
    )
    gaps = [b.touchdown_gap for b in plant.machine.bearings if b.touchdown_gap is not None]
    return linear.run(
        loop_at,
        scenario,
        machine=plant.machine.name,
        point=plant.point,
        displacement_limit=min(gaps, default=None),
        mass=mass_properties(plant.rotor_model).mass,
        along=along,
    )


def steps(
    trace: Trace,
    scenario: Scenario,
    signals: Sequence[str],
    *,
    every: float = 0.05,
    band: float = 0.05,
) -> tuple[Step, ...]:
    """How the signals answer in each window of ``every`` seconds, for disturbances that change at
    the start of each.
    """
    every = check_positive(every, "every", "the bundled scenario disturbs every 50 ms")
    time, values = trace.record.time, trace.record.select(list(signals)).values
    intervals = []
    for k in range(int(time[-1] / every + 1e-6)):
        inside = (time >= k * every - 1e-9) & (time < (k + 1) * every - 1e-9)
        part = values[:, inside]
        peak = float(np.abs(part).max())
        after = settling_time(time[inside] - k * every, part, band) if peak > 0 else 0.0
        # the signal with the largest peak, what is beyond the band: its sign changes
        row = part[int(np.argmax(np.abs(part).max(axis=1)))]
        row = row[np.abs(row) > band * peak]
        intervals.append(
            Step(
                k * every,
                scenario.speed_at(k * every),
                peak,
                after,
                int((np.diff(np.sign(row)) != 0).sum()),
            )
        )
    return tuple(intervals)


# One controller with everything that verification and simulation say about it, as a comparison
# takes it.
#
# candidate = evaluate("mu", synthesis, full_plants(machine))


SCENARIOS = ("impulse-orthogonal", "impulse-parallel")  # the two disturbance patterns of P5


@dataclass(frozen=True, slots=True, eq=False)
class Candidate:
    """One controller and all results about it. Raises InvalidInput for a name or a label that does
    not tell apart.

    name: for people ("PID", "H-infinity", "mu"); checks: per operating point; boxes: over the
    tolerances around each, from verify_tolerances; traces: (operating point, trace) pairs, several
    scenarios; left_out: labels of the operating points that its schedule does not cover; timing:
    what loop was judged, in words; ranges: over the machine's ranges, from verify_ranges.
    """

    name: str
    synthesis: Synthesis
    checks: tuple[Checks, ...]
    boxes: tuple[Checks, ...] = ()
    traces: tuple[tuple[str, Trace], ...] = ()
    left_out: tuple[str, ...] = ()
    timing: str = CONTINUOUS
    ranges: tuple[Checks, ...] = ()

    def __post_init__(self) -> None:
        if not self.name.strip():
            raise InvalidInput("a candidate has no name; give it one, e.g. that of its method")
        if not self.checks:
            raise InvalidInput(
                f"candidate {self.name!r} has no checks; verify it at one operating point at least"
            )
        labels = [checks.label for checks in self.checks]
        twice = next((label for label in labels if labels.count(label) > 1), None)
        if twice is not None:
            raise InvalidInput(
                f"candidate {self.name!r} has two verifications labelled {twice!r}; give every "
                "point its label"
            )

    @property
    def robust(self) -> Checks | None:
        """The checks over the tolerances around the first point that has any: the one with all
        curves, bounds and proofs.
        """
        return self.boxes[0] if self.boxes else None

    @property
    def verifications(self) -> tuple[Checks, ...]:
        """The checks at every operating point, then those over the tolerances around each and over
        the ranges.
        """
        return (*self.checks, *self.boxes, *self.ranges)

    @property
    def passed(self) -> bool:
        """Whether no operating point is left out and every check at every one and over the
        tolerances around each is met.
        """
        return not self.left_out and all(checks.passed for checks in self.verifications)

    def at(self, point: str) -> Checks | None:
        """The checks at the operating point of that label; None where it was not verified."""
        return next((checks for checks in self.checks if checks.label == point), None)


@dataclass(frozen=True, slots=True, eq=False)
class Deployed:
    """A controller as it runs on the machine, where that differs from its design.

    law: sampled, without its computing delay, which is verified with it; program: what computes it,
    run on the rig; plants: of the machine that the rig stands for; timing: when it acts (None: it
    is continuous).
    """

    law: LawLike
    program: LawLike
    plants: tuple[Plant, ...]
    timing: Timing | None = None


def find(checks: Checks | None, name: str) -> Check | None:
    """The check of that name, if there is one."""
    return (
        next((check for check in checks.checks if check.name == name), None)
        if checks is not None
        else None
    )


def points_of(machine: Machine, candidates: Sequence[Candidate]) -> tuple[str, ...]:
    """The labels of all operating points, by rising speed and seal pressure; unknown ones last, as
    they come.

    Raises InvalidInput for no candidates, or two of the same name.
    """
    names = [candidate.name for candidate in candidates]
    if not names or len(set(names)) < len(names):
        raise InvalidInput(
            f"the candidates are named {', '.join(names) or 'not at all'}, but need one name "
            "each; rename them"
        )
    known = {
        point.label: (point.speed, point.seal_pressure) for point in machine.operation.envelope
    }
    labels = dict.fromkeys(checks.label for candidate in candidates for checks in candidate.checks)
    return tuple(sorted(labels, key=lambda label: known.get(label, (float("inf"), 0.0))))


def evaluate(
    name: str,
    synthesis: Synthesis,
    plants: Sequence[Plant],
    progress: Progress = lambda stage: None,
    *,
    deployed: Deployed | None = None,
    tolerances: Sequence[Tolerance] | None = None,
) -> Candidate:
    """A controller with everything that verification and simulation say about it.

    plants: full; tolerances: as for ``verify_tolerances``. In time: both patterns of P5 on the
    linear loop, one also on the virtual rig. deployed: as it runs, where that is known: its law is
    verified, its program runs the rig (None: the controller itself does, at the rate that it or the
    machine file knows). Raises InvalidInput.
    """
    law = synthesis
    within, left_out = split_covered(law, plants)
    timing = timing_of(plants[0].machine, synthesis) if deployed is None else deployed.timing
    running = Deployed(law, law, within, timing) if deployed is None else deployed
    checks = verify_points(within, running.law, progress, timing)
    boxes = verify_tolerances(within, running.law, checks, progress, timing, tolerances, design=law)
    ranges, beyond = verify_ranges(plants[0].machine, running.law, checks, progress, timing)
    left_out = (*left_out, *beyond)
    traces: list[tuple[str, Trace]] = []
    for plant, real in zip(within, running.plants, strict=True):
        label = plant.point.label
        progress(f"simulating at {label}")
        traces += [(label, simulate_linear(plant, law, scenario, timing)) for scenario in SCENARIOS]
        progress(f"virtual rig at {label}")
        traces.append((label, run_on_rig(real, running.program, SCENARIOS[-1], timing)))
    words = CONTINUOUS if timing is None else str(timing)
    return Candidate(name, synthesis, checks, boxes, tuple(traces), left_out, words, ranges)


def check_trials(machine: Machine) -> None:
    """Raises InvalidInput for a machine on which a scenario that ``evaluate`` runs is refused,
    before anything is computed.
    """
    timing = machine_timing(machine) or DEFAULT
    for name in SCENARIOS:
        virtual_rig.check_scenario(machine, load_scenario(name), timing.sample_time)


def run_ups(
    plant: Plant, candidates: tuple[Candidate, ...], progress: Progress
) -> tuple[RunUp, ...]:
    """The scheduled candidates and the robust ones beside them while the machine runs up, on the
    linear loop and on the virtual rig; none where no schedule covers the scenario's speeds.
    """
    schedules = [c.synthesis.scheduled for c in candidates if c.synthesis.scheduled is not None]
    if not schedules:  # nor need the machine state what the scenario's speeds are shares of
        return ()
    scenario = load_scenario(RUN_UP).on(plant.machine)
    low, high = scenario.speed_at(0.0), scenario.speed_at(scenario.duration)
    if not any(
        s.axes[0][0] <= low * (1 + 1e-9) and high <= s.axes[0][-1] * (1 + 1e-9) for s in schedules
    ):
        return ()
    runs = []
    for candidate in candidates:
        # the scheduled one, and the fixed ones that are robust
        if candidate.synthesis.method not in {"lpv", "tuned", "mu"}:
            continue
        law = candidate.synthesis.law
        progress(f"{candidate.name}: running up, {RUN_UP}")
        linear = simulate_linear(
            plant, law, scenario, timing_of(plant.machine, candidate.synthesis)
        )
        rig = virtual_rig.run(plant.machine, law, scenario, point=plant.point)
        y = plant.named("y")
        runs.append(
            RunUp(candidate.name, linear, rig, steps(linear, scenario, y), steps(rig, scenario, y))
        )
    return tuple(runs)
