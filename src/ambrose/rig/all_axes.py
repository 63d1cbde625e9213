"""The virtual rig of all axes: the radial ones and that along the shaft, in one run under one
controller.

Both parts are those of virtual_rig.py and axial_rig.py, moved sample by sample by one compiled
loop. What they share is the sample, the controller, the power and the scenario; the collar's tilt
is among the radial rig's own forces. The thrust does not move the rotor across its axis, as built.
"""

import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ambrose.core.checks import InvalidInput, invalid, same_clock
from ambrose.core.statespace import StateSpace, append
from ambrose.law.law import AllAxesProgram, Law, LawLike, law_of
from ambrose.law.loop import DEFAULT, Timing, timing_of
from ambrose.machine.description import OperatingPoint
from ambrose.machine.machine import Machine
from ambrose.rig import axial_rig, virtual_rig
from ambrose.rig.engine.controller import (
    RunningProgram,
    SampledLaw,
    of_one_type,
    sample_time,
    sampled_law,
)
from ambrose.rig.engine.equilibrium import fastest_pole, steps_per_sample, steps_within
from ambrose.rig.engine.inputs import Drive, Plan, plan, stretch
from ambrose.rig.engine.record import Recorder, classify_outcome, watch, within_bounds
from ambrose.rig.engine.state import build
from ambrose.rig.scenario import LEVITATED, Scenario
from ambrose.rig.trace import Trace

_REPORT_EVERY = 2.0  # [s] between two progress messages
# from the worst to the best
_WORST = ("diverged", "not levitated", "touchdown", "completed")


class Parts(NamedTuple):
    """The laws of the radial axes and of the one along the shaft; program: what runs both."""

    radial: LawLike
    axial: LawLike
    program: AllAxesProgram | None


def parts_of(law: Law, axial: LawLike | None) -> Parts | None:
    """What controls all axes; None where that is a controller of the radial axes alone. Raises
    InvalidInput for two controllers of the thrust axis.
    """
    program = law.all_axes
    if program is not None:
        if axial is not None:
            raise InvalidInput(
                "this program has the axis along the shaft, too; leave the axial controller out"
            )
        return Parts(*program.parts, program)
    return None if axial is None else Parts(law, axial, None)


def run(
    machine: Machine,
    parts: Parts,
    scenario: Scenario,
    *,
    point: OperatingPoint | None = None,
    bending_modes: int | None = None,
    dt: float | None = None,
    seed: int = 0,
    computing_delay: int | None = None,
    every: int = 1,
    path: str | Path | None = None,
    progress: Callable[[str], None] | None = None,
) -> Trace:
    """A scenario on the nonlinear machine with all its axes; arguments, signals and outcomes as of
    ``virtual_rig.run``, those of the axis along the shaft behind the others.

    The process thrust is that of the operating point ``point`` from the start; a scenario adds to
    it (f_thrust_z). Raises InvalidInput, and NumericalFailure where there is no levitated state to
    start from.
    """
    beside: Any = machine.axial
    across, along = scenario.parted(machine)
    timing = _timing(machine, parts, scenario.sample_time, computing_delay)
    sample, delay = timing.sample_time, timing.delay_samples
    if parts.program is not None and delay != 1:
        raise invalid("computing_delay", delay, "1 sample", "a program acts at the next sample")
    if progress is not None:
        progress("the virtual rig of all axes (compiled once per computer, up to a minute)")
    begun = time.perf_counter()
    rig = axial_rig.build(beside, point or beside.operation.nominal, sample, dt)
    task = plan(build(machine, point, bending_modes), across, sample, seed)
    thrust: Any = plan(rig, along, sample, seed + 1)  # type: ignore[arg-type]  # its axes and ports
    laws = virtual_rig.Laws(law_of(parts.radial), None, machine, sample, delay)
    conditions = virtual_rig.conditions(task)
    law = laws.at(conditions[0][1], 0, False)
    own = sampled_law(law_of(parts.axial), beside, sample, rig.point, delay)
    steps = steps_per_sample(dt, sample, fastest_pole(task.rig, [item for _, item in conditions]))
    whole = _joined(law, own)

    # both begin by themselves, their controllers' states one after the other
    motion = virtual_rig.start_of(task, laws, conditions[0][1], steps_within(task.rig, sample, dt))
    z, flux, x, held = axial_rig.begin(rig, own, lifted=scenario.initial == LEVITATED)
    motion.x, motion.held = np.concatenate([motion.x, x]), np.concatenate([motion.held, held])
    pole = max(
        (virtual_rig.rightmost(task.rig, item, laws, False) for _, item in conditions),
        key=lambda p: p.real,
    )
    axial_pole = axial_rig.rightmost_pole(beside, rig.point, law_of(parts.axial), timing)
    acting = np.zeros(1)

    def advanced(number: int, count: int, moving: virtual_rig.Motion, running: Any) -> Any:
        """Drive, log and log of the axis along the shaft of one stretch."""
        drive, pushed = stretch(task, number, count), axial_rig.driven(thrust, number, count)
        moving.follow(task, drive, number)
        log = np.zeros((count, 5))
        axis = axial_rig.Along(rig.constants, pushed, z, flux, acting, log)
        every_axis = _every_axis(drive, pushed)
        across_log, _ = virtual_rig.advance_motion(
            task.rig, whole, every_axis, steps, moving, count, running, axis
        )
        both = within_bounds(log[: len(across_log)])
        return drive, pushed, across_log[:both], log[:both]

    # called once, so that it is compiled; the axis' noise goes on from there, as by itself
    trial = replace(motion, z=motion.z.copy(), x=motion.x.copy(), held=motion.held.copy())
    quiet = replace(task, scenario=across.quiet, noise=np.random.default_rng(0))
    _try(quiet, thrust, rig, whole, trial)
    running = None
    if parts.program is not None:
        parts.program.begin(motion.x)
        running = RunningProgram(parts.program, (*machine.axes, *beside.axes))
    prepared = reported = time.perf_counter()
    monitor, watched = watch(task.rig, across), axial_rig.Watch(rig, along)
    recorder = Recorder(task, every, seed, path, thrust)
    with recorder:
        for number in range(0, task.samples, virtual_rig.STRETCH):
            count = min(virtual_rig.STRETCH, task.samples - number)
            drive, pushed, log, axial_log = advanced(number, count, motion, running)
            monitor.follow(task, number, log)
            log = monitor.until_lost(number, log)
            axial_log = axial_log[: len(log)]
            watched.follow(number, axial_log, sample)
            row: Any = (thrust, axial_rig.recorded(thrust, pushed), axial_log)
            recorder.add(number, drive, log, row)
            if monitor.inside is not None:  # what comes after it means nothing
                motion.overflow = None
                break
            if len(log) < count or motion.overflow is not None:
                motion.overflow = (number + len(log)) * sample
                break
            if progress is not None and time.perf_counter() - reported > _REPORT_EVERY:
                reported = time.perf_counter()
                done = (number + count) * sample
                progress(f"simulated {done:.3g} s of {scenario.duration:g} s")
        outcome, text = _outcome(
            classify_outcome(monitor, across, motion.overflow, pole),
            watched.outcome(motion.overflow, axial_pole),
            beside.axes[0],
        )
        record = recorder.finish(text)
    touched = [at for at in (monitor.touched_at, watched.touched) if at is not None]
    lifted = [at for at in (monitor.lifted_at, watched.lifted) if at is not None]
    poles = [item for item in (pole, axial_pole) if item is not None]
    return Trace(
        record,
        scenario.name,
        all(item.real < 0 for item in poles),
        outcome,
        text,
        max(poles, key=lambda item: item.real),
        monitor.stopped_at(motion.overflow),
        touchdown_at=min(touched, default=None),
        levitated_at=max(lifted) if len(lifted) == 2 else None,
        run_time=time.perf_counter() - prepared,
        compile_time=prepared - begun,
    )


