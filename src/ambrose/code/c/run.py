"""A controller with synchronous blocks beside it as C99: the controller's files, the blocks' files,
and one unit that runs both, with its own self-test.

The twin is ``ambrose.code.synchronous``; the texts are templates/run.h.j2, run.c.j2 and
run_test.c.j2. ``CompiledRun`` runs the unit in this process.
"""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from typing import Any, cast

import numpy as np
from numpy.typing import ArrayLike

from ambrose.code.block.fixed import ControlBlock
from ambrose.code.block.names import as_comment
from ambrose.code.block.scheduled import ScheduledBlock
from ambrose.code.block.supervised import SupervisedBlock
from ambrose.code.c.code import WORDS, Arithmetic, generate, in_words
from ambrose.code.c.compiler import COMPILERS, build_library, find_compiler, load_library
from ambrose.code.c.literals import integer_table, literal, real_table
from ambrose.code.c.synchronous import generate_synchronous
from ambrose.code.c.synchronous_fixed import generate_words
from ambrose.code.rendering import render
from ambrose.code.self_test import EVERY, SHARE, run_up_of
from ambrose.code.synchronous import (
    Base,
    RunUnit,
    UnitRun,
    contact_counts,
    run_unit,
    run_unit_words,
    words_of,
)
from ambrose.core.checks import InvalidInput

_FLAGS = ("-Wall", "-Wextra", "-pedantic", "-Werror", "-ffp-contract=off")
_FLOAT = 2e-2  # of the largest current: how far single precision may be


def generate_run(
    unit: RunUnit, arithmetic: Arithmetic = "double", provenance: Sequence[str] = ()
) -> dict[str, str]:
    """The files of a unit by name: the controller's (``code.c.code.generate``), <name>_sync.h and
    .c, <name>_run.h, .c and _run_test.c, of fixed point also <name>_sync_report.md. Raises
    InvalidInput, also for fixed point beside a schedule.
    """
    base, sync = unit.base, f"{unit.base.name}_sync"
    files = generate(base, arithmetic, provenance)
    if word := WORDS.get(arithmetic, 0):
        files |= generate_words(words_of(unit), word, sync, provenance)
    else:
        files |= generate_synchronous(unit.law, sync, arithmetic, provenance)
    if arithmetic == "float":
        unit = RunUnit(base.single(), unit.law, unit.contact)
    facts = _facts(unit, arithmetic, provenance) | _self_test(unit, arithmetic)
    for end in ("_run.h", "_run.c", "_run_test.c"):
        files[f"{base.name}{end}"] = render(f"{end[1:]}.j2", facts)
    return files


def _facts(unit: RunUnit, arithmetic: str, provenance: Sequence[str]) -> dict[str, Any]:
    base, word = unit.base, WORDS.get(arithmetic, 0)
    table = integer_table if word else real_table(arithmetic)
    supervised = isinstance(base, SupervisedBlock)
    told = [one.name for one in base.along.each] if isinstance(base, ScheduledBlock) else []
    told += ["estimate", "half_width"] if supervised else []
    touches = bool(np.isfinite(unit.contact).all())
    contact = contact_counts(unit, 1 << (word - 2)) if word else unit.contact
    floating = {"double": "double precision", "float": "single precision"}
    return {
        "name": base.name,
        "prefix": base.name.upper(),
        "sync": f"{base.name.upper()}_SYNC",
        "n": len(base.inputs),
        "fixed": bool(word),
        "type": f"int{word}_t" if word else arithmetic,
        "arithmetic": floating.get(arithmetic, f"fixed point, {word} bits"),
        "sample_time": f"{base.sample_time:.9g}",
        "provenance": [as_comment(line) for line in provenance] or ["provenance: not given"],
        "supervised": supervised,
        "transfers": base.transfers,
        "touches": touches,
        "contact": table(contact) if touches else "",
        "error_limit": "" if word else table(base.error_limit),
        "zero": "0" if word else literal(0.0, arithmetic),
        "told_parameters": "".join(f"{arithmetic} {name}, " for name in told),
        "told_arguments": "".join(f"{name}, " for name in told),
    }


