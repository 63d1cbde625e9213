"""`ambrose landing`."""

from __future__ import annotations

import sys
from pathlib import Path

import click

from ambrose.terminal import (
    AS_JSON,
    MACHINE,
    claim,
    kept_page,
    load,
    load_controller,
    print_table,
    progress_shown,
    say,
    say_json,
    say_verdict,
)


@click.command("landing")
@MACHINE
@click.option("--point", help="The operating point of the power loss; default: the fastest one.")
@click.option(
    "--drops",
    type=click.IntRange(0, 1_000_000),
    default=0,
    show_default=True,
    help="Drops over friction, mount, unbalance and speed.",
)
@click.option(
    "--duration",
    type=float,
    help="Of a drop [s]; default: until the races turn with the rotor, 0.4 to 1 s.",
)
@click.option("--seed", type=int, default=1, show_default=True, help="Of the drops.")
@click.option(
    "--controller",
    type=click.Path(path_type=Path),
    help="Another drop in which the magnets come on again under this controller.",
)
@click.option(
    "--power-back",
    type=float,
    default=0.1,
    show_default=True,
    help="With --controller: when they do [s].",
)
@click.option(
    "--from",
    "source",
    type=click.Path(path_type=Path),
    help="The one drop begins as the rotor moves in this record (*.h5), at --trip.",
)
@click.option("--trip", type=float, help="With --from: when the power is lost [s].")
@click.option("--workers", type=click.IntRange(1, 256), help="Default: one for each processor.")
@click.option("-o", "--output", type=click.Path(path_type=Path), help="The page (*.html).")
@AS_JSON
def landing_command(
    machine: str,
    point: str | None,
    drops: int,
    duration: float | None,
    seed: int,
    controller: Path | None,
    power_back: float,
    source: Path | None,
    trip: float | None,
    workers: int | None,
    output: Path | None,
    as_json: bool,
) -> None:
    """Landing in the touchdown bearings: whip before any simulation, then drops.

    Backward whip from the receptances of the rotor without its magnets and of the touchdown
    bearings: at which friction, how fast, with which force. One drop with the file's values, or
    many over the uncertain ones. Exit status 1: a limit of [bearing.touchdown.limits] fails.
    """
    from ambrose.annexes.touchdown.analysis import WHIP_MODEL, landing
    from ambrose.record.files import read_record

    description = load(machine)
    law = None if controller is None else load_controller(controller, description)
    record = None if source is None else read_record(source)
    claim(page=output)
    with progress_shown(as_json) as progress:
        result = landing(
            description,
            point,
            drops=drops,
            duration=duration,
            seed=seed,
            law=law,
            power_back=power_back,
            record=record,
            trip=trip,
            workers=workers,
            progress=progress,
        )
        failure = kept_page(result, output, progress=progress)
    if as_json:
        say_json(result.to_dict())
    else:
        from ambrose.annexes.touchdown.page import cost_rows, verdict_text, whip_rows

        print_table(
            f"{description.name}: backward whip at {result.point_name}",
            ("kind", "friction", "settles at", "force"),
            whip_rows(result),
        )
        say(f"Model: {WHIP_MODEL}.")
        print_table(
            "landing",
            ("place", "quantity", "value", "limit", "verdict"),
            cost_rows(result),
        )
        if result.campaign is not None:
            share = 100 * result.campaign.whirls.mean()
            say(
                f"{share:.3g} % of {drops:,} drops whirl within {result.duration:.3g} s (three "
                f"turns against the spin, nonlinear model); {result.campaign.wall:.0f} s."
            )
        verdict = verdict_text(result)
        say_verdict(f"{verdict[:1].upper()}{verdict[1:]}.", in_full=f"Result: {verdict}.")
    if failure is not None:
        raise failure
    sys.exit(1 if result.passed is False else 0)
