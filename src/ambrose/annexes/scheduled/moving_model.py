"""Verification on a reduced model while the seal pressure changes: of a schedule that reads it with
an error, or of a fixed law.

The proof is of the model of scheduled/moving_model.py, with as many bending modes as it takes to
agree with the full plant's sensitivities at constant pressure.
"""

import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from ambrose.annexes.scheduled.varying_cells import Cell, elevated, product, proved_on_cells
from ambrose.core.checks import AmbroseError, InvalidInput, NumericalFailure, check_positive
from ambrose.core.lft import GeneralizedPlant
from ambrose.core.norms import hinf_norm
from ambrose.core.scheduled import ScheduledSystem
from ambrose.core.statespace import StateSpace, is_stable, select
from ambrose.judge.checks import Check, Checks, information, judge
from ambrose.law.design_problem import apply_delay
from ambrose.law.law import LawLike, law_of
from ambrose.law.loop import Timing, match_controller
from ambrose.machine.criteria import TWO_PI, Demand, demand
from ambrose.machine.description import OperatingPoint
from ambrose.machine.machine import Machine
from ambrose.machine.part import Seal
from ambrose.model.assemble import assemble, seal_coefficients
from ambrose.model.effects.seal_rational import has_states
from ambrose.model.plant import Plant
from ambrose.model.uncertainty import reduce

# A law along the one quantity that moves: between knots its matrices are affine in it.


@dataclass(frozen=True, slots=True, eq=False)
class MovingLaw:
    """at: speed [rad/s] or pressure [Pa] as it is told -> the law there, its signals in the order
    of a plant's axes. grid (k,): of a schedule, whose matrices are linear between its values; None:
    the law is the same at all of them. dt [s]: sample time, None where it is continuous.
    """

    at: Callable[[float], StateSpace]
    grid: np.ndarray | None
    n_states: int
    dt: float | None

    def knots(self, low: float, high: float, cells: int) -> list[float]:
        """The values between which it is affine: a schedule's grid; of a law that does not change
        the ends of ``cells`` intervals from low to high.
        """
        inner = np.linspace(low, high, cells + 1) if self.grid is None else self.grid
        return [float(value) for value in inner.tolist()]

    def reach(self, low: float, high: float) -> tuple[float, float]:
        """As much of low to high as a schedule covers."""
        if self.grid is None:
            return low, high
        return max(low, float(self.grid[0])), min(high, float(self.grid[-1]))


def moving_law(law: LawLike, plant: Plant) -> MovingLaw:
    """A schedule over one quantity, or a law that does not change with it, along that quantity.

    Raises InvalidInput where it is not one for the plant's machine.
    """
    schedule = law_of(law).schedule
    if schedule is None:
        still = match_controller(law, plant)
        return MovingLaw(lambda value: still, None, still.n_states, still.dt)
    matrices = schedule
    return MovingLaw(
        lambda value: match_controller(matrices.at(value), plant),
        schedule.grid,
        schedule.n_states,
        schedule.dt,
    )


# Spans of seal pressure at one speed, and how the seals' forces follow the pressure within them.


FROZEN = 21  # pressures at which the loop with a pressure that stands still is examined
REST = (
    "proved is the energy gain from disturbances of the measurement to the measurement, which is "
    "sigma_max(S_o) at rest"
)
_NODES = 13  # pressures at which a seal's coefficients are read
_STRAIGHT = 1e-3  # largest misfit of a polynomial over the range of its coefficient
_MOST_POWERS = 3  # of pressure in a seal's coefficients

Tell = Callable[[str], None]


@dataclass(frozen=True, slots=True)
class PressureSpan:
    """Operating points that differ in pressure alone: all between ``low`` and ``high`` [Pa] at the
    place of ``point``.
    """

    point: OperatingPoint
    low: float
    high: float

    @property
    def half(self) -> float:
        """Half its width [Pa]."""
        return (self.high - self.low) / 2

    @property
    def label(self) -> str:
        where = (
            f"{self.low / 1e5:.4g} to {self.high / 1e5:.4g} bar at {self.point.speed / TWO_PI:.4g} "
            "Hz"
        )
        return f"while the pressure changes, {where}"

    @property
    def middle(self) -> OperatingPoint:
        return replace(self.point, seal_pressure=(self.low + self.high) / 2, label=self.label)


