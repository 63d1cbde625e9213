"""The virtual rig of the axis along the shaft: the nonlinear magnets with the flux in their cores,
the process thrust, amplifier, sensor, axial stops; the controller as it is deployed.

It runs the scenarios of the radial rig, whose first direction is then the axis, and returns the
same kind of trace. What only turns or whirls (unbalance, speed, seal pressure) does not act here
(``Scenario.on``).
"""

import hashlib
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import brentq

from ambrose.core.checks import InvalidInput, NumericalFailure, invalid
from ambrose.judge.plants import judge_stability
from ambrose.law.law import LawLike, law_of
from ambrose.law.loop import DEFAULT, Timing, machine_timing
from ambrose.machine.description import OperatingPoint
from ambrose.machine.machine import Machine
from ambrose.model.assemble import assemble
from ambrose.model.axial import at_point, core_lags, force, rotor_mass, sides
from ambrose.model.effects import amplifier, sensor
from ambrose.rig.engine.controller import (
    NO_PROGRAM,
    RunningProgram,
    SampledLaw,
    sample_time,
    sampled_law,
)
from ambrose.rig.engine.inputs import Plan, plan
from ambrose.rig.engine.record import Lift, Recorder, within_bounds
from ambrose.rig.engine.state import in_rows
from ambrose.rig.linear import waveforms, without_power
from ambrose.rig.scenario import LEVITATED, Scenario
from ambrose.rig.trace import Trace

_STRETCH = 4000  # control samples computed at once
_STEP = 1.25e-5  # [s], the longest; the flux of a core is settled to first order in it
_NO_LAG = 5000.0  # [rad/s] at which the bias follows an ideal amplifier
_REPORT_EVERY = 2.0  # [s]
_FAR = 1.0  # [m] where there is no stop


class Constants(NamedTuple):
    """Of axial_kernel.py; n lags of the cores."""

    # m [kg], k [N/m], d [N s/m], place where the sensor reads zero [m], ways to the left and right
    # stop [m], their stiffness and damping, step h [s], exp(-h w) of the bias
    body: np.ndarray
    side: np.ndarray  # (2, 7) N, bias [A], gap [m], rho, R_f, phi_s (0: none), R_0
    weight: np.ndarray  # (2, n)
    decay: np.ndarray  # (2, n) a = exp(-p h)
    rest: np.ndarray  # (2, n) g a^2 of the weights g
    # (2, 3) what the drive w of a step has of the flux at its end, sum g (1 - a), and one step
    # later, sum g a (1 - a); one over the first (0: a side without lags)
    share: np.ndarray
    amplifier: np.ndarray  # effects.amplifier.parameters
    sensor: np.ndarray  # effects.sensor.parameters
    steps: int  # in a control sample
    load: float  # process thrust [N]


class Work(NamedTuple):
    """Scratch arrays of the compiled code."""

    sampled: np.ndarray
    command: np.ndarray
    ahead: np.ndarray


class Driven(NamedTuple):
    """K control samples of a scenario: rows (1, K), force (4, K) cubics [N]."""

    speed: np.ndarray
    excitation: np.ndarray
    reference: np.ndarray
    disturbance: np.ndarray
    noise: np.ndarray
    powered: np.ndarray
    force: np.ndarray
    told: np.ndarray
    pressure: np.ndarray


class Along(NamedTuple):
    """The axis as the compiled code moves it through K samples: z (6,), flux (2, n) and the
    magnets' force (1,) [N] go on from stretch to stretch; log (K, 5).
    """

    constants: Constants
    drive: Driven
    z: np.ndarray
    flux: np.ndarray
    force: np.ndarray
    log: np.ndarray


class Recorded(NamedTuple):
    """What the record needs of them; force (4, m, K)."""

    speed: np.ndarray
    excitation: np.ndarray
    reference: np.ndarray
    disturbance: np.ndarray
    force: np.ndarray
    pressure: np.ndarray


@dataclass(frozen=True, slots=True, eq=False)
class AxialRig:
    """The axis ready to run, with what a plan and a record ask of a rig."""

    machine: Machine
    point: OperatingPoint
    constants: Constants
    mass: float

    @property
    def axes(self) -> tuple[str, ...]:
        return self.machine.axes

    @property
    def port_names(self) -> tuple[str, ...]:
        return self.machine.axes


