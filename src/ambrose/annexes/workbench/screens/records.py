"""Records: a file is dropped, its columns are mapped where they are another program's, and it is
seen and judged against the machine.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import tomlkit

from ambrose.annexes.workbench import blocks, pages
from ambrose.annexes.workbench.blocks import Block, Refusal
from ambrose.annexes.workbench.given import texts, width, word
from ambrose.annexes.workbench.project import MACHINE, Project
from ambrose.annexes.workbench.screens import Screen
from ambrose.core.checks import InvalidInput
from ambrose.machine.atomic_write import write_text
from ambrose.machine.file.toml import load_machine
from ambrose.machine.machine import Machine
from ambrose.record.column_map import columns_in_words, read_columns
from ambrose.record.files import read_record, write_record
from ambrose.record.foreign import read_foreign, variables_in_words
from ambrose.report.record import record_page

OWN = (".h5", ".hdf5", ".csv")
_LIVE = re.compile(r"live-(.+)-\d{8}-\d{6}(?:-\d+)?\.h5")
_KINDS = {"y": "um", "e": "A", "u": "A", "i": "A"}  # of signals of an axis, and usual units
_FIELDS = 500


def show(project: Project, given: Mapping[str, Any]) -> dict[str, Any]:
    """The files there are, and the one that is looked at."""
    names = [name for name in project.names("records") if not name.endswith(".toml")]
    chosen = word(given, "file")
    if chosen not in names:
        chosen = names[0] if names else ""
    drop = blocks.field("drop", "Drop a record here, or choose a file", kind="file", to="records")
    fields = [drop]
    if names:
        known = blocks.choice("file", "Record", names, chosen)
        fields.append({**known, "action": "look"})
    hint = "Records of the live rig stand here too. Other programs' files: MATLAB, TDMS, text, UFF."
    found = [blocks.form("files", fields, title="Records", hint=hint)]
    if chosen:
        found += _looked(project, chosen, width(given))
    return blocks.content(found)


def run_fields(project: Project) -> list[Block]:
    """The record of a run, the newest one at first, and the controller that ran."""
    records = [name for name in project.names("records") if name.endswith(OWN)]
    newest = project.newest("records", OWN)
    controllers = project.names("controllers")
    # the live rig writes the controller's name into the record's
    ran = _LIVE.fullmatch(newest)
    named = f"{ran[1]}.json" if ran else ""
    known = named if named in controllers else "pid.json"
    return [
        blocks.choice("record", "Record", records, newest),
        blocks.choice("controller", "Controller that ran", controllers, known),
    ]


def _looked(project: Project, name: str, wide: int) -> list[Block]:
    """A record with its verdicts and pictures, or what is wrong with it."""
    path = project.path("records", name)
    machine = load_machine(project.machine)
    if path.suffix.lower() not in OWN:
        return [_mapping(path, machine)]
    try:
        record = read_record(path)
        page = record_page(record, machine)
    except InvalidInput as error:
        said = str(error).replace(f"{path.parent}/", "")
        refused = blocks.words("refused", said, f"{name} is no record of this machine", "bad")
        return [refused, *([_mapping(path, machine)] if path.suffix == ".csv" else [])]
    report = f"reports/{path.stem}.html"
    same = blocks.same(
        f"ambrose identify {MACHINE} records/{name} --controller controllers/pid.json",
        "from ambrose.report.page import page_of, write",
        f'machine = amb.load_machine("{MACHINE}")',
        f'record = amb.read_record("records/{name}")',
        f'write(page_of(record, machine), "{report}")',
    )
    return [*pages.blocks_of(page, wide), same]


def _mapping(path: Path, machine: Machine) -> Block:
    """Which variable of the file is which signal; what is left empty is left out."""
    fields = [
        blocks.field("rate", "Sample rate [Hz], where the file has none"),
        blocks.field("time", "Variable of the times, where there is one"),
        blocks.field("time.unit", "Unit of the times", "s"),
        blocks.field("speed", "Speed", "0 rpm"),
        blocks.field("pressure", "Seal pressure", "0 bar"),
    ]
    for kind, unit in _KINDS.items():
        for axis in machine.axes:
            name = f"{kind}_{axis}"
            fields.append(blocks.field(f"from.{name}", f"{name} is"))
            fields.append(blocks.field(f"unit.{name}", f"Unit of {name}", unit))
    return blocks.form(
        "mapping",
        [*fields, blocks.field("source", "File", path.name)],
        [blocks.button("Read it", "map", main=True)],
        f"{path.name}: which column is what",
        hint=f"{variables_in_words(path)} A factor may stand before the name, such as -2 * probe.",
    )


def _map(project: Project, given: Mapping[str, Any]) -> dict[str, Any]:
    """The column map beside the file, and the record that it gives."""
    path = project.path("records", given.get("source"))
    said = {key: text.strip() for key, text in texts(given, _FIELDS).items()}
    machine = load_machine(project.machine)
    names = [f"{kind}_{axis}" for kind in _KINDS for axis in machine.axes]
    try:
        document = columns_in_words(machine.name, names, said)
        columns = read_columns(document, "the columns")
        record = read_foreign(path, columns)
    except InvalidInput as error:
        raise Refusal(str(error).replace(f"{path.parent}/", "")) from None
    target = project.free("records", path.stem)
    kept = project.free("records", f"{target.stem}-columns", ".toml")
    write_text(kept, tomlkit.dumps(document), "column map")
    write_record(record, target)
    told = f"records/{target.name} and records/{kept.name} are written."
    return {**show(project, {**given, "file": target.name}), "told": told}


SCREEN = Screen(show, {"look": show, "map": _map})
