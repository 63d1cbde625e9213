"""The proofs along a moving speed and a moving pressure, as the judge asks for them."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import block_diag

from ambrose.annexes.scheduled.moving_model import (
    CLOSE,
    FROZEN,
    REST,
    PressureSpan,
    Tell,
    check_on_model,
    judged_rate,
    pressure_spans,
    scheduled_spans,
    seal_terms,
)
from ambrose.annexes.scheduled.moving_speed import SpeedSpan, check_speed, speed_spans
from ambrose.annexes.scheduled.varying_proof import Proof, VaryingLoop, proved_gain
from ambrose.core.checks import (
    AmbroseError,
    InvalidInput,
    NumericalFailure,
    check_positive,
    invalid,
)
from ambrose.core.norms import hinf_norm
from ambrose.core.statespace import StateSpace, balance_matrix as balance, is_stable, select
from ambrose.judge.checks import Checks, Progress, information
from ambrose.law.law import PRESSURE, SPEED, Law, LawLike, law_of
from ambrose.law.loop import Timing, running_law
from ambrose.machine.criteria import demand
from ambrose.machine.machine import Machine
from ambrose.model.assemble import assemble
from ambrose.model.plant import Plant
from ambrose.model.uncertainty import reduce
from ambrose.options import Verifying

# Verification while the seal pressure changes: stability and output sensitivity proved along every
# motion of it.
#
# All seals see the operating point's pressure. Where operating points of one speed have different
# pressures, the pressure may be anywhere between the lowest and the highest, and move: as fast as
# it likes, or up to a rate. Proved is the energy gain from d to y of core/lft.py's loop (sampled:
# from the samples of d to those of y), which is max sigma_max(S_o) where the pressure stands still.
# On the full plant, with the pressure moving within a sample, too, where K, k, C and c of every
# seal follow the pressure on a polynomial up to the third degree; on the model of
# scheduled/moving_model.py where that is not close to rest, or a seal is bent.


# bending modes per plane of the plant on which the frozen peaks are searched; assumed to be enough
# to find where they lie, as the ends and the worst pressure are computed again on the full plant
_MODES = 3

# Sizes of the search for multipliers, assumed: a proof holds with any, only its gamma and time
# change.
_FILTERS = 3  # first-order filters for a bounded rate
_SPREAD = 4.0  # highest over lowest of their poles, at least
_UNKNOWNS = 12  # rows of a multiplier, filters included
_TOGETHER = 8  # channels up to which the multipliers of all seals are one
_WITHOUT_PEAK = 100.0  # [rad/s] for the poles where no frozen loop has a peak beside zero frequency


def pressure_loop(
    plant: Plant, span: PressureSpan, law: LawLike, timing: Timing | None
) -> VaryingLoop:
    """The loop with the pressure pulled out: delta = -1 at the span's lowest, +1 at its highest
    pressure.

    plant: at the span's middle. law: continuous (sampled by ``timing``, where there is one) or as
    it runs. Raises InvalidInput for a seal with states or an added mass that change.
    """
    rows = [seal_terms(plant, seal, span) for seal in plant.machine.seals]
    names = [seal.name for seal in plant.machine.seals]
    forces = [f"f_{name}_{axis}" for name in names for axis in "xy"]
    motions = [f"{kind}_{name}_{axis}" for name in names for kind in ("q", "qdot") for axis in "xy"]

    y, u = plant.named("y"), plant.named("u")
    part = select(plant.system, [*forces, *u], [*motions, *y])

    # z = per_parameter (q, qdot) + shift w and f = into w; w in pairs (x, y), a pair per power of
    # the pressure and seal
    r = 2 * sum(len(terms) for terms in rows)
    f = len(forces)
    v = len(motions)
    into = np.zeros((f, r))
    per_parameter = np.zeros((r, v))
    shift = np.zeros((r, r))
    owner = []
    at = 0
    # Horner's scheme: w1 = delta (P1 v + w2), w2 = delta (P2 v + ...), the force is w1
    for k, terms in enumerate(rows):
        into[2 * k : 2 * k + 2, at : at + 2] = np.eye(2)
        for i, P in enumerate(terms):
            block = slice(at, at + 2)
            per_parameter[block, 4 * k : 4 * k + 4] = P
            if i + 1 < len(terms):
                shift[block, at + 2 : at + 4] = np.eye(2)
            owner += [k, k]
            at += 2

    # outputs (z, y) from (q, qdot, y), inputs (w, u) into (f, u); states scaled by t:
    # x = diag(t) x_s, A_s = T^-1 A T, B_s = T^-1 B, C_s = C T
    left, right = block_diag(per_parameter, np.eye(len(y))), block_diag(into, np.eye(len(u)))
    A, t = balance(part.A)
    B = part.B @ right / t[:, None]
    C = (left @ part.C) * t
    D = left @ part.D @ right
    D[:r, :r] += shift

    # Few channels: one parameter for all seals, as it is one pressure. Many: one per seal, which
    # proves more than is asked (seals with pressures of their own) by a smaller search.
    every = np.array(owner) if r > _TOGETHER else np.zeros(r, int)
    K = running_law(law, plant, timing)
    if K.dt is None:
        return _closed(StateSpace(A, B, C, D), K, every)
    return VaryingLoop(A, B, C, D, every, K)


def _closed(part: StateSpace, K: StateSpace, owner: np.ndarray) -> VaryingLoop:
    """A continuous controller around (w, u) -> (z, y): u = K(-(y + d)), outputs z and y + d."""
    r = len(owner)
    n = part.n_states
    k = K.n_states
    p = len(K.inputs)
    B_w = part.B[:, :r]
    B_u = part.B[:, r:]
    C_z = part.C[:r]
    C_y = part.C[r:]
    D_zw = part.D[:r, :r]
    D_zu = part.D[:r, r:]
    D_yw = part.D[r:, :r]
    if part.D[r:, r:].any():
        raise InvalidInput(
            "the currents reach the sensors at once; give the amplifier a bandwidth in the "
            "machine file"
        )

    # e = -(y + d) = -(C_y x + D_yw w + d),   u = C_K x_K + D_K e
    to_u = np.hstack([-K.D @ C_y, K.C, -K.D @ D_yw, -K.D])  # over x, x_K, w, d
    to_e = np.hstack([-C_y, np.zeros((p, k)), -D_yw, -np.eye(p)])

    # x' = A x + B_w w + B_u u,   x_K' = A_K x_K + B_K e;   columns x, x_K, w, d
    own = np.zeros((n + k, n + k + r + p))
    own[:n, :n] = part.A
    own[:n, n + k : n + k + r] = B_w
    own[n:, n : n + k] = K.A
    own[:n] += B_u @ to_u
    own[n:] += K.B @ to_e

    # z = C_z x + D_zw w + D_zu u,   y + d = -e
    out = np.vstack(
        [np.hstack([C_z, np.zeros((r, k)), D_zw, np.zeros((r, p))]) + D_zu @ to_u, -to_e]
    )

    A, t = balance(own[:, : n + k])
    return VaryingLoop(A, own[:, n + k :] / t[:, None], out[:, : n + k] * t, out[:, n + k :], owner)


@dataclass(frozen=True, slots=True)
class Frozen:
    """The loop at pressures that stand still: the worst gain, its pressure [Pa], and the
    frequencies [rad/s] of all peaks.
    """

    stable: bool
    gain: float
    pressure: float
    frequencies: tuple[float, ...]


def frozen_peaks(plant: Plant, span: PressureSpan, law: LawLike, timing: Timing | None) -> Frozen:
    """At FROZEN pressures on the plant reduced to three bending modes, at both ends and at the
    worst on the full one.
    """
    small = pressure_loop(reduce(plant, _MODES, static_correction=False), span, law, timing)
    full = pressure_loop(plant, span, law, timing)

    values = np.linspace(-1, 1, FROZEN)
    loops = [small.closed(np.full(small.parameters, delta)) for delta in values]
    if not all(is_stable(loop) for loop in loops):
        return Frozen(False, np.inf, np.nan, ())
    peaks = [hinf_norm(loop) for loop in loops]
    worst = float(values[int(np.argmax([peak.value for peak in peaks]))])

    # the full plant at both ends and where the reduced one is worst
    ends = [
        full.closed(np.full(full.parameters, delta)) for delta in dict.fromkeys((-1.0, 1.0, worst))
    ]
    if not all(is_stable(loop) for loop in ends):
        return Frozen(False, np.inf, np.nan, ())

    gain = max(hinf_norm(loop).value for loop in ends)
    at = (span.low + span.high) / 2 + worst * span.half
    return Frozen(True, gain, at, tuple(abs(float(peak.frequency)) for peak in peaks))


def filter_poles(frozen: Frozen, channels: int) -> tuple[float, ...]:
    """Poles [rad/s] of the filters for a bounded rate, where the frozen loops have their peaks;
    fewer for many channels.

    Geometrically between half the lowest and half the highest frequency of the peaks; a single one
    at their geometric mean.
    """
    peaks = [omega for omega in frozen.frequencies if np.isfinite(omega) and omega > 0]
    peaks = peaks or [_WITHOUT_PEAK]
    low = min(peaks) / 2

    # a multiplier has channels (1 + filters) rows
    count = min(_FILTERS, max(1, _UNKNOWNS // max(1, channels) - 1))
    if count == 1:
        return (-float(np.sqrt(low * max(peaks) / 2)),)
    return tuple(-np.geomspace(low, max(max(peaks) / 2, _SPREAD * low), count))


def check_pressure(
    machine: Machine,
    span: PressureSpan,
    law: LawLike,
    timing: Timing | None,
    rate: float,
    tell: Tell = lambda text: None,
) -> Checks:
    """Stability and output sensitivity while the pressure moves within the span, at any speed and
    at up to ``rate`` [Pa/s].

    law: a controller as for ``law.loop.match_controller``. The proof for the rate is judged by the
    machine's requirement; one that cannot be had has the value inf and says why. Raises
    InvalidInput.
    """
    check_positive(rate, "the rate of the pressure", "give the fastest change in Pa/s")
    wanted = demand("maximum singular value of a sensitivity", machine.requirements)
    plant = assemble(machine, span.middle)
    try:
        loop = pressure_loop(plant, span, law, timing)
        frozen = frozen_peaks(plant, span, law, timing)
    except InvalidInput:  # a seal that is bent too much
        return check_on_model(machine, span, law, timing, rate, tell=tell)
    except AmbroseError as error:
        return Checks(
            span.label, True, (judged_rate(wanted, rate, np.inf, f"not proved: {error}"),)
        )
    where = (
        f"the worst of {FROZEN} pressures, at {frozen.pressure / 1e5:.4g} bar"
        if frozen.stable
        else "unstable"
    )
    title = "Largest output sensitivity at constant pressure, found by search"
    checks = [information("moving.frozen", title, frozen.gain, "-", where)]
    if not frozen.stable:
        lost = judged_rate(wanted, rate, np.inf, "unstable at constant pressure")
        return Checks(span.label, False, (*checks, lost))
    tell(f"proving the loop {span.label}, at any speed")
    value, detail = _proof(loop, (), np.inf, tell)
    title = "Output sensitivity proved for any motion of the pressure, however fast"
    checks.append(information("moving.sensitivity.any", title, value, "-", detail))
    tell(f"proving the loop {span.label}, at up to {rate / 1e5:.4g} bar/s")

    # delta = (p - middle)/half, so that |d delta/dt| <= rate/half
    bounded, words = _proof(
        loop, filter_poles(frozen, int(np.bincount(loop.owner).max())), rate / span.half, tell
    )
    if value < bounded:  # what holds for any speed holds for this one
        bounded, words = value, detail
    if bounded > (1 + CLOSE) * frozen.gain:
        other = check_on_model(machine, span, law, timing, rate, tell=tell).checks[-1]
        if other.value < bounded:
            proved = f"proved {bounded:.4g}" if np.isfinite(bounded) else words
            bounded, words = other.value, f"{other.detail}; on the full plant {proved}"
    checks.append(
        judged_rate(
            wanted,
            rate,
            bounded,
            f"{words}; {bounded / frozen.gain - 1:.1%} above what was found at rest",
        )
    )
    return Checks(span.label, True, tuple(checks), notes=(REST,))


def _proof(
    loop: VaryingLoop, poles: tuple[float, ...], rate: float, tell: Tell
) -> tuple[float, str]:
    """The gain proved (inf where none is) and how, in words. poles [rad/s] of the filters, rate
    [1/s] of delta in [-1, 1].
    """
    try:
        proof: Proof = proved_gain(loop, poles, [rate] * loop.parameters, tell=tell)
    except NumericalFailure as error:
        return np.inf, f"not proved: {error}"
    size = f"full plant, {len(loop.A)} states" + (
        f" and {loop.controller.n_states} of the sampled law" if loop.controller else ""
    )
    return (
        proof.gamma,
        f"{size}; the inequality holds by {proof.slack:.0e}, rounding {proof.rounding:.0e}",
    )


def covered_spans(machine: Machine, law: LawLike) -> tuple[PressureSpan, ...]:
    """The spans at whose ends a law is meant to run; a schedule over speed is made for one pressure
    and covers none.
    """
    ends = (
        (span, (replace(span.point, seal_pressure=p) for p in (span.low, span.high)))
        for span in pressure_spans(machine)
    )
    return tuple(
        span
        for span, points in ends
        if all(law_of(law).covers(assemble(machine, point)) for point in points)
    )


def refuse(machine: Machine, law: Law, motion: Verifying) -> None:
    """Raises InvalidInput where a law cannot be examined along the motion that is asked for."""
    if motion.speed_rate is not None:
        machine.across_the_shaft("nothing along it follows the speed", "leave the speed's rate out")
    if motion.pressure_rate is not None:
        remedy = "leave the pressure's rate out; the process thrust changes within load_time"
        machine.across_the_shaft("nothing along it follows the seals' pressure", remedy)
    _over_pressure(law, motion.pressure_error)
    if motion.speed_rate is not None:
        _speed_spans(machine, law)


def prove(
    machine: Machine,
    law: Law,
    points: Sequence[Checks],
    timing: Timing | None,
    motion: Verifying,
    progress: Progress,
) -> tuple[Checks, ...]:
    """The checks while the seal pressure changes, then those while the speed does.

    Without a rate, or with an unstable operating point, there are none. Raises InvalidInput as
    ``refuse`` does.
    """
    if not all(checks.stable for checks in points):
        return ()
    checks = _along_pressure(machine, law, timing, motion, progress)
    if motion.speed_rate is None:
        return checks
    runs = (
        check_speed(machine, span, law, timing, motion.speed_rate, motion.tolerances, progress)
        for span in _speed_spans(machine, law)
    )
    return (*checks, *runs)


def unproved(machine: Machine, motion: Verifying) -> str | None:
    """Why nothing is proved for a pressure that changes between the operating points of a machine,
    as a sentence; None where no operating points differ in pressure.
    """
    if not pressure_spans(machine):
        return None
    known = motion.pressure_rate is not None or machine.operation.pressure_rate is not None
    remedy = (
        "It needs a loop that is stable at every point, with a controller that is fixed or "
        "scheduled over pressure."
        if known
        else "Use --pressure-rate, or set pressure_rate."
    )
    return f"Not checked: changing seal pressure. {remedy}"


def _along_pressure(
    machine: Machine, law: Law, timing: Timing | None, motion: Verifying, progress: Progress
) -> tuple[Checks, ...]:
    """The checks while the pressure changes at up to the rate given or that of the machine file.

    There are none for a schedule over speed, or over speed and pressure, and none for a program or
    a function that follows the pressure.
    """
    rate = motion.pressure_rate
    if rate is None:
        rate = machine.operation.pressure_rate
    if rate is None:
        return ()
    schedule = law.schedule
    if schedule is None and law.follows(PRESSURE):
        return ()  # a function or a program: at the pressure of a span's middle it is another law
    if schedule is None:
        return tuple(
            check_pressure(machine, span, law, timing, rate, progress)
            for span in covered_spans(machine, law)
        )
    error = motion.pressure_error
    spans = scheduled_spans(machine, schedule) if _over_pressure(law, error) else ()
    return tuple(
        check_on_model(machine, span, law, timing, rate, error, progress) for span in spans
    )


def _speed_spans(machine: Machine, law: Law) -> tuple[SpeedSpan, ...]:
    """Where a fixed law or a schedule over speed is proved while the speed changes.

    Raises InvalidInput where it cannot be.
    """
    if law.fixed is None and law.scheduled_over is not SPEED:
        raise InvalidInput(
            "a controller scheduled over pressure is not proved while the speed changes; leave "
            "the speed's rate out"
        )
    if law.fixed is None and law.schedule is None:
        raise InvalidInput(
            "a function of the speed is not proved while the speed changes; make it a schedule "
            "(ScheduledSystem), or leave the speed's rate out"
        )
    spans = speed_spans(machine, law)
    if not spans:
        raise InvalidInput(
            "no two operating points differ in speed alone; add one in the machine file, or leave "
            "the speed's rate out"
        )
    return spans


def _over_pressure(law: Law, error: float) -> bool:
    """Whether a law is scheduled over pressure alone.

    Raises InvalidInput for an error [Pa] where it is not.
    """
    over_pressure = law.schedule is not None and law.scheduled_over is PRESSURE
    if error and not over_pressure:
        why = "alone is proved with it" if law.follows(PRESSURE) else "is told of it"
        raise invalid(
            "the error of the pressure",
            f"{error:g} Pa",
            "0",
            f"only a controller scheduled over pressure {why}",
        )
    return over_pressure
