"""What a run of the virtual rig leaves: its signals collected in memory and, while it runs, in a
file.
"""

from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np

from ambrose.core.checks import invalid
from ambrose.machine.criteria import CLEARANCE
from ambrose.machine.ordinary_file import LARGEST_SAMPLE
from ambrose.record.record import Record, signal_dimension
from ambrose.rig.engine.inputs import Drive, Plan
from ambrose.rig.engine.state import Rig
from ambrose.rig.scenario import LEVITATED, Scenario

# How a run of the virtual rig ended: touchdown as an outcome with its time and cause.


# a rotor that stays [s] within this part of the touchdown gaps, where zone C of ISO 14839-2 ends,
# counts as levitated
_CLEAR = 0.05
LEVITATED_WITHIN = CLEARANCE.limits[-1].value
_BEFORE = 0.05  # [s] before a touchdown in which currents at their limit count as its cause
_AT_LIMIT = 0.999  # of the limit: reached, but for rounding


# a motion beyond it has left all bounds; a thousandth of what a record holds, for what is derived
# from it
_BOUND = 1e-3 * LARGEST_SAMPLE


def within_bounds(log: np.ndarray) -> int:
    """How many rows of a log (k, columns) come before the first that is no number, or beyond all
    bounds.
    """
    usable = (np.abs(log) <= _BOUND).all(axis=1)  # NaN is not
    return len(log) if usable.all() else int(np.argmin(usable))


@dataclass(slots=True)
class Lift:
    """Since when a rotor that starts in contact is levitated, told stretch by stretch.

    near [s]: since when it is within ``LEVITATED_WITHIN`` without a break; share: the last one.
    """

    near: float | None = None
    share: float = 1.0

    def follow(self, time: np.ndarray, share: np.ndarray) -> float | None:
        """The time [s] from which it is levitated, None: not by the end of these samples. share
        (k,): of the way to the nearest touchdown bearing at the times (k,) [s].
        """
        if not len(time):
            return None
        self.share = float(share[-1])
        # runs of samples that are near: from after one that is far to before the next
        far = np.flatnonzero(share > LEVITATED_WITHIN)
        first, last = np.append(0, far + 1), np.append(far, len(time)) - 1
        begin = time[np.minimum(first, len(time) - 1)]
        begin[0] = begin[0] if self.near is None else self.near
        for i in np.flatnonzero((last >= first) & (time[last] - begin >= _CLEAR * (1 - 1e-9))):
            return float(begin[i])
        self.near = float(begin[-1]) if last[-1] >= first[-1] else None
        return None

    @property
    def missing(self) -> str:
        """Why it is not levitated, in words."""
        return (
            f"not within {LEVITATED_WITHIN:.0%} of the way to the touchdown bearings for "
            f"{1e3 * _CLEAR:g} ms; at the end at {self.share:.0%} of it"
        )


@dataclass(slots=True)
class Watch:
    """Follows a run stretch by stretch: contact in the touchdown bearings, controller outputs at
    their limit.

    lifted_at [s]: since when the rotor is levitated (``Lift``; 0: from the start; None: not
    yet). touched_at [s] and where: the first contact after that. contact [s]: how long any was
    touched after that, and when last. deepest [m]: the largest displacement in a touchdown bearing
    beyond its gap. ended [s]: the last sample that was followed.
    """

    rig: Rig
    lifted_at: float | None
    lift: Lift = field(default_factory=Lift)
    touched_at: float | None = None
    where: str = ""
    contact: float = 0.0
    last_contact: float = 0.0
    ended: float = 0.0
    deepest: float = 0.0
    limited: list[tuple[float, str]] = field(default_factory=list)
    # when the rotor first was beyond a magnet's air gap [s], and at which bearing
    inside: tuple[float, str] | None = None
    _dt: float = 0.0  # [s] of a sample

    def follow(self, task: Plan, number: int, log: np.ndarray) -> None:
        """One stretch: number of its first sample, log (k, columns) as kernel.py writes it."""
        a = len(self.rig.axes)
        self._dt = task.dt
        time = (number + np.arange(len(log))) * task.dt
        outputs, places = log[:, a : 2 * a].T, log[:, 4 * a : 5 * a].T
        gaps = self.rig.constants.touchdown[:, 0]
        distance = np.hypot(places[0::2], places[1::2])
        depth = distance - gaps[:, None]
        air = np.array([np.inf if b.gap is None else b.gap for b in self.rig.machine.bearings])
        if self.inside is None and (beyond := distance > air[:, None]).any():
            at = int(np.flatnonzero(beyond.any(axis=0))[0])
            self.inside = (
                float(time[at]),
                self.rig.machine.bearings[int(np.argmax(beyond[:, at]))].name,
            )
        touching = (depth > 0).any(axis=0)
        if self.lifted_at is None:
            self.lifted_at = self.lift.follow(time, (distance / gaps[:, None]).max(axis=0))
        after = (
            np.zeros(0, dtype=int)
            if self.lifted_at is None
            else np.flatnonzero(touching & (time >= self.lifted_at))
        )
        if self.touched_at is None:
            limit = np.array(
                [
                    np.inf if b.max_current is None else b.max_current
                    for b in self.rig.machine.bearings
                ]
            )
            stop = after[0] if len(after) else len(time)
            full = np.abs(outputs[:, :stop]) >= _AT_LIMIT * np.repeat(limit, 2)[:, None]
            for axis, row in zip(self.rig.axes, full, strict=True):
                if row.any():
                    self.limited.append((float(time[np.flatnonzero(row)[-1]]), axis))
        self.ended = float(time[-1]) if len(time) else self.ended
        if len(after):
            self.last_contact = float(time[after[-1]])
            if self.touched_at is None:
                self.touched_at = float(time[after[0]])
                self.where = self.rig.machine.bearings[int(np.argmax(depth[:, after[0]]))].name
            self.contact += len(after) * task.dt
            self.deepest = max(self.deepest, float(depth[:, after].max()))

    def until_lost(self, number: int, log: np.ndarray) -> np.ndarray:
        """The rows of a stretch that was followed, up to the one at which the rotor is beyond an
        air gap.
        """
        if self.inside is None:
            return log
        return log[: max(round(self.inside[0] / self._dt) - number, 0) + 1]

    def stopped_at(self, overflow: float | None) -> float | None:
        """When [s] the run ended early; overflow: when the motion left all bounds."""
        return overflow if self.inside is None else self.inside[0]


