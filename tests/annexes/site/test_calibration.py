"""Sensors and centres from standard tests: made-up circles exactly, the rig within a few per cent,
and the file updated.
"""

import json
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from click.testing import CliRunner

import ambrose as amb
from ambrose.annexes.site.calibration import calibrate
from ambrose.cli import main
from ambrose.core.checks import InvalidInput
from ambrose.machine.description import OperatingPoint
from ambrose.machine.part import Runout
from ambrose.model.effects import magnet, sensor
from ambrose.model.effects.seal import coefficients
from ambrose.model.static_load import operating_magnets, static_sag
from ambrose.record.record import Record
from ambrose.rig.scenario import Scenario, Sine

GAIN, OFFSET = (1.04, 0.97), (12e-6, -8e-6)


@cache
def machine():
    return amb.load_machine("overhung-blower")


def circle(gain=GAIN, offset=OFFSET, turn=2 * np.pi, gap=2e-4, inside=0.0, lag=0.0, seed=0):
    """y of a rotor that goes around by ``turn`` [rad]; inside: share of the samples that hang free;
    lag of the last bearing.
    """
    rng, t = np.random.default_rng(seed), np.linspace(0, 1, 4000)
    names, rows = [], []
    for k, bearing in enumerate(machine().bearings):
        angle = turn * t - lag * k - bearing.angle
        radius = (
            np.where(rng.uniform(size=len(t)) < inside, rng.uniform(0.2, 0.9, len(t)), 1.0) * gap
        )
        for way, axis in enumerate(("zeta", "eta")):
            names.append(f"y_{bearing.name}_{axis}")
            rows.append(
                offset[way]
                + gain[way] * radius * np.cos(angle - way * np.pi / 2)
                + 1e-8 * rng.standard_normal(len(t))
            )
    return Record(machine().name, 1e3, tuple(names), ("m",) * len(names), np.array(rows))


def dead(record, *rows, at=3e-5):
    """The record with channels that stand still."""
    values = record.values.copy()
    values[list(rows)] = at
    return replace(record, values=values)


def value(done, name):
    return next(entry.value for entry in done.entries if entry.name == name)


@pytest.mark.parametrize("inside", [0.0, 0.2])
def test_gains_and_offsets_of_a_circle(inside):
    done = calibrate(machine(), circle=circle(inside=inside), settle=0)
    for pair in done.machine.sensors:
        assert pair.gain == pytest.approx(GAIN, rel=1e-3) and pair.offset == pytest.approx(
            OFFSET, abs=2e-7
        )
    assert "compliance" in done.notes[0]
    assert all(entry.half < (1e-3 if entry.unit == "-" else 1e-6) for entry in done.entries)
    assert value(done, "sensor free-end gain zeta") == done.machine.sensors[1].gain[0]


def test_clearance_of_a_circle_when_the_gains_are_known():
    bearings = tuple(replace(bearing, touchdown_gap=None) for bearing in machine().bearings)
    sensors = tuple(replace(pair, gain=GAIN) for pair in machine().sensors)
    told = replace(machine(), bearings=bearings, sensors=sensors)
    done = calibrate(told, circle=circle(), find="clearance", settle=0)
    for bearing in done.machine.bearings:
        assert bearing.touchdown_gap == pytest.approx(2e-4, rel=1e-3)
    with pytest.raises(InvalidInput, match="touchdown_gap is not stated"):
        calibrate(told, circle=circle(), settle=0)


@pytest.mark.parametrize(
    ("tests", "words"),
    [
        ({"circle": lambda: circle(turn=np.pi)}, "a circle all around"),
        ({"circle": lambda: circle(inside=1.0)}, "a circle all around"),
        ({"circle": lambda: circle(lag=1.0)}, "in phase"),
        (
            {"circle": lambda: dead(circle(), 0)},
            "still within .* um, but must be moved as all others.*dead channel",
        ),
        ({"circle": lambda: dead(circle(), 3)}, "still within"),
        ({"circle": lambda: dead(circle(), 0, 1)}, "still within"),
        ({"circle": lambda: dead(circle(), 0, 1, 2, 3)}, "still within"),
        ({}, "no test was given"),
        ({"circle": circle, "find": "weight"}, '"gain" or "clearance"'),
        ({"levitated": circle}, "lacks i_<axis>"),
        (
            {"slow_roll": lambda: replace(circle(), point=OperatingPoint(speed=60.0))},
            "neither u_<axis> nor i_<axis>",
        ),
        ({"slow_roll": circle}, "at rest"),
    ],
)
def test_what_tells_nothing_is_refused(tests, words):
    made = {key: item() if callable(item) else item for key, item in tests.items()}
    with pytest.raises(InvalidInput, match=words):
        calibrate(machine(), settle=0, **made)


