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
    from ambrose.core.checks import invalid
    from ambrose.stages.plants import full_plants
    from ambrose.stages.proof import over_tolerances, verification
    from ambrose.synthesis.controller_file import match_controller, read_controller

    description = load(machine)
    file = read_controller(path)
    controller = file.law
    with progress_shown(as_json) as progress:
        plants = full_plants(description)
        if file.scheduled is not None:
            low, high = file.scheduled.range
            plants = tuple(plant for plant in plants if low <= plant.point.speed <= high)
            if not plants:
                raise invalid(
                    "the scheduled range", f"{low:g} to {high:g} rad/s", "one with an operating point of the machine in it",
                    "design over the machine's own speeds",
                )  # fmt: skip
        points = verification(plants, controller, progress)
        over_box = over_tolerances(plants[0], match_controller(controller, plants[0]), points[0].stable, progress)
    if as_json:
        found = {"points": [r.to_dict() for r in points], "robust": over_box.to_dict() if over_box else None}
        click.echo(json.dumps({"machine": description.name, **found}))
    else:
        for result in [*points, *([over_box] if over_box else [])]:
            print_checks(result, everything)
    sys.exit(0 if all(r.passed for r in points) and (over_box is None or over_box.passed) else 1)
