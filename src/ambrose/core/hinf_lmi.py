"""H-infinity control by linear matrix inequalities, for plants that violate the assumptions of the
Riccati equations.

A controller with norm below gamma exists exactly when symmetric R and S (n, n) satisfy, with N_R
spanning the null space of [B2^T D12^T] and N_S that of [C2 D21],

    N^T [A R + R A^T  R C1^T   B1 ] N        N^T [A^T S + S A  S B1    C1^T ] N         [R  I]
        [C1 R        -gamma I  D11]   < 0        [B1^T S     -gamma I  D11^T]   < 0     [I  S] >= 0
        [B1^T         D11^T  -gamma I]           [C1           D11   -gamma I]

where N is diag(N_R, I) and diag(N_S, I). The controller then solves one more inequality, in closed
form. Sources: Gahinet & Apkarian 1994, Int. J. Robust Nonlinear Control 4; Iwasaki & Skelton 1994,
Automatica 30 (theorem 1). Solver: Clarabel.
"""

import contextlib
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.linalg as sla

from ambrose.core.checks import AmbroseError, InvalidInput, NumericalFailure
from ambrose.core.hinf_riccati import (
    GammaSearch,
    Matrices,
    ScaledPlant,
    gains,
    hamiltonian,
    normal_form,
    search_gamma,
    unavoidable,
)
from ambrose.core.matrix_equations import lyapunov, solve_riccati
from ambrose.core.matrix_inequalities import side, smat, svec

# A gain from w to z that no controller comes below, shown by disturbances that are written down.
#
# Two kinds. At one frequency, what the control does not reach or the measurement does not show
# (``unavoidable`` beside this file). And in time: up to t = 0 a disturbance that the measurement
# does not show, y = 0, so that no causal controller has acted, u = 0, and the state is x0 then;
# from t = 0 on a fixed disturbance, against the control that is best for it, of one that knows all
# its future. Whatever stabilising controller closes the loop,
#
#     gamma^2 >= (int |z|^2 before + min_u int |z|^2 after) / int |w|^2.
#
# This holds for every such disturbance. The one taken is that of the game at a gamma that can be
# reached: the optimum itself, to second order in the distance from it, where rho(X Y) = gamma^2
# decides. All is a Sylvester and four Lyapunov equations and the Riccati equation of gamma = inf,
# in double precision; no conclusion rests on an equation that has no solution. Source of the game:
# Basar & Bernhard 1995, H-infinity Optimal Control, chapters 4 and 5.


_ROUNDING = 1e-11  # of the energies' terms, that is taken off
_AXIS = 1e-6  # of its modulus: an eigenvalue so near the imaginary axis lies on it
_BELOW = 1e-7  # of gamma, at which the frequencies are looked for where the conditions fail


def lower_bound(plant: ScaledPlant) -> float:
    """The gain that no controller of a scaled plant comes below."""
    try:
        normal = normal_form(plant)[0]
        return shown_bound(normal, search_gamma(normal, 1e-3, lambda _: None))
    except (NumericalFailure, np.linalg.LinAlgError):
        return unavoidable(plant)


def shown_bound(plant: ScaledPlant, search: GammaSearch) -> float:
    """The same, of a plant in normal form whose optimum was searched for."""
    best, least = search.best, [0.0]
    at: list[float] = []

    # the transposed plant has the same optimum, and other disturbances
    for view, X, Y in ((plant, best.X, best.Y), (plant.dual(), best.Y, best.X)):
        # where the conditions fail for a frequency's sake, an eigenvalue on the axis shows which
        poles = np.linalg.eigvals(hamiltonian(view, search.lower * (1 - _BELOW)))
        at += np.abs(poles.imag)[np.abs(poles.real) <= _AXIS * np.abs(poles)].tolist()
        with contextlib.suppress(AmbroseError, np.linalg.LinAlgError):
            least.append(_in_time(view, best.gamma, X, Y))
    return max(unavoidable(plant, at), *least)


