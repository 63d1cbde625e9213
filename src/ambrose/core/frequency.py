"""Frequency responses: one real Schur form, then a triangular solve for all frequencies at once.

The triangular matrix is split recursively, so that almost all work is products of constant real
matrices with the stacked right-hand sides of every frequency (BLAS 3). Schur vectors are
orthogonal: the accuracy is that of a direct solve with the balanced A, also for defective poles,
where a diagonalisation would fail. Where it does not, a form may keep the residues of its poles
instead: one product per frequency, an order of magnitude faster at hundreds of states.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.linalg as sla
from numpy.typing import ArrayLike

from ambrose.core.checks import InvalidInput, check_shape, invalid
from ambrose.core.presentation import Presented, data_frame, to_plain
from ambrose.core.statespace import Names, as_statespace, balance, index_of

_LEAF = 16  # rows solved one by one at the bottom of the recursion
_NEAR = 100.0  # points within so many rounding errors of a pole are evaluated one by one
_CHUNK = 2_000_000  # complex numbers held for one batch of frequencies: 32 MB
# of the eigenvectors (norms of right and left ones), up to which residues lose at most these digits
_SPREAD = 1e4


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class FrequencyResponse(Presented):
    """Values of a transfer matrix on a grid.

    values (..., w, p, m) complex, omega (w,) [rad/s]; leading axes are a stack of systems with the
    same signals.
    """

    values: np.ndarray
    omega: np.ndarray
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]

    def __post_init__(self) -> None:
        w = len(self.omega)
        p = len(self.outputs)
        m = len(self.inputs)
        check_shape(self.values, "values", "(..., w, p, m)", w=w, p=p, m=m)

    def select(
        self, inputs: Names | None = None, outputs: Names | None = None
    ) -> FrequencyResponse:
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
        return largest_gain(self.values)

    def facts(self) -> Mapping[str, Any]:
        """Range, largest gain and signals."""
        span = (
            f"{self.omega.min():.4g} to {self.omega.max():.4g} rad/s" if self.omega.size else "none"
        )
        peak = float(self.max_singular_value().max()) if self.values.size else 0.0
        return {
            "frequencies": len(self.omega),
            "range": span,
            "peak": peak,
            "inputs": self.inputs,
            "outputs": self.outputs,
        }

    def to_dict(self) -> dict[str, Any]:
        """omega, real and imaginary parts of the values and the signal names, ready for JSON."""
        parts = {"omega": self.omega, "real": self.values.real, "imag": self.values.imag}
        return {**to_plain(parts), "inputs": list(self.inputs), "outputs": list(self.outputs)}

    def to_frame(self) -> Any:
        """A pandas.DataFrame over frequency [rad/s] with one complex column "output / input" per
        pair, of a single system.

        Raises InvalidInput for a stack of systems, or without pandas.
        """
        if self.values.ndim != 3:
            raise invalid(
                "the values' shape",
                self.values.shape,
                "(w, p, m) for a table",
                "take one system of the stack",
            )
        pairs = ((i, j) for i in range(len(self.outputs)) for j in range(len(self.inputs)))
        columns = {f"{self.outputs[i]} / {self.inputs[j]}": self.values[:, i, j] for i, j in pairs}
        return data_frame({"omega [rad/s]": self.omega, **columns}, "omega [rad/s]")


def frequency_response(system: Any, omega: ArrayLike) -> FrequencyResponse:
    """G(j omega), or G(exp(j omega dt)) for a sampled system.

    omega (w,) [rad/s]. Raises InvalidInput at a frequency that coincides with a pole, and above
    Nyquist when sampled.
    """
    system = as_statespace(system)
    omega = check_shape(omega, "omega", "(w)")
    if np.iscomplexobj(omega):
        raise invalid("omega", "complex", "real", "give frequencies in rad/s, not points j omega")
    if system.dt is not None:
        check_nyquist(omega, system.dt)
    s = 1j * omega if system.dt is None else np.exp(1j * omega * system.dt)
    values = transfer_matrix(system.A, system.B, system.C, system.D, s)
    return FrequencyResponse(values, omega, system.inputs, system.outputs)


def largest_gain(values: np.ndarray) -> np.ndarray:
    """The largest singular value of each matrix of a stack (..., p, m), as (...).

    From the Gram matrix's largest eigenvalue: as exact as an SVD for this one, and faster.
    """
    p, m = values.shape[-2:]
    adjoint = values.conj().swapaxes(-1, -2)
    with np.errstate(over="ignore", invalid="ignore"):
        gram = adjoint @ values if m <= p else values @ adjoint
        size = np.einsum("...ii->...", gram).real
    if not ((size > 1e-280) & (size < 1e280)).all():  # squares that overflow or vanish
        return np.asarray(np.linalg.norm(values, 2, axis=(-2, -1)))
    return np.asarray(np.sqrt(size if min(p, m) == 1 else np.linalg.eigvalsh(gram)[..., -1]))


def check_nyquist(omega: np.ndarray, dt: float) -> None:
    """Raises InvalidInput where omega (w,) [rad/s] exceeds the Nyquist frequency of the sample time
    dt [s].
    """
    highest, nyquist = np.abs(omega).max(initial=0.0), np.pi / dt
    if highest > nyquist * (1 + 1e-9):
        required = f"at most the Nyquist frequency {nyquist:g}"
        raise invalid("the highest frequency", f"{highest:g} rad/s", required, "shorten the grid")


@dataclass(frozen=True, slots=True, eq=False)
class SchurForm:
    """A system made ready for evaluation at many points: C (s I - A)^-1 B + D = right (s I -
    triangle)^-1 left + D.

    triangle (n, n): the Schur form of the balanced A, quasi-triangular for a real A; left (n, m),
    right (p, n), D (p, m). ``transposed`` tells that the form belongs to the transposed system,
    which has fewer right-hand sides. expansion: the eigenvalues (n,) and their residues (n, p m),
    where they were asked for and keep the digits.
    """

    triangle: np.ndarray
    left: np.ndarray
    right: np.ndarray
    D: np.ndarray
    transposed: bool = False
    expansion: tuple[np.ndarray, np.ndarray] | None = None

    @property
    def poles(self) -> np.ndarray:
        """The eigenvalues of A, (n,) complex, in the order of the triangle's diagonal."""
        return schur_eigenvalues(self.triangle)

    @property
    def pole_errors(self) -> np.ndarray:
        """What rounding can do to each (well-conditioned) pole, (n,): eps times the largest entry
        in its row and column.
        """
        size = np.abs(self.triangle)
        return np.finfo(float).eps * np.maximum(size.max(0, initial=0.0), size.max(1, initial=0.0))


