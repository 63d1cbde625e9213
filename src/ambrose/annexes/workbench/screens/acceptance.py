"""Acceptance: the loop measured on the running machine over what was predicted, a page to sign."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from ambrose.annexes.workbench import blocks
from ambrose.annexes.workbench.project import MACHINE, Project
from ambrose.annexes.workbench.screens import Screen
from ambrose.annexes.workbench.screens.records import run_fields

_PAGE = "accept.html"


def show(project: Project, given: Mapping[str, Any]) -> dict[str, Any]:
    """The record and its controller, the job, the page."""
    fields = run_fields(project)
    record, controller = (field["value"] for field in fields)
    hint = (
        "A record of the running machine with excitation on every axis, also from the live rig, "
        "and the controller that ran."
    )
    buttons = [blocks.job("Measure and judge", "accept")]
    form = blocks.form("accept", fields, buttons, "Accept the machine", hint=hint)
    same = blocks.same(
        f"ambrose accept {MACHINE} controllers/{controller} records/{record} -o reports/{_PAGE}",
        "from ambrose.annexes.site.acceptance import accept",
        f'machine = amb.load_machine("{MACHINE}")',
        f'law = amb.read_controller("controllers/{controller}")',
        f'accepted = accept(machine, law, ["records/{record}"])',
        "print(accepted.passed)",
    )
    found = [form, same]
    if _PAGE in project.names("reports"):
        title = "The page to sign: open it alone and print it"
        found.append(blocks.page("page", project.path("reports", _PAGE), title))
    return blocks.content(found, jobs=["accept"])


SCREEN = Screen(show)
