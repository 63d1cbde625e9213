"""One axis from a record of it alone: looked at, fitted, questioned.

done = identify_generic("record.csv")
done.pole, done.value("gain").half_width, done.verdict
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.signal import coherence

from ambrose.core.checks import InvalidInput, check_positive, invalid
from ambrose.core.presentation import Presented, with_unit
from ambrose.identification.data_quality.signals import flat_tops
from ambrose.identification.findings import ERROR, WARNING, Code, Finding, refuse
from ambrose.identification.one_axis.axis_record import AxisRecord, read_axis
from ambrose.identification.one_axis.estimate import (
    ACTUATORS,
    ANSWERS,
    LEVEL,
    Estimate,
    estimate,
    outside_part,
)
from ambrose.machine.units import DIMENSIONS, read_quantity

# First look at a record of one levitated axis, whatever controlled it: whether anything can be
# identified from it, before anything is fitted.
#
# The plant is m y'' = k_s y + k_i i about the mean position, with the pole p = sqrt(k_s / m). Under
# its own weight, f ~ (i / y)^2 holds it with k_s = 2 m g / y, so that p = sqrt(2 g / y): the rate
# that a record needs is known before the plant is.


_GRAVITY = 9.81  # m/s^2
# samples per time constant 1/p of the plant: needed (measured: at 3 a fit's intervals hold the
# truth), and recommended
_LEAST_RATE, _GOOD_RATE = 3.0, 10.0
_COARSE = 0.05  # of a signal's rms, its smallest step; assumed
_AT_STOP = (
    0.02  # of the samples at an end of the travel, from which on it did not levitate; assumed
)
_BELONGS = 0.95  # of the voltage's variance that R i + L di/dt explains at least; assumed
_LEAST = 50  # samples


def dead_channels(signals: dict[str, np.ndarray]) -> Iterator[Finding]:
    """A signal of two values or fewer measures nothing."""
    for name, values in signals.items():
        count = len(np.unique(values))
        if count <= 2:
            yield Finding(
                Code.DEAD_CHANNEL,
                ERROR,
                f"{name} is dead",
                f"{count} value{'s' if count > 1 else ''} in {len(values)} samples",
                "look for another channel of it, or mend the sensor",
            )


def levitation(t: np.ndarray, position: np.ndarray, gap: float | None) -> Iterator[Finding]:
    """Samples (n,) at either end of the travel [m]: it fell, or it stuck."""
    far = position.max() if gap is None else gap
    edge = _AT_STOP * far
    stopped = (position <= edge) | (position >= far - edge)
    share = float(np.mean(stopped))
    if share > _AT_STOP:
        first, last = longest_run(~stopped)
        yield Finding(
            Code.TOUCHDOWN,
            ERROR,
            "it did not levitate all the time",
            f"{100 * share:.2g} % of the samples are at an end of the travel of {far:.3g} m",
            f"cut out the part in which it hovers (the longest: {t[first]:.4g} to {t[last]:.4g} s)"
            ", or record again",
        )


def longest_run(good: np.ndarray) -> tuple[int, int]:
    """First and last sample of the longest run of True in (n,); (0, 0) where there is none."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], good, [False]]).astype(int)))
    if not len(edges):
        return 0, 0
    starts, ends = edges[0::2], edges[1::2]
    longest = int(np.argmax(ends - starts))
    return int(starts[longest]), int(ends[longest]) - 1


def rate_by_weight(t: np.ndarray, position: np.ndarray) -> Iterator[Finding]:
    """Samples per time constant of the plant, p = sqrt(2 g / y) at the median position."""
    middle = float(np.median(position))
    if middle <= 0:
        return
    pole, step = np.sqrt(2 * _GRAVITY / middle), float(np.median(np.diff(t)))
    if pole * step * _LEAST_RATE > 1:
        yield Finding(
            Code.SAMPLE_RATE,
            ERROR,
            "the rate is too low for this plant",
            f"{1 / (pole * step):.2g} samples in the time in which a fall grows by e (by its "
            f"weight, f ~ (i/y)^2, the pole is at {pole:.3g} rad/s)",
            f"record at {_GOOD_RATE * pole:.2g} Hz or more",
        )


