"""A machine file brought up to date: what changed is written in the user's unit and place, all else
stays as it stands. And one made for people: every number in an everyday unit, every key with its
meaning, what is assumed marked.
"""

import os
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import tomlkit
from tomlkit.container import Container
from tomlkit.exceptions import TOMLKitError
from tomlkit.items import AoT, Array, InlineTable, Item, String, Table

from ambrose.core.checks import InvalidInput, invalid
from ambrose.machine.attachment import attachments
from ambrose.machine.file.tables import Table as Model, ToleranceTable, machine_file, table_below
from ambrose.machine.file.toml import (
    dumps_machine,
    loads_machine,
    named_materials,
    read_machine_text,
    written,
    written_key,
)
from ambrose.machine.kinds import Quantity
from ambrose.machine.machine import Machine
from ambrose.machine.ordinary_file import write_text
from ambrose.machine.parameters import parse_parameter
from ambrose.machine.part import MATERIALS, SEAL_AXES
from ambrose.machine.units import DIMENSIONS, called, rewrite_quantity, shown

# The values of a machine file as fields of a form: where each stands, how it is written, what a
# refusal says of it, and the text with others in their places.
#
# A place is the keys and numbers down to a value, joined by dots: "bearing.0.gap".


_Place = tuple[str | int, ...]


def tables_of(text: str) -> list[tuple[str, str]]:
    """Name and heading of every table at the top of a machine file."""
    return [
        (name, f"[[{name}]]" if isinstance(value, list) else f"[{name}]")
        for name, value in tomlkit.parse(text).items()
        if isinstance(value, list | dict)
    ]


def fields_of(text: str) -> dict[str, tuple[str, str]]:
    """Of every value of a machine file, by its place: its heading as messages have it, and how it
    is written.
    """
    found: dict[str, tuple[str, str]] = {}
    for name, value in tomlkit.parse(text).items():
        if isinstance(value, list):
            entries = _listed(value, (name,), "", name)
        else:
            entries = _entries(value, (name,), f"[{name}]")
        for place, where, item in entries:
            found[".".join(map(str, place))] = where, _written(item)
    return found


def _entries(value: Any, place: _Place, where: str) -> Iterator[tuple[_Place, str, Any]]:
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


def _listed(value: Any, place: _Place, where: str, name: str) -> Iterator[tuple[_Place, str, Any]]:
    """As ``_entries``, of tables in double brackets."""
    for i, entry in enumerate(value):
        heading = f"[[{name}]] {called(entry, name.rpartition('.')[2], i + 1)}"
        yield from _entries(entry, (*place, i), f"{where}, {heading}" if where else heading)


def _written(item: Any) -> str:
    """A value as it stands in the file; texts without their quotes."""
    return str(item) if isinstance(item, str) else str(item.as_string())


def with_fields(text: str, values: Mapping[str, str]) -> str:
    """The text of a machine file with values by their place; only what differs from what stands
    there changes, a place that it does not have is passed over, an empty value is taken out.
    """
    document = tomlkit.parse(text)
    before = fields_of(text)
    for name, value in values.items():
        if name in before and value != before[name][1]:
            _set(document, name.split("."), value)
    return document.as_string()


def _set(document: Any, place: list[str], value: str) -> None:
    """A value at its place, a text unless it reads as a number, a list or true and false."""
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


