"""`ambrose convert`."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import click

from ambrose.cli.convert_controller import write_imported
from ambrose.terminal import AS_JSON, claim, say, say_json


@click.command()
@click.argument("record", type=click.Path(path_type=Path))
@click.option(
    "--columns",
    type=click.Path(path_type=Path),
    help="Column map (*.toml), for files of other programs.",
)
@click.option(
    "--speed",
    help='Of a rotor model: the highest, such as "9000 rpm"; default: the model\'s, or standstill.',
)
@click.option(
    "--bearings", help='Of a rotor model: places of its magnets, such as "75 mm, 525 mm".'
)
@click.option("--vertical", is_flag=True, help="Of a rotor model: it stands.")
@click.option(
    "-o", "--output", type=click.Path(path_type=Path), default=Path("record.h5"), show_default=True
)
@AS_JSON
def convert(
    record: Path,
    columns: Path | None,
    speed: str | None,
    bearings: str | None,
    vertical: bool,
    output: Path,
    as_json: bool,
) -> None:
    """Write what another program wrote as a file of this one, by the suffix of the output.

    As a record (*.h5, *.csv): a record; with a column map a file of MATLAB (*.mat) or LabVIEW
    (*.tdms), any HDF5 (*.h5), a universal file (*.uff or *.unv) or a text table of any separator
    and decimal mark (*.csv, *.txt).

    As a controller file (*.json): a controller of another program, as `ambrose convert controller`
    does with its options.

    As a machine file (*.toml): a rotor model of ROSS (*.toml, *.json) or a table of stations
    (*.csv), on magnets chosen as `ambrose new` does; a machine file, or a bundled machine's name,
    becomes a model of ROSS.
    """
    from ambrose.record.files import check_suffix, read_record, write_record
    from ambrose.record.foreign import read_foreign

    if output.suffix == ".json":
        write_imported(record, None, output, as_json)
    if output.suffix.lower() == ".toml":
        _convert_machine(record, output, speed, bearings, vertical, as_json)
        return
    check_suffix(output)
    claim(record=output)
    result = read_record(record) if columns is None else read_foreign(record, columns)
    write_record(result, output)
    count, rate = result.values.shape[1], result.sample_rate_hz
    summary = {
        "record": str(output),
        "signals": result.signals,
        "samples": count,
        "sample_rate_hz": rate,
    }
    signals = f"{', '.join(result.signals[:8])}{' ...' if len(result.signals) > 8 else ''}"
    words = (
        f"{output}: {count / rate:.6g} s at {rate:.6g} Hz, {len(result.signals)} signals "
        f"({signals})"
    )
    say_json(summary) if as_json else say(words)


def _convert_machine(
    source: Path,
    output: Path,
    speed: str | None,
    bearings: str | None,
    vertical: bool,
    as_json: bool,
) -> None:
    from ambrose.chain.check import springs
    from ambrose.chain.new_machine import (
        NOT_HELD,
        Known,
        machine_of_rotor,
        quantities_of,
        quantity_of,
    )
    from ambrose.core.checks import InvalidInput
    from ambrose.machine.atomic_write import write_text
    from ambrose.machine.file.ross import off_nodes, ross_text
    from ambrose.machine.file.stations import read_rotor
    from ambrose.machine.file.toml import bundled_machines, load_machine, read_toml
    from ambrose.machine.file.update import save_machine

    own = (
        source.suffix.lower() == ".toml"
        and str(source) not in bundled_machines()
        and "machine" in read_toml(source, "file")
    )
    if own or str(source) in bundled_machines():
        machine = load_machine(source)
        claim(rotor_model=output)
        write_text(output, ross_text(machine, springs(machine)), "rotor model")
        left = [*(seal.name for seal in machine.seals), *(part.name for part in machine.attached)]
        left += [f"support of {item.bearing}" for item in machine.supports]
        left += [f"{len(machine.casing_modes)} casing modes"] * bool(machine.casing_modes)
        left += [f"{len(machine.bending_modes)} measured bending modes"] * bool(
            machine.bending_modes
        )
        moved = off_nodes(machine)
        summary: dict[str, object] = {
            "rotor_model": str(output),
            "left_out": left,
            "moved_m": moved,
        }
        springy = "a model of ROSS, bearings as springs of the reference controller"
        words = f"{output}: {springy}; left out: {', '.join(left) or 'nothing'}"
        words += "".join(
            f"; {name} moved by {1e6 * away:.3g} um to a node" for name, away in moved.items()
        )
    else:
        if output.exists() and output.samefile(source):
            raise InvalidInput(
                f"{output} is what is read; give the machine file another name with -o"
            )
        if output.exists():
            raise InvalidInput(
                f"{output} exists already; choose another name with -o, or remove the machine "
                "that stands there"
            )
        rotor = read_rotor(source)
        claim(machine_file=output)
        rotor = replace(
            rotor,
            speed=rotor.speed if speed is None else quantity_of("speed", speed),
            bearings=rotor.bearings if bearings is None else quantities_of("bearings", bearings),
        )
        machine = machine_of_rotor(rotor, Known(vertical=vertical))
        save_machine(machine, output)
        reasons = dict(machine.assumed)
        summary = {
            "machine": str(output),
            "axes": machine.axes,
            "assumed": reasons,
            "left_out": rotor.left_out,
        }
        counts = (
            f"{len(machine.shaft)} sections, {len(machine.discs)} discs, {len(machine.bearings)} "
            "bearings"
        )
        words = f"{output}: {counts}; {reasons['controller']}"
        if rotor.left_out:
            words += (
                "; left out: "
                f"{', '.join(rotor.left_out[:6])}{' ...' if len(rotor.left_out) > 6 else ''}"
            )
    say_json(summary) if as_json else say(words)
    sys.exit(1 if NOT_HELD in words else 0)
