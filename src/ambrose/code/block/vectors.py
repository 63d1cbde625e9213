"""Test vectors: a short run of a block that meets every branch, with what the block in Python
answers.
"""

from __future__ import annotations

import csv
import io
from dataclasses import dataclass, field

import numpy as np

from ambrose.code.block.block import Block
from ambrose.code.block.cascade_fixed import FixedCascade
from ambrose.code.block.fixed import ControlBlock
from ambrose.code.block.fixed_point import FixedBlock
from ambrose.code.block.run import (
    run_block,
    run_fixed,
    run_fixed_cascade,
    run_scheduled,
    run_supervised,
)
from ambrose.code.block.scheduled import ScheduledBlock
from ambrose.code.block.supervised import SupervisedBlock

_SAMPLES = 96  # of a fixed block: its test vectors
# samples of a scheduled run in which what it is told passes through the range and beyond
_SWEEP = 64
_LONGEST = 20_000  # samples of one row of a supervised run
_TAIL = 24  # samples without a value, at the end


@dataclass(frozen=True, slots=True, eq=False)
class Vectors:
    """errors (k, m) [m] and currents (k, p) [A], or counts of fixed point; valid (k, m) and status
    (k,): whole numbers. Of a scheduled block besides what it is told (k,), or (k, 2), NaN for none,
    by the names of the parameters, and rounding (p,) [A]: the largest difference between single and
    double precision. times (k,): how many samples each row stands for, of which the last is
    compared; moves (k,) [Pa]: what every second of them is told besides (None: each is one sample).
    """

    errors: np.ndarray
    valid: np.ndarray
    currents: np.ndarray
    status: np.ndarray
    told: np.ndarray | None = None
    parameters: tuple[str, ...] = ()
    rounding: np.ndarray = field(default_factory=lambda: np.zeros(0))
    times: np.ndarray | None = None
    moves: np.ndarray | None = None


def make_vectors(
    block: ControlBlock, fixed: FixedBlock | FixedCascade | None = None, single: bool = False
) -> Vectors:
    """Small and large errors, limiting, flags, values out of range, silence. fixed: the answer in
    whole numbers; single: errors that single precision holds.
    """
    e, valid = _errors(len(block.inputs), _SAMPLES)

    # long limiting, an implausible value, a flag that outlasts the hold
    e[40:60] = 1.0
    e[70] = 3.0  # implausible
    valid[64:82, -1] = 0
    if fixed is not None:
        words = np.clip(
            np.round(e * (1 << fixed.signal_bits)),
            1 - 2 ** (fixed.word - 1),
            2 ** (fixed.word - 1) - 1,
        )
        e = words.astype(np.int64)
        run = (
            run_fixed_cascade(fixed, e, valid)
            if isinstance(fixed, FixedCascade)
            else run_fixed(fixed, e, valid)
        )
    else:
        e = _held_exactly(e * block.error_limit, single)
        run = run_block(block, e, valid)
    return Vectors(e, valid, run.currents, run.status)


def make_scheduled_vectors(block: ScheduledBlock, single: bool = False) -> Vectors:
    """The same with speeds or pressures: sweeps beyond both ends, limiting everywhere, grid points,
    none; of a supervised block readings of every kind.
    """
    if isinstance(block, SupervisedBlock):
        return _supervised_vectors(block, single)

    # rows: a sweep beyond both ends, limiting over the range, every grid point, silence
    k = max(len(axis) for axis in block.axes)
    limited = max(24, 2 * k)
    e, valid = _errors(len(block.inputs), _SWEEP + limited + k + _TAIL)
    e[30] = 3.0  # implausible
    e[_SWEEP : _SWEEP + limited] = 1.0
    valid[40:58, -1] = 0
    columns = []
    for i, (axis, limit) in enumerate(zip(block.axes, block.told_limits, strict=True)):
        low, high = float(axis[0]), float(axis[-1])
        wide = np.linspace(low - 0.1 * (high - low), high + 0.1 * (high - low), _SWEEP)
        points = axis[np.minimum(np.arange(k), len(axis) - 1)]
        column = np.concatenate(
            [
                wide[:: -1 if i else 1],
                np.linspace(high, low, limited),
                points,
                np.full(_TAIL, np.nan),
            ]
        )

        # none at the start; at the end one implausible value and jumps from end to end
        column[:2], column[-4:] = np.nan, [2 * limit, low, high, low]
        columns.append(np.roll(column, 5 * i))  # so that one is told while the other is not
    told = columns[0] if len(columns) == 1 else np.stack(columns, axis=1)
    e, told = _held_exactly(e * block.error_limit, single), _held_exactly(told, single)
    run = run_scheduled(block, e, told, valid)

    # what single precision makes of the same run
    rounding = np.abs(
        run_scheduled(block, e, told, valid, single=True).currents - run.currents
    ).max(axis=0)
    return Vectors(
        e,
        valid,
        run.currents,
        run.status,
        told,
        tuple(one.name for one in block.along.each),
        rounding,
    )


