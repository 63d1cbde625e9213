"""The seal monitor: a seal's coefficients against time from the running loop, with intervals, and
what they say.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from ambrose.annexes.scheduled.seal_monitor.estimator import BLOCK, Estimate, Window, block_sums
from ambrose.annexes.scheduled.seal_monitor.history import SealHistory, findings_of
from ambrose.annexes.scheduled.seal_monitor.model import SealModel, seal_model
from ambrose.annexes.scheduled.seal_monitor.signals import Filter, Signals, measuring_filter
from ambrose.core.arguments import names_wrong_types
from ambrose.core.checks import InvalidInput, check_positive, invalid
from ambrose.identification.data_quality.diagnosis import screened
from ambrose.identification.data_quality.excitation_fit import DOUBTS
from ambrose.identification.excitation import signal_rows
from ambrose.identification.findings import Code
from ambrose.identification.output_error.problem import check_machine
from ambrose.identification.parameters import nominal_values, reduced_plant
from ambrose.law.law import LawLike
from ambrose.machine.axial import across_the_shaft
from ambrose.machine.description import OperatingPoint
from ambrose.machine.machine import Machine
from ambrose.machine.seals import Seal, not_straight
from ambrose.record.record import Record

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
    names = (unknown,) if isinstance(unknown, str) else unknown
    paths = [f"seal.{watched.name}.{quantity}" for quantity in names or _usual(watched)]
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
    across_the_shaft(machine, "the seals are watched across it")
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
