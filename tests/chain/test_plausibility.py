"""What `ambrose check` says about implausible machines: each doubt with cause and remedy; none
about those that are sound.
"""

import json
import math
import re
from dataclasses import replace

import numpy as np
import pytest
from click.testing import CliRunner

import ambrose as amb
from ambrose.chain import check as plants
from ambrose.chain.check import block_doubts, critical_speeds, facts, rows_of, shares
from ambrose.cli import main
from ambrose.core.checks import NumericalFailure
from ambrose.judge.loop_response import unavoidable_sensitivity
from ambrose.machine.description import Amplifier, OperatingPoint, Operation, Tolerance
from ambrose.machine.file.toml import read_machine_text
from ambrose.machine.part import BendingMode, Material, Synchronous, Touchdown, TouchdownRace
from ambrose.machine.units import DIMENSIONS, read_quantity
from ambrose.model.effects.stations import Clearance, Load, Stage
from coarse import coarse


@pytest.fixture(scope="module")
def rig():
    return coarse("seal-rig")


def doubts(machine):
    return facts(machine)["doubts"]


@pytest.mark.parametrize("name", sorted(amb.bundled_machines()))
def test_bundled_machines_raise_no_doubt(name):
    assert doubts(amb.load_machine(name)) == []


def bearings(machine, **changes):
    return replace(machine, bearings=tuple(replace(item, **changes) for item in machine.bearings))


def scaled(machine, factor):
    """Lengths as if one had left out a unit."""
    shaft = tuple(
        replace(
            s,
            outer_diameter=factor * s.outer_diameter,
            mass_diameter=s.mass_diameter and factor * s.mass_diameter,
        )
        for s in machine.shaft
    )
    return replace(machine, shaft=shaft)


def sensor_at(machine, place):
    return replace(
        machine, sensors=(replace(machine.sensors[0], position=place), *machine.sensors[1:])
    )


def alone(machine):
    return replace(
        machine,
        bearings=machine.bearings[:1],
        sensors=machine.sensors[:1],
        controller=replace(machine.controller, gain=(18250.0,)),
    )


def material(machine, **changes):
    return replace(
        machine,
        shaft=tuple(
            replace(item, material=replace(Material(), **changes)) for item in machine.shaft
        ),
    )


def points(machine, speed):
    return replace(
        machine,
        operation=Operation((OperatingPoint(speed, label="fast"),), (0.0, 100.0)),
        tolerances=(),
    )


def seal(machine, **changes):
    return replace(machine, seals=(replace(machine.seals[0], **changes),))


def pressure(machine, value):
    operation = Operation((OperatingPoint(0.0, value, label="rated"),))
    return replace(machine, operation=operation, tolerances=())


def stage(**changes):
    """The overhung blower, which turns at 6000 and 12 000 rpm, with a stage."""
    machine = amb.load_machine("overhung-blower")
    rated = {"power": 2e5, "speed": 400 * math.pi, "diameter": 0.3, "width": 0.02} | changes
    return replace(machine, effects=(*machine.effects, Stage("wheel", 0.035, **rated)))


def first_section(machine, **changes):
    return replace(machine, shaft=(replace(machine.shaft[0], **changes), *machine.shaft[1:]))


def amplifier(machine, **changes):
    return replace(machine, amplifier=replace(machine.amplifier, **changes))


