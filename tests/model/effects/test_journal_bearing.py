"""Journal bearings: a table over speed in plant, tolerance and rig, against closed forms."""

from dataclasses import replace

import numpy as np
import pytest
from click.testing import CliRunner

from ambrose.cli import main
from ambrose.core.checks import InvalidInput
from ambrose.core.statespace import poles
from ambrose.machine.description import OperatingPoint, Tolerance
from ambrose.machine.file.toml import dumps_machine, loads_machine
from ambrose.model.assemble import assemble
from ambrose.model.effects.rotor import finite_element_rotor, mass_properties
from ambrose.model.effects.stations import JournalBearing, coefficients
from ambrose.model.uncertainty import free_mode_reduction, perturbed
from ambrose.rig.engine.equilibrium import linear_view, state_at_rest
from ambrose.rig.engine.inputs import plan, stretch
from ambrose.rig.engine.state import build
from ambrose.rig.scenario import Scenario, SpeedChange, Unbalance
from pole_sets import matched

MACHINE = """
[machine]
schema = 1
name = "cylinder"

[[shaft]]
length = "400 mm"
outer_diameter = "60 mm"
elements = 8

[[bearing]]
name = "A"
position = "200 mm"
bias_current = "2 A"
force_per_current = "200 N/A"
negative_stiffness = "0.2 N/um"

[[sensor]]
bearing = "A"
position = "200 mm"

[[journal_bearing]]
name = "left"
position = "100 mm"
speed = ["1000 rpm", "3000 rpm"]
K_xx = ["4 N/um", "6 N/um"]
K_xy = ["1 N/um", "3 N/um"]
K_yx = ["-2 N/um", "-4 N/um"]
K_yy = ["8 N/um", "9 N/um"]
C_xx = ["20 kN s/m", "16 kN s/m"]
C_yy = ["30 kN s/m", "20 kN s/m"]
C_xy = ["-2 kN s/m", "-1 kN s/m"]
[[journal_bearing]]
name = "right"
position = "300 mm"
speed = ["1000 rpm", "3000 rpm"]
K_xx = ["4 N/um", "6 N/um"]
K_xy = ["1 N/um", "3 N/um"]
K_yx = ["-2 N/um", "-4 N/um"]
K_yy = ["8 N/um", "9 N/um"]
C_xx = ["20 kN s/m", "16 kN s/m"]
C_yy = ["30 kN s/m", "20 kN s/m"]
C_xy = ["-2 kN s/m", "-1 kN s/m"]

[amplifier]
order = "none"

[operation]
speed_range = ["1000 rpm", "3000 rpm"]
[[operation.point]]
label = "2000 rpm"
speed = "2000 rpm"
"""
RPM = np.pi / 30
# halfway in the table
K = np.array([[5e6, 2e6], [-3e6, 8.5e6]])
C = np.array([[18e3, -1.5e3], [0.0, 25e3]])


@pytest.fixture(scope="module")
def machine():
    return loads_machine(MACHINE)


def test_table_is_linear_between_its_speeds(machine):
    found = coefficients(machine.effects[0], 2000 * RPM)
    assert np.allclose(found[0], K, rtol=1e-12) and np.allclose(found[1], C, rtol=1e-12)
    constant = JournalBearing("j", 0.1, (1e6,), (2e6,), (1e3,), (2e3,))
    assert np.array_equal(coefficients(constant, 1e4)[0], np.diag([1e6, 2e6]))
    with pytest.raises(InvalidInput, match=r"within its table, 1000 to 3000 rpm"):
        assemble(machine, OperatingPoint(speed=320.0))


def test_bounce_is_that_of_a_mass_on_two_films(machine):
    """m q'' + (2 K - k_s) q + 2 C q' = 0 of a rigid rotor, its bearings alike about its centre."""
    m = mass_properties(finite_element_rotor(machine)).mass
    plant = free_mode_reduction(assemble(machine), 0)
    stiffness = 2 * K - 0.2e6 * np.eye(2)
    A = np.block([[np.zeros((2, 2)), np.eye(2)], [-stiffness / m, -2 * C / m]])
    found = poles(plant.rotor)
    for pole in np.linalg.eigvals(A):
        assert np.abs(found - pole).min() < 1e-8 * abs(pole)


