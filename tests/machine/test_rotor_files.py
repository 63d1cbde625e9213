"""Rotor models of ROSS and tables of stations: read, refused in one sentence, written so that ROSS
loads them.
"""

import copy
import json
import tomllib
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

import ambrose as amb
from ambrose.core.checks import InvalidInput
from ambrose.machine.attachment import mesh, stations
from ambrose.machine.description import MachineDescription
from ambrose.machine.file.ross import off_nodes, parse_ross, ross_text, rotor_of_ross
from ambrose.machine.file.stations import read_rotor, rotor_of_stations
from ambrose.machine.file.toml import load_machine
from ambrose.model.effects.magnet import linearised
from ambrose.model.effects.rotor import (
    finite_element_rotor,
    free_bending_frequencies,
    mass_properties,
)

# The compressor of ROSS' own tests (compressor_example): length, inner and outer diameter of the
# steel, outer diameter of what lies around it without stiffness [mm]; one finite element each.
# Discs: (node, mass [kg], diametral and polar inertia [kg m2]).
COMPRESSOR = """
35.5 140.9954 151.003; 36 140.9954 151.003; 54 0 80; 43 0 80; 16.5 0 88; 14 0 88; 36.5 0 90; 51 0 90; 25 0 103 138; 16 0 85 138;
24.2 0 104 174; 4.5 0 98.2 174; 12.57 0 104 174; 20 0 106 184; 62.73 0 108 184; 38 0 110 184; 38 0 122 139; 30 0 135 175;
53 0 117.7 196.5; 19.49 0 122.35 127; 13.51 0 122.35 127; 49.5 0 117.7; 19.59 0 122.35 127; 12.41 0 122.35 127; 49 0 117.7;
19.7 0 122.35 127; 12.3 0 122.35 127; 49.5 0 117.7; 19.83 0 122.35 127; 11.67 0 122.35 127; 49.5 0 117.7; 19.98 0 122.35 127;
12.02 0 122.35 127; 49.5 0 117.7; 20.1 0 122.35 127; 12.4 0 122.35 127; 57 0 117.7; 26 0 135 175; 38 0 122 139; 38 0 110 184;
62.73 0 108 184; 20 0 106 184; 12.57 0 104 174; 4.5 0 98.2 174; 24.2 0 104 174; 16 0 85 138; 25 0 103 138; 51 0 90; 50.5 0 90;
36.375 0 90; 36.375 0 90; 13.5 0 90; 35 0 90 245; 24 0 87.2 112; 32 0 85 113
"""
DISCS = (
    (3, 15.119982018530925, 0.0, 0.0),
    (20, 6.909991782278354, 0.02499983979288977, 0.046999698810632776),
    (23, 6.929991758493341, 0.02499983979288977, 0.046999698810632776),
    (26, 6.94999173470833, 0.02499983979288977, 0.047999692402348366),
    (29, 6.979991699030812, 0.02499983979288977, 0.047999692402348366),
    (32, 6.939991746600836, 0.02499983979288977, 0.047999692402348366),
    (35, 6.959991722815824, 0.02499983979288977, 0.047999692402348366),
)
# By ross-rotordynamics 2.3.0: eigenvalues of K() and M() of its shaft and discs without bearings,
# Rotor.m, Rotor.CG, Rotor.Ip.
ROSS_HERTZ = [154.82772345, 343.69550132, 613.17852883, 1027.27555322, 1488.97306334, 1927.32702128]
ROSS_MASS = 246.87036435603625
ROSS_CENTRE = 0.8276413453580715
ROSS_POLAR = 0.9154643232219528
LEFT_OUT = ("SealElement_Seal 1", "kxx = replaced by magnets (BearingElement_7 and 1 more)")
# Two MagneticBearingElements as ROSS 2.3.0 saves them, a PID's and one of a transfer function, and
# their k_i and k_s there.
MAGNETIC = {
    "ag": 4e-4,
    "alpha": 0.39269908,
    "color": "#355d7a",
    "cxx": [-51893.07605779015, -35129.410792991446],
    "cyy": [-51893.07605779015, -35129.410792991446],
    "frequency": [1.0, 1.2067926406393286],
    "g0": 0.0005,
    "i0": 2.0,
    "k_amp": 1,
    "k_sense": 1,
    "kd_pid": 30.0,
    "ki_pid": 1000.0,
    "kp_pid": 30000.0,
    "kxx": [1390948.5904788515, 1390948.6637200648],
    "kyy": [1390948.5904788515, 1390948.6637200648],
    "mxx": [0, 0],
    "n": 7,
    "n_f": 10000,
    "nw": 120,
    "scale_factor": 1,
    "sensors_axis_rotation": 0.78539816,
    "tag": "AMB A",
}
ROSS_MAGNETS = ((53.49801653787705, 213992.0661515082), (55.7271005602886, 278635.50280144304))
# of what ross_text writes, loaded: a rotor without shear, and one with Hutchinson's coefficient
ROSS_SEAL_RIG = [550.12368284, 1342.33652743, 2481.90870117]
ROSS_BLOWER = [466.41408433, 922.54357405, 1968.07429245]


