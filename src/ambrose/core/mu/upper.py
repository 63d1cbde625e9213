"""Upper bound of the mixed structured singular value with D and G scalings.

For beta >= 0, Hermitian X > 0 that commutes with Delta and Hermitian G on the real blocks (Fan,
Tits & Doyle 1991)::

    M^H X_z M + j (G M - M^H G^H) - beta^2 X_w < 0     implies     mu(M) < beta

The smallest such beta is a generalized eigenvalue problem. It is followed along its analytic
centres (method of centres, Boyd & El Ghaoui 1993): with G = beta G~ (Young's normalisation) the
inequality reads F = V^H S V > 0, V = [beta I; M], S = [[X_w, -j G~], [j G~^H, -X_z]]. The barrier
-logdet F - logdet X + tr X is self-concordant; the trace fixes the scale of (X, G). One step lowers
beta along the tangent of the path of centres, one to three Newton steps return to the path. All
members of the batch move together; those that are done leave it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg.lapack import zpotrf

from ambrose.core.checks import memberwise
from ambrose.core.frequency import largest_gain
from ambrose.core.mu.structure import Basis, Structure, osborne, scaling_basis

# fractions of the way to the dual bound that the predictor tries
_SHRINK = (1.0, 0.98, 0.9, 0.7, 0.45, 0.2, 0.07, 0.02)
_CENTRED = 0.3  # Newton decrement that counts as centred
# added to X, whose trace is about the number of channels
_REGULARISE = (1e-10, 1e-9, 1e-8, 1e-7, 1e-6)
_LIFTS = (2.0**-52, 2.0**-48, 2.0**-40)  # of the norm of a matrix that rounding made singular
# Newton steps in a row without a centre after which there may be none: G grows without bound
_LATE = 30
_ZERO = 1e-7  # a bound below this fraction of sigma_max(M) is driven no further


@dataclass(frozen=True, slots=True, eq=False)
class UpperBound:
    """value (b,); X_w (b, n_w, n_w), X_z (b, n_z, n_z), G (b, n_w, n_z) in the inequality above;
    worst (b, n_w) complex: the direction w in which it is tight, a guess of the worst perturbation.
    """

    value: np.ndarray
    X_w: np.ndarray
    X_z: np.ndarray
    G: np.ndarray
    worst: np.ndarray

    def part(self, members: np.ndarray) -> UpperBound:
        """The same for some members of the batch."""
        return UpperBound(
            self.value[members],
            self.X_w[members],
            self.X_z[members],
            self.G[members],
            self.worst[members],
        )


def positive_definite(F: np.ndarray) -> np.ndarray:
    """Which members of the complex Hermitian batch F (b, n, n) are positive definite, (b,) bool;
    none with NaN or infinity.

    One by one: many are not, and numpy refuses a batch for one of its members.
    """
    factored = np.array([zpotrf(member.T, lower=True, clean=False)[1] == 0 for member in F], bool)
    return np.asarray(factored & np.isfinite(F).all(axis=(1, 2)))


def _inverse(F: np.ndarray) -> np.ndarray:
    """Inverses of positive definite F (b, n, n). One that rounding made singular, at the very edge
    of the feasible set, is lifted by a few roundings: the barrier is as steep there as the
    arithmetic can tell, and the descent turns back.
    """
    P = memberwise(np.linalg.inv, F)
    for lift in _LIFTS:
        k = np.flatnonzero(~np.isfinite(P).all(axis=(1, 2)))
        if len(k) == 0:
            break
        size = np.maximum(np.linalg.norm(F[k], axis=(1, 2)), np.finfo(float).tiny)
        P[k] = memberwise(np.linalg.inv, F[k] + lift * size[:, None, None] * np.eye(F.shape[-1]))
    return P


class _Path:
    """The barrier at (x, beta) for a batch of M (b, n_z, n_w)."""

    __slots__ = ("P", "S", "V", "basis", "gradient", "hessian", "kernel")

    def __init__(self, basis: Basis, M: np.ndarray, x: np.ndarray, beta: np.ndarray) -> None:
        n_w, n_z = basis.n_w, basis.n_z

        # F = V^H S V with V = [beta I; M], S over the rows (w, z); X over the rows "x" of S
        S = basis.assemble(x)
        V = np.concatenate([beta[:, None, None] * np.eye(n_w), M], axis=1)
        F, X = (
            V.conj().swapaxes(1, 2) @ S[:, : n_w + n_z, : n_w + n_z] @ V,
            S[:, n_w + n_z :, n_w + n_z :],
        )

        # P = F^-1, Hermitian in spite of rounding
        P = _inverse(F)
        P = 0.5 * (P + P.conj().swapaxes(1, 2))

        # K = diag(V P V^H, X^-1); with phi = tr X - logdet F - logdet X
        # d phi / dx_a = tr X_a - tr(K S_a),   d2 phi / dx_a dx_b = tr(K S_a K S_b)
        K = np.zeros_like(S)
        K[:, : n_w + n_z, : n_w + n_z] = V @ P @ V.conj().swapaxes(1, 2)
        K[:, n_w + n_z :, n_w + n_z :] = _inverse(X)
        self.basis = basis
        self.S = S
        self.V = V
        self.P = P
        self.kernel = K
        self.gradient = basis.trace - basis.traces(K)
        self.hessian = basis.curvature(K)

    def part(self, members: np.ndarray) -> _Path:
        """The same for some members of the batch."""
        new = object.__new__(_Path)
        new.basis = self.basis
        for name in ("P", "S", "V", "gradient", "hessian", "kernel"):
            setattr(new, name, getattr(self, name)[members])
        return new

    def tangent(self) -> np.ndarray:
        """d(gradient)/d(beta) at fixed x, (b, variables)."""
        n_w, n_z = self.basis.n_w, self.basis.n_z
        n = n_w + n_z
        V = self.V
        P = self.P
        S = self.S

        # dV / dbeta = [I; 0], of which dF = dV^H S V + V^H S dV
        dV = np.zeros_like(V)
        dV[:, :n_w] = np.eye(n_w)
        cross = dV.conj().swapaxes(1, 2) @ S[:, :n, :n] @ V
        dF = cross + cross.conj().swapaxes(1, 2)

        # dK = dV P V^H + V P dV^H - V P dF P V^H, as dP = -P dF P; X^-1 does not depend on beta
        half = dV @ P @ V.conj().swapaxes(1, 2)
        dK = np.zeros_like(self.kernel)
        dK[:, :n, :n] = (
            half + half.conj().swapaxes(1, 2) - V @ (P @ dF @ P) @ V.conj().swapaxes(1, 2)
        )
        return -self.basis.traces(dK)


def _eigenvalues(A: np.ndarray) -> np.ndarray:
    """Those of Hermitian A (b, n, n), ascending; NaN for a member that is not finite."""
    usable = np.isfinite(A).all(axis=(1, 2))
    values = np.linalg.eigvalsh(np.where(usable[:, None, None], A, 0.0))
    return np.where(usable[:, None], values, np.nan)


def _solve(H: np.ndarray, g: np.ndarray) -> np.ndarray:
    """H^-1 g for a batch of symmetric positive definite H, scaled by its diagonal and regularised
    at rounding level.
    """
    # diag(d) H diag(d) has a diagonal of ones, beside which the regularisation is measured
    d = 1 / np.sqrt(np.maximum(np.einsum("bii->bi", H), 1e-300))
    n = H.shape[1]
    scaled = H * d[:, :, None] * d[:, None, :] + 1e-14 * n * np.eye(n)
    return d * memberwise(np.linalg.solve, scaled, (g * d)[..., None])[..., 0]


def _inside(basis: Basis, M: np.ndarray, x: np.ndarray, beta: np.ndarray) -> np.ndarray:
    """Whether F > 0 and X > 0, (b,)."""
    n = basis.n_w + basis.n_z
    S = basis.assemble(x)
    V = np.concatenate([beta[:, None, None] * np.eye(basis.n_w), M], axis=1)
    inside = positive_definite(V.conj().swapaxes(1, 2) @ S[:, :n, :n] @ V)
    inside[inside] = positive_definite(S[inside, n:, n:])
    return inside


def _dual(structure: Structure, path: _Path, beta: np.ndarray) -> np.ndarray:
    """Estimate of the smallest beta the scalings can reach, from the dual variable P = F^-1; the
    larger of two.

    Per block the smallest ratio of (M P M^H)_ii to P_ii is a true dual bound on the path of
    centres, but weak for repeated blocks; beta^2 - n_w / tr(P X_w) is the usual gap of a
    logarithmic barrier.
    """
    # K holds M P M^H in its rows z. Where G drops out of tr(P F), as at a centre, no X > 0 gets
    # below a beta with (M P M^H)_ii >= beta^2 P_ii for every block i.
    n_w, K = structure.n_w, path.kernel
    ratio = np.full(len(K), np.inf)
    for place in structure.places:
        z = slice(n_w + place.z.start, n_w + place.z.stop)
        top, bottom = K[:, z, z], path.P[:, place.w, place.w]

        # X_i = x I, or one scalar: the ratio of the traces
        if place.block.full or place.block.n_w == 1:
            value = np.einsum("bii->b", top).real / np.einsum("bii->b", bottom).real
        else:
            # X_i of any shape: the smallest eigenvalue of the pencil (M P M^H)_ii - lambda P_ii
            L = memberwise(np.linalg.inv, memberwise(np.linalg.cholesky, bottom))
            value = _eigenvalues(L @ top @ L.conj().swapaxes(1, 2))[:, 0]
        ratio = np.minimum(ratio, value)

    # the gap of the barrier, in beta^2
    gap = n_w / np.einsum("bij,bji->b", path.P, path.S[:, :n_w, :n_w]).real
    # beyond beta: not on the path yet; NaN: singular to rounding
    ratio = np.where(ratio < beta**2, ratio, -np.inf)
    return np.sqrt(np.clip(np.maximum(ratio, beta**2 - gap), 0.0, None))


def _lower_beta(
    basis: Basis, M: np.ndarray, x: np.ndarray, beta: np.ndarray, path: _Path, target: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The predictor: move along the tangent of the path of centres as far towards ``target`` as
    stays inside.
    """
    # On the path gradient(x, beta) = 0: H dx + d(gradient)/d(beta) dbeta = 0;
    # dbeta = -step gives dx = step slope.
    slope = _solve(path.hessian, path.tangent())
    new_x, new_beta = x.copy(), beta.copy()
    left = np.arange(len(x))
    for fraction in _SHRINK:
        # the shortest step also with x left where it is
        for use in (1.0, 0.0) if fraction == _SHRINK[-1] else (1.0,):
            step = fraction * (beta[left] - target[left])
            try_beta = beta[left] - step
            try_x = x[left] + use * step[:, None] * slope[left]
            ok = _inside(basis, M[left], try_x, try_beta)
            new_x[left[ok]], new_beta[left[ok]] = try_x[ok], try_beta[ok]
            left = left[~ok]
            if len(left) == 0:
                return new_x, new_beta
    return new_x, new_beta


