"""The largest energy gain of a sampled loop along a motion of its pressure that goes round, and
motions that raise it.

Plant and controller are read between neighbours of tables: the plant over delta, -1 .. 1 of the
span, the controller over what it is told. The gain is the largest singular value of d -> y + d over
one round, both going round with the motion (Lanczos; before the round the loop runs in for a while,
so that states go round, too); its slope over every sample of the motion comes from the same two
passes. ``ascend`` goes up that slope by conditional gradients (Frank & Wolfe 1956, Naval Research
Logistics Quarterly 3): the motion that a slope favours most within range and rate is found by
dynamic programming, and every step towards it keeps both.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numba import njit
from scipy.linalg import eigh_tridiagonal

from ambrose.annexes.scheduled.varying_proof import VaryingLoop
from ambrose.core.sampling import c2d
from ambrose.core.statespace import StateSpace

_SHARES = (1.0, 0.5, 0.25, 0.1, 0.03)  # of the way to the favoured motion
_LEAST = 3e-5  # relative, of a step of the gain
_NODES = 400  # values of delta among which the favoured motion is sought, about


@dataclass(frozen=True, eq=False)
class Tables:
    """A loop over places in tables, transposed: states and currents to states (l, n + m, n) of the
    plant at values of delta, states and errors to states and currents (t, k + p, k + m) of the
    controller at values told; C (p, n) of y.

    before: samples for which the loop runs in.
    """

    plant: np.ndarray
    law: np.ndarray
    C: np.ndarray
    before: int

    def places(self, motion: Motion) -> tuple[np.ndarray, np.ndarray]:
        """Where in the tables a motion is, between 0 and their length less one."""
        told = motion.delta if motion.error is None else np.clip(motion.delta + motion.error, -1, 1)
        return (motion.delta + 1) / 2 * (len(self.plant) - 1), (told + 1) / 2 * (len(self.law) - 1)


def tables(
    loop: VaryingLoop,
    deltas: np.ndarray,
    laws: list[StateSpace],
    before: int,
    kind: type = np.float32,
) -> Tables:
    """Of a loop with sampled controllers: one of them, or one for every value that may be told."""
    plant = replace(loop, controller=None)
    sampled = [c2d(plant.closed(np.full(loop.parameters, delta)), loop.dt) for delta in deltas]
    moved = np.array([np.hstack([item.A, item.B]).T for item in sampled], kind)
    told = np.array([np.block([[law.A, law.B], [law.C, law.D]]).T for law in laws], kind)
    return Tables(moved, told, sampled[0].C.astype(kind), before)


@dataclass(frozen=True, eq=False)
class Motion:
    """delta (samples,) in -1 .. 1 and by how much what is told of it is off (samples,), in the same
    units.
    """

    delta: np.ndarray
    error: np.ndarray | None = None


@njit(fastmath=True)
def _apply(table, place, v, out):
    """Into ``out`` what the table does to v at a place between two of its rows."""
    i = min(int(place), len(table) - 1)
    j, f = min(i + 1, len(table) - 1), v.dtype.type(place - i)
    out[:] = 0.0
    for a in range(len(v)):
        for b in range(len(out)):
            out[b] += ((1 - f) * table[i, a, b] + f * table[j, a, b]) * v[a]


@njit(fastmath=True)
def _apply_back(table, place, v, out):
    """The same of the table's adjoint."""
    i = min(int(place), len(table) - 1)
    j, f = min(i + 1, len(table) - 1), v.dtype.type(place - i)
    for a in range(len(out)):
        total = v[0] * 0
        for b in range(len(v)):
            total += ((1 - f) * table[i, a, b] + f * table[j, a, b]) * v[b]
        out[a] = total


@njit(fastmath=True)
def _forward(plant, law, C, before, place, told, d):
    """States and currents (s, n + m), controller's states and errors (s, k + p), y + d (s, p),
    after running in.
    """
    samples = len(d)
    p = C.shape[0]
    n = C.shape[1]
    k = law.shape[1] - C.shape[0]
    X = np.zeros((samples, plant.shape[1]), d.dtype)
    Z = np.zeros((samples, k + p), d.dtype)
    Y = np.zeros_like(d)
    x, z = np.zeros(plant.shape[1], d.dtype), np.zeros(k + p, d.dtype)
    new, fresh = np.zeros(n, d.dtype), np.zeros(law.shape[2], d.dtype)
    for s in range(-before, samples):
        at = s % samples
        for a in range(p):
            y = d[at, a]
            for b in range(n):
                y += C[a, b] * x[b]
            Y[at, a], z[k + a] = y, -y
        _apply(law, told[at], z, fresh)
        x[n:] = fresh[k:]
        _apply(plant, place[at], x, new)
        X[at], Z[at] = x, z
        x[:n], z[:k] = new, fresh[:k]
    return X, Z, Y


