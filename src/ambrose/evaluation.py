"""Evaluation: one controller on the full plants of a machine, point by point, over all tolerances, and in time.

verification = verify_controller(machine, controller)                    what the front door and `ambrose verify` call
trace = simulate_scenario(machine, controller, "levitation")                      the same for `ambrose simulate`
candidate = evaluate("mu", synthesis, full_plants(machine))              everything of it, as a comparison takes it
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ambrose.core.checks import InvalidInput, check_positive, invalid
from ambrose.core.frequency import frequency_response
from ambrose.core.sampling import c2d, delayed
from ambrose.core.scheduled import ScheduledSystem
from ambrose.core.statespace import StateSpace, select
from ambrose.machine.description import OperatingPoint, Tolerance
from ambrose.machine.machine import Machine
from ambrose.machine.parameters import operating_point
from ambrose.physics.rotor import mass_properties
from ambrose.plant.assemble import assemble
from ambrose.plant.loop import closed_loop, match_controller
from ambrose.plant.model import Plant
from ambrose.plant.reduce import reduce
from ambrose.plant.uncertainty import with_offsets_of
from ambrose.simulation import linear, virtual_rig
from ambrose.simulation.run_up import Step, spin_up, steps
from ambrose.simulation.scenario import Scenario, load_scenario
from ambrose.simulation.trace import Trace
from ambrose.synthesis.result import Synthesis
from ambrose.synthesis.weights import machine_weights
from ambrose.verification import campbell, nominal, robust, sampled
from ambrose.verification.checks import Check, Checks, Curve
from ambrose.verification.verification import Verification

Progress = Callable[[str], None]
SCENARIOS = ("impulse-orthogonal", "impulse-parallel")  # the two disturbance patterns of P5
RUN_UP = "spin-up-steps"  # P3: 20 to 300 Hz in 1 s, a step of force or set point every 50 ms
_CAMPBELL_SPEEDS, _CAMPBELL_MODES = 15, 10


@dataclass(frozen=True, slots=True, eq=False)
class Candidate:
    """One controller and all results about it. Raises InvalidInput for a name or a label that does not tell apart.

    name: for people ("PID", "H-infinity", "mu"); checks: per operating point; robust: over the whole tolerance box, from
    verify_tolerances (None: not evaluated); traces: (operating point, trace) pairs, several scenarios; left_out: labels of the
    operating points that its schedule does not cover.
    """

    name: str
    synthesis: Synthesis
    checks: tuple[Checks, ...]
    robust: Checks | None = None
    traces: tuple[tuple[str, Trace], ...] = ()
    left_out: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if not self.name.strip():
            raise InvalidInput("a candidate has no name; give it one, e.g. that of its method")
        if not self.checks:
            raise InvalidInput(f"candidate {self.name!r} has no checks; verify it at one operating point at least")
        labels = [checks.label for checks in self.checks]
        twice = next((label for label in labels if labels.count(label) > 1), None)
        if twice is not None:
            raise InvalidInput(f"candidate {self.name!r} has two verifications labelled {twice!r}; give every point its label")

    @property
    def verifications(self) -> tuple[Checks, ...]:
        """The checks at every operating point, then those over the tolerance box."""
        return (*self.checks, *([self.robust] if self.robust is not None else []))

    @property
    def passed(self) -> bool:
        """Whether no operating point is left out and every check at every one and over the tolerance box is met."""
        return not self.left_out and all(checks.passed for checks in self.verifications)

    def at(self, point: str) -> Checks | None:
        """The checks at the operating point of that label; None where it was not verified."""
        return next((checks for checks in self.checks if checks.label == point), None)


@dataclass(frozen=True, slots=True, eq=False)
class Deployed:
    """A controller as it runs on the machine, where that differs from its design.

    law: sampled and with its computing delay, which is verified; program: what computes it, run on the rig; plants: of the
    machine that the rig stands for.
    """

    law: StateSpace | ScheduledSystem
    program: Any
    plants: tuple[Plant, ...]


@dataclass(frozen=True, slots=True, eq=False)
class RunUp:
    """One controller while the machine runs up: on the linear loop and on the rig, with what followed each step."""

    name: str
    linear: Trace
    rig: Trace
    linear_steps: tuple[Step, ...]
    rig_steps: tuple[Step, ...]


def find(checks: Checks | None, name: str) -> Check | None:
    """The check of that name, if there is one."""
    return next((check for check in checks.checks if check.name == name), None) if checks is not None else None


def points_of(machine: Machine, candidates: Sequence[Candidate]) -> tuple[str, ...]:
    """The labels of all operating points, by rising speed and seal pressure; unknown ones last, as they come.

    Raises InvalidInput for no candidates, or two of the same name.
    """
    names = [candidate.name for candidate in candidates]
    if not names or len(set(names)) < len(names):
        raise InvalidInput(f"the candidates are named {', '.join(names) or 'not at all'}, but need one name each; rename them")
    known = {point.label: (point.speed, point.seal_pressure) for point in machine.operation.points}
    labels = dict.fromkeys(checks.label for candidate in candidates for checks in candidate.checks)
    return tuple(sorted(labels, key=lambda label: known.get(label, (float("inf"), 0.0))))


# The plants of a machine


def full_plants(machine: Machine) -> tuple[Plant, ...]:
    """The full finite-element plant at every operating point of the machine; the first is the one designs are made for."""
    first = machine.operation.design
    others = [point for point in machine.operation.points if point is not first]
    return tuple(assemble(machine, point) for point in (first, *others))


def plant_at(machine: Machine, point: str | OperatingPoint | None = None) -> Plant:
    """The full plant at an operating point, given itself or by its label or the beginning of it (None: the design point).

    Raises InvalidInput.
    """
    return assemble(machine, _point(machine, point) or machine.operation.design)


def _point(machine: Machine, point: str | OperatingPoint | None) -> OperatingPoint | None:
    return operating_point(machine, point) if isinstance(point, str) else point


def plants_along_speed(plant: Plant) -> Callable[[float], Plant]:
    """Speed [rad/s] -> the plant assembled anew at that speed."""
    return lambda speed: with_offsets_of(assemble(plant.machine, replace(plant.point, speed=speed)), plant)


def covers(law: Any, plant: Plant) -> bool:
    """Whether a law is meant for the plant's speed and seal pressure: a schedule has a range, and a pressure it was made at."""
    if not isinstance(law, ScheduledSystem):
        return True
    low, high = law.range
    design = plant.machine.operation.design
    slack = 1e-9 * high
    return low - slack <= plant.point.speed <= high + slack and plant.point.seal_pressure == design.seal_pressure


