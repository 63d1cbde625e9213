"""The envelope: what every operating point asks for, proofs over tolerances and while the machine
moves, maps beyond; all of them jobs whose pages are shown.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from ambrose.annexes.workbench import blocks
from ambrose.annexes.workbench.project import MACHINE, Project
from ambrose.annexes.workbench.screens import Screen
from ambrose.machine.file.fields import fields_of
from ambrose.machine.file.toml import loads_machine, read_machine_text
from ambrose.report.tables import operating_points_table
from ambrose.report.units import quantity

_PAGES = {"verify.html": "What was verified", "map.html": "Maps over the range"}


def show(project: Project, given: Mapping[str, Any]) -> dict[str, Any]:
    """Requirements and points, the jobs, their pages."""
    text = read_machine_text(project.machine)
    machine = loads_machine(text, MACHINE)
    names = project.names("controllers")
    demands = [
        (name.partition(".")[2].replace("_", " "), value)
        for name, (_, value) in fields_of(text).items()
        if name.startswith("requirements.")
    ]
    rate = machine.operation.pressure_rate
    hint = (
        "Moving: give how fast it changes, for a proof while it does. "
        f"The file's pressure rate: {'none' if rate is None else quantity(rate, 'Pa')}."
    )
    form = blocks.form(
        "verify",
        [
            blocks.choice("controller", "Controller", names, project.newest("controllers")),
            blocks.field("pressure_rate", "Pressure rate, such as 20 bar/s"),
            blocks.field("speed_rate", "Run-up [rad/s²]"),
        ],
        [blocks.job("Verify", "verify"), blocks.job("Map", "map")],
        "Judge a controller",
        hint=hint,
    )
    controller = project.newest("controllers") or "pid.json"
    same = blocks.same(
        f"ambrose verify {MACHINE} --controller controllers/{controller} "
        "--report reports/verify.html",
        f'verified = amb.verify("{MACHINE}", "controllers/{controller}")',
        "print(verified.passed)",
    )
    wanted = blocks.rows_table("What is required", ("requirement", "value"), demands)
    written = project.names("reports")
    pages = [
        blocks.page(name, project.path("reports", name), title)
        for name, title in _PAGES.items()
        if name in written
    ]
    points = blocks.table("points", operating_points_table(machine.operation.envelope))
    return blocks.content(
        [form, same, points, blocks.table("demands", wanted), *pages], jobs=["verify", "map"]
    )


SCREEN = Screen(show)
