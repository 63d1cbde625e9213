"""Everywhere in the tests: shapes stated in docstrings are checked, `tests/` (random_systems) and
`benchmarks` are importable, slow tests run where a change reaches them (``reach.py``).

On CI Hypothesis repeats the same cases, so that a verdict depends on the commit alone; at a desk it
looks for new ones.
"""

import gc
import os
import re
import shutil
import sys
import time
from functools import cache
from importlib.util import find_spec
from pathlib import Path

import pytest
from hypothesis import settings

sys.path.insert(0, str(Path(__file__).parent))
# the campaigns are commands and no part of the package
sys.path.append(str(Path(__file__).parents[1]))

import reach
import shape_contract

TESTS = Path(__file__).parent
BENCHMARKS = TESTS.parent / "benchmarks"
IMPORT = re.compile(r"^(?:from|import) [^#\n]*(?:\([^)]*\))?", re.M)
ANNEX = re.compile(r"ambrose\.annexes\.(\w+)")

shape_contract.install()
import compiled_once  # noqa: E402 - imports the package, which is looked at from here on
import machines_once  # noqa: E402

compiled_once.install()
machines_once.install()
settings.register_profile("ci", derandomize=True, deadline=None)
settings.register_profile("desk", deadline=None)
settings.load_profile("ci" if os.environ.get("CI") else "desk")
LEFT = pytest.StashKey[list]()
WHY = pytest.StashKey[str]()
BEGIN = pytest.StashKey[tuple]()
MEASURED, ALONE = {}, {}
COSTS = {}  # [s] of every fixture that may be several tests'
NEW = set()  # those of them that the running test has set up


@pytest.fixture
def values_alone(monkeypatch):
    """Identification without its search for what the model may lack, a third of its time and more,
    where a test looks at the values.
    """
    monkeypatch.setattr("ambrose.identification.loop.suspects", lambda *given, **how: ())


def pytest_addoption(parser):
    parser.addoption("--all", action="store_true", help="slow tests, too, whatever differs")
    parser.addoption("--quick", action="store_true", help="no slow test, whatever differs")
    parser.addoption("--base", metavar="REVISION", help="what differs from this decides, not main")
    parser.addoption("--renew-durations", action="store_true", help="write tests/durations.json")


def pytest_configure(config):
    """What differs from the main branch is asked of git once, and the workers are told."""
    os.environ.pop("COLUMNS", None)  # a worker has that of the terminal that started it
    if hasattr(config, "workerinput"):
        config.stash[LEFT] = config.workerinput["left"]
        return
    left, why = [], "all tests: " + ("on CI" if os.environ.get("CI") else "--all")
    if config.getoption("quick"):
        left, why = reach.left_out([], quick=True), "quick tests only"
    elif not (config.getoption("all") or os.environ.get("CI")):
        try:
            changed = reach.changed_files(base=config.getoption("base"))
            left = reach.left_out(changed)
            why = f"without {len(left)} slow tests that reach none of the {len(changed)} files "
            why += "that differ from the main branch (make test-all runs them)"
        except reach.Unknown as problem:
            why = f"all tests: {problem}"
    config.stash[LEFT], config.stash[WHY] = left, why


@pytest.hookimpl(optionalhook=True)
def pytest_configure_node(node):
    node.workerinput["left"] = node.config.stash[LEFT]


def pytest_sessionstart(session):
    """Which tests run, and why; a header is left out by -q."""
    printer = session.config.pluginmanager.get_plugin("terminalreporter")
    if printer and WHY in session.config.stash:  # no worker has it
        printer.write_line(session.config.stash[WHY])


@pytest.hookimpl(wrapper=True)
def pytest_collection():
    """What is collected stays until the end: the collector of garbage never looks at it."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.enable()
        gc.freeze()


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(config, items):
    """Folders and the whole tree are thinned out; a file or a test that is named runs."""
    if all(Path(argument).is_dir() for argument in config.args):
        left = set(config.stash[LEFT])
        config.hook.pytest_deselected(items=[item for item in items if item.nodeid in left])
        items[:] = reach.longest_first([item for item in items if item.nodeid not in left])


def seconds():
    """Processor time of this process and of those that it waited for, and the clock's."""
    return sum(os.times()[:4]), time.perf_counter()


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup(item):
    item.stash[BEGIN] = seconds()
    NEW.clear()
    shape_contract.begin()


@pytest.hookimpl(wrapper=True)
def pytest_fixture_setup(fixturedef):
    """What a fixture costs that a test sets up for others, too."""
    begin = seconds()
    try:
        return (yield)
    finally:
        if fixturedef.scope != "function":
            COSTS[fixturedef] = max(now - then for now, then in zip(seconds(), begin, strict=True))
            NEW.add(fixturedef)


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_teardown(item):
    took = [now - then for now, then in zip(seconds(), item.stash[BEGIN], strict=True)]
    # and what other tests have set up for it: alone it would pay for that
    used = {one for found in item._fixtureinfo.name2fixturedefs.values() for one in found}
    shared = sum(COSTS[one] for one in used & COSTS.keys() - NEW)
    item.user_properties += [("seconds", took), ("shared", shared)]


def pytest_runtest_logreport(report):
    if report.when == "teardown":
        told = dict(report.user_properties)
        MEASURED[report.nodeid] = told.get("seconds", (0.0, 0.0))
        # a browser and servers that go on are no children that were waited for
        ALONE[report.nodeid] = max(MEASURED[report.nodeid]) + told.get("shared", 0.0)


def pytest_unconfigure(config):
    if not hasattr(config, "workerinput"):
        shutil.rmtree(compiled_once.KEPT, ignore_errors=True)


def pytest_terminal_summary(terminalreporter, config):
    """What was slowest; the file of durations, where it was asked for."""
    slowest = sorted(MEASURED.items(), key=lambda entry: -max(entry[1]))[:10]
    if os.environ.get("CI") and slowest:
        terminalreporter.section("ten slowest, seconds of processor time and by the clock")
        for name, (processor, clock) in slowest:
            terminalreporter.write_line(f"{processor:6.1f} {clock:6.1f} {name}")
    if config.getoption("renew_durations"):
        reach.write_durations(ALONE)


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
        # a module of the package may be called as a benchmark is
        for name in re.findall(r"\w+", line) if "ambrose" not in line else ():
            for file in (BENCHMARKS / f"{name}.py", TESTS / f"{name}.py"):
                if file != path and file.exists():
                    behind |= annexes_behind(file)
    return behind