def _covered(law: Any, plants: Sequence[Plant]) -> tuple[tuple[Plant, ...], tuple[str, ...]]:
    """The plants that a law is meant for, and the labels of the points that it leaves out. Raises InvalidInput for none."""
    within = tuple(plant for plant in plants if covers(law, plant))
    if not within:
        low, high = law.range
        raise invalid(
            "the scheduled range", f"{low:g} to {high:g} rad/s", "one with an operating point of the machine in it",
            "design over the machine's own speeds",
        )  # fmt: skip
    return within, tuple(plant.point.label for plant in plants if not covers(law, plant))


def plant_gain(plant: Plant) -> Curve:
    """Largest singular value of currents -> sensors [m/A], 1 Hz to 5 kHz."""
    omega = np.geomspace(2 * np.pi, 2 * np.pi * 5000, 600)
    gain = frequency_response(select(plant.system, plant.named("u"), plant.named("y")), omega).max_singular_value()[None]
    name = "plant gain, currents to sensors"
    return Curve("plant.gain", name, "frequency", omega, gain, ("max singular value",), "rad/s", "m/A")


# Verification


def verify_controller(
    machine: Machine | Plant | Sequence[Plant],
    controller: Any,
    points: Sequence[str | OperatingPoint] | None = None,
    *,
    tolerances: bool = True,
    rate: float | None = None,
    progress: Progress = lambda stage: None,
) -> Verification:
    """The checks of a controller on the full plant at every operating point, and over the machine's tolerances.

    machine: or the plants to verify on, one or several. controller: a Synthesis, a schedule over speed, or anything with A, B,
    C, D. points: operating points or labels (None: all). tolerances: whether the tolerance box is examined, around the first
    point. rate [Hz]: the controller as it runs, sampled by Tustin's map and one sample late (None: as it is). Operating points
    that a schedule does not cover are listed as left out. Raises InvalidInput where the controller is not one for this machine.
    """
    law = getattr(controller, "law", controller)
    if not isinstance(machine, Machine):
        plants = (machine,) if isinstance(machine, Plant) else tuple(machine)
    elif points is None:
        plants = full_plants(machine)
    else:
        plants = tuple(plant_at(machine, point) for point in points)
    if not plants:
        raise InvalidInput("no operating point is given; name one at least, or leave points out for all of the machine")
    within, left_out = _covered(law, plants)
    if rate is not None:
        law = _at_rate(law, within[0], rate)
    checks = verify_points(within, law, progress)
    box = None
    if tolerances:
        box = verify_tolerances(within[0], match_controller(law, within[0]), checks[0].stable, progress)
    return Verification(checks, box, left_out)


