"""Frequency responses: one real Schur form, then a triangular solve for all frequencies at once.

The triangular matrix is split recursively, so that almost all work is products of constant real
matrices with the stacked right-hand sides of every frequency (BLAS 3). Schur vectors are
orthogonal: the accuracy is that of a direct solve with the balanced A, also for defective poles,
where a diagonalisation would fail. Where it does not, a form may keep the residues of its poles
instead: one product per frequency, an order of magnitude faster at hundreds of states.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from sys import float_info
from typing import Any

import numpy as np
import scipy.linalg as sla
from numpy.typing import ArrayLike

from ambrose.core.checks import InvalidInput, NumericalFailure, check_shape, invalid
from ambrose.core.presentation import Presented, data_frame, to_plain
from ambrose.core.statespace import Names, as_statespace, balance_matrix as balance, index_of

_LEAF = 16  # rows solved one by one at the bottom of the recursion
_NEAR = 100.0  # points within so many rounding errors of a pole are evaluated one by one
_CHUNK = 2_000_000  # complex numbers held for one batch of frequencies: 32 MB
_NETS, _FINER = 6, 9  # one in the other, that end in a peak, at most; points of each
_FLAT = 1e-5  # of a gain, by which its neighbours are lower where a parabola is as good: 1e-10
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


def largest_gains(values: np.ndarray, axis: int = -1) -> np.ndarray:
    """The largest singular value of each matrix of a stack (..., p, m) that may be the largest
    along an axis of the stack; of the others something below that, as (...).
    """
    # longest column <= sigma_max <= |T|_F, and sigma_max^2 <= |T|_1 |T|_inf: what cannot reach the
    # largest lower bound is not asked
    size = np.abs(values)
    with np.errstate(over="ignore"):
        columns = np.square(size).sum(axis=-2)
        found = np.sqrt(columns.max(axis=-1, initial=0.0))
        sums = size.sum(axis=-2).max(axis=-1, initial=0.0) * size.sum(axis=-1).max(
            axis=-1, initial=0.0
        )
        least = np.square(found).max(axis=axis, keepdims=True, initial=0.0)
    asked = ~(np.minimum(columns.sum(axis=-1), sums) < least * (1 - 1e-12))
    found[asked] = largest_gain(values[asked])
    return np.asarray(found)


def peak_near(gain: Callable[[np.ndarray], np.ndarray], grid: np.ndarray) -> tuple[float, float]:
    """The frequency of the largest gain near the best of an ascending grid (w,), and its value:
    by nets between the neighbours of the best, each in the one before, until these are hardly
    lower, then the vertex of the parabola through the best three. gain: of frequencies (w,), (w,).
    """
    best = 0.0, -np.inf
    for stage in range(_NETS):
        value = gain(grid)
        k = int(value.argmax())
        if value[k] > best[1]:
            best = float(grid[k]), float(value[k])
        low, high = grid[max(k - 1, 0)], grid[min(k + 1, len(grid) - 1)]
        inside = low < grid[k] < high
        # of even points; what is no parabola goes with the square of how much lower the others are
        if stage and inside and value[k] - value[k - 1 : k + 2].min() <= _FLAT * value[k]:
            break
        if stage < _NETS - 1:
            grid = np.linspace(low, high, _FINER)
    if inside:
        bend = value[k - 1] - 2 * value[k] + value[k + 1]
        share = 0.5 * (value[k - 1] - value[k + 1]) / bend if bend < 0 else 0.0
        vertex = np.array([grid[k] + share * (high - low) / 2])
        best = max(best, (float(vertex[0]), float(gain(vertex)[0])), key=lambda item: item[1])
    return best


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
    return SchurForm(T, left, right, D, expansion=expansion(T, left, right) if expand else None)


def eigenvectors(A: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Eigenvalues (n,) of A (n, n), right vectors (n, n) and left ones (n, n), left @ right = I;
    of a real A pairs are neighbours, the one above the real axis first. Raises LinAlgError where a
    pole is defective to the last digit.
    """
    values, right = np.linalg.eig(A)
    if np.iscomplexobj(A):
        return values, right, np.linalg.inv(right)
    # in real columns, [v, conj v] = [Re v, Im v] [[1, 1], [j, -j]]: the rows of the inverse are
    # (a - j b)/2 and its conjugate
    pair = np.flatnonzero(values.imag > 0)
    basis = right.real.copy()
    basis[:, pair + 1] = right[:, pair].imag
    left = np.linalg.inv(basis).astype(complex)
    left[pair] = (left[pair] - 1j * left[pair + 1]) / 2
    left[pair + 1] = left[pair].conj()
    return values, right, left


