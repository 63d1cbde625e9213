"""A supervised schedule on the rig with the seal monitor beside it: what the seal's forces say of
the pressure's reading.

The monitor's estimate is a mean over its fading memory, and is held against the mean of the reading
with the same weights. Their difference is the sensor's error, whatever the pressure did meanwhile;
the pressure now is the reading less that error. Where a reading was doubted (lost, out of range, a
jump) both begin anew. "alone", the estimate is told in place of a reading: a mean of the past, for
pressures that change slowly.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np

from ambrose.annexes.scheduled.seal_monitor import (
    BLOCK,
    Direction,
    Estimate,
    SealHistory,
    SealModel,
    Window,
    block_sums,
    findings_of,
    seal_model,
)
from ambrose.core.checks import InvalidInput, as_several, check_positive, invalid, names_wrong_types
from ambrose.core.response import simulate
from ambrose.core.statespace import StateSpace
from ambrose.identification.data_quality.controller import DOUBTS
from ambrose.identification.data_quality.diagnosis import screened
from ambrose.identification.findings import Code, signal_rows
from ambrose.identification.output_error.problem import check_machine
from ambrose.identification.parameters import nominal_values, reduced_plant
from ambrose.law.law import LawLike
from ambrose.law.supervision import Fault, Limits, SupervisedProgram
from ambrose.machine.description import OperatingPoint
from ambrose.machine.machine import Machine
from ambrose.machine.part import Seal, not_straight
from ambrose.record.record import Record
from ambrose.rig.linear import waveforms
from ambrose.rig.scenario import Scenario

# From measured signals to the regression's: notch and high-pass on what is measured, then the
# filters of seal_monitor.py.
#
# All filters are linear, so that the notch on y, v and e is the same notch on the prediction error,
# the regressors and the instruments. The instruments are the regressors of a simulated loop, driven
# by the recorded excitation alone: no noise, gas force or unbalance is in them, and none biases the
# estimate (Soderstrom & Stoica 1983, Instrumental Variable Methods, sec. 5.3).


HIGH_PASS, NOTCH = 2 * np.pi * 5.0, 2 * np.pi * 4.0  # [rad/s]: corner; width of a notch


@dataclass(frozen=True, slots=True, eq=False)
class Filter:
    """Biquads in series on every signal: rows b0, b1, b2, a1, a2; settled after ``settling``
    [s].
    """

    sections: np.ndarray
    settling: float


def measuring_filter(speed: float, dt: float, harmonics: int = 3) -> Filter:
    """High-pass of second order and notches at 1x to ``harmonics`` x of speed [rad/s], as far as
    the samples carry them.
    """
    # Bilinear, s = (1 - z^-1)/(1 + z^-1) with tan(w dt/2) for w:   s^2/(s^2 + sqrt(2) c s + c^2)
    c = np.tan(HIGH_PASS * dt / 2)
    a0 = 1 + np.sqrt(2) * c + c * c
    rows = [[1 / a0, -2 / a0, 1 / a0, 2 * (c * c - 1) / a0, (1 - np.sqrt(2) * c + c * c) / a0]]

    # (s^2 + w^2)/(s^2 + beta s + w^2) at every harmonic
    tones = [k * speed for k in range(1, harmonics + 1) if HIGH_PASS < k * speed < 0.8 * np.pi / dt]
    for tone in tones:
        w, beta = np.tan(tone * dt / 2), np.tan(NOTCH * dt / 2)
        a0 = 1 + beta + w * w
        b1 = 2 * (w * w - 1) / a0
        rows.append([(1 + w * w) / a0, b1, (1 + w * w) / a0, b1, (1 - beta + w * w) / a0])

    # decay rates [1/s] of the high-pass and of a notch
    slowest = min([HIGH_PASS / np.sqrt(2), *[NOTCH / 2 for _ in tones]])
    return Filter(np.array(rows), 9.0 / slowest)


@dataclass(slots=True)
class Signals:
    """The regression's signals of successive stretches of a record; holds the filters' states
    between them.
    """

    model: SealModel
    filter: Filter
    _states: dict[str, np.ndarray] = field(default_factory=dict)

    def follow(self, y: np.ndarray, v: np.ndarray, e: np.ndarray) -> dict[str, np.ndarray]:
        """y (p, k) [m], command v = u + e (m, k) [A] and excitation e (m, k) [A] of the next
        stretch.

        Returns, whitened: error (p, k), r1 (q, p, k) and r2 (q q, p, k), doubts (c, p, k),
        instruments (q, p, k).
        """
        from scipy.signal import sosfilt

        s = self.filter.sections
        sos = np.hstack([s[:, :3], np.ones((len(s), 1)), s[:, 3:]])
        signals = np.vstack([y, v, e])
        if "filter" not in self._states:  # as if it had always been as it is now
            self._states["filter"] = np.zeros((len(sos), len(signals), 2))
            self._states["offset"] = np.r_[signals[: len(y) + len(v), 0], np.zeros(len(e))]
        filtered, self._states["filter"] = sosfilt(
            sos, signals - self._states["offset"][:, None], zi=self._states["filter"]
        )
        y, v, e = np.split(filtered, [len(y), len(y) + len(v)])

        model = self.model
        W = self.model.W
        C = self.model.C

        # x^+ = (A - L C) x^ + B v + L y,   e = y - C x^
        x = self._step("observer", model.observer, np.hstack([model.B, model.L]), np.vstack([v, y]))
        out = {"error": W @ (y - C @ x)}

        # phi_g driven by D_g x^ + N_g v
        parts = [self._driven(f"1 {g}", d, x, v) for g, d in enumerate(model.unknown)]
        out["r1"] = np.stack([W @ C @ part for part in parts])

        # phi_gh driven by D_g phi_h + D_gh x^ + N_gh v; g outside, h inside, as in ``squares``
        pairs = [(d, part) for d in model.unknown for part in parts]
        bent = [square.D @ x + square.N @ v for square in model.squares]
        twice = [self._driven(f"2 {i}", *pair, into=bent[i]) for i, pair in enumerate(pairs)]
        out["r2"] = np.stack([W @ C @ part for part in twice])

        doubts = [W @ C @ self._driven(f"doubt {c}", d, x, v) for c, d in enumerate(model.doubts)]
        out["doubts"] = np.stack(doubts) if doubts else np.zeros((0, *y.shape))

        # instruments: as r1, from the simulated loop that the excitation alone drives
        x, v = self._loop(e)
        out["instruments"] = np.stack(
            [W @ C @ self._driven(f"z {g}", d, x, v) for g, d in enumerate(model.unknown)]
        )

        return out

    def _driven(
        self,
        name: str,
        direction: Direction,
        x: np.ndarray,
        v: np.ndarray | None = None,
        into: np.ndarray | float = 0.0,
    ) -> np.ndarray:
        driven = into + direction.D @ x + (0 if v is None else direction.N @ v)
        return self._step(name, self.model.observer, np.eye(len(driven)), driven)

    def _step(self, name: str, A: np.ndarray, B: np.ndarray, u: np.ndarray) -> np.ndarray:
        """The states x (n, k) of x+ = A x + B u."""
        n = len(A)
        into = B @ u
        x = simulate(
            StateSpace(A, np.eye(n), np.eye(n), np.zeros((n, n)), dt=1.0),
            into,
            x0=self._states.get(name, np.zeros(n)),
        )
        # the state that the next stretch begins with
        self._states[name] = A @ x[:, -1] + into[:, -1]
        return x

    def _loop(self, e: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """States and command of the simulated loop."""
        model, law = self.model, self.model.law
        n, x = len(model.A), self._step("loop", *model.loop, e)
        # v = u + e = C_k x_k - D_k C x + e
        return x[:n], law.C @ x[n:] - law.D @ model.C @ x[:n] + e


# The seal monitor: a seal's coefficients against time from the running loop, with intervals, and
# what they say.


# [s], [s], [reference/s]
WINDOW = 2.0
SHORT = 0.25  # [s] window that notices a fast change, or half the long one
RATE = 0.01  # [1/s] how fast a seal may change, of its reference; assumed
# the seal may be another one than in the file, change, and not be told at all
_SETTLED = (Code.MOVING_POINT, Code.FAR_FROM_START, Code.NO_RESPONSE)
_STRETCH = 1.0  # [s] of the record worked on at once
OLD = 2.0  # windows: mean age of what an estimate rests on, beyond which nothing is said
WIDE = 1.0  # noise part of a half width, in units of the reference, beyond which nothing is said


@dataclass(slots=True)
class SealMonitor:
    """Follows a loop: two fading windows over the same signals; both begin anew where they
    disagree.
    """

    model: SealModel
    window: float = WINDOW
    rate: float = RATE
    harmonics: int = 3
    settling: float = field(init=False)
    filters: Filter = field(init=False)
    _signals: Signals = field(init=False)
    _long: Window = field(init=False)
    _short: Window = field(init=False)
    _left: dict[str, np.ndarray] | None = None
    _wait: int = field(init=False)

    def __post_init__(self) -> None:
        self.filters = measuring_filter(self.model.point.speed, self.model.dt, self.harmonics)
        self._signals, self.settling = Signals(self.model, self.filters), self.filters.settling
        self._wait = round(self.settling / self.model.dt)
        self.restart()

    def restart(self) -> None:
        """What was seen is forgotten; the filters go on."""
        q = len(self.model.unknown)
        c = len(self.model.doubts)
        step = self.block * self.model.dt
        self._long, self._short = (Window(q, c, size, step) for size in self.windows)

    @property
    def windows(self) -> tuple[float, float]:
        """Long and short memory [s]."""
        return self.window, min(SHORT, 0.5 * self.window)

    @property
    def waiting(self) -> int:
        """Samples until the filters have settled."""
        return self._wait

    @property
    def block(self) -> int:
        """Samples between two estimates."""
        return max(1, round(BLOCK / self.model.dt))

    def follow(self, y: np.ndarray, v: np.ndarray, e: np.ndarray) -> list[Estimate]:
        """One estimate per block of the next stretch: y (p, k) [m], command v = u + e (m, k) [A],
        excitation e (m, k) [A].
        """
        signals = self._signals.follow(y, v, e)

        # what comes while the filters settle is dropped
        skipped = min(self._wait, y.shape[1])
        self._wait -= skipped
        signals = {name: x[..., skipped:] for name, x in signals.items()}

        # whole blocks alone; the rest waits for the next stretch
        if self._left is not None:
            signals = {
                name: np.concatenate([self._left[name], x], axis=-1) for name, x in signals.items()
            }
        whole = signals["error"].shape[-1] // self.block * self.block
        self._left = {name: x[..., whole:] for name, x in signals.items()}

        sums = block_sums(signals, self.block)
        return [
            self._next({name: x[i] for name, x in sums.items()}) for i in range(len(sums["ze"]))
        ]

    def _next(self, block: Mapping[str, np.ndarray]) -> Estimate:
        kinds = np.unique(self.model.kinds, return_inverse=True)[1]
        for window in (self._long, self._short):
            window.add(block)
        long, short = (window.estimate(kinds, self.rate) for window in (self._long, self._short))
        if not (np.isfinite(long.noise).all() and np.isfinite(short.noise).all()):
            return long

        # the long window lags behind a seal that changes faster than ``rate``, the short one less
        apart = np.abs(long.theta - short.theta)
        if (apart > long.noise + 2 * short.noise).any():
            self.restart()
            return replace(self._long.estimate(kinds, self.rate), restarted=True)

        # below that, what they are apart beyond the short one's noise counts as change
        change = np.maximum(long.change, apart - short.noise)
        return replace(long, change=change, half_width=np.hypot(long.noise, long.known) + change)


def said(item: Estimate, window: float) -> bool:
    """Whether an estimate says anything: fresh, and sharper than the reference."""
    return bool(
        item.age < OLD * window and (item.noise < WIDE).all() and np.isfinite(item.half_width).all()
    )


@names_wrong_types
def seal_monitor(
    machine: Machine,
    controller: LawLike,
    point: OperatingPoint,
    dt: float,
    *,
    seal: str | None = None,
    unknown: str | Sequence[str] = (),
    window: float = WINDOW,
    rate: float = RATE,
    bending_modes: int = 3,
    computing_delay: int = 1,
    harmonics: int = 3,
    doubts: Mapping[str, float] | None = None,
) -> SealMonitor:
    """A monitor for samples every dt [s] at an operating point.

    seal: which one is watched (None: the only one); the others stay as the file has them at the
    point's pressure. unknown: "pressure" (the pressure that its forces tell), or some of K, k, C,
    c, the others as the file has them (none: the pressure where the seal's forces are a straight
    line over it, else k). window [s]: memory of the estimate; rate [1/s]: how fast the seal may
    change, in units of the reference; faster changes restart the window. doubts: relative half
    widths of "force_per_current", "negative_stiffness" and "amplifier" (None: 3 %, 0, 5 %). Raises
    InvalidInput.
    """
    check_positive(window, "window", "give the estimate's memory in seconds, such as 2")
    check_positive(
        rate, "rate", "say how fast the seal may change per second, such as 0.01", zero_allowed=True
    )
    watched = _watched(machine, seal)
    names = as_several(unknown) or _usual(watched)
    paths = [f"seal.{watched.name}.{quantity}" for quantity in names]
    model = seal_model(
        machine,
        controller,
        point,
        paths,
        dt,
        bending_modes=bending_modes,
        computing_delay=computing_delay,
        doubts=doubts,
    )
    return SealMonitor(model, window, rate, harmonics)


@names_wrong_types
def monitor(
    machine: Machine,
    controller: LawLike,
    record: Record,
    *,
    progress: Callable[[str], None] = lambda stage: None,
    **options: Any,
) -> SealHistory:
    """A seal's parameters against time from one record of the loop, with y_<axis>, u_<axis> and a
    small excitation e_<axis>.

    options: those of ``seal_monitor``. Raises InvalidInput.
    """
    check_machine(machine, record, "the record")
    watched = _watched(machine, options.get("seal"))
    missing = [
        name
        for name in (f"{kind}_{axis}" for kind in "yu" for axis in machine.axes)
        if name not in record.signals
    ]
    if missing:
        needs = "the monitor needs every displacement and command of the loop; record them"
        raise InvalidInput(f"the record has no {', '.join(missing)}; {needs}")
    following = seal_monitor(machine, controller, record.point, record.dt, **options)
    stretch = max(following.block, round(_STRETCH * record.sample_rate_hz))
    total = record.values.shape[1]
    if following.settling + 10 * BLOCK > total * record.dt:
        raise invalid(
            "the record's length",
            f"{total * record.dt:g} s",
            f"more than {following.settling + 10 * BLOCK:.2g} s",
            "the filters settle first; record longer",
        )
    progress("checking the record")
    faults = screened(
        machine,
        [record],
        controller,
        computing_delay=int(options.get("computing_delay", 1)),
        excited="",
        settled=_SETTLED,
        doubts={**DOUBTS, "seal": 1.0},
    )
    y, u = (np.stack([record[f"{kind}_{axis}"] for axis in machine.axes]) for kind in "yu")
    e = np.stack(signal_rows(record, [f"e_{axis}" for axis in machine.axes]))
    estimates: list[Estimate] = []
    for start in range(0, total, stretch):
        part = slice(start, start + stretch)
        estimates += following.follow(y[:, part], u[:, part] + e[:, part], e[:, part])
        if start and start % (20 * stretch) == 0:
            progress(f"{start * record.dt:.0f} of {total * record.dt:.0f} s")
    history = _history(machine, watched, following.model, following, record, estimates)
    return replace(history, findings=(*map(str, faults), *history.findings))


def _watched(machine: Machine, name: str | None) -> Seal:
    machine.across_the_shaft("the seals are watched across it")
    names = [item.name for item in machine.seals]
    if not names:
        raise InvalidInput(
            f"machine {machine.name!r} has no [[seal]], and nothing to watch; add the seal to the "
            "machine file"
        )
    if name is None and len(names) > 1:
        raise InvalidInput(
            f"machine {machine.name!r} has the seals {', '.join(names)}; name the one to watch "
            "(--seal)"
        )
    if name is not None and name not in names:
        raise invalid("seal", repr(name), f"one of {', '.join(names)}", "correct the name")
    return next(item for item in machine.seals if name in {None, item.name})


def _usual(seal: Seal) -> tuple[str, ...]:
    return ("k",) if not_straight(seal) else ("pressure",)


def _limits(machine: Machine, record: Record, path: str) -> tuple[float, float] | None:
    """From the lowest to the highest value that the file's operating points at the record's speed
    have with their tolerances, SI; the tolerance of k stands for the pressure's. None: no such
    point.
    """
    seal, quantity = path.rsplit(".", 1)
    near = [
        item
        for item in machine.operation.envelope
        if abs(item.speed - record.point.speed) <= 0.01 * item.speed
    ]
    ends: list[float] = []
    for point in near:
        if quantity == "pressure":
            value, wanted = point.seal_pressure, {path, f"{seal}.k"}
        else:
            value, wanted = (
                float(nominal_values(reduced_plant(machine, point, 0), [path])[0]),
                {path},
            )
        tolerances = [
            t
            for t in machine.tolerances
            if t.parameter in wanted and (not t.around or point.label in t.around)
        ]
        width = max(
            (
                abs(value) * (t.relative or 0.0) + (t.absolute or 0.0) * (t.parameter == path)
                for t in tolerances
            ),
            default=0.0,
        )
        ends += [value - width, value + width]
    return (min(ends), max(ends)) if ends and min(ends) < max(ends) else None


def _history(
    machine: Machine,
    seal: Seal,
    model: SealModel,
    following: SealMonitor,
    record: Record,
    estimates: Sequence[Estimate],
) -> SealHistory:
    step, q = following.block * model.dt, len(model.paths)
    time = record.start_time + following.settling + step * np.arange(1, len(estimates) + 1)

    def rows(name: str) -> np.ndarray:
        return (
            np.array([getattr(item, name) for item in estimates]).reshape(-1, q) * model.reference
        )

    values = rows("theta")
    half = rows("half_width")
    noise = rows("noise")
    ages = np.array([item.age for item in estimates])
    silent = ~(
        (ages < OLD * following.window)
        & (noise < WIDE * model.reference).all(axis=1)
        & np.isfinite(half).all(axis=1)
    )
    values[silent], half[silent] = np.nan, np.nan
    measured = None
    if "p_seal" in record.signals:
        at = np.clip(
            np.round((time - record.start_time) / model.dt).astype(int) - 1,
            0,
            record.values.shape[1] - 1,
        )
        measured = record["p_seal"][at]
    history = SealHistory(
        machine.name,
        seal.name,
        model.paths,
        time,
        values,
        half,
        noise,
        rows("known"),
        rows("change"),
        _apart(time[[item.restarted for item in estimates]].tolist(), following.window),
        model.reference,
        following.rate,
        following.window,
        following.settling,
        tuple(_limits(machine, record, path) for path in model.paths),
        measured,
        (),
        (),
    )
    findings, notes = findings_of(history, record.point.seal_pressure)
    return replace(history, findings=findings, notes=notes)


def _apart(times: Sequence[float], window: float) -> tuple[float, ...]:
    """The first of every group of times that follow one another within a window [s]."""
    before = (-np.inf, *times)
    return tuple(t for t, last in zip(times, before, strict=False) if t - last > window)


Estimated = Literal["beside", "alone"]
_MODES = 1  # bending modes per plane of the monitor's observer, as in its study
_NOTHING = (math.nan, math.inf)


@dataclass(slots=True)
class WatchedProgram:
    """A supervised program, Python or compiled code, and a monitor as one program for the rig
    (``ControlProgram``).

    begin_monitor: a new one; excitation (m, k) [A]: of every sample of the run; alone: the estimate
    is the reading where its half width is within the ``band`` [Pa]. seen: sample, estimate and half
    width [Pa] of every block of the monitor, NaN and infinity where it says nothing.
    """

    program: Any
    begin_monitor: Callable[[], SealMonitor]
    excitation: np.ndarray
    band: float
    alone: bool = False
    seen: list[tuple[int, float, float]] = field(default_factory=list)
    _monitor: SealMonitor = field(init=False)
    # y, v, e and the reading of every sample of the block
    _rows: list[np.ndarray] = field(init=False)
    _acting: np.ndarray | None = None
    _reading: float = math.nan  # what the program was told [Pa]
    _doubted: bool = False
    _mean: np.ndarray = field(init=False)  # sums of weights and of weighted readings
    # estimate, half width, mean of the reading
    _now: tuple[float, float, float] = (math.nan, math.inf, math.nan)
    _count: int = 0

    def __post_init__(self) -> None:
        self._begin()

    def _begin(self) -> None:
        self._monitor = self.begin_monitor()
        self._rows = []
        self._acting = None
        self._mean = np.zeros(2)
        self._doubted = False
        self._now = (*_NOTHING, math.nan)
        self._count = 0
        self.seen.clear()

    @property
    def sample_time(self) -> float:
        return float(self.program.sample_time)

    @property
    def delay(self) -> int:
        return int(self.program.delay)

    @property
    def parameter(self) -> str:
        return str(self.program.parameter)

    @property
    def system(self) -> StateSpace:
        law: StateSpace = self.program.system
        return law

    def __call__(self, value: float) -> StateSpace:
        """The schedule frozen at a pressure [Pa]."""
        law: StateSpace = self.program(value)
        return law

    def words(self) -> str:
        """What the supervision did, and of how much the monitor could speak."""
        spoke = sum(math.isfinite(half) for _, _, half in self.seen)
        if not self.excitation.any():
            return (
                f"{self.program.words()}; the monitor saw no excitation and said nothing: add "
                "e_<axis> to the scenario"
            )
        least = min((half for _, _, half in self.seen), default=math.inf)
        width = f", +-{least / 1e5:.3g} bar at best" if math.isfinite(least) else ""
        return (
            f"{self.program.words()}; the monitor spoke in {spoke} of {len(self.seen)} "
            f"blocks{width}"
        )

    def begin(self, states: np.ndarray) -> None:
        """Ready to go on from the schedule's states (n,)."""
        self._begin()
        self.program.begin(states)

    def schedule(self, value: float) -> None:
        """The reading [Pa] of the next step; NaN: lost."""
        estimate, half_width, mean = self._now
        if self.alone:
            self.program.estimate = _NOTHING
            scheduled_value = estimate if half_width <= self.band else math.nan
        else:
            self.program.estimate = (estimate + value - mean, half_width)
            scheduled_value = value
        self.program.schedule(scheduled_value)
        self._doubted |= not self.alone and self.program.fault in (
            Fault.LOST,
            Fault.RANGE,
            Fault.JUMP,
        )
        self._reading = scheduled_value

    def step(self, errors: np.ndarray) -> np.ndarray:
        """Currents (a,) [A] from errors (a,) [m]; the monitor has the currents that act at this
        sample.
        """
        currents: np.ndarray = self.program.step(errors)
        e = self.excitation[:, min(self._count, self.excitation.shape[1] - 1)]
        acting = currents if self._acting is None else self._acting
        self._rows.append(np.concatenate([-errors, acting + e, e, [self._reading]]))
        self._acting, self._count = currents, self._count + 1
        if len(self._rows) == self._monitor.waiting + self._monitor.block:
            self._judge()
        return currents

    def _judge(self) -> None:
        rows, m = np.array(self._rows).T, len(self.excitation)
        self._rows = []
        estimates = self._monitor.follow(rows[:-1][:m], rows[:-1][m : 2 * m], rows[:-1][2 * m :])
        for item in estimates:
            self._take(item, float(rows[-1][-self._monitor.block :].mean()))
        if self._doubted:
            self._monitor.restart()
            self._doubted = False
            self._mean = np.zeros(2)
            self._now = (*_NOTHING, math.nan)

    def _take(self, item: Estimate, reading: float) -> None:
        monitor = self._monitor
        fade = math.exp(-monitor.block * monitor.model.dt / monitor.window)
        self._mean = np.zeros(2) if item.restarted else fade * self._mean + np.array([1.0, reading])
        self._now = (*_NOTHING, math.nan)
        if said(item, monitor.window):
            reference = float(monitor.model.reference[0])
            mean = self._mean[1] / self._mean[0] if self._mean[0] else math.nan
            self._now = (
                float(item.theta[0]) * reference,
                float(item.half_width[0]) * reference,
                float(mean),
            )
        self.seen.append((self._count, *self._now[:2]))


