"""What takes long and compares: every controller that the machine allows, how small its magnets may
be, a plan of many cases.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import tomlkit
from tomlkit.exceptions import TOMLKitError

from ambrose.annexes.workbench import blocks
from ambrose.annexes.workbench.blocks import Block, Refusal
from ambrose.annexes.workbench.given import word
from ambrose.annexes.workbench.project import MACHINE, Project, slug
from ambrose.annexes.workbench.screens import Screen
from ambrose.core.checks import InvalidInput
from ambrose.machine.atomic_write import write_text
from ambrose.machine.file.toml import load_machine
from ambrose.machine.machine import Machine

_EVERY = "every controller"
_TASKS = ("screen", "verify")
_LONGEST = 4000  # characters of what is varied
_FILES = ("machine", "controller", "scenario")  # whole ones are no numbers to vary
_PAGES = (
    ("reports", "size.html", "How small the magnets may be"),
    ("study", "report.html", "The study"),
    ("campaign", "report.html", "The campaign"),
)


def show(project: Project, given: Mapping[str, Any]) -> dict[str, Any]:
    """The three jobs and their pages."""
    machine = load_machine(project.machine)
    written = [
        blocks.page(folder, project.path(folder, name), title)
        for folder, name, title in _PAGES
        if name in project.names(folder)
    ]
    commands = (
        f"ambrose study {MACHINE} -o study",
        f"ambrose size {MACHINE} -o reports/size.html --machine-out machines/sized.toml",
        "ambrose campaign plans/plan.toml -o campaign",
    )
    same = blocks.same(
        "\n".join(commands),
        f'amb.study("{MACHINE}", "study")',
        f'sized = amb.size("{MACHINE}")',
        'amb.campaign("plans/plan.toml", "campaign")',
    )
    found = [_study(), _size(), *_campaign(project, machine), same, *written]
    return blocks.content(found, jobs=["study", "size", "campaign"])


def _study() -> Block:
    hint = "Every controller that the machine file allows: designed, verified, simulated, compared."
    return blocks.form("do-study", (), [blocks.job("Study", "study")], "The whole chain", hint=hint)


def _size() -> Block:
    fields = [
        blocks.field("areas", "Pole areas over the file's", "0.35, 0.5, 0.7, 1"),
        blocks.field("biases", "Bias currents over the file's", "0.5, 0.7, 1"),
        blocks.field("rate", "Sample rate [Hz], default: the file's"),
    ]
    hint = "The size with the least copper and iron is verified and stands in machines/sized.toml."
    button = blocks.job("Size", "size")
    return blocks.form("do-size", fields, [button], "Smaller magnets", hint=hint)


def _campaign(project: Project, machine: Machine) -> list[Block]:
    names = project.names("controllers")
    fields = [
        blocks.choice("task", "For every case", _TASKS),
        blocks.choice("controller", "Controller", [*names, _EVERY] if names else ["pid"]),
        blocks.field("vary", "What is varied", _varied(machine), "area"),
        blocks.field("name", "Name", "plan"),
    ]
    hint = (
        "Screen: stability and the largest sensitivity of the linear loop. Verify: every check. "
        "All combinations are taken; a path may also be machine.bearing.*.negative_stiffness, "
        "tolerance.<parameter> (-1 to 1), or controller.gain."
    )
    write = blocks.button("Write the plan", "plan", main=True)
    found = [blocks.form("plan", fields, [write], "A plan of many cases", hint=hint)]
    plans = project.names("plans")
    if plans:
        newest = max(plans, key=lambda name: project.path("plans", name).stat().st_mtime)
        chosen = blocks.choice("plan", "Plan", plans, newest)
        button = blocks.job("Compute", "campaign")
        hint = "Rows are kept as they come: what was cancelled goes on where it was."
        found.append(blocks.form("do-campaign", [chosen], [button], "The campaign", hint=hint))
    return found


def _varied(machine: Machine) -> str:
    """A first table of what is varied: the gain, and the operating point where it has a range."""
    lines = ['"controller.gain" = { from = 0.5, to = 2.0, count = 7 }']
    ranges = {"speed": machine.operation.speed_range}
    if machine.seals:
        pressures = [point.seal_pressure for point in machine.operation.envelope]
        ranges["seal_pressure"] = (min(pressures), max(pressures))
    units = {"speed": "rad/s", "seal_pressure": "Pa"}
    for key, (low, high) in ranges.items():
        if high > low:
            ends = (f'"{value:.6g} {units[key]}"' for value in (low, high))
            lines.append('"point.{}" = {{ from = {}, to = {}, count = 5 }}'.format(key, *ends))
    return "\n".join(lines) + "\n"


def _plan(project: Project, given: Mapping[str, Any]) -> dict[str, Any]:
    """A plan from the form; the command looks at what it says. Raises Refusal."""
    try:
        name = slug(word(given, "name"), "plan")
    except InvalidInput as error:
        raise Refusal(str(error), {"name": str(error)}) from None
    task, controller = word(given, "task"), word(given, "controller")
    head: dict[str, Any] = {"task": task, "machine": f"../{MACHINE}"}
    vary = _vary(word(given, "vary", _LONGEST))
    files = {known: f"../controllers/{known}" for known in project.names("controllers")}
    if controller == _EVERY:
        vary["controller"] = list(files.values())
    else:
        head["controller"] = files.get(controller, "pid")
    path = project.free("plans", name)
    write_text(path, tomlkit.dumps({"campaign": head, "vary": vary}), "plan")
    return {**show(project, given), "told": f"plans/{path.name} is written."}


def _vary(text: str) -> dict[str, Any]:
    """The table of what is varied. Raises Refusal."""
    try:
        vary: dict[str, Any] = tomlkit.parse(text).unwrap()
    except (TOMLKitError, ValueError, RecursionError) as error:
        told = f"what is varied cannot be read: {error}; write a path in quotes, = and its values"
    else:
        whole = [path for path in vary if path in _FILES]
        if not whole:
            return vary
        told = f"{whole[0]} whole is chosen above; vary numbers of it, such as controller.gain"
    raise Refusal(told, {"vary": told})


SCREEN = Screen(show, {"plan": _plan})