def compressor():
    """The compressor as ROSS saves it, as far as it is read."""
    document = {"ross_version": "2.0.0", "parameters": {}}
    steel = {"name": "steel", "rho": 7833.412, "E": 206842300000.0, "G_s": 82736940000.0}
    soft = {"name": "soft", "rho": 7833.412, "E": 6894.75, "G_s": 6894.75}
    for n, row in enumerate(COMPRESSOR.replace("\n", " ").strip().split(";")):
        length, *diameters = (round(float(word) / 1e3, 9) for word in row.split())
        for layer, (inner, outer) in enumerate(pairwise(diameters)):
            document[f"ShaftElement_{n}.{layer}"] = {
                "L": length,
                "idl": inner,
                "odl": outer,
                "idr": inner,
                "odr": outer,
                "n": n,
                "material": soft if layer else steel,
                "shear_effects": True,
                "rotary_inertia": True,
                "shear_method_calc": "cowper",
                "tag": f"{n}.{layer}",
            }
    for n, mass, diametral, polar in DISCS:
        document[f"DiskElement_Disk {n}"] = {
            "n": n,
            "m": mass,
            "Id": diametral,
            "Ip": polar,
            "tag": f"Disk {n}",
        }
    for n in (7, 48):
        document[f"BearingElement_{n}"] = {"n": n, "kxx": [1e6], "tag": str(n)}
    document["SealElement_Seal 1"] = {"n": 18, "kxx": [1e6], "tag": "Seal 1"}
    return document


def finite_elements(model):
    return finite_element_rotor(
        MachineDescription(
            model.name, model.shaft, (), (), discs=model.discs, beam_theory=model.beam_theory
        )
    )


def hertz(rotor, count):
    return free_bending_frequencies(rotor, count) / (2 * np.pi)


@pytest.mark.literature
@pytest.mark.parametrize("suffix", [".toml", ".json"])
def test_the_compressor_of_ross_bends_as_in_ross(tmp_path, suffix):
    path = tmp_path / f"compressor{suffix}"
    if suffix == ".json":
        path.write_text(json.dumps(compressor()), encoding="utf-8")
    else:
        lines = ['ross_version = "2.0.0"']
        for key, row in compressor().items():
            if isinstance(row, dict):
                cells = [
                    f"{name} = {json.dumps(value)}"
                    for name, value in row.items()
                    if name != "material"
                ]
                lines += [f'["{key}"]', *cells] if key != "parameters" else ["[parameters]"]
                if "material" in row:
                    lines += [
                        f'["{key}".material]',
                        *(
                            f"{name} = {json.dumps(value)}"
                            for name, value in row["material"].items()
                        ),
                    ]
        path.write_text("\n".join(lines), encoding="utf-8")
    model = read_rotor(path)
    rotor = finite_elements(model)
    np.testing.assert_allclose(hertz(rotor, 6), ROSS_HERTZ, rtol=1e-3)
    found = mass_properties(rotor)
    assert (found.mass, found.centre, found.polar_inertia) == pytest.approx(
        (ROSS_MASS, ROSS_CENTRE, ROSS_POLAR), rel=1e-6
    )
    assert model.bearings == pytest.approx((0.2355, 1.4255)) and model.left_out == LEFT_OUT
    assert "Seal 1" in model.assumed["seal"] and model.name == "compressor"


