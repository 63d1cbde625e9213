"""Verification while the seal pressure changes: stability and output sensitivity proved along every motion of it.

K, k, C and c of every seal follow the pressure on a straight line or a polynomial up to the third degree. All seals see the
operating point's pressure. Where operating points of one speed have different pressures, the pressure may be anywhere
between the lowest and the highest, and move: as fast as it likes, or up to a rate. Proved is the energy gain from d to y of
core/lft.py's loop (sampled: from the samples of d to those of y), which is max sigma_max(S_o) where the pressure stands still.
On the full plant, with the pressure moving within a sample, too.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import block_diag

from ambrose.core.checks import AmbroseError, InvalidInput, NumericalFailure, check_positive
from ambrose.core.norms import hinf_norm
from ambrose.core.statespace import StateSpace, balance, is_stable, select
from ambrose.core.varying.loop import VaryingLoop
from ambrose.core.varying.proof import Proof, proved_gain
from ambrose.machine.criteria import TWO_PI, Demand, demand
from ambrose.machine.description import OperatingPoint, Seal
from ambrose.machine.machine import Machine
from ambrose.physics.seal_rational import has_states
from ambrose.plant.assemble import assemble, seal_coefficients
from ambrose.plant.loop import covers, match_controller
from ambrose.plant.model import Plant
from ambrose.plant.reduce import reduce
from ambrose.plant.timing import Timing
from ambrose.verification.checks import Check, Checks
from ambrose.verification.criteria import information, judge

FROZEN = 21  # pressures at which the loop with a pressure that stands still is examined
_MODES = 3  # bending modes per plane of the plant on which those are found; the ends are on the full plant
_FILTERS = 3  # for a bounded rate, between half the lowest and half the highest frequency of the frozen peaks
_SPREAD = 4.0  # between the outer two, at least
_NODES = 13  # pressures at which a seal's coefficients are read
_STRAIGHT = 1e-3
_MOST_POWERS = 3
_UNKNOWNS = 12  # rows of a multiplier, filters included, that a search takes in its stride
_TOGETHER = 8  # channels up to which the multipliers of all seals are one

Tell = Callable[[str], None]


@dataclass(frozen=True, slots=True)
class PressureSpan:
    """Operating points that differ in pressure alone: all between ``low`` and ``high`` [Pa] at the place of ``point``."""

    point: OperatingPoint
    low: float
    high: float

    @property
    def half(self) -> float:
        """Half its width [Pa]."""
        return (self.high - self.low) / 2

    @property
    def label(self) -> str:
        where = f"{self.low / 1e5:.4g} to {self.high / 1e5:.4g} bar at {self.point.speed / TWO_PI:.4g} Hz"
        return f"while the pressure changes, {where}"

    @property
    def middle(self) -> OperatingPoint:
        return replace(self.point, seal_pressure=(self.low + self.high) / 2, label=self.label)


def pressure_spans(machine: Machine) -> tuple[PressureSpan, ...]:
    """One span for every speed (and bias) of the operating points and ranges at which there are several pressures."""
    found: dict[tuple[float, float | None, float | None], list[OperatingPoint]] = {}
    for point in machine.operation.envelope:
        found.setdefault((point.speed, point.bias_current, point.whirl_frequency), []).append(point)
    spans = []
    for points in found.values():
        pressures = [point.seal_pressure for point in points]
        if machine.seals and min(pressures) < max(pressures):
            spans.append(PressureSpan(points[0], min(pressures), max(pressures)))
    return tuple(spans)


def pressure_loop(plant: Plant, span: PressureSpan, law: StateSpace, timing: Timing | None) -> VaryingLoop:
    """The loop with the pressure pulled out: delta = -1 at the span's lowest, +1 at its highest pressure.

    plant: at the span's middle. law: continuous (sampled by ``timing``, where there is one) or as it runs. Raises InvalidInput
    for a seal with states or an added mass that change.
    """
    rows = [seal_terms(plant, seal, span) for seal in plant.machine.seals]
    names = [seal.name for seal in plant.machine.seals]
    forces = [f"f_{name}_{axis}" for name in names for axis in "xy"]
    motions = [f"{kind}_{name}_{axis}" for name in names for kind in ("q", "qdot") for axis in "xy"]
    y, u = plant.named("y"), plant.named("u")
    part = select(plant.system, [*forces, *u], [*motions, *y])
    r, f, v = 2 * sum(len(terms) for terms in rows), len(forces), len(motions)
    into, own, shift, owner, at = np.zeros((f, r)), np.zeros((r, v)), np.zeros((r, r)), [], 0
    for k, terms in enumerate(rows):  # Horner's scheme: w1 = delta (P1 v + w2), w2 = delta (P2 v + ...), the force is w1
        into[2 * k : 2 * k + 2, at : at + 2] = np.eye(2)
        for i, P in enumerate(terms):
            here = slice(at, at + 2)
            own[here, 4 * k : 4 * k + 4] = P
            if i + 1 < len(terms):
                shift[here, at + 2 : at + 4] = np.eye(2)
            owner += [k, k]
            at += 2
    left, right = block_diag(own, np.eye(len(y))), block_diag(into, np.eye(len(u)))
    A, t = balance(part.A)
    B, C, D = part.B @ right / t[:, None], (left @ part.C) * t, left @ part.D @ right
    D[:r, :r] += shift
    every = np.array(owner) if r > _TOGETHER else np.zeros(r, int)
    K = match_controller(law, plant)
    if timing is not None:
        K = timing.in_loop(K)
    if K.dt is None:
        return _closed(StateSpace(A, B, C, D), K, every)
    return VaryingLoop(A, B, C, D, every, K)


def seal_terms(plant: Plant, seal: Seal, span: PressureSpan) -> list[np.ndarray]:
    """P_1 .. P_n (2, 4): the change of a seal's force is sum_i delta^i P_i (x, y, x', y'), to 0.1 % of the range.

    Raises InvalidInput where three powers do not suffice, and for a seal with states or an added mass that changes.
    """
    values = np.cos(np.pi * (np.arange(_NODES) + 0.5) / _NODES)
    found = []
    if has_states(seal):
        raise InvalidInput(f"seal {seal.name} has states of its own, which no proof for a changing pressure covers yet")
    for delta in (0.0, *values):
        c = seal_coefficients(seal, replace(plant.point, seal_pressure=(span.low + span.high) / 2 + delta * span.half))
        found.append([c.K, c.k, c.C, c.c, c.M])
    table = np.array(found)
    change, size = table[1:] - table[0], np.ptp(table, axis=0)
    size[:2], size[2:4] = size[:2].max(), size[2:4].max()  # what adds up to one force is measured together
    if size[4] > 0:
        raise InvalidInput(f"the added mass of seal {seal.name} changes with the pressure; no port of the plant carries it")
    for degree in range(1, _MOST_POWERS + 1):
        powers = values[:, None] ** np.arange(1, degree + 1)
        terms = np.linalg.lstsq(powers, change, rcond=None)[0]
        off = np.abs(powers @ terms - change).max(axis=0) / np.where(size > 0, size, 1.0)
        if off.max() < _STRAIGHT:
            return [-np.array([[K, k, C, c], [-k, K, -c, C]]) for K, k, C, c, _ in terms]
    remedy = "give operating points at pressures closer together, or the seal a smoother table"
    raise InvalidInput(
        f"seal {seal.name} is {off.max():.1%} off a polynomial of the pressure of degree {_MOST_POWERS}; {remedy}"
    )


def _closed(part: StateSpace, K: StateSpace, owner: np.ndarray) -> VaryingLoop:
    """A continuous controller around (w, u) -> (z, y): u = K(-(y + d)), outputs z and y + d."""
    r, n, k, p = len(owner), part.n_states, K.n_states, len(K.inputs)
    B_w, B_u, C_z, C_y = part.B[:, :r], part.B[:, r:], part.C[:r], part.C[r:]
    D_zw, D_zu, D_yw = part.D[:r, :r], part.D[:r, r:], part.D[r:, :r]
    if part.D[r:, r:].any():
        raise InvalidInput("the currents reach the sensors at once; give the amplifier a bandwidth in the machine file")
    to_u = np.hstack([-K.D @ C_y, K.C, -K.D @ D_yw, -K.D])  # over x, x_K, w, d
    to_e = np.hstack([-C_y, np.zeros((p, k)), -D_yw, -np.eye(p)])
    own = np.zeros((n + k, n + k + r + p))
    own[:n, :n], own[:n, n + k : n + k + r], own[n:, n : n + k] = part.A, B_w, K.A
    own[:n] += B_u @ to_u
    own[n:] += K.B @ to_e
    out = np.vstack([np.hstack([C_z, np.zeros((r, k)), D_zw, np.zeros((r, p))]) + D_zu @ to_u, -to_e])
    A, t = balance(own[:, : n + k])
    return VaryingLoop(A, own[:, n + k :] / t[:, None], out[:, : n + k] * t, out[:, n + k :], owner)


@dataclass(frozen=True, slots=True)
class Frozen:
    """The loop at pressures that stand still: the worst gain, its pressure [Pa], and the frequencies [rad/s] of all peaks."""

    stable: bool
    gain: float
    pressure: float
    frequencies: tuple[float, ...]


def frozen_peaks(plant: Plant, span: PressureSpan, law: StateSpace, timing: Timing | None) -> Frozen:
    """At FROZEN pressures on the plant reduced to three bending modes, at both ends and at the worst on the full one."""
    small = pressure_loop(reduce(plant, _MODES, static_correction=False), span, law, timing)
    full = pressure_loop(plant, span, law, timing)
    values = np.linspace(-1, 1, FROZEN)
    loops = [small.closed(np.full(small.parameters, delta)) for delta in values]
    if not all(is_stable(loop) for loop in loops):
        return Frozen(False, np.inf, np.nan, ())
    peaks = [hinf_norm(loop) for loop in loops]
    worst = float(values[int(np.argmax([peak.value for peak in peaks]))])
    ends = [full.closed(np.full(full.parameters, delta)) for delta in dict.fromkeys((-1.0, 1.0, worst))]
    if not all(is_stable(loop) for loop in ends):
        return Frozen(False, np.inf, np.nan, ())
    gain = max(hinf_norm(loop).value for loop in ends)
    at = (span.low + span.high) / 2 + worst * span.half
    return Frozen(True, gain, at, tuple(abs(float(peak.frequency)) for peak in peaks))


def filter_poles(frozen: Frozen, channels: int) -> tuple[float, ...]:
    """Poles [rad/s] of the filters for a bounded rate, where the frozen loops have their peaks; fewer for many channels."""
    usable = [omega for omega in frozen.frequencies if np.isfinite(omega) and omega > 0] or [100.0]
    low, count = min(usable) / 2, min(_FILTERS, max(1, _UNKNOWNS // max(1, channels) - 1))
    if count == 1:
        return (-float(np.sqrt(low * max(usable) / 2)),)
    return tuple(-np.geomspace(low, max(max(usable) / 2, _SPREAD * low), count))


def check_pressure(
    machine: Machine, span: PressureSpan, law: StateSpace, timing: Timing | None, rate: float, tell: Tell = lambda text: None
) -> Checks:
    """Stability and output sensitivity while the pressure moves within the span, at any speed and at up to ``rate`` [Pa/s].

    law: a controller as for ``plant.loop.match_controller``. The proof for the rate is judged by the machine's requirement;
    one that cannot be had has the value inf and says why. Raises InvalidInput.
    """
    check_positive(rate, "the rate of the pressure", "give the fastest change in Pa/s")
    plant = assemble(machine, span.middle)
    try:
        loop = pressure_loop(plant, span, law, timing)
        frozen = frozen_peaks(plant, span, law, timing)
    except AmbroseError as error:
        wanted = demand("maximum singular value of a sensitivity", machine.requirements)
        return Checks(span.label, True, (judged_rate(wanted, rate, np.inf, f"not proved: {error}"),))
    wanted = demand("maximum singular value of a sensitivity", machine.requirements)
    where = f"the worst of {FROZEN} pressures, at {frozen.pressure / 1e5:.4g} bar" if frozen.stable else "unstable"
    title = "Largest output sensitivity while the pressure stands still, found"
    checks = [information("moving.frozen", title, frozen.gain, "-", where)]
    if not frozen.stable:
        return Checks(
            span.label, False, (*checks, judged_rate(wanted, rate, np.inf, "a pressure that stands still is unstable"))
        )
    tell(f"proving the loop {span.label}, at any speed")
    value, detail = _proof(loop, (), np.inf, tell)
    title = "Output sensitivity proved for any motion of the pressure, however fast"
    checks.append(information("moving.sensitivity.any", title, value, "-", detail))
    tell(f"proving the loop {span.label}, at up to {rate / 1e5:.4g} bar/s")
    bounded, words = _proof(loop, filter_poles(frozen, int(np.bincount(loop.owner).max())), rate / span.half, tell)
    if value < bounded:  # what holds for any speed holds for this one
        bounded, words = value, detail
    checks.append(judged_rate(wanted, rate, bounded, f"{words}; {bounded / frozen.gain - 1:.1%} above what was found at rest"))
    note = "proved is the energy gain from disturbances of the measurement to the measurement, which is sigma_max(S_o) at rest"
    return Checks(span.label, True, tuple(checks), notes=(note,))


def judged_rate(wanted: Demand, rate: float, value: float, detail: str) -> Check:
    """The row of what was proved for a rate [Pa/s]; failed where nothing was."""
    title = f"Output sensitivity proved for any motion of the pressure at up to {rate / 1e5:.4g} bar/s"
    check = judge("moving.sensitivity.rate", title, value, "-", wanted, detail)
    return check if np.isfinite(value) else replace(check, passed=False)  # also where nothing is required


def _proof(loop: VaryingLoop, poles: tuple[float, ...], rate: float, tell: Tell) -> tuple[float, str]:
    try:
        found: Proof = proved_gain(loop, poles, [rate] * loop.parameters, tell=tell)
    except NumericalFailure as error:
        return np.inf, f"not proved: {error}"
    size = f"full plant, {len(loop.A)} states" + (
        f" and {loop.controller.n_states} of the sampled law" if loop.controller else ""
    )
    return found.gamma, f"{size}; the inequality holds by {found.slack:.0e}, rounding {found.rounding:.0e}"


def covered_spans(machine: Machine, law: object) -> tuple[PressureSpan, ...]:
    """The spans at whose ends a law is meant to run; a schedule over speed is made for one pressure and covers none."""
    ends = ((span, (replace(span.point, seal_pressure=p) for p in (span.low, span.high))) for span in pressure_spans(machine))
    return tuple(span for span, points in ends if all(covers(law, assemble(machine, point)) for point in points))
