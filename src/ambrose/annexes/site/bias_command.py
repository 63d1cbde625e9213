"""`ambrose bias`."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import click

from ambrose.terminal import (
    AS_JSON,
    MACHINE,
    claim,
    kept,
    kept_page,
    load,
    print_table,
    progress_shown,
    say,
    say_json,
)


@click.command()
@MACHINE
@click.argument("records", nargs=-1, type=click.Path(path_type=Path))
@click.option(
    "--controller",
    "controllers",
    multiple=True,
    metavar="[AMPERES=]PATH",
    help="The controller that ran, at all bias currents or at one: 6=pid6.json (repeatable).",
)
@click.option(
    "--loads",
    multiple=True,
    type=click.Path(path_type=Path),
    help="A record of static loads (repeatable).",
)
@click.option(
    "--unknown",
    multiple=True,
    metavar="PATH",
    help="What else is sought at every bias (repeatable).",
)
@click.option("--report", type=click.Path(path_type=Path), help="A page (*.html).")
@click.option(
    "-o", "--output", type=click.Path(path_type=Path), default=Path("bias.toml"), show_default=True
)
@AS_JSON
def bias(
    machine: str,
    records: tuple[Path, ...],
    controllers: tuple[str, ...],
    loads: tuple[Path, ...],
    unknown: tuple[str, ...],
    report: Path | None,
    output: Path,
    as_json: bool,
) -> None:
    """K_i and K_s of every axis against bias current; write the machine with a measured row for
    each.

    RECORDS are closed-loop records with excitation at several bias currents, as their operating
    points state; static loads (f_<port> [N]) give K_i by itself, for comparison or alone. Exit
    status 1: found and written, but something is doubtful.
    """
    from ambrose.annexes.site.bias import UNKNOWN, identify_over_bias
    from ambrose.annexes.site.bias_page import bias_tables
    from ambrose.machine.atomic_write import write_text
    from ambrose.machine.file.update import machine_text

    description = load(machine)
    laws = dict(map(_law, controllers))
    claim(machine_file=output, report=report)
    with progress_shown(as_json) as progress:
        done = identify_over_bias(
            description, records, laws, loads=loads, unknown=(*UNKNOWN, *unknown), progress=progress
        )
        text = done.comment + machine_text(done.machine)
        failures = [
            kept(lambda path: write_text(path, text, "machine file"), output),
            kept_page(done, report, progress=progress, called="report"),
        ]
    if as_json:
        say_json(
            {
                **done.to_dict(),
                "machine_file": str(output),
                "report": str(report) if report else None,
            }
        )
    else:
        for item in bias_tables(done):
            print_table(
                item.title, item.columns, [tuple(cell.text for cell in row) for row in item.cells]
            )
        for finding in done.findings:
            say(f"doubt: {finding}")
        say(
            f"Machine with a row for every bias current: {output}"
            + (f". Report: {report}" if report else "")
        )
    for failure in failures:
        if failure is not None:
            raise failure
    sys.exit(0 if done.passed else 1)


def _law(text: str) -> tuple[float | None, Any]:
    """ "6=pid6.json" -> 6.0 and the controller; a path alone -> None and the controller. Raises
    InvalidInput.
    """
    from ambrose.judge.controller_file import read_controller

    amperes, equals, path = text.partition("=")
    try:
        key: float | None = float(amperes) if equals else None
    except ValueError:
        key, path = None, text
    return key, read_controller(Path(path if key is not None else text))
