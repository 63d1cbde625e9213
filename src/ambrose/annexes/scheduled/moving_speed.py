"""Verification while the speed changes at one seal pressure: output sensitivity proved along every
run-up and run-down, and over the tolerances as well.

The model is the rotor in its free modes, whose states mean the same at every speed, with as many
bending modes as the full plant's sensitivities at steady speeds need. A sampled loop is proved as
it runs (moving_speed.py, annexes/scheduled/varying_sampled.py), from the samples of d to those of
y. Over tolerances, which stand still (annexes/scheduled/varying_cells.py), it is proved with its
mean delay, as a second-order all-pass, and raised by what that is better than the loop as it runs
at steady speeds. Of a continuous loop the matrices are polynomials between values of the speed
(annexes/scheduled/varying_cells.py).
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import pairwise
from math import comb
from typing import cast

import numpy as np
import scipy.linalg as sla

from ambrose.annexes.scheduled.moving_model import REST, MovingLaw, Tell, moving_law
from ambrose.annexes.scheduled.varying_cells import Cell, elevated, proved_over_tolerances
from ambrose.annexes.scheduled.varying_proof import Proof
from ambrose.annexes.scheduled.varying_sampled import SampledLoop, proved_sampled
from ambrose.core.checks import AmbroseError, InvalidInput, NumericalFailure, check_positive
from ambrose.core.lft import GeneralizedPlant
from ambrose.core.norms import hinf_norm
from ambrose.core.statespace import StateSpace, is_stable, select
from ambrose.judge.checks import Checks, information, judge
from ambrose.law.design_problem import apply_delay, open_model
from ambrose.law.law import LawLike, law_of
from ambrose.law.loop import Timing
from ambrose.machine.criteria import TWO_PI, demand
from ambrose.machine.description import OperatingPoint, Tolerance
from ambrose.machine.machine import Machine
from ambrose.model.assemble import assemble
from ambrose.model.plant import Plant
from ambrose.model.uncertainty import free_mode_reduction, tolerances_around

# Plant and sampled law while the speed changes: the loop as it runs, from sample to sample.
#
# With the currents u held over a sample of dt, (x, u)' = N (x, u), N = [A(Omega), B; 0, 0], the
# plant goes from sample to sample by P = exp(N dt); the law, sampled and late, by its own matrices.
# Omega is the mean of the speed over a sample, which changes by at most rate dt from one to the
# next. From it the speed within the sample is off by r(t) of mean zero, int |r| <= rate dt^2/4, and
# P by
#
#     int K(t) r(t) dt = int (K(t) - K(dt/2)) r(t) dt,    K(t) = e^(N (dt - t)) dN/dOmega e^(N t),
#
# to first order in rate dt, a few thousandths of a rad/s. A schedule is told the speed at the
# sample, which is within rate dt/2 of the mean.


_WITHIN = (0.0, 0.25, 0.75, 1.0)  # of a sample, where K is compared with that in the middle
_FURTHER = 1.1  # of the largest found, for what lies between


class SampledFamily:
    """Plant and law along speeds; point_at: speed [rad/s] -> operating point; modes: bending modes
    per plane, None: the full plant.
    """

    def __init__(
        self,
        plant: Plant,
        point_at: Callable[[float], OperatingPoint],
        law: MovingLaw,
        timing: Timing,
        modes: int | None,
    ) -> None:
        self.plant = plant
        self.point_at = point_at
        self.law = law
        self.timing = timing
        self.modes = modes
        system = self._open(plant.point.speed)
        if system.D.any():
            raise InvalidInput(
                "the currents reach the sensors at once; give the amplifier a bandwidth in the "
                "machine file"
            )
        self.C = system.C
        self.n = system.n_states
        self.at = lru_cache(maxsize=4096)(self._at)

    def _open(self, speed: float) -> StateSpace:
        """u -> y."""
        own = replace(self.plant, point=self.point_at(speed))
        small = (
            assemble(own.machine, own.point)
            if self.modes is None
            else free_mode_reduction(own, self.modes)
        )
        return select(small.system, list(small.named("u")), list(small.named("y")))

    def _generator(self, speed: float) -> np.ndarray:
        """N of (x, u)."""
        system = self._open(speed)
        q = system.B.shape[1]
        return np.pad(np.hstack([system.A, system.B]), ((0, q), (0, 0)))

    def controller(self, speed: float) -> StateSpace:
        """The law as it runs: sampled and late at the values of a schedule, linear between them."""
        law, timing = self.law, self.timing
        if law.grid is None:
            return timing.in_loop(law.at(speed))
        k = int(np.clip(np.searchsorted(law.grid, speed) - 1, 0, len(law.grid) - 2))
        low, high = float(law.grid[k]), float(law.grid[k + 1])
        share = (speed - low) / (high - low)
        a, b = timing.in_loop(law.at(low)), timing.in_loop(law.at(high))
        A, B, C, D = (
            (1 - share) * getattr(a, name) + share * getattr(b, name)
            for name in ("A", "B", "C", "D")
        )
        return StateSpace(A, B, C, D, a.inputs, a.outputs, a.dt)

    def _reads(self, K: StateSpace) -> np.ndarray:
        """(x, u) over (x, x_K, d), u = C_K x_K - D_K (C x + d)."""
        u = np.hstack([-K.D @ self.C, K.C, -K.D])
        return np.vstack([np.eye(self.n, u.shape[1]), u])

    def _around(self, P: np.ndarray, K: StateSpace) -> np.ndarray:
        """[A, B] of the loop with P of the plant and the law K."""
        # x_K+ = A_K x_K - B_K (C x + d)
        return np.vstack([P[: self.n] @ self._reads(K), np.hstack([-K.B @ self.C, K.A, -K.B])])

    def _at(self, speed: float) -> np.ndarray:
        P = sla.expm(self._generator(speed) * self.timing.sample_time)
        return self._around(P, self.controller(speed))

    def frozen(self, speed: float) -> StateSpace:
        """d -> y + d at one speed."""
        return self.loop(0.0).system(speed)

    def loop(self, rate: float) -> SampledLoop:
        """The loop for a speed that changes at up to ``rate`` [rad/s^2]."""
        k = self.controller(self.plant.point.speed).n_states
        C = np.pad(self.C, ((0, 0), (0, k)))
        beside = lambda low, high: self._within(low, high, rate)  # noqa: E731
        return SampledLoop(self.at, beside, C, self.timing.sample_time)

    def _within(self, low: float, high: float, rate: float) -> list[np.ndarray]:
        """What the change of the speed within a sample makes of [A, B]: in the plant, in the
        law.
        """
        middle, dt = (low + high) / 2, self.timing.sample_time
        N, K = self._generator(middle), self.controller(middle)
        slope = (self._generator(high) - self._generator(low)) / (high - low)
        kernels = [
            sla.expm(N * (1 - t) * dt) @ slope @ sla.expm(N * t * dt) for t in (0.5, *_WITHIN)
        ]
        moved = np.array(kernels[1:]) - kernels[0]
        plant = moved[:, : self.n] @ self._reads(K) * (_FURTHER * rate * dt**2 / 4)
        plant = np.pad(plant, ((0, 0), (0, K.n_states), (0, 0)))
        if self.law.grid is None:
            return [plant]
        P = sla.expm(N * dt)
        told = self._around(P, self.controller(high)) - self._around(P, self.controller(low))
        return [plant, told[None] * (_FURTHER * rate * dt / 2 / (high - low))]


# bending modes per plane that are tried, and what one may be off the full plant at rest
_MODES, _SAME = (0, 2, 4, 6), 1e-2
_FROZEN = 11  # speeds at which the loop that turns steadily is examined
_CELLS = 6  # of a fixed controller
_NODES = 7  # Chebyshev points of a cell, to which polynomials are fitted
_POWERS = 3  # of speed in a cell, at most
_STRAIGHT = 2e-3  # largest misfit of an entry over its range; above, a cell is halved
_HALVINGS = 6  # of a cell, at most
_PADE = 2  # order of the delay's approximation
# rad/s, of the filters for what stands still; from a third to three times as fast it hardly matters
_POLE = TWO_PI * 60.0
_MOST = 12  # rows of tolerances up to which each has its filters


@dataclass(frozen=True, slots=True)
class SpeedSpan:
    """Operating points that differ in speed alone: all between ``low`` and ``high`` [rad/s] at the
    place of ``point``.
    """

    point: OperatingPoint
    low: float
    high: float

    @property
    def label(self) -> str:
        where = (
            f"{self.low / TWO_PI:.4g} to {self.high / TWO_PI:.4g} Hz at "
            f"{self.point.seal_pressure / 1e5:.4g} bar"
        )
        return f"while the speed changes, {where}"

    def at(self, speed: float) -> OperatingPoint:
        return replace(self.point, speed=float(speed), label=self.label)


def speed_spans(machine: Machine, law: LawLike) -> tuple[SpeedSpan, ...]:
    """One for every pressure (and bias) at which operating points have several speeds, cut at a
    schedule's ends.
    """
    groups: dict[tuple[float, float | None, float | None], list[OperatingPoint]] = {}
    for point in machine.operation.envelope:
        groups.setdefault(
            (point.seal_pressure, point.bias_current, point.whirl_frequency), []
        ).append(point)

    law = law_of(law)
    low, high = (0.0, np.inf) if law.range is None else law.range
    ends = (
        (p[0], max(low, min(q.speed for q in p)), min(high, max(q.speed for q in p)))
        for p in groups.values()
    )
    spans = (SpeedSpan(*item) for item in ends if item[1] < item[2])
    return tuple(
        span
        for span in spans
        if all(law.covers(assemble(machine, span.at(v))) for v in (span.low, span.high))
    )


class _Family:
    """Plant and law over a span; polynomials of the speed on cells."""

    def __init__(
        self,
        plant: Plant,
        span: SpeedSpan,
        law: MovingLaw,
        lag: float,
        modes: int,
        tolerances: Sequence[Tolerance],
    ) -> None:
        self.plant = plant
        self.span = span
        self.law = law
        self.lag = lag
        self.modes = modes
        self.tolerances = tolerances

        # owners (r,): the parameter of every row of z
        model = self._open(self._middle)
        system, r = model.system, len(model.w)
        owners = np.array([block.name for block in model.blocks for _ in range(block.n_z)])

        # direct terms in z, or no states in it: not covered by this proof
        # a parameter is in it with all its rows
        lost = set(owners[system.D[:r].any(axis=1) | ~system.C[:r].any(axis=1)])
        if system.D[r:].any():
            raise InvalidInput(
                "the currents reach the sensors at once; give the amplifier a bandwidth in the "
                "machine file"
            )
        # of z that the states alone decide
        self.rows = np.array([i for i, name in enumerate(owners) if name not in lost], int)
        # the parameters whose tolerances are in it
        self.covered = tuple(dict.fromkeys(owners[self.rows].tolist()))

        # C_z by unit rows; their sizes go to the columns of w (_of_speed)
        self.directions = system.C[self.rows] / np.linalg.norm(system.C[self.rows], axis=1)[:, None]
        self.B, self.C = system.B[:, r:], system.C[r:]

        # by how much each entry of (A, B_w) changes over the span
        self._range = np.ptp(
            [
                self._of_speed(v)
                for v in np.linspace(span.low + 1e-3 * (span.high - span.low), span.high, 9)
            ],
            axis=0,
        )

        # one that hardly changes need not be followed more finely
        self._range = np.maximum(
            self._range, 1e-6 * np.abs(self._of_speed(self._middle)).max(axis=0)
        )

    @property
    def _middle(self) -> float:
        return (self.span.low + self.span.high) / 2

    def _open(self, speed: float) -> GeneralizedPlant:
        """(w, u) -> (z, y)."""
        small = free_mode_reduction(replace(self.plant, point=self.span.at(speed)), self.modes)
        model = open_model(small, self.tolerances or None, bool(self.tolerances))
        return apply_delay(model, self.lag, _PADE)

    def _of_speed(self, speed: float) -> np.ndarray:
        """A and the columns of w, z being unit rows of the states."""
        model = self._open(speed)
        system, r = model.system, len(model.w)
        Z, W = system.C[:r][self.rows], system.B[:, :r][:, self.rows]

        # C_z = diag(size) directions: w = delta C_z x = (delta directions x) size
        size = (Z * self.directions).sum(axis=1)
        if np.abs(Z - size[:, None] * self.directions).max(initial=0.0) > 1e-9 * np.abs(Z).max(
            initial=0.0
        ):
            raise InvalidInput(
                "a tolerance acts on other states at other speeds, which this proof does not cover"
            )
        return np.hstack([system.A, W * size])

    def controller(self, speed: float) -> StateSpace:
        return self.law.at(speed)

    def around(self, speed: float) -> tuple[np.ndarray, np.ndarray]:
        """What the controller adds to A, and B of (w, d)."""
        K = self.controller(speed)
        n = len(self.B)
        r = len(self.rows)

        # u = C_K x_K - D_K (C x + d),   x_K' = A_K x_K - B_K (C x + d)
        A = np.block([[-self.B @ K.D @ self.C, self.B @ K.C], [-K.B @ self.C, K.A]])
        # w enters through the polynomials of the plant, not here
        return A, np.hstack([np.zeros((n + K.n_states, r)), np.vstack([-self.B @ K.D, -K.B])])

    def wide(self, rows: np.ndarray) -> np.ndarray:
        return np.pad(rows, ((0, 0), (0, self.controller(self._middle).n_states)))

    def frozen(self, speed: float) -> StateSpace:
        """d -> y + d at one speed, without deviations."""
        # the plant's A beside what the controller adds; d alone of (w, d)
        system, (A, B) = self._open(speed).system, self.around(speed)
        n, C = len(self.B), self.wide(self.C)
        A[:n, :n] += system.A
        return StateSpace(A, B[:, len(self.rows) :], C, np.eye(len(C)))

    def cells(self) -> list[Cell]:
        low, high = self.span.low, self.span.high
        inner = self.law.knots(low, high, _CELLS)
        knots = sorted({low, high, *(v for v in inner if low < v < high)})
        return [cell for ends in pairwise(knots) for cell in self._cells(*ends, _HALVINGS)]

    def _cells(self, low: float, high: float, left: int) -> Iterator[Cell]:
        # Chebyshev's nodes on [0, 1], s = 0 at low
        s = (np.cos(np.pi * (np.arange(_NODES) + 0.5) / _NODES) + 1) / 2
        values = np.array([self._of_speed(low + (high - low) * share) for share in s])

        # sum_j s^j terms_j by least squares, of the lowest degree that is close at all nodes
        for degree in range(1, _POWERS + 1):
            terms, *_ = np.linalg.lstsq(
                np.vander(s, degree + 1, increasing=True), values.reshape(_NODES, -1), rcond=None
            )
            off = np.vander(s, degree + 1, increasing=True) @ terms - values.reshape(_NODES, -1)
            if (np.abs(off).max(axis=0) <= _STRAIGHT * self._range.ravel()).all():
                break
        else:
            if not left:
                raise InvalidInput(
                    f"the plant is bent near {low / TWO_PI:.4g} Hz; give its seals a smoother table"
                )
            middle = (low + high) / 2
            yield from self._cells(low, middle, left - 1)
            yield from self._cells(middle, high, left - 1)
            return

        # s^j = sum_{i >= j} C(i, j)/C(n, j) b_i(s): monomials into Bernstein coefficients
        bernstein = [
            [comb(i, j) / comb(degree, j) if j <= i else 0.0 for j in range(degree + 1)]
            for i in range(degree + 1)
        ]
        net = (np.array(bernstein) @ terms).reshape(degree + 1, 1, *values.shape[1:])

        # the controller is linear between the cell's ends; all of one degree, 2 at least
        (A0, B0), (A1, B1) = self.around(low), self.around(high)
        n = len(self.B)
        more = len(A0) - len(self.B)
        size = (max(2, degree + 1), 1)
        A = elevated(np.pad(net[..., :n], ((0, 0), (0, 0), (0, more), (0, more))), size)
        B = elevated(np.pad(net[..., n:], ((0, 0), (0, 0), (0, more), (0, len(self.C)))), size)

        # the span as -1 .. 1
        ends = (
            2 * (np.array([[low], [high]]) - self.span.low) / (self.span.high - self.span.low) - 1
        )
        yield Cell(
            A + elevated(np.stack([A0, A1])[:, None], size),
            B + elevated(np.stack([B0, B1])[:, None], size),
            ends,
        )


def check_speed(
    machine: Machine,
    span: SpeedSpan,
    law: LawLike,
    timing: Timing | None,
    rate: float,
    tolerances: bool = True,
    tell: Tell = lambda text: None,
) -> Checks:
    """Output sensitivity while the speed changes within the span at up to ``rate`` [rad/s^2], and
    over the tolerances as well.

    law: a schedule over speed or a fixed controller, sampled by ``timing``. Proofs are judged by
    the machine's requirement; one that cannot be had has the value inf and says why. Raises
    InvalidInput.
    """
    check_positive(rate, "the rate of the speed", "give the fastest run-up in rad/s^2")
    wanted = demand("maximum singular value of a sensitivity", machine.requirements)
    plant, lag = (
        assemble(machine, span.at((span.low + span.high) / 2)),
        0.0 if timing is None else timing.lag,
    )
    title = f"Output sensitivity proved while the speed changes at up to {rate:.4g} rad/s^2"
    checks, stable = [], True
    try:
        moving = moving_law(law, plant)
        if timing is None and moving.dt is not None:
            raise InvalidInput("the controller is sampled; state its sample rate")
        family: _Family | SampledFamily
        family, off, peaks = _chosen(plant, span, moving, timing)
        words = f"the worst of {_FROZEN} speeds"
        checks.append(
            information(
                "moving.speed.frozen",
                "Largest output sensitivity at a steady speed, found",
                float(peaks.max()),
                "-",
                words,
            )
        )
        tell(f"proving the loop {span.label}")
        # the span is -1 .. 1: rad/s^2 into 1/s
        slope = rate / ((span.high - span.low) / 2)
        if isinstance(family, SampledFamily):
            try:
                proof = proved_sampled(family.loop(rate), span.low, span.high, rate, tell=tell)
                beside = ""
            except NumericalFailure:
                if moving.dt is not None:
                    raise
                family, off, beside = _late(plant, span, moving, lag, peaks)
                proof = _proof(family, slope, tell)
        else:
            proof, beside = _proof(family, slope, tell), ""
        detail = _how(family, proof, off) + beside
        checks.append(
            judge("moving.speed.rate", title, proof.gamma * (1 + off), "-", wanted, detail)
        )
        varied = tolerances_around(plant) if tolerances else ()
        if varied:
            title += ", over the tolerances"
            if moving.dt is not None:
                raise InvalidInput(
                    "the controller is sampled; give the continuous one that it was made of"
                )
            beside = ""
            if timing is not None:
                family, off, beside = _late(plant, span, moving, lag, peaks)
            assert family.modes is not None
            family = _Family(plant, span, moving, lag, family.modes, varied)
            tell(
                f"proving the loop {span.label}, over {len(family.rows)} entries of the tolerances"
            )
            if not len(family.rows):
                raise NumericalFailure("none of the tolerances is one that this proof covers")
            proof = _proof(family, slope, tell)
            detail = f"{_how(family, proof, off)}; {_varied(family, varied)}{beside}"
            checks.append(
                judge(
                    "moving.speed.tolerances", title, proof.gamma * (1 + off), "-", wanted, detail
                )
            )
    except AmbroseError as failure:
        name = "moving.speed.tolerances" if len(checks) > 1 else "moving.speed.rate"
        checks.append(
            replace(judge(name, title, np.inf, "-", wanted, f"not proved: {failure}"), passed=False)
        )
        stable = not isinstance(failure, _Unstable)
    return Checks(span.label, stable, tuple(checks), notes=(REST,))


class _Unstable(NumericalFailure):
    """The loop is unstable at a steady speed."""


def _chosen(
    plant: Plant, span: SpeedSpan, law: MovingLaw, timing: Timing | None, lag: float = 0.0
) -> tuple[_Family | SampledFamily, float, np.ndarray]:
    """The smallest model within _SAME of the full plant at every steady speed, by how much it is
    off, and the full plant's peaks. With a timing as it runs, else continuous and ``lag`` [s] late.
    """
    speeds = np.linspace(span.low, span.high, _FROZEN)

    def family(modes: int | None) -> _Family | SampledFamily:
        if timing is not None:
            return SampledFamily(plant, span.at, law, timing, modes)
        assert modes is not None
        return _Family(plant, span, law, lag, modes, ())

    if timing is None:
        wanted = np.array([_full_peak(plant, span.at(v), law, lag) for v in speeds])
    else:
        full = family(None)
        wanted = np.array([_peak(full.frozen(v), v) for v in speeds])
    for modes in _MODES:
        chosen = family(modes)
        loops = [chosen.frozen(v) for v in speeds]
        peaks = np.array([hinf_norm(loop).value if is_stable(loop) else np.inf for loop in loops])
        off = float(np.abs(peaks / wanted - 1).max())
        if off < _SAME:
            return chosen, off, wanted
    raise NumericalFailure(
        f"the model with {modes} bending modes per plane is {off:.1%} off the full plant"
    )


def _late(
    plant: Plant, span: SpeedSpan, law: MovingLaw, lag: float, peaks: np.ndarray
) -> tuple[_Family, float, str]:
    """The continuous model with the mean delay, by how much it is raised, and words for that; peaks
    of the loop as it runs.
    """
    family, off, late = _chosen(plant, span, law, None, lag)
    better = float((peaks / late).max()) - 1
    words = "; continuous, with the mean delay, at steady speeds " + (
        f"{-better:.1%} or more above the loop as it runs"
        if better < 0
        else f"up to {better:.1%} below the loop as it runs, by which it is raised"
    )
    return cast(_Family, family), (1 + off) * max(1.0, 1 + better) - 1, words


def _peak(loop: StateSpace, speed: float) -> float:
    if not is_stable(loop):
        raise _Unstable(f"the loop is unstable at a steady {speed / TWO_PI:.4g} Hz")
    return hinf_norm(loop).value


def _full_peak(plant: Plant, point: OperatingPoint, law: MovingLaw, lag: float) -> float:
    full = assemble(plant.machine, point)
    K = law.at(point.speed)
    open_loop = apply_delay(open_model(full, None, False), lag, _PADE).system
    G = select(open_loop, list(full.named("u")), list(full.named("y")))

    # u = C_K x_K - D_K (C x + d): d -> y + d, on the full plant
    A = np.block([[G.A - G.B @ K.D @ G.C, G.B @ K.C], [-K.B @ G.C, K.A]])
    C = np.pad(G.C, ((0, 0), (0, K.n_states)))
    loop = StateSpace(A, np.vstack([-G.B @ K.D, -K.B]), C, np.eye(len(C)))
    return _peak(loop, point.speed)


def _proof(family: _Family, slope: float, tell: Tell) -> Proof:
    """Over the family's tolerances, if it has any."""
    Z, C = family.wide(family.directions), family.wide(family.C)
    pole = _POLE if len(Z) <= _MOST else None
    return proved_over_tolerances(family.cells(), C, Z, slope, pole=pole, tell=tell)


# two steps of the sampled proof rest on the largest of what was sampled, not on a bound
_MEASURED = (
    "what a parabola between speeds leaves of its matrices measured (twice the largest found "
    "counts), as is the motion within a sample (1.1 times)"
)


def _how(family: _Family | SampledFamily, proof: Proof, off: float) -> str:
    if isinstance(family, SampledFamily):
        delay_words = f", as it runs ({family.timing}), {_MEASURED}"
    else:
        delay_words = f", {1e6 * family.lag:.4g} us late" if family.lag else ""
    return (
        f"model with {family.modes} bending modes per plane{delay_words}, raised by the "
        f"{off:.2%} by which it is off the full plant at steady speeds; the inequality holds by "
        f"{proof.slack:.0e}, rounding {proof.rounding:.0e}"
    )


def _varied(family: _Family, varied: Sequence[Tolerance]) -> str:
    covered = family.covered
    left = [item.parameter for item in varied if item.parameter not in covered]
    how = "standing still" if len(family.rows) <= _MOST else "moving as they like"
    return f"{len(covered)} tolerances, {how}" + (
        f"; not varied: {', '.join(left)}" if left else ""
    )