@njit(fastmath=True)
def _backward(plant, law, C, before, place, told, Y):
    """The adjoint at Y: of d (s, p), of the plant's next states (s, n), of the controller's and the
    currents (s, k + m).
    """
    samples = len(Y)
    p = C.shape[0]
    n = C.shape[1]
    k = law.shape[1] - C.shape[0]
    out = np.zeros_like(Y)
    over_x = np.zeros((samples, n), Y.dtype)
    over_z = np.zeros((samples, law.shape[2]), Y.dtype)
    x, z = np.zeros(n, Y.dtype), np.zeros(law.shape[2], Y.dtype)
    new, fresh = np.zeros(plant.shape[1], Y.dtype), np.zeros(k + p, Y.dtype)
    for s in range(samples + before - 1, -1, -1):
        at = s % samples
        _apply_back(plant, place[at], x, new)
        z[k:] = new[n:]
        _apply_back(law, told[at], z, fresh)
        over_x[at] = x
        over_z[at] = z
        x[:] = new[:n]
        for a in range(p):
            out[at, a] = Y[at, a] - fresh[k + a]
            for b in range(n):
                x[b] += C[a, b] * out[at, a]
        z[:k] = fresh[:k]
    return out, over_x, over_z


@njit(fastmath=True)
def _slopes(table, place, v, over):
    """Of half the squared gain over the place, at every sample."""
    found = np.zeros(len(v))
    for s in range(len(v)):
        i = min(int(place[s]), len(table) - 2)
        for a in range(v.shape[1]):
            for b in range(over.shape[1]):
                found[s] += v[s, a] * (table[i + 1, a, b] - table[i, a, b]) * over[s, b]
    return found


@dataclass(frozen=True, eq=False)
class Gain:
    """The gain along a motion, the disturbance (samples, p) that has it, and its slopes over delta
    and over what is told.
    """

    value: float
    disturbance: np.ndarray
    over_delta: np.ndarray
    over_told: np.ndarray


def gain(
    on: Tables,
    places: tuple[np.ndarray, np.ndarray],
    start: np.ndarray,
    steps: int,
    slopes: bool = False,
) -> Gain:
    """By Lanczos from a disturbance ``start``; as large as the disturbance that was found makes
    it.
    """
    parts = (on.plant, on.law, on.C, on.before, *places)
    basis = [(start / np.linalg.norm(start)).astype(on.C.dtype)]
    diagonal = []
    beside = []
    for _ in range(steps):
        w = _backward(*parts, _forward(*parts, basis[-1])[2])[0]
        diagonal.append(float((w * basis[-1]).sum()))
        for v in basis:
            w -= (v * w).sum() * v
        beside.append(float(np.linalg.norm(w)))
        if beside[-1] < 1e-6 * diagonal[0]:
            break
        basis.append(w / np.float32(beside[-1]))
    _, vectors = eigh_tridiagonal(diagonal, beside[: len(diagonal) - 1])
    best = sum(on.C.dtype.type(share) * v for share, v in zip(vectors[:, -1], basis, strict=False))
    best /= np.linalg.norm(best)
    X, Z, Y = _forward(*parts, best)
    value, none = float(np.linalg.norm(Y)), np.zeros(0)
    if not slopes:
        return Gain(value, best, none, none)
    _, over_x, over_z = _backward(*parts, Y)
    of_law = (
        _slopes(on.law, places[1], Z, over_z) * (len(on.law) - 1) / 2 / value
        if len(on.law) > 1
        else np.zeros(len(Y))
    )
    return Gain(
        value,
        best,
        _slopes(on.plant, places[0], X, over_x) * (len(on.plant) - 1) / 2 / value + of_law,
        of_law,
    )


def closed(on: Tables, held: Motion, dt: float) -> StateSpace:
    """d -> y + d where a motion of one sample stands still."""
    (moved,), (told,) = (np.array(parts, float) for parts in _matrices(on, *on.places(held)))
    p = len(on.C)
    k = told.shape[0] - p
    A, B = _step(moved, told, on.C.astype(float), k)
    return StateSpace(A, B, np.hstack([on.C, np.zeros((p, k))]), np.eye(p), dt=dt)


