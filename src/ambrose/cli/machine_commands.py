"""`ambrose convert`."""

from __future__ import annotations

import sys
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from ambrose.terminal import (
    AS_JSON,
    MACHINE,
    claim,
    load,
    narrowed,
    print_table,
    progress_shown,
    say,
    say_json,
    say_verdict,
    say_whole,
)

if TYPE_CHECKING:
    from ambrose.judge.result import Synthesis
    from ambrose.machine.machine import Machine


# `ambrose machines` and `ambrose check`.


@click.command()
@AS_JSON
def machines(as_json: bool) -> None:
    """List the bundled machines."""
    from ambrose.machine.file.toml import bundled_machines, load_machine

    descriptions = {name: load_machine(name).description for name in bundled_machines()}
    if as_json:
        say_json(descriptions)
        return
    print_table("Bundled machines", ("name", "what it is"), list(descriptions.items()))


@click.command()
@click.argument("name", required=False)
@AS_JSON
def scenarios(name: str | None, as_json: bool) -> None:
    """List the bundled scenarios, or print the file of the one called NAME, to copy and change."""
    from ambrose.rig.scenario import bundled_scenarios, scenario_text

    known = bundled_scenarios()
    if name is not None:
        text = scenario_text(name)
        if as_json:
            say_json({"name": name, "text": text})
        else:
            say_whole(text)
        return
    if as_json:
        say_json(known)
    else:
        print_table("Bundled scenarios", ("name", "what is done"), list(known.items()))


@click.command()
@MACHINE
@AS_JSON
def check(machine: str, as_json: bool) -> None:
    """Validate a machine file and print its properties: mass, load capacity, bending,
    poles, critical speeds.

    What is implausible (a length without its unit, a magnet that cannot lift, a gain below k_s/k_i)
    is said with its remedy, and the exit status is 1.
    """
    from ambrose.chain.check import facts, rows_of

    known = facts(load(machine, magnets=False, part=False), machine, narrowed())
    if as_json:
        say_json(known)
    else:
        title = ": ".join(text for text in (known["machine"], known["description"]) if text)
        doubts = len(known["doubts"])
        say_verdict(
            f"IMPLAUSIBLE: {doubts} {'entry' if doubts == 1 else 'entries'} of the machine file."
            if doubts
            else "PASSED: no entry of the machine file is implausible."
        )
        print_table(title, ("quantity", "value"), rows_of(known))
        for doubt in known["doubts"]:
            say(f"implausible: {doubt}")
        for remark in known["remarks"]:
            say(f"note: {remark}")
    sys.exit(1 if known["doubts"] else 0)


# `ambrose new`.


_SHAFT = ("length", "diameter", "speed")


