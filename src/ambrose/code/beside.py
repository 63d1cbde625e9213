"""Synchronous blocks of an export: which there are, their verdict in the loop as it will run, and
the unit that runs them beside the controller.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from ambrose.code.synchronous import Base, RunUnit, in_order
from ambrose.code.targets import Target
from ambrose.core.checks import InvalidInput, UnstableSystem
from ambrose.core.presentation import with_unit
from ambrose.judge.checks import Check, Checks
from ambrose.judge.result import Synthesis
from ambrose.judge.synchronous import block_loops, check_block
from ambrose.law.law import LawLike
from ambrose.law.synchronous import synchronous_loop
from ambrose.law.synchronous_table import check_blocks, running_law
from ambrose.machine.machine import Machine
from ambrose.machine.synchronous import Synchronous

_DIVERGES = ("synchronous.margin", "synchronous.gain")
_TOUCH = 0.95  # of the smallest touchdown gap: an error beyond it counts as contact


def blocks_beside(
    synthesis: Synthesis, machine: Machine | None, target: Target
) -> tuple[Synchronous, ...]:
    """The blocks of a controller, else of its machine. Raises InvalidInput where the target, or a
    missing machine, leaves no way to write them.
    """
    settings = None if machine is None else machine.controller
    blocks = synthesis.synchronous or (() if settings is None else settings.synchronous)
    if blocks:
        target.check_beside()
        if machine is None:
            raise InvalidInput(
                "the synchronous blocks need the machine, which says what they read; name its file "
                "(--machine my.toml)"
            )
        check_blocks(blocks, machine)
    return tuple(blocks)


def judge_beside(
    blocks: Sequence[Synchronous],
    machine: Machine,
    law: LawLike,
    block: Base,
    progress: Callable[[str], None],
    *,
    force: bool,
) -> tuple[RunUnit, tuple[Checks, ...]]:
    """The unit of a controller block and its synchronous blocks, and their checks with the law that
    runs. Raises UnstableSystem for blocks that diverge, unless forced.
    """
    rate, delay = 1 / block.sample_time, block.delay
    judged = tuple(
        check_block(item, progress) for item in block_loops(machine, law, blocks, rate, delay)
    )
    if not force and (found := diverging(judged)):
        raise UnstableSystem(f"{'; '.join(found)}; give another T, or force the export")
    running = running_law(blocks, synchronous_loop(machine, law, rate, delay))
    gaps = [bearing.touchdown_gap for bearing in machine.bearings if bearing.touchdown_gap]
    contact = np.full(len(block.inputs), _TOUCH * min(gaps, default=np.inf))
    return RunUnit(block, in_order(running, machine.axes, block), contact), judged


def diverging(judged: Sequence[Checks]) -> tuple[str, ...]:
    """What of the checks speaks of a block that is not proved to converge, in words."""
    return tuple(
        f"{item.label}: {_said(check)}"
        for item in judged
        for check in item.failed
        if check.name.startswith(_DIVERGES)
    ) + tuple(f"{item.label}: {' '.join(item.notes)}" for item in judged if not item.stable)


def missed_beside(judged: Sequence[Checks]) -> tuple[str, ...]:
    """The other limits that the blocks miss, in words."""
    return tuple(
        f"{item.label}: {_said(check)}"
        for item in judged
        for check in item.failed
        if not check.name.startswith(_DIVERGES)
    )


def _said(check: Check) -> str:
    value, limit = with_unit(check.value, check.unit), check.limit or 0.0
    detail = f", {check.detail}" if check.detail else ""
    return f"{check.title} {value} (limit {check.relation} {limit:.4g}){detail}"
