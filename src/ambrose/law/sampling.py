"""A controller's sampled matrices (core/sampling.py has the methods), in modal form; of a schedule
at every grid point.

A slow pole is 1 - 1e-7 once sampled, which leaves A nine digits; so A - I is computed from the
continuous matrices and kept beside the system.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from ambrose.core.checks import SAME_CLOCK, check_positive, invalid, same_clock
from ambrose.core.realisation.modal_form import modal_form
from ambrose.core.sampling import Method, c2d
from ambrose.core.scheduled import ScheduledSystem, grid_points
from ambrose.core.statespace import StateSpace, poles

_TINY = 2.0**-150  # weight of the states among the outputs, from which the transform is read
_RESIDUAL = 1e-8  # relative: what going to the block form and back may cost A
_FREQUENCIES = 200  # up to 0.98 of the Nyquist frequency


def whole_samples(delay: float, sample_time: float) -> int:
    """``delay`` [s] as a number of samples. Raises InvalidInput for a fraction."""
    check_positive(delay, "the computing delay", "give it in seconds", zero_allowed=True)
    count = round(delay / sample_time)
    if abs(delay - count * sample_time) > SAME_CLOCK * max(count, 1) * sample_time:
        remedy = "round it up: outputs are written when the next sample is taken"
        raise invalid(
            "the computing delay",
            f"{delay:g} s",
            f"a whole number of samples of {sample_time:g} s",
            remedy,
        )
    return count


def check_rate(source: StateSpace | ScheduledSystem, dt: float) -> None:
    """Refuse a sample time [s] that is too long for a continuous controller's fastest pole, which
    must lie below half the sample rate, and one that is not a sampled controller's own. Raises
    InvalidInput.
    """
    if source.dt is not None:
        if not same_clock(source.dt, dt):
            raise invalid(
                "the sample time",
                f"{dt:g} s",
                f"the controller's {source.dt:g} s",
                "it is sampled already",
            )
        return
    for K in source.systems if isinstance(source, ScheduledSystem) else (source,):
        needed = float(np.abs(poles(K)).max(initial=0.0) / np.pi)
        if 1 / dt < needed:
            remedy = (
                f"sample at {needed:.4g} Hz or more, or roll the controller off below "
                f"{np.pi / dt:.4g} rad/s"
            )
            fastest = f"{needed * np.pi:.4g} rad/s"
            raise invalid(
                "the sample rate",
                f"{1 / dt:.4g} Hz",
                f"at least {needed:.4g} Hz for a pole at {fastest}",
                remedy,
            )


def sample_controller(
    source: StateSpace, dt: float, method: Method, prewarp: float | None
) -> tuple[StateSpace, np.ndarray, tuple[int, ...]]:
    """The sampled controller in modal form, its A - I (n, n) and the sizes of its blocks. Raises
    InvalidInput.
    """
    check_rate(source, dt)
    form = modal_form(source)
    K, n = form.system, form.system.n_states
    if source.dt is not None:
        return K, K.A - np.eye(n), form.sizes

    sampled = c2d(K, dt, method, prewarp=prewarp)

    # A - I of a block-diagonal A is block diagonal: rounding outside the blocks is cut
    inside = np.zeros((n, n), bool)
    for start, k in zip(form.starts, form.sizes, strict=True):
        inside[start : start + k, start : start + k] = True
    increment = np.where(inside, _increment(K, dt, method, prewarp), 0.0)
    A = np.eye(n) + increment
    return (
        StateSpace(A, sampled.B, sampled.C, sampled.D, source.inputs, source.outputs, dt),
        increment,
        form.sizes,
    )


def sample_schedule(
    source: ScheduledSystem, dt: float, method: Method, prewarp: float | None
) -> tuple[ScheduledSystem, np.ndarray]:
    """The schedule sampled at its grid points, in its own states, and A - I (k, n, n) there. Raises
    InvalidInput.
    """
    check_rate(source, dt)
    n, eye = source.n_states, np.eye(source.n_states)
    if source.dt is not None:
        return source, np.array([s.A - eye for s in source.systems])
    increments = [_increment(K, dt, method, prewarp) for K in source.systems]
    sampled = [c2d(K, dt, method, prewarp=prewarp) for K in source.systems]
    systems = tuple(
        StateSpace(eye + E, K.B, K.C, K.D, source.inputs, source.outputs, dt)
        for E, K in zip(increments, sampled, strict=True)
    )
    return replace(source, systems=systems), np.array(increments).reshape(len(systems), n, n)


def _increment(K: StateSpace, dt: float, method: Method, prewarp: float | None) -> np.ndarray:
    """A - I (n, n) of the sampled K: A times what the held identity adds to the states."""
    n, eye = K.n_states, np.eye(K.n_states)
    # its A is that of the hold
    method, prewarp = ("zoh", None) if method == "matched" else (method, prewarp)
    # zoh: e^{A dt} - I = A int_0^dt e^{A s} ds, and the integral is B of the held identity
    return (
        K.A @ c2d(StateSpace(K.A, eye, eye, np.zeros((n, n))), dt, method, prewarp=prewarp).B
        if n
        else np.zeros((0, 0))
    )


def common_states(source: ScheduledSystem) -> tuple[ScheduledSystem, tuple[int, ...]]:
    """The schedule in the modal states of its middle grid point, the same at every point, and the
    sizes of their blocks.

    Where the transform is too ill-conditioned to give the other points back to 1e-8, the states
    stay as they are.
    """
    n = source.n_states
    if n == 0:
        return source, ()
    middle = source.systems[len(source.systems) // 2]

    # x = X x_modal: the outputs _TINY x of the modal form are _TINY X x_modal
    outputs = np.vstack([middle.C, _TINY * np.eye(n)])
    form = modal_form(
        StateSpace(
            middle.A, middle.B, outputs, np.zeros((len(outputs), len(source.inputs))), dt=middle.dt
        )
    )
    X = form.system.C[len(middle.C) :] / _TINY
    inverse = np.linalg.inv(X)

    # (X^-1 A X, X^-1 B, C X) at every grid point
    moved = [
        StateSpace(inverse @ s.A @ X, inverse @ s.B, s.C @ X, s.D, s.inputs, s.outputs, s.dt)
        for s in source.systems
    ]

    # what going there and back costs A, relative to its largest entry
    residual = max(
        np.abs(X @ new.A @ inverse - old.A).max() / max(np.abs(old.A).max(), 1e-300)
        for new, old in zip(moved, source.systems, strict=True)
    )
    return (
        (replace(source, systems=tuple(moved)), form.sizes)
        if residual <= _RESIDUAL
        else (source, (1,) * n)
    )


def interpolation_deviation(
    source: ScheduledSystem,
    sampled: ScheduledSystem,
    dt: float,
    method: Method,
    prewarp: float | None,
) -> tuple[float, Any]:
    """The largest distance [-], and where, between interpolating before and after sampling,
    half-way between grid points; relative to the gain at the same frequency.
    """
    if source.dt is not None:
        return 0.0, source.range[0]
    omega = np.geomspace(1e-5, 0.98, _FREQUENCIES) * np.pi / dt
    distances = []
    for value in grid_points([(axis[1:] + axis[:-1]) / 2 for axis in source.axes]):
        exact = response(c2d(source.at(value), dt, method, prewarp=prewarp), omega)
        size = np.linalg.norm(exact, 2, axis=(1, 2))
        # exact: interpolated, then sampled; against sampled, then interpolated
        distance = np.linalg.norm(response(sampled.at(value), omega) - exact, 2, axis=(1, 2))
        distances.append((float((distance / np.maximum(size, np.finfo(float).tiny)).max()), value))
    return max(distances)


def response(system: StateSpace, omega: np.ndarray) -> np.ndarray:
    """The frequency response (w, p, m) of a sampled system at omega (w,) [rad/s]."""
    z = np.exp(1j * omega * float(system.dt or 1.0))
    if not system.n_states:
        return np.broadcast_to(system.D, (len(omega), *system.D.shape)).astype(complex)
    inner = z[:, None, None] * np.eye(system.n_states) - system.A
    return (
        system.C @ np.linalg.solve(inner, np.broadcast_to(system.B, (len(omega), *system.B.shape)))
        + system.D
    )
