"""The grammar of parameter paths."""

import itertools
from dataclasses import replace

import pytest
from hypothesis import given, strategies as st

from ambrose.core.checks import InvalidInput
from ambrose.machine.description import OperatingPoint
from ambrose.machine.file.toml import bundled_machines, load_machine
from ambrose.machine.parameters import (
    Parameter,
    chosen,
    find_parameter,
    find_uncertain,
    operating_point,
    parse_parameter,
    quantities,
)
from ambrose.machine.units import DIMENSIONS
from ambrose.report.tables import assumed_table

GOOD = {
    "stage.s.cross_coupling": ("stage", "s", "cross_coupling", "", "stiffness"),
    **{
        f"thrust_bearing.t.{quantity}": ("thrust_bearing", "t", quantity, "", dimension)
        for quantity, dimension in (
            ("force_per_current", "force per current"),
            ("negative_stiffness", "stiffness"),
            ("core_scale", "ratio"),
        )
    },
    "seal.c.K": ("seal", "c", "K", "", "stiffness"),
    "seal.c.k": ("seal", "c", "k", "", "stiffness"),
    "seal.c.C": ("seal", "c", "C", "", "damping"),
    "seal.c.c": ("seal", "c", "c", "", "damping"),
    "seal.c.M": ("seal", "c", "M", "", "mass"),
    "seal.c.K_xx": ("seal", "c", "K", "xx", "stiffness"),
    "seal.c.K_yy": ("seal", "c", "K", "yy", "stiffness"),
    "seal.c.k_xy": ("seal", "c", "k", "xy", "stiffness"),
    "seal.c.k_yx": ("seal", "c", "k", "yx", "stiffness"),
    "seal.c.C_xx": ("seal", "c", "C", "xx", "damping"),
    "seal.c.C_yy": ("seal", "c", "C", "yy", "damping"),
    "seal.c.c_xy": ("seal", "c", "c", "xy", "damping"),
    "seal.c.c_yx": ("seal", "c", "c", "yx", "damping"),
    "seal.c.pressure": ("seal", "c", "pressure", "", "pressure"),
    "bearing.A.force_per_current": ("bearing", "A", "force_per_current", "", "force per current"),
    "bearing.A.force_per_current.zeta": (
        "bearing",
        "A",
        "force_per_current",
        "zeta",
        "force per current",
    ),
    "bearing.A.negative_stiffness.eta": ("bearing", "A", "negative_stiffness", "eta", "stiffness"),
    "coupling.c_1.stiffness": ("coupling", "c_1", "stiffness", "", "stiffness"),
    "coupling.c-1.damping.zeta": ("coupling", "c-1", "damping", "zeta", "damping"),
    "amplifier.bandwidth": ("amplifier", "", "bandwidth", "", "angular rate"),
    "amplifier.eddy_bandwidth": ("amplifier", "", "eddy_bandwidth", "", "angular rate"),
    "amplifier.natural_frequency": ("amplifier", "", "natural_frequency", "", "angular rate"),
    "amplifier.damping": ("amplifier", "", "damping", "", "angular rate"),
    **{
        f"journal_bearing.j.{letter}_{entry}": (
            "journal_bearing",
            "j",
            f"{letter}_{entry}",
            "",
            dimension,
        )
        for letter, dimension in (("K", "stiffness"), ("C", "damping"))
        for entry in ("xx", "xy", "yx", "yy")
    },
    "rotor.bending_1.frequency": ("rotor", "bending_1", "frequency", "", "angular rate"),
    "rotor.bending_2.damping": ("rotor", "bending_2", "damping", "", "ratio"),
}
BAD = [
    *(
        "",
        ".",
        "seal",
        "seal.c",
        "seal..k",
        "seal.c.k.",
        "seal.c.k_",
        "seal.c.K_xy",
        "seal.c.k_xx",
        "seal.c.M_xx",
    ),
    *("seal.c.pressure_", "seal.c.pressure_xx"),
    *("rotor.modal_damping", "rotor.bending_1.shape"),
    *("seal.c.k.xy", "seal.c.Q", "bearing.A", "bearing.A.gap", "bearing.A.negative_stiffness_zeta"),
    *(
        "bearing.A.negative_stiffness.x",
        "bearing.A.negative_stiffness.zeta.zeta",
        "bearing.A.negative_stiffness.",
    ),
    *(
        "coupling.c.mass",
        "journal_bearing.j.K",
        "journal_bearing.j.K_xx.zeta",
        "amplifier",
        "amplifier.",
        "amplifier.order",
        "amplifier.bandwidth.zeta",
        "Seal.c.k",
        "seal.c. k",
    ),
]


