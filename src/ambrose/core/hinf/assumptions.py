"""What the two Riccati equations need of a generalized plant, checked by name, and what can be
mended.

1. (A, B2) stabilisable and (C2, A) detectable: without it no controller stabilises the plant at
   all. Not mended.
2. D12 has full column rank: every control costs something at infinite frequency. Mended by z' =
   epsilon u.
3. D21 has full row rank: every measurement is noisy at infinite frequency. Mended by y' = y +
   epsilon w'.
4. P12 has no zeros on the imaginary axis: [A - jw, B2; C1, D12] keeps full column rank. Mended by
   z' = epsilon x in that mode.
5. P21 has no zeros on the imaginary axis: [A - jw, B1; C2, D21] keeps full row rank. Mended by
   disturbing that mode.

They are (A1) to (A4) of Zhou, Doyle & Glover 1996, sec. 17.1; 2 and 3 here are (A2) there, where
D12 = [0; I] and D21 = [0, I] already. D22 is taken out by their loop shifting, sec. 17.2
(scaling.py).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ambrose.core.checks import InvalidInput
from ambrose.core.frequency import schur_eigenvalues
from ambrose.core.hinf.scaling import ScaledPlant
from ambrose.core.realisation.balancing import balance

_RANK = 1e-10  # of D12 and D21 with columns or rows of norm 1
_SINGULAR = 1e-11  # smallest singular value of an equilibrated pencil that counts as zero
# part of a left eigenvector's terms in an input, below which they cancel but for rounding
_UNREACHED = 1e-10
_NEAR_AXIS = 1e-6  # candidates: real part against the largest entry of the matrix


@dataclass(frozen=True, slots=True, eq=False)
class Assumptions:
    """``findings``: a sentence for each assumption that fails and can be mended, with the mending
    outputs and inputs.

    rows (k, n + m): outputs of [x; u]; columns (n + p, l): inputs into [x'; y] (see
    ScaledPlant.extended).
    """

    findings: tuple[str, ...]
    rows: np.ndarray
    columns: np.ndarray


def check_assumptions(plant: ScaledPlant) -> Assumptions:
    """Assumptions 1 to 5 on a scaled plant. Raises InvalidInput naming the mode where the first
    fails.
    """
    _require_stabilisable(
        plant.A,
        plant.B2,
        "(A, B2) is not stabilisable",
        "no control u reaches it",
        "give it an actuator; a weight's pole here must lie in the open left half plane (a slow "
        "pole, not an integrator)",
    )
    _require_stabilisable(
        plant.A.T,
        plant.C2.T,
        "(C2, A) is not detectable",
        "no measurement y shows it",
        "measure it; a weight's pole here must lie in the open left half plane (a slow pole "
        "instead of an integrator)",
    )
    control, rows = _side(plant, "D12 has not full column rank", "u", "P12", "z' = epsilon")
    estimation, columns = _side(
        plant.dual(), "D21 has not full row rank", "y", "P21", "w' enters with epsilon in"
    )
    return Assumptions((*control, *estimation), rows, columns.T)


def full_regularisation(plant: ScaledPlant) -> Assumptions:
    """Every state and control in z, every state and measurement disturbed: mends whatever rounding
    hides from the checks.
    """
    n = len(plant.A)
    m = plant.B2.shape[1]
    p = len(plant.C2)
    note = (
        "the Riccati equations are too close to singular: every state, control and measurement is "
        "weighted with epsilon"
    )
    return Assumptions((note,), np.eye(n + m), np.eye(n + p))


def _require_stabilisable(
    A: np.ndarray, B: np.ndarray, failure: str, why: str, remedy: str
) -> None:
    if len(A) == 0:
        return
    import scipy.linalg as sla

    scale = balance(A)[1]
    A, B = A * scale / scale[:, None], B / scale[:, None]

    # Y^T A = A_u Y^T, Y orthonormal: the left invariant space of the modes that are not clearly
    # stable (A^T Y = Y A_u^T, the leading Schur vectors of A^T); stable ones count no more
    values, errors = _eigenvalues(A)
    limit = -float(errors.max())
    T, Z, count = sla.schur(A.T, sort=lambda re, im: re >= limit)
    if not count:
        return
    A_u, Y = T[:count, :count].T, Z[:, :count]
    rounding = 1e3 * np.finfo(float).eps * np.linalg.norm(A_u)
    for value in values[(values.real >= -errors) & (values.imag >= 0)]:
        # left eigenvectors y = Y v, v^H (A_u - s I) = 0, several where modes coincide
        U, size, _ = np.linalg.svd(A_u - value * np.eye(count))
        y = Y @ U[:, min(int((size > rounding).sum()), count - 1) :]

        # y^H b_j against the sum of its terms' sizes, which no unit of a state or of u changes
        terms = np.abs(y).max(axis=1) @ np.abs(B)
        reach = y.conj().T @ B / np.where(terms > 0, terms, 1.0)
        if np.linalg.svd(reach, compute_uv=False)[: y.shape[1]].min() <= _UNREACHED or (
            y.shape[1] > reach.shape[1]
        ):
            real = 0.0 if abs(value.real) <= -limit else float(value.real)
            place = "unstable" if real else "on the imaginary axis"
            mode = _text(complex(real, value.imag))
            raise InvalidInput(
                f"{failure}: the mode s = {mode} rad/s is {place} and {why}; {remedy}"
            )


def _eigenvalues(A: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Eigenvalues (n,) and a generous bound of their rounding errors (n,), the latter for
    well-conditioned ones.
    """
    import scipy.linalg as sla

    T = sla.schur(A)[0]
    size = np.abs(T)
    return schur_eigenvalues(T), 100 * np.finfo(float).eps * np.maximum(size.max(0), size.max(1))