def watch(rig: Rig, scenario: Scenario) -> Watch:
    """A watch at the start of a scenario."""
    return Watch(rig, 0.0 if scenario.initial == LEVITATED else None)


def classify_outcome(
    monitor: Watch, scenario: Scenario, overflow: float | None, pole: complex | None
) -> tuple[str, str]:
    """The outcome ("completed", "touchdown", "not levitated" or "diverged") and the same in words.

    overflow [s]: when the motion left all bounds. pole [rad/s]: the rightmost of the linear
    loop.
    """
    modes = (monitor.rig.coordinates - 4) // 2
    loop = f"linear loop with {modes} bending mode{'' if modes == 1 else 's'} per plane"
    side = (
        "" if pole is None else f"; {loop}: rightmost pole {pole.real:.4g}{pole.imag:+.4g}j rad/s"
    )
    if overflow is not None:
        return (
            "diverged",
            f"diverged: the motion left all bounds at t = {overflow:.6g} s; the record ends "
            f"before{side}",
        )
    if monitor.inside is not None:
        at, where = monitor.inside
        # an unstable loop drives it there; of a stable one the magnet overcomes the contact
        why = (
            "the loop is unstable as it runs: another controller, rate or delay"
            if pole is not None and pole.real >= 0
            else "the magnet pulls it through the touchdown bearing; lower the current, or correct "
            "[bearing.touchdown] stiffness"
        )
        return (
            "diverged",
            f"diverged: at t = {at:.6g} s the rotor is beyond the air gap of bearing {where}, "
            f"where nothing can be, and the record ends there; {why}{side}",
        )
    if monitor.lifted_at is None:
        return (
            "not levitated",
            f"not levitated: the rotor is {monitor.lift.missing}{side}",
        )
    lifted = (
        "" if scenario.initial == LEVITATED else f", levitated since t = {monitor.lifted_at:.4g} s"
    )
    if monitor.touched_at is None:
        short = (
            ", only because it is short: the loop is unstable as it runs"
            if pole is not None and pole.real >= 0
            else ""
        )
        return "completed", f"completed without contact{lifted}{short}{side}"
    stay = (
        f"in contact for {monitor.contact:.3g} s, {monitor.deepest * 1e6:.3g} um beyond the gap at "
        "most"
    ) + _again(monitor, scenario)
    return (
        "touchdown",
        f"touchdown at {monitor.where} at t = {monitor.touched_at:.6g} s{lifted}: "
        f"{_cause(monitor, scenario, pole)}; {stay}",
    )


def _again(monitor: Watch, scenario: Scenario) -> str:
    """Whether the rotor floats again where the power returns."""
    if all(item.until is None for item in scenario.failures):
        return ""
    if monitor.ended - monitor.last_contact < _CLEAR:
        return "; not free of the touchdown bearings again"
    return f"; free again since t = {monitor.last_contact:.6g} s"


def _cause(monitor: Watch, scenario: Scenario, pole: complex | None) -> str:
    at = monitor.touched_at or 0.0
    failures = [item for item in scenario.failures if item.time <= at]
    if failures:
        last = failures[-1]
        what = (
            "the power of all amplifiers" if last.axis is None else f"the amplifier of {last.axis}"
        )
        return f"{what} failed {at - last.time:.4g} s before"
    limited = sorted({axis for time, axis in monitor.limited if time >= at - _BEFORE})
    stops = f"; controller output at its limit on {', '.join(limited)}" if limited else ""
    if pole is not None and pole.real > 0:
        return f"the loop is unstable, rightmost pole {pole.real:.4g}{pole.imag:+.4g}j rad/s{stops}"
    return f"driven there by the disturbances although the linear loop is stable{stops}"


