"""H-infinity control by two Riccati equations: which gamma can be reached, and the central
controller for one.

The plant is brought to D12 = [0; I], D21 = [0, I] by unitary transformations of z and w and
invertible ones of u and y. With

    D11 = [D1111 D1112]   r - m rows        N = [D1111 D1112],  E = [D1121 D1122]
          [D1121 D1122]   m rows
           q - p  p columns

gamma can be reached exactly when (Zhou, Doyle & Glover 1996, theorem 17.1 (a); their X_inf, Y_inf,
F, L and hats)

    (i)   gamma > max(|[D1111 D1112]|, |[D1111; D1121]|),
    (ii)  X >= 0 solves its Riccati equation, that of the Hamiltonian H_inf,
    (iii) Y >= 0 solves its own, that of J_inf, which is H_inf of the transposed plant,
    (iv)  rho(X Y) < gamma^2.

Theorem 17.1 (b) gives the controllers, here the central one, Q = 0. First published by Glover &
Doyle 1988, Systems & Control Letters 11; for D11 = 0 they are theorems 3 and 4 of Doyle, Glover,
Khargonekar & Francis 1989, IEEE Trans. Automatic Control 34, and theorems 16.4 and 16.5 of the
book.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ambrose.core.checks import InvalidInput, NumericalFailure, invalid
from ambrose.core.frequency import evaluate, largest_gain, schur_eigenvalues, schur_form
from ambrose.core.lft import GeneralizedPlant
from ambrose.core.matrix_equations import solve_riccati
from ambrose.core.statespace import StateSpace, balance_matrix as balance, balance_system

# The generalized plant made ready for computing: states, controls and measurements scaled, D22
# taken out; and the way back.
#
# States, u and y may be measured in any unit without a change of gamma; the algorithms are not
# indifferent. Here the states are balanced, each u is given the size at which its direct effect on
# z (the column of D12) has norm 1, each y the size at which the direct effect of w on it (the row
# of D21) has norm 1. w and z stay as they are: their sizes are the specification.


_SAMPLES = 200  # frequencies at which the unavoidable gain is looked for
# a direct term below this fraction of its channel's largest gain counts as zero
_NEGLIGIBLE = 1e-10
Matrices = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]


@dataclass(frozen=True, slots=True, eq=False)
class ScaledPlant:
    """x' = A x + B1 w + B2 u, z = C1 x + D11 w + D12 u, y = C2 x + D21 w in scaled units, without
    D22.

    A (n, n), B1 (n, q), B2 (n, m), C1 (r, n), C2 (p, n), D11 (r, q), D12 (r, m), D21 (p, q);
    u_scale (m,), y_scale (p,): u = u_scale u_scaled, y_scaled = y_scale y; D22 (p, m) in original
    units; gain: the largest sampled gain from w to z.
    """

    A: np.ndarray
    B1: np.ndarray
    B2: np.ndarray
    C1: np.ndarray
    C2: np.ndarray
    D11: np.ndarray
    D12: np.ndarray
    D21: np.ndarray
    D22: np.ndarray
    u_scale: np.ndarray
    y_scale: np.ndarray
    gain: float

    def dual(self) -> ScaledPlant:
        """The transposed plant: what holds for control there holds for estimation here."""
        return ScaledPlant(
            self.A.T,
            self.C1.T,
            self.C2.T,
            self.B1.T,
            self.B2.T,
            self.D11.T,
            self.D21.T,
            self.D12.T,
            self.D22.T,
            self.y_scale,
            self.u_scale,
            self.gain,
        )

    def in_states(self, T: np.ndarray, inverse: np.ndarray) -> ScaledPlant:
        """In the states x = T x', T (n, n) with its inverse."""
        B1 = inverse @ self.B1
        B2 = inverse @ self.B2
        C1 = self.C1 @ T
        C2 = self.C2 @ T
        return replace(self, A=inverse @ self.A @ T, B1=B1, B2=B2, C1=C1, C2=C2)

    def in_time(self, rate: float) -> ScaledPlant:
        """With time measured in 1/rate, rate in [rad/s]."""
        root = np.sqrt(rate)
        B1 = self.B1 / root
        B2 = self.B2 / root
        C1 = self.C1 / root
        C2 = self.C2 / root
        return replace(self, A=self.A / rate, B1=B1, B2=B2, C1=C1, C2=C2)

    def in_units(self, gamma: float) -> ScaledPlant:
        """With w and z in units in which ``gamma`` is 1."""
        root = np.sqrt(gamma)
        B1 = self.B1 / root
        C1 = self.C1 / root
        D12 = self.D12 / root
        D21 = self.D21 / root
        return replace(self, B1=B1, C1=C1, D11=self.D11 / gamma, D12=D12, D21=D21)

    def extended(self, rows: np.ndarray, columns: np.ndarray, epsilon: float) -> ScaledPlant:
        """With the outputs z' = epsilon rows [x; u] and the inputs [x'; y] += epsilon columns w'
        added; the rest unchanged.

        rows (k, n + m), columns (n + p, l). Every controller has a larger or equal norm on this
        plant than on the original.
        """
        n = len(self.A)
        more_z = len(rows)
        more_w = columns.shape[1]
        rows, columns = epsilon * rows, epsilon * columns
        q, r = self.B1.shape[1], len(self.C1)
        return replace(
            self,
            B1=np.hstack([self.B1, columns[:n]]),
            C1=np.vstack([self.C1, rows[:, :n]]),
            D11=np.block([[self.D11, np.zeros((r, more_w))], [np.zeros((more_z, q + more_w))]]),
            D12=np.vstack([self.D12, rows[:, n:]]),
            D21=np.hstack([self.D21, columns[n:]]),
        )