@pytest.mark.literature
def test_a_machine_goes_to_ross_and_back():
    machine = load_machine("seal-rig")
    text = ross_text(machine, {"A": (1e6, 100.0), "B": (2e6, 200.0)})
    document = tomllib.loads(text)
    back = rotor_of_ross(parse_ross(text, "there", ".toml"), "there")
    assert [document[f"BearingElement_{name}"]["kxx"] for name in "AB"] == [[1e6], [2e6]]
    np.testing.assert_allclose(
        hertz(finite_elements(back), 3), hertz(finite_element_rotor(machine), 3), rtol=1e-6
    )
    np.testing.assert_allclose(hertz(finite_element_rotor(machine), 3), ROSS_SEAL_RIG, rtol=1e-6)
    assert mass_properties(finite_elements(back)).mass == pytest.approx(
        mass_properties(finite_element_rotor(machine)).mass
    )


@pytest.mark.literature
def test_discs_and_bearings_go_to_ross_where_they_stand():
    """An impeller in the middle of an element stood 8 mm off, the bearings 15 mm."""
    machine = load_machine("overhung-blower")
    text = ross_text(machine, {bearing.name: (1e6, 100.0) for bearing in machine.bearings})
    document = tomllib.loads(text)
    back = rotor_of_ross(document, "there")
    assert back.discs[0].position == pytest.approx(0.035, abs=1e-12)
    assert back.bearings == pytest.approx((0.185, 0.525), abs=1e-12)
    assert off_nodes(machine) == {}
    ours = hertz(finite_element_rotor(machine), 3)
    np.testing.assert_allclose(hertz(finite_elements(back), 3), ours, rtol=1e-9)
    np.testing.assert_allclose(ours, ROSS_BLOWER, rtol=5e-4)
    # so near to another node that no element fits between: moved there, and said
    wheel = replace(machine.discs[0], position=0.08 + 5e-5)
    assert off_nodes(replace(machine, discs=(wheel,))) == {"impeller": pytest.approx(5e-5)}


def test_nothing_is_unread_in_a_model_that_says_no_more():
    assert rotor_of_ross(compressor(), "rotor").left_out == LEFT_OUT


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda d: d["ShaftElement_5.0"].update(axial_force=-3e4), "axial_force = -30000.0"),
        (lambda d: d["ShaftElement_5.0"].update(torque=5e3), "torque = 5000.0 (ShaftElement_5.0)"),
        (lambda d: d["ShaftElement_5.0"].update(alpha=8.0, beta=1e-3), "beta = 0.001"),
        (lambda d: d["ShaftElement_5.0"].update(gyroscopic=False), "gyroscopic = False"),
        (lambda d: d["ShaftElement_5.0"].update(shear_effects=False), "shear_effects = False"),
        (lambda d: d["ShaftElement_5.0"].update(rotary_inertia=False), "rotary_inertia = False"),
        (lambda d: d["ShaftElement_5.0"].update(of_next_year=3), "of_next_year = 3"),
        (lambda d: d["ShaftElement_5.0"]["material"].update(loss=0.1), "loss = 0.1"),
        (lambda d: d["ShaftElement_5.0"]["material"].update(G_s=8e9), "G_s = 8e+09: Poisson's"),
        (lambda d: d["parameters"].update(alpha=8.05), "alpha = 8.05 (the model)"),
        (
            lambda d: d["parameters"].update(modal_damping_ratio=[0.05]),
            "modal_damping_ratio = [0.0",
        ),
        (lambda d: d["DiskElement_Disk 3"].update(bow=1e-3), "bow = 0.001 (DiskElement_Disk 3)"),
        (
            lambda d: d.update({"PointMass_p": {"n": 3, "mx": 5.0, "my": 9.0}}),
            "my = 9.0 (PointMass",
        ),
    ],
)
def test_every_key_of_ross_that_is_not_read_is_named(change, words):
    document = copy.deepcopy(compressor())
    change(document)
    model = rotor_of_ross(document, "rotor")
    assert any(words in item for item in model.left_out) and words in model.assumed["rotor"]


