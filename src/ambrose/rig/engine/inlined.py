"""What the compiled parts of the virtual rig have in common: numba's options, and the forces of
``model.effects`` made to be inlined.

This module imports numba: import it only inside functions.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable
from typing import Any

from llvmlite import ir
from numba import njit, types
from numba.extending import intrinsic

from ambrose.model.effects import (
    amplifier,
    magnet,
    seal,
    seal_rational,
    sensor,
    touchdown,
    unbalance,
)

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
