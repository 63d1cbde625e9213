"""Rational functions through complex frequency responses: vector fitting with stable poles common
to all responses.

    H_i(s) = sum_n r_in/(s - p_n) + d_i + s e_i,   poles real or in conjugate pairs, Re p_n < 0

The poles move to the zeros of a weighting function sigma(s) = d + sum_n c_n/(s - p_n) for which
sigma H is fitted on the old poles, linear least squares each time (Gustavsen & Semlyen 1999, IEEE
Trans. Power Delivery 14, 1052-1061), sigma kept from vanishing by its mean (Gustavsen 2006, the
relaxed form), and what only one response needs eliminated from its rows (Deschrijver et al. 2008).
Poles that come out unstable are mirrored. Residues follow from one last least-squares problem.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ambrose.core.checks import NumericalFailure, check_shape, invalid, named_failure

_ROUNDS = 60  # relocations of the poles, at most
_SETTLED = 1e-9  # relative change of every pole
_LEAST_DAMPING = 1e-6  # of a mirrored pole, relative


@dataclass(frozen=True, slots=True, eq=False)
class RationalFit:
    """The m functions of the formula above.

    poles (n,) [rad/s]: stable, a pair's upper one first. residues (m, n), constant (m,), slope (m,)
    [s]: r, d, e. error (m,): largest distance of a response from its data over the data's largest
    magnitude.
    """

    poles: np.ndarray
    residues: np.ndarray
    constant: np.ndarray
    slope: np.ndarray
    error: np.ndarray

    def response(self, omega: ArrayLike) -> np.ndarray:
        """H(j omega) (m, w) at omega (w,) [rad/s]."""
        s = 1j * np.asarray(omega, dtype=float)
        return (
            self.residues @ (1 / (s - self.poles[:, None]))
            + self.constant[:, None]
            + s * self.slope[:, None]
        ).reshape(-1, len(s))

    def real_form(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """A (n, n), b (n,), C (m, n) of the part with poles: H = C (s - A)^-1 b + d + s e, all
        real.
        """
        A, b = _real_poles(self.poles)

        # r/(s - p) + r*/(s - p*) = Re r (sum of the fractions) + Im r j (their difference)
        C = self.residues.real.copy()
        upper = np.flatnonzero(self.poles.imag > 0)
        C[:, upper + 1] = self.residues[:, upper].imag
        return A, b, C


def _real_poles(poles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A (n, n) and b (n,), real, with C (s - A)^-1 b a sum of fractions on the poles: a pair is a
    rotation fed by [2, 0].
    """
    A, b = np.zeros((len(poles), len(poles))), np.ones(len(poles))
    for i, p in enumerate(poles):
        if p.imag > 0:
            # (s - A)^-1 b = [2 (s - Re p), -2 Im p]/((s - p)(s - p*)): the two functions of
            # ``_basis``.
            A[i : i + 2, i : i + 2] = [[p.real, p.imag], [-p.imag, p.real]]
            b[i : i + 2] = [2, 0]
        elif p.imag == 0:
            A[i, i] = p.real
    return A, b


@named_failure("the rational fit")
def fit_rational(
    omega: ArrayLike,
    data: ArrayLike,
    order: int,
    slope: bool = False,
    noise: np.ndarray | None = None,
) -> RationalFit:
    """The rational functions with ``order`` common stable poles nearest to the data, by least
    squares.

    omega (w,) [rad/s]: positive, ascending. data (m, w) or (w,), complex: H_i(j omega), each over
    its largest magnitude, or all over their noise (w,). slope: whether terms s e_i are allowed.
    Data that are such functions are met to rounding (``error`` below 1e-9); else ``error`` says how
    far the fit is off. Raises InvalidInput, among others when the points do not determine so many
    parameters; NumericalFailure.
    """
    omega = check_shape(omega, "omega", "(w,)").astype(float)
    H = np.atleast_2d(check_shape(data, "data", "(..., w)", w=len(omega))).astype(complex)
    if H.ndim != 2:
        raise invalid(
            "the shape of data", H.shape, "(m, w)", "stack the responses along the first axis"
        )
    if omega.size == 0 or omega[0] <= 0 or (np.diff(omega) <= 0).any():
        raise invalid(
            "omega", omega.tolist()[:5], "positive and ascending", "sort it, and leave out zero"
        )
    if order < 1 or 2 * len(omega) < 2 * order + 1 + slope:
        limit = f"between 1 and {(2 * len(omega) - 1 - slope) // 2} for {len(omega)} frequencies"
        raise invalid(
            "the order of the fit", order, limit, "give more frequencies or lower the order"
        )
    weights = np.broadcast_to(1 / (_size(H) if noise is None else noise), H.shape)
    # frequencies of order one: the powers of s stay comparable
    unit = np.sqrt(omega[0] * omega[-1])
    poles = _poles(1j * omega / unit, H, weights, _start(omega / unit, order), slope)
    return _on_poles(omega, H, weights, poles * unit, slope)


