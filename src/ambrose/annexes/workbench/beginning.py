"""How a project gets its machine: a bundled one, a shaft in a few words, a file that is dropped (a
machine file, a model of ROSS, a table of stations). One that was there before is kept.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from ambrose.annexes.workbench import blocks
from ambrose.annexes.workbench.blocks import Block, Refusal
from ambrose.annexes.workbench.given import word
from ambrose.annexes.workbench.project import MACHINE, Project, begin
from ambrose.chain.new_machine import new_machine, text_of_file
from ambrose.core.checks import InvalidInput
from ambrose.machine.atomic_write import write_text
from ambrose.machine.file.toml import bundled_machines, loads_machine, read_machine_text
from ambrose.machine.file.update import machine_text

_SHAFT = {"length": "600 mm", "diameter": "40 mm", "speed": "12000 rpm"}


def forms(project: Project) -> list[Block]:
    """The ways to a machine; folded where there is one already."""
    there = project.machine.is_file()
    found = []
    if not there:
        known = blocks.choice("machine", "Machine", list(bundled_machines()), "seal-rig")
        title = "This folder has no machine yet"
        found.append(
            blocks.form("begin", [known], [blocks.button("Begin", "begin", main=True)], title)
        )
        shaft = [blocks.field(key, key.capitalize(), text) for key, text in _SHAFT.items()]
        stands = blocks.field("vertical", "It stands upright", False, "check")
        button = blocks.button("Make it", "template", main=True)
        hint = "All the rest is chosen so that it levitates, and marked as assumed."
        title = "A plain shaft to start from"
        found.append(blocks.form("template", [*shaft, stands], [button], title, hint=hint))
    drop = blocks.field("drop", "Drop a file here, or choose it", kind="file", to="machines")
    files = project.names("machines")
    fields = [drop]
    buttons = []
    if files:
        fields += [
            blocks.choice("source", "Taken from", files),
            blocks.field("speed", "Highest speed, for a rotor alone", "0 rpm"),
        ]
        buttons = [blocks.button("Take it", "take", main=True)]
    hint = f"A machine file, a model of ROSS, a table of stations. {MACHINE} of before is kept."
    title = "A machine from a file"
    found.append(blocks.form("import", fields, buttons, title, folded=there, hint=hint))
    return found


def bundled(project: Project, given: Mapping[str, Any]) -> str:
    """A bundled machine becomes the machine; what was done, in words."""
    begin(project, given.get("machine"))
    return f"{MACHINE} is written."


def template(project: Project, given: Mapping[str, Any]) -> str:
    """A plain shaft becomes the machine; what was done, in words."""
    said: dict[str, Any] = {key: word(given, key) for key in _SHAFT}
    try:
        machine = new_machine(project.root.name, vertical=given.get("vertical") is True, **said)
    except InvalidInput as error:
        beside = {key: str(error) for key in _SHAFT if str(error).startswith(key)}
        raise Refusal(str(error), beside) from None
    return keep(project, machine_text(machine))


def take(project: Project, given: Mapping[str, Any]) -> str:
    """A file of the folder machines becomes the machine; what was done, in words."""
    path = project.path("machines", given.get("source"))
    text = text_of_file(path, word(given, "speed"))
    try:
        loads_machine(text, path.name)
    except InvalidInput as error:
        raise Refusal(str(error)) from None
    return keep(project, text)


def keep(project: Project, text: str) -> str:
    """A text as the machine file, the one before beside it; what was done, in words."""
    told = f"{MACHINE} is written."
    if project.machine.is_file():
        before = project.free("machines", "before")
        write_text(before, read_machine_text(project.machine), "machine file")
        told += f" What it was is machines/{before.name}."
    write_text(project.machine, text, "machine file")
    return told