CASES = {
    "mass": (
        lambda m: scaled(m, 15),
        r"the rotor weighs [\d,.e+]+ kg, unheard of .*; look for a length without its unit",
    ),
    "diameter": (lambda m: scaled(m, 1000), r"the shaft is 1[\d,.]+ m in diameter; look for"),
    "density": (
        lambda m: material(m, density=7.85),
        r"density is 7.85 kg/m\^3, where 500 .* is usual; write \"7.85 g/cm3\" if",
    ),
    "modulus": (
        lambda m: material(m, youngs_modulus=210.0),
        r"youngs_modulus is 210 Pa, where 10 GPa .*; write \"210 GPa\" if that is meant",
    ),
    "tolerance": (
        lambda m: replace(m, tolerances=(Tolerance("seal.center.k", relative=50.0),)),
        r'\[\[tolerance\]\] 1 seal.center.k: relative is 50, where .* is usual; write "50 %" if',
    ),
    "point": (
        lambda m: points(m, 200 * math.pi),
        r'point "fast" turns at 6000 rpm, outside of speed_range, 0 to 954',
    ),
    "tip": (lambda m: points(m, 1e5), r"surface runs at [\d,.e+]+ m/s"),
    "one bearing": (
        alone,
        r"one bearing cannot carry the tilting of a rotor 0.86 m long; add a second",
    ),
    "node": (
        lambda m: sensor_at(m, 0.196),
        r"sensor of bearing A is at a node of the first bending mode \(550",
    ),
    "across": (
        lambda m: sensor_at(m, 0.3),
        r"sensor of bearing A is across a node of the first bending mode \(550",
    ),
    "weak": (
        lambda m: bearings(m, max_force=200.0),
        r"A reaches 200 N per axis and carries 239.2 N of the weight on one: .* cannot be lifted",
    ),
    "scarce": (
        lambda m: bearings(m, max_force=300.0),
        r"bearing A reaches 300 N per axis and carries 239.2 N .*three times the load",
    ),
    "unit of force": (
        lambda m: replace(bearings(m, max_force=7.5), gravity_direction=None),
        r"bearing A reaches 7.5 N per axis .* if the rotor lies: check the units",
    ),
    "gain": (
        lambda m: replace(m, controller=replace(m.controller, gain=(4000.0,))),
        r"K_p k_i is below k_s \(0.5\d* of it\).*raise gain 2.8 times",
    ),
    "scant gain": (
        lambda m: replace(m, controller=replace(m.controller, gain=(8000.0,))),
        r"only 1.07 times k_s",
    ),
    "gap": (
        lambda m: bearings(m, gap=0.5),
        r"\]\] A: gap is 0.5 m, where 50 um to 5 mm is usual; write \"0.5 mm\" if",
    ),
    "coefficients": (
        lambda m: bearings(m, force_per_current=(0.144, 0.139)),
        r"times k_i bias / gap; .*check the units",
    ),
    "friction": (
        lambda m: bearings(m, touchdown=Touchdown(friction=2.0)),
        r"A, \[bearing.touchdown\]: friction is 2, where 0.001 to 0.8 is usual",
    ),
    "race": (
        lambda m: bearings(
            m, touchdown=Touchdown(radius=0.05, race=TouchdownRace(0.3, 0.4, 1e8, 1e3))
        ),
        r"has 533 times the inertia of its mass at the contact's radius, .*check the units",
    ),
    "touchdown gap": (
        lambda m: replace(
            bearings(coarse("turboexpander"), gap=5e-4, touchdown_gap=4e-4), controller=None
        ),
        r"touchdown gap of bearing A, 0.4 mm, is above the clearance of seal piston, 0.2",
    ),
    "delay": (
        lambda m: replace(m, controller=replace(m.controller, sample_time=1e-3, delay=8e-3)),
        r"no controller can: the unstable pole at 23.9 Hz and the delay of 8.5 ms keep S above "
        r"5.29, and the limit is 3; sample",
    ),
    "rate": (
        lambda m: replace(m, controller=replace(m.controller, sample_time=1e-2)),
        r"at 100 Hz, less than 10 times the 2",
    ),
    "sensor elsewhere": (
        lambda m: sensor_at(m, 0.78),
        r"sensor of bearing A, at 780 mm, is nearer to bearing B, at 698 mm, than to its own, at "
        r"162 mm: .*correct its position or its bearing",
    ),
    "modal damping": (
        lambda m: replace(m, modal_damping=0.3),
        r'\[machine\]: modal_damping is 0.3, where .* 5 % is usual; write "0.3 %" if that is',
    ),
    "damping of a mode": (
        lambda m: replace(m, bending_modes=(BendingMode(1, damping=0.5),)),
        r"\[\[bending_mode\]\] 1: damping is 0.5, where",
    ),
    "inductance": (
        lambda m: amplifier(m, inductance=43.0, max_voltage=300.0),
        r'\[amplifier\]: inductance is 43 H, .*; write "43 mH" if that is meant',
    ),
    "contact": (
        lambda m: bearings(m, touchdown=Touchdown(stiffness=150.0)),
        r"A, \[bearing.touchdown\]: stiffness is 150 N/m, .*write \"150 N/um\" if",
    ),
    "rolling elements": (
        lambda m: bearings(
            m, touchdown=Touchdown(radius=0.05, race=TouchdownRace(0.3, 1e-3, 100.0, 1e3))
        ),
        r"A, \[bearing.touchdown.race\]: element_stiffness is 100 N/m",
    ),
    "sign of k": (
        lambda m: seal(m, k=-3.2e6),
        r"k of seal center is -3.2 N/um at operating point .*correct its sign",
    ),
    "bar as pascals": (
        lambda m: pressure(m, 30.0),
        r'point "rated" has 30 Pa across its seals; .*write "30 bar"',
    ),
    "reference in pascals": (
        lambda m: seal(m, reference_pressure=204.0),
        r'reference_pressure of seal center is 204 Pa; .*write "204 bar"',
    ),
    "far from the reference": (
        lambda m: pressure(m, 20.4e5),
        r'"rated" has 20.4 bar across seal center, 10 times its reference_pressure, 2.04 bar',
    ),
    "mass diameter": (
        lambda m: first_section(m, mass_diameter=0.001),
        r"mass_diameter of \[\[shaft\]\] 1.*, 1 mm, is below its outer_diameter, [\d.]+ mm",
    ),
    "power": (
        lambda m: stage(power=200.0),
        r'wheel of 300 mm in diameter takes 200 W, where 1,000 W and more .*write "200 kW"',
    ),
    "width": (
        lambda m: stage(width=0.0016),
        r"wheel is 1.6 mm wide and 300 mm in diameter, .*check the unit of its width",
    ),
    "rated speed": (
        lambda m: stage(speed=12000.0),
        r"wheel is rated at 114,592 rpm, where the machine turns at 6,000 to 12,000 rpm; "
        r'.*write "12000 rpm"',
    ),
    "load": (
        lambda m: replace(m, effects=(*m.effects, Load("surge", 0.4, kind="static", force=300e3))),
        r"load surge, 300,000 N, is [\d.]+ times what all bearings reach together",
    ),
    "corner of the amplifier": (
        lambda m: replace(m, amplifier=Amplifier("first", 1500.0)),
        r'bandwidth of the amplifier means 238.7 Hz, less than 10 times the .*write "1500 Hz"',
    ),
    "corner of a sensor": (
        lambda m: replace(m, sensors=tuple(replace(s, bandwidth=1500.0) for s in m.sensors)),
        r"bandwidth of the sensor of bearing A means 238.7 Hz",
    ),
}

