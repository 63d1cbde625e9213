"""A controller by a method: designed on the reduced plant, then certified on the full one."""

import math
from collections.abc import Callable, Collection, Sequence
from contextlib import suppress
from dataclasses import asdict, replace
from math import pi
from typing import Any

import numpy as np

from ambrose.core.aliasing import continuous_poles
from ambrose.core.checks import (
    AmbroseError,
    InvalidInput,
    NumericalFailure,
    check_positive,
    invalid,
    names_wrong_types,
)
from ambrose.core.frequency import frequency_response
from ambrose.core.presentation import to_plain
from ambrose.core.sampling import c2d
from ambrose.core.scheduled import ScheduledSystem
from ambrose.core.statespace import StateSpace, select
from ambrose.judge.campbell import held_to, modes
from ambrose.judge.checks import Check
from ambrose.judge.loop_response import beyond_reach, unavoidable_sensitivity
from ambrose.judge.nominal import below_stiffness, stiffness_margin
from ambrose.judge.plants import envelope_of, judge_assumed
from ambrose.judge.result import Provenance, Status, Synthesis, certify_as_it_runs, certify_envelope
from ambrose.judge.verdict import verify_points
from ambrose.law.law import law_of
from ambrose.law.loop import DEFAULT, Timing, check_rate, closed_loop, timing_of
from ambrose.machine.criteria import SENSITIVITY, demand
from ambrose.machine.file.toml import machine_hash
from ambrose.machine.machine import Machine, require_magnets
from ambrose.model.assemble import (
    assemble,
    badly_placed,
    bending_modes_of,
    driven_modes,
    judged_bending,
)
from ambrose.model.effects import amplifier
from ambrose.model.effects.rotor import free_modes
from ambrose.model.plant import Plant, top_speed
from ambrose.model.uncertainty import reduce_from
from ambrose.options import choose, settings
from ambrose.registry import registered
from ambrose.synthesis.fixed_order.channels import lateness
from ambrose.synthesis.methods import Method, methods
from ambrose.synthesis.order_selection import reduce_order

# Why a controller does not hold a machine, or none was found: cause and remedy in one sentence.


_ORDINALS = ("first", "second", "third", "fourth", "fifth", "sixth")
_PEAK = "maximum singular value of a sensitivity"
_TRIED = 6  # bending modes
_SHOWN = 3  # of those that bar a design
_TWO_PI = 2 * np.pi  # rad/s per Hz
_LIGHT = 0.05  # damping ratio of a pole that is told of where a requirement is missed
_AROUND = 1.3  # times the top speed: critical speeds near it
_COSTLY = np.radians(70)  # of lag at a mode: what leads by more lets noise and other modes through
_NEAR = 0.06  # of a bending frequency at rest: gyroscopic moments part a mode's two


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
    note = f"not in the design model, but checked: bending mode {which} ({hertz} Hz)"

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
    margins = dict(result.certificate.margins)
    margins["unmet_checks"] = margins.get("unmet_checks", 0.0) + len(worst)  # measured ones before
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
        f"checked as continuous; at {late} it would be unstable{where} ({pole}); state the rate, "
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
        return plant.machine.in_file(below_stiffness(margin))
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
            remedy = plant.machine.in_file(f"the [controller]; add {notch} there")
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


# A controller of another program on the machine that it is for: do its axes, sign and units hold
# the loop?


_UNITS = {
    1.0: "",
    1e3: "in mm (--input-unit mm)",
    1e6: "in um (--input-unit um)",
    1e-3: "with a gain 1e3 times smaller",
    1e-6: "with a gain 1e6 times smaller",
}
_FALLEN = 0.2  # of the largest real part, to which another unit must lower it to be worth a word
_SIGNS = {
    1.0: "",
    -1.0: "of the other sign (exchange input error and displacement: --input, or in its file)",
}


