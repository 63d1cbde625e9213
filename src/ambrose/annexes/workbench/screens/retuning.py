"""Retuning: from a record of the machine as it has become to another controller, proved, coded and
tried, with the way back.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from ambrose.annexes.workbench import blocks
from ambrose.annexes.workbench.blocks import Refusal
from ambrose.annexes.workbench.project import MACHINE, Project
from ambrose.annexes.workbench.screens import Screen
from ambrose.annexes.workbench.screens.records import run_fields
from ambrose.machine.atomic_write import write_text

_FOLDER = "retuning"
_PAGE, _NEW = "retuning.html", "controller.json"


def show(project: Project, given: Mapping[str, Any]) -> dict[str, Any]:
    """The record and the controller that ran, the job, what came of it."""
    run = run_fields(project)
    record, controller = (field["value"] for field in run)
    fields = [
        *run,
        blocks.field("unknown", "Unknown"),
        blocks.field("changed", "The machine is known to have changed", False, "check"),
        blocks.field("anyway", "Design also where the running one does", False, "check"),
    ]
    hint = (
        "Identifies the machine, says what changed, judges the running controller, and designs "
        "another where it is needed. Minutes; what was done before it stops stays."
    )
    form = blocks.form("retune", fields, [blocks.job("Retune", "retune")], "Retune", hint=hint)
    same = blocks.same(
        f"ambrose retune {MACHINE} records/{record} --controller controllers/{controller} "
        f"-o {_FOLDER}",
        f'done = amb.retune("{MACHINE}", "records/{record}", "controllers/{controller}", '
        f'"{_FOLDER}")',
        "print(done.passed)",
    )
    found = [form, same]
    made = project.names(_FOLDER)
    if _NEW in made:
        take = blocks.button("Take it", "take", main=True)
        text = "It becomes a controller of this project; read first what was shown of it."
        found.append(blocks.form("take", (), [take], "The new controller", hint=text))
    if _PAGE in made:
        found.append(blocks.page("page", project.path(_FOLDER, _PAGE), "What was done"))
    return blocks.content(found, jobs=["retune"])


def _take(project: Project, given: Mapping[str, Any]) -> dict[str, Any]:
    """The new controller among the others."""
    path = project.path(_FOLDER, _NEW)
    if not path.is_file():
        raise Refusal(f"there is no {_FOLDER}/{_NEW}; retune first")
    target = project.free("controllers", "retuned")
    write_text(target, path.read_text(encoding="utf-8"), "controller")
    return {**show(project, given), "told": f"controllers/{target.name} is written."}


SCREEN = Screen(show, {"take": _take})