def _in_time(plant: ScaledPlant, gamma: float, X: np.ndarray, Y: np.ndarray) -> float:
    """The bound in time, 0 where the disturbance has no energy; raises what the equations do."""
    if not len(X):
        return 0.0
    q, r = plant.B1.shape[1], len(plant.C1)
    free = q - len(plant.C2)

    # the costate at t = 0: X x0 = gamma^2 lambda with x0 = Y lambda
    values, vectors = np.linalg.eig(X @ Y)
    costate = vectors[:, int(np.argmax(values.real))].real

    # Before, the dual game backwards: lambda' = -A_L^T lambda, w = W lambda, and its free part W_1:
    # the others follow from y = C2 x + D21 w = 0, D21 = [0 I].
    L = gains(plant.dual(), gamma, Y)
    A_L = plant.A + L.T @ np.vstack([plant.C1, plant.C2])
    W_1 = (plant.B1.T + plant.D11.T @ L[:r] + plant.D21.T @ L[r:])[:free]

    # x' = A_o x + B_o W_1 lambda: what of (lambda, x) dies out backwards in time is the past
    A_o, B_o = plant.A - plant.B1[:, free:] @ plant.C2, plant.B1[:, :free]
    backwards = np.block([[A_L.T, np.zeros_like(A_L)], [-B_o @ W_1, -A_o]])
    T, U, k = sla.schur(backwards, sort="lhp")
    past, U = T[:k, :k], U[:, :k]
    at_end = U.T @ np.concatenate([costate, Y @ costate])
    z = np.hstack([plant.D11[:, :free] @ W_1, plant.C1 - plant.D11[:, free:] @ plant.C2]) @ U
    w = sla.block_diag(W_1, -plant.C2) @ U
    before, spent = lyapunov(past.T, z.T @ z), lyapunov(past.T, w.T @ w)

    # the energies from t = 0 on, at x0
    x0 = (U @ at_end)[len(costate) :]
    terms, energy = _after(plant, gamma, X)
    parts = [at_end @ before @ at_end, *(x0 @ term @ x0 for term in terms)]
    kept, size = sum(parts), sum(abs(part) for part in parts)
    given = at_end @ spent @ at_end + x0 @ energy @ x0
    if not given > 0:
        return 0.0
    return float(np.sqrt(max(kept - _ROUNDING * size, 0.0) / (given * (1 + _ROUNDING))))


def _after(plant: ScaledPlant, gamma: float, X: np.ndarray) -> tuple[list[np.ndarray], np.ndarray]:
    """Terms (n, n) whose sum is min_u int |z|^2 from x0 on, while w is the game's worst, fixed
    beforehand; and its energy int |w|^2.
    """
    q, k = plant.B1.shape[1], len(plant.C1) - plant.B2.shape[1]
    F = gains(plant, gamma, X)
    A_c = plant.A + np.hstack([plant.B1, plant.B2]) @ F
    F = F[:q]  # w = F xi, xi' = A_c xi, xi(0) = x0

    # the last m of z, v = C' x + E w + u, serve as the control:
    # x' = A x + B w + B2 v,   |z|^2 = |C x + N w|^2 + |v|^2
    C, N = plant.C1[:k], plant.D11[:k]
    A, B = plant.A - plant.B2 @ plant.C1[k:], (plant.B1 - plant.B2 @ plant.D11[k:]) @ F

    # min = x^T P x + 2 x^T T xi + xi^T Z xi, v = -B2^T (P x + T xi):
    # A^T P + P A - P B2 B2^T P + C^T C = 0
    # (A - B2 B2^T P)^T T + T A_c + P B F + C^T N F = 0
    # A_c^T Z + Z A_c + (B F)^T T + T^T B F - T^T B2 B2^T T + (N F)^T N F = 0
    solution = solve_riccati(A, plant.B2 @ plant.B2.T, C.T @ C)
    if not solution.solved:
        raise NumericalFailure(solution.status)
    P, NF = solution.X, N @ F
    T = sla.solve_sylvester((A - plant.B2 @ (plant.B2.T @ P)).T, A_c, -(P @ B + C.T @ NF))
    BT = plant.B2.T @ T
    Z = lyapunov(A_c.T, B.T @ T + T.T @ B - BT.T @ BT + NF.T @ NF)
    return [P, 2 * T, Z], lyapunov(A_c.T, F.T @ F)


# (strictness of the inequalities, largest R and S) when designing
_MARGINS = ((1e-3, 1e3), (1e-4, 1e4), (1e-6, 1e6))
_ROUNDS = 4  # solved again in coordinates and units in which R, S and gamma are close to 1


@dataclass(frozen=True, slots=True, eq=False)
class Prepared:
    """gamma: the smallest of the inequalities (any larger one satisfies them strictly); plant: the
    scaled plant in states in which the optimal R and S are equal and diagonal, with time measured
    in 1/rate, rate in [rad/s].
    """

    gamma: float
    plant: ScaledPlant
    rate: float


