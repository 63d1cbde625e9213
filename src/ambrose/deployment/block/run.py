"""The block's behaviour in Python, sample by sample: the generated code is compared with it, test vectors come from it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ambrose.core.checks import InvalidInput, check_shape
from ambrose.deployment.block.fixed import ControlBlock
from ambrose.deployment.block.fixed_point import FixedBlock

HELD, FAULT, LIMITED = 1, 2, 4  # status bits, as in the header
FLOOR = {"double": 1e-200, "float": 1e-30}  # a state below it is zero: no denormal numbers linger


@dataclass(frozen=True, slots=True, eq=False)
class BlockRun:
    """currents (k, p) [A] (whole numbers for fixed point), status (k,) the states after the last sample (n,) and
    the largest magnitude of each on the way (n,)."""

    currents: np.ndarray
    status: np.ndarray
    states: np.ndarray
    largest: np.ndarray


def run_block(
    block: ControlBlock, errors: ArrayLike, valid: ArrayLike | None = None, start: ArrayLike | None = None
) -> BlockRun:
    """Double precision. errors (k, m) [m]: NaN and infinity allowed; valid (k, m): the channels' flags (None: all true);
    start (n,): the states before the first sample (None: zero). Raises InvalidInput."""
    e, good = _inputs(errors, valid, block)
    with np.errstate(invalid="ignore"):
        good &= np.abs(e) <= block.error_limit
    e, status = held(e, good, block.hold_samples)
    x = np.zeros(block.n_states) if start is None else np.array(start, dtype=float)
    carry, largest = np.zeros_like(x), np.abs(x)
    w = block.winding
    direct, driven = e @ block.D.T, e @ block.B.T
    currents = np.empty(direct.shape)
    limit, floor = block.current_limit, FLOOR["double"]
    for k in range(len(e)):
        u = direct[k] + block.C @ x
        cut = np.minimum(np.maximum(u, -limit), limit)
        currents[k] = cut
        d = block.increment @ x + driven[k]
        if (cut != u).any():
            status[k] |= LIMITED
            d += block.unwind @ (cut - u)
        d[:w] += carry[:w]
        new = x + d
        carry[:w] = d[:w] - (new[:w] - x[:w])  # what the sum lost (Kahan 1965)
        new[np.abs(new) < floor] = 0.0
        x = new
        largest = np.maximum(largest, np.abs(x))
    return BlockRun(currents, status, x, largest)


def run_fixed(fixed: FixedBlock, errors: ArrayLike, valid: ArrayLike | None = None) -> BlockRun:
    """Fixed point, bit by bit. errors (k, m): whole numbers of 2^-signal_bits error_limit; currents likewise."""
    block, s = fixed.block, fixed.signal_bits
    given, good = _inputs(errors, valid, block)
    e = given.astype(np.int64)
    one = 1 << s
    good &= (e >= -one) & (e <= one)
    e, status = held(e, good, block.hold_samples)
    n = block.n_states
    X, largest = np.zeros(n, np.int64), np.zeros(n, np.int64)
    edge = 1 << fixed.state_bits
    currents = np.empty((len(e), len(block.outputs)), np.int64)
    driven, direct = e @ fixed.update[:, n:].T, e @ fixed.output[:, n:].T
    A, C = fixed.update[:, :n], fixed.output[:, :n]
    to_signal, to_output, to_cut = _half(fixed.state_bits - s, n), _half(fixed.output_bits), _half(fixed.cut_bits)
    to_state, to_unwinding = (_half(bits + s - fixed.state_bits) for bits in (fixed.update_bits, fixed.unwind_bits))
    for k in range(len(e)):
        x = _shift(X, *to_signal)
        u = _shift(direct[k] + C @ x, *to_output)
        cut = np.minimum(np.maximum(u, -one), one)
        currents[k] = cut
        step = _shift(driven[k] + A @ x, *to_state)
        if (cut != u).any():
            status[k] |= LIMITED
            step = step + _shift(fixed.unwind @ _shift(cut - u, *to_cut), *to_unwinding)
        X = np.minimum(np.maximum(X + step, -edge), edge)
        largest = np.maximum(largest, np.abs(X))
    return BlockRun(currents, status, X, largest)


def _half(bits: int | np.ndarray, count: int | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Shifts as an array, and half a unit of each."""
    shifts = np.full(count, bits, np.int64) if count is not None else np.asarray(bits, np.int64)
    return shifts, np.where(shifts > 0, np.int64(1) << np.maximum(shifts - 1, 0), 0)


def _shift(value: np.ndarray, bits: np.ndarray, half: np.ndarray) -> np.ndarray:
    """value / 2^bits, rounded to nearest, halves away from zero."""
    return np.sign(value) * ((np.abs(value) + half) >> bits)


def _inputs(errors: ArrayLike, valid: ArrayLike | None, block: ControlBlock) -> tuple[np.ndarray, np.ndarray]:
    e = np.asarray(errors)
    if e.ndim != 2 or e.shape[1] != len(block.inputs):
        raise InvalidInput(f"the shape of errors is {e.shape}, but must be (k, {len(block.inputs)}); give one column per axis")
    if valid is None:
        return e, np.ones(e.shape, bool)
    return e, check_shape(valid, "valid", "(k, m)", k=len(e), m=e.shape[1]) != 0


def held(e: np.ndarray, good: np.ndarray, hold: int) -> tuple[np.ndarray, np.ndarray]:
    """Bad samples replaced by the channel's last good one (zero before the first), and the status (k,) without limiting."""
    row = np.arange(len(e))[:, None]
    last = np.maximum.accumulate(np.where(good, row, -1), axis=0)
    filled = np.where(last >= 0, np.take_along_axis(e, np.maximum(last, 0), axis=0), 0)
    missing = row - last  # before the first good sample counted from the start
    status = np.where((~good).any(axis=1), HELD, 0) | np.where((missing > hold).any(axis=1), FAULT, 0)
    return filled, status
