"""`ambrose lateral`."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import click

from ambrose.terminal import (
    AS_JSON,
    DELAY,
    MACHINE,
    RATE,
    claim,
    kept,
    kept_page,
    load,
    load_controller,
    print_table,
    progress_shown,
    say,
    say_json,
)


@click.command("lateral")
@MACHINE
@click.option(
    "--controller",
    type=click.Path(path_type=Path),
    default=None,
    help="A controller file (*.json); left out for a rotor on journal bearings alone.",
)
@click.option(
    "--point", help="The operating point at maximum continuous speed; default: the fastest one."
)
@click.option(
    "--trip-rpm",
    type=float,
    default=None,
    help="Trip speed; default: 1.05 times the highest running speed.",
)
@click.option(
    "--density",
    type=float,
    default=None,
    help="Mean gas density [kg/m3], for the screening of Level I.",
)
@click.option("--nominal", is_flag=True, help="Without the search over the tolerances.")
@RATE
@DELAY
@click.option(
    "-o", "--output", type=click.Path(path_type=Path), help="The report as a page (*.html)."
)
@click.option("--data", type=click.Path(path_type=Path), help="The report as data (lateral.json).")
@AS_JSON
def lateral_command(
    machine: str,
    controller: Path | None,
    point: str | None,
    trip_rpm: float | None,
    density: float | None,
    nominal: bool,
    rate_hz: float | None,
    delay_samples: int | None,
    output: Path | None,
    data: Path | None,
    as_json: bool,
) -> None:
    """Lateral analysis after API 617 and ISO 14839, clause by clause.

    Unbalance response with API's amounts placed for every mode, separation margins, vibration
    limit, clearances from rest to trip, stability Level I and II with each component's share, and
    load capacity. Clauses are recalled, not read from the standards, and marked so. Exit status 1:
    a row with a limit fails.
    """
    from ambrose.annexes.rotordynamics.analysis import lateral
    from ambrose.annexes.rotordynamics.standard import RPM

    description = load(machine, magnets=False)
    law = None if controller is None else load_controller(controller, description)
    claim(page=output, data=data)
    with progress_shown(as_json) as progress:
        result = lateral(
            description,
            law,
            point,
            trip=None if trip_rpm is None else trip_rpm * RPM,
            density=density,
            tolerances=not nominal,
            rate=rate_hz,
            delay_samples=delay_samples,
            progress=progress,
        )
        failure = kept_page(result, output, progress=progress)
        if data is not None:
            failure = kept(lambda path: _write(result, path), data) or failure
    if as_json:
        say_json(dict(result.to_dict()))
    else:
        rows = [
            (
                item.title,
                "-" if item.value is None else f"{item.value:.4g} {item.unit}".rstrip(" -"),
                "-" if item.limit is None else f"{item.relation} {item.limit:.4g}",
                "-" if item.passed is None else "holds" if item.passed else "fails",
            )
            for item in result.items
            if item.value is not None or item.passed is not None
        ]
        print_table(f"{description.name}: lateral analysis", ("item", "value", "limit", ""), rows)
        for note in result.notes:
            say(note)
    if failure is not None:
        raise failure
    sys.exit(0 if result.passed else 1)


def _write(result: Any, path: Path) -> None:
    import json

    from ambrose.machine.atomic_write import write_text

    write_text(path, json.dumps(dict(result.to_dict()), indent=1) + "\n", "lateral analysis")
