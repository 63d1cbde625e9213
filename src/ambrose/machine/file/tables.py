"""The tables of a machine file as pydantic models, made from the fields of the parts that they
become.

A part's field says what its key takes and means, ``length: Annotated[float, Quantity("length"),
"axial length"]``, and its default. Only what a file gives is passed on to the part.
"""

import json
import os
import sys
from collections.abc import Mapping
from dataclasses import MISSING, fields
from functools import lru_cache
from pathlib import Path
from types import GenericAlias, NoneType
from typing import Annotated, Any, ClassVar, cast, get_args, get_origin

from pydantic import BaseModel, ConfigDict, Field, ValidationInfo, create_model, field_validator
from pydantic_core import PydanticCustomError

from ambrose.core.checks import InvalidInput
from ambrose.machine.attachment import Attachment, attachments
from ambrose.machine.description import SCHEMA_VERSION, MachineDescription, Tolerance
from ambrose.machine.kinds import (
    PLACEHOLDER,
    Choices,
    ListOf,
    NestedOf,
    Quantity,
    Ratio,
    Text,
    Texts,
    Version,
    quantity_schemas,
)
from ambrose.machine.parameters import parse_parameter
from ambrose.machine.part import SEAL_AXES, SEAL_COEFFICIENTS, Material, Part, SealTable, hints_of


def optional(doc: str) -> Any:
    """A key that may be left out; the part's own default applies then."""
    return Field(default=None, description=doc)


class Table(BaseModel):
    """One table of the file; ``noun`` is what it becomes."""

    model_config = ConfigDict(extra="forbid", frozen=True, defer_build=True)
    noun: ClassVar[type[Part] | None] = None
    apart: ClassVar[frozenset[str]] = frozenset()  # keys that ``given`` leaves to the reader
    # the part's fields that are called differently, by their keys
    attributes: ClassVar[Mapping[str, str]] = {}

    def given(self) -> dict[str, Any]:
        """The part's fields that the file gives, nested tables turned into parts and lists into
        tuples.
        """
        return {
            self.attributes.get(key, key): _built(getattr(self, key))
            for key in self.model_fields_set - self.apart
        }

    def build(self) -> Any:
        """The part, with its own defaults for what the file leaves out."""
        assert self.noun is not None
        return self.noun(**self.given())


def _built(value: Any) -> Any:
    if isinstance(value, Table):
        return value.build()
    if isinstance(value, list):
        return tuple(_built(element) for element in value)
    return value


class SealTableTable(Table):
    """Coefficients over any of pressure, speed and frequency; a coefficient listed here replaces
    the seal's constant.
    """

    axes: Annotated[tuple[str, ...], Choices(SEAL_AXES)] = optional(
        "order of nesting; default: pressure, speed, frequency"
    )
    pressure: Annotated[tuple[float, ...], ListOf("pressure")] = optional(
        "pressure axis, ascending"
    )
    speed: Annotated[tuple[float, ...], ListOf("angular rate")] = optional(
        "spin speed axis, ascending"
    )
    frequency: Annotated[tuple[float, ...], ListOf("angular rate")] = optional(
        "whirl frequency axis, ascending"
    )
    K: Annotated[Any, NestedOf("stiffness")] = optional("direct stiffness")
    k: Annotated[Any, NestedOf("stiffness")] = optional("cross-coupled stiffness")
    C: Annotated[Any, NestedOf("damping")] = optional("direct damping")
    c: Annotated[Any, NestedOf("damping")] = optional("cross-coupled damping")
    M: Annotated[Any, NestedOf("mass")] = optional("added mass")

    def build(self) -> SealTable:
        stated = self.given()
        order = stated.get("axes", SEAL_AXES)
        axes = tuple((axis, stated[axis]) for axis in order if axis in stated)
        rest = tuple(
            (axis, stated[axis]) for axis in SEAL_AXES if axis in stated and axis not in order
        )
        return SealTable(
            axes + rest, tuple((c, stated[c]) for c in SEAL_COEFFICIENTS if c in stated)
        )


class ToleranceTable(Table):
    """One uncertain parameter, with a relative or an absolute half-width."""

    noun = Tolerance
    parameter: Annotated[str, Text("the path of a parameter, such as seal.center.k,")] = Field(
        description="path of the parameter"
    )
    relative: Ratio = optional("half-width as a fraction of the nominal value")
    absolute: float = optional("half-width in the parameter's own unit")
    around: Annotated[tuple[str, ...], Texts()] = optional(
        "labels of the operating points around which it applies; default: every one"
    )

    @field_validator("absolute", mode="plain", json_schema_input_type=float | str)
    @classmethod
    def _in_the_unit_of_its_parameter(cls, value: object, info: ValidationInfo) -> float:
        try:
            parameter = parse_parameter(info.data.get("parameter", ""))
        except InvalidInput:
            return 0.0  # the path itself is reported
        try:
            return Quantity(parameter.dimension).read(value)
        except ValueError as error:
            raise PydanticCustomError("value", "{problem}", {"problem": str(error)}) from None


@lru_cache
def table_of(noun: type) -> type[Table]:
    """The model of the table that a part is read from."""
    if noun in (SealTable, Tolerance):
        return SealTableTable if noun is SealTable else ToleranceTable
    return make_table(noun.__name__, (noun.__doc__ or "").partition("\n\n")[0], keys_of(noun), noun)