def resampled(
    law: Synthesis, rate: float | None, method: Any, prewarp_hz: float | None
) -> Synthesis:
    """A continuous controller sampled at a rate [Hz]. Raises InvalidInput."""
    if rate is None:
        raise InvalidInput(
            "--sampling needs the rate at which the controller will run; give it with --rate-hz"
        )
    if law.scheduled is not None:
        raise InvalidInput(
            "a scheduled controller is sampled as it is exported; leave --sampling out"
        )
    dt = 1 / check_positive(rate, "the sample rate", "give it in Hz")
    prewarp = None if prewarp_hz is None else 2 * pi * prewarp_hz
    check_rate(law.controller, dt)
    if law.controller.dt is not None:
        raise InvalidInput(
            f"it is sampled already, at {1 / law.controller.dt:g} Hz; leave --sampling out"
        )
    note = f"sampled at {rate:g} Hz by {method}" + (
        "" if prewarp_hz is None else f", exact at {prewarp_hz:g} Hz"
    )
    sampled = c2d(law.controller, dt, method, prewarp=prewarp)
    settings = {
        key: value
        for key, value in (law.provenance.settings or {}).items()
        if key == "delay_samples"
    }
    made = replace(law.provenance, settings=settings or None, digest=None)
    return Synthesis(sampled, law.method, notes=(*law.notes, note), provenance=made)


def not_held(
    machine: Machine,
    law: Synthesis,
    progress: Callable[[str], None] = lambda stage: None,
    other_feedback: Callable[[], Synthesis] | None = None,
) -> list[str]:
    """Where the loop, as it runs on the full plant, is unstable; with the sign and the unit that
    would hold it, in a sentence.

    other_feedback: the controller with a1 and a2 of the other sign. Empty: it is stable at every
    operating point. Raises InvalidInput.
    """
    progress("closing the loop at every operating point")
    plants = [assemble(machine, point) for point in machine.operation.envelope]
    lost = _lost(plants, law, machine)
    if not lost:
        return []
    progress("trying other signs and units")
    others = [(sign, unit) for unit in _UNITS for sign in _SIGNS if (sign, unit) != (1.0, 1.0)]
    points = ", ".join(f"{label} ({abscissa:+.4g} rad/s)" for label, abscissa in lost.items())
    if other_feedback is not None and len(_lost(plants, other_feedback(), machine)) < len(lost):
        return [
            f"the loop is unstable at {points}, and not with a1 and a2 of the other sign, as "
            "CMSIS-DSP and SigmaDSP write them: --feedback added, or turn their signs in the file"
        ]
    counts = {pair: _lost(plants, _scaled(law, pair[0] * pair[1]), machine) for pair in others}
    best = min(others, key=lambda pair: (len(counts[pair]), max(counts[pair].values(), default=0)))
    before, after = (max(of.values(), default=0.0) for of in (lost, counts[best]))
    check = (
        "check the order of the axes, the rate and the delay"
        if len(lost) == len(plants)
        else "it holds the others"
    )
    words = " and ".join(filter(None, (_SIGNS[best[0]], _UNITS[best[1]])))
    if len(counts[best]) >= len(lost):
        if len(counts[best]) == len(lost) and after < _FALLEN * before:
            return [
                f"the loop is unstable at {points}; were the controller {words}, still, but with "
                f"{after:+.4g} rad/s at most: if that is its unit, {check}"
            ]
        return [
            f"the loop is unstable at {points}, and no other sign or unit of length (m, mm, um) "
            f"does better; {check}"
        ]
    where = "everywhere" if not counts[best] else f"but for {', '.join(counts[best])}"
    return [
        f"the loop is unstable at {points}; were the controller {words}, it would be stable "
        f"{where}: u = K (r - y) in A and m"
    ]


def _lost(plants: Sequence[Plant], law: Synthesis, machine: Machine) -> dict[str, float]:
    """Spectral abscissa [rad/s] at the operating points where the loop is unstable."""
    envelope = certify_envelope(plants, law, timing_of(machine, law)).certificate.envelope
    return {label: abscissa for label, abscissa in envelope.items() if not abscissa < 0}


def _scaled(law: Synthesis, factor: float) -> Synthesis:
    K = law.controller
    return replace(
        law, controller=StateSpace(K.A, K.B * factor, K.C, K.D * factor, K.inputs, K.outputs, K.dt)
    )


Progress = Callable[[str], None]


def methods_for(plant: Plant) -> tuple[str, ...]:
    """What the machine file allows: "tuned" always, "pid" with [controller], "hinf" with [weights],
    mu with [[tolerance]], too.

    The methods of the annexes, such as "lpv", are asked for by name: that is one controller for all
    speeds or pressures instead of one for the plant's.
    """
    named = registered("method")
    return tuple(
        name for name, kind in methods().items() if name not in named and kind.suits(plant)
    )


