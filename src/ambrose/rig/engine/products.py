"""Products of a matrix and a vector in the compiled rig: eight rows at once, in vector registers.

The compiler's own loops over a few rows and columns spend more on finding out how many there are
than on the sums. A matrix is kept in blocks of eight rows, (rows/8, columns, 8) with rows filled up
by zeros, its columns a multiple of four (``in_blocks``); four sums run side by side, column j in
the sum j mod 4.

This module imports numba in ``products`` only.
"""

import inspect
import os
import shutil
import stat
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from llvmlite import ir
from numba import njit, types
from numba.core import config
from numba.extending import intrinsic

from ambrose.core.checks import InvalidInput
from ambrose.machine.ordinary_file import claimed
from ambrose.model.effects import (
    amplifier,
    magnet,
    rotor,
    seal,
    seal_rational,
    sensor,
    stations as unbalance,
    touchdown,
)

# Where the compiled rig is kept between runs.
#
# Numba keeps it beside the source, else in the user's cache folder (NUMBA_CACHE_DIR, XDG_CACHE_HOME
# or the system's own). A service on a read-only image may have neither: then in a private folder of
# the temporary ones, which lasts until the system clears it.
#
# This module imports numba: import it only inside functions.


_ROOM = 16 << 20  # bytes free where compiled code is kept, or it is compiled anew in every run
_POLL, _PATIENCE = 0.1, 3000  # [s] between two looks at a lock, and how many of them
_HELD = "another process compiles it"


def compile_kept(functions: tuple[Callable[..., Any], ...], **options: Any) -> tuple[Any, ...]:
    """The functions as numba compiles them, kept on disk where there is a place with room."""
    for place in (None, private_folder):
        with suppress(RuntimeError, OSError), _kept_in(place):  # no folder to write to
            kept = tuple(njit(cache=True, **options)(function) for function in functions)
            if shutil.disk_usage(kept[0].stats.cache_path).free > _ROOM:
                for function in kept:
                    function.compile = _one_at_a_time(function)
                return kept
    return tuple(njit(**options)(function) for function in functions)


def _one_at_a_time(function: Any) -> Callable[[Any], Any]:
    """``function.compile`` for one process at a time: the next one finds it kept. Of what several
    that began together wrote into one index, only the last was left.
    """
    compile_it, place = function.compile, Path(function.stats.cache_path, "compiled")

    def compile_alone(signature: Any) -> Any:
        with ExitStack() as stack:
            for _ in range(_PATIENCE):
                try:
                    stack.enter_context(claimed(place, "compiled rig", _HELD))
                    break
                except InvalidInput as error:
                    if str(error) != _HELD:  # no place for a lock
                        break
                    time.sleep(_POLL)
            return compile_it(signature)

    return compile_alone


def is_kept(function: Any) -> bool:
    """Whether a compiled function of ``compile_kept`` has been kept by an earlier run."""
    path = function.stats.cache_path
    return path is not None and any(Path(path).glob(f"*.{function.py_func.__name__}-*.nbi"))


def private_folder() -> str:
    """A folder of this user alone among the temporary ones. Raises OSError where that name is
    another user's, or others may write there: what is loaded from it runs.
    """
    user = os.getuid() if hasattr(os, "getuid") else 0
    folder = Path(tempfile.gettempdir()) / f"ambrose-compiled-{user}"
    with suppress(FileExistsError):
        folder.mkdir(mode=0o700)
    found = folder.lstat()
    if not stat.S_ISDIR(found.st_mode) or found.st_uid != user or found.st_mode & 0o022:
        raise PermissionError(f"{folder} is not this user's alone")
    return str(folder)


@contextmanager
def _kept_in(place: Callable[[], str] | None) -> Iterator[None]:
    """Numba's cache in another folder; None: where numba has it."""
    settings: Any = config
    before = settings.CACHE_DIR
    try:
        if place is not None:
            settings.CACHE_DIR = place()
        yield
    finally:
        settings.CACHE_DIR = before


# What the compiled parts of the virtual rig have in common: numba's options, and the forces of
# ``model.effects`` made to be inlined.
#
# This module imports numba: import it only inside functions.


# Sums may be vectorised, but NaN and infinity stay what they are; nothing here allocates an array,
# so none is counted. Stages that were called instead of inlined would copy the descriptions of some
# forty arrays every time: ten times slower.
OPTIONS: dict[str, Any] = {
    "fastmath": {"reassoc", "contract", "nsz", "arcp"},
    "error_model": "numpy",
    "_nrt": False,
}


# never called by Python
_INNER: dict[str, Any] = {"forceinline": True, "no_cpython_wrapper": True, "no_cfunc_wrapper": True}


def compiled(function: Callable[..., Any]) -> Any:
    return njit(**_INNER, **OPTIONS)(inspect.unwrap(function))


def merged(function: Callable[..., Any]) -> Any:
    """A stage that becomes part of its caller before types are inferred: what is compiled on its
    own is optimised on its own, and once more in every caller.
    """
    return njit(inline="always", **OPTIONS)(function)


magnet_force = compiled(magnet.force)
amplifier_derivative = compiled(amplifier.derivative)
stops = compiled(amplifier.stops)
coil_current = compiled(amplifier.coil_current)
effective_current = compiled(amplifier.effective_current)
contact_force = compiled(touchdown.force)
element_forces = compiled(touchdown.elements)
mount_force = compiled(touchdown.mount)
race_drag = compiled(touchdown.race_drag)
seal_force = compiled(seal.force)
state_force = compiled(seal_rational.force)
seal_lag = compiled(seal_rational.lag)
turning_force = compiled(unbalance.force)
rotating_force = compiled(rotor.rotating_force)
runout = compiled(sensor.runout)
indicated = compiled(sensor.indicated)
lag = compiled(sensor.lag)
converted = compiled(sensor.sampled)


@intrinsic
def _call(context: Any, address: Any, first: Any, errors: Any, told: Any, currents: Any) -> Any:
    """int f(void *, const double *, const double *, double *) at an address; the pointers are
    integers, too.
    """

    def generate(context: Any, builder: Any, signature: Any, given: Any) -> Any:
        byte = ir.IntType(8).as_pointer()
        kind = ir.FunctionType(ir.IntType(32), [byte] * 4)
        pointers = [builder.inttoptr(item, byte) for item in given[1:]]
        return builder.call(builder.inttoptr(given[0], kind.as_pointer()), pointers)

    whole = types.int64
    return types.int32(*[whole] * 5), generate


by_address: Any = _call  # whose first argument, the compiler's context, is numba's own


@njit(inline="always")
def coordinates(rig: Any) -> int:
    """How many displacements the state has: of the rotor's modes in both planes and of the
    supports.
    """
    return 2 * rig.stiffness.shape[0] + rig.support.shape[0]


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
    from numba.core import cgutils as untyped, types

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
