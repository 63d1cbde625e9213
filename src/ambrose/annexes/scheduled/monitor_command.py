"""`ambrose monitor`."""

from __future__ import annotations

import sys
from dataclasses import replace
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
    load_controller,
    print_table,
    progress_shown,
    say,
    say_json,
)


@click.command()
@MACHINE
@click.argument("controller", type=click.Path(path_type=Path))
@click.argument("record", type=click.Path(path_type=Path))
@click.option("--seal", default=None, help="The seal to watch; default: the only one.")
@click.option(
    "--unknown",
    multiple=True,
    type=click.Choice(["pressure", "K", "k", "C", "c"]),
    help="What is found (repeatable); default: the pressure that the seal's forces tell, or k.",
)
@click.option(
    "--window",
    type=float,
    default=2.0,
    show_default=True,
    help="Memory of the estimate in seconds.",
)
@click.option(
    "--rate",
    type=float,
    default=0.01,
    show_default=True,
    help="Change per second, as a share of the file's value.",
)
@click.option(
    "--current-gain", type=float, default=0.03, show_default=True, help="How well k_i is known."
)
@click.option(
    "--stiffness", type=float, default=0.0, show_default=True, help="How well k_s is known."
)
@click.option(
    "--amplifier",
    type=float,
    default=0.05,
    show_default=True,
    help="How well the amplifiers' bandwidth is known.",
)
@click.option(
    "--bending-modes",
    type=int,
    default=3,
    show_default=True,
    help="Bending modes per plane of the observer.",
)
@click.option(
    "--harmonics",
    type=int,
    default=3,
    show_default=True,
    help="Harmonics of the speed to remove.",
)
@click.option(
    "--delay-samples",
    type=int,
    default=1,
    show_default=True,
    help="From measured errors to currents set.",
)
@click.option(
    "--csv", "table", type=click.Path(path_type=Path), help="Every estimate as text (*.csv)."
)
@click.option(
    "--code", type=click.Path(path_type=Path), help="A folder for this monitor as C code."
)
@click.option("-o", "--output", type=click.Path(path_type=Path), help="A page (*.html).")
@AS_JSON
def monitor(
    machine: str,
    controller: Path,
    record: Path,
    seal: str | None,
    unknown: tuple[str, ...],
    window: float,
    rate: float,
    current_gain: float,
    stiffness: float,
    amplifier: float,
    bending_modes: int,
    harmonics: int,
    delay_samples: int,
    table: Path | None,
    code: Path | None,
    output: Path | None,
    as_json: bool,
) -> None:
    """A seal against time, with 95 % intervals, from the running loop and a small excitation.

    RECORD contains y_<axis>, u_<axis> and the excitation e_<axis> (0.02 A on every axis will do),
    CONTROLLER is the one that ran. Exit status 1: done, but the seal changes, leaves the range of
    the machine file's tolerances, contradicts the pressure given, or nothing can be said.
    """
    from ambrose.annexes.scheduled.monitor import monitor_table
    from ambrose.annexes.scheduled.seal_watch import monitor as watched, seal_monitor
    from ambrose.machine.ordinary_file import write_text
    from ambrose.record.files import read_record

    description = load(machine)
    ran = load_controller(controller, description)
    law = ran.controller
    claim(page=output, table=table)
    doubts = {
        "force_per_current": current_gain,
        "negative_stiffness": stiffness,
        "amplifier": amplifier,
    }
    measured = read_record(record)
    options = {
        "seal": seal,
        "unknown": unknown,
        "window": window,
        "rate": rate,
        "doubts": doubts,
        "bending_modes": bending_modes,
        "harmonics": harmonics,
        "computing_delay": delay_samples,
    }
    with progress_shown(as_json) as progress:
        if code is not None:
            from ambrose.annexes.scheduled.monitor import write_monitor

            progress("writing the code")
            following: Any = seal_monitor
            write_monitor(code, following(description, law, measured.point, measured.dt, **options))
        history = watched(description, law, measured, progress=progress, **options)
        history = replace(history, controller=ran.named)
        failures = []
        if table is not None:
            failures.append(kept(lambda path: write_text(path, history.to_csv(), "table"), table))
        failures.append(kept_page(history, output, description, progress=progress))
    if as_json:
        say_json(
            {
                **history.to_dict(),
                "page": str(output) if output else None,
                "table": str(table) if table else None,
                "code": str(code) if code else None,
            }
        )
    else:
        rows = monitor_table(history)
        print_table(
            f"Seal {history.seal}",
            rows.columns,
            [tuple(cell.text for cell in row) for row in rows.cells],
        )
        for note in history.notes:
            say(note)
        for finding in history.findings:
            say(f"finding: {finding}")
        for what, place in (("Code", code), ("Table", table), ("Page", output)):
            if place is not None:
                say(f"{what}: {place}")
    for failure in failures:
        if failure is not None:
            raise failure
    sys.exit(1 if history.findings else 0)
