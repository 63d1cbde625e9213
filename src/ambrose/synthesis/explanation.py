"""Why a controller does not hold a machine, or none was found: cause and remedy in one sentence."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from ambrose.core.aliasing import continuous_poles
from ambrose.core.checks import AmbroseError
from ambrose.core.frequency import frequency_response
from ambrose.core.scheduled import ScheduledSystem
from ambrose.core.statespace import StateSpace, select
from ambrose.judge.checks import Check
from ambrose.judge.envelope import envelope_of
from ambrose.judge.result import Synthesis
from ambrose.judge.stability import judge_assumed
from ambrose.judge.static_stiffness import below_stiffness, stiffness_margin
from ambrose.judge.unavoidable import beyond_reach, unavoidable_sensitivity
from ambrose.judge.verdict import verify_points
from ambrose.law.law import law_of
from ambrose.law.loop import closed_loop
from ambrose.law.timing import DEFAULT, Timing
from ambrose.machine.axial import in_file
from ambrose.machine.criteria import SENSITIVITY, demand
from ambrose.model.assemble import assemble
from ambrose.model.basis import bending_modes_of, judged_bending
from ambrose.model.effects.rotor import free_modes
from ambrose.model.plant import Plant
from ambrose.model.reduce import reduce_from

_ORDINALS = ("first", "second", "third", "fourth", "fifth", "sixth")
_PEAK = "maximum singular value of a sensitivity"
_TRIED = 6  # bending modes
_TWO_PI = 2 * np.pi  # rad/s per Hz


def explained(
    plant: Plant,
    result: Synthesis,
    timing: Timing | None,
    bending_modes: int,
    *,
    envelope: bool | None = None,
) -> Synthesis:
    """The synthesis; a note says why where it does not hold an operating point, and where its S_o
    is above the file's limit or only a continuous controller would. Of a tuned one that holds them
    all: which checks of ``verify`` fail at the points, however tuning went. envelope: whether the
    method designed for all points (None: it has no such choice).
    """
    result = replace(
        result,
        notes=(
            *result.notes,
            *_above_limit(plant, result),
            *_not_modelled(plant, result, timing, bending_modes),
        ),
    )
    result = _with_assumed(plant, result, timing)
    lost = result.lost
    if result.status != "unstable" and not lost:
        missed = result.method == "tuned" and result.gamma > 1
        why = why_none(plant, timing) if missed else ""
        result = replace(result, notes=(*result.notes, why)) if why else result
        return _with_unmet(plant, result, timing) if result.method == "tuned" else result
    point = next((p for p in plant.machine.operation.envelope if p.label in lost), plant.point)
    place = (
        plant
        if result.status == "unstable" or plant.point.label in lost
        else assemble(plant.machine, point)
    )
    try:
        reason = why_unstable(place, result.law, timing, bending_modes, result.method)
    except AmbroseError:
        return result  # what cannot be computed explains nothing
    where = "" if place is plant else f"at {place.point.label}: "
    if where and envelope is False:
        reason += (
            f"; it was designed for {plant.point.label} alone: --envelope designs for all, which "
            "takes minutes with several bending modes"
        )
    return replace(result, notes=(*result.notes, f"{where}{reason}"))


def _above_limit(plant: Plant, result: Synthesis) -> list[str]:
    """Stable is not good enough: what the certificate's peak says against the machine's own limit.
    Tuning tells it itself.
    """
    margins, limit = result.certificate.margins, demand(_PEAK, plant.machine.requirements).limit
    names = ("sampled_sensitivity_peak", "full_sensitivity_peak", "sensitivity_peak")
    peak = next((margins[name] for name in names if name in margins), 0.0)
    if result.method == "tuned" or limit is None or not limit < peak < np.inf:
        return []
    return [
        f"sigma_max(S_o) of {peak:.3g} is above the machine's limit of {limit:g}; verify tells "
        "all that is missed"
    ]


def _not_modelled(
    plant: Plant, result: Synthesis, timing: Timing | None, bending_modes: int
) -> list[str]:
    """The bending modes at which the sensitivity is judged and that the design model leaves out; at
    which of them it is largest, where that is above all else or above the limit.
    """
    judged = judged_bending(plant.machine)
    if result.method == "pid" or result.status == "unstable" or len(judged) <= bending_modes:
        return []
    hertz = ", ".join(f"{w / _TWO_PI:.4g}" for w in judged[bending_modes:])
    which = f"{bending_modes + 1}" + (
        f" to {len(judged)}" if len(judged) > bending_modes + 1 else ""
    )
    note = f"not in the design model though judged: bending mode {which} ({hertz} Hz)"

    # sigma_max(S_o) of the full plant around each of them
    runs = law_of(result.law).at(plant.point)
    loop = closed_loop(plant, runs if timing is None else timing.in_loop(runs))
    S = select(loop, [f"d_{a}" for a in plant.axes], [f"y_{a}" for a in plant.axes])
    near = judged[bending_modes:, None] * np.linspace(0.98, 1.02, 21)
    peaks = frequency_response(S, near.ravel()).max_singular_value().reshape(near.shape).max(axis=1)
    worst = int(peaks.argmax())
    limit = demand(_PEAK, plant.machine.requirements).limit or SENSITIVITY.limits[0].value
    if peaks[worst] > limit:
        note += f"; sigma_max(S_o) is {peaks[worst]:.3g} at mode {bending_modes + 1 + worst}"
    return [f"{note}; --bending-modes {len(judged)} takes them in"]


def _with_unmet(plant: Plant, result: Synthesis, timing: Timing | None) -> Synthesis:
    """The synthesis with a note of every check that ``verify`` fails at the operating points, each
    where it is worst, and the margin "unmet_checks"; unchanged where all pass.

    What verification judges has no other name for what tuning minimises: an amplification factor is
    read off a response, tuning asks poles for damping.
    """
    worst: dict[str, tuple[float, str, Check]] = {}
    for checks in verify_points(envelope_of(plant), result.law, timing=timing):
        for check in checks.failed:
            ratio = check.ratio or math.inf
            if ratio > worst.get(check.name, (0.0,))[0]:
                worst[check.name] = ratio, checks.label, check
    if not worst:
        return result
    margins = {**result.certificate.margins, "unmet_checks": float(len(worst))}
    return replace(
        result,
        certificate=replace(result.certificate, margins=margins),
        notes=(
            *result.notes,
            *(f"verify fails {_in_words(label, item)}" for _, label, item in worst.values()),
        ),
    )


def _in_words(label: str, check: Check) -> str:
    """A failed check in a clause: what, where, value against limit, the first cause."""
    unit = "" if check.unit == "-" else f" {check.unit}"
    limit = "" if check.limit is None else f", not {check.relation} {check.limit:.4g}{unit}"
    cause = check.detail.partition(";")[0]
    title = check.title if check.title[:2].isupper() else check.title[:1].lower() + check.title[1:]
    return f"{title} at {label}: {check.value:.4g}{unit}{limit}{f' ({cause})' if cause else ''}"


def _with_assumed(plant: Plant, result: Synthesis, timing: Timing | None) -> Synthesis:
    """Where nobody stated a rate the loop was judged continuous. One that would not run at the rate
    that the rig assumes gets a note with the pole, and the margin "assumed_abscissa"; as
    ``verify``'s check "timing.assumed", which asks the judge the same.
    """
    if result.status == "unstable":
        return result
    places = [
        place
        for place in envelope_of(plant)
        # one that the continuous loop loses has its own words
        if law_of(result.law).covers(place) and place.point.label not in result.lost
    ]
    found = [(place, judge_assumed(place, result.law, timing)) for place in places]
    lost = [
        (judged.abscissa, place)
        for place, judged in found
        if judged is not None and not judged.stable
    ]
    if not lost:
        return result
    abscissa, place = max(lost, key=lambda item: item[0])
    own = [value for value, where in lost if where.point.label == plant.point.label]
    where = f" at {', '.join(item.point.label for _, item in lost)}" if len(found) > 1 else ""
    late = f"{DEFAULT.rate:g} Hz and one sample late, as virtual rig and export assume,"
    pole = f"{abscissa:+.4g} rad/s{_at_frequency(place, result)}"
    note = (
        f"judged as continuous; at {late} it would be unstable{where} ({pole}); state the rate, "
        "--rate-hz or sample_time"
    )
    margins = {**result.certificate.margins, "assumed_abscissa": abscissa}
    if own:
        margins["assumed_abscissa_of_design"] = own[0]
    return replace(
        result,
        certificate=replace(result.certificate, margins=margins),
        notes=(*result.notes, note),
    )


def _at_frequency(plant: Plant, result: Synthesis) -> str:
    """ " at so many Hz", of the rightmost pole at the assumed rate; "" where none can be named."""
    modes = min(_TRIED, bending_modes_of(plant.rotor_model))
    law = law_of(result.law).at(plant.point)
    try:
        return f" at {_rightmost(reduce_from(plant, modes), DEFAULT.in_loop(law))[1]:.4g} Hz"
    except AmbroseError:
        return ""


def why_none(plant: Plant, timing: Timing | None) -> str:
    """Why a design may have found nothing; "" where no reason shows."""
    limit = demand(_PEAK, plant.machine.requirements).limit or SENSITIVITY.limits[0].value
    try:
        return beyond_reach(*unavoidable_sensitivity(plant, timing), limit)
    except AmbroseError:
        return ""


def why_unstable(
    plant: Plant,
    law: StateSpace | ScheduledSystem,
    timing: Timing | None,
    bending_modes: int,
    method: str,
) -> str:
    """Why a law does not hold a full plant: a bending mode, a gain below k_s/k_i, or what the poles
    tell.
    """
    runs = law_of(law).at(plant.point)
    runs = runs if timing is None else timing.in_loop(runs)
    margin = stiffness_margin(plant.machine) if method == "pid" else None
    if margin is not None and margin < 1:
        return in_file(plant.machine, below_stiffness(margin))
    available = bending_modes_of(plant.rotor_model)
    modes = free_modes(plant.rotor_model, min(_TRIED, available)).frequencies[4::2] / _TWO_PI
    for count in range(min(_TRIED, available) + 1):
        small = reduce_from(plant, count)
        abscissa, frequency = _rightmost(small, runs)
        if abscissa < 0:
            continue
        kept = small.bending_modes or 0
        if kept == 0 or count == 0:
            break
        what = f"the {_ORDINALS[kept - 1]} bending mode ({modes[kept - 1]:.4g} Hz)"
        if method == "pid":
            own = plant.machine.reference
            notch = (
                "a section of kind notch to its [[controller.channel]]"
                if own is not None and own.channels
                else "a [[controller.notch]]"
            )
            remedy = in_file(plant.machine, f"the [controller]; add {notch} there")
            return f"{what} is driven unstable by {remedy}, or use method tuned"
        if kept > bending_modes:
            return (
                f"{what} is not in the design model; design with --bending-modes {kept}, or use "
                "method tuned"
            )
        return (
            f"{what} is driven unstable although it is in the design model; lower "
            "weights.bandwidth, or use method tuned"
        )
    abscissa, frequency = _rightmost(plant, runs)
    where = f"{frequency:.4g} Hz" if frequency > 0 else "standstill of whirl"
    if why := why_none(plant, timing):
        return why
    loop = "" if timing is None else " as it runs, sampled and late,"
    remedy = (
        "tune its gains and times, or sample faster"
        if method == "tuned"
        else "use method tuned, or sample faster"
    )
    return f"the loop{loop} has a pole at {abscissa:+.4g} rad/s ({where}); {remedy}"


def _rightmost(plant: Plant, law: StateSpace) -> tuple[float, float]:
    """Real part [rad/s] and frequency [Hz] of the rightmost pole of the loop."""
    loop = closed_loop(plant, law)
    values = continuous_poles(loop.A, loop.dt, plant.system.A)[0]
    worst = values[np.argmax(values.real)]
    return float(worst.real), float(abs(worst.imag) / _TWO_PI)