def _supervised_vectors(block: SupervisedBlock, single: bool) -> Vectors:
    """Every doubt and every change of who is in charge; long waits are one row each, in silence."""
    watch, (low, high) = block.watch, block.range
    band, wide = watch.band, high - low

    # waits [samples], cut to a row's longest; move is within the step that is allowed between
    # samples, below within the margin of the range
    fade, dwell, crossing = (
        min(block.samples(t) or 0, _LONGEST) for t in (watch.fade, watch.dwell, wide / watch.rate)
    )
    move = min(1e-4 * wide, 0.5 * (watch.noise or watch.rate * block.sample_time))
    stuck, below = min(block.samples(watch.stuck) or 8, _LONGEST), min(0.5 * watch.margin, move)
    other, none = low + 0.7 * wide, np.nan
    rows = [  # reading, estimate, half width, samples each, how many, kind of error, moves
        (low, none, none, 1, 16, "all", 0.0),
        (low, none, none, 1, 8, "most", 0.0),
        (low, none, none, 1, 14, "flags", 0.0),
        (low + move, low + 0.4 * band, 0.5 * band, 1, 6, "all", 0.0),
        (low - below, none, none, 1, 3, "all", 0.0),
        (none, none, none, 1, 10, "all", 0.0),
        (none, none, none, fade + crossing + 2, 1, "none", 0.0),
        (none, none, none, 1, 10, "most", 0.0),
        (other, none, none, dwell, 1, "none", move),
        (other, none, none, 1, 10, "all", 0.0),
        (other, none, none, fade + 1, 1, "none", move),
        (other, none, none, 1, 6, "all", 0.0),
        (other, none, none, stuck + 2, 1, "none", 0.0),
        (other, none, none, fade + dwell + 2, 1, "none", move),
        (high + 3 * watch.margin + move, none, none, 1, 3, "all", 0.0),
        (np.inf, none, none, fade + crossing + 2, 1, "none", 0.0),
        (other, none, none, fade + dwell + 2, 1, "none", move),
        (other, none, none, fade + 2, 1, "none", move),
        (other, other + 3 * band + 0.1 * wide, band, 1, 3, "all", 0.0),
        (other, none, none, fade + dwell + 2, 1, "none", move),
        (other, other + 0.5 * band, band, fade + dwell + 2, 1, "none", move),
        (other, none, none, 1, 6, "all", 0.0),
        (low, none, none, 1, 12, "all", 0.0),
        (low, none, none, fade + dwell + 2, 1, "none", move),
    ]

    # rows spread out: readings, samples each stands for, moves
    counts = np.array([row[4] for row in rows])
    told = np.repeat([row[:3] for row in rows], counts, axis=0)
    times, moves = (
        np.repeat([row[3] for row in rows], counts),
        np.repeat([row[6] for row in rows], counts),
    )
    kind = np.repeat([row[5] for row in rows], counts)
    e, valid = _errors(len(block.inputs), len(told))
    e *= 0.05  # so that most currents are within their limits
    e[kind == "most"], e[kind == "none"] = 1.0, 0.0
    flagged = np.flatnonzero(kind == "flags")
    e[flagged[0]], valid[flagged[1:], -1] = 3.0, 0
    e, told, moves = (_held_exactly(x, single) for x in (e * block.error_limit, told, moves))

    # every second sample of a row has its move added; a row's last sample is compared
    odd = np.concatenate([np.arange(n) % 2 for n in times])
    readings = np.repeat(told, times, axis=0)
    readings[:, 0] += odd * np.repeat(moves, times)
    inputs, last = (
        (np.repeat(e, times, axis=0), readings, np.repeat(valid, times, axis=0)),
        np.cumsum(times) - 1,
    )
    run = run_supervised(block, *inputs)
    rounding = np.abs(run_supervised(block, *inputs, single=True).currents - run.currents)[
        last
    ].max(axis=0)
    names = ("pressure", "estimate", "half_width")
    told[~np.isfinite(told)] = np.nan
    return Vectors(
        e, valid, run.currents[last], run.status[last], told, names, rounding, times, moves
    )


def _errors(m: int, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Errors (count, m) of all sizes as parts of their limit, after a pulse into silence, and flags
    (count, m), all good.
    """
    rng = np.random.default_rng(7)
    e = rng.uniform(-1, 1, (count, m)) * np.exp2(-rng.integers(0, 16, (count, m)))
    e[:8] = 0.0
    e[0, 0] = 1.0
    return e, np.ones((count, m), np.int64)


def _held_exactly(x: np.ndarray, single: bool) -> np.ndarray:
    """x, rounded to what single precision holds."""
    return x.astype(np.float32).astype(float) if single else x


def as_csv(block: Block, run: Vectors) -> str:
    """The vectors as CSV: errors, flags, [speed or pressure,] currents, status with all their
    digits, below a line of names.
    """
    titles = [
        *block.inputs,
        *(f"valid_{name}" for name in block.inputs),
        *run.parameters,
        *block.outputs,
        "status",
    ]
    told = [] if run.told is None else [run.told.reshape(len(run.told), -1)]
    if run.times is not None and run.moves is not None:
        titles[len(titles) - len(block.outputs) - 1 : -len(block.outputs) - 1] = ["move", "samples"]
        told += [run.moves[:, None], run.times[:, None]]
    columns = [run.errors, run.valid, *told, run.currents, run.status[:, None]]
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(titles)
    for k in range(len(run.errors)):
        writer.writerow(
            [
                f"{v:.17g}" if isinstance(v, float) else int(v)
                for part in columns
                for v in part[k].tolist()
            ]
        )
    return stream.getvalue()