def make_table(
    name: str, doc: str, keys: Mapping[str, Any], noun: type[Part] | None = None
) -> type[Table]:
    """A table with these keys (``keys_of``); ``noun`` is the part that it becomes."""
    table = cast(
        type[Table], create_model(name, __base__=Table, __doc__=" ".join(doc.split()), **keys)
    )
    if noun is not None:
        named = [item for item in fields(noun) if "key" in item.metadata]  # type: ignore[arg-type]  # every Part is a dataclass
        table.noun, table.attributes = noun, {item.metadata["key"]: item.name for item in named}
    return table


def keys_of(noun: type[Part]) -> dict[str, tuple[Any, Any]]:
    """Type and pydantic field of every key, from the annotated fields of a part."""
    hints = hints_of(noun)  # type: ignore[arg-type]  # a class is hashable
    keys = {}
    for item in fields(noun):  # type: ignore[arg-type]
        *kinds, doc = getattr(hints[item.name], "__metadata__", (None,))
        if doc is None:
            continue
        simple = isinstance(item.default, (int, float, str)) or (
            bool(kinds) and item.default not in {MISSING, None, ()}
        )
        required = item.metadata.get(
            "required", item.default is MISSING and item.default_factory is MISSING
        )
        entry = (
            Field(description=doc)
            if required
            else Field(default=item.default if simple else None, description=doc)
        )
        keys[item.metadata.get("key", item.name)] = (
            _type(hints[item.name].__origin__, kinds),
            entry,
        )
    return keys


def _type(hint: Any, kinds: list[Any]) -> Any:
    """What pydantic reads: a value of a kind, a table, or a list of tables."""
    if kinds:
        return Annotated[Any, kinds[0]]
    if NoneType in get_args(hint):
        hint = get_args(hint)[0]
    if get_origin(hint) is tuple:
        return GenericAlias(list, (table_of(get_args(hint)[0]),))
    is_part = isinstance(hint, type) and issubclass(hint, Part)
    return table_of(hint) if is_part else hint


def table_below(table: type[Table], key: str) -> type[Table] | None:
    """The model of the table or entries under ``key``, None where the key holds a value."""
    field = table.model_fields.get(key)
    return None if field is None else _table_in(field.annotation)


def _table_in(annotation: Any) -> type[Table] | None:
    if isinstance(annotation, type) and issubclass(annotation, Table):
        return annotation
    return next((table for part in get_args(annotation) if (table := _table_in(part))), None)


_WHOLE = keys_of(MachineDescription)
MachineTable = make_table(
    "MachineTable",
    "The machine as a whole.",
    {
        "version": (
            Annotated[int, Version(SCHEMA_VERSION)],
            Field(alias="schema", description="version of the file format"),
        ),
        **{key: entry for key, entry in _WHOLE.items() if not _table_in(entry[0])},
        "assumed": (
            dict[str, Any],
            optional(
                "key = reason, for every figure that was chosen and is neither measured nor "
                "published"
            ),
        ),
    },
)


def machine_file() -> type[Table]:
    """The model of a whole machine file, with the tables of all registered effects."""
    return _machine_file(tuple(attachments().values()))


@lru_cache(maxsize=8)
def _machine_file(effects: tuple[Attachment, ...]) -> type[Table]:
    tables = {key: entry for key, entry in _WHOLE.items() if _table_in(entry[0])}
    for item in effects:
        part: type = item.part
        below = table_of(part)
        tables.setdefault(item.table, (GenericAlias(list, (below,)), optional(below.__doc__ or "")))
    table = make_table(
        "MachineFile",
        "A rotor on magnetic bearings.",
        {
            "machine": (MachineTable, Field(description="the machine as a whole")),
            "material": (
                GenericAlias(dict, (str, table_of(Material))),
                optional("materials by name"),
            ),
            **tables,
        },
        MachineDescription,
    )
    table.apart = frozenset({"machine", "material", "shaft"})
    return table


# The JSON schema of machine files, made from the tables in file/tables.py.


DIALECT = "https://json-schema.org/draft/2020-12/schema"


def machine_schema() -> dict[str, Any]:
    """JSON schema (draft 2020-12) of a machine file, for editors: every table and key with its
    meaning, form and default.
    """
    # whoever reads a record needs no tables of machines

    schema: dict[str, Any] = tidy_schema(machine_file().model_json_schema(by_alias=True))
    tables: dict[str, Any] = schema.pop("$defs")
    head = {
        "$schema": DIALECT,
        "title": f"ambrose machine file, schema {SCHEMA_VERSION}",
        "description": schema.pop("description"),
    }
    return {**head, **schema, "$defs": {**dict(sorted(tables.items())), **quantity_schemas()}}


def tidy_schema(node: Any) -> Any:
    """Without pydantic's titles and null defaults, and with references to quantities in place of
    their placeholders.
    """
    if isinstance(node, list):
        return [tidy_schema(element) for element in node]
    if not isinstance(node, dict):
        return node
    kept: dict[str, Any] = {}
    for key, value in node.items():
        if key == PLACEHOLDER:
            kept["$ref"] = f"#/$defs/{value}"
        elif key == "properties":
            kept[key] = {name: tidy_schema(entry) for name, entry in value.items()}
        elif not (key == "title" or (key == "default" and value is None)):
            kept[key] = tidy_schema(value)
    return kept


def write_schema(schema: dict[str, Any], path: str | os.PathLike[str]) -> None:
    """Write a schema as it is committed in docs."""
    Path(path).write_text(json.dumps(schema, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")


if __name__ == "__main__":  # python -m ambrose.machine.file.tables docs/machine.schema.json
    write_schema(machine_schema(), sys.argv[1])
