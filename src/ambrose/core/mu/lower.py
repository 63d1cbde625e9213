"""Lower bound of the structured singular value: a perturbation that makes I - M Delta singular, and
its size.

For given real parameters q the rest is a complex problem of the reduced matrix F(q) = M_cc + M_cr Q
(I - M_rr Q)^-1 M_rc: every complex Delta_c and eigenvalue lambda of F Delta_c give the perturbation
(q, Delta_c / lambda), exactly singular, of size max(|q|, 1 / |lambda|). So any search gives a true
bound; here it is a projected ascent over q with exact gradients (the eigenvalue's first-order
change), started from the direction in which the upper bound is tight, and from seeded random
points. The complex problem is solved by one singular value or eigenvalue decomposition where that
is exact, else by the power iteration of Packard, Fan & Doyle (1988). With real blocks only, det(I -
M Q) = 0 is two equations: a Newton iteration inside a box that is bisected; for one block the real
eigenvalues are exact.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ambrose.core.checks import memberwise
from ambrose.core.frequency import largest_gain
from ambrose.core.mu.structure import Structure, osborne

_POWER_STEPS = 60  # of the complex power iteration from a cold start; a third of it when warm
_TRIES = 8  # random parameter vectors looked at per restart
_CHECK = 10  # power steps between two looks at the eigenvalue, the best is kept
_REAL_TOLERANCE = 1e-9  # relative imaginary part that counts as real


@dataclass(frozen=True, slots=True, eq=False)
class LowerBound:
    """value (b,); delta (b, n_w, n_z) complex with det(I - M delta) = 0 and largest singular value
    1 / value, NaN where value is 0.
    """

    value: np.ndarray
    delta: np.ndarray


@dataclass(frozen=True, slots=True, eq=False)
class _Parts:
    """M split into real and complex channels, and which real channel belongs to which real block,
    (blocks, channels).
    """

    structure: Structure
    real_w: np.ndarray
    real_z: np.ndarray
    complex_w: np.ndarray
    complex_z: np.ndarray
    member: np.ndarray


def _parts(structure: Structure) -> _Parts:
    def channels(places: tuple, side: str, count: int) -> np.ndarray:
        numbers = np.arange(count)
        return np.concatenate([numbers[:0], *(numbers[getattr(place, side)] for place in places)])

    real, other = structure.real, structure.complex

    # the real block of every real channel, in order
    owner = np.repeat(np.arange(len(real)), [place.block.n_w for place in real]).astype(int)
    return _Parts(
        structure,
        channels(real, "w", structure.n_w),
        channels(real, "z", structure.n_z),
        channels(other, "w", structure.n_w),
        channels(other, "z", structure.n_z),
        (owner == np.arange(len(real))[:, None]).astype(float),
    )


def _unit(v: np.ndarray) -> np.ndarray:
    """v over its length, along the last axis; zero stays zero."""
    size = np.linalg.norm(v, axis=-1, keepdims=True)
    return v / np.where(size > 0, size, 1.0)


def _phase(c: np.ndarray) -> np.ndarray:
    size = np.abs(c)
    return np.where(size > 0, c / np.where(size > 0, size, 1.0), 1.0)


def _align(structure: Structure, a: np.ndarray, w: np.ndarray) -> np.ndarray:
    """Delta (b, n_wc, n_zc) of unit size that maps a (b, n_zc) closest to w (b, n_wc), block by
    block.
    """
    delta = np.zeros((len(a), w.shape[1], a.shape[1]), complex)
    i = j = 0
    for place in structure.complex:
        n_w, n_z = place.block.n_w, place.block.n_z
        ai, wi = a[:, j : j + n_z], w[:, i : i + n_w]

        # Delta_i = w_i a_i^H / (|w_i| |a_i|), or for a repeated scalar e^j phi I with phi of a_i^H
        # w_i
        if place.block.full:
            delta[:, i : i + n_w, j : j + n_z] = (
                _unit(wi)[:, :, None] * _unit(ai).conj()[:, None, :]
            )
        else:
            delta[:, i : i + n_w, j : j + n_z] = _phase((ai.conj() * wi).sum(axis=1))[
                :, None, None
            ] * np.eye(n_w)
        i, j = i + n_w, j + n_z
    return delta


def _eigen(F: np.ndarray, delta: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The outermost eigenvalue of F delta (b,), its right x and left y vectors (b, n_z), y^H x =
    1.
    """
    # y^H: the row of V^-1 that belongs to x, so that y^H x = 1
    values, vectors = np.linalg.eig(np.nan_to_num(F @ delta))
    top = np.abs(values).argmax(axis=1)
    pick = np.arange(len(F))
    x = vectors[pick, :, top]
    # a defective member has no left vector: its gradient is useless, its eigenvalue is not
    y = np.nan_to_num(memberwise(np.linalg.inv, vectors)[pick, top].conj())
    return values[pick, top], x, y