def beside(error: InvalidInput, text: str, source: str) -> dict[str, str]:
    """The sentences of a refusal of a text, by the place of the value that each is about.

    source: what the refusal calls the text.
    """
    lines = getattr(error, "problems", None) or [
        line.removeprefix("  - ").removeprefix(f"{source}: ") for line in str(error).splitlines()
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


# A list of tables as rows of cells, as a spreadsheet has them: numbers in one unit, whichever the
# file has. A row says under "was" which entry it came from, so that it keeps its unit and comments.


# of every list its keys, with the unit of their cells
Cells = Mapping[str, Mapping[str, str]]


def rows_of(text: str, cells: Cells) -> dict[str, list[dict[str, Any]]]:
    """The entries of lists of a machine file as rows of cells, without the keys they lack."""
    document = tomlkit.parse(text)
    return {
        name: [
            {"was": i, **cells_of(entry, name, keys)}
            for i, entry in enumerate(document.get(name, ()))
        ]
        for name, keys in cells.items()
    }


def cells_of(entry: Any, name: str, keys: Mapping[str, str]) -> dict[str, str]:
    """The cells of one entry of a list, as the file has it or as a part says it (``to_dict``)."""
    found = {}
    for key, unit in keys.items():
        if key in entry:
            found[key] = str(value := _plain(entry[key]))
            if unit:
                dimension = _dimension(_entry_of(name), key, {})
                number = Quantity(dimension).read(value)
                known = rewrite_quantity(f"0 {unit}", number, DIMENSIONS[dimension])
                found[key] = known.removesuffix(f" {unit}")
    return found


def _entry_of(name: str) -> type[Model]:
    model = table_below(machine_file(), name)
    assert model is not None, "a list of tables"
    return model


def with_rows(
    text: str, rows: Mapping[str, Sequence[Mapping[str, Any]]], cells: Cells
) -> tuple[str, dict[str, str]]:
    """The text of a machine file with lists that have these rows, and what is wrong in a cell, by
    its place ("shaft.0.length"): with such a fault the text is of no use.

    Only cells that differ from the file change, in its unit; comments stay with their entries,
    those above a list with the list. A ``start`` in the shaft follows the lengths.
    """
    document = tomlkit.parse(text)
    tail, faults = _attach_comments(document), dict[str, str]()
    for name, wanted in rows.items():
        entries = list(document.get(name, ()))
        places, values = list[int | None](), list[Any]()
        for i, row in enumerate(wanted):
            was = row.get("was")
            fresh = was in places or not isinstance(was, int) or not 0 <= was < len(entries)
            places.append(None if fresh else was)
            entry = {} if was is None or fresh else entries[was]
            for key, fault in _set_cells(entry, name, row, cells[name]):
                faults[f"{name}.{i}.{key}"] = fault
            values.append(entry)
        if places != list(range(len(entries))):
            _place_entries(document, name, entries, places, values)
    if rows.get("shaft") and not faults:
        _follow_lengths(document["shaft"])
    return tomlkit.dumps(document) + tail, faults


def _place_entries(
    document: Any, name: str, entries: list[Any], places: list[int | None], values: list[Any]
) -> None:
    """The entries of a list in the order ``places``; None stands for a new one, with its values."""
    if not values:
        document.remove(name)
    elif not entries:
        _add(document, name, values)
    else:
        heads = [entry.trivia.indent for entry in entries]
        _reorder(document[name], entries, places, values)
        if not isinstance(document[name], Array) and places[0] != 0:  # the list keeps its head
            if 0 in places:
                document[name][places.index(0)].trivia.indent = "\n" * heads[-1].startswith("\n")
            first = document[name][0].trivia
            first.indent = heads[0] + first.indent.lstrip("\n")


def _set_cells(
    entry: Any, name: str, row: Mapping[str, Any], keys: Mapping[str, str]
) -> Iterator[tuple[str, str]]:
    """Bring an entry to the cells of a row; key and sentence of every cell that cannot be."""
    model, before = _entry_of(name), cells_of(entry, name, keys)
    for key, unit in keys.items():
        cell = str(row.get(key, "")).strip()
        if not cell and model.model_fields[key].is_required():
            yield key, f"{key} is missing"
        elif not cell:
            entry.pop(key, None)
        elif cell != before.get(key):
            stated = f"{cell} {unit}" if re.fullmatch(r"[-+\d.,eE]+", cell) and unit else cell
            dimension = _dimension(model, key, {})
            try:
                value = Quantity(dimension).read(stated) if unit else cell
            except ValueError as error:
                yield key, f"{key} {error}"
                continue
            if key == "elements" and re.fullmatch(r"\d+", cell):
                value = int(cell)
            entry[key] = (
                _rewritten(entry[key], value, dimension)
                if key in entry
                else stated
                if unit
                else value
            )


def _follow_lengths(shaft: Any) -> None:
    """Where a section states its start, it is the end of the one before."""
    end, length = 0.0, Quantity("length")
    for entry in shaft:
        if "start" in entry and abs(length.read(_plain(entry["start"])) - end) > 1e-9 * end:
            entry["start"] = _rewritten(entry["start"], float(f"{end:.12g}"), "length")
        end += length.read(_plain(entry["length"]))


_Plain = Mapping[str, Any]
# the key whose value tells the entries of a list apart; of other lists their order does
_IDENTITIES = {
    **dict.fromkeys(("disc", "bearing", "seal"), "name"),
    **dict.fromkeys(("sensor", "support"), "bearing"),
    "measured": "bias_current",
    "point": "label",
    "tolerance": "parameter",
}


def update_machine_file(text_or_path: str | os.PathLike[str], machine: Machine) -> str:
    """The text of a machine file with the values of ``machine``; reading it gives an equal machine.

    text_or_path: the file's text, or its path (or the name of a bundled machine). Only entries
    whose value differs change, and are written in the unit that stands there; comments, order and
    all other text stay, and what stands above a table goes with it. New keys and tables follow
    those of their kind, with the units that ``annotated_machine`` writes. Raises InvalidInput where
    the file is no machine.
    """
    is_text = isinstance(text_or_path, str) and "\n" in text_or_path
    text = str(text_or_path if is_text else read_machine_text(text_or_path)).replace("\r\n", "\n")
    loads_machine(text)
    try:
        document = tomlkit.parse(text)
        tail = _attach_comments(document)
        _update_document(document, machine)
        updated = tomlkit.dumps(document) + tail
        if loads_machine(updated) == machine:
            return updated
    except (TOMLKitError, ValueError):  # a form of TOML that tomlkit does not take, or cannot edit
        pass
    return dumps_machine(machine)


def machine_text(machine: Machine) -> str:
    """A machine as TOML text: the file that it was read from brought up to date, or else anew in SI
    numbers. An axis along the shaft is written with its whole machine.
    """
    machine = machine.whole or machine
    return (
        update_machine_file(machine.file_text, machine)
        if machine.file_text
        else dumps_machine(machine)
    )


def save_machine(machine: Machine, path: str | os.PathLike[str]) -> Path:
    """Write a machine as TOML (``machine_text``), complete or not at all; reading it gives an equal
    machine. Returns the path.

    Raises InvalidInput for a path that cannot be written.
    """
    if not isinstance(machine, Machine):
        raise invalid(
            "the machine to save",
            shown(machine),
            "a Machine",
            "give what load_machine or identify returned",
        )
    return write_text(path, machine_text(machine), "machine file")


def _update_document(document: tomlkit.TOMLDocument, machine: Machine) -> None:
    whole, given = machine.to_dict(defaults=True), machine.to_dict()
    whole.setdefault("material", {})  # those that no section names stay
    if "channel" in given.get("controller", {}) and "channel" not in document.get("controller", {}):
        # chains replace all else: of an earlier controller no default stays
        whole["controller"] = {
            key: value for key, value in whole["controller"].items() if key in given["controller"]
        }
    _update_assumed(document["machine"], machine.assumed)
    used = zip(machine.shaft, given["shaft"], strict=True)
    named = {table["material"]: section.material for section, table in used if "material" in table}
    materials = named_materials(document.unwrap()) | named
    end, entries = 0.0, document["shaft"]
    for i, section in enumerate(machine.shaft):
        if section.start == end:
            del given["shaft"][i]["start"]  # which is what a file means that leaves it out
        end = section.start + section.length
        name = entries[i].get("material") if i < len(entries) else None
        if name is not None and materials.get(str(name)) == section.material:
            whole["shaft"][i]["material"] = given["shaft"][i]["material"] = str(name)
    for known in {*whole["material"]} - {*document.get("material", {})}:
        if MATERIALS.get(known) == materials.get(known):  # known without a table
            del whole["material"][known]
            given.get("material", {}).pop(known, None)
    for seal, every in zip(given.get("seal", ()), whole["seal"], strict=False):
        table = seal.get("table", {})
        for key in ("scales_with_pressure", *table):
            if key not in seal:
                every.pop(key, None)  # what the table replaces leaves no zero behind
        if table.get("axes") == [axis for axis in SEAL_AXES if axis in table]:
            del table["axes"]
    _update_table(document, machine_file(), whole, given)


def _update_table(table: Any, model: type[Model], whole: _Plain, given: _Plain) -> None:
    """Bring a table to the values of ``whole``; keys that it lacks are added where they stand in
    ``given``.
    """
    for name, field in model.model_fields.items():
        key, below = field.alias or name, table_below(model, name)
        if key == "assumed":
            continue
        if key not in whole:
            if key in table:
                table.remove(key)
        elif below is None:
            _update_value(table, key, _dimension(model, name, whole), whole[key], key in given)
        elif str(field.annotation).startswith("dict"):
            dotted = any(
                item is not None and item.is_dotted() for item, _ in table.body if item == key
            )
            for entry, values in given.get(key, {}).items():
                if entry in table.get(key, {}):
                    _update_table(table[key][entry], below, whole[key][entry], values)
                else:
                    new = _in_units(below, values)
                    _add(
                        table.setdefault(key, tomlkit.table(is_super_table=True)),
                        entry,
                        new,
                        inline=dotted,
                    )
        elif str(field.annotation).startswith("list"):
            _update_entries(table, key, below, whole[key], given.get(key, ()))
        elif key in table:
            _update_table(table[key], below, whole[key], given.get(key, {}))
        elif key in given:
            _add(table, key, _in_units(below, given[key]))


def _dimension(model: type[Model], name: str, values: _Plain) -> str:
    """The dimension of the numbers under a key; "" for texts and counts."""
    if model is ToleranceTable and name == "absolute":
        return parse_parameter(values["parameter"]).dimension
    return getattr(next(iter(model.model_fields[name].metadata), None), "dimension", "")


def _update_value(table: Any, key: str, dimension: str, value: Any, wanted: bool) -> None:
    if key not in table:
        if wanted:
            table[key] = _worded(value, dimension, key)
        return
    # there are none any more, which is the default
    if value == [] and not (wanted and isinstance(table[key], Array)):
        table.remove(key)
        return
    updated = _rewritten(table[key], value, dimension)
    if updated is not table[key]:
        table[key] = updated


def _in_units(model: type[Model], values: _Plain) -> dict[str, Any]:
    """A new table, its numbers with the units that people write."""
    table = dict(values)
    for name, field in model.model_fields.items():
        key, below = field.alias or name, table_below(model, name)
        if key in table and below is None:
            table[key] = _worded(table[key], _dimension(model, name, values), key)
        elif below is not None and key in table and not str(field.annotation).startswith("dict"):
            several = isinstance(table[key], list)
            table[key] = (
                [_in_units(below, item) for item in table[key]]
                if several
                else _in_units(below, table[key])
            )
    return table


def _worded(value: Any, dimension: str, key: str) -> Any:
    if isinstance(value, list):
        return [_worded(item, dimension, key) for item in value]
    return (
        in_everyday_unit(value, dimension, key) if dimension and isinstance(value, float) else value
    )


def _rewritten(old: Any, value: Any, dimension: str) -> Any:
    """``value`` in the form and unit of the item ``old``; ``old`` itself where it says the same."""
    if isinstance(value, list):
        if not isinstance(old, Array):
            same = all(element == value[0] for element in value)  # one number stands for all
            return (
                _rewritten(old, value[0], dimension)
                if same
                else [_rewritten(old, x, dimension) for x in value]
            )
        if len(old) != len(value):
            return [
                _rewritten(_first(old), x, dimension) if not isinstance(x, list) else x
                for x in value
            ]
        for i, element in enumerate(value):
            # a table gained an axis
            deeper = isinstance(element, list) and not isinstance(old[i], Array)
            updated = (
                _spread(old[i], element, dimension)
                if deeper
                else _rewritten(old[i], element, dimension)
            )
            if updated is not old[i]:
                old[i] = updated
        return old
    if not dimension:
        return old if old == value else value
    if isinstance(old, Array) or Quantity(dimension).read(_plain(old)) == value:
        return value if isinstance(old, Array) else old
    if isinstance(old, str):
        return rewrite_quantity(str(old), value, DIMENSIONS[dimension])
    return int(value) if isinstance(old, int) and value.is_integer() else value


def _spread(old: Any, value: Any, dimension: str) -> Any:
    """Nested ``value``, every number in the form and unit of ``old``."""
    return (
        [_spread(old, x, dimension) for x in value]
        if isinstance(value, list)
        else _rewritten(old, value, dimension)
    )


def _plain(value: Any) -> Any:
    return value.unwrap() if isinstance(value, Item) else value


def _first(array: Any) -> Any:
    """The first element at the bottom of nested arrays."""
    return _first(array[0]) if isinstance(array, Array) and len(array) else array


def _update_entries(
    table: Any, key: str, model: type[Model], whole: Sequence[_Plain], given: Sequence[_Plain]
) -> None:
    """Bring the entries of a list of tables to those of ``whole``, each with the entry of its
    identity.
    """
    entries = list(table.get(key, ()))
    named = key in attachments() and "name" in model.model_fields
    identity_key = "name" if named else _IDENTITIES.get(key, "")
    known = dict(zip(_identities(entries, model, identity_key), range(len(entries)), strict=True))
    wanted = [known.get(identity) for identity in _identities(whole, model, identity_key)]
    for place, values, some in zip(wanted, whole, given or [{}] * len(whole), strict=True):
        if place is not None:
            _update_table(entries[place], model, values, some)
    if wanted == list(range(len(entries))):
        return
    if not whole:
        table.remove(key)
    elif not entries:
        _add(table, key, [_in_units(model, values) for values in given])
    else:
        _reorder(table[key], entries, wanted, [_in_units(model, values) for values in given])


def _identities(entries: Sequence[Any], model: type[Model], key: str) -> Iterator[tuple[Any, int]]:
    """What tells entries apart: the value of ``key``, and how often it occurred before."""
    occurrences: dict[Any, int] = {}
    for entry in entries:
        value = _plain(entry.get(key))
        if key and (dimension := _dimension(model, key, {})):
            value = Quantity(dimension).read(value)
        occurrences[value] = occurrences.get(value, -1) + 1
        yield value, occurrences[value]


def _reorder(
    listed: Any, entries: Sequence[Any], wanted: Sequence[int | None], given: Sequence[_Plain]
) -> None:
    """Put the entries in the order ``wanted``; None stands for a new one."""
    made = [
        tomlkit.item(values, _parent=listed) if place is None else entries[place]
        for place, values in zip(wanted, given, strict=True)
    ]
    if isinstance(listed, Array):  # comments in it stay where they are
        for i, (place, entry) in enumerate(zip(wanted, made, strict=True)):
            if i >= len(listed):
                listed.append(entry)
            elif place != i:
                listed[i] = entry
        while len(listed) > len(made):
            del listed[-1]
        return
    leads = [entry.trivia.indent for entry in entries]
    spaced = "\n" if any(lead.startswith("\n") for lead in leads[1:]) else ""
    listed.clear()
    for place, entry in zip(wanted, made, strict=True):
        listed.append(entry)
        listed[-1].trivia.indent = spaced if place is None else leads[place]


def _add(table: Any, key: str, value: Any, *, inline: bool = False) -> None:
    """A new table, or list of tables, at the end of ``table``."""
    parent = tomlkit.inline_table() if inline else table
    table.append(key, tomlkit.item(value, _parent=parent))
    added = table[key]
    first = added[0] if isinstance(added, AoT) else added
    if not isinstance(parent, InlineTable):
        first.trivia.indent = "\n" if isinstance(table, Container) else ""


def _update_assumed(head: Any, reasons: Sequence[tuple[str, str]]) -> None:
    """Bring [machine.assumed] to these reasons; dotted keys without quotes stand in it as tables
    within tables.
    """
    wanted = dict(reasons)
    if not wanted:
        head.pop("assumed", None)
        return
    if "assumed" not in head:
        _add(head, "assumed", wanted)
        return
    for table, key, path in list(_leaves(head["assumed"], "")):
        if path not in wanted:
            table.remove(key)
        elif table[key] != wanted[path]:
            table[key] = wanted[path]
    kept = [path for _, _, path in _leaves(head["assumed"], "")]
    for path, reason in wanted.items():
        if path not in kept:
            head["assumed"][path] = reason
    if [path for _, _, path in _leaves(head["assumed"], "")] != list(wanted):
        head["assumed"] = wanted


def _leaves(table: Any, above: str) -> Iterator[tuple[Any, str, str]]:
    for key, value in table.items():
        if isinstance(value, String):
            yield table, key, f"{above}{key}"
        else:
            yield from _leaves(value, f"{above}{key}.")


def _attach_comments(document: Container) -> str:
    """Blank lines and comments above a table's header belong to the table above when parsed: give
    each to its header.

    Returns the text at the end of the file.
    """
    last = document
    for table in _headers(document):
        table.trivia.indent = _take_end(last) + table.trivia.indent
        last = table.value
    return _take_end(last)


def _headers(container: Container) -> Iterator[Table]:
    """Tables with a line of their own, in the order of the text."""
    for key, item in container.body:
        for table in (
            item.body if isinstance(item, AoT) else [item] if isinstance(item, Table) else ()
        ):
            if not (table.is_super_table() or (key is not None and key.is_dotted())):
                yield table
            yield from _headers(table.value)


def _take_end(container: Container) -> str:
    """The blank lines and comments at the end of a table, taken out."""
    taken: list[str] = []
    while container.body and container.body[-1][0] is None:
        taken.insert(0, container.body.pop()[1].as_string())
    return "".join(taken)


# A machine as a file for people.


# (from which size on, unit); other dimensions in SI
_UNITS: Mapping[str, tuple[tuple[float, str], ...]] = {
    "length": ((0.0, "um"), (1e-4, "mm")),
    "angle": ((0.0, "deg"),),
    "angular rate": ((0.0, "Hz"),),
    "time": ((0.0, "us"), (1e-3, "ms"), (1.0, "s")),
    "area": ((0.0, "mm^2"),),
    "current": ((0.0, "A"),),
    "voltage": ((0.0, "V"),),
    "force": ((0.0, "N"),),
    "elastic modulus": ((0.0, "GPa"),),
    "stiffness": ((0.0, "N/um"),),
    "current per displacement": ((0.0, "A/mm"),),
    "velocity": ((0.0, "mm/s"),),
    "pressure": ((0.0, "bar"),),
}
_RPM = {"speed", "speed_range", "balance_speed", "unbalance_to"}
_COMMENT = 46  # column of comments


def annotated_machine(machine: Machine, title: str) -> str:
    """The machine as TOML text that reads back as an equal one; the first entry of every kind has
    comments.

    title: the comment at its head, a line or several.
    """
    document = machine.to_dict()
    end = 0.0
    for table, section in zip(document["shaft"], machine.shaft, strict=True):
        if section.start == end:
            del table["start"]
        end = section.start + section.length
    writer = _Writer(tuple(name for name, _ in machine.assumed), set())
    text = [f"# {line}".rstrip() for line in title.splitlines()]
    for key, value in document.items():
        text += writer.table(machine_file(), key, key, value)
    return "\n".join(text) + "\n"


def in_everyday_unit(value: float, dimension: str, key: str = "") -> Any:
    """What a file holds for ``value`` [SI]: a text with a unit that reads back as the very same
    number, or the number.
    """
    rows = ((0.0, "rpm"),) if key in _RPM else _UNITS.get(dimension)
    if rows is None or value == 0:
        unit = DIMENSIONS[dimension].unit
        return (
            rewrite_quantity(f"1 {unit}", value, DIMENSIONS[dimension])
            if value and unit not in {"", "-"}
            else value
        )
    unit = max(row for row in rows if row[0] <= abs(value) or row is rows[0])[1]
    return rewrite_quantity(f"1 {unit}", value, DIMENSIONS[dimension])


@dataclass(frozen=True, slots=True)
class _Writer:
    """assumed: keys of [machine.assumed]; seen: tables and keys that have their comment already."""

    assumed: tuple[str, ...]
    seen: set[str]

    def table(self, model: type[Model], key: str, path: str, value: Any) -> Iterator[str]:
        below = table_below(model, key)
        if below is None:  # [machine.assumed]
            yield from [
                "",
                f"[{path}]",
                *(f"{written_key(name)} = {written(reason)}" for name, reason in value.items()),
            ]
        elif str(model.model_fields[key].annotation).startswith("dict"):
            for name, entry in value.items():
                yield from self._entry(below, f"[{path}.{written_key(name)}]", path, entry)
        else:
            for entry in value if isinstance(value, list) else [value]:
                yield from self._entry(
                    below, f"[[{path}]]" if isinstance(value, list) else f"[{path}]", path, entry
                )

    def _entry(
        self, model: type[Model], header: str, path: str, entry: Mapping[str, Any]
    ) -> Iterator[str]:
        meaning = " ".join((model.__doc__ or "").split()).partition(". ")[0].rstrip(".")
        yield from ["", *([f"# {meaning}."] if path not in self.seen else []), header]
        self.seen.add(path)
        names = {field.alias or name: name for name, field in model.model_fields.items()}
        tables = [
            key
            for key, value in entry.items()
            if table_below(model, names[key]) or isinstance(value, dict)
        ]
        for key, value in entry.items():
            if key not in tables:
                field = model.model_fields[names[key]]
                yield self._line(
                    f"{path}.{key}",
                    f"{key} = {written(_valued(field.metadata, key, value))}",
                    field.description or "",
                )
        for key in tables:
            yield from self.table(model, names[key], f"{path}.{key}", entry[key])

    def _line(self, path: str, line: str, meaning: str) -> str:
        if path in self.seen or not meaning:
            return line
        self.seen.add(path)
        guess = any(path == name or path.startswith(f"{name}.") for name in self.assumed)
        return (
            f"{line:<{_COMMENT}} # "
            f"{'assumed: ' if guess else ''}{meaning.partition('; default')[0]}"
        )


def _valued(kinds: list[Any], key: str, value: Any) -> Any:
    dimension = getattr(kinds[0], "dimension", "") if kinds else ""
    if (
        isinstance(value, list)
        and value
        and getattr(kinds[0], "scalar", False)
        and all(item == value[0] for item in value)
    ):
        value = value[0]  # one number stands for all
    if isinstance(value, list):
        return [_valued(kinds, key, item) for item in value]
    return (
        in_everyday_unit(value, dimension, key) if dimension and isinstance(value, float) else value
    )
