"""`ambrose magnet`."""

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
    say,
    say_json,
    say_verdict,
)


@click.command("magnet")
@MACHINE
@click.option("--bearing", help="One bearing alone; default: every one with a geometry.")
@click.option(
    "--share",
    type=float,
    default=0.25,
    show_default=True,
    help="Share of gap and full control current over which the force law is compared with its "
    "straight line.",
)
@click.option("--tolerances", is_flag=True, help="Print tolerances that cover the bent force law.")
@click.option(
    "-o", "--output", type=click.Path(path_type=Path), help="The magnets as a page (*.html)."
)
@AS_JSON
def magnet_command(
    machine: str,
    bearing: str | None,
    share: float,
    tolerances: bool,
    output: Path | None,
    as_json: bool,
) -> None:
    """What the magnets are by their geometry: k_i, k_s, fluxes, inductance, force.

    Every magnet with a [bearing.magnet] or [bearing.geometry] is solved as a magnetic network.
    Shown are how far the linear force law is off within a share of gap and current, and what an
    open coil leaves.
    """
    from ambrose.annexes.magnets.analysis import magnet_sheets

    description = load(machine)
    claim(page=output)
    result = magnet_sheets(description, bearing, share=share)
    failure = kept_page(result, output)
    if as_json:
        say_json(result.to_dict())
    else:
        from ambrose.annexes.magnets.analysis import magnets_verdict, sheet_rows

        say_verdict(f"{description.name}: {magnets_verdict(result)}")
        for sheet in result.sheets:
            print_table(
                f"{description.name}: magnet {sheet.bearing} ({sheet.part.kind})",
                ("quantity", "value"),
                sheet_rows(sheet, share),
            )
        if tolerances:
            for item in (row for sheet in result.sheets for row in sheet.tolerances):
                say("[[tolerance]]")
                say(f'parameter = "{item.parameter}"')
                say(f"relative = {item.relative}")
    if failure is not None:
        raise failure
