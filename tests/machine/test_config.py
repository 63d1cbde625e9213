"""Machine files: what is read, that writing and reading give the same machine, and that writing is
all or nothing.
"""

import json
import math
import os
import re
import subprocess
import sys
import time
import tomllib
from dataclasses import fields, is_dataclass, replace
from pathlib import Path

import jsonschema
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings, strategies as st

from ambrose.core.checks import InvalidInput
from ambrose.machine import description as d, thrust as t
from ambrose.machine.file import update
from ambrose.machine.file.tables import Table, machine_file, machine_schema, table_below
from ambrose.machine.file.toml import (
    bundled_machines,
    dumps_machine,
    load_machine,
    loads_machine,
    machine_hash,
)
from ambrose.machine.file.update import save_machine
from ambrose.machine.machine import Machine
from ambrose.machine.part import (
    CONTROLLER_COORDINATES,
    FREQUENCY_DEPENDENCE,
    MODES,
    SEAL_AXES,
    SEAL_COEFFICIENTS,
    SECTIONS,
    BendingMode,
    CasingMode,
    ChainElement,
    Channel,
    CoastDown,
    Disc,
    GasSealGeometry,
    Magnet,
    Material,
    Notch,
    PidSettings,
    Runout,
    Seal,
    SealTable,
    Section,
    Sensor,
    ShaftSection,
    Support,
    Synchronous,
    TouchdownLimits,
    TouchdownMount,
    TouchdownRace,
)
from ambrose.model.effects.stations import Clearance, JournalBearing, Load, Probe, Stage
from physical_numbers import physical

HERE = Path(__file__).parent
ROOT = HERE.parents[1]
SMALL = (HERE / "small.toml").read_text()


