"""A scheduled block as C99: a source and a header, a self-test with its vectors, and a report of schedule and cost.

The text of the code is in templates/scheduled*.j2; here are its numbers. Arithmetic, signs and timing: block/scheduled.py and
docs/integrator.md. The code needs no library, no heap and no recursion.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np

from ambrose.core.checks import invalid
from ambrose.deployment.block.cost import Cost
from ambrose.deployment.block.names import as_comment
from ambrose.deployment.block.run import FLOOR
from ambrose.deployment.block.scheduled import ScheduledBlock, transfers
from ambrose.deployment.block.scheduled_run import run_scheduled
from ambrose.deployment.block.vectors import csv_text
from ambrose.deployment.block.word_length import gain_error
from ambrose.deployment.c.fixed import array, delay_text, literal
from ambrose.deployment.rendering import render
from ambrose.machine.atomic_write import write_files

Precision = Literal["double", "float"]
_TAIL = 24  # samples without a speed, at the end
_BYTES = {"double": 8, "float": 4}
_TOLERANCE = {"double": 1e-12, "float": 1e-4}  # of the current asked for, of the current limit
_HZ = 2 * np.pi


def generate_scheduled(
    block: ScheduledBlock, arithmetic: Precision = "double", provenance: Sequence[str] = ()
) -> dict[str, str]:  # fmt: skip
    """The files of a block by name: <name>.h, .c, _test.c, _vectors.csv and _report.md.

    arithmetic: "double" or "float"; provenance: lines for the header. Raises InvalidInput, also for fixed point.
    """
    check_precision(arithmetic)
    if arithmetic == "float":
        block = single(block)
    run = vectors(block, arithmetic)
    facts = _facts(block, arithmetic, provenance)
    replayed = _replayed(block, run, arithmetic)
    texts = {
        f"{block.name}.h": ("scheduled.h.j2", facts),
        f"{block.name}.c": ("scheduled.c.j2", {**facts, **_tables(block, arithmetic)}),
        f"{block.name}_test.c": ("scheduled_test.c.j2", {**facts, **replayed}),
        f"{block.name}_report.md": ("scheduled_report.md.j2", {**facts, **_report(block, run)}),
    }
    files = {name: render(template, values) for name, (template, values) in texts.items()}
    return {**files, f"{block.name}_vectors.csv": _csv(block, run)}


def write_scheduled(
    directory: str | Path, block: ScheduledBlock, arithmetic: Precision = "double", provenance: Sequence[str] = ()
) -> list[Path]:  # fmt: skip
    """Generate the code and write it to ``directory`` (made if absent): all files, or none. Returns their paths.

    Raises InvalidInput, also where the directory cannot be written.
    """
    return write_files(directory, generate_scheduled(block, arithmetic, provenance))


def check_precision(arithmetic: str) -> None:
    """Refuse fixed point for a schedule. Raises InvalidInput."""
    if arithmetic not in get_args(Precision):
        remedy = "fixed point would need tight bounds on every state for any motion of the speed; use double or float"
        raise invalid("arithmetic of a scheduled controller", repr(arithmetic), "double or float", remedy)


def single(block: ScheduledBlock) -> ScheduledBlock:
    """The block with limits and grid that single precision holds. Raises InvalidInput where grid points fall together."""
    rounded = [np.float32(x).astype(float) for x in (block.error_limit, block.current_limit, block.grid)]
    if not (np.diff(rounded[2]) > 0).all():
        raise invalid("the grid", block.grid.tolist(), "apart in single precision", 'use arithmetic="double"')
    step = float(np.float32(block.speed_step))
    return replace(
        block, error_limit=rounded[0], current_limit=rounded[1], grid=rounded[2],
        speed_limit=float(np.float32(block.speed_limit)), rate_limit=step / block.sample_time,
    )  # fmt: skip


@dataclass(frozen=True, slots=True, eq=False)
class ScheduledVectors:
    """errors (k, m) [m], valid (k, m), speeds (k,) [rad/s] with NaN for none, currents (k, p) [A], status (k,); rounding (p,)
    [A]: the largest difference between single and double precision on them."""

    errors: np.ndarray
    valid: np.ndarray
    speeds: np.ndarray
    currents: np.ndarray
    status: np.ndarray
    rounding: np.ndarray


def vectors(block: ScheduledBlock, arithmetic: Precision = "double") -> ScheduledVectors:
    """A short run that meets every branch: sweeps beyond both ends, limiting everywhere, grid points, flags, no speed."""
    rng = np.random.default_rng(7)
    m, k, (low, high) = len(block.inputs), len(block.grid), block.range
    swept, limited = 64, max(24, 2 * k)
    count = swept + limited + k + _TAIL
    e = rng.uniform(-1, 1, (count, m)) * np.exp2(-rng.integers(0, 16, (count, m)))
    e[:8], e[0, 0], e[30] = 0.0, 1.0, 3.0
    e[swept : swept + limited] = 1.0
    valid = np.ones((count, m), np.int64)
    valid[40:58, m - 1] = 0
    wide = np.linspace(low - 0.1 * (high - low), high + 0.1 * (high - low), swept)
    speeds = np.concatenate([wide, np.linspace(high, low, limited), block.grid, np.full(_TAIL, np.nan)])
    speeds[:2], speeds[-4:] = np.nan, [2 * block.speed_limit, low, high, low]
    e = e * block.error_limit
    if arithmetic == "float":
        e, speeds = e.astype(np.float32).astype(float), speeds.astype(np.float32).astype(float)
    run = run_scheduled(block, e, speeds, valid)
    off = np.abs(run_scheduled(block, e, speeds, valid, single=True).currents - run.currents).max(axis=0)
    return ScheduledVectors(e, valid, speeds, run.currents, run.status, off)


def _csv(block: ScheduledBlock, run: ScheduledVectors) -> str:
    titles = [*block.inputs, *(f"valid_{name}" for name in block.inputs), "speed", *block.outputs, "status"]
    return csv_text(titles, [run.errors, run.valid, run.speeds[:, None], run.currents, run.status[:, None]])


def _facts(block: ScheduledBlock, arithmetic: Precision, provenance: Sequence[str]) -> dict[str, Any]:
    """What header, source and report share."""

    def signals(names: Sequence[str], limits: np.ndarray) -> list[dict[str, str]]:
        return [{"name": n, "limit": f"{v:.9g}"} for n, v in zip(names, limits, strict=True)]

    low, high = block.range
    limited = bool(np.isfinite(block.rate_limit))
    return {
        "name": block.name,
        "prefix": block.name.upper(),
        "arithmetic": {"double": "double precision", "float": "single precision"}[arithmetic],
        "type": arithmetic,
        "zero": literal(0.0, arithmetic), "one": literal(1.0, arithmetic),
        "provenance": [as_comment(line) for line in provenance] or ["provenance: not given"],
        "ni": len(block.inputs), "no": len(block.outputs), "nx": block.n_states, "ng": len(block.grid),
        "sample_time": f"{block.sample_time:.9g}", "rate": f"{1 / block.sample_time:.9g}",
        "delay": block.delay, "delay_text": delay_text(block.delay), "hold": block.hold_samples,
        "windup": f"{block.windup_time:g} s",
        "low": f"{low:.6g}", "high": f"{high:.6g}", "low_hz": f"{low / _HZ:.4g}", "high_hz": f"{high / _HZ:.4g}",
        "lowest": literal(low, arithmetic), "highest": literal(high, arithmetic),
        "speed_limit": literal(block.speed_limit, arithmetic), "plausible": f"{block.speed_limit:.6g}",
        "speed_rate": f"{block.rate_limit:.9g}" if limited else "",
        "rate_text": f" The schedule follows at {block.rate_limit:.6g} rad/s^2 at most." if limited else "",
        "motion_text": _motion(block),
        "inputs": signals(block.inputs, block.error_limit),
        "outputs": signals(block.outputs, block.current_limit),
        "transfers": transfers(block), "passes": block.passes, "cost": scheduled_cost(block, arithmetic),
    }  # fmt: skip


def _motion(block: ScheduledBlock) -> str:
    if not block.motion.proved:
        return "While the speed moves no bound is proved."
    farthest = block.motion.states.max(initial=0.0)
    return f"For any motion of the speed: within +-{farthest:.3g} (proved, conservative)."


def _tables(block: ScheduledBlock, arithmetic: Precision) -> dict[str, Any]:
    def table(x: np.ndarray) -> str:
        return array(x, lambda v: literal(float(v), arithmetic))

    return {
        "error_limit": table(block.error_limit),
        "current_limit": table(block.current_limit),
        "grid": table(block.grid),
        "speed_limit_table": literal(block.speed_limit, arithmetic),
        "speed_step": literal(block.speed_step, arithmetic) if np.isfinite(block.speed_step) else "",
        "to_current": table(np.concatenate([block.C, block.D], axis=2).transpose(0, 2, 1)),
        "to_state": table(np.concatenate([block.increment, block.B], axis=2).transpose(0, 2, 1)),
        "unwind": table(block.unwind.transpose(0, 2, 1)),
        "steady": table(block.steady.transpose(0, 2, 1)),
        "pick": table(block.pick.transpose(0, 2, 1)),
        "floor": literal(FLOOR[arithmetic], arithmetic),
    }


def _replayed(block: ScheduledBlock, run: ScheduledVectors, arithmetic: Precision) -> dict[str, Any]:
    """What the self-test holds."""

    def table(x: np.ndarray) -> str:
        return array(x, lambda v: literal(float(v), arithmetic))

    def whole(x: np.ndarray) -> str:
        return array(x, lambda v: str(int(v)))

    tolerance = _TOLERANCE["double"] * block.raw_limit
    if arithmetic == "float":
        tolerance = np.maximum(_TOLERANCE["float"] * block.current_limit, 4 * run.rounding)
    known = ~np.isnan(run.speeds)
    return {
        "samples": len(run.errors), "errors": table(run.errors), "valid": whole(run.valid), "currents": table(run.currents),
        "speeds": table(np.where(known, run.speeds, 0.0)), "known": whole(known), "status": whole(run.status),
        "tolerance": table(tolerance),
    }  # fmt: skip


def _report(block: ScheduledBlock, run: ScheduledVectors) -> dict[str, Any]:
    outputs = [
        {"name": name, "limit": f"{limit:.6g}", "raw": f"{raw:.4g}", "error": f"{off:.2g}"}
        for name, limit, raw, off in zip(block.outputs, block.current_limit, block.raw_limit, run.rounding, strict=True)
    ]
    points = []
    for i, speed in enumerate(block.grid):
        E = block.increment[i]
        z = 1 + np.linalg.eigvals(E) if len(E) else np.zeros(1)
        led = 1 + np.linalg.eigvals(E - block.unwind[i] @ block.C[i]) if len(E) else np.zeros(1)
        away = 1 - np.abs(z)
        points.append({
            "speed": f"{speed:.6g}", "hz": f"{speed / _HZ:.4g}", "radius": f"{np.abs(led).max():.6f}",
            "slow": f"{away.min():.3g}", "fast": f"{away.max():.3g}",
            "single": f"{gain_error(E, block.B[i], block.C[i], block.D[i], 24):.2g}",
        })  # fmt: skip
    return {"outputs_report": outputs, "points": points}


def scheduled_cost(block: ScheduledBlock, arithmetic: Precision) -> Cost:
    """Counted as the code does it: two grid points, dense tables."""
    n, m, p, k = block.n_states, len(block.inputs), len(block.outputs), len(block.grid)
    size = _BYTES[arithmetic]
    products = 2 * (n + m) * (n + p)
    transfer = k * n * (m + p) if transfers(block) else 0
    return Cost(
        multiplications=products + 2 * (n + m),
        additions=products + 3 * n + 4,
        limited=2 * p * (n + 1),
        state_bytes=(2 * n + m + 2) * size + 2 * (m + 3),
        table_bytes=(k * ((n + m) * (n + p) + n * p + 1) + transfer + m + p + 2) * size,
    )


__all__ = [
    "Precision",
    "ScheduledVectors",
    "check_precision",
    "generate_scheduled",
    "scheduled_cost",
    "single",
    "vectors",
    "write_scheduled",
]
