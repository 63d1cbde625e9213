"""A supervised schedule on the rig with the seal monitor beside it: what the seal's forces say of
the pressure's reading.

The monitor's estimate is a mean over its fading memory, and is held against the mean of the reading
with the same weights. Their difference is the sensor's error, whatever the pressure did meanwhile;
the pressure now is the reading less that error. Where a reading was doubted (lost, out of range, a
jump) both begin anew. "alone", the estimate is told in place of a reading: a mean of the past, for
pressures that change slowly.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any, Literal, get_args

import numpy as np

from ambrose.annexes.scheduled.seal_monitor.estimator import Estimate
from ambrose.annexes.scheduled.seal_monitor.watch import (
    RATE,
    SHORT,
    SealMonitor,
    said,
    seal_monitor,
)
from ambrose.core.checks import InvalidInput, invalid
from ambrose.core.statespace import StateSpace
from ambrose.law.supervision import Fault, Limits, SupervisedProgram
from ambrose.machine.description import OperatingPoint
from ambrose.machine.machine import Machine
from ambrose.machine.seals import not_straight
from ambrose.rig.scenario import Scenario
from ambrose.rig.waveforms import waveforms

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
    if how not in get_args(Estimated):
        raise invalid("estimate", repr(how), " or ".join(get_args(Estimated)), "choose one of them")
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
            "say how far off the reading may be, such as 0.4 bar",
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
                f"no monitor tells the pressure of seal {seal.name!r}: {why.partition(';')[0]}; "
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
            "say how fast the pressure changes at most",
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
