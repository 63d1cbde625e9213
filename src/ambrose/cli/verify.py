"""`ambrose verify`."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import click

from ambrose.cli.terminal import ALL, AS_JSON, MACHINE, load, print_checks, progress_shown


@click.command()
@MACHINE
@click.option("--controller", "path", type=click.Path(path_type=Path), required=True, help="A controller file (*.json).")
@ALL
@AS_JSON
def verify(machine: str, path: Path, everything: bool, as_json: bool) -> None:
    """Check a controller on the full plant: at every operating point of the machine, and over all its tolerances."""
    from ambrose.evaluation import verify_controller
    from ambrose.synthesis.controller_file import read_controller

    description = load(machine)
    controller = read_controller(path)
    with progress_shown(as_json) as progress:
        result = verify_controller(description, controller, progress=progress)
    box = result.tolerances
    if as_json:
        points = {"points": [checks.to_dict() for checks in result.points], "robust": box.to_dict() if box else None}
        left_out = {"left_out": list(result.left_out)} if result.left_out else {}
        click.echo(json.dumps({"machine": description.name, **points, **left_out}))
    else:
        for checks in [*result.points, *([box] if box else [])]:
            print_checks(checks, everything)
        for label in result.left_out:
            click.echo(f"{label}: left out, the schedule does not cover this operating point")
    sys.exit(0 if result.passed else 1)
