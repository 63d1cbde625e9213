"""Corrections from 1x vectors as read off an instrument, without a machine: initial run and trial
runs, or influence coefficients.

With the initial vectors v (m,) and A (m, p), vectors per correction in each plane, corrections w
leave r = v + A w (Goodman 1964, J. Eng. Ind. 86, 273). What is small of r is the norm's:

    squares:  sum |r_k|^2     least squares
    sum:      sum |r_k|       a reading that is wrong hardly counts
    largest:  max |r_k|       the worst reading (Foiles, Allaire & Gunter 2000, IMechE C576/097)

Readings and corrections have any units; those of A are theirs.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ambrose.core.checks import InvalidInput, check_positive, check_shape, invalid
from ambrose.core.presentation import Presented
from ambrose.machine.messages import suggestion

# share of a column that no other explains, below which its plane is none of its own
DEPENDENT = 0.2  # Darlow 1982 (ASME 82-GT-269), as recommended there
_ROUNDS = 300  # of weights
_STILL = 1e-12  # relative change of the corrections that ends them


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class VectorCorrection(Presented):
    """correction (p,) complex, left (m,) complex: the readings as predicted with it; condition: of
    the coefficients with columns of unit length; leave_out: planes whose column the others explain
    but for ``DEPENDENT`` of it; norm: what was made small.
    """

    planes: tuple[str, ...]
    correction: np.ndarray
    left: np.ndarray
    condition: float
    leave_out: tuple[str, ...]
    norm: str

    @property
    def sizes(self) -> np.ndarray:
        """Size (p,) of each correction."""
        return np.abs(self.correction)

    @property
    def angles(self) -> np.ndarray:
        """Angle (p,) of each correction [rad], 0 to 2 pi."""
        return np.asarray(np.angle(self.correction) % (2 * np.pi))

    def __str__(self) -> str:
        rows = [
            f"{plane}: {size:.4g} at {np.degrees(angle):.1f} deg"
            for plane, size, angle in zip(self.planes, self.sizes, self.angles, strict=True)
        ]
        if self.leave_out:
            rows.append(
                f"{' and '.join(self.leave_out)} can hardly be told from the other planes "
                f"(condition {self.condition:.3g}): leave out"
            )
        return "\n".join(rows)


def coefficients_of_trials(
    initial: ArrayLike, trials: ArrayLike, weights: ArrayLike, kept: bool = False
) -> np.ndarray:
    """Influence coefficients (m, p) of p planes from trial runs, each with a weight in one plane.

    initial (m,), trials (m, p): readings; column j with the weight ``weights[j]`` complex in plane
    j. kept: whether a trial weight stays on in the runs after it. Raises InvalidInput.
    """
    W = _vectors(weights, "weights", "(p,)")
    v = _vectors(initial, "initial", "(m,)")
    runs = _vectors(trials, "trials", "(m, p)", m=len(v), p=len(W))
    if not W.all():
        raise invalid("a trial weight", 0, "not zero", "give what was put on, at its angle")

    # A_j = (run with W_j - run before it) / W_j
    before = np.column_stack([v, runs[:, :-1]]) if kept else v[:, None]
    return np.asarray((runs - before) / W)


def balance_vectors(
    initial: ArrayLike,
    coefficients: ArrayLike,
    *,
    norm: str = "squares",
    limits: Mapping[str, float] | None = None,
    planes: Sequence[str] = (),
) -> VectorCorrection:
    """Corrections in p planes from m readings (complex, 0 degrees and direction as they are read).

    initial (m,): run-out taken off. coefficients (m, p): readings per correction. norm: "squares",
    "sum" or "largest" of the readings left. limits: the largest correction by plane. planes: their
    names (none: "1", "2", ...). Raises InvalidInput for fewer readings than planes, and for columns
    that depend on one another.
    """
    v = _vectors(initial, "initial", "(m,)")
    A = _vectors(coefficients, "coefficients", "(m, p)", m=len(v))
    names = tuple(planes) or tuple(str(number) for number in range(1, A.shape[1] + 1))
    if len(names) != A.shape[1]:
        raise invalid("the number of planes", len(names), f"{A.shape[1]}, one per column", "name")
    if len(v) < len(names):
        raise InvalidInput(
            f"{len(v)} readings cannot tell {len(names)} planes; read more sensors or speeds, or "
            "leave planes out"
        )
    if norm not in _NORMS:
        raise invalid("norm", repr(norm), f"one of {', '.join(_NORMS)}", "choose")
    most = _limits(names, limits or {})

    condition, dependent = _independence(A)
    if not np.isfinite(condition):
        raise InvalidInput(
            f"plane {names[dependent[0]]} does what others do; leave it out, or read another speed"
        )

    # readings and columns of size one, for the solver's sake
    size, length = float(np.abs(v).max()) or 1.0, np.linalg.norm(A, axis=0)
    w = _NORMS[norm](A / length, v / size, most * length / size) * size / length
    return VectorCorrection(
        names, w, v + A @ w, condition, tuple(names[j] for j in dependent), norm
    )


def _vectors(values: ArrayLike, name: str, shape: str, **sizes: int) -> np.ndarray:
    """What was read or put on, complex. Raises InvalidInput."""
    try:
        numbers = np.asarray(values, complex)
    except (TypeError, ValueError, OverflowError):
        raise invalid(
            name, repr(values)[:40], "complex numbers", "give size * exp(1j * angle) of each"
        ) from None
    return check_shape(numbers, name, shape, **sizes)


def _limits(names: Sequence[str], limits: Mapping[str, float]) -> np.ndarray:
    """The largest correction (p,) of each plane, infinite where none is given."""
    for name, limit in limits.items():
        if name not in names:
            raise InvalidInput(f"there is no plane {name!r}; {suggestion(name, names)}")
        check_positive(limit, f"the limit of plane {name}", "leave it out for none")
    return np.array([limits.get(name, np.inf) for name in names], float)


def _independence(A: np.ndarray) -> tuple[float, tuple[int, ...]]:
    """Condition of A with columns of unit length, and the columns that the larger ones explain but
    for ``DEPENDENT``: Gram and Schmidt, the largest rest first (Darlow 1982).
    """
    from scipy.linalg import qr

    length = np.linalg.norm(A, axis=0)
    if not length.all():
        return np.inf, tuple(np.flatnonzero(length == 0).tolist())
    R, order = qr(A, mode="r", pivoting=True)
    share = np.abs(np.diag(R)) / length[order]
    dependent = tuple(int(j) for j in order[share < DEPENDENT])
    s = np.linalg.svd(A / length, compute_uv=False)
    return (float(s[0] / s[-1]) if s[-1] > 1e-9 * s[0] else np.inf), dependent


def _least_squares(
    A: np.ndarray, v: np.ndarray, most: np.ndarray, weights: np.ndarray | None = None
) -> np.ndarray:
    """The w with the least sum of weights |v + A w|^2, |w_j| <= most_j."""
    root = 1.0 if weights is None else np.sqrt(weights / weights.max())
    M, right = A * np.reshape(root, (-1, 1)), v * root
    w = np.asarray(np.linalg.lstsq(M, -right)[0])
    if (np.abs(w) <= most).all():
        return w

    # gradient of |r|^2 with respect to Re w and Im w: 2 Re and 2 Im of A^H r
    def cost(x: np.ndarray) -> tuple[float, np.ndarray]:
        r = right + M @ _complex(x)
        return float(np.vdot(r, r).real), 2 * _real(M.conj().T @ r)

    return _complex(_convex(cost, _real(_within(w, most)), [_discs(most)]))


def _least_sum(A: np.ndarray, v: np.ndarray, most: np.ndarray) -> np.ndarray:
    """The w with the least sum of |v + A w|, by weights 1/|r_k| anew until w stands still."""
    w = _least_squares(A, v, most)
    for _ in range(_ROUNDS):
        r = np.abs(v + A @ w)

        # a reading that is met exactly would weigh without limit
        moved = _least_squares(A, v, most, 1 / np.maximum(r, 1e-9))
        still = np.abs(moved - w).max() <= _STILL * np.abs(moved).max()
        w = moved
        if still:
            break
    return w


def _least_largest(A: np.ndarray, v: np.ndarray, most: np.ndarray) -> np.ndarray:
    """The w with the least t such that |v + A w|^2 <= t^2 in every row."""
    w = _least_squares(A, v, most)
    t = float(np.abs(v + A @ w).max())
    objective = np.append(np.zeros(2 * len(w)), 1.0)

    # t^2 - |r_k|^2 >= 0; its slope over Re w and Im w is -2 Re and -2 Im of conj(A_k) r_k
    def room(x: np.ndarray) -> np.ndarray:
        return np.asarray(x[-1] ** 2 - np.abs(v + A @ _complex(x[:-1])) ** 2)

    def slope(x: np.ndarray) -> np.ndarray:
        rows = A.conj() * (v + A @ _complex(x[:-1]))[:, None]
        return np.column_stack(
            [-2 * rows.real, -2 * rows.imag, np.full(len(v), 2 * x[-1])],
        )

    rows = {"type": "ineq", "fun": room, "jac": slope}
    found = _convex(
        lambda x: (float(x[-1]), objective), np.append(_real(w), t), [rows, _discs(most)]
    )
    return _complex(found[:-1])


_NORMS: dict[str, Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]] = {
    "squares": _least_squares,
    "sum": _least_sum,
    "largest": _least_largest,
}


def _convex(
    cost: Callable[[np.ndarray], tuple[float, np.ndarray]],
    start: np.ndarray,
    constraints: Sequence[dict[str, object]],
) -> np.ndarray:
    """The minimum of a convex problem by sequential quadratic programming (SLSQP, Kraft 1988)."""
    from scipy.optimize import minimize

    options = {"ftol": 1e-14, "maxiter": 1000}
    found = minimize(
        cost, start, jac=True, method="SLSQP", constraints=list(constraints), options=options
    )
    return np.asarray(found.x)


def _discs(most: np.ndarray) -> dict[str, object]:
    """The constraints 1 - |w_j|^2 / most_j^2 >= 0 of the planes that have a limit; x begins with
    Re w, Im w.
    """
    p, limited = len(most), np.flatnonzero(np.isfinite(most))
    scale = most[limited] ** -2.0

    def room(x: np.ndarray) -> np.ndarray:
        return np.asarray(1 - scale * (x[limited] ** 2 + x[p + limited] ** 2))

    def slope(x: np.ndarray) -> np.ndarray:
        rows = np.zeros((len(limited), len(x)))
        k = np.arange(len(limited))
        rows[k, limited] = -2 * scale * x[limited]
        rows[k, p + limited] = -2 * scale * x[p + limited]
        return rows

    return {"type": "ineq", "fun": room, "jac": slope}


def _within(w: np.ndarray, most: np.ndarray) -> np.ndarray:
    return np.asarray(w * np.minimum(1.0, most / np.maximum(np.abs(w), 1e-300)))


def _real(w: np.ndarray) -> np.ndarray:
    return np.concatenate([w.real, w.imag])


def _complex(x: np.ndarray) -> np.ndarray:
    half = len(x) // 2
    return np.asarray(x[:half] + 1j * x[half:])
