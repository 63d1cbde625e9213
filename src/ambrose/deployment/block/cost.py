"""Operations and memory of one step of the generated code."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ambrose.deployment.block.fixed import ControlBlock, transfers

_BYTES = {"double": (8, 8), "float": (4, 4), "fixed32": (4, 8), "fixed16": (2, 4)}  # of a signal, of a state


@dataclass(frozen=True, slots=True)
class Cost:
    """Multiplications and additions of a step, ``limited`` more of each while a current is cut; bytes of state and tables."""

    multiplications: int
    additions: int
    limited: int
    state_bytes: int
    table_bytes: int


def diagonals_of(x: np.ndarray) -> list[tuple[int, int]]:
    """The non-zero diagonals of x (n, n): offset (positive above) and how many entries are not zero."""
    n = len(x)
    counts = [(k, int(np.count_nonzero(np.diagonal(x, k)))) for k in range(1 - n, n)]
    return [(k, count) for k, count in counts if count]


def step_cost(block: ControlBlock, arithmetic: str) -> Cost:
    """Counted as the code does it: whole diagonals of A - I, dense B, C and (where not zero) D."""
    n, m, p, w = block.n_states, len(block.inputs), len(block.outputs), block.winding
    diagonals = diagonals_of(block.increment)
    direct = m * p if block.D.any() else 0
    products = len(diagonals) * n + n * m + n * p + direct
    signal, state = _BYTES[arithmetic]
    floating = arithmetic in {"double", "float"}
    padding = max(0, -diagonals[0][0]) + max(0, diagonals[-1][0]) if diagonals else 0
    carry = w * signal if floating else 0
    tables = products + w * p + (m + p if floating else 0) + (n * (m + p) if transfers(block) else 0)
    shifts = 0 if floating else n + 2 * p + (n if transfers(block) else 0)
    return Cost(
        multiplications=products,
        additions=products + n + (3 * w if floating else 0),
        limited=w * p,
        state_bytes=(n + padding) * state + carry + m * (signal + 2),
        table_bytes=tables * signal + shifts,
    )


def flop_floor(block: ControlBlock) -> int:
    """Multiplications and additions of the non-zero coefficients alone: what no arrangement of this realisation can avoid."""
    parts = (block.increment, block.B, block.C, block.D)
    return 2 * sum(int(np.count_nonzero(part)) for part in parts)