@click.command()
@click.argument("file", type=click.Path(path_type=Path))
@click.option("--length", help='Length of the shaft, such as "600 mm".')
@click.option("--diameter", help='Diameter of the shaft, such as "40 mm".')
@click.option(
    "--speed", help='Maximum speed, such as "12000 rpm"; 0 for a rotor that does not turn.'
)
@click.option(
    "--disc",
    "discs",
    multiple=True,
    metavar="POSITION,MASS,DIAMETER",
    help='A disc, such as "300 mm, 8 kg, 250 mm"; repeatable.',
)
@click.option(
    "--bearings",
    help='Positions from the left end, such as "75 mm, 525 mm"; default: two, near the ends.',
)
@click.option(
    "--sensors",
    help='Positions of the sensors, one for each bearing, such as "60 mm, 540 mm"; default: beside '
    "the bearings, where bending modes move as at the magnet.",
)
@click.option(
    "--vertical",
    is_flag=True,
    help="The rotor is vertical; default: horizontal, its weight loads the bearings.",
)
@click.option(
    "--load",
    help='Force that a bearing must reach, such as "400 N"; default: three times its share of the '
    "weight.",
)
@click.option("--gap", help="Radial gap of the magnets; default: from the shaft's diameter.")
@click.option(
    "--bias-current", help='Bias current of the magnets, such as "3 A"; default: from their force.'
)
@click.option(
    "--force-per-current",
    help='k_i, such as "180 N/A"; default: from the geometry of a magnet with that force.',
)
@click.option("--negative-stiffness", help='k_s, such as "0.7 N/um"; default: from the geometry.')
@click.option(
    "--rate-hz",
    type=float,
    help="Sample rate of the controller; default: 10000, or more for fast rotors.",
)
@click.option("--name", help="Name of the machine; default: the file's name.")
@click.option("--force", is_flag=True, help="Replace an existing file.")
@AS_JSON
def new(file: Path, force: bool, as_json: bool, **answers: Any) -> None:
    """Write a machine file to start from. Values that are not given are asked for on a terminal,
    or chosen so that the rotor levitates.

    Every number has its unit and a comment; chosen values are marked as assumed, with the reason.
    Then: ambrose check FILE.
    """
    from ambrose.chain.new_machine import NOT_HELD, new_machine
    from ambrose.core.checks import InvalidInput, invalid
    from ambrose.machine.file.update import save_machine

    if file.suffix.lower() != ".toml":
        raise invalid(
            "the machine file", f'"{file}"', "a file *.toml", f'write "{file.with_suffix(".toml")}"'
        )
    if file.exists() and not force:
        raise InvalidInput(
            f"{file} exists already; choose another name, or replace it with --force"
        )
    claim(machine_file=file)
    missing = [key for key in _SHAFT if answers[key] is None]
    if (missing and as_json) or (missing and not (sys.stdin.isatty() and sys.stderr.isatty())):
        options = ", ".join(f"--{key}" for key in missing)
        raise InvalidInput(
            f"{options} missing, and there is no terminal to ask on; give them, such as "
            f"--{missing[0]} {_EXAMPLES[missing[0]]}"
        )
    if missing:
        answers = _asked(answers)
    rate = answers.pop("rate_hz")
    discs = answers.pop("discs")
    bearings, sensors = answers.pop("bearings"), answers.pop("sensors")
    machine = new_machine(
        name=answers.pop("name") or file.stem.strip() or "my machine",
        discs=[_split(disc, "--disc", "position, mass, diameter", 3) for disc in discs],
        bearings=_split(bearings, "--bearings", "positions", None) if bearings else (),
        sensors=_split(sensors, "--sensors", "positions", None) if sensors else (),
        rate=rate,
        **{key: _united(key, value) for key, value in answers.items()},
    )
    save_machine(machine, file)
    reasons = dict(machine.assumed)
    holds_shaft = NOT_HELD not in reasons["controller"]
    if as_json:
        say_json(
            {"machine": str(file), "axes": machine.axes, "held": holds_shaft, "assumed": reasons}
        )
        sys.exit(0 if holds_shaft else 1)
    say(
        f"{file}: {len(machine.bearings)} bearings of {machine.bearings[0].max_force:g} N; "
        f"{reasons['controller']}"
    )
    say(
        f"{len(reasons)} entries are assumed, each with its reason in the file; "
        f"next: ambrose check {file}"
    )
    sys.exit(0 if holds_shaft else 1)


_LISTS = ('"300 mm, 8 kg, 250 mm"', '"75 mm, 525 mm"')
_EXAMPLES = {"length": '"600 mm"', "diameter": '"40 mm"', "speed": '"12000 rpm"'}
_QUESTIONS = (
    ("length", "Length of the shaft", "600 mm"),
    ("diameter", "Diameter of the shaft", "40 mm"),
    ("speed", "Highest speed", "12000 rpm"),
)