@named_failure("the rational fit")
def fit_on_poles(
    omega: ArrayLike, data: ArrayLike, poles: ArrayLike, slope: bool = False
) -> RationalFit:
    """As ``fit_rational``, with poles (n,) [rad/s] that are given, those of another fit say: only
    what is linear is found.
    """
    omega = check_shape(omega, "omega", "(w,)").astype(float)
    H = check_shape(data, "data", "(m, w)", w=len(omega)).astype(complex)
    return _on_poles(
        omega, H, np.broadcast_to(1 / _size(H), H.shape), np.asarray(poles, dtype=complex), slope
    )


def _size(H: np.ndarray) -> np.ndarray:
    """The largest magnitude of every response, (m, 1); 1 where it is zero."""
    size: np.ndarray = np.abs(H).max(axis=1, keepdims=True)
    size[size == 0] = 1
    return size


def _on_poles(
    omega: np.ndarray, H: np.ndarray, weights: np.ndarray, poles: np.ndarray, slope: bool
) -> RationalFit:
    """Residues, constants and slopes by one least-squares problem per response."""
    order, unit = len(poles), np.sqrt(omega[0] * omega[-1])
    fitted = _residues(1j * omega / unit, H, weights, poles / unit, slope)

    # Back from s/unit: r/(s/unit - p/unit) = r unit/(s - p), e s/unit
    residues = fitted[:, :order] * unit
    constant = fitted[:, order].real
    slopes = fitted[:, order + 1].real / unit
    fit = RationalFit(poles, residues, constant, slopes, np.zeros(len(H)))
    error = np.abs(fit.response(omega) - H).max(axis=1) / _size(H)[:, 0]
    if not np.isfinite(error).all():
        raise NumericalFailure(
            "vector fitting did not end in finite numbers; lower the order or widen the frequency "
            "range"
        )
    return RationalFit(fit.poles, fit.residues, fit.constant, fit.slope, error)


def _start(omega: np.ndarray, order: int) -> np.ndarray:
    """Weakly damped pairs spread over the logarithm of the frequency, and one real pole where the
    order is odd.
    """
    pairs = order // 2
    corner = np.geomspace(omega[0], omega[-1], pairs + 2)[1:-1] if pairs else np.array([])
    poles = np.stack([corner * (-0.1 + 1j), corner * (-0.1 - 1j)], axis=1).ravel()
    return np.concatenate([poles, [-np.sqrt(omega[0] * omega[-1])]]) if order % 2 else poles


def _basis(s: np.ndarray, poles: np.ndarray) -> np.ndarray:
    """Real-coefficient basis (w, n): 1/(s - p), and for a pair the sum and j times the difference
    of its two fractions.
    """
    basis = 1 / (s[:, None] - poles)
    up = np.flatnonzero(poles.imag > 0)
    first, second = basis[:, up], basis[:, up + 1]
    basis[:, up], basis[:, up + 1] = first + second, 1j * (first - second)
    return basis


def _stack(rows: np.ndarray) -> np.ndarray:
    """Real and imaginary parts one below the other."""
    return np.concatenate([rows.real, rows.imag])


def _poles(
    s: np.ndarray, H: np.ndarray, weights: np.ndarray, poles: np.ndarray, slope: bool
) -> np.ndarray:
    """Poles (n,) after relocation until they settle or the rounds are used up (the best round
    counts).
    """
    best, smallest = poles, np.inf
    for _ in range(_ROUNDS):
        moved = _relocate(s, H, weights, poles, slope)
        misfit = _misfit(s, H, weights, moved, slope)
        if misfit < smallest:
            best, smallest = moved, misfit
        if (
            np.abs(np.sort_complex(moved) - np.sort_complex(poles)).max()
            < _SETTLED * np.abs(moved).max()
        ):
            break
        poles = moved
    return best


