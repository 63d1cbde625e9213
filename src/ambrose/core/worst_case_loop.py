"""Where a loop with real parameters has a pole on the imaginary axis, and the smallest perturbation
that puts one there.

A point (delta, omega) of the crossing surface has an eigenvalue 1 of M11(j omega) diag(delta).
Along one direction v the eigenvalues mu of M11 diag(v) over frequency are real where the direction
crosses, at the factor 1 / mu: all crossings at once, without a step in the factor that could miss a
range of instability. M11 is the nominal loop's, smooth between its own poles. Parameters that act
at one place share inputs: M11 = N E with r < n columns of M11 and a constant E (r, n), and the
eigenvalues other than zero are those of E diag(v) N. From a crossing the surface is followed
downhill: a step in delta that lowers the largest entry and keeps the eigenvalue real to first order
(a linear program with one equation, solved exactly), then back onto the surface.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import product
from typing import Any, cast

import numpy as np
from scipy.linalg import block_diag

from ambrose.core.checks import UnstableSystem, check_shape, invalid, named_failure
from ambrose.core.frequency import largest_gain, largest_gains
from ambrose.core.lft import Block, Ports, RealBlock, ports, upper_lft, upper_lft_responses
from ambrose.core.mu.all_frequencies import Chords, ChordsBetween, chords
from ambrose.core.mu.structure import osborne, structure_of
from ambrose.core.statespace import StateSpace, as_statespace, is_stable, spectral_abscissa

# A loop with real parameters in a box: its gain and the number of its unstable poles at any point
# of the box.
#
# The parameters are pulled out of a stable system: w = diag(delta) z, (z, e) = M (w, d), so that at
# every frequency
#
#     T(delta) = M22 + M21 diag(delta) (I - M11 diag(delta))^-1 M12        d -> e
#
# costs a small matrix whatever the order of the system. ``core/worst_case.py`` looks for the
# worst that can happen in the box.


_CHUNK = 4_000  # matrices worked on at once, which a processor keeps near
# determinants held at once: points that share values are closed together while they fit
_VALUES = 2_000_000
_STEP = 0.8  # rad, largest turn of the determinant between two grid points that is trusted
# distance between grid points over the distance of the nearest zero or pole of the determinant
# (about)
_HIDDEN = 1.2
_BESIDE = 1e-6  # relative step of the derivative in frequency
_ROUNDS = 14  # of new grid points between restless ones, at most
# norm of M11 delta, over the channels, below which a frequency is left out unless its neighbour is
# not
_WEAK = 0.1
_ALL_CORNERS = 8  # parameters up to which every corner is visited


@dataclass(frozen=True, slots=True, eq=False)
class BoxLoop:
    """A stable continuous loop whose first inputs w and outputs z belong to ``blocks``, one real
    parameter each.

    owner (n,): the parameter that channel belongs to; model: for proof; poles (s,) of the loop with
    delta = 0; ports: the channels that all are made of; response: the model by these.
    """

    system: StateSpace
    blocks: tuple[RealBlock, ...]
    owner: np.ndarray
    model: Chords
    poles: np.ndarray
    ports: Ports
    response: ChordsBetween

    @property
    def parameters(self) -> int:
        return len(self.blocks)

    def at(self, omega: np.ndarray) -> np.ndarray:
        """M (w, n + p, n + m) at omega (w,) [rad/s], infinity allowed."""
        return self.response.at(omega)


def box_loop(system: Any, blocks: Sequence[Block], model: Chords | None = None) -> BoxLoop:
    """model: the chords of the system, where they are known: it is stable then.

    Raises InvalidInput for blocks that are not real or do not fit, UnstableSystem when delta = 0 is
    unstable already.
    """
    system = as_statespace(system)
    several = isinstance(blocks, list | tuple)
    other = [
        getattr(block, "name", type(block).__name__)
        for block in (blocks if several else [blocks])
        if not isinstance(block, RealBlock)
    ]
    if other or not several or not blocks:
        raise invalid(
            "the blocks",
            other or "none",
            "real parameters, at least one",
            "use mu_bounds for complex ones",
        )
    real = cast(tuple[RealBlock, ...], tuple(blocks))
    owner = np.repeat(np.arange(len(real)), [block.repeat for block in real])
    if system.dt is not None or min(system.D.shape) < len(owner):
        raise invalid(
            "the loop",
            repr(system),
            f"continuous with {len(owner)} or more inputs and outputs",
            "list w, z first",
        )
    if model is None and not is_stable(system):
        raise UnstableSystem(
            "the loop with all parameters nominal has a pole with real part "
            f"{spectral_abscissa(system):.4g} rad/s; "
            "robustness is a question about a stable loop: change the controller first"
        )
    model = chords(system) if model is None else model
    few, n = ports(system, len(owner)), len(owner)
    rows, columns = (
        np.r_[channels, n:size]
        for channels, size in zip((few.outputs, few.inputs), system.D.shape, strict=True)
    )
    response = model.part(rows, columns).between(
        *(
            block_diag(one, np.eye(size - n))
            for one, size in zip((few.out_of, few.into), system.D.shape, strict=True)
        )
    )
    return BoxLoop(system, real, owner, model, model.every_pole, few, response)


def default_grid(loop: BoxLoop, per_decade: int = 60) -> np.ndarray:
    """Frequencies (w,) [rad/s] from 0.01 times the slowest to 100 times the fastest pole, denser
    around resonances.
    """
    modulus = np.abs(loop.poles)
    if not modulus.size:
        return np.array([1.0])
    low, high = 0.01 * modulus.min(), 100 * modulus.max()
    net = np.geomspace(low, high, int(per_decade * np.log10(high / low)) + 2)
    light = loop.poles[(loop.poles.imag > 0) & (-loop.poles.real < 0.3 * modulus)]
    beside = light.imag[:, None] + light.real[:, None] * np.array(
        [-4.0, -2.0, -1.0, -0.5, 0.0, 0.5, 1.0, 2.0, 4.0]
    )
    return np.unique(np.concatenate([net, beside[beside > low]]))


def corners(parameters: int, seed: int = 0) -> np.ndarray:
    """The corners (c, k) of the box for up to 8 parameters, 256 random ones beyond."""
    if parameters <= _ALL_CORNERS:
        return np.array(list(product((-1.0, 1.0), repeat=parameters)))
    return np.random.default_rng(seed).choice((-1.0, 1.0), (256, parameters))


def samples(parameters: int, count: int = 64, seed: int = 1) -> np.ndarray:
    """Points (c, k) inside the box: evenly spaced for one parameter, random for several."""
    if parameters == 1:
        return np.linspace(-1, 1, count + 1)[:, None]
    return np.random.default_rng(seed).uniform(-1, 1, (count, parameters))


def box_points(parameters: int, count: int = 64, seed: int = 1) -> np.ndarray:
    """The nominal point, the corners and ``count`` samples of the box (d, parameters)."""
    return np.vstack(
        [np.zeros((1, parameters)), corners(parameters), samples(parameters, count, seed)]
    )


def gains(M: np.ndarray, loop: BoxLoop, delta: np.ndarray) -> np.ndarray:
    """Largest singular value of T(delta), (d, w), infinite on a pole; M (w, n + p, n + m) of
    ``loop.at``, delta (d, k).
    """
    return _of_members(largest_gain, M, loop, delta)


def envelope(M: np.ndarray, loop: BoxLoop, delta: np.ndarray) -> np.ndarray:
    """The largest of ``gains`` over all points delta (d, k), (w,)."""
    return _of_members(partial(largest_gains, axis=0), M, loop, delta).max(axis=0)


def _of_members(
    size: Callable[[np.ndarray], np.ndarray], M: np.ndarray, loop: BoxLoop, delta: np.ndarray
) -> np.ndarray:
    """size of T(delta) (d, w), infinite on a pole."""
    # a part of the frequencies at a time: what is held stays in memory that was asked for before
    step = max(1, _CHUNK // max(1, len(delta)))
    parts = []
    for start in range(0, max(1, len(M)), step):
        T = transfers(M[start : start + step], loop, delta)
        on_pole = ~np.isfinite(T).all(axis=(2, 3))
        T[on_pole] = 0.0
        parts.append(np.where(on_pole, np.inf, size(T)))
    return parts[0] if len(parts) == 1 else np.hstack(parts)


def transfers(M: np.ndarray, loop: BoxLoop, delta: np.ndarray) -> np.ndarray:
    """T(delta) (d, w, p, m); not finite on a pole."""
    few, (n, (_, rows, columns)) = loop.ports, (len(loop.owner), M.shape)
    row, column = np.r_[few.outputs, n:rows], np.r_[few.inputs, n:columns]
    T = upper_lft_responses(
        M[:, row[:, None], column].transpose(1, 2, 0), few.gain(delta[:, loop.owner])
    )
    return T.transpose(0, 3, 1, 2)


@dataclass(frozen=True, slots=True, eq=False)
class Sweep:
    """M11 at ascending frequencies, 0 and infinity included: omega (w,) [rad/s], M11 and slope =
    dM11/d(ln omega) (w, n, n).
    """

    omega: np.ndarray
    M11: np.ndarray
    slope: np.ndarray

    def __getitem__(self, kept: np.ndarray) -> Sweep:
        return Sweep(self.omega[kept], self.M11[kept], self.slope[kept])

    def joined(self, other: Sweep) -> tuple[Sweep, np.ndarray]:
        """Both in one, and the order that sorts (self, other)."""
        omega = np.concatenate([self.omega, other.omega])
        order = np.argsort(omega)
        M11, slope = (
            np.concatenate([self.M11, other.M11]),
            np.concatenate([self.slope, other.slope]),
        )
        return Sweep(omega[order], M11[order], slope[order]), order


def sweep(loop: BoxLoop) -> Sweep:
    """M11 on the default grid, to be used for many perturbations."""
    return _evaluated(loop, np.concatenate([[0.0], default_grid(loop), [np.inf]]))


def _evaluated(loop: BoxLoop, omega: np.ndarray) -> Sweep:
    n = len(loop.owner)
    M11, beside = np.split(loop.at(np.concatenate([omega, omega * (1 + _BESIDE)]))[:, :n, :n], 2)
    return Sweep(omega, M11, (beside - M11) / _BESIDE)


@named_failure("the number of unstable poles in the box")
def unstable_poles(loop: BoxLoop, delta: np.ndarray, start: Sweep | None = None) -> np.ndarray:
    """How many poles of the loop lie in the right half plane for every delta (d, k), (d,).

    By the turns of h = det(I - M11 diag(delta)) along the imaginary axis (argument principle). The
    sweep is refined until h turns by less than 0.8 rad between neighbours and its logarithm changes
    slowly enough there for no zero to hide between them; where it does not come to rest, a pole is
    next to the axis, and the eigenvalues decide. Raises InvalidInput.
    """
    delta = check_shape(delta, "delta", "(d, k)", k=loop.parameters)
    return count_unstable(loop, delta, sweep(loop) if start is None else start)[0]


def count_unstable(loop: BoxLoop, delta: np.ndarray, start: Sweep) -> tuple[np.ndarray, Sweep]:
    """``unstable_poles``, and the sweep with the frequencies that had to be added."""
    # where the perturbation cannot turn the determinant noticeably only the neighbours of other
    # points are needed
    strong = largest_gain(start.M11) * np.abs(delta).max(initial=0.0) > _WEAK / len(loop.owner)
    near = strong.copy()
    near[1:] |= strong[:-1]
    near[:-1] |= strong[1:]
    near[[0, -1]] = True
    used = start[near]
    h, rate = _determinants(used, loop, delta)
    for _ in range(_ROUNDS):
        wild = _restless(used.omega, h, rate).any(axis=0)
        a, b = used.omega[:-1][wild], used.omega[1:][wild]
        # halfway on a logarithmic scale; towards zero and infinity by fixed factors
        new = np.where(np.isinf(b), 4 * a + 1, np.where(a > 0, np.sqrt(a * b), b / 8))
        new = np.unique(new[(new > a) & (new < b)])
        if not new.size:
            break
        added = _evaluated(loop, new)
        used, order = used.joined(added)
        added_values, more_rate = _determinants(added, loop, delta)
        h, rate = np.hstack([h, added_values])[:, order], np.hstack([rate, more_rate])[:, order]
        start = start.joined(added[~np.isin(new, start.omega)])[0]

    # h = prod(s - perturbed poles) / prod(s - nominal poles), the latter stable, is real at 0 and
    # infinity: every pole to the right turns it by -pi from one to the other
    turns = np.angle(h[:, 1:] / h[:, :-1]).sum(axis=1) / np.pi
    count = np.rint(-turns)
    unclear = (
        _restless(used.omega, h, rate).any(axis=1) | (np.abs(-turns - count) > 0.1) | (count < 0)
    )
    for i in np.flatnonzero(unclear):
        count[i] = (np.linalg.eigvals(perturbed_matrix(loop, delta[i])).real >= 0).sum()
    return count.astype(int), start


def _restless(omega: np.ndarray, h: np.ndarray, rate: np.ndarray) -> np.ndarray:
    """Between which neighbours (d, w - 1) h turns far, or has a zero or pole closer than the
    distance between them.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        turns = np.abs(np.angle(h[:, 1:] / h[:, :-1]))
        width = np.log(omega[1:] / omega[:-1])
    width[~np.isfinite(width)] = 0.0

    # 1/rate is about how far the nearest zero or pole is, in ln omega; a turn of NaN counts as far
    hidden = np.maximum(rate[:, 1:], rate[:, :-1]) * width
    return ~(turns <= _STEP) | (hidden > _HIDDEN)


