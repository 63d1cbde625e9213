"""Mended defects put back one by one: the suite must go red for each.

    python -m benchmarks.reverted_defects [--list] [--name NAME ...] [--checkout FOLDER]

``reverted_defects.toml`` holds the table: what the changelog says, the snippet of source as it
stands now, the snippet that is the defect, and the tests that know it. A snippet is searched for in
the whole package and must stand there once, so that files may move. The package is copied once to a
temporary folder; each defect is put into the copy, its tests run there until the first is red, and
the copy is as it was. In the end all those that were red run without a defect and must be green.
Exit status 1 where a defect stays green, where a test is red for another reason (a name that is not
there, say, is a snippet gone stale), or where a snippet is not found once.
"""

import argparse
import ast
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
import tomllib
import xml.etree.ElementTree as ET
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[1]
TABLE = Path(__file__).with_suffix(".toml")
# of an edit that is none, not of a defect
STALE = ("NameError", "ImportError", "ModuleNotFoundError", "SyntaxError", "UnboundLocalError")
LONGEST = 300.0  # s, ten times what a test in the table may take


class Unclear(Exception):
    """What keeps a defect from being judged."""


@dataclass(frozen=True)
class Defect:
    """A mended defect: the changelog's words; the source now, and with the defect; the tests that
    know it, as pytest's arguments.
    """

    name: str
    changelog: str
    now: str
    before: str
    tests: tuple[str, ...]

    def place(self, package: Path) -> Path:
        """The one file below ``package`` that holds the snippet. Raises Unclear."""
        counts = {
            file: file.read_text(encoding="utf-8").count(self.now) for file in sources(package)
        }
        found = [file for file, count in counts.items() if count]
        total = sum(counts.values())
        if total != 1:
            raise Unclear(f"its snippet is found {total} times, not once")
        return found[0]

    def put_into(self, file: Path) -> str:
        """The text of ``file`` with the defect. Raises Unclear where that is no Python."""
        text = file.read_text(encoding="utf-8").replace(self.now, self.before)
        if file.suffix == ".py":
            try:
                ast.parse(text)
            except SyntaxError as error:
                raise Unclear(f"with the defect {file.name} is no Python: {error}") from error
        return text


def sources(package: Path) -> list[Path]:
    """All that a defect can stand in: Python and templates of code."""
    return sorted(p for p in package.rglob("*") if p.suffix in {".py", ".j2", ".js", ".css"})


def read_table(path: Path = TABLE) -> list[Defect]:
    """The defects of the table, in its order."""
    rows = tomllib.loads(path.read_text(encoding="utf-8"))["defect"]
    return [Defect(**{**row, "tests": tuple(row["tests"])}) for row in rows]


def run_tests(checkout: Path, folder: Path, tests: tuple[str, ...]) -> tuple[str, str]:
    """The first test that is red with the package in ``folder``, and what it says; ("", "") where
    all are green. Raises Unclear.
    """
    report = folder / "report.xml"
    report.unlink(missing_ok=True)
    paths = [str(folder), os.environ.get("PYTHONPATH", "")]
    own = {"PYTHONPATH": os.pathsep.join(filter(None, paths)), "PYTHONDONTWRITEBYTECODE": ""}
    command = [sys.executable, "-m", "pytest", "-x", "-q", "-p", "no:cacheprovider"]
    command += ["-m", "not study", "--junitxml", str(report), *tests]
    environment = {"OPENBLAS_NUM_THREADS": "1", **os.environ, **own}
    try:
        done = subprocess.run(
            command,
            check=False,
            cwd=checkout,
            env=environment,
            capture_output=True,
            text=True,
            timeout=LONGEST,
        )
    except subprocess.TimeoutExpired as error:
        raise Unclear(f"its tests took more than {LONGEST:g} s") from error
    if done.returncode not in {0, 1}:
        raise Unclear((done.stdout + done.stderr).strip().splitlines()[-1])
    for case in ET.parse(report).getroot().iter("testcase"):
        for kind in ("failure", "error"):
            if (problem := case.find(kind)) is not None:
                return node_of(case, done.stdout), problem.get("message", "")
    return "", ""


def node_of(case: ET.Element, printed: str) -> str:
    """A test's name as pytest takes it, out of its short summary."""
    name = re.escape(case.get("name", ""))
    found = re.search(rf"^(?:FAILED|ERROR) (\S+?::(?:\w+::)*{name})(?: |$)", printed, re.M)
    if found is None:
        raise Unclear(f"{case.get('classname')} {case.get('name')} is no test")
    return found[1]


def judge(defect: Defect, checkout: Path, folder: Path) -> str:
    """The test that goes red with the defect. Raises Unclear."""
    original = defect.place(checkout / "src" / "ambrose")
    copy = folder / "ambrose" / original.relative_to(checkout / "src" / "ambrose")
    try:
        copy.write_text(defect.put_into(original), encoding="utf-8")
        test, words = run_tests(checkout, folder, defect.tests)
    finally:
        shutil.copy2(original, copy)
    if not test:
        raise Unclear("GREEN with the defect")
    if words.startswith(STALE):
        raise Unclear(f"{test} is red for another reason: {words.splitlines()[0]}")
    return test


def main(arguments: list[str] | None = None) -> int:
    """Every defect, or those named: a line each."""
    parser = argparse.ArgumentParser(description="Mended defects put back: does a test go red?")
    parser.add_argument("--name", action="append", help="this defect alone; more than once")
    parser.add_argument("--list", action="store_true", help="the table, and nothing run")
    parser.add_argument("--checkout", type=Path, default=ROOT, help="another state of the sources")
    chosen = parser.parse_args(arguments)
    table = read_table()
    if unknown := set(chosen.name or ()) - {defect.name for defect in table}:
        parser.error(f"no defect is called {', '.join(sorted(unknown))}; --list has their names")
    table = [d for d in table if not chosen.name or d.name in chosen.name]
    if chosen.list:
        print("\n".join(f"{d.name} | {d.changelog} | {' '.join(d.tests)}" for d in table))
        return 0
    checkout = chosen.checkout.resolve()
    caught: list[str] = []
    with tempfile.TemporaryDirectory() as name:
        # with the bytecode and the rig that were compiled before
        shutil.copytree(checkout / "src" / "ambrose", Path(name) / "ambrose")
        print("defect | red by | seconds")
        for defect in table:
            began = time.perf_counter()
            try:
                said = judge(defect, checkout, Path(name))
                caught.append(said)
            except Unclear as problem:
                said = f"NOT RED: {problem}"
            print(f"{defect.name} | {said} | {time.perf_counter() - began:.0f}", flush=True)
        anyway, words = run_tests(checkout, Path(name), tuple(caught)) if caught else ("", "")
    print(f"{len(caught)} of {len(table)} defects are red")
    if anyway:
        print(f"{anyway} is red without a defect, too: {words}")
    return 1 if anyway or len(caught) < len(table) else 0


if __name__ == "__main__":
    sys.exit(main())