def watched(
    program: SupervisedProgram,
    machine: Machine,
    scenario: Scenario,
    fixed: Any,
    point: OperatingPoint,
    how: Estimated,
    rate: float | None = None,
) -> WatchedProgram:
    """A supervised program with a monitor of the machine's only seal.

    fixed: the law whose loop the monitor simulates; point: where the machine runs; rate [Pa/s]: how
    fast the pressure changes at most, which an estimate "alone" has to be told. Raises
    InvalidInput.
    """
    if scenario.runs_up:
        raise InvalidInput(
            "the monitor watches at one speed, and the scenario changes it; leave the run-up or "
            "the estimate out"
        )
    if any(item.signal.startswith("r_") for item in scenario.all_windows):
        raise InvalidInput(
            "the monitor's excitation is a current, and the scenario moves references; drive "
            "e_<axis> instead"
        )
    if not program.limits.band > 0:
        raise invalid(
            "pressure_error",
            "0 Pa",
            "above zero with an estimate",
            "state the largest error of the reading, such as 0.4 bar",
        )
    rate = machine.operation.pressure_rate if rate is None else rate
    if how == "alone":
        _check_alone(rate, program.limits)
    if len(machine.seals) != 1:
        raise invalid(
            "the number of seals",
            len(machine.seals),
            "1 with an estimate of their pressure",
            "leave the estimate out",
        )
    for seal in machine.seals:
        if why := not_straight(seal):
            raise InvalidInput(
                f"no monitor estimates the pressure of seal {seal.name!r}: "
                f"{why.partition(';')[0]}; "
                "leave it out"
            )
    dt, rotating = (
        program.sample_time,
        point if scenario.speed is None else replace(point, speed=scenario.speed_at(0.0)),
    )
    first = seal_monitor(machine, fixed, rotating, dt, unknown="pressure", bending_modes=_MODES)
    allowed, window = RATE, first.window
    if how == "alone" and rate:  # a memory in which the pressure changes by half the band
        allowed, window = (
            rate / float(first.model.reference[0]),
            min(window, 0.5 * program.limits.band / rate),
        )

    def begin() -> SealMonitor:
        return SealMonitor(first.model, window, allowed, first.harmonics)

    excitation = _excitation(scenario, machine.axes, dt)
    return WatchedProgram(program, begin, excitation, program.limits.band, how == "alone")