def levitated(centre, bias, weight=1.0, place=0.0):
    """Means of a rotor held at ``place`` by currents that balance its weight about the magnets'
    centre.
    """
    from scipy.optimize import fsolve

    hangs, loads = static_sag(machine())
    rows, names = [], []
    for bearing, load, hang in zip(machine().bearings, loads, hangs, strict=True):
        p = magnet.parameters(replace(bearing, magnetic_offset=centre), bias)
        i = fsolve(
            lambda i, p=p, load=load, x=place + hang: np.add(
                magnet.force(*i, *x, p), weight * load
            ),
            np.zeros(2),
        )
        for kind, values in (("y", (place, place)), ("i", i)):
            names += [f"{kind}_{bearing.name}_{axis}" for axis in ("zeta", "eta")]
            rows += [np.full(50, v) for v in values]
    units = tuple("m" if name[0] == "y" else "A" for name in names)
    return Record(
        machine().name, 1e3, tuple(names), units, np.array(rows), OperatingPoint(bias_current=bias)
    )


def test_the_magnetic_centre_balances_the_weight():
    done = calibrate(machine(), levitated=levitated((6e-6, -4e-6), None), settle=0)
    for bearing in done.machine.bearings:
        assert bearing.magnetic_offset == pytest.approx((6e-6, -4e-6), abs=1e-9)
    assert "right to 2 %" in done.notes[0]


def test_what_a_seal_holds_is_no_magnetic_centre():
    """Under pressure a rotor off the zero is pushed by its seals, K and across it k: by levers of a
    rigid rotor, both magnets carry it.
    """
    point, place = OperatingPoint(seal_pressure=0.6e5), 8e-6
    free = levitated((6e-6, -4e-6), None, place=place)
    a, b = machine().bearings
    pushed = {name: free[name].copy() for name in free.signals}
    for item in machine().seals:
        known = coefficients(item, point.seal_pressure)
        share = (item.position - a.position) / (b.position - a.position)
        for bearing, part in ((a, 1 - share), (b, share)):
            # along the bearing's axes, both displaced alike: F = -(K -+ k) q
            force = -np.array([known.K + known.k, known.K - known.k]) * place * part
            at = next(
                x for x, y in zip(operating_magnets(machine()), (a, b), strict=True) if y is bearing
            )
            k_i = np.array(at.coefficients.force_per_current)
            for way, change in zip(("zeta", "eta"), -force / k_i, strict=True):
                pushed[f"i_{bearing.name}_{way}"] += change
    values = np.array([pushed[name] for name in free.signals])
    record = replace(free, values=values, point=point)
    done, without = (calibrate(machine(), levitated=item, settle=0) for item in (record, free))
    for bearing, own in zip(done.machine.bearings, without.machine.bearings, strict=True):
        assert bearing.magnetic_offset == pytest.approx(own.magnetic_offset, abs=1e-7)
    moved = replace(record, point=OperatingPoint())
    wrong = calibrate(machine(), levitated=moved, settle=0).machine.bearings
    assert max(abs(item.magnetic_offset[0] - 6e-6) for item in wrong) > 3e-7


def test_two_bias_currents_tell_the_weight_as_well():
    """A rotor that is 20 % heavier than the file: one record is wrong by it, two are not."""
    heavy = [levitated((6e-6, -4e-6), bias, weight=1.2) for bias in (None, 3.0)]
    one, two = (
        calibrate(machine(), levitated=items, settle=0).machine.bearings[0].magnetic_offset
        for items in (heavy[:1], heavy)
    )
    assert np.abs(np.array(one) - (6e-6, -4e-6)).max() > 5e-6
    assert two == pytest.approx((6e-6, -4e-6), abs=1e-8)


