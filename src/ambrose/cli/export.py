"""`ambrose export`."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import click

from ambrose.cli.options import chosen_from, groups_from, options_from
from ambrose.code.targets import TARGETS
from ambrose.terminal import AS_JSON, GroupedCommand, load, progress_shown, say, say_json

_WORD = "--to"
_GROUPS = {
    "": ("target", "output", "machine", "axial", "replaces", "name", "arithmetic", "rate", "force"),
    "Scheduled controllers": (
        "speed_limit",
        "speed_rate",
        "pressure_limit",
        "pressure_rate",
        "fallback",
        "pressure_error",
        "stuck_after",
    ),
    "On its processor": ("try_on", "clock", "flash", "ram", "bare_metal"),
    **groups_from(TARGETS, "With every target", _WORD),
}


@click.command(cls=GroupedCommand, groups=_GROUPS)
@click.argument("controller", type=click.Path(path_type=Path))
@click.option(
    _WORD,
    "target",
    type=click.Choice(list(TARGETS)),
    required=True,
    help="What to write: C99, a MAT-file, FMUs (FMI 2.0 and 3.0) or structured text.",
)
@click.option(
    "-o",
    "--output",
    type=click.Path(path_type=Path),
    required=True,
    help="Directory for the files.",
)
@click.option(
    "--machine",
    "machine",
    default=None,
    help="Default: the bundled machine that the controller was made for.",
)
@options_from(TARGETS)
@click.option(
    "--fallback",
    type=click.Path(path_type=Path),
    help="Fixed controller for when a schedule's pressure cannot be trusted.",
)
@click.option(
    "--axial",
    type=click.Path(path_type=Path),
    help="The controller of machine.toml#axial: both as one unit of all axes (C, FMU).",
)
@click.option(
    "--replaces",
    type=click.Path(path_type=Path),
    help="The controller that runs now: what changes in the tables of its code, and the way back.",
)
@AS_JSON
def export(
    controller: Path,
    target: str,
    output: Path,
    machine: str | None,
    fallback: Path | None,
    replaces: Path | None,
    axial: Path | None,
    as_json: bool,
    **asked: Any,
) -> None:
    """Sample a controller, verify its loop as it will run, and write it as code for the target.

    A scheduled controller is written in floating point, verified at frozen speeds or pressures over
    its range.
    """
    from ambrose.code.pipeline import export as write_for_target
    from ambrose.judge.controller_file import read_controller

    chosen = chosen_from(TARGETS, target, asked, _WORD)
    other = None if fallback is None else read_controller(fallback)
    file, known = read_controller(controller), None if machine is None else load(machine)
    running = None if replaces is None else read_controller(replaces)
    with progress_shown(as_json) as progress:
        delivery = write_for_target(
            file,
            output,
            to=chosen,
            machine=known,
            fallback=other,
            replaces=running,
            axial=None if axial is None else read_controller(axial),
            progress=progress,
        )
    content = delivery.to_dict()
    if as_json:
        say_json(content)
    else:
        for problem in content["problems"]:
            say(f"forced although {problem}", err=True)
        for limit in content["unmet_limits"]:
            say(f"the loop as it runs misses a limit: {limit}", err=True)
        if delivery.not_alike:
            say(f"no parameters.json: {delivery.not_alike}", err=True)
        if delivery.trial is not None:
            say(f"{delivery.trial.processor.name}: {delivery.trial.text}", err=True)
        for path in content["files"]:
            say(path)
    sys.exit(0 if content["verified"] and not content["unmet_limits"] else 1)