def test_every_value_of_the_small_machine():
    """Every key in every table, converted by hand."""
    deg = math.pi / 180
    hz = 2 * math.pi
    rpm = math.pi / 30
    titanium = Material(4430.0, 114e9, 0.34)
    rows = (d.BiasPoint(6.0, (220.0, 220.0), (2.5e6, 2.6e6)),)
    limits = {"gap": 0.5e-3, "touchdown_gap": 250e-6, "max_current": 4.0, "max_force": 1500.0}
    iron, ring = d.MagnetIron(40.0, 1.6, 50e-6), TouchdownRace(0.3, 7e-4, 150e6, 2e3)
    ring = replace(ring, preload=200.0, element_damping=2e3, pitch_diameter=0.095)
    ring = replace(ring, friction_moment=0.02, load_friction=0.002, static_capacity=40e3)
    ring = replace(ring, specific_heat=470.0, temperature=313.15)
    mount = TouchdownMount(0.5, 20e6, 8e3, 1e-4, 500e6)
    cost = TouchdownLimits(10, 12e3, 423.15, 20e3, 2.0)
    contact = d.Touchdown(90e6, 5e3, 0.15, 0.04, 0.02, 0.25, 0.2, ring, mount, cost)
    rig = {
        "iron": iron,
        "touchdown": contact,
        "cross_coupling": 0.02,
        "magnetic_offset": (20e-6, 0.0),
    }
    rig["coefficients_at"] = "static-load"
    rig["magnet"] = Magnet(
        kind="homopolar",
        turns=60.0,
        pole_area=500e-6,
        gap=0.5e-3,
        poles=6,
        leakage=0.08,
        iron_path=0.08,
        iron_permeability=2500.0,
        iron_flux_density=2.0,
        journal_radius=0.04,
        back_iron_area=600e-6,
        bias="permanent-magnet",
        remanence=1.1,
        magnet_permeability=1.06,
        magnet_length=0.012,
        magnet_area=900e-6,
    )
    table = SealTable(
        (("pressure", (0.0, 1e5, 2e5)), ("frequency", (0.0, 200 * hz))),
        (("k", ((0.0, 0.0), (1e6, 1.1e6), (2e6, 2.2e6))),),
    )
    geometry = GasSealGeometry(
        length=0.04,
        diameter=0.08,
        inlet_clearance=0.2e-3,
        exit_clearance=0.19e-3,
        temperature=293.15,
        exit_pressure=10e5,
        hole_depth=3e-3,
        hole_area_ratio=0.68,
        stator_friction=(0.02, 0.0),
        rotor_friction=(0.079, -0.25),
        inlet_loss=0.2,
        exit_recovery=0.1,
        preswirl=0.3,
        speed=9000 * rpm,
        max_frequency=1000 * hz,
        gas_constant=296.8,
        viscosity=17.6e-6,
        compressibility=0.99,
    )
    eye, zero = (tuple(map(tuple, rows.tolist())) for rows in (np.eye(4), np.zeros((4, 4))))
    expected = Machine(
        name="small",
        description="Two bearings, a disc, a seal and a coupling",
        source="made up",
        beam_theory="timoshenko",
        modal_damping=0.01,
        rotating_share=0.2,
        gravity_direction=-90 * deg,
        assumed=(
            ("bearing.A.gap", "made up"),
            ("seal coefficients", "made up"),
            ("seal.center.scales_with_pressure", "K is made up as well"),
        ),
        shaft=(
            ShaftSection(0.0, 0.2, 0.06, 0.02, None, 4, Material(), "left end", 0.064, 0.024),
            ShaftSection(0.2, 0.4, 0.08, 0.0, 0.1, 8, titanium),
        ),
        discs=(Disc("wheel", 0.02, 3.0, 0.02, 0.011),),
        bearings=(
            d.MagneticBearing(
                "A",
                0.15,
                4.0,
                45 * deg,
                (150.0, 160.0),
                (1.2e6, 1.2e6),
                None,
                rows,
                **limits,
                **rig,
            ),
            d.MagneticBearing(
                "B", 0.5, 4.0, geometry=d.MagnetGeometry(36.0, 480e-6, 0.5e-3, 22.5 * deg)
            ),
        ),
        sensors=(
            Sensor(
                "A",
                0.12,
                (1.0, 0.98),
                1e4 * hz,
                0.2e-6,
                (5e-6, 0.0),
                0.1e-6,
                (Runout(2, 2e-6, 25 * deg),),
                35 * deg,
                2.0,
            ),
            Sensor("B", 0.53),
        ),
        amplifier=d.Amplifier(
            "twice-first", 1500 * hz, 3000 * hz, max_voltage=150.0, inductance=20e-3
        ),
        seals=(
            Seal("center", 0.3, 0.4e6, 0.0, 2e3, 0.0, 0.1, 2e5, ("C",), table),
            Seal(
                "balance",
                0.35,
                reference_pressure=2e5,
                geometry=geometry,
                frequency_dependence="states",
                poles=2,
            ),
        ),
        couplings=(d.Coupling("coupling", 0.0, (0.40e6, 0.42e6), (10.0, 10.0), 45 * deg),),
        effects=(
            JournalBearing(
                "steady",
                0.3,
                (40e6, 50e6),
                (80e6, 90e6),
                (200e3, 160e3),
                (300e3, 200e3),
                (0.0, 9000 * rpm),
                (10e6, 30e6),
                (-20e6, -40e6),
                (-20e3, 0.0),
                (-20e3, 0.0),
            ),
            Stage("expander", 0.25, 40e3, 9000 * rpm, 0.22, 0.009, 1.3, "radial"),
            Clearance("eye", 0.24, 0.4e-3, 0.7),
            Probe("VE1", 0.06, 45 * deg),
            Load("surge", 0.25, "surge", 200.0, None, 8 * hz, 90 * deg),
            thrust_bearing(),
        ),
        supports=(
            Support(
                "A", (300.0, 300.0), (80e6, 120e6), (40e3, 40e3), 10 * deg, "ground", ("center",)
            ),
        ),
        casing_modes=(
            CasingMode(140 * hz, 900.0, ("A", "balance"), (1.0, 0.7), (0.0, 0.1), 0.02, "ground"),
        ),
        bending_modes=(BendingMode(1, 630 * hz, 0.008),),
        chain=(
            ChainElement("filter", "anti-alias", None, 12e3 * hz, 4),
            ChainElement("program", "computation", 60e-6),
        ),
        controller=PidSettings(
            (18e3,),
            0.2,
            3.5e-3,
            0.1,
            (Notch(550 * hz, 0.5, 0.05),),
            (100 * hz, 500 * hz),
            2e3 * hz,
            0.7,
            "tilt-translate",
            1.2,
            1e-4,
            1e-4,
            (
                Channel(
                    ("tilt_x", "tilt_y"),
                    22e3,
                    (
                        Section("pid", 0.2, 3e-3, 0.1),
                        Section(
                            "notch",
                            zero_frequency=550 * hz,
                            zero_damping=0.05,
                            pole_frequency=580 * hz,
                            pole_damping=0.4,
                        ),
                        Section("phase-bump", frequency=210 * hz, phase=20 * deg, damping=0.3),
                        Section("sos", numerator=(1.0, 4e3), denominator=(1.0, 8e3)),
                    ),
                ),
            ),
            (
                Synchronous(
                    "current-free",
                    (6000 * rpm, 12000 * rpm),
                    0.5,
                    (6000 * rpm, 12000 * rpm),
                    (eye, eye),
                    (zero, zero),
                    None,
                    "axes",
                    1,
                    hz,
                    20e-6,
                    0.4,
                    0.1,
                    0.01,
                ),
                Synchronous(
                    "vibration-free",
                    (6000 * rpm, 12000 * rpm),
                    1.0,
                    (6000 * rpm, 12000 * rpm),
                    phase=(30 * deg, 40 * deg),
                    update="turn",
                    harmonic=2,
                ),
            ),
            10000.1,
        ),
        operation=d.Operation(
            (
                d.OperatingPoint(6000 * rpm, 2e5, 4.0, 40 * hz, "nominal"),
                d.OperatingPoint(label="standstill"),
            ),
            (0.0, 12000 * rpm),
            "nominal",
            (d.OperatingRange("running", (0.0, 3000 * rpm), (1e5, 1e5), 3.0),),
            20e5,
        ),
        tolerances=(
            d.Tolerance("seal.center.K", absolute=0.1e6),
            d.Tolerance("bearing.A.negative_stiffness.zeta", relative=0.2, around=("standstill",)),
        ),
        coast_down=CoastDown(2.0, 0.05, 0.4, 9000 * rpm),
        requirements=d.Requirements(
            3.0,
            1e-6,
            2.5e-3,
            200 * hz,
            8e-6,
            200 * hz,
            0.05,
            2.0,
            30 * deg,
            0.1,
            0.002,
            4.0,
            9e4,
            1500 * hz,
            (5000 * rpm, 7000 * rpm),
        ),
        weights=d.DesignWeights(20e-6, 1.0, 2 * hz, 0.3, 2.5, 0.002, 1400 * hz, 2, 20.0, 0.5, 2.0),
    )
    ours, theirs = flat(loads_machine(SMALL)), flat(expected)
    assert list(ours) == list(theirs)
    for path, value in theirs.items():
        assert ours[path] == (
            pytest.approx(value, rel=1e-15) if isinstance(value, float) else value
        ), path