SOUND = {
    "laminated shaft": lambda m: replace(m, modal_damping=0.02),
    "strong coil": lambda m: amplifier(m, inductance=0.5, max_voltage=300.0),
    "soft contact": lambda m: bearings(m, touchdown=Touchdown(stiffness=1e6)),
    "half a sensor elsewhere": lambda m: replace(
        m,
        sensors=(
            replace(m.sensors[0], weight=0.8),
            replace(m.sensors[0], weight=0.2, position=0.6),
            *m.sensors[1:],
        ),
    ),
    "swirl brake": lambda m: replace(
        seal(m, k=-1e5), assumed=(("seal.center.k", "swirl brakes"),), tolerances=()
    ),
    "fan": lambda m: seal(pressure(m, 2e3), reference_pressure=2e3),
    "small wheel": lambda m: stage(power=400.0, diameter=0.055, width=0.003),
    "narrow wheel": lambda m: stage(width=0.003),
    "slow stage": lambda m: stage(speed=200 * math.pi),
    "shock": lambda m: replace(
        m, effects=(*m.effects, Load("shock", 0.4, kind="static", force=5e3))
    ),
    "no coil": lambda m: replace(m, amplifier=Amplifier("first", 3200.0)),
}


def test_an_implausible_entry_is_named_where_the_model_fails(rig, monkeypatch):
    """A reference pressure of 2.04 Pa made poles that no reduction parts, and `check` said that."""

    def fails(*_):
        raise NumericalFailure("poles 20 and 21 cannot be parted; keep one more")

    monkeypatch.setattr(plants, "reduce_from", fails)
    with pytest.raises(NumericalFailure, match=r"one more\n.*reference_pressure of"):
        facts(seal(rig, reference_pressure=2.04))
    with pytest.raises(NumericalFailure, match=r"one more$"):
        facts(rig)


@pytest.mark.parametrize("case", sorted(SOUND))
def test_what_is_unusual_but_built_is_not_doubted(rig, case):
    assert doubts(SOUND[case](rig)) == []