def smallest_gamma(plant: ScaledPlant, time_left: Callable[[], float]) -> Prepared:
    """The smallest gamma, and the plant made ready for ``lmi_controller``; time_left() [s] bounds
    each call of the solver.

    Raises NumericalFailure when the solver fails, InvalidInput without the solver.
    """
    rate = float(np.linalg.norm(plant.A, 2)) if len(plant.A) else 1.0  # with which |A| = 1
    rate = rate if rate > 0 else 1.0
    plant = plant.in_time(rate)
    gamma = plant.gain if plant.gain > 0 else 1.0
    for _ in range(_ROUNDS):
        # In units of gamma the result is a factor, 1 once it stands still.
        R, S, value = _solve(plant.in_units(gamma), None, 0.0, np.inf, time_left())
        last, gamma = gamma, gamma * value
        if not gamma > 0:
            raise NumericalFailure(
                f"the matrix inequalities give gamma = {gamma:.3g}; w has almost no effect on "
                "z; check the inputs w and the outputs z"
            )
        plant = _balanced(plant, R, S)
        if abs(gamma / last - 1) < 5e-4:
            break
    return Prepared(gamma, plant, rate)


def lmi_controller(prepared: Prepared, gamma: float, time_left: Callable[[], float]) -> Matrices:
    """(A, B, C, D) of a controller of the plant's order with norm below ``gamma``, R S far from I
    so that its poles stay slow.

    Raises NumericalFailure when the solver finds none, InvalidInput without the solver.
    """
    unit = prepared.plant.in_units(gamma)
    reasons = []
    for strict, largest in _MARGINS:
        try:
            R, S, _ = _solve(unit, 1.0, strict, largest, time_left())
            A, B, C, D = _controller(unit, R, S)
        except (NumericalFailure, np.linalg.LinAlgError) as reason:
            reasons.append(str(reason))
            continue

        # back from time in 1/rate: K(s) = D + C (s I - A)^-1 B
        root = np.sqrt(prepared.rate)
        return A * prepared.rate, B * root, C * root, D
    raise NumericalFailure(
        f"no controller from the matrix inequalities at gamma = {gamma:.6g}: {reasons[-1]}"
    )


def _balanced(plant: ScaledPlant, R: np.ndarray, S: np.ndarray) -> ScaledPlant:
    """States x = T x' in which R and S are equal and diagonal; unchanged when they are not
    definite.
    """
    try:
        # R = L L^T, L^T S L = U Lambda U^T, T = L U Lambda^-1/4: T^-1 R T^-T = T^T S T = Lambda^1/2
        L = np.linalg.cholesky(R)
        values, U = np.linalg.eigh(L.T @ S @ L)
    except np.linalg.LinAlgError:
        return plant
    if not len(values) or values[0] <= 0 or np.linalg.cond(L) > 1e8:
        return plant
    T = L @ U / values**0.25
    return plant.in_states(T, np.linalg.inv(T))


def _solve(
    plant: ScaledPlant, gamma: float | None, strict: float, largest: float, time_limit: float
) -> tuple[np.ndarray, np.ndarray, float]:
    """R, S and the least gamma; or at a given gamma the largest t in [R tI; tI S] >= 0 under
    ``strict`` and ``largest``.

    Raises NumericalFailure.
    """
    # Variables: svec(R), svec(S), and gamma, or t at a given gamma.
    n = len(plant.A)
    count = n * (n + 1) // 2
    free_gamma = 1.0 if gamma is None else 0.0

    # The two existence conditions, in R and in S of the dual plant, with ``strict`` I to spare.
    blocks = []
    for place, half in ((0, plant), (1, plant.dual())):
        of_matrix, of_gamma, constant = existence(half)
        rows = np.zeros((len(constant), 2 * count + 1))
        rows[:, place * count : (place + 1) * count] = of_matrix
        rows[:, -1] = free_gamma * of_gamma
        identity = svec(np.eye(side(len(constant))))
        blocks.append(
            (rows, constant + (0.0 if gamma is None else gamma) * of_gamma - strict * identity)
        )

    # [R tI; tI S] >= 0, t = 1 while gamma is free
    of_R, of_S, off = coupling(n)
    blocks.append((np.column_stack([of_R, of_S, (1 - free_gamma) * off]), free_gamma * off))

    # largest I - R >= 0, largest I - S >= 0
    if np.isfinite(largest):
        for place in range(2):
            rows = np.zeros((count, 2 * count + 1))
            rows[:, place * count : (place + 1) * count] = -np.eye(count)
            blocks.append((rows, largest * svec(np.eye(n))))

    # least gamma, or largest t
    cost = np.zeros(2 * count + 1)
    cost[-1] = 1.0 if gamma is None else -1.0
    x = _clarabel(cost, blocks, time_limit)
    if gamma is not None and not x[-1] > 1:
        raise NumericalFailure(f"the largest t is {x[-1]:.6g}, but must exceed 1")
    return smat(x[:count]), smat(x[count:-1]), float(x[-1])


