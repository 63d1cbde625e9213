"""Where a record's rotor has settled: a knock, or the end of a lift-off, at a record's beginning is
motion of tens of micrometres, at which the magnets are another machine than about the middle.

The judgement needs no model. A signal's mean and its swing over short blocks are held against what
those of later blocks scatter about their own middle; a beginning is left out up to the last block
beyond, and twice as much again, so that a decay is down by the same factor twice more.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ambrose.identification.data_quality.signals import signal_findings
from ambrose.identification.findings import Code
from ambrose.machine.machine import Machine
from ambrose.record.record import Record

_BLOCK = 0.02  # s; a block is that long at least
_BLOCKS = 400  # of a long record
_FEWEST = 20  # blocks, below which nothing is told
_BEYOND = 8.0  # times the scatter of later blocks: not settled; assumed
_MOVED = 5.0  # times its own scatter: the excitation does it itself; assumed
_PART = 0.5  # of the signal's own standard deviation later: less is a small part of what it does
_QUIET = 10  # blocks in a row within their bound, after which a signal has settled
_LONGEST = 0.3  # share of a record that may be left out: a longer course is the experiment itself
_AT_LIMITS = {Code.TOUCHDOWN, Code.SATURATED, Code.CLIPPED}


def settled(machine: Machine, record: Record) -> Record:
    """The record from where every y_ and u_<axis> has settled; the record itself where they had
    from the first sample on, where they never do, and where one reaches a limit of the machine:
    what is said of that must not be lost with a beginning.

    What an excitation, reference or force does itself is no reason: a slow chirp moves the rotor
    slowly.
    """
    samples = record.values.shape[1]
    length = max(round(_BLOCK / record.dt), samples // _BLOCKS, 1)
    count = samples // length
    if count < _FEWEST:
        return record
    axes = set(machine.axes)
    blocks = 0
    for name, row in zip(record.signals, record.values, strict=True):
        kind, _, place = name.partition("_")
        whole = row[: count * length].reshape(count, length)
        if kind in {"y", "u"} and place in axes:
            least = _PART * float(np.std(row[count // 2 * length :]))
            mean, swing = _courses(whole)
            blocks = max(blocks, _unsettled(np.abs(mean - _middle(mean)), mean, least))
            # a swing that is smaller at first is no motion to wait for
            blocks = max(blocks, _unsettled(swing - _middle(swing), swing, least))
    # three times as long: what had fallen to a part r of its beginning is down to r^3; two times
    # at least
    longest = int(_LONGEST * count)
    if blocks == 0 or 2 * blocks > longest:
        return record
    blocks = min(3 * blocks, longest)
    if _moved(record, blocks, length, count):
        return record
    if any(found.code in _AT_LIMITS for found in signal_findings(machine, record, 1, "")):
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


def taken(parts: Sequence[Record]) -> str:
    """In words, from when to when the records were cut on demand."""
    each = [
        f"{part.start_time:.4g} to {part.start_time + part.values.shape[1] * part.dt:.4g} s of "
        f"record {number}"
        for number, part in enumerate(parts, 1)
    ]
    return f"{', '.join(each)} {'was' if len(each) == 1 else 'were'} taken"


def _courses(whole: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Mean and swing (blocks,) of a signal in blocks (blocks, samples)."""
    return whole.mean(axis=1), np.ptp(whole, axis=1)


def _middle(values: np.ndarray) -> float:
    """The median of the later half."""
    return float(np.median(values[len(values) // 2 :]))


def _scatter(values: np.ndarray) -> float:
    """The standard deviation of the later half."""
    return float(np.std(values[len(values) // 2 :]))


def _unsettled(off: np.ndarray, values: np.ndarray, least: float) -> int:
    """How many blocks at the beginning are not settled yet, ``off`` (blocks,) from the middle of
    ``values`` (blocks,); ``least``: a smaller deviation is none.
    """
    beyond = off > max(_BEYOND * _scatter(values), least)
    # a decay is largest where the record begins; of a swing, the mean may pass its middle there
    if not beyond[:2].any():
        return 0
    # the first block after which ten in a row are within
    within = np.convolve(~beyond, np.ones(_QUIET, int), "valid") == _QUIET
    return int(within.argmax()) if within.any() else len(off)


def _moved(record: Record, blocks: int, length: int, count: int) -> bool:
    """Whether an excitation, a reference or a force has another course over the first ``blocks``
    than later.
    """
    for name, row in zip(record.signals, record.values, strict=True):
        # a magnet's force is measured; all else with these names is given
        if name[:2] not in {"e_", "r_", "f_"} or name.startswith("f_magnet_"):
            continue
        for values in _courses(row[: count * length].reshape(count, length)):
            off = np.abs(values[:blocks] - _middle(values)).max()
            if off > max(_MOVED * _scatter(values), 1e-9 * np.abs(row).max()):
                return True
    return False