def pressure_spans(machine: Machine) -> tuple[PressureSpan, ...]:
    """One span for every speed (and bias) of the operating points and ranges at which there are
    several pressures.
    """
    groups: dict[tuple[float, float | None, float | None], list[OperatingPoint]] = {}
    for point in machine.operation.envelope:
        groups.setdefault((point.speed, point.bias_current, point.whirl_frequency), []).append(
            point
        )
    spans = []
    for points in groups.values():
        pressures = [point.seal_pressure for point in points]
        if machine.seals and min(pressures) < max(pressures):
            spans.append(PressureSpan(points[0], min(pressures), max(pressures)))
    return tuple(spans)


def seal_force(plant: Plant, seal: Seal, pressure: float) -> np.ndarray:
    """P (2, 4): a seal's force at the pressure [Pa] is P (x, y, x', y') beyond what it is at the
    plant's own point.

    Raises InvalidInput for a seal with states or an added mass that changes.
    """
    change = (
        _coefficients(plant, seal, [pressure])[0]
        - _coefficients(plant, seal, [plant.point.seal_pressure])[0]
    )
    if change[4]:
        raise InvalidInput(
            f"the added mass of seal {seal.name} changes with the pressure; no port of the plant "
            "carries it"
        )
    return _force(change)


def _force(change: np.ndarray) -> np.ndarray:
    K, k, C, c = change[:4]
    # f_x = -(K x + k y + C x' + c y'),   f_y = -(-k x + K y - c x' + C y')
    return -np.array([[K, k, C, c], [-k, K, -c, C]])


def _coefficients(plant: Plant, seal: Seal, pressures: Iterable[float]) -> np.ndarray:
    """K, k, C, c and M at every pressure."""
    if has_states(seal):
        raise InvalidInput(
            f"seal {seal.name} has states of its own, which no proof for a changing pressure "
            "covers yet"
        )
    at_pressures = [
        seal_coefficients(seal, replace(plant.point, seal_pressure=float(p))) for p in pressures
    ]
    return np.array([[c.K, c.k, c.C, c.c, c.M] for c in at_pressures])


class BentSeal(InvalidInput):
    """Coefficients that no polynomial of three powers follows over a span."""


def seal_range(plant: Plant, seal: Seal, span: PressureSpan) -> np.ndarray:
    """By how much K, k, C, c and M change over the span (5,); of two that add up to one force the
    larger change.
    """
    size = np.ptp(_coefficients(plant, seal, _nodes(span)), axis=0)
    size[:2], size[2:4] = size[:2].max(), size[2:4].max()
    return np.asarray(size)


def seal_terms(
    plant: Plant, seal: Seal, span: PressureSpan, size: np.ndarray | None = None
) -> list[np.ndarray]:
    """P_1 .. P_n (2, 4): from the span's middle a seal's force changes by sum_i delta^i P_i (x, y,
    x', y').

    delta is -1 at the span's lowest and 1 at its highest pressure; to 0.1 % of ``size``, the span's
    own range where not given. Raises InvalidInput (BentSeal) where three powers do not suffice, for
    a seal with states or an added mass that changes.
    """
    size = seal_range(plant, seal, span) if size is None else size
    if size[4] > 0:
        raise InvalidInput(
            f"the added mass of seal {seal.name} changes with the pressure; no port of the plant "
            "carries it"
        )

    # change from the middle, at Chebyshev's nodes; delta = -1 .. 1
    nodes = _nodes(span)
    values = (nodes - span.low) / span.half - 1
    change = _coefficients(plant, seal, nodes) - _coefficients(
        plant, seal, [(span.low + span.high) / 2]
    )

    # sum_i delta^i term_i without a constant: the middle is met exactly
    for degree in range(1, _MOST_POWERS + 1):
        powers = values[:, None] ** np.arange(1, degree + 1)
        terms = np.linalg.lstsq(powers, change, rcond=None)[0]
        off = np.abs(powers @ terms - change).max(axis=0) / np.where(size > 0, size, 1.0)
        if off.max() < _STRAIGHT:
            return [_force(term) for term in terms]
    remedy = "give operating points at pressures closer together, or the seal a smoother table"
    raise BentSeal(
        f"seal {seal.name} deviates by {off.max():.1%} from a polynomial of degree {_MOST_POWERS} "
        f"in the pressure; {remedy}"
    )


