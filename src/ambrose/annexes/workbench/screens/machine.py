"""The machine: its drawing, what `check` says of it, its tables to be edited with their units.

What is typed is written only where the file with it is a machine; until then the last one stays,
and the sentence of the machine file stands beside the field that it names. Who edits tells the
fingerprint of the text that was read: an edit of a text that has changed since is refused.
"""

import hashlib
import re
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import tomlkit

from ambrose.annexes.workbench import blocks, blocks as pages, project as beginning
from ambrose.annexes.workbench.blocks import Block, Refusal, texts, width, word
from ambrose.annexes.workbench.project import MACHINE, Project
from ambrose.annexes.workbench.screens import Answer, Screen
from ambrose.annexes.workbench.svg import svg
from ambrose.chain.check import facts, free_mode_rows, rows_of as rows_of_facts
from ambrose.core.checks import InvalidInput
from ambrose.machine.file.stations import rotor_of_stations
from ambrose.machine.file.toml import load_machine, loads_machine, read_machine_text
from ambrose.machine.file.update import (
    beside,
    cells_of,
    fields_of,
    rows_of,
    tables_of,
    with_fields,
    with_rows,
)
from ambrose.machine.machine import Machine
from ambrose.machine.ordinary_file import TOML_BYTES, write_text
from ambrose.machine.part import MATERIALS, Material
from ambrose.model.assemble import bending_modes_of
from ambrose.model.effects.rotor import finite_element_rotor, mass_properties
from ambrose.record.files import read_record, write_record
from ambrose.record.foreign import columns_in_words, read_columns, read_foreign, variables_in_words
from ambrose.report import theme
from ambrose.report.page import Cell
from ambrose.report.record import record_page

_WIDEST = 1000  # [px] of the drawing
_FIELDS = 4000  # of one form at most


def show_machine(project: Project, given: Mapping[str, Any]) -> dict[str, Any]:
    """The whole screen, or where there is no machine yet how to begin."""
    if not project.machine.is_file():
        return blocks.content(beginning.forms(project))
    text = read_machine_text(project.machine)
    try:
        machine = loads_machine(text, MACHINE)
    except InvalidInput as error:
        lead = blocks.words("problem", str(error), "The file is no machine", "bad")
        return blocks.content([lead, _whole_text(text)], stamp=stamp_of(text))
    grid = _grid(text, machine)
    tables = [
        _table_form(text, name, title)
        for name, title in tables_of(text)
        if grid["kind"] == "words" or name not in _CELLS
    ]
    rest = [*tables, _whole_text(text), *beginning.forms(project)]
    return blocks.content([grid, *_seen(machine, given), *rest], stamp=stamp_of(text))


def _drawn(machine: Machine, given: Mapping[str, Any]) -> list[Block]:
    """The rotor with its first modes, and where these have nodes."""
    from ambrose.report.figures.rotor_drawing import machine_drawing

    rotor = finite_element_rotor(machine)
    count = min(_MODES, bending_modes_of(rotor))
    with theme.bare():
        figure = machine_drawing(machine, count, rigid=False)
    words = f"The rotor of {machine.name}"
    drawing = svg(figure, min(width(given), _WIDEST), words, "rotor")
    properties = mass_properties(rotor)
    note = f"{properties.mass:.5g} kg, centre of mass at {1e3 * properties.centre:.5g} mm."
    fixed = [str(mode.number) for mode in machine.bending_modes if mode.frequency is not None]
    if fixed:
        note += f" [[bending_mode]] sets the measured frequency of mode {', '.join(fixed)}."
    columns = ("mode", "frequency", "at magnets and sensors")
    known = blocks.rows_table(
        "Free-free bending modes",
        columns,
        [(*row[:2], row[2] or "-") for row in free_mode_rows(machine, count)],
    )
    return [
        blocks.picture("drawing", drawing, machine.name, machine.description),
        blocks.table("modes", replace(known, note=note)),
    ]