def levitated():
    document = compressor()
    for n in (7, 48):
        del document[f"BearingElement_{n}"]
    gains = dict.fromkeys(("kp_pid", "ki_pid", "kd_pid"), 0)
    other = {**MAGNETIC, **gains, "n": 48, "g0": 0.0006, "i0": [3.0, 3.0], "tag": "AMB B"}
    return document | {"BearingElement_AMB A": MAGNETIC, "BearingElement_AMB B": other}


@pytest.mark.literature
def test_magnets_of_ross_are_taken_over(tmp_path):
    """They were read as springs, and every figure of theirs was dropped without a word."""
    path = tmp_path / "levitated.json"
    path.write_text(json.dumps(levitated()), encoding="utf-8")
    machine = amb.machine_from_ross(path, speed="6000 rpm")
    found = [linearised(bearing) for bearing in machine.bearings]
    for item, (k_i, k_s) in zip(found, ROSS_MAGNETS, strict=True):
        assert item.force_per_current == pytest.approx((k_i, k_i), rel=1e-12)
        assert item.negative_stiffness == pytest.approx((k_s, k_s), rel=1e-12)
    assert [item.bias_current for item in machine.bearings] == [2.0, 3.0]
    assert [item.gap for item in machine.bearings] == [0.0005, 0.0006]
    assert machine.bearings[0].angle == 0.78539816
    assert machine.bearings[0].max_force == pytest.approx(2 * 53.498, rel=1e-3)
    assumed = dict(machine.assumed)
    for words in (
        "kp_pid = 30000.0 (BearingElement_AMB A)",
        "n_f = 10000 (BearingElement_AMB A and 1 more)",
        "controller_transfer_function = not saved (BearingElement_AMB B)",
    ):
        assert words in assumed["rotor"]
    assert not {"bearing.geometry", "bearing.bias_current", "bearing.gap"} & assumed.keys()
    assert assumed["bearing.max_force"] == "all the current in one of two opposite coils"


def test_magnets_whose_axes_differ_are_named():
    document = levitated()
    document["BearingElement_AMB B"] |= {"i0": [3.0, 2.0]}
    model = rotor_of_ross(document, "rotor")
    assert len(model.magnets) == 1
    assert any("i0 = [3.0, 2.0] (BearingElement_AMB B)" in item for item in model.left_out)
    document["BearingElement_AMB A"] = {**MAGNETIC, "g0": 0.0}
    with pytest.raises(InvalidInput, match="g0, i0, ag and nw must be positive; correct"):
        rotor_of_ross(document, "rotor.toml")


class Rotor:
    """As a ross.Rotor: it has a tag, and saves itself."""

    tag = "my rotor"

    def __init__(self, document):
        self.document = document

    def save(self, file):
        machine = load_machine("seal-rig")
        springs = {bearing.name: (1e6, 100.0) for bearing in machine.bearings}
        file.write_text(self.document or ross_text(machine, springs), encoding="utf-8")


