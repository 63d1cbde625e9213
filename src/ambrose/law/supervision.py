"""A controller scheduled over measured pressure under supervision: where the reading cannot be
trusted, a fixed one takes over.

Both run in every sample; the one that is not in charge is an observer of the currents that act
(Astrom & Wittenmark, Computer-Controlled Systems, 3.5: x+ = A x + B e + L (u - C x - D e)), and
what is left of the difference at the change fades away linearly. Nothing is proved of the change
itself: the dwell time is tried on the rig.
"""

import math
from dataclasses import dataclass, field
from enum import IntEnum
from itertools import pairwise

import numpy as np
from scipy.linalg import solve_discrete_are

from ambrose.core.checks import InvalidInput, NumericalFailure, check_positive, invalid, same_clock
from ambrose.core.sampling import c2d
from ambrose.core.scheduled import ScheduledSystem, interval_points
from ambrose.core.statespace import StateSpace
from ambrose.law.law import PRESSURE, LawLike, law_of
from ambrose.law.loop import match_axes
from ambrose.machine.machine import Machine

# E = A - I, B, C, D, L: sampled, with the gain that leads its states to the currents that act
Matrices = tuple[np.ndarray, ...]
_LONGEST = 3600.0  # s, after which a value counts as stuck: samples are counted in 32 bits
# points between two of the schedule where it is sampled; the sampled matrices are linear between
# them
_BETWEEN = 3
_RADIUS = 0.99  # of the slowest mode with which one that waits follows


class State(IntEnum):
    """Who is in charge: the schedule, or the fixed controller; while FALLING_BACK and RETURNING the
    difference fades.
    """

    SCHEDULED = 0
    FALLING_BACK = 1
    FIXED = 2
    RETURNING = 3


class Fault(IntEnum):
    """Why the reading of this sample is not trusted."""

    NONE = 0
    LOST = 1
    RANGE = 2
    JUMP = 3
    STUCK = 4
    DIVERGED = 5


WORDS = {
    Fault.LOST: "the reading is lost",
    Fault.RANGE: "the reading is out of range",
    Fault.DIVERGED: "reading and estimate differ",
    Fault.JUMP: "the reading moved faster than its rate",
    Fault.STUCK: "the reading is stuck",
}


@dataclass(frozen=True, slots=True)
class Limits:
    """What a reading has to keep to.

    low, high [Pa]: the schedule's range; margin [Pa]: how far beyond it a reading may be; rate
    [Pa/s]: its fastest change, and noise [Pa]: the largest step between two samples besides (inf:
    not watched); stuck [s]: how long the very same value may come (inf: not watched; for sensors
    whose last digit moves); band [Pa]: how far off the reading may be by the proof; dwell [s]: how
    long readings have to be good before the schedule returns; fade [s]: of the difference at a
    change. InvalidInput.
    """

    low: float
    high: float
    margin: float
    rate: float = math.inf
    noise: float = 0.0
    stuck: float = math.inf
    band: float = 0.0
    dwell: float = 0.2
    fade: float = 0.02

    def __post_init__(self) -> None:
        for name in ("margin", "noise", "band", "fade"):
            check_positive(
                getattr(self, name),
                f"{name} of the supervision",
                "give zero or more",
                zero_allowed=True,
            )
        for name in ("rate", "stuck"):
            if not getattr(self, name) > 0:
                raise invalid(
                    f"{name} of the supervision",
                    getattr(self, name),
                    "above zero",
                    "leave it out to watch nothing",
                )
        if math.isfinite(self.stuck) and self.stuck > _LONGEST:
            raise invalid(
                "stuck of the supervision",
                f"{self.stuck:g} s",
                f"at most {_LONGEST:g} s",
                "leave it out to watch nothing",
            )
        check_positive(
            self.dwell,
            "dwell of the supervision",
            "say how long readings have to be good, such as 0.2 s",
        )