def _asked(given: dict[str, Any]) -> dict[str, Any]:
    """What is given and what the user answers; a wrong answer is asked again."""

    def ask(text: str, default: str, read: Callable[[str], Any]) -> str:
        def checked(answer: str) -> str:
            try:
                read(answer.strip())
            except ValueError as error:  # every refusal is one
                raise click.BadParameter(str(error)) from None
            return answer.strip()

        return str(click.prompt(text, default=default, value_proc=checked, err=True))

    answers = dict(given)
    for key, text, example in _QUESTIONS:
        if given[key] is None:
            answers[key] = ask(text, example, partial(_checked, key))
    discs = list(given["discs"])
    while not given["discs"]:
        wanted = "Disc: position, mass, diameter (empty: no more)"
        answer = ask(
            wanted,
            "",
            lambda answer: answer and _split(answer, "disc", "position, mass, diameter", 3),
        )
        if not answer:
            break
        discs.append(answer)
    if not given["vertical"]:
        answers["vertical"] = click.confirm("Is the rotor vertical", default=False, err=True)
    return {**answers, "discs": discs}


def _checked(key: str, answer: str) -> None:
    from ambrose.chain.new_machine import quantity_of

    quantity_of(key, _united(key, answer))


def _split(text: str, what: str, parts: str, count: int | None) -> list[str]:
    from ambrose.core.checks import invalid

    values = [_united(what, part.strip()) for part in text.split(",")]
    if (count is not None and len(values) != count) or not all(values):
        raise invalid(
            what, f'"{text}"', f"{parts}, separated by commas", f"such as {_LISTS[count is None]}"
        )
    return values


def _united(key: str, value: Any) -> Any:
    """A text with a unit; a bare number is refused, as nobody can tell metres from millimetres. 0
    needs none.
    """
    from ambrose.core.checks import InvalidInput

    if not isinstance(value, str):
        return value
    try:
        number = float(value)
    except ValueError:
        return value
    if number == 0:
        return 0.0
    raise InvalidInput(
        f'{key} is "{value}" without a unit; write it with one, such as '
        f"{_EXAMPLES.get(key, _EXAMPLES['length'])}"
    )


# `ambrose convert controller`.


# core/sampling.py, which is not imported for --help
METHODS = ("tustin", "zoh", "backward-euler", "matched")


@click.command()
@click.argument("source", type=click.Path(path_type=Path))
@click.option(
    "--machine", help="Machine of the controller: axes, signs and units are checked on its loop."
)
@click.option(
    "--axes",
    help='Names of the channels in order, such as "A_zeta,A_eta"; default: the file\'s, else '
    "the machine's.",
)
@click.option(
    "--input",
    "given",
    type=click.Choice(["error", "displacement"]),
    help="Controller input: the error r - y (default), or the displacement y (its sign is then "
    "changed).",
)
@click.option(
    "--input-unit", help="Unit of the controller's input, such as um; default: the file's, else m."
)
@click.option(
    "--output-unit", help="Unit of the output currents, such as mA; default: the file's, else A."
)
@click.option(
    "--feedback",
    type=click.Choice(["subtracted", "added"]),
    help="How a1 and a2 enter the sum that gives the output: subtracted (default), or added, as "
    "CMSIS-DSP and SigmaDSP have it.",
)
@click.option(
    "--rate-hz",
    type=float,
    help="Sample rate of coefficients of z if the file has none; with --sampling the new rate.",
)
@click.option(
    "--delay-samples",
    type=int,
    help="Loop delay, from measured errors to currents set; default: the file's.",
)
@click.option(
    "--sampling",
    type=click.Choice(METHODS),
    help="Method to sample a continuous controller at --rate-hz.",
)
@click.option(
    "--prewarp-hz",
    type=float,
    help="tustin: exact at this frequency; matched: same gain as the continuous controller at "
    "this frequency.",
)
@click.option(
    "-o",
    "--output",
    type=click.Path(path_type=Path),
    default=Path("controller.json"),
    show_default=True,
)
@AS_JSON
def convert_controller(
    source: Path, machine: str | None, output: Path, as_json: bool, **asked: Any
) -> None:
    """Write a controller of another program as a controller file, for verify, simulate, identify
    and export.

    SOURCE contains difference equations (b, a), second-order sections, or zeros, poles and gain per
    channel (*.csv, *.json, *.mat), transfer-function or state-space matrices (*.json, *.mat), or is
    a controller file. With --machine the loop is closed around the full plant at every operating
    point: exit status 1 where it is unstable, with the sign or unit that would stabilise it.
    """
    write_imported(source, machine, output, as_json, **asked)


