"""docs/machine-file.md names every table and key with its unit and default, and its example is a
machine.
"""

import re
from dataclasses import MISSING, fields
from pathlib import Path

import pytest

from ambrose.machine.file.tables import MachineTable, Table, machine_file, table_below
from ambrose.machine.file.toml import dumps_machine, loads_machine
from ambrose.machine.machine import Machine
from ambrose.machine.parameters import QUANTITIES
from ambrose.machine.units import DIMENSIONS

PAGE = (Path(__file__).parents[2] / "docs" / "machine-file.md").read_text()


def headings(model: type[Table] | None = None, path: str = "") -> dict[str, type[Table]]:
    """Every table's heading, as it stands in a file -> its model."""
    found = {}
    model = machine_file() if model is None else model
    for name, field in model.model_fields.items():
        below = table_below(model, name)
        if below is None:
            continue
        inner = f"{path}{name}"
        many = str(field.annotation).startswith("list")
        header = (
            f"[[{inner}]]" if many else f"[{inner}.NAME]" if name == "material" else f"[{inner}]"
        )
        found[header] = below
        found |= headings(below, f"{inner}.")
    return found


def rows(model: type[Table]) -> list[str]:
    """The rows of a table's keys: key, unit, default, meaning."""
    return [row(model, name) for name in model.model_fields if table_below(model, name) is None]


def row(model: type[Table], name: str) -> str:
    field = model.model_fields[name]
    kind = next(iter(field.metadata), None)
    if hasattr(kind, "dimension"):
        unit = DIMENSIONS[kind.dimension].unit
    else:
        unit = {
            "Count": "whole number",
            "Version": "whole number",
            "Text": "text",
            "Choice": "choice",
            "Choices": "list",
        }.get(type(kind).__name__, "as the parameter's" if name == "absolute" else "texts")
    unit = {
        "PairOf": f"{unit}, pair",
        "ListOf": f"{unit}, list",
        "NestedOf": f"{unit}, nested lists",
    }.get(type(kind).__name__, unit)
    if hasattr(kind, "options"):
        unit += ": " + ", ".join(f"`{option}`" for option in kind.options)
    return f"| `{field.alias or name}` | {unit} | {default(model, name)} | {field.description} |"


def default(model: type[Table], name: str) -> str:
    if model.model_fields[name].is_required():
        return "required"
    noun = Machine if model is MachineTable else model.noun
    value = next((f.default for f in fields(noun) if f.name == name), None) if noun else None
    if value in (None, MISSING, "", ()):
        return ""
    return (
        f"{value:g}"
        if isinstance(value, float)
        else f"[{value[0]:g}, {value[1]:g}]"
        if isinstance(value, tuple)
        else str(value)
    )


@pytest.mark.parametrize("heading", headings())
def test_every_key_has_its_row(heading):
    section = re.search(
        rf"^###? `{re.escape(heading)}`\n(.*?)(?=^##|\Z)", PAGE, re.DOTALL | re.MULTILINE
    )
    assert section, f"docs/machine-file.md lacks a section for {heading}"
    missing = [line for line in rows(headings()[heading]) if line not in section[1]]
    assert not missing, "add or correct these rows:\n" + "\n".join(missing)


def test_no_row_is_out_of_date():
    current = {line for model in headings().values() for line in rows(model)}
    written = set(re.findall(r"^\| `\w+` \| .*\|$", PAGE, re.MULTILINE))
    assert written <= current


def test_the_example_is_a_machine_and_has_every_table():
    (example,) = re.findall(r"```toml title=\"example.toml\"\n(.*?)```", PAGE, re.DOTALL)
    machine = loads_machine(example)
    assert loads_machine(dumps_machine(machine)) == machine
    for heading in headings():
        assert heading.replace("NAME", "titanium") in example, heading


def test_every_unit_and_parameter_is_listed():
    for dimension in DIMENSIONS.values():
        if dimension.units:
            units = ", ".join(f"`{unit}`" for unit in dimension.units)
            assert f"| {dimension.name} | `{dimension.unit}` | {units} |" in PAGE
    for table, quantities in QUANTITIES.items():
        for quantity, (_, components) in quantities.items():
            path = f"`{table}.{quantity}`" if table == "amplifier" else f"`{table}.NAME.{quantity}`"
            assert path in PAGE
            mark = "_" if table == "seal" else "."
            assert all(f"`{mark}{component}`" in PAGE for component in components)