@names_wrong_types
def design(
    plant: Plant,
    method: Method | str = "tuned",
    *,
    progress: Progress = lambda text: None,
    **options: Any,
) -> Synthesis:
    """One controller for a full plant.

    method: one of the methods with its options, or the name of one, its options then by name:
    ``Tuned`` (to the requirements themselves, at all operating points of the plant's machine and
    with the worst members of the tolerances around each; the others know the plant's point alone),
    ``Pid`` (the machine's reference controller), ``Hinf`` (H-infinity for the nominal plant),
    ``Mu`` (D-K iteration over the machine's tolerances), ``Polish`` (the mu controller at half its
    order, refined for the worst case), ``Lpv`` (scheduled over speed, pressure or both).

    Where a rate is known (the method's, else the machine file's) the delay of the sampled loop is
    in the design model (not in that of "pid"). The certificate's margins gain
    "full_spectral_abscissa" and "full_sensitivity_peak", recomputed on ``plant``, with a rate also
    "sampled_spectral_abscissa" and "sampled_sensitivity_peak" of the loop as it runs; a controller
    that does not hold one of the two has the status "unstable". The certificate's ``envelope``
    tells the stability at every operating point of the machine, and ``Synthesis.verdict`` where
    "verified" holds. Raises InvalidInput for an unknown method, an option that it does not have, or
    a machine file that lacks what it needs.
    """
    chosen = choose(methods(), "method", method, options)
    if not isinstance(plant, Plant):
        raise invalid(
            "plant", type(plant).__name__, "a Plant", "assemble(machine, point) gives one"
        )
    require_magnets(plant.machine)
    timing = chosen.timing(plant.machine)
    chosen = chosen.on(plant.machine)
    try:
        result = chosen.design(plant, progress)
    except NumericalFailure as error:
        if why := why_none(plant, timing):
            raise NumericalFailure(f"{error}; {why}") from error
        if bar := _barred(plant.machine):
            first = str(error).partition(";")[0]
            raise NumericalFailure(f"{first}; {bar}") from error
        raise
    modes = getattr(chosen, "bending_modes", None) or 0
    modes = int(result.certificate.margins.get("bending_modes", modes))
    if (loss := getattr(chosen, "loss", None)) is not None and timing is not None:
        progress("lowering the order")
        result = reduce_order(plant, result, loss, timing, modes, progress)
    result = certify_as_it_runs(plant, result, timing)
    result = certify_envelope(envelope_of(plant), result, timing)
    envelope = getattr(chosen, "envelope", None)
    result = explained(plant, result, timing, modes, envelope=envelope)
    missed = result.gamma > 1 or "unmet_checks" in result.certificate.margins
    if result.method == "tuned" and missed:
        poor = _poor(plant, result, timing)
        bar = _barred(plant.machine, poor) or _late(plant, timing, poor)
        result = replace(result, notes=(*result.notes, *filter(None, [bar])))
    return replace(result, provenance=provenance(plant, chosen))


def _barred(machine: Machine, poor: Collection[float] | None = None) -> str:
    """The bending modes that bar a design, the places that make them do so, and what to move; poor
    [rad/s]: of a loop, where it is poor (None: there is no loop).
    """
    if not machine.bearings:
        return ""
    places = {bearing.name: bearing.position for bearing in machine.bearings}
    placed, lead = badly_placed(machine), "what bars it is"
    if poor is not None:
        near = {
            mode: any(abs(w - at) < _NEAR * at for w in poor) for mode, (at, *_) in placed.items()
        }
        placed = {mode: row for mode, row in placed.items() if near[mode]}
    elif driven := driven_modes(machine):
        placed = {k: (w, "", {name: places[name]}) for k, (w, name) in driven.items()}
        lead = "what damps the others drives"
    if not placed:
        return ""
    words, moves = [], dict[str, None]()
    for mode, (frequency, kind, moved) in placed.items():
        names, several = " and ".join(moved), len(moved) > 1
        what = f"near whose node {kind}{'s' * several} {names} stand{'s' * (not several)}"
        if not kind:
            what = f"in which magnet and sensor {names} move oppositely"
        if kind == "loud sensor":
            what = f"which sensor{'s' * several} {names} read{'s' * (not several)} far larger than "
            what += "it is at the magnet"
        words.append(f"bending mode {mode} ({frequency / _TWO_PI:.3g} Hz), {what}")
        part = "magnet" if kind == "magnet" else "sensor"
        along = (" and its sensor", "") if kind == "magnet" else ("", ", to the magnet")
        moves |= dict.fromkeys(
            f"{part} {name}{along[0]} towards {1e3 * at:.4g} mm{along[1]}"
            for name, at in moved.items()
        )
    both = ", or read on both its sides" * any(move.startswith("sensor") for move in moves)
    return f"{lead} {'; '.join(words[:_SHOWN])}; move {', '.join(moves)}{both}"