@pytest.mark.parametrize("path", GOOD)
def test_good_paths(path):
    parameter = parse_parameter(path)
    assert parameter == Parameter(path, *GOOD[path])
    assert parameter.dimension in DIMENSIONS


@pytest.mark.parametrize("path", BAD)
def test_bad_paths(path):
    with pytest.raises(InvalidInput, match=r"known:|did you mean|possible:|incomplete; write"):
        parse_parameter(path)


@given(st.text("seal.bearing_kKA", max_size=20))
def test_any_path_is_parsed_or_refused(path):
    try:
        assert parse_parameter(path).table in quantities()
    except InvalidInput as error:
        assert path in str(error)


def test_every_quantity_of_the_grammar_is_covered_above():
    listed = {(p[0], p[2]) for p in GOOD.values()}
    assert listed == {(table, quantity) for table, of in quantities().items() for quantity in of}


def test_overlap():
    """A parameter of both axes contains its single entries; entries and other quantities are
    apart.
    """
    overlapping = {
        frozenset(pair)
        for pair in itertools.combinations(GOOD, 2)
        if parse_parameter(pair[0]).overlaps(parse_parameter(pair[1]))
    }
    wanted = [
        ("seal.c.K", "seal.c.K_xx"),
        ("seal.c.K", "seal.c.K_yy"),
        ("seal.c.k", "seal.c.k_xy"),
        ("seal.c.k", "seal.c.k_yx"),
    ]
    wanted += [
        ("seal.c.C", "seal.c.C_xx"),
        ("seal.c.C", "seal.c.C_yy"),
        ("seal.c.c", "seal.c.c_xy"),
        ("seal.c.c", "seal.c.c_yx"),
    ]
    wanted += [("bearing.A.force_per_current", "bearing.A.force_per_current.zeta")]
    assert overlapping == {frozenset(pair) for pair in wanted}
    assert parse_parameter("seal.c.k").overlaps(parse_parameter("seal.c.k"))
    assert not parse_parameter("seal.c.k").overlaps(parse_parameter("seal.d.k"))


class TestOfAMachine:
    def test_found(self):
        machine = load_machine("seal-rig")
        for tolerance in machine.tolerances:
            assert find_parameter(machine, tolerance.parameter).name == "center"
        assert find_parameter(machine, "amplifier.damping").quantity == "damping"

    @pytest.mark.parametrize(
        "path, reason",
        [
            ("seal.centre.k", 'unknown seal "centre"; did you mean "center"'),
            ("bearing.C.negative_stiffness", 'unknown bearing "C"; known: A, B'),
            ("amplifier.bandwidth", 'order "second" has only natural_frequency and damping'),
        ],
    )
    def test_not_found(self, path, reason):
        with pytest.raises(InvalidInput, match=reason):
            find_parameter(load_machine("seal-rig"), path)

    def test_the_added_mass_is_a_parameter_but_not_an_uncertain_one(self):
        machine = load_machine("seal-rig")
        assert find_parameter(machine, "seal.center.M").quantity == "M"
        with pytest.raises(
            InvalidInput,
            match=r'"seal.center.M" cannot be uncertain.*give "seal.center.K" or "seal.center.C"',
        ):
            find_uncertain(machine, "seal.center.M")
        assert find_uncertain(machine, "seal.center.K") == find_parameter(machine, "seal.center.K")

    def test_no_such_table(self):
        with pytest.raises(InvalidInput, match=r"the machine has no \[\[coupling\]\]"):
            find_parameter(load_machine("turboexpander"), "coupling.x.stiffness")