def expansion(A: np.ndarray, B: np.ndarray, C: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
    """Poles (n,) and residues (n, p m) of C (s I - A)^-1 B; None where the eigenvectors would cost
    more than four digits.
    """
    try:
        poles, V, W = eigenvectors(A)
    except np.linalg.LinAlgError:
        return None
    with np.errstate(over="ignore", invalid="ignore"):
        # |v_i| |w_i| with w_i v_i = 1: the condition of pole i, and the digits that its residue
        # loses.
        spread = np.linalg.norm(V, axis=0) * np.linalg.norm(W, axis=1)
    if not (spread <= _SPREAD).all():
        return None

    # residue i = (C v_i)(w_i B), rank one
    residues = (C @ V).T[:, :, None] * (W @ B)[:, None, :]
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
                values[start : start + step] += times(form.right, X).swapaxes(0, 1)
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


def times(T: np.ndarray, X: np.ndarray) -> np.ndarray:
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
        X[:h] += times(T[:h, h:], X[h:])
        solve_shifted(T[:h, :h], X[:h], s)
        return

    # The same from the last row up, rows k..i of one diagonal block at a time.
    i = n
    while i > 0:
        k = i - 2 if i > 1 and T[i - 1, i - 2] != 0 else i - 1
        if i < n:
            X[k:i] += times(T[k:i, i:], X[i:])
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


# How large a state can become under bounded inputs: the sum of the absolute impulse response (the
# l1 norm), from above.


_EXACT = 4096  # samples summed one by one; beyond, blocks of samples are bounded together
_BATCH = 64  # powers of A that are stacked at once
_DOUBLINGS = 60  # of the horizon, at most


def peak_gains(increment: np.ndarray, B: np.ndarray, steps: float = np.inf) -> np.ndarray:
    """Bounds (n, m) on |x_i| for |u_j| <= 1 and x[k+1] = x[k] + increment x[k] + B u[k] from rest;
    infinite when unstable.

    increment (n, n), B (n, m). steps: how many samples the input acts (infinite: for ever). A - I
    is given, not A: a slow pole keeps its digits. Exact for one state; for several an upper bound,
    exact over the first 4096 samples (Dahleh & Diaz-Bobillo 1995, ch. 2: the l1 norm is the peak
    gain).
    """
    increment = check_shape(increment, "increment", "(n, n)")
    B = check_shape(B, "B", "(n, m)", n=len(increment))
    if len(increment) == 1:
        return np.abs(B) * _single(float(increment[0, 0]), steps)
    A = increment + np.eye(len(increment))
    if steps == np.inf and np.abs(np.linalg.eigvals(A)).max(initial=0.0) >= 1:
        return np.where(np.abs(B).sum(axis=0)[None] > 0, np.inf, np.zeros(B.shape))
    return np.minimum(_summed(A, B, steps), _rotation(A, B, steps))


def _single(increment: float, steps: float) -> float:
    """sum over k < steps of |a|^k, a = 1 + increment."""
    distance = -increment if increment >= -1 else 2 + increment  # 1 - |a|

    # |a| >= 1: the sum (|a|^k - 1)/(|a| - 1) of the geometric series, k where |a| = 1
    if distance <= 0:
        if steps == np.inf:
            return np.inf
        return steps if distance == 0 else float(np.expm1(steps * np.log1p(-distance)) / -distance)

    # (1 - |a|^k)/(1 - |a|), in expm1 and log1p: a slow pole keeps its digits; at a = 0, a delay, 1
    if steps == np.inf or distance == 1:
        return 1 / distance
    return float(-np.expm1(steps * np.log1p(-distance)) / distance)


def _summed(A: np.ndarray, B: np.ndarray, steps: float) -> np.ndarray:
    """The first samples one by one; then S(2K) <= S(K) + |A^K| S(K)."""
    total, response = np.zeros(B.shape), B
    count = int(min(_EXACT, steps))

    # A^0 .. A^batch: a batch of samples is one product with the response at its start.
    powers = [np.eye(len(A))]
    for _ in range(min(_BATCH, count)):
        powers.append(A @ powers[-1])
    rows = np.reshape(powers[:-1], (len(A) * (len(powers) - 1), len(A)))
    for start in range(0, count, _BATCH):
        samples = rows[: len(A) * (count - start)] @ response
        total += np.abs(samples).reshape(min(_BATCH, count - start), *B.shape).sum(axis=0)
        response = powers[-1] @ response

        # each entry against its own sum: states and inputs may be in units of any size; what is
        # below 1e-18 of it no longer changes a sum of doubles
        if (np.abs(response) <= 1e-18 * total).all():
            count = min(count, start + _BATCH)
            break

    # Entry by entry |A^(K + i) B| <= |A^K| |A^i B|: the next K samples add at most |A^K| S(K).
    power = np.linalg.matrix_power(A, count)
    done = float(count)
    for _ in range(_DOUBLINGS):
        further = np.abs(power) @ total
        if done >= steps or (further <= 1e-12 * total).all():
            break
        total = total + further
        power = power @ power
        done *= 2
    return total * (1 + 1e-9)  # an upper bound in spite of rounding and of what was cut off


def _rotation(A: np.ndarray, B: np.ndarray, steps: float) -> np.ndarray:
    """By r = ||A||_2: ||A^k b|| <= r^k ||b||, with equality where A is r times a rotation."""
    r = np.linalg.norm(A, 2)
    if r >= 1 and steps == np.inf:
        return np.full(B.shape, np.inf)

    # |x_i| <= sum_k ||A^k b|| <= ||b|| sum_k r^k, r the 2-norm of A:
    # at most 1/(1 - r), or (r^steps - 1)/(r - 1)
    length = steps if r >= 1 else 1 / (1 - r)
    if r > 1:  # r^steps overflows beyond exp(709)
        length = float(np.expm1(steps * np.log(r)) / (r - 1)) if steps * np.log(r) < 700 else np.inf
    return np.broadcast_to(np.linalg.norm(B, axis=0) * length, B.shape).copy()


# A root of one equation in one unknown between two ends of opposite sign.
#
# SciPy's optimisers have the same method; loading them takes longer than a short command may.


def bracketed_root(
    f: Callable[[float], float],
    low: float,
    high: float,
    *,
    absolute: float,
    relative: float = 4 * float_info.epsilon,
    evaluations: int = 200,
) -> float:
    """The place x between ``low`` and ``high`` where f changes its sign, to within ``absolute`` +
    ``relative`` |x|.

    Inverse quadratic interpolation where it converges, bisection else (Brent, Algorithms for
    Minimization without Derivatives, 1973, chapter 4). Raises InvalidInput where f has one sign at
    both ends, NumericalFailure after so many evaluations.
    """
    a, b = low, high
    fa, fb = f(a), f(b)
    if fa * fb > 0:
        raise InvalidInput(
            f"the function is {fa:.4g} at {low:.4g} and {fb:.4g} at {high:.4g}; give ends of "
            "opposite sign"
        )
    # b is the best place, c the end across the root from it, a the best place before
    c, fc = a, fa
    step = before = b - a
    for _ in range(evaluations):
        if fb * fc > 0:
            c, fc = a, fa
            step = before = b - a
        if abs(fc) < abs(fb):
            a, b, c = b, c, b
            fa, fb, fc = fb, fc, fb
        within, half = (absolute + relative * abs(b)) / 2, (c - b) / 2
        if abs(half) <= within or fb == 0:
            return b
        tried = _interpolated((a, fa), (b, fb), (c, fc))
        # taken where it stays within the bracket, and is less than half of the step before the last
        if (
            abs(before) >= within
            and abs(tried) < min(1.5 * abs(half), abs(before) / 2)
            and (tried * half > 0)
        ):
            before, step = step, tried
        else:
            before = step = half
        a, fa = b, fb
        b += step if abs(step) > within else within * (1 if half > 0 else -1)
        fb = f(b)
    raise NumericalFailure(
        f"no root to {absolute:.2g} within {evaluations} evaluations; is the function continuous "
        f"between {low:.4g} and {high:.4g}?"
    )


def _interpolated(
    last: tuple[float, float], best: tuple[float, float], across: tuple[float, float]
) -> float:
    """The step from the best place to the root of the parabola x(f) through three points, of the
    line through two where the first is the third; 0 where there is none.
    """
    a, fa = last
    b, fb = best
    c, fc = across
    if abs(fa) <= abs(fb):
        return 0.0
    s = fb / fa
    if a == c:
        # x = b + (c - b) f(b)/(f(b) - f(c))
        return (c - b) * s / (s - 1) if s != 1 else 0.0
    # Lagrange's x(0) with q = f(a)/f(c), r = f(b)/f(c), s = f(b)/f(a)
    q, r = fa / fc, fb / fc
    below = (q - 1) * (r - 1) * (s - 1)
    return -s * ((c - b) * q * (q - r) - (b - a) * (r - 1)) / below if below else 0.0
