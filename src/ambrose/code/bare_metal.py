"""An example to start from: a law's code on a processor without an operating system, with timer,
two buffers and watchdog, and an emulated board that it runs on.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from ambrose.code.block.scheduled import ScheduledBlock
from ambrose.code.block.supervised import SupervisedBlock
from ambrose.code.c.code import Arithmetic
from ambrose.code.c.literals import integer_table, literal, real_table
from ambrose.code.processor.unit import Law, Unit, unit_of
from ambrose.code.rendering import render
from ambrose.code.synchronous import RunUnit

SAMPLES = 1000  # that the example runs on its emulated board
_PATIENCE = 20  # samples without one that was worked on, before the watchdog bites
_SHARE = 8 * 100  # a hundredth of an eighth of the limit
_DUE = ("as soon as they are known", "at the next sample")
_NAMES = ("board.h", "main.c", "board_mps2.c", "mps2.ld")


def bare_metal_files(law: Law, arithmetic: Arithmetic) -> dict[str, str]:
    """The example's files by name: <name>_main.c, which knows no hardware, <name>_board.h, which
    says what it needs of it, and <name>_board_mps2.c and <name>_mps2.ld, a board of QEMU's.
    """
    unit = unit_of(law, arithmetic, {})
    base = unit.base
    real = arithmetic in {"double", "float"}

    def number(value: float) -> str:
        return literal(value, arithmetic) if real else str(int(value))

    # on the emulated board: errors within an eighth of their limit, what is told in mid range
    amplitude = unit.counts(base.error_limit / _SHARE, unit.metre)
    told = []
    if isinstance(base, ScheduledBlock):
        for axis, one in zip(base.axes, base.along.each, strict=True):
            told.append({"name": one.name, "value": number(float(np.mean(axis)))})
    if isinstance(base, SupervisedBlock):  # no monitor beside it
        told += [{"name": name, "value": number(-1.0)} for name in ("estimate", "half_width")]
    delay = base.delay
    arguments = "".join(f"from->{one['name']}, " for one in told)
    call = f"{unit.step}(&controller, from->error, from->valid, {arguments}current[k % SETS])"
    if unit.beside:
        call = (
            f"{unit.step}(&controller, from->pulse, from->error, from->valid, {arguments}"
            "from->flags, current[k % SETS])"
        )
    facts: dict[str, Any] = {
        **unit.driver_facts(),
        "step": call,
        "delay": delay,
        "delay_text": _DUE[delay] if delay < len(_DUE) else f"{delay} samples later",
        "samples": SAMPLES,
        "patience": _PATIENCE,
        "sources": " ".join(unit.sources),
        "amplitude": real_table(arithmetic)(amplitude) if real else integer_table(amplitude),
        "minus_one": number(-1.0),
        "zero": number(0.0),
        "fixed": not real,
        "turn": _turn(unit),
    }
    files = {}
    for name in _NAMES:
        values = facts | {"told": told if name == "board_mps2.c" else [one["name"] for one in told]}
        files[f"{base.name}_{name}"] = render(f"bare_metal/{name}.j2", values)
    return files


def _turn(unit: Unit) -> int:
    """Samples of a turn in the middle of the first synchronous block's band; 0: there is none."""
    law = unit.law
    if not isinstance(law, RunUnit):
        return 0
    low, high = law.law.blocks[0].band
    return max(2, round(4 * math.pi / ((low + high) * law.base.sample_time)))
