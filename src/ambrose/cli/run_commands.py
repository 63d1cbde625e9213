"""`ambrose study`."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import click

from ambrose.code.targets import PROCESSORS, WORDS, C
from ambrose.options import Rules, Simulating, option
from ambrose.terminal import (
    ALL,
    AS_JSON,
    MACHINE,
    GroupedCommand,
    asked_for,
    claim,
    kept,
    kept_page,
    load,
    load_controller,
    narrowed,
    options_from,
    print_checks,
    print_table,
    progress_shown,
    say,
    say_json,
    say_verdict,
)

if TYPE_CHECKING:
    from ambrose.code.in_loop import InLoop


# `ambrose simulate`.


_GROUPS = {
    "": ("path", "scenario", "point", "output", "report"),
    "The run": (
        *("axial", "axes", "linear", "rate", "delay_samples", "bending_modes", "seed", "second"),
    ),
    "A fallback for a controller scheduled over pressure": (
        "fallback",
        "pressure_rate",
        "pressure_error",
        "stuck_after",
        "estimate",
    ),
    "The code on its processor": ("on_target", "arithmetic"),
}


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class OnTarget(Simulating):
    """A run that may have its controller's code on a processor."""

    rules: ClassVar[Rules] = (
        *Simulating.rules,
        (("on_target",), "linear", False, Simulating.rules[0][-1]),
        (
            ("second", "fallback", "axial"),
            "on_target",
            False,
            "the binary is one controller's; leave one of the two out",
        ),
        (("arithmetic",), "on_target", True, "name a processor"),
    )
    on_target: str | None = option(
        None,
        "The controller's C code, compiled for this processor, runs in QEMU as the controller; "
        "the same code runs on this computer for comparison.",
        choices=PROCESSORS,
    )
    arithmetic: Any = option(
        None, "With --on-target: numbers of the code; default: double.", choices=WORDS
    )


@click.command(cls=GroupedCommand, groups=_GROUPS)
@MACHINE
@click.option(
    "--controller",
    "path",
    type=click.Path(path_type=Path),
    help="The controller: its file, or a table of coefficients (*.csv, *.json, *.mat); default: "
    "the machine file's PID.",
)
@click.option(
    "--scenario", required=True, help="A scenario file (*.toml) or the name of a bundled scenario."
)
@options_from(OnTarget)
@click.option(
    "--point", default=None, help="Label of an operating point, or its beginning; default: nominal."
)
@click.option(
    "--report",
    type=click.Path(path_type=Path),
    help="A page of the run: orbits, waterfall, currents, animation.",
)
@click.option(
    "-o", "--output", type=click.Path(path_type=Path), default=Path("record.h5"), show_default=True
)
@AS_JSON
def simulate(
    machine: str,
    path: Path | None,
    scenario: str,
    point: str | None,
    report: Path | None,
    output: Path,
    as_json: bool,
    **asked: Any,
) -> None:
    """Run a scenario on the virtual rig (or the linear model) and write the record (*.h5 or *.csv).

    An *.h5 record of the rig grows while it runs, as *.h5.partial, which stays readable when the
    run is interrupted.
    """
    from ambrose.api import simulate as run
    from ambrose.judge.result import OF_MACHINE, machine_pid
    from ambrose.law.loop import DEFAULT, timing_in_words, timing_of
    from ambrose.record.files import check_suffix, write_record
    from ambrose.report.record import REACHED, run_result

    chosen = asked_for(OnTarget, asked)
    options = chosen.values()
    target, words = options.pop("on_target"), options.pop("arithmetic")
    description = load(machine, part=False)
    controller = machine_pid(description) if path is None else load_controller(path, description)
    check_suffix(output)
    claim(record=output, report=report)
    growing = not chosen.linear and output.suffix.lower() != ".csv"
    options |= {"axes": narrowed(), "point": point, "path": output if growing else None}
    for name in ("second", "axial", "fallback"):
        if options[name] is not None:
            place = description.axial if name == "axial" else description
            options[name] = load_controller(options[name], place)
    looped: InLoop | None = None
    with progress_shown(as_json) as progress:
        if target is not None:
            from ambrose.code.in_loop import simulate_on_target

            timed = {name: options.pop(name) for name in ("rate", "delay_samples")}
            code = C(try_on=target, arithmetic=words or "double", **timed)
            looped = simulate_on_target(
                description, controller, scenario, code, progress=progress, **options
            )
            trace = looped.trace
        else:
            trace = run(description, controller, scenario, progress=progress, **options)
    timing = timing_of(description, controller, chosen.rate, chosen.delay_samples) or (
        None if chosen.linear else DEFAULT
    )
    result = run_result(trace, description)
    failure = None if growing else kept(lambda path: write_record(trace.record, path), output)
    unwritten = kept_page(trace, report, description)
    failure, report = unwritten or failure, None if unwritten else report
    summary = {
        "record": str(output),
        "outcome": trace.outcome,
        "text": trace.text,
        "stable": trace.stable,
        "passed": result.passed,
        "result": result.text,
        "timing": None if timing is None else str(timing),
        "report": str(report) if report else None,
    } | ({} if looped is None else {"on_target": looped.to_dict()})
    if as_json:
        say_json(summary)
    else:
        say(f"{output}: {trace.text}")
        if trace.passed and (not result.passed or result.text.endswith(REACHED)):
            say(f"{result.text[:1].upper()}{result.text[1:]}.")
        say(f"Controller: {timing_in_words(str(timing or 'continuous'))}")
        for part, named in trace.laws:
            if OF_MACHINE in named:
                say(f"{part}: {OF_MACHINE}")
        if looped is not None:
            say(looped.text)
    if failure is not None:
        raise failure
    sys.exit(0 if result.passed and (looped is None or looped.equal) else 1)


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
    from ambrose.api import study
    from ambrose.core.checks import InvalidInput
    from ambrose.machine.ordinary_file import file_name
    from ambrose.report.comparison_tables import decision
    from ambrose.report.tables import verdict
    from ambrose.synthesis.methods import methods

    description = load(machine, part=False)
    directory = output or Path(f"study-{file_name(description.name)}")
    with progress_shown(as_json) as progress:
        result = study(description, directory, axes=narrowed(), progress=progress)
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
        words = decision(result.candidates).text
        if result.axial is not None:
            words += f" Along the shaft: {decision(along).text}"
        say_verdict(words, in_full=words)
        print_table(
            f"{description.name}: {len(result.candidates)} controllers",
            ("controller", "at", "verdict"),
            rows,
            marks,
        )
        if result.commissioned is None:
            say(f"Commissioning was not done: {dict(result.failed)['commissioning']}")
        if report:
            axial = f", {directory / 'axial'}" if result.axial is not None else ""
            say(f"Report: {report}{axial}")
    if result.unwritten:
        raise InvalidInput("; ".join(result.unwritten))
    sys.exit(0 if result.passed and result.commissioned is not None else 1)