def _at_rate(law: Any, plant: Plant, rate: float) -> StateSpace:
    """A fixed continuous law as it runs at a sample rate [Hz]."""
    if isinstance(law, ScheduledSystem):
        raise InvalidInput("a scheduled controller is verified as it is designed; leave rate out, or give its .at(speed)")
    fixed = match_controller(law, plant)
    check_positive(rate, "rate", "give the sample rate in Hz, or leave it out")
    if fixed.dt is not None:
        raise invalid("the controller", f"sampled at {1 / fixed.dt:g} Hz", "continuous where a rate is given", "leave rate out")
    return delayed(c2d(fixed, 1 / rate, "tustin"), 1)


def verify_points(plants: Sequence[Plant], controller: Any, progress: Progress = lambda stage: None) -> tuple[Checks, ...]:
    """The checks on every full plant. Raises InvalidInput where the controller is not one for this machine."""
    results = []
    for plant in plants:
        progress(f"verifying at {plant.point.label}")
        fixed = not isinstance(controller, ScheduledSystem)  # a scheduled one has its own verdict over speed
        turning = fixed and plant.machine.operation.speed_range[1] > 0 and plant is plants[0]
        along = plants_along_speed(plant) if turning else None
        results.append(nominal.check(plant, match_controller(controller, plant), plant_at=along))
    return tuple(results)


def verify_tolerances(
    plant: Plant, controller: Any, stable: bool, progress: Progress, tolerances: Sequence[Tolerance] | None = None
) -> Checks | None:
    """The checks over the machine's tolerances; None without tolerances and for an unstable loop.

    A sampled controller (with its delay) is examined at the corners and at samples of the box, nothing is proved between them.
    tolerances: None: all. Otherwise those, and of all together only the number of unstable corners and samples. Worst cases are
    searched on the full model; stability is proved on the reduced one, with one bending mode per plane.
    """
    if not plant.machine.tolerances or not stable:
        return None
    progress("verifying over all tolerances")
    if controller.dt is not None:
        return sampled.check_over_box(plant, controller)
    weights = machine_weights(plant.machine) if plant.machine.weights is not None else None
    box = robust.check(plant, controller, tolerances, weights)
    proof = [
        replace(check, detail=f"{check.detail}; on the reduced model with one bending mode per plane")
        for check in robust.check(reduce(plant, 1), controller, tolerances).checks
        if check.name == "robust.stability.proved"
    ]
    every = [] if tolerances is None else [robust.stability(plant, controller)]
    return replace(box, checks=(*box.checks, *proof, *every))


def campbell_map(plant: Plant, controller: Any, progress: Progress) -> tuple[Curve, ...]:
    """Closed-loop natural frequencies and damping over the machine's speed range; empty for one that does not turn."""
    low, high = plant.machine.operation.speed_range
    if high <= low:
        return ()
    progress("following the modes over speed")
    along = campbell.campbell(plants_along_speed(plant), np.linspace(low, high, _CAMPBELL_SPEEDS), _CAMPBELL_MODES, controller)
    return tuple(campbell.campbell_curves(along))


# Simulation


def simulate_scenario(
    machine: Machine | Plant,
    controller: Any,
    scenario: str | Scenario,
    *,
    point: str | OperatingPoint | None = None,
    linear: bool = False,
    progress: Progress = lambda stage: None,
    **rig: Any,
) -> Trace:
    """One scenario on the nonlinear virtual rig or, ``linear``, on the linear closed loop.

    machine: or a Plant, whose operating point is then the default. controller: a Synthesis, a schedule over speed, or anything
    with A, B, C, D. scenario: bundled, a file, or a Scenario. point: operating point or label (None: the nominal one). rig:
    further arguments of ``virtual_rig.run`` (second, bending_modes, seed, path, ...). Raises InvalidInput.
    """
    law = getattr(controller, "law", controller)
    plant = machine if isinstance(machine, Plant) else None
    described = machine.machine if isinstance(machine, Plant) else machine
    events = scenario if isinstance(scenario, Scenario) else load_scenario(scenario)
    where = _point(described, point)
    if linear:
        if rig:
            raise invalid("the simulation", f"linear with {', '.join(rig)}", "on the virtual rig for these", "leave linear out")
        if plant is None or where is not None:
            progress("assembling the plant")
            plant = assemble(described, where or described.operation.nominal)
        progress(f"simulating {events.name}")
        return simulate_linear(plant, law, events)
    progress(f"running {events.name} on the virtual rig (the first run on a computer compiles it, half a minute)")
    start = where or (plant.point if plant is not None else None)
    if "second" in rig:
        rig["second"] = getattr(rig["second"], "law", rig["second"])
    return virtual_rig.run(described, law, events, point=start, progress=progress, **rig)