@pytest.mark.parametrize("case", sorted(CASES))
def test_what_is_implausible_is_said_with_its_remedy(rig, case):
    change, pattern = CASES[case]
    found = doubts(change(rig))
    assert any(re.search(pattern, line) for line in found), found
    assert all("\n" not in line and (";" in line or ":" in line) for line in found)


def test_the_command_says_doubts_and_ends_with_one(tmp_path):
    path = tmp_path / "typo.toml"
    path.write_text(
        read_machine_text("seal-rig").replace('"18250 A/m"', '"4000 A/m"'), encoding="utf-8"
    )
    shown = CliRunner().invoke(main, ["check", str(path)])
    assert (
        shown.exit_code == 1
        and "implausible: K_p k_i is below k_s" in shown.output
        and "bearing A" in shown.output
    )
    told = CliRunner().invoke(main, ["check", str(path), "--json"])
    assert told.exit_code == 1 and len(json.loads(told.output)["doubts"]) == 1
    sound = CliRunner().invoke(main, ["check", "seal-rig"])
    assert (
        sound.exit_code == 0
        and "note: no sample_time in [controller]" in sound.output
        and "implausible: " not in sound.output
    )


def test_every_point_outside_a_table_is_named_in_the_units_of_the_file(tmp_path):
    """The first of them stood alone, without file and point, in pascals."""
    text = read_machine_text("three-bearing-train")
    stated = text[text.index('reference_pressure = "20 bar"') : text.index("[controller]")]
    rows = '[seal.table]\npressure = ["5 bar", "15 bar"]\nk = ["0.2 N/um", "0.6 N/um"]\n\n'
    path = tmp_path / "train.toml"
    path.write_text(text.replace(stated, rows), encoding="utf-8")
    shown = CliRunner().invoke(main, ["check", str(path)])
    assert shown.exit_code == 2
    said = " ".join(shown.output.split())
    assert f"{path} has 3 problems:" in said
    labels = [point.label for point in amb.load_machine(path).operation.points]
    for label, pressure in zip(labels, ("20 bar", "0 bar", None, "0 bar"), strict=True):
        named = f'operating point "{label}": the pressure of seal balance-piston is {pressure}, but'
        assert (named in said) == (pressure is not None)
    assert said.count("must be within its table, 5 to 15 bar; extend the table") == 3


def test_a_block_turned_by_180_degrees_is_doubted(rig):
    """T = 1 converges where S is near 1, far above the loop's bandwidth; -T nowhere there."""
    for angle, said in ((0.0, []), (math.pi, ["[[controller.synchronous]] 1: current-free"])):
        block = Synchronous("current-free", (600.0, 900.0), 0.5, phase=(angle,))
        settings = replace(rig.controller, synchronous=(block,), sample_time=1e-4)
        lines = list(block_doubts(replace(rig, controller=settings)))
        assert [line.partition(" with this T drives away")[0] for line in lines] == said


def test_a_block_in_a_loop_that_is_lost_without_it_is_not_blamed(rig):
    """A gain below k_s/k_i: T = 1 was said to have the wrong sign, or nothing was said."""
    block = Synchronous("current-free", (600.0, 900.0), 0.5)
    weak = tuple(0.05 * gain for gain in np.atleast_1d(rig.controller.gain))
    settings = replace(rig.controller, synchronous=(block,), sample_time=1e-4, gain=weak)
    (line,) = block_doubts(replace(rig, controller=settings))
    assert "without the block the [controller] does not hold the rotor" in line
    assert "drives away" not in line


def test_what_is_missing_is_noted_but_no_doubt(rig):
    bare = replace(
        rig, requirements=type(rig.requirements)(), weights=None, controller=None, tolerances=()
    )
    known = facts(bare)
    assert known["doubts"] == [] and known["stiffness_margin"] is None
    assert {"no [requirements]", "no [weights]", "no reference controller"} <= {
        line.split(":")[0] for line in known["remarks"]
    }


