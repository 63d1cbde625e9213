"""`ambrose seal`."""

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
    print_table,
    progress_shown,
    say,
    say_json,
)


@click.command()
@MACHINE
@click.argument("records", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option("--seal", metavar="NAME", help="Which seal, where there are several.")
@click.option(
    "--form",
    type=click.Choice(("line", "table", "frequency")),
    help="How the machine file keeps it: lines over pressure, values at the pressures, or at "
    "every frequency too. Default: "
    "lines from three pressures on, that without included; else a table.",
)
@click.option(
    "--at-hz",
    "frequencies",
    type=float,
    multiple=True,
    help="Broadband: a frequency (repeatable); default: 5 to 100",
)
@click.option(
    "--settle", type=float, default=0.3, show_default=True, help="Sines: seconds left out of each."
)
@click.option(
    "--currents",
    type=click.Choice(("measured", "commanded")),
    help="Default: measured where recorded.",
)
@click.option(
    "--harmonics",
    type=int,
    default=3,
    show_default=True,
    help="Broadband: multiples of the speed taken out.",
)
@click.option("--report", type=click.Path(path_type=Path), help="A page (*.html).")
@click.option(
    "-o", "--output", type=click.Path(path_type=Path), default=Path("seal.toml"), show_default=True
)
@AS_JSON
def seal(
    machine: str,
    records: tuple[Path, ...],
    seal: str | None,
    form: str | None,
    frequencies: tuple[float, ...],
    settle: float,
    currents: str | None,
    harmonics: int,
    report: Path | None,
    output: Path,
    as_json: bool,
) -> None:
    """Seal coefficients K, k, C, c over frequency and pressure; write the machine with them and
    their tolerances.

    RECORDS hold y_<axis>, excitations e_<axis> along both directions, and i_<axis> or u_<axis>:
    stepped sines (scenario seal-sines), or chirps, binary sequences and noise (scenario
    acceptance), at one pressure or several. Those without pressure are the baseline: what the model
    lacks shows there, and is taken off. No controller is needed. Exit status 1: found and written,
    but something makes it doubtful.
    """
    from math import tau

    from ambrose.identification.seal.by_frequency import identify_by_frequency
    from ambrose.machine.atomic_write import write_text
    from ambrose.machine.axial import across_the_shaft
    from ambrose.machine.file.update import machine_text
    from ambrose.report.identification.seal import frequency_tables

    description = load(machine)
    across_the_shaft(description, "a seal is identified across it")
    claim(machine_file=output, report=report)
    with progress_shown(as_json) as progress:
        done = identify_by_frequency(
            description,
            records,
            seal=seal,
            form=form,
            frequencies=[tau * f for f in frequencies],
            settle=settle,
            currents=currents,
            harmonics=harmonics,
            progress=progress,
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
        for item in list(frequency_tables(done))[:-1]:
            print_table(
                item.title, item.columns, [tuple(cell.text for cell in row) for row in item.cells]
            )
        base = (
            "the records without pressure are the baseline"
            if done.reference
            else "no record without pressure: no baseline"
        )
        say(f"{done.fit.method}; {base}")
        for finding in done.findings:
            say(f"doubt: {finding}")
        say(
            f"Machine with this seal and its tolerances: {output}"
            + (f". Report: {report}" if report else "")
        )
    for failure in failures:
        if failure is not None:
            raise failure
    sys.exit(0 if done.passed else 1)
