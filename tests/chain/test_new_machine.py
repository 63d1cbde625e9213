"""A machine out of a few numbers, or of a rotor: it levitates, says what was chosen, and reads as a
file for people.
"""

import json
import re
import sys
from pathlib import Path

import click
import numpy as np
import pytest
from click.testing import CliRunner

import ambrose as amb
from ambrose.cli import main
from ambrose.machine.file.toml import loads_machine
from ambrose.machine.file.update import annotated_machine, machine_text

RIG = {
    "length": "600 mm",
    "diameter": "40 mm",
    "speed": "12000 rpm",
    "discs": [("300 mm", "8 kg", "200 mm")],
}
OPTIONS = ("--length", "600 mm", "--diameter", "40 mm", "--speed", "0 rpm")


def call(*arguments, **more):
    return CliRunner().invoke(main, [str(argument) for argument in arguments], **more)


@pytest.fixture(scope="module")
def rig():
    return amb.new_machine("rig", **RIG)


def holds(machine):
    """The reference controller's largest abscissa over all points, as it runs on the full
    plants.
    """
    return max(amb.design(machine, "pid").certificate.envelope.values())


def test_it_has_all_that_a_machine_needs_and_its_pid_holds_it(rig):
    assert holds(rig) < 0
    assert [point.label for point in rig.operation.points] == ["top speed", "standstill"]
    assert rig.operation.speed_range[1] == pytest.approx(2 * np.pi * 200)
    assert (
        rig.weights is not None
        and rig.requirements.sensitivity_peak == 3.0
        and rig.gravity_direction == -np.pi / 2
    )
    reasons = dict(rig.assumed)
    assert {
        "bearing.geometry",
        "bearing.gap",
        "sensor.position",
        "amplifier.bandwidth",
        "controller",
        "weights",
    } <= set(reasons)
    assert "bearing.position" in reasons and "shaft" not in reasons


def test_its_file_has_units_and_comments_and_reads_back(rig):
    text = machine_text(rig)
    assert text == rig.file_text and loads_machine(text) == rig
    numbers = [
        line
        for line in text.splitlines()
        if re.match(r"(length|outer_diameter|position|mass|gain|bandwidth) = ", line)
    ]
    assert len(numbers) >= 8 and all(re.match(r'\w+ = "[-\d.e]+ [^"]+"', line) for line in numbers)
    assert (
        'outer_diameter = "40 mm" ' in text
        and "# outer diameter" in text
        and "# assumed: nominal radial air gap" in text
    )


def test_every_machine_can_be_written_so():
    for name in amb.bundled_machines():
        machine = amb.load_machine(name)
        assert loads_machine(annotated_machine(machine, "two\nlines")) == machine


def test_what_is_known_is_kept_and_not_called_assumed():
    machine = amb.new_machine(
        "m",
        **{**RIG, "speed": 0},
        force_per_current="180 N/A",
        negative_stiffness="0.7 N/um",
        gap="0.5 mm",
    )
    bearing = machine.bearings[0]
    assert (bearing.force_per_current, bearing.negative_stiffness, bearing.gap) == (
        (180.0,) * 2,
        (7e5,) * 2,
        5e-4,
    )
    assert bearing.geometry is None and not {"bearing.gap", "bearing.geometry"} & set(
        dict(machine.assumed)
    )
    assert bearing.bias_current == pytest.approx(7e5 * 5e-4 / 180, rel=0.03)
    assert [point.label for point in machine.operation.points] == ["standstill"]


@pytest.mark.parametrize(
    "numbers",
    [
        {"length": "80 mm", "diameter": "8 mm", "speed": "90000 rpm"},  # a tiny spindle
        pytest.param(
            {"length": "1.2 m", "diameter": "100 mm", "speed": "6000 rpm", "vertical": True},
        ),
        pytest.param(
            {
                "length": "3 m",
                "diameter": "100 mm",
                "speed": "4000 rpm",
                "bearings": ["0.3 m", "1.5 m", "2.7 m"],
            },
        ),
    ],
)
def test_rotors_of_all_kinds_are_held(numbers):
    machine = amb.new_machine("m", **numbers)
    assert holds(machine) < 0
    assert (machine.gravity_direction is None) == bool(numbers.get("vertical"))


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ({"length": float("nan")}, "length is nan, but must be finite"),
        ({"length": "600"}, "without a unit"),
        ({"length": -1}, "must be positive"),
        ({"diameter": "40 kg"}, "must be a length"),
        ({"diameter": "1 um"}, "at most 100; check the units"),
        ({"speed": -5}, "zero or positive"),
        ({"discs": [("700 mm", "1 kg", "10 mm")]}, "on the shaft"),
        ({"discs": [("300 mm", "0 kg", "10 mm")]}, "mass of disc 1 is 0"),
        ({"discs": [("300 mm", "1 kg")]}, "position, mass and diameter"),
        ({"bearings": ["1 m"]}, "on the shaft"),
        ({"bearings": ["0.3 m", "300 mm"]}, "apart from each other"),
        ({"rate": 0}, "rate is 0"),
        ({"gap": 0}, "gap is 0"),
        ({"weight": "3 kg"}, "has no option 'weight'"),
    ],
)
def test_hostile_numbers_are_refused_in_one_sentence(wrong, words):
    with pytest.raises(amb.InvalidInput, match=words) as error:
        amb.new_machine("m", **{**RIG, **wrong})
    assert "\n" not in str(error.value)