def test_a_force_of_one_axis_is_held_against_what_that_axis_carries(rig):
    """Magnets at 45 degrees share the weight: what they reach per axis stood beside all of it."""
    known = facts(rig)
    (item, _) = known["bearings"]
    assert item["weight_of_axis"] == pytest.approx(item["weight"] / math.sqrt(2))
    ((_, said), *_) = [row for row in rows_of(known) if row[0] == "bearing A"]
    assert "N per axis for 338.2 N of the weight, at most 239.2 N on an axis" in said
    assert doubts(bearings(rig, max_force=400.0)) == []
    (item, _) = facts(replace(rig, gravity_direction=None))["bearings"]
    assert item["weight_of_axis"] is None


def test_a_touchdown_gap_given_in_diameter_is_told_from_radial_clearances(rig):
    """0.4 mm of a gap of 0.5 mm: the clearances were blamed, and the first of all bearings."""
    places = {"left": 0.25, "right": 0.6, "end": 0.65}
    parts = tuple(Clearance(name, at, 5e-4) for name, at in places.items())
    wide = replace(bearings(rig, touchdown_gap=4e-4), effects=parts)
    first, second = doubts(wide)
    for line, name, near in ((first, "AB", ("left",)), (second, "BA", ("right", "end"))):
        assert line.startswith(f"touchdown_gap of bearing {name[0]}, 0.4 mm of an air gap of 0.5")
        assert line.endswith(
            f'write "0.2 mm" where it is a diametral one, and so at bearing {name[1]}'
        )
        assert [other for other in places if f"{other} (0.5 mm)" in line] == list(near)
    assert doubts(replace(bearings(rig, touchdown_gap=2.5e-4), effects=parts)) == []
    (line,) = doubts(replace(rig, effects=(Clearance("end", 0.65, 2.5e-4),)))
    assert line.startswith("the diametral clearance of end, 0.25 mm, is below that of touchdown ")
    assert "bearing B, 0.5 mm, twice its touchdown_gap" in line and "not the radial one" in line


def test_loads_of_two_bearings_follow_the_lever_and_of_three_sum_up():
    assert shares(100.0, 0.3, [0.1, 0.9]) == pytest.approx([75.0, 25.0])
    assert shares(100.0, 0.5, [0.1, 0.5, 0.9]) == pytest.approx([100 / 3] * 3)
    assert shares(100.0, 0.5, [0.2]) == pytest.approx([100.0])


def test_critical_speeds_are_where_a_forward_mode_turns_as_fast_as_the_rotor():
    """Without gyroscopics they are the natural frequencies on the springs: assembled with the
    magnets as those springs.
    """
    machine = coarse("turboexpander")
    found = critical_speeds(machine)
    k = read_quantity("60 A/mm", DIMENSIONS["current per displacement"]) * 160 - 2.4e6
    rotor = amb.finite_element_rotor(machine)
    from ambrose.model.effects.rotor import plane_rows

    w = plane_rows(rotor, [b.position for b in machine.bearings])[0]
    K = rotor.plane_stiffness + k * w.T @ w
    for speed in found[:3]:
        values = np.linalg.eigvals(
            np.linalg.solve(
                rotor.plane_mass, K - speed**2 * (rotor.plane_mass - rotor.plane_gyroscopic)
            )
        )
        assert np.abs(values).min() < 1e-3 * speed**2


STIFF = """
[machine]
schema = 1
name = "rigid rotor"
beam_theory = "timoshenko"

[[shaft]]
length = "400 mm"
outer_diameter = "80 mm"
elements = 8

[[bearing]]
name = "A"
position = "50 mm"
bias_current = "3 A"
force_per_current = 180
negative_stiffness = "0.7 N/um"
[[bearing]]
name = "B"
position = "350 mm"
bias_current = "3 A"
force_per_current = 180
negative_stiffness = "0.7 N/um"

[[sensor]]
bearing = "A"
position = "50 mm"
[[sensor]]
bearing = "B"
position = "350 mm"

[amplifier]
order = "first"
bandwidth = "1.5 kHz"

[controller]
gain = "5 A/mm"
derivative_time = "3 ms"
derivative_filter = 0.1

[operation]
speed_range = [0, "12000 rpm"]
[[operation.point]]
label = "rated"
speed = "12000 rpm"
"""
STAGE = """
[[stage]]
name = "impeller"
position = "100 mm"
power = "{power:g} W"
speed = "12000 rpm"
diameter = "200 mm"
width = "15 mm"
density_ratio = 1.4
"""
FILM = """
[[journal_bearing]]
name = "film"
position = "300 mm"
K_xx = ["0.2 N/um"]
K_yy = ["0.2 N/um"]
C_xx = ["1 kN s/m"]
C_yy = ["1 kN s/m"]
K_xy = ["{xy:g} N/m"]
K_yx = ["{yx:g} N/m"]
"""


