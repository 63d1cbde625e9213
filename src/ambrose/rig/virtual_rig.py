"""The virtual rig: a nonlinear machine in a scenario, under a controller as it is deployed.

Every control sample is a short list of stages (rig/engine/kernel.py): measure, control, command the
amplifiers, log, integrate. The machine between the samples is the rotor in free modes under magnet,
contact, coupling, seal, weight and unbalance forces.
"""

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from ambrose.core.checks import InvalidInput, NumericalFailure, invalid
from ambrose.law.law import PRESSURE, SPEED, ControlProgram, Law, LawLike, law_of
from ambrose.law.loop import DEFAULT, Timing, machine_timing
from ambrose.machine.description import OperatingPoint
from ambrose.machine.machine import Machine
from ambrose.rig import axial_rig
from ambrose.rig.engine.controller import (
    NO_PROGRAM,
    RunningProgram,
    SampledLaw,
    closed_loop_poles,
    sample_time,
    sampled_law,
    take_over,
)
from ambrose.rig.engine.equilibrium import (
    Propagator,
    fastest_pole,
    landed_state,
    levitated_state,
    linear_view,
    measurement,
    propagator,
    state_at_rest,
    steps_per_sample,
    steps_within,
)
from ambrose.rig.engine.inputs import Drive, Plan, plan, stretch
from ambrose.rig.engine.record import Recorder, classify_outcome, watch, within_bounds
from ambrose.rig.engine.state import Rig, build, compiled, kept
from ambrose.rig.linear import waveforms
from ambrose.rig.scenario import LEVITATED, PressureChange, Scenario, SpeedChange
from ambrose.rig.trace import Trace

STRETCH = 4000  # control samples computed at once
_SCHEDULED_STRETCH = {SPEED: 50, PRESSURE: 10}  # while what a controller is scheduled over changes
MEMORY = 256  # samples from which a second controller learns where to take over
_REPORT_EVERY = 2.0  # [s] between two progress messages


def check_scenario(machine: Machine, scenario: Scenario, dt: float) -> None:
    """Raises InvalidInput for what a run of a scenario at a control sample time [s] would refuse,
    without running it.
    """
    scenario = scenario.on(machine)
    along, at = not machine.lateral, machine.operation.nominal
    rig: Any = axial_rig.build(machine, at, dt) if along else build(machine)
    waveforms(scenario, plan(rig, scenario, dt, 0).inputs, dt, 1, rig.mass)


