"""The controller as it runs on the rig: sampled, delayed by its computing time, limited; and the
change to another one.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple, cast

import numpy as np

from ambrose.core.aliasing import continuous_poles
from ambrose.core.checks import check_positive, invalid, same_clock
from ambrose.core.sampling import c2d, delayed
from ambrose.core.statespace import StateSpace
from ambrose.law.law import SPEED, ControlProgram, LawLike, law_of
from ambrose.law.loop import DEFAULT, axis_order, machine_timing, match_axes
from ambrose.machine.description import OperatingPoint
from ambrose.machine.machine import Machine
from ambrose.rig.engine.products import by_address, compiled

# What happens once a control sample, compiled: the controller or a program in its place, and what
# the amplifiers are told.
#
# This module imports numba: import it only inside functions.


@compiled
def control(
    law: SampledLaw, drive: Any, k: int, y: Any, x: Any, held: Any, u: Any, err: Any, ahead: Any
) -> None:
    """One sample of the controller: err = r - y, u (a,) what acts now, held (a,) what acts later;
    ahead (m,) is scratch.
    """
    n, m = x.shape[0], y.shape[0]
    # e = r - y; with a delay of one sample what was computed last acts now
    for a in range(m):
        u[a] = held[a]
        err[a] = drive.reference[a, k] - y[a]
    for a in range(m):
        value = 0.0
        for j in range(n):
            value += law.C[a, j] * x[j]
        for j in range(m):
            value += law.D[a, j] * err[j]
        held[a] = min(max(value, -law.limit[a]), law.limit[a])

    # x_(k+1) = A x_k + B e_k
    for i in range(n):
        value = 0.0
        for j in range(n):
            value += law.A[i, j] * x[j]
        for j in range(m):
            value += law.B[i, j] * err[j]
        ahead[i] = value
    for i in range(n):
        x[i] = ahead[i]
    if law.delay == 0:
        for a in range(m):
            u[a] = held[a]


@compiled
def run_program(
    law: SampledLaw, program: Any, drive: Any, k: int, y: Any, held: Any, u: Any, err: Any
) -> int:
    """One sample of a program at an address: what it computes acts at the next one. Negative where
    it gave up.
    """
    m = y.shape[0]
    for a in range(m):
        u[a] = held[a]
        err[a] = drive.reference[a, k] - y[a]

    # signals: inputs (m), outputs (m), then what it is scheduled over; 8 bytes each
    for i in range(m):
        program.signals[i] = err[program.into[i]]
    for i in range(drive.told.shape[1]):
        program.signals[2 * m + i] = drive.told[k, i]
    at = program.place
    failed: int = by_address(program.address, program.first, at, at + 16 * m, at + 8 * m)
    for a in range(m):
        held[a] = min(max(program.signals[m + program.out[a]], -law.limit[a]), law.limit[a])
    return failed


@compiled
def command(drive: Any, work: Any, k: int, u: Any) -> None:
    """What the amplifiers are told: controller plus excitation; nothing without power."""
    for a in range(u.shape[0]):
        work.command[a] = (u[a] + drive.excitation[a, k]) * drive.powered[a, k]


_TOLD = 2  # at most: speed and pressure
_DOUBLES = ctypes.POINTER(ctypes.c_double)
_CALLBACK = ctypes.CFUNCTYPE(ctypes.c_int, ctypes.c_void_p, _DOUBLES, _DOUBLES, _DOUBLES)


class SampledLaw(NamedTuple):
    """x+ = A x + B e, u = C x + D e within +-limit (a,) [A], which acts ``delay`` samples later (0
    or 1).
    """

    A: np.ndarray
    B: np.ndarray
    C: np.ndarray
    D: np.ndarray
    limit: np.ndarray
    delay: int


class Program(NamedTuple):
    """A program as the compiled rig calls it; address 0: none.

    address, first: of a ``NativeProgram``; signals (2a + 2,): errors and currents in its order,
    what it is told; place: their address; into, out (a,): the rig's axis of each error, and where
    each axis' current is.
    """

    address: int
    first: int
    signals: np.ndarray
    place: int
    into: np.ndarray
    out: np.ndarray


NO_PROGRAM = Program(0, 0, np.zeros(0), 0, np.zeros(0, np.int64), np.zeros(0, np.int64))


class RunningProgram:
    """A program of any kind behind one address: compiled code as it is, Python by a callback."""

    __slots__ = ("_callback", "called", "failure")

    def __init__(self, program: ControlProgram, axes: tuple[str, ...]) -> None:
        self.failure: BaseException | None = None
        native = getattr(program, "entry", None)  # of a NativeProgram
        if native is None:
            # kept as long as the program runs: the address is that of the object
            self._callback = _CALLBACK(self._step_of(program, len(axes)))
            native = cast(int, ctypes.cast(self._callback, ctypes.c_void_p).value), 0
        address, first = native
        into = np.argsort(axis_order(program.system, "inputs", axes))
        out = np.asarray(axis_order(program.system, "outputs", axes))
        signals = np.zeros(2 * len(axes) + _TOLD)
        self.called = Program(
            address,
            first,
            signals,
            signals.ctypes.data,
            into.astype(np.int64),
            out.astype(np.int64),
        )

    def _step_of(self, program: ControlProgram, m: int) -> Callable[..., int]:
        tell = getattr(program, "schedule", None)  # of a ScheduledProgram
        along = law_of(program).scheduled_over or SPEED

        def step(first: object, errors: Any, told: Any, currents: Any) -> int:
            try:
                if tell is not None:
                    tell((told[0], told[1]) if along.parts else told[0])
                for a, value in enumerate(
                    np.asarray(program.step(np.array(errors[:m])), float).tolist()
                ):
                    currents[a] = value
            except (
                BaseException
            ) as error:  # told by who called the rig: nothing gets through compiled code
                self.failure = error
                return -1
            return 0

        return step


def sample_time(law: LawLike, machine: Machine, wanted: float | None) -> float:
    """The controller's own sample time [s], else the one wanted, else the machine's, else 0.1 ms.
    Raises InvalidInput.
    """
    law_time = law_of(law).sample_time
    if law_time is not None:
        if wanted is not None and not same_clock(law_time, wanted):
            raise invalid(
                "the sample time",
                f"{wanted:g} s",
                f"the controller's own {law_time:g} s",
                "leave it out",
            )
        return law_time
    if wanted is not None:
        return check_positive(wanted, "the sample time", "give it in seconds")
    return (machine_timing(machine) or DEFAULT).sample_time


def sampled_law(
    law: LawLike, machine: Machine, dt: float, point: OperatingPoint, delay: int
) -> SampledLaw:
    """The law at a sample time [s] and operating point: Tustin's map of a continuous controller, a
    sampled one as it is.

    Its signals are matched by ``law.loop.match_axes``. Raises InvalidInput where sizes or axes
    differ.
    """
    system = match_axes(law_of(law).at(point), machine.axes, repr(machine.name))
    if system.dt is None:
        system = c2d(system, dt, method="tustin")
    if delay > 1:  # the rig holds one sample back itself
        system = delayed(system, delay - 1)
    limits = [np.inf if b.max_current is None else b.max_current for b in machine.axis_bearings]
    A, B, C, D = of_one_type(system.A, system.B, system.C, system.D)
    return SampledLaw(A, B, C, D, np.array(limits, dtype=float), min(delay, 1))


def of_one_type(*arrays: np.ndarray) -> Iterator[np.ndarray]:
    """Copies that may be written, row by row: an order in memory or a lock against writing would be
    a type of its own, for which numba compiles the whole rig once more, for half a minute.
    """
    return (np.array(X, dtype=float, order="C") for X in arrays)


def take_over(law: SampledLaw, errors: np.ndarray, outputs: np.ndarray) -> np.ndarray:
    """The state x (n,) with which a law continues what another one did: it would have given the
    same last outputs.

    errors (a, k) [m] and outputs (a, k) [A] of the last k samples. The least-squares state k
    samples ago, of smallest size in what the samples do not tell, followed to the present.
    """
    n, k = len(law.A), errors.shape[1]
    if n == 0 or k == 0:
        return np.zeros(n)
    free, power = np.zeros(n), np.eye(n)
    observed, missing = [], []

    # u_i = C (A^i x_0 + free_i) + D e_i, free_i the state from zero: rows C A^i of x_0
    for i in range(k):
        observed.append(law.C @ power)
        missing.append(outputs[:, i] - law.C @ free - law.D @ errors[:, i])
        free = law.A @ free + law.B @ errors[:, i]
        power = law.A @ power
    matrix = np.vstack(observed)

    # columns to norm one; what the samples hardly tell falls under rcond and stays zero
    scale = np.linalg.norm(matrix, axis=0)
    scale[scale == 0] = 1.0
    start = np.linalg.lstsq(matrix / scale, np.concatenate(missing), rcond=1e-8)[0] / scale
    return free + power @ start


def closed_loop_poles(
    A: np.ndarray, B: np.ndarray, C: np.ndarray, law: SampledLaw, dt: float
) -> np.ndarray:
    """Poles [rad/s] of the linear loop around z' = A z + B u, y = C z with the law as it runs."""
    a = B.shape[1]
    sampled = c2d(StateSpace(A, B, C, np.zeros((len(C), a))), dt)
    Ad = sampled.A
    Bd = sampled.B
    Cd = sampled.C
    n = len(A)
    m = len(law.A)

    # states z, x and, with a delay, the held u; e = -y
    loop = np.zeros((n + m + a, n + m + a))
    loop[:n, :n] = Ad
    loop[n : n + m, :n], loop[n : n + m, n : n + m] = -law.B @ Cd, law.A
    out = np.hstack([-law.D @ Cd, law.C])  # u from (z, x)
    if law.delay:
        loop[:n, n + m :], loop[n + m :, : n + m] = Bd, out
    else:
        loop[:n, : n + m] += Bd @ out
        loop = loop[: n + m, : n + m]
    return continuous_poles(loop, dt, A)[0]
