"""An annex that is taken off the tree takes with it what it registered, nothing else."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import ambrose
from ambrose.registry import annexes

SOURCE = Path(ambrose.__file__).parent

# run in a process of its own, on a tree without the annex
LOOK = """
import importlib, json, pkgutil
import ambrose
from ambrose.cli import main
for module in pkgutil.walk_packages(ambrose.__path__, "ambrose."):
    if not module.name.endswith("__main__"):
        importlib.import_module(module.name)
for name in ambrose.__all__:
    getattr(ambrose, name)
plant = ambrose.reduce(ambrose.assemble("two-disc-rotor"))
checks = ambrose.verify(plant, ambrose.design("two-disc-rotor", "pid"), tolerances=False)
print(json.dumps([sorted(main.commands), sorted(ambrose.__all__), len(checks.points)]))
"""


def look(source):
    environment = {**os.environ, "PYTHONPATH": str(source)}
    done = subprocess.run(
        [sys.executable, "-c", LOOK],
        env=environment,
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


@pytest.mark.parametrize(
    "gone", [annexes(), *(pytest.param((name,), marks=pytest.mark.study) for name in annexes())]
)
def test_the_rest_stands_without_it(gone, tmp_path):
    """All of them at once: none imports another (lint-imports), so that one alone takes no more."""
    shutil.copytree(SOURCE, tmp_path / "ambrose", ignore=shutil.ignore_patterns("__pycache__"))
    for annex in gone:
        shutil.rmtree(tmp_path / "ambrose" / "annexes" / annex)
    commands, public, points = look(tmp_path)
    for annex in gone:
        table = __import__(f"ambrose.annexes.{annex}", fromlist=["ANNEX"]).ANNEX
        own = {name for kind, row in table.items() if kind.endswith("command") for name in row}
        # what has no command of its own is an extension of those that there are
        assert own or set(table) == {"beside"}
        assert not own & set(commands)
        assert not set(table.get("public", {})) & set(public)
    assert {"verify", "synthesize", "check"} <= set(commands)
    assert points == 1
