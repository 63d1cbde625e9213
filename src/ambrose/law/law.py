"""Everything that controls, as one protocol; the only file that knows which kinds there are.

A law is fixed (one linear system), scheduled (matrices on a grid of speeds, pressures or both), a
function of what it changes with, or a running program. Who judges, simulates, identifies or exports
asks the law: for its linear system at an operating point, whether it is meant for one, what it
changes with. ``law_of`` makes a law of whatever has been given; a law itself stays as it is.
"""

from __future__ import annotations

import math
import os
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Protocol, cast, runtime_checkable

import numpy as np

from ambrose.core.checks import InvalidInput, invalid
from ambrose.core.scheduled import AND, ScheduledSystem
from ambrose.core.statespace import ControllerLike, StateSpace, as_statespace, is_system
from ambrose.machine.description import OperatingPoint
from ambrose.machine.machine import Machine
from ambrose.machine.part import Synchronous
from ambrose.model.plant import Plant
from ambrose.registry import registered, resolve

# A controller that exists as a running program: the rig hands it the errors of one sample and takes
# its currents.
#
# ``code.c.compiled`` makes one from the generated C code, so that what runs on the rig is what runs
# on the machine.


@runtime_checkable
class ControlProgram(Protocol):
    """What the rig asks of a program.

    sample_time [s]; delay [samples]: from the errors to the currents that act; system: its law
    between its limits in the program's own states, sampled, err_<axis> [m] to u_<axis> [A]: for the
    equilibrium at the start and the poles of the loop.
    """

    @property
    def sample_time(self) -> float: ...

    @property
    def delay(self) -> int: ...

    @property
    def system(self) -> StateSpace: ...

    def begin(self, states: np.ndarray) -> None:
        """Ready to go on from the states (n,) of ``system``."""

    def step(self, errors: np.ndarray) -> np.ndarray:
        """One sample: currents (a,) [A] from errors (a,) [m]."""


@runtime_checkable
class ScheduledProgram(ControlProgram, Protocol):
    """A program whose law changes with the speed [rad/s] or, where its attribute ``parameter`` says
    so, the pressure [Pa] or both ("speed and pressure", a tuple): it is told that before every
    step; called with a value it returns its law there, frozen, as ``system`` is at the present. One
    that is made for a range has besides ``range``, its lowest and highest value; of several tuples.
    """

    def schedule(self, value: Any) -> None:
        """Speed or pressure of the next step; NaN: not known."""

    def __call__(self, value: Any) -> StateSpace: ...


@runtime_checkable
class NativeProgram(ControlProgram, Protocol):
    """A program that the compiled rig calls by itself.

    entry: address of ``int f(void *first, const double *errors, const double *told, double
    *currents)``, [m], speed [rad/s] or what a ``ScheduledProgram`` is told, [A], and its first
    argument; both hold as long as the program does. A negative result ends the run.
    """

    @property
    def entry(self) -> tuple[int, int]: ...


@runtime_checkable
class AllAxesProgram(ControlProgram, Protocol):
    """A program of the radial axes and of the one along the shaft, the last of its inputs and
    outputs.

    parts: the laws of the radial axes and of that one; the states of ``system`` are theirs, one
    after the other.
    """

    @property
    def parts(self) -> tuple[StateSpace, StateSpace]: ...


# What a controller can be scheduled over: quantities of the operating point, by the names that the
# schedule states.