Scalings = tuple[np.ndarray, np.ndarray, np.ndarray]


def _scalings(structure: Structure, basis: Basis, x: np.ndarray, beta: np.ndarray) -> Scalings:
    """(X_w, X_z, G) of the variables x."""
    # S = [[X_w, -j G~], [j G~^H, -X_z]], G = beta G~
    S = basis.assemble(x)
    n_w = structure.n_w
    n = structure.n_w + structure.n_z
    return S[:, :n_w, :n_w], -S[:, n_w:n, n_w:n], 1j * S[:, :n_w, n_w:n] * beta[:, None, None]


def _without_centre(
    structure: Structure,
    basis: Basis,
    M: np.ndarray,
    x: np.ndarray,
    beta: np.ndarray,
    level: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """x and beta lowered to nearly what x proves: for where G can grow without bound, so that
    ``beta`` has no centre.
    """
    # what (X, G) prove, with 5 % of room to stay inside; never below the level asked for
    scalings = _scalings(structure, basis, x, beta)
    low = np.maximum(
        1.05 * _verified(structure, M, scalings[:2], scalings[2]), np.maximum(level, _ZERO / 10)
    )

    # G = beta G~ stays as it is while beta falls: G~ grows by beta / low
    with np.errstate(over="ignore"):
        moved = np.where(basis.is_g, x * (beta / low)[:, None], x)
    better = (low < 0.9 * beta) & _inside(basis, M, moved, low)
    return np.where(better[:, None], moved, x), np.where(better, low, beta)


def _drop_to_zero(
    basis: Basis, M: np.ndarray, x: np.ndarray, beta: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """With real blocks only, beta = 0 is reached when M^H X M + j (G M - M^H G) < 0; then G~ = G /
    beta at a tiny beta.
    """
    # G = beta G~ stays as it is
    near = np.full(len(x), _ZERO / 10)
    dropped = np.where(basis.is_g, x * (beta / near)[:, None], x)
    zero = _inside(basis, M, dropped, near)
    return np.where(zero[:, None], dropped, x), np.where(zero, near, beta), zero


def _minimise(
    structure: Structure,
    basis: Basis,
    M: np.ndarray,
    beta: np.ndarray,
    level: np.ndarray,
    tolerance: float,
    max_iterations: int,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Follow the centres down until within ``tolerance`` of the dual bound, or at ``level``. M is
    balanced, of size about 1.
    """
    b = len(M)
    stalled_steps = np.zeros(b, int)
    x = np.tile(basis.start, (b, 1))
    worst = np.zeros((b, basis.n_w), complex)
    active = np.arange(b)
    for iteration in range(1, max_iterations + 1):
        if not len(active):
            break
        m = M[active]
        xa = x[active]
        ba = beta[active]

        # Newton: x - H^-1 g, decrement sqrt(g^T H^-1 g); the barrier is self-concordant, so that a
        # full step stays inside while the decrement is below 1, a damped one always.
        path = _Path(basis, m, xa, ba)
        step = _solve(path.hessian, path.gradient)
        decrement = np.sqrt(np.maximum((step * path.gradient).sum(axis=1), 0.0))
        centred = decrement < _CENTRED
        damping = np.where(decrement < 0.9, 1.0, 1 / (1 + decrement))
        xa = xa - damping[:, None] * step

        # not finite, or outside all the same: rounding at the edge, no further progress
        stuck = ~np.isfinite(xa).all(axis=1) | ~_inside(basis, m, xa, ba)
        xa[stuck] = x[active][stuck]
        done = stuck.copy()

        # At a centre: how low the dual allows, but not below the level asked for; then on to there.
        if centred.any():
            c = np.flatnonzero(centred & ~stuck)
            here = path.part(c)
            target = np.minimum(np.maximum(_dual(structure, here, ba[c]), _ZERO / 10), ba[c])
            target = np.maximum(target, np.minimum(level[active[c]], ba[c]))
            done[c] = (ba[c] - target <= tolerance * ba[c]) | (ba[c] < _ZERO)
            xa[c], ba[c] = _lower_beta(basis, m[c], xa[c], ba[c], here, target)

        # Long without a centre: see _without_centre.
        stalled_steps[active] = np.where(centred, 0, stalled_steps[active] + 1)
        k = np.flatnonzero((stalled_steps[active] >= _LATE) & ~done)
        if len(k) and basis.is_g.any():
            xa[k], ba[k] = _without_centre(structure, basis, m[k], xa[k], ba[k], level[active[k]])

        # Real blocks alone: mu may be zero.
        if not structure.complex and not level.any():
            xa, ba, zero = _drop_to_zero(basis, m, xa, ba)
            done |= zero

        # Those that are done leave with the direction in which F = P^-1 is smallest: there it is
        # tight.
        if done.any() or iteration == max_iterations:
            end_now = np.flatnonzero(done) if iteration < max_iterations else np.arange(len(done))
            P = path.P[end_now]
            usable = np.isfinite(P).all(axis=(1, 2), keepdims=True)
            worst[active[end_now]] = np.linalg.eigh(np.where(usable, P, np.eye(basis.n_w)))[1][
                :, :, -1
            ]
        x[active], beta[active] = xa, ba
        active = active[~done]
    return x, beta, worst


def _verified(
    structure: Structure, M: np.ndarray, X: tuple[np.ndarray, np.ndarray], G: np.ndarray
) -> np.ndarray:
    """The bound that (X, G) prove, by one Hermitian eigenvalue problem, with the rounding error of
    that added.

    X: (X_w (b, n_w, n_w), X_z (b, n_z, n_z)). Returns the bound (b,), infinite where X is not
    positive definite to rounding.
    """
    # X = L L^H, T = L_z^H M L_w^-H: the inequality times L_w^-1 and L_w^-H reads
    # A = T^H T + L_w^-1 j G M L_w^-H + its conjugate < beta^2 I.
    L_w, L_z = (memberwise(np.linalg.cholesky, part) for part in X)
    inverse = memberwise(np.linalg.inv, L_w)
    T = L_z.conj().swapaxes(1, 2) @ M @ inverse.conj().swapaxes(1, 2)
    left = inverse @ (1j * G @ M) @ inverse.conj().swapaxes(1, 2)
    A = T.conj().swapaxes(1, 2) @ T + left + left.conj().swapaxes(1, 2)

    # The largest eigenvalue of A, rounding included, is the beta^2 proved.
    values = _eigenvalues(A)
    size = np.linalg.norm(T, axis=(1, 2)) ** 2 + 2 * np.linalg.norm(left, axis=(1, 2))
    error = 4 * structure.n_w * np.finfo(float).eps * size
    bound = np.sqrt(np.maximum(values[:, -1] + error, 0.0))
    return np.where(np.isfinite(bound), bound, np.inf)


def _proved(
    structure: Structure, M: np.ndarray, scalings: Scalings, beta: np.ndarray
) -> tuple[np.ndarray, Scalings]:
    """The verified bound, (b,), and its scalings (X_w, X_z, G).

    Where the best X is nearly singular rounding errors spoil the proof; then X + epsilon I is tried
    as well.
    """
    best = _verified(structure, M, scalings[:2], scalings[2])
    X_w, X_z, G = (part.copy() for part in scalings)
    for epsilon in _REGULARISE:
        # members for which rounding spoils what beta should prove
        k = np.flatnonzero(best > beta * (1 + 1e-8))
        if len(k) == 0:
            break
        wider = (
            scalings[0][k] + epsilon * np.eye(structure.n_w),
            scalings[1][k] + epsilon * np.eye(structure.n_z),
        )
        value = _verified(structure, M[k], wider, scalings[2][k])
        better = value < best[k]
        best[k[better]] = value[better]
        X_w[k[better]], X_z[k[better]] = wider[0][better], wider[1][better]
    return best, (X_w, X_z, G)


def needs_scaling(structure: Structure) -> bool:
    """Whether scalings can change sigma_max: not for one full block, nor for one complex scalar."""
    block = structure.places[0].block
    return len(structure.places) > 1 or block.real or block.repeat > 1


def upper_bound(
    M: np.ndarray,
    structure: Structure,
    *,
    g_scaling: bool = True,
    level: np.ndarray | None = None,
    tolerance: float = 1e-4,
    max_iterations: int = 120,
) -> UpperBound:
    """Upper bound of mu for a batch M (b, n_z, n_w), within ``tolerance`` (relative) of the best
    (D, G) bound.

    level (b,): stop at this value, with the scalings of its analytic centre: those that prove mu <
    level with most room, and so reach furthest in frequency. ``g_scaling=False`` treats real blocks
    as complex.
    """
    # The matrix worked on: diag(d_z) M diag(1/d_w) / scale, of norm 1; M = 0 needs no work.
    b = len(M)
    balanced, d_z, d_w = osborne(M, structure)
    size = largest_gain(balanced)
    alive = np.flatnonzero(size > 0)
    scale = np.where(size > 0, size, 1.0)
    unit = balanced / scale[:, None, None]

    # To begin with the balanced matrix as it is: X = I, G = 0.
    X_w, X_z = (
        np.tile(np.eye(structure.n_w, dtype=complex), (b, 1, 1)),
        np.tile(np.eye(structure.n_z, dtype=complex), (b, 1, 1)),
    )
    G = np.zeros((b, structure.n_w, structure.n_z), complex)
    value, worst = _verified_osborne(structure, unit, alive)
    if len(alive) and needs_scaling(structure):
        # X = I is inside for every beta > 1, where the path begins.
        basis = scaling_basis(structure, g_scaling=g_scaling)
        low = (np.zeros(b) if level is None else level / scale)[alive]
        x, beta, direction = _minimise(
            structure,
            basis,
            unit[alive],
            np.maximum(1.05, np.minimum(low, 10.0)),
            low,
            tolerance,
            max_iterations,
        )
        proved, new = _proved(structure, unit[alive], _scalings(structure, basis, x, beta), beta)

        # Asked for a level, the centre's scalings are taken if they prove it, though X = I may
        # prove less: they have more room.
        better = proved < (
            value[alive] if level is None else np.maximum(value, level / scale)[alive]
        )
        k = alive[better]
        value[k], worst[alive] = proved[better], direction
        X_w[k], X_z[k], G[k] = (part[better] for part in new)

    # Back to M: the inequality times scale^2, diag(d_w) on both sides.
    value = value * size
    X_w = d_w[:, :, None] * X_w * d_w[:, None, :]
    X_z = d_z[:, :, None] * X_z * d_z[:, None, :]
    G = d_w[:, :, None] * G * d_z[:, None, :] * scale[:, None, None]
    return UpperBound(value, X_w, X_z, G, worst / d_w)


def _verified_osborne(
    structure: Structure, unit: np.ndarray, alive: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """sigma_max of the balanced matrix, with its rounding error, and the right singular vector."""
    value, worst = np.zeros(len(unit)), np.zeros((len(unit), structure.n_w), complex)
    if len(alive):
        _, s, vh = np.linalg.svd(unit[alive])
        value[alive] = s[:, 0] * (1 + 4 * structure.n_w * np.finfo(float).eps)
        worst[alive] = vh[:, 0].conj()
    return value, worst
