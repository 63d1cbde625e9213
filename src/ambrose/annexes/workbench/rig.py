"""The virtual rig a frame at a time: a run whose scenario is written while it goes on.

What is done to it - a knock, another speed, a failure - joins the scenario at the sample that comes
next, and a frame is a stretch of a run (``virtual_rig``) from the state that the last one left. The
frames of a scenario that is known from the start are therefore its run, sample by sample.
"""

from __future__ import annotations

import math
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from ambrose.core.checks import InvalidInput, check_finite, check_positive, invalid
from ambrose.law.law import SPEED, Law, LawLike, law_of
from ambrose.law.loop import DEFAULT, timing_of
from ambrose.machine.description import OperatingPoint
from ambrose.machine.machine import Machine
from ambrose.machine.units import suggestion
from ambrose.model.effects.rotor import finite_element_rotor, mass_properties
from ambrose.record.record import signal_dimension
from ambrose.rig.engine.controller import SampledLaw, sample_time, take_over
from ambrose.rig.engine.equilibrium import fastest_pole, steps_per_sample, steps_within
from ambrose.rig.engine.inputs import Drive, Plan, plan, stretch
from ambrose.rig.engine.state import build
from ambrose.rig.scenario import (
    LEVITATED,
    Failure,
    Prbs,
    PressureChange,
    PressureSensor,
    Pulse,
    Scenario,
    SpeedChange,
    Unbalance,
)
from ambrose.rig.virtual_rig import MEMORY, STRETCH, Laws, advance_motion, begin_motion, remembered

# How far a live rig is turned and pushed by hand: from what the machine knows of itself to where a
# slider ends.


_BEYOND = 1.2  # the top speed's slider over the highest speed
_GRADE = 2.5e-3  # [m/s], G2.5 of ISO 21940-11
_GRADES = 8.0  # the unbalance's slider over the grade
_PUSH = 0.05  # a knock's first displacement over the gap, roughly
_RINGING = 300.0  # [rad/s] of a levitated rotor, roughly
_SHAKE = 0.025  # excitation over the limit of the currents: far from it also on top of the weight


@dataclass(frozen=True, slots=True)
class LiveRanges:
    """speed [rad/s], pressure [Pa] and unbalance [kg m] at most; gap [m], the smallest, of the
    touchdown bearings or the magnets; impulse [N s] that moves the rotor some hundredths of it;
    excitation [A] for identification.
    """

    speed: float
    pressure: float
    unbalance: float
    gap: float
    impulse: float
    excitation: float


def ranges_of(rig: LiveRig, machine: Machine) -> LiveRanges:
    """Those of a machine on its live rig."""
    operation = machine.operation
    speeds = [*operation.speed_range, *(point.speed for point in operation.points), 100.0]
    pressures = [point.seal_pressure for point in operation.points]
    gaps = [float(gap) for gap in rig.clearances if np.isfinite(gap)]
    gaps += [bearing.gap for bearing in machine.bearings if bearing.gap]
    gap = min(gaps, default=1e-4)
    mass = mass_properties(finite_element_rotor(machine)).mass
    limits = [float(most) for most in rig.limits if np.isfinite(most)]
    return LiveRanges(
        speed=_BEYOND * max(speeds),
        pressure=2.5 * max(pressures, default=0.0),
        # m e, with e = grade / speed
        unbalance=_GRADES * mass * _GRADE / max(speeds),
        gap=gap,
        # of a free mass that swings with a share of the gap: m x omega
        impulse=_PUSH * gap * mass * _RINGING,
        excitation=_SHAKE * min(limits, default=1.0),
    )


_FOREVER = 1e9  # [s] that a scenario lasts to which events are added
_EVENTS = 60  # events after which the scenario starts anew from the present state
_KNOCK = 1e-3  # [s] of a knock
_LONGEST_RECORD = 120.0  # [s]


