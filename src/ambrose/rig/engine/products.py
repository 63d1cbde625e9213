"""Products of a matrix and a vector in the compiled rig: eight rows at once, in vector registers.

The compiler's own loops over a few rows and columns spend more on finding out how many there are
than on the sums. A matrix is kept in blocks of eight rows, (rows/8, columns, 8) with rows filled up
by zeros, its columns a multiple of four (``in_blocks``); four sums run side by side, column j in
the sum j mod 4.

This module imports numba in ``products`` only.
"""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np

ROWS = 8  # of a block
COLUMNS = 4  # side by side
_FLAGS = ("contract", "reassoc", "nsz")


def filled(count: int, whole: int) -> int:
    """The next multiple of ``whole``."""
    return count + -count % whole


def in_blocks(matrix: np.ndarray) -> np.ndarray:
    """(rows, columns) as (rows/8, columns, 8), filled up by zeros to whole blocks of rows and whole
    fours of columns.
    """
    rows, columns = matrix.shape
    whole = np.pad(matrix, ((0, -rows % ROWS), (0, -columns % COLUMNS)))
    blocks = whole.reshape(-1, ROWS, whole.shape[1]).transpose(0, 2, 1)
    # from a line of the processor's memory on: a register is then one line
    kept = np.empty(blocks.size + ROWS)
    first = -(kept.ctypes.data // 8) % ROWS
    result: np.ndarray = kept[first : first + blocks.size].reshape(blocks.shape)
    result[:] = blocks
    return result


@cache
def products() -> tuple[Any, Any]:
    """For compiled functions: ``fill(matrix, by, result)``, result = matrix by, and ``add(matrix,
    by, start, first, result)``, result = start[first:] + matrix by; result as long as the blocks
    have rows, and start from first on.
    """
    from numba import types
    from numba.extending import intrinsic

    @intrinsic
    def fill(context: Any, matrix: Any, by: Any, result: Any) -> Any:
        return types.void(matrix, by, result), _generate

    @intrinsic
    def add(context: Any, matrix: Any, by: Any, start: Any, first: Any, result: Any) -> Any:
        return types.void(matrix, by, start, types.int64, result), _generate

    return fill, add


def _generate(context: Any, builder: Any, signature: Any, given: Any) -> Any:
    """The loops over blocks and fours of columns."""
    from llvmlite import ir
    from numba.core import cgutils as untyped
    from numba.core import types

    cgutils: Any = untyped

    def array(i: int) -> Any:
        return context.make_array(signature.args[i])(context, builder, given[i])

    def vector(data: Any, at: Any) -> Any:
        return builder.bitcast(builder.gep(data, [at]), wide.as_pointer())

    def spread(number: Any) -> Any:
        """A vector of one number."""
        none = ir.Constant(wide, ir.Undefined)
        first = builder.insert_element(none, number, ir.Constant(ir.IntType(32), 0))
        lanes = ir.Constant(ir.VectorType(ir.IntType(32), ROWS), [0] * ROWS)
        return builder.shuffle_vector(first, none, lanes)

    whole = ir.IntType(64)
    wide = ir.VectorType(ir.DoubleType(), ROWS)
    rows, four = ir.Constant(whole, ROWS), ir.Constant(whole, COLUMNS)
    matrix, by = array(0), array(1)
    result = array(len(given) - 1)
    blocks, columns = cgutils.unpack_tuple(builder, matrix.shape)[:2]
    sums = [cgutils.alloca_once(builder, wide) for _ in range(COLUMNS)]
    with cgutils.for_range(builder, blocks) as block:
        at = builder.mul(block.index, rows)
        for one in sums:
            builder.store(ir.Constant(wide, [0.0] * ROWS), one)
        if len(given) > 3:
            first = context.cast(builder, given[3], signature.args[3], types.int64)
            begin = vector(array(2).data, builder.add(at, first))
            builder.store(builder.load(begin, align=8), sums[0])
        before = builder.mul(block.index, columns)
        with cgutils.for_range(builder, builder.sdiv(columns, four)) as part:
            for i, one in enumerate(sums):
                j = builder.add(builder.mul(part.index, four), ir.Constant(whole, i))
                factor = spread(builder.load(builder.gep(by.data, [j])))
                column = vector(matrix.data, builder.mul(builder.add(before, j), rows))
                product = builder.fmul(builder.load(column, align=8), factor, flags=_FLAGS)
                builder.store(builder.fadd(builder.load(one), product, flags=_FLAGS), one)
        # (s_0 + s_1) + (s_2 + s_3)
        parts = [builder.load(one) for one in sums]
        pairs = [builder.fadd(*parts[i : i + 2], flags=_FLAGS) for i in (0, 2)]
        total = builder.fadd(*pairs, flags=_FLAGS)
        builder.store(total, vector(result.data, at), align=8)
    return context.get_dummy_value()
