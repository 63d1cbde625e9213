"""A loop with real parameters in a box: its gain and the number of its unstable poles at any point
of the box.

The parameters are pulled out of a stable system: w = diag(delta) z, (z, e) = M (w, d), so that at
every frequency

    T(delta) = M22 + M21 diag(delta) (I - M11 diag(delta))^-1 M12        d -> e

costs a small matrix whatever the order of the system. ``worst_case/search.py`` looks for the worst
that can happen in the box.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np

from ambrose.core.checks import UnstableSystem, check_shape, invalid, named_failure
from ambrose.core.frequency import largest_gain
from ambrose.core.lft import Block, RealBlock
from ambrose.core.mu.chords import Chords, chords
from ambrose.core.statespace import StateSpace, as_statespace, is_stable, spectral_abscissa
from ambrose.core.worst_case.elimination import determinants_at, transfers_at

_CHUNK = 400_000  # matrices worked on at once
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

    owner (n,): the parameter that channel belongs to; model: for evaluation and proof; poles (s,)
    of the loop with delta = 0.
    """

    system: StateSpace
    blocks: tuple[RealBlock, ...]
    owner: np.ndarray
    model: Chords
    poles: np.ndarray

    @property
    def parameters(self) -> int:
        return len(self.blocks)

    def at(self, omega: np.ndarray) -> np.ndarray:
        """M (w, n + p, n + m) at omega (w,) [rad/s], infinity allowed."""
        return self.model.at(omega)


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
    real = tuple(block for block in blocks if isinstance(block, RealBlock))
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
    return BoxLoop(system, real, owner, model, model.every_pole)


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
    # a part of the frequencies at a time: what is held stays in memory that was asked for before
    n = len(loop.owner)
    size = max(1, len(delta) * (M.shape[1] - n) * (M.shape[2] - n))
    step = max(1, _CHUNK // size)
    parts = [
        _largest(transfers(M[start : start + step], loop, delta))
        for start in range(0, max(1, len(M)), step)
    ]
    return parts[0] if len(parts) == 1 else np.hstack(parts)


def _largest(T: np.ndarray) -> np.ndarray:
    on_pole = ~np.isfinite(T).all(axis=(2, 3))
    T[on_pole] = 0.0
    return np.where(on_pole, np.inf, largest_gain(T))


def transfers(M: np.ndarray, loop: BoxLoop, delta: np.ndarray) -> np.ndarray:
    """T(delta) (d, w, p, m)."""
    step = max(1, _CHUNK // max(1, len(M)))
    parts = [
        transfers_at(M, loop.owner, delta[start : start + step])
        for start in range(0, max(1, len(delta)), step)
    ]
    return np.concatenate(parts)


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
                determinants_at(both, loop.owner, delta[i : i + step])
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
    n, s = len(loop.owner), loop.system
    D = np.diag(delta[loop.owner])
    return s.A + s.B[:, :n] @ D @ np.linalg.solve(np.eye(n) - s.D[:n, :n] @ D, s.C[:n])
