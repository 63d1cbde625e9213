"""`ambrose calibrate`."""

from __future__ import annotations

from pathlib import Path

import click

from ambrose.terminal import AS_JSON, MACHINE, claim, kept, load, print_table, say, say_json


@click.command()
@MACHINE
@click.option(
    "--circle",
    type=click.Path(path_type=Path),
    help="A record of the rotor going around in its touchdown bearings.",
)
@click.option(
    "--slow-roll",
    type=click.Path(path_type=Path),
    help="A record of the levitated rotor turning slowly.",
)
@click.option(
    "--levitated",
    multiple=True,
    type=click.Path(path_type=Path),
    help="A record of it levitated at rest (repeatable).",
)
@click.option(
    "--find",
    type=click.Choice(("gain", "clearance")),
    default="gain",
    show_default=True,
    help="What the circle tells: gains, the touchdown gaps known; or the gaps, the gains known.",
)
@click.option("--harmonics", type=int, default=3, show_default=True, help="Of the run-out.")
@click.option(
    "--settle",
    type=float,
    default=0.3,
    show_default=True,
    help="Seconds left out at the beginning of every record.",
)
@click.option(
    "-o",
    "--output",
    type=click.Path(path_type=Path),
    default=Path("calibrated.toml"),
    show_default=True,
)
@AS_JSON
def calibrate(
    machine: str,
    circle: Path | None,
    slow_roll: Path | None,
    levitated: tuple[Path, ...],
    find: str,
    harmonics: int,
    settle: float,
    output: Path,
    as_json: bool,
) -> None:
    """Sensor gains and offsets, clearance, run-out and magnetic centre from standard tests; write
    the machine with them.

    The static circle needs no controller, only slowly turning currents that press the rotor against
    its touchdown bearings; slow roll and levitation record y_<axis> with u_<axis> or i_<axis>.
    Comments and all else in the machine file stay.
    """
    from ambrose.annexes.site.calibration import calibrate as calibrated
    from ambrose.machine.atomic_write import write_text
    from ambrose.machine.file.update import machine_text
    from ambrose.report import units

    description = load(machine)
    claim(machine_file=output)
    done = calibrated(
        description,
        circle=circle,
        slow_roll=slow_roll,
        levitated=levitated,
        find=find,  # type: ignore[arg-type]
        harmonics=harmonics,
        settle=settle,
    )
    failure = kept(
        lambda path: write_text(path, machine_text(done.machine), "machine file"), output
    )
    if as_json:
        say_json({**done.to_dict(), "machine_file": str(output)})
    else:
        rows = [
            (
                e.name,
                units.quantity(e.before, e.unit, 4),
                units.quantity(e.value, e.unit, 4),
                units.quantity(e.half, e.unit, 2),
            )
            for e in done.entries
        ]
        print_table("Calibration", ("entry", "before", "found", "+- 95 %"), rows)
        for note in done.notes:
            say(f"note: {note}")
        say(f"Machine with these values: {output}")
    if failure is not None:
        raise failure
