"""Files and names that prose speaks of exist: `room/file.py`, `docs/page.md`, `ambrose.room.name`, in docstrings, comments,
messages and pages alike."""

import importlib
import re
from functools import cache
from pathlib import Path

import pytest

pytestmark = pytest.mark.source

ROOT = Path(__file__).parents[2]
FOLDERS = ("src", "tests", "benchmarks", "examples", "docs", "docs_build")
PAGES = ("README.md", "CONTRIBUTING.md", "pyproject.toml", "Makefile")

# a path of Python, or of a page in docs/, that begins neither in a quotation mark (a file that a test makes) nor after
# another folder or a placeholder (ROOT/x.py, <folder>/x.py, *.py)
FILE = re.compile(r"(?<![\w/<>*{}\"'.$~-])((?:[\w-][\w.-]*/)*[\w-]+\.py|docs/[\w/-]+\.md)\b")
DOTTED = re.compile(r"(?<![\w./-])ambrose(?:\.[A-Za-z_]\w*)+")
ROOMS = "|".join(
    sorted(path.parent.name for path in (ROOT / "src" / "ambrose").glob("*/__init__.py"))
)
IN_A_ROOM = re.compile(rf"`((?:{ROOMS})(?:\.[A-Za-z_]\w*){{2,}})")

# another program's file; names that are forbidden; an error handler of codecs; a record that is being written
ELSEWHERE = {
    "ross/tests/test_examples.py",
    "utils.py",
    "base.py",
    "helpers.py",
    "ambrose.spell",
    "ambrose.record.h5.partial",
}


@cache
def files():
    """Every path below the root, and each of its ends: a/b/c.py, b/c.py, c.py."""
    known = set()
    for folder in FOLDERS:
        for path in (ROOT / folder).rglob("*"):
            parts = path.relative_to(ROOT).parts
            known |= {"/".join(parts[i:]) for i in range(len(parts))}
    return known | {path.name for path in ROOT.glob("*.*")}


@cache
def resolves(name):
    """Whether the dotted name is a module, or leads from one through names of its file (not imported: seconds)."""
    parts = name.split(".")
    for count in range(len(parts), 0, -1):
        path = ROOT / "src" / "/".join(parts[:count])
        if path.is_dir():
            return all(
                hasattr(importlib.import_module(".".join(parts[:count])), part)
                for part in parts[count : count + 1]
            )
        if path.with_suffix(".py").is_file():
            text = path.with_suffix(".py").read_text(encoding="utf-8")
            return all(
                re.search(rf"^\s*(?:def |class |from .* import .*\b)?{part}\b", text, re.MULTILINE)
                for part in parts[count:]
            )
    return False


def missing(text):
    """Paths and names in ``text`` that lead nowhere."""
    named = {name for name in FILE.findall(text) if name not in files()}
    dotted = {*DOTTED.findall(text), *(f"ambrose.{name}" for name in IN_A_ROOM.findall(text))}
    named |= {name for name in dotted if name not in ELSEWHERE and not resolves(name)}
    return sorted(named - ELSEWHERE)


@pytest.mark.parametrize("folder", [*FOLDERS, ""])
def test_what_prose_names_exists(folder):
    paths = [ROOT / page for page in PAGES]
    if folder:
        paths = [
            path
            for path in sorted((ROOT / folder).rglob("*"))
            if path.suffix in {".py", ".md", ".toml"}
        ]
    found = {
        path.relative_to(ROOT).as_posix(): lost
        for path in paths
        if path != Path(__file__) and (lost := missing(path.read_text(encoding="utf-8")))
    }
    assert not found


def test_a_name_that_leads_nowhere_is_noticed():
    text = "See verification/margins.py, core/lft.py, `judge.nobody.knows`, ambrose.simulate and ambrose.plant.model."
    assert missing(text) == [
        "ambrose.judge.nobody.knows",
        "ambrose.plant.model",
        "verification/margins.py",
    ]
