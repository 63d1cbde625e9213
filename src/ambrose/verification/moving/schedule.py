"""Verification of a controller scheduled over seal pressure, while the pressure changes and is not told exactly.

Plant and controller form the loop of core/varying/cells.py: the pressure p anywhere between the lowest and the highest
operating point of one speed, as far as the schedule goes; what the controller is told is within ``error`` of it; both move: as
they like, or p up to a rate. A pressure sensor that is T late adds rate x T to the error. Proved is the model with as many
bending modes as the frozen sensitivities of the full plant need; of a sampled loop with the mean delay (n + 1/2) T as a
second-order all-pass.
"""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np

from ambrose.core.checks import AmbroseError, InvalidInput, NumericalFailure, check_positive
from ambrose.core.lft import GeneralizedPlant
from ambrose.core.norms import hinf_norm
from ambrose.core.scheduled import ScheduledSystem
from ambrose.core.statespace import StateSpace, is_stable, select
from ambrose.core.varying.cells import LIGHT, Cell, elevated, product, proved_on_cells
from ambrose.machine.criteria import demand
from ambrose.machine.machine import Machine
from ambrose.plant.assemble import assemble
from ambrose.plant.loop import match_axes
from ambrose.plant.model import Plant
from ambrose.plant.reduce import reduce
from ambrose.plant.timing import Timing
from ambrose.synthesis.problem import apply_delay
from ambrose.verification.checks import Checks
from ambrose.verification.criteria import information
from ambrose.verification.moving.pressure import FROZEN, PressureSpan, Tell, judged_rate, pressure_spans, seal_terms

_MODES = (1, 2, 3)  # bending modes per plane that are tried
_SAME = 5e-3  # relative, of the frozen sensitivities on a model and on the full plant
_PADE = 2
_TIME_LIMIT = 900.0  # s, of the proof of one span


class _Loop:
    """Reduced plant and schedule over a span of pressures, relative to the span: -1 .. 1."""

    def __init__(self, plant: Plant, span: PressureSpan, law: ScheduledSystem, lag: float) -> None:
        machine = plant.machine
        terms = {seal.name: seal_terms(plant, seal, span) for seal in machine.seals}
        forces = [f"f_{name}_{axis}" for name in terms for axis in "xy"]
        motions = [f"{kind}_{name}_{axis}" for name in terms for kind in ("q", "qdot") for axis in "xy"]
        y, u = list(plant.named("y")), list(plant.named("u"))
        part = select(plant.system, [*forces, *u], [*motions, *y])
        late = apply_delay(GeneralizedPlant(part, forces, u, motions, y), lag, _PADE).system
        r, v = len(forces), len(motions)
        self.B, self.C, own = late.B[:, r:], late.C[v:], late.C[:v]
        if late.D.any():
            raise InvalidInput("the currents reach the sensors at once; give the amplifier a bandwidth in the machine file")
        degree = max(len(powers) for powers in terms.values())
        self.terms = [late.A]  # A(p) = sum_i p^i terms[i]
        for i in range(degree):
            P = np.zeros((r, v))
            for k, powers in enumerate(terms.values()):
                if i < len(powers):
                    P[2 * k : 2 * k + 2, 4 * k : 4 * k + 4] = powers[i]
            self.terms.append(late.B[:, :r] @ P @ own)
        self.span, self.law, self.axes = span, law, plant.axes

    @property
    def output(self) -> np.ndarray:
        """C of y + d over the states of plant and controller."""
        return np.hstack([self.C, np.zeros((len(self.C), self.law.n_states))])

    def _controller(self, told: float) -> StateSpace:
        return match_axes(self.law.at(told), self.axes)

    def _around(self, K: StateSpace) -> tuple[np.ndarray, np.ndarray]:
        """What the controller adds to A, and B of d: u = K (-(C x + d))."""
        n, k = len(self.B), K.n_states
        A = np.zeros((n + k, n + k))
        A[:n, :n], A[:n, n:], A[n:, :n], A[n:, n:] = -self.B @ K.D @ self.C, self.B @ K.C, -K.B @ self.C, K.A
        return A, np.vstack([-self.B @ K.D, -K.B])

    def _wide(self, A: np.ndarray) -> np.ndarray:
        n, k = len(A), self.law.n_states
        return np.pad(A, ((0, k), (0, k))) if k else A.reshape(n, n)

    def frozen(self, pressure: float, told: float) -> StateSpace:
        """d -> y + d with both held."""
        delta, (A, B) = self.relative(pressure), self._around(self._controller(told))
        plant = sum(delta**i * term for i, term in enumerate(self.terms))
        return StateSpace(A + self._wide(np.asarray(plant)), B, self.output, np.eye(len(self.output)))

    def relative(self, pressure: float) -> float:
        return (pressure - self.span.low) / self.span.half - 1

    def cells(self, error: float) -> tuple[Cell, ...]:
        """One for every two neighbours among the grid's values, the span's ends and where the error's band meets them."""
        low, high = self.span.low, self.span.high
        first, last = told_range(self.span, self.law, error)
        inner = (*self.law.grid.tolist(), low + error, high - error)
        knots = sorted({first, last, *(v for v in inner if first < v < last)})
        around = [self._around(self._controller(told)) for told in knots]
        bands = [(self.relative(max(low, told - error)), self.relative(min(high, told + error))) for told in knots]
        found = []
        for i in range(len(knots) - 1):
            p = np.array([bands[i], bands[i + 1]])[:, : 2 if error else 1]  # told exactly, a cell is a line
            power, net = np.ones((1, 1)), self._wide(self.terms[0])[None, None]
            for term in self.terms[1:]:
                power = product(p, power[:, :, None, None])[:, :, 0, 0]
                net = elevated(net, power.shape) + power[:, :, None, None] * self._wide(term)
            for_A, for_B = (np.stack([around[i][m], around[i + 1][m]])[:, None] for m in (0, 1))
            found.append(Cell(net + elevated(for_A, net.shape[:2]), elevated(for_B, net.shape[:2]), p))
        return tuple(found)


