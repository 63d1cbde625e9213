"""What changes over a grid, as few signals: against matrices whose rank is known, and a controller
of a machine.
"""

from __future__ import annotations

import numpy as np
import pytest

from ambrose.code.block.scheduled import beside_blocks, changes_of
from schedule_driver import block_of, gain_schedule, small_schedule

RNG = np.random.default_rng(3)


def tables(rank: int, spread: float = 0.0) -> np.ndarray:
    """Five matrices (9, 8) around one whose rows and columns differ by powers of ten up to
    ``spread``.
    """
    rows, columns = 10 ** RNG.uniform(-spread, spread, 9), 10 ** RNG.uniform(-spread, spread, 8)
    left, right = RNG.normal(0, 1, (9, rank)), RNG.normal(0, 1, (rank, 8))
    core = RNG.normal(0, 1, (5, rank, rank))
    return (RNG.normal(0, 1, (9, 8)) + left @ core @ right) * rows[:, None] * columns


@pytest.mark.parametrize("spread", [0.0, 4.0])
@pytest.mark.parametrize("rank", [0, 1, 3, 8])
def test_the_rank_is_found_and_the_tables_come_back(rank, spread):
    whole = tables(rank, spread)
    found = changes_of(whole, np.zeros((9, 8)))
    assert found.ranks == (rank, rank)
    size = np.abs(whole).max(axis=0)
    assert (np.abs(found.tables() - whole).max(axis=0) <= 1e-11 * size.max(axis=1)[:, None]).all()


def test_rounding_is_no_change():
    whole = tables(2)
    noisy = whole * (1 + 1e-15 * RNG.normal(0, 1, whole.shape))
    assert changes_of(noisy, np.zeros((9, 8))).ranks == (2, 2)


def test_entries_beside_the_blocks_are_dropped_only_where_they_are_rounding():
    blocks = np.zeros((3, 4, 4))
    blocks[:, :2, :2], blocks[:, 2:, 2:] = 1.0, 2.0
    noise = np.zeros((4, 4))
    noise[0, 3] = 1e-14
    np.testing.assert_array_equal(beside_blocks(blocks + noise, (2, 2)), noise)
    noise[0, 3] = 1e-6
    np.testing.assert_array_equal(beside_blocks(blocks + noise, (2, 2)), 0.0)


def test_a_block_is_what_its_changes_say():
    for make in (small_schedule, gain_schedule):
        block = block_of(make())
        n = block.n_states
        whole = block.changes.tables()
        np.testing.assert_array_equal(whole[:, :n, :n], block.increment)
        np.testing.assert_array_equal(whole[:, n:, n:], block.D)
        assert np.count_nonzero(block.changes.fixed[:n, :n]) <= 5  # a real pole and a pair