def existence(plant: ScaledPlant) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """svec of minus the first inequality above: coefficients of svec(R) (k, n(n+1)/2), of gamma
    (k,), and the constant (k,).

    The second one is the first one of the dual plant.
    """
    n = len(plant.A)
    r = len(plant.C1)
    q = plant.B1.shape[1]

    # N = diag(N_R, I): rows (x, z) and w of the inequality
    null = sla.null_space(np.hstack([plant.B2.T, plant.D12.T]), rcond=1e-12)
    N = sla.block_diag(null, np.eye(q))

    # N^T ([A; C1; 0] R [I 0 0] + its transpose) N for every R of the basis, with the sign reversed
    left = N.T @ np.vstack([plant.A, plant.C1, np.zeros((q, n))])
    right = N.T @ np.eye(n + r + q, n)
    basis = symmetric_basis(n)
    products = left @ basis @ right.T
    products = -(products + products.swapaxes(1, 2))
    of_matrix = np.array([svec(M) for M in products]).T.reshape(-1, len(basis))

    # what holds neither R nor gamma: B1 and D11
    gains = np.vstack([plant.B1, plant.D11])
    constant = -N.T @ np.block([[np.zeros((n + r, n + r)), gains], [gains.T, np.zeros((q, q))]]) @ N

    # -(-gamma I) in the rows z and w
    of_gamma = N.T @ np.diag(np.repeat([0.0, 1.0], [n, r + q])) @ N
    return of_matrix, svec(of_gamma), svec(constant)