def growth(on: Tables, places: np.ndarray) -> float:
    """Spectral radius of one round, at the same places in both tables."""
    n, k = on.C.shape[1], on.law.shape[1] - on.C.shape[0]
    whole = np.eye(n + k)
    for moved, told in zip(
        *_matrices(on, places, places if len(on.law) > 1 else 0 * places), strict=True
    ):
        whole = _step(moved, told, on.C, k)[0] @ whole
    return float(np.abs(np.linalg.eigvals(whole)).max())


def _matrices(on: Tables, *places: np.ndarray) -> list[list[np.ndarray]]:
    found = []
    for table, at in zip((on.plant, on.law), places, strict=True):
        low = np.minimum(at.astype(int), len(table) - 1)
        high, f = np.minimum(low + 1, len(table) - 1), at - low
        found.append([(1 - f[s]) * table[low[s]] + f[s] * table[high[s]] for s in range(len(at))])
    return found


def _step(
    moved: np.ndarray, told: np.ndarray, C: np.ndarray, k: int
) -> tuple[np.ndarray, np.ndarray]:
    """States (x, z) from sample to sample, and what d adds, with u = K(-(C x + d))."""
    n = C.shape[1]
    P = moved[:n].T
    Q = moved[n:].T
    A = told[:k, :k].T
    B = told[k:, :k].T
    C_k = told[:k, k:].T
    D = told[k:, k:].T
    return np.block([[P - Q @ D @ C, Q @ C_k], [-B @ C, A]]), np.vstack([-Q @ D, -B])


@njit
def _favoured(weights, levels, first):
    """The walk over levels, by at most one a step, from ``first`` back to it, with the largest sum
    of weights times level.
    """
    steps = len(weights)
    value, choice = np.full(levels, -np.inf), np.zeros((steps, levels), np.int8)
    value[first] = 0.0
    for s in range(steps):
        new = np.full(levels, -np.inf)
        for i in range(levels):
            for move in (-1, 0, 1):
                if 0 <= i - move < levels and value[i - move] > new[i]:
                    new[i], choice[s, i] = value[i - move], move
            new[i] += weights[s] * i
        value = new
    walk = np.empty(steps + 1)
    walk[steps] = at = first
    for s in range(steps - 1, -1, -1):
        at -= choice[s, at]
        walk[s] = at
    return walk


def favoured(slope: np.ndarray, first: float, rate: float) -> np.ndarray:
    """The motion (samples,) from ``first`` to it, at most ``rate`` a sample, with nearly the
    largest sum of slope delta.
    """
    if not np.isfinite(rate):
        return np.where(slope == 0, first, np.sign(slope))
    samples = len(slope)
    block = max(1, int(2 / _NODES / rate))
    step = rate * block
    below = int((first + 1) / step)
    levels = below + int((1 - first) / step) + 1
    ends = np.minimum(np.arange(1, -(-samples // block) + 1) * block, samples)
    # a shorter last block stands still
    whole = len(ends) - (ends[-1] - (ends[-2] if len(ends) > 1 else 0) < block)
    sums = np.add.reduceat(slope, np.r_[0, ends[:-1]])
    walk = _favoured((sums[:whole] + np.r_[sums[1:whole], 0.0]) / 2, levels, below)
    nodes = first + (walk - below) * step
    return np.interp(np.arange(samples), np.r_[0, ends[:whole]], nodes)


def ascend(
    on: Tables,
    motion: Motion,
    start: np.ndarray,
    rate: float,
    error: float,
    rng: np.random.Generator,
    most: int = 40,
) -> tuple[Gain, Motion]:
    """Up the slope from a motion, at most ``rate`` [1/sample] fast and told within ``error``, both
    in units of delta.
    """
    here, tries = gain(on, on.places(motion), start, 12, True), 0
    for _ in range(most):
        shift = int(rng.integers(len(motion.delta)))
        slope = np.roll(here.over_delta, -shift)
        delta = np.roll(favoured(slope, float(motion.delta[shift]), rate), shift)
        wrong = None if motion.error is None else error * np.sign(here.over_told)
        for share in _SHARES:
            trial = replace(motion, delta=motion.delta + share * (delta - motion.delta))
            if wrong is not None:
                trial = replace(trial, error=motion.error + share * (wrong - motion.error))
            there = gain(on, on.places(trial), here.disturbance, 4, True)
            if there.value > (1 + _LEAST) * here.value:
                here = there
                motion = trial
                tries = 0
                break
        else:
            tries += 1
            if tries == 3:
                break
    return here, motion