def _determinants(part: Sweep, loop: BoxLoop, delta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """h = det(I - M11 diag(delta)) and |dh/d(ln omega)| / |h|, (d, w) each; the latter is 0 at 0
    and infinity.
    """
    # h at omega and at omega (1 + _BESIDE): the relative difference is the rate
    both = np.concatenate([part.M11, part.M11 + _BESIDE * part.slope])
    step = max(1, _VALUES // max(1, len(both)))
    h, beside = np.split(
        np.concatenate(
            [
                determinants_at(both, loop.owner, delta[i : i + step], loop.ports)
                for i in range(0, max(1, len(delta)), step)
            ]
        ),
        2,
        1,
    )
    with np.errstate(divide="ignore", invalid="ignore"):
        rate = np.abs(beside / h - 1) / _BESIDE
    rate[h == 0] = np.inf
    rate[:, (part.omega == 0) | np.isinf(part.omega)] = 0.0
    return h, rate


def perturbed_matrix(loop: BoxLoop, delta: np.ndarray) -> np.ndarray:
    """The state matrix of the loop at delta (k,)."""
    return upper_lft(loop.system, np.diag(delta[loop.owner]))[0]


# Many points of a box of real parameters at once: the determinant at each, over frequency.
#
# The parameters are closed one after another, M' = M22 + M21 delta (I - M11 delta)^-1 M12, and
# det(I - M11 diag(delta)) is the product of the pivots' determinants. Points that share the values
# of the first parameters share the work (the corners of a box of k parameters: 2, 4, 8 .. matrices
# that shrink, in place of 2^k full ones).


# complex numbers of matrices that are factorised one by one: memory that is not asked for anew
_HELD = 100_000
_BATCH = 200_000  # numbers held at once, so that they stay in the cache
# a pivot smaller than this, relative, spoils digits: such points are solved with pivoting
_SMALL = 1e-5
_FEW = 16  # points below which each is solved by itself
_SHARED = 0.5  # branches over points, on average over the parameters, above which nothing is gained


@dataclass(frozen=True, slots=True, eq=False)
class _Branching:
    """Parameters in the order in which they are closed; per parameter: channels, the branch it
    comes from, the value there.
    """

    order: np.ndarray
    repeats: tuple[int, ...]
    parents: tuple[np.ndarray, ...]
    values: tuple[np.ndarray, ...]
    leaf: np.ndarray  # (d,) the branch that holds each point


def determinants_at(
    M11: np.ndarray, owner: np.ndarray, delta: np.ndarray, shared: Ports | None = None
) -> np.ndarray:
    """h = det(I - M11 diag(delta)), (d, w), for M11 (w, n, n), the parameter ``owner`` (n,) of each
    channel, delta (d, k). shared: the channels that all are made of, where they are known.
    """
    if shared is not None and len(shared.inputs) <= 2:
        return _by_minors(M11, owner, delta, shared)
    branching = _branching(owner, delta)
    if branching is not None:
        return _closed(M11, owner, delta, branching)
    if shared is None or len(shared.inputs) >= len(owner):
        step = max(1, _HELD // M11.size)
        parts = range(0, max(1, len(delta)), step)
        return np.concatenate(
            [_all_determinants(M11[None], delta[i : i + step, None, owner]) for i in parts]
        )

    # M11 = F N E: det(I - F N E diag(delta)) = det(I - E diag(delta) F N), of fewer channels
    N = M11[:, shared.outputs[:, None], shared.inputs]
    gain, identity = shared.gain(delta[:, owner]), np.eye(N.shape[2])
    step = max(1, _HELD // (N.size + 1))
    return np.concatenate(
        [
            np.linalg.det(identity - gain[i : i + step, None] @ N)
            for i in range(0, max(1, len(delta)), step)
        ]
    )


def _by_minors(M11: np.ndarray, owner: np.ndarray, delta: np.ndarray, shared: Ports) -> np.ndarray:
    """The same for one or two channels, by a product of real matrices for all points at once:
    det(I - G N) = 1 - tr G N + the sum over minors of G and N of two columns and rows
    (Cauchy-Binet).
    """
    G, N = shared.gain(delta[:, owner]), M11[:, shared.outputs[:, None], shared.inputs]
    (d, r, q), w = G.shape, len(N)
    of_points = [-G.swapaxes(1, 2).reshape(d, q * r)]
    of_responses = [N.reshape(w, q * r)]
    if r == 2:
        i, j = np.triu_indices(q, 1)
        of_points.append(G[:, 0, i] * G[:, 1, j] - G[:, 0, j] * G[:, 1, i])
        of_responses.append(N[:, i, 0] * N[:, j, 1] - N[:, j, 0] * N[:, i, 1])
    left, right = np.hstack(of_points), np.ascontiguousarray(np.hstack(of_responses).T)
    h = (left @ right.view(float)).view(complex) + 1

    # what cancels has lost digits
    i, j = np.nonzero(~(np.abs(h) > _SMALL * (1 + np.abs(left) @ np.abs(right))))
    h[i, j] = _all_determinants(M11[j], delta[i][:, owner])
    return np.asarray(h)


def _branching(owner: np.ndarray, delta: np.ndarray) -> _Branching | None:
    """Parameters with few values and many channels first: while there are few branches. None where
    little would be shared.
    """
    d, k = delta.shape
    if d < _FEW or k == 1:
        return None
    repeats = np.bincount(owner, minlength=k)
    distinct = np.array([len(np.unique(column)) for column in delta.T], int)
    if distinct.min() > _SHARED * d:
        return None
    order = np.lexsort((-repeats, distinct))
    leaf = np.zeros(d, int)
    parents = []
    values = []
    # a branch is a combination of values of the parameters so far
    for i in order:
        pairs, leaf = np.unique(np.stack([leaf, delta[:, i]], axis=1), axis=0, return_inverse=True)
        leaf = leaf.reshape(-1)
        parents.append(pairs[:, 0].astype(int))
        values.append(pairs[:, 1])
    if sum(len(parent) for parent in parents) > _SHARED * k * d:
        return None
    return _Branching(order, tuple(repeats[order].tolist()), tuple(parents), tuple(values), leaf)


def _closed(
    M11: np.ndarray, owner: np.ndarray, delta: np.ndarray, branching: _Branching
) -> np.ndarray:
    """Determinants (d, w), in chunks over frequency."""
    channels = np.concatenate([np.flatnonzero(owner == i) for i in branching.order])

    # frequency last, so that the products run over it; one branch to begin with
    S = np.ascontiguousarray(M11[:, channels[:, None], channels].transpose(1, 2, 0))[:, :, None]
    h = np.empty((len(delta), len(M11)), complex)
    spoilt = np.empty(h.shape, bool)

    # the most numbers per frequency in one array: many branches while the matrices are large, as
    # points that share nothing have, count as much as many points
    closed = np.cumsum([0, *branching.repeats[:-1]])
    branches = np.array([len(parent) for parent in branching.parents])
    step = max(1, _BATCH // int((branches * (len(owner) - closed) ** 2).max()))
    for start in range(0, len(M11), step):
        part = slice(start, start + step)
        det, bad = _eliminated(S[..., part], branching)
        h[:, part], spoilt[:, part] = det[branching.leaf], bad[branching.leaf]
    i, j = np.nonzero(spoilt)  # a pivot close to zero
    h[i, j] = _all_determinants(M11[j], delta[i][:, owner])
    return h


def _eliminated(S: np.ndarray, branching: _Branching) -> tuple[np.ndarray, np.ndarray]:
    """S (n, n, 1, w) closed parameter by parameter: determinant (c, w) and spoilt (c, w)."""
    det, bad = np.ones(S.shape[2:], complex), np.zeros(S.shape[2:], bool)
    with np.errstate(all="ignore"):
        for r, parent, value in zip(
            branching.repeats, branching.parents, branching.values, strict=True
        ):
            # S' = S22 + S21 v (I - S11 v)^-1 S12, and the determinant times det(I - S11 v)
            v = value[:, None]
            if r == 1:
                loop = v * S[0, 0][parent]
                pivot = 1 - loop
                small = np.abs(pivot) < _SMALL * (1 + np.abs(loop))
                step = S[1:, 0][:, None][:, :, parent] * (S[0, 1:][:, parent] * (v / pivot))
            else:
                pivot, small, step = _block(S, r, parent, v)
            S = S[r:, r:][:, :, parent] + step
            det, bad = det[parent] * pivot, bad[parent] | small | ~np.isfinite(pivot)
    return det, bad


def _block(
    S: np.ndarray, r: int, parent: np.ndarray, v: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A parameter of r channels: determinant of its pivot (c, w), whether that is near zero, what
    is added (a, b, c, w).
    """
    B, right, left = (
        part.transpose(2, 3, 0, 1)[parent] for part in (S[:r, :r], S[:r, r:], S[r:, :r])
    )
    X = np.eye(r) - B * v[..., None, None]
    pivot = np.linalg.det(X)

    # a singular pivot would end the inversion of all; such points are solved again with pivoting
    singular = ~(np.abs(pivot) > 0)
    X[singular] = np.eye(r)
    inverse = np.linalg.inv(X)
    small = singular | (np.abs(inverse).max(axis=(2, 3)) * np.abs(X).max(axis=(2, 3)) > 1 / _SMALL)
    step = left @ ((inverse * v[..., None, None]) @ right)
    return pivot, small, step.transpose(2, 3, 0, 1)


def _all_determinants(M11: np.ndarray, wide: np.ndarray) -> np.ndarray:
    """det(I - M11 diag(wide)) by LU with pivoting, M11 (..., n, n), wide (..., n)."""
    return np.asarray(np.linalg.det(np.eye(M11.shape[-1]) - M11 * wide[..., None, :]))


LARGEST_BOX = 20.0  # in boxes
_ANGLES = 25  # frequencies beside every lightly damped pole
_AT_ONCE = 60_000  # matrices whose eigenvalues are computed at once
_DIRECTIONS = 40  # at random, per parameter beyond the first
_FEW_CORNERS = 5  # parameters up to which all corners are directions
_STARTS = 6  # per round
_STEPS = 60  # along the surface of the crossing, at most
_HALVINGS = 12  # of a grid interval in which an eigenvalue crosses the real axis
_NEWTON = 12  # steps of Newton's method, at most
_STILL = 1e-10  # relative imaginary part of the eigenvalue that counts as none


@dataclass(frozen=True, slots=True, eq=False)
class BoxMargin:
    """The box may grow by ``factor`` before a perturbation in it destabilises: delta (k,), largest
    entry ``factor``, does.

    frequency [rad/s] of the pole on the axis. factor is infinite (delta NaN) when none was found up
    to 20 times the box. It is found by search: a smaller perturbation may exist where there are
    several parameters.
    """

    factor: float
    delta: np.ndarray
    frequency: float


@named_failure("the margin of the box")
def box_margin(loop: BoxLoop, also: np.ndarray | None = None, seed: int = 0) -> BoxMargin:
    """The smallest destabilising perturbation found, up to 20 times the box. also (d, k): more
    directions to try.
    """
    rng = np.random.default_rng(seed)
    grid = _grid(loop)
    n = len(loop.owner)
    M = loop.at(grid)[:, :n, :n]
    M[0] = M[0].real  # at rest, exactly: its real eigenvalues are crossings, of poles at zero
    # no crossing below 1 / reach there
    reach = np.linalg.norm(osborne(M, structure_of(loop.blocks))[0], 2, axis=(1, 2))
    directions = _main_directions(loop.parameters, rng)
    if also is not None:
        size = np.abs(also).max(axis=1, keepdims=True)
        directions = np.vstack([(also / np.where(size > 0, size, 1.0))[size[:, 0] > 0], directions])
    best = BoxMargin(float("inf"), np.full(loop.parameters, np.nan), float("nan"))
    for number in range(3 if loop.parameters > 1 else 1):
        # corners and axes first, then points of the faces, then the best direction with noise
        if number == 1:
            directions = _scattered(loop.parameters, rng)
        elif number == 2:
            if not np.isfinite(best.factor):
                break
            directions = best.delta / best.factor + rng.normal(
                0, 0.4, (_DIRECTIONS, loop.parameters)
            )
            directions /= np.abs(directions).max(axis=1, keepdims=True)

        # below the best so far, mu > 1 / top; with a neighbour on each side
        top = min(best.factor, LARGEST_BOX)
        kept = reach >= 1 / top
        kept[1:] |= kept[:-1]
        kept[:-1] |= kept[1:]
        starts = _candidates(grid, M, kept, loop, directions, top)
        crossings = [
            landed
            for start in starts
            if (landed := _followed(loop, start)) and landed.factor <= LARGEST_BOX
        ]
        best = min([best, *crossings], key=lambda item: item.factor)
    return best


def _grid(loop: BoxLoop) -> np.ndarray:
    """Frequencies (w,) [rad/s] between which the eigenvalues turn by a few degrees: equal angles as
    seen from each pole.
    """
    turned = np.tan(np.linspace(-1.5, 1.5, _ANGLES))
    light = loop.poles[(loop.poles.imag > 0) & (-loop.poles.real < 0.3 * np.abs(loop.poles))]
    beside = (light.imag[:, None] - light.real[:, None] * turned).ravel()
    return np.unique(np.concatenate([[0.0], default_grid(loop, 40), beside[beside > 0]]))


def _main_directions(parameters: int, rng: np.random.Generator) -> np.ndarray:
    """Corners of the box, not more than 32, and the axes (d, k)."""
    if parameters == 1:
        return np.array([[-1.0], [1.0]])
    ends = corners(parameters)
    if parameters > _FEW_CORNERS:
        ends = ends[rng.choice(len(ends), 2**_FEW_CORNERS, replace=False)]
    return np.vstack([ends, np.eye(parameters), -np.eye(parameters)])


def _scattered(parameters: int, rng: np.random.Generator) -> np.ndarray:
    """Random points (d, k) of the faces of the box."""
    inside = rng.uniform(-1, 1, (min(_DIRECTIONS * (parameters - 1), 160), parameters))
    side = rng.integers(0, parameters, len(inside))
    inside[np.arange(len(inside)), side] = rng.choice([-1.0, 1.0], len(inside))
    return inside


def _candidates(
    grid: np.ndarray,
    M: np.ndarray,
    kept: np.ndarray,
    loop: BoxLoop,
    directions: np.ndarray,
    limit: float,
) -> list[BoxMargin]:
    """Crossings of the directions below ``limit``, to first order; the lowest, and of those in one
    band of frequency a few.
    """
    index = np.flatnonzero(kept)
    if len(index) < 2:
        return []
    rows: list[tuple[float, int, float]] = []
    step = max(1, _AT_ONCE // len(index))
    for start in range(0, len(directions), step):
        part = directions[start : start + step]
        values = loop.ports.eigenvalues(M[index], part[:, None, loop.owner])
        through, touching = _real_crossings(values, grid[index], np.diff(index) == 1, limit)
        rows += [
            (factor, start + d, omega)
            for factor, d, omega in [*_narrowed(loop, part, through), *touching]
        ]
    rows.sort()
    chosen: list[BoxMargin] = []
    bands: dict[int, int] = {}
    # three at most of an eighth of an octave
    for factor, i, omega in rows:
        band = round(8 * np.log2(max(omega, grid[1])))
        if bands.get(band, 0) < 3:
            bands[band] = bands.get(band, 0) + 1
            chosen.append(BoxMargin(factor, factor * directions[i], omega))
        if len(chosen) == _STARTS:
            break
    return chosen


@dataclass(frozen=True, slots=True, eq=False)
class _Brackets:
    """Eigenvalues (r,) at the two ends (r, 2) [rad/s] of an interval in which they cross the real
    axis, each of a direction.
    """

    direction: np.ndarray
    omega: np.ndarray
    values: np.ndarray


def _real_crossings(
    values: np.ndarray, omega: np.ndarray, beside: np.ndarray, limit: float
) -> tuple[_Brackets, list[tuple[float, int, float]]]:
    """Where an eigenvalue (d, w, n) crosses the positive real axis; and (factor, direction,
    frequency) where it nearly does.
    """
    # real but for rounding, as at zero
    values = np.where(np.abs(values.imag) <= _STILL * np.abs(values), values.real, values)

    # each eigenvalue with the nearest at the next frequency: the imaginary part changes its sign
    a, b = values[:, :-1], values[:, 1:]
    near = np.abs(a[..., :, None] - b[..., None, :]).argmin(axis=-1)
    b = np.take_along_axis(b, near, axis=-1)
    through = (
        (a.imag * b.imag <= 0) & (np.maximum(a.real, b.real) > 1 / limit) & beside[None, :, None]
    )
    d, w, i = np.nonzero(through)
    brackets = _Brackets(
        d, np.stack([omega[w], omega[w + 1]], axis=1), np.stack([a[d, w, i], b[d, w, i]], axis=1)
    )

    # nearly: |Im| is smallest at a grid point and below a tenth of Re; the factor 5 % larger
    turn = np.abs(values.imag)
    touch = (
        (turn[:, 1:-1] <= turn[:, :-2])
        & (turn[:, 1:-1] <= turn[:, 2:])
        & (turn[:, 1:-1] < 0.1 * values.real[:, 1:-1])
    )
    d, w, i = np.nonzero(touch & (values.real[:, 1:-1] > 1 / limit))
    sizes = 1.05 / values.real[d, w + 1, i]
    return brackets, list(zip(sizes.tolist(), d.tolist(), omega[w + 1].tolist(), strict=True))


def _narrowed(
    loop: BoxLoop, directions: np.ndarray, brackets: _Brackets
) -> list[tuple[float, int, float]]:
    """(factor, direction, frequency) of the crossings, their brackets halved: the eigenvalues may
    turn fast in between.
    """
    if not len(brackets.direction):
        return []
    n = len(loop.owner)
    low, high = brackets.omega.T.copy()
    a, b = brackets.values.T.copy()
    wide = directions[brackets.direction][:, loop.owner]
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        M = loop.at(middle)[:, :n, :n]
        values = loop.ports.eigenvalues(np.where(middle[:, None, None] > 0, M, M.real), wide)
        at = np.abs(values - 0.5 * (a + b)[:, None]).argmin(axis=1)
        value = values[np.arange(len(at)), at]
        upper = value.imag * a.imag > 0  # the crossing is in the upper half
        low, a = np.where(upper, middle, low), np.where(upper, value, a)
        high, b = np.where(upper, high, middle), np.where(upper, b, value)

    # the rest of the bracket by linear interpolation to Im = 0
    share = np.where(
        a.imag == b.imag, 0.0, a.imag / np.where(a.imag == b.imag, 1.0, a.imag - b.imag)
    )
    size, omega = a.real + share * (b.real - a.real), low + share * (high - low)
    kept = size > 0
    return list(
        zip(
            (1 / size[kept]).tolist(),
            brackets.direction[kept].tolist(),
            omega[kept].tolist(),
            strict=True,
        )
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Eigenvalue:
    """An eigenvalue of M11(j omega) diag(v), and its derivatives with respect to omega and v
    (k,).
    """

    value: complex
    over_omega: complex
    over_v: np.ndarray


def _eigenvalue(loop: BoxLoop, v: np.ndarray, omega: float, near: complex) -> _Eigenvalue | None:
    n = len(loop.owner)
    M, slope = (part[:n, :n] for part in loop.response.with_slope(omega))
    wide = v[loop.owner]
    M = M if omega > 0 else M.real

    # the eigenvalue nearest to ``near``, x and y with y x = 1
    values, X = np.linalg.eig(M * wide)
    i = int(np.abs(values - near).argmin())
    try:
        y = np.linalg.inv(X)[i]
    except np.linalg.LinAlgError:
        return None
    x = X[:, i]

    # d mu = y dM diag(v) x + y M diag(dv) x, the channels of a parameter added
    gradient = (y @ M) * x
    over = np.bincount(loop.owner, gradient.real, len(v)) + 1j * np.bincount(
        loop.owner, gradient.imag, len(v)
    )
    return _Eigenvalue(complex(values[i]), complex(y @ (slope * wide) @ x), over)


def _on_surface(
    loop: BoxLoop, delta: np.ndarray, omega: float
) -> tuple[BoxMargin, _Eigenvalue] | None:
    """The crossing in the direction of delta near (delta, omega), by Newton's iteration: where the
    eigenvalue is real.
    """
    near: complex = 1.0
    for _ in range(_NEWTON):
        found = _eigenvalue(loop, delta, omega, near)
        if found is None or found.value.real <= 0:
            return None
        if abs(found.value.imag) <= _STILL * abs(found.value):
            scaled = delta / found.value.real
            return BoxMargin(float(np.abs(scaled).max()), scaled, omega), found
        if omega == 0.0 or found.over_omega.imag == 0:
            return None

        # Im mu = 0 by Newton, omega by at most 30 %; mu is followed to first order
        step = -found.value.imag / found.over_omega.imag
        if abs(step) > 0.3 * omega:
            step = float(np.sign(step)) * 0.3 * omega
        omega, near = omega + step, found.value + step * found.over_omega
        if abs(found.value.imag) > 0.8 * abs(found.value):
            return None
    return None


def _followed(loop: BoxLoop, start: BoxMargin) -> BoxMargin | None:
    """Down the crossing surface from a start near it, to where no direction lowers the largest
    entry any more.
    """
    landed = _on_surface(loop, start.delta, start.frequency)
    if landed is None:
        return None
    here, slope = landed
    radius = 0.3
    for _ in range(_STEPS if loop.parameters > 1 else 0):
        # mu = r at v, so that it is 1 at here.delta = v / r:
        # d mu = over_v . d delta + over_omega d omega / r = 0, omega eliminated:
        # Im(r over_v conj(over_omega)) . d delta = 0; at rest omega stays zero and over_v is real
        scale = slope.value.real
        turned = (
            slope.over_v * scale * np.conj(slope.over_omega)
            if here.frequency > 0
            else slope.over_v * scale * 1j
        )
        step = _downhill(turned.imag, here.delta, radius * here.factor)
        moved = here.delta + step
        omega = here.frequency
        if omega > 0:
            # omega from the same equation, by its real part
            guess = (
                -float((np.conj(slope.over_omega) * (slope.over_v @ step) * scale).real)
                / abs(slope.over_omega) ** 2
            )
            omega = float(np.clip(omega + guess, 0.5 * omega, 2 * omega))
        landed = _on_surface(loop, moved, omega)
        if landed is not None and landed[0].factor < here.factor:
            gain = 1 - landed[0].factor / here.factor
            here, slope = landed
            radius = min(2 * radius, 0.5)
            if gain < 1e-7:
                break
        else:
            radius /= 4
            if radius < 1e-5:
                break
    return here


def _downhill(a: np.ndarray, delta: np.ndarray, radius: float) -> np.ndarray:
    """The step with a . step = 0 and |step| <= radius that makes the largest entry of |delta +
    step| smallest, by bisection.

    With the largest entry at most t each coordinate has a range; a . step can be zero when the
    extremes of the sum enclose it.
    """
    low, high = np.abs(delta).max() - radius, float(np.abs(delta).max())
    low = max(low, 0.0)

    def ends(t: float) -> tuple[np.ndarray, np.ndarray]:
        least, most = np.maximum(-t - delta, -radius), np.minimum(t - delta, radius)
        # of the smallest and the largest sum
        return np.where(a > 0, least, most), np.where(a > 0, most, least)

    for _ in range(30):
        t = 0.5 * (low + high)
        smallest, largest = ends(t)
        if a @ smallest <= 0 <= a @ largest:
            high = t
        else:
            low = t
    smallest, largest = ends(high)
    bottom, span = a @ smallest, a @ (largest - smallest)
    return smallest + (largest - smallest) * (
        np.clip(-bottom / span, 0.0, 1.0) if span > 0 else 0.5
    )
