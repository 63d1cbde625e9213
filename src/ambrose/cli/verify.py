"""`ambrose verify`."""

from __future__ import annotations

import sys
from pathlib import Path

import click

from ambrose.terminal import (
    ALL,
    AS_JSON,
    DELAY,
    MACHINE,
    RATE,
    GroupedCommand,
    claim,
    kept,
    kept_page,
    load,
    load_controller,
    print_checks,
    progress_shown,
    quantity_given,
    say,
    say_json,
)

_GROUPS = {
    "": ("path", "everywhere", "report", "everything"),
    "The loop as it runs": ("rate_hz", "delay_samples"),
    "Proofs while the machine moves": ("pressure_rate", "pressure_error", "speed_rate"),
    "Synchronous blocks": ("page",),
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
    "--everywhere",
    is_flag=True,
    help="Bounds and proofs over the tolerances around every operating point, not the first alone.",
)
@RATE
@DELAY
@click.option(
    "--pressure-rate",
    metavar="RATE",
    default=None,
    help='Fastest change of the seal pressure, such as "20 bar/s", for a proof while it changes; '
    "default: the machine file's.",
)
@click.option(
    "--pressure-error",
    metavar="PRESSURE",
    default=None,
    help='How far off what a controller scheduled over pressure is told may be, such as "0.4 '
    'bar"; default: not at all.',
)
@click.option(
    "--speed-rate",
    type=float,
    default=None,
    help="Fastest run-up, rad/s^2, for a proof while the speed changes, over the tolerances as "
    "well; default: none is tried.",
)
@click.option(
    "--report",
    type=click.Path(path_type=Path),
    default=None,
    help="A page: verdicts, curves of all operating points, every check.",
)
@click.option(
    "--page",
    type=click.Path(path_type=Path),
    default=None,
    help="A page of the synchronous blocks: current, force, orbit and margin over speed, before "
    "and after.",
)
@ALL
@AS_JSON
def verify(
    machine: str,
    path: Path,
    everywhere: bool,
    rate_hz: float | None,
    delay_samples: int | None,
    pressure_rate: str | None,
    pressure_error: str | None,
    speed_rate: float | None,
    report: Path | None,
    page: Path | None,
    everything: bool,
    as_json: bool,
) -> None:
    """Check a controller on the full plant: at every operating point of the machine, and over all
    tolerances around each.
    """
    from ambrose.core.checks import check_positive, invalid
    from ambrose.judge.motion import Motion, moving_proofs, refuse_motion
    from ambrose.judge.verdict import verify_controller

    description = load(machine)
    controller = load_controller(path, description)
    fastest = quantity_given(pressure_rate, "--pressure-rate", "pressure per time")
    error = quantity_given(pressure_error, "--pressure-error", "pressure")
    if error and fastest is None and description.operation.pressure_rate is None:
        raise invalid(
            "--pressure-error",
            pressure_error,
            "given with --pressure-rate",
            "say how fast the pressure changes",
        )
    if page is not None:
        settings = description.controller
        if not controller.synchronous and not (settings is not None and settings.synchronous):
            remedy = "design one with ambrose synthesize --synchronous current-free"
            raise invalid(
                "--page", str(page), "given for a controller with a synchronous block", remedy
            )
    claim(page=page, report=report)
    if speed_rate is not None:
        check_positive(speed_rate, "--speed-rate", "give the fastest run-up in rad/s^2")
    motion = Motion(fastest, error or 0.0, speed_rate)
    refuse_motion(description, controller, motion)
    with progress_shown(as_json) as progress:
        result = verify_controller(
            description,
            controller,
            everywhere=everywhere,
            rate=rate_hz,
            delay_samples=delay_samples,
            pressure_rate=fastest,
            pressure_error=error or 0.0,
            speed_rate=speed_rate,
            progress=progress,
        )
    failure = None
    if page is not None:
        from ambrose.report.page import write
        from ambrose.report.synchronous import synchronous_page

        blocks = synchronous_page(
            description, result.synchronous, loop=result.timing, controller=result.controller
        )
        failure = kept(lambda path: write(blocks, path), page)
    failure = kept_page(result, report, description, called="report") or failure
    if as_json:
        say_json({"machine": description.name, **result.to_dict()})
    else:
        for _, checks in result.labelled:
            print_checks(checks, everything)
        say(f"The loop that was judged is {result.timing}.")
        for words in result.over_speed:
            say(f"Beyond the machine's own speed: {words}.")
        for words in result.not_varied:
            say(f"Not varied around {words}.")
        for proof in moving_proofs() if not result.moving else ():
            if (sentence := proof.unproved(description, motion)) is not None:
                say(sentence)
        failed = [label for label, checks in result.labelled if not checks.passed]
        every = f"every check of all {len(result.labelled)} tables"
        say(f"Failed: {'; '.join(failed)}." if failed else f"Passed: {every}.")
        if result.left_out:
            why = (
                "the schedule does not cover them, in what it is scheduled over or in what it was "
                "designed at"
            )
            say(f"Not judged, which does not pass: {'; '.join(result.left_out)}; {why}.")
    if failure is not None:
        raise failure
    sys.exit(0 if result.passed else 1)