def test_cross_coupling_drives_forward_whirl(machine):
    """Without damping a film of K_xy = -K_yx = k on K has the poles s^2 = -(2/m)(K +- j k)."""
    film = {"K_xx": (5e6,), "K_yy": (5e6,), "C_xx": (0.0,), "C_yy": (0.0,), "speed": ()}
    film |= {"K_xy": (2e6,), "K_yx": (-2e6,), "C_xy": ()}
    plain = replace(machine, effects=tuple(replace(j, **film) for j in machine.effects))
    m = mass_properties(finite_element_rotor(machine)).mass
    found = poles(free_mode_reduction(assemble(plain), 0).rotor)
    expected = np.sqrt(complex(-2 * 5e6 + 0.2e6, 2 * 2e6) / m)
    assert np.abs(found - expected).min() < 1e-8 * abs(expected)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('K_xx = ["4 N/um", "6 N/um"]', 'K_xx = ["4 N/um"]', "K_xx is a list of 1, but must be"),
        ('["1000 rpm", "3000 rpm"]\nK', '["3000 rpm", "1000 rpm"]\nK', "speed is not ascending"),
        ('K_yy = ["8 N/um", "9 N/um"]\n', "", "K_yy is missing"),
        ("K_xx", "kxx", 'unknown key "kxx"'),
    ],
)
def test_what_is_wrong_is_refused(old, new, words):
    assert old in MACHINE
    with pytest.raises(InvalidInput) as wrong:
        loads_machine(MACHINE.replace(old, new))
    assert words in str(wrong.value)


def test_saved_and_read_again(machine):
    assert loads_machine(dumps_machine(machine)) == machine


def test_a_tolerance_is_of_the_value_at_the_point(machine):
    path = "journal_bearing.left.K_yx"
    varied = replace(machine, tolerances=(Tolerance(path, relative=0.5),))
    moved = perturbed(free_mode_reduction(assemble(varied), 1), {path: 1.0})
    first, second = machine.effects
    stiffer = replace(first, K_yx=(-3e6, -6e6))
    other = replace(machine, effects=(stiffer, second))
    expected = poles(free_mode_reduction(assemble(other), 1).system)
    assert matched(poles(moved.system), expected) == pytest.approx(expected, rel=1e-8, abs=1e-6)


def test_the_rig_follows_the_table_over_the_speed(machine):
    """Its linear view in a run-up is the plant's at the speed of that moment."""
    rig = build(machine, bending_modes=1)
    climb = Scenario(
        "climb",
        0.4,
        speed=1000 * RPM,
        speed_changes=(SpeedChange(0.0, 3000 * RPM, 0.2),),
        unbalances=(Unbalance("A", 1e-6),),
    )
    task = plan(rig, climb, 1e-4, 0)
    for first, speed in ((0, 1000.0), (500, 1500.0), (1500, 2500.0), (3000, 3000.0)):
        drive = stretch(task, first, 2)
        assert drive.speed[0] == pytest.approx(speed * RPM)
        still, off = state_at_rest(rig, np.zeros(rig.coordinates), np.zeros(2)), np.zeros(2)
        A, _ = linear_view(rig, drive, still, off)
        point = replace(machine.operation.nominal, speed=float(drive.speed[0]))
        plant = free_mode_reduction(assemble(machine, point), 1)
        used = [i for i in range(2 * rig.coordinates)]
        found, expected = np.linalg.eigvals(A[np.ix_(used, used)]), poles(plant.rotor)
        for pole in expected:
            assert np.abs(found - pole).min() < 1e-4 * abs(pole)


def test_check_looks_at_a_rotor_without_magnets(tmp_path):
    """It ended in a KeyError, though a refusal elsewhere advises it."""
    path = tmp_path / "oil.toml"
    first, rest = MACHINE.split("[[bearing]]")
    path.write_text(first + rest[rest.index("[[journal_bearing]]") :], encoding="utf-8")
    done = CliRunner().invoke(main, ["check", str(path)])
    assert done.exit_code == 0, done.output
    assert "free-free bending" in done.output and "ambrose lateral" in done.output
    assert "critical speeds" not in done.output  # not computed: not "none"
