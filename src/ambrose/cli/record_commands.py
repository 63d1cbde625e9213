"""`ambrose seal`."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import click

from ambrose.identification.methods import METHODS
from ambrose.terminal import (
    AS_JSON,
    MACHINE,
    GroupedCommand,
    chosen_from,
    claim,
    groups_from,
    kept,
    kept_page,
    load,
    one_screen,
    options_from,
    print_table,
    progress_shown,
    quantity_given,
    say,
    say_json,
    say_verdict,
)

# identification/one_axis/axis_record.py, which is not imported for --help
AXIS_COLUMNS = ("displacement", "drive", "reference", "current", "voltage", "time")
_AXIS_HELP = {
    "displacement": "Of the axis; default: y, y_<axis>.",
    "drive": "What the plant is driven by, a current best; default: u, u_<axis>.",
    "reference": "What drives the loop from outside; default: r, e, yd, e_<axis>, r_<axis>.",
    "current": "Of the coil; default: i, i_<axis>.",
    "voltage": "Of the coil, to see whether the current belongs to it.",
    "time": "Default: t, time.",
}


def axis_columns(command: Any) -> Any:
    """Decorator of a command: a flag for every column of a record of one axis."""
    for name in reversed(AXIS_COLUMNS):
        command = click.option(f"--{name}", metavar="COLUMN", help=_AXIS_HELP[name])(command)
    return command


# `ambrose record check`.


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
    """Check what a record can be used for: its signals, their faults, and what each use lacks.

    RECORD: a record, or a text table of one axis. MACHINE: whose record it is; its axes and limits
    are then checked. Exit status 1: the record cannot be used, or one of its signals cannot.
    """
    from ambrose.api import check_record

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


# `ambrose identify --generic`.


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
    best what drove the loop from outside. The controller may be unknown. Unusable records are
    refused with the reasons (status 2); status 1: the result is doubtful, or the model does not
    fit.
    """
    from ambrose.api import identify_generic as run
    from ambrose.report.identification import generic_tables

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
        text = f"Verdict: {done.verdict}" + (f". Page: {output}" if output and not failure else "")
        say_verdict(text, in_full=text)
    if failure is not None:
        raise failure
    sys.exit(0 if done.passed else 1)


# `ambrose identify`.


_WORD = "--method"
_GROUPS_IDENTIFY = {
    "": ("method", "controller", "unknown", "output", "report"),
    "Records": ("repeats", "between", "compare"),
    **groups_from(METHODS, "With every method", _WORD),
}


@click.command(cls=GroupedCommand, groups=_GROUPS_IDENTIFY)
@MACHINE
@click.argument("records", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option(
    _WORD,
    type=click.Choice(list(METHODS)),
    default="closed-loop",
    show_default=True,
    help="How to identify.",
)
@click.option("--controller", type=click.Path(path_type=Path), help="The controller that ran.")
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
    static takes loads f_<port> and currents, and finds K_i. Or RECORDS are frequency responses
    (*.h5 of ambrose convert, or *.csv whose columns are named "S A_zeta gain [dB]"). One axis
    without a machine file: identify --generic RECORD. Exit status 1: done, but a warning says that
    the result is doubtful; 2: refused.
    """
    from ambrose.api import identify as run
    from ambrose.identification.pipeline import Provenance, check_controller
    from ambrose.identification.validation.plausibility import (
        check_comparable,
        compare as agreement,
    )
    from ambrose.machine.file.update import machine_text
    from ambrose.machine.ordinary_file import write_text

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
        done = run(
            description,
            records,
            controller,
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
    """An identification for people: values first, fit and tests, then verdict and doubts;
    compared: rows beside another machine file's values, or None.
    """
    from ambrose.report import identification as tables
    from ambrose.report.identification import static_table

    values = static_table(done) if done.method == "static" else None
    values = values or tables.parameters_table(done.result)
    if (screen := one_screen()) is not None:
        # what was found stands in full; how well it fits is among the details
        screen.lines = min(60, max(screen.lines, 28 + len(values.cells)))
    _table(values)
    if done.repeats is not None:
        _table(tables.repeats_table(done.repeats))
    if done.method != "static" and screen is None:
        _table(tables.fit_table(done.result))
        if done.result.turning:
            _table(tables.turning_table(done.result))
        if not all(test.passed for test in done.result.tests):
            _table(tables.residual_tests_table(done.result), only_failed=True)
    if done.method != "static" and done.seal is not None:
        _table(tables.seal_table(done.seal.fit))
        if done.seal.form == "line":
            _table(tables.seal_lines_table(done.seal.fit))
    if compared is not None:
        _table(tables.compared_table(compared))
    say_verdict(f"Verdict: {done.verdict}", in_full=f"Verdict: {done.verdict}")
    for finding in done.doubts:
        say(f"Warning: {finding}")
    for remark in () if done.method == "static" else done.remarks:
        say(f"Note: {remark}.")
    if screen is not None:
        say("How well it fits: --details, or on the page of --report.")


def _table(table: Any, only_failed: bool = False) -> None:
    """A table of a page in the terminal, or of it the rows with a failure alone."""
    rows = [
        row for row in table.cells if not only_failed or any(cell.mark == "fail" for cell in row)
    ]
    texts = [tuple(f"{cell.symbol} {cell.text}".strip() for cell in row) for row in rows]
    marks = ["red" if any(cell.mark == "fail" for cell in row) else "" for row in rows]
    print_table(table.title, table.columns, texts, marks)


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

    RECORDS contain y_<axis>, excitations e_<axis> along both directions, and i_<axis> or u_<axis>:
    stepped sines (scenario seal-sines), or chirps, binary sequences and noise (scenario
    acceptance), at one pressure or several. Records without pressure are the baseline: the model's
    error found there is subtracted. No controller is needed. Exit status 1: found and written,
    but something makes it doubtful.
    """
    from math import tau

    from ambrose.identification.seal.by_frequency import identify_by_frequency
    from ambrose.machine.file.update import machine_text
    from ambrose.machine.ordinary_file import write_text
    from ambrose.report.identification import frequency_tables

    description = load(machine)
    description.across_the_shaft("a seal is identified across it")
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
