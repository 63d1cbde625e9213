"""`ambrose synthesize`."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import click

from ambrose.cli.terminal import AS_JSON, MACHINE, load, print_table, progress_shown, shown


@click.command()
@MACHINE
@click.option("--method", type=click.Choice(["pid", "hinf", "mu", "polish"]), default="pid", show_default=True)
@click.option("--bending-modes", type=int, default=0, show_default=True, help="Bending modes per plane in the design model.")
@click.option(
    "--match-reference/--own-gain",
    default=None,
    help="Scale the control weight until the direct gains match the reference PID's; default: with a constant weight.",
)
@click.option("--order", type=int, default=None, help="States of the polished controller; default: half of what mu needs.")
@click.option("-o", "--output", type=click.Path(path_type=Path), default=Path("controller.json"), show_default=True)
@AS_JSON
def synthesize(
    machine: str,
    method: str,
    bending_modes: int,
    match_reference: bool | None,
    order: int | None,
    output: Path,
    as_json: bool,
) -> None:
    """Design a controller on the reduced plant and certify it on the full one, at the nominal operating point."""
    from ambrose.export.files import write_controller
    from ambrose.export.results import certificate_to_dict
    from ambrose.plant.assemble import assemble
    from ambrose.synthesis.design import design

    description = load(machine)
    with progress_shown(as_json) as progress:
        progress("assembling the plant")
        plant = assemble(description)
        progress(f"designing ({method})")
        result = design(
            plant, method, bending_modes=bending_modes, match_reference=match_reference, order=order, progress=progress
        )
    write_controller(output, result, description)
    certificate = certificate_to_dict(result.certificate)
    if as_json:
        summary: dict[str, Any] = {"controller": str(output), "method": method, "status": result.status}
        summary["notes"] = list(result.notes)
        summary["certificate"] = certificate
        click.echo(json.dumps(summary))
    else:
        rows = [(name.replace("_", " "), shown(value)) for name, value in certificate.items() if name != "margins"]
        rows += [(name.replace("_", " "), shown(value)) for name, value in certificate["margins"].items()]
        rows += [("note", note) for note in result.notes]
        print_table(f"{method} controller, {result.status}: {output}", ("certificate", "value"), rows)
    sys.exit(0 if result.status.startswith("verified") else 1)