def thrust_bearing():
    """The thrust bearing of small.toml."""
    hz, rings = 2 * math.pi, (0.033, 0.04)
    return t.ThrustBearing(
        "thrust",
        0.08,
        0.06,
        0.012,
        (0.5e-3, 0.52e-3),
        (3.0, 3.2),
        (
            t.ThrustStator(84.0, rings, (0.054, 0.061), 0.015, 9e-3),
            t.ThrustStator(80.0, rings, (0.054, 0.060), 0.015, 0.01),
        ),
        t.AxialSensor(0.59, 0.98, 8e3 * hz, 0.3e-6, 0.1e-6, (-20e-6, 40e-6), expansion=1.1e-5),
        13.02e-3,
        "solid",
        4e6,
        600.0,
        20 * hz,
        0.8,
        1.6,
        3.0,
        400.0,
        (0.25e-3, 0.25e-3),
        90e6,
        5e3,
        20e3,
        5.0,
        1.02,
        0.98,
        0.05,
        1e3 * hz,
        100.0,
        0.03,
        (t.AxialLoad("nominal", 120.0),),
        t.AxialController(22e3, 0.06, 4e-3, 0.05, 3e3 * hz, 2e-4, 2e-4),
        t.AxialWeights(40e-6, 1.0, 2 * hz, 0.2),
        t.AxialRequirements(2.8, 0.8e-6, 0.08),
        (
            d.Tolerance(
                "thrust_bearing.thrust.force_per_current", relative=0.1, around=("nominal",)
            ),
            d.Tolerance("thrust_bearing.thrust.negative_stiffness", absolute=50e3),
        ),
    )


def flat(thing, path="") -> dict:
    """A noun as path -> value, numbers at the leaves."""
    if is_dataclass(thing):
        named = {field.name: getattr(thing, field.name) for field in fields(thing) if field.compare}
    elif isinstance(thing, tuple):
        named = dict(enumerate(thing))
    else:
        return {path: thing}
    return {
        key: value
        for name, part in named.items()
        for key, value in flat(part, f"{path}.{name}").items()
    }


def test_small_machine_has_every_key_of_every_table():
    """So that the tests above and below leave nothing out; the alternatives to a key are the
    exceptions.
    """
    known = set(keys_of(machine_file()))
    written = set(keys_in(tomllib.loads(SMALL), machine_file()))
    alternatives = {
        *("machine.rayleigh_alpha", "machine.rayleigh_beta", "machine.loss_factor"),
        *(
            "bearing.magnet.polarity",
            "bearing.magnet.bias_turns",
            "shaft.start",
            "amplifier.natural_frequency",
            "amplifier.damping",
            "amplifier.resistance",
            "load.duration",
            "seal.c",
            "seal.k",
            "seal.table.axes",
        ),
        *(
            "seal.table.speed",
            "seal.table.K",
            "seal.table.C",
            "seal.table.c",
            "seal.table.M",
            "seal.geometry.inlet_pressure",
            "thrust_bearing.sensor.temperature_rise",
        ),
        # tests/model/effects/test_measured_rotor.py
        *(f"measured_rotor.{name}" for name in ("mass", "centre", "diametral_inertia")),
        *(f"measured_rotor.{name}" for name in ("polar_inertia", "speed", "places")),
        *("bending_mode.shape", "bending_mode.gyroscopic"),
    }
    assert known - written == alternatives


