"""The default model of H-infinity holds the bending modes that its controller would excite."""

import json
from dataclasses import replace

import pytest
from click.testing import CliRunner

import ambrose as amb
from ambrose.chain.new_machine import new_machine
from ambrose.cli import main
from ambrose.law.design_problem import machine_weights
from ambrose.machine.file.update import save_machine
from ambrose.synthesis.order_selection import modes_that_matter


@pytest.fixture(scope="module")
def compressor():
    """180 kg on 1.5 m, bending at 189, 467, 880 Hz; 10 kHz."""
    made = new_machine(
        length="1500 mm",
        diameter="110 mm",
        speed="11000 rpm",
        discs=[(f"{place} mm", "14 kg", "340 mm") for place in (450, 600, 750, 900, 1050)],
        bearings=("190 mm", "1310 mm"),
    )
    top = made.operation.points[0]
    return replace(made, operation=replace(made.operation, points=(top,), design_point=None))


def test_a_design_without_options_holds_a_flexible_machine(compressor):
    """It came out unstable, with no bending mode in its model, and exit 0 in some of the cases."""
    plant = amb.assemble(compressor)
    rigid = amb.design(plant, "hinf", bending_modes=0)
    assert rigid.status == "unstable"
    made = amb.design(plant, "hinf")
    assert made.status == "verified" and not made.lost
    kept = int(made.certificate.margins["bending_modes"])
    assert kept >= 1

    # the least number: one mode fewer does not hold what the full plant is
    fewer = amb.design(plant, "hinf", bending_modes=kept - 1, match_reference=False)
    peak = fewer.certificate.margins["sampled_sensitivity_peak"]
    assert (
        fewer.status == "unstable"
        or peak > 1.2 * made.certificate.margins["sampled_sensitivity_peak"]
    )


def test_a_stiff_rotor_needs_none():
    machine = amb.load_machine("seal-rig")
    plant, said = amb.assemble(machine), []
    assert modes_that_matter(plant, machine_weights(machine), None, said.append) == 0
    assert said == []


def test_a_lost_point_says_that_one_point_was_designed_for(compressor):
    standstill = amb.OperatingPoint(label="standstill")
    machine = replace(
        compressor,
        operation=replace(compressor.operation, points=(*compressor.operation.points, standstill)),
    )
    made = amb.design(amb.assemble(machine, machine.operation.design), "hinf")
    assert made.lost == ("standstill",) and "unstable at standstill" in made.verdict
    assert "--envelope designs for all" in made.notes[-1]


def test_the_command_says_which_point_holds_all_and_ends_with_1(tmp_path):
    """ "verified at 1 of 3 operating points, unstable at half speed, rest" was exit 0."""
    controller = tmp_path / "c.json"
    words = ["synthesize", "flywheel", "--method", "hinf", "--json", "-o", str(controller)]
    flywheel = amb.load_machine("flywheel")
    weights = amb.load_machine("seal-rig").weights
    assert weights is not None
    path = tmp_path / "flywheel.toml"
    save_machine(replace(flywheel, weights=weights), path)
    words[1] = str(path)
    done = CliRunner().invoke(main, words)
    told = json.loads(done.stdout)
    lost = [label for label, a in told["certificate"]["envelope"].items() if a >= 0]
    assert done.exit_code == 1 and lost == ["half speed", "rest"]
    assert any(note.endswith('--point "half speed"') for note in told["notes"])
    pointed = CliRunner().invoke(main, [*words, "--point", "half speed"])
    assert pointed.exit_code == 0
    assert max(json.loads(pointed.stdout)["certificate"]["envelope"].values()) < 0