@cache
def rolled():
    profile = (Runout(1, 3e-6, 0.7), Runout(2, 1e-6, -1.0))
    true = replace(
        machine(),
        sensors=tuple(replace(pair, runout=profile, noise=1e-8) for pair in machine().sensors),
    )
    law = amb.design(replace(machine(), tolerances=()), "pid")
    return true, amb.simulate(true, law, Scenario("roll", 4.0, speed=62.8), bending_modes=1).record


def test_run_out_is_found_on_the_rig():
    done = calibrate(machine(), slow_roll=rolled()[1], harmonics=2, settle=1.5)
    for pair in done.machine.sensors:
        found = {item.order: item for item in pair.runout}
        assert found[1].amplitude == pytest.approx(3e-6, rel=0.05) and found[
            1
        ].phase == pytest.approx(0.7, abs=0.05)
        assert found[2].amplitude == pytest.approx(1e-6, rel=0.1)
    phasors = [sensor.runout_phasors(m.sensor_pairs, m.axes) for m in (done.machine, rolled()[0])]
    np.testing.assert_allclose(*phasors, atol=2e-7)


def test_a_circle_on_the_rig_is_free_of_the_compliance_of_the_contact():
    """Magnets press the rotor tens of um into the touchdown bearing: without that the gains would
    be 5 % too large.
    """
    true = replace(
        machine(),
        sensors=tuple(replace(pair, gain=GAIN, offset=OFFSET) for pair in machine().sensors),
    )
    sines = []
    for bearing in true.bearings:
        for way, axis in enumerate(("zeta", "eta")):
            name, phase = f"e_{bearing.name}_{axis}", np.pi / 2 - bearing.angle - way * np.pi / 2
            sines += [Sine(name, 3.6, 8 * np.pi, phase), Sine(name, -1.2, 8 * np.pi, phase, 0.5)]
    from ambrose.core.statespace import static_gain

    law = static_gain(
        np.zeros((4, 4)), [f"err_{x}" for x in true.axes], [f"u_{x}" for x in true.axes], dt=1e-4
    )
    scenario = Scenario(
        "circle", 0.9, sines=tuple(sines), initial="resting", sample_time=1e-4, speed=0.0
    )
    record = amb.simulate(true, law, scenario, bending_modes=0).record
    with_currents = calibrate(machine(), circle=record, settle=0.25)
    without = calibrate(
        machine(), circle=record.select([n for n in record.signals if n[0] == "y"]), settle=0.25
    )
    for pair, blind in zip(with_currents.machine.sensors, without.machine.sensors, strict=True):
        assert pair.gain == pytest.approx(GAIN, rel=0.02)
        assert blind.gain[0] > 1.03 * GAIN[0]


def test_the_command_keeps_the_comments_of_the_file(tmp_path):
    amb.write_record(circle(turn=4 * np.pi), tmp_path / "circle.h5")
    amb.write_record(rolled()[1], tmp_path / "roll.h5")
    text = machine().file_text.replace("[[sensor]]", "# mine\n[[sensor]]", 1)
    (tmp_path / "m.toml").write_text(text, encoding="utf-8")
    call = [
        "calibrate",
        str(tmp_path / "m.toml"),
        "--circle",
        str(tmp_path / "circle.h5"),
        "--slow-roll",
        str(tmp_path / "roll.h5"),
    ]
    call += ["--settle", "1", "-o", str(tmp_path / "new.toml")]
    printed = CliRunner().invoke(main, call)
    assert printed.exit_code == 0, printed.output
    assert "gain zeta" in printed.output and "run-out 1x" in printed.output
    made = (tmp_path / "new.toml").read_text(encoding="utf-8")
    assert "# mine" in made and "[[sensor.runout]]" in made
    again = amb.load_machine(tmp_path / "new.toml")
    assert again.sensors[0].gain == pytest.approx(GAIN, rel=2e-3)
    told = json.loads(CliRunner().invoke(main, [*call, "--json"]).output)
    assert {"name", "unit", "before", "value", "half"} <= set(told["entries"][0])