def simulate_linear(plant: Plant, controller: Any, scenario: str | Scenario) -> Trace:
    """One scenario on the linear closed loop; stops where the rotor would touch down.

    Where the scenario changes the speed, the plant changes with it (``run_up.spin_up``).
    """
    events = scenario if isinstance(scenario, Scenario) else load_scenario(scenario)
    if events.runs_up:
        scheduled = isinstance(controller, ScheduledSystem)
        return spin_up(plant, controller if scheduled else match_controller(controller, plant), events)
    gaps = [b.touchdown_gap for b in plant.machine.bearings if b.touchdown_gap is not None]
    return linear.run(
        closed_loop(plant, match_controller(controller, plant)),
        events,
        machine=plant.machine.name,
        point=plant.point,
        mass=mass_properties(plant.rotor_model).mass,
        displacement_limit=min(gaps, default=None),
    )


def _on_the_rig(plant: Plant, program: Any, scenario: str) -> Trace:
    """One scenario on the virtual rig with the controller as it would be deployed; touchdown is an outcome.

    Only the measured displacements are kept: the currents carry the rotor's weight and hide the response beside it.
    """
    trace = virtual_rig.run(plant.machine, program, load_scenario(scenario), point=plant.point)
    measured = trace.record.select(plant.named("y"))
    return replace(trace, record=measured, scenario=f"{scenario} on the virtual rig")


# All of it


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

    plants: full, the first one carries the verification over the tolerances, which is of the continuous controller;
    tolerances: as for ``verify_tolerances``. In time: both patterns of P5 on the linear loop, one also on the virtual rig.
    deployed: as it runs, where that differs: its law is verified point by point, its program runs the rig (None: the
    controller itself does). Raises InvalidInput.
    """
    law = synthesis.law
    within, left_out = _covered(law, plants)
    running = Deployed(law, law, within) if deployed is None else deployed
    checks = verify_points(within, running.law, progress)
    box = verify_tolerances(within[0], synthesis.controller, checks[0].stable, progress, tolerances)
    traces: list[tuple[str, Trace]] = []
    for plant, real in zip(within, running.plants, strict=True):
        label = plant.point.label
        progress(f"simulating at {label}")
        traces += [(label, simulate_linear(plant, law, scenario)) for scenario in SCENARIOS]
        progress(f"virtual rig at {label}")
        traces.append((label, _on_the_rig(real, running.program, SCENARIOS[-1])))
    return Candidate(name, synthesis, checks, box, tuple(traces), left_out)


def run_ups(plant: Plant, candidates: tuple[Candidate, ...], progress: Progress) -> tuple[RunUp, ...]:
    """The scheduled candidates and the robust ones beside them while the machine runs up, on the linear loop and on the virtual
    rig; none where no schedule covers the scenario's speeds."""
    scenario = load_scenario(RUN_UP)
    low, high = scenario.speed_at(0.0), scenario.speed_at(scenario.duration)
    schedules = [c.synthesis.scheduled for c in candidates if c.synthesis.scheduled is not None]
    if not any(s.range[0] <= low * (1 + 1e-9) and high <= s.range[1] * (1 + 1e-9) for s in schedules):
        return ()
    runs = []
    for candidate in candidates:
        if candidate.synthesis.method not in {"lpv", "mu"}:  # the scheduled one, and the fixed one that is robust
            continue
        law = candidate.synthesis.law
        progress(f"{candidate.name}: running up, {RUN_UP}")
        linear = spin_up(plant, law, scenario)
        rig = virtual_rig.run(plant.machine, law, scenario, point=plant.point)
        y = plant.named("y")
        runs.append(RunUp(candidate.name, linear, rig, steps(linear, scenario, y), steps(rig, scenario, y)))
    return tuple(runs)
