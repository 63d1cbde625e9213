"""A parsed TOML document -> Machine: pydantic's findings put into the words of the file, and nouns
put together.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import fields
from typing import Any

from pydantic import ValidationError

from ambrose.core.checks import InvalidInput
from ambrose.machine.attachment import attachments
from ambrose.machine.description import MachineDescription
from ambrose.machine.file.tables import Table, machine_file, table_below
from ambrose.machine.machine import Machine
from ambrose.machine.messages import SHOWN, called, listed, shown, suggestion
from ambrose.machine.rotor_model import Material, ShaftSection
from ambrose.machine.validation.machine import InvalidMachine

# keys of the file whose parts are a field of the machine
_FIELDS = {item.metadata.get("key", item.name) for item in fields(MachineDescription)}


def machine_from_document(document: Mapping[str, Any], name: str, text: str = "") -> Machine:
    """The machine in a parsed TOML document; ``name`` is the file's, for messages, and ``text``
    what stands in it.

    Raises InvalidInput with one line for each problem found: of its form, or of its physics where
    the form is right.
    """
    file = read_table(machine_file(), _with_magnets(document), name)
    tables = dict(file)
    whole = tables["machine"].given()
    whole.pop("version")
    assumed, unclear = _reasons(whole.pop("assumed", {}))
    materials = _materials(file)
    shaft, unknown = _shaft(tables["shaft"], materials)
    if unclear or unknown:
        raise InvalidInput(listed(name, [*unclear, *unknown]))
    stated = file.given()
    # of tables whose parts have a field of their own the machine has that
    no_field = set(attachments()) - _FIELDS
    effects = tuple(
        part for table in attachments() if table in no_field for part in stated.pop(table, ())
    )
    try:
        return Machine(
            shaft=shaft, assumed=assumed, file_text=text, effects=effects, **whole, **stated
        )
    except InvalidMachine as error:
        raise InvalidMachine(name, error.problems) from None  # named by its file


def _with_magnets(document: Mapping[str, Any]) -> Mapping[str, Any]:
    """The document; with empty tables of magnets, sensors and amplifier where the rotor is carried
    by bearings of another kind alone, and none is written.
    """
    others = [table for table, item in attachments().items() if item.carries]
    if "bearing" in document or not any(document.get(table) for table in others):
        return document
    return {"sensor": [], "amplifier": {"order": "none"}, **document, "bearing": []}


def read_table(model: type[Table], document: Mapping[str, Any], name: str) -> Table:
    """A parsed TOML document as ``model``. Raises InvalidInput with one line for each problem of
    its form.
    """
    try:
        return model.model_validate(document)
    except ValidationError as error:
        problems = error.errors(include_url=False)
        lines = [_line(detail, document, model) for detail in problems[:SHOWN]]
        # what is beyond is counted only
        raise InvalidInput(listed(name, [*lines, *[""] * (len(problems) - SHOWN)])) from None


def named_materials(document: Mapping[str, Any]) -> dict[str, Material]:
    """The materials of a document that ``machine_from_document`` accepts, by name."""
    return _materials(machine_file().model_validate(document))


def _materials(file: Table) -> dict[str, Material]:
    return {
        name: Material(name=name, **table.given())
        for name, table in (dict(file)["material"] or {}).items()
    }


def _shaft(
    tables: Sequence[Table], materials: Mapping[str, Material]
) -> tuple[tuple[ShaftSection, ...], list[str]]:
    """The sections, each starting where the previous one ends unless it says otherwise, and
    complaints about materials.
    """
    sections = []
    complaints = []
    end = 0.0
    for i, table in enumerate(tables):
        stated = table.given()
        material = stated.pop("material", None)
        if material in materials:
            stated["material"] = materials[material]
        elif material is not None:
            remedy = suggestion(
                material, materials, f"there is no material table; add [material.{material}]"
            )
            complaints.append(f'[[shaft]] {i + 1}: material "{material}" is unknown; {remedy}')
        sections.append(ShaftSection(**{"start": end, **stated}))
        end = sections[-1].start + sections[-1].length
    return tuple(sections), complaints


def _reasons(
    table: Mapping[str, Any], above: str = ""
) -> tuple[tuple[tuple[str, str], ...], list[str]]:
    """[machine.assumed] as (key, reason) pairs; dotted keys without quotes arrive as tables within
    tables.
    """
    pairs: list[tuple[str, str]] = []
    complaints: list[str] = []
    for key, value in table.items():
        if isinstance(value, Mapping):
            inner, wrong = _reasons(value, f"{above}{key}.")
            pairs += inner
            complaints += wrong
        elif isinstance(value, str):
            pairs.append((f"{above}{key}", value))
        else:
            complaints.append(
                f"[machine.assumed]: {above}{key} is {shown(value)}, but must be a string; write "
                "the reason in quotes"
            )
    return tuple(pairs), complaints


def _line(detail: Any, document: Mapping[str, Any], root: type[Table]) -> str:
    """One of pydantic's findings as a line: place, key, what is wrong, what to do."""
    *above, last = detail["loc"]
    kind = detail["type"]
    if kind in {"model_type", "model_attributes_type", "dict_type", "list_type"}:
        return _wrong_form((*above, last), kind, detail["input"])
    where, model = _place(above, document, root)
    prefix = f"{where}: " if where else ""
    if kind == "missing":
        return f"{prefix}{_missing(model, str(last), root)}"
    if kind == "extra_forbidden":
        known = [field.alias or key for key, field in (model.model_fields if model else {}).items()]
        if not above and root is machine_file():
            return f"[{last}]: unknown table; {suggestion(str(last), known)}"
        return f'{prefix}unknown key "{last}"; {suggestion(str(last), known)}'
    problem = (
        detail["ctx"]["problem"]
        if kind == "value"
        else f"is {shown(detail['input'])}: {detail['msg']}"
    )
    return f"{prefix}{last} {problem}"


