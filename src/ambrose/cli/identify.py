"""`ambrose identify`."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import click

from ambrose.cli.terminal import AS_JSON, MACHINE, load, print_table, progress_shown


@click.command()
@MACHINE
@click.argument("records", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option("--controller", "path", type=click.Path(path_type=Path), required=True, help="The controller that ran (*.json).")
@click.option(
    "--unknown", multiple=True, metavar="PATH",
    help='What to identify, "*" for every name or axis: bearing.*.negative_stiffness.* (repeatable). '
    "Default: what the machine file marks as uncertain, K_i and K_s of every axis, and the amplifier's lag.",
)  # fmt: skip
@click.option("--start", multiple=True, metavar="PATH=VALUE", help="SI value to begin at; default: the machine's (repeatable).")
@click.option("--signals", multiple=True, metavar="NAME", help="Signals to fit, y_, u_ or i_<axis>; default: every y_<axis>.")
@click.option("--delay-samples", type=float, default=1, show_default=True, help="From measured errors to acting currents.")
@click.option("--bending-modes", type=int, default=1, show_default=True, help="Bending modes per plane in the model.")
@click.option("--repeats", "repeated", is_flag=True, help="The records are repeats: identify each alone, too.")
@click.option("--report", type=click.Path(path_type=Path), help="A page: parameters, measured over model, residual tests.")
@click.option("-o", "--output", type=click.Path(path_type=Path), default=Path("identified.toml"), show_default=True)
@AS_JSON
def identify(
    machine: str, records: tuple[Path, ...], path: Path, unknown: tuple[str, ...], start: tuple[str, ...],
    signals: tuple[str, ...], delay_samples: float, bending_modes: int, repeated: bool, report: Path | None, output: Path,
    as_json: bool,
) -> None:  # fmt: skip
    """Identify parameters from records of the closed loop; write the machine with them and their uncertainty.

    RECORDS are *.h5 or *.csv files with the excitations e_<axis> and the displacements y_<axis>; with u_<axis> the controller
    is checked too. Exit status 1: done, but a warning or a residual test says that the result is doubtful; 2: refused.
    """
    from ambrose.export.files import read_controller
    from ambrose.identify.checked import checked_identification, usual_unknowns
    from ambrose.identify.unknowns import expand
    from ambrose.machine.record import read_record

    description = load(machine)
    begin = _starts(start)
    controller = read_controller(path).controller
    with progress_shown(as_json) as progress:
        progress(f"reading {len(records)} record{'s' if len(records) > 1 else ''}")
        measured = [read_record(record) for record in records]
        paths = expand(description, unknown or usual_unknowns(description, measured))
        if not as_json and not unknown:
            click.echo(f"  unknown: {', '.join(paths)}", err=True)
        checked = checked_identification(
            description, measured, controller, paths, start=begin, signals=signals or None, bending_modes=bending_modes,
            computing_delay=delay_samples, repeats=repeated, progress=progress,
        )  # fmt: skip
        names = [record.name for record in records]
        _write(description, checked, names, path.name, output)
        if report is not None:
            from ambrose.report.document import write
            from ambrose.report.identification import identification_report

            progress("writing the report")
            write(identification_report(description, checked, sources=names, controller=path.name), report)
    if as_json:
        from ambrose.identify.checked import as_dict

        written = {"machine_file": str(output), "report": str(report) if report else None}
        click.echo(json.dumps({**as_dict(checked), **written}))
    else:
        _print(checked, output, report)
    sys.exit(0 if checked.good else 1)


def _starts(texts: tuple[str, ...]) -> dict[str, float]:
    """ "PATH=VALUE" -> path and value; raises InvalidInput."""
    from ambrose.core.checks import invalid

    found = {}
    for text in texts:
        path, equals, value = text.partition("=")
        try:
            found[path.strip()] = float(value)
        except ValueError:
            equals = ""
        if not equals:
            raise invalid(
                "--start", repr(text), "PATH=VALUE with a number in SI units", "write bearing.A.force_per_current.zeta=140"
            )
    return found


def _write(machine: Any, checked: Any, records: list[str], controller: str, output: Path) -> None:
    from ambrose.identify.checked import provenance
    from ambrose.identify.identified import identified_machine
    from ambrose.machine.config import dumps_machine
    from ambrose.machine.writing import write_text

    origin, comment = provenance(checked, records, controller)
    found = identified_machine(machine, checked.result, origin=origin, keep_wider=True)
    write_text(output, comment + dumps_machine(found), "machine file")


def _print(checked: Any, output: Path, report: Path | None) -> None:
    from ambrose.report.identification_tables import fit_table, parameters_table, repeats_table, residual_tests_table

    result = checked.result
    _table(parameters_table(result))
    if checked.repeats is not None:
        _table(repeats_table(checked.repeats))
    _table(fit_table(result))
    if not all(test.passed for test in result.tests):
        _table(residual_tests_table(result), only_failed=True)
    click.echo(f"Verdict: {result.verdict}")
    for finding in checked.findings:
        click.echo(f"Warning: {finding}")
    for text in result.warnings:
        if text != result.verdict:
            click.echo(f"Warning: {text}")
    click.echo(f"Machine with these values and their uncertainty: {output}" + (f". Report: {report}" if report else ""))


def _table(table: Any, only_failed: bool = False) -> None:
    rows = [row for row in table.cells if not only_failed or any(cell.mark == "fail" for cell in row)]
    texts = [tuple(f"{cell.symbol} {cell.text}".strip() for cell in row) for row in rows]
    marks = ["red" if any(cell.mark == "fail" for cell in row) else "" for row in rows]
    print_table(table.title, table.columns, texts, marks)
