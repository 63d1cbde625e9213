"""What takes long and compares: every controller that the machine allows, how small its magnets may
be, a plan of many cases.
"""

import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import tomlkit
from tomlkit.exceptions import TOMLKitError

from ambrose.annexes.workbench import blocks
from ambrose.annexes.workbench.blocks import Block, Refusal, word
from ambrose.annexes.workbench.jobs import CHOICES
from ambrose.annexes.workbench.project import MACHINE, Project, slug
from ambrose.annexes.workbench.screens import Screen
from ambrose.code.c.compiled import run_self_test
from ambrose.core.checks import InvalidInput
from ambrose.machine.file.toml import load_machine, loads_machine, read_machine_text
from ambrose.machine.file.update import fields_of
from ambrose.machine.machine import Machine
from ambrose.machine.ordinary_file import draft_of, write_text
from ambrose.report.tables import operating_points_table
from ambrose.report.theme import quantity

# The envelope: what every operating point asks for, proofs over tolerances and while the machine
# moves, maps beyond; all of them jobs whose pages are shown.


_PAGES = {"verify.html": "What was verified", "map.html": "Maps over the range"}


def show_envelope(project: Project, given: Mapping[str, Any]) -> dict[str, Any]:
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
        "For a proof while pressure or speed changes, state the rate. "
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
        "Check a controller",
        hint=hint,
    )
    controller = project.newest("controllers") or "pid.json"
    same = blocks.same(
        f"ambrose verify {MACHINE} --controller controllers/{controller} "
        "--report reports/verify.html",
        f'verified = amb.verify("{MACHINE}", "controllers/{controller}")',
        "print(verified.passed)",
    )
    wanted = blocks.rows_table("Requirements", ("requirement", "value"), demands)
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


SCREEN_ENVELOPE = Screen(show_envelope)


_EVERY = "every controller"
_TASKS = ("screen", "verify")
_LONGEST = 4000  # characters of what is varied
_FILES = ("machine", "controller", "scenario")  # whole ones are no numbers to vary
_PAGES_STUDIES = (
    ("reports", "size.html", "How small the magnets may be"),
    ("study", "report.html", "The study"),
    ("campaign", "report.html", "The campaign"),
)


def show_studies(project: Project, given: Mapping[str, Any]) -> dict[str, Any]:
    """The three jobs and their pages."""
    machine = load_machine(project.machine)
    written = [
        blocks.page(folder, project.path(folder, name), title)
        for folder, name, title in _PAGES_STUDIES
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
    items = [_study(), _size(), *_campaign(project, machine), same, *written]
    return blocks.content(items, jobs=["study", "size", "campaign"])


def _study() -> Block:
    hint = "Every controller that the machine file allows: designed, verified, simulated, compared."
    return blocks.form("do-study", (), [blocks.job("Study", "study")], "The whole chain", hint=hint)


def _size() -> Block:
    fields = [
        blocks.field("areas", "Pole areas over the file's", "0.35, 0.5, 0.7, 1"),
        blocks.field("biases", "Bias currents over the file's", "0.5, 0.7, 1"),
        blocks.field("rate", "Sample rate [Hz], default: the file's"),
    ]
    hint = "The size with the least copper and iron is verified and written to machines/sized.toml."
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
    items = [blocks.form("plan", fields, [write], "A plan of many cases", hint=hint)]
    plans = project.names("plans")
    if plans:
        newest = max(plans, key=lambda name: project.path("plans", name).stat().st_mtime)
        chosen = blocks.choice("plan", "Plan", plans, newest)
        button = blocks.job("Compute", "campaign")
        hint = "A cancelled campaign continues where it stopped."
        items.append(blocks.form("do-campaign", [chosen], [button], "The campaign", hint=hint))
    return items


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
    return {**show_studies(project, given), "told": f"plans/{path.name} is written."}


def _vary(text: str) -> dict[str, Any]:
    """The table of what is varied. Raises Refusal."""
    try:
        vary: dict[str, Any] = tomlkit.parse(text).unwrap()
    except (TOMLKitError, ValueError, RecursionError) as error:
        problem = (
            f"what is varied cannot be read: {error}; write a path in quotes, = and its values"
        )
    else:
        whole = [path for path in vary if path in _FILES]
        if not whole:
            return vary
        problem = f"{whole[0]} whole is chosen above; vary numbers of it, such as controller.gain"
    raise Refusal(problem, {"vary": problem})


SCREEN_STUDIES = Screen(show_studies, {"plan": _plan})


# Deploy: a controller as code for its target, the code's own test on this computer, a file to take
# along.


_FILES_DEPLOY = 200  # of a folder of code


def show_deploy(project: Project, given: Mapping[str, Any]) -> dict[str, Any]:
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
    items = [blocks.table(f"files-{name}", table), blocks.form(f"do-{name}", (), buttons)]
    if f"{name}.zip" in project.names("code"):
        address = f"/files/code/{name}.zip"
        items.append(blocks.link(f"zip-{name}", address, f"Download {name}.zip"))
    return items


def _files(project: Project, name: str) -> list[Path]:
    """The ordinary files of a folder of code. Raises InvalidInput for another name."""
    root = project.folder("code") / slug(name, "folder of code")
    if not root.is_dir() or root.is_symlink():
        raise Refusal(f"there is no code/{name}; export it first")
    files = [path for path in sorted(root.iterdir()) if path.is_file() and not path.is_symlink()]
    return files[:_FILES_DEPLOY]


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
    return {**show_deploy(project, given), "told": f"code/{path.name} is written."}


SCREEN_DEPLOY = Screen(show_deploy, {"test": _test, "pack": _pack})
