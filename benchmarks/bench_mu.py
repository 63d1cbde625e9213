"""Mixed structured singular value over 100 frequencies, beside SLICOT's AB13MD (slycot) and dkpy's
LMI bisection.

Neither peer can do the first case: AB13MD has no repeated real block and dkpy no real block at all.
They get the nearest problem they can represent, named in the row: AB13MD independent reals, dkpy
complex blocks. dkpy is timed at two frequencies and scaled to 100 (its cost is one bisection per
frequency). Slow peers are skipped where they are not installed.
"""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable
from typing import Any

import numpy as np

from ambrose.core.frequency import frequency_response
from ambrose.core.lft import Block, FullBlock, RealBlock
from ambrose.core.mu.all_frequencies import proved_below
from ambrose.core.mu.bounds import mu_bounds, mu_peak
from ambrose.core.statespace import StateSpace

FREQUENCIES = 100


def run() -> list[dict[str, Any]]:
    """One row per case: name, ours [s], peer [s] or None, peer name, error (or the gap between
    upper and lower bound).
    """
    repeated: list[Block] = [RealBlock("k", 2), FullBlock("performance", 8, 8)]
    eight: list[Block] = [*(RealBlock(f"k{i}") for i in range(8)), FullBlock("performance", 8, 8)]
    rows = []
    for name, blocks in (("delta I_2 + full 8x8", repeated), ("8 reals + full 8x8", eight)):
        system = _system(sum(block.n_z for block in blocks))
        omega = np.geomspace(0.3, 300, FREQUENCIES)
        M = frequency_response(system, omega).values
        rows += _against_peers(name, M, blocks)
        rows.append(_over_frequency(name, system, blocks, omega))
    rows += [_growth(repeated, count) for count in (50, 200, 1000)]
    return rows


def _system(channels: int) -> StateSpace:
    """Twelve modes between 1 and 100 rad/s with 2 to 20 % damping, seen by all channels. Seeded."""
    rng = np.random.default_rng(channels)
    A = np.zeros((24, 24))
    for i, (w, zeta) in enumerate(
        zip(np.geomspace(1, 100, 12), rng.uniform(0.02, 0.2, 12), strict=True)
    ):
        A[2 * i : 2 * i + 2, 2 * i : 2 * i + 2] = w * np.array([[-zeta, 1], [-1, -zeta]])
    B, C = rng.standard_normal((24, channels)), rng.standard_normal((channels, 24))
    return StateSpace(A, B, C, 0.1 * rng.standard_normal((channels, channels)))


def _timed(work: Callable[[], Any], repeats: int = 3) -> tuple[float, Any]:
    best, result = np.inf, None
    for _ in range(repeats):
        start = time.perf_counter()
        result = work()
        best = min(best, time.perf_counter() - start)
    return best, result


def _against_peers(name: str, M: np.ndarray, blocks: list[Block]) -> list[dict[str, Any]]:
    mixed_s, mixed = _timed(lambda: mu_bounds(M, blocks, lower=False))
    both_s, both = _timed(lambda: mu_bounds(M, blocks))
    complex_s, complex_only = _timed(lambda: mu_bounds(M, blocks, g_scaling=False, lower=False))
    rows = [_row(f"{name}: upper and lower, largest gap", both_s, None, "", float(both.gap.max()))]
    independent: list[Block] = []
    for block in blocks:
        independent += (
            [RealBlock(f"{block.name}{i}") for i in range(block.n_w)]
            if isinstance(block, RealBlock)
            else [block]
        )
    same = len(independent) == len(blocks)
    peer = _ab13md(M, independent)
    label = "slycot AB13MD" if same else "slycot AB13MD (independent reals)"
    error = float(np.abs(mixed.upper / peer[1] - 1).max()) if peer and same else None
    rows.append(_row(f"{name}: mixed upper", mixed_s, peer[0] if peer else None, label, error))
    lmi = _dkpy(M[:2], blocks)
    error = float(np.abs(complex_only.upper[:2] / lmi[1] - 1).max()) if lmi else None
    rows.append(
        _row(
            f"{name}: complex upper",
            complex_s,
            lmi[0] * len(M) / 2 if lmi else None,
            "dkpy (2 points, scaled)",
            error,
        )
    )
    return rows


def _over_frequency(
    name: str, system: StateSpace, blocks: list[Block], omega: np.ndarray
) -> dict[str, Any]:
    """The peak, then its proof 1 % above on [0, infinity); error: 0 when proved, else 1."""

    def work() -> float:
        peak = mu_peak(system, blocks, omega, lower=False)
        return 0.0 if proved_below(system, blocks, 1.01 * peak.upper) else 1.0

    seconds, error = _timed(work, 1)
    return _row(f"{name}: peak and its proof, 24 states", seconds, None, "", error)


def _growth(blocks: list[Block], count: int) -> dict[str, Any]:
    system = _system(sum(block.n_z for block in blocks))
    M = frequency_response(system, np.geomspace(0.3, 300, count)).values
    seconds, result = _timed(lambda: mu_bounds(M, blocks), 1)
    return _row(
        f"delta I_2 + full 8x8, {count} frequencies, upper and lower",
        seconds,
        None,
        "",
        float(result.gap.max()),
    )


def _row(
    name: str, ours: float, peer: float | None, peer_name: str, error: float | None
) -> dict[str, Any]:
    return {
        "name": f"mu: {name}",
        "ours": ours,
        "peer": peer,
        "peer_name": peer_name,
        "error": error,
    }


def _ab13md(M: np.ndarray, blocks: list[Block]) -> tuple[float, np.ndarray] | None:
    """Seconds and upper bounds; None without slycot."""
    try:
        import slycot
    except ImportError:
        return None
    sizes = np.array([block.n_w for block in blocks])
    types = np.array([1 if isinstance(block, RealBlock) else 2 for block in blocks])
    return _timed(lambda: np.array([slycot.ab13md(m, sizes, types)[0] for m in M]), 1)


def _dkpy(M: np.ndarray, blocks: list[Block]) -> tuple[float, np.ndarray] | None:
    """Seconds and complex upper bounds (real blocks as repeated complex); None without dkpy."""
    try:
        import dkpy
    except ImportError:
        return None
    structure = [
        dkpy.ComplexDiagonalBlock(block.n_w)
        if isinstance(block, RealBlock) and block.n_w > 1
        else dkpy.ComplexFullBlock(block.n_w, block.n_z)
        for block in blocks
    ]
    method = dkpy.SsvLmiBisection(n_jobs=None)
    response = np.moveaxis(M, 0, -1)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return _timed(lambda: np.asarray(method.compute_ssv(response, structure)[0], float), 1)
    except Exception as error:  # a peer that fails is a row without a peer, said so
        print(f"dkpy failed: {error}")
        return None
