"""Sampling: zero-order hold and Tustin, with delay. States keep their meaning; the matrices are balanced for the work."""

from __future__ import annotations

from typing import Any, Literal

import numpy as np
import scipy.linalg as sla

from ambrose.core.checks import InvalidInput, check_positive, invalid, named_failure
from ambrose.core.realisation.balancing import balance
from ambrose.core.statespace import StateSpace, as_statespace, series, transfer_function

Method = Literal["zoh", "tustin"]


@named_failure("the sampled system")
def c2d(system: Any, dt: float, method: Method = "zoh", delay: float = 0.0, prewarp: float | None = None) -> StateSpace:
    """The sampled equivalent of a continuous system.

    dt [s]; ``zoh`` is exact for an input held between samples (plants), ``tustin`` the bilinear map (controllers), exact at
    the frequency ``prewarp`` [rad/s] if given; both to rounding (1e-11 of the largest sample of the impulse response).
    ``delay`` [s] acts on the input: any value for ``zoh`` (the fractional part exactly, Franklin, Powell & Workman 1998, sec.
    4.3.4), whole samples for ``tustin``. Raises InvalidInput.
    """
    system = as_statespace(system)
    if system.dt is not None:
        raise invalid("the system's dt", system.dt, "None (continuous)", "it is sampled already")
    check_positive(dt, "dt", "give the sample time in seconds")
    check_positive(delay, "delay", "give it in seconds", zero_allowed=True)
    whole = int(np.floor(delay / dt + 1e-9))
    fraction = max(delay - whole * dt, 0.0)
    if fraction < 1e-9 * dt:
        fraction = 0.0
    if method == "zoh":
        if prewarp is not None:
            raise invalid("prewarp", prewarp, "None with method 'zoh'", "use method='tustin'")
        sampled = _zoh(system, dt, fraction)
    elif method == "tustin":
        if fraction:
            raise invalid(
                "delay",
                f"{delay:g} s",
                f"a whole number of samples of {dt:g} s",
                "use method='zoh' for fractions",
            )
        sampled = _tustin(system, dt, prewarp)
    else:
        raise invalid("method", repr(method), "'zoh' or 'tustin'", "choose one of them")
    return delayed(sampled, whole)


def delayed(system: Any, samples: int) -> StateSpace:
    """A sampled system that receives its input ``samples`` samples late."""
    system = as_statespace(system)
    names, one = system.inputs, np.eye(len(system.inputs))
    for _ in range(samples):
        system = series(StateSpace(0 * one, one, one, 0 * one, names, names, system.dt), system)
    return system


def _zoh(system: StateSpace, dt: float, fraction: float) -> StateSpace:
    A, B, C, D = system.A, system.B, system.C, system.D
    early, gain_early = _held(A, B, dt - fraction)  # the part of the interval in which the newest input acts
    if fraction == 0.0:
        return StateSpace(early, gain_early, C, D, system.inputs, system.outputs, dt)
    n, m = B.shape
    late, gain_late = _held(A, B, fraction)
    return StateSpace(
        np.block([[early @ late, early @ gain_late], [np.zeros((m, n + m))]]),
        np.vstack([gain_early, np.eye(m)]),
        np.hstack([C, D]),
        np.zeros_like(D),
        system.inputs, system.outputs, dt,
    )  # fmt: skip


def _held(A: np.ndarray, B: np.ndarray, time: float) -> tuple[np.ndarray, np.ndarray]:
    """exp(A t) and the integral of exp(A s) B over 0..t, from one exponential (Van Loan 1978) of the balanced matrix.

    B is scaled to the size of A: without both scalings large entries cost as many squarings, and digits.
    """
    n, m = B.shape
    A, t = balance(A)
    B = B / t[:, None]
    size = np.exp2(np.round(np.log2(max(_size(A), 1 / time) / max(_size(B), 1e-280))))
    E = sla.expm(np.block([[A, B * size], [np.zeros((m, n + m))]]) * time)
    return E[:n, :n] * t[:, None] / t, E[:n, n:] * t[:, None] / size


def _size(X: np.ndarray) -> float:
    return float(np.abs(X).sum(axis=0).max(initial=0.0))


def _tustin(system: StateSpace, dt: float, prewarp: float | None) -> StateSpace:
    half = dt / 2
    if prewarp is not None:
        check_positive(prewarp, "prewarp", "give a frequency in rad/s")
        if prewarp * dt >= np.pi:
            raise invalid("prewarp", f"{prewarp:g} rad/s", f"below Nyquist {np.pi / dt:g} rad/s", "sample faster")
        half = np.tan(prewarp * dt / 2) / prewarp
    n = system.n_states
    A, t = balance(system.A)
    B, C = system.B / t[:, None], system.C * t
    if n and np.abs(1 - half * np.linalg.eigvals(A)).min() < 1e-12:
        raise InvalidInput(f"a pole at {1 / half:g} rad/s (2/dt) has no Tustin equivalent; change the sample time")
    E = np.eye(n) - half * A
    Ad = np.linalg.solve(E, np.eye(n) + half * A)
    Bd = np.linalg.solve(E, B) * 2 * half
    CE = np.linalg.solve(E.T, C.T).T
    D = system.D + half * CE @ B
    return StateSpace(Ad * t[:, None] / t, Bd * t[:, None], CE / t, D, system.inputs, system.outputs, dt)


def hold(omega: np.ndarray, dt: float) -> np.ndarray:
    """Zero-order hold over dt [s] at omega (w,) [rad/s], unit gain at zero frequency: sinc(w T/2) exp(-j w T/2), (w,)."""
    half = omega * dt / 2
    return np.sinc(half / np.pi) * np.exp(-1j * half)


def pade(delay: float, order: int, input: str = "u1", output: str = "y1") -> StateSpace:
    """All-pass approximation of a pure delay [s] (diagonal Pade), for continuous loop models."""
    check_positive(delay, "delay", "leave the delay out if there is none")
    if not isinstance(order, int | np.integer) or not 1 <= order <= 12:
        raise invalid("order", order, "a whole number from 1 to 12", "2 suits a delay of one sample")
    c = np.ones(order + 1)
    for k in range(1, order + 1):
        c[k] = c[k - 1] * (order - k + 1) / (k * (2 * order - k + 1))
    powers = np.arange(order + 1)
    denominator = (c * delay**powers)[::-1]
    return transfer_function(denominator * (-1.0) ** powers[::-1], denominator, input, output)
