"""A frequency response from stepped sines: exact at its few lines, where the average over segments smears and leaks."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ambrose.core.checks import InvalidInput
from ambrose.core.statespace import Names
from ambrose.identification.frf.phasors import Phasors, Step, find_steps, phasors
from ambrose.identification.frf.spectral import Frf
from ambrose.machine.record.record import Record


def stepped(
    records: Record | Sequence[Record],
    inputs: Names,
    outputs: Names,
    *,
    steps: Sequence[Step] | None = None,
    settle: float = 0.3,
) -> Frf:
    """The response of ``outputs`` to ``inputs`` at the frequencies driven in every record, Y U^-1 of the phasors.

    As many records as inputs, driven in different directions. steps: the schedule of all records (None: found in each).
    settle [s]: left out of each step. Coherence: the part of a signal's power that repeats from block to block. Variance:
    from the blocks' scatter. Raises InvalidInput.
    """
    records = (records,) if isinstance(records, Record) else tuple(records)
    u, y = (tuple([names] if isinstance(names, str) else names) for names in (inputs, outputs))
    if len(records) != len(u) or not y:
        raise InvalidInput(f"{len(u)} inputs need as many records, driven in different directions; there are {len(records)}")
    plans = [find_steps(record) if steps is None else tuple(steps) for record in records]
    common = [s for s in plans[0] if all(_same(plan, s.frequency) for plan in plans)]
    if not common:
        raise InvalidInput("the records have no frequency in common; use one schedule")
    parts = []
    for step in common:
        own = [_same(plan, step.frequency) for plan in plans]
        driven = [phasors(r, s, (*u, *y), settle) for r, s in zip(records, own, strict=True) if s is not None]
        parts.append(_line(step.frequency, driven, len(u)))
    values, variance, coherence, freedom = (np.array(part) for part in zip(*parts, strict=True))
    omega = np.array([step.frequency for step in common])
    m = len(u)
    return Frf(values, omega, u, y, variance, coherence[:, m:], coherence[:, :m], float(freedom.min()), records[0].dt)


def _same(plan: Sequence[Step], frequency: float) -> Step | None:
    return next((s for s in plan if abs(s.frequency - frequency) <= 1e-3 * frequency), None)


def _line(frequency: float, driven: Sequence[Phasors], m: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
    """Values, variance (p, m), coherence (m + p,) and degrees of freedom at one frequency."""
    mean = np.stack([item.mean for item in driven], axis=1)
    if np.linalg.cond(mean[:m]) > 1e6:
        raise InvalidInput(
            f"at {frequency / 2 / np.pi:g} Hz the records drive the inputs alike; drive each in a record of its own"
        )
    count = min(len(item.blocks) for item in driven)
    blocks = np.stack([item.blocks[:count].T for item in driven], axis=2)  # (s, b, m)
    single = np.moveaxis(blocks, 1, 0)
    each = single[:, m:] @ np.linalg.inv(single[:, :m])
    variance = np.mean(np.abs(each - each.mean(axis=0)) ** 2, axis=0) / (count - 1)
    power = np.mean(np.abs(blocks) ** 2, axis=(1, 2))
    steady = np.mean(np.abs(blocks.mean(axis=1)) ** 2, axis=1)
    coherence = np.where(power > 0, steady / np.where(power > 0, power, 1.0), 0.0)
    return mean[m:] @ np.linalg.inv(mean[:m]), variance, coherence, count - 1.0
