"""Where a record's rotor has settled: lift-off, or a knock, just before a record begins is motion
of tens of micrometres, at which the magnets are another machine than about the middle.

The judgement needs no model: a displacement's mean over a short block, against what such means
scatter about later in the same record.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ambrose.record.record import Record

_BLOCK = 0.02  # s; a block is that long at least
_BLOCKS = 400  # of a long record
_BEYOND = 8.0  # times the scatter of later blocks' means: not settled; assumed
_PART = 0.5  # of the signal's own standard deviation later: less is a small part of what it does
_LONGEST = 0.3  # share of a record that may be left out: a longer course is the experiment itself
_SIGMA = 1.4826  # standard deviation over median deviation, of normal values


def settled(record: Record, axes: Sequence[str]) -> Record:
    """The record from where every y_<axis> has settled; the record itself where it had from the
    first sample on, and where it never does.

    What an excitation or reference does itself is no reason: a slow chirp moves the rotor slowly.
    """
    length = max(round(_BLOCK / record.dt), record.values.shape[1] // _BLOCKS, 1)
    count = record.values.shape[1] // length
    if count < 20:
        return record
    means = {
        name: row[: count * length].reshape(count, length).mean(axis=1)
        for name, row in zip(record.signals, record.values, strict=True)
        if name[:2] in {"y_", "e_", "r_"}
    }
    if any(_unsettled(rows, 0.0) for name, rows in means.items() if name[:2] != "y_"):
        return record

    # a displacement is settled at the first block after which it lies on the other side
    blocks = 0
    for axis in axes:
        rows = means.get(f"y_{axis}")
        if rows is not None:
            spread = float(np.std(record[f"y_{axis}"][count // 2 * length :]))
            blocks = max(blocks, _unsettled(rows, _PART * spread))
    if blocks == 0 or blocks > _LONGEST * count:
        return record
    return record.between(float(record.time[blocks * length]), float(record.time[-1]) + record.dt)


def left_out(whole: Sequence[Record], kept: Sequence[Record]) -> str:
    """In words, which beginnings ``settled`` took off; empty where none."""
    parts = [
        f"the first {now.start_time - record.start_time:.3g} s of record {number}"
        for number, (record, now) in enumerate(zip(whole, kept, strict=True), 1)
        if now is not record
    ]
    if not parts:
        return ""
    verb = "is" if len(parts) == 1 else "are"
    return (
        f"{', '.join(parts)} {verb} left out: the rotor had not settled (--between takes what you "
        "name)"
    )


def _unsettled(means: np.ndarray, least: float) -> int:
    """How many blocks at the beginning are not settled yet; ``least``: a smaller deviation is
    none.
    """
    later = means[len(means) // 2 :]
    centre = float(np.median(later))
    scatter = _SIGMA * float(np.median(np.abs(later - centre)))
    off = means - centre
    if abs(off[0]) <= max(_BEYOND * scatter, least):
        return 0
    inside = np.flatnonzero(off * np.sign(off[0]) <= 0)
    return int(inside[0]) if len(inside) else len(means)
