"""`ambrose landing`."""

from __future__ import annotations

from pathlib import Path

import click

from ambrose.terminal import (
    AS_JSON,
    MACHINE,
    claim,
    kept_page,
    load,
    print_table,
    progress_shown,
    say,
    say_json,
)


@click.command("landing")
@MACHINE
@click.option("--point", help="The operating point of the power loss; default: the fastest one.")
@click.option("-o", "--output", type=click.Path(path_type=Path), help="The page (*.html).")
@AS_JSON
def landing_command(machine: str, point: str | None, output: Path | None, as_json: bool) -> None:
    """Landing in the touchdown bearings: whip before any simulation.

    Backward whip from the receptances of the rotor without its magnets and of the touchdown
    bearings with their mounts: at which friction, how fast, with which force.
    """
    from ambrose.annexes.touchdown.analysis import WHIP_MODEL, landing

    description = load(machine)
    claim(page=output)
    with progress_shown(as_json) as progress:
        result = landing(description, point, progress=progress)
        failure = kept_page(result, output, progress=progress)
    if as_json:
        say_json(result.to_dict())
    else:
        from ambrose.annexes.touchdown.page import whip_rows

        print_table(
            f"{description.name}: backward whip at {result.point_name}",
            ("kind", "friction", "settles at", "force"),
            whip_rows(result),
        )
        say(f"Model: {WHIP_MODEL}.")
    if failure is not None:
        raise failure
