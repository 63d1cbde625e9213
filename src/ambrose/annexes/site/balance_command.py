"""`ambrose balance`."""

from __future__ import annotations

import cmath
import math
import sys
from contextlib import suppress
from pathlib import Path

import click

from ambrose.terminal import AS_JSON, MACHINE, load, load_controller, print_table, say, say_json


@click.command()
@MACHINE
@click.argument("records", nargs=-1, type=click.Path(path_type=Path))
@click.option(
    "--plane",
    "planes",
    multiple=True,
    required=True,
    metavar="NAME=RADIUS",
    help="Where masses go: a bearing, disc, seal or coupling of the machine, and the radius: "
    '"impeller=80 mm" (repeatable).',
)
@click.option(
    "--trial",
    "trials",
    nargs=2,
    multiple=True,
    metavar="RECORD WEIGHTS",
    help='A record with known weights on: "impeller=2 g@30", or several, with commas between; '
    "degrees (repeatable).",
)
@click.option(
    "--controller", type=click.Path(path_type=Path), help="The controller that ran (*.json)."
)
@click.option(
    "--amplitudes",
    type=click.Path(path_type=Path),
    help="In place of records: the amplitudes that converged current-free blocks hold (*.csv with "
    "speed_rpm, axis, amplitude_um_0p, angle_deg).",
)
@click.option(
    "--since",
    type=click.Path(path_type=Path),
    help="With --amplitudes: an earlier such table; what has come since is told and balanced.",
)
@click.option(
    "--settle",
    type=float,
    default=0.3,
    show_default=True,
    help="Seconds left out at the beginning of every record.",
)
@AS_JSON
def balance(
    machine: str,
    records: tuple[Path, ...],
    planes: tuple[str, ...],
    trials: tuple[tuple[str, str], ...],
    controller: Path | None,
    amplitudes: Path | None,
    since: Path | None,
    settle: float,
    as_json: bool,
) -> None:
    """Correction masses from what turns once with the rotor, in g and degrees, with the residual
    that they will leave.

    RECORDS hold y_<axis> and u_<axis> (or i_<axis>) at steady speeds, one or several; one at slow
    roll tells the run-out. With as many trial runs as planes, at the same speed, the influence
    coefficients are measured; without, they are the model's. Degrees count in the direction of spin
    from the key mark, which points along x when the signal key rises. Exit status 1: done, but the
    planes are hardly told apart, run-out is unknown, or the correction may not lower the vibration;
    with --since: the unbalance has changed.
    """
    from ambrose.annexes.site.balancing.amplitude_table import read_amplitudes
    from ambrose.annexes.site.balancing.correction import balance as balanced
    from ambrose.annexes.site.balancing.synchronous import balance_amplitudes, grown
    from ambrose.annexes.site.balancing_page import balancing_tables, in_words

    _check_sources(records, trials, amplitudes, since)
    description = load(machine)
    radii = {
        name: _read(text, "--plane", "length", f"{name}=80 mm") for name, text in map(_pair, planes)
    }
    weights = [(Path(record), _weights(text, radii)) for record, text in trials]
    law = load_controller(controller, description) if controller else None
    if amplitudes is not None:
        axes = description.axes
        earlier = None if since is None else read_amplitudes(since, axes)
        result = balance_amplitudes(
            description,
            read_amplitudes(amplitudes, axes),
            radii,
            before=earlier,
            controller=law,
        )
        passed = result.passed if since is None else not grown(result)
    else:
        result = balanced(
            description, records, radii, trials=weights, controller=law, settle=settle
        )
        passed = result.passed
    if as_json:
        say_json(result.to_dict())
    else:
        for table in balancing_tables(result):
            rows = [tuple(cell.text for cell in row) for row in table.cells]
            print_table(table.title, table.columns, rows)
        for line in in_words(result):
            say(line)
    sys.exit(0 if passed else 1)


def _check_sources(
    records: tuple[Path, ...],
    trials: tuple[tuple[str, str], ...],
    amplitudes: Path | None,
    since: Path | None,
) -> None:
    """Raises InvalidInput unless there are records, or amplitudes with nothing that goes with
    records.
    """
    from ambrose.core.checks import InvalidInput, invalid

    if amplitudes is None:
        if since is not None:
            raise invalid("--since", since, "given with --amplitudes", "give the table of now")
        if not records:
            raise InvalidInput("no record is given; name one, or a table with --amplitudes")
        return
    for name, value in {"a record": records, "--trial": trials}.items():
        if value:
            raise InvalidInput(
                f"{name} is given beside --amplitudes; a table of amplitudes needs no record, "
                "leave it out"
            )


def _pair(text: str) -> tuple[str, str]:
    name, _, value = text.partition("=")
    return name.strip(), value.strip()


def _read(text: str, option: str, dimension: str, example: str) -> float:
    from ambrose.core.checks import InvalidInput
    from ambrose.machine.units import DIMENSIONS, read_quantity

    bare = False
    with suppress(ValueError):
        bare = math.isfinite(float(text))
    if bare:
        raise InvalidInput(f'{option} {text!r} has no unit; write it as in "{example}"')
    try:
        return read_quantity(text, DIMENSIONS[dimension])
    except ValueError as error:
        raise InvalidInput(f'{option} {text!r} {error}; write it as in "{example}"') from error


def _weights(text: str, radii: dict[str, float]) -> dict[str, complex]:
    """m r exp(j angle) [kg m] by plane, of "impeller=2 g@30, D2=1 g@120"."""
    from ambrose.core.checks import invalid

    found: dict[str, complex] = {}
    for item in text.split(","):
        name, value = _pair(item)
        mass, at, degrees = value.partition("@")
        try:
            angle = float(degrees)
        except ValueError:
            at = ""
        if not at or name not in radii:
            raise invalid(
                "--trial",
                repr(text),
                "PLANE=MASS@DEGREES with the planes of --plane",
                'write "impeller=2 g@30"',
            )
        found[name] = (
            _read(mass.strip(), "--trial", "mass", f"{name}=2 g@30")
            * radii[name]
            * cmath.exp(1j * angle * cmath.pi / 180)
        )
    return found