def _relocate(
    s: np.ndarray, H: np.ndarray, weights: np.ndarray, poles: np.ndarray, slope: bool
) -> np.ndarray:
    """One step: the stable zeros of sigma."""
    n = len(poles)
    basis = _basis(s, poles)

    # sigma H_i = (sum r_in/(s - p_n) + d_i + s e_i): own unknowns (r, d, e) of every response,
    # shared ones (c, d) of sigma.
    columns = np.column_stack([basis, np.ones_like(s)] + ([s] if slope else []))
    shared = np.column_stack([basis, np.ones_like(s)])
    blocks = []
    for response, weight in zip(H, weights, strict=True):
        # [own, -H_i shared] = 0, weighted. After QR the rows below the own unknowns hold the shared
        # ones alone (Deschrijver et al. 2008).
        rows = _stack(np.column_stack([columns, -response[:, None] * shared]) * weight[:, None])
        R = np.asarray(np.linalg.qr(rows, mode="r"))
        blocks.append(R[columns.shape[1] :, columns.shape[1] :])

    # Gustavsen (2006): sum_k Re sigma(s_k) = number of points, weighted like all the data together;
    # without it sigma = 0 would solve the homogeneous rows.
    size = np.sqrt((np.abs(H * weights) ** 2).sum())
    mean = shared.sum(axis=0).real * size / len(s)  # sigma's mean real part is one
    left = np.concatenate([*blocks, mean[None]])
    right = np.zeros(len(left))
    right[-1] = size

    # Columns of length one, for the condition of the least squares.
    norm = np.linalg.norm(left, axis=0)
    norm[norm == 0] = 1
    c = np.linalg.lstsq(left / norm, right, rcond=None)[0] / norm

    # sigma = d + c^T (s - A)^-1 b has the zeros eig(A - b c^T/d); d not so near zero that they all
    # run away.
    d = c[n] if abs(c[n]) > 1e-8 else np.copysign(1e-8, c[n])
    A, b = _real_poles(poles)
    return _ordered(np.linalg.eigvals(A - np.outer(b, c[:n]) / d))


def _ordered(zeros: np.ndarray) -> np.ndarray:
    """Mirrored into the left half plane, real ones first, pairs side by side and exactly
    conjugate.
    """
    # Re p <- -|Re p|, and never quite on the axis.
    damped = np.minimum(-np.abs(zeros.real), -_LEAST_DAMPING * np.abs(zeros))
    real = np.sort(damped[zeros.imag == 0])
    upper = zeros.imag > 0
    pairs = damped[upper] + 1j * zeros.imag[upper]
    pairs = pairs[np.argsort(np.abs(pairs))]
    return np.concatenate([real, np.stack([pairs, pairs.conj()], axis=1).ravel()])


def _residues(
    s: np.ndarray, H: np.ndarray, weights: np.ndarray, poles: np.ndarray, slope: bool
) -> np.ndarray:
    """Residues, constant and slope (m, n + 2) by least squares on given poles; complex, conjugate
    for a pair.
    """
    basis = np.column_stack([_basis(s, poles), np.ones_like(s), s])

    # Columns: fractions (n), 1, s; the last one only with slopes.
    used = basis.shape[1] - (not slope)
    result = np.zeros((len(H), basis.shape[1]), dtype=complex)
    for i, (response, weight) in enumerate(zip(H, weights, strict=True)):
        rows = _stack(basis[:, :used] * weight[:, None])
        norm = np.linalg.norm(rows, axis=0)
        result[i, :used] = (
            np.linalg.lstsq(rows / norm, _stack((response * weight)[:, None])[:, 0], rcond=None)[0]
            / norm
        )

    # The real coefficients of sum and j difference are Re r and Im r.
    up = np.flatnonzero(poles.imag > 0)
    both = result[:, up] + 1j * result[:, up + 1]
    result[:, up], result[:, up + 1] = both, both.conj()
    return result


def _misfit(
    s: np.ndarray, H: np.ndarray, weights: np.ndarray, poles: np.ndarray, slope: bool
) -> float:
    """Weighted sum of squares on given poles."""
    r = _residues(s, H, weights, poles, slope)
    n = len(poles)
    fitted = r[:, :n] @ (1 / (s - poles[:, None])) + r[:, n : n + 1] + r[:, n + 1 :] * s
    return float((np.abs((fitted - H) * weights) ** 2).sum())