def test_operating_point_by_label():
    rig = load_machine("seal-rig")
    assert operating_point(rig, "zero").seal_pressure == 0
    with pytest.raises(InvalidInput, match="'nominal pressure'"):
        operating_point(rig, "half")
    with pytest.raises(InvalidInput, match="not one point"):
        operating_point(rig, "")


def test_operating_point_by_values():
    rig = load_machine("seal-rig")
    assert operating_point(rig) == rig.operation.design
    assert operating_point(rig, rig.operation.points[1]) is rig.operation.points[1]
    # another point has another name
    assert operating_point(rig, "zero", speed=100.0) == OperatingPoint(speed=100.0)
    assert operating_point(rig, "twice", seal_pressure=4.08e5).label == "twice nominal pressure"
    assert operating_point(rig, speed=100, bias_current=6.0) == OperatingPoint(100.0, 2.04e5, 6.0)
    assert (
        operating_point(rig, OperatingPoint(bias_current=6.0), bias_current=None)
        == OperatingPoint()
    )


@pytest.mark.parametrize(
    ("point", "values", "message"),
    [
        (
            3,
            {},
            r"the operating point is 3, but must be a label or an OperatingPoint; choose 'nominal "
            r"pressure', 'zero",
        ),
        ("half", {"speed": 1.0}, "'half' is not one point of machine 'seal-rig'"),
        (None, {"pressure": 1e5}, r'unknown keyword "pressure"; did you mean "seal_pressure"'),
        (None, {"speed": -1.0}, r"speed is -1\.0, but must be zero or positive; give it in rad/s"),
        (None, {"speed": "fast"}, r"speed is .fast., but must be a number; give it in rad/s"),
        (None, {"speed": None}, "speed is None, but must be finite"),
        (None, {"seal_pressure": float("nan")}, "seal_pressure is nan, but must be finite"),
        (None, {"bias_current": 0.0}, r"bias_current is 0\.0, but must be positive; give it in A"),
    ],
)
def test_operating_point_refuses(point, values, message):
    with pytest.raises(InvalidInput, match=message):
        operating_point(load_machine("seal-rig"), point, **values)


@pytest.mark.parametrize(
    ("key", "gone", "stands"),
    [
        ("bearing.geometry", {"bearings": {"geometry": None}}, False),
        ("bearing.max_force", {"bearings": {"max_force": None}}, False),
        ("requirements.unbalance_orbit", {"requirements": {"unbalance_orbit": None}}, False),
        ("weights.bandwidth", {"weights": None}, False),
        ("controller.gain", {"controller": None}, False),
        ("operation.point.seal_pressure", {}, True),
        ("bearing.A.gap", {}, True),
        # may say why there is none, or be words
        ("gravity_direction", {"gravity_direction": None}, True),
        ("all figures", {}, True),
        ("seal.center.scales_with_pressure", {}, True),
        ("seal.geometry.stator_friction", {}, False),
    ],
)
def test_a_reason_stands_as_long_as_the_machine_states_its_key(key, gone, stands):
    machine = load_machine("seal-rig")
    for table, change in gone.items():
        old = getattr(machine, table)
        new = change
        if isinstance(change, dict):
            many = isinstance(old, tuple)
            new = tuple(replace(one, **change) for one in old) if many else replace(old, **change)
        machine = replace(machine, **{table: new})
    machine = replace(machine, assumed=((key, "chosen"),))
    assert chosen(machine) == (((key, "chosen"),) if stands else ())
    (table,) = assumed_table(machine)
    assert table.rows == chosen(machine)
    assert (key in table.note) != stands


def test_every_reason_of_the_bundled_machines_stands():
    for name in bundled_machines():
        machine = load_machine(name)
        assert chosen(machine) == machine.assumed, name
