"""The page of synchronous blocks: what they change over speed, their margin, and every check."""

from __future__ import annotations

from collections.abc import Sequence

from ambrose.judge.checks import Checks
from ambrose.machine.machine import Machine
from ambrose.report import tables
from ambrose.report.figures.synchronous import synchronous_figure
from ambrose.report.page import Figure, Page, Section, Verdict

_WORDS = (
    "A synchronous block takes one signal of the unbalance to zero while the rotor turns. "
    "Lines without the block are the loop as the other pages judge it; lines with it hold once "
    "it has converged. Between two pieces of a line the block is off.\n\n"
    "Unbalance is what the balance grade leaves, in the bearing planes, shared as is worst; of "
    "all seal pressures the worst one is drawn. The margin has a line for every pressure: it is "
    "the angle by which all phases of the loop may be off before a block of small gain "
    "diverges. The tables say over what it is proved, and what was only sampled."
)


def synchronous_section(blocks: Sequence[Checks]) -> Section:
    """A section for any page. blocks: the checks of ``judge.synchronous.check_block``."""
    with_curves = [block for block in blocks if block.curves]
    figures: tuple[Figure, ...] = ()
    if with_curves:
        words = (
            "Top to bottom: current, force, orbit and sensitivity before and after, and the margin "
            "of convergence."
        )
        figures = (Figure("Over speed, before and after", synchronous_figure(with_curves), words),)
    check_tables = tuple(tables.checks_table(block) for block in blocks if block.checks)
    return Section("Synchronous blocks", _WORDS, figures, check_tables)


def synchronous_page(
    machine: Machine,
    blocks: Sequence[Checks],
    *,
    left_out: Sequence[str] = (),
    loop: str = "",
    controller: str = "",
    date: str = "",
) -> Page:
    """A page of its own. left_out: bands in which no block may be on, each with its reason; loop,
    controller: which one was judged.
    """
    facts = (
        tables.machine_fact(machine),
        ("Controller", controller),
        ("Loop judged", loop),
        ("Left out", "; ".join(left_out)),
    )
    title = "Synchronous unbalance control"
    verdicts = tuple(map(tables.verdict, blocks))
    passed = all(block.passed for block in blocks)
    result = Verdict(
        "",
        passed,
        "every synchronous block passes" if passed else "not every synchronous block passes",
    )
    return Page(
        title, machine, (synchronous_section(blocks),), verdicts, facts, date, result=result
    )