@dataclass(frozen=True, slots=True, eq=False)
class Frame:
    """Samples of a live rig: time [s] of the first one, log (k, columns) as the rig writes it: y,
    u, coil currents, magnet forces (a each), displacements of the stations in their axes; the speed
    [rad/s] and the seal pressure [Pa] at its end; contact (b,): which touchdown bearing was
    touched; ended: why the run is over, or "".
    """

    time: float
    log: np.ndarray
    speed: float
    pressure: float
    contact: tuple[bool, ...]
    ended: str = ""


class LiveRig:
    """A machine under a controller that runs on, one ``advance`` after the other.

    machine, controller: as for ``virtual_rig.run``; the controller is no program and has no
    synchronous blocks. scenario: what is known from the start, its duration left out (None:
    nothing; the rotor is levitated, or "resting" in its touchdown bearings as ``initial`` says, at
    the point's speed). point: bias current, speed and seal pressure at the start (None: the nominal
    one). rate [Hz], delay_samples: of the controller (None: as it or the machine file says).
    bending_modes, seed: as there. Raises InvalidInput, and NumericalFailure where there is no
    levitated state to start from.
    """

    def __init__(
        self,
        machine: Machine,
        controller: LawLike,
        scenario: Scenario | None = None,
        *,
        point: OperatingPoint | None = None,
        initial: str = LEVITATED,
        rate: float | None = None,
        delay_samples: int | None = None,
        bending_modes: int | None = None,
        seed: int = 0,
    ) -> None:
        law = _simple(law_of(controller))
        begin = machine.operation.nominal if point is None else point
        if scenario is None:
            scenario = Scenario("live", _FOREVER, speed=begin.speed, initial=initial)
        speed = begin.speed if scenario.speed is None else scenario.speed
        scenario = replace(scenario, duration=_FOREVER, speed=speed, switch_at=None).on(machine)
        timing = timing_of(machine, law, rate, delay_samples) or DEFAULT
        wanted = timing.sample_time if rate is not None else scenario.sample_time
        dt = sample_time(law, machine, wanted or timing.sample_time)
        self.machine = machine
        self.law = law
        self.gain = 1.0
        self.ended = ""
        self._task = plan(
            build(machine, begin, bending_modes), scenario, dt, seed, law.scheduled_over or SPEED
        )
        self._constants = self._task.rig.constants
        self._laws = Laws(law, None, machine, dt, timing.delay_samples)
        first = stretch(self._quiet(scenario), 0, 1)
        self._steps = steps_per_sample(None, dt, fastest_pole(self._task.rig, [first]))
        self._motion = begin_motion(
            self._task, self._laws, first, steps_within(self._task.rig, dt, None)
        )
        self._number = 0
        # before the scenario that now holds: seconds, and the angle turned [rad]
        self._before, self._turned = 0.0, 0.0
        self._law: SampledLaw | None = None
        self._recent: list[tuple[np.ndarray, np.ndarray]] = []
        self._recording: _Recording | None = None
        # whether the scenario so far tells all that was done
        self.told = True

    def _quiet(self, scenario: Scenario) -> Plan:
        return replace(
            self._task,
            scenario=scenario.quiet,
            noise=np.random.default_rng(0),
        )

    @property
    def dt(self) -> float:
        """The control sample time [s]."""
        return self._task.dt

    @property
    def axes(self) -> tuple[str, ...]:
        """The control axes, two per bearing."""
        return self._task.rig.axes

    @property
    def ports(self) -> tuple[str, ...]:
        """Names of the stations' axes, two per station, in the order of a frame's log."""
        return self._task.rig.port_names

    @property
    def stations(self) -> tuple[str, ...]:
        """Where it can be knocked: bearings, then what else stands on the rotor."""
        return tuple(name.rpartition("_")[0] for name in self.ports[0::2])

    @property
    def clearances(self) -> np.ndarray:
        """Touchdown gaps (b,) [m]; infinite where a bearing has none."""
        return np.asarray(self._task.rig.constants.touchdown[:, 0])

    @property
    def direction(self) -> np.ndarray:
        """Cosine and sine (S, 2) of the angle from x to each station's first axis."""
        return self._task.rig.constants.direction

    def places(self, log: np.ndarray) -> np.ndarray:
        """Displacements x, y (k, S, 2) [m] of the stations in the frame of the machine, of a
        frame's log.
        """
        along = log[:, 4 * len(self.axes) :].reshape(len(log), len(self.stations), 2)
        cosine, sine = self.direction.T
        # a displacement p along the first axis, q along the second, which is 90 degrees further
        p, q = along[..., 0], along[..., 1]
        return np.stack([cosine * p - sine * q, sine * p + cosine * q], axis=-1)

    @property
    def limits(self) -> np.ndarray:
        """The controller's limits (a,) [A]; infinite where there are none."""
        most = [b.max_current or np.inf for b in self.machine.bearings]
        return np.repeat(np.array(most, dtype=float), 2)

    @property
    def time(self) -> float:
        """Seconds since the start."""
        return self._before + self._now

    @property
    def _now(self) -> float:
        return self._number * self._task.dt

    @property
    def scenario(self) -> Scenario:
        """What was done so far; ``told`` says whether a run of it is this one, to rounding where
        no change of speed or pressure came unforeseen.
        """
        return replace(self._task.scenario, duration=max(self._now, self.dt))

    def advance(self, count: int) -> Frame:
        """The next ``count`` control samples; fewer where the state overflows, none after that.
        Raises InvalidInput where speed or pressure leave what the machine file knows.
        """
        begun, logs = self.time, []
        left = 0 if self.ended else count
        while left:
            # pieces end where those of a run do
            length = self._laws.stretch(self._task.scenario)
            piece = min(left, STRETCH - self._number % STRETCH)
            if length is not None:
                piece = min(piece, length - self._number % length)
            log = self._piece(piece, length)
            logs.append(log)
            left = 0 if self.ended else left - piece
        ports = 4 * len(self.axes) + len(self.ports)
        log = np.concatenate(logs) if logs else np.zeros((0, ports))
        return Frame(begun, log, *self._conditions(), self._contact(log), self.ended)

    def _piece(self, count: int, length: int | None) -> np.ndarray:
        motion, task = self._motion, self._task
        number = self._number
        drive = stretch(task, number, count)
        drive = drive._replace(angle=drive.angle + self._turned)
        motion.follow(task, drive, number)
        if self._law is None or length is not None:
            sensor = bool(task.scenario.pressure_sensors)
            law = self._laws.at(drive, count // 2, False, sensor)
            self._law = law._replace(C=self.gain * law.C, D=self.gain * law.D)
        log, errors = advance_motion(task.rig, self._law, drive, self._steps, motion, count)
        self._number += len(log)
        a = len(self.axes)
        self._recent = [
            *self._recent[-(MEMORY // max(count, 1)) - 1 :],
            (errors[:, : len(log)], log[:, a : 2 * a].T),
        ]
        if self._recording is not None and not self._recording.add(self, drive, log, number):
            self.stop_recording()
        if motion.overflow is not None:
            self.ended = f"diverged: the motion left all bounds at t = {self.time:.4g} s"
        elif (where := self._beyond(log)) is not None:
            self.ended = (
                f"ended: at t = {self.time:.4g} s the rotor is beyond the air gap of bearing "
                f"{where}, where nothing can be"
            )
        return log

    def _distance(self, log: np.ndarray) -> np.ndarray:
        """(k, b) of the rotor from the middle of its bearings [m]."""
        a = len(self.axes)
        places = log[:, 4 * a : 5 * a]
        return np.hypot(places[:, 0::2], places[:, 1::2])

    def _contact(self, log: np.ndarray) -> tuple[bool, ...]:
        beyond = self._distance(log) > self.clearances
        return tuple(bool(column.any()) for column in beyond.T)

    def _beyond(self, log: np.ndarray) -> str | None:
        for bearing, far in zip(self.machine.bearings, self._distance(log).T, strict=True):
            if bearing.gap is not None and (far > bearing.gap).any():
                return bearing.name
        return None

    def _conditions(self) -> tuple[float, float]:
        now = np.array([self._now])
        return float(self._task.speeds(now)[0]), float(self._task.pressures(now)[0])

    # what is done to it

    def knock(self, station: str, x: float, y: float) -> None:
        """An impulse (x, y) [N s] at a station, a force of 1 ms. Raises InvalidInput."""
        s = self._station(station)
        c, d = self.direction[s]
        # x, y in the station's axes
        parts = c * x + d * y, c * y - d * x
        ports = self.ports[2 * s : 2 * s + 2]
        length = max(round(_KNOCK / self.dt), 1) * self.dt
        pulses = [
            Pulse(f"f_{port}", float(check_finite(part, "the impulse")) / length, self._now, length)
            for port, part in zip(ports, parts, strict=True)
        ]
        self._do(pulses=(*self._task.scenario.pulses, *pulses))
        self._rebuilt()

    def set_speed(self, speed: float, rate: float = 100.0) -> None:
        """The speed goes to ``speed`` [rad/s] at ``rate`` [rad/s^2]. Raises InvalidInput."""
        check_positive(speed, "the speed", "a rotor turns one way", zero_allowed=True)
        check_positive(rate, "the rate of the speed", "give it in rad/s^2")
        now, pressure = self._conditions()
        self._try(replace(self._task.rig.point, speed=speed, seal_pressure=pressure))
        changes = list(self._task.scenario.speed_changes)
        if changes and changes[-1].time + changes[-1].ramp > self._now:
            last = changes.pop()
            if self._now - last.time >= self.dt / 2:
                changes.append(SpeedChange(last.time, now, self._now - last.time))
        if speed != now:
            changes.append(SpeedChange(self._now, speed, max(abs(speed - now) / rate, self.dt)))
        self._do(speed_changes=tuple(changes))

    def set_pressure(self, pressure: float, rate: float = 20e5) -> None:
        """The pressure across every seal goes to ``pressure`` [Pa] at ``rate`` [Pa/s]. Raises
        InvalidInput where it leaves what a seal's table knows.
        """
        check_positive(pressure, "the pressure", "give it in Pa", zero_allowed=True)
        check_positive(rate, "the rate of the pressure", "give it in Pa/s")
        speed, now = self._conditions()
        self._try(replace(self._task.rig.point, speed=speed, seal_pressure=pressure))
        changes = list(self._task.scenario.pressures)
        if changes and changes[-1].time + changes[-1].ramp > self._now:
            last = changes.pop()
            if self._now - last.time >= self.dt / 2:
                changes.append(PressureChange(last.time, now, self._now - last.time))
        if pressure != now:
            ramp = max(abs(pressure - now) / rate, self.dt)
            changes.append(PressureChange(self._now, pressure, ramp))
        self._do(pressures=tuple(changes))

    def _try(self, point: OperatingPoint) -> None:
        """Raises InvalidInput where the machine cannot be at a point."""
        rig = replace(self._task.rig, point=point)
        quiet = self._quiet(Scenario("there", 1.0, speed=point.speed))
        stretch(replace(quiet, rig=rig), 0, 1)

    def set_unbalance(self, station: str, amount: float) -> None:
        """A mass times radius ``amount`` [kg m] at a station, in place of all others. Raises
        InvalidInput.
        """
        self._station(station)
        check_finite(amount, "the unbalance")
        self.told = self.told and self._number == 0
        self._do(unbalances=(Unbalance(station, amount),) if amount else ())
        self._rebuilt()

    def set_gain(self, gain: float) -> None:
        """The controller's output times ``gain``. Raises InvalidInput."""
        self.gain = check_positive(gain, "the gain", "1 is the controller as it is")
        self.told = False
        self._law = None

    def switch(self, controller: LawLike) -> None:
        """Another controller takes over without a bump. Raises InvalidInput where it does not
        fit.
        """
        law = _simple(law_of(controller))
        if law.sample_time is not None and abs(law.sample_time / self.dt - 1) > 1e-6:
            raise invalid(
                "the sample time of the other controller",
                f"{law.sample_time:g} s",
                f"that of the rig, {self.dt:g} s",
                "start the rig again with it",
            )
        laws = replace(self._laws, first=law)
        drive = stretch(self._quiet(self._task.scenario), self._number, 1)
        sampled = laws.at(drive, 0, False)
        sampled = sampled._replace(C=self.gain * sampled.C, D=self.gain * sampled.D)
        if self._recent:
            self._motion.x = take_over(
                sampled, *remembered(self._recent, self._motion.held, sampled.delay)
            )
        else:
            self._motion.x = np.zeros(len(sampled.A))
        self.told = False
        self.law, self._laws = law, laws
        self._law = sampled

    def drop(self) -> None:
        """No amplifier has power any more: the rotor falls into its touchdown bearings."""
        self._do(failures=(*self._task.scenario.failures, Failure(self._now)))

    def lift(self) -> None:
        """Power again, sensors whole, the controller from zero."""
        self.told = self.told and not self._task.scenario.failures
        rig = replace(self._task.rig, constants=self._constants)
        self._task = replace(self._task, rig=rig)
        self._do(failures=(), pressure_sensors=())
        if self._law is not None:
            self._motion.x = np.zeros(len(self._law.A))
        self._motion.held = np.zeros(len(self.axes))
        self._rebuilt()

    def fail_amplifier(self, axis: str) -> None:
        """The amplifier of an axis has no power any more. Raises InvalidInput."""
        self._axis(axis)
        self._do(failures=(*self._task.scenario.failures, Failure(self._now, axis)))

    def fail_sensor(self, axis: str) -> None:
        """The sensors of an axis tell zero. Raises InvalidInput."""
        rig, a = self._task.rig, self._axis(axis)
        sensor = rig.constants.sensor.copy()
        sensor[rig.constants.mean[a] != 0, :2] = 0.0  # gain and offset
        constants = rig.constants._replace(sensor=sensor)
        self._task = replace(self._task, rig=replace(rig, constants=constants))
        self.told = False
        self._rebuilt()

    def fail_pressure_sensor(self, fault: str) -> None:
        """A controller scheduled over the pressure is told what a sensor does that is "stuck" or
        "lost". Raises InvalidInput.
        """
        sensors = [s for s in self._task.scenario.pressure_sensors if s.time < self._now]
        self._do(pressure_sensors=(*sensors, PressureSensor(self._now, fault=fault)))

    def excite(self, amplitude: float) -> None:
        """Binary sequences of +-amplitude [A] on every axis, as identification wants them; 0: none.
        Raises InvalidInput.
        """
        check_positive(amplitude, "the excitation", "give it in A", zero_allowed=True)
        now, bit = self._now, max(round(1e-3 / self.dt), 1) * self.dt
        # no bit comes twice in the longest record: a sequence that repeats has power at the
        # multiples of its own frequency only
        order = math.ceil(math.log2(_LONGEST_RECORD / bit + 1))
        ended = [
            s if s.duration is not None else replace(s, duration=now - s.start)
            for s in self._task.scenario.sequences
            if s.start < now
        ]
        new = [
            Prbs(f"e_{axis}", amplitude, bit, order, seed=i, start=now)
            for i, axis in enumerate(self.axes)
            if amplitude
        ]
        self._do(sequences=(*ended, *new))

    def record(self, path: str | Path) -> None:
        """Write what comes into a record (.h5), with what drives it, until ``stop_recording``; two
        minutes at most. Raises InvalidInput.
        """
        self.stop_recording()
        self._recording = _Recording(self, path)

    def stop_recording(self) -> Path | None:
        """The finished record, or None where there was none."""
        recording, self._recording = self._recording, None
        return None if recording is None else recording.close()

    @property
    def recorded(self) -> float | None:
        """Seconds in the record that is being written; None: there is none."""
        return None if self._recording is None else self._recording.count * self.dt

    def _do(self, **changes: Any) -> None:
        self._task = replace(self._task, scenario=replace(self._task.scenario, **changes))
        self._shorten()

    def _rebuilt(self) -> None:
        """What the propagator holds for the whole time has changed."""
        self._motion.propagator = None

    def _shorten(self) -> None:
        """After many events the scenario starts anew from here, so that an hour needs no more
        memory than a minute.
        """
        scenario, now = self._task.scenario, self._now
        kinds = (scenario.pulses, scenario.speed_changes, scenario.pressures, scenario.sequences)
        ends = [change.time + change.ramp for change in scenario.speed_changes[-1:]]
        ends += [change.time + change.ramp for change in scenario.pressures[-1:]]
        moving = any(end > now for end in ends)
        exciting = any(item.duration is None for item in scenario.sequences)
        if sum(map(len, kinds)) <= _EVENTS or moving or exciting:
            return
        self.told = False
        speed, pressure = self._conditions()
        self._turned = math.remainder(self._turned + self._angle(now), 2 * math.pi)
        point = replace(self._task.rig.point, speed=speed, seal_pressure=pressure)
        fresh = replace(
            scenario,
            speed=speed,
            to_speed=None,
            ramp=None,
            sequences=(),
            speed_changes=(),
            pressures=(),
            # those that are not over yet
            pulses=tuple(
                replace(p, start=p.start - now) for p in scenario.pulses if p.start >= now
            ),
            failures=tuple(
                Failure(max(f.time - now, 0.0), f.axis, None if f.until is None else f.until - now)
                for f in scenario.failures
                if f.until is None or f.until > now
            ),
            pressure_sensors=tuple(
                replace(item, time=0.0) for item in scenario.pressure_sensors[-1:]
            ),
        )
        rig = replace(self._task.rig, point=point)
        self._task = replace(self._task, rig=rig, scenario=fresh)
        self._before, self._number = self._before + now, 0
        self._motion.middle = None
        self._rebuilt()

    def _angle(self, time: float) -> float:
        return float(self._task.angles(np.array([time]))[0])

    def _station(self, name: str) -> int:
        if name not in self.stations:
            raise InvalidInput(f"no station {name!r}; {suggestion(name, self.stations)}")
        return self.stations.index(name)

    def _axis(self, name: str) -> int:
        if name not in self.axes:
            raise InvalidInput(f"no axis {name!r}; {suggestion(name, self.axes)}")
        return self.axes.index(name)


def _simple(law: Law) -> Law:
    """Raises InvalidInput for a law that a live rig cannot run."""
    if law.program is not None or law.synchronous:
        raise InvalidInput(
            "the live rig runs a controller by its matrices; give the law of a program, and take "
            "synchronous blocks out of the controller's file"
        )
    return law


class _Recording:
    """A record that grows: log, excitations and forces, speed and pressure, every sample."""

    def __init__(self, live: LiveRig, path: str | Path) -> None:
        from ambrose.record.stream import RecordWriter

        axes, ports = live.axes, live.ports
        kinds = ("y", "u", "i", "f_magnet")
        self.names = (
            *(f"{kind}_{axis}" for kind in kinds for axis in axes),
            *(f"q_{port}" for port in ports),
            *(f"e_{axis}" for axis in axes),
            *(f"f_{port}" for port in ports),
            "speed",
            "p_seal",
        )
        units = tuple(signal_dimension(name).unit for name in self.names)
        speed, pressure = live._conditions()
        point = OperatingPoint(
            speed, pressure, live.machine.operation.nominal.bias_current, label="live"
        )
        self.path = Path(path)
        self.count = 0
        self._stack = ExitStack()
        notes = (("scenario", "live"),)
        writer = RecordWriter(
            self.path, live.machine.name, 1 / live.dt, self.names, units, point, notes=notes
        )
        self._writer = self._stack.enter_context(writer)

    def add(self, live: LiveRig, drive: Drive, log: np.ndarray, number: int) -> bool:
        """One stretch from a sample on; False: the record is long enough."""
        k, task = len(log), live._task
        forces = np.zeros((len(live.ports), k))
        for m, (station, axis) in enumerate(drive.force_at):
            forces[2 * station + axis] = drive.force[0, m, :k]
        pressure = task.pressures((number + np.arange(k)) * task.dt)
        rows = [log.T, drive.excitation[:, :k], forces, drive.speed[None, :k], pressure[None]]
        if k:
            self._writer.append(np.vstack(rows))
        self.count += k
        return self.count * live.dt < _LONGEST_RECORD

    def close(self) -> Path:
        self._writer.note("outcome", "recorded on the live rig")
        self._stack.close()
        return self.path
