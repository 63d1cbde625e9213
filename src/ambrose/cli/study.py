"""`ambrose study`."""

from __future__ import annotations

import sys
from pathlib import Path

import click

from ambrose.terminal import (
    ALL,
    AS_JSON,
    MACHINE,
    load,
    print_checks,
    print_table,
    progress_shown,
    say,
    say_json,
)


@click.command(name="study")
@MACHINE
@click.option(
    "-o",
    "--output",
    type=click.Path(path_type=Path),
    default=None,
    help="Directory; default: study-<machine>.",
)
@ALL
@AS_JSON
def study_command(machine: str, output: Path | None, everything: bool, as_json: bool) -> None:
    """The whole chain: every controller the machine file allows, verified, simulated and compared
    in report.html; exit status 1 where none meets every check or commissioning was not done.
    """
    from ambrose.chain.study import study
    from ambrose.core.checks import InvalidInput
    from ambrose.machine.ordinary_file import file_name
    from ambrose.report.comparison.envelope import decision
    from ambrose.report.tables import verdict
    from ambrose.synthesis.methods.choice import methods

    description = load(machine)
    directory = output or Path(f"study-{file_name(description.name)}")
    with progress_shown(as_json) as progress:
        result = study(description, directory, progress)
    report = None if result.unwritten else directory / "report.html"
    if as_json:
        say_json({**result.to_dict(), "report": report and str(report)})
    else:
        titles = {method.title for method in methods().values()}
        rows = [
            (name, "design" if name in titles else "not done", why) for name, why in result.failed
        ]
        marks = ["red"] * len(rows)
        along = () if result.axial is None else result.axial.candidates
        for candidate in (*result.candidates, *along):
            which = candidate.name if candidate in result.candidates else f"{candidate.name}, axial"
            for checks in candidate.verifications:
                rows.append((which, checks.label, verdict(checks).text))
                marks.append("" if checks.passed else "red")
                if everything:
                    print_checks(checks, everything)
            for label in candidate.left_out:
                rows.append(
                    (candidate.name, label, "left out: its schedule does not cover this point")
                )
                marks.append("red")
        print_table(
            f"{description.name}: {len(result.candidates)} controllers",
            ("controller", "at", "verdict"),
            rows,
            marks,
        )
        say(decision(result.candidates).text + (f" Report: {report}" if report else ""))
        if result.commissioned is None:
            say(f"Commissioning was not done: {dict(result.failed)['commissioning']}")
        if result.axial is not None:
            say(f"Along the shaft: {decision(along).text} Report: {directory / 'axial'}")
    if result.unwritten:
        raise InvalidInput("; ".join(result.unwritten))
    sys.exit(0 if result.passed and result.commissioned is not None else 1)