def check_plant(plant: Any) -> GeneralizedPlant:
    """``plant``, after refusing what is no generalized plant. Raises InvalidInput."""
    if not isinstance(plant, GeneralizedPlant):
        raise invalid(
            "plant",
            type(plant).__name__,
            "a GeneralizedPlant",
            "GeneralizedPlant(system, w, u, z, y) makes one",
        )
    return plant


def scale_plant(plant: GeneralizedPlant) -> ScaledPlant:
    """``plant`` scaled. Raises InvalidInput for a sampled plant and for empty w, u, z or y."""
    for side, what in zip(
        "wuzy", ("disturbance", "control", "performance output", "measurement"), strict=True
    ):
        if not getattr(plant, side):
            raise invalid(
                f"the number of {what} signals {side}", 0, "at least 1", f"name the plant's {side}"
            )
    system = plant.system
    if system.dt is not None:
        raise invalid(
            "the plant's sample time",
            system.dt,
            "None (continuous time)",
            "design in continuous time, sample the controller",
        )
    q, r = len(plant.w), len(plant.z)

    # balanced for the sampled gains, which u and y without a direct term are scaled by
    A, B, C, _ = balance_system(system.A, system.B, system.C)
    gains = _gains(A, B, C, system.D)
    u_scale = _channel_scale(np.linalg.norm(system.D[:r, q:], axis=0), gains[:, :r, q:], axis=1)
    y_scale = _channel_scale(np.linalg.norm(system.D[r:, :q], axis=1), gains[:, r:, :q], axis=2)

    # columns (w, u) of B and rows (z, y) of C in the new units, which change the balance
    B = np.hstack([B[:, :q], B[:, q:] * u_scale])
    C = np.vstack([C[:r], C[r:] * y_scale[:, None]])
    A, B, C, _ = balance_system(A, B, C)

    # A direct term that is rounding beside its channel's gain is no direct term.
    D12, D21 = system.D[:r, q:] * u_scale, system.D[r:, :q] * y_scale[:, None]
    D12[:, np.linalg.norm(D12, axis=0) < _NEGLIGIBLE] = 0.0
    D21[np.linalg.norm(D21, axis=1) < _NEGLIGIBLE] = 0.0
    gain = float(np.linalg.norm(gains[:, :r, :q], axis=(1, 2)).max())
    return ScaledPlant(
        A,
        B[:, :q],
        B[:, q:],
        C[:r],
        C[r:],
        system.D[:r, :q],
        D12,
        D21,
        system.D[r:, q:],
        u_scale,
        y_scale,
        gain,
    )


