"""The largest gain over a box of real parameters and all frequencies, from below: members tried,
and the best followed uphill.

M is the nominal loop's and smooth between its poles; the gain of a member is sharp where the member
has a pole. That pole is a zero of h = det(I - M11 delta), found from the grid by one Newton step, d
ln h / d ln s: where it lies between grid points the member is looked at beside it as well. From the
best, ascent in delta and frequency together, frequency measured from the pole, in units of its
decay, along with which it moves: a ridge that is narrow in frequency is followed all the same.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from ambrose.core.checks import AmbroseError, invalid, named_failure
from ambrose.core.frequency import largest_gain, peak_near
from ambrose.core.lft import Block, ComplexBlock, FullBlock
from ambrose.core.mu.all_frequencies import least_level, proved_level
from ambrose.core.mu.structure import structure_of
from ambrose.core.presentation import Presented
from ambrose.core.worst_case_loop import (
    LARGEST_BOX,
    BoxLoop,
    box_loop,
    box_points,
    default_grid,
    determinants_at,
    gains,
)

# What cannot happen in a box of real parameters: bounds by the structured singular value, at all
# frequencies or on a grid.
#
# The searches beside it (``crossing``, ``search``) give what does happen. Both sides are meant to
# be reported together, and each is a start for the other: the frequency at which a bound is reached
# is one at which to search.


# of a proof: they never take a result with them
FAILURES = (AmbroseError, ArithmeticError, np.linalg.LinAlgError)
COMPLEX_PART = 0.01  # of each parameter, in the proof of stability
_CLOSE = 0.99  # of the factor found, at which the proof begins
_ROOM = 3e-3  # of a level above the bound at one frequency; the nearer, the shorter the intervals
_LEAST_FACTOR = 0.05  # of the factor found, below which no proof is tried


@dataclass(frozen=True, slots=True, eq=False)
class Proved:
    """A bound proved at all frequencies: value, the frequency [rad/s] that decides it (NaN: none),
    and why there is none (else empty; value is then 0 for a margin, infinite for a gain).
    """

    value: float
    frequency: float = float("nan")
    why: str = ""


def proved_margin(loop: BoxLoop, most: float) -> Proved:
    """A factor by which the box may grow with stability proved for every point of it; 0 when
    nothing could be proved.

    Near ``most`` (see ``box_margin``) where the proof is that sharp. With real parameters alone mu
    is discontinuous and its scalings grow without bound; each parameter is therefore allowed to be
    complex by 1 % of its size besides, which makes the proof a little stronger than needed.
    """
    e = COMPLEX_PART

    # w + w_c = (delta + e delta_c) z: M11 with outputs (z, e z) and inputs w, w_c that add
    few = loop.ports
    M11 = loop.model.part(few.outputs, few.inputs)
    both = M11.between(np.vstack([few.out_of, e * few.out_of]), np.hstack([few.into, few.into]))
    blocks: list[Block] = [
        *loop.blocks,
        *(ComplexBlock(f"{block.name} complex", block.repeat) for block in loop.blocks),
    ]

    # mu < level proves the box up to the factor 1 / level
    start = 1 / (_CLOSE * min(most, LARGEST_BOX))
    try:
        proved = proved_level(both, blocks, start, room=_ROOM, highest=start / _LEAST_FACTOR)
    except FAILURES as error:
        return Proved(0.0, why=str(error))
    return Proved(1 / proved.level, proved.frequency)


def proved_gain(loop: BoxLoop, start: float, omega: np.ndarray | None = None) -> Proved:
    """An upper bound of the gain over the whole box and all frequencies; infinite when nothing
    could be proved.

    The smallest gamma found >= ``start`` (a gain known from below) with mu(diag(I, I/gamma) M) < 1
    at every frequency, mu with the parameters' real blocks and one full block (skewed structured
    singular value; Fan & Tits 1992). omega (w,) [rad/s]: frequencies at which the gain comes near
    its worst.
    """
    blocks, skew = _with_gain(loop)
    try:
        proved = proved_level(
            loop.response, blocks, start * (1 + _ROOM), skew=skew, room=_ROOM, omega=omega
        )
    except FAILURES as error:
        return Proved(float("inf"), why=str(error))
    return Proved(proved.level, proved.frequency)


@named_failure("the bound of the gain in the box")
def gain_bound(loop: BoxLoop, omega: np.ndarray, start: float) -> float:
    """An upper bound of the largest gain over the box at the frequencies omega (w,) [rad/s], and
    nowhere between.

    As ``proved_gain``, frequency by frequency. Infinite when 100 times ``start`` does not suffice:
    the bound then cannot exclude instability in the box.
    """
    blocks, skew = _with_gain(loop)
    return least_level(loop.at(omega), structure_of(blocks), skew, start, 2e-3)[0]


def _with_gain(loop: BoxLoop) -> tuple[list[Block], np.ndarray]:
    """The blocks with a full one for the gain, and the rows that it owns."""
    n, (rows, columns) = len(loop.owner), loop.system.D.shape
    return [*loop.blocks, FullBlock("gain", columns - n, rows - n)], np.arange(rows) >= n


_STARTS = 10  # points from which the gain is climbed, the largest first
_BAND = 0.1  # relative width in which two starts of one member are the same
_STEP = 1e-6  # relative step of the derivative in frequency
_BESIDE = (-1.0, 0.0, 1.0)  # of a member's pole, in its decays
_MEET = 1e-6  # relative, of frequencies and tolerances at one place
_ROUNDS = 8  # of ascent, each from a new pole


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class BoxGain(Presented):
    """The largest gain found in the box: value at frequency [rad/s] and delta (k,)."""

    value: float
    frequency: float
    delta: np.ndarray

    def meets(self, other: BoxGain) -> bool:
        """Whether both are at one place, but for what a search leaves."""
        near = abs(self.frequency - other.frequency) <= _MEET * other.frequency
        return near and bool((np.abs(self.delta - other.delta) <= _MEET).all())


def worst_case_gain(system: Any, blocks: Sequence[Block], seed: int = 1) -> BoxGain:
    """The largest gain that was found of ``system`` over its real parameters, each in -1..1, and
    over all frequencies.

    system: stable, its leading inputs and outputs those of ``blocks`` (RealBlock), the others those
    of the gain; see ``box_loop``. A lower bound: it is searched, not proved (``worst_gain``).
    Raises InvalidInput.
    """
    loop = box_loop(system, blocks)
    if min(loop.system.D.shape) <= len(loop.owner):
        raise invalid(
            "the system",
            f"{loop.system.D.shape[1]} inputs and {loop.system.D.shape[0]} outputs, those of the "
            "blocks",
            "one with further inputs and outputs, of which the gain is computed",
            "list them after those of the blocks",
        )
    return worst_gain(loop, seed=seed)


@named_failure("the worst gain in the box")
def worst_gain(loop: BoxLoop, seed: int = 1) -> BoxGain:
    """The largest singular value of T(delta) over the box and all frequencies, from below.

    Corners, samples and the centre on a grid and beside their own poles, then ascent from the best
    of different bands of frequency. The loop must be stable all over the box.
    """
    grid = np.concatenate([[0.0], default_grid(loop)])
    members = box_points(loop.parameters, seed=seed)
    M = loop.at(grid)

    # where the limit is below the gain without perturbation nothing is to be found; neighbours stay
    kept = _gain_limit(M, len(loop.owner)) >= gains(M, loop, members[:1])[0].max()
    kept[1:] |= kept[:-1]
    kept[:-1] |= kept[1:]
    grid, M = grid[kept], M[kept]
    levels = gains(M, loop, members)
    i, k = np.nonzero(_local_maxima(levels))
    rows = [np.stack([levels[i, k], i, grid[k]]), _beside_poles(loop, grid, M, members, kept)]
    starts = [(int(i), float(omega)) for _, i, omega in _best_of_each_band(np.hstack(rows))]
    best = BoxGain(-np.inf, 0.0, members[0])
    passed: list[BoxGain] = []
    for row, omega in starts:
        best = max(best, _ascend(loop, members[row], omega, passed), key=lambda item: item.value)
    return best


@named_failure("the worst gain in the box")
def worst_gain_beside(loop: BoxLoop, omega: float) -> BoxGain:
    """As ``worst_gain``, by ascent from the worst at one frequency [rad/s] alone."""
    return _ascend(loop, worst_gain_at(loop, omega).delta, omega, [])


@named_failure("the worst gain in the box")
def worst_gain_at(loop: BoxLoop, omega: float) -> BoxGain:
    """As ``worst_gain``, at one frequency [rad/s] that is held."""
    M = loop.at(np.array([omega]))
    starts = box_points(loop.parameters)
    levels = gains(M, loop, starts)[:, 0]
    best = BoxGain(-np.inf, omega, starts[0])
    for i in np.argsort(levels)[::-1][:_STARTS]:
        delta = _climb(M[0], loop, starts[i])
        value = float(gains(M, loop, delta[None])[0, 0])
        best = max(best, BoxGain(value, omega, delta), key=lambda item: item.value)
    return best


def _gain_limit(M: np.ndarray, n: int) -> np.ndarray:
    """What the gain cannot exceed anywhere in the box, (w,), by norms alone: frequencies where it
    is low need no search.
    """
    M11, M12, M21, M22 = (
        largest_gain(X) for X in (M[:, :n, :n], M[:, :n, n:], M[:, n:, :n], M[:, n:, n:])
    )

    # |T| <= |M22| + |M21| |M12| / (1 - |M11|), as |delta| <= 1
    room = 1 - M11
    return np.where(room > 0, M22 + M21 * M12 / np.where(room > 0, room, 1.0), np.inf)


def _local_maxima(values: np.ndarray) -> np.ndarray:
    """Which of values (d, w) are no lower than their neighbours in the row."""
    padded = np.pad(values, ((0, 0), (1, 1)), constant_values=-np.inf)
    return np.asarray((values >= padded[:, :-2]) & (values >= padded[:, 2:]))


def _beside_poles(
    loop: BoxLoop, grid: np.ndarray, M: np.ndarray, members: np.ndarray, kept: np.ndarray
) -> np.ndarray:
    """(3, c): gain, member and frequency [rad/s] beside those poles of the members that hide
    between grid points.
    """
    n, positive = len(loop.owner), grid > 0
    omega = grid[positive]
    M11 = M[positive, :n, :n]
    h = determinants_at(M11, loop.owner, members, loop.ports)

    # Newton's step in ln s from j omega to a zero of h: -1 / (d ln h / d ln s)
    beside = loop.at(omega * (1 + _STEP))[:, :n, :n]
    with np.errstate(all="ignore"):
        shift = -_STEP / (determinants_at(beside, loop.owner, members, loop.ports) / h - 1)

    # between grid points, and closer to the axis than they are to each other: the peak hides
    gap = np.gradient(np.log(omega)) if len(omega) > 1 else np.ones(1)
    i, k = np.nonzero((np.abs(shift.real) <= 1.5 * gap) & (np.abs(shift.imag) <= gap))
    if not len(i):
        return np.zeros((3, 0))

    # the zero is at j omega (1 + shift): its frequency from Re, its decay from Im
    centre, decay = omega[k] * (1 + shift[i, k].real), np.abs(omega[k] * shift[i, k].imag)
    which = np.tile(i, len(_BESIDE))
    at = np.concatenate([centre + share * decay for share in _BESIDE])
    which, at = which[at > 0], at[at > 0]
    values = _gains_one_by_one(loop, members[which], at)
    return np.stack([values, which, at])


def _gains_one_by_one(loop: BoxLoop, delta: np.ndarray, omega: np.ndarray) -> np.ndarray:
    """Gain (c,) of member delta[i] at omega[i] [rad/s]."""
    n = len(loop.owner)
    M, wide = loop.at(omega), delta[:, loop.owner]
    X = np.eye(n) - M[:, :n, :n] * wide[:, None, :]
    singular = ~(np.abs(np.linalg.det(X)) > 0)
    X[singular] = np.eye(n)
    T = M[:, n:, n:] + (M[:, n:, :n] * wide[:, None, :]) @ np.linalg.solve(X, M[:, :n, n:])
    values = largest_gain(T)
    values[singular] = 0.0
    return np.asarray(values)


def _best_of_each_band(rows: np.ndarray) -> list[tuple[float, float, float]]:
    """Of rows (gain, member, frequency), the highest: three of one band of frequency at most, one
    of a member there.
    """
    chosen: list[tuple[float, float, float]] = []
    count: dict[int, int] = {}
    taken_bands: set[tuple[int, int]] = set()
    for value, member, omega in rows[:, np.argsort(-rows[0])].T:
        band = round(np.log(max(omega, 1e-300)) / _BAND)
        if (band, int(member)) in taken_bands or count.get(band, 0) == 3:
            continue
        taken_bands.add((band, int(member)))
        count[band] = count.get(band, 0) + 1
        chosen.append((value, member, omega))
        if len(chosen) == _STARTS or value < 0.3 * chosen[0][0]:
            break
    return chosen


def _ascend(loop: BoxLoop, delta: np.ndarray, omega: float, passed: list[BoxGain]) -> BoxGain:
    """Uphill in delta and frequency together until a round gains nothing more, or comes to where
    an earlier ascent was; ``passed`` holds where all were.
    """
    from scipy.optimize import minimize

    best = BoxGain(_gain(loop, delta, omega), omega, delta)
    for _ in range(_ROUNDS):
        decay, slope = _pole_beside(loop, best.delta, best.frequency)
        origin, centre = np.append(best.delta, 0.0), best.frequency

        line = np.append(slope, decay)  # frequency = |centre + line . (x - origin)|
        bounds = [*[(-1.0, 1.0)] * loop.parameters, (-20.0, 20.0)]
        options = {"maxiter": 60}
        cost = partial(_along, loop, centre, line, origin)
        optimum = minimize(
            cost, origin, jac=True, bounds=bounds, method="L-BFGS-B", options=options
        )
        at, omega = np.clip(optimum.x[:-1], -1, 1), abs(centre + float(line @ (optimum.x - origin)))
        omega, value = peak_at(loop, at, max(omega - 3 * decay, 0.0), omega, omega + 3 * decay)
        if not value > best.value * (1 + 1e-9):
            break
        best = BoxGain(value, omega, at)
        if any(best.meets(other) for other in passed):
            break
        passed.append(best)
    return best


def _along(
    loop: BoxLoop, centre: float, line: np.ndarray, origin: np.ndarray, x: np.ndarray
) -> tuple[float, np.ndarray]:
    """-ln of the gain at x = (delta, distance from the pole in decays), and its gradient (k +
    1,).
    """
    omega = centre + float(line @ (x - origin))
    value, over_delta, over_omega = _log_gain(loop, x[:-1], abs(omega))
    return value, np.append(over_delta, 0.0) + (over_omega if omega >= 0 else -over_omega) * line


def _pole_beside(loop: BoxLoop, delta: np.ndarray, omega: float) -> tuple[float, np.ndarray]:
    """The decay [rad/s] of the member's pole next to j omega, and how its frequency moves with
    delta (k,) [rad/s].
    """
    k, n = loop.parameters, len(loop.owner)
    broad = (max(0.05 * omega, 1e-3 * float(np.abs(loop.poles).min(initial=1.0))), np.zeros(k))
    if omega == 0.0:
        return broad
    M, slope = (part[:n, :n] for part in loop.response.with_slope(omega))
    wide = delta[loop.owner]
    X = np.eye(n) - M * wide
    try:
        K = np.linalg.inv(X)
    except np.linalg.LinAlgError:
        return broad
    over_omega = -np.trace(K @ (slope * wide))  # of ln det
    diagonal = np.diag(K @ M)
    over_delta = -(
        np.bincount(loop.owner, diagonal.real, k) + 1j * np.bincount(loop.owner, diagonal.imag, k)
    )
    if not abs(over_omega) * omega > 3:
        return broad

    # the zero omega + distance by Newton; it moves by -over_delta / over_omega with delta
    distance = -1 / over_omega  # of the zero from omega, complex
    moved = -over_delta / over_omega
    decay = abs(distance.imag)
    return (float(max(decay, 1e-9 * omega)), np.asarray(moved.real)) if decay < broad[0] else broad


def _gain(loop: BoxLoop, delta: np.ndarray, omega: float) -> float:
    return float(gains(loop.at(np.array([omega])), loop, delta[None])[0, 0])


def _climb(M: np.ndarray, loop: BoxLoop, delta: np.ndarray) -> np.ndarray:
    """The point (k,) of the box with the largest gain near delta (k,), for M (n + p, n + m) at one
    frequency.
    """
    from scipy.optimize import minimize

    def cost(x: np.ndarray) -> tuple[float, np.ndarray]:
        return _slopes(M, np.zeros_like(M), loop, x)[:2]

    result = minimize(cost, delta, jac=True, bounds=[(-1, 1)] * len(delta), method="L-BFGS-B")
    return np.clip(result.x, -1, 1)


def _log_gain(loop: BoxLoop, delta: np.ndarray, omega: float) -> tuple[float, np.ndarray, float]:
    """-ln sigma_max(T(delta)) at omega [rad/s], its gradient (k,) and its derivative with respect
    to omega.
    """
    return _slopes(*loop.response.with_slope(omega), loop, delta)


def _slopes(
    M: np.ndarray, slope: np.ndarray, loop: BoxLoop, delta: np.ndarray
) -> tuple[float, np.ndarray, float]:
    """The same from M and dM/d omega (n + p, n + m)."""
    n = len(loop.owner)
    wide = delta[loop.owner]
    inverse = np.linalg.inv(np.eye(n) - M[:n, :n] * wide)  # (I - M11 D)^-1
    right = inverse @ M[:n, n:]
    T = M[n:, n:] + (M[n:, :n] * wide) @ right
    if not np.isfinite(T).all():  # a pole is met to rounding: the search steps back from it
        return -float(np.log(np.finfo(float).tiny)), np.zeros(loop.parameters), 0.0
    u, s, v = np.linalg.svd(T)
    if s[0] < np.finfo(float).tiny:  # nothing passes here, whichever way it would grow
        return -float(np.log(np.finfo(float).tiny)), np.zeros(loop.parameters), 0.0
    a, b = u[:, 0].conj(), v[0].conj()
    forward = (a @ M[n:, :n]) * wide @ inverse  # M21 D (I - M11 D)^-1
    left = a @ M[n:, :n] + forward @ M[:n, :n]  # M21 (I - D M11)^-1

    # d sigma = Re a dT b, dT = M21 (I - D M11)^-1 dD (I - M11 D)^-1 M12
    over_delta = np.bincount(loop.owner, (left * (right @ b)).real, loop.parameters)
    # dT = [M21 D (I - M11 D)^-1, I] dM [D (I - M11 D)^-1 M12; I]
    over_omega = np.concatenate([forward, a]) @ slope @ np.concatenate([wide * (right @ b), b])
    return -float(np.log(s[0])), -over_delta / s[0], -float(over_omega.real) / float(s[0])


def peak_at(
    loop: BoxLoop, delta: np.ndarray, left: float, middle: float, right: float
) -> tuple[float, float]:
    """Frequency [rad/s] and value of the largest gain at delta (k,) near ``middle`` in [left,
    right].
    """
    net = np.unique([left, middle, right])
    return peak_near(lambda omega: gains(loop.at(omega), loop, delta[None])[0], net)
