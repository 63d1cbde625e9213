"""Test vectors: a short run of a block that meets every branch, with what the block in Python answers."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ambrose.deployment.block.fixed import ControlBlock
from ambrose.deployment.block.fixed_point import FixedBlock
from ambrose.deployment.block.run import run_block, run_fixed

SAMPLES = 96


@dataclass(frozen=True, slots=True, eq=False)
class Vectors:
    """errors (k, m) [m] and currents (k, p) [A], or counts of fixed point; valid (k, m) and status (k,): whole numbers."""

    errors: np.ndarray
    valid: np.ndarray
    currents: np.ndarray
    status: np.ndarray


def vectors(block: ControlBlock, fixed: FixedBlock | None = None, single: bool = False) -> Vectors:
    """Small and large errors, limiting, flags, values out of range, silence. fixed: the answer in whole numbers; single:
    errors that single precision holds."""
    rng = np.random.default_rng(7)
    m = len(block.inputs)
    e = rng.uniform(-1, 1, (SAMPLES, m)) * np.exp2(-rng.integers(0, 16, (SAMPLES, m)))
    e[:8] = 0.0
    e[0, 0] = 1.0
    e[40:60] = 1.0
    e[70] = 3.0  # implausible
    valid = np.ones((SAMPLES, m), np.int64)
    valid[64:82, m - 1] = 0
    if fixed is not None:
        words = np.clip(np.round(e * (1 << fixed.signal_bits)), 1 - 2 ** (fixed.word - 1), 2 ** (fixed.word - 1) - 1)
        e = words.astype(np.int64)
        run = run_fixed(fixed, e, valid)
    else:
        e = e * block.error_limit
        if single:
            e = e.astype(np.float32).astype(float)
        run = run_block(block, e, valid)
    return Vectors(e, valid, run.currents, run.status)


def as_csv(block: ControlBlock, run: Vectors) -> str:
    """The vectors as CSV: errors, flags, currents, status, with a line of names."""
    titles = [*block.inputs, *(f"valid_{name}" for name in block.inputs), *block.outputs, "status"]
    return csv_text(titles, [run.errors, run.valid, run.currents, run.status[:, None]])


def csv_text(titles: Sequence[str], columns: Sequence[np.ndarray]) -> str:
    """CSV with a line of titles above columns (k, ...), with all their digits."""
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(titles)
    for k in range(len(columns[0])):
        writer.writerow([f"{v:.17g}" if isinstance(v, float) else int(v) for part in columns for v in part[k].tolist()])
    return stream.getvalue()


__all__ = ["SAMPLES", "Vectors", "as_csv", "csv_text", "vectors"]
