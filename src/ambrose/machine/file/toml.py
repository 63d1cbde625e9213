"""Machine files: TOML <-> Machine. The only place, with record/record.py, where units are converted; inside all is SI."""

from __future__ import annotations

import hashlib
import json
import os
import tomllib
from collections.abc import Iterator, Mapping
from importlib.resources import files
from pathlib import Path
from typing import Any

from ambrose.core.checks import InvalidInput, invalid
from ambrose.machine.machine import Machine
from ambrose.machine.messages import meant, shown
from ambrose.machine.ordinary_file import read_text


def bundled_machines() -> dict[str, Path]:
    """The machine files that come with the package, by name."""
    folder = Path(str(files("ambrose") / "machines"))
    return {path.stem: path for path in sorted(folder.glob("*.toml"))}


def load_machine(path: str | os.PathLike[str] | Machine) -> Machine:
    """The machine in a TOML file, or the bundled machine of that name; a Machine is returned as it is.

    Raises InvalidInput, one message with a line for each problem, for a file that is missing, unreadable or wrong.
    """
    return path if isinstance(path, Machine) else loads_machine(read_machine_text(path), name=str(path))


def loads_machine(text: str, name: str = "machine file") -> Machine:
    """The machine in TOML text; ``name`` stands in messages. Raises InvalidInput."""
    from ambrose.machine.file.parse import machine_from_document

    if not text.strip():
        raise InvalidInput(
            f"{name}: the file is empty; it needs at least [machine], [[shaft]], [[bearing]], [[sensor]], [amplifier]"
        )
    try:
        document = tomllib.loads(text)
    except RecursionError:
        raise InvalidInput(f"{name}: brackets are nested too deeply; a machine file nests lists at most three deep") from None
    except ValueError as error:
        remedy = "check quotes, brackets and commas there; a cut-off file ends like this too"
        raise InvalidInput(f"{name}: not valid TOML: {error}; {remedy}") from None
    return machine_from_document(document, name, text)


def dumps_machine(machine: Machine) -> str:
    """A machine as TOML text in SI numbers; keys that have their default value are left out."""
    return "\n".join(_lines(machine.to_dict(), "")).lstrip("\n") + "\n"


def machine_hash(machine: Machine) -> str:
    """SHA-256 (64 hexadecimal digits) of everything that is computed with; descriptions, sources and reasons do not count.

    It does not depend on how a file is formatted, on units or on keys written out with their default value.
    """
    document = machine.to_dict()
    for key in ("description", "source", "assumed"):
        document["machine"].pop(key, None)
    return hashlib.sha256(json.dumps(document, sort_keys=True, allow_nan=False).encode()).hexdigest()


def read_machine_text(file: Any) -> str:
    """The text of a machine file (its path), or of the bundled machine of that name. Raises InvalidInput."""
    if not isinstance(file, (str, os.PathLike)):
        remedy = f"give the path of a TOML file or one of {', '.join(bundled_machines())}"
        raise invalid("the machine", shown(file), "a file or the name of a bundled machine", remedy)
    bundled = bundled_machines()
    path = bundled.get(os.fspath(file), Path(file))
    try:
        return read_text(path, "machine file")
    except InvalidInput as error:
        if not isinstance(error.__cause__, FileNotFoundError):
            raise
        close = meant(str(path), bundled)
        hint = f'did you mean "{close}"?' if close else f"bundled machines: {', '.join(bundled)}"
        raise InvalidInput(f'"{path}" is neither a file nor a bundled machine; {hint}') from None


def _lines(table: Mapping[str, Any], path: str) -> Iterator[str]:
    """A table as lines of TOML: its values, then the tables in it."""
    import tomlkit

    def below(value: Any) -> bool:
        return isinstance(value, dict) or (isinstance(value, list) and bool(value) and isinstance(value[0], dict))

    def quoted(key: str) -> str:
        return tomlkit.key(key).as_string()

    def written(value: Any) -> str:
        if isinstance(value, list):
            comma = ",\n  " if value and isinstance(value[0], list) else ", "
            return f"[{comma.join(map(written, value))}]"
        return tomlkit.item(value).as_string()

    yield from (f"{quoted(key)} = {written(value)}" for key, value in table.items() if not below(value))
    for key, value in table.items():
        inner = f"{path}{quoted(key)}"
        for entry in value if isinstance(value, list) and below(value) else [value] if below(value) else []:
            yield f"\n[[{inner}]]" if isinstance(value, list) else f"\n[{inner}]"
            yield from _lines(entry, f"{inner}.")
