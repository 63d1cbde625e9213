"""`ambrose identify --generic`."""

from __future__ import annotations

import sys
from pathlib import Path

import click

from ambrose.cli.options import AXIS_COLUMNS, axis_columns
from ambrose.terminal import (
    AS_JSON,
    GroupedCommand,
    claim,
    kept_page,
    print_table,
    progress_shown,
    quantity_given,
    say,
    say_json,
)

_GROUPS = {
    "": ("between", "travel", "actuator", "output"),
    'Columns (a name, or "column 2"; "column 2 [um]" with a unit; "none")': AXIS_COLUMNS,
    "Force law F = c (i/s)^2": ("hanging", "gap", "bias", "mass"),
}


@click.command("identify --generic", cls=GroupedCommand, groups=_GROUPS)
@click.argument("record", type=click.Path(path_type=Path))
@axis_columns
@click.option("--rate-hz", type=float, help="Of a text table without times.")
@click.option("--between", type=(float, float), metavar="START STOP", help="Seconds to use.")
@click.option(
    "--travel",
    metavar="LENGTH",
    help='Between the stops, such as "20 mm", where y is the distance from the magnet.',
)
@click.option(
    "--actuator",
    type=click.Choice(("auto", "none", "lag")),
    default="auto",
    show_default=True,
    help="A first-order lag before the force.",
)
@click.option(
    "--hanging", is_flag=True, help="The magnet carries the weight at the record's mean y and i."
)
@click.option("--gap", metavar="LENGTH", help='s at the working point, such as "0.4 mm".')
@click.option("--bias", metavar="CURRENT", help='i at the working point, such as "3 A".')
@click.option("--mass", metavar="MASS", help='For k_s and k_i, such as "8 kg".')
@click.option("-o", "--output", type=click.Path(path_type=Path), help="A page (*.html).")
@AS_JSON
def identify_generic(
    record: Path,
    rate_hz: float | None,
    between: tuple[float, float] | None,
    travel: str | None,
    actuator: str,
    hanging: bool,
    gap: str | None,
    bias: str | None,
    mass: str | None,
    output: Path | None,
    as_json: bool,
    **columns: str | None,
) -> None:
    """Identify one levitated axis from its record alone: pole, gain, delay, with intervals.

    RECORD: a record, or a text table (*.csv, *.txt) with times, displacement y and drive u, and
    best what drove the loop from outside. The controller may be unknown. Looks first and refuses
    with reasons what can carry no identification (status 2); status 1: a doubt, or "not this
    model".
    """
    from ambrose.identification.one_axis.identify import identify_generic as run
    from ambrose.report.identification.one_axis import generic_tables

    claim(page=output)
    with progress_shown(as_json) as progress:
        progress("looking at the record, fitting")
        done = run(
            record,
            columns={name: column for name, column in columns.items() if column},
            sample_rate_hz=rate_hz,
            between=between,
            travel=quantity_given(travel, "--travel", "length"),
            actuator=actuator,
            gap=quantity_given(gap, "--gap", "length"),
            current=quantity_given(bias, "--bias", "current"),
            mass=quantity_given(mass, "--mass", "mass"),
            hanging=hanging,
        )
        failure = kept_page(done, output, progress=progress)
    if as_json:
        say_json({**done.to_dict(), "page": str(output) if output and not failure else None})
    else:
        for table in generic_tables(done):
            rows = [
                tuple(f"{cell.symbol} {cell.text}".strip() for cell in row) for row in table.cells
            ]
            print_table(table.title, table.columns, rows)
        for finding in done.findings:
            say(f"Warning: {finding}")
        say(f"Verdict: {done.verdict}" + (f". Page: {output}" if output and not failure else ""))
    if failure is not None:
        raise failure
    sys.exit(0 if done.passed else 1)