def _gains(A: np.ndarray, B: np.ndarray, C: np.ndarray, D: np.ndarray) -> np.ndarray:
    """|P(s)| (w, r + p, q + m) at points near the imaginary axis with the moduli of the poles,
    and at infinity.
    """
    form = schur_form(A, B, C, D)
    moduli = np.abs(form.poles)
    moduli = np.unique(moduli[moduli > 1e3 * form.pole_errors])
    if not moduli.size:
        moduli = np.array([max(1e-3, np.abs(A).max(initial=0.0))])
    return np.abs(np.concatenate([evaluate(form, moduli * np.exp(1.3j)), D[None]]))


def unavoidable(plant: ScaledPlant, at: Sequence[float] = ()) -> float:
    """A gain from w to z below which no controller comes, stabilising or not, whatever the rank of
    D12 and D21.

    At a frequency the loop is P11 + P12 R P21, with R the controller's choice: what P12 does not
    reach or P21 does not see stays, max(|N^H P11|, |P11 M|) with N, M the complements of P12 and
    P21 (Parrott 1978); the largest over some frequencies, those ``at`` [rad/s] among them.
    """
    q, r = plant.B1.shape[1], len(plant.C1)
    D = np.block(
        [[plant.D11, plant.D12], [plant.D21, np.zeros((len(plant.C2), plant.B2.shape[1]))]]
    )
    form = schur_form(plant.A, np.hstack([plant.B1, plant.B2]), np.vstack([plant.C1, plant.C2]), D)

    # frequencies around the poles; those that rounding cannot tell from zero do not count
    moduli = np.abs(form.poles[np.abs(form.poles) > 1e3 * form.pole_errors])
    omega = (
        np.geomspace(0.1 * moduli.min(), 10.1 * moduli.max(), _SAMPLES)
        if moduli.size
        else np.zeros(0)
    )
    P = np.concatenate([evaluate(form, 1j * np.append(omega, at)), D[None]])
    P11 = P[:, :r, :q]
    left, right = _complements(P[:, :r, q:]), _complements(P[:, r:, :q].conj().swapaxes(1, 2))
    sizes = np.maximum(largest_gain(left.conj().swapaxes(1, 2) @ P11), largest_gain(P11 @ right))
    rounding = 1e-12 * np.linalg.norm(P11, axis=(1, 2))
    return max(0.0, float((sizes - rounding).max()))


def _complements(M: np.ndarray) -> np.ndarray:
    """Orthonormal bases of what each M (w, r, m) does not reach, or reaches only by rounding,
    beside columns of zeros, (w, r, r).
    """
    U, values, _ = np.linalg.svd(M)
    rounding = np.finfo(float).eps * M.shape[1] * values.max(axis=1, initial=0.0, keepdims=True)
    reached = (values > rounding).sum(axis=1)
    return np.asarray(U * (np.arange(M.shape[1]) >= reached[:, None])[:, None])


def _channel_scale(direct: np.ndarray, gains: np.ndarray, axis: int) -> np.ndarray:
    """1/direct (k,), or 1/(largest gain) where that is negligible, or 1 where there is no gain at
    all.
    """
    largest = np.linalg.norm(gains, axis=axis).max(axis=0)
    size = np.where(direct > _NEGLIGIBLE * largest, direct, largest)
    return 1 / np.where(size > 0, size, 1.0)


