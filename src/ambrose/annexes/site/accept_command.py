"""`ambrose accept`."""

from __future__ import annotations

import sys
from pathlib import Path

import click

from ambrose.terminal import (
    ALL,
    AS_JSON,
    DELAY,
    MACHINE,
    claim,
    kept_page,
    load,
    load_controller,
    print_checks,
    progress_shown,
    say,
    say_json,
)


@click.command()
@MACHINE
@click.argument("controller", type=click.Path(path_type=Path))
@click.argument("records", nargs=-1, required=True, type=click.Path(path_type=Path))
@DELAY
@click.option(
    "--harmonics",
    type=int,
    default=3,
    show_default=True,
    help="Multiples of the speed that are taken out.",
)
@click.option("-o", "--output", type=click.Path(path_type=Path), help="The page to sign (*.html).")
@ALL
@AS_JSON
def accept(
    machine: str,
    controller: Path,
    records: tuple[Path, ...],
    delay_samples: int | None,
    harmonics: int,
    output: Path | None,
    everything: bool,
    as_json: bool,
) -> None:
    """Measure sensitivity, open and closed loop on the running machine, and hold them against their
    limits.

    RECORDS hold the displacements y_<axis> and excitations e_<axis> (or references r_<axis>) on
    every axis, at standstill or running, at one operating point or several; CONTROLLER is the file
    of the one that ran, and with u_<axis> it is checked. Limits and zones (ISO 14839-3) judge the
    outer end of the 95 % intervals. Exit status 1: measured, but a check failed.
    """
    from ambrose.annexes.site.acceptance import accept as accepted

    description = load(machine)
    law = load_controller(controller, description)
    claim(page=output)
    with progress_shown(as_json) as progress:
        progress("measuring the loop")
        result = accepted(
            description, law, records, harmonics=harmonics, delay_samples=delay_samples
        )
        failure = kept_page(result, output, progress=progress)
    if as_json:
        say_json({**result.to_dict(), "page": str(output) if output and failure is None else None})
    else:
        for loop in result.points:
            print_checks(loop.checks, everything)
            for note in loop.checks.notes:
                say(note)
        say(f"The loop that was measured is {result.timing}.")
        if output is not None and failure is None:
            say(f"Page: {output}")
    if failure is not None:
        raise failure
    sys.exit(0 if result.passed else 1)
