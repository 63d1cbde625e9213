"""Mixed mu below a level at every frequency: the interval proof up to a high frequency, and a norm bound for the rest."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ambrose.core.lft import Block
from ambrose.core.mu.bounds import mu_bounds, mu_certificate
from ambrose.core.realisation.balancing import balance_system
from ambrose.core.statespace import StateSpace

_TAILS = (1e2, 1e4, 1e6, 1e8)  # start of the rest, in norms of A


def proved_below(loop: StateSpace, blocks: Sequence[Block], level: float, max_pieces: int = 100) -> bool:
    """Whether mu(M(j omega)) < level was proved for all frequencies, infinity included.

    loop: M, continuous and stable. Above a frequency W the constant scalings of M(infinity) = D suffice:
    sigma_max(D_z M D_w^-1) <= sigma_max(D_z D D_w^-1) + |D_z C| |B D_w^-1| / (W - |A|). Below, core's mu_certificate.
    """
    if mu_certificate(loop, blocks, level, (0.0, np.inf), max_pieces=max_pieces).proved:
        return True
    A, B, C, _ = balance_system(loop.A, loop.B, loop.C)
    size = float(np.linalg.norm(A, 2)) if len(A) else 1.0
    floor = 1e-6 * max(level, float(np.linalg.norm(loop.D, 2)))
    # a little of everything everywhere: scalings that are optimal for D alone may be as large as they like
    rng = np.random.default_rng(0)
    bound = mu_bounds(loop.D + floor * rng.uniform(0.5, 1.0, loop.D.shape), blocks, g_scaling=False, lower=False)
    D_z, D_w = bound.D_z, np.linalg.inv(bound.D_w)
    rest = float(np.linalg.norm(D_z @ loop.D @ D_w, 2))
    into, out = float(np.linalg.norm(B @ D_w, 2)), float(np.linalg.norm(D_z @ C, 2))
    for factor in _TAILS:
        start = factor * size
        if rest + into * out / (start - size) < level:
            return mu_certificate(loop, blocks, level, (0.0, start), max_pieces=max_pieces).proved
    return False