def original_controller(
    plant: ScaledPlant, matrices: Matrices, inputs: Sequence[str], outputs: Sequence[str]
) -> StateSpace:
    """The controller for the original plant from one for the scaled plant without D22; states
    balanced.

    Raises NumericalFailure where the loop around D22 has no solution.
    """
    A, B, C, D = original_matrices(plant, matrices)
    A, B, C, _ = balance_system(A, B, C)
    return StateSpace(A, B, C, D, inputs, outputs)


def original_matrices(plant: ScaledPlant, matrices: Matrices) -> Matrices:
    """The matrices for the original plant, in the same controller states. Raises NumericalFailure
    like its caller.
    """
    A, B, C, D = matrices
    D22 = plant.D22 * plant.u_scale * plant.y_scale[:, None]
    E = np.eye(len(D)) + D @ D22  # u = K0 (y - D22 u)
    if np.linalg.svd(E, compute_uv=False).min(initial=1.0) < 1e-12 * max(
        1.0, float(np.abs(E).max())
    ):
        raise NumericalFailure(
            "the controller and D22 form an algebraic loop; increase the back-off a little"
        )

    # u = C x + D (y - D22 u): E u = C x + D y;   x' = A x + B (y - D22 u)
    C, D = np.linalg.solve(E, C), np.linalg.solve(E, D)
    A, B = A - B @ D22 @ C, B - B @ D22 @ D

    # y_scaled = y_scale y, u = u_scale u_scaled
    return (
        A,
        B * plant.y_scale,
        C * plant.u_scale[:, None],
        D * plant.u_scale[:, None] * plant.y_scale,
    )


# What the two Riccati equations need of a generalized plant, checked by name, and what can be
# mended.
#
# 1. (A, B2) stabilisable and (C2, A) detectable: without it no controller stabilises the plant at
#    all. Not mended.
# 2. D12 has full column rank: every control costs something at infinite frequency. Mended by z' =
#    epsilon u.
# 3. D21 has full row rank: every measurement is noisy at infinite frequency. Mended by y' = y +
#    epsilon w'.
# 4. P12 has no zeros on the imaginary axis: [A - jw, B2; C1, D12] keeps full column rank. Mended by
#    z' = epsilon x in that mode.
# 5. P21 has no zeros on the imaginary axis: [A - jw, B1; C2, D21] keeps full row rank. Mended by
#    disturbing that mode.
#
# They are (A1) to (A4) of Zhou, Doyle & Glover 1996, sec. 17.1; 2 and 3 here are (A2) there, where
# D12 = [0; I] and D21 = [0, I] already. D22 is taken out by their loop shifting, sec. 17.2
# (above).


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


_FLOOR = 1e-9  # gamma below this fraction of the plant's gain from w to z counts as zero
# successive factors above the lower bound, the last one repeated
_GROWTH = (1.02, 1.2, 2.0, 4.0, 10.0)
_LARGEST = 1e12  # how far above the lower bound a solution is looked for
_STEPS = 60  # of the bisection on gamma, at most


@dataclass(frozen=True, slots=True, eq=False)
class Level:
    """One gamma tried: ``reason`` is "feasible" or the condition that failed; rho: spectral radius
    of X Y / gamma^2.
    """

    gamma: float
    reason: str
    rho: float
    X: np.ndarray
    Y: np.ndarray

    @property
    def feasible(self) -> bool:
        return self.reason == "feasible"


@dataclass(frozen=True, slots=True, eq=False)
class GammaSearch:
    """The optimal gamma lies between ``lower`` and ``best.gamma``, which can be reached.

    lower: the highest level that failed, as computed; a bound that is shown is that of
    hinf_lmi.py. inaccurate: whether rounding spoiled a level; vanishing:
    whether gamma fell to a part in 1e9 of the plant's gain, where the search ends; history: a row
    for each level.
    """

    lower: float
    best: Level
    inaccurate: bool
    vanishing: bool
    history: tuple[dict[str, float], ...]