_LARGEST = 100_000_000  # numbers in one record: 0.8 GB


class Recorder:
    """Takes the logs of one stretch after the other, keeps each ``every``-th sample; a context
    manager for the file's sake.

    Raises InvalidInput for ``every`` below 1 or so small that the record would be too large.
    """

    def __init__(
        self,
        task: Plan,
        every: int,
        seed: int,
        path: str | Path | None,
        beside: Plan | None = None,
    ) -> None:
        """beside: another rig that runs along, whose signals follow."""
        self.task = task
        self.every = every
        self.path = path
        self.names = (*_names(task), *(() if beside is None else _names(beside)))
        count = (task.samples - 1) // max(every, 1) + 1
        if every < 1 or count * len(self.names) > _LARGEST:
            requirement = f"at least 1, and so large that a record has {_LARGEST:g} numbers at most"
            remedy = f"the run has {task.samples} samples of {len(self.names)} signals"
            raise invalid("every", every, requirement, remedy)
        self.units = tuple(signal_dimension(name).unit for name in self.names)
        self.point = replace(task.rig.point, speed=float(task.speeds(np.zeros(1))[0]))
        self.notes = (("scenario", task.scenario.name), ("seed", str(seed)))
        self.values, self.filled = np.empty((len(self.names), count)), 0
        self._writer: Any = None
        self._stack = ExitStack()

    @property
    def rate(self) -> float:
        """Samples per second of the record [Hz]."""
        return 1 / (self.task.dt * self.every)

    def __enter__(self) -> Self:
        if self.path is not None:
            from ambrose.record.stream import RecordWriter

            name = self.task.rig.machine.name
            writer = RecordWriter(
                self.path, name, self.rate, self.names, self.units, self.point, notes=self.notes
            )
            self._writer = self._stack.enter_context(writer)
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._stack.__exit__(kind, error, trace)

    def add(
        self, number: int, drive: Drive, log: np.ndarray, *beside: tuple[Plan, Drive, np.ndarray]
    ) -> None:
        """One stretch: number of its first sample, what acted, log (k, columns); beside: the same
        of a rig that runs along.
        """
        parts = [(self.task, drive, log), *beside]
        rows = [row for part in parts for row in signals(*part, number)]
        first = (-number) % self.every
        count = len(range(first, len(log), self.every))
        kept = self.values[:, self.filled : self.filled + count]
        at = 0
        for some in rows:
            kept[at : at + len(some)] = some[:, first :: self.every]
            at += len(some)
        self.filled += count
        if self._writer is not None and count:
            self._writer.append(kept)

    def finish(self, outcome: str) -> Record:
        """The record, with the outcome in words among its notes."""
        if self._writer is not None:
            self._writer.note("outcome", outcome)
        values = (
            self.values
            if self.filled == self.values.shape[1]
            else self.values[:, : self.filled].copy()
        )
        values.flags.writeable = False  # a Record then takes it as it is
        notes = (*self.notes, ("outcome", outcome))
        return Record(
            self.task.rig.machine.name,
            self.rate,
            self.names,
            self.units,
            values,
            self.point,
            notes=notes,
        )


def _names(task: Plan) -> tuple[str, ...]:
    """The names of the signals in a record."""
    axes, scenario = task.rig.axes, task.scenario
    names = [f"{kind}_{a}" for kind in ("y", "u", "i", "f_magnet") for a in axes] + [
        f"q_{p}" for p in task.rig.port_names
    ]
    varying = ["speed"] * scenario.runs_up + ["p_seal"] * bool(scenario.pressures)
    varying += ["p_measured"] * bool(scenario.pressure_sensors)
    return (*names, *task.driven, *varying)


def signals(task: Plan, drive: Drive, log: np.ndarray, number: int) -> list[np.ndarray]:
    """All recorded signals of a stretch, a list of rows (some, k)."""
    k = len(log)
    rig = task.rig
    scenario = task.scenario
    sources = {"e": drive.excitation, "r": drive.reference, "d": drive.disturbance}
    rows = [log.T]
    driven = task.driven
    forces = [port for port in rig.port_names if f"f_{port}" in driven]
    for name in driven:
        kind, _, rest = name.partition("_")
        row = (
            drive.force[0, forces.index(rest)]
            if kind == "f"
            else sources[kind][rig.axes.index(rest)]
        )
        rows.append(row[None, :k])
    if scenario.runs_up:
        rows.append(drive.speed[None, :k])
    if scenario.pressures:
        rows.append(task.pressures((number + np.arange(k)) * task.dt)[None])
    if scenario.pressure_sensors:
        rows.append(drive.pressure[None, :k])
    return rows
