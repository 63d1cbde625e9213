"""A frequency response from stepped sines: exact at its few lines, where the average over segments
smears and leaks.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ambrose.core.checks import InvalidInput
from ambrose.core.statespace import Names
from ambrose.identification.frf.phasors import Phasors, Step, find_steps, phasors
from ambrose.identification.frf.spectral import Frf
from ambrose.record.record import Record

_APART = 1e-6  # least over largest singular value of the inputs at a frequency
# shares of power: what is no sine within the steps, and what lies within them (not their ends)
_BESIDE, _MOST = 2e-3, 0.6


def stepped(
    records: Record | Sequence[Record],
    inputs: Names,
    outputs: Names,
    *,
    steps: Sequence[Step] | None = None,
    settle: float = 0.3,
) -> Frf:
    """The response of ``outputs`` to ``inputs``, Y U^-1 of phasors, at the frequencies driven in as
    many ways as inputs.

    The ways may be steps of one record, or of several, driven in different directions; more of them
    are fitted by least squares. steps: the schedule of all records (None: found in each). settle
    [s]: left out of each step. Coherence: the part of a signal's power that repeats from block to
    block. Variance: from the blocks' scatter. Raises InvalidInput.
    """
    records = (records,) if isinstance(records, Record) else tuple(records)
    u, y = (tuple([names] if isinstance(names, str) else names) for names in (inputs, outputs))
    if not records or not u or not y:
        raise InvalidInput("a frequency response needs a record, an input and an output; name them")
    plans = [find_steps(record) if steps is None else tuple(steps) for record in records]
    groups: list[list[tuple[Record, Step]]] = []
    for record, plan in zip(records, plans, strict=True):
        for step in plan:
            same_step = next(
                (
                    g
                    for g in groups
                    if abs(g[0][1].frequency - step.frequency) <= 1e-3 * step.frequency
                ),
                None,
            )
            if same_step is None:
                groups.append(same_step := [])
            same_step.append((record, step))
    enough = sorted((g for g in groups if len(g) >= len(u)), key=lambda g: g[0][1].frequency)
    if not enough:
        raise InvalidInput(
            f"no frequency was driven in as many ways as there are inputs, {len(u)}: drive every "
            "input by one schedule of "
            "frequencies, one after the other or in records of their own"
        )
    parts = []
    for group in enough:
        driven = [phasors(record, step, (*u, *y), settle) for record, step in group]
        parts.append(_line(group[0][1].frequency, driven, len(u)))
    values, variance, coherence, freedom = (np.array(part) for part in zip(*parts, strict=True))
    omega, m = np.array([group[0][1].frequency for group in enough]), len(u)
    return Frf(
        values,
        omega,
        u,
        y,
        variance,
        coherence[:, m:],
        coherence[:, :m],
        float(freedom.min()),
        records[0].dt,
    )


def is_stepped(record: Record, excitations: Sequence[str]) -> bool:
    """Whether the excitations of a record are steady sines and hardly anything else."""
    try:
        steps = find_steps(record)
    except InvalidInput:
        return False
    waves = np.stack([record[name] for name in excitations if name in record.signals])
    inside = beside = 0.0
    for step in steps:
        first, last = (
            round((time - record.start_time) / record.dt) for time in (step.start, step.stop)
        )
        part = waves[:, first:last]

        # power of the steps, and what a sine leaves of it
        angle = step.frequency * np.arange(part.shape[1]) * record.dt
        X = np.stack([np.cos(angle), np.sin(angle)]).T
        left = part.T - X @ np.linalg.lstsq(X, part.T, rcond=None)[0]
        inside, beside = inside + float((part**2).sum()), beside + float((left**2).sum())
    return beside <= _BESIDE * inside and inside >= _MOST * float((waves**2).sum())


def _line(
    frequency: float, driven: Sequence[Phasors], m: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
    """Values, variance (p, m), coherence (m + p,) and degrees of freedom at one frequency."""
    # phasors (signals, ways): the first m are the inputs
    mean = np.stack([item.mean for item in driven], axis=1)
    if np.linalg.svd(mean[:m], compute_uv=False)[m - 1] <= _APART * np.linalg.norm(mean[:m], 2):
        raise InvalidInput(
            f"at {frequency / 2 / np.pi:g} Hz the records drive the inputs alike; drive each in a "
            "record of its own"
        )
    count = min(len(item.blocks) for item in driven)
    blocks = np.stack([item.blocks[:count].T for item in driven], axis=2)  # (s, b, ways)

    # Y U^-1 of each block alone; variance of the mean of b: sum |.|^2/(b (b - 1))
    single = np.moveaxis(blocks, 1, 0)
    each = single[:, m:] @ np.linalg.pinv(single[:, :m])
    variance = np.mean(np.abs(each - each.mean(axis=0)) ** 2, axis=0) / (count - 1)

    # |mean over the blocks|^2 over the mean of |.|^2
    power = np.mean(np.abs(blocks) ** 2, axis=(1, 2))
    steady = np.mean(np.abs(blocks.mean(axis=1)) ** 2, axis=1)
    coherence = np.where(power > 0, steady / np.where(power > 0, power, 1.0), 0.0)
    return mean[m:] @ np.linalg.pinv(mean[:m]), variance, coherence, count - 1.0
