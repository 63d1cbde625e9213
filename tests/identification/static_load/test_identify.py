"""K_i from static loads: the balance of forces by hand, records of known magnets, and what must be
refused.
"""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from ambrose import load_machine
from ambrose.core.checks import InvalidInput
from ambrose.identification import static_load
from ambrose.identification.parameters import update_machine
from ambrose.identification.static_load import Levels, steady_levels
from ambrose.law.pid import pid_controller
from ambrose.machine.description import Amplifier, OperatingPoint
from ambrose.machine.part import Notch, PidSettings
from ambrose.model.effects import magnet
from ambrose.model.static_load import operating_magnets
from ambrose.record.record import Record
from ambrose.rig import virtual_rig
from ambrose.rig.scenario import Pulse, Scenario, load_scenario

RIG = load_machine("seal-rig")
BARE = replace(
    RIG,
    tolerances=(),
    couplings=(),
    seals=tuple(replace(s, K=0.0, k=0.0, C=0.0, c=0.0) for s in RIG.seals),
)  # nothing but magnets; the seal stays as the place of a load
POINT = OperatingPoint()
K_I, K_S = np.array([150.0, 140.0, 160.0, 165.0]), np.array([0.86e6, 0.87e6, 1.2e6, 1.2e6])
AXES = RIG.axes


def levels_of(loads, ports, y=None):
    m = len(loads)
    y = np.zeros((m, 4)) if y is None else y
    zero = np.zeros((m, 4))
    return Levels(
        tuple(ports),
        np.array(loads, dtype=float),
        y,
        zero,
        zero,
        np.ones(m, dtype=int),
        np.arange(m),
    )


def test_balance_of_forces_and_moments_by_hand():
    """A load of 100 N off the middle, at A, and in the middle; both levers from the machine file,
    actuators at 45 degrees.
    """
    # x in the middle, y in the middle, B_eta
    loads = [[0, 0, 0], [100, 0, 0], [0, 100, 0], [0, 0, 100]]
    forces, places = static_load.bearing_forces(
        BARE, POINT, levels_of(loads, ("center_x", "center_y", "B_eta"))
    )
    half = 50 / np.sqrt(2)
    expected = np.array(
        [[0, 0, 0, 0], [-half, half, -half, half], [-half, -half, -half, -half], [0, 0, 0, -100]]
    )
    np.testing.assert_allclose(forces, expected, atol=1e-6)
    assert np.abs(places).max() < 5e-6  # only by bending: the sensors stay at zero


def test_the_bent_rotor_leaves_the_bearings_where_beam_theory_says():
    """100 N in the middle of a beam on two bearings, fixed at the sensors beyond them: displacement
    at the bearings.

    Independent: Castigliano's integral of bending moment over the stepped shaft, relative to the
    line through the sensors.
    """
    _, places = static_load.bearing_forces(
        BARE, POINT, levels_of([[0, 0], [100, 0]], ("center_x", "center_y"))
    )
    z = np.linspace(0, RIG.length, 86001)
    inertia = (
        np.concatenate(
            [
                np.full(
                    np.count_nonzero((z[:-1] >= s.start) & (z[:-1] < s.start + s.length - 1e-12)),
                    s.outer_diameter**4,
                )
                for s in RIG.shaft
            ]
        )
        * np.pi
        / 64
    )
    a, b = (bearing.position for bearing in RIG.bearings)
    middle = RIG.seals[0].position
    here = (z[1:] + z[:-1]) / 2
    step = np.diff(z)
    moment = 50 * (np.clip(here - a, 0, None) + np.clip(here - b, 0, None)) - 100 * np.clip(
        here - middle, 0, None
    )
    slope = np.concatenate([[0], np.cumsum(moment / (2.1e11 * inertia) * step)])
    deflection = np.concatenate([[0], np.cumsum((slope[1:] + slope[:-1]) / 2 * step)])
    s_a, s_b = (sensor.position for sensor in RIG.sensors)
    line = np.interp(z, [s_a, s_b], np.interp([s_a, s_b], z, deflection), left=np.nan, right=np.nan)
    expected = abs(np.interp(a, z, deflection - line))
    np.testing.assert_allclose(np.hypot(places[1, 0], places[1, 1]), expected, rtol=2e-3)
    assert 0.1e-6 < expected < 5e-6


