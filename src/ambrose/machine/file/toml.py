"""Machine files: TOML <-> Machine. The only place, with record/record.py, where units are
converted; inside all is SI.
"""

import hashlib
import json
import os
import re
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import fields
from importlib.resources import files
from itertools import accumulate
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from ambrose.core.checks import InvalidInput, invalid
from ambrose.machine.attachment import attachments
from ambrose.machine.description import MachineDescription
from ambrose.machine.file.tables import Table, machine_file, table_below
from ambrose.machine.machine import Machine
from ambrose.machine.ordinary_file import TOML_BYTES, TOML_DEPTH, TOML_ENTRIES, excess, read_text
from ambrose.machine.part import MATERIALS, Material, ShaftSection
from ambrose.machine.units import SHOWN, called, listed, meant, quoted, shown, suggestion
from ambrose.machine.validation.machine import InvalidMachine

# A parsed TOML document -> Machine: pydantic's findings put into the words of the file, and nouns
# put together.


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
    own = (dict(file)["material"] or {}).items()
    return {**MATERIALS, **{name: Material(name=name, **table.given()) for name, table in own}}


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
            key = material if material.isidentifier() else quoted(material)
            remedy = f"{suggestion(material, materials)}; or add [material.{key}]"
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


# strings and comments; one that is never closed ends where the text or the line does
_QUOTED = re.compile(
    r'"""(?:[^"\\]|\\.|"(?!""))*+"{0,5}'
    r"|'''(?:[^']|'(?!''))*+'{0,5}"
    r'|"(?:[^"\\\n]|\\.)*+"?'
    r"|'[^'\n]*+'?|#[^\n]*+",
    re.DOTALL,
)
_DEEP_KEY = re.compile(rf"(?<![\w-])(?:[\w-]++[ \t]*+\.[ \t]*+){{{TOML_DEPTH}}}")
_BRACKET = re.compile(r"[][{}]")
AXIAL = "#axial"  # after a file or name: the axis along the shaft


def bundled_machines() -> dict[str, Path]:
    """The machine files that come with the package, by name."""
    folder = Path(str(files("ambrose") / "machines"))
    return {path.stem: path for path in sorted(folder.glob("*.toml"), key=lambda path: path.stem)}


def load_machine(path: str | os.PathLike[str] | Machine) -> Machine:
    """The machine in a TOML file, or the bundled machine of that name; a Machine is returned as it
    is. "<file or name>#axial" is the axis along its shaft (``Machine.axial``).

    Raises InvalidInput, one message with a line for each problem, for a file that is missing,
    unreadable or wrong.
    """
    if isinstance(path, Machine):
        return path
    if isinstance(path, (str, os.PathLike)) and os.fspath(path).endswith(AXIAL):
        return load_machine(os.fspath(path).removesuffix(AXIAL)).axial
    return loads_machine(read_machine_text(path), name=str(path))


def loads_machine(text: str, name: str = "machine file") -> Machine:
    """The machine in TOML text; ``name`` stands in messages. Raises InvalidInput."""

    if not text.strip():
        raise InvalidInput(
            f"{name}: the file is empty; it needs at least [machine], [[shaft]], [[bearing]], "
            "[[sensor]], [amplifier]"
        )
    return machine_from_document(parse_toml(text, name), name, text)


def read_toml(path: Any, what: str) -> dict[str, Any]:
    """A small TOML file, a ``what`` in messages, as plain data.

    Raises InvalidInput; where there is nothing at all, its cause is a FileNotFoundError.
    """
    return parse_toml(read_text(path, what, TOML_BYTES), f"{what} {path}")