def test_the_command_writes_a_file_once(tmp_path):
    path = tmp_path / "my machine.toml"
    first = call("new", path, *OPTIONS, "--json")
    told = json.loads(first.output)
    assert (
        first.exit_code == 0
        and told["held"]
        and told["axes"] == ["A_zeta", "A_eta", "B_zeta", "B_eta"]
    )
    written = path.read_text(encoding="utf-8")
    assert 'name = "my machine"' in written
    again = call("new", path, *OPTIONS)
    assert (
        again.exit_code == 2
        and "exists already; choose another name, or replace it with --force" in again.output
    )
    assert path.read_text(encoding="utf-8") == written
    assert call("check", path).exit_code == 0


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("m.toml",), "--length, --diameter, --speed missing, and there is no terminal to ask on"),
        (("m.toml", "--length", "1 m"), "--diameter, --speed missing"),
        (("m.txt", *OPTIONS), 'must be a file *.toml; write "'),
        (("m.toml", *OPTIONS, "--length", "600"), 'length is "600" without a unit'),
        (("m.toml", *OPTIONS, "--disc", "300 mm"), "position, mass, diameter, separated by commas"),
        (("m.toml", *OPTIONS, "--bearings", "70, 500"), "without a unit"),
    ],
)
def test_the_command_refuses(tmp_path, arguments, words):
    result = call("new", tmp_path / arguments[0], *arguments[1:])
    assert result.exit_code == 2 and words in result.output and not list(tmp_path.iterdir())


class Terminal:
    """A stream that says it is a terminal."""

    def __init__(self, stream):
        self._stream = stream

    def isatty(self):
        return True

    def __getattr__(self, name):
        return getattr(self._stream, name)


@pytest.fixture
def terminal(monkeypatch):
    class Streams:
        stdin = Terminal(None)
        stderr = Terminal(None)
        exit = staticmethod(sys.exit)

    monkeypatch.setattr(sys.modules["ambrose.cli.machine_commands"], "sys", Streams)


def test_on_a_terminal_it_asks_and_asks_again(tmp_path, terminal):
    answers = "\n40\n40 mm\n0 rpm\n300 mm, 8 kg\n300 mm, 8 kg, 200 mm\n\ny\n"
    result = call("new", tmp_path / "m.toml", input=answers)
    assert result.exit_code == 0, result.output
    assert '"40" without a unit' in result.output and "separated by commas" in result.output
    machine = amb.load_machine(tmp_path / "m.toml")
    assert (
        machine.length == 0.6 and machine.discs[0].mass == 8.0 and machine.gravity_direction is None
    )


def test_interrupted_questions_leave_nothing(tmp_path, terminal, monkeypatch):
    def interrupted(*_, **__):
        raise click.Abort

    monkeypatch.setattr(click, "prompt", interrupted)
    result = call("new", tmp_path / "m.toml")
    assert result.exit_code == 130 and not list(tmp_path.glob("*.toml"))


def test_rotor_files_become_machines_and_machines_models_of_ross(tmp_path):
    table = tmp_path / "rotor.csv"
    table.write_text(
        "length [mm];od [mm];bearing;disc mass [kg];disc Ip [kg m^2];disc Id [kg m^2]\n"
        "75;40;;;;\n225;40;x;;;\n225;40;;8;0,04;0,02\n75;40;x;;;\n",
        encoding="utf-8",
    )
    made = call("convert", table, "-o", tmp_path / "rotor.toml", "--speed", "6000 rpm", "--json")
    assert made.exit_code == 0, made.output
    machine = amb.load_machine(tmp_path / "rotor.toml")
    assert [bearing.position for bearing in machine.bearings] == pytest.approx([0.075, 0.525])
    assert json.loads(made.output)["assumed"] == dict(
        machine.assumed
    ) and "bearing.position" not in dict(machine.assumed)
    assert (
        machine.operation.speed_range[1] == pytest.approx(2 * np.pi * 100)
        and "rotor.csv" in machine.source
    )
    again = call("convert", table, "-o", tmp_path / "rotor.toml")
    assert again.exit_code == 2 and "exists already; choose another name" in again.output
    back = call("convert", tmp_path / "rotor.toml", "-o", tmp_path / "ross.toml")
    assert back.exit_code == 0 and "DiskElement_disc1" in (tmp_path / "ross.toml").read_text(
        encoding="utf-8"
    )
    bundled = call("convert", "seal-rig", "-o", tmp_path / "seal.toml")
    assert bundled.exit_code == 0 and "left out: center, coupling" in bundled.output
    same = call("convert", tmp_path / "ross.toml", "-o", tmp_path / "ross.toml")
    assert same.exit_code == 2 and "give the machine file another name" in same.output


@pytest.mark.study
def test_from_nothing_to_a_levitating_rig(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for line in (
        (
            "new",
            "my-machine.toml",
            *OPTIONS[:4],
            "--speed",
            "12000 rpm",
            "--disc",
            "300 mm, 8 kg, 200 mm",
        ),
        ("check", "my-machine.toml"),
        ("synthesize", "my-machine.toml", "-o", "controller.json"),
        (
            "simulate",
            "my-machine.toml",
            "--controller",
            "controller.json",
            "--scenario",
            "levitation",
        ),
    ):
        result = call(*line)
        assert result.exit_code == 0, result.output
    assert "completed" in result.output and Path("record.h5").exists()


def test_rounded_inertias_of_a_disc_are_those_of_a_body():
    """Each was rounded by itself, and the polar one came out above twice the diametral one, which
    no body has.
    """
    discs = [("350 mm", "9 kg", "220 mm"), ("300 mm", "7 kg", "230 mm")]
    machine = amb.new_machine(length="700 mm", diameter="40 mm", speed="3000 rpm", discs=discs)
    assert all(disc.polar_inertia == 2 * disc.diametral_inertia for disc in machine.discs)