def check_schedule(
    machine: Machine,
    span: PressureSpan,
    law: ScheduledSystem,
    timing: Timing | None,
    rate: float,
    error: float = 0.0,
    tell: Tell = lambda text: None,
) -> Checks:
    """Stability and output sensitivity while the pressure moves at up to ``rate`` [Pa/s] and is told within ``error`` [Pa].

    law: continuous, scheduled over pressure, covering the span. The proof for the rate is judged by the machine's requirement;
    one that cannot be had has the value inf and says why. Raises InvalidInput.
    """
    check_positive(rate, "the rate of the pressure", "give the fastest change in Pa/s")
    check_positive(error, "the error of the pressure", "give it in Pa", zero_allowed=True)
    wanted = demand("maximum singular value of a sensitivity", machine.requirements)
    label = span.label + (f", told to {error / 1e5:.4g} bar" if error else "")

    def without(why: str, stable: bool = True) -> Checks:
        return Checks(label, stable, (judged_rate(wanted, rate, np.inf, f"not proved: {why}"),))

    if law.dt is not None:
        return without("the schedule is sampled; give the continuous one that it was made of")
    full, lag = assemble(machine, span.middle), 0.0 if timing is None else timing.lag
    try:
        whole = _Loop(full, span, law, lag)
        held = [(p, told) for told in np.linspace(*told_range(span, law, error), FROZEN) for p in _told(told, error, span)]
        modes, model, off = _model(full, whole, span, law, lag)
        loops = [model.frozen(p, told) for p, told in held]
        if not all(is_stable(loop) for loop in loops):
            return without("a pressure that stands still is unstable", stable=False)
        gains = [hinf_norm(loop).value for loop in loops]
        worst = int(np.argmax(gains))
        full_gain = hinf_norm(whole.frozen(*held[worst])).value
    except AmbroseError as failure:
        return without(str(failure))
    at = f"the worst of {len(held)} pairs, at {held[worst][0] / 1e5:.4g} bar told as {held[worst][1] / 1e5:.4g} bar"
    title = "Largest output sensitivity while the pressure stands still, found, full plant"
    checks = [information("moving.frozen", title, full_gain, "-", at)]
    cells, size = model.cells(error), f"model with {modes} bending modes per plane, {len(model.output.T)} states"
    late = f", {1e6 * lag:.4g} us late" if lag else ""

    tell(f"proving the loop {label}, at up to {rate / 1e5:.4g} bar/s")
    value, words, aim = np.inf, "", (1 + _SAME) * gains[worst]
    end = time.monotonic() + _TIME_LIMIT
    for light in LIGHT:
        try:
            left = end - time.monotonic()
            found = proved_on_cells(cells, model.output, rate / span.half, light=light, time_limit=left, tell=tell)
        except NumericalFailure as failure:
            words = words or f"not proved: {failure}"
            continue
        if (raised := found.gamma * (1 + off)) < value:
            value = raised
            words = (
                f"{size}{late}; {found.gamma / gains[worst] - 1:.1%} above what was found at rest there, and raised by the "
                f"{off:.2%} by which the model is off the full plant at rest; the inequality holds by {found.slack:.0e}, "
                f"rounding {found.rounding:.0e}"
            )
        if found.gamma <= aim:
            break
    checks.append(judged_rate(wanted, rate, value, words))
    note = "proved is the energy gain from disturbances of the measurement to the measurement, which is sigma_max(S_o) at rest"
    return Checks(label, True, tuple(checks), notes=(note,))


def told_range(span: PressureSpan, law: ScheduledSystem, error: float) -> tuple[float, float]:
    """What a pressure of the span may be told as [Pa]: beyond its ends by the error, as far as the schedule goes."""
    return max(span.low - error, law.range[0]), min(span.high + error, law.range[1])


def _told(told: float, error: float, span: PressureSpan) -> tuple[float, ...]:
    """The pressures that may be told as this one, as far as they are looked at."""
    here = min(max(told, span.low), span.high)
    return tuple(sorted({max(span.low, told - error), here, min(span.high, told + error)}))


def _model(full: Plant, whole: _Loop, span: PressureSpan, law: ScheduledSystem, lag: float) -> tuple[int, _Loop, float]:
    """The smallest model that has the full plant's frozen sensitivities at the ends and in the middle; how far it is off."""
    places = (span.low, (span.low + span.high) / 2, span.high)
    wanted = [whole.frozen(p, p) for p in places]
    if not all(is_stable(loop) for loop in wanted):
        raise NumericalFailure("a pressure that stands still is unstable on the full plant")
    peaks = np.array([hinf_norm(loop).value for loop in wanted])
    for modes in _MODES:
        model = _Loop(reduce(full, modes, static_correction=False), span, law, lag)
        loops = [model.frozen(p, p) for p in places]
        if all(is_stable(loop) for loop in loops):
            off = np.abs(np.array([hinf_norm(loop).value for loop in loops]) / peaks - 1).max()
            if off < _SAME:
                break
    else:
        raise NumericalFailure(f"the model with {modes} bending modes per plane is {off:.1%} off the full plant")
    return modes, model, float(off)


def scheduled_spans(machine: Machine, law: ScheduledSystem) -> tuple[PressureSpan, ...]:
    """The spans of pressure that a schedule over pressure covers, cut at its ends."""
    low, high = law.range
    cut = (replace(span, low=max(low, span.low), high=min(high, span.high)) for span in pressure_spans(machine))
    return tuple(span for span in cut if span.low < span.high)