@dataclass(frozen=True, slots=True)
class Scheduling:
    """name and SI unit in a schedule, field of an OperatingPoint, unit in which people are told of
    it and its size.

    parts: of several at once, each by itself; a value is then a tuple, in their order.
    """

    name: str
    unit: str
    field: str = ""
    people: str = ""
    size: float = math.nan
    parts: tuple[Scheduling, ...] = ()

    @property
    def each(self) -> tuple[Scheduling, ...]:
        """Its parts, or itself alone."""
        return self.parts or (self,)

    def of(self, point: OperatingPoint) -> Any:
        """Its value [unit] at an operating point."""
        return (
            tuple(part.of(point) for part in self.parts)
            if self.parts
            else float(getattr(point, self.field))
        )

    def moved(self, point: OperatingPoint, value: Any) -> OperatingPoint:
        """The operating point with another value [unit] of it."""
        if self.parts:
            speed, pressure = value
            return replace(point, speed=speed, seal_pressure=pressure)
        return (
            replace(point, speed=value)
            if self.field == "speed"
            else replace(point, seal_pressure=value)
        )

    def words(self, value: Any) -> str:
        """A value [unit] for people: "140 Hz", "2.04 bar"."""
        if self.parts:
            return ", ".join(part.words(item) for part, item in zip(self.parts, value, strict=True))
        return f"{value / self.size:.6g} {self.people}"

    def number(self, value: Any) -> str:
        """A value with its SI unit: "880 rad/s"."""
        items = value if self.parts else (value,)
        return ", ".join(
            f"{item:.6g} {part.unit}" for part, item in zip(self.each, items, strict=True)
        )

    @property
    def plural(self) -> str:
        return AND.join(f"{part.name}s" for part in self.each)

    @property
    def rate_unit(self) -> str:
        return f"{self.unit}^2" if self.unit.endswith("/s") else f"{self.unit}/s"


SPEED = Scheduling("speed", "rad/s", "speed", "Hz", 2 * math.pi)
PRESSURE = Scheduling("pressure", "Pa", "seal_pressure", "bar", 1e5)
BOTH = Scheduling(
    AND.join((SPEED.name, PRESSURE.name)),
    AND.join((SPEED.unit, PRESSURE.unit)),
    parts=(SPEED, PRESSURE),
)
SCHEDULINGS = {item.name: item for item in (SPEED, PRESSURE, BOTH)}


def scheduling_named(name: str, unit: str | None = None, words: str = "") -> Scheduling:
    """The scheduling by its name; unit: that which is stated (None: none is); words: the same for
    people. Raises InvalidInput for anything that is no quantity of the operating point.
    """
    if name not in SCHEDULINGS or unit not in (None, SCHEDULINGS[name].unit):
        known = " or ".join(f"{item.name} [{item.unit}]" for item in SCHEDULINGS.values())
        raise invalid(
            "the scheduling parameter",
            words or (name if unit is None else f"{name} [{unit}]"),
            known,
            "make the schedule over one of them",
        )
    return SCHEDULINGS[name]