def coarse_steps(signals: dict[str, np.ndarray]) -> Iterator[Finding]:
    """The smallest step between values, over the signal's rms."""
    for name, values in signals.items():
        step = float(np.diff(np.unique(values)).min())
        share = step / float(values.std())
        if share > _COARSE:
            yield Finding(
                Code.CLIPPED,
                WARNING,
                f"{name} is coarse",
                f"its quantisation steps of {step:.2g} are {100 * share:.2g} % of its rms",
                "use more of the converter's range",
            )


def coil_equation(t: np.ndarray, signals: dict[str, np.ndarray]) -> Iterator[Finding]:
    """u = R i + L di/dt + c by least squares: how much of the voltage the current explains."""
    if "voltage" not in signals:
        return
    i, u = signals["current"], signals["voltage"]
    columns = np.column_stack([i, np.gradient(i, t), np.ones_like(i)])
    found = np.linalg.lstsq(columns, u, rcond=None)[0]
    share = 1 - float(np.sum((u - columns @ found) ** 2) / np.sum((u - u.mean()) ** 2))
    if share < _BELONGS:
        yield Finding(
            Code.MIXED_CHANNELS,
            ERROR,
            "the current does not belong to the voltage",
            f"R i + L di/dt explains {100 * share:.3g} % of it, at best with R = {found[0]:.3g} "
            f"ohm and {found[2]:+.2g} V beside",
            "record the voltage at the coil, or an average over its modulation, at the current's "
            "instants",
        )


# Whether what was identified belongs to the force law F = c (i/s)^2 of a magnet.
#
# Of one magnet about s_0, i_0, and of a pair with the bias i_0 and the gap s_0 on both sides,
#
#     one:   m y'' = dF/ds y + dF/di i,      k_s = 2 F_0 / s_0,       k_i = 2 F_0 / i_0,
#     pair:                                  k_s = 4 c i_0^2 / s_0^3, k_i = 4 c i_0 / s_0^2,
#
# so that k_s / k_i = a / b = i_0 / s_0 for both, whatever c and m are; and where one magnet carries
# the weight, F_0 = m g, then a = 2 g / s_0 and b = 2 g / i_0 besides (Schweitzer and Maslen,
# Magnetic Bearings, 2009, section 4.1).


GRAVITY = 9.81  # m/s^2
COVERAGE = 1.96  # standard deviations to either side: 95 % of a normal distribution


@dataclass(frozen=True, slots=True)
class ForceLaw:
    """gap s_0 [m]; current i_0 [A]; hanging: one magnet carries the weight, else a pair with bias.
    Raises InvalidInput.
    """

    gap: float
    current: float
    hanging: bool = False

    def __post_init__(self) -> None:
        for name in ("gap", "current"):
            check_positive(getattr(self, name), name, "state it in SI units")


@dataclass(frozen=True, slots=True)
class LawRow:
    """One consequence of the law: expected of it, found with its half-width (95 %), one unit."""

    name: str
    expected: float
    found: float
    half_width: float
    unit: str

    @property
    def fits(self) -> bool:
        """Whether the interval holds what the law expects."""
        return bool(abs(self.found - self.expected) <= self.half_width)


def current_scale(unit: str) -> float | None:
    """What one ``unit`` is in A; None where it is no unit of current."""
    try:
        return read_quantity(f"1 {unit}", DIMENSIONS["current"])
    except ValueError:
        return None


def compare_law(
    law: ForceLaw, stiffness: float, gain: float, covariance: np.ndarray, unit: str
) -> tuple[LawRow, ...]:
    """What the law expects beside what was found.

    stiffness a [1/s^2], gain b [m/s^2 per unit] (its sign: how y and u are counted), covariance
    (2, 2) of both; unit: of the drive, one of current.
    """
    # b per ampere, and its row and column of the covariance
    scale = current_scale(unit) or 1.0
    gain, per_ampere = gain / scale, np.array([1.0, 1 / scale])
    covariance = covariance * per_ampere * per_ampere[:, None]
    ratio = stiffness / abs(gain)
    slope = np.array([1 / abs(gain), -stiffness / (gain * abs(gain))])
    rows = [
        LawRow(
            "a/b = i0/s0",
            law.current / law.gap,
            ratio,
            COVERAGE * float(np.sqrt(slope @ covariance @ slope)),
            "A/m",
        )
    ]
    if law.hanging:
        halves = COVERAGE * np.sqrt(np.diag(covariance))
        rows.append(
            LawRow("a = 2 g/s0", 2 * GRAVITY / law.gap, stiffness, float(halves[0]), "1/s^2")
        )
        rows.append(
            LawRow(
                "b = 2 g/i0",
                2 * GRAVITY / law.current,
                abs(gain),
                float(halves[1]),
                "m/s^2/A",
            )
        )
    return tuple(rows)


