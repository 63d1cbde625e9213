"""One controller in time: a scenario on the linear loop or on the virtual rig, and run-ups of
several.

trace = simulate_scenario(machine, controller, "levitation")
                    what the front door and `ambrose simulate` call
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import wraps
from typing import Any, Literal

import numpy as np

from ambrose.core.arguments import names_wrong_types
from ambrose.core.checks import invalid
from ambrose.judge.plants import Progress, chosen_point
from ambrose.law.law import LawLike, law_of
from ambrose.law.loop import closed_loop, match_controller, running_law
from ambrose.law.supervision import check_pair, supervised, supervision_limits
from ambrose.law.timing import DEFAULT, Timing, timing_of
from ambrose.machine.axial import AxialMachine
from ambrose.machine.description import OperatingPoint
from ambrose.machine.machine import Machine
from ambrose.model.assemble import assemble
from ambrose.model.basis import judged_bending
from ambrose.model.effects.rotor import mass_properties
from ambrose.model.plant import Plant, beyond_top_speed
from ambrose.model.reduce import reduce
from ambrose.registry import registered, resolve
from ambrose.rig import all_axes, linear, virtual_rig
from ambrose.rig.engine.controller import sample_time
from ambrose.rig.engine.state import RIG_MODES
from ambrose.rig.run_up import Step, spin_up
from ambrose.rig.scenario import Scenario, load_scenario
from ambrose.rig.synchronous import beside_law, blocks_of
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


def _naming_laws(run: Callable[..., Trace]) -> Callable[..., Trace]:
    """The function, its trace with what controlled."""

    @wraps(run)
    def named(
        machine: Machine | Plant, controller: LawLike, scenario: str | Scenario, **options: Any
    ) -> Trace:
        given = {"Controller": controller} | {
            f"{name.capitalize()} controller": options.get(name)
            for name in ("second", "fallback", "axial")
        }
        trace = run(machine, controller, scenario, **options)
        laws = ((part, law_of(law).named) for part, law in given.items() if law is not None)
        return replace(trace, laws=tuple(laws))

    return named


@names_wrong_types
@_naming_laws
def simulate_scenario(
    machine: Machine | Plant,
    controller: LawLike,
    scenario: str | Scenario,
    *,
    point: str | OperatingPoint | None = None,
    linear: bool = False,
    rate: float | None = None,
    delay_samples: int | None = None,
    fallback: LawLike | None = None,
    pressure_rate: float | None = None,
    pressure_error: float = 0.0,
    stuck_after: float | None = None,
    estimate: Literal["beside", "alone"] | None = None,
    axial: LawLike | None = None,
    progress: Progress = lambda stage: None,
    **rig: Any,
) -> Trace:
    """One scenario on the nonlinear virtual rig or, ``linear``, on the linear closed loop.

    machine: or a Plant, whose operating point is then the default. controller: what controls, as a
    law or as anything that ``law.law.law_of`` makes one of. scenario: bundled, a file, or a
    Scenario. point: operating point or label (None: the nominal one). rate [Hz], delay_samples: of
    the controller (None: as it or the machine file says; the rig takes 10 kHz and one sample where
    nobody does). fallback: the fixed controller that takes over where the pressure that a schedule
    is told cannot be trusted, pressure_rate [Pa/s]: how fast that may change (None: the machine
    file's), pressure_error [Pa]: how far off the reading may be, stuck_after [s]: how long it may
    be the very same (None: for ever); ``law.supervision``. estimate: a seal monitor runs "beside"
    the reading, or "alone" in place of it (registered by the annex of schedules). axial: the
    controller of the axis along the shaft: all axes then run together (``rig.all_axes``), as with a
    program of all axes (rig only). Synchronous blocks of the controller, else of the machine file,
    run beside it (rig only, without the axis along the shaft). rig: further arguments of
    ``virtual_rig.run`` (second, bending_modes, seed, path, ...). Raises InvalidInput.
    """
    law = law_of(controller)
    plant = machine if isinstance(machine, Plant) else None
    described = machine.machine if isinstance(machine, Plant) else machine
    events = scenario if isinstance(scenario, Scenario) else load_scenario(scenario)
    parts = all_axes.parts_of(law, axial)
    if parts is not None:
        given = {"linear": linear, "fallback": fallback, "second": rig.pop("second", None)}
        return _all_axes(described, parts, events, point, given, rate, delay_samples, progress, rig)
    across = events.across if isinstance(described, AxialMachine) else ()
    events, where = events.on(described), chosen_point(described, point)
    timing = timing_of(described, law, rate, delay_samples)
    blocks = blocks_of(described, law)
    if blocks and (linear or fallback is not None or rig.get("second") is not None):
        raise invalid(
            "the simulation of a controller with synchronous blocks",
            "linear" if linear else "with a second controller",
            "on the virtual rig, the controller alone",
            "leave that out, or the blocks out of the controller's file",
        )
    if linear:
        if rig or fallback is not None:
            raise invalid(
                "the simulation",
                f"linear with {', '.join(rig) or 'a fallback'}",
                "on the virtual rig for these",
                "leave linear out",
            )
        if plant is None or where is not None:
            progress("assembling the plant")
            plant = assemble(described, where or described.operation.nominal)
        progress(f"simulating {events.name}")
        trace = simulate_linear(plant, law, events, timing)
        return _warned(trace, described, events, plant.point, across=across)
    if timing is not None:
        rig.setdefault("computing_delay", timing.delay_samples)
        events = (
            replace(events, sample_time=timing.sample_time)
            if events.sample_time is None or rate is not None
            else events
        )
    progress(
        f"running {events.name} on the virtual rig (the first run on a computer compiles it, half "
        "a minute)"
    )
    start = where or (plant.point if plant is not None else None)
    if blocks:
        begin = start or described.operation.nominal
        if events.speed is None:  # the key phasor's
            events = replace(events, speed=begin.speed)
        beside = beside_law(described, law, blocks, events, begin, timing or DEFAULT)
        trace = virtual_rig.run(described, beside, events, point=start, progress=progress, **rig)
        return replace(trace, text=f"{trace.text}; {beside.words()}")
    if isinstance(described, AxialMachine) and fallback is not None:
        raise invalid("fallback", "given", "left out", "no law along the shaft follows a pressure")
    if fallback is None:
        trace = virtual_rig.run(described, law, events, point=start, progress=progress, **rig)
        return _warned(trace, described, events, start, rig.get("bending_modes"), across=across)
    sample = sample_time(law, described, events.sample_time)
    schedule, other = check_pair(law, fallback)
    stuck = math.inf if stuck_after is None else stuck_after
    rate = math.inf if estimate == "alone" else pressure_rate  # a mean of the past moves by steps
    limits = supervision_limits(schedule, described, rate, pressure_error, stuck)
    program: Any = supervised(law, other, described, sample, limits)
    if estimate is not None:
        at = start or described.operation.nominal
        program = _companion()(program, described, events, other, at, estimate, pressure_rate)
    trace = virtual_rig.run(described, program, events, point=start, progress=progress, **rig)
    trace = replace(trace, text=f"{trace.text}; {program.words()}")
    return _warned(trace, described, events, start, rig.get("bending_modes"))


def _all_axes(
    machine: Machine,
    parts: all_axes.Parts,
    events: Scenario,
    point: str | OperatingPoint | None,
    given: Mapping[str, Any],
    rate: float | None,
    delay_samples: int | None,
    progress: Progress,
    rig: dict[str, Any],
) -> Trace:
    """A scenario on the rig of all axes. Raises InvalidInput for what else was given."""
    for name, value in given.items():
        if value:
            raise invalid(
                f"{name} beside an axial controller",
                "given",
                "left out: all axes run on the nonlinear rig with one controller each",
                "leave it out, or run the parts one by one",
            )
    where = chosen_point(machine, point)
    timing = timing_of(machine, parts.radial, rate, delay_samples)
    if timing is not None:
        rig.setdefault("computing_delay", timing.delay_samples)
        if events.sample_time is None or rate is not None:
            events = replace(events, sample_time=timing.sample_time)
    trace = all_axes.run(machine, parts, events, point=where, progress=progress, **rig)
    return _warned(trace, machine, events.parted(machine)[0], where, rig.get("bending_modes"))


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
            f"{mode} is judged but not on the rig; --bending-modes {len(judged)} takes them in"
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