@dataclass(slots=True)
class Supervisor:
    """The state machine, a few comparisons a sample. A jump, or a reading that left the estimate,
    is forgiven only by an estimate that agrees: a sensor that is off by a constant looks healthy
    afterwards.
    """

    limits: Limits
    dt: float
    state: State = State.SCHEDULED
    fault: Fault = Fault.NONE
    # [Pa] what the schedule follows; the lowest until a reading is trusted
    value: float = field(init=False)
    last: float = math.nan
    since: int = 0  # samples since it
    same: int = 0
    good: int = 0
    clock: int = 0
    latched: bool = False

    def __post_init__(self) -> None:
        self.value = self.limits.low

    def follow(
        self, scheduled: float, estimate: float = math.nan, half_width: float = math.inf
    ) -> State:
        """One sample: told, estimate and its 95 % half width [Pa] (NaN, inf: nothing is said)."""
        limits = self.limits
        known = math.isfinite(estimate) and math.isfinite(half_width) and half_width >= 0

        self.fault = self._fault(scheduled, known, estimate, half_width)
        if self.fault in (Fault.JUMP, Fault.DIVERGED):
            self.latched = True
        elif self.fault is Fault.NONE and known and half_width <= limits.band:
            self.latched = False

        trusted = self.fault is Fault.NONE and not self.latched
        self.good = self.good + 1 if trusted else 0
        if trusted:
            # a sharp estimate corrects the reading, as far as the proof's band allows
            trim = (
                min(max(estimate - scheduled, -limits.band), limits.band)
                if known and half_width <= limits.band
                else 0.0
            )
            self.value = min(max(scheduled + trim, limits.low), limits.high)

        self.clock += 1
        faded = self.clock * self.dt >= limits.fade
        if self.state in (State.SCHEDULED, State.RETURNING) and not trusted:
            self.state, self.clock = State.FALLING_BACK, 0
        elif self.state is State.FALLING_BACK and faded:
            self.state = State.FIXED
        elif self.state is State.FIXED and self.good * self.dt >= limits.dwell:
            self.state, self.clock = State.RETURNING, 0
        elif self.state is State.RETURNING and faded:
            self.state = State.SCHEDULED
        return self.state

    def _fault(self, scheduled: float, known: bool, estimate: float, half_width: float) -> Fault:
        limits = self.limits
        self.since += 1
        if not math.isfinite(scheduled):
            return Fault.LOST

        # what the rate allows since the last reading that was not lost
        step = abs(scheduled - self.last)  # NaN at the first one: no step
        allowed = limits.rate * self.dt * self.since + limits.noise
        self.last, self.since = scheduled, 0
        self.same = self.same + 1 if step == 0.0 else 0

        if not limits.low - limits.margin <= scheduled <= limits.high + limits.margin:
            return Fault.RANGE
        if step > allowed:
            return Fault.JUMP
        if self.same * self.dt >= limits.stuck:
            return Fault.STUCK
        if known and abs(scheduled - estimate) > limits.band + half_width:
            return Fault.DIVERGED
        return Fault.NONE


@dataclass(frozen=True, slots=True, eq=False)
class SupervisedLaws:
    """Schedule and fixed controller, sampled: x+ = x + E x + B e + L cut, u = C x + D e for errors
    e [m] of ``axes`` and currents u [A] within +-limit (p,) [A]; cut: what acts less u.

    schedule: E, B, C, D, L at every value of the grid (k,) [Pa], linear between; fixed: of the
    other one. start (n, m), (n, p): where the fixed one stands after errors and currents that have
    been there for long. unwinds: whether L is an anti-windup gain, which the one in charge takes as
    well while its currents are cut; an observer's moves every state, and a rotor that rests on its
    touchdown bearings would never get free. Raises NumericalFailure where one that waits would not
    follow.
    """

    grid: np.ndarray
    schedule: tuple[Matrices, ...]
    fixed: Matrices
    start: tuple[np.ndarray, np.ndarray]
    limit: np.ndarray
    axes: tuple[str, ...]
    sample_time: float
    delay: int = 1
    unwinds: bool = False

    def __post_init__(self) -> None:
        # linear between grid points: looked at half-way as well
        halfway = (
            tuple((a + b) / 2 for a, b in zip(*pair, strict=True))
            for pair in pairwise(self.schedule)
        )
        for E, _, C, _, L in (self.fixed, *self.schedule, *halfway):
            # waiting, with u what acts:   x+ = (I + E - L C) x + (B - L D) e + L u
            radius = max(np.abs(1 + np.linalg.eigvals(E - L @ C)), default=0.0)
            if not radius < 1:
                raise NumericalFailure(
                    f"a controller that waits would not follow the currents (radius {radius:g}); "
                    "use another one"
                )

    def at(self, value: float) -> Matrices:
        """The schedule at a pressure [Pa] of its range."""
        i = min(
            max(int(np.searchsorted(self.grid, value, side="right")) - 1, 0), len(self.grid) - 2
        )
        share = float((value - self.grid[i]) / (self.grid[i + 1] - self.grid[i]))
        return tuple(
            (1 - share) * a + share * b
            for a, b in zip(self.schedule[i], self.schedule[i + 1], strict=True)
        )


