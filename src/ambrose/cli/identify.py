"""`ambrose identify`."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click

from ambrose.cli.terminal import AS_JSON, MACHINE, load, print_table, progress_shown

METHODS = ("closed-loop", "youla", "static")
_GOES_WITH = {  # option -> the methods that it goes with; those not named go with all
    "path": ("closed-loop", "youla"),
    "unknown": ("closed-loop", "youla"),
    "start": ("closed-loop", "youla"),
    "signals": ("closed-loop",),
    "delay_samples": ("closed-loop", "youla"),
    "bending_modes": ("closed-loop", "youla"),
    "seal_form": ("closed-loop",),
    "seal": ("closed-loop",),
    "average": ("static",),
}
_WHY = {
    "closed-loop": "the closed loop is fitted over the whole record",
    "youla": "the Youla residual takes every u_ and y_<axis> of one operating point",
    "static": "static loads give K_i of every axis from forces and currents; no loop is modelled",
}


@dataclass(frozen=True, slots=True)
class _Given:
    """What the command was asked for, read and checked."""

    machine: Any
    records: list[Any]
    names: list[str]
    controller: Any
    controller_name: str
    unknown: tuple[str, ...]
    start: dict[str, float]
    options: dict[str, Any]
    progress: Callable[[str], None]
    say: Callable[[str], None]


@dataclass(frozen=True, slots=True)
class _Done:
    """What came out: the machine file, plain data, tables (each whole, or only its failed rows), lines, and the page."""

    good: bool
    machine: Any
    comment: str
    data: dict[str, Any]
    tables: list[tuple[Any, bool]]
    lines: list[str]
    page: Callable[[Any], Any]
    found: Any


@click.command()
@MACHINE
@click.argument("records", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option("--method", type=click.Choice(METHODS), default="closed-loop", show_default=True, help="How to identify.")
@click.option("--controller", "path", type=click.Path(path_type=Path), help="The controller that ran (*.json).")
@click.option(
    "--unknown", multiple=True, metavar="PATH",
    help='What to identify, "*" for every name or axis: bearing.*.negative_stiffness.* (repeatable). '
    "Default: what the machine file marks as uncertain, K_i and K_s of every axis, and the amplifier's lag.",
)  # fmt: skip
@click.option("--start", multiple=True, metavar="PATH=VALUE", help="SI value to begin at; default: the machine's (repeatable).")
@click.option("--signals", multiple=True, metavar="NAME", help="Signals to fit, y_, u_ or i_<axis>; default: every y_<axis>.")
@click.option("--delay-samples", type=float, default=1, show_default=True, help="From measured errors to acting currents.")
@click.option("--bending-modes", type=int, default=1, show_default=True, help="Bending modes per plane in the model.")
@click.option(
    "--seal-fit", "seal_form", type=click.Choice(("line", "table")), help="The seal pressure by pressure, and how kept."
)
@click.option("--seal", metavar="NAME", help="Which seal, where there are several.")
@click.option("--average", type=float, default=0.5, show_default=True, help="Static: seconds averaged at the end of a level.")
@click.option("--repeats", "repeated", is_flag=True, help="The records are repeats: identify each alone, too.")
@click.option("--compare", type=click.Path(path_type=Path), help="A machine file found by another method: the differences.")
@click.option("--report", type=click.Path(path_type=Path), help="A page: parameters, measured over model, residual tests.")
@click.option("-o", "--output", type=click.Path(path_type=Path), default=Path("identified.toml"), show_default=True)
@AS_JSON
@click.pass_context
def identify(
    context: click.Context, machine: str, records: tuple[Path, ...], method: str, path: Path | None, unknown: tuple[str, ...],
    start: tuple[str, ...], signals: tuple[str, ...], delay_samples: float, bending_modes: int, seal_form: str | None,
    seal: str | None, average: float, repeated: bool, compare: Path | None, report: Path | None, output: Path, as_json: bool,
) -> None:  # fmt: skip
    """Identify parameters from records of the running machine; write the machine with them and their uncertainty.

    RECORDS are *.h5 or *.csv files with the excitations e_<axis> and the displacements y_<axis>; with u_<axis> the controller
    is checked too. --method youla needs every u_<axis>; --method static takes loads f_<port> and currents, and finds K_i.
    Exit status 1: done, but a warning or a residual test says that the result is doubtful; 2: refused.
    """
    from ambrose.machine.record.files import read_record

    _check_options(context, method)
    description = load(machine)
    other = load(str(compare)) if compare is not None else None
    begin = _starts(start)
    loop = {"signals": signals or None, "bending_modes": bending_modes, "computing_delay": delay_samples}
    options = {"average": average} if method == "static" else loop
    with progress_shown(as_json) as progress:
        progress(f"reading {len(records)} record{'s' if len(records) > 1 else ''}")
        measured = [(read_record(record), record.name) for record in records]
        if seal_form is not None:  # those without pressure first, as they are numbered
            measured.sort(key=lambda item: float(item[0].point.seal_pressure))
        given = _Given(
            description, [item for item, _ in measured], [name for _, name in measured], *_controller(path), unknown, begin,
            options, progress, (lambda text: None) if as_json else (lambda text: click.echo(f"  {text}", err=True)),
        )  # fmt: skip
        done = _identified(given, method, repeated, seal_form, seal)
        compared = _compared(done, other)
        _write(done, output)
        if report is not None:
            from ambrose.report.page import write

            progress("writing the report")
            write(done.page(compared), report)
    if as_json:
        from ambrose.identification.validation.agreement import as_dict

        written = {"machine_file": str(output), "report": str(report) if report else None}
        beside = {"compared": None if compared is None else as_dict(compared)}
        click.echo(json.dumps({**done.data, **beside, **written}))
    else:
        _print(done, compared, output, report)
    sys.exit(0 if done.good else 1)


def _check_options(context: click.Context, method: str) -> None:
    """Refuse what does not go together; raises InvalidInput."""
    from click.core import ParameterSource

    from ambrose.core.checks import InvalidInput

    flags = {item.name: item.opts[-1] for item in context.command.params}
    given = {name for name in flags if name and context.get_parameter_source(name) is not ParameterSource.DEFAULT}
    for name, methods in _GOES_WITH.items():
        if name in given and method not in methods:
            raise InvalidInput(
                f"{flags[name]} goes with --method {' or '.join(methods)}, not {method}: {_WHY[method]}; leave it out"
            )
    if "path" not in given and method != "static":
        raise InvalidInput("--controller is missing: the loop is modelled with the controller that ran; give its file (*.json)")
    if "seal" in given and "seal_form" not in given:
        raise InvalidInput(
            "--seal names the seal of --seal-fit, which is missing; give --seal-fit line or table, or leave it out"
        )
    if {"seal_form", "repeated"} <= given:
        raise InvalidInput("--repeats does not go with --seal-fit: records at several pressures repeat nothing; leave one out")


def _controller(path: Path | None) -> tuple[Any, str]:
    from ambrose.synthesis.controller_file import read_controller

    return (None, "") if path is None else (read_controller(path).controller, path.name)


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


def _identified(given: _Given, method: str, repeated: bool, seal_form: str | None, seal: str | None) -> _Done:
    if method == "static":
        return _static(given, repeated)
    return _loop(given, method, repeated) if seal_form is None else _seal(given, seal_form, seal)


def _loop(given: _Given, method: str, repeated: bool) -> _Done:
    from ambrose.identification.model_updating import identified_machine
    from ambrose.identification.parameters import split_timing
    from ambrose.identification.pipeline import as_dict, checked_identification, provenance, usual_unknowns
    from ambrose.report.identification.page import identification_report

    wanted = given.unknown or usual_unknowns(given.machine, given.records)
    paths = [path for kind in split_timing(given.machine, wanted) for path in kind]
    if not given.unknown:
        given.say(f"unknown: {', '.join(paths)}")
    pressures = {record.point.seal_pressure for record in given.records}
    if method == "closed-loop" and given.machine.seals and len(pressures) > 2:
        given.say(f"{len(pressures)} seal pressures, fitted together: --seal-fit line finds the seal at each")
    checked = checked_identification(
        given.machine, given.records, given.controller, paths, method=method, start=given.start, repeats=repeated,
        progress=given.progress, **given.options,
    )  # fmt: skip
    origin, comment = provenance(checked, given.names, given.controller_name)
    found = identified_machine(given.machine, checked.result, origin=origin, keep_wider=True)

    def page(compared: Any) -> Any:
        return identification_report(
            given.machine, checked, sources=given.names, controller=given.controller_name, compared=compared
        )

    return _Done(
        checked.good, found, comment, as_dict(checked), _loop_tables(checked), _loop_lines(checked), page, checked.result
    )


def _loop_tables(checked: Any) -> list[tuple[Any, bool]]:
    from ambrose.report.identification.tables import fit_table, parameters_table, repeats_table, residual_tests_table

    tables = [(parameters_table(checked.result), False)]
    if checked.repeats is not None:
        tables.append((repeats_table(checked.repeats), False))
    tables.append((fit_table(checked.result), False))
    if not all(test.passed for test in checked.result.tests):
        tables.append((residual_tests_table(checked.result), True))
    return tables


def _loop_lines(checked: Any) -> list[str]:
    doubts = [text for text in checked.result.warnings if text != checked.result.verdict]
    return [f"Verdict: {checked.result.verdict}", *[f"Warning: {item}" for item in (*checked.findings, *doubts)]]


def _seal(given: _Given, form: str, seal: str | None) -> _Done:
    from ambrose.identification.pipeline import as_dict, provenance
    from ambrose.identification.seal import pipeline as seal_checked
    from ambrose.report.identification.page import identification_report
    from ambrose.report.identification.tables import seal_lines_table, seal_table

    found = seal_checked.seal_identification(
        given.machine, given.records, given.controller, form, given.unknown, seal=seal, start=given.start,
        progress=given.progress, **given.options,
    )  # fmt: skip
    origin, comment = provenance(found.checked, given.names, given.controller_name)
    origin += f"; seal {found.fit.seal} as a {form} over {len(found.fit.pressures)} pressures"
    machine = seal_checked.written_machine(given.machine, found, origin)

    def page(compared: Any) -> Any:
        return identification_report(
            given.machine, found.checked, sources=given.names, controller=given.controller_name, seal=found.fit,
            compared=compared,
        )  # fmt: skip

    tables = [*_loop_tables(found.checked), (seal_table(found.fit), False)]
    if form == "line":
        tables.append((seal_lines_table(found.fit), False))
    lines = [*_loop_lines(found.checked), *[f"Warning: seal {found.fit.seal} {text}" for text in found.fit.warnings]]
    note = seal_checked.beyond(given.machine, found)
    lines += [f"Note: {note}."] if note else []
    data = {**as_dict(found.checked), "good": found.good, "seal": {**seal_checked.as_dict(found), "note": note}}
    return _Done(
        found.good,
        machine,
        comment + seal_checked.comment(given.machine, found),
        data,
        tables,
        lines,
        page,
        found.checked.result,
    )


def _static(given: _Given, repeated: bool) -> _Done:
    from ambrose.identification.model_updating import identified_machine
    from ambrose.identification.static_load.pipeline import as_dict, checked_static_load, provenance
    from ambrose.report.identification.static_load import static_report, static_table
    from ambrose.report.identification.tables import repeats_table

    checked = checked_static_load(given.machine, given.records, repeats=repeated, progress=given.progress, **given.options)
    origin, comment = provenance(checked, given.names)
    found = identified_machine(given.machine, checked.result, origin=origin, keep_wider=True)
    tables = [(static_table(checked), False)]
    if checked.repeats is not None:
        tables.append((repeats_table(checked.repeats), False))
    lines = [f"Verdict: {checked.result.verdict}", *[f"Warning: {text}" for text in checked.result.warnings]]

    def page(compared: Any) -> Any:
        return static_report(given.machine, checked, sources=given.names, compared=compared)

    return _Done(checked.good, found, comment, as_dict(checked), tables, lines, page, checked.result)


def _compared(done: _Done, other: Any) -> Any:
    from ambrose.identification.validation.agreement import beside

    return None if other is None else beside(done.found, other)


def _write(done: _Done, output: Path) -> None:
    from ambrose.machine.atomic_write import write_text
    from ambrose.machine.file.update import machine_text

    write_text(output, done.comment + machine_text(done.machine), "machine file")


def _print(done: _Done, compared: Any, output: Path, report: Path | None) -> None:
    tables: Sequence[tuple[Any, bool]] = done.tables
    for table, only_failed in tables:
        _table(table, only_failed)
    if compared is not None:
        from ambrose.report.identification.tables import compared_table

        _table(compared_table(compared))
    for line in done.lines:
        click.echo(line)
    click.echo(f"Machine with these values and their uncertainty: {output}" + (f". Report: {report}" if report else ""))


def _table(table: Any, only_failed: bool = False) -> None:
    rows = [row for row in table.cells if not only_failed or any(cell.mark == "fail" for cell in row)]
    texts = [tuple(f"{cell.symbol} {cell.text}".strip() for cell in row) for row in rows]
    marks = ["red" if any(cell.mark == "fail" for cell in row) else "" for row in rows]
    print_table(table.title, table.columns, texts, marks)