def _nodes(span: PressureSpan) -> np.ndarray:
    return (span.low + span.high) / 2 + span.half * np.cos(
        np.pi * (np.arange(_NODES) + 0.5) / _NODES
    )


def judged_rate(wanted: Demand, rate: float, value: float, detail: str) -> Check:
    """The row of what was proved for a rate [Pa/s]; failed where nothing was."""
    title = (
        f"Output sensitivity proved for any motion of the pressure at up to {rate / 1e5:.4g} bar/s"
    )
    check = judge("moving.sensitivity.rate", title, value, "-", wanted, detail)
    # also where nothing is required
    return check if np.isfinite(value) else replace(check, passed=False)


# A reduced plant and its controller, scheduled or fixed, while the pressure moves: its cells, and
# the proof on them.
#
# The pressure is anywhere within the span; what a scheduled controller reads of it is within
# ``error``, beyond the span's ends too, as far as the schedule goes. Both move: as they like, or
# the pressure up to a rate. A pressure sensor that is T late adds rate x T to the error. Of a
# sampled loop the mean delay (n + 1/2) T is in the model, as a second-order all-pass. Every cell
# (annexes/scheduled/varying_cells.py) has its own polynomials for the seals, which may be bent.


_MODES = (0, 1, 2, 3)  # bending modes per plane that are tried
SAME = 5e-3  # relative, of the frozen sensitivities on a model and on the full plant
CLOSE = 1e-2  # of a proof to the worst found at rest, beyond which one with more terms is tried
_PADE = 2  # order of the delay's approximation
_CELLS = 8  # of a fixed controller
_HALVINGS = 8  # of a cell in which a seal is bent
# degree of X(p), and share of the states whose rows change with p
_FUNCTIONS = ((2, 0.35), (4, 0.5), (4, 1.0))
_GAINED = 1e-3  # relative, by more terms; less, and no further ones are tried
_TIME_LIMIT = 900.0  # s, of the proof of one span