def _check_alone(rate: float | None, limits: Limits) -> None:
    """A mean of the past follows a pressure only so fast, and is the same for a block of samples.
    Raises InvalidInput.
    """
    band = limits.band
    if math.isfinite(limits.stuck):
        raise invalid(
            "stuck_after",
            f"{limits.stuck:g} s",
            "left out with an estimate alone",
            "an estimate holds for a block",
        )
    if rate is None:
        raise invalid(
            "pressure_rate",
            "not given",
            "given with an estimate alone",
            "state the fastest change of the pressure",
        )
    if not rate * SHORT <= band:
        most = (
            f"at most {band / SHORT:g} Pa/s, the pressure's error within the monitor's short "
            f"memory of {SHORT:g} s"
        )
        raise invalid(
            "pressure_rate of an estimate alone",
            f"{rate:g} Pa/s",
            most,
            "a pressure that surges needs a sensor",
        )


def _excitation(scenario: Scenario, axes: tuple[str, ...], dt: float) -> np.ndarray:
    """The excitation currents (m, k) [A] of every sample of the scenario."""
    kinds = ("pulses", "sines", "stepped_sines", "chirps", "sequences")
    excitations: dict[str, Any] = {
        kind: tuple(x for x in getattr(scenario, kind) if x.signal.startswith("e_"))
        for kind in kinds
    }
    names, count = [f"e_{axis}" for axis in axes], int(scenario.duration / dt + 1e-6) + 1
    driven, cubics = waveforms(replace(scenario, unbalances=(), **excitations), names, dt, count)
    coefficients = np.zeros((len(names), count))
    coefficients[[names.index(name) for name in driven]] = cubics[0]
    return coefficients