def schur_eigenvalues(T: np.ndarray) -> np.ndarray:
    """The eigenvalues (n,) of a triangular or (real, standardised) quasi-triangular T (n, n), in
    the order of its diagonal.
    """
    values = np.diag(T).astype(complex)
    i = np.flatnonzero(np.diag(T, -1))
    half = 1j * np.sqrt(-np.diag(T, 1)[i] * np.diag(T, -1)[i])
    values[i] += half
    values[i + 1] -= half
    return values


def schur_form(
    A: np.ndarray, B: np.ndarray, C: np.ndarray, D: np.ndarray, *, expand: bool = False
) -> SchurForm:
    """The balanced Schur form, computed once for any number of calls of ``evaluate``.

    A (n, n), B (n, m), C (p, n), D (p, m): real or complex. expand: keep the partial fractions
    where eigenvectors allow, for some hundred frequencies or more.
    """
    if C.shape[0] < B.shape[1]:  # fewer right-hand sides: work with the transposed system
        form = schur_form(A.T, C.T, B.T, D.T, expand=expand)
        return SchurForm(form.triangle, form.left, form.right, form.D, True, form.expansion)
    A, t = balance(A)
    if A.shape[0] == 0:
        return SchurForm(A, B, C, D)
    T, Q = sla.schur(A, output="complex" if np.iscomplexobj(A) else "real")
    left, right = Q.conj().T @ (B / t[:, None]), (C * t) @ Q
    return SchurForm(T, left, right, D, expansion=_expansion(T, left, right) if expand else None)


def _expansion(
    T: np.ndarray, left: np.ndarray, right: np.ndarray
) -> tuple[np.ndarray, np.ndarray] | None:
    """Poles (n,) and residues (n, p m); None where the eigenvectors would cost more than four
    digits.
    """
    try:
        poles, V = np.linalg.eig(T)
        W = np.linalg.inv(V)
    except np.linalg.LinAlgError:
        return None
    with np.errstate(over="ignore", invalid="ignore"):
        # |v_i| |w_i| with w_i v_i = 1: the condition of pole i, and the digits that its residue
        # loses.
        spread = np.linalg.norm(V, axis=0) * np.linalg.norm(W, axis=1)
    if not (spread <= _SPREAD).all():
        return None

    # residue i = (right v_i)(w_i left), rank one
    residues = (right @ V).T[:, :, None] * (W @ left)[:, None, :]
    return poles, residues.reshape(len(poles), -1)


