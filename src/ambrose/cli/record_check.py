"""`ambrose record check`."""

from __future__ import annotations

import sys
from pathlib import Path

import click

from ambrose.cli.options import axis_columns
from ambrose.terminal import AS_JSON, load, print_table, quantity_given, say, say_json


@click.command("record check")
@click.argument("record", type=click.Path(path_type=Path))
@click.argument("machine", required=False)
@axis_columns
@click.option("--rate-hz", type=float, help="Of a text table without times.")
@click.option("--travel", metavar="LENGTH", help="Of one axis, as for identify --generic.")
@AS_JSON
def record_check(
    record: Path,
    machine: str | None,
    rate_hz: float | None,
    travel: str | None,
    as_json: bool,
    **columns: str | None,
) -> None:
    """Whether a record can be used, and for what: what is in it, what is wrong with its signals,
    and for every use what it lacks.

    RECORD: a record, or a text table of one axis. MACHINE: whose record it is; its axes and limits
    are then checked. Exit status 1: it serves for nothing, or a signal is useless.
    """
    from ambrose.identification.record_check import check_record

    done = check_record(
        record,
        None if machine is None else load(machine),
        columns={name: column for name, column in columns.items() if column},
        sample_rate_hz=rate_hz,
        travel=quantity_given(travel, "--travel", "length"),
    )
    if as_json:
        say_json(done.to_dict())
    else:
        print_table(done.name, ("what", "holds"), done.contents)
        rows = [
            (use.purpose, use.command, "yes" if use.usable else "no", use.reason)
            for use in done.uses
        ]
        marks = ["" if use.usable else "dim" for use in done.uses]
        print_table("Usable for", ("purpose", "command", "", "why"), rows, marks)
        for finding in done.findings:
            say(f"{finding.severity}: {finding}")
    sys.exit(0 if done.passed else 1)
