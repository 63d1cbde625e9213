"""Frequency responses: one complex Schur form, then a triangular solve for all frequencies at once.

The triangular matrix is split recursively, so that almost all work is products of constant matrices with the
stacked right-hand sides of every frequency (BLAS 3). Schur vectors are unitary: the accuracy is that of a
direct solve with the balanced A, also for defective poles, where a diagonalisation would fail.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.linalg as sla
from numpy.typing import ArrayLike

from ambrose.core.checks import InvalidInput, check_shape, invalid
from ambrose.core.statespace import Names, as_statespace, balance, index_of

_LEAF = 16  # rows solved one by one at the bottom of the recursion
_CHUNK = 2_000_000  # complex numbers held for one batch of frequencies: 32 MB


@dataclass(frozen=True, slots=True, eq=False)
class FrequencyResponse:
    """Values of a transfer matrix on a grid.

    values (..., w, p, m) complex, omega (w,) [rad/s]; leading axes are a stack of systems with the same signals.
    """

    values: np.ndarray
    omega: np.ndarray
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]

    def __post_init__(self) -> None:
        w, p, m = len(self.omega), len(self.outputs), len(self.inputs)
        check_shape(self.values, "values", "(..., w, p, m)", w=w, p=p, m=m)

    def select(self, inputs: Names | None = None, outputs: Names | None = None) -> FrequencyResponse:
        """The part between the named signals, in the order given; None keeps all."""
        j = index_of(self.inputs if inputs is None else inputs, self.inputs, "input")
        i = index_of(self.outputs if outputs is None else outputs, self.outputs, "output")
        return FrequencyResponse(
            self.values[..., i, :][..., j],
            self.omega,
            tuple(self.inputs[k] for k in j),
            tuple(self.outputs[k] for k in i),
        )

    def max_singular_value(self) -> np.ndarray:
        """Largest singular value at each frequency, (..., w)."""
        return np.linalg.norm(self.values, 2, axis=(-2, -1))


def frequency_response(system: Any, omega: ArrayLike) -> FrequencyResponse:
    """G(j omega), or G(exp(j omega dt)) for a sampled system.

    omega (w,) [rad/s]. Raises InvalidInput at a frequency that coincides with a pole, and above Nyquist when sampled.
    """
    system = as_statespace(system)
    omega = check_shape(omega, "omega", "(w)").astype(float)
    if system.dt is not None and omega.size and np.abs(omega).max() > np.pi / system.dt * (1 + 1e-9):
        nyquist = np.pi / system.dt
        raise invalid(
            "the highest frequency",
            f"{np.abs(omega).max():g} rad/s",
            f"at most the Nyquist frequency {nyquist:g}",
            "shorten the grid",
        )
    s = 1j * omega if system.dt is None else np.exp(1j * omega * system.dt)
    values = transfer_matrix(system.A, system.B, system.C, system.D, s)
    return FrequencyResponse(values, omega, system.inputs, system.outputs)


def stacked_frequency_response(systems: Sequence[Any], omega: ArrayLike) -> FrequencyResponse:
    """The responses of several systems with the same signals as one stack, values (systems, w, p, m)."""
    parts = [frequency_response(system, omega) for system in systems]
    if not parts:
        raise InvalidInput("no system was given; a stack needs at least one")
    for part in parts[1:]:
        if (part.inputs, part.outputs) != (parts[0].inputs, parts[0].outputs):
            raise invalid(
                "the signals of a stacked system",
                (part.inputs, part.outputs),
                "those of the first",
                "select() or rename() them",
            )
    first = parts[0]
    return FrequencyResponse(np.stack([part.values for part in parts]), first.omega, first.inputs, first.outputs)


@dataclass(frozen=True, slots=True, eq=False)
class SchurForm:
    """A system made ready for evaluation at many points: C (s I - A)^-1 B + D = right (s I - triangle)^-1 left + D.

    triangle (n, n) complex, upper triangular; left (n, m), right (p, n) complex; D (p, m). ``transposed`` tells that the form
    belongs to the transposed system, which has fewer right-hand sides.
    """

    triangle: np.ndarray
    left: np.ndarray
    right: np.ndarray
    D: np.ndarray
    transposed: bool = False


def schur_form(A: np.ndarray, B: np.ndarray, C: np.ndarray, D: np.ndarray) -> SchurForm:
    """The balanced complex Schur form, computed once for any number of calls of ``evaluate``.

    A (n, n), B (n, m), C (p, n), D (p, m).
    """
    if C.shape[0] < B.shape[1]:  # fewer right-hand sides: work with the transposed system
        form = schur_form(A.T, C.T, B.T, D.T)
        return SchurForm(form.triangle, form.left, form.right, form.D, True)
    A, t = balance(A)
    if A.shape[0] == 0:
        return SchurForm(A.astype(complex), B.astype(complex), C.astype(complex), D)
    T, Q = sla.schur(A, output="complex")
    return SchurForm(T, Q.conj().T @ (B / t[:, None]), (C * t) @ Q, D)


def evaluate(form: SchurForm, s: np.ndarray) -> np.ndarray:
    """The transfer matrix at the complex points s (w,), as (w, p, m). Raises InvalidInput where s is an eigenvalue of A."""
    n, m = form.left.shape
    p = form.right.shape[0]
    values = np.broadcast_to(form.D, (len(s), p, m)).astype(complex)
    if n and m and p:
        step = max(1, _CHUNK // (n * m))
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            for start in range(0, len(s), step):
                part = s[start : start + step]
                X = np.repeat(form.left[:, None, :], len(part), axis=1)
                _solve_shifted(form.triangle, X, part)
                values[start : start + step] += (form.right @ X.reshape(n, -1)).reshape(p, len(part), m).swapaxes(0, 1)
        bad = ~np.isfinite(values).all(axis=(1, 2))
        if bad.any():
            point = s[np.argmax(bad)]
            raise InvalidInput(f"s = {point:.6g} is a pole of the system; evaluate beside it or leave this frequency out")
    return values.swapaxes(1, 2) if form.transposed else values


def transfer_matrix(A: np.ndarray, B: np.ndarray, C: np.ndarray, D: np.ndarray, s: np.ndarray) -> np.ndarray:
    """C (s I - A)^-1 B + D at the complex points s (w,), as (w, p, m).

    A (n, n), B (n, m), C (p, n), D (p, m). Raises InvalidInput where s is an eigenvalue of A.
    """
    if A.shape[0] == 0 or len(s) == 0 or 0 in D.shape:
        return np.broadcast_to(D, (len(s), *D.shape)).astype(complex)
    return evaluate(schur_form(A, B, C, D), s)


def _solve_shifted(T: np.ndarray, X: np.ndarray, s: np.ndarray) -> None:
    """Replace X (n, w, m) by (s_w I - T)^-1 X for upper triangular T (n, n) and every s (w,), in place."""
    n = T.shape[0]
    if n <= _LEAF:
        for i in range(n - 1, -1, -1):
            if i + 1 < n:
                X[i] += np.tensordot(T[i, i + 1 :], X[i + 1 :], 1)
            X[i] /= (s - T[i, i])[:, None]
        return
    h = n // 2
    _solve_shifted(T[h:, h:], X[h:], s)
    X[:h] += (T[:h, h:] @ X[h:].reshape(n - h, -1)).reshape(X[:h].shape)
    _solve_shifted(T[:h, :h], X[:h], s)