def normal_form(plant: ScaledPlant) -> tuple[ScaledPlant, np.ndarray, np.ndarray]:
    """The plant with D12 = [0; I], D21 = [0, I], and T_u (m, m), T_y (p, p): u = T_u u_normal,
    y_normal = T_y y.

    Raises NumericalFailure when D12 or D21 lacks rank.
    """
    m, p = plant.B2.shape[1], len(plant.C2)
    if len(plant.C1) < m or plant.B1.shape[1] < p:
        raise NumericalFailure("D12 is wide or D21 tall; regularise first")

    # D12 = U [S; 0] V_u^T,   D21 = U_y [S 0] V^T
    U, su, Vuh = np.linalg.svd(plant.D12)
    Uyh, sy, Vh = np.linalg.svd(plant.D21)
    if not (su.min() > 1e-14 and sy.min() > 1e-14):
        raise NumericalFailure("D12 or D21 is singular; regularise first")

    # z_normal = [U_2 U_1]^T z,   w = [V_2 V_1] w_normal,   T_u = V_u S^-1,   T_y = S^-1 U_y^T
    z = np.hstack([U[:, m:], U[:, :m]]).T
    w = np.vstack([Vh[p:], Vh[:p]]).T
    T_u, T_y = Vuh.T / su, (Uyh / sy).T
    normal = replace(
        plant,
        B1=plant.B1 @ w,
        B2=plant.B2 @ T_u,
        C1=z @ plant.C1,
        C2=T_y @ plant.C2,
        D11=z @ plant.D11 @ w,
        D12=np.eye(len(z), m, m - len(z)),
        D21=np.eye(p, len(w), len(w) - p),
    )
    return normal, T_u, T_y