def keys_of(model: type[Table], path: str = "") -> list[str]:
    keys = []
    for name, field in model.model_fields.items():
        below = table_below(model, name)
        here = f"{path}{field.alias or name}"
        keys += keys_of(below, f"{here}.") if below else [here]
    return keys


def keys_in(document: dict, model: type[Table], path: str = "") -> list[str]:
    keys = []
    for name, value in document.items():
        below = table_below(model, name) if name in model.model_fields else None
        if below is None:
            keys.append(f"{path}{name}")
            continue
        entries = (
            value
            if isinstance(value, list)
            else list(value.values())
            if name == "material"
            else [value]
        )
        keys += [key for entry in entries for key in keys_in(entry, below, f"{path}{name}.")]
    return keys


def test_start_defaults_to_the_end_of_the_previous_section():
    given = loads_machine(SMALL.replace("length = 0.4", 'length = 0.4\nstart = "200 mm"'))
    assert given == loads_machine(SMALL)


def test_axes_of_a_seal_table_in_another_order():
    swapped = SMALL.replace("[seal.table]", '[seal.table]\naxes = ["frequency", "pressure"]')
    swapped = swapped.replace(
        'k = [[0, 0], ["1 N/um", 1.1e6], [2e6, 2.2e6]]', "k = [[0, 1e6, 2e6], [0, 1.1e6, 2.2e6]]"
    )
    table = loads_machine(swapped).seals[0].table
    assert [axis for axis, _ in table.axes] == ["frequency", "pressure"]
    assert np.array_equal(
        np.array(dict(table.values)["k"]).T, dict(loads_machine(SMALL).seals[0].table.values)["k"]
    )
    assert loads_machine(dumps_machine(loads_machine(swapped))) == loads_machine(swapped)


def test_absolute_tolerance_is_in_the_unit_of_its_parameter():
    for path, text, value in (
        ("seal.center.C", "2 kN s/m", 2000.0),
        ("coupling.coupling.stiffness", "2 N/um", 2e6),
        ("bearing.A.force_per_current", "5 N/A", 5.0),
        ("amplifier.bandwidth", "100 Hz", 200 * math.pi),
        ("coupling.coupling.damping.eta", 3, 3.0),
    ):
        written = SMALL.replace('"seal.center.K"', f'"{path}"').replace(
            '"0.1 N/um"', json.dumps(text)
        )
        assert loads_machine(written).tolerances[0].absolute == pytest.approx(value, rel=1e-15)


class TestBundled:
    @pytest.mark.parametrize("name", bundled_machines())
    def test_loads_by_name_and_by_path(self, name):
        machine = load_machine(name)
        assert machine == load_machine(bundled_machines()[name])
        assert machine == load_machine(str(bundled_machines()[name]))
        assert machine.name == name
        assert machine.description
        assert machine.source
        assert machine.assumed

    def test_all_are_valid_and_named_as_their_file(self):
        for name in bundled_machines():
            assert load_machine(name).name == name

    def test_a_file_is_found_before_a_name_only_with_its_suffix(self, tmp_path, monkeypatch):
        monkeypatch.chdir(tmp_path)
        Path("seal-rig.toml").write_text(SMALL)
        assert load_machine("seal-rig.toml").name == "small"
        assert load_machine("seal-rig").name == "seal-rig"


class TestRoundTrip:
    @pytest.mark.parametrize("name", [*bundled_machines(), HERE / "small.toml"], ids=str)
    def test_files(self, name, tmp_path):
        machine = load_machine(name)
        again = load_machine(save_machine(machine, tmp_path / "again.toml"))
        assert again == machine
        assert machine_hash(again) == machine_hash(machine)
        assert dumps_machine(again) == dumps_machine(machine)

    def test_names_of_materials_survive(self):
        again = loads_machine(dumps_machine(loads_machine(SMALL)))
        assert again.shaft[1].material.name == "titanium"

    def test_different_materials_of_one_name_stay_apart(self):
        machine = loads_machine(SMALL)
        a, b = Material(8000.0, name="x"), Material(7000.0, name="x")
        machine = replace(
            machine,
            shaft=tuple(replace(s, material=m) for s, m in zip(machine.shaft, (a, b), strict=True)),
        )
        assert loads_machine(dumps_machine(machine)) == machine

    def test_numbers_of_other_types(self):
        machine = loads_machine(SMALL)
        odd = replace(
            machine, discs=(Disc("wheel", np.float64(0.02), 3, np.float32(0.5), -0.0 + 0.25),)
        )
        again = loads_machine(dumps_machine(odd))
        assert again == odd
        assert machine_hash(again) == machine_hash(odd)

    def test_nothing_but_si_numbers_is_written(self):
        document = tomllib.loads(dumps_machine(loads_machine(SMALL)))
        texts = [
            value
            for value in leaves({k: v for k, v in document.items() if k != "machine"})
            if isinstance(value, str)
        ]
        assert not [text for text in texts if re.match(r"[-\d.]", text)]
        assert document["shaft"][1]["length"] == 0.4