def test_a_rotor_of_ross_in_memory():
    machine = amb.machine_from_ross(Rotor(""), speed=1000.0, bearings=("100 mm", 0.5))
    rig = load_machine("seal-rig")
    assert (machine.name, machine.source) == ("my-rotor", "ROSS model (version 2.0.0)")
    assert [bearing.position for bearing in machine.bearings] == [0.1, 0.5]
    assert machine.operation.speed_range[1] == 1000.0
    assert [disc.mass for disc in machine.discs] == [disc.mass for disc in rig.discs]
    np.testing.assert_allclose(
        hertz(finite_elements(machine), 3), hertz(finite_element_rotor(rig), 3), rtol=1e-6
    )
    assert "cxx, cyy, kxx, kyy = replaced" in dict(machine.assumed)["rotor"].replace(
        "kxx, kyy, cxx, cyy", "cxx, cyy, kxx, kyy"
    )
    with pytest.raises(InvalidInput, match="the rotor: it has no ShaftElement, so that"):
        amb.machine_from_ross(Rotor("[parameters]\n"))
    with pytest.raises(InvalidInput, match=r"must be a ross\.Rotor; give one, or the path"):
        amb.machine_from_ross(7)


def test_every_element_that_is_left_out_is_named():
    """From the ninth on they were a count."""
    document = compressor()
    document |= {f"SealElement_{i}": {"n": i, "kxx": [1e6]} for i in range(20)}
    document["ShaftElement_5.0"] |= {f"key_{i}": 1.0 for i in range(20)}
    assumed = rotor_of_ross(document, "rotor").assumed
    assert all(f"SealElement_{i}" in assumed["seal"] for i in range(20))
    assert all(f"key_{i} = 1.0" in assumed["rotor"] for i in range(20))
    document["ShaftElement_5.0"] |= {f"long_key_{i}": 1.0 for i in range(1000)}
    model = rotor_of_ross(document, "rotor")
    assert len(model.assumed["rotor"]) < 6000 and model.assumed["rotor"].endswith("... and more")
    assert len(model.left_out) > 1000


def test_conical_elements_and_two_stiff_layers_are_said():
    document = compressor()
    document["ShaftElement_8.0"] |= {"odr": 0.105}
    document["ShaftElement_9.1"]["material"] = document["ShaftElement_9.0"]["material"]
    model = rotor_of_ross(document, "rotor")
    assert {"shaft.outer_diameter", "shaft.material"} <= set(model.assumed)
    widened = next(item for item in model.shaft if item.start == pytest.approx(0.2865))
    assert widened.outer_diameter == pytest.approx(0.104)


def test_a_cone_goes_to_ross_and_back():
    """A single layer stays a cone; written as a cylinder of its left end, it lost a tenth of this
    rotor's mass.
    """
    document = compressor()
    document["ShaftElement_3.0"] |= {"odr": 0.12}
    cone = next(item for item in rotor_of_ross(document, "rotor").shaft if item.conical)
    assert (cone.outer_diameter, cone.end_outer_diameter) == (0.08, 0.12)
    machine = load_machine("seal-rig")
    shaft = tuple(
        replace(s, end_outer_diameter=1.4 * s.outer_diameter) if i % 2 else s
        for i, s in enumerate(machine.shaft)
    )
    tapered = replace(machine, shaft=shaft)
    back = rotor_of_ross(
        tomllib.loads(ross_text(tapered, {"A": (1e6, 100.0), "B": (2e6, 200.0)})), "there"
    )
    ours, theirs = finite_element_rotor(tapered), finite_elements(back)
    assert sum(item.conical for item in back.shaft) == sum(
        piece.section.conical for piece in mesh(shaft, stations(tapered))
    )
    assert mass_properties(theirs).mass == pytest.approx(mass_properties(ours).mass)
    np.testing.assert_allclose(hertz(theirs, 3), hertz(ours, 3), rtol=1e-6)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda d: d.pop("ShaftElement_5.0"), "the shaft has a gap"),
        (lambda d: d["ShaftElement_5.0"].update(L="x"), "a finite number"),
        (lambda d: d["ShaftElement_5.0"].update(L=float("nan")), "a finite number"),
        (lambda d: d["ShaftElement_5.0"].update(L=-1.0), "must be positive"),
        (lambda d: d["ShaftElement_5.0"].pop("material"), "no material"),
        (lambda d: d["ShaftElement_9.1"].update(L=1.0), "different lengths"),
        (lambda d: d["DiskElement_Disk 3"].update(m=None), "a finite number"),
        (lambda d: [d.pop(key) for key in list(d) if key.startswith("Shaft")], "no ShaftElement"),
    ],
)
def test_models_that_are_none_are_refused(change, words):
    document = compressor()
    change(document)
    with pytest.raises(InvalidInput, match=words) as error:
        rotor_of_ross(document, "rotor.toml")
    assert (
        "\n" not in str(error.value)
        and str(error.value).startswith("rotor.toml")
        and "; " in str(error.value)
    )