def run(
    machine: Machine,
    controller: LawLike,
    scenario: Scenario,
    *,
    point: OperatingPoint | None = None,
    second: LawLike | None = None,
    dt: float | None = None,
    seed: int = 0,
    computing_delay: int | None = None,
    every: int = 1,
    path: str | Path | None = None,
    progress: Callable[[str], None] | None = None,
) -> Trace:
    """A scenario on the nonlinear axis; arguments, signals and outcomes as of
    ``virtual_rig.run``, without a second controller.

    Raises InvalidInput, and NumericalFailure where there is no levitated state to start from.
    """
    if second is not None or scenario.switch_at is not None:
        raise InvalidInput(
            "the axis along the shaft runs one controller; leave the second one out, or compare "
            "two runs"
        )
    law = law_of(controller)
    begun = time.perf_counter()
    sample = sample_time(law, machine, scenario.sample_time)
    rig = build(machine, point or machine.operation.nominal, sample, dt)
    task: Any = plan(rig, scenario, sample, seed)  # type: ignore[arg-type]  # its axes and ports
    delay = (machine_timing(machine) or DEFAULT).delay_samples
    delay = Timing(sample, delay if computing_delay is None else computing_delay).delay_samples
    program = law.program
    if program is not None and delay != 1:
        raise invalid("computing_delay", delay, "1 sample", "a program acts at the next sample")
    laws = sampled_law(law, machine, sample, rig.point, delay)
    z, flux, x, held = begin(rig, laws, lifted=scenario.initial == LEVITATED)
    work = Work(np.zeros((2, 1)), np.zeros(1), np.zeros(len(x)))
    acting = np.zeros(1)
    running = None
    if program is not None:
        program.begin(x)
        running = RunningProgram(program, rig.axes)
    code = NO_PROGRAM if running is None else running.called
    # called once, so that it is compiled
    trial = Along(
        rig.constants, driven(task, 0, 1), z.copy(), flux.copy(), np.zeros(1), np.zeros((1, 5))
    )
    _kernel()(trial, laws, NO_PROGRAM, work, x.copy(), held.copy(), np.zeros((1, 1)))
    pole = rightmost_pole(machine, rig.point, law, Timing(sample, delay))
    prepared = time.perf_counter()
    recorder, watched = Recorder(task, every, seed, path), Watch(rig, scenario)
    overflow: float | None = None
    reported = prepared
    with recorder:
        for number in range(0, task.samples, _STRETCH):
            count = min(_STRETCH, task.samples - number)
            drive = driven(task, number, count)
            log, seen = np.zeros((count, 5)), np.zeros((count, 1))
            along = Along(rig.constants, drive, z, flux, acting, log)
            done = _kernel()(along, laws, code, work, x, held, seen)
            if running is not None and running.failure is not None:
                raise running.failure
            done = within_bounds(log[:done])
            watched.follow(number, log[:done], sample)
            recorder.add(number, recorded(task, drive), log[:done])  # type: ignore[arg-type]
            if progress is not None and time.perf_counter() - reported > _REPORT_EVERY:
                reported = time.perf_counter()
                progress(f"simulated {(number + done) * sample:.3g} s of {scenario.duration:g} s")
            if done < count:
                overflow = (number + done) * sample
                break
        outcome, text = watched.outcome(overflow, pole)
        record = recorder.finish(text)
    return Trace(
        record,
        scenario.name,
        pole is None or pole.real < 0,
        outcome,
        text,
        pole,
        overflow,
        touchdown_at=watched.touched,
        levitated_at=watched.lifted,
        run_time=time.perf_counter() - prepared,
        compile_time=prepared - begun,
    )


def build(
    machine: Machine, point: OperatingPoint, sample: float, longest: float | None = None
) -> AxialRig:
    """The axis at an operating point for a control sample time [s]."""
    part, at = machine.thrust, at_point(machine, point)
    steps = int(np.ceil(sample / (longest or _STEP) - 1e-9))
    h = sample / steps
    models = core_lags(part)
    n = max((len(model.poles) for model in models if model is not None), default=0)
    weight, decay = np.zeros((2, n)), np.zeros((2, n))
    rows = []
    for s, (side, model) in enumerate(zip(sides(part), models, strict=True)):
        if model is not None:
            # a side with fewer lags keeps idle ones
            weight[s, : len(model.poles)] = model.weights
            decay[s, : len(model.poles)] = np.exp(-model.poles * h)
        limit = 0.0 if np.isinf(side.flux_limit) else side.flux_limit
        met = side.met(0.0, side.gap)
        rows.append([side.turns, side.bias, side.gap, side.slope, side.iron, limit, met])
    drive = machine.amplifier
    lag = drive.bandwidth or drive.natural_frequency or _NO_LAG
    stops = part.touchdown_gap or (_FAR, _FAR)
    body = [
        rotor_mass(machine),
        part.coupling_stiffness,
        part.coupling_damping,
        at.place,
        *stops,
        part.stop_stiffness,
        part.stop_damping,
        h,
        np.exp(-h * lag),
    ]
    values = Constants(
        np.array(body),
        np.array(rows),
        weight,
        decay,
        weight * decay**2,
        _shares(weight, decay),
        np.array(amplifier.parameters(drive, part.max_current)),
        np.array(sensor.parameters(machine.sensor_pairs[0], 0)),
        steps,
        at.load,
    )
    return AxialRig(machine, point, in_rows(values), body[0])


