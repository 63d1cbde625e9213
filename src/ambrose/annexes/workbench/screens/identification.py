"""Identification: what is unknown, the fit as a job, its page, the machine file written back."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from ambrose.annexes.workbench import beginning, blocks
from ambrose.annexes.workbench.blocks import Refusal
from ambrose.annexes.workbench.project import MACHINE, Project
from ambrose.annexes.workbench.screens import Screen
from ambrose.annexes.workbench.screens.records import run_fields
from ambrose.core.checks import InvalidInput
from ambrose.machine.file.toml import loads_machine, read_machine_text

_FOUND = "identified.toml"
_PAGE = "identify.html"


def show(project: Project, given: Mapping[str, Any]) -> dict[str, Any]:
    """What to identify from, and what was found."""
    fields = [*run_fields(project), blocks.field("unknown", "Unknown")]
    record, controller = (field["value"] for field in fields[:2])
    hint = (
        "Unknown: names as tolerances have them, such as bearing.*.negative_stiffness.*, with "
        "spaces between; what is usual where it is left empty. Choose the controller that ran."
    )
    form = blocks.form(
        "identify", fields, [blocks.job("Identify", "identify")], "Identify the machine", hint=hint
    )
    same = blocks.same(
        f"ambrose identify {MACHINE} records/{record} --controller controllers/{controller} "
        f"-o machines/{_FOUND} --report reports/{_PAGE}",
        f'found = amb.identify("{MACHINE}", "records/{record}", "controllers/{controller}")',
        "print(found.verdict)",
        "machine = found.machine",
    )
    found = [form, same]
    if _FOUND in project.names("machines"):
        back = blocks.button("Write back", "back", main=True)
        text = (
            f"machines/{_FOUND} is {MACHINE} with the identified values and their intervals, and "
            "nothing else changed. Read the verdict first."
        )
        found.append(blocks.form("back", (), [back], "Identified machine", hint=text))
    if _PAGE in project.names("reports"):
        found.append(blocks.page("page", project.path("reports", _PAGE), "What was found"))
    return blocks.content(found, jobs=["identify"])


def _back(project: Project, given: Mapping[str, Any]) -> dict[str, Any]:
    """The identified machine becomes the project's; the one before is kept beside it."""
    path = project.path("machines", _FOUND)
    if not path.is_file():
        raise Refusal(f"there is no machines/{_FOUND}; identify first")
    text = read_machine_text(path)
    try:
        loads_machine(text, _FOUND)
    except InvalidInput as error:
        raise Refusal(str(error)) from None
    told = beginning.keep(project, text)
    return {**show(project, given), "told": told}


SCREEN = Screen(show, {"back": _back})