class Law(ABC):
    """What controls a machine, from errors [m] to currents [A].

    A kind of law states ``at`` and what of the rest is not as it stands here, which is a fixed,
    continuous law that nothing is known of besides. ``judge.result.Synthesis`` is a law with what
    was shown of it.
    """

    @property
    def inputs(self) -> tuple[str, ...]:
        """Names of its errors."""
        return self.at(OperatingPoint()).inputs

    @property
    def outputs(self) -> tuple[str, ...]:
        """Names of its currents."""
        return self.at(OperatingPoint()).outputs

    @property
    def sample_time(self) -> float | None:
        """Sample time [s] of a law that is sampled already; None: it is continuous."""
        return None

    @property
    def rate(self) -> float | None:
        """The sample rate [Hz] that it was designed for; None: it does not say."""
        return None

    @property
    def delay_samples(self) -> int | None:
        """Computing delay [samples] that it was designed for; None: it does not say."""
        return None

    @property
    def scheduled_over(self) -> Scheduling | None:
        """What it changes with; None: nothing. Raises InvalidInput for a schedule over anything
        that is no quantity of the operating point.
        """
        return None

    @property
    def fixed(self) -> StateSpace | None:
        """The one linear system that it is at every operating point; None: it is no such law."""
        return None

    @property
    def nominal(self) -> StateSpace | None:
        """The linear system for the plant that it was designed on; None: there is none."""
        return self.fixed

    @property
    def digest(self) -> str:
        """What tells it from any other, as hexadecimal digits; "" where it is not written down."""
        return ""

    @property
    def named(self) -> str:
        """What a page calls it: what it is, with its digest where it is written down."""
        return "not from a controller file"

    @property
    def synchronous(self) -> tuple[Synchronous, ...]:
        """The blocks beside it that act at the speed of rotation; most laws have none."""
        return ()

    def blocks_on(self, machine: Machine) -> tuple[Synchronous, ...]:
        """The blocks beside it on a machine: its own, else those of the machine file."""
        settings = machine.controller
        return self.synchronous or (() if settings is None else settings.synchronous)

    @property
    def thrust(self) -> Law | None:
        """The law of the thrust axis beside it, of one that holds both groups of axes."""
        return None

    @property
    def schedule(self) -> ScheduledSystem | None:
        """The matrices on a grid that it is, linear between neighbours; None: it is no such law."""
        return None

    @property
    def program(self) -> ControlProgram | None:
        """The program that runs it; None: it runs by its matrices."""
        return None

    @property
    def all_axes(self) -> AllAxesProgram | None:
        """The program of the radial axes and of the one along the shaft; None: it is no such
        law.
        """
        return None

    @property
    def range(self) -> tuple[Any, Any] | None:
        """The lowest and highest value [unit] of ``scheduled_over`` that it is made for; of several
        tuples; None: all.
        """
        return None

    @abstractmethod
    def at(self, point: OperatingPoint) -> StateSpace:
        """Its linear system, frozen at an operating point; of a program that between its limits.
        Raises InvalidInput outside the range of a schedule that refuses it.
        """

    def covers(self, plant: Plant) -> bool:
        """Whether it is meant for a plant's operating point: a schedule has a range, and one over
        speed a seal pressure that it was made at.
        """
        along, span = self.scheduled_over, self.range
        if along is None or span is None:
            return True
        low, high, value = (np.atleast_1d(x).astype(float) for x in (*span, along.of(plant.point)))
        slack = 1e-9 * high
        design = plant.machine.operation.design
        elsewhere = along is SPEED and plant.point.seal_pressure != design.seal_pressure
        return bool(((low - slack <= value) & (value <= high + slack)).all()) and not elsewhere

    def follows(self, one: Scheduling) -> bool:
        """Whether it changes with a quantity, alone or among others."""
        along = self.scheduled_over
        return along is not None and one in along.each

    def points(self, point: OperatingPoint) -> tuple[OperatingPoint, ...]:
        """The operating points of its grid, all else as at ``point``; of a law without a grid that
        point itself.
        """
        along, schedule = self.scheduled_over, self.schedule
        if along is None or schedule is None:
            return (point,)
        return tuple(along.moved(point, value) for value in schedule.values)

    def clamped(self, point: OperatingPoint) -> OperatingPoint:
        """The operating point as code takes it that is told the seal pressure: within the range,
        where the law follows the pressure.
        """
        if not self.follows(PRESSURE) or self.range is None:
            return point
        low, high = (float(np.atleast_1d(end)[-1]) for end in self.range)  # the pressure is last
        return replace(point, seal_pressure=min(max(point.seal_pressure, low), high))


def extension(verb: str) -> Any:
    """What is registered to be done with the blocks beside a law: "request", "design", "refuse",
    "loops", "check", "doubts", "program" or "unit". Raises InvalidInput where nothing is.
    """
    place = registered("beside").get(verb)
    if place is None:
        raise InvalidInput(
            "blocks beside a controller need ambrose.annexes.synchronous, which this installation "
            "lacks; leave them out"
        )
    return resolve(place)


# speed [rad/s], or what its attribute ``parameter`` says, -> the law there
LawAt = Callable[[Any], ControllerLike]
# what ``law_of`` makes a law of
LawLike = Law | ControllerLike | ScheduledSystem | ControlProgram | LawAt


@dataclass(frozen=True, slots=True, eq=False)
class FixedLaw(Law):
    """One linear system, continuous or sampled: a PID, a filter bank, an H-infinity or mu law."""

    system: StateSpace

    @property
    def sample_time(self) -> float | None:
        return self.system.dt

    @property
    def fixed(self) -> StateSpace:
        return self.system

    def at(self, point: OperatingPoint) -> StateSpace:
        return self.system


