"""`ambrose export`."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import click

from ambrose.cli.convert_controller import METHODS
from ambrose.terminal import (
    AS_JSON,
    DELAY,
    PRESSURE_ERROR,
    RATE,
    STUCK_AFTER,
    load,
    progress_shown,
    quantity_given,
    say,
    say_json,
)


@click.command()
@click.argument("controller", type=click.Path(path_type=Path))
@click.option(
    "--to",
    "target",
    type=click.Choice(["c", "mat", "fmu", "st"]),
    required=True,
    help="What to write: C99, a MAT-file, FMUs (FMI 2.0 and 3.0) or structured text.",
)
@click.option(
    "-o",
    "--output",
    type=click.Path(path_type=Path),
    required=True,
    help="Directory for the files.",
)
@click.option(
    "--name",
    default="controller",
    show_default=True,
    help="Prefix of every name in the code, a C identifier.",
)
@click.option(
    "--arithmetic",
    type=click.Choice(["double", "float", "fixed32", "fixed16"]),
    default="double",
    show_default=True,
)
@RATE
@DELAY
@click.option(
    "--sampling",
    type=click.Choice(METHODS),
    default="tustin",
    show_default=True,
    help="How it is sampled.",
)
@click.option(
    "--prewarp-hz",
    type=float,
    help="Tustin exact at this frequency; of matched: where the gain is that of before.",
)
@click.option(
    "--form",
    type=click.Choice(["modal", "cascade"]),
    default="modal",
    show_default=True,
    help="Realisation in C: modal, or of a filter bank its sections one by one.",
)
@click.option(
    "--machine",
    "machine",
    default=None,
    help="Default: the bundled machine that the controller was made for.",
)
@click.option(
    "--error-limit",
    type=float,
    default=None,
    help="Largest plausible error in m; default: the bearing's gap.",
)
@click.option(
    "--current-limit",
    type=float,
    default=None,
    help="Largest current in A; default: the bearing's.",
)
@click.option(
    "--speed-limit",
    type=float,
    default=None,
    help="Scheduled: largest plausible speed in rad/s; default: twice the range's.",
)
@click.option(
    "--speed-rate",
    type=float,
    default=None,
    help="Scheduled: how fast it follows the speed, in rad/s^2.",
)
@click.option(
    "--pressure-limit",
    metavar="PRESSURE",
    default=None,
    help='Scheduled: largest plausible pressure, such as "6 bar"; default: twice the range\'s.',
)
@click.option(
    "--pressure-rate",
    metavar="RATE",
    default=None,
    help='Scheduled: how fast it follows the pressure, such as "40 bar/s".',
)
@click.option(
    "--fallback",
    type=click.Path(path_type=Path),
    help="Fixed controller for when a schedule's pressure cannot be trusted; --pressure-rate: the "
    "fastest change believed.",
)
@PRESSURE_ERROR
@STUCK_AFTER
@click.option(
    "--sources-only", is_flag=True, help="An FMU without a binary: no C compiler is needed here."
)
@click.option(
    "--force",
    is_flag=True,
    help="Export a controller that is not verified, or not stable everywhere.",
)
@AS_JSON
def export(
    controller: Path,
    target: Any,
    output: Path,
    name: str,
    arithmetic: Any,
    rate_hz: float | None,
    delay_samples: int | None,
    sampling: Any,
    prewarp_hz: float | None,
    form: Any,
    machine: str | None,
    error_limit: float | None,
    current_limit: float | None,
    speed_limit: float | None,
    speed_rate: float | None,
    pressure_limit: str | None,
    pressure_rate: str | None,
    fallback: Path | None,
    pressure_error: str | None,
    stuck_after: float | None,
    sources_only: bool,
    force: bool,
    as_json: bool,
) -> None:
    """Sample a controller, verify its loop as it will run, and write it as code for the target.

    A scheduled controller is written in floating point, verified at frozen speeds or pressures over
    its range.
    """
    from ambrose.code.pipeline import ExportOptions
    from ambrose.code.pipeline import export as write_for_target
    from ambrose.core.checks import check_positive
    from ambrose.judge.controller_file import read_controller

    remedy = "give it in Hz"
    if rate_hz is not None:
        check_positive(rate_hz, "--rate-hz", remedy)
    prewarp = (
        None
        if prewarp_hz is None
        else 6.283185307179586 * check_positive(prewarp_hz, "--prewarp-hz", remedy)
    )
    options = ExportOptions(
        name=name,
        arithmetic=arithmetic,
        rate=rate_hz,
        delay_samples=delay_samples,
        sampling=sampling,
        prewarp=prewarp,
        form=form,
        error_limit=error_limit,
        current_limit=current_limit,
        speed_limit=speed_limit,
        speed_rate=speed_rate,
        pressure_limit=quantity_given(pressure_limit, "--pressure-limit", "pressure"),
        pressure_rate=quantity_given(pressure_rate, "--pressure-rate", "pressure per time"),
        pressure_error=quantity_given(pressure_error, "--pressure-error", "pressure"),
        stuck_after=stuck_after,
        sources_only=sources_only,
        force=force,
    )
    other = None if fallback is None else read_controller(fallback)
    file, known = read_controller(controller), None if machine is None else load(machine)
    with progress_shown(as_json) as progress:
        delivery = write_for_target(
            file,
            output,
            to=target,
            machine=known,
            options=options,
            fallback=other,
            progress=progress,
        )
    content = delivery.to_dict()
    if as_json:
        say_json(content)
    else:
        for problem in content["problems"]:
            say(f"forced although {problem}", err=True)
        for limit in content["unmet_limits"]:
            say(f"the loop as it runs misses a limit: {limit}", err=True)
        for path in content["files"]:
            say(path)
    sys.exit(0 if content["verified"] and not content["unmet_limits"] else 1)
