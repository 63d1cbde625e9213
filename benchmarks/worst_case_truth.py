"""Worst cases over a box of real parameters against the truth: random loops, most of them with
lightly damped modes.

python -m benchmarks.worst_case_truth [systems] [first]

The truth is brute force that shares nothing with what it judges: eigenvalues of the perturbed state
matrix, and gains from the perturbed matrices at their own poles, over a dense grid of the box (one
or two parameters) or corners and random points (three or four); from the best, simplex search on
the exact H-infinity norm (Hamiltonian test), or on the spectral abscissa. The box is scaled to 0.3
to 0.97 of the margin found. Printed at the end: how often a bound lies below the truth (must be
never), and how often and by how much a search misses it.
"""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass
from itertools import product

import numpy as np
from scipy.optimize import minimize

from ambrose.core.lft import RealBlock
from ambrose.core.norms import hinf_norm
from ambrose.core.statespace import StateSpace
from ambrose.core.worst_case import proved_gain, proved_margin, worst_gain, worst_gain_beside
from ambrose.core.worst_case_loop import BoxLoop, box_loop, box_margin

SYSTEMS = 500
_GRID = {1: 801, 2: 35}  # points per axis
_POINTS = 1000  # of the box of three or four parameters
_REFINED = 2


def light_modes(rng: np.random.Generator, parameters: int) -> StateSpace:
    """Modes of 0.1 to 5 % damping; the parameters move stiffness, damping and cross-coupling of
    several at once, a lot.
    """
    modes = int(rng.integers(1, 5))
    omega, zeta = np.exp(rng.uniform(0, 3, modes)), 10 ** rng.uniform(-3, -1.3, modes)
    A = np.block(
        [[np.zeros((modes, modes)), np.diag(omega)], [-np.diag(omega), -np.diag(2 * zeta * omega)]]
    )
    repeats = rng.integers(1, 3, parameters)
    n = int(repeats.sum())
    B = np.vstack([np.zeros((modes, n)), rng.normal(size=(modes, n))])
    C = rng.normal(size=(n, 2 * modes)) * (10 ** rng.uniform(-1, 0.5, n))[:, None]
    C[:, modes:] *= rng.choice([0.0, 0.1, 1.0], (n, 1))
    into, out = rng.normal(size=(2 * modes, 1)), rng.normal(size=(1, 2 * modes))
    D = np.zeros((n + 1, n + 1))
    return StateSpace(A, np.hstack([B, into]), np.vstack([C, out]), D), repeats


def general(rng: np.random.Generator, parameters: int) -> StateSpace:
    """Random matrices with a direct term, two inputs and outputs."""
    states = int(rng.integers(3, 9))
    A = rng.normal(size=(states, states))
    A -= (np.linalg.eigvals(A).real.max() + 10 ** rng.uniform(-2, -0.3)) * np.eye(states)
    repeats = rng.integers(1, 3, parameters)
    n = int(repeats.sum())
    B, C = rng.normal(size=(states, n + 2)), rng.normal(size=(n + 2, states))
    B[:, :n] *= 0.3
    D = np.zeros((n + 2, n + 2))
    D[:n, :n] = rng.choice([0.0, 0.1]) * rng.normal(size=(n, n))
    return StateSpace(A, B, C, D), repeats


def loop_of(seed: int) -> BoxLoop:
    """One loop; every third one is of random matrices."""
    rng = np.random.default_rng(seed)
    parameters = int(rng.integers(1, 5))
    system, repeats = (general if seed % 3 == 2 else light_modes)(rng, parameters)
    return box_loop(system, [RealBlock(f"p{i}", int(r)) for i, r in enumerate(repeats)])


def scaled(loop: BoxLoop, factor: float) -> BoxLoop:
    """The same loop with its box grown by ``factor``."""
    s, n = loop.system, len(loop.owner)
    grow = np.append(np.full(n, factor), np.ones(s.D.shape[0] - n))[:, None]
    return box_loop(StateSpace(s.A, s.B, grow * s.C, grow * s.D), loop.blocks)


