"""`ambrose synthesize`."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import click

from ambrose.terminal import (
    AS_JSON,
    DELAY,
    MACHINE,
    RATE,
    claim,
    kept,
    load,
    print_table,
    progress_shown,
    quantity_given,
    say_json,
    shown,
)


@click.command()
@MACHINE
@click.option(
    "--method",
    type=click.Choice(["tuned", "pid", "hinf", "mu", "polish", "lpv"]),
    default="tuned",
    show_default=True,
)
@click.option(
    "--bending-modes",
    type=int,
    default=None,
    help="Bending modes per plane in the design model; default: with --method tuned all that "
    "matter, else none.",
)
@click.option(
    "--match-reference/--own-gain",
    default=None,
    help="Scale the control weight until the direct gains match the reference PID's; default: "
    "with a constant weight.",
)
@click.option(
    "--order",
    type=int,
    default=None,
    help="States of the polished (default: half of what mu needs) or the tuned controller (three "
    "per axis; filters: six).",
)
@click.option(
    "--structure",
    type=click.Choice(["free", "plane", "axis", "pid", "filters"]),
    default="free",
    show_default=True,
    help="With --method tuned: which axes share a part of the controller, or a filter bank per "
    "channel.",
)
@click.option(
    "--envelope", is_flag=True, help="With --method hinf or mu: for all operating points at once."
)
@click.option(
    "--point",
    default=None,
    help="Label of an operating point, or its beginning; default: the design point.",
)
@RATE
@DELAY
@click.option(
    "--loss",
    type=float,
    default=None,
    help="With a rate: lower the order until the worst sensitivity rises by so many percent.",
)
@click.option(
    "--speeds-hz",
    type=float,
    nargs=2,
    default=None,
    help="With --method lpv: lowest and highest speed; default: those of the operating points at "
    "the same seal pressure; "
    "where those have one speed alone, their pressures.",
)
@click.option(
    "--speed-rate",
    type=float,
    default=None,
    help="With --method lpv: fastest run-up, rad/s^2, which the proof then takes; default: any.",
)
@click.option(
    "--pressures-bar",
    type=float,
    nargs=2,
    default=None,
    help="With --method lpv: lowest and highest seal pressure, to schedule over it instead of the "
    "speed, or over both.",
)
@click.option(
    "--pressure-rate",
    metavar="RATE",
    default=None,
    help='With --method lpv: fastest change of the pressure, such as "20 bar/s", which the proof '
    "then takes; default: any.",
)
@click.option(
    "--tolerances",
    is_flag=True,
    help="With --method lpv: design over the machine's tolerances, too (mu, polish and tuned "
    "always do).",
)
@click.option(
    "--backoff",
    type=float,
    default=None,
    help="With --method lpv: how far above the smallest gamma to stay; default 1.1, with "
    "--tolerances 1.2. Nearer to 1 it is "
    "better, with faster poles.",
)
@click.option(
    "-o",
    "--output",
    type=click.Path(path_type=Path),
    default=Path("controller.json"),
    show_default=True,
)
@click.option(
    "--machine-file",
    type=click.Path(path_type=Path),
    default=None,
    help="With --structure pid or filters: write the machine with the filters found as its "
    "[controller].",
)
@AS_JSON
def synthesize(
    machine: str,
    method: str,
    bending_modes: int | None,
    match_reference: bool | None,
    order: int | None,
    structure: str,
    envelope: bool,
    point: str | None,
    rate_hz: float | None,
    delay_samples: int | None,
    loss: float | None,
    speeds_hz: tuple[float, float] | None,
    speed_rate: float | None,
    pressures_bar: tuple[float, float] | None,
    pressure_rate: str | None,
    tolerances: bool,
    backoff: float | None,
    output: Path,
    machine_file: Path | None,
    as_json: bool,
) -> None:
    """Design a controller on the reduced plant and certify it on the full one.

    With --method tuned, the default, for the whole envelope: all operating points and the
    tolerances around each; the other methods design for one operating point (--point), lpv for a
    range of speeds, of seal pressures or both.
    """
    from ambrose.core.checks import check_positive, invalid
    from ambrose.judge.controller_file import write_controller
    from ambrose.judge.plants import plant_at
    from ambrose.judge.result import Status
    from ambrose.law.filters import filter_rows
    from ambrose.law.timing import machine_timing
    from ambrose.machine.file.update import save_machine
    from ambrose.synthesis.design import design
    from ambrose.synthesis.fixed_order.bank import BANKS
    from ambrose.synthesis.options import DesignOptions

    for option, given, methods in (
        ("--order", order is not None, ("polish", "tuned")),
        ("--structure", structure != "free", ("tuned",)),
        ("--loss", loss is not None, ("pid", "hinf", "mu", "polish", "lpv")),
        ("--envelope", envelope, ("hinf", "mu")),
        ("--speeds-hz", speeds_hz is not None, ("lpv",)),
        ("--speed-rate", speed_rate is not None, ("lpv",)),
        ("--pressures-bar", pressures_bar is not None, ("lpv",)),
        ("--pressure-rate", pressure_rate is not None, ("lpv",)),
        ("--tolerances", tolerances, ("lpv",)),
        ("--backoff", backoff is not None, ("lpv",)),
    ):
        if given and method not in methods:
            raise invalid(
                option,
                "given",
                f"left out with --method {method}",
                f"it goes with {' or '.join(methods)}",
            )
    description = load(machine)
    hertz = 6.283185307179586  # rad/s
    if loss is not None and rate_hz is None and machine_timing(description) is None:
        raise invalid(
            "--rate-hz",
            "not given",
            "given with --loss",
            "say at which rate the controller will run",
        )
    if loss is not None:  # before the design, which takes a while
        check_positive(loss, "--loss", "5 allows 5 %", zero_allowed=True)
    for option, ends in (("--speeds-hz", speeds_hz), ("--pressures-bar", pressures_bar)):
        if ends is not None and not 0 <= ends[0] < ends[1] < float("inf"):
            remedy = "swap the two" if 0 <= ends[1] < ends[0] else "give two numbers that differ"
            raise invalid(
                option,
                f"{ends[0]:g} {ends[1]:g}",
                "the lower, then the higher, none negative",
                remedy,
            )
    if rate_hz is not None:
        check_positive(rate_hz, "--rate-hz", "10000 is usual")
    if speed_rate is not None:
        check_positive(speed_rate, "--speed-rate", "give it in rad/s^2")
    options = DesignOptions(
        rate=rate_hz,
        delay_samples=delay_samples,
        loss=None if loss is None else loss / 100,
        order=order,
        bending_modes=bending_modes,
        structure=structure,
        envelope=envelope,
        match_reference=match_reference,
        speeds=None if speeds_hz is None else (hertz * speeds_hz[0], hertz * speeds_hz[1]),
        speed_rate=speed_rate,
        pressures=None
        if pressures_bar is None
        else (1e5 * pressures_bar[0], 1e5 * pressures_bar[1]),
        pressure_rate=quantity_given(pressure_rate, "--pressure-rate", "pressure per time"),
        tolerances=tolerances,
        backoff=backoff,
    )
    if machine_file is not None and (method != "tuned" or structure not in BANKS):
        raise invalid(
            "--machine-file",
            str(machine_file),
            "given with a filter bank",
            "add --method tuned --structure pid",
        )
    claim(controller_file=output, machine_file=machine_file)
    with progress_shown(as_json) as progress:
        progress("assembling the plant")
        plant = plant_at(description, point)
        progress(f"designing ({method})")
        result = design(plant, method, options=options, progress=progress)
    failure = kept(lambda path: write_controller(path, result), output)
    if machine_file is not None and result.filters is not None:
        runs = options.on(description).timing()
        settings = result.filters
        if runs is not None:  # or the loop would be judged continuous, read back from the file
            settings = replace(
                settings, sample_time=runs.sample_time, delay=runs.delay_samples * runs.sample_time
            )
        # of [machine.assumed]; the rest speaks of other settings
        stays = {"controller.sample_time", "controller.delay"}
        reasons = tuple(
            row
            for row in description.assumed
            if row[0] in stays or row[0].partition(".")[0] != "controller"
        )
        found = replace(description, controller=settings, assumed=reasons)
        failure = kept(lambda path: save_machine(found, path), machine_file) or failure
    certificate = result.certificate.to_dict()
    factor = None if result.weights is None else result.weights.control_factor
    if as_json:
        summary = {
            "controller": str(output),
            "method": method,
            "status": result.status,
            "stopped_early": result.stopped_early,
            "states": result.controller.n_states,
            "control_weight_factor": factor,
            "notes": result.notes,
            "certificate": certificate,
            "filters": None if result.filters is None else result.filters.to_dict(),
        }
        say_json(summary)
    else:
        rows = [("states", f"{result.controller.n_states}")]
        numbers = _numbers(certificate)
        if method != "pid":  # which minimises nothing
            numbers = {"gamma": result.gamma, **numbers}
        rows += [(name.replace("_", " "), shown(value)) for name, value in numbers.items()]
        rows += [
            (f"abscissa, {label}", shown(value)) for label, value in certificate["envelope"].items()
        ]
        if factor is not None:
            rows.append(("control weight factor", shown(factor)))
        rows += [("note", note) for note in result.notes]
        early = "STOPPED EARLY: " if result.stopped_early else ""
        print_table(
            f"{method} controller, {early}{result.verdict}: {output}",
            ("certificate", "value"),
            rows,
        )
        if result.filters is not None and result.filters.channels:
            print_table(
                "filters, each channel in series",
                ("channel", "filter", "parameters"),
                filter_rows(result.filters),
            )
    if failure is not None:
        raise failure
    sys.exit(0 if result.status is Status.VERIFIED and not result.missed else 1)


def _numbers(certificate: dict[str, Any]) -> dict[str, Any]:
    """What is told of a certificate: where the loop runs sampled those figures first, and no
    margins of another one that it does not have. The controller file keeps all.
    """
    margins, apart = certificate["margins"], {"margins", "envelope"}
    numbers = {name: value for name, value in certificate.items() if name not in apart}
    as_run = {name: value for name, value in margins.items() if name.startswith("sampled_")}
    if not as_run:
        return numbers | margins
    told = {name: numbers.pop(name) for name in ("stable", "plant")} | as_run
    if not certificate["stable"]:
        return told
    others = numbers | {name: value for name, value in margins.items() if name not in as_run}
    full = {"full_spectral_abscissa", "full_sensitivity_peak"}
    return told | {
        name if name == "fastest_pole" else f"continuous {name}": value
        for name, value in others.items()
        if name not in full
    }