# The first look at the record of one axis, before anything is fitted.


_AT_RAIL = 0.02  # of the samples at a flat top; assumed
# different values of a signal, from which on its ends are rails; assumed: a square wave or a coarse
# converter lies at its ends without being cut off
_LEVELS = 50
# periods 2 pi/pole of the plant in a segment of the coherence; assumed: what a segment begins with
# has died away in it
_SEGMENT = 4.0
_SHORTEST, _LEAST_COUNT = 64, 8  # samples of a segment, segments of a record; assumed
_SLOWEST = 1e-9  # [rad/s] of a plant's pole, so that none is divided by


def look(record: AxisRecord, travel: float | None = None) -> tuple[Finding, ...]:
    """What is wrong with it. travel [m]: between the stops, where the displacement is the distance
    from the magnet; None: it is counted from anywhere.
    """
    signals = {"displacement": record.position, "drive": record.drive}
    for name in ("current", "voltage"):
        if getattr(record, name) is not None:
            signals[name] = getattr(record, name)
    dead = tuple(dead_channels(signals))
    if dead:
        return dead
    current = record.drive if record.current is None and record.unit == "A" else record.current
    coil = {}
    if record.voltage is not None and current is not None:
        coil = {"voltage": record.voltage, "current": current}
    return (
        *(levitation(record.time, record.position, travel) if travel else ()),
        *(rate_by_weight(record.time, record.position) if travel else ()),
        *(() if travel else _rails(record)),
        *_silent_reference(record),
        *coarse_steps({name: signals[name] for name in ("displacement", "drive")}),
        *(coil_equation(record.time, coil) if coil else ()),
    )


def _rails(record: AxisRecord) -> Iterator[Finding]:
    """A share of samples at the very ends of a signal: a stop, a sensor's or a converter's end."""
    for name, values in (("displacement", record.position), ("drive", record.drive)):
        count, level = flat_tops(values)
        share = count / len(values)
        if share > _AT_RAIL and len(np.unique(values)) >= _LEVELS:
            first, last = longest_run(values != level)
            start, stop = record.time[first], record.time[last]
            yield Finding(
                Code.TOUCHDOWN if name == "displacement" else Code.SATURATED,
                ERROR,
                f"the {name} is at an end of its range",
                f"{100 * share:.2g} % of its samples lie at {level:.4g}, in flat tops",
                f"cut out a part without (the longest: {start:.4g} to {stop:.4g} s), or record "
                "again",
            )


def _silent_reference(record: AxisRecord) -> Iterator[Finding]:
    if record.reference is not None and np.ptp(record.reference) == 0:
        yield Finding(
            Code.NO_EXCITATION,
            WARNING,
            "the reference never changes",
            f"{record.reference[0]:.3g} throughout",
            "it is left out; name the column of what was driven, if there was one",
        )


