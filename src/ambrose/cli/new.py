"""`ambrose new`."""

from __future__ import annotations

import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import click

from ambrose.terminal import AS_JSON, claim, say, say_json

_SHAFT = ("length", "diameter", "speed")


@click.command()
@click.argument("file", type=click.Path(path_type=Path))
@click.option("--length", help='Of the shaft, such as "600 mm".')
@click.option("--diameter", help='Of the shaft, such as "40 mm".')
@click.option("--speed", help='The highest, such as "12000 rpm"; 0 for a rotor that does not turn.')
@click.option(
    "--disc",
    "discs",
    multiple=True,
    metavar="POSITION,MASS,DIAMETER",
    help='Such as "300 mm, 8 kg, 250 mm"; any number of times.',
)
@click.option(
    "--bearings",
    help='Positions from the left end, such as "75 mm, 525 mm"; default: two, near the ends.',
)
@click.option(
    "--vertical",
    is_flag=True,
    help="The rotor stands; default: it lies, and its weight loads the bearings.",
)
@click.option(
    "--load",
    help='Force that a bearing must reach, such as "400 N"; default: three times its share of the '
    "weight.",
)
@click.option("--gap", help="Radial gap of the magnets; default: by the shaft's diameter.")
@click.option("--bias-current", help='Of the magnets, such as "3 A"; default: by their force.')
@click.option(
    "--force-per-current",
    help='k_i, such as "180 N/A"; default: by the geometry of a magnet of that force.',
)
@click.option("--negative-stiffness", help='k_s, such as "0.7 N/um"; default: by the geometry.')
@click.option(
    "--rate-hz",
    type=float,
    help="Sample rate of the controller; default: 10000, or more for fast rotors.",
)
@click.option("--name", help="What the machine is called; default: the file's name.")
@click.option("--force", is_flag=True, help="Replace a file that exists.")
@AS_JSON
def new(file: Path, force: bool, as_json: bool, **answers: Any) -> None:
    """Write a machine file to start from: what is not given is asked for on a terminal, or chosen
    so that the rotor levitates.

    Every number has its unit and a comment; what was chosen is marked as assumed, with the reason.
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
    bearings = answers.pop("bearings")
    machine = new_machine(
        name=answers.pop("name") or file.stem.strip() or "my machine",
        discs=[_split(disc, "--disc", "position, mass, diameter", 3) for disc in discs],
        bearings=_split(bearings, "--bearings", "positions", None) if bearings else (),
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
        answers["vertical"] = click.confirm("Does the rotor stand upright", default=False, err=True)
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
