"""Linear simulation of a closed loop in a scenario: exact for pulses, to (w dt)^4/384 for sines and
unbalance.

Smooth disturbances are cubics between the samples (core/response.py: hermite), not stairs. In a
run-up the speed is held over short intervals at its middle value (exponential midpoint rule, second
order in the interval) and the number of intervals is doubled until two results agree: unlike an
explicit Runge-Kutta method that cost does not grow with the stiffness of the bending modes, and the
change of the gyroscopic terms within an interval is small. The phase of the unbalance is always
exact.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import pairwise
from typing import Any

import numpy as np

from ambrose.core.checks import (
    InvalidInput,
    NumericalFailure,
    check_finite,
    check_positive,
    invalid,
    same_clock,
)
from ambrose.core.response import hermite, sample_polynomial, simulate_piecewise
from ambrose.core.statespace import StateSpace, as_statespace, index_of, poles, select
from ambrose.law.law import PRESSURE, SPEED, Scheduling
from ambrose.machine.description import OperatingPoint
from ambrose.machine.ordinary_file import NUMBERS
from ambrose.record.record import Record, signal_dimension
from ambrose.rig.scenario import Chirp, Disturbance, Failure, Prbs, Scenario, Unbalance
from ambrose.rig.trace import Trace

# A scenario's disturbances as cubics between the samples: exact for pulses, to (w dt)^4/384 for all
# that turns.


_STRETCHED = 0.1  # share by which a duration or a bit may be rounded to whole samples
FASTEST = 0.32  # largest (w dt) of a sine between samples: an error of 3e-5


def waveforms(
    scenario: Scenario,
    inputs: Sequence[str],
    dt: float,
    k: int,
    mass: float | None = None,
    first: int = 0,
    turning: bool = True,
) -> tuple[list[str], np.ndarray]:
    """The driven inputs' names, and the cubics c (4, m, k) they follow from sample to sample
    (core/response.py: hermite).

    inputs: the names that the loop has. dt [s], k samples from number ``first`` on; mass [kg] of
    the rotor; turning False: without the unbalances. Raises InvalidInput for an unknown signal
    (listing the known ones), a length of few samples that rounding would stretch, or a sine too
    fast for dt. Edges move to the nearest sample.
    """
    rows: dict[str, np.ndarray] = {}

    def row(name: str) -> np.ndarray:
        index_of(name, inputs, "input")
        return rows.setdefault(name, np.zeros((4, k)))

    def smooth(
        item: Disturbance, angle_and_rate: Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]
    ) -> None:
        for start, stop, offset in _windows(item, dt, first, k):
            angle, rate = angle_and_rate(np.arange(offset, offset + stop - start + 1) * dt)
            value, slope = item.amplitude * np.sin(angle), item.amplitude * rate * np.cos(angle)
            row(item.signal)[:, start:stop] += hermite(value[None], slope[None], dt)[:, 0]

    for item in scenario.all_windows:
        row(item.signal)
    for pulse in scenario.pulses:
        for start, stop, _ in _windows(pulse, dt, first, k, pulse.every):
            row(pulse.signal)[0, start:stop] += pulse.amplitude
    for prbs in scenario.sequences:
        for start, stop, offset in _windows(prbs, dt, first, k):
            row(prbs.signal)[0, start:stop] += prbs.amplitude * _levels(
                prbs, dt, offset, stop - start
            )
    for sine in scenario.all_sines:
        _check_smooth(sine.frequency, dt, f"the sine on {sine.signal}")
        w, phase = sine.frequency, sine.phase
        smooth(sine, lambda t, w=w, phase=phase: (w * t + phase, np.full_like(t, w)))  # type: ignore[misc]
    for chirp in scenario.chirps:
        _check_smooth(max(chirp.frequency, chirp.to_frequency), dt, f"the chirp on {chirp.signal}")
        smooth(chirp, _sweep(chirp, scenario.duration))
    for unbalance in scenario.unbalances if turning else ():
        names = directions(unbalance.port, inputs)
        for start, stop, force, rate in _turning(scenario, unbalance, dt, first, k, mass):
            for name, part in zip(names, (np.real, np.imag), strict=True):
                row(name)[:, start:stop] += hermite(part(force)[None], part(rate)[None], dt)[:, 0]
    driven = [name for name in inputs if name in rows]
    return driven, np.stack([rows[name] for name in driven], axis=1) if driven else np.zeros(
        (4, 0, k)
    )


def without_power(failure: Failure, dt: float, first: int, count: int) -> slice:
    """Those among the samples first .. first + count - 1 of dt [s]."""
    end = count if failure.until is None else sample_of(failure.until, dt) - first
    return slice(max(sample_of(failure.time, dt) - first, 0), max(end, 0))


def sample_of(time: float, dt: float) -> int:
    """The number of the sample that is nearest to an edge at a time [s]: an edge moves by half a
    sample at most.
    """
    return round(min(time / dt, 1e15))


def samples_in(length: float, dt: float, what: str) -> int:
    """How many samples a length [s] is, to the nearest. Raises InvalidInput where that changes it
    by more than a tenth.
    """
    count = sample_of(length, dt)
    if abs(count * dt - length) > _STRETCHED * length:
        least = f"{math.ceil(0.5 / _STRETCHED) * dt:.3g} s"
        remedy = (
            f"choose a shorter sample time, or a multiple of it ({least} and more are met well "
            "enough)"
        )
        raise invalid(what, f"{length:g} s", f"a multiple of {dt:g} s, to a tenth of it", remedy)
    return count


def directions(port: str, inputs: Sequence[str]) -> tuple[str, str]:
    """The two force inputs of a port; raises InvalidInput where there are none."""
    for first, second in (("zeta", "eta"), ("x", "y")):
        if f"f_{port}_{first}" in inputs and f"f_{port}_{second}" in inputs:
            return f"f_{port}_{first}", f"f_{port}_{second}"
    known = sorted({name[2:].rpartition("_")[0] for name in inputs if name.startswith("f_")})
    raise InvalidInput(
        f"the unbalance is at port {port!r}, which the loop has not; it has "
        f"{', '.join(known) or 'none'}"
    )


def _windows(
    item: Disturbance, dt: float, first: int, k: int, period: float | None = None
) -> Iterator[tuple[int, int, int]]:
    """First and past-the-last column of a disturbance and of its repetitions, and how long it then
    has been on [samples].
    """
    what = f"of the disturbance on {item.signal}"
    begin, end = sample_of(item.start, dt), first + k
    length = end if item.duration is None else samples_in(item.duration, dt, f"the duration {what}")
    every = 0 if period is None else samples_in(period, dt, f"the period {what}")

    # from the last repetition that begins at or before this piece
    if every and begin < first:
        begin += (first - begin) // every * every
    while begin < end:
        start, stop = max(begin, first), min(begin + length, end)
        if start < stop:
            yield start - first, stop - first, start - begin
        if not every:
            break
        begin += every


@lru_cache(maxsize=8)
def _sequence(order: int, shift: int) -> np.ndarray:
    """One period of +-1."""
    from scipy.signal import max_len_seq

    bits = np.roll(2.0 * max_len_seq(order)[0] - 1.0, shift)
    bits.flags.writeable = False
    return bits


def _levels(prbs: Prbs, dt: float, offset: int, count: int) -> np.ndarray:
    """+-1 for ``count`` samples of a sequence that has been on for ``offset`` samples."""
    bit_samples = samples_in(prbs.bit_time, dt, f"the bit_time on {prbs.signal}")
    if bit_samples < 1:
        raise invalid(
            f"the bit_time on {prbs.signal}",
            f"{prbs.bit_time:g} s",
            f"at least dt = {dt:g} s",
            "lengthen it",
        )
    bits = _sequence(prbs.order, prbs.shift)
    return bits[(np.arange(offset, offset + count) // bit_samples) % len(bits)]


def _sweep(chirp: Chirp, end: float) -> Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]:
    """Angle and frequency over the time [s] since its start."""
    T = end - chirp.start if chirp.duration is None else chirp.duration
    a, b = chirp.frequency, chirp.to_frequency
    # w = a + (b - a) t/T, angle its integral
    if chirp.spacing == "linear" or a == b:
        return lambda t: (a * t + (b - a) / T * t**2 / 2, a + (b - a) / T * t)
    # w = a e^(g t), angle int w dt = a/g (e^(g t) - 1)
    g = np.log(b / a) / T
    return lambda t: (a / g * np.expm1(g * t), a * np.exp(g * t))


def _check_smooth(frequency: float, dt: float, what: str) -> None:
    if float(check_finite(frequency, f"the frequency of {what}")) * dt > FASTEST * (1 + 1e-9):
        requirement = f"at most {FASTEST / dt:g} rad/s at dt = {dt:g} s"
        raise invalid(
            f"the frequency of {what}", f"{frequency:g} rad/s", requirement, "sample faster"
        )


def _turning(
    scenario: Scenario, unbalance: Unbalance, dt: float, first: int, k: int, mass: float | None
) -> Iterator[tuple[int, int, np.ndarray, np.ndarray]]:
    """Stretches of constant angular acceleration a: first and past-the-last column, force and its
    rate (complex) at all ends.

    F = U (W^2 - j a) exp(j phi), real part in the first direction and imaginary part in the second:
    minus the mass times the acceleration of a point that turns with phi'' = a.
    """
    amount = unbalance.mass_times_radius(mass)
    times, speeds = scenario.speed_knots
    _check_smooth(max(map(abs, speeds)), dt, f"the unbalance at {unbalance.port}")

    # corners of the speed at the nearest samples, and its slope between them
    turns = [round(time / dt) for time in times]
    at = [scenario.speed_at(turn * dt) for turn in turns]
    pieces = [
        (i, j, (w - v) / ((j - i) * dt))
        for (i, j), (v, w) in zip(pairwise(turns), pairwise(at), strict=True)
        if j > i
    ]
    start, angle = at[0], unbalance.phase
    for begin, end, acceleration in (*pieces, (turns[-1], max(first + k, turns[-1]), 0.0)):
        low, high = max(begin, first), min(end, first + k)
        if low < high:
            # W = W_0 + a t, phi = phi_0 + W_0 t + a t^2/2
            t = np.arange(low - begin, high - begin + 1) * dt
            W, phi = start + acceleration * t, angle + start * t + acceleration * t**2 / 2
            # F = U e^(j phi) (W^2 - j a), F' = U e^(j phi) (2 W a + j W (W^2 - j a))
            size = W**2 - 1j * acceleration
            turned = amount * np.exp(1j * phi)
            yield (
                low - first,
                high - first,
                turned * size,
                turned * (2 * W * acceleration + 1j * W * size),
            )
        # speed and angle at the start of the next stretch
        length = (end - begin) * dt
        start, angle = (
            start + acceleration * length,
            angle + start * length + acceleration * length**2 / 2,
        )


LoopAt = Callable[[float], Any]
_SAMPLE_TIME = 1e-4  # [s] unless the scenario, the loop or the caller says otherwise
_ESCAPE = 1e-3  # [m] where an unstable loop is stopped when no displacement limit is given
_FROZEN = 5  # speeds of a run-up at which the poles are looked at
_FEWEST, _MOST = 32, 1024  # intervals of constant speed in a run-up
# of an output's row of C: rounding of loops whose states mean the same at all speeds
_SAME_STATES = 1e-6
# error of a run-up, as a fraction of the peak: aimed at, and refused
_CLOSE, _TOLERATED = 1e-3, 1e-2


def run(
    loop: Any | LoopAt,
    scenario: Scenario,
    *,
    machine: str = "",
    point: OperatingPoint | None = None,
    mass: float | None = None,
    outputs: Sequence[str] | None = None,
    displacement_limit: float | None = None,
    dt: float | None = None,
    along: Scheduling = SPEED,
) -> Trace:
    """Simulate a closed loop from rest.

    loop: the closed loop of law/loop.py, a StateSpace (or python-control system) with inputs e_,
    d_, r_, f_ and outputs y_, u_, i_, q_, qdot_; or, for a speed that changes, a function from
    speed [rad/s] to that (with ``along`` PRESSURE, from seal pressure [Pa], for one that changes),
    always in the same states, such as those of ``model.assemble`` and
    ``model.uncertainty.free_mode_reduction`` (``model.uncertainty.reduce`` has others at every
    speed). machine, point: written into the record. mass [kg]: of the rotor, needed where an
    unbalance is given as a grade. outputs: the signals to record (None: all). displacement_limit
    [m]: the record ends where a displacement q_ (y_ where there is none) passes it; None: 1 mm for
    an unstable loop, else nowhere. dt [s]: None takes the loop's, the scenario's, or 0.1 ms divided
    as the fastest sine demands. A sampled loop sees the mean of a smooth disturbance over each
    sample. Raises InvalidInput, also where the states of loops at different speeds are not the same
    (their displacements and velocities are read from the states in another way), and
    NumericalFailure where a run-up does not converge.
    """
    varies = callable(loop) and not hasattr(loop, "A")
    check_scenario(scenario, along if varies else SPEED)
    course = _course(scenario, point, along)
    loop_at, first = _resolve(loop, course)
    axes = [name.removeprefix("e_") for name in first.inputs if name.startswith("e_")]
    scenario = scenario.at_bearings(list(dict.fromkeys(axis.rpartition("_")[0] for axis in axes)))
    step = _sample_time(first, scenario, dt)
    k = int(min(scenario.duration / step, 1e15) + 1e-6) + 1
    if k * (len(first.inputs) + len(first.outputs)) > NUMBERS:
        raise invalid(
            "the number of samples",
            f"{k:g}",
            f"at most {NUMBERS} values in all",
            "shorten the scenario or raise dt",
        )
    names, c = waveforms(scenario, first.inputs, step, k, mass)
    recorded = list(first.outputs if outputs is None else outputs)
    watched = [name for name in first.outputs if name.startswith("q_")] or [
        n for n in first.outputs if n.startswith("y_")
    ]
    frozen = _frozen(loop_at, course)
    _check_same_states(frozen, watched, along.unit)
    pole, where = _rightmost(frozen)
    stable = pole is None or pole.real < 0
    limit = np.inf if stable else _ESCAPE
    if displacement_limit is not None:
        limit = check_positive(displacement_limit, "displacement_limit", "give it in metres")
    task = _Task(
        loop_at,
        scenario,
        names,
        list(dict.fromkeys([*recorded, *watched])),
        c,
        step,
        course,
        watched,
        limit,
    )
    y, error = _run_up(task) if course.moves and varies else (_constant_speed(task, pole), 0.0)

    # The record ends with the first sample at which a displacement is past the limit.
    beyond = np.abs(y[index_of(watched, task.outputs, "output")]) > limit
    stop = int(np.argmax(beyond.any(axis=0))) if beyond.any() else None
    k = y.shape[1] if stop is None else stop + 1
    record = _record(
        task, y[index_of(recorded, task.outputs, "output"), :k], recorded, machine, point
    )
    culprit = watched[int(np.argmax(beyond[:, stop]))] if stop is not None else ""
    stopped_at = None if stop is None else stop * step
    outcome = "completed" if stop is None else ("limit exceeded" if stable else "diverged")
    at = f" at {where:g} {along.unit}" if course.moves else ""
    text = _explain(outcome, stopped_at, culprit, limit, pole, at, error if course.moves else None)
    return Trace(record, scenario.name, stable, outcome, text, pole, stopped_at, error)


def check_scenario(scenario: Scenario, along: Scheduling = PRESSURE) -> None:
    """Raises InvalidInput for a scenario with something that a linear model does not know; along
    PRESSURE it may change.
    """
    known = ["changes of pressure"] if along is PRESSURE and not scenario.runs_up else []
    if unsupported := [item for item in scenario.only_for_the_rig if item not in known]:
        what = ", ".join(unsupported)
        raise InvalidInput(
            f"scenario {scenario.name} has {what}, which a linear model does not have; run it "
            "on the virtual rig"
        )


@dataclass(frozen=True, slots=True, eq=False)
class _Task:
    """What both ways of computing need: loop and scenario, the driven inputs with their cubics c
    (4, m, k), the outputs.
    """

    loop_at: LoopAt
    scenario: Scenario
    inputs: list[str]
    outputs: list[str]
    c: np.ndarray
    dt: float
    course: _Course
    watched: list[str]
    limit: float

    def stop(self, y: np.ndarray) -> bool:
        """Whether a displacement has passed the limit."""
        return bool(
            np.abs(y[index_of(self.watched, self.outputs, "output")]).max(initial=0.0) > self.limit
        )

    def sampled(self, value: float) -> StateSpace:
        """The loop at a speed or pressure, sampled for the driven inputs; a sampled loop as it
        is.
        """
        system = select(as_statespace(self.loop_at(value)), self.inputs, self.outputs)
        return sample_polynomial(system, self.dt) if system.dt is None else system

    def piece(self, system: StateSpace, first: int, last: int) -> np.ndarray:
        """Inputs of ``sampled`` for the samples first..last - 1; the means over the samples for a
        sampled loop.
        """
        c = self.c[:, :, first:last]

        # A system with as many inputs as signals takes means: int (c_0 + c_1 t + c_2 t^2 + c_3 t^3)
        # over t = 0...1; ``sample_polynomial`` has made four inputs of each.
        if len(system.inputs) == len(self.inputs):
            return np.tensordot([1, 1 / 2, 1 / 3, 1 / 4], c, 1)
        return c.reshape(4 * len(self.inputs), -1)


@dataclass(frozen=True, slots=True, eq=False)
class _Course:
    """Speed [rad/s] or pressure [Pa] of a scenario, linear between the ``values`` at ``times`` [s];
    speed at the start.
    """

    along: Scheduling
    times: np.ndarray
    values: np.ndarray
    speed: float

    @property
    def moves(self) -> bool:
        return len(set(self.values.tolist())) > 1

    def at(self, time: Any) -> Any:
        return np.interp(time, self.times, self.values)


def _course(scenario: Scenario, point: OperatingPoint | None, along: Scheduling) -> _Course:
    place = OperatingPoint() if point is None else point
    times, speeds = scenario.speed_knots
    speed = speeds[0] if speeds else place.speed
    if along is SPEED:
        return _Course(along, np.array(times or (0.0,)), np.array(speeds or (speed,)), speed)
    knots, pressures = scenario.pressure_knots(place.seal_pressure, _SAMPLE_TIME)
    return _Course(along, np.array(knots), np.array(pressures), speed)


def _resolve(loop: Any, course: _Course) -> tuple[LoopAt, StateSpace]:
    """The loop as a function of speed or pressure, and the loop at the start."""
    if hasattr(loop, "A") or not callable(loop):
        first = as_statespace(loop)
        return (lambda _: first), first
    return loop, as_statespace(loop(float(course.values[0])))


def _sample_time(loop: StateSpace, scenario: Scenario, dt: float | None) -> float:
    stated = (
        scenario.sample_time
        if dt is None
        else check_positive(dt, "dt", "give the sample time in seconds")
    )
    if loop.dt is not None:
        if stated is not None and not same_clock(stated, loop.dt):
            raise invalid(
                "the sample time", stated, f"the loop's own {loop.dt:g} s, or None", "leave it out"
            )
        return loop.dt
    if stated is not None:
        return stated
    return _SAMPLE_TIME / max(1.0, np.ceil(scenario.fastest * _SAMPLE_TIME / FASTEST))


def _constant_speed(task: _Task, pole: complex | None) -> np.ndarray:
    """Outputs at one speed; an unstable loop in stretches of twenty time constants, so that it
    stops before it overflows.
    """
    k = task.c.shape[2]
    # twenty time constants of the rightmost pole, 16 samples at least
    length = (
        k if pole is None or pole.real <= 0 else max(16, int(min(20 / (pole.real * task.dt), k)))
    )
    system = task.sampled(float(task.course.values[0]))
    edges = [*range(0, k, length), k]
    pieces = [task.piece(system, first, last) for first, last in pairwise(edges)]
    return simulate_piecewise([system] * len(pieces), pieces, stop=task.stop)


def _run_up(task: _Task) -> tuple[np.ndarray, float]:
    """Outputs while the speed changes, and their estimated error as a fraction of the peak."""
    count = _FEWEST
    error = np.inf
    name = task.course.along.name
    coarse = _held_speed(task, count)
    rows = index_of(task.watched or task.outputs, task.outputs, "output")
    while True:
        count *= 2
        fine = _held_speed(task, count)
        k = min(coarse.shape[1], fine.shape[1])
        peak = np.abs(fine[rows, :k]).max(initial=0.0)
        # second order: of twice as many intervals the error is a third of the change
        error = (
            float(np.abs(fine[rows, :k] - coarse[rows, :k]).max(initial=0.0) / 3 / peak)
            if peak > 0
            else 0.0
        )
        if error <= _CLOSE or count >= min(_MOST, task.c.shape[2]):
            break
        coarse = fine

    # a run that ends at the limit needs no such accuracy
    if error > _TOLERATED and not task.stop(fine):
        raise NumericalFailure(
            f"the run-up has an error of {error:.2g} of the peak with {count} intervals of "
            f"constant {name}, more than "
            f"{_TOLERATED:g}; lengthen the run-up, narrow its {name} range or set a "
            "displacement_limit"
        )
    return fine, error


def _held_speed(task: _Task, count: int) -> np.ndarray:
    """Outputs with the ramps in ``count`` intervals, each at its middle speed, and the rest at the
    final speed.
    """
    k = task.c.shape[2]
    # edges at the corners of the course, too: no interval goes across one
    knots = np.minimum((task.course.times / task.dt).round().astype(int), k)
    edges = np.unique(
        [*np.linspace(0, knots[-1], count + 1).round().astype(int), *knots, k]
    ).tolist()
    spans = list(pairwise(edges))

    def systems() -> Iterator[StateSpace]:
        for first, last in spans:
            yield task.sampled(float(task.course.at((first + last) / 2 * task.dt)))

    probe = task.sampled(float(task.course.values[0]))
    return simulate_piecewise(
        systems(), [task.piece(probe, first, last) for first, last in spans], stop=task.stop
    )


def _frozen(loop_at: LoopAt, course: _Course) -> list[tuple[float, StateSpace]]:
    """Values of the course and the loops there; one alone where the loop is the same at every
    one.
    """
    values = (
        course.at(np.linspace(0.0, course.times[-1], _FROZEN))
        if course.moves
        else course.values[:1]
    )
    cache: dict[int, tuple[float, StateSpace]] = {}
    for value in np.append(values, [] if course.along is SPEED else course.values).tolist():
        system = as_statespace(loop_at(value))
        cache.setdefault(id(system), (value, system))  # the same loop at every speed
    return list(cache.values())


def _check_same_states(
    frozen: Sequence[tuple[float, StateSpace]], watched: Sequence[str], unit: str
) -> None:
    """Displacements and velocities are the same sums of states at every speed, as they are of a
    rotor's own coordinates.

    A basis or a scaling that depends on the speed shows there; carried over, such states would jump
    from speed to speed.
    """
    (start, first), *others = frozen
    rows = [name for name in first.outputs if name.startswith("qdot_")]
    rows = [*watched, *rows]
    for speed, system in others:
        for name in ("n_states", "inputs", "outputs", "dt"):
            if getattr(system, name) != getattr(first, name):
                raise invalid(
                    f"{name} of the loop at {speed:g} {unit}",
                    getattr(system, name),
                    f"as at {start:g} {unit}, {getattr(first, name)}",
                    "close the loop with the same parts at every speed",
                )

        # rows of C that read displacements and velocities, each in units of its largest entry
        ours, theirs = (x.C[index_of(rows, x.outputs, "output")] for x in (first, system))
        change = np.abs(theirs - ours).max(axis=1, initial=0.0) / np.abs(ours).max(
            axis=1, initial=1e-300
        )
        if change.max(initial=0.0) > _SAME_STATES:
            k = int(np.argmax(change))
            raise invalid(
                "the states of the loop",
                f"others at {speed:g} than at {start:g} {unit} ({rows[k]} reads them "
                f"{change[k]:.1%} "
                "otherwise)",
                "the same at every speed, for the run-up carries them over",
                "take plants of assemble or free_mode_reduction; reduce has a basis of its own at "
                "every speed",
            )


def _rightmost(frozen: Sequence[tuple[float, StateSpace]]) -> tuple[complex | None, float]:
    """The rightmost pole [rad/s] of the loops, and the speed or pressure it belongs to."""
    rightmost: list[tuple[float, complex, float]] = []
    for value, system in frozen:
        z = poles(system)
        # sampled: s = ln(z)/dt, a pole at zero far to the left
        s = (
            z
            if system.dt is None
            else np.log(np.maximum(np.abs(z), 1e-300)) / system.dt + 1j * np.angle(z) / system.dt
        )
        rightmost += [(float(pole.real), complex(pole), value) for pole in s]
    if not rightmost:
        return None, frozen[0][0]
    _, pole, at = max(rightmost, key=lambda entry: (entry[0], entry[1].imag))
    return pole, at


def _record(
    task: _Task, y: np.ndarray, recorded: Sequence[str], machine: str, point: OperatingPoint | None
) -> Record:
    """Outputs, driven inputs and, where it changes, the speed or pressure, as a Record."""
    k = y.shape[1]
    names, values = [*recorded, *task.inputs], [y, task.c[0, :, :k]]
    if task.course.moves:
        names.append("speed" if task.course.along is SPEED else "p_seal")
        values.append(task.course.at(np.arange(k) * task.dt)[None])
    units = tuple(signal_dimension(name).unit for name in names)
    where = replace(OperatingPoint() if point is None else point, speed=task.course.speed)
    notes = (("scenario", task.scenario.name),)
    return Record(machine, 1 / task.dt, tuple(names), units, np.vstack(values), where, notes=notes)


def _explain(
    outcome: str,
    stopped_at: float | None,
    culprit: str,
    limit: float,
    pole: complex | None,
    at: str,
    error: float | None,
) -> str:
    side = "" if pole is None else f"rightmost pole {pole.real:.4g}{pole.imag:+.4g}j rad/s{at}"
    if stopped_at is not None:
        what = f"{culprit} passed {limit * 1e6:g} um at t = {stopped_at:.6g} s"
        return (
            f"diverged: {what}; the loop is unstable, {side}"
            if outcome == "diverged"
            else f"limit exceeded: {what}; {side}"
        )
    accuracy = f"; error of the run-up about {error:.1e} of the peak" if error is not None else ""
    if pole is not None and pole.real >= 0:
        return (
            f"completed within {limit * 1e6:g} um only because it is short: the loop is unstable, "
            f"{side}{accuracy}"
        )
    return f"completed; {side or 'the loop has no states'}{accuracy}"
