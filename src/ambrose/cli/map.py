"""`ambrose map`."""

from __future__ import annotations

import sys
from pathlib import Path

import click

from ambrose.terminal import (
    AS_JSON,
    DELAY,
    MACHINE,
    RATE,
    claim,
    kept_page,
    load,
    load_controller,
    print_table,
    progress_shown,
    say,
    say_json,
)

# those of judge/exploration.py, which is not imported for --help
PARTS = ("poles", "campbell", "pulses", "unbalance")


@click.command("map")
@MACHINE
@click.option(
    "--controller",
    type=click.Path(path_type=Path),
    required=True,
    help="A controller file (*.json).",
)
@click.option(
    "--what", type=click.Choice(PARTS), multiple=True, help="Only this (repeatable); default: all."
)
@click.option(
    "--point", help="Label of an operating point, or its beginning; default: the design point."
)
@click.option(
    "--pressure-bar",
    nargs=2,
    type=float,
    default=None,
    help="Poles over this range of the seal pressure.",
)
@click.option(
    "--speed-rpm", nargs=2, type=float, default=None, help="Poles over this range of the speed."
)
@click.option("--bound", is_flag=True, help="An upper bound beside the worst unbalance found.")
@RATE
@DELAY
@click.option("-o", "--output", type=click.Path(path_type=Path), help="A page (*.html).")
@AS_JSON
def map_command(
    machine: str,
    controller: Path,
    what: tuple[str, ...],
    point: str | None,
    pressure_bar: tuple[float, float] | None,
    speed_rpm: tuple[float, float] | None,
    bound: bool,
    rate_hz: float | None,
    delay_samples: int | None,
    output: Path | None,
    as_json: bool,
) -> None:
    """Map a loop over its range: poles over speed and pressure, Campbell, pulse and unbalance over
    the tolerances.

    Where stability ends over speed and pressure, beyond what the machine file asks for; how far all
    members of the tolerances swing after a pulse; the worst orbit by unbalance over speed. Exit
    status 1: not stable everywhere in the machine's own range.
    """
    from math import pi

    from ambrose.judge.exploration import explore
    from ambrose.report import units
    from ambrose.report.exploration import exploration_page

    description = load(machine)
    law = load_controller(controller, description)
    claim(page=output)
    reach = {}
    if pressure_bar is not None:
        reach["pressure"] = (1e5 * pressure_bar[0], 1e5 * pressure_bar[1])
    if speed_rpm is not None:
        reach["speed"] = (pi / 30 * speed_rpm[0], pi / 30 * speed_rpm[1])
    with progress_shown(as_json) as progress:
        exploration = explore(
            description,
            law,
            parts=what or PARTS,
            point=point,
            reach=reach,
            bound=bound,
            rate=rate_hz,
            delay_samples=delay_samples,
            progress=progress,
        )
        failure = kept_page(exploration, output, progress=progress)
    if as_json:
        say_json({**exploration.to_dict(), "page": str(output) if output else None})
    else:
        report = exploration_page(exploration)
        rows = [(verdict.label, verdict.text) for verdict in report.verdicts]
        for item in exploration.maps:
            rows.append(
                (
                    f"largest real part over {item.over}",
                    units.quantity(float(item.abscissa.max()), "1/s"),
                )
            )
        if exploration.pulses is not None and exploration.pulses.stable.all():
            rows.append(
                (
                    "settled after a pulse, worst member",
                    units.quantity(float(exploration.pulses.settling().max()), "s"),
                )
            )
        if exploration.unbalance is not None:
            worst, at = (
                float(exploration.unbalance.found.max()),
                float(exploration.unbalance.speeds[exploration.unbalance.found.argmax()]),
            )
            rows.append(
                (
                    "worst orbit found, 0-p",
                    f"{units.quantity(worst, 'm')} at {at * units.RPM:.4g} rpm",
                )
            )
        title = f"{description.name}, {exploration.point.label or 'its design point'}"
        print_table(title, ("what", "found"), [tuple(map(str, row)) for row in rows])
        for note in exploration.notes:
            say(f"note: {note}")
        say(f"The loop is {exploration.timing}.")
        if output is not None and failure is None:
            say(f"Page: {output}")
    if failure is not None:
        raise failure
    sys.exit(0 if exploration.stable else 1)