def parse_toml(text: str, name: str) -> dict[str, Any]:
    """TOML of any kind as plain data, after its size was looked at (ordinary_file.py); ``name``
    stands in messages.

    Raises InvalidInput.
    """
    if len(text) > TOML_BYTES:
        raise InvalidInput(
            f"{name}: it has {len(text)} characters, but at most {TOML_BYTES} are allowed; is it "
            "the right file?"
        )
    # a parser of nested things takes long, and memory, before it can count
    bare = _QUOTED.sub("s", text)
    depth = max(
        accumulate({"[": 1, "{": 1}.get(mark, -1) for mark in _BRACKET.findall(bare)), default=0
    )
    if depth > TOML_DEPTH or _DEEP_KEY.search(bare):
        what = "brackets are" if depth > TOML_DEPTH else "a key is"
        raise InvalidInput(
            f"{name}: {what} nested too deeply, more than {TOML_DEPTH} times; lists nest at most "
            "three deep here"
        )
    entries = sum(map(bare.count, "=,["))
    if entries > TOML_ENTRIES:
        raise InvalidInput(
            f"{name}: it has about {entries} entries, but at most {TOML_ENTRIES} are allowed; "
            "make tables coarser"
        )
    try:
        document = tomllib.loads(text)
    except (ValueError, RecursionError) as error:
        remedy = "check quotes, brackets and commas there; a cut-off file ends like this too"
        raise InvalidInput(f"{name}: not valid TOML: {error}; {remedy}") from None
    for complaint in excess(document):
        raise InvalidInput(f"{name}: {complaint}")
    return document


def dumps_machine(machine: Machine) -> str:
    """A machine as TOML text in SI numbers; keys that have their default value are left out."""
    return "\n".join(_lines(machine.to_dict(), "")).lstrip("\n") + "\n"


def machine_hash(machine: Machine) -> str:
    """SHA-256 (64 hexadecimal digits) of everything that is computed with; descriptions, sources
    and reasons do not count.

    It does not depend on how a file is formatted, on units or on keys written out with their
    default value.
    """
    document = machine.to_dict()
    for key in ("description", "source", "assumed"):
        document["machine"].pop(key, None)
    return hashlib.sha256(
        json.dumps(document, sort_keys=True, allow_nan=False).encode()
    ).hexdigest()


def read_machine_text(file: Any) -> str:
    """The text of a machine file (its path), or of the bundled machine of that name. Raises
    InvalidInput.
    """
    if not isinstance(file, (str, os.PathLike)):
        remedy = f"give the path of a TOML file or one of {', '.join(bundled_machines())}"
        raise invalid("the machine", shown(file), "a file or the name of a bundled machine", remedy)
    bundled = bundled_machines()
    path = bundled.get(os.fspath(file), Path(file))
    try:
        return read_text(path, "machine file", TOML_BYTES)
    except InvalidInput as error:
        if not isinstance(error.__cause__, FileNotFoundError):
            raise
        here = f"{os.fspath(path)}.toml"
        close = here if os.path.isfile(here) else meant(str(path), bundled)
        hint = f'did you mean "{close}"?' if close else f"bundled machines: {', '.join(bundled)}"
        raise InvalidInput(f'"{path}" is neither a file nor a bundled machine; {hint}') from None


def _lines(table: Mapping[str, Any], path: str) -> Iterator[str]:
    """A table as lines of TOML: its values, then the tables in it."""

    def below(value: Any) -> bool:
        return isinstance(value, dict) or (
            isinstance(value, list) and bool(value) and isinstance(value[0], dict)
        )

    yield from (
        f"{written_key(key)} = {written(value)}" for key, value in table.items() if not below(value)
    )
    for key, value in table.items():
        inner = f"{path}{written_key(key)}"
        for entry in (
            value if isinstance(value, list) and below(value) else [value] if below(value) else []
        ):
            yield f"\n[[{inner}]]" if isinstance(value, list) else f"\n[{inner}]"
            yield from _lines(entry, f"{inner}.")


def written_key(key: str) -> str:
    """A key as TOML, quoted where it must be."""
    import tomlkit

    return tomlkit.key(key).as_string()


def written(value: Any) -> str:
    """A value, or lists of values, as TOML."""
    import tomlkit

    if isinstance(value, list):
        comma = ",\n  " if value and isinstance(value[0], list) else ", "
        return f"[{comma.join(map(written, value))}]"
    return tomlkit.item(value).as_string()