def leaves(value):
    if isinstance(value, dict):
        value = list(value.values())
    return [leaf for part in value for leaf in leaves(part)] if isinstance(value, list) else [value]


positive = st.floats(1e-6, 1e9, allow_subnormal=False)
ratio = st.floats(1e-3, 0.9)
signed = physical(-1e9, 1e9)
angle = physical(-7, 7)
text = st.text(st.characters(exclude_categories=["Cs"]), max_size=20)
line = st.text(st.characters(exclude_categories=["Cs", "Cc", "Zl", "Zp"]), max_size=20).map(
    str.strip
)
pair = st.tuples(positive, positive)
signed_pair = st.tuples(signed, signed)


def maybe(strategy):
    return st.none() | strategy


def ascending(n):
    return st.lists(positive, min_size=n, max_size=n, unique=True).map(sorted).map(tuple)


COIL = {"current-loop": ("inductance", "resistance")}


@st.composite
def shafts(draw):
    sections, end = [], 0.0
    for _ in range(draw(st.integers(1, 5))):
        length, bore = draw(st.floats(1e-3, 10)), draw(physical(0, 1))
        outer = bore + draw(st.floats(1e-3, 1))
        mass = draw(maybe(st.just(outer + 0.1)))
        material = Material(draw(positive), draw(positive), draw(physical(0, 0.49)), draw(text))
        material = draw(st.sampled_from([Material(), material]))
        sections.append(
            ShaftSection(
                end, length, outer, bore, mass, draw(st.integers(1, 80)), material, draw(text)
            )
        )
        end += length
    return tuple(sections)


@st.composite
def magnets(draw):
    sizes = {key: draw(positive) for key in ("turns", "pole_area", "gap", "leakage")}
    if draw(st.booleans()):
        poles = draw(st.sampled_from([None, 8, 12, 16]))
        polarity = draw(st.sampled_from(["NSNS", "NNSS"]))
        return Magnet("heteropolar", **sizes, poles=poles, polarity=polarity)
    if draw(st.booleans()):
        return Magnet("homopolar", **sizes, bias_turns=draw(positive))
    permanent = {key: draw(positive) for key in ("magnet_length", "magnet_area")}
    permanent["remanence"] = draw(physical(0.1, 1.9))
    return Magnet("homopolar", **sizes, bias="permanent-magnet", **permanent)


@st.composite
def bearings(draw, name, place):
    geometry = d.MagnetGeometry(
        draw(positive), draw(positive), draw(positive), draw(physical(0, 1.5))
    )
    rows = tuple(
        d.BiasPoint(i, draw(pair), draw(pair))
        for i in draw(st.lists(positive, max_size=3, unique=True))
    )
    magnet = draw(maybe(magnets()))
    given = draw(st.booleans())
    if magnet is not None and not given:
        return d.MagneticBearing(name, draw(place), draw(positive), draw(angle), magnet=magnet)
    return d.MagneticBearing(
        name,
        draw(place),
        draw(positive),
        draw(angle),
        draw(pair) if given else None,
        draw(pair) if given else None,
        draw(maybe(st.just(geometry))) if given else geometry,
        rows,
        draw(maybe(st.just(2.0))),
        draw(maybe(st.just(1.0))),
        draw(maybe(positive)),
        draw(maybe(positive)),
    )


@st.composite
def sections(draw):
    kind = draw(st.sampled_from(list(SECTIONS)))
    if kind == "sos":
        return Section(kind, numerator=draw(pair), denominator=(draw(positive), *draw(pair)))
    values = {key: draw(positive) for key in SECTIONS[kind]}
    return Section(
        kind, **{key: min(value, 3.0) if key == "phase" else value for key, value in values.items()}
    )


@st.composite
def gas_seals(draw):
    diameter, share = 2.0 + draw(positive), physical(0, 1)  # no shaft drawn here is larger
    clearance = st.floats(0.001, 0.04).map(lambda part: part * diameter)
    one = {draw(st.sampled_from(["exit_pressure", "inlet_pressure"])): draw(positive)}
    wall = st.tuples(positive, physical(-1, 1))
    return GasSealGeometry(
        draw(positive),
        diameter,
        draw(clearance),
        draw(clearance),
        draw(positive),
        **one,
        hole_depth=draw(share),
        hole_area_ratio=draw(share),
        stator_friction=draw(wall),
        rotor_friction=draw(wall),
        inlet_loss=draw(share),
        exit_recovery=draw(share),
        preswirl=draw(physical(-2, 2)),
        speed=draw(st.none() | positive),
        max_frequency=draw(positive),
        gas_constant=draw(positive),
        viscosity=draw(st.none() | positive),
    )