def coherence_with(
    driving: np.ndarray, position: np.ndarray, rate: float, pole: float
) -> tuple[np.ndarray, np.ndarray, float]:
    """Frequencies (k,) [Hz], coherence (k,) of the displacement (n,) with what drives the loop
    (n,), and the value that is exceeded by chance in 5 of 100.

    pole [rad/s]: the plant's, which sets the segments. Of K segments that share no samples,
    1 - 0.05^(1/(K - 1)) (Bendat and Piersol, Random Data, 4th ed., 2010, section 9.2).
    """
    n = len(position)
    wanted = _SEGMENT * 2 * np.pi / max(pole, _SLOWEST) * rate
    length = int(min(max(wanted, _SHORTEST), n // _LEAST_COUNT))
    frequency, value = coherence(driving, position, rate, nperseg=length)
    segments = max(n // length, 2)
    return frequency, np.nan_to_num(value), float(1 - 0.05 ** (1 / (segments - 1)))


# What `identify --generic` found about one axis.


@dataclass(frozen=True, slots=True)
class PlantValue:
    """A quantity of the plant with the half-width of its 95 % interval, all in ``unit``.

    formal, halves: the half-widths that the residual and that both halves of the record tell; the
    larger is half_width. second: the value of the other way, None: there is none.
    """

    name: str
    symbol: str
    value: float
    half_width: float
    formal: float
    halves: float
    unit: str
    second: float | None = None

    @property
    def source(self) -> str:
        """Where the interval comes from: "formal" or "halves"."""
        return "halves" if self.halves > self.formal else "formal"


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class GenericIdentification(Presented):
    """One axis, y'' = a y + b u(t - tau), as identified.

    verdict: "identified" or "not this model". frequency (k,) [Hz], coherence (k,) of the
    displacement with what drives the loop, chance: what of it noise would show in 5 of 100. law:
    what a stated force law expects, beside what was found. findings: doubts.
    """

    record: AxisRecord
    values: tuple[PlantValue, ...]
    estimate: Estimate
    verdict: str
    findings: tuple[Finding, ...]
    frequency: np.ndarray
    coherence: np.ndarray
    chance: float
    law: tuple[LawRow, ...] = ()

    @property
    def passed(self) -> bool:
        return not self.findings

    @property
    def pole(self) -> float:
        """The unstable pole [rad/s]; 0 where the axis is stable without control."""
        return self.value("pole").value

    @property
    def coherence_in_band(self) -> float:
        """Mean coherence from 0.3 to 3 times the pole; of all frequencies where there is none."""
        edge = max(self.pole, 1e-9) / (2 * np.pi)
        inside = (self.frequency >= 0.3 * edge) & (self.frequency <= 3 * edge)
        return float((self.coherence[inside] if inside.any() else self.coherence).mean())

    def value(self, name: str) -> PlantValue:
        """One of "pole", "stiffness", "gain", "delay", "lag", "k_s", "k_i". Raises KeyError."""
        for item in self.values:
            if item.name == name:
                return item
        raise KeyError(name)

    def facts(self) -> dict[str, Any]:
        rows = {item.name: _in_words(item) for item in self.values}
        return {"record": self.record.name, "verdict": self.verdict, **rows}

    def to_dict(self) -> dict[str, Any]:
        """Plain data for JSON, SI."""
        done, ahead = self.estimate, self.estimate.prediction
        values = {
            item.name: {
                "value": item.value,
                "half_width": item.half_width,
                "formal_half_width": item.formal,
                "halves_half_width": item.halves,
                "interval_from": item.source,
                "unit": item.unit,
                "other_way": item.second,
            }
            for item in self.values
        }
        return {
            "record": self.record.name,
            "columns": dict(self.record.columns),
            "sample_rate_hz": self.record.rate,
            "samples": len(self.record.position),
            "verdict": self.verdict,
            "passed": self.passed,
            "values": values,
            "way": done.way,
            "noise_order": 2 + done.structure.colour,
            "coherence": self.coherence_in_band,
            "coherence_by_chance": self.chance,
            "residual": {
                "white": done.white,
                "share_from_its_past": done.white_share,
                "follows": done.follows,
                "share_that_follows": done.follows_share,
                "both_ways_agree": done.agree,
                "straight": done.curved,
            },
            "prediction": {
                "ahead_s": ahead.horizon,
                "error_m": ahead.error,
                "expected_m": ahead.expected,
                "staying_m": ahead.still,
            },
            "law": [
                {
                    "name": row.name,
                    "expected": row.expected,
                    "found": row.found,
                    "half_width": row.half_width,
                    "unit": row.unit,
                    "fits": row.fits,
                }
                for row in self.law
            ],
            "findings": [
                {
                    "code": str(finding.code),
                    "severity": finding.severity,
                    "text": str(finding),
                }
                for finding in self.findings
            ],
        }


def _in_words(item: PlantValue) -> str:
    return f"{with_unit(item.value, item.unit)} +- {item.half_width:.2g}"


def plant_values(done: Estimate, unit: str, mass: float | None = None) -> tuple[PlantValue, ...]:
    """Pole, stiffness, gain, delay and lag, with a mass [kg] k_s and k_i too; unit: of the drive.

    p = sqrt(a), and its deviation that of a over 2 p.
    """
    names = [
        ("stiffness", "a", "1/s^2"),
        ("gain", "b", f"m/s^2/{unit}"),
        ("delay", "tau", "s"),
        ("lag", "T", "s"),
    ]
    rows = []
    for place, (name, symbol, its_unit) in enumerate(names[: done.structure.plant]):
        second = None if done.second is None else float(done.second[place])
        rows.append(
            PlantValue(
                name,
                symbol,
                float(done.plant[place]),
                COVERAGE * float(done.deviations[place]),
                COVERAGE * float(done.formal[place]),
                COVERAGE * float(done.halves[place]),
                its_unit,
                second,
            )
        )
    stiffness = rows[0]
    pole = float(np.sqrt(max(stiffness.value, 0.0)))
    # dp = da / 2 p; where a is not above zero, as far as its interval reaches
    slope = 1 / (2 * pole) if pole else 1 / np.sqrt(max(stiffness.half_width, 1e-30))
    second = None if stiffness.second is None else float(np.sqrt(max(stiffness.second, 0.0)))
    first = PlantValue(
        "pole",
        "p",
        pole,
        stiffness.half_width * slope,
        stiffness.formal * slope,
        stiffness.halves * slope,
        "rad/s",
        second,
    )
    forces = [] if mass is None else [("k_s", "k_s", "N/m"), ("k_i", "k_i", f"N/{unit}")]
    for item, (name, symbol, its_unit) in zip(rows[:2], forces, strict=False):
        scaled = {
            key: mass * getattr(item, key) for key in ("value", "half_width", "formal", "halves")
        }
        rows.append(PlantValue(name, symbol, **scaled, unit=its_unit))
    return (first, *rows)


IDENTIFIED, OTHER = "identified", "not this model"
# samples per time constant 1/p: below the first no record serves (measured: at 3 the intervals
# hold the truth); below the second one that the model does not explain is refused for its rate
_LEAST_RATE, _GOOD_RATE = 3.0, 10.0
_DRIVEN = 5.0  # |b| over its deviation by what drives the loop from outside, at least; assumed
_WIDE = 0.5  # half-width over value
_PARTED = 3.3  # deviations between the halves: 1 of 1000 by chance
_BENT = 2.0  # %, by which a or b may differ at the tangent
_EXCESS = 1.5  # error of the prediction over what the model expects of it; assumed
_DRIVE_IT = (
    "add a binary sequence or sines, a few times the noise, to the reference or to u while it "
    "hovers, and record them too"
)


def identify_generic(
    record: Any,
    *,
    columns: Mapping[str, str] | None = None,
    sample_rate_hz: float | None = None,
    between: tuple[float, float] | None = None,
    travel: float | None = None,
    actuator: str = "auto",
    gap: float | None = None,
    current: float | None = None,
    mass: float | None = None,
    hanging: bool = False,
) -> GenericIdentification:
    """Unstable pole, gain and delay of one levitated axis, whatever controlled it, with 95 %
    intervals.

    record: a path (a record, or a text table) or a Record. columns: {"displacement", "drive",
    "reference", "current", "time": its name in the file, "column 2", or "none"} for what its name
    does not tell. sample_rate_hz [Hz]: of a table without times. between: the part (start, stop)
    [s]. travel [m]: between the stops, where the displacement is the distance from the magnet.
    actuator: "lag" (first order), "none", "auto". gap [m], current [A]: working point of a magnet,
    whose force law F = c (i/s)^2 is then compared; hanging: it carries the weight, and both are
    taken from the record where not given; mass [kg]: of what moves, for k_s = m a and k_i = m b.
    Raises InvalidInput with the reasons where the record cannot carry an identification.
    """
    if actuator not in ACTUATORS:
        raise invalid("actuator", repr(actuator), f"one of {', '.join(ACTUATORS)}", "choose one")
    if travel is not None:
        check_positive(travel, "travel", "give the distance between the stops in m")
    if mass is not None:
        check_positive(mass, "mass", "give it in kg")
    axis = read_axis(record, columns=dict(columns or {}), sample_rate_hz=sample_rate_hz)
    if between is not None:
        axis = axis.between(*between)
    law = _law(axis, gap, current, hanging)
    findings = look(axis, travel)
    refuse(findings)
    moving = axis.reference is not None and np.ptp(axis.reference) > 0
    reference = axis.reference if moving else None
    driving = outside_part(axis.position, axis.drive) if reference is None else reference
    if driving is None:
        raise InvalidInput(str(_undriven()))
    done = estimate(axis.position, axis.drive, axis.rate, reference, actuator=actuator)
    values = plant_values(done, axis.unit, mass)
    frequency, value, chance = coherence_with(driving, axis.position, axis.rate, values[0].value)
    rows: tuple[LawRow, ...] = ()
    if law is not None:
        rows = compare_law(
            law, float(done.plant[0]), float(done.plant[1]), done.covariance[:2, :2], axis.unit
        )
    doubts = (*findings, *_doubts(axis, done, values, rows))
    verdict = IDENTIFIED if done.is_believable and values[0].value > 0 else OTHER
    result = GenericIdentification(
        axis, values, done, verdict, doubts, frequency, value, chance, rows
    )
    refuse((*_unusable(result, reference is not None), *doubts))
    return result


def _law(
    axis: AxisRecord, gap: float | None, current: float | None, hanging: bool
) -> ForceLaw | None:
    """The stated law, at the record's own working point where it hangs and nothing is given.

    Raises InvalidInput where the drive is no current: the law's i_0/s_0 is in A/m.
    """
    if gap is None and current is None and not hanging:
        return None
    if current_scale(axis.unit) is None:
        unit = f"in {axis.unit}" if axis.unit != "-" else "without a unit"
        raise InvalidInput(
            f"the force law is one of currents, and the drive is {unit}; name the coil's current "
            'as the drive, with its unit where the header has none (drive "column 3 [A]"), or '
            "leave out gap, current and hanging"
        )
    if hanging:
        gap = float(axis.position.mean()) if gap is None else gap
        measured = axis.current if axis.current is not None else axis.drive
        scale = 1.0 if axis.current is not None else current_scale(axis.unit) or 1.0
        current = scale * float(abs(measured.mean())) if current is None else current
    if gap is None or current is None:
        missing = "gap" if gap is None else "current"
        raise InvalidInput(f"the force law lacks the {missing} of the working point; state it")
    return ForceLaw(gap, current, hanging)


def _undriven() -> Finding:
    return Finding(
        Code.NO_EXCITATION,
        ERROR,
        "nothing drives the loop from outside",
        "u follows from the displacement and from its own past to rounding, so that the record "
        "identifies the controller (y over u is near -1/K where noise drives the loop), not the "
        "plant",
        _DRIVE_IT,
    )


def _unusable(result: GenericIdentification, referenced: bool) -> Iterator[Finding]:
    """What only the fit shows, and without which its values mean nothing."""
    done, rate = result.estimate, result.record.rate
    # of a residual that is no noise, nothing of the kind can be said: not this model
    if done.answering < ANSWERS and min(done.follows, done.white) >= LEVEL:
        yield Finding(
            Code.MIXED_CHANNELS,
            ERROR,
            "the reference answers the displacement",
            f"it depends on earlier noise (chance {done.answering:.1g}), as the control error "
            "or u do",
            "name the external signal as the reference, or state reference: none",
        )
        return
    if done.outside < _DRIVEN:
        evidence = (
            f"by the {'reference' if referenced else 'part of u that y does not make'} alone the "
            f"gain is known to {done.outside:.2g} of its deviations, at least {_DRIVEN:g} are "
            "needed; what noise drives tells the controller (-1/K), not the plant"
        )
        yield Finding(
            Code.NO_EXCITATION, ERROR, "the loop has almost no excitation", evidence, _DRIVE_IT
        )
        return
    if referenced and result.pole > 0 and not result.coherence_in_band > result.chance:
        yield Finding(
            Code.COHERENCE,
            ERROR,
            "the displacement does not follow the reference",
            f"coherence {result.coherence_in_band:.2g} about the pole, {result.chance:.2g} by "
            "chance",
            "is it the column of this loop's reference? drive it harder, or for longer",
        )
    needed = _LEAST_RATE if done.is_believable else _GOOD_RATE
    if result.pole / rate * needed > 1:
        yield Finding(
            Code.SAMPLE_RATE,
            ERROR,
            "the rate is too low for this plant",
            f"{rate / result.pole:.2g} samples in the time in which a fall grows by e (pole found: "
            f"{result.pole:.3g} rad/s)",
            f"record at {_GOOD_RATE * result.pole:.2g} Hz or more",
        )


def _doubts(
    axis: AxisRecord, done: Estimate, values: tuple[PlantValue, ...], law: tuple[LawRow, ...]
) -> Iterator[Finding]:
    if not done.settled:
        yield Finding(
            Code.NOT_CONVERGED,
            WARNING,
            "the search ended in no minimum",
            "in the record or in one of its halves",
            "record for longer, or drive the loop harder; the intervals cannot be trusted",
        )
    if not done.is_believable:
        yield Finding(
            Code.NOT_THIS_MODEL,
            WARNING,
            "not this model: one unstable pole pair, a gain and a delay do not explain the record",
            _why(done),
            "look for a second mode, a moving working point, a nonlinear magnet or a filter; "
            "record the reference, and with smaller motion",
        )
    elif not done.plant[0] > 0:
        yield Finding(
            Code.NOT_THIS_MODEL,
            WARNING,
            "not this model: the axis is stable without control",
            f"a = {values[1].value:.3g} +- {values[1].half_width:.2g} 1/s^2",
            "are displacement, drive and reference the right columns?",
        )
    delay = values[3]
    if delay.value + delay.half_width < 0:
        yield Finding(
            Code.CHANNEL_SKEW,
            WARNING,
            "the displacement answers before it is driven",
            f"delay {1e3 * delay.value:.3g} +- {1e3 * delay.half_width:.2g} ms",
            "record both at the same instants, u as it is set",
        )
    for place, item in enumerate(values):
        if item.name in {"pole", "gain"} and item.half_width > _WIDE * abs(item.value):
            yield Finding(
                Code.HARDLY_VISIBLE,
                WARNING,
                f"the {item.name} is hardly visible",
                f"{item.value:.3g} {item.unit} +- {item.half_width:.2g}",
                "drive the loop harder or for longer, about the pole",
            )
        if 0 < place <= done.structure.plant and done.apart[place - 1] > _PARTED:
            yield Finding(
                Code.SCATTER,
                WARNING,
                f"both halves of the record disagree about the {item.name}",
                f"by {done.apart[place - 1]:.2g} deviations; the interval includes it",
                "something changed during the record (working point, temperature); identify the "
                "halves separately",
            )
    share = 100 * done.bend[:2] / np.abs(done.plant[:2])
    if share.max() > _BENT:
        yield Finding(
            Code.CURVED,
            WARNING,
            "the motion is large for the magnet: its curvature shows",
            f"at the tangent a differs by {share[0]:.2g} %, b by {share[1]:.2g} %; the "
            "intervals include it",
            "record with smaller motion",
        )
    ahead = done.prediction
    if ahead.excess > _EXCESS:
        yield Finding(
            Code.PREDICTION,
            WARNING,
            "the second half is not predicted as well as the first half promises",
            f"{ahead.error:.3g} m rms {1e3 * ahead.horizon:.3g} ms ahead, {ahead.expected:.3g} m "
            "expected",
            "something changed during the record; identify the halves separately",
        )
    off = [row for row in law if not row.fits]
    if off:
        evidence = "; ".join(
            f"{row.name}: {row.found:.4g} +- {row.half_width:.2g}, expected {row.expected:.4g} "
            f"{row.unit}"
            for row in off
        )
        yield Finding(
            Code.FORCE_LAW,
            WARNING,
            "the force law does not fit",
            evidence,
            "check gap, current and their units; iron and stray flux make the effective gap longer",
        )


def _why(done: Estimate) -> str:
    reasons = []
    if done.white < LEVEL:
        reasons.append(
            f"its residual is coloured (chance {done.white:.1g}; its past tells "
            f"{100 * done.white_share:.2g} % of it)"
        )
    if done.follows < LEVEL:
        reasons.append(
            f"its residual follows the excitation (chance {done.follows:.1g}, "
            f"{100 * done.follows_share:.2g} % of it)"
        )
    if done.answering < ANSWERS:
        reasons.append(f"the reference depends on earlier residuals ({done.answering:.1g})")
    if done.agree is not None and done.agree < LEVEL:
        reasons.append(f"with and without a noise model it is another plant ({done.agree:.1g})")
    return "; ".join(reasons)