def test_coupling_and_seal_carry_their_part():
    """With the rotor moved by 10 um in parallel, the springs of coupling and seal pull at the
    bearings by their levers.
    """
    machine = replace(
        BARE,
        couplings=RIG.couplings,
        seals=tuple(replace(s, K=1e5, scales_with_pressure=()) for s in BARE.seals),
    )
    y = np.array([[0, 0, 0, 0], [10e-6, 0, 10e-6, 0]])
    forces, places = static_load.bearing_forces(
        machine, POINT, levels_of([[0], [0]], ("center_x",), y)
    )
    np.testing.assert_allclose(places[1], [10e-6, 0, 10e-6, 0], atol=0.3e-6)
    a, b = (bearing.position for bearing in RIG.bearings)
    spring = RIG.couplings[0].stiffness[0] * 10e-6  # at z = 0, along the same zeta
    np.testing.assert_allclose(forces[1, [0, 2]].sum(), spring + 1.0, rtol=0.02)
    np.testing.assert_allclose(forces[1, 2], spring * (0 - a) / (b - a) + 0.5, rtol=0.03)


def straight(
    most=200.0,
    steps=4,
    hold=1.0,
    rate=1000.0,
    noise=0.0,
    curve=0.0,
    gain=None,
    drift=0.0,
    sides=(1, -1),
):
    """A record of magnets f = k_i i (1 - curve i^2) under loads at both bearings; ``gain`` [A/m] of
    a controller without integrator lets the rotor move.
    """
    rng, k = np.random.default_rng(5), round(hold * rate)
    levels = [np.zeros(4)]
    for axis in range(2):
        for side in sides:
            for step in (*range(1, steps + 1), *range(steps - 1, -1, -1)):
                load = np.zeros(4)
                load[[axis, axis + 2]] = side * most * step / steps
                levels.append(load)
    f = np.repeat(np.array(levels).T, k, axis=1)
    force = -f  # of the magnets: a rigid balance, loads at the bearings themselves
    if gain is None:
        y = np.zeros_like(f)
        i = force / K_I[:, None]
        for _ in range(30):
            i = force / (K_I[:, None] * (1 - curve * i**2))
    else:
        y = -force / (gain * K_I - K_S)[:, None]  # at the bearings; the sensors stand further out
        i = -gain * y
    i = i + 1.3 + drift * (np.arange(f.shape[1]) % k) / k  # 1.3 A carry the weight
    i = i + noise * rng.standard_normal(i.shape)
    names = [f"{kind}_{axis}" for kind in ("y", "i", "f") for axis in AXES]
    units = ("m",) * 4 + ("A",) * 4 + ("N",) * 4
    return Record("seal-rig", rate, tuple(names), units, np.vstack([y, i, f]), POINT)


def test_straight_line_is_found_exactly():
    found = static_load.identify(BARE, straight(), negative_stiffness=np.zeros(4))
    np.testing.assert_allclose(found.values, K_I, rtol=1e-9)
    np.testing.assert_allclose(found.at_rest, K_I, rtol=1e-7)
    assert not found.warnings and "straight line" in found.verdict
    assert found.paths[1] == "bearing.A.force_per_current.eta"
    assert len(found.levels.start) == 33
    np.testing.assert_allclose(found.local[2].slope, K_I[2], rtol=1e-9)
    np.testing.assert_allclose(np.sort(found.local[2].force), np.arange(-175, 176, 50), atol=1e-3)


def test_deviation_against_repeats():
    """The stated deviation is that of 40 records with other noise, within its own chance."""
    record = straight(rate=200.0)
    values = []
    stated = []
    for seed in range(40):
        noise = np.zeros_like(record.values)
        noise[4:8] = 0.1 * np.random.default_rng(seed).standard_normal((4, record.values.shape[1]))
        found = static_load.identify(
            BARE, replace(record, values=record.values + noise), negative_stiffness=np.zeros(4)
        )
        values.append(found.values)
        stated.append(found.standard_deviations)
    ratio = np.sqrt(np.mean(np.square(stated), axis=0)) / np.std(values, axis=0, ddof=1)
    assert ((ratio > 0.75) & (ratio < 1.35)).all(), ratio


def test_saturation_is_curvature_and_the_tangent_is_that_at_rest():
    curve = 0.02
    found = static_load.identify(
        BARE, straight(curve=curve, noise=1e-3), negative_stiffness=np.zeros(4)
    )
    assert (
        found.linearity < 1e-6
    ).all() and "curved on A_zeta, A_eta, B_zeta, B_eta" in found.verdict
    np.testing.assert_allclose(found.at_rest, K_I, rtol=3e-3)
    assert (found.values < 0.98 * K_I).all() and any(
        "the iron saturates" in str(text) for text in found.warnings
    )
    i = found.local[0].current
    np.testing.assert_allclose(found.local[0].slope, K_I[0] * (1 - 3 * curve * i**2), rtol=0.01)


