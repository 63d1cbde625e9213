"""What a scenario is made of: one small class per table of its file, all quantities in SI and
rad/s.

A ``signal`` is an input of the loop: current excitation e_<axis> [A], output disturbance d_<axis>
[m], reference r_<axis> [m], force f_<port>_<direction> [N].
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ambrose.core.checks import InvalidInput, check_finite, check_positive, invalid

SPACINGS = ("linear", "logarithmic")
SENSOR_FAULTS = ("", "stuck", "lost")
_ORDERS = (2, 20)  # bits of a shift register


@dataclass(frozen=True, slots=True)
class Pulse:
    """A rectangular disturbance: ``amplitude`` (SI unit of ``signal``) from ``start`` [s] for
    ``duration`` [s].

    Without a duration it is a step that lasts to the end. ``every`` [s] repeats it.
    """

    signal: str
    amplitude: float
    start: float = 0.0
    duration: float | None = None
    every: float | None = None


@dataclass(frozen=True, slots=True)
class Sine:
    """amplitude sin(frequency (t - start) + phase) from ``start`` [s] for ``duration`` [s] (None:
    to the end); [rad/s].
    """

    signal: str
    amplitude: float
    frequency: float
    phase: float = 0.0
    start: float = 0.0
    duration: float | None = None


@dataclass(frozen=True, slots=True)
class SteppedSine:
    """A sine of one frequency [rad/s] after the other, each for ``dwell`` [s] and beginning at
    angle zero.
    """

    signal: str
    amplitude: float
    frequencies: tuple[float, ...]
    dwell: float
    start: float = 0.0

    def __post_init__(self) -> None:
        check_positive(self.dwell, f"the dwell on {self.signal}", "give it in seconds")
        if not self.frequencies:
            raise InvalidInput(
                f"the stepped sine on {self.signal} has no frequencies; list at least one"
            )

    @property
    def sines(self) -> tuple[Sine, ...]:
        """The same as single sines."""
        return tuple(
            Sine(
                self.signal, self.amplitude, frequency, 0.0, self.start + i * self.dwell, self.dwell
            )
            for i, frequency in enumerate(self.frequencies)
        )


@dataclass(frozen=True, slots=True)
class Chirp:
    """A sine whose frequency goes from ``frequency`` to ``to_frequency`` [rad/s] within
    ``duration`` [s] (None: to the end).

    spacing "linear" passes equal frequency ranges in equal times, "logarithmic" equal ratios.
    """

    signal: str
    amplitude: float
    frequency: float
    to_frequency: float
    start: float = 0.0
    duration: float | None = None
    spacing: str = "linear"

    def __post_init__(self) -> None:
        for frequency in (self.frequency, self.to_frequency):
            check_positive(
                frequency, f"a frequency of the chirp on {self.signal}", "give it in rad/s"
            )
        if self.spacing not in SPACINGS:
            raise invalid(
                f"the spacing of the chirp on {self.signal}",
                repr(self.spacing),
                " or ".join(SPACINGS),
                "correct it",
            )


@dataclass(frozen=True, slots=True)
class Prbs:
    """A pseudo-random binary sequence of +-amplitude: a maximum-length sequence of 2^order - 1
    bits, each ``bit_time`` [s].

    It repeats to the end of ``duration`` [s] (None: of the scenario). Sequences with different
    ``seed`` are the same shifted far apart, and so nearly uncorrelated.
    """

    signal: str
    amplitude: float
    bit_time: float
    order: int = 10
    seed: int = 0
    start: float = 0.0
    duration: float | None = None

    def __post_init__(self) -> None:
        check_positive(self.bit_time, f"the bit_time on {self.signal}", "give it in seconds")
        if not _ORDERS[0] <= self.order <= _ORDERS[1]:
            requirement = f"from {_ORDERS[0]} to {_ORDERS[1]}"
            raise invalid(
                f"the order of the sequence on {self.signal}",
                self.order,
                requirement,
                "10 repeats after 1023 bits",
            )

    @property
    def shift(self) -> int:
        """Bits by which the sequence is shifted: multiples of the golden section of its length."""
        length = 2**self.order - 1
        return round(self.seed * 0.6180339887498949 * length) % length


@dataclass(frozen=True, slots=True)
class Unbalance:
    """A mass off centre at ``port`` ("A", "center", ...), turning with the rotor; ``phase`` [rad]
    from the first direction.

    Either ``amount`` [kg m], or ``grade`` [m/s] at ``grade_speed`` [rad/s] (ISO 21940-11, G2.5:
    2.5e-3 m/s), of which this port carries the fraction ``share``: amount = share grade mass /
    grade_speed with the rotor's mass.
    """

    port: str
    amount: float | None = None
    grade: float | None = None
    grade_speed: float | None = None
    share: float = 1.0
    phase: float = 0.0

    def __post_init__(self) -> None:
        graded = self.grade is not None and self.grade_speed is not None
        if graded == (self.amount is not None) or (self.grade is None) != (
            self.grade_speed is None
        ):
            raise InvalidInput(
                f"the unbalance at {self.port} needs either amount, or grade and grade_speed; "
                "give one of the two"
            )

    def mass_times_radius(self, mass: float | None) -> float:
        """The amount [kg m]; ``mass`` of the rotor [kg] is needed for a grade. Raises
        InvalidInput.
        """
        if self.amount is not None:
            return self.amount
        if self.grade is None or self.grade_speed is None or mass is None:
            raise InvalidInput(
                f"the unbalance at {self.port} is a grade, which needs the rotor's mass; pass "
                "mass=... in kg"
            )
        return (
            self.share
            * self.grade
            * check_positive(mass, "mass", "give it in kg")
            / self.grade_speed
        )


@dataclass(frozen=True, slots=True)
class PressureChange:
    """The differential pressure of every seal goes to ``pressure`` [Pa] at ``time`` [s], linearly
    within ``ramp`` [s].
    """

    time: float
    pressure: float
    ramp: float = 0.0

    def __post_init__(self) -> None:
        for name in ("time", "pressure", "ramp"):
            check_positive(
                getattr(self, name),
                f"{name} of the change of pressure",
                "correct it",
                zero_allowed=True,
            )


@dataclass(frozen=True, slots=True)
class PressureSensor:
    """From ``time`` [s] on the sensor of the seal pressure tells gain p + offset [Pa] through a
    first-order lag [s], with white noise of so many Pa (rms) at every sample; "stuck" it keeps what
    it told last, "lost" it tells nothing.
    """

    time: float = 0.0
    gain: float = 1.0
    offset: float = 0.0
    lag: float = 0.0
    noise: float = 0.0
    fault: str = ""

    def __post_init__(self) -> None:
        for name in ("time", "lag", "noise"):
            check_positive(
                getattr(self, name),
                f"{name} of the pressure sensor",
                "correct it",
                zero_allowed=True,
            )
        for name in ("gain", "offset"):
            check_finite(getattr(self, name), f"{name} of the pressure sensor")
        if self.fault not in SENSOR_FAULTS:
            raise invalid(
                "fault of the pressure sensor",
                repr(self.fault),
                '"stuck", "lost" or left out',
                "correct it",
            )


_EXACT = PressureSensor()


def sensed(
    time: np.ndarray,
    sensors: Sequence[PressureSensor],
    knots: Sequence[float],
    values: Sequence[float],
) -> np.ndarray:
    """What the sensors, one from its time on and each to the next one's, tell (n,) [Pa] at times
    (n,) [s] without their noise.

    knots, values: times [s] and pressures [Pa], linear between. Stuck or lost: the last one. Exact:
    g + s t - s T + (l - g + s T) exp(-t/T) within a segment from g with slope s, for a lag T that
    tells l at its start.
    """
    edges = np.unique([0.0, *knots, *(item.time for item in sensors)])
    at = np.searchsorted(edges, time, side="right") - 1
    result, last = np.empty(len(time)), float(np.interp(0.0, knots, values))
    for i, start in enumerate(edges.tolist()):
        item = next((sensor for sensor in reversed(sensors) if sensor.time <= start), _EXACT)
        # constant after the last knot
        end = float(edges[i + 1]) if i + 1 < len(edges) else start + 1.0
        # gain p + offset at both ends: g and s
        begin, then = (
            item.gain * float(np.interp(t, knots, values)) + item.offset for t in (start, end)
        )
        # a fault holds what was told last; without a lag the sensor tells g at once
        slope = 0.0 if item.fault else (then - begin) / (end - start)
        begin, behind = last if item.fault else begin, slope * item.lag
        last = begin if item.lag == 0 else last
        # g + s t - s T + (l - g + s T) e^(-t/T); the last entry is the next segment's l
        since = np.append(time[at == i], end) - start
        left = np.exp(-since / item.lag) if item.lag > 0 else np.zeros(len(since))
        reading = begin + slope * since - behind + (last - begin + behind) * left
        result[at == i], last = reading[:-1], float(reading[-1])
    return result


@dataclass(frozen=True, slots=True)
class SpeedChange:
    """The rotor's speed goes to ``speed`` [rad/s] from ``time`` [s] on, linearly within ``ramp``
    [s].
    """

    time: float
    speed: float
    ramp: float

    def __post_init__(self) -> None:
        check_positive(self.time, "time of the change of speed", "correct it", zero_allowed=True)
        check_positive(
            self.ramp,
            "ramp of the change of speed",
            "give it in seconds; no rotor changes its speed at once",
        )
        check_positive(
            self.speed, "the speed of a change of speed", "a rotor turns one way", zero_allowed=True
        )


@dataclass(frozen=True, slots=True)
class Failure:
    """From ``time`` [s] on the amplifier of ``axis`` ("A_zeta") has no power; without an axis, none
    has. ``until`` [s] it returns (without one it does not); the controller has run on.
    """

    time: float
    axis: str | None = None
    until: float | None = None

    def __post_init__(self) -> None:
        check_positive(
            self.time, "the time of the failure", "give it in seconds", zero_allowed=True
        )
        if self.until is not None and not self.time < self.until < math.inf:
            raise invalid(
                "until of a failure",
                self.until,
                f"after its time, {self.time:g} s",
                "correct it, or leave it out if the power stays away",
            )


Disturbance = Pulse | Sine | Chirp | Prbs


def check_disturbance(item: Disturbance, end: float) -> None:
    """Refuse what cannot act in a scenario that lasts until ``end`` [s]. Raises InvalidInput."""
    if not math.isfinite(item.amplitude):
        raise invalid(f"the amplitude on {item.signal}", item.amplitude, "finite", "correct it")
    if not 0 <= item.start < end:
        raise invalid(
            f"the start on {item.signal}", item.start, f"within 0 to {end:g} s", "move it"
        )
    if item.duration is not None:
        check_positive(item.duration, f"the duration on {item.signal}", "give it in seconds")
    if (
        isinstance(item, Pulse)
        and item.every is not None
        and (item.duration is None or not item.duration <= item.every)
    ):
        raise invalid(
            f"every of the pulse on {item.signal}",
            item.every,
            "at least its duration",
            "lengthen it",
        )
    if isinstance(item, Sine):
        check_positive(
            item.frequency, f"the frequency of the sine on {item.signal}", "give it in rad/s"
        )
