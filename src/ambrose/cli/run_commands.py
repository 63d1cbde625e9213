"""`ambrose study`."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import click

from ambrose.code.targets import PROCESSORS, WORDS, C
from ambrose.terminal import (
    ALL,
    AS_JSON,
    DELAY,
    MACHINE,
    PRESSURE_ERROR,
    RATE,
    STUCK_AFTER,
    GroupedCommand,
    claim,
    kept,
    kept_page,
    load,
    load_controller,
    print_checks,
    print_table,
    progress_shown,
    quantity_given,
    say,
    say_json,
)

if TYPE_CHECKING:
    from ambrose.code.in_loop import InLoop


# `ambrose simulate`.


_GROUPS = {
    "": ("path", "scenario", "point", "output", "report"),
    "The run": ("axial", "linear", "rate_hz", "delay_samples", "bending_modes", "seed", "second"),
    "A fallback beside a controller scheduled over pressure": (
        "fallback",
        "pressure_rate",
        "pressure_error",
        "stuck_after",
        "estimate",
    ),
    "The code on its processor": ("on_target", "arithmetic"),
}


@click.command(cls=GroupedCommand, groups=_GROUPS)
@MACHINE
@click.option(
    "--controller",
    "path",
    type=click.Path(path_type=Path),
    required=True,
    help="A controller file (*.json).",
)
@click.option(
    "--scenario", required=True, help="A scenario file (*.toml) or the name of a bundled scenario."
)
@click.option(
    "--axial",
    type=click.Path(path_type=Path),
    help="The controller of machine.toml#axial: all axes run together.",
)
@click.option(
    "--linear", is_flag=True, help="The linear model instead of the nonlinear virtual rig."
)
@click.option(
    "--second",
    type=click.Path(path_type=Path),
    help="A controller that takes over at the scenario's switch_at.",
)
@click.option(
    "--fallback",
    type=click.Path(path_type=Path),
    help="Fixed controller for when a schedule's pressure cannot be trusted.",
)
@click.option(
    "--pressure-rate",
    metavar="RATE",
    help='With --fallback: the fastest change believed, such as "80 bar/s".',
)
@PRESSURE_ERROR
@STUCK_AFTER
@click.option(
    "--estimate",
    type=click.Choice(["beside", "alone"]),
    help="With --fallback: a seal monitor runs beside the pressure's reading, or its estimate is "
    "told in place of one.",
)
@click.option(
    "--bending-modes",
    type=int,
    help="Bending modes per plane of the rig; default: 3, as identify models.",
)
@click.option(
    "--on-target",
    type=click.Choice(PROCESSORS),
    help="The controller's C code, compiled for this processor, runs in QEMU as the controller; "
    "beside it once more on this computer.",
)
@click.option(
    "--arithmetic",
    type=click.Choice(WORDS),
    help="With --on-target: numbers of the code; default: double.",
)
@click.option("--seed", type=int, help="Of the sensors' noise on the rig; default: 0.")
@click.option(
    "--point", default=None, help="Label of an operating point, or its beginning; default: nominal."
)
@RATE
@DELAY
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
    path: Path,
    scenario: str,
    axial: Path | None,
    linear: bool,
    second: Path | None,
    fallback: Path | None,
    pressure_rate: str | None,
    pressure_error: str | None,
    stuck_after: float | None,
    estimate: str | None,
    on_target: str | None,
    arithmetic: str | None,
    bending_modes: int | None,
    seed: int | None,
    point: str | None,
    rate_hz: float | None,
    delay_samples: int | None,
    report: Path | None,
    output: Path,
    as_json: bool,
) -> None:
    """Run a scenario on the virtual rig (or the linear model) and write the record (*.h5 or *.csv).

    An *.h5 record of the rig grows while it runs, as *.h5.partial, which stays readable when the
    run is interrupted.
    """
    from ambrose.core.checks import invalid
    from ambrose.law.loop import DEFAULT, timing_in_words, timing_of
    from ambrose.record.files import check_suffix, write_record
    from ambrose.report.record import REACHED, run_result
    from ambrose.rig.trial import simulate_scenario

    for option, value in (
        ("--bending-modes", bending_modes),
        ("--seed", seed),
        ("--second", second),
        ("--fallback", fallback),
        ("--on-target", on_target),
        ("--axial", axial),
    ):
        if linear and value is not None:
            remedy = (
                "the linear loop has all modes, no noise and one controller; leave one of the two "
                "out"
            )
            raise invalid(option, value, "left out with --linear", remedy)
    watched = {
        "--pressure-rate": pressure_rate,
        "--pressure-error": pressure_error,
        "--stuck-after": stuck_after,
    }
    watched["--estimate"] = estimate
    for option, is_given in watched.items():
        if is_given is not None and fallback is None:
            raise invalid(
                option, is_given, "given with --fallback", "name the controller that takes over"
            )
    for option, there in (("--second", second), ("--fallback", fallback), ("--axial", axial)):
        if on_target is not None and there is not None:
            remedy = "the binary is one controller's; leave one of the two out"
            raise invalid(option, there, "left out with --on-target", remedy)
    if arithmetic is not None and on_target is None:
        raise invalid("--arithmetic", arithmetic, "given with --on-target", "name a processor")
    description = load(machine)
    controller = load_controller(path, description)
    check_suffix(output)
    claim(record=output, report=report)
    growing = not linear and output.suffix.lower() != ".csv"
    options: dict[str, Any] = (
        {} if second is None else {"second": load_controller(second, description)}
    )
    if axial is not None:
        options["axial"] = load_controller(axial, description.axial)
    if fallback is not None:
        rate = quantity_given(pressure_rate, "--pressure-rate", "pressure per time")
        error = quantity_given(pressure_error, "--pressure-error", "pressure")
        options |= {"fallback": load_controller(fallback, description), "pressure_rate": rate}
        options |= {
            "pressure_error": error or 0.0,
            "stuck_after": stuck_after,
            "estimate": estimate,
        }
    if not linear:
        options |= {
            "bending_modes": bending_modes,
            "seed": seed or 0,
            "path": output if growing else None,
        }
    looped: InLoop | None = None
    with progress_shown(as_json) as progress:
        if on_target is not None:
            from ambrose.code.in_loop import simulate_on_target

            code = C(
                try_on=on_target,
                arithmetic=cast("Any", arithmetic or "double"),
                rate=rate_hz,
                delay_samples=delay_samples,
            )
            looped = simulate_on_target(
                description, controller, scenario, code, point=point, progress=progress, **options
            )
            trace = looped.trace
        else:
            trace = simulate_scenario(
                description,
                controller,
                scenario,
                point=point,
                linear=linear,
                rate=rate_hz,
                delay_samples=delay_samples,
                progress=progress,
                **options,
            )
    timing = timing_of(description, controller, rate_hz, delay_samples) or (
        None if linear else DEFAULT
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
    from ambrose.chain.study import study
    from ambrose.core.checks import InvalidInput
    from ambrose.machine.ordinary_file import file_name
    from ambrose.report.comparison_tables import decision
    from ambrose.report.tables import verdict
    from ambrose.synthesis.methods import methods

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
