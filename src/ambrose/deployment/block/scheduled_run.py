"""The scheduled block's behaviour in Python, sample by sample: the generated code is compared with it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ambrose.core.checks import InvalidInput, check_shape
from ambrose.deployment.block.run import FAULT, FLOOR, HELD, LIMITED, held
from ambrose.deployment.block.scheduled import ScheduledBlock

CLAMPED, SPEED, BEHIND = 8, 16, 32  # status bits, as in the header, besides those of every block


@dataclass(frozen=True, slots=True, eq=False)
class ScheduledRun:
    """currents (k, p) [A], status (k,), schedule (k,) [rad/s]: where the law was taken, the states after the last sample (n,)
    and the largest magnitude of each on the way (n,)."""

    currents: np.ndarray
    status: np.ndarray
    schedule: np.ndarray
    states: np.ndarray
    largest: np.ndarray


def run_scheduled(
    block: ScheduledBlock,
    errors: ArrayLike,
    speeds: ArrayLike,
    valid: ArrayLike | None = None,
    start: ArrayLike | None = None,
    single: bool = False,
) -> ScheduledRun:
    """errors (k, m) [m] and speeds (k,) [rad/s]: NaN and infinity allowed; valid (k, m): the errors' flags (None: all true);
    start (n,): the states before the first sample (None: zero). single: computed in single precision. Raises InvalidInput."""
    e, status = _errors(block, errors, valid)
    kind = np.float32 if single else np.float64
    schedule, moved = followed(block, _speeds(speeds, len(e)))
    status |= moved
    i, share = places(block.grid, schedule)
    n = block.n_states
    x = np.zeros(n, kind) if start is None else np.array(start, dtype=kind)
    carry, largest = np.zeros_like(x), np.abs(x)
    to_state = np.concatenate([block.increment, block.B], axis=2).astype(kind)
    to_current = np.concatenate([block.C, block.D], axis=2).astype(kind)
    unwind, limit = block.unwind.astype(kind), np.asarray(block.current_limit, kind)
    lowest = np.negative(limit)
    e, share = e.astype(kind), share.astype(kind)
    currents = np.empty((len(e), len(block.outputs)), kind)
    floor = FLOOR["float" if single else "double"]
    for k in range(len(e)):
        z = np.concatenate([x, e[k]])
        low, high, a = (1 - share[k]) * z, share[k] * z, i[k]
        u = to_current[a] @ low + to_current[a + 1] @ high
        cut = np.minimum(np.maximum(u, lowest), limit)
        currents[k] = cut
        d = to_state[a] @ low + to_state[a + 1] @ high
        if (cut != u).any():
            status[k] |= LIMITED
            d += unwind[a] @ ((1 - share[k]) * (cut - u)) + unwind[a + 1] @ (share[k] * (cut - u))
        d += carry
        new = x + d
        carry = d - (new - x)  # what the sum lost (Kahan 1965)
        new[np.abs(new) < floor] = 0.0
        x = new
        largest = np.maximum(largest, np.abs(x))
    return ScheduledRun(currents.astype(float), status, schedule, x.astype(float), largest.astype(float))


def followed(block: ScheduledBlock, speeds: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Where the schedule stands (k,) [rad/s] for speeds (k,) as measured, and the status (k,) of the speed alone."""
    low, high = block.range
    with np.errstate(invalid="ignore"):
        good = np.abs(speeds) <= block.speed_limit
    known, status = held(speeds[:, None], good[:, None], block.hold_samples)
    status = np.where(good, 0, status | SPEED)
    first = int(np.argmax(good)) if good.any() else len(good)
    known = known[:, 0].astype(float)
    known[:first] = low  # nothing is known of the speed yet
    target = np.clip(known, low, high)
    status |= np.where(known != target, CLAMPED, 0)
    if not np.isfinite(block.speed_step):
        return target, status
    place, step, at = np.empty(len(target)), block.speed_step, low
    for k, wanted in enumerate(target.tolist()):
        if k > first and abs(wanted - at) > step:
            at += step if wanted > at else -step
            status[k] |= BEHIND
        else:
            at = wanted
        place[k] = at
    return place, status


def places(grid: np.ndarray, schedule: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The grid point (k,) below the schedule (k,), and the share (k,) of the next one."""
    i = np.clip(np.searchsorted(grid, schedule, side="right") - 1, 0, len(grid) - 2)
    return i, (schedule - grid[i]) / (grid[i + 1] - grid[i])


def _errors(block: ScheduledBlock, errors: ArrayLike, valid: ArrayLike | None) -> tuple[np.ndarray, np.ndarray]:
    e = np.asarray(errors, dtype=float)
    if e.ndim != 2 or e.shape[1] != len(block.inputs):
        raise InvalidInput(f"the shape of errors is {e.shape}, but must be (k, {len(block.inputs)}); give one column per axis")
    with np.errstate(invalid="ignore"):
        good = np.abs(e) <= block.error_limit
    if valid is not None:
        good &= check_shape(valid, "valid", "(k, m)", k=len(e), m=e.shape[1]) != 0
    return held(e, good, block.hold_samples)


def _speeds(speeds: ArrayLike, count: int) -> np.ndarray:
    v = np.asarray(speeds, dtype=float)
    if v.shape != (count,):
        raise InvalidInput(f"the shape of speeds is {v.shape}, but must be ({count},), one for every sample")
    return v


__all__ = ["BEHIND", "CLAMPED", "FAULT", "HELD", "LIMITED", "SPEED", "ScheduledRun", "followed", "places", "run_scheduled"]
