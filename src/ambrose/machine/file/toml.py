"""Machine files: TOML <-> Machine. The only place, with record/record.py, where units are
converted; inside all is SI.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
import tomllib
from collections.abc import Iterator, Mapping
from importlib.resources import files
from itertools import accumulate
from pathlib import Path
from typing import Any

from ambrose.core.checks import InvalidInput, invalid
from ambrose.machine.limits import TOML_BYTES, TOML_DEPTH, TOML_ENTRIES, excess
from ambrose.machine.machine import Machine
from ambrose.machine.messages import meant, shown
from ambrose.machine.ordinary_file import read_text

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
    from ambrose.machine.file.parse import machine_from_document

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
    """TOML of any kind as plain data, after its size was looked at (machine/limits.py); ``name``
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
