"""The machine: its drawing, what `check` says of it, its tables to be edited with their units.

What is typed is written only where the file with it is a machine; until then the last one stays,
and the sentence of the machine file stands beside the field that it names. Who edits tells the
fingerprint of the text that was read: an edit of a text that has changed since is refused.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping
from typing import Any

from ambrose.annexes.workbench import beginning, blocks
from ambrose.annexes.workbench.blocks import Block, Refusal
from ambrose.annexes.workbench.given import texts, width, word
from ambrose.annexes.workbench.project import MACHINE, Project
from ambrose.annexes.workbench.screens import Answer, Screen
from ambrose.core.checks import InvalidInput
from ambrose.machine.file.fields import beside, fields_of, tables_of, with_fields
from ambrose.machine.file.toml import loads_machine, read_machine_text
from ambrose.machine.limits import TOML_BYTES
from ambrose.machine.machine import Machine
from ambrose.report.page import Cell
from ambrose.report.svg import svg

_WIDEST = 1000  # [px] of the drawing
_FIELDS = 4000  # of one form at most


def show(project: Project, given: Mapping[str, Any]) -> dict[str, Any]:
    """The whole screen, or where there is no machine yet how to begin."""
    if not project.machine.is_file():
        return blocks.content(beginning.forms(project))
    text = read_machine_text(project.machine)
    try:
        machine = loads_machine(text, MACHINE)
    except InvalidInput as error:
        lead = blocks.words("problem", str(error), "The file is no machine", "bad")
        return blocks.content([lead, _whole_text(text)], stamp=stamp_of(text))
    tables = [_table_form(text, name, title) for name, title in tables_of(text)]
    rest = [*tables, _whole_text(text), *beginning.forms(project)]
    return blocks.content([*_seen(machine, given), *rest], stamp=stamp_of(text))


def _seen(machine: Machine, given: Mapping[str, Any]) -> list[Block]:
    """The drawing and what `check` says."""
    from ambrose.chain.facts_in_words import rows_of
    from ambrose.chain.plants import facts
    from ambrose.report.figures.rotor_drawing import machine_drawing

    drawing = svg(
        machine_drawing(machine),
        min(width(given), _WIDEST),
        f"The rotor of {machine.name}",
        "rotor",
    )
    known = facts(machine)
    doubts = [(Cell("implausible", "fail"), doubt) for doubt in known["doubts"]]
    remarks = [(Cell("note", "muted"), remark) for remark in known["remarks"]]
    rows = [*doubts, *rows_of(known), *remarks]
    return [
        blocks.picture("drawing", drawing, machine.name, machine.description),
        blocks.same(
            f"ambrose check {MACHINE}",
            f'machine = amb.load_machine("{MACHINE}")',
            "amb.plot(machine).show()",
        ),
        blocks.table("check", blocks.rows_table("What check says", ("quantity", "value"), rows)),
    ]


def stamp_of(text: str) -> str:
    """The fingerprint of a text."""
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def _table_form(text: str, table: str, title: str) -> Block:
    """The values of one table, each with the heading of its entry."""
    fields = []
    last = ""
    for name, (where, value) in fields_of(text).items():
        if name.partition(".")[0] != table:
            continue
        place = name.split(".")
        known = blocks.field(name, place[-1], value)
        if where != last:
            known["heading"] = where
            last = where
        fields.append(known)
    buttons = [blocks.button("Save", "save", main=True)]
    return blocks.form(f"table-{table}", fields, buttons, title, folded=True)


def _whole_text(text: str) -> Block:
    hint = "A quantity is a number in SI units or a text with its unit, such as 0.5 mm."
    return blocks.form(
        "text",
        [blocks.field("text", MACHINE, text, "area")],
        [blocks.button("Save", "write", main=True)],
        "The whole file",
        folded=True,
        hint=hint,
    )


# what is written


def _then(way: Callable[[Project, Mapping[str, Any]], str]) -> Answer:
    """An action that says what it did and shows what there is then."""

    def action(project: Project, given: Mapping[str, Any]) -> dict[str, Any]:
        told = way(project, given)
        return {**show(project, given), "told": told}

    return action


def _save(project: Project, given: Mapping[str, Any]) -> dict[str, Any]:
    """Fields by their place; only what differs from the file is written."""
    text = _current(project, given)
    return _keep(project, given, text, with_fields(text, texts(given, _FIELDS)))


def _write(project: Project, given: Mapping[str, Any]) -> dict[str, Any]:
    """The whole text."""
    text = _current(project, given)
    new = word(given, "text", TOML_BYTES).replace("\r\n", "\n")
    return _keep(project, given, text, new)


def _current(project: Project, given: Mapping[str, Any]) -> str:
    """The text of the file, which must be the one that the page showed."""
    text = read_machine_text(project.machine)
    if given.get("stamp") != stamp_of(text):
        raise Refusal(
            f"{MACHINE} was changed meanwhile, here or by another; nothing was written: look at "
            "what stands there now (Reload) and change it again",
            stale=True,
        )
    return text


def _keep(project: Project, given: Mapping[str, Any], before: str, text: str) -> dict[str, Any]:
    """The text written, if it is a machine's. Raises Refusal with a sentence for each field."""
    from ambrose.machine.atomic_write import write_text

    try:
        loads_machine(text, MACHINE)
    except InvalidInput as error:
        raise Refusal(str(error), beside(error, text, MACHINE)) from None
    if text != before:
        write_text(project.machine, text, "machine file")
    return {**show(project, given), "told": f"{MACHINE} is saved."}


_WAYS = {"begin": beginning.bundled, "template": beginning.template, "take": beginning.take}
SCREEN = Screen(
    show, {"save": _save, "write": _write, **{name: _then(way) for name, way in _WAYS.items()}}
)
