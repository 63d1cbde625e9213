"""A control block as C99: a source and a header, a self-test with its vectors, and a report of formats and cost.

The text of the code is in templates/; here are its numbers. The block's arithmetic, signs and timing: block/fixed.py,
block/fixed_point.py and docs/integrator.md. The code needs no library, no heap and no recursion.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np

from ambrose.core.checks import InvalidInput, invalid
from ambrose.deployment.block.cost import Cost, diagonals_of, step_cost
from ambrose.deployment.block.fixed import ControlBlock, transfers
from ambrose.deployment.block.fixed_point import HORIZON, LARGEST_ERROR, FixedBlock, fixed_point
from ambrose.deployment.block.names import as_comment
from ambrose.deployment.block.run import FLOOR
from ambrose.deployment.block.vectors import SAMPLES, as_csv, vectors
from ambrose.deployment.block.word_length import floating_error, word_lengths
from ambrose.deployment.rendering import render
from ambrose.machine.atomic_write import write_files

Arithmetic = Literal["double", "float", "fixed32", "fixed16"]
_WORDS = {"fixed32": 32, "fixed16": 16}
_BITS = {"double": 53, "float": 24}
_WIDTH = 118


def generate(
    block: ControlBlock,
    arithmetic: Arithmetic = "double",
    provenance: Sequence[str] = (),
    largest_error: float = LARGEST_ERROR,
) -> dict[str, str]:
    """The files of a block by name: <name>.h, .c, _test.c, _vectors.csv and _report.md.

    arithmetic: "double", "float", "fixed32" or "fixed16" (see ``fixed_point`` for what that refuses, and
    for largest_error [-]). provenance: lines for the header: where the controller comes from and what it was verified on.
    Raises InvalidInput.
    """
    if arithmetic not in get_args(Arithmetic):
        raise invalid("arithmetic", repr(arithmetic), " or ".join(get_args(Arithmetic)), "choose one of them")
    if arithmetic == "float":
        block = single_limits(block)
    fixed = fixed_point(block, _WORDS[arithmetic], largest_error) if arithmetic in _WORDS else None
    facts = _facts(block, fixed, arithmetic, provenance)
    tables = _fixed_tables(fixed) if fixed is not None else _floating_tables(block, arithmetic)
    replayed = _vectors(block, fixed, arithmetic)
    texts = {
        f"{block.name}.h": ("controller.h.j2", facts),
        f"{block.name}.c": ("controller_fixed.c.j2" if fixed is not None else "controller.c.j2", {**facts, **tables}),
        f"{block.name}_test.c": ("selftest.c.j2", {**facts, **replayed}),
        f"{block.name}_report.md": ("report.md.j2", {**facts, **_report(block, fixed, arithmetic)}),
    }
    files = {name: render(template, values) for name, (template, values) in texts.items()}
    return {**files, f"{block.name}_vectors.csv": replayed["csv"]}


def write_code(
    directory: str | Path,
    block: ControlBlock,
    arithmetic: Arithmetic = "double",
    provenance: Sequence[str] = (),
    largest_error: float = LARGEST_ERROR,
) -> list[Path]:
    """Generate the code and write it to ``directory`` (made if absent): all files, or none. Returns their paths.

    Raises InvalidInput, also where the directory cannot be written.
    """
    return write_files(directory, generate(block, arithmetic, provenance, largest_error))


def single_limits(block: ControlBlock) -> ControlBlock:
    """The block with limits that single precision holds: what the code in "float" compares with."""
    limits = (np.float32(x).astype(float) for x in (block.error_limit, block.current_limit))
    error_limit, current_limit = limits
    return replace(block, error_limit=error_limit, current_limit=current_limit)


def _facts(block: ControlBlock, fixed: FixedBlock | None, arithmetic: str, provenance: Sequence[str]) -> dict[str, Any]:
    """What header, source and report share."""
    low, high = _reach(block)
    word = fixed.word if fixed is not None else 0
    one = 1 << fixed.signal_bits if fixed is not None else 0
    cost = step_cost(block, arithmetic)

    def signals(names: Sequence[str], limits: np.ndarray, unit: str) -> list[dict[str, str]]:
        return [
            {"name": n, "limit": f"{v:.9g}", "unit": unit, "lsb": f"{v / one:.17g}" if one else ""}
            for n, v in zip(names, limits, strict=True)
        ]

    types = {"double": "double", "float": "float"}
    part = {"inputs": "counts of the limit" if one else "m", "outputs": "counts of the limit" if one else "A"}
    return {
        "name": block.name,
        "prefix": block.name.upper(),
        "arithmetic": {"double": "double precision", "float": "single precision"}.get(arithmetic, f"fixed point, {word} bits"),
        "fixed": fixed is not None,
        "type": types.get(arithmetic, f"int{word}_t"),
        "state_type": types.get(arithmetic, f"int{2 * word}_t"),
        "zero": {"double": "0.0", "float": "0.0f"}.get(arithmetic, "0"),
        "provenance": [as_comment(line) for line in provenance] or ["provenance: not given"],
        "ni": len(block.inputs), "no": len(block.outputs), "nx": block.n_states, "winding": block.winding,
        "low": low, "padded": block.n_states + low + high,
        "sample_time": f"{block.sample_time:.9g}", "rate": f"{1 / block.sample_time:.9g}",
        "delay": block.delay, "delay_text": delay_text(block.delay), "hold": block.hold_samples,
        "windup": f"{block.windup_time:g} s",
        "error_unit": part["inputs"], "current_unit": part["outputs"],
        "inputs": signals(block.inputs, block.error_limit, "m"),
        "outputs": signals(block.outputs, block.current_limit, "A"),
        "one": one, "word": word,
        "signal_bits": fixed.signal_bits if fixed is not None else 0,
        "state_bits": fixed.state_bits if fixed is not None else 0,
        "transfers": transfers(block), "direct": bool(block.D.any()), "cost": cost,
    }  # fmt: skip


def delay_text(delay: int) -> str:
    """What the design assumes of the time from errors to currents, delay [samples]."""
    if delay == 0:
        return "The design assumes that the currents are set at once: within a small part of the sample."
    count = "1 sample" if delay == 1 else f"{delay} samples"
    return f"The design assumes that the currents are set {count} after the errors were measured, and held."


def _reach(block: ControlBlock) -> tuple[int, int]:
    """How many places before and after the states the diagonals reach."""
    offsets = [k for k, _ in diagonals_of(block.increment)]
    return max(0, -min(offsets, default=0)), max(0, max(offsets, default=0))


def _floating_tables(block: ControlBlock, arithmetic: str) -> dict[str, Any]:
    def table(x: np.ndarray) -> str:
        return array(x, lambda v: literal(float(v), arithmetic))

    return {
        **_tables(block.increment, block.B, block.C, block.D, block.unwind[: block.winding], block, table),
        "error_limit": table(block.error_limit),
        "current_limit": table(block.current_limit),
        "transfer_error": table(block.from_error.T),
        "transfer_current": table(block.from_output.T),
        "floor": literal(FLOOR[arithmetic], arithmetic),
    }


def _fixed_tables(fixed: FixedBlock) -> dict[str, Any]:
    block, n, m, w = fixed.block, fixed.block.n_states, len(fixed.block.inputs), fixed.block.winding
    update = np.split(fixed.update, [n], axis=1)
    output = np.split(fixed.output, [n], axis=1)
    return {
        **_tables(update[0], update[1], output[0], output[1], fixed.unwind[:w], block, _integers),
        "update_shift": _integers(fixed.update_bits + fixed.signal_bits - fixed.state_bits),
        "unwind_shift": _integers((fixed.unwind_bits + fixed.signal_bits - fixed.state_bits)[:w]),
        "output_bits": _integers(fixed.output_bits),
        "cut_bits": _integers(fixed.cut_bits),
        "transfer_error": _integers(fixed.transfer[:, :m].T),
        "transfer_current": _integers(fixed.transfer[:, m:].T),
        "transfer_bits": _integers(fixed.transfer_bits + fixed.signal_bits),
    }


def _tables(
    increment: np.ndarray, B: np.ndarray, C: np.ndarray, D: np.ndarray, unwind: np.ndarray, block: ControlBlock, table: Any
) -> dict[str, Any]:
    return {
        "diagonals": [
            {
                "label": f"{'below' if k < 0 else 'above'}_{abs(k)}" if k else "own",
                "offset": k,
                "shift": f" {'-' if k < 0 else '+'} {abs(k)}" if k else "",
                "table": table(on_diagonal(increment, k)),
            }
            for k, _ in diagonals_of(block.increment)
        ],
        "B": table(B.T),
        "C": table(C.T),
        "D": table(D.T),
        "unwind": table(unwind.T),
    }


def on_diagonal(x: np.ndarray, k: int) -> np.ndarray:
    """Row by row x[i, i + k], zero outside."""
    values = np.zeros(len(x), x.dtype)
    rows = np.arange(max(0, -k), min(len(x), len(x) - k))
    values[rows] = x[rows, rows + k]
    return values


def _integers(x: np.ndarray) -> str:
    return array(x, lambda v: str(int(v)))


def literal(value: float, arithmetic: str) -> str:
    """A number as C writes it, with all its digits."""
    text = f"{value:.17g}" if arithmetic == "double" else f"{float(np.float32(value)):.9g}"
    if not any(c in text for c in ".en"):
        text += ".0"
    return text if arithmetic == "double" else f"{text}f"


def array(x: np.ndarray, form: Any, indent: str = "    ") -> str:
    """A C initialiser, its lines at most _WIDTH wide."""
    if x.ndim > 1:
        rows = ",\n".join(f"{indent}{array(row, form, indent + '    ')}" for row in x)
        return "{\n" + rows + "\n" + indent[4:] + "}"
    lines, line = [], ""
    for i, value in enumerate(x):
        item = form(value) + (", " if i + 1 < len(x) else "")
        if line and len(line) + len(item) + len(indent) > _WIDTH:
            lines.append(line.rstrip())
            line = ""
        line += item
    lines.append(line)
    return "{" + f"\n{indent}    ".join(lines) + "}"


def _vectors(block: ControlBlock, fixed: FixedBlock | None, arithmetic: str) -> dict[str, Any]:
    """What the self-test holds: the run of ``vectors`` as C, its tolerance, and the same as CSV."""
    run = vectors(block, fixed, single=arithmetic == "float")
    if fixed is not None:
        table, number_format, number_cast = _integers, "%ld", "long"
        tolerance = np.zeros(len(block.outputs))
    else:
        tolerance = 1e-12 * block.raw_limit if arithmetic == "double" else floating_error(block, 24)
        number_format, number_cast = "%.17g", "double"

        def table(x: np.ndarray) -> str:
            return array(x, lambda v: literal(float(v), arithmetic))

    return {
        "errors": table(run.errors), "currents": table(run.currents), "tolerance": table(tolerance),
        "number_format": number_format, "number_cast": number_cast, "samples": SAMPLES,
        "valid": _integers(run.valid), "status": _integers(run.status), "csv": as_csv(block, run),
    }  # fmt: skip


def _report(block: ControlBlock, fixed: FixedBlock | None, arithmetic: str) -> dict[str, Any]:
    error = fixed.error if fixed is not None else floating_error(block, _BITS[arithmetic])
    outputs = [
        {"name": name, "limit": f"{limit:.6g}", "raw": f"{raw:.4g}", "error": f"{off:.2g}"}
        for name, limit, raw, off in zip(block.outputs, block.current_limit, block.raw_limit, error, strict=True)
    ]
    return {
        "sizes": ", ".join(str(k) for k in block.sizes) or "none",
        "outputs": outputs,
        "horizon": HORIZON,
        "rows": [] if fixed is None else _formats(fixed),
        "word_lengths": word_lengths(block),
    }


def _formats(fixed: FixedBlock) -> list[dict[str, str]]:
    block = fixed.block
    states = [f"x[{i}]" for i in range(block.n_states)]
    groups = [(states, fixed.update, fixed.update_bits), (block.outputs, fixed.output, fixed.output_bits)]
    groups.append(([f"unwind x[{i}]" for i in range(block.winding)], fixed.unwind, fixed.unwind_bits))
    if transfers(block):
        groups.append(([f"track x[{i}]" for i in range(block.n_states)], fixed.transfer, fixed.transfer_bits))
    return [
        {"name": name, "bits": str(f), "total": f"{np.abs(row * np.exp2(-f)).sum():.3g}"}
        for names, matrix, bits in groups
        for name, row, f in zip(names, matrix, bits, strict=False)  # unwind: the first states
    ]


__all__ = [
    "Arithmetic", "Cost", "InvalidInput", "array", "delay_text", "generate", "literal", "on_diagonal", "single_limits",
    "write_code",
]  # fmt: skip