@dataclass(slots=True)
class SupervisedProgram:
    """Schedule, fixed controller and supervisor as one program for the rig (``ControlProgram``).

    tracking: whether the one that waits follows the currents that act. estimate: the seal monitor's
    pressure and half width [Pa], set by who runs one. changes: sample, state and fault at every
    change of state; limited: whether the last currents were cut.
    """

    laws: SupervisedLaws
    limits: Limits
    tracking: bool = True
    parameter: str = "pressure"
    estimate: tuple[float, float] = (math.nan, math.inf)
    changes: list[tuple[int, State, Fault]] = field(default_factory=list)
    limited: bool = False
    supervisor: Supervisor = field(init=False)
    _x: list[np.ndarray] = field(init=False)
    _carry: list[np.ndarray] = field(init=False)
    _left: np.ndarray = field(init=False)  # [A] of the difference at the last change
    _share: float = 0.0
    _charge: int = 0
    _count: int = 0

    def __post_init__(self) -> None:
        self.begin(np.zeros(len(self.laws.schedule[0][0])))

    def words(self) -> str:
        """What happened, for people: "fixed from 0.1001 s (the reading is lost), schedule again
        from 0.25 s".
        """
        sentences = []
        for sample, state, fault in self.changes:
            if state is State.FALLING_BACK:
                sentences.append(
                    f"fixed from {sample * self.sample_time:.4g} s "
                    f"({WORDS.get(fault, 'the reading was not trusted')})"
                )
            elif state is State.RETURNING:
                sentences.append(f"schedule again from {sample * self.sample_time:.4g} s")
        return ", ".join(sentences) or "schedule throughout"

    @property
    def sample_time(self) -> float:
        return self.laws.sample_time

    @property
    def delay(self) -> int:
        return self.laws.delay

    @property
    def range(self) -> tuple[float, float]:
        return float(self.laws.grid[0]), float(self.laws.grid[-1])

    @property
    def system(self) -> StateSpace:
        return self(self.supervisor.value)

    def __call__(self, value: float) -> StateSpace:
        """The schedule as it runs, frozen at a pressure [Pa] of its range, sampled."""
        axes, (low, high) = self.laws.axes, self.range
        E, B, C, D, _ = self.laws.at(min(max(value, low), high))
        return StateSpace(
            np.eye(len(E)) + E,
            B,
            C,
            D,
            [f"err_{axis}" for axis in axes],
            [f"u_{axis}" for axis in axes],
            self.sample_time,
        )

    @property
    def fault(self) -> Fault:
        """Why the last reading is not trusted."""
        return self.supervisor.fault

    @property
    def states(self) -> np.ndarray:
        """Of the schedule (n,)."""
        return self._x[0]

    def begin(self, states: np.ndarray) -> None:
        """The schedule in charge from its states (n,); the fixed one begins as if their currents
        had been there for long.
        """
        kind = self.laws.fixed[0].dtype
        self._x = [np.array(states, kind), np.zeros(len(self.laws.fixed[0]), kind)]
        self._carry = [np.zeros_like(x) for x in self._x]
        self._left, self._share, self._charge, self._count = (
            np.zeros(len(self.laws.limit), kind),
            0.0,
            0,
            0,
        )
        self.supervisor = Supervisor(self.limits, self.sample_time)
        self.changes.clear()

    def schedule(self, value: float) -> None:
        """The reading [Pa] of the next step; NaN: lost."""
        before = self.supervisor.state
        after = self.supervisor.follow(value, *self.estimate)
        if after is not before:
            self.changes.append((self._count, after, self.supervisor.fault))

    def step(self, errors: np.ndarray) -> np.ndarray:
        """Currents (a,) [A] from errors (a,) [m]."""
        supervisor, limit = self.supervisor, self.laws.limit
        laws = self.laws.at(supervisor.value), self.laws.fixed

        # the fixed one begins where these errors and currents bring it in the long run
        if self._count == 0 and self.tracking:
            first = laws[0][2] @ self._x[0] + laws[0][3] @ errors
            self._x[1] = self.laws.start[0] @ errors + self.laws.start[1] @ first

        outputs = [C @ x + D @ errors for (_, _, C, D, _), x in zip(laws, self._x, strict=True)]

        # at a change the currents go on where they were: left = wanted before - outputs now
        charge = 0 if supervisor.state in (State.SCHEDULED, State.RETURNING) else 1
        if charge != self._charge:
            self._left, self._charge = (
                outputs[1 - charge] + self._share * self._left - outputs[charge],
                charge,
            )

        # of which the share fades from 1 to 0
        passed, fade = supervisor.clock * self.sample_time, self.limits.fade
        self._share = 1 - passed / fade if passed < fade else 0.0

        wanted = outputs[charge] + self._share * self._left
        acting = np.clip(wanted, -limit, limit)
        self.limited = bool((acting != wanted).any())

        for i, (E, B, _, _, L) in enumerate(laws):
            added = E @ self._x[i] + B @ errors
            if i == charge and self.laws.unwinds:
                # in charge: what was cut off its own currents, the fading difference left out
                added += L @ (
                    np.clip(acting - self._share * self._left, -limit, limit) - outputs[i]
                )
            elif i != charge and self.tracking:
                # waiting: its currents follow those that act
                added += L @ (acting - outputs[i])
            added += self._carry[i]  # compensated: small increments are not lost
            total = self._x[i] + added
            self._carry[i], self._x[i] = added - (total - self._x[i]), total
        self._count += 1
        return acting


