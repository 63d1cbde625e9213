"""A controller that exists as a running program: the rig hands it the errors of one sample and
takes its currents.

``code.c.compiled`` makes one from the generated C code, so that what runs on the rig is what runs
on the machine.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol, runtime_checkable

import numpy as np

from ambrose.core.statespace import StateSpace


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
    step; called with a value it returns its law there, frozen, as ``system`` is at the present.
    """

    def schedule(self, value: Any) -> None:
        """Speed or pressure of the next step; NaN: not known."""

    def __call__(self, value: Any) -> StateSpace: ...


@runtime_checkable
class Ranged(Protocol):
    """What a scheduled program has besides that is made for a range."""

    @property
    def range(self) -> tuple[Any, Any]:
        """Its lowest and highest value; of several tuples."""


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


def entry_of(program: ControlProgram) -> tuple[int, int] | None:
    """Address and first argument of a ``NativeProgram``; None for any other."""
    return program.entry if isinstance(program, NativeProgram) else None


def teller(program: ControlProgram) -> Callable[[Any], None] | None:
    """What a ``ScheduledProgram`` is told its speed or pressure by; None for any other."""
    return program.schedule if isinstance(program, ScheduledProgram) else None