def _seen(machine: Machine, given: Mapping[str, Any]) -> list[Block]:
    """The drawing and what `check` says."""
    known = facts(machine)
    doubts = [(Cell("implausible", "fail"), doubt) for doubt in known["doubts"]]
    remarks = [(Cell("note", "muted"), remark) for remark in known["remarks"]]
    rows = [*doubts, *rows_of_facts(known), *remarks]
    verdict = "PASSED: no entry of the machine file is implausible."
    if known["doubts"]:
        verdict = f"IMPLAUSIBLE: {known['doubts'][0]}"
    return [
        blocks.words("verdict", verdict, tone="bad" if known["doubts"] else "good"),
        *_drawn(machine, given),
        blocks.same(
            f"ambrose check {MACHINE}",
            f'machine = amb.load_machine("{MACHINE}")',
            "amb.plot(machine).show()",
        ),
        blocks.table("check", blocks.rows_table("Properties", ("quantity", "value"), rows)),
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


# The shaft and its discs as a spreadsheet, drawn while it is edited.


_MODES = 4
_ROWS = 2000  # of a grid
# keys and units of the cells; names as in a table of stations; all columns but those in _FIRST are
# hidden at first where no row of the file has them
_CELLS = {
    "shaft": {
        "length": "mm",
        "outer_diameter": "mm",
        "inner_diameter": "mm",
        "end_outer_diameter": "mm",
        "end_inner_diameter": "mm",
        "mass_diameter": "mm",
        "elements": "",
        "material": "",
        "label": "",
    },
    "disc": {
        "name": "",
        "position": "mm",
        "mass": "kg",
        "polar_inertia": "kg m^2",
        "diametral_inertia": "kg m^2",
    },
}
_COLUMNS = {
    "outer_diameter": "od",
    "inner_diameter": "id",
    "end_outer_diameter": "od right",
    "end_inner_diameter": "id right",
    "mass_diameter": "mass od",
    "polar_inertia": "Ip",
    "diametral_inertia": "It",
}
_FIRST = {"length", "outer_diameter", "inner_diameter", "elements", *_CELLS["disc"]}


def _grid(text: str, machine: Machine, document: Any = None) -> Block:
    """The rows of the file, or these; of a rotor that has none, what to do."""
    if machine.measured_rotor is not None:
        told = "[measured_rotor] states the modes: take it out of the file to edit stations here."
        return blocks.words("grid", told, "Stations", "muted")
    known = rows_of(text, _CELLS)
    used = {key for rows in known.values() for row in rows for key in row}
    columns = {
        name: [
            [key, _COLUMNS.get(key, key), unit, key in _FIRST | used] for key, unit in keys.items()
        ]
        for name, keys in _CELLS.items()
    }
    hint = (
        "Paste cells of a spreadsheet, or a whole table of stations with its row of names. "
        "Positions count from the left end; bearings and sensors keep theirs."
    )
    rows = document or known
    return blocks.grid("grid", "Stations", rows, columns, hint=hint, side=True)


def _edited(project: Project, given: Mapping[str, Any]) -> tuple[str, str, Machine]:
    """The text of the file, the one with the rows of the page, and its machine. Raises Refusal."""
    before, rows = _current(project, given), given.get("rows")
    kept: dict[str, dict[int, dict[str, Any]]] = {}
    for name, keys in _CELLS.items():
        listed = rows.get(name) if isinstance(rows, dict) else None
        listed = listed if isinstance(listed, list) else [listed]
        if len(listed) > _ROWS or not all(isinstance(row, dict) for row in listed):
            raise InvalidInput(f"the grid is no table of {_ROWS} rows at most; reload the page")
        cells = [{key: word(row, key).strip() for key in keys} for row in listed]
        # a row without a word is none
        kept[name] = {
            i: {**row, "was": listed[i].get("was")}
            for i, row in enumerate(cells)
            if any(row.values())
        }
    wanted = {name: list(found.values()) for name, found in kept.items()}
    after, faults = with_rows(before, wanted, _CELLS)
    told = "; ".join(faults.values())
    if not faults:
        try:
            return before, after, loads_machine(after, MACHINE)
        except InvalidInput as error:
            told, faults = str(error), beside(error, after, MACHINE)
    own = {}
    for place, fault in faults.items():
        name, number, key = [*place.split(".", 2), "", ""][:3]
        if name in kept:  # each row where the page has it
            own[f"{name}.{[*kept[name]][int(number)]}.{key}"] = fault
    raise Refusal(told, own)


def _look(project: Project, given: Mapping[str, Any]) -> dict[str, Any]:
    """The rotor of the rows that are edited; what `check` says waits for the file."""
    before, after, machine = _edited(project, given)
    if after == before:
        return blocks.content(_seen(machine, given), whole=False)
    verdict = blocks.words("verdict", "No result yet: Save checks the edited rotor.", tone="muted")
    return blocks.content([verdict, *_drawn(machine, given)], whole=False, gone=["check"])


def _save_rows(project: Project, given: Mapping[str, Any]) -> dict[str, Any]:
    """The rows into the file."""
    return _keep(project, given, *_edited(project, given)[:2])


def _take_stations(project: Project, given: Mapping[str, Any]) -> dict[str, Any]:
    """A table of stations that was pasted with its names, in place of the rows; without discs in
    it, these stay.
    """
    text = read_machine_text(project.machine)
    machine, rows = loads_machine(text, MACHINE), rows_of(text, _CELLS)
    rotor = rotor_of_stations(word(given, "table", TOML_BYTES), "the pasted table")
    known = {**MATERIALS, **{part.material.name: part.material for part in machine.shaft}}
    taken: dict[str, list[dict[str, Any]]] = {"shaft": [], "disc": []}
    for part in rotor.shaft:
        made, named = part.material, part.material.name
        alike = [name for name, had in known.items() if replace(had, name=named) == made]
        if made != Material() and not alike and made != MATERIALS.get(named):
            raise InvalidInput(
                f"the pasted table has a material of {made.youngs_modulus / 1e9:.4g} GPa and "
                f"{made.density:.5g} kg/m^3, which the machine file lacks; add a [material.NAME] "
                "table with them, then paste again"
            )
        name = named if named in alike or not alike else alike[0]
        taken["shaft"].append({**part.to_dict(), "material": "" if made == Material() else name})
    taken["disc"] = [part.to_dict() for part in rotor.discs]
    for name, parts in taken.items():
        if parts:
            same = len(parts) == len(rows[name])  # of as many rows each keeps its comments
            short = [
                {k: float(f"{v:.12g}") if isinstance(v, float) else v for k, v in part.items()}
                for part in parts
            ]
            rows[name] = [
                {"was": i if same else None, **cells_of(part, name, _CELLS[name])}
                for i, part in enumerate(short)
            ]
    return blocks.content([{**_grid(text, machine, rows), "fresh": True}], whole=False)


# what is written


def _then(way: Callable[[Project, Mapping[str, Any]], str]) -> Answer:
    """An action that says what it did and shows what there is then."""

    def action(project: Project, given: Mapping[str, Any]) -> dict[str, Any]:
        told = way(project, given)
        return {**show_machine(project, given), "told": told}

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
            f"{MACHINE} has changed since it was read; nothing was written: reload it and "
            "change it again",
            stale=True,
        )
    return text