def _riccati(plant: ScaledPlant, gamma: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A, G, Q (n, n) of A^T X + X A - X G X + Q = 0, (ii) of the theorem, H_inf = [A -G; -Q -A^T].

    The theorem inverts R = D1^T D1 - diag(gamma^2 I, 0), D1 = [D11 D12]; here the control u is
    eliminated by hand, so that only gamma^2 I - N^T N is inverted.
    """
    # C1 = [C; C'], C' the last m rows. The last m of z, v = C' x + E w + u, serve as the control:
    # x' = (A - B2 C') x + (B1 - B2 E) w + B2 v,   |z|^2 = |C x + N w|^2 + |v|^2.
    k = len(plant.C1) - plant.B2.shape[1]
    N, E = plant.D11[:k], plant.D11[k:]
    B = plant.B1 - plant.B2 @ E
    A = plant.A - plant.B2 @ plant.C1[k:]

    # S^-1 = 0
    if np.isinf(gamma):
        return A, plant.B2 @ plant.B2.T, plant.C1[:k].T @ plant.C1[:k]

    # S = gamma^2 I - N^T N, worst w = S^-1 (N^T C + B^T X) x, v = -B2^T X x:
    # A + B S^-1 N^T C,   G = B2 B2^T - B S^-1 B^T,   Q = C^T (I + N S^-1 N^T) C
    S = gamma**2 * np.eye(N.shape[1]) - N.T @ N
    S_N, S_B = np.linalg.solve(S, N.T @ plant.C1[:k]), np.linalg.solve(S, B.T)
    G = plant.B2 @ plant.B2.T - B @ S_B
    Q = plant.C1[:k].T @ (plant.C1[:k] + N @ S_N)
    return A + B @ S_N, (G + G.T) / 2, (Q + Q.T) / 2


def hamiltonian(plant: ScaledPlant, gamma: float) -> np.ndarray:
    """H_inf (2n, 2n) of the theorem; J_inf is that of the dual plant."""
    A, G, Q = _riccati(plant, gamma)
    return np.block([[A, -G], [-Q, -A.T]])


def _solve(plant: ScaledPlant, gamma: float, name: str) -> tuple[np.ndarray, str]:
    """X (n, n) and "", or the reason why there is no positive semidefinite one."""
    A, G, Q = _riccati(plant, gamma)

    # X = size X': A^T X' + X' A - X' (size G) X' + Q / size = 0
    size = float(np.linalg.norm(A) / np.linalg.norm(G)) if A.any() and G.any() else 1.0
    solution = solve_riccati(A, size * G, Q / size)  # in units of X in which G is as large as A
    if not solution.solved:
        return solution.X, f"{name}: {solution.status}"
    X = size * solution.X
    values = np.linalg.eigvalsh(X)
    if values.size and values[0] < -1e-12 * max(values[-1], 0.0):
        # X >= 0 exactly when u = -(C1' + B2^T X) x alone stabilises; a test that does not depend on
        # the states' units
        rows = len(plant.C1) - plant.B2.shape[1]
        closed = plant.A - plant.B2 @ (plant.C1[rows:] + plant.B2.T @ X)
        if np.linalg.eigvals(closed).real.max() >= 0:
            return X, f"{name}: not positive semidefinite"
    return X, ""


def gains(plant: ScaledPlant, gamma: float, X: np.ndarray) -> np.ndarray:
    """F = -R^-1 (D1^T C1 + B^T X) (q + m, n): worst disturbance F1 and control F2."""
    # in the letters of _riccati: w = F1 x, u = v - C' x - E w, v = -B2^T X x
    k = len(plant.C1) - plant.B2.shape[1]
    N, E = plant.D11[:k], plant.D11[k:]
    S = gamma**2 * np.eye(N.shape[1]) - N.T @ N
    F1 = np.linalg.solve(S, N.T @ plant.C1[:k] + (plant.B1 - plant.B2 @ E).T @ X)
    return np.vstack([F1, -(plant.C1[k:] + plant.B2.T @ X) - E @ F1])


def try_gamma(plant: ScaledPlant, gamma: float) -> Level:
    """The Riccati conditions at one gamma, for a plant in normal form; gamma inf is the LQG
    problem.
    """
    X, reason = _solve(plant, gamma, "X")
    if reason:
        return Level(gamma, reason, np.nan, X, X)
    Y, reason = _solve(plant.dual(), gamma, "Y")
    if reason:
        return Level(gamma, reason, np.nan, X, Y)
    radius = float(np.linalg.eigvals(X @ Y).real.max(initial=0.0))
    if np.isinf(gamma):
        return Level(gamma, "feasible", radius, X, Y)
    rho = radius / gamma**2
    return Level(gamma, "feasible" if rho < 1 else "rho(X Y) >= gamma^2", rho, X, Y)


def direct_bound(plant: ScaledPlant) -> float:
    """What no controller can change at infinite frequency, (i): max(|[D1111 D1112]|, |[D1111;
    D1121]|), in normal form.
    """
    rows, columns = len(plant.C1) - plant.B2.shape[1], plant.B1.shape[1] - len(plant.C2)
    sizes = [
        np.linalg.norm(part, 2) if part.size else 0.0
        for part in (plant.D11[:rows], plant.D11[:, :columns])
    ]
    return float(max(sizes))


def search_gamma(
    plant: ScaledPlant, tolerance: float, report: Callable[[Level], None]
) -> GammaSearch:
    """The smallest reachable gamma to the relative ``tolerance``, for a plant in normal form.

    Between the bounds: false position on rho, which falls with gamma, where X and Y exist, else
    bisection. ``report`` sees every level and may raise to end the search. Raises NumericalFailure
    when even large gammas fail.
    """
    history: list[dict[str, float]] = []
    inaccurate: list[str] = []

    def attempt(gamma: float) -> Level:
        level = try_gamma(plant, gamma)
        history.append({"gamma": gamma, "feasible": float(level.feasible), "rho": level.rho})
        inaccurate.extend([level.reason] if "inaccurate" in level.reason else [])
        report(level)
        return level

    # Bounds from below: (i), and rho(X Y) < gamma^2 with the X and Y of gamma = inf, the smallest.
    base = try_gamma(plant, np.inf)
    floor = _FLOOR * (plant.gain if plant.gain > 0 else 1.0)
    start = direct_bound(plant)
    if base.feasible:
        start = max(start, float(np.sqrt(base.rho)))  # X and Y grow as gamma falls
    low = Level(max(start, floor), "the lower bound", np.nan, base.X, base.Y)
    high = low

    # Upwards from the lower bound to a gamma that can be reached.
    for step in range(_STEPS):
        gamma = high.gamma * (
            1 + tolerance if step == 0 else _GROWTH[min(step - 1, len(_GROWTH) - 1)]
        )
        high = attempt(gamma)
        if high.feasible:
            break
        if gamma > _LARGEST * max(start, plant.gain, floor):
            why = base.reason if not base.feasible else high.reason
            raise NumericalFailure(
                f"no gamma up to {gamma:.3g} passes the Riccati conditions ({why}); look for "
                "weights or modes whose poles are "
                "many decades apart, for modes close to the imaginary axis that u cannot move or "
                "y does not show, or "
                'use method="lmi"'
            )
        low = high

    # Between: low fails, high can be reached.
    while high.gamma > (1 + tolerance) * low.gamma and len(history) < _STEPS:
        level = attempt(_next(low, high, tolerance))
        low, high = (low, level) if level.feasible else (level, high)
    return GammaSearch(low.gamma, high, bool(inaccurate), low.gamma == floor, tuple(history))


def _next(low: Level, high: Level, tolerance: float) -> float:
    """A gamma between: on either side of the estimated root of rho = 1 in turn, so that both bounds
    close in on it.
    """
    a, b = np.log(low.gamma), np.log(high.gamma)
    middle = (a + b) / 2
    if low.rho > 1 and 0 < high.rho < 1:
        # log rho taken as linear in log gamma; the guess lies beyond the root as seen from the
        # nearer bound, by less than half the tolerance, and 2 % of the way or more from both
        root = a + (b - a) * np.log(low.rho) / (np.log(low.rho) - np.log(high.rho))
        aside = 0.45 * tolerance
        guess = root + aside if b - root > root - a else root - aside
        shortest = 0.02 * (b - a)
        middle = min(max(guess, a + shortest), b - shortest)
    return float(np.exp(middle))


def central_controller(plant: ScaledPlant, gamma: float) -> Matrices:
    """(A, B, C, D) of the central controller at ``gamma`` for a plant in normal form without D22:
    (A, B1, C1, D11) with hats.

    Raises NumericalFailure naming the condition that fails at this gamma.
    """
    level = try_gamma(plant, gamma)
    if not level.feasible or gamma <= direct_bound(plant):
        raise NumericalFailure(f"gamma = {gamma:.6g} cannot be reached: {level.reason}")
    n = len(plant.A)
    q = plant.B1.shape[1]
    r = len(plant.C1)
    m, p = plant.B2.shape[1], len(plant.C2)

    # x = diag(scale) x': X' = diag(scale) X diag(scale), Y' = diag(1/scale) Y diag(1/scale)
    scale = _even(level.X, level.Y)
    plant = plant.in_states(np.diag(scale), np.diag(1 / scale))
    X, Y = level.X * scale[:, None] * scale, level.Y / scale[:, None] / scale

    # F = [F11; F12; F2] with q - p, p and m rows, L = [L11 L12 L2] with r - m, m and p columns
    F, L = gains(plant, gamma, X), gains(plant.dual(), gamma, Y).T
    F12 = F[q - p : q]
    F2 = F[q:]
    L12 = L[:, r - m : r]
    L2 = L[:, r:]

    D1111, D1112 = plant.D11[: r - m, : q - p], plant.D11[: r - m, q - p :]
    D1121, D1122 = plant.D11[r - m :, : q - p], plant.D11[r - m :, q - p :]
    right = gamma**2 * np.eye(q - p) - D1111.T @ D1111
    left = gamma**2 * np.eye(r - m) - D1111 @ D1111.T

    # theorem 17.1 (b), every letter with a hat: D11; D12 D12^T, D21^T D21, any factors of which
    # will do; Z = (I - Y X/g^2)^-1
    D = -D1121 @ D1111.T @ np.linalg.solve(left, D1112) - D1122

    # D12 D12^T = I - D1121 (gamma^2 I - D1111^T D1111)^-1 D1121^T
    # D21^T D21 = I - D1112^T (gamma^2 I - D1111 D1111^T)^-1 D1112
    D12 = np.linalg.cholesky(np.eye(m) - D1121 @ np.linalg.solve(right, D1121.T))
    D21 = np.linalg.cholesky(np.eye(p) - D1112.T @ np.linalg.solve(left, D1112)).T

    # the variable Z holds I - Y X / gamma^2, the inverse of the theorem's Z
    Z = np.eye(n) - Y @ X / gamma**2
    B2 = np.linalg.solve(Z, plant.B2 + L12) @ D12  # Z (B2 + L12) D12
    C2 = -D21 @ (plant.C2 + F12)
    B1 = -np.linalg.solve(Z, L2) + B2 @ np.linalg.solve(D12, D)  # -Z L2 + B2 D12^-1 D11
    C1 = F2 + D @ np.linalg.solve(D21, C2)  # F2 + D11 D21^-1 C2
    # A + B F + B1 D21^-1 C2
    A = plant.A + plant.B1 @ F[:q] + plant.B2 @ F2 + B1 @ np.linalg.solve(D21, C2)
    return A, B1, C1, D


def balancing_states(level: Level) -> tuple[np.ndarray, np.ndarray]:
    """T (n, n) and its inverse: x = T x' makes X and Y of a feasible ``level`` equal and diagonal.

    There the Riccati equations are solved to full accuracy where X or Y spans many decades. Source:
    Jonckheere & Silverman 1983, IEEE Trans. Automatic Control 28 (balancing for control), by the
    square-root method.
    """
    L_x, L_y = _root(level.X), _root(level.Y)

    # X = L_x L_x^T, Y = L_y L_y^T, L_y^T L_x = U Sigma V^T:
    # T = L_y U Sigma^-1/2, T^-1 = Sigma^-1/2 V^T L_x^T, and T^T X T = T^-1 Y T^-T = Sigma
    U, values, Vt = np.linalg.svd(L_y.T @ L_x)
    root = np.sqrt(np.maximum(values, 1e-300))
    return L_y @ U / root, (L_x @ (Vt.T / root)).T


def _root(X: np.ndarray) -> np.ndarray:
    """L (n, n) with L L^T = X, nearly zero and negative eigenvalues raised to 1e-14 of the
    largest.
    """
    values, U = np.linalg.eigh(X)
    largest = float(np.abs(values).max(initial=0.0))
    return U * np.sqrt(np.maximum(values, 1e-14 * largest if largest > 0 else 1.0))


def _even(X: np.ndarray, Y: np.ndarray) -> np.ndarray:
    """State scaling (n,) that gives X and Y equal diagonals, as far as neither is nearly zero;
    powers of 2.
    """
    # scale^2 x = y / scale^2, so scale = (y / x)^(1/4)
    x, y = np.abs(np.diag(X)), np.abs(np.diag(Y))
    x, y = (
        np.maximum(x, 1e-12 * x.max(initial=1e-280)),
        np.maximum(y, 1e-12 * y.max(initial=1e-280)),
    )
    return np.exp2(np.round(np.log2(np.maximum(y, 1e-280) / np.maximum(x, 1e-280)) / 4))
