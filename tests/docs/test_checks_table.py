"""The table of checks of the page on verifying against the names that the code gives its checks."""

import ast
import re
from pathlib import Path

import pytest
from docs_build import DOCS

import ambrose

pytestmark = pytest.mark.source
PACKAGE = Path(ambrose.__file__).parent
# what makes checks of a controller: the verdict's own room, and the proofs of the annex that join
# it there
ROOMS = [PACKAGE / "judge", *(PACKAGE / "annexes" / name for name in ("scheduled", "synchronous"))]
MAKERS = {"judge", "Check"}


def texts(node):
    """The texts that an expression may be, what is put in as "*"."""
    if isinstance(node, ast.Constant) and isinstance(node.value, str):
        return {node.value}
    if isinstance(node, ast.JoinedStr):
        parts = [part.value if isinstance(part, ast.Constant) else "*" for part in node.values]
        return {"".join(parts)}
    if isinstance(node, ast.IfExp):
        return texts(node.body) | texts(node.orelse)
    return set()


def called(node):
    return getattr(node.func, "id", getattr(node.func, "attr", ""))


def names_in(tree):
    """The names of the checks with a limit that a module makes; of a variable all that it is set
    to, of an argument all that the module's calls give.
    """
    for function in (node for node in ast.walk(tree) if isinstance(node, ast.FunctionDef)):
        arguments = [argument.arg for argument in function.args.args]
        for call in (node for node in ast.walk(function) if isinstance(node, ast.Call)):
            if called(call) not in MAKERS or not call.args or function.name in MAKERS:
                continue
            first = call.args[0]
            yield from texts(first)
            if not isinstance(first, ast.Name):
                continue
            for node in ast.walk(function):
                if isinstance(node, ast.Assign) and first.id in map(ast.unparse, node.targets):
                    yield from texts(node.value)
            if first.id in arguments:
                place = arguments.index(first.id)
                for other in ast.walk(tree):
                    if isinstance(other, ast.Call) and called(other) == function.name:
                        yield from texts(other.args[place])


def in_code():
    found = set()
    for path in (path for room in ROOMS for path in room.rglob("*.py")):
        tree = ast.parse(path.read_text(encoding="utf-8"))
        names = {name for name in names_in(tree) if "." in name}
        if "*.*" in names:  # of a table of quantities
            makes = [n for n in ast.walk(tree) if isinstance(n, ast.Call)]
            heads = [n.args[0] for n in makes if called(n) == "_Quantity"]
            names |= {f"{head}.*" for node in heads for head in texts(node)}
            assert heads
        found |= names - {"*.*"}
    return found


def in_table():
    page = (DOCS / "how-to" / "verify.md").read_text(encoding="utf-8")
    section = page.partition("## What is checked")[2].partition("\n## ")[0]
    cells = re.findall(r"^\| (`[^|]*) \|", section, re.MULTILINE)
    names = {name for cell in cells for name in re.findall(r"`([^`]*)`", cell)}
    boxes = {f"synchronous.{name}.box" for name in ("gain", "margin", "sensitivity")}
    return names - {".box"} | (boxes if ".box" in names else set())


def test_every_check_that_code_makes_is_in_the_table_and_no_other():
    code, table = in_code(), in_table()
    margins = {"margin.gain.*", "margin.phase.*"}
    assert len(code) > 40 and margins < code
    code -= {"margin.*.output.*"}  # of measured responses: those two
    assert code - table == set(), "not in the table"
    assert table - code == set(), "in no code"