class MovingModel:
    """Plant and law (a schedule over pressure, or a fixed one) over a span of pressures, which is
    -1 .. 1.
    """

    def __init__(self, plant: Plant, span: PressureSpan, law: LawLike, lag: float) -> None:
        names = [seal.name for seal in plant.machine.seals]
        forces = [f"f_{name}_{axis}" for name in names for axis in "xy"]
        motions = [
            f"{kind}_{name}_{axis}" for name in names for kind in ("q", "qdot") for axis in "xy"
        ]

        # (f, u) -> (q, qdot, y), the currents late
        y, u = list(plant.named("y")), list(plant.named("u"))
        part = select(plant.system, [*forces, *u], [*motions, *y])
        delayed = apply_delay(GeneralizedPlant(part, forces, u, motions, y), lag, _PADE).system
        r, v = len(forces), len(motions)
        if delayed.D.any():
            raise InvalidInput(
                "the currents reach the sensors at once; give the amplifier a bandwidth in the "
                "machine file"
            )
        self.A = delayed.A
        self.B = delayed.B[:, r:]
        self.C = delayed.C[v:]
        self._into, self._own = delayed.B[:, :r], delayed.C[:v]
        self._ranges = [seal_range(plant, seal, span) for seal in plant.machine.seals]
        self.plant = plant
        self.span = span
        self.lag = lag
        self.law = moving_law(law, plant)

    @property
    def output(self) -> np.ndarray:
        """C of y + d over the states of plant and controller."""
        return np.hstack([self.C, np.zeros((len(self.C), self.law.n_states))])

    def controller(self, reported: float) -> StateSpace:
        """The law where the pressure is measured as ``reported`` [Pa]."""
        return self.law.at(reported)

    def _around(self, K: StateSpace) -> tuple[np.ndarray, np.ndarray]:
        """What the controller adds to A, and B of d: u = K (-(C x + d))."""
        n, k = len(self.B), K.n_states
        # x' = A x + B (C_K x_K - D_K (C x + d)),   x_K' = A_K x_K - B_K (C x + d)
        A = np.zeros((n + k, n + k))
        A[:n, :n] = -self.B @ K.D @ self.C
        A[:n, n:] = self.B @ K.C
        A[n:, :n] = -K.B @ self.C
        A[n:, n:] = K.A
        return A, np.vstack([-self.B @ K.D, -K.B])

    def _wide(self, A: np.ndarray) -> np.ndarray:
        return np.pad(A, ((0, self.law.n_states), (0, self.law.n_states)))

    def _pulled(self, forces: list[np.ndarray]) -> np.ndarray:
        """What forces P (2, 4) of every seal add to A."""
        # f = P (q, qdot): rows of a seal in twos, its columns (x, y, x', y') in fours
        P = np.zeros((self._into.shape[1], len(self._own)))
        for k, force in enumerate(forces):
            P[2 * k : 2 * k + 2, 4 * k : 4 * k + 4] = force
        return self._wide(self._into @ P @ self._own)

    def _at(self, pressure: float) -> np.ndarray:
        seals = self.plant.machine.seals
        return self._wide(self.A) + self._pulled(
            [seal_force(self.plant, seal, pressure) for seal in seals]
        )

    def frozen(self, pressure: float, reported: float) -> StateSpace:
        """d -> y + d with both held."""
        A, B = self._around(self.controller(reported))
        return StateSpace(A + self._at(pressure), B, self.output, np.eye(len(self.output)))

    def relative(self, pressure: np.ndarray) -> np.ndarray:
        return (pressure - self.span.low) / self.span.half - 1

    def cells(self, error: float) -> tuple[Cell, ...]:
        """Of a schedule between neighbours among its grid's values and those where the error's band
        meets the span's ends.
        """
        low, high = self.span.low, self.span.high

        # bends of the reported pressure, and of its band where that meets the span's ends
        first, last = told_range(self.span, self.law, error)
        inner = self.law.knots(low, high, _CELLS)
        if self.law.grid is not None:
            inner += [low + error, high - error]
        knots = sorted({first, last, *(v for v in inner if first < v < last)})
        share = (0.0, 1.0) if error else (0.0,)  # told exactly, a cell is a line
        return tuple(
            cell
            for reported in pairwise(knots)
            for cell in self._cells(reported, share, error, _HALVINGS)
        )

    def _cells(
        self, reported: tuple[float, ...], share: tuple[float, ...], error: float, left: int
    ) -> Iterator[Cell]:
        """Of the pressure that is reported and a share of its band; halved where a seal is bent,
        along what moves the pressure more.
        """
        low, high = self.span.low, self.span.high
        # pressures that may be reported as each end; p: its shares, a row per end
        bands = np.array([(max(low, v - error), min(high, v + error)) for v in reported])
        p = bands[:, :1] + np.array(share) * np.ptp(bands, axis=1)[:, None]
        try:
            yield self._cell(p, [self._around(self.controller(v)) for v in reported])
        except BentSeal:
            if left == 0:
                raise
            if len(share) > 1 and abs(p[:, 1] - p[:, 0]).max() > abs(p[1] - p[0]).max():
                halves = [(reported, half) for half in _halves(share)]
            else:
                halves = [(half, share) for half in _halves(reported)]
            for one, other in halves:
                yield from self._cells(one, other, error, left - 1)

    def _cell(self, pressures: np.ndarray, around: list[tuple[np.ndarray, np.ndarray]]) -> Cell:
        # s = -1 .. 1 over the pressures of this cell, (reported, share) at its corners
        part = replace(self.span, low=pressures.min(), high=pressures.max())
        middle = (part.low + part.high) / 2
        s = (pressures - middle) / part.half

        seals = self.plant.machine.seals
        terms = [
            seal_terms(self.plant, seal, part, size)
            for seal, size in zip(seals, self._ranges, strict=True)
        ]

        # A(middle) + sum_i s^i P_i as a Bernstein net: s^i = s s^(i-1), degrees raised
        none = np.zeros((2, 4))
        power, net = np.ones((1, 1)), self._at(middle)[None, None]
        for i in range(max(len(powers) for powers in terms)):
            power = product(s, power[:, :, None, None])[:, :, 0, 0]
            term = self._pulled([powers[i] if i < len(powers) else none for powers in terms])
            net = elevated(net, power.shape) + power[:, :, None, None] * term

        # the controller depends on the reported pressure alone, linearly
        for_A, for_B = (np.stack([beside[m] for beside in around])[:, None] for m in (0, 1))
        shape = (max(2, net.shape[0]), net.shape[1])
        return Cell(
            elevated(net, shape) + elevated(for_A, shape),
            elevated(for_B, shape),
            self.relative(pressures),
        )


