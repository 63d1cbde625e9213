"""Products in blocks against numpy's, in compiled code."""

from __future__ import annotations

import numpy as np
import pytest
from numba import njit

from ambrose.rig.engine.products import COLUMNS, ROWS, filled, in_blocks, products

FILL, ADD = products()


@njit
def both(matrix, by, start, first, result, sum_):
    FILL(matrix, by, result)
    ADD(matrix, by, start, first, sum_)


@pytest.mark.parametrize(("rows", "columns"), [(1, 1), (8, 4), (24, 12), (29, 33)])
def test_blocks_multiply_as_the_matrix_does(rows, columns):
    rng = np.random.default_rng(rows)
    matrix, by = rng.normal(size=(rows, columns)), rng.normal(size=columns)
    given = np.zeros(filled(columns, COLUMNS))
    given[:columns] = by
    start = rng.normal(size=filled(rows, ROWS) + 3)
    result, total = np.full(filled(rows, ROWS), np.nan), np.full(filled(rows, ROWS), np.nan)
    blocks = in_blocks(matrix)
    assert blocks.shape == (filled(rows, ROWS) // ROWS, filled(columns, COLUMNS), ROWS)
    both(blocks, given, start, 3, result, total)
    # every sum is rounded once a column at most
    bound = columns * np.finfo(float).eps * (np.abs(matrix) @ np.abs(by))
    assert (np.abs(result[:rows] - matrix @ by) <= bound).all()
    assert not result[rows:].any()
    rounding = np.finfo(float).eps * np.abs(start[3:]).max()
    assert (np.abs(total - start[3:] - result) <= 2 * (bound.max() + rounding)).all()
