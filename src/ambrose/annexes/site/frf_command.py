"""`ambrose frf`."""

from __future__ import annotations

import sys
from pathlib import Path

import click

from ambrose.terminal import (
    AS_JSON,
    MACHINE,
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

# identification/frf/measured.py, which is not imported for --help
METHODS = ("sines", "periods", "polynomials")


@click.command()
@MACHINE
@click.argument("records", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option(
    "--controller", type=click.Path(path_type=Path), help="The controller that ran (*.json)."
)
@click.option("--method", type=click.Choice(METHODS), help="Default: what suits the excitation.")
@click.option(
    "--from-hz", type=float, default=0.0, help="Lowest frequency; default: all that was excited."
)
@click.option(
    "--to-hz", type=float, default=None, help="Highest frequency; default: all that was excited."
)
@click.option(
    "--harmonics",
    type=int,
    default=3,
    show_default=True,
    help="Multiples of the speed that are taken out.",
)
@click.option(
    "--settle",
    type=float,
    default=None,
    help="Sines: seconds left out of each; default: up to 0.3.",
)
@click.option("--csv", "table", type=click.Path(path_type=Path), help="Every line as text (*.csv).")
@click.option("-o", "--output", type=click.Path(path_type=Path), help="A page (*.html).")
@AS_JSON
def frf(
    machine: str,
    records: tuple[Path, ...],
    controller: Path | None,
    method: str | None,
    from_hz: float,
    to_hz: float | None,
    harmonics: int,
    settle: float | None,
    table: Path | None,
    output: Path | None,
    as_json: bool,
) -> None:
    """Measure frequency responses, open and closed loop, with their coherence and 95 % intervals,
    beside the model's.

    RECORDS hold the displacements y_<axis> and excitations e_<axis> (or references r_<axis>, forces
    f_<port>): chirps, binary sequences, multisines, stepped sines or noise, at one operating point
    or several. With u_<axis> they tell the open loop of every axis driven by itself, and with all
    axes driven the plant. Exit status 1: measured, but something makes it doubtful.
    """
    from math import inf, tau

    from ambrose.annexes.site.frf import respond, summary
    from ambrose.annexes.site.frf_page import response_tables
    from ambrose.machine.atomic_write import write_text

    description = load(machine)
    law = load_controller(controller, description) if controller else None
    claim(page=output, table=table)
    with progress_shown(as_json) as progress:
        band = (tau * from_hz, inf if to_hz is None else tau * to_hz)
        found = respond(
            description,
            records,
            law,
            method=method,
            band=band,
            harmonics=harmonics,
            settle=settle,
            progress=progress,
        )
        failures = []
        if table is not None:
            failures.append(kept(lambda path: write_text(path, found.to_csv(), "table"), table))
        failures.append(kept_page(found, output, progress=progress))
    if as_json:
        say_json(
            {
                **found.to_dict(),
                "page": str(output) if output else None,
                "table": str(table) if table else None,
            }
        )
    else:
        for point in found.points:
            for note in point.notes:
                say(f"{point.label}: {note}")
            for item in response_tables(found, point):
                print_table(
                    f"{item.title}, {point.label}",
                    item.columns,
                    [tuple(c.text for c in row) for row in item.cells],
                )
            for row in summary(point):
                if row["silent"]:
                    say(
                        f"{row['axis']}: noise hides the sensitivity, excite there: {row['silent']}"
                    )
        for finding in found.findings:
            say(f"doubt: {finding}")
        for what, place in (("Table", table), ("Page", output)):
            if place is not None:
                say(f"{what}: {place}")
    for failure in failures:
        if failure is not None:
            raise failure
    sys.exit(1 if found.findings else 0)