def write_imported(
    source: Path,
    machine: str | None,
    output: Path,
    as_json: bool,
    *,
    sampling: str | None = None,
    prewarp_hz: float | None = None,
    given: str | None = None,
    rate_hz: float | None = None,
    axes: str | None = None,
    **stated: Any,
) -> None:
    """What the command does; also `ambrose convert SOURCE -o NAME.json`."""
    from ambrose.code.sampled import instability
    from ambrose.core.checks import InvalidInput
    from ambrose.judge.controller_file import read_controller, write_controller
    from ambrose.law.filter_table import check_channels
    from ambrose.synthesis.design import not_held, resampled

    known = None if machine is None else load(machine)
    claim(controller_file=output)
    stated |= {"input": given, "axes": axes, "rate_hz": None if sampling else rate_hz}
    law = read_controller(source, known, **stated)
    if known is None:
        check_channels(law.controller)
    if sampling is not None:
        law = resampled(law, rate_hz, sampling, prewarp_hz)
    elif prewarp_hz is not None:
        raise InvalidInput(
            "--prewarp-hz goes with --sampling tustin or matched; name it, or leave it out"
        )

    def other() -> Synthesis:
        with suppress(InvalidInput):  # where the file states it
            return read_controller(source, known, **{**stated, "feedback": "added"})
        return law

    wrong, lost = instability(law.controller), list[str]()
    if known is not None:
        with progress_shown(as_json) as progress:
            lost = not_held(known, law, progress, other)
    write_controller(output, law, known)
    kind = (
        "continuous" if law.controller.dt is None else f"sampled at {1 / law.controller.dt:.6g} Hz"
    )
    verified = None if known is None else not lost
    summary = {
        "controller": str(output),
        "inputs": law.controller.inputs,
        "states": law.controller.n_states,
        "kind": kind,
        "held": verified,
        "problems": [*wrong, *lost],
    }
    where = f"; it holds {known.name} at every operating point" if known and verified else ""
    text = (
        f"{output}: {law.controller.n_states} states, {kind}, from "
        f"{', '.join(law.controller.inputs)}{where}"
    )
    if as_json:
        say_json(summary)
    else:
        for line in (text, *lost):
            say(line)
    for problem in wrong:
        say(f"careful: {problem}", err=True)
    sys.exit(1 if verified is False else 0)


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
@click.option("--vertical", is_flag=True, help="The rotor model is of a vertical rotor.")
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

    A map with [[path]] makes frequency responses of an analyser's file: see `ambrose identify`.

    As a controller file (*.json): a controller of another program, as `ambrose convert controller`
    does with its options.

    As a machine file (*.toml): a rotor model of ROSS (*.toml, *.json) or a table of stations
    (*.csv, *.xlsx), on magnets chosen as `ambrose new` does; a machine file, or a bundled machine's
    name, becomes a model of ROSS.

    As a table of stations (*.csv, *.xlsx): the rotor of a machine or of such a model.
    """
    from ambrose.machine.file.toml import bundled_machines
    from ambrose.record.files import check_suffix, read_record, write_record
    from ambrose.record.foreign import read_foreign
    from ambrose.record.response_files import (
        holds_responses,
        maps_responses,
        read_response,
        write_response,
    )

    if output.suffix == ".json":
        write_imported(record, None, output, as_json)
    if output.suffix.lower() == ".toml":
        _convert_machine(record, output, speed, bearings, vertical, as_json)
        return
    rotor = record.suffix.lower() in {".toml", ".xlsx"} or str(record) in bundled_machines()
    if output.suffix.lower() == ".xlsx" or (output.suffix.lower() == ".csv" and rotor):
        _convert_to_stations(record, output, as_json)
        return
    check_suffix(output)
    claim(record=output)
    if holds_responses(record) if columns is None else maps_responses(columns):
        responses = read_response(record, columns)
        write_response(responses, output)
        facts = {"responses": str(output), **responses.facts()}
        names = ", ".join(path.name for path in responses.paths[:8])
        words = f"{output}: {len(responses.paths)} responses at {len(responses.omega)} frequencies"
        say_json(facts) if as_json else say(f"{words} ({names})")
        return
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
        f"{output}: {count / rate:.6g} s at {rate:.6g} Hz, {len(result.signals)} signal"
        f"{'s' * (len(result.signals) > 1)} ({signals})"
    )
    say_json(summary) if as_json else say(words)


def _left_out(machine: Machine) -> list[str]:
    """What of a machine the models and tables of its rotor do not hold."""
    left = [*(seal.name for seal in machine.seals), *(part.name for part in machine.attached)]
    left += [f"support of {item.bearing}" for item in machine.supports]
    left += [f"{len(machine.casing_modes)} casing modes"] * bool(machine.casing_modes)
    left += [f"{len(machine.bending_modes)} measured bending modes"] * bool(machine.bending_modes)
    return left


def _convert_to_stations(source: Path, output: Path, as_json: bool) -> None:
    from ambrose.chain.new_machine import is_machine
    from ambrose.core.checks import InvalidInput
    from ambrose.machine.attachment import stations
    from ambrose.machine.file.ross import off_nodes
    from ambrose.machine.file.stations import read_rotor, write_stations
    from ambrose.machine.file.toml import load_machine
    from ambrose.machine.part import RotorModel

    if output.exists():
        raise InvalidInput(
            f"{output} exists already; choose another name with -o, or remove the file"
        )
    machine = load_machine(source) if is_machine(source) else None
    rotor = (
        read_rotor(source)
        if machine is None
        else RotorModel(
            machine.name,
            machine.shaft,
            machine.discs,
            tuple(bearing.position for bearing in machine.bearings),
            beam_theory=machine.beam_theory,
        )
    )
    left = [*rotor.left_out]
    if machine is not None:
        left += ["magnets, sensors and controller", *_left_out(machine)]
    moved = {} if machine is None else off_nodes(machine)
    left += [f"{1e6 * away:.3g} um of the place of {name}" for name, away in moved.items()]
    if rotor.beam_theory != "timoshenko":
        left.append(f"beam theory {rotor.beam_theory} (a table is read as timoshenko)")
    claim(table_of_stations=output)
    count = write_stations(output, rotor, () if machine is None else stations(machine))
    summary = {"stations": str(output), "rows": count, "left_out": left}
    words = f"{output}: {count} stations; left out: {', '.join(left) or 'nothing'}"
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
        is_machine,
        machine_of_rotor,
        rotor_with,
    )
    from ambrose.core.checks import InvalidInput
    from ambrose.machine.file.ross import off_nodes, ross_text
    from ambrose.machine.file.toml import load_machine
    from ambrose.machine.file.update import save_machine
    from ambrose.machine.ordinary_file import write_text

    if is_machine(source):
        machine = load_machine(source)
        claim(rotor_model=output)
        write_text(output, ross_text(machine, springs(machine)), "rotor model")
        left, moved = _left_out(machine), off_nodes(machine)
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
                f"{output} is the input file; give the machine file another name with -o"
            )
        if output.exists():
            raise InvalidInput(
                f"{output} exists already; choose another name with -o, or remove the file"
            )
        rotor = rotor_with(source, speed, bearings)
        claim(machine_file=output)
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
