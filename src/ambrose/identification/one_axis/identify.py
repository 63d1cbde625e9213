"""One axis from a record of it alone: looked at, fitted, questioned.

done = identify_generic("record.csv")
done.pole, done.value("gain").half_width, done.verdict
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from ambrose.core.checks import InvalidInput, check_positive, invalid
from ambrose.identification.findings import ERROR, WARNING, Code, Finding, refuse
from ambrose.identification.one_axis.axis_record import AxisRecord, read_axis
from ambrose.identification.one_axis.estimate import (
    ACTUATORS,
    ANSWERS,
    LEVEL,
    Estimate,
    estimate,
)
from ambrose.identification.one_axis.force_law import (
    ForceLaw,
    LawRow,
    compare_law,
    current_scale,
)
from ambrose.identification.one_axis.instruments import outside_part
from ambrose.identification.one_axis.look import coherence_with, look
from ambrose.identification.one_axis.result import (
    GenericIdentification,
    PlantValue,
    plant_values,
)

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
        "tells the controller (y over u is near -1/K where noise drives the loop), not the plant",
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
            f"it knows of the noise before it (chance {done.answering:.1g}), as the control error "
            "or u do",
            "name what was added from outside, or leave it out as a reference: none",
        )
        return
    if done.outside < _DRIVEN:
        evidence = (
            f"by the {'reference' if referenced else 'part of u that y does not make'} alone the "
            f"gain is known to {done.outside:.2g} of its deviations, at least {_DRIVEN:g} are "
            "needed; what noise drives tells the controller (-1/K), not the plant"
        )
        yield Finding(
            Code.NO_EXCITATION, ERROR, "hardly anything drives the loop", evidence, _DRIVE_IT
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
                f"by {done.apart[place - 1]:.2g} deviations; the interval holds it",
                "something changed meanwhile (working point, temperature); identify the halves "
                "apart",
            )
    share = 100 * done.bend[:2] / np.abs(done.plant[:2])
    if share.max() > _BENT:
        yield Finding(
            Code.CURVED,
            WARNING,
            "the motion is large for the magnet: its curvature shows",
            f"at the tangent a differs by {share[0]:.2g} %, b by {share[1]:.2g} %; the intervals "
            "hold it",
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
            "something changed meanwhile; identify the halves apart",
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
        reasons.append(f"the reference knows of its residual before it ({done.answering:.1g})")
    if done.agree is not None and done.agree < LEVEL:
        reasons.append(f"with and without a noise model it is another plant ({done.agree:.1g})")
    return "; ".join(reasons)