def _halves(ends: tuple[float, ...]) -> tuple[tuple[float, ...], ...]:
    middle = (ends[0] + ends[1]) / 2
    return (ends[0], middle), (middle, ends[1])


def told_range(span: PressureSpan, law: MovingLaw, error: float) -> tuple[float, float]:
    """What a pressure of the span may be reported as [Pa]: beyond its ends by the error, as far as
    a schedule goes.
    """
    if law.grid is None:
        return span.low, span.high
    return law.reach(span.low - error, span.high + error)


@dataclass(frozen=True, slots=True, eq=False)
class Model:
    """The smallest model with the full plant's frozen sensitivities where they were compared;
    ``off``: by how much not.

    at_rest: the largest of them on the model; full_gain, held: on the full plant, and its pressure
    and what is told [Pa].
    """

    loop: MovingModel
    modes: int
    off: float
    at_rest: float
    full_gain: float
    held: tuple[float, float]


class UnstableAtRest(NumericalFailure):
    """A loop whose pressure stands still is unstable already."""


def choose_model(
    full: Plant,
    span: PressureSpan,
    law: LawLike,
    lag: float,
    pairs: Sequence[tuple[float, float]],
) -> Model:
    """Compared at all ``pairs`` of a pressure and what is told of it [Pa], for a model may be good
    at one that is told exactly and off where it is misread. Raises UnstableAtRest, and
    NumericalFailure where even the largest model is off.
    """
    wanted = _peaks(MovingModel(full, span, law, lag), pairs)
    if not np.isfinite(wanted).all():
        raise UnstableAtRest("the loop at a constant pressure is unstable on the full plant")
    off, worst = np.inf, int(np.argmax(wanted))
    for modes in _MODES:
        model = MovingModel(reduce(full, modes, static_correction=False), span, law, lag)
        peaks = _peaks(model, pairs)
        off = float(np.abs(peaks / wanted - 1).max())
        if off < SAME:
            return Model(model, modes, off, float(peaks.max()), float(wanted[worst]), pairs[worst])
    raise NumericalFailure(
        f"the model with {modes} bending modes per plane is {off:.1%} off the full plant"
    )


def _peaks(model: MovingModel, pairs: Sequence[tuple[float, float]]) -> np.ndarray:
    loops = (model.frozen(*pair) for pair in pairs)
    return np.array([hinf_norm(loop).value if is_stable(loop) else np.inf for loop in loops])