def test_a_controller_without_integrator_needs_the_negative_stiffness():
    """K_i i alone would carry K_i - K_s/gain; with K_s known the slope is right, and the doubt is
    said.
    """
    rigid = replace(
        BARE,
        sensors=tuple(
            replace(s, position=b.position) for s, b in zip(RIG.sensors, RIG.bearings, strict=True)
        ),
    )
    record = straight(gain=20e3)
    found = static_load.identify(rigid, record, negative_stiffness=K_S)
    np.testing.assert_allclose(found.values, K_I, rtol=5e-3)
    assert (
        all("controller without integrator" in str(text) for text in found.warnings)
        and len(found.warnings) == 4
    )
    np.testing.assert_allclose(found.stiffness_share, K_S / (20e3 * K_I), rtol=0.02)
    other = static_load.identify(rigid, record, negative_stiffness=1.1 * K_S)
    np.testing.assert_allclose(
        other.values - found.values, found.stiffness_effect * 0.1 * K_S, rtol=1e-6
    )
    np.testing.assert_allclose(found.stiffness_effect, 1 / 20e3, rtol=0.02)


def test_one_sided_loads_are_doubted():
    found = static_load.identify(BARE, straight(sides=(1,)), negative_stiffness=np.zeros(4))
    np.testing.assert_allclose(found.values, K_I, rtol=1e-9)
    assert sum("one side only" in str(text) for text in found.warnings) == 4


def unloaded_eta(record):
    values = record.values.copy()
    for row in (5, 7, 9, 11):
        values[row] = values[row, 0]
    return replace(record, values=values)


def clipped(record):
    values = record.values.copy()
    values[4:8] = np.minimum(values[4:8], 2.0)
    return replace(record, values=values)


def moved_far(record):
    values = record.values.copy()
    values[0] += 0.3e-3
    return replace(record, values=values)


def unsteady(record):
    """A level between two values: half of the averaged time at each."""
    return straight(drift=0.5)


@pytest.mark.parametrize(
    ("change", "options", "words"),
    [
        (
            unsteady,
            {},
            r"i_\w+ at the level from [\d.]+ s in record 1 is still drifting by .*hold the loads "
            r"longer",
        ),
        (
            unloaded_eta,
            {},
            "axis A_eta carries no load .* load the rotor along every actuator axis",
        ),
        (lambda r: r.select(r.signals[:8]), {}, "have no load.*force transducer"),
        (
            lambda r: straight(hold=0.3),
            {},
            "number of levels is 0, but must be at least 2, each held for more than 0.5 s",
        ),
        (lambda r: r.select(r.signals[4:]), {}, "record 1 has no signal y_A_zeta"),
        (lambda r: replace(r, machine="other"), {}, "machine of record 1 is 'other'"),
        (
            lambda r: [r, replace(r, point=OperatingPoint(bias_current=6.0))],
            {},
            "operating point of record 2",
        ),
        (
            lambda r: replace(r, notes=(("outcome", "touchdown at B at t = 3 s"),)),
            {},
            "did not stay free .touchdown at B",
        ),
        (
            moved_far,
            {},
            "displacement at bearing A is .* touchdown gap of 250 um, as it must not touch",
        ),
        (lambda r: [], {}, "no record was given"),
        (lambda r: r, {"average": -1.0}, "average"),
        (lambda r: r, {"negative_stiffness": [1.0]}, "shape of negative_stiffness"),
    ],
)
def test_bad_input(change, options, words):
    with pytest.raises(InvalidInput, match=words):
        static_load.identify(BARE, change(straight()), **options)


def test_currents_at_their_limit_are_refused():
    tight = replace(BARE, bearings=tuple(replace(b, max_current=2.0) for b in BARE.bearings))
    with pytest.raises(
        InvalidInput,
        match=r"current of A_zeta is 2 A, but must be below its limit of 2 A; lower the loads",
    ):
        static_load.identify(tight, clipped(straight()))


def test_a_load_where_the_machine_has_no_port():
    record = straight()
    names = tuple(name.replace("f_B", "f_C") for name in record.signals)
    with pytest.raises(InvalidInput, match=r"a load's port is 'C_zeta'.*one of A_zeta"):
        static_load.identify(BARE, replace(record, signals=names))