def coupling(n: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """svec of [R tI; tI S]: coefficients of svec(R) and of svec(S) (n(2n+1), n(n+1)/2), and of t
    (n(2n+1),).
    """
    zero = np.zeros((n, n))
    up = np.array([svec(sla.block_diag(M, zero)) for M in symmetric_basis(n)]).T
    low = np.array([svec(sla.block_diag(zero, M)) for M in symmetric_basis(n)]).T
    return up, low, svec(np.kron([[0.0, 1.0], [1.0, 0.0]], np.eye(n)))


def symmetric_basis(n: int) -> np.ndarray:
    """Symmetric matrices (n(n+1)/2, n, n), orthonormal, in the order of svec."""
    return smat(np.eye(n * (n + 1) // 2)).reshape(-1, n, n)


def _clarabel(
    cost: np.ndarray, blocks: list[tuple[np.ndarray, np.ndarray]], time_limit: float
) -> np.ndarray:
    """Minimise cost x subject to smat(rows x + constant) >= 0 for every block. Raises
    NumericalFailure, InvalidInput.
    """
    from scipy import sparse

    try:
        import clarabel
    except ImportError as error:
        raise InvalidInput(
            'method "lmi" needs the solver Clarabel; install it with: pip install "ambrose[lmi]"'
        ) from error

    # Clarabel's form: -rows x + s = constant with smat(s) >= 0, triangles in the order of svec
    blocks = [block for block in blocks if len(block[1])]
    rows = sparse.csc_matrix(-np.vstack([block[0] for block in blocks]))
    constant = np.concatenate([block[1] for block in blocks])
    cones: list[Any] = [clarabel.PSDTriangleConeT(side(len(block[1]))) for block in blocks]
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.max_iter = 200
    settings.time_limit = max(time_limit, 1e-3)

    # a linear cost
    no_curvature = sparse.csc_matrix((len(cost), len(cost)))
    solve: Callable[[], Any] = clarabel.DefaultSolver(
        no_curvature, cost, rows, constant, cones, settings
    ).solve
    solution = solve()
    status = str(solution.status)
    if status not in ("Solved", "AlmostSolved", "InsufficientProgress"):
        raise NumericalFailure(
            f"the solver of the matrix inequalities ended with {status} after "
            f"{solution.iterations} steps"
        )
    return np.array(solution.x)


def _controller(plant: ScaledPlant, R: np.ndarray, S: np.ndarray) -> Matrices:
    """The controller at gamma = 1 in closed form, from strictly feasible R and S.

    The closed loop's matrix inequality is Psi + P^T K Q + Q^T K^T P < 0 with its certificate [S W;
    W W], W = S - R^-1.
    """
    n = len(plant.A)
    m = plant.B2.shape[1]
    p = len(plant.C2)
    r, q = len(plant.C1), plant.B1.shape[1]

    # Of the certificate X = [S W; W W] the first block of X^-1 is (S - W)^-1 = R.
    W = S - np.linalg.inv(R)
    W = (W + W.T) / 2
    X = np.block([[S, W], [W, W]])

    # The loop in the states (x, x_K): the gain K = [A_K B_K; C_K D_K] from (x_K, y) to (x_K', u),
    # A + B_u K C_y and so on.
    zero = np.zeros((n, n))
    A = sla.block_diag(plant.A, zero)
    B, C = np.vstack([plant.B1, np.zeros((n, q))]), np.hstack([plant.C1, np.zeros((r, n))])
    B_u = np.block([[zero, plant.B2], [np.eye(n), np.zeros((n, m))]])
    C_y = np.block([[zero, np.eye(n)], [plant.C2, np.zeros((p, n))]])

    # The bounded real lemma at gamma = 1, rows ((x, x_K), w, z):
    # Psi = [XA + A^T X, XB, C^T; B^T X, -I, D11^T; C, D11, -I],
    # P = [B_u^T X, 0, D12^T], Q = [C_y, D21, 0], with D12 for u and D21 for y alone.
    XA = X @ A
    Psi = np.block(
        [[XA + XA.T, X @ B, C.T], [B.T @ X, -np.eye(q), plant.D11.T], [C, plant.D11, -np.eye(r)]]
    )
    P = np.hstack([B_u.T @ X, np.zeros((n + m, q)), np.vstack([np.zeros((n, r)), plant.D12.T])])
    Q = np.hstack([C_y, np.vstack([np.zeros((n, q)), plant.D21]), np.zeros((n + p, r))])
    K = _iwasaki_skelton(Psi, P.T, Q)
    return K[:n, :n], K[:n, n:], K[n:, :n], K[n:, n:]


def _iwasaki_skelton(Psi: np.ndarray, B: np.ndarray, C: np.ndarray) -> np.ndarray:
    """K with Psi + B K C + (B K C)^T < 0: K = -w B^T Phi C^T (C Phi C^T)^-1, Phi = (w B B^T -
    Psi)^-1 > 0, B orthonormal.

    Phi is put together from its blocks along B and across it, for w may be many decades above the
    rest. Raises NumericalFailure when there is none to working precision.
    """
    # B back = along (orthonormal, the range of B), C_back C = C_full (orthonormal rows)
    U, s, Vt = np.linalg.svd(B)
    k = int((s > 1e-12 * s[0]).sum())
    along = U[:, :k]
    across = U[:, k:]
    back = Vt[:k].T / s[:k]
    V, s, Wt = np.linalg.svd(C, full_matrices=False)
    keep = s > 1e-12 * s[0]
    C_full, C_back = Wt[keep], (V[:, keep] / s[keep]).T

    # Across B no K acts: -Psi must be positive definite there.
    rest = -across.T @ Psi @ across
    if rest.size and np.linalg.eigvalsh(rest)[0] <= 0:
        raise NumericalFailure("R and S are feasible only to rounding")

    # Phi^-1 in (along, across): [w I - Psi_11, -Psi_12; -Psi_21, rest]. Its Schur complement is
    # w I - inner, inner = Psi_11 + Psi_12 rest^-1 Psi_21, slope = Psi_12 rest^-1.
    coupling = along.T @ Psi @ across
    slope = np.linalg.solve(rest, coupling.T).T
    inner = along.T @ Psi @ along + slope @ coupling.T

    # w above the largest eigenvalue of inner
    needed = np.linalg.eigvalsh((inner + inner.T) / 2)[-1]
    weight = 2 * max(float(needed), 1e-3 * float(np.linalg.norm(Psi, 2)))

    # Phi = across rest^-1 across^T + direction (w I - inner)^-1 direction^T,
    # direction = along + across slope^T, and along^T Phi = (w I - inner)^-1 direction^T
    direction = along + across @ slope.T
    small = np.linalg.inv(weight * np.eye(k) - inner)
    Phi = across @ np.linalg.solve(rest, across.T) + direction @ small @ direction.T

    # K for along and C_full in the place of B and C, then back to these
    gain = -weight * small @ direction.T @ C_full.T @ np.linalg.inv(C_full @ Phi @ C_full.T)
    return back @ gain @ C_back