def run(
    machine: Machine,
    controller: LawLike,
    scenario: Scenario,
    *,
    second: LawLike | None = None,
    point: OperatingPoint | None = None,
    bending_modes: int | None = None,
    dt: float | None = None,
    seed: int = 0,
    computing_delay: int | None = None,
    every: int = 1,
    path: str | Path | None = None,
    progress: Callable[[str], None] | None = None,
) -> Trace:
    """Run a scenario on the nonlinear machine.

    controller: a StateSpace (or python-control system) from errors [m] to currents [A], its signals
    matched as in ``law.loop.match_controller``; or, scheduled, a function from speed [rad/s] to
    one, always in the same states (of a schedule over pressure, from what its sensor tells [Pa],
    held where that is lost, clamped to its range where it errs); or a ControlProgram such as
    compiled C code. Continuous, it is sampled by Tustin's map at the scenario's or the machine's
    sample time (else 10 kHz); its output, limited to max_current, acts ``computing_delay`` samples
    later (None: the machine's, else one). second: takes over without a bump at the scenario's
    switch_at. point: bias current, speed and seal pressure at the start, where the scenario does
    not say otherwise (None: the nominal one). bending_modes: per plane (None: 3, as identification
    models). dt [s]: longest integration step (None: by the machine's fastest pole). seed: of the
    sensors' noise. every: only each so many-th sample is recorded. path (.h5): where the record is
    written while it grows; what was run so far stays readable when the run is interrupted.
    progress: is reported how far it is.

    Recorded: y_, u_ (what acts), i_ (coils), f_magnet_ (axes), q_ (ports), what the scenario
    drives, speed and p_seal where they change. Touchdown is an outcome with time and cause, and the
    run goes on; "diverged" means that the state overflowed, and the record ends before. Raises
    InvalidInput, and NumericalFailure where there is no levitated state to start from.
    """
    if not machine.lateral:
        return axial_rig.run(
            machine,
            controller,
            scenario.on(machine),
            point=point,
            second=second,
            dt=dt,
            seed=seed,
            computing_delay=computing_delay,
            every=every,
            path=path,
            progress=progress,
        )
    law, other = law_of(controller), None if second is None else law_of(second)
    if progress is not None and not kept():
        progress("compiling the virtual rig: once per computer, up to a minute")
    scenario = scenario.on(machine)
    dt_control = sample_time(law, machine, scenario.sample_time)
    task = plan(
        build(machine, point, bending_modes),
        scenario,
        dt_control,
        seed,
        law.scheduled_over or SPEED,
    )
    if (second is None) != (scenario.switch_at is None):
        raise InvalidInput(
            "a second controller and the scenario's switch_at belong together; give both or neither"
        )
    if computing_delay is None:
        computing_delay = (machine_timing(machine) or DEFAULT).delay_samples
    # refuses what is no number of samples
    computing_delay = Timing(task.dt, computing_delay).delay_samples
    program = _program(law, other, computing_delay)
    recorder = Recorder(task, every, seed, path)
    begun = time.perf_counter()
    laws = Laws(law, other, machine, task.dt, computing_delay)
    looked_at = conditions(task)
    steps = steps_per_sample(dt, task.dt, fastest_pole(task.rig, [drive for _, drive in looked_at]))
    motion = begin_motion(task, laws, looked_at[0][1], steps_within(task.rig, task.dt, dt))
    pole = max(
        (rightmost(task.rig, drive, laws, time >= task.switch) for time, drive in looked_at),
        key=lambda p: p.real,
    )
    prepared = time.perf_counter()
    monitor = watch(task.rig, scenario)
    with recorder:
        for number, drive, log in _stretches(task, laws, motion, steps, progress, program):
            monitor.follow(task, number, log)
            recorder.add(number, drive, monitor.until_lost(number, log))
            if monitor.inside is not None:  # what comes after it means nothing
                motion.overflow = None
                break
        outcome, text = classify_outcome(monitor, scenario, motion.overflow, pole)
        record = recorder.finish(text)
    return Trace(
        record,
        scenario.name,
        pole.real < 0,
        outcome,
        text,
        pole,
        monitor.stopped_at(motion.overflow),
        touchdown_at=monitor.touched_at,
        levitated_at=monitor.lifted_at,
        run_time=time.perf_counter() - prepared,
        compile_time=prepared - begun,
    )


