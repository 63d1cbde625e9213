"""The JSON schema of machine files, made from the tables in file/tables.py."""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path
from typing import Any

from ambrose.machine.description import SCHEMA_VERSION
from ambrose.machine.kinds import PLACEHOLDER, quantity_schemas

DIALECT = "https://json-schema.org/draft/2020-12/schema"


def machine_schema() -> dict[str, Any]:
    """JSON schema (draft 2020-12) of a machine file, for editors: every table and key with its
    meaning, form and default.
    """
    # whoever reads a record needs no tables of machines
    from ambrose.machine.file.tables import machine_file

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


if __name__ == "__main__":  # python -m ambrose.machine.file.json_schema docs/machine.schema.json
    write_schema(machine_schema(), sys.argv[1])