def written(tmp_path, text):
    path = tmp_path / "machine.toml"
    path.write_text(text, encoding="utf-8")
    return amb.load_machine(path)


@pytest.mark.parametrize("power", [1e-6, 1e3, 1e7])
def test_critical_speeds_do_not_depend_on_cross_coupling(tmp_path, power):
    """A stage of any power: the same numbers as without, and for a rigid rotor on two springs k at
    distances b from its centre m W^2 = 2 k and (I_d - I_p) W^2 = 2 k b^2.

    The roots of W^2 became complex with any q, and were left out as none.
    """
    plain = critical_speeds(written(tmp_path, STIFF))
    staged = critical_speeds(written(tmp_path, STIFF + STAGE.format(power=power)))
    assert len(plain) == 4
    np.testing.assert_allclose(staged, plain, rtol=1e-9)
    density, d, length, b = Material().density, 0.08, 0.4, 0.15
    k = 5000.0 * 180 - 0.7e6
    m = density * math.pi / 4 * d**2 * length
    polar, diametral = m * d**2 / 8, m * (3 * d**2 / 4 + length**2) / 12
    rigid = math.sqrt(2 * k / m), math.sqrt(2 * k * b**2 / (diametral - polar))
    # and what the shaft bends
    np.testing.assert_allclose(plain[:2], sorted(rigid), rtol=2e-3)


def test_critical_speeds_take_of_a_film_what_is_symmetric(tmp_path):
    """K_xy = -K_yx moves nothing; K_xy = K_yx is a spring across the axes, as strong as the
    difference of two along axes turned by 45 degrees.
    """
    at = {
        xy: critical_speeds(written(tmp_path, STIFF + FILM.format(xy=xy[0], yx=xy[1])))
        for xy in ((0, 0), (3e5, -3e5), (1e5, 1e5), (3e5, -1e5))
    }
    np.testing.assert_allclose(at[3e5, -3e5], at[0, 0], rtol=1e-9)
    np.testing.assert_allclose(at[3e5, -1e5], at[1e5, 1e5], rtol=1e-9)
    assert abs(at[1e5, 1e5][0] / at[0, 0][0] - 1) > 1e-3


def test_the_limit_holds_for_every_controller_that_was_designed(rig):
    plant = amb.assemble(
        replace(rig, controller=replace(rig.controller, sample_time=1e-3, delay=1e-3))
    )
    least, pole, delay = unavoidable_sensitivity(plant)
    assert delay == pytest.approx(1.5e-3) and pole == pytest.approx(150.5, rel=0.01)
    assert math.exp(0.9 * pole * delay) < least < 2
    peak = amb.design(plant, "pid").certificate.margins["sampled_sensitivity_peak"]
    assert peak > least


def test_a_controller_that_loses_a_point_is_told_and_no_fault():
    """The PID of the seal rig is unstable at twice its nominal pressure, and `check` said nothing
    of it.
    """
    known = facts(coarse("seal-rig"))
    (line,) = [text for text in known["remarks"] if "[controller] is unstable" in text]
    assert "twice nominal pressure" in line and "zero pressure" not in line
    assert not known["doubts"]
    assert not [
        text
        for text in facts(amb.load_machine("flywheel"))["remarks"]
        if "[controller] is unstable" in text
    ]


