"""The machine: its drawing, what `check` says of it, its tables to be edited with their units.

What is typed is written only where the file with it is a machine; until then the last one stays,
and the sentence of the machine file stands beside the field that it names. Who edits tells the
fingerprint of the text that was read: an edit of a text that has changed since is refused.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from typing import Any

from ambrose.annexes.workbench import beginning, blocks
from ambrose.annexes.workbench.blocks import Block, Refusal
from ambrose.annexes.workbench.given import texts, width, word
from ambrose.annexes.workbench.project import MACHINE, Project
from ambrose.annexes.workbench.screens import Answer, Screen
from ambrose.core.checks import InvalidInput
from ambrose.machine.file.parse import called
from ambrose.machine.file.toml import loads_machine, read_machine_text
from ambrose.machine.limits import TOML_BYTES
from ambrose.machine.machine import Machine
from ambrose.report.page import Cell
from ambrose.report.svg import svg

_WIDEST = 1000  # [px] of the drawing
_FIELDS = 4000  # of one form at most
Place = tuple[str | int, ...]


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
    tables = [_table_form(text, name, title) for name, title in _tables(text)]
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


# the tables of a file and their fields


def _document(text: str) -> Any:
    import tomlkit

    return tomlkit.parse(text)


def _tables(text: str) -> list[tuple[str, str]]:
    """Name and heading of every table at the top of the file."""
    document = _document(text)
    return [
        (name, f"[[{name}]]" if isinstance(value, list) else f"[{name}]")
        for name, value in document.items()
        if isinstance(value, list | dict)
    ]


def _entries(value: Any, place: Place, where: str) -> Iterator[tuple[Place, str, Any]]:
    """Place, heading and value of everything below a table that is no table itself."""
    if isinstance(value, dict):
        for key, below in value.items():
            if key == "assumed":  # reasons, in many words
                continue
            name = ".".join(str(part) for part in (*place, key) if isinstance(part, str))
            if isinstance(below, dict):
                heading = f"{where}, [{name}]" if where and len(place) > 1 else f"[{name}]"
                yield from _entries(below, (*place, key), heading)
            elif isinstance(below, list) and below and isinstance(below[0], dict):
                yield from _listed(below, (*place, key), where if len(place) > 1 else "", name)
            else:
                yield (*place, key), where, below


def _listed(value: Any, place: Place, where: str, name: str) -> Iterator[tuple[Place, str, Any]]:
    """As ``_entries``, of tables in double brackets."""
    for i, entry in enumerate(value):
        heading = f"[[{name}]] {called(entry, name.rpartition('.')[2], i + 1)}"
        yield from _entries(entry, (*place, i), f"{where}, {heading}" if where else heading)


def fields_of(text: str) -> dict[str, tuple[str, str]]:
    """Of every value of a machine file: its heading as messages have it, and how it is written;
    under its place, "bearing.0.gap".
    """
    document = _document(text)
    found: dict[str, tuple[str, str]] = {}
    for name, value in document.items():
        if isinstance(value, list):
            entries = _listed(value, (name,), "", name)
        else:
            entries = _entries(value, (name,), f"[{name}]")
        for place, where, item in entries:
            found[".".join(map(str, place))] = where, _written(item)
    return found


def _written(item: Any) -> str:
    """A value as it stands in the file; texts without their quotes."""
    return str(item) if isinstance(item, str) else item.as_string()


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
    document = _document(text)
    before = fields_of(text)
    for name, value in texts(given, _FIELDS).items():
        if name in before and value != before[name][1]:
            _set(document, name.split("."), value)
    return _keep(project, given, text, document.as_string())


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


def _set(document: Any, place: list[str], value: str) -> None:
    """A value at its place, a text unless it reads as a number, a list or true and false; taken out
    where nothing is given.
    """
    import tomlkit
    from tomlkit.exceptions import TOMLKitError

    item = document
    for part in place[:-1]:
        item = item[int(part)] if part.isdecimal() and isinstance(item, list) else item[part]
    text = value.strip()
    if not text:
        item.remove(place[-1])
        return
    new: Any = text
    if not isinstance(item[place[-1]], str) or re.match(r"[-+\d\[]", text):
        with suppress(TOMLKitError, ValueError):
            new = tomlkit.value(text)
    item[place[-1]] = new


def _keep(project: Project, given: Mapping[str, Any], before: str, text: str) -> dict[str, Any]:
    """The text written, if it is a machine's. Raises Refusal with a sentence for each field."""
    from ambrose.machine.atomic_write import write_text

    try:
        loads_machine(text, MACHINE)
    except InvalidInput as error:
        raise Refusal(str(error), _beside(error, text)) from None
    if text != before:
        write_text(project.machine, text, "machine file")
    return {**show(project, given), "told": f"{MACHINE} is saved."}


def _beside(error: InvalidInput, text: str) -> dict[str, str]:
    """The sentences of a refusal by the fields that they are about."""
    lines = getattr(error, "problems", None) or [
        line.removeprefix("  - ").removeprefix(f"{MACHINE}: ") for line in str(error).splitlines()
    ]
    with suppress(Exception):  # what is no TOML has no fields
        found: dict[str, str] = {}
        for name, (where, _) in fields_of(text).items():
            key = name.rpartition(".")[2]
            about = [line for line in lines if _is_about(line, where, key)]
            if about:
                found[name] = " ".join(about)
        return found
    return {}


def _is_about(line: str, where: str, key: str) -> bool:
    """Whether a sentence begins with a place and a key."""
    head = f"{where}: "
    begins = rf'(unknown key ")?{re.escape(key)}\b'
    return line.startswith(head) and re.match(begins, line[len(head) :]) is not None


_WAYS = {"begin": beginning.bundled, "template": beginning.template, "take": beginning.take}
SCREEN = Screen(
    show, {"save": _save, "write": _write, **{name: _then(way) for name, way in _WAYS.items()}}
)