def evaluate(form: SchurForm, s: np.ndarray) -> np.ndarray:
    """The transfer matrix at the complex points s (w,), as (w, p, m). Raises InvalidInput where s
    is an eigenvalue of A.
    """
    s = np.asarray(s, dtype=complex)
    values = _by_substitution(form, s) if form.expansion is None else _partial_fractions(form, s)
    if not np.isfinite(values).all():
        raise _at_pole(s[np.argmax(~np.isfinite(values).all(axis=(1, 2)))])
    return values.swapaxes(1, 2) if form.transposed else values


def _partial_fractions(form: SchurForm, s: np.ndarray) -> np.ndarray:
    assert form.expansion is not None
    poles, residues = form.expansion
    step = max(1, _CHUNK // (10 * len(poles)))
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        parts = [
            (1 / (s[i : i + step, None] - poles)) @ residues for i in range(0, max(1, len(s)), step)
        ]
        values = parts[0] if len(parts) == 1 else np.concatenate(parts)
    return values.reshape(len(s), *form.D.shape) + form.D


def _by_substitution(form: SchurForm, s: np.ndarray) -> np.ndarray:
    n, m = form.left.shape
    p = form.right.shape[0]
    values = np.broadcast_to(form.D, (len(s), p, m)).astype(complex)
    if n and m and p:
        step = max(1, _CHUNK // (n * m))
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            for start in range(0, len(s), step):
                part = s[start : start + step]
                X = np.repeat(form.left[:, None, :].astype(complex), len(part), axis=1)
                solve_shifted(form.triangle, X, part)
                values[start : start + step] += _times(form.right, X).swapaxes(0, 1)
    return values


def _at_pole(s: complex) -> InvalidInput:
    return InvalidInput(
        f"s = {s:.6g} is a pole of the system; evaluate beside it or leave this frequency out"
    )


def transfer_matrix(
    A: np.ndarray, B: np.ndarray, C: np.ndarray, D: np.ndarray, s: np.ndarray
) -> np.ndarray:
    """C (s I - A)^-1 B + D at the complex points s (w,), as (w, p, m).

    A (n, n), B (n, m), C (p, n), D (p, m). Raises InvalidInput where s is an eigenvalue of A.
    """
    s = np.asarray(s, dtype=complex)
    if A.shape[0] == 0 or len(s) == 0 or 0 in D.shape:
        return np.broadcast_to(D, (len(s), *D.shape)).astype(complex)
    form = schur_form(A, B, C, D)
    near = _near_poles(form, s)
    if not near.any():
        return evaluate(form, s)
    values = np.empty((len(s), *D.shape), dtype=complex)
    values[~near] = evaluate(form, s[~near])
    for i in np.flatnonzero(near):
        values[i] = transfer_matrix_at(A, B, C, D, complex(s[i]))
    return values


def _near_poles(form: SchurForm, s: np.ndarray) -> np.ndarray:
    """Which points (w,) lie so close to a pole, or to a defective pair, that the Schur form does
    not resolve the distance.
    """
    eps = np.finfo(float).eps

    # In rounding errors of each pole, (w, n).
    distance = np.abs(s[:, None] - form.poles) / np.maximum(form.pole_errors, 1e-280)

    # Only these may be near by either measure: the product of the two nearest, or the nearest.
    near = distance.min(axis=1) <= np.sqrt(_NEAR / eps)

    # A defective pair is known to sqrt(eps) only: (s - p)^2 within 100 eps of its size squared.
    two = np.sort(distance[near], axis=1)[:, :2]
    near[near] = (two[:, 0] <= _NEAR) | (two.prod(axis=1) <= _NEAR / eps) & (distance.shape[1] > 1)
    return near


def transfer_matrix_at(
    A: np.ndarray, B: np.ndarray, C: np.ndarray, D: np.ndarray, s: complex
) -> np.ndarray:
    """C (s I - A)^-1 B + D at one point, (p, m), as exactly as the data allow: LU and refinement in
    extended precision.

    A (n, n), B (n, m), C (p, n), D (p, m). Raises InvalidInput where s is an eigenvalue of A to
    rounding.
    """
    if A.shape[0] == 0 or 0 in D.shape:
        return D.astype(complex)
    X, rcond = state_response_at(A, B, s)
    if rcond < A.shape[0] * np.finfo(float).eps:
        raise _at_pole(s)
    return C @ X + D


def state_response_at(A: np.ndarray, B: np.ndarray, s: complex) -> tuple[np.ndarray, float]:
    """X = (s I - A)^-1 B, (n, m) complex, refined in extended precision, and the equilibrated
    matrix's reciprocal condition.

    A (n, n), B (n, m). At an eigenvalue of A the condition is 0 and X is zero.
    """
    n = A.shape[0]
    A, t = balance(A)
    shifted = s * np.eye(n) - A

    # Equilibrated: every row, then every column of s - A has the largest entry one.
    rows = 1 / np.maximum(np.abs(shifted).max(axis=1), 1e-280)
    columns = 1 / np.maximum((np.abs(shifted) * rows[:, None]).max(axis=0), 1e-280)
    scaled = shifted * rows[:, None] * columns
    lu, pivots, singular = sla.lapack.zgetrf(scaled)
    if singular:
        return np.zeros(B.shape, complex), 0.0

    # (s - A)^-1 = diag(columns) (rows (s - A) columns)^-1 diag(rows)
    def solve(right: np.ndarray) -> np.ndarray:
        return columns[:, None] * sla.lapack.zgetrs(lu, pivots, rows[:, None] * right)[0]

    # Residuals in extended precision, corrections by the factors at hand.
    right = B / t[:, None]
    X = solve(right)
    wide = s * np.eye(n, dtype=np.clongdouble) - A
    for _ in range(2):
        X = X + solve((right - wide @ X).astype(complex))
    rcond = float(sla.lapack.zgecon(lu, np.abs(scaled).sum(axis=0).max())[0])
    return t[:, None] * X, rcond


def _times(T: np.ndarray, X: np.ndarray) -> np.ndarray:
    """T (k, n) times every column of the contiguous complex X (n, w, m); a real T is not made
    complex.
    """
    flat = X.reshape(X.shape[0], -1)
    product = (T @ flat.view(float)).view(complex) if np.isrealobj(T) else T @ flat
    return product.reshape(T.shape[0], *X.shape[1:])


def solve_shifted(T: np.ndarray, X: np.ndarray, s: np.ndarray) -> None:
    """Replace X (n, w, m) by (s_w I - T)^-1 X for (quasi-)triangular T (n, n) and every s (w,), in
    place.
    """
    n = T.shape[0]
    if n > _LEAF:
        # X2 <- (s - T22)^-1 X2, then X1 <- (s - T11)^-1 (X1 + T12 X2)
        h = n // 2 + int(T[n // 2, n // 2 - 1] != 0)  # never through a 2 x 2 block
        solve_shifted(T[h:, h:], X[h:], s)
        X[:h] += _times(T[:h, h:], X[h:])
        solve_shifted(T[:h, :h], X[:h], s)
        return

    # The same from the last row up, rows k..i of one diagonal block at a time.
    i = n
    while i > 0:
        k = i - 2 if i > 1 and T[i - 1, i - 2] != 0 else i - 1
        if i < n:
            X[k:i] += _times(T[k:i, i:], X[i:])
        if k == i - 1:
            X[k] /= (s - T[k, k])[:, None]
        else:
            _solve_pair(T[k:i, k:i], X[k:i], s)
        i = k


def _solve_pair(block: np.ndarray, X: np.ndarray, s: np.ndarray) -> None:
    """The same for a standardised 2 x 2 block [[a, b], [c, a]] with b c < 0; its determinant is
    kept in factors.
    """
    (a, b), (c, _) = block

    # (s - block)^-1 = [[d, b], [c, d]]/(d^2 - b c), d = s - a, d^2 - b c = (d - half)(d + half)
    half = 1j * np.sqrt(-b * c)
    d = s - a
    scale = (1 / (d - half) / (d + half))[:, None]
    first = (d[:, None] * X[0] + b * X[1]) * scale
    X[1] = (c * X[0] + d[:, None] * X[1]) * scale
    X[0] = first