def _missing(model: type[Table] | None, key: str, root: type[Table]) -> str:
    """What to say about a key or a table that is not there."""
    if model is None:
        return f"{key} is missing"
    if model is root and (below := table_below(root, key)):
        many = str(model.model_fields[key].annotation).startswith("list")
        needs = {
            name: field for name, field in below.model_fields.items() if field.is_required()
        } or below.model_fields
        keys = ", ".join(field.alias or name for name, field in needs.items())
        return f"table {_brackets(key, many=many)} is missing; add it with {keys}"
    kinds = next(
        field.metadata for name, field in model.model_fields.items() if (field.alias or name) == key
    )
    if not kinds:  # a table of its own, below this one
        return f"table {key} is missing; add it"
    return f"{key} is missing; give {kinds[0].expects}"


def _wrong_form(loc: Sequence[str | int], kind: str, value: object) -> str:
    """A value, or a table in single brackets, where tables in double brackets belong, and the
    reverse.
    """
    keys = [str(part) for part in loc if isinstance(part, str)]
    many = kind == "list_type" or isinstance(loc[-1], int)
    key, right = ".".join(keys), _brackets(".".join(keys), many=many)
    form = "an array" if isinstance(value, list) else shown(value)
    return f"{key} is {form}, but must be {right}; write its keys below the line {right}"


def _brackets(path: str, *, many: bool) -> str:
    return f"[[{path}]]" if many else f"[{path}]"


def _place(
    loc: Sequence[str | int], document: Mapping[str, Any], root: type[Table]
) -> tuple[str, type[Table] | None]:
    """Where a key stands, as the file has it ("[[bearing]] A, [[bearing.measured]] 2"), and the
    model of that table.
    """
    entry: Any = document
    model: type[Table] | None = root
    places: list[str] = []
    path: list[str] = []
    for i, part in enumerate(loc):
        entry = entry[part]
        if isinstance(part, int):
            places.append(
                f"{_brackets('.'.join(path), many=True)} {called(entry, path[-1], part + 1)}"
            )
            continue
        path.append(part)
        model = (table_below(model, part) or model) if model else None
        if i == len(loc) - 1 or (not isinstance(loc[i + 1], int) and places):
            places.append(_brackets(".".join(path), many=False))
    return ", ".join(places), model
