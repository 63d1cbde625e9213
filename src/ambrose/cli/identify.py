"""`ambrose identify`."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import click

from ambrose.cli.options import chosen_from, groups_from, options_from
from ambrose.identification.methods import METHODS
from ambrose.terminal import (
    AS_JSON,
    MACHINE,
    GroupedCommand,
    claim,
    kept,
    kept_page,
    load,
    print_table,
    progress_shown,
    say,
    say_json,
)

_WORD = "--method"
_GROUPS = {
    "": ("method", "controller", "unknown", "output", "report"),
    "Records": ("repeats", "between", "compare"),
    **groups_from(METHODS, "With every method", _WORD),
}


@click.command(cls=GroupedCommand, groups=_GROUPS)
@MACHINE
@click.argument("records", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option(
    _WORD,
    type=click.Choice(list(METHODS)),
    default="closed-loop",
    show_default=True,
    help="How to identify.",
)
@click.option(
    "--controller", type=click.Path(path_type=Path), help="The controller that ran (*.json)."
)
@options_from(METHODS)
@click.option("--repeats", is_flag=True, help="The records are repeats: identify each alone, too.")
@click.option(
    "--between",
    nargs=2,
    type=float,
    metavar="FROM TO",
    help="Seconds of the records to take; default: all, from where the rotor has settled on.",
)
@click.option(
    "--compare",
    type=click.Path(path_type=Path),
    help="A machine file found by another method: the differences.",
)
@click.option(
    "--report",
    type=click.Path(path_type=Path),
    help="A page: parameters, measured over model, residual tests.",
)
@click.option(
    "-o",
    "--output",
    type=click.Path(path_type=Path),
    default=Path("identified.toml"),
    show_default=True,
)
@AS_JSON
def identify(
    machine: str,
    records: tuple[Path, ...],
    method: str,
    controller: Path | None,
    repeats: bool,
    between: tuple[float, float] | None,
    compare: Path | None,
    report: Path | None,
    output: Path,
    as_json: bool,
    **asked: Any,
) -> None:
    """Identify parameters from records of the running machine; write the machine with them and
    their uncertainty.

    RECORDS are *.h5 or *.csv files with the excitations e_<axis> and the displacements y_<axis>;
    with u_<axis> the controller is checked too. --method youla needs every u_<axis>; --method
    static takes loads f_<port> and currents, and finds K_i. One axis without a machine file:
    identify --generic RECORD. Exit status 1: done, but a warning says
    that the result is doubtful; 2: refused.
    """
    from ambrose.identification.pipeline import Provenance, check_controller
    from ambrose.identification.pipeline import identify as run
    from ambrose.identification.validation.agreement import check_comparable
    from ambrose.identification.validation.agreement import compare as agreement
    from ambrose.judge.controller_file import read_controller
    from ambrose.machine.atomic_write import write_text
    from ambrose.machine.file.update import machine_text

    asked["start"] = _starts(asked["start"])
    chosen = chosen_from(METHODS, method, asked, _WORD)
    check_controller(chosen, controller is not None, repeats, "--")
    description = load(machine)
    other = load(str(compare)) if compare is not None else None
    if other is not None:  # before anything is computed
        check_comparable(description.name, other)
    claim(machine_file=output, report=report)
    names = Provenance(tuple(path.name for path in records), controller.name if controller else "")
    with progress_shown(as_json) as progress:
        law = read_controller(controller) if controller else None
        done = run(
            description,
            records,
            law,
            method=chosen,
            repeats=repeats,
            between=between,
            provenance=names,
            progress=progress,
        )
        compared = None if other is None else agreement(done.result, other)
        text = done.comment + machine_text(done.machine)
        failure = kept(lambda path: write_text(path, text, "machine file"), output)
        unwritten = kept_page(done, report, progress=progress, called="report", compared=compared)
        failure, report = unwritten or failure, None if unwritten else report
    if as_json:
        rows = None if compared is None else [row.to_dict() for row in compared]
        files = {"machine_file": str(output), "report": str(report) if report else None}
        say_json({**done.to_dict(), "compared": rows, **files})
    else:
        _print(done, compared)
        say(
            f"Machine with these values and their uncertainty: {output}"
            + (f". Report: {report}" if report else "")
        )
    if failure is not None:
        raise failure
    sys.exit(0 if done.passed else 1)


def _starts(texts: tuple[str, ...]) -> dict[str, float]:
    """ "PATH=VALUE" -> path and value; raises InvalidInput."""
    from ambrose.core.checks import invalid

    values = {}
    for text in texts:
        path, equals, value = text.partition("=")
        try:
            values[path.strip()] = float(value)
        except ValueError:
            equals = ""
        if not equals:
            raise invalid(
                "--start",
                repr(text),
                "PATH=VALUE with a number in SI units",
                "write bearing.A.force_per_current.zeta=140",
            )
    return values


def _print(done: Any, compared: Any) -> None:
    from ambrose.report.identification import page as tables
    from ambrose.report.identification.static_load import static_table

    if done.method == "static":
        _table(static_table(done))
    else:
        _table(tables.parameters_table(done.result))
    if done.repeats is not None:
        _table(tables.repeats_table(done.repeats))
    if done.method != "static":
        _table(tables.fit_table(done.result))
        if done.result.turning:
            _table(tables.turning_table(done.result))
        if not all(test.passed for test in done.result.tests):
            _table(tables.residual_tests_table(done.result), only_failed=True)
        if done.seal is not None:
            _table(tables.seal_table(done.seal.fit))
            if done.seal.form == "line":
                _table(tables.seal_lines_table(done.seal.fit))
    if compared is not None:
        _table(tables.compared_table(compared))
    for line in (f"Verdict: {done.verdict}", *[f"Warning: {finding}" for finding in done.doubts]):
        say(line)
    for remark in () if done.method == "static" else done.remarks:
        say(f"Note: {remark}.")


def _table(table: Any, only_failed: bool = False) -> None:
    rows = [
        row for row in table.cells if not only_failed or any(cell.mark == "fail" for cell in row)
    ]
    texts = [tuple(f"{cell.symbol} {cell.text}".strip() for cell in row) for row in rows]
    marks = ["red" if any(cell.mark == "fail" for cell in row) else "" for row in rows]
    print_table(table.title, table.columns, texts, marks)