def _middle(base: Base) -> list[float]:
    """What a scheduled block is told in the self-test: the middle of its ranges."""
    if not isinstance(base, ScheduledBlock):
        return []
    return [float(axis[0] + axis[-1]) / 2 for axis in base.axes]


def _self_test(unit: RunUnit, arithmetic: str) -> dict[str, Any]:
    """Signals of whole numbers, as run_test.c.j2 makes them, and what the twin answers."""
    base, run_up = unit.base, run_up_of(unit)
    dt, n = base.sample_time, len(base.inputs)
    count, within = run_up.count, run_up.within()

    # the angle in 2^32 to a turn, and what it moves in a sample
    per_speed = dt / (2 * np.pi) * 2**32
    step, change = round(run_up.start * per_speed), round(run_up.slope * dt * per_speed)
    steps = step + change * np.arange(count)
    turn = np.concatenate([[0], np.cumsum(steps)[:-1]]) % 2**32
    pulses = np.where((turn < steps) & ~within["lost"], dt * (turn / steps), -1.0)

    # a triangle of each channel, |2^32 - at| - 2^30, at = turn + 1000000007 i
    at = (turn[:, None] + np.arange(n) * 1000000007) % 2**32
    wave = np.where(at < 2**31, at, 2**32 - at) - 2**30
    valid = np.ones((count, n), bool)
    valid[within["invalid"], 0] = False
    shown = slice(EVERY - 1, None, EVERY)
    facts: dict[str, Any] = {
        "rows": run_up.rows,
        "every": EVERY,
        "first": step,
        "change": change,
        "windows": {name: f"{a}, {b}" for name, (a, b) in run_up.windows.items()},
    }
    if word := WORDS.get(arithmetic, 0):
        # the same in counts: eight tenths or a tenth of the limit, and a word beyond it
        one = 1 << (word - 2)
        came = (turn < steps) & ~within["lost"]
        ages = np.where(came, turn * one // steps, -1)
        large = np.where(within["large"][:, None], 8 * wave, wave)
        counts = np.sign(large) * (np.abs(large) // (10 * (2**30 // one)))
        counts[within["none"], -1] = one // 2 * 3
        fixed = in_words(cast(ControlBlock, base), word)
        run = run_unit_words(unit, fixed, ages, counts, valid, within["contact"], ~within["off"])
        return facts | {
            "told_test": "",
            "currents": integer_table(run.currents[shown]),
            "faults": _whole(run.faults[shown]),
            "status": _whole(run.status[shown]),
            "tolerance": integer_table(np.zeros(n)),
        }
    scale = SHARE * base.error_limit / 2**30
    errors = wave * np.where(within["large"][:, None], 8.0 * scale, scale)
    errors[within["none"], -1] = np.nan

    middle = _middle(base)
    told = np.full((count, len(middle)), middle) if middle else None
    texts = [literal(value, arithmetic) for value in middle]
    if isinstance(base, SupervisedBlock):
        told = np.column_stack([np.full(count, middle[0]), np.full((count, 2), np.nan)])
        texts += ["none", "none"]
    elif told is not None and told.shape[1] == 1:
        told = told[:, 0]
    run = run_unit(unit, pulses, errors, told, valid, within["contact"], ~within["off"])
    table, largest = real_table(arithmetic), np.abs(run.currents).max(axis=0)
    share = {"double": 1e-9, "float": _FLOAT}[arithmetic]
    return facts | {
        "sample_time_double": literal(dt, "double"),
        "told_test": "".join(f"{text}, " for text in texts),
        "scale": real_table("double")(scale),
        "currents": table(run.currents[shown]),
        "faults": _whole(run.faults[shown]),
        "status": _whole(run.status[shown]),
        "tolerance": table(np.maximum(share * largest, 1e-12)),
    }


def _whole(values: np.ndarray) -> str:
    lines = [", ".join(map(str, values[i : i + 24].tolist())) for i in range(0, len(values), 24)]
    return "{" + ",\n    ".join(lines) + "}"


_RECORD = """#include <stddef.h>
#include "{name}_run.h"
void record(long count, const double *pulses, const double *errors,
    const unsigned char *valid, const double *told, const unsigned *flags, double *currents,
    double *c, double *amplitudes, unsigned *marks);
void record(long count, const double *pulses, const double *errors,
    const unsigned char *valid, const double *told, const unsigned *flags, double *currents,
    double *c, double *amplitudes, unsigned *marks)
{{
    static {name}_run run;
    long k;
    int i, b;
    {name}_run_init(&run);
    for (k = 0; k < count; k++) {{
        {name}_real error[{n}], current[{n}];
        (void)told;
        for (i = 0; i < {n}; i++) error[i] = ({name}_real)errors[k * {n} + i];
        marks[2 * k] = {name}_run_step(&run, ({name}_real)pulses[k], error, valid + k * {n},
            {told}flags[k], current);
        marks[2 * k + 1] = run.faults;
        for (i = 0; i < {n}; i++) currents[k * {n} + i] = current[i], c[k * {n} + i] = run.c[i];
        for (b = 0; b < {blocks}; b++)
            for (i = 0; i < {n}; i++) {{
                amplitudes[(k * {blocks} + b) * {n2} + 2 * i] = (double)run.sync.block[b].re[i];
                amplitudes[(k * {blocks} + b) * {n2} + 2 * i + 1] = (double)run.sync.block[b].im[i];
            }}
    }}
}}
"""


class CompiledRun:
    """The unit's C code in this process."""

    def __init__(
        self, unit: RunUnit, arithmetic: Arithmetic = "double", compiler: str | None = None
    ) -> None:
        """Compiles the code; in fixed point pulses, errors, currents, c are counts, amplitudes
        stored numbers. Raises InvalidInput where there is no C compiler, or it fails.
        """
        chosen = find_compiler(compiler)
        if chosen is None:
            raise InvalidInput(
                f"there is no C compiler {compiler or ' or '.join(COMPILERS)} on this computer; "
                "install one to run the C code here"
            )
        self.unit = unit
        name, n = unit.base.name, len(unit.base.inputs)
        facts = _facts(unit, arithmetic, ())
        columns = facts["told_parameters"].count(",")
        told = "".join(f"({name}_real)told[{columns} * k + {i}], " for i in range(columns))
        text = _RECORD.format(name=name, n=n, n2=2 * n, blocks=len(unit.law.blocks), told=told)
        files = {**generate_run(unit, arithmetic), "record.c": text}
        sources = [f"{name}.c", f"{name}_sync.c", f"{name}_run.c", "record.c"]
        self._columns = columns
        self._library = load_library(
            build_library(chosen, files, sources, _FLAGS, "give another compiler", libraries="-lm")
        )

    def run(
        self,
        pulses: ArrayLike,
        errors: ArrayLike,
        told: ArrayLike | None = None,
        valid: ArrayLike | None = None,
        contact: ArrayLike | None = None,
        enabled: ArrayLike | None = None,
    ) -> UnitRun:
        """As ``code.synchronous.run_unit``; its states are left empty."""
        e = np.ascontiguousarray(errors, float)
        (count, n), blocks = e.shape, len(self.unit.law.blocks)
        good = np.ones((count, n), np.uint8) if valid is None else np.array(valid, np.uint8)
        marks = np.zeros(count, bool) if contact is None else np.asarray(contact, bool)
        on = np.ones(count, bool) if enabled is None else np.asarray(enabled, bool)
        flags = (4 * marks + 64 * ~on).astype(np.uint32)
        given = np.ascontiguousarray(
            np.zeros((count, 1)) if told is None else np.asarray(told, float).reshape(count, -1)
        )
        times = np.ascontiguousarray(pulses, float)
        currents, c = np.zeros((count, n)), np.zeros((count, n))
        amplitudes = np.zeros((count, blocks, n), complex)
        bits = np.zeros((count, 2), np.uint32)
        arrays = (times, e, good, given, flags, currents, c, amplitudes, bits)
        self._library.record(
            ctypes.c_long(count), *(ctypes.c_void_p(array.ctypes.data) for array in arrays)
        )
        empty = np.zeros((count, 0), int)
        return UnitRun(
            currents, bits[:, 0].astype(int), bits[:, 1].astype(int), empty, c, amplitudes
        )