def _null(pencil: np.ndarray) -> np.ndarray:
    """The right vectors, as rows, of the singular values that are zero after equilibration; (k, l)
    with k < l is transposed.
    """
    wide = pencil.shape[0] < pencil.shape[1]
    matrix = pencil.conj().T if wide else pencil

    # rows, then columns, scaled to a largest entry of 1; the columns are undone in the result
    rows = np.abs(matrix).max(axis=1, initial=0.0)
    matrix = matrix / np.where(rows > 0, rows, 1.0)[:, None]
    columns = np.abs(matrix).max(axis=0, initial=0.0)
    columns = np.where(columns > 0, columns, 1.0)
    _, values, Vh = np.linalg.svd(matrix / columns, full_matrices=False)
    return Vh[values < _SINGULAR].conj() / columns


def _side(
    plant: ScaledPlant, rank: str, signal: str, name: str, remedy: str
) -> tuple[list[str], np.ndarray]:
    """Findings on D12 and P12 and the mending rows (k, n + m) in [x; u]; for D21 and P21 with the
    dual plant.
    """
    n, m = plant.B2.shape
    findings: list[str] = []

    # directions of u without a direct term; D12 is completed by them to full column rank
    _, values, Vh = np.linalg.svd(plant.D12)
    strong = int((values > _RANK).sum())
    missing = Vh[strong:]
    if len(missing):
        which = f"{len(missing)} of {m} directions of {signal} have no direct term"
        findings.append(f"{rank} ({which}); regularised by {remedy} {signal} in them")
    D12 = np.vstack([plant.D12, missing])
    C1 = np.vstack([plant.C1, np.zeros((len(missing), n))])

    # u = -D12^+ C1 x cancels what D12 reaches of z. The zeros of P12 are the modes of
    # A - B2 D12^+ C1 that the rest, U_2^T C1, does not show.
    U, values, Vh = np.linalg.svd(D12)
    gain = Vh.T / values @ U[:, :m].T
    zeros, directions = _axis_zeros(plant.A - plant.B2 @ gain @ C1, U[:, m:].T @ C1)
    if zeros:
        places = ", ".join(f"{z:.4g}" for z in zeros)
        findings.append(
            f"{name} has a zero on the imaginary axis, w = {places} rad/s; regularised by "
            f"{remedy} x in that mode"
        )

    # z' = epsilon x in a mode, of the size of the plant's own outputs
    size = max(float(np.linalg.norm(plant.C1)), float(np.linalg.norm(plant.C2)), 1e-280)
    states = np.hstack([size * directions, np.zeros((len(directions), m))])
    return findings, np.vstack([np.hstack([np.zeros((len(missing), n)), missing]), states])


def _axis_zeros(A: np.ndarray, C: np.ndarray) -> tuple[list[float], np.ndarray]:
    """Frequencies [rad/s] of the modes of A (n, n) on the imaginary axis that C (p, n) does not
    show, and their directions.
    """
    n = len(A)
    zeros: list[float] = []
    directions: list[np.ndarray] = []
    if n == 0:
        return zeros, np.zeros((0, 0))
    A, t = balance(A)
    values, _ = _eigenvalues(A)
    on_axis = np.abs(values.real) <= _NEAR_AXIS * np.abs(A).max()
    for frequency in np.unique(values[on_axis & (values.imag >= 0)].imag):
        # several where modes coincide
        for x in _null(np.vstack([A - 1j * frequency * np.eye(n), C * t])):
            zeros.append(float(frequency))
            # rows that see the mode: x^H, not x, scaled back to the plant's states
            parts = [x.real / t, x.imag / t]
            directions += [
                part / np.linalg.norm(part)
                for part in parts
                if np.linalg.norm(part) > 1e-8 * np.linalg.norm(x / t)
            ]
    return zeros, np.array(directions).reshape(-1, n)


def _text(value: complex) -> str:
    return f"{value.real:.4g}" if value.imag == 0 else f"{value.real:.4g} + {value.imag:.4g}j"