@st.composite
def seals(draw, name, place):
    if draw(st.booleans()):
        mode, poles = draw(st.sampled_from(FREQUENCY_DEPENDENCE)), draw(st.integers(1, 12))
        return Seal(
            name,
            draw(place),
            M=draw(signed),
            reference_pressure=draw(positive),
            geometry=draw(gas_seals()),
            frequency_dependence=mode,
            poles=poles,
        )
    axes = draw(st.lists(st.sampled_from(SEAL_AXES), max_size=3, unique=True))
    names = (
        draw(st.lists(st.sampled_from(SEAL_COEFFICIENTS), min_size=1, unique=True)) if axes else []
    )
    table = None
    if axes:
        grids = tuple((axis, draw(ascending(draw(st.integers(1, 3))))) for axis in axes)

        def nested(sizes):
            return tuple(nested(sizes[1:]) for _ in range(sizes[0])) if sizes else draw(signed)

        sizes = [len(grid) for _, grid in grids]
        table = SealTable(grids, tuple((n, nested(sizes)) for n in SEAL_COEFFICIENTS if n in names))
    constants = {n: draw(signed) for n in SEAL_COEFFICIENTS if n not in names}
    scaled = tuple(draw(st.lists(st.sampled_from(SEAL_COEFFICIENTS), unique=True)))
    scaled = tuple(n for n in scaled if not ("pressure" in axes and n in names))
    return Seal(
        name,
        draw(place),
        **constants,
        reference_pressure=draw(positive),
        scales_with_pressure=scaled,
        table=table,
    )


@st.composite
def machines(draw):
    shaft = draw(shafts())
    place = physical(0, shaft[-1].start + shaft[-1].length)
    couplings = tuple(
        d.Coupling(f"coupling{i}", draw(place), draw(pair), draw(pair), draw(angle))
        for i in range(draw(st.integers(0, 2)))
    )
    order = draw(st.sampled_from(sorted(d.AMPLIFIER_PARAMETERS)))
    notches = tuple(
        Notch(draw(positive), draw(positive), draw(positive))
        for _ in range(draw(st.integers(0, 2)))
    )
    points = tuple(
        d.OperatingPoint(
            draw(positive),
            draw(positive),
            draw(maybe(positive)),
            draw(maybe(positive)),
            f"point {i}",
        )
        for i in range(draw(st.integers(1, 3)))
    )
    low, high = sorted((draw(positive), draw(positive)))
    areas = (
        (d.OperatingRange("running", (0.0, high), (low, high), draw(maybe(positive))),)
        if draw(st.booleans())
        else ()
    )
    tolerances = [
        d.Tolerance(
            "bearing.A.force_per_current",
            relative=draw(ratio),
            around=draw(st.sampled_from([(), ("point 0",)])),
        ),
        d.Tolerance("seal.seal.k_xy", absolute=draw(positive)),
    ]
    sample_time = draw(maybe(positive))
    samples = None if sample_time is None else draw(maybe(st.integers(0, 5)))
    coordinates = draw(st.sampled_from(CONTROLLER_COORDINATES))
    names = (
        MODES if coordinates == "tilt-translate" else ("A_zeta", "A_eta", "B-2__zeta", "B-2__eta")
    )
    chains = draw(st.lists(st.sampled_from(names[1:]), max_size=3, unique=True))
    channels = tuple(
        Channel((name,), draw(positive), draw(st.lists(sections(), max_size=3).map(tuple)))
        for name in chains
    )
    gains = st.sampled_from([(1,)] if channels else [(1,), (4,)])
    controller = PidSettings(
        tuple(draw(gains.flatmap(lambda n: st.tuples(*[positive] * n[0])))),
        draw(maybe(positive)),
        draw(maybe(positive)),
        draw(positive),
        notches,
        draw(maybe(pair)),
        draw(maybe(positive)),
        draw(positive),
        coordinates,
        draw(positive),
        sample_time,
        None if samples is None else samples * sample_time,
        channels,
    )
    demands = {field.name: draw(maybe(st.floats(1, 3))) for field in fields(d.Requirements)}
    demands["running_speeds"] = draw(maybe(st.just((0.5 * points[0].speed, 2 * points[0].speed))))
    demands["roll_off"] = None if demands["control_gain"] is None else demands["roll_off"]
    crossover = draw(maybe(positive))
    limit = None if crossover is None else draw(maybe(st.floats(2, 50)))
    weights = d.DesignWeights(
        draw(positive),
        draw(positive),
        draw(positive),
        draw(ratio),
        draw(st.floats(1.1, 9)),
        draw(ratio),
        crossover,
        draw(st.integers(1, 8)),
        limit,
        draw(positive),
        draw(positive),
    )
    return Machine(
        name="m" + draw(line),
        shaft=shaft,
        bearings=(draw(bearings("A", place)), draw(bearings("B-2_", place))),
        sensors=tuple(
            Sensor(name, draw(place), draw(pair), draw(maybe(positive))) for name in ("A", "B-2_")
        ),
        amplifier=d.Amplifier(
            order,
            **{
                key: draw(positive)
                for key in (*d.AMPLIFIER_PARAMETERS[order], *COIL.get(order, ()))
            },
        ),
        discs=tuple(
            Disc(f"disc{i}", draw(place), draw(positive), 1.5 * i, 1.0 * i)
            for i in range(draw(st.integers(0, 2)))
        ),
        seals=(draw(seals("seal", place)),),
        couplings=couplings,
        bending_modes=draw(
            st.sampled_from([(), (BendingMode(1, 1234.5), BendingMode(2, None, 0.002))])
        ),
        controller=draw(maybe(st.just(controller))),
        operation=d.Operation(points, tuple(sorted(draw(pair))), "", areas, draw(maybe(positive))),
        tolerances=tuple(tolerances[: draw(st.integers(0, 2))]),
        requirements=d.Requirements(**demands),
        weights=draw(maybe(st.just(weights))),
        description=draw(text),
        source=draw(text),
        modal_damping=draw(ratio),
        beam_theory=draw(st.sampled_from(d.BEAM_THEORIES)),
        assumed=tuple(
            {
                **draw(st.dictionaries(text, text, max_size=3)),
                "seal.seal.scales_with_pressure": "drawn",
            }.items()
        ),
    )