def supervised(
    law: LawLike,
    fallback: LawLike,
    machine: Machine,
    sample_time: float,
    limits: Limits | None = None,
    *,
    tracking: bool = True,
) -> SupervisedProgram:
    """The program for a machine, its laws sampled by Tustin's map; limits: None for
    ``machine_limits``. Raises InvalidInput.
    """
    schedule, other = check_pair(law, fallback)
    axes = machine.axes
    grid = interval_points(schedule.grid, _BETWEEN)
    laws = tuple(_sampled(match_axes(schedule.at(p), axes), sample_time) for p in grid.tolist())
    fixed = _sampled(match_axes(other, axes), sample_time)
    E, B, C, D, L = fixed

    # at rest 0 = E x + B e + L (u - C x - D e):   x = (L C - E)^-1 ((B - L D) e + L u)
    stands = np.linalg.inv(L @ C - E)

    most = [
        np.inf if b.max_current is None else b.max_current
        for b in machine.bearings
        for _ in range(2)
    ]
    pair = SupervisedLaws(
        grid, laws, fixed, (stands @ (B - L @ D), stands @ L), np.array(most), axes, sample_time
    )
    return SupervisedProgram(
        pair, supervision_limits(schedule, machine) if limits is None else limits, tracking
    )


def check_pair(law: LawLike, fallback: LawLike) -> tuple[ScheduledSystem, StateSpace]:
    """The schedule and the fixed controller that takes over from it. Raises InvalidInput for what
    cannot be supervised.
    """
    over, other = law_of(law), law_of(fallback).fixed
    schedule = over.schedule
    if schedule is None or over.scheduled_over is not PRESSURE:
        raise InvalidInput(
            "only a controller scheduled over pressure alone can have a fallback; make one with "
            "--pressures-bar"
        )
    if other is None:
        raise InvalidInput(
            "the fallback is scheduled itself; give a fixed controller, such as --method tuned "
            "makes"
        )
    return schedule, other


def supervision_limits(
    law: ScheduledSystem,
    machine: Machine | None,
    rate: float | None = None,
    band: float = 0.0,
    stuck: float = math.inf,
) -> Limits:
    """Limits of a schedule's readings: 5 % of the range beyond its ends, 1 % from sample to sample
    besides the rate [Pa/s] (None: the machine file's, or not watched); band [Pa], stuck [s] as in
    ``Limits``. Raises InvalidInput.
    """
    low, high = law.range
    rate = machine.operation.pressure_rate if rate is None and machine is not None else rate
    return Limits(
        low,
        high,
        0.05 * (high - low),
        math.inf if rate is None else rate,
        0.01 * (high - low),
        stuck=stuck,
        band=band,
    )


def _sampled(law: StateSpace, sample_time: float) -> Matrices:
    if law.dt is None:
        law = c2d(law, sample_time, method="tustin")
    elif not same_clock(law.dt, sample_time):
        raise invalid(
            "the sample time",
            f"{sample_time:g} s",
            f"the controller's own {law.dt:g} s",
            "leave it out",
        )
    return law.A - np.eye(law.n_states), law.B, law.C, law.D, tracking_gain(law.A, law.B, law.C)


def tracking_gain(A: np.ndarray, B: np.ndarray, C: np.ndarray) -> np.ndarray:
    """L (n, a) of x+ = A x + B e + L (u - C x - D e): the Kalman predictor of A / _RADIUS (Anderson
    & Moore, Optimal Control, 3.5: prescribed degree of stability), so that every mode dies away
    within about 100 samples. Raises NumericalFailure.
    """
    if not len(A):
        return np.zeros((0, len(C)))

    # x = scale x~, by the states' sizes under errors; outputs in one unit; A / _RADIUS
    size = np.linalg.norm(B, axis=1)
    scale = np.maximum(size, 1e-9 * size.max())
    faster, out = A * scale / scale[:, None] / _RADIUS, C * scale
    unit = max(float(np.abs(out).max()), np.finfo(float).tiny)
    out = out / unit

    # predictor of process noise 1e-6 I and unit noise of the outputs, in those units
    try:
        P = solve_discrete_are(faster.T, out.T, 1e-6 * np.eye(len(A)), np.eye(len(C)))
    except np.linalg.LinAlgError as error:
        raise NumericalFailure(
            "no gain makes this controller follow the currents that act; use another one"
        ) from error

    # L~ = _RADIUS faster P out' (out P out' + I)^-1:   A~ - L~ out = _RADIUS times a stable matrix
    gain = _RADIUS * np.linalg.solve(out @ P @ out.T + np.eye(len(C)), out @ P @ faster.T).T
    return np.asarray(scale[:, None] * gain / unit)