def _shares(weight: np.ndarray, decay: np.ndarray) -> np.ndarray:
    """``Constants.share``."""
    taken = (weight * (1 - decay)).sum(axis=1)
    later = (weight * decay * (1 - decay)).sum(axis=1)
    return np.column_stack([taken, later, np.divide(1.0, taken, out=0 * taken, where=taken > 0)])


def begin(
    rig: AxialRig, law: SampledLaw, *, lifted: bool
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """z, flux, state and held output of the controller: in equilibrium, or on the stop to which the
    thrust pushes (without one the left), without power.
    """
    c, part = rig.constants, rig.machine.thrust
    z, n = np.zeros(6), c.weight.shape[1]
    state, gain = np.zeros(len(law.A)), float(c.sensor[0])
    if not lifted:
        if part.touchdown_gap is None:
            raise InvalidInput(
                f"[[thrust_bearing]] {part.name} has no stops to rest on; add touchdown_gap"
            )
        z[0] = c.body[5] if c.load > 0 else -c.body[4]
        z[5] = gain * (z[0] - c.body[3])
        return z, np.zeros((2, n)), state, np.zeros(1)
    at = at_point(rig.machine, rig.point)
    place, current = at.place, at.current
    # x_c = A x_c + B e, u = C x_c + D e: integral action takes any current at e = 0
    M = np.eye(len(law.A)) - law.A
    integral = len(M) > 0 and np.abs(np.linalg.eigvals(M)).min() < 1e-9
    error = 0.0
    if not integral:
        still = float((law.D + law.C @ np.linalg.solve(M, law.B))[0, 0]) if len(M) else law.D[0, 0]

        def left(x: float) -> float:
            """Force that is left with the collar at x and the controller's answer to it."""
            e = -gain * (x - c.body[3])
            spring = c.body[1] * x
            return force(part, float(np.clip(still * e, -law.limit[0], law.limit[0])), x) + (
                c.load - spring
            )

        ends = (-0.9 * min(part.gap[0], c.body[4]), 0.9 * min(part.gap[1], c.body[5]))
        if not left(ends[0]) > 0 > left(ends[1]):
            raise NumericalFailure(
                "there is no levitated state to start from: the controller's static stiffness "
                "does not carry the process thrust; raise its gain, add integral action, or "
                "begin resting"
            )
        place = float(brentq(left, *ends, xtol=1e-15))
        error = -gain * (place - c.body[3])
        current = float(still * error)
    both, right = np.vstack([M, law.C]), np.concatenate([law.B[:, 0] * error, [0.0]])
    right[-1] = current - law.D[0, 0] * error
    if len(M):
        state = np.linalg.lstsq(both, right, rcond=None)[0]
    left_side, right_side = sides(part)
    phi = (
        left_side.flux(left_side.bias - current, left_side.gap + place),
        right_side.flux(right_side.bias + current, right_side.gap - place),
    )
    reading = gain * (place - c.body[3])
    z = np.array([place, 0.0, current, _second(rig.machine, current), 1.0, reading])
    return z, np.repeat(np.array(phi)[:, None], n, axis=1), state, np.array([current])


def _second(machine: Machine, current: float) -> float:
    """The second amplifier state at rest: of "twice-first" and "current-loop" the current's."""
    return current if machine.amplifier.order in {"twice-first", "current-loop"} else 0.0


def driven(task: Plan, first: int, count: int) -> Driven:
    """The control samples first .. first + count - 1; call them in order, for the noise's sake."""
    rig, scenario = task.rig, task.scenario
    (axis,), dt = rig.axes, task.dt
    names, c = waveforms(scenario, task.inputs, dt, count, first=first)
    rows = {name: c[:, i] for i, name in enumerate(names)}

    def held(kind: str) -> np.ndarray:
        found = rows.get(f"{kind}_{axis}")
        return np.zeros((1, count)) if found is None else found[:1]

    powered = np.ones((1, count))
    for failure in scenario.failures:
        powered[:, without_power(failure, dt, first, count)] = 0.0
    sigma = float(rig.constants.sensor[4])
    noise = sigma * task.noise.standard_normal((1, count)) if sigma else np.zeros((1, count))
    pushed = rows.get(f"f_{axis}")
    force_rows = np.zeros((4, count)) if pushed is None else pushed
    speed = np.full(count + 1, rig.point.speed)
    driven = Driven(
        speed,
        held("e"),
        held("r"),
        held("d"),
        noise,
        powered,
        force_rows,
        speed[:-1, None],
        np.zeros(count),
    )
    return in_rows(driven)


def recorded(task: Plan, drive: Driven) -> Recorded:
    forces = drive.force[:, None] if any(n.startswith("f_") for n in task.driven) else None
    return Recorded(
        drive.speed,
        drive.excitation,
        drive.reference,
        drive.disturbance,
        np.zeros((4, 0, drive.excitation.shape[1])) if forces is None else forces,
        drive.pressure,
    )


def rightmost_pole(
    machine: Machine, point: OperatingPoint, law: LawLike, timing: Timing
) -> complex | None:
    """The rightmost pole [rad/s] of the linear loop; None where it has none to tell."""
    found = judge_stability(assemble(machine, point), law_of(law), timing)
    return complex(found.abscissa, 0.0)


@cache
def _kernel() -> Any:
    """``advance`` of axial_kernel.py, compiled on first use and kept."""
    from ambrose.rig.engine import axial_kernel, controller as sampled, products as inlined

    digest = hashlib.sha256()
    for module in (axial_kernel, inlined, sampled, amplifier, sensor):
        digest.update(Path(str(module.__file__)).read_bytes())
    return axial_kernel.entry_point(int.from_bytes(digest.digest()[:6], "big"))


class Watch:
    """Contact with the stops, and the controller's output at its limit."""

    def __init__(self, rig: AxialRig, scenario: Scenario) -> None:
        self.rig, self.scenario = rig, scenario
        self.lifted: float | None = 0.0 if scenario.initial == LEVITATED else None
        self.touched: float | None = None
        self.deepest = 0.0
        self.contact = 0.0
        self.limited: float | None = None
        self.lift = Lift()

    def follow(self, number: int, log: np.ndarray, sample: float) -> None:
        """One stretch of the log."""
        stops = self.rig.constants.body[4:6]
        time = (number + np.arange(len(log))) * sample
        x = log[:, 4]
        depth = np.maximum(x - stops[1], -x - stops[0])
        if self.lifted is None:
            self.lifted = self.lift.follow(time, np.maximum(x / stops[1], -x / stops[0]))
        most = self.rig.machine.thrust.max_current
        if most is not None and self.touched is None:
            full = np.flatnonzero(np.abs(log[:, 1]) >= most * (1 - 1e-9))
            self.limited = float(time[full[-1]]) if len(full) else self.limited
        if self.lifted is None:
            return
        after = np.flatnonzero((depth > 0) & (time >= self.lifted))
        if len(after):
            self.touched = float(time[after[0]]) if self.touched is None else self.touched
            self.deepest = max(self.deepest, float(depth[after].max()))
            self.contact += len(after) * sample

    def outcome(self, overflow: float | None, pole: complex | None) -> tuple[str, str]:
        """As ``rig.engine.record.classify_outcome``."""
        side = "" if pole is None else f"; linear loop: largest real part {pole.real:.4g} rad/s"
        if overflow is not None:
            return "diverged", f"diverged: the motion left all bounds at t = {overflow:.6g} s{side}"
        if self.lifted is None:
            return "not levitated", f"not levitated: the collar is {self.lift.missing}{side}"
        lifted = "" if not self.lifted else f", levitated since t = {self.lifted:.4g} s"
        if self.touched is None:
            return "completed", f"completed without contact{lifted}{side}"
        failed = [item.time for item in self.scenario.failures if item.time <= self.touched]
        cause = "driven there by the disturbances"
        if failed:
            cause = f"the power failed {self.touched - failed[-1]:.4g} s before"
        elif pole is not None and pole.real >= 0:
            cause = "the loop is unstable"
        if self.limited is not None:
            cause += "; controller output at its limit"
        return (
            "touchdown",
            f"touchdown at an axial stop at t = {self.touched:.6g} s{lifted}: {cause}; in contact "
            f"for {self.contact:.3g} s, {1e6 * self.deepest:.3g} um beyond the stop at most{side}",
        )
