"""The worst that can happen in a box of real parameters: the margin to instability, and the largest gain.

Searches give truths from one side: a perturbation that does it. From the other side come the structured singular value's
bounds: ``proved_margin`` over all frequencies, ``gain_bound`` on a grid. Both sides are meant to be reported together.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ambrose.core.lft import Block, ComplexBlock, FullBlock
from ambrose.core.mu.bounds import mu_certificate
from ambrose.core.mu.structure import osborne, structure_of
from ambrose.core.mu.upper import upper_bound
from ambrose.core.statespace import StateSpace, balance
from ambrose.core.worst_case.loop import (
    BoxLoop,
    Sweep,
    box_loop,
    box_points,
    corners,
    count_unstable,
    default_grid,
    gains,
    perturbed_matrix,
    sweep,
)

_SAMPLES = 64
_LARGEST_BOX = 20.0
_STARTS = 6


@dataclass(frozen=True, slots=True, eq=False)
class BoxMargin:
    """The box may grow by ``factor`` before a perturbation in it destabilises: delta (k,), largest entry ``factor``, does.

    frequency [rad/s] of the pole on the axis. factor is infinite (delta NaN) when none was found up to 20 times the box. It is
    found by search: a smaller perturbation may exist where there are several parameters (for one it is exact).
    """

    factor: float
    delta: np.ndarray
    frequency: float


def box_margin(loop: BoxLoop, start: Sweep | None = None) -> BoxMargin:
    """The smallest destabilising perturbation found along the corners' directions and, from the best, beside them."""
    around = sweep(loop) if start is None else start
    rng = np.random.default_rng(0)
    directions = corners(loop.parameters)
    finest = 1.05 if loop.parameters == 1 else 1.25
    low, high = 0.0, 0.1
    unstable = np.zeros(len(directions), bool)
    while high < _LARGEST_BOX:
        count, around = count_unstable(loop, high * directions, around)
        unstable = count > 0
        if unstable.any():
            break
        low, high = high, high * finest
    if not unstable.any():
        return BoxMargin(float("inf"), np.full(loop.parameters, np.nan), float("nan"))
    factor, best = _shrink(loop, directions[unstable], low, high, around)
    for _ in range(4 if loop.parameters > 1 else 0):
        tries = np.clip(best + rng.normal(0, 0.5, (_SAMPLES, len(best))) * rng.integers(0, 2, (_SAMPLES, len(best))), -1, 1)
        count, around = count_unstable(loop, 0.998 * factor * tries, around)
        unstable = count > 0
        if unstable.any():
            factor, best = _shrink(loop, tries[unstable], 0.5 * factor, 0.998 * factor, around)
    size = np.abs(best).max()
    values = np.linalg.eigvals(perturbed_matrix(loop, factor * best))
    return BoxMargin(float(factor * size), factor * best, float(abs(values[np.argmin(np.abs(values.real))].imag)))


def _shrink(loop: BoxLoop, directions: np.ndarray, low: float, high: float, around: Sweep) -> tuple[float, np.ndarray]:
    """The smallest factor in (low, high] at which one of the directions, all unstable at ``high``, is unstable; bisection."""
    while high - low > 1e-5 * high:
        middle = 0.5 * (low + high)
        count, around = count_unstable(loop, middle * directions, around)
        unstable = count > 0
        if unstable.any():
            high, directions = middle, directions[unstable]
        else:
            low = middle
    return high, directions[0]


def proved_margin(loop: BoxLoop, most: float) -> float:
    """A factor by which the box may grow with stability proved for every point of it; 0 when nothing could be proved.

    The largest of a bisection up to ``most`` (see ``box_margin``) at which ``mu_certificate`` succeeds. With real parameters
    alone mu is discontinuous and its scalings grow without bound next to a real eigenvalue; each parameter is therefore allowed
    to be complex by 1 % of its size besides, which makes the proof a little stronger than needed.
    """
    n, s = len(loop.owner), loop.system
    B, C, D = s.B[:, :n], s.C[:n], s.D[:n, :n]
    e = 0.01
    both = StateSpace(s.A, np.hstack([B, B]), np.vstack([C, e * C]), np.block([[D, D], [e * D, e * D]]))
    blocks: list[Block] = [*loop.blocks]
    blocks += [ComplexBlock(f"{block.name} complex", block.repeat) for block in loop.blocks]
    largest = min(most, _LARGEST_BOX)
    low, high = 0.0, largest
    for i in range(6):
        factor = (0.99 * largest, 0.95 * largest, 0.9 * largest)[i] if low == 0 and i < 3 else 0.5 * (low + high)
        if mu_certificate(both, blocks, 1 / factor, (0.0, _tail(both, 1 / factor))).proved:
            low = factor
        else:
            high = factor
        if high - low < 0.01 * low:
            break
    return low