def test_nodes_of_higher_modes_are_named_from_the_uniform_beam(tmp_path):
    """A thin shaft of 2 m: w'''' = beta^4 w between free ends has its nodes at 0.1321 and 0.5
    lengths in mode 2, at 0.0944, 0.3558 ... in mode 3 (Blevins 1979, table 8-1). On a test rig
    whose second mode had its node in the magnet `check` said nothing, and `new` advised a higher
    order.
    """
    text = STIFF.replace('"400 mm"', '"2 m"').replace('"80 mm"', '"20 mm"')
    text = text.replace("elements = 8", "elements = 60").replace('"12000 rpm"', '"300 rpm"')
    # magnet A at a node of mode 2, its sensor beyond a node of mode 3; B and its sensor beside
    # the nodes of both, on one side of them
    places = (('"50 mm"', '"264.2 mm"', '"140 mm"'), ('"350 mm"', '"1860 mm"', '"1850 mm"'))
    for old, magnet, sensor in places:
        text = text.replace(f"position = {old}", f"position = {magnet}", 1)
        text = text.replace(f"position = {old}", f"position = {sensor}", 1)
    (said,) = [r for r in facts(written(tmp_path, text))["remarks"] if r.startswith("bending: ")]
    named = re.findall(r"(a node at \w+ [AB]|magnet and sensor [AB] move oppositely)", said)
    assert "a node at magnet A" in named
    assert re.search(r"a node at magnet A in mode 2 \(", said)
    assert re.search(r"magnet and sensor A move oppositely in mode 3 \(", said)
    first = re.split(r"; ", said.removeprefix("bending: "))
    assert not [words for words in first if " B" in words and re.search(r"mode [23] \(", words)]


def every(machine, table, **factors):
    """The entries of a table, some numbers times a factor."""
    parts = tuple(
        replace(part, **{key: factor * getattr(part, key) for key, factor in factors.items()})
        for part in getattr(machine, table)
    )
    return replace(machine, **{table: parts})


def asked(machine, **changes):
    return replace(machine, requirements=replace(machine.requirements, **changes))


def wide(parameter, **width):
    return lambda machine: replace(machine, tolerances=(Tolerance(parameter, **width),))


BLOWER_K_I = "bearing.impeller-side.force_per_current"
# (machine, what is done to it, the quantity that is doubted); all of these were passed
RELATIONS = {
    "seal k times 1000": ("overhung-blower", lambda m: every(m, "seals", k=1e3), "k of seal"),
    "seal C times 1000": ("overhung-blower", lambda m: every(m, "seals", C=1e3), "C of seal"),
    "c of a rig times 1000": ("seal-rig", lambda m: every(m, "seals", c=1e3), "c of seal"),
    "a pump's k times 1000": ("vertical-pump", lambda m: every(m, "seals", k=1e3), "k of seal"),
    "a pump's M in grams": ("vertical-pump", lambda m: every(m, "seals", M=1e3), "M of seal"),
    "grade in m/s": ("overhung-blower", lambda m: asked(m, balance_grade=2.5), "balance_grade"),
    "9000 Hz of balance": (
        "flywheel",
        lambda m: asked(m, balance_speed=9000 * 2 * np.pi),
        "balance_speed",
    ),
    "balanced at a tenth of the speed": (
        "flywheel",
        lambda m: asked(m, balance_speed=94.2),
        "balance_speed",
    ),
    "unbalance up to 9000 Hz": (
        "flywheel",
        lambda m: asked(m, unbalance_to=9000 * 2 * np.pi),
        "unbalance_to",
    ),
    "disc in grams": ("overhung-blower", lambda m: every(m, "discs", mass=1e-3), "polar_inertia"),
    "disc in g m2": (
        "overhung-blower",
        lambda m: every(m, "discs", polar_inertia=1e-3, diametral_inertia=1e-3),
        "polar_inertia",
    ),
    "k_i known to 100 %": ("overhung-blower", wide(BLOWER_K_I, relative=1.0), "relative is 1"),
    "k_s in N/um": (
        "overhung-blower",
        wide("bearing.impeller-side.negative_stiffness", absolute=8e8),
        "absolute is",
    ),
    "k within 1e9": ("overhung-blower", wide("seal.labyrinth.k", absolute=1e9), "absolute is"),
    "a bending mode anywhere": (
        "overhung-blower",
        wide("rotor.bending_1.frequency", relative=0.95),
        "relative is 0.95",
    ),
}


@pytest.mark.parametrize("case", RELATIONS)
def test_what_is_implausible_beside_other_numbers_is_doubted(case):
    name, change, quantity = RELATIONS[case]
    found = doubts(change(amb.load_machine(name)))
    assert any(quantity in line for line in found), found
    assert all("; " in line for line in found)


def test_a_seal_that_a_tolerance_takes_to_zero_is_no_mistake():
    """Swirl brakes reverse k: 100 % of it is usual, and ten times a small one may be."""
    for width in ({"relative": 1.0}, {"absolute": 5 * 6e4}):
        assert doubts(wide("seal.labyrinth.k", **width)(amb.load_machine("overhung-blower"))) == []
