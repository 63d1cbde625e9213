"""A controller block with synchronous blocks beside it as IEC 61131-3 structured text: a function
block that calls the controller's, and a program that tests it.

The twin is ``ambrose.code.synchronous``; signs, order of the sums and state machine are those of
the generated C. Besides the common part of the language it needs TRUNC and DINT_TO_LREAL, which the
standard has.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, get_args

import numpy as np

from ambrose.code.block.scheduled import ScheduledBlock
from ambrose.code.block.supervised import SupervisedBlock
from ambrose.code.c.code import Precision
from ambrose.code.c.synchronous import FAR, NEWTON
from ambrose.code.rendering import render
from ambrose.code.self_test import EVERY, SHARE, run_up_of
from ambrose.code.structured_text import (
    Table,
    check_names,
    generate_structured_text,
    literal,
    text_facts,
    values,
    whole_numbers,
)
from ambrose.code.synchronous import RunUnit, run_unit
from ambrose.core.checks import InvalidInput, invalid
from ambrose.law.synchronous_block import DECAY, JUMP, LOST_TURNS, SECTORS, BlockLaw, circle

FAULTS = (
    "lost",
    "jumped",
    "touched",
    "saturated",
    "at_limit",
    "outside",
    "off_told",
    "unusable",
)  # in the order of the bits of law.synchronous_block.BlockFault
_FLAGS = ("held", "fault", "limited")
_OWN = """
pulse contact off base pulses tau period middle omega slope now theta came turned length change span
turns sector angle p q mode clock ramp limits cosine sine re im samples sum_re sum_im v w error good
added given current s x y share eps leak any inside wanted k next i j circle touching error_limit
reset track held fault limited clamped behind u e turn part d row since expected check block shift
scale status faults tolerance currents sample wrong largest done
"""  # what the function block and its test declare besides signals
_TOLERANCE = {"double": 1e-9, "float": 2e-2}  # of the largest current


def generate_run_structured_text(
    unit: RunUnit, precision: Precision = "double", provenance: Sequence[str] = ()
) -> dict[str, str]:
    """The controller's files (``structured_text``), <name>_run.st (the function block that is
    called in its place) and <name>_run_test.st.

    Raises InvalidInput for fixed point, a supervised controller, or names that structured text
    reserves.
    """
    if precision not in get_args(Precision):
        raise invalid(
            "arithmetic beside a synchronous block",
            repr(precision),
            "double or float",
            "structured text has no fixed point here; write C",
        )
    base = unit.base
    if isinstance(base, SupervisedBlock):
        raise InvalidInput(
            "structured text has no supervision of a schedule by a fallback; write C, which has it"
        )
    own = frozenset(_OWN.split()) | {f"{name}_{k}" for k in range(16) for name in _OF_BLOCK}
    check_names(base, own)
    files = generate_structured_text(base, precision, provenance)
    unit = replace(unit, base=base.single()) if precision == "float" else unit
    facts = {**text_facts(unit.base, precision, provenance), **_facts(unit, precision)}
    facts |= _test(unit, precision)
    return {
        **files,
        f"{base.name}_run.st": render("run.st.j2", facts),
        f"{base.name}_run_test.st": render("run_test.st.j2", facts),
    }


_OF_BLOCK = ("speeds", "drive_re", "drive_im", "amplitude_limit")


def _facts(unit: RunUnit, precision: Precision) -> dict[str, Any]:
    base, law = unit.base, unit.law
    dt = law.sample_time

    def number(value: float) -> str:
        return literal(value, precision)

    arrays: dict[str, np.ndarray] = {"circle": circle(), "error_limit": base.error_limit}
    touches = bool(np.isfinite(unit.contact).all())
    if touches:
        arrays["touching"] = unit.contact
    for k, block in enumerate(law.blocks):
        tables = (block.speeds, block.drive.real, block.drive.imag, block.limit)
        arrays |= {f"{name}_{k}": x for name, x in zip(_OF_BLOCK, tables, strict=True)}
    flags = list(_FLAGS)
    if isinstance(base, ScheduledBlock):
        flags += ["clamped", f"{base.along.name}_held", "behind"]
    return {
        "n": len(base.inputs),
        "count": len(law.blocks),
        "blocks": [_block(k, one, dt, precision) for k, one in enumerate(law.blocks)],
        "tables": [_table(name, x, precision) for name, x in arrays.items()],
        "flags": flags,
        "faults": list(FAULTS),
        "touches": touches,
        "per_turn": any(block.per_turn for block in law.blocks),
        "newton": NEWTON,
        "sectors": SECTORS,
        "dt": number(dt),
        "fastest": number(law.fastest),
        "jump": number(JUMP),
        "lost_turns": number(LOST_TURNS),
        "far": number(FAR),
        "two_pi": number(2 * math.pi),
        "per_radian": number(SECTORS / (2 * math.pi)),
        "sector_angle": number(2 * math.pi / SECTORS),
        "sixth": number(1 / 6),
    }


def _block(at: int, block: BlockLaw, dt: float, precision: Precision) -> dict[str, Any]:
    low, high = block.band
    reals = {
        "low": low,
        "high": high,
        "hysteresis": block.hysteresis,
        "gain": block.gain,
        "leak": block.leak,
        "ramp": dt / block.ramp,
        "fade": 1 - dt / block.release,
        "harmonic": block.harmonic,
    }
    return {
        **{name: literal(float(value), precision) for name, value in reals.items()},
        "at": at,
        "m": block.drive.shape[2],
        "points": len(block.speeds),
        "hold": round(block.hold / dt),
        "release": round(DECAY * block.release / dt),
        "subtracts": block.subtracts,
        "currents": block.reads_currents,
        "per_turn": block.per_turn,
    }


def _table(name: str, x: np.ndarray, precision: Precision) -> Table:
    bounds = ", ".join(f"0..{size - 1}" for size in x.shape)
    kind = {"double": "LREAL", "float": "REAL"}[precision]
    return Table(name, bounds, kind, values(x, precision))


def _test(unit: RunUnit, precision: Precision) -> dict[str, Any]:
    """The signals as run_test.st.j2 makes them, in the same numbers, and what the twin answers."""
    base, run_up = unit.base, run_up_of(unit)
    dt, n = base.sample_time, len(base.inputs)
    count, within = run_up.count, run_up.within()

    # the angle in turns and what it moves in a sample, summed up in the numbers of the code
    kind: Any = np.float32 if precision == "float" else np.float64
    turn, part = kind(0), kind(run_up.start * dt / (2 * np.pi))
    first_part, change = part, kind(run_up.slope * dt * dt / (2 * np.pi))
    angle, parts = np.zeros(count, kind), np.zeros(count, kind)
    for i in range(count):
        angle[i], parts[i] = turn, part
        turn = kind(turn + part)
        turn = kind(turn - kind(1)) if turn >= 1 else turn
        part = kind(part + change)

    pulses = np.where((angle < parts) & ~within["lost"], kind(dt) * (angle / parts), kind(-1))

    # a triangle of each channel
    shift = (np.arange(n) * 0.2328306 % 1).astype(kind)
    scale = (4 * SHARE * base.error_limit).astype(kind)
    d = angle[:, None] + shift
    d = np.where(d >= 1, d - kind(1), d)
    wave = (np.where(d >= 0.5, kind(1) - d, d) - kind(0.25)) * scale
    errors = np.where(within["large"][:, None], kind(8) * wave, wave)
    valid = np.ones((count, n), bool)
    valid[within["invalid"], 0] = False

    middle = (base.grid[0] + base.grid[-1]) / 2 if isinstance(base, ScheduledBlock) else 0.0
    told = np.full(count, middle) if isinstance(base, ScheduledBlock) else None
    enabled = np.logical_not(within["off"])
    run = run_unit(unit, pulses, errors, told, valid, within["contact"], enabled)
    shown, largest = slice(EVERY - 1, None, EVERY), np.abs(run.currents).max(axis=0)
    tables = {
        "shift": shift,
        "scale": scale,
        "currents": run.currents[shown],
        "tolerance": np.maximum(_TOLERANCE[precision] * largest, 1e-12),
    }
    return {
        "rows": run_up.rows,
        "every": EVERY,
        "first": literal(float(first_part), precision),
        "change": literal(float(change), precision),
        "windows": run_up.windows,
        "told": literal(float(middle), precision),
        "test_tables": [_table(name, x, precision) for name, x in tables.items()],
        "status": whole_numbers(run.status[shown]),
        "expected_faults": whole_numbers(run.faults[shown]),
    }
