"""`ambrose convert`."""

from __future__ import annotations

from pathlib import Path

import click

from ambrose.cli.terminal import AS_JSON, claim, say, say_json


@click.command()
@click.argument("record", type=click.Path(path_type=Path))
@click.option("--columns", type=click.Path(path_type=Path), help="Column map (*.toml), for files of MATLAB and LabVIEW.")
@click.option("-o", "--output", type=click.Path(path_type=Path), default=Path("record.h5"), show_default=True)
@AS_JSON
def convert(record: Path, columns: Path | None, output: Path, as_json: bool) -> None:
    """Write a record (*.h5, *.csv), or a file of MATLAB (*.mat) or LabVIEW (*.tdms), as a record (*.h5 or *.csv); a table of
    filters (*.csv, *.json) as a controller file (*.json)."""
    from ambrose.deployment.discretisation.deployment import instability
    from ambrose.machine.record.files import check_suffix, read_record, write_record
    from ambrose.machine.record.foreign import read_foreign
    from ambrose.synthesis.controller_file import read_controller, write_controller

    if output.suffix == ".json":
        claim(controller_file=output)
        law = read_controller(record)
        write_controller(output, law)
        kind = "continuous" if law.controller.dt is None else f"sampled at {1 / law.controller.dt:.6g} Hz"
        wrong = instability(law.controller)
        told = {
            "controller": str(output), "inputs": law.controller.inputs, "states": law.controller.n_states, "kind": kind,
            "problems": wrong,
        }  # fmt: skip
        text = f"{output}: {law.controller.n_states} states, {kind}, from {', '.join(law.controller.inputs)}"
        say_json(told) if as_json else say(text)
        for problem in wrong:
            say(f"careful: {problem}", err=True)
        return
    check_suffix(output)
    claim(record=output)
    result = read_record(record) if columns is None else read_foreign(record, columns)
    write_record(result, output)
    count, rate = result.values.shape[1], result.sample_rate_hz
    summary = {"record": str(output), "signals": result.signals, "samples": count, "sample_rate_hz": rate}
    signals = f"{', '.join(result.signals[:8])}{' ...' if len(result.signals) > 8 else ''}"
    words = f"{output}: {count / rate:.6g} s at {rate:.6g} Hz, {len(result.signals)} signals ({signals})"
    say_json(summary) if as_json else say(words)