def test_noisy_loads_still_have_levels():
    record = straight(hold=1.5)
    values = record.values.copy()
    values[8:] += 2.0 * np.random.default_rng(0).standard_normal((4, values.shape[1]))
    found = steady_levels(BARE, replace(record, values=values))
    assert len(found.start) == 33
    np.testing.assert_allclose(found.loads[4, 0], 200.0, atol=1.0)
    np.testing.assert_allclose(np.diff(found.start), 1.5, atol=0.05)


@cache
def loaded(scenario, bias=None):
    """The rig in a scenario, with coupling and weight; its PID has a notch at the bending mode."""
    given = [magnet.linearised(b, bias) for b in BARE.bearings]
    gain = 1.5 * max(
        c.negative_stiffness[a] / c.force_per_current[a] for c in given for a in (0, 1)
    )
    quick = Amplifier("first", bandwidth=2 * np.pi * 1000)
    machine = replace(RIG, tolerances=(), seals=BARE.seals, amplifier=quick)
    law = pid_controller(
        PidSettings((gain,), 0.05, 2e-3, 0.05, notches=(Notch(2 * np.pi * 550, 0.5, 0.02),)),
        machine,
    )
    return machine, virtual_rig.run(
        machine, law, scenario, point=OperatingPoint(bias_current=bias)
    ).record


def tangents(machine, record, bias):
    """K_i of the rig's own force where the record rests."""
    found = []
    for j, working in enumerate(operating_magnets(machine, bias)):
        at = np.array(
            [
                record[f"{kind}_{axis}"].mean()
                for kind in ("i", "q")
                for axis in AXES[2 * j : 2 * j + 2]
            ]
        )
        p = working.parameters
        for axis in range(2):
            step = 1e-4 * np.eye(4)[axis]
            found.append(
                (magnet.force(*(at + step), p)[axis] - magnet.force(*(at - step), p)[axis]) / 2e-4
            )
    return np.array(found)


def test_the_bundled_loads_are_at_one_bearing_only():
    """100 N at A: what B's K_i is cannot be told; at A every level lies on the rig's tangent within
    its curvature.
    """
    machine, record = loaded(load_scenario("static-loads"))
    with pytest.raises(InvalidInput, match="axis B_zeta carries no load"):
        static_load.identify(machine, record)
    levels = steady_levels(machine, record)
    forces, places = static_load.bearing_forces(machine, record.point, levels)
    K_s = magnet.linearised(machine.bearings[0]).negative_stiffness[0]
    force = (forces[:, 0] - K_s * places[:, 0])[np.argsort(levels.current[:, 0])[[0, -1]]]
    chord = np.ptp(force) / np.ptp(levels.current[:, 0])
    start = record.between(10.9, 11.0)  # unloaded eta again: nothing at zeta
    np.testing.assert_allclose(chord, tangents(machine, start, None)[0], rtol=0.02)


def test_the_bundled_loads_at_both_bearings_tell_every_axis():
    machine, record = loaded(load_scenario("static-loads-both"), 6.0)
    found = static_load.identify(machine, record)
    np.testing.assert_allclose(
        found.values, tangents(machine, record.between(7.5, 7.9), 6.0), rtol=5e-3
    )


def test_loads_in_the_middle_at_six_ampere():
    """The cubic's slope at rest is the rig's tangent at its working point within 0.3 %, the chord a
    little lower.
    """
    pulses, time = [], 0.8
    for direction in np.pi / 4 + np.pi / 2 * np.arange(4):
        for size in (100.0, 200.0, 300.0, 200.0, 100.0):
            for way, share in (("x", np.cos(direction)), ("y", np.sin(direction))):
                pulses.append(Pulse(f"f_center_{way}", size * share, time, 0.8))
            time += 0.8
        time += 0.8
    machine, record = loaded(Scenario("loads", time, pulses=tuple(pulses), sample_time=1e-4), 6.0)
    found = static_load.identify(machine, record, average=0.2)
    np.testing.assert_allclose(
        found.at_rest, tangents(machine, record.between(0.0, 0.7), 6.0), rtol=3e-3
    )
    assert (found.values < 1.001 * found.at_rest).all()
    other = update_machine(machine, found)
    assert other.bearings[0].measured[0].force_per_current == pytest.approx(tuple(found.values[:2]))
