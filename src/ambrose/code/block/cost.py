"""Operations and memory of one step of the generated code."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ambrose.code.block.cascade import CascadeBlock
from ambrose.code.block.fixed import ControlBlock
from ambrose.code.block.scheduled import ScheduledBlock
from ambrose.code.block.supervised import SupervisedBlock

# of a signal, of a state
_BYTES = {"double": (8, 8), "float": (4, 4), "fixed32": (4, 8), "fixed16": (2, 4)}


@dataclass(frozen=True, slots=True)
class Cost:
    """Multiplications and additions of a step, ``limited`` more of each while a current is cut;
    bytes of state and tables.
    """

    multiplications: int
    additions: int
    limited: int
    state_bytes: int
    table_bytes: int


def diagonals_of(x: np.ndarray) -> list[int]:
    """The offsets (positive above) of the diagonals of x (n, n) that are not zero."""
    return [k for k in range(1 - len(x), len(x)) if np.diagonal(x, k).any()]


def padding_of(block: ControlBlock | ScheduledBlock) -> tuple[int, int]:
    """How many places before and after the states the diagonals of A - I reach; a cascade has
    none.
    """
    offsets = [] if isinstance(block, CascadeBlock) else diagonals_of(increment_of(block))
    return max(0, -min(offsets, default=0)), max(0, max(offsets, default=0))


def increment_of(block: ControlBlock | ScheduledBlock) -> np.ndarray:
    """A - I (n, n), of a schedule what is the same at every point."""
    if isinstance(block, ScheduledBlock):
        return block.changes.fixed[: block.n_states, : block.n_states]
    return block.increment


def step_cost(block: ControlBlock, arithmetic: str) -> Cost:
    """Counted as the code does it: whole diagonals of A - I, dense B, C and (where not zero) D; of
    a cascade its sections.
    """
    n = block.n_states
    m = len(block.inputs)
    p = len(block.outputs)
    w = block.winding

    # products: diagonals of A - I, B, C and D
    direct = m * p if block.D.any() else 0
    products = len(diagonals_of(block.increment)) * n + n * m + n * p + direct
    signal, state = _BYTES[arithmetic]
    floating = arithmetic in {"double", "float"}
    if isinstance(block, CascadeBlock):
        # a cascade: per state a and b, in whole numbers the factor between ranges as well; d of
        # each section; out, and into where channels are mixed
        per_state = 2 if floating else 3  # and a feedthrough of every section
        products = per_state * n + len(block.stages) + m * p + (m * m if block.mixes else 0)

    # kept between samples: what compensated sums lost, or the fractions saved
    carry = (
        w * signal
        if floating
        else (n + m * block.mixes) * state
        if isinstance(block, CascadeBlock)
        else 0
    )

    # coefficients with the unwinding, limits and transfer, then the shifts of the rows, a byte each
    tables = products + w * p + (m + p if floating else 0) + (n * (m + p) if block.transfers else 0)
    shifts = 0 if floating else n + 2 * p + (n if block.transfers else 0)
    return Cost(
        multiplications=products,
        additions=products + n + (3 * w if floating else 0),
        limited=w * p,
        state_bytes=(n + sum(padding_of(block))) * state + carry + m * (signal + 2),
        table_bytes=tables * signal + shifts,
    )


def scheduled_cost(block: ScheduledBlock, arithmetic: str) -> Cost:
    """Counted as the code does it: whole diagonals of the fixed A - I, dense B, C and D, and few
    signals for what changes.
    """
    n = block.n_states
    m = len(block.inputs)
    p = len(block.outputs)
    k = len(block.B)
    (r, q), size = block.changes.ranks, _BYTES[arithmetic][0]
    d, places = len(block.axes), sum(len(axis) for axis in block.axes)
    points = 2**d  # around a value
    fixed = len(diagonals_of(increment_of(block))) * n + n * m + n * p + m * p

    # left (n + p, r) and right (q, n + m); core (r, q) at every corner of the cell
    around = r * (n + p) + q * (n + m)
    transfer = k * n * (m + p) if block.transfers else 0
    cost = Cost(
        multiplications=fixed + around + points * q * (r + 1) + 4 * (d - 1),
        additions=fixed + around + points * q * r + 3 * n + 4 * d,
        limited=points * p * (n + 1),
        state_bytes=(2 * n + sum(padding_of(block)) + m + 2 * d) * size + 2 * (m + 3 * d),
        table_bytes=(fixed + around + k * (r * q + n * p) + places + transfer + m + p + 2 * d)
        * size,
    )
    return _with_fallback(cost, block, size) if isinstance(block, SupervisedBlock) else cost


def _with_fallback(cost: Cost, block: SupervisedBlock, size: int) -> Cost:
    """The fixed law besides, whichever of the two is led because it waits, and what is left of the
    difference.
    """
    fixed = block.fallback
    p = len(block.outputs)
    m = len(block.inputs)
    n = block.fallback.n_states
    products = len(diagonals_of(fixed.increment)) * n + n * (m + p) + m * p
    led, numbers = max(fixed.winding * p, 2 * p * (block.n_states + 1)), 12
    transfer = n * (m + p) if block.transfers else 0
    return Cost(
        multiplications=cost.multiplications + products + led + 2 * p + 2,
        additions=cost.additions + products + 3 * n + led + 6 * p + 12,
        limited=cost.limited,
        state_bytes=cost.state_bytes + (2 * n + sum(padding_of(fixed)) + p + 2) * size + 26,
        table_bytes=cost.table_bytes + (products + fixed.winding * p + transfer + numbers) * size,
    )
