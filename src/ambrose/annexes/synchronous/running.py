"""A controller with its synchronous blocks on the virtual rig: one program, with a key phasor of
its own.

The key phasor's pulses are those of the scenario's speed, to which the rig turns the rotor; windows
without pulses are drop-outs. What the blocks did is kept, every so many samples.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ambrose.annexes.synchronous.block_loop import running_law, synchronous_loop
from ambrose.core.checks import InvalidInput
from ambrose.core.sampling import c2d
from ambrose.core.scheduled import corners, grid_points, interval_points
from ambrose.core.statespace import StateSpace
from ambrose.law.law import Law
from ambrose.law.loop import Timing, match_axes
from ambrose.law.synchronous_block import BlockState, SynchronousBlock, SynchronousLaw, key_phasor
from ambrose.machine.description import OperatingPoint
from ambrose.machine.machine import Machine
from ambrose.machine.part import Synchronous
from ambrose.model.assemble import assemble
from ambrose.rig.scenario import Scenario

# A scheduled controller as it runs beside synchronous blocks on the virtual rig.
#
# It runs as its generated code does: sampled on a grid, its matrices linear between the grid's
# points at what it is told in every sample, in one and the same states. What is lost is the last
# one told, what is beyond the range its nearer end.


_BETWEEN = 3  # points between two of the grid at which the law is sampled


@dataclass(frozen=True, slots=True, eq=False)
class SampledSchedule:
    """x+ = A x + B e, u = C x + D e, each matrix linear between the points of a grid.

    axes: ascending values of each quantity; matrices: A, B, C, D at every point (k, ., .);
    parameter: what it is scheduled over, as a program states it.
    """

    axes: tuple[np.ndarray, ...]
    matrices: tuple[np.ndarray, ...]
    signals: tuple[tuple[str, ...], tuple[str, ...]]
    sample_time: float
    parameter: str

    def at(self, value: Any) -> StateSpace:
        """The law at a value, or at a tuple of several, within the grid or its nearer end."""
        told = np.atleast_1d(value).astype(float)
        inside = [np.clip(v, a[0], a[-1]) for v, a in zip(told, self.axes, strict=True)]
        index, share = corners(self.axes, np.array([inside]))
        A, B, C, D = (np.tensordot(share[0], M[index[0]], 1) for M in self.matrices)
        return StateSpace(A, B, C, D, *self.signals, self.sample_time)


def sampled_schedule(machine: Machine, law: Law, sample_time: float) -> SampledSchedule:
    """A schedule sampled by Tustin's map, its signals in the order of the machine's axes. Raises
    InvalidInput for a law without a grid.
    """
    along, schedule = law.scheduled_over, law.schedule
    if along is None or schedule is None:
        raise InvalidInput(
            "synchronous blocks are simulated with a fixed controller, or one scheduled on a "
            "grid; give its matrices on a grid, or leave the blocks out of its file"
        )
    axes = tuple(interval_points(axis, _BETWEEN) for axis in schedule.axes)
    design = machine.operation.design
    sampled = []
    for value in grid_points(axes):
        found = match_axes(law.at(along.moved(design, value)), machine.axes, repr(machine.name))
        sampled.append(found if found.dt is not None else c2d(found, sample_time, method="tustin"))
    matrices = tuple(np.array([getattr(one, name) for one in sampled]) for name in "ABCD")
    signals = tuple(sampled[0].inputs), tuple(sampled[0].outputs)
    return SampledSchedule(axes, matrices, signals, sample_time, along.name)


@dataclass(slots=True)
class SynchronousProgram:
    """A sampled law and synchronous blocks before it, as the rig runs a program.

    law: sampled, without its delay, errors [m] to currents [A] in the order of the machine's axes;
    block: Python (``SynchronousBlock``) or compiled code with the same ``step``; pulses (k,) [s]:
    of every sample (``key_phasor``); limits (a,) [A]: of the currents; enabled (k,): the switch
    (None: on). history: (sample, states, amplitudes, speed) every ``every`` samples.
    """

    law: StateSpace
    block: Any
    pulses: np.ndarray
    limits: np.ndarray
    gap: float = np.inf
    enabled: np.ndarray | None = None
    every: int = 50
    delay: int = 1
    history: list[tuple[int, tuple[int, ...], np.ndarray, float]] = field(default_factory=list)
    _x: np.ndarray = field(default_factory=lambda: np.zeros(0))
    _u: np.ndarray = field(default_factory=lambda: np.zeros(0))
    _k: int = 0

    def words(self) -> str:
        """For how long each block was on, in words."""
        told = np.array([states for _, states, _, _ in self.history]).reshape(len(self.history), -1)
        shares = (told == int(BlockState.ON)).mean(axis=0) if len(told) else np.zeros(0)
        shown = ", ".join(f"{share:.0%}" for share in shares) or "not"
        return f"synchronous blocks on for {shown} of the time"

    @property
    def sample_time(self) -> float:
        assert self.law.dt is not None
        return self.law.dt

    @property
    def system(self) -> StateSpace:
        return self.law

    def begin(self, states: np.ndarray) -> None:
        """Ready to go on from the states (n,) of the law, with all blocks off."""
        self._x, self._k = np.array(states, float), 0
        self._u = np.zeros(len(self.law.outputs))
        self.block.begin()
        self.history.clear()

    def step(self, errors: np.ndarray) -> np.ndarray:
        """One sample: currents (a,) [A] from errors (a,) [m]."""
        k, self._k = self._k, self._k + 1
        pulse = float(self.pulses[k]) if k < len(self.pulses) else -1.0
        contact = bool((np.abs(errors) > self.gap).any())
        saturated = bool((np.abs(self._u) >= self.limits).any())
        on = True if self.enabled is None else bool(self.enabled[k])
        c = self.block.step(pulse, errors, self._u, contact, saturated, on)
        e = errors + c
        u = self.law.C @ self._x + self.law.D @ e
        self._x = self.law.A @ self._x + self.law.B @ e
        self._u = np.clip(u, -self.limits, self.limits)
        if k % self.every == 0:
            self.history.append(
                (
                    k,
                    tuple(int(s) for s in self.block.states),
                    self.block.amplitudes(),
                    self.block.speed,
                )
            )
        return self._u


@dataclass(slots=True)
class ScheduledSynchronousProgram(SynchronousProgram):
    """The same program, its law that of a schedule: told what that is scheduled over before every
    step (``law.law.ScheduledProgram``).
    """

    over: SampledSchedule = field(kw_only=True)
    _told: Any = None

    @property
    def parameter(self) -> str:
        """What it is scheduled over."""
        return self.over.parameter

    @property
    def range(self) -> tuple[Any, Any]:
        """The lowest and the highest value told; of several tuples."""
        ends = [tuple(float(axis[k]) for axis in self.over.axes) for k in (0, -1)]
        low, high = ends if len(self.over.axes) > 1 else [end[0] for end in ends]
        return low, high

    def schedule(self, value: Any) -> None:
        """What the next step is told; NaN: it is lost."""
        if value != self._told and np.isfinite(value).all():
            self.law, self._told = self.over.at(value), value

    def __call__(self, value: Any) -> StateSpace:
        """The law at a value, frozen."""
        return self.over.at(value)


def beside_law(
    machine: Machine,
    law: Law,
    blocks: Sequence[Synchronous],
    scenario: Scenario,
    start: OperatingPoint,
    timing: Timing,
) -> SynchronousProgram:
    """The program that runs a law, fixed or scheduled on a grid, and synchronous blocks through a
    scenario; start: where it begins. Raises InvalidInput for a law that is a program or a function.
    """
    if law.program is not None:
        raise InvalidInput(
            "synchronous blocks are simulated with a controller's matrices, not with a program; "
            "leave them out, or export both to C and run that"
        )
    loop = synchronous_loop(machine, law, timing.rate, timing.delay_samples)
    sampled, dt = loop.controller(assemble(machine, start)), loop.timing.sample_time
    over = None if law.scheduled_over is None else sampled_schedule(machine, law, dt)
    return synchronous_program(machine, sampled, running_law(blocks, loop), scenario, over=over)


def synchronous_program(
    machine: Machine,
    law: StateSpace,
    blocks: SynchronousLaw,
    scenario: Scenario,
    *,
    block: Any = None,
    lost: Sequence[tuple[float, float]] = (),
    switched_off: Sequence[tuple[float, float]] = (),
    over: SampledSchedule | None = None,
) -> SynchronousProgram:
    """A program for ``virtual_rig.run`` of a scenario.

    law: sampled, err_<axis> to u_<axis> in the machine's order. block: what runs the blocks (None:
    in Python). lost: windows [s] without pulses; switched_off: windows in which the blocks are
    switched off. over: the schedule whose law is that at the start (None: it is fixed). Raises
    InvalidInput for another sample time.
    """
    if law.dt is None or abs(law.dt - blocks.sample_time) > 1e-9 * blocks.sample_time:
        raise InvalidInput(
            "the law and its synchronous blocks run at different sample times; sample the law first"
        )
    scenario = scenario.on(machine)
    count = int(np.ceil(scenario.duration / law.dt)) + 1
    times, speeds = scenario.speed_knots
    pulses = key_phasor(times, speeds, law.dt, count)
    t, enabled = np.arange(count) * law.dt, np.ones(count, bool)
    for start, end in lost:
        pulses[(t >= start) & (t < end)] = -1.0
    for start, end in switched_off:
        enabled[(t >= start) & (t < end)] = False
    limits = np.array(
        [
            np.inf if b.max_current is None else b.max_current
            for b in machine.bearings
            for _ in range(2)
        ]
    )
    gaps = [b.touchdown_gap for b in machine.bearings if b.touchdown_gap is not None]
    running = SynchronousBlock(blocks) if block is None else block
    limit = 0.95 * min(gaps, default=np.inf)
    if over is None:
        return SynchronousProgram(law, running, pulses, limits, limit, enabled)
    return ScheduledSynchronousProgram(law, running, pulses, limits, limit, enabled, over=over)