@given(machines())
@settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.too_slow])
def test_any_valid_machine_survives_writing_and_reading(machine):
    again = loads_machine(dumps_machine(machine))
    assert again == machine
    assert [s.start for s in again.shaft] == [s.start for s in machine.shaft]  # to the last bit
    assert machine_hash(again) == machine_hash(machine)


@given(machines(), machines())
@settings(max_examples=15, deadline=None, suppress_health_check=[HealthCheck.too_slow])
def test_any_file_is_brought_up_to_any_machine(one, other):
    def fail(machine):
        raise AssertionError("written anew")

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(update, "dumps_machine", fail)
        assert loads_machine(update.update_machine_file(dumps_machine(one), other)) == other


class TestWriting:
    def test_an_invalid_machine_is_not_written(self, tmp_path):
        machine = loads_machine(SMALL)
        with pytest.raises(
            InvalidInput, match=r'machine "small": \[\[disc\]\] wheel: mass is -1 kg'
        ):
            save_machine(
                replace(machine, discs=(replace(machine.discs[0], mass=-1.0),)),
                tmp_path / "bad.toml",
            )
        assert not list(tmp_path.iterdir())

    def test_a_failure_leaves_the_old_file_and_no_rest(self, tmp_path, monkeypatch):
        path = save_machine(loads_machine(SMALL), tmp_path / "rig.toml")
        before = path.read_bytes()

        def fail(*_):
            raise OSError(28, "No space left on device")

        monkeypatch.setattr(os, "replace", fail)
        with pytest.raises(InvalidInput, match="No space left on device"):
            save_machine(load_machine("seal-rig"), path)
        assert path.read_bytes() == before
        assert list(tmp_path.iterdir()) == [path]

    def test_it_replaces_a_file(self, tmp_path):
        path = tmp_path / "rig.toml"
        path.write_text("old")
        save_machine(loads_machine(SMALL), path)
        assert load_machine(path).name == "small"
        assert list(tmp_path.iterdir()) == [path]