def _tail(system: StateSpace, level: float) -> float:
    """A frequency [rad/s] above which the largest singular value is below ``level``: |C||B|/(omega - |A|) + |D| bounds it."""
    A, t = balance(system.A)
    a, b, c, d = (float(np.linalg.norm(X, 2)) for X in (A, system.B / t[:, None], system.C * t, system.D))
    return np.inf if d >= level else 1.01 * (a + c * b / (level - d))


@dataclass(frozen=True, slots=True, eq=False)
class BoxGain:
    """The largest gain found in the box: value at frequency [rad/s] and delta (k,)."""

    value: float
    frequency: float
    delta: np.ndarray


def worst_case_gain(system: Any, blocks: Sequence[Block], seed: int = 1) -> BoxGain:
    """The largest gain that was found of ``system`` over its real parameters, each in -1..1, and over all frequencies.

    system: stable, its leading inputs and outputs those of ``blocks`` (RealBlock), the others those of the gain; see
    ``box_loop``. A lower bound: it is searched, not proved (``worst_gain``). Raises InvalidInput.
    """
    return worst_gain(box_loop(system, blocks), seed=seed)


def worst_gain(loop: BoxLoop, seed: int = 1) -> BoxGain:
    """The largest singular value of T(delta) over the box and all frequencies, from below.

    Corners, samples and the centre on the grid, then from the best few: gradient steps in delta (L-BFGS-B, exact gradient of
    the singular value), and a narrowing net in frequency, in turn. The loop must be stable all over the box.
    """
    grid = default_grid(loop)
    starts = box_points(loop.parameters, seed=seed)
    M = loop.at(grid)
    nominal = gains(M, loop, starts[:1])[0]
    kept = _gain_limit(M, len(loop.owner)) >= nominal.max()
    grid, found = grid[kept], gains(M[kept], loop, starts)
    order = np.argsort(found.max(axis=1))[::-1][:_STARTS]
    best = BoxGain(-np.inf, 0.0, starts[0])
    for i in order:
        best = max(best, _ascend(loop, grid, starts[i], int(found[i].argmax())), key=lambda item: item.value)
    return best


def worst_gain_at(loop: BoxLoop, omega: float) -> BoxGain:
    """As ``worst_gain``, at one frequency [rad/s] that is held."""
    M = loop.at(np.array([omega]))
    starts = box_points(loop.parameters)
    found = gains(M, loop, starts)[:, 0]
    best = BoxGain(-np.inf, omega, starts[0])
    for i in np.argsort(found)[::-1][:_STARTS]:
        delta = _climb(M[0], loop, starts[i], {})
        value = float(gains(M, loop, delta[None])[0, 0])
        best = max(best, BoxGain(value, omega, delta), key=lambda item: item.value)
    return best


def _gain_limit(M: np.ndarray, n: int) -> np.ndarray:
    """What the gain cannot exceed anywhere in the box, (w,), by norms alone: frequencies where it is low need no search."""
    M11, M12, M21, M22 = (np.linalg.norm(X, 2, axis=(1, 2)) for X in (M[:, :n, :n], M[:, :n, n:], M[:, n:, :n], M[:, n:, n:]))
    room = 1 - M11
    return np.where(room > 0, M22 + M21 * M12 / np.where(room > 0, room, 1.0), np.inf)


def _ascend(loop: BoxLoop, grid: np.ndarray, delta: np.ndarray, at: int) -> BoxGain:
    omega, value = float(grid[at]), 0.0
    left, right = float(grid[max(at - 1, 0)]), float(grid[min(at + 1, len(grid) - 1)])
    for _ in range(20):
        M = loop.at(np.array([omega]))[0]

        delta = _climb(M, loop, delta, {"maxiter": 30})
        omega, new = peak_at(loop, delta, left, omega, right)
        if new <= value * (1 + 1e-9):
            break
        value = new
        left, right = omega / 1.05, omega * 1.05
    return BoxGain(value, omega, delta)


