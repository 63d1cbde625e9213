"""The virtual rig: a nonlinear machine in a scenario, under a controller as it is deployed.

Every control sample is a short list of stages (rig_kernel.py): measure, control, command the amplifiers, log, integrate. The
machine between the samples is the rotor in free modes under magnet, contact, coupling, seal, weight and unbalance forces.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from ambrose.core.checks import InvalidInput, NumericalFailure, invalid
from ambrose.machine.description import Machine, OperatingPoint
from ambrose.machine.record import Record, signal_dimension
from ambrose.simulate.rig_controller import ControllerAt, Law, closed_loop_poles, deployed, sample_time, taking_over
from ambrose.simulate.rig_drive import Drive, Plan, plan, stretch
from ambrose.simulate.rig_outcome import judged, watch
from ambrose.simulate.rig_start import fastest_pole, levitated, linear_view, measurement, resting, standing, steps_per_sample
from ambrose.simulate.rig_state import Rig, build, compiled
from ambrose.simulate.scenario import LEVITATED, Scenario
from ambrose.simulate.trace import Trace

_STRETCH = 4000  # control samples computed at once
_SCHEDULED_STRETCH = 50  # of a controller that changes with speed
_MEMORY = 256  # samples from which a second controller learns where to take over
_LARGEST = 100_000_000  # numbers in one record: 0.8 GB
_TOLD_EVERY = 2.0  # [s] between two words of progress


def run(
    machine: Machine,
    controller: Any | ControllerAt,
    scenario: Scenario,
    *,
    second: Any | None = None,
    point: OperatingPoint | None = None,
    bending_modes: int = 1,
    dt: float | None = None,
    seed: int = 0,
    computing_delay: int = 1,
    every: int = 1,
    path: str | Path | None = None,
    progress: Callable[[str], None] | None = None,
) -> Trace:
    """Run a scenario on the nonlinear machine.

    controller: a StateSpace (or python-control system) from errors [m] to currents [A], axes by place; or, scheduled, a
    function from speed [rad/s] to one. Continuous, it is sampled by Tustin's map at the scenario's or the machine's sample time
    (else 10 kHz); its output, limited to max_current, acts ``computing_delay`` (0 or 1) samples later. second: takes over
    without a bump at the scenario's switch_at. point: bias current, speed and seal pressure at the start, where the scenario
    does not say otherwise (None: the nominal one). bending_modes: per plane. dt [s]: longest integration step (None: by the
    machine's fastest pole). seed: of the sensors' noise. every: only each so many-th sample is recorded. path (.h5): where the
    record is written while it grows; what was run so far stays readable when the run is interrupted. progress: is told how far
    it is.

    Recorded: y_, u_ (what acts), i_ (coils), f_magnet_ (axes), q_ (ports), what the scenario drives, speed and p_seal where
    they change. Touchdown is an outcome with time and cause, and the run goes on; "diverged" means that the state overflowed,
    and the record ends before. Raises InvalidInput, and NumericalFailure where there is no levitated state to start from.
    """
    rig = build(machine, point, bending_modes)
    sample = sample_time(controller, machine, scenario.sample_time)
    task = plan(rig, scenario, sample, seed)
    names = _recorded(task)
    if not 1 <= every <= task.samples or task.samples // every * len(names) > _LARGEST:
        remedy = f"the record would hold {task.samples} samples of {len(names)} signals"
        raise invalid(
            "every", every, f"from 1 to {task.samples}, and so that a record has {_LARGEST:g} numbers at most", remedy
        )
    if (second is None) != (scenario.switch_at is None):
        raise InvalidInput("a second controller and the scenario's switch_at belong together; give both or neither")
    begun = time.perf_counter()
    conditions = _conditions(task)
    start = conditions[0][1]
    steps = steps_per_sample(dt, sample, fastest_pole(rig, [drive for _, drive in conditions]))
    laws = _Laws(controller, second, machine, sample, computing_delay)
    first = laws.at(float(start.speed[0]), False)
    motion = _Motion(*(levitated(rig, start, first) if scenario.initial == LEVITATED else resting(rig, first)))
    pole = max((_rightmost(rig, drive, laws, time >= task.switch) for time, drive in conditions), key=lambda p: p.real)
    _advance(rig, first, start, 1, _Motion(motion.z.copy(), motion.x.copy(), motion.held.copy()), 1)  # compiles
    compile_time = time.perf_counter() - begun

    seen, values, filled = watch(rig, scenario), np.empty((len(names), (task.samples - 1) // every + 1)), 0
    where = replace(rig.point, speed=float(start.speed[0]))
    notes = (("scenario", scenario.name), ("seed", str(seed)))
    units = tuple(signal_dimension(name).unit for name in names)
    with ExitStack() as stack:
        writer = None
        if path is not None:
            from ambrose.machine.record_stream import RecordWriter

            writer = stack.enter_context(
                RecordWriter(path, machine.name, 1 / (sample * every), names, units, where, notes=notes)
            )
        for number, drive, log in _stretches(task, laws, motion, steps, progress):
            block = _block(task, drive, log, number)
            count, a = len(log), len(rig.axes)
            seen.follow((number + np.arange(count)) * sample, log[:, 4 * a : 5 * a].T, log[:, a : 2 * a].T)
            kept = block[:, (-number) % every :: every]
            values[:, filled : filled + kept.shape[1]] = kept
            filled += kept.shape[1]
            if writer is not None and kept.shape[1]:
                writer.append(kept)
        outcome, text = judged(seen, scenario, motion.overflow, pole)
        if writer is not None:
            writer.note("outcome", text)
    if filled < values.shape[1]:
        values = values[:, :filled].copy()
    values.flags.writeable = False  # a Record then takes it as it is
    record = Record(machine.name, 1 / (sample * every), names, units, values, where, notes=(*notes, ("outcome", text)))
    run_time = time.perf_counter() - begun - compile_time
    return Trace(
        record, scenario.name, pole.real < 0, outcome, text, pole, motion.overflow, 0.0, seen.touched_at, run_time, compile_time
    )


@dataclass(slots=True)
class _Motion:
    """The state between two stretches: machine z, controller x, its output that acts next; when it overflowed [s]."""

    z: np.ndarray
    x: np.ndarray
    held: np.ndarray
    overflow: float | None = None


@dataclass(frozen=True, slots=True)
class _Laws:
    """The controllers of a run, as they are deployed."""

    first: Any
    second: Any | None
    machine: Machine
    sample: float
    delay: int

    @property
    def scheduled(self) -> bool:
        return any(callable(item) and not hasattr(item, "A") for item in (self.first, self.second))

    def at(self, speed: float, switched: bool) -> Law:
        """The law at a speed [rad/s], before or after the switch."""
        return deployed(self.second if switched else self.first, self.machine, self.sample, speed, self.delay)


def _conditions(task: Plan) -> list[tuple[int, Drive]]:
    """One sample, with its number, of the conditions at the start, at the end and around every change, with nothing driven."""
    quiet = replace(task, scenario=task.scenario.quiet, noise=np.random.default_rng(0))
    last = task.samples - 1
    numbers = {0, last, min(task.switch, last)}
    for change in task.scenario.pressures:
        numbers |= {round(change.time / task.dt), min(round((change.time + change.ramp) / task.dt) + 1, last)}
    return [(number, stretch(quiet, number, 1)) for number in sorted(numbers)]


def _rightmost(rig: Rig, drive: Drive, laws: _Laws, switched: bool) -> complex:
    """The rightmost pole [rad/s] of the linear loop around the centred rotor."""
    law = laws.at(float(drive.speed[0]), switched)
    try:
        z, _, u = levitated(rig, drive, law)
    except NumericalFailure:
        u = np.zeros(len(rig.axes))
        z = standing(rig, np.zeros(2 * rig.modes), u)
    A, B = linear_view(rig, drive, z, u)
    used = (A != 0).any(axis=0) | (A != 0).any(axis=1)  # an amplifier or sensor may need fewer states than it has
    poles = closed_loop_poles(A[np.ix_(used, used)], B[used], measurement(rig)[:, used], law, laws.sample)
    return complex(max(poles, key=lambda p: (p.real, p.imag)))


def _stretches(
    task: Plan, laws: _Laws, motion: _Motion, steps: int, progress: Callable[[str], None] | None
) -> Iterator[tuple[int, Drive, np.ndarray]]:
    """Number of the first sample, drive and log (k, columns) of one stretch after the other; motion moves along."""
    length = _SCHEDULED_STRETCH if laws.scheduled and task.scenario.runs_up else _STRETCH
    switch = task.switch
    told = time.perf_counter()
    recent: list[tuple[np.ndarray, np.ndarray]] = []
    number, law = 0, None
    while number < task.samples:
        count = min(length, task.samples - number, switch - number if number < switch else task.samples)
        drive = stretch(task, number, count)
        if law is None or laws.scheduled or number == switch:
            law = laws.at(float(drive.speed[count // 2]), number >= switch)
        if number == switch:
            motion.x = taking_over(law, *_remembered(recent, motion.held, law.delay))
        log, errors = _advance(task.rig, law, drive, steps, motion, count)
        yield number, drive, log
        if len(log) < count or motion.overflow is not None:
            motion.overflow = (number + len(log)) * task.dt
            return
        a = len(task.rig.axes)
        recent = [*recent[-(_MEMORY // count) - 1 :], (errors, log[:, a : 2 * a].T)]
        number += count
        if progress is not None and time.perf_counter() - told > _TOLD_EVERY:
            told = time.perf_counter()
            progress(f"simulated {number * task.dt:.3g} s of {task.scenario.duration:g} s")


def _advance(rig: Rig, law: Law, drive: Drive, steps: int, motion: _Motion, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Log (k, columns) and errors (a, k) of a stretch, up to the sample where the state overflowed."""
    a = len(rig.axes)
    log, errors = np.empty((count, 4 * a + len(rig.port_names))), np.empty((count, a))
    done = compiled()[0](
        rig.constants, law, drive, steps, motion.z, motion.x, motion.held, rig.work(len(motion.x)), log, errors
    )
    if done < count:
        motion.overflow = np.nan  # its time is added by who knows it
        log, errors = log[: done + 1], errors[: done + 1]
        log = log[np.isfinite(log).all(axis=1)]
    return log, errors.T


def _remembered(recent: list[tuple[np.ndarray, np.ndarray]], held: np.ndarray, delay: int) -> tuple[np.ndarray, np.ndarray]:
    """The last errors (a, k) and the outputs (a, k) computed from them; what acts was computed ``delay`` samples earlier."""
    errors, acting = (np.concatenate([pair[i] for pair in recent], axis=1) for i in (0, 1))
    outputs = np.column_stack([acting[:, delay:], held]) if delay else acting
    return errors[:, -_MEMORY:], outputs[:, -_MEMORY:]


def _recorded(task: Plan) -> tuple[str, ...]:
    """The names of the signals in a record."""
    axes, scenario = task.rig.axes, task.scenario
    names = [f"{kind}_{a}" for kind in ("y", "u", "i", "f_magnet") for a in axes] + [f"q_{p}" for p in task.rig.port_names]
    varying = ["speed"] * scenario.runs_up + ["p_seal"] * bool(scenario.pressures)
    return (*names, *task.driven, *varying)


def _block(task: Plan, drive: Drive, log: np.ndarray, number: int) -> np.ndarray:
    """All recorded signals (s, k) of a stretch."""
    k, rig, scenario = len(log), task.rig, task.scenario
    sources = {"e": drive.excitation, "r": drive.reference, "d": drive.disturbance}
    rows = [log.T]
    forces = [port for port in rig.port_names if f"f_{port}" in task.driven]
    for name in task.driven:
        kind, _, rest = name.partition("_")
        row = drive.force[0, forces.index(rest)] if kind == "f" else sources[kind][rig.axes.index(rest)]
        rows.append(row[None, :k])
    if scenario.runs_up:
        rows.append(drive.speed[None, :k])
    if scenario.pressures:
        rows.append(task.pressures((number + np.arange(k)) * task.dt)[None])
    return np.vstack(rows)
