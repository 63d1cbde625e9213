"""What docs/reference/machine-file.md leaves to the program: the rows of every table's keys, the units, the
limits.

A comment holds the place: ``<!-- keys -->`` below the heading of a table, ``<!-- units -->``,
``<!-- limits -->``.
"""

import re
from dataclasses import MISSING, fields

from ambrose.machine import ordinary_file as limits
from ambrose.machine.file.tables import MachineTable, Table, machine_file, table_below
from ambrose.machine.machine import Machine
from ambrose.machine.units import DIMENSIONS

_KINDS = {"Count": "whole number", "Version": "whole number", "Text": "text"}
_KINDS |= {"Choice": "choice", "Choices": "list"}
_MANY = {"PairOf": ", pair", "ListOf": ", list", "NestedOf": ", nested lists"}
_SECTION = re.compile(r"^###? `(\[[^`]*\])`\n(.*?)<!-- keys -->$", re.DOTALL | re.MULTILINE)


def render(text: str) -> str:
    """The page with its rows. Raises KeyError where a heading is no table of the file."""
    tables = headings()
    text = _SECTION.sub(
        lambda found: found[0].replace("<!-- keys -->", keys(tables[found[1]])), text
    )
    return text.replace("<!-- units -->", units()).replace("<!-- limits -->", tables_at_most())


def headings(model: type[Table] | None = None, path: str = "") -> dict[str, type[Table]]:
    """{heading of a table, as it stands in a file: its model}."""
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


def keys(model: type[Table]) -> str:
    """The table of a table's keys: key, unit, default, meaning."""
    rows = [_row(model, name) for name in model.model_fields if table_below(model, name) is None]
    return "\n".join(["| key | unit | default | meaning |", "|---|---|---|---|", *rows])


def units() -> str:
    """A row per dimension with the units in everyday use."""
    rows = [
        f"| {each.name} | `{each.unit}` | {', '.join(f'`{unit}`' for unit in each.units)} |"
        for each in DIMENSIONS.values()
        if each.units
    ]
    return "\n".join(["| dimension | SI | everyday units |", "|---|---|---|", *rows])


def tables_at_most() -> str:
    """A row per limit of a machine file."""
    of_tables = {f"tables `{key}`": most for key, most in limits.TABLES.items() if key != "signal"}
    rows = {
        "elements of the whole shaft": limits.ELEMENTS,
        **of_tables,
        "poles of all seals with states together": limits.SEAL_POLES,
        "sample times of the controller's delay": limits.DELAY_SAMPLES,
        "entries of any other list or table": limits.ENTRIES_EACH,
        "characters of a text": limits.TEXT,
        "characters of a name, a label or a key": limits.NAME,
        "entries (keys, elements of lists, tables) of a file": limits.TOML_ENTRIES,
        "brackets or dotted keys within each other": limits.TOML_DEPTH,
        "bytes of a file": limits.TOML_BYTES,
    }
    lines = [f"| {of} | {f'{most:,}'.replace(',', ' ')} |" for of, most in rows.items()]
    return "\n".join(["| of | at most |", "|---|---|", *lines])


def _row(model: type[Table], name: str) -> str:
    field = model.model_fields[name]
    kind = next(iter(field.metadata), None)
    noun = type(kind).__name__
    if hasattr(kind, "dimension"):
        unit = DIMENSIONS[kind.dimension].unit
    else:
        unit = _KINDS.get(noun, "as the parameter's" if name == "absolute" else "texts")
    unit += _MANY.get(noun, "")
    if hasattr(kind, "options"):
        unit += ": " + ", ".join(f"`{option}`" for option in kind.options)
    return f"| `{field.alias or name}` | {unit} | {_default(model, name)} | {field.description} |"


def _default(model: type[Table], name: str) -> str:
    if model.model_fields[name].is_required():
        return "required"
    noun = Machine if model is MachineTable else model.noun
    value = next((f.default for f in fields(noun) if f.name == name), None) if noun else None
    if value in (None, MISSING, "", ()):
        return ""
    if isinstance(value, float):
        return f"{value:g}"
    return f"[{value[0]:g}, {value[1]:g}]" if isinstance(value, tuple) else str(value)