class TestHash:
    def test_form_does_not_count(self):
        machine = loads_machine(SMALL)
        same = (
            SMALL.replace('"200 mm"', "0.2")
            .replace("[[disc]]", "# a comment\n[[disc]]")
            .replace('"1 %"', "0.01")
        )
        assert machine_hash(loads_machine(same)) == machine_hash(machine)
        assert re.fullmatch(r"[0-9a-f]{64}", machine_hash(machine))

    def test_texts_do_not_count(self):
        machine = loads_machine(SMALL)
        assert machine_hash(
            replace(machine, description="other", source="other", assumed=machine.assumed[2:])
        ) == machine_hash(machine)

    def test_every_number_counts(self):
        machine = loads_machine(SMALL)
        hashes = {machine_hash(machine)}
        changed = [
            replace(machine, modal_damping=np.nextafter(0.01, 1)),
            replace(
                machine,
                shaft=(replace(machine.shaft[0], outer_diameter=0.0600000001), machine.shaft[1]),
            ),
            replace(machine, seals=(replace(machine.seals[0], C=2001.0), machine.seals[1])),
            replace(machine, supports=(replace(machine.supports[0], mass=(300.0, 301.0)),)),
            replace(machine, casing_modes=(replace(machine.casing_modes[0], x=(1.0, 0.71)),)),
            replace(machine, bending_modes=(replace(machine.bending_modes[0], damping=0.009),)),
            replace(machine, tolerances=machine.tolerances[:1]),
            replace(machine, bearings=machine.bearings[::-1]),
            replace(machine, requirements=replace(machine.requirements, gain_margin=2.5)),
            replace(machine, controller=None),
        ]
        assert len(hashes | {machine_hash(m) for m in changed}) == len(changed) + 1


@pytest.fixture(scope="module")
def validator():
    return jsonschema.Draft202012Validator(machine_schema())


class TestSchema:
    def test_committed_schema_is_current(self):
        committed = json.loads((ROOT / "docs" / "machine.schema.json").read_text())
        assert committed == machine_schema(), (
            "write it anew: python -m ambrose.machine.file.tables docs/machine.schema.json"
        )

    def test_it_is_a_schema(self):
        jsonschema.Draft202012Validator.check_schema(machine_schema())

    @pytest.mark.parametrize(
        "path", [*bundled_machines().values(), HERE / "small.toml"], ids=lambda p: p.name
    )
    def test_it_accepts_what_is_read(self, path, validator):
        validator.validate(tomllib.loads(path.read_text()))

    def test_it_accepts_what_is_written(self, validator):
        validator.validate(tomllib.loads(dumps_machine(loads_machine(SMALL))))

    @pytest.mark.parametrize(
        "old, new",
        [
            ("outer_diameter", "outer_diamter"),
            ('length = "200 mm"\n', ""),
            ('length = "200 mm"', 'length = "200"'),
            ('length = "200 mm"', "length = true"),
            ("elements = 4", "elements = 4.5"),
            ('"timoshenko"', '"euler"'),
            ("[0.40e6, 0.42e6]", "[0.40e6]"),
            ("[requirements]", "[requirement]"),
            ("schema = 1", "schema = 2"),
            ("turns = 36", 'turns = "36"'),
        ],
    )
    def test_it_refuses_what_is_refused(self, old, new, validator):
        wrong = SMALL.replace(old, new, 1)
        with pytest.raises(jsonschema.ValidationError):
            validator.validate(tomllib.loads(wrong))
        with pytest.raises(InvalidInput):
            loads_machine(wrong)

    def test_every_key_is_described_and_defaults_are_the_nouns(self):
        schema = machine_schema()
        for name, table in schema["$defs"].items():
            for key, entry in table.get("properties", {}).items():
                assert entry.get("description"), f"{name}.{key} has no description"
        assert (
            schema["$defs"]["MachineTable"]["properties"]["modal_damping"]["default"]
            == Machine.__dataclass_fields__["modal_damping"].default
        )
        assert schema["$defs"]["ShaftSection"]["properties"]["elements"]["default"] == 1


def test_every_field_of_every_noun_has_a_key():
    """A field added to description.py and forgotten here would be dropped silently by writing and
    reading.
    """
    renamed = {
        "notches": "notch",
        "points": "point",
        "ranges": "range",
        "channels": "channel",
        "sections": "section",
        "stators": "stator",
        "loads": "load",
        "tolerances": "tolerance",
    }
    for table in Table.__subclasses__():
        # that have been used in this process
        of_a_machine = table.noun is not None and "record" not in table.noun.__module__
        if of_a_machine and table.noun not in (SealTable, d.MachineDescription):
            keys = {field.alias or name for name, field in table.model_fields.items()}
            nouns = {
                renamed.get(field.name, field.name) for field in fields(table.noun) if field.compare
            }
            assert keys == nouns, table.noun.__name__


def test_loading_is_fast():
    """6 ms of a processor for a file without less common units, ten times as much on a slow one,
    after the first load has imported what it needs.
    """
    plain = dumps_machine(load_machine("turboexpander"))
    loads_machine(plain)
    times = []
    for _ in range(5):
        start = time.process_time()
        loads_machine(plain)
        times.append(time.process_time() - start)
    assert min(times) < 0.06


def test_loading_a_bundled_machine_does_not_import_pint():
    code = (
        "import sys; from ambrose import load_machine; load_machine('seal-rig'); assert 'pint' not "
        "in sys.modules"
    )
    subprocess.run([sys.executable, "-c", code], check=True, timeout=60)