def _climb(M: np.ndarray, loop: BoxLoop, delta: np.ndarray, options: dict[str, int]) -> np.ndarray:
    """The point (k,) of the box with the largest gain near delta (k,), for M (n + p, n + m) at one frequency."""
    from scipy.optimize import minimize

    bounds = [(-1, 1)] * len(delta)
    result = minimize(lambda x: _log_gain(M, loop, x), delta, jac=True, bounds=bounds, method="L-BFGS-B", options=options)
    return np.clip(result.x, -1, 1)


def _log_gain(M: np.ndarray, loop: BoxLoop, delta: np.ndarray) -> tuple[float, np.ndarray]:
    """-ln sigma_max(T(delta)) and its gradient (k,)."""
    n = len(loop.owner)
    wide = delta[loop.owner]
    inverse = np.linalg.inv(np.eye(n) - M[:n, :n] * wide)  # (I - M11 D)^-1
    right = inverse @ M[:n, n:]
    T = M[n:, n:] + (M[n:, :n] * wide) @ right
    u, s, v = np.linalg.svd(T)
    left = u[:, 0].conj() @ M[n:, :n] @ (np.eye(n) + (wide[:, None] * inverse) @ M[:n, :n])  # M21 (I - D M11)^-1
    slope = np.bincount(loop.owner, (left * (right @ v[0].conj())).real, loop.parameters)
    return -float(np.log(s[0])), -slope / s[0]


def peak_at(loop: BoxLoop, delta: np.ndarray, left: float, middle: float, right: float) -> tuple[float, float]:
    """Frequency [rad/s] and value of the largest gain at delta (k,) near ``middle``, by a narrowing net in [left, right]."""
    best, value = middle, float(gains(loop.at(np.array([middle])), loop, delta[None])[0, 0])
    for _ in range(8):
        net = np.unique(np.concatenate([np.linspace(left, best, 6), np.linspace(best, right, 6)]))
        row = gains(loop.at(net), loop, delta[None])[0]
        i = int(row.argmax())
        if row[i] > value:
            best, value = float(net[i]), float(row[i])
        left, right = max(left, best - (net[1] - net[0]) * 1.5), min(right, best + (net[-1] - net[-2]) * 1.5)
    return best, value


def gain_bound(loop: BoxLoop, omega: np.ndarray, start: float) -> float:
    """An upper bound of the largest gain over the box at the frequencies omega (w,) [rad/s], and nowhere between.

    The smallest gamma found with mu(diag(I, I/gamma) M) < 1, mu with the parameters' real blocks and one full block (skewed
    structured singular value; Fan & Tits 1992); ``start`` is a gain known from below. Infinite when 100 times it does not
    suffice: the bound then cannot exclude instability in the box.
    """
    n, tolerance = len(loop.owner), 2e-3
    M = loop.at(omega)
    structure = structure_of([*loop.blocks, FullBlock("gain", M.shape[2] - n, M.shape[1] - n)])

    def exceeds(part: np.ndarray, gamma: float) -> np.ndarray:
        scaled = part.copy()
        scaled[:, n:] /= gamma
        over = np.linalg.norm(osborne(scaled, structure)[0], 2, axis=(1, 2)) >= 1 - tolerance / 10
        level = np.full(int(over.sum()), 1 - tolerance / 10)  # whether mu < 1 is all that is asked
        over[over] = upper_bound(scaled[over], structure, level=level, tolerance=tolerance / 10).value >= 1
        return over

    low, high = start, start * (1 + tolerance)
    active = M
    step = 1 + tolerance
    while True:
        left = exceeds(active, high)
        if not left.any():
            break
        active, low = active[left], high
        step = step**2
        high *= step
        if high > 100 * start:
            return np.inf
    while high / low > 1 + tolerance:
        middle = np.sqrt(low * high)
        left = exceeds(active, middle)
        if left.any():
            active, low = active[left], middle
        else:
            high = middle
    return float(high)