TABLE = """length [mm];od [mm];id [mm];E [GPa];rho [kg/m^3];disc mass [kg];disc Ip [kg m^2];disc Id [kg m^2];bearing
75,5;40;0;210;7850;;;;
225;40;0;210;7850;;;;x
225;40;0;210;7850;8;0,0625;0,03125;
75;40;10;210;7850;;;;x
0;;;;;1,5;0,001;0;
"""


def test_a_spreadsheet_with_decimal_commas_becomes_a_rotor():
    model = rotor_of_stations(TABLE, "table.csv")
    assert [(item.length, item.outer_diameter) for item in model.shaft] == [
        (0.0755, 0.04),
        (0.45, 0.04),
        (0.075, 0.04),
    ]
    assert (
        model.shaft[-1].inner_diameter == pytest.approx(0.01)
        and model.shaft[0].material.youngs_modulus == 2.1e11
    )
    assert model.bearings == pytest.approx((0.0755, 0.5255)) and [
        disc.mass for disc in model.discs
    ] == [8.0, 1.5]
    assert model.discs[-1].position == pytest.approx(0.6005)
    assert (
        "steel"
        in rotor_of_stations("L [m],diameter [m]\n0.5,0.05\n", "t").assumed["shaft.material"]
    )


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "a row of names .* a table of stations"),
        ("length [mm];od [mm]\n", "a row of names"),
        ("time;torque\n1;2\n", "'time' is unknown; .* a table of stations"),
        ("length [mm];width\n1;2\n", "unknown"),
        ("length [mm];id [mm]\n1;2\n", '"od" is missing'),
        ("length;od [mm]\n100;40\n", "has no unit"),
        ("length [kg];od [mm]\n100;40\n", "length is"),
        ("length [mm];od [mm]\nabc;40\n", "must be a number"),
        ("length [mm];od [mm]\nnan;40\n", "but must be"),
        ("length [mm];od [mm]\n-5;40\n", "must be positive"),
        ("length [mm];od [mm]\n5;\n", "must be positive"),
        ("length [mm];od [mm]\n5;1;2\n", "3 cells"),
        ("length [mm];od [mm];od [mm]\n5;1;2\n", "twice"),
        ("length [mm];od [mm]\n0;1\n", "no row has a length"),
        ("length [mm];od [mm];id [mm]\n5;1\n", "line 2 has 2 cells, but the header names 3"),
        ("length [mm];od [mm]\n75,5;40\n1.225;40\n", "'75,5' in line 2. and points .'1.225'"),
        ("length [mm];od [mm]\n75;40\n1.225;40\n", '"1.225" in line 3 may be 1225'),
        ("length [mm]\tod [mm]\n75\t40\n1,225\t40\n", '"1,225" in line 3 may be 1225'),
        ("length [mm];od [mm]\n1.225,5;40\n", "decimal commas"),
    ],
)
def test_tables_that_are_none_are_refused(text, words):
    with pytest.raises(InvalidInput, match=words) as error:
        rotor_of_stations(text, "table.csv")
    assert "\n" not in str(error.value) and str(error.value).startswith("table.csv")