@dataclass(slots=True)
class Motion:
    """The state between two stretches: machine z, controller x, its output that acts next; near:
    where the magnets are taken as linear; steps of the propagator in a sample; when it overflowed
    [s].
    """

    z: np.ndarray
    x: np.ndarray
    held: np.ndarray
    near: np.ndarray
    substeps: int = 1
    overflow: float | None = None
    propagator: Propagator | None = None
    middle: tuple[int, Drive] | None = None

    def follow(self, task: Plan, drive: Drive, number: int) -> None:
        """The propagator for a stretch from sample number on: that of the middle of its
        ``STRETCH`` samples since the start, so that neither shorter stretches nor an earlier end
        make a difference. Where speed and pressure stay, any middle is that of all stretches.
        """
        middle = (number // STRETCH) * STRETCH + STRETCH // 2
        moves = task.scenario.runs_up or task.scenario.pressures or task.scenario.pressure_sensors
        if self.middle is None or (moves and self.middle[0] != middle):
            quiet = replace(task, scenario=task.scenario.quiet, noise=np.random.default_rng(0))
            self.middle = middle, stretch(quiet, middle, 1)
        self.propagator = propagator(
            task.rig, drive, self.middle[1], self.substeps, self.near, self.propagator
        )


@dataclass(frozen=True, slots=True)
class Laws:
    """The controllers of a run, as they are deployed."""

    first: Law
    second: Law | None
    machine: Machine
    sample: float
    delay: int

    def stretch(self, scenario: Scenario) -> int | None:
        """After how many samples a law is to be read again; None: it does not change."""
        moves = {
            SPEED: scenario.runs_up,
            PRESSURE: bool(scenario.pressures or scenario.pressure_sensors),
        }
        scheduled = [
            one
            for law in (self.first, self.second)
            for one in moves
            if law is not None and moves[one] and law.follows(one)
        ]
        return min((_SCHEDULED_STRETCH[one] for one in scheduled), default=None)

    def at(self, drive: Drive, k: int, switched: bool, sensor: bool = False) -> SampledLaw:
        """The law at the speed and, told by a ``sensor`` that may err, the pressure of sample k,
        before or after the switch.
        """
        law = self.second if switched and self.second is not None else self.first
        point = OperatingPoint(float(drive.speed[k]), float(drive.pressure[k]))
        if sensor:
            point = law.clamped(point)
        return sampled_law(law, self.machine, self.sample, point, self.delay)


def conditions(task: Plan) -> list[tuple[int, Drive]]:
    """One sample, with its number, of the conditions at the start, at the end and around every
    change, with nothing driven.
    """
    quiet = replace(task, scenario=task.scenario.quiet, noise=np.random.default_rng(0))
    last = task.samples - 1
    numbers = {0, last, min(task.switch, last)}
    changes: list[PressureChange | SpeedChange] = [
        *task.scenario.pressures,
        *task.scenario.speed_changes,
    ]
    for change in changes:
        numbers |= {
            min(round(change.time / task.dt), last),
            min(round((change.time + change.ramp) / task.dt) + 1, last),
        }
    return [(number, stretch(quiet, number, 1)) for number in sorted(numbers)]


def begin_motion(task: Plan, laws: Laws, drive: Drive, substeps: int) -> Motion:
    """The state at the start; the compiled code has then been called once, and so is there."""
    motion = start_of(task, laws, drive, substeps)
    trial = replace(motion, z=motion.z.copy(), x=motion.x.copy(), held=motion.held.copy())
    trial.substeps = 1
    trial.follow(task, drive, 0)
    advance_motion(task.rig, laws.at(drive, 0, False), drive, 1, trial, 1)
    return motion


def start_of(task: Plan, laws: Laws, drive: Drive, substeps: int) -> Motion:
    """The state at a scenario's start: in equilibrium, or resting in the touchdown bearings."""
    law = laws.at(drive, 0, False)
    lifted = task.scenario.initial == LEVITATED
    z, x, last_output = (
        levitated_state(task.rig, drive, law) if lifted else landed_state(task.rig, law)
    )
    near = (
        z.copy() if lifted else state_at_rest(task.rig, np.zeros(task.rig.coordinates), last_output)
    )
    return Motion(z, x, last_output, near, substeps)


def rightmost(rig: Rig, drive: Drive, laws: Laws, switched: bool) -> complex:
    """The rightmost pole [rad/s] of the linear loop around the centred rotor."""
    law = laws.at(drive, 0, switched)
    try:
        z, _, u = levitated_state(rig, drive, law)
    except NumericalFailure:
        u = np.zeros(len(rig.axes))
        z = state_at_rest(rig, np.zeros(rig.coordinates), u)
    A, B = linear_view(rig, drive, z, u)
    # an amplifier or sensor may need fewer states than it has
    used = (A != 0).any(axis=0) | (A != 0).any(axis=1)
    used[rig.behind] = False  # nothing in the loop moves race and ring
    poles = closed_loop_poles(
        A[np.ix_(used, used)], B[used], measurement(rig)[:, used], law, laws.sample
    )
    return complex(max(poles, key=lambda p: (p.real, p.imag)))


def _stretches(
    task: Plan,
    laws: Laws,
    motion: Motion,
    steps: int,
    progress: Callable[[str], None] | None,
    program: ControlProgram | None,
) -> Iterator[tuple[int, Drive, np.ndarray]]:
    """Number of the first sample, drive and log (k, columns) of one stretch after the other; motion
    moves along.
    """
    laws_stretch, sensor = (
        None if program is not None else laws.stretch(task.scenario),
        bool(task.scenario.pressure_sensors),
    )
    length = laws_stretch or STRETCH
    switch = task.switch
    reported = time.perf_counter()
    recent: list[tuple[np.ndarray, np.ndarray]] = []
    number, law = 0, None
    running = None
    if program is not None:
        program.begin(motion.x)
        running = RunningProgram(program, task.rig.axes)
    while number < task.samples:
        count = min(
            length - number % length,
            task.samples - number,
            switch - number if number < switch else task.samples,
        )
        drive = stretch(task, number, count)
        motion.follow(task, drive, number)
        if law is None or laws_stretch is not None or number == switch:
            law = laws.at(drive, count // 2, number >= switch, sensor)
        if number == switch:
            motion.x = take_over(law, *remembered(recent, motion.held, law.delay))
        log, errors = advance_motion(task.rig, law, drive, steps, motion, count, running)
        yield number, drive, log
        if len(log) < count or motion.overflow is not None:
            motion.overflow = (number + len(log)) * task.dt
            return
        a = len(task.rig.axes)
        recent = [*recent[-(MEMORY // count) - 1 :], (errors, log[:, a : 2 * a].T)]
        number += count
        if progress is not None and time.perf_counter() - reported > _REPORT_EVERY:
            reported = time.perf_counter()
            progress(f"simulated {number * task.dt:.3g} s of {task.scenario.duration:g} s")


def advance_motion(
    rig: Rig,
    law: SampledLaw,
    drive: Drive,
    steps: int,
    motion: Motion,
    count: int,
    running: RunningProgram | None = None,
    along: axial_rig.Along | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """Log (k, columns) and errors (a, k) of a stretch, up to the sample where the motion left all
    bounds. along: the axis along the shaft, of a law and a drive that have it as the last one.
    """
    a, axes = len(rig.axes), len(motion.held)
    log, errors = np.empty((count, 4 * a + len(rig.port_names))), np.empty((count, axes))
    program = NO_PROGRAM if running is None else running.called
    work = rig.work(len(motion.x))
    if along is not None:
        work = work._replace(command=np.zeros(axes), sampled=np.zeros((2, axes)))
    done = compiled()[0](
        rig.constants,
        law,
        program,
        drive,
        motion.propagator,
        steps,
        motion.z,
        motion.x,
        motion.held,
        work,
        log,
        errors,
        along,
    )
    if done < count:
        if running is not None and running.failure is not None:
            raise running.failure
        if running is not None and np.isfinite(motion.z.sum()):
            raise NumericalFailure(
                f"the controller's program stopped after {done} samples of this run; check its "
                "return value"
            )
    # a state that overflowed ends in the row after the last that was done
    kept = within_bounds(log[: done + 1])
    if kept < count:
        motion.overflow = np.nan  # its time is added by who knows it
        log, errors = log[:kept], errors[:kept]
    return log, errors.T


def _program(law: Law, second: Law | None, computing_delay: int) -> ControlProgram | None:
    """The controller, if it is a program. Raises InvalidInput for what the rig cannot do with
    one.
    """
    if second is not None and second.program is not None:
        raise InvalidInput(
            "the second controller is a program; only the first can be one, so give its law instead"
        )
    program = law.program
    if program is None:
        return None
    if second is not None or computing_delay != 1 or program.delay != 1:
        raise invalid(
            "computing_delay of a program",
            min(computing_delay, program.delay),
            "1 sample, with no second controller",
            "a program's currents act at the next sample: export it with delay_samples 1",
        )
    return program


def remembered(
    recent: list[tuple[np.ndarray, np.ndarray]], last_output: np.ndarray, delay: int
) -> tuple[np.ndarray, np.ndarray]:
    """The last errors (a, k) and the outputs (a, k) computed from them; what acts was computed
    ``delay`` samples earlier.
    """
    errors, acting = (np.concatenate([pair[i] for pair in recent], axis=1) for i in (0, 1))
    outputs = np.column_stack([acting[:, delay:], last_output]) if delay else acting
    return errors[:, -MEMORY:], outputs[:, -MEMORY:]