def _timing(machine: Machine, parts: Parts, wanted: float | None, delay: int | None) -> Timing:
    """The one clock of both. Raises InvalidInput where they have two."""
    axial = law_of(parts.axial)
    sample = sample_time(law_of(parts.radial), machine, wanted)
    own = axial.sample_time
    if own is None:
        own = sample if axial.rate is None else 1 / axial.rate
    if not same_clock(sample, own):
        raise invalid(
            "the sample time of the axial controller",
            f"{own:g} s",
            f"the radial one's {sample:g} s",
            f"design it with --rate-hz {1 / sample:g}: one processor runs both",
        )
    if delay is None:
        delay = (timing_of(machine, parts.radial) or DEFAULT).delay_samples
    return Timing(sample, delay)


def _joined(law: SampledLaw, axial: SampledLaw) -> SampledLaw:
    """Both laws side by side."""
    systems = []
    for name, item in (("radial", law), ("axial", axial)):
        m = len(item.limit)
        signals = [f"{name}_{i}" for i in range(m)]
        outputs = [f"{name}_out_{i}" for i in range(m)]
        systems.append(StateSpace(item.A, item.B, item.C, item.D, signals, outputs, 1.0))
    whole = append(*systems)
    A, B, C, D = of_one_type(whole.A, whole.B, whole.C, whole.D)
    return SampledLaw(A, B, C, D, np.concatenate([law.limit, axial.limit]), law.delay)


def _every_axis(drive: Drive, pushed: axial_rig.Driven) -> Drive:
    """The radial drive with the rows of the axis along the shaft."""
    return drive._replace(
        powered=np.vstack([drive.powered, pushed.powered]),
        excitation=np.vstack([drive.excitation, pushed.excitation]),
        reference=np.vstack([drive.reference, pushed.reference]),
    )


def _try(
    task: Plan, thrust: Plan, rig: axial_rig.AxialRig, law: SampledLaw, motion: virtual_rig.Motion
) -> None:
    """One sample that counts for nothing."""
    drive, pushed = stretch(task, 0, 1), axial_rig.driven(thrust, 0, 1)
    motion.follow(task, drive, 0)
    n = rig.constants.weight.shape[1]
    axis = axial_rig.Along(
        rig.constants, pushed, np.zeros(6), np.zeros((2, n)), np.zeros(1), np.zeros((1, 5))
    )
    virtual_rig.advance_motion(task.rig, law, _every_axis(drive, pushed), 1, motion, 1, along=axis)


def _outcome(across: tuple[str, str], along: tuple[str, str], axis: str) -> tuple[str, str]:
    """The worse outcome, and both in words."""
    worst = min(across[0], along[0], key=_WORST.index)
    return worst, f"{across[1]}; {axis}: {along[1]}"