def _keep(project: Project, given: Mapping[str, Any], before: str, text: str) -> dict[str, Any]:
    """The text written, if it is a machine's. Raises Refusal with a sentence for each field."""
    try:
        loads_machine(text, MACHINE)
    except InvalidInput as error:
        raise Refusal(str(error), beside(error, text, MACHINE)) from None
    if text != before:
        write_text(project.machine, text, "machine file")
    return {**show_machine(project, given), "told": f"{MACHINE} is saved."}


_WAYS = {"begin": beginning.bundled, "template": beginning.template, "take": beginning.take}
SCREEN_MACHINE = Screen(
    show_machine,
    {
        "save": _save,
        "write": _write,
        "look": _look,
        "rows": _save_rows,
        "stations": _take_stations,
        **{name: _then(way) for name, way in _WAYS.items()},
    },
)


# Records: a file is dropped, its columns are mapped where they are another program's, and it is
# seen and judged against the machine.


OWN = (".h5", ".hdf5", ".csv")
_LIVE = re.compile(r"live-(.+)-\d{8}-\d{6}(?:-\d+)?\.h5")
_KINDS = {"y": "um", "e": "A", "u": "A", "i": "A"}  # of signals of an axis, and usual units
_FIELDS_RECORDS = 500


def show_records(project: Project, given: Mapping[str, Any]) -> dict[str, Any]:
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
    hint = (
        "Records of the live rig are listed, too. Files of other programs: MATLAB, TDMS, text, UFF."
    )
    found = [blocks.form("files", fields, title="Records", hint=hint)]
    none = blocks.words("verdict", "No result yet: there is no record.", tone="muted")
    first, *rest = _looked(project, chosen, width(given)) if chosen else [none]
    return blocks.content([first, *found, *rest])


def run_fields(project: Project) -> list[Block]:
    """The record of a run, the newest one at first, and the controller that ran."""
    records = [name for name in project.names("records") if name.endswith(OWN)]
    newest = project.newest("records", OWN)
    controllers = project.names("controllers")
    # the live rig writes the controller's name into the record's
    ran = _LIVE.fullmatch(newest)
    alike = [name for name in controllers if ran and name.partition(".")[0] == ran[1]]
    known = (*alike, "pid.json")[0]
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
    said = {key: text.strip() for key, text in texts(given, _FIELDS_RECORDS).items()}
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
    return {**show_records(project, {**given, "file": target.name}), "told": told}


SCREEN_RECORDS = Screen(show_records, {"look": show_records, "map": _map})