@dataclass(frozen=True, slots=True, eq=False)
class ScheduledLaw(Law):
    """Matrices on a grid of speeds, seal pressures or both."""

    matrices: ScheduledSystem

    @property
    def sample_time(self) -> float | None:
        return self.matrices.dt

    @property
    def inputs(self) -> tuple[str, ...]:
        return self.matrices.inputs

    @property
    def outputs(self) -> tuple[str, ...]:
        return self.matrices.outputs

    @property
    def scheduled_over(self) -> Scheduling:
        parameter, unit = self.matrices.parameter, self.matrices.unit
        return scheduling_named(parameter, unit, f"{parameter} [{unit}]")

    @property
    def schedule(self) -> ScheduledSystem:
        return self.matrices

    @property
    def range(self) -> tuple[Any, Any]:
        return self.matrices.range

    def at(self, point: OperatingPoint) -> StateSpace:
        return self.matrices.at(self.scheduled_over.of(point))


@dataclass(frozen=True, slots=True, eq=False)
class FunctionLaw(Law):
    """A function from what it changes with to the linear system there."""

    function: LawAt
    parameter: str = SPEED.name
    unit: str | None = None
    dt: float | None = None

    @property
    def sample_time(self) -> float | None:
        return self.dt

    @property
    def scheduled_over(self) -> Scheduling:
        return scheduling_named(self.parameter, self.unit)

    def at(self, point: OperatingPoint) -> StateSpace:
        return as_statespace(self.function(self.scheduled_over.of(point)))


@dataclass(frozen=True, slots=True, eq=False)
class ProgramLaw(Law):
    """A program such as compiled C code, fixed or, told what it follows, scheduled or
    supervised.
    """

    running: ControlProgram
    along: Scheduling | None = None
    span: tuple[Any, Any] | None = None

    @property
    def sample_time(self) -> float:
        return self.running.sample_time

    @property
    def scheduled_over(self) -> Scheduling | None:
        return self.along

    @property
    def program(self) -> ControlProgram:
        return self.running

    @property
    def all_axes(self) -> AllAxesProgram | None:
        return cast(AllAxesProgram, self.running) if hasattr(self.running, "parts") else None

    @property
    def range(self) -> tuple[Any, Any] | None:
        return self.span

    def at(self, point: OperatingPoint) -> StateSpace:
        if self.along is None:
            return self.running.system
        return cast(ScheduledProgram, self.running)(self.along.of(point))


def law_of(given: LawLike, *, functions: bool = True) -> Law:
    """The law that something is: itself, a system with A, B, C, D (of python-control, too), a
    schedule, a program, or a function of the speed.

    functions: whether a function is taken for one. Raises InvalidInput for anything else.
    """
    if isinstance(given, Law):
        return given
    if is_system(given):
        return FixedLaw(as_statespace(given))
    if isinstance(given, ScheduledSystem):
        return ScheduledLaw(given)
    if isinstance(given, ControlProgram):
        return _program_law(given)
    if functions and callable(given):
        # a function may say what it is one of, and at which rate
        parameter = getattr(given, "parameter", SPEED.name)
        return FunctionLaw(
            given, parameter, getattr(given, "unit", None), getattr(given, "dt", None)
        )
    if isinstance(given, str | os.PathLike):
        raise invalid(
            "the controller",
            repr(os.fspath(given)),
            "a StateSpace or a Synthesis",
            "read its file with read_controller",
        )
    return FixedLaw(as_statespace(given))


def _program_law(program: ControlProgram) -> ProgramLaw:
    """A program's law: one that can be called changes, with the speed where it does not say with
    what.
    """
    if not callable(program):
        return ProgramLaw(program)
    along = scheduling_named(getattr(program, "parameter", SPEED.name))
    return ProgramLaw(program, along, getattr(program, "range", None))
