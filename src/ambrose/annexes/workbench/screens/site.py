"""Retuning: from a record of the machine as it has become to another controller, proved, coded and
tried, with the way back.
"""

from collections.abc import Mapping
from typing import Any

from ambrose.annexes.workbench import blocks, project as beginning
from ambrose.annexes.workbench.blocks import Refusal
from ambrose.annexes.workbench.project import MACHINE, Project
from ambrose.annexes.workbench.screens import Screen
from ambrose.annexes.workbench.screens.machine import run_fields
from ambrose.core.checks import InvalidInput
from ambrose.machine.file.toml import loads_machine, read_machine_text
from ambrose.machine.ordinary_file import write_text

# Identification: what is unknown, the fit as a job, its page, the machine file written back.


_FOUND = "identified.toml"
_PAGE = "identify.html"


def show_identification(project: Project, given: Mapping[str, Any]) -> dict[str, Any]:
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
    return {**show_identification(project, given), "told": told}


SCREEN_IDENTIFICATION = Screen(show_identification, {"back": _back})


# Acceptance: the loop measured on the running machine over what was predicted, a page to sign.


_SIGNED = "accept.html"


def show_acceptance(project: Project, given: Mapping[str, Any]) -> dict[str, Any]:
    """The record and its controller, the job, the page."""
    fields = run_fields(project)
    record, controller = (field["value"] for field in fields)
    hint = (
        "A record of the running machine with excitation on every axis, also from the live rig, "
        "and the controller that ran."
    )
    buttons = [blocks.job("Measure and check", "accept")]
    form = blocks.form("accept", fields, buttons, "Accept the machine", hint=hint)
    same = blocks.same(
        f"ambrose accept {MACHINE} controllers/{controller} records/{record} -o reports/{_SIGNED}",
        "from ambrose.annexes.site.acceptance import accept",
        f'machine = amb.load_machine("{MACHINE}")',
        f'law = amb.read_controller("controllers/{controller}")',
        f'accepted = accept(machine, law, ["records/{record}"])',
        "print(accepted.passed)",
    )
    found = [form, same]
    if _SIGNED in project.names("reports"):
        title = "The page to sign: open it alone and print it"
        found.append(blocks.page("page", project.path("reports", _SIGNED), title))
    return blocks.content(found, jobs=["accept"])


SCREEN_ACCEPTANCE = Screen(show_acceptance)


_FOLDER = "retuning"
_PAGE_RETUNING, _NEW = "retuning.html", "controller.json"


def show_retuning(project: Project, given: Mapping[str, Any]) -> dict[str, Any]:
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
        text = "It becomes a controller of this project. Read its page first."
        found.append(blocks.form("take", (), [take], "The new controller", hint=text))
    if _PAGE_RETUNING in made:
        found.append(blocks.page("page", project.path(_FOLDER, _PAGE_RETUNING), "What was done"))
    return blocks.content(found, jobs=["retune"])


def _take(project: Project, given: Mapping[str, Any]) -> dict[str, Any]:
    """The new controller among the others."""
    path = project.path(_FOLDER, _NEW)
    if not path.is_file():
        raise Refusal(f"there is no {_FOLDER}/{_NEW}; retune first")
    target = project.free("controllers", "retuned")
    write_text(target, path.read_text(encoding="utf-8"), "controller")
    return {**show_retuning(project, given), "told": f"controllers/{target.name} is written."}


SCREEN_RETUNING = Screen(show_retuning, {"take": _take})
