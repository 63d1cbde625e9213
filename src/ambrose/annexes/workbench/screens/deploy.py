"""Deploy: a controller as code for its target, the code's own test on this computer, a file to take
along.
"""

from __future__ import annotations

import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ambrose.annexes.workbench import blocks
from ambrose.annexes.workbench.blocks import Refusal
from ambrose.annexes.workbench.given import word
from ambrose.annexes.workbench.jobs import CHOICES
from ambrose.annexes.workbench.project import MACHINE, Project, slug
from ambrose.annexes.workbench.screens import Screen
from ambrose.code.c.self_test import run_self_test
from ambrose.machine.atomic_write import draft_of

_FILES = 200  # of a folder of code


def show(project: Project, given: Mapping[str, Any]) -> dict[str, Any]:
    """The export as a job; of every folder of code its files, its test, its archive."""
    names = project.names("controllers")
    form = blocks.form(
        "export",
        [
            blocks.choice("controller", "Controller", names, project.newest("controllers")),
            blocks.choice("target", "Target", CHOICES["target"], "c"),
            blocks.choice("arithmetic", "Arithmetic", CHOICES["arithmetic"], "double"),
            blocks.field("rate", "Sample rate [Hz], default: the file's"),
        ],
        [blocks.job("Export", "export")],
        "Write code",
        hint="The loop is verified as it will run before anything is written.",
    )
    controller = project.newest("controllers") or "pid.json"
    same = blocks.same(
        f"ambrose export controllers/{controller} --to c --machine {MACHINE} -o code/c",
        f'amb.export("controllers/{controller}", "code/c", to="c", machine="{MACHINE}")',
    )
    folders = [_folder(project, name) for name in code_folders(project)]
    return blocks.content([form, same, *(b for part in folders for b in part)], jobs=["export"])


def code_folders(project: Project) -> list[str]:
    """The folders of code, by name."""
    root = project.folder("code")
    return sorted(path.name for path in root.iterdir() if path.is_dir() and not path.is_symlink())


def _folder(project: Project, name: str) -> list[blocks.Block]:
    """What a folder of code holds and what can be done with it."""
    files = _files(project, name)
    rows = [(path.name, f"{path.stat().st_size} bytes") for path in files]
    buttons = [blocks.button("Pack", "pack", code=name)]
    if any(path.name.endswith("_test.c") for path in files):
        buttons.insert(0, blocks.button("Self test", "test", main=True, code=name))
    table = blocks.rows_table(f"code/{name}", ("file", "size"), rows)
    found = [blocks.table(f"files-{name}", table), blocks.form(f"do-{name}", (), buttons)]
    if f"{name}.zip" in project.names("code"):
        address = f"/files/code/{name}.zip"
        found.append(blocks.link(f"zip-{name}", address, f"Download {name}.zip"))
    return found


def _files(project: Project, name: str) -> list[Path]:
    """The ordinary files of a folder of code. Raises InvalidInput for another name."""
    root = project.folder("code") / slug(name, "folder of code")
    if not root.is_dir() or root.is_symlink():
        raise Refusal(f"there is no code/{name}; export it first")
    found = [path for path in sorted(root.iterdir()) if path.is_file() and not path.is_symlink()]
    return found[:_FILES]


def _test(project: Project, given: Mapping[str, Any]) -> dict[str, Any]:
    """The code's own test, compiled and run here."""
    name = word(given, "code")
    sources = [path for path in _files(project, name) if path.suffix == ".c"]
    ran = run_self_test(sources)
    title = f"Self test of code/{name}: {'passed' if ran.passed else 'failed'}"
    tone = "good" if ran.passed else "bad"
    same = {"Command line": f"cc -std=c99 -O2 -o test code/{name}/*.c -lm && ./test"}
    shown = blocks.form(f"test-{name}", (), (), title, tone=tone, log=ran.text, same=same)
    return blocks.content([shown], whole=False)


def _pack(project: Project, given: Mapping[str, Any]) -> dict[str, Any]:
    """A folder of code as one archive beside it."""
    name = word(given, "code")
    path = project.path("code", f"{name}.zip")
    files = _files(project, name)
    with draft_of(path, "archive") as draft, zipfile.ZipFile(draft, "w") as archive:
        for file in files:
            archive.write(file, f"{name}/{file.name}", zipfile.ZIP_DEFLATED)
    return {**show(project, given), "told": f"code/{path.name} is written."}


SCREEN = Screen(show, {"test": _test, "pack": _pack})