def _complex_problem(
    F: np.ndarray, structure: Structure, b0: np.ndarray | None, steps: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Complex structured singular value of F (b, n_zc, n_wc) from below: unit Delta_c, eigenvalue,
    right and left vectors.
    """
    blocks = [place.block for place in structure.complex]

    # One full block, exact: F v = sigma u, Delta = v u^H, and u is both eigenvectors of F Delta.
    if len(blocks) == 1 and blocks[0].full:
        u, s, vh = np.linalg.svd(F)
        x = u[:, :, 0]
        return vh[:, 0].conj()[:, :, None] * x.conj()[:, None, :], s[:, 0].astype(complex), x, x

    # One repeated scalar, exact: Delta = I, the spectral radius of F.
    if len(blocks) == 1 and not blocks[0].full:
        delta = np.tile(np.eye(F.shape[1], dtype=complex), (len(F), 1, 1))
        return delta, *_eigen(F, delta)

    # Several: the power iteration, from b0 or the first right singular vector. It need not
    # converge, nor rise from step to step: the best perturbation looked at is kept.
    b = _unit(np.linalg.svd(F)[2][:, 0].conj() if b0 is None else b0)
    best_delta, best_value = (
        np.zeros((len(F), F.shape[2], F.shape[1]), complex),
        np.full(len(F), -1.0),
    )
    w = b
    for step in range(1, steps + 1):
        # a = F b,   z = Delta^H w,   w ~ F^H z,   b ~ Delta a;   Delta maps a closest to w
        a = (F @ b[..., None])[..., 0]
        z = (_align(structure, a, w).conj().swapaxes(1, 2) @ w[..., None])[..., 0]
        w = _unit((F.conj().swapaxes(1, 2) @ z[..., None])[..., 0])
        delta = _align(structure, a, w)
        b = _unit((delta @ a[..., None])[..., 0])
        if step % _CHECK == 0 or step == steps:
            value = np.abs(np.linalg.eigvals(F @ delta)).max(axis=1)
            better = value > best_value
            best_delta[better], best_value[better] = delta[better], value[better]
    return best_delta, *_eigen(F, best_delta)


@dataclass(slots=True, eq=False)
class _Point:
    """Real parameters q (b, m) and what they give: the perturbation's size (b,), eigenvalue,
    Delta_c, slope of log|lambda|.
    """

    q: np.ndarray
    size: np.ndarray
    eigenvalue: np.ndarray
    delta: np.ndarray
    gradient: np.ndarray
    direction: np.ndarray  # w of the complex channels, the start of the next power iteration

    def take(self, keep: np.ndarray) -> _Point:
        return _Point(*(getattr(self, name)[keep] for name in self.__slots__))

    def put(self, where: np.ndarray, other: _Point) -> None:
        for name in self.__slots__:
            getattr(self, name)[where] = getattr(other, name)


def _evaluate(
    M: np.ndarray, parts: _Parts, q: np.ndarray, b0: np.ndarray | None, steps: int
) -> _Point:
    """The perturbation that completes the real parameters q."""
    rw = parts.real_w
    rz = parts.real_z
    cw = parts.complex_w
    cz = parts.complex_z

    # real (r) and complex (c) channels: rows z, columns w
    M_rr, M_rc, M_cr, M_cc = (
        M[:, i[:, None], j[None, :]] for i, j in ((rz, rw), (rz, cw), (cz, rw), (cz, cw))
    )

    # F = M_cc + M_cr Q R,   R = E^-1 M_rc,   E = I - M_rr Q;   Q = diag(channel)
    channel = q @ parts.member
    E = np.eye(len(rz)) - M_rr * channel[:, None, :]
    R = memberwise(np.linalg.solve, E, M_rc)
    k = np.flatnonzero(~np.isfinite(R).all(axis=(1, 2)))
    if len(k):  # exactly on a pole of F: step beside it
        E[k] += 1e-12 * np.eye(len(rz))
        R[k] = np.nan_to_num(memberwise(np.linalg.solve, E[k], M_rc[k]))
    F = M_cc + (M_cr * channel[:, None, :]) @ R
    delta, eigenvalue, x, y = _complex_problem(F, parts.structure, b0, steps)
    magnitude = np.maximum(np.abs(eigenvalue), 1e-300)
    # dF/dq_i = L_i R_i with L = M_cr (I + Q E^-1 M_rr): first-order change of log|lambda|
    # y_L = y^H L = y^H M_cr + (y^H M_cr Q E^-1) M_rr
    y_cr = (y.conj()[:, None, :] @ M_cr)[:, 0]
    y_L = (
        y_cr
        + (
            memberwise(np.linalg.solve, E.swapaxes(1, 2), (y_cr * channel)[..., None]).swapaxes(
                1, 2
            )
            @ M_rr
        )[:, 0]
    )

    # d log lambda = y^H dF Delta x / lambda = y_L dQ R Delta x / lambda, its real part is
    # d log|lambda|; per channel, summed over the channels of each parameter at the end
    R_x = (R @ (delta @ x[..., None]))[..., 0]
    change = (y_L * R_x / np.where(np.abs(eigenvalue) > 0, eigenvalue, 1.0)[:, None]).real
    size = np.maximum(np.abs(q).max(axis=1, initial=0.0), 1 / magnitude)
    return _Point(
        q,
        size,
        eigenvalue,
        delta,
        np.nan_to_num(change @ parts.member.T),
        (delta @ x[..., None])[..., 0],
    )


def _ascend(
    M: np.ndarray,
    parts: _Parts,
    q: np.ndarray,
    b0: np.ndarray,
    goal: np.ndarray,
    tolerance: float,
    iterations: int,
    steps: int,
) -> _Point:
    """Shrink the perturbation by moving q: projected steps with a secant curvature per parameter
    and a trust region.

    goal (b,): size 1/upper below which no perturbation exists; members within ``tolerance`` of it
    stop.
    """
    best = _evaluate(M, parts, q, b0, steps)
    trust = np.full(len(q), 0.5)
    last_q, last_g = best.q.copy(), best.gradient.copy()
    active = np.arange(len(q))
    for _ in range(iterations):
        active = active[
            (best.size[active] > goal[active] * (1 + tolerance)) & (trust[active] > 1e-7)
        ]
        if len(active) == 0:
            break

        # The q_i at the edge of the box k with the gradient outwards: they move inwards with it.
        here = best.take(active)
        g, k = here.gradient, here.size[:, None]
        at_edge = (np.abs(here.q) > 0.999 * k) & (g * here.q > 0)
        slope = np.where(at_edge, g * here.q, 0.0).sum(axis=1, keepdims=True)

        # A box smaller by e^-t costs t slope of log|lambda|; max(|q|, 1/|lambda|) is least where
        # both are equal: log|lambda| - t slope + log k - t = 0, t = excess / (1 + slope).
        # > 0: the box may shrink
        excess = np.log(np.maximum(np.abs(here.eigenvalue[:, None]), 1e-300) * k)
        box = k * np.exp(-np.clip(excess, 0, 1) / (1 + slope))

        # Secant curvature -d2 log|lambda| / dq_i^2; where it is positive, the step to the maximum,
        # else a share of the trust region by the size of the gradient.
        dq, dg = here.q - last_q[active], g - last_g[active]
        curvature = np.where(dq != 0, -dg / np.where(dq != 0, dq, 1.0), 0.0)
        limit = trust[active, None] * k
        newton = np.where(
            curvature > 0, np.abs(g) / np.where(curvature > 0, curvature, 1.0), np.inf
        )
        largest = np.abs(g).max(axis=1, keepdims=True)
        plain = limit * np.abs(g) / np.where(largest > 0, largest, 1.0)
        step = np.sign(g) * np.minimum(
            np.where(np.isfinite(newton), newton, np.maximum(plain, 0.1 * limit)), limit
        )
        warm = here.direction
        trial = _evaluate(
            M[active], parts, np.clip(here.q + step, -box, box), warm, max(1, steps // 3)
        )

        # The other end of the next secant: the trial that failed, or the point that was left.
        last_q[active], last_g[active] = trial.q, trial.gradient
        good = trial.size < here.size
        last_q[active[good]], last_g[active[good]] = here.q[good], here.gradient[good]
        best.put(active[good], trial.take(good))
        trust[active] = np.where(good, np.minimum(2 * trust[active], 2.0), trust[active] / 3)
    return best


def _real_only(
    M: np.ndarray, parts: _Parts, q: np.ndarray, goal: np.ndarray, rounds: int = 14
) -> tuple[np.ndarray, np.ndarray]:
    """Smallest box found that holds a root of det(I - M Q) = 0: (size (b,), q (b, m)), infinite
    where none was found.
    """
    rz, rw = parts.real_z, parts.real_w
    M = M[:, rz[:, None], rw[None, :]]
    size, best = np.full(len(M), np.inf), np.zeros_like(q)
    if q.shape[1] == 1:  # exact: the real eigenvalues
        values = np.linalg.eigvals(M)
        norm = np.linalg.norm(M, axis=(1, 2))[:, None]
        real = np.where(np.abs(values.imag) <= _REAL_TOLERANCE * norm, values.real, 0.0)
        top = np.take_along_axis(real, np.abs(real).argmax(axis=1)[:, None], axis=1)[:, 0]
        nonzero = np.abs(top) > 1e-12 * norm[:, 0]
        size[nonzero], best[nonzero, 0] = 1 / np.abs(top[nonzero]), 1 / top[nonzero]
        return size, best

    # No root lies inside ``goal``. Until one is found the box grows threefold; then bisection of
    # its logarithm. A box without a root raises low: a guess, as Newton may have missed one.
    low, high = goal.copy(), np.maximum(8.0 * goal, np.abs(q).max(axis=1))
    for _ in range(rounds):
        box = np.where(np.isinf(size), high, np.sqrt(low * np.minimum(high, size)))
        root, ok = _newton_in_box(M, parts.member, np.where(np.isinf(size)[:, None], q, best), box)
        reached = np.abs(root).max(axis=1)
        better = ok & (reached < size)
        size[better], best[better] = reached[better], root[better]
        low = np.where(ok | np.isinf(size), low, box)
        high = np.where(np.isinf(size), 3 * high, np.minimum(high, size))
    return size, best


def _newton_in_box(
    M: np.ndarray, member: np.ndarray, q: np.ndarray, box: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Newton on (eigenvalue of M Q nearest 1) = 1 with minimum-norm steps, parameters kept within
    +-box by an active set.
    """
    q = np.clip(q, -box[:, None], box[:, None])
    miss = np.full(len(M), np.inf)
    active = np.arange(len(M))
    for _ in range(12):
        # f = lambda - 1 for the eigenvalue of M Q nearest 1
        values, vectors = np.linalg.eig(M[active] * (q[active] @ member)[:, None, :])
        rows = np.arange(len(active))
        near = np.abs(values - 1).argmin(axis=1)
        f = values[rows, near] - 1
        miss[active] = np.abs(f)
        going = np.flatnonzero(np.abs(f) > 1e-13)
        if len(going) == 0:
            break
        active = active[going]
        rows = rows[going]
        near = near[going]
        f = f[going]

        # y^T V = e^T: the row of V^-1 for x, y^T x = 1; the shift is for a defective M Q
        # dlambda / dq_i = y^T M (dQ/dq_i) x
        x = vectors[rows, :, near]
        selector = np.eye(M.shape[1])[near][..., None]
        y = memberwise(
            np.linalg.solve, vectors[going].swapaxes(1, 2) + 1e-14 * np.eye(M.shape[1]), selector
        )[..., 0]
        J = np.nan_to_num(((y[:, None, :] @ M[active])[:, 0] * x) @ member.T)  # d lambda / d q_i

        # two real equations: the real and the imaginary part of f
        q[active] += _boxed_step(
            np.stack([J.real, J.imag], axis=1),
            -np.stack([f.real, f.imag], axis=1),
            q[active],
            box[active, None],
        )
    return q, miss < 1e-10


def _boxed_step(J: np.ndarray, target: np.ndarray, q: np.ndarray, edge: np.ndarray) -> np.ndarray:
    """The shortest step with J step = target (b, 2) that keeps |q + step| <= edge, by three rounds
    of an active set.
    """
    free, step = np.ones_like(q), np.zeros_like(q)
    for _ in range(3):
        # J_f step_f = target - J step_fixed, shortest: step_f = J_f^T (J_f J_f^T)^-1 rest
        Jf = J * free[:, None, :]
        rest = target - (J @ (step * (1 - free))[..., None])[..., 0]
        gram = Jf @ Jf.swapaxes(1, 2)
        gram = gram + (1e-13 * np.trace(gram, axis1=1, axis2=2)[:, None, None] + 1e-300) * np.eye(2)
        step = np.where(
            free > 0, (Jf.swapaxes(1, 2) @ np.linalg.solve(gram, rest[..., None]))[..., 0], step
        )

        # those beyond the edge stay on it in the rounds that follow
        beyond = np.abs(q + step) > edge
        step = np.clip(q + step, -edge, edge) - q
        free = free * ~beyond
    return step


def _random_reals(
    M: np.ndarray, parts: _Parts, reach: np.ndarray, rng: np.random.Generator, *, corner: bool
) -> np.ndarray:
    """Random parameters in the box +-reach (b,), or at its corners; with complex blocks the best of
    a few, by a quick look.
    """
    b, m = len(M), len(parts.member)
    tries = _TRIES if m > (0 if parts.structure.complex else 1) else 1
    spread = rng.uniform(-1, 1, (tries, b, m))
    q = reach[:, None] * (np.sign(spread) if corner else spread)
    if tries == 1:
        return q[0]

    # each start, and where its ray meets a pole of F
    q = np.concatenate([q, np.stack([_on_pole(M, parts, guess, reach) for guess in q])])
    if not parts.structure.complex:
        return _best_root(M, parts, q, reach)
    size = np.stack([_evaluate(M, parts, guess, None, 1).size for guess in q])
    return np.take_along_axis(q, size.argmin(axis=0)[None, :, None], axis=0)[0]


def _best_root(M: np.ndarray, parts: _Parts, q: np.ndarray, reach: np.ndarray) -> np.ndarray:
    """Of several starts q (tries, b, m), the root of det(I - M Q) = 0 in the smallest box; the last
    start where none leads.
    """
    M_rr = M[:, parts.real_z[:, None], parts.real_w[None, :]]
    best, size = q[-1].copy(), np.full(len(M), np.inf)
    for guess in q:
        root, ok = _newton_in_box(M_rr, parts.member, guess, reach)
        reached = np.where(ok, np.abs(root).max(axis=1), np.inf)
        better = reached < size
        best[better], size[better] = root[better], reached[better]
    return best


def _on_pole(M: np.ndarray, parts: _Parts, q: np.ndarray, reach: np.ndarray) -> np.ndarray:
    """q stretched to where F(q) is largest along its ray, near a pole: the most real eigenvalue of
    M_rr Q becomes 1.
    """
    M_rr = M[:, parts.real_z[:, None], parts.real_w[None, :]]
    values = np.linalg.eigvals(M_rr * (q @ parts.member)[:, None, :])

    # the eigenvalue of most weight that is nearly real
    pick = (np.abs(values.real) - 3 * np.abs(values.imag)).argmax(axis=1)
    value = values[np.arange(len(q)), pick]

    # |t lambda - 1| is smallest for t = Re lambda / |lambda|^2
    stretch = value.real / np.maximum(np.abs(value) ** 2, 1e-300)
    return np.clip(q * stretch[:, None], -reach[:, None], reach[:, None])


def _start_reals(M: np.ndarray, parts: _Parts, worst: np.ndarray, goal: np.ndarray) -> np.ndarray:
    """The real parameters that map z = M w closest to w, for the direction w of the upper bound,
    within its box.
    """
    # |w - q_i z| over the channels of q_i is smallest for q_i = Re(z^H w) / |z|^2
    z = (M @ worst[..., None])[..., 0][:, parts.real_z]
    w = worst[:, parts.real_w]
    top = (z.conj() * w).real @ parts.member.T
    bottom = (np.abs(z) ** 2) @ parts.member.T
    return np.clip(top / np.where(bottom > 0, bottom, 1.0), -goal[:, None], goal[:, None])


def lower_bound(
    M: np.ndarray,
    structure: Structure,
    upper: np.ndarray,
    worst: np.ndarray,
    *,
    tolerance: float = 1e-4,
    restarts: int = 4,
    seed: int = 0,
    iterations: int = 30,
) -> LowerBound:
    """Lower bound of mu for a batch M (b, n_z, n_w) with the perturbation that proves it.

    upper (b,): an upper bound, worst (b, n_w): its direction; the search stops within ``tolerance``
    of it. ``restarts`` seeded random starts are spent where the gap stays open.
    """
    b = len(M)
    value, delta = np.zeros(b), np.full((b, structure.n_w, structure.n_z), np.nan, complex)

    # unit = diag(d_z) M diag(1/d_w) / size; goal, direction and box are those of this matrix
    balanced, _, d_w = osborne(M, structure)
    size = largest_gain(balanced)
    todo = np.flatnonzero((size > 0) & (upper > 0))
    parts, rng = _parts(structure), np.random.default_rng(seed)
    m = len(structure.real)
    for attempt in range(1 + restarts):
        # Later random starts only where the gap is wide; none where the answer is exact.
        todo = todo[
            value[todo] < upper[todo] * (1 - (tolerance if attempt < 2 else 10 * tolerance))
        ]
        if len(todo) == 0 or (attempt and not m and len(structure.complex) == 1):
            break
        unit, goal = balanced[todo] / size[todo, None, None], size[todo] / upper[todo]
        direction = (worst * d_w)[todo]
        q = _start_reals(unit, parts, direction, goal)
        b0 = direction[:, parts.complex_w]

        # Restarts: a random direction, random parameters no larger than what would improve the
        # bound, at corners of the box in turn.
        if attempt:
            noise = rng.standard_normal((2, *b0.shape))
            b0 = noise[0] + 1j * noise[1]
            reach = np.minimum(size[todo] / np.maximum(value[todo], 1e-3 * upper[todo]), 1e3 * goal)
            q = _random_reals(unit, parts, reach, rng, corner=attempt % 2 == 1)
        if structure.complex:
            point = _ascend(
                unit, parts, q, b0, goal, tolerance, iterations if m else 0, _POWER_STEPS
            )
            candidate = _assemble(structure, point)
        else:
            reach, q = _real_only(unit, parts, q, goal)
            candidate = _assemble(
                structure, _Point(q, reach, np.ones(len(q)), np.zeros((len(q), 0, 0)), q, b0)
            )
        verified = _verify(unit, candidate)
        better = verified * size[todo] > value[todo]
        k = todo[better]

        # Delta d_z = d_w Delta, so that det(I - unit Delta) = det(I - M Delta / size).
        value[k] = verified[better] * size[k]
        delta[k] = candidate[better] / size[k, None, None]
    return LowerBound(value, delta)


def _assemble(structure: Structure, point: _Point) -> np.ndarray:
    """Delta (b, n_w, n_z) of a point: real parameters as they are, Delta_c over the eigenvalue."""
    delta = np.zeros((len(point.q), structure.n_w, structure.n_z), complex)
    for i, place in enumerate(structure.real):
        delta[:, place.w, place.z] = point.q[:, i, None, None] * np.eye(place.block.n_w)
    scale = np.where(np.abs(point.eigenvalue) > 0, point.eigenvalue, np.nan)
    i = j = 0
    for place in structure.complex:
        n_w, n_z = place.block.n_w, place.block.n_z
        with np.errstate(invalid="ignore"):  # an eigenvalue 0 gives NaN, which _verify refuses
            delta[:, place.w, place.z] = (
                point.delta[:, i : i + n_w, j : j + n_z] / scale[:, None, None]
            )
        i, j = i + n_w, j + n_z
    return delta


def _verify(M: np.ndarray, delta: np.ndarray) -> np.ndarray:
    """1 / sigma_max(delta), 0 where the smallest singular value of I - M delta, relative to its
    terms, exceeds 1e-9.
    """
    usable = np.isfinite(delta).all(axis=(1, 2))
    safe = np.where(usable[:, None, None], delta, 0.0)
    norm = largest_gain(safe)
    s = np.linalg.svd(np.eye(M.shape[1]) - M @ safe, compute_uv=False)[:, -1]
    miss = s / (1 + largest_gain(M) * norm)
    ok = usable & (norm > 0) & (miss <= 1e-9)
    return np.where(ok, 1 / np.where(norm > 0, norm, 1.0), 0.0)