def prove_on_model(model: Model, rate: float, error: float, tell: Tell) -> tuple[float, str]:
    """The sensitivity proved for |p'| <= rate [Pa/s] and a pressure told within ``error`` [Pa], and
    the words that say how.

    It is raised by the model's ``off``, and inf where there is no proof. Functions of more terms
    are tried until they come close to the worst found on the model at rest.
    """
    loop = model.loop
    lag = model.loop.lag
    at_rest = model.at_rest
    size = f"model with {model.modes} bending modes per plane, {len(loop.output.T)} states"
    delay_words = f", {1e6 * lag:.4g} us late" if lag else ""
    value = np.inf
    words = ""
    end = time.monotonic() + _TIME_LIMIT
    cells = loop.cells(error)
    for degree, share in _FUNCTIONS:
        try:
            left = end - time.monotonic()
            proof = proved_on_cells(
                cells,
                loop.output,
                rate / loop.span.half,
                degree=degree,
                share=share,
                time_limit=left,
                tell=tell,
            )
        except NumericalFailure as failure:
            words = words or f"not proved: {failure}"
            continue
        before, raised = value, proof.gamma * (1 + model.off)
        if raised < value:
            value = raised
            words = (
                f"{size}{delay_words}; {proof.gamma / at_rest - 1:.1%} above what was found at "
                "rest there, and raised by the "
                f"{model.off:.2%} by which the model is off the full plant at rest; the "
                f"inequality holds by {proof.slack:.0e}, "
                f"rounding {proof.rounding:.0e}"
            )
        if proof.gamma <= (1 + CLOSE) * at_rest or (1 - _GAINED) * before < raised < np.inf:
            break
    return value, words


def check_on_model(
    machine: Machine,
    span: PressureSpan,
    law: LawLike,
    timing: Timing | None,
    rate: float,
    error: float = 0.0,
    tell: Tell = lambda text: None,
) -> Checks:
    """Stability and output sensitivity while the pressure moves at up to ``rate`` [Pa/s] and is
    measured within ``error`` [Pa].

    law: continuous; a schedule over pressure that covers the span, or fixed. The proof for the rate
    is judged by the machine's requirement; where there is none, its value is inf and its detail
    says why.
    Raises InvalidInput.
    """
    check_positive(rate, "the rate of the pressure", "give the fastest change in Pa/s")
    check_positive(error, "the error of the pressure", "give it in Pa", zero_allowed=True)
    wanted = demand("maximum singular value of a sensitivity", machine.requirements)
    label = span.label + (f", told to {error / 1e5:.4g} bar" if error else "")

    def not_proved(why: str, stable: bool = True) -> Checks:
        return Checks(label, stable, (judged_rate(wanted, rate, np.inf, f"not proved: {why}"),))

    plant = assemble(machine, span.middle)
    moving = moving_law(law, plant)
    if moving.dt is not None:
        return not_proved("the controller is sampled; give the continuous one that it was made of")
    try:
        pairs = [
            (p, reported)
            for reported in np.linspace(*told_range(span, moving, error), FROZEN)
            for p in _true_pressures(reported, error, span)
        ]
        lag = 0.0 if timing is None else timing.lag
        model = choose_model(plant, span, law, lag, pairs)
        at = (
            f"the worst of {len(pairs)} pairs, at {model.held[0] / 1e5:.4g} bar told as "
            f"{model.held[1] / 1e5:.4g} bar"
        )
        title = "Largest output sensitivity at constant pressure, found by search, full plant"
        checks = [information("moving.frozen", title, model.full_gain, "-", at)]
        tell(f"proving the loop {label}, at up to {rate / 1e5:.4g} bar/s")
        value, words = prove_on_model(model, rate, error, tell)
    except AmbroseError as failure:
        return not_proved(str(failure), stable=not isinstance(failure, UnstableAtRest))
    checks.append(judged_rate(wanted, rate, value, words))
    return Checks(label, True, tuple(checks), notes=(REST,))


def _true_pressures(reported: float, error: float, span: PressureSpan) -> tuple[float, ...]:
    """Pressures of the span that the sensor may report as this one: the ends of the band
    ``reported`` +- error [Pa], and what lies nearest in the span.
    """
    nearest = min(max(reported, span.low), span.high)
    return tuple(
        sorted({max(span.low, reported - error), nearest, min(span.high, reported + error)})
    )


def scheduled_spans(machine: Machine, law: ScheduledSystem) -> tuple[PressureSpan, ...]:
    """The spans of pressure that a schedule over pressure covers, cut at its ends."""
    low, high = law.range
    cut = (
        replace(span, low=max(low, span.low), high=min(high, span.high))
        for span in pressure_spans(machine)
    )
    return tuple(span for span in cut if span.low < span.high)