def _late(plant: Plant, timing: Timing | None, poor: Collection[float]) -> str:
    """The bending modes at which a loop is poor and so late that no rate of the displacement damps
    them; "" for none.
    """
    judged = judged_bending(plant.machine)
    near = [k for k, at in enumerate(judged) if any(abs(w - at) < _NEAR * at for w in poor)]
    lag = np.zeros(len(judged))
    if near:
        path = frequency_response(
            amplifier.linearised(plant.machine.amplifier, ["a"]), np.asarray(judged)
        )
        lag = -np.unwrap(np.r_[0.0, np.angle(path.values[:, 0, 0])])[1:]
        lag -= np.unwrap(np.angle(lateness(judged, timing))) if timing is not None else 0.0
    late = [k for k in near if lag[k] > _COSTLY]
    if not late:
        return ""
    words = [
        f"bending mode {k + 1} ({judged[k] / _TWO_PI:.3g} Hz), where they cost "
        f"{np.degrees(lag[k]):.0f} degrees"
        for k in late[:_SHOWN]
    ]
    return f"sampling, delay and amplifier come too late for {'; '.join(words)}: sample faster"


def _poor(plant: Plant, result: Synthesis, timing: Timing | None) -> list[float]:
    """The bending modes [rad/s] around which sigma_max(S_o) is above its limit, at all points, and
    the light poles of those that `verify` holds, or that stand near the speed.
    """
    limit = demand(_PEAK, plant.machine.requirements).limit or SENSITIVITY.limits[0].value
    top, judged = top_speed(plant.machine), judged_bending(plant.machine)
    found: list[float] = []
    for place in envelope_of(plant):
        runs = law_of(result.law).at(place.point)
        loop = closed_loop(place, runs if timing is None else timing.in_loop(runs))
        own = modes(loop, place.ports, place.system)
        held = max(held_to(own, top)[0], _AROUND * top)
        found += own.frequency[(own.damping < _LIGHT) & (own.frequency <= held)].tolist()
        S = select(loop, [f"d_{a}" for a in place.axes], [f"y_{a}" for a in place.axes])
        near = judged[:, None] * np.linspace(1 - _NEAR, 1 + _NEAR, 41)
        peaks = frequency_response(S, near.ravel()).max_singular_value().reshape(near.shape)
        found += judged[peaks.max(axis=1) > limit].tolist()
    return found


def another_point(plant: Plant, method: Method) -> str:
    """Which operating point's design holds all points of the machine, or that none does.

    For a method of one point, whose controller leaves a light mode where that point has it.
    """
    machine = plant.machine
    for point in machine.operation.envelope:
        if point == plant.point:
            continue
        with suppress(NumericalFailure):
            made = design(assemble(machine, point), method)
            if made.status is Status.VERIFIED and not made.lost:
                return (
                    f'designed for "{point.label}" it is stable at all points: --point '
                    f'"{point.label}"'
                )
    return (
        "no point's design by this method is stable at all points: their light modes are not at "
        "one frequency; "
        "method tuned designs for all points"
    )


def provenance(plant: Plant, method: Method) -> Provenance:
    """Machine and settings of a design: its key decides which controller comes out.

    The settings name every option of every method, those that this one does not have at their
    defaults, so that files of before compare with it.
    """
    machine = plant.machine
    content = {
        "method": method.name,
        **settings(methods(), method.on(machine)),
        **method.evidence(),
        "point": asdict(plant.point),
        "plant_states": plant.system.n_states,
    }
    return Provenance(
        machine=machine.name, machine_hash=machine_hash(machine), settings=to_plain(content)
    )
