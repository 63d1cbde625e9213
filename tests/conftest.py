"""Everywhere in the tests: shapes stated in docstrings are checked, `tests/` (random_systems) and
`benchmarks` are importable.

On CI Hypothesis repeats the same cases, so that a verdict depends on the commit alone; at a desk it
looks for new ones.
"""

import os
import re
import sys
from functools import cache
from importlib.util import find_spec
from pathlib import Path

from hypothesis import settings

sys.path.insert(0, str(Path(__file__).parent))
# the campaigns are commands and no part of the package
sys.path.append(str(Path(__file__).parents[1]))

import shape_contract

TESTS = Path(__file__).parent
BENCHMARKS = TESTS.parent / "benchmarks"
IMPORT = re.compile(r"^(?:from|import) [^#\n]*(?:\([^)]*\))?", re.M)
ANNEX = re.compile(r"ambrose\.annexes\.(\w+)")

shape_contract.install()
settings.register_profile("ci", derandomize=True, deadline=None)
settings.register_profile("desk", deadline=None)
settings.load_profile("ci" if os.environ.get("CI") else "desk")


def pytest_ignore_collect(collection_path):
    """Tests that import an annex that was taken off the tree go with it."""
    if collection_path.suffix != ".py":
        return None
    needed = annexes_behind(collection_path)
    return True if any(find_spec(f"ambrose.annexes.{name}") is None for name in needed) else None


@cache
def annexes_behind(path):
    """The annexes that a test imports, itself or by a benchmark or a helper of the tests."""
    imports = IMPORT.findall(path.read_text())
    behind = {name for line in imports for name in ANNEX.findall(line)}
    for line in imports:
        for name in re.findall(r"\w+", line):
            for file in (BENCHMARKS / f"{name}.py", TESTS / f"{name}.py"):
                if file != path and file.exists():
                    behind |= annexes_behind(file)
    return behind