def members(
    loop: BoxLoop, delta: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """The matrices of the perturbed loops (d, ...), by the formula of the upper LFT."""
    s, n = loop.system, len(loop.owner)
    wide = delta[:, loop.owner][:, :, None] * np.eye(n)
    inner = wide @ np.linalg.inv(np.eye(n) - s.D[:n, :n] @ wide)
    left, right = s.B[:, :n] @ inner, s.D[n:, :n] @ inner
    return (
        s.A + left @ s.C[:n],
        s.B[:, n:] + left @ s.D[:n, n:],
        s.C[n:] + right @ s.C[:n],
        s.D[n:, n:] + right @ s.D[:n, n:],
    )


def points(loop: BoxLoop, rng: np.random.Generator) -> np.ndarray:
    """Points (d, k) all over the box, ends included."""
    k = loop.parameters
    if k in _GRID:
        return np.array(list(product(np.linspace(-1, 1, _GRID[k]), repeat=k)))
    some = rng.uniform(-1, 1, (_POINTS, k))
    some[: _POINTS // 2] = np.where(
        rng.random((_POINTS // 2, k)) < 0.6, np.sign(some[: _POINTS // 2]), some[: _POINTS // 2]
    )
    return np.vstack([np.array(list(product((-1.0, 0.0, 1.0), repeat=k))), some])


def abscissa(loop: BoxLoop, delta: np.ndarray) -> np.ndarray:
    """Spectral abscissa (d,) [rad/s] over the fastest pole."""
    values = np.linalg.eigvals(members(loop, delta)[0])
    return values.real.max(axis=1) / np.abs(values).max(axis=1)


def true_margin(loop: BoxLoop, found: float, rng: np.random.Generator) -> float:
    """The smallest factor below ``found`` (20 where none was found) at which brute force finds an
    unstable member.
    """
    best = found
    for _ in range(4):
        size = 0.995 * min(best, 20.0)
        tried = points(loop, rng) * size
        values = abscissa(loop, tried)
        seeds = tried[np.argsort(-values)[:_REFINED]]
        for seed in seeds:
            if values.max() >= 0:
                break
            result = minimize(
                lambda x, size=size: -abscissa(loop, np.clip(x, -size, size)[None])[0],
                seed,
                method="Nelder-Mead",
                options={"maxfev": 40 * loop.parameters},
            )
            tried, values = (
                np.vstack([tried, np.clip(result.x, -size, size)]),
                np.append(values, -result.fun),
            )
        bad = tried[values >= 0]
        if not len(bad):
            return best
        best = float(np.abs(bad).max(axis=1).min())
    return best


def true_gain(loop: BoxLoop, rng: np.random.Generator) -> float:
    """The largest H-infinity norm over the box that brute force finds."""
    tried = points(loop, rng)
    A, B, C, D = members(loop, tried)
    poles = np.linalg.eigvals(A)
    omega = np.concatenate([np.abs(poles.imag), np.abs(poles), np.zeros((len(poles), 1))], axis=1)
    gain = np.zeros(len(tried))
    for column in omega.T:
        X = np.linalg.solve(1j * column[:, None, None] * np.eye(A.shape[1]) - A, B)
        gain = np.maximum(gain, np.linalg.norm(C @ X + D, 2, axis=(1, 2)))

    def norm(x: np.ndarray) -> float:
        parts = [part[0] for part in members(loop, np.clip(x, -1, 1)[None])]
        return -hinf_norm(StateSpace(*parts), tolerance=1e-5).value

    best = 0.0
    for i in np.argsort(-gain)[:_REFINED]:
        simplex = np.vstack(
            [
                tried[i],
                tried[i] + 0.03 * np.where(tried[i] > 0, -1, 1)[:, None] * np.eye(loop.parameters),
            ]
        )
        options = {"maxfev": 20 * loop.parameters, "initial_simplex": simplex}
        result = minimize(norm, tried[i], method="Nelder-Mead", options=options)
        best = max(best, -float(result.fun))
    return best


@dataclass(frozen=True, slots=True)
class Row:
    """What was found and what is true of one system; NaN where it was not asked for."""

    parameters: int
    margin: float
    proved: float
    margin_truth: float
    worst: float = float("nan")
    bound: float = float("nan")
    gain_truth: float = float("nan")


def compare(seed: int) -> Row:
    """One random system."""
    rng = np.random.default_rng(seed)
    loop = loop_of(seed)
    margin = box_margin(loop)
    proved = proved_margin(loop, margin.factor).value
    truth = true_margin(loop, margin.factor, rng)
    stable = min(margin.factor, truth, 20.0)
    box = scaled(loop, rng.uniform(0.3, 0.97) * stable)
    worst = worst_gain(box)
    bound = proved_gain(box, worst.value)
    # as verification does: search where the proof says it may be
    if bound.value > 1.01 * worst.value:
        worst = max(worst, worst_gain_beside(box, bound.frequency), key=lambda item: item.value)
    return Row(
        loop.parameters, margin.factor, proved, truth, worst.value, bound.value, true_gain(box, rng)
    )


def report(rows: list[Row]) -> list[str]:
    """The comparison in words."""
    finite = [r for r in rows if np.isfinite(min(r.margin, r.margin_truth))]
    high = np.array([r.margin / r.margin_truth - 1 for r in finite])
    low = np.array([1 - r.worst / r.gain_truth for r in rows])
    gap = np.array([r.bound / max(r.worst, r.gain_truth) - 1 for r in rows])
    short = np.array([1 - r.proved / r.margin_truth for r in finite])
    return [
        f"{len(rows)} systems, {len(finite)} of them can be destabilised within 20 boxes",
        f"margin found too high by > 1 %: {(high > 0.01).sum()}, > 5 %: {(high > 0.05).sum()}, "
        f"most {high.max(initial=0):.2%}",
        f"margin proved above the truth: {(short < -1e-6).sum()}; proved within 2 % of the truth: "
        f"{(short < 0.02).mean():.1%}, "
        f"within 10 %: {(short < 0.1).mean():.1%}, nothing proved: "
        f"{sum(r.proved == 0 for r in rows)}",
        f"gain found too low by > 1 %: {(low > 0.01).sum()}, > 5 %: {(low > 0.05).sum()}, most "
        f"{low.max():.2%}",
        f"gain bound below the truth: {(gap < -1e-6).sum()}; not proved: "
        f"{sum(not np.isfinite(r.bound) for r in rows)}; "
        f"above the larger of search and truth by > 1 %: {(gap > 0.01).sum()}, > 10 %: "
        f"{(gap > 0.1).sum()}, "
        f"median {np.median(gap):.2%}",
    ]


def main() -> None:
    count = int(sys.argv[1]) if len(sys.argv) > 1 else SYSTEMS
    first = int(sys.argv[2]) if len(sys.argv) > 2 else 0
    rows: list[Row] = []
    start = time.process_time()
    for seed in range(first, first + count):
        row = compare(seed)
        rows.append(row)
        off = row.margin / row.margin_truth > 1.01 or row.worst < 0.99 * row.gain_truth
        wrong = row.proved > row.margin_truth * (1 + 1e-6) or row.bound < row.gain_truth * (
            1 - 1e-6
        )
        if off or wrong or not np.isfinite(row.bound) or not row.proved:
            print(f"seed {seed}: {'WRONG ' * wrong}{row}", flush=True)
    for line in report(rows):
        print(line)
    print(f"{time.process_time() - start:.0f} s of processor time")


if __name__ == "__main__":
    main()
