"""Balancing on the linear loop, where the answer is known to rounding, and its refusals."""

import json
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from click.testing import CliRunner

import ambrose as amb
from ambrose.annexes.site.balancing import balance, revolution
from ambrose.cli import main
from ambrose.core.checks import InvalidInput
from ambrose.machine.description import Tolerance
from ambrose.machine.part import Runout, Seal
from ambrose.model.effects import sensor
from ambrose.model.static_load import stated_at_load
from ambrose.record.record import Record
from ambrose.rig.scenario import Scenario, Sine, Unbalance
from coarse import coarse

TOP, SLOW = 2 * np.pi * 150, 2 * np.pi * 20
PLANES = {"impeller": 0.05, "free-end": 0.05}
U = {"impeller": 2e-4 * np.exp(0.8j), "free-end": 1e-4 * np.exp(-2j)}
RUNOUT = Runout(1, 3e-6, 0.7)


@cache
def machine():
    found = replace(coarse("overhung-blower"), tolerances=())
    return replace(found, sensors=tuple(replace(item, runout=(RUNOUT,)) for item in found.sensors))


@cache
def law():
    return amb.design(machine(), "pid")


@cache
def record(speed, extra=(), runout=True):
    """The linear loop with the unbalance, extra weights and the run-out, which enters as an output
    disturbance.
    """
    first = {item.name: item.angle for item in machine().bearings}
    moments = {name: u + dict(extra).get(name, 0) for name, u in U.items()}
    unbalances = [
        Unbalance(n, abs(u), phase=float(np.angle(u)) - first.get(n, 0.0))
        for n, u in moments.items()
    ]
    phasors = sensor.runout_phasors(machine().sensor_pairs, machine().axes) * runout
    lag = 1 / (1 + 1j * speed / machine().sensors[0].bandwidth)
    d = [
        Sine(f"d_{axis}", abs(r * lag), speed, float(np.angle(r * lag)) + np.pi / 2)
        for axis, r in zip(machine().axes, phasors, strict=True)
        if r
    ]
    scenario = Scenario("turning", 3.0, sines=tuple(d), unbalances=tuple(unbalances), speed=speed)
    return amb.simulate(machine(), law(), scenario, linear=True).record


def off(result):
    wanted = np.array(list(U.values()))
    return float(np.linalg.norm(result.correction + wanted) / np.linalg.norm(wanted))


def found(records, planes=PLANES, described=None, **options):
    return balance(described or machine(), records, planes, settle=1.5, **options)


@pytest.mark.parametrize("currents", ["u", "i", "law"])
def test_unbalance_and_run_out_are_told_apart_by_two_speeds(currents):
    records = [record(SLOW), record(TOP)]
    if currents != "u":
        records = [
            r.select([n for n in r.signals if n[0] in ("yi" if currents == "i" else "y")])
            for r in records
        ]
    result = found(records, controller=law() if currents == "law" else None)
    assert off(result) < 0.01
    np.testing.assert_allclose(
        result.runout, sensor.runout_phasors(machine().sensor_pairs, machine().axes), atol=2e-8
    )
    assert np.all(np.abs(result.correction + np.array(list(U.values()))) < result.uncertainty)
    assert result.passed and result.remaining < 0.2
    assert result.quantity == ("y" if currents == "law" else "y - G u")


def test_one_speed_takes_the_run_out_of_the_machine_file_and_says_where_it_is_zero():
    assert off(found([record(TOP)])) < 0.01
    bare = replace(machine(), sensors=tuple(replace(item, runout=()) for item in machine().sensors))
    result = found([record(TOP)], described=bare)
    assert off(result) > 0.1 and not result.passed
    assert "run-out was taken as zero" in " ".join(result.notes)


def test_trial_weights_measure_what_a_wrong_model_has_wrong():
    """A magnet of 1.3 times the gain in the machine file: the model's coefficients are wrong by it,
    measured ones are not.
    """
    trials = [(record(TOP, ((name, 1e-4),), False), {name: 1e-4}) for name in PLANES]
    seen = [record(TOP, (), False), *(trial for trial, _ in trials)]
    seen = [r.select([n for n in r.signals if n[0] == "y"]) for r in seen]
    bare = replace(machine(), sensors=tuple(replace(item, runout=()) for item in machine().sensors))
    result = found(
        seen[:1], described=bare, trials=list(zip(seen[1:], [w for _, w in trials], strict=True))
    )
    assert result.method == "trial weights" and off(result) < 1e-3
    given = [stated_at_load(bare, bearing) for bearing in bare.bearings]
    wrong = tuple(
        replace(b, force_per_current=tuple(1.3 * k for k in b.force_per_current)) for b in given
    )
    again = found([record(TOP, (), False)], described=replace(bare, bearings=wrong), trials=trials)
    assert off(again) < 1e-3
    assert off(found([record(TOP, (), False)], described=replace(bare, bearings=wrong))) > 0.03


def test_fewer_trials_than_planes_stand_beside_the_model():
    weight = {"impeller": 1e-4}
    result = found(
        [record(SLOW), record(TOP)], trials=[(record(TOP, (("impeller", 1e-4),)), weight)]
    )
    assert result.method == "model" and off(result) < 0.01


def test_several_speeds_lower_the_condition():
    one, two = found([record(TOP)]), found([record(TOP), record(1.5 * TOP), record(SLOW)])
    assert off(two) < 0.01
    assert two.condition > one.condition > 1  # run-out is unknown, too


def test_a_tolerance_of_nothing_moves_nothing():
    """A seal without pressure has no coefficients, and a share of them is none."""
    seal = Seal("seal", 0.1, k=1e6, reference_pressure=2e5, scales_with_pressure=("k",))
    bearing = Tolerance(f"bearing.{machine().bearings[0].name}.force_per_current", relative=0.03)
    loose, tight = (
        replace(machine(), seals=(seal,), tolerances=tolerances)
        for tolerances in ((Tolerance("seal.seal.k", relative=0.2), bearing), (bearing,))
    )
    turning = replace(record(TOP), point=replace(record(TOP).point, seal_pressure=0.0, label=""))
    both = [found([turning], described=item) for item in (loose, tight)]
    np.testing.assert_allclose(both[0].uncertainty, both[1].uncertainty, rtol=1e-9)
    assert (both[0].uncertainty > found([turning]).uncertainty).all()


@pytest.mark.parametrize("mark", ["key", "angle", "none"])
def test_the_key_mark_is_what_angles_count_from(mark):
    """A record that begins a quarter turn late says the same with its mark, and another angle
    without.
    """
    whole = record(TOP, (), False)
    late = 0.25 * 2 * np.pi / TOP
    angle = TOP * whole.time
    signals = {"key": (angle % (2 * np.pi) < 0.5) * 5.0, "angle": angle % (2 * np.pi)}
    shifted = replace(whole, start_time=-late)
    if mark != "none":
        values = np.vstack([whole.values, signals[mark]])
        unit = "V" if mark == "key" else "rad"
        shifted = replace(
            shifted, signals=(*whole.signals, mark), units=(*whole.units, unit), values=values
        )
    bare = replace(machine(), sensors=tuple(replace(item, runout=()) for item in machine().sensors))
    result = found([shifted], described=bare)
    turned = np.angle(-result.correction[0] / U["impeller"])
    assert turned == pytest.approx(0.0 if mark != "none" else np.pi / 2, abs=0.05)


def test_what_cannot_be_balanced_is_refused():
    turning, y = record(TOP), [n for n in record(TOP).signals if n[0] == "y"]
    still = replace(turning, point=replace(turning.point, speed=0.0))
    off_speed = replace(turning, point=replace(turning.point, speed=1.003 * TOP))
    for records, planes, options, words in (
        ([still], PLANES, {}, "at rest"),
        ([off_speed], PLANES, {}, "record key"),
        ([turning], {"impeler": 0.05}, {}, "did you mean"),
        ([turning], {"impeller": -0.05}, {}, "radius"),
        ([turning], {}, {}, "no correction plane"),
        ([turning.select(y)], PLANES, {}, "give the controller"),
        (
            [turning],
            PLANES,
            {"trials": [(turning, {"free-end": 1e-4}), (turning, {"impeller": 1e-4})]},
            "the very run",
        ),
        (
            [turning],
            PLANES,
            {"trials": [(record(SLOW), {"impeller": 1e-4})]},
            "that of a run without weights",
        ),
        ([turning], PLANES, {"trials": [(turning, {"elsewhere": 1e-4})]}, "not a correction plane"),
        ([turning.between(0, 1.0)], PLANES, {}, "record longer"),
    ):
        with pytest.raises(InvalidInput, match=words):
            found(records, planes, **options)


def test_a_changing_speed_is_refused():
    k = 20000
    speed = np.linspace(TOP, 1.1 * TOP, k)
    values = np.vstack([np.sin(np.cumsum(speed) * 1e-4), speed])
    point = replace(record(TOP).point, speed=TOP)
    with pytest.raises(InvalidInput, match="steady"):
        revolution(
            Record("blower", 1e4, ("y_impeller_zeta", "speed"), ("m", "rad/s"), values, point)
        )


def test_run_out_phasors_are_those_of_the_profile():
    pairs, axes = machine().sensor_pairs, machine().axes
    phasors = sensor.runout_phasors(pairs, axes)
    for spin in (0.0, 0.4, 2.0):
        seen = [
            sensor.runout(spin - pair.angle, sensor.harmonics(pair), sensor.parameters(pair, way))
            for _, pair, way in sensor.channels(pairs, axes)
        ]
        np.testing.assert_allclose((phasors * np.exp(1j * spin)).real, seen, atol=1e-12)


def test_the_command_prints_grams_and_degrees(tmp_path):
    for name, r in (("slow", record(SLOW)), ("top", record(TOP))):
        amb.write_record(r, tmp_path / f"{name}.h5")
    amb.save_machine(machine(), tmp_path / "m.toml")
    call = [
        "balance",
        str(tmp_path / "m.toml"),
        str(tmp_path / "slow.h5"),
        str(tmp_path / "top.h5"),
    ]
    call += ["--plane", "impeller=50 mm", "--plane", "free-end=5 cm", "--settle", "1.5"]
    printed = CliRunner().invoke(main, call)
    assert printed.exit_code == 0, printed.output
    assert "Correction masses" in printed.output and "ISO 21940-11" in printed.output
    plain = CliRunner().invoke(main, [*call, "--json"])
    first = json.loads(plain.output)["corrections"][0]
    assert first["mass_g"] == pytest.approx(4.0, rel=0.02)
    assert first["angle_deg"] == pytest.approx(np.degrees(0.8) + 180, abs=1)
    trial = CliRunner().invoke(main, [*call, "--trial", str(tmp_path / "top.h5"), "impeller=2 g"])
    assert trial.exit_code == 2 and "PLANE=MASS@DEGREES" in trial.output
    for wrong in (
        ["--plane", "impeller=50"],
        ["--plane", "impeller=50 mm", "--trial", str(tmp_path / "top.h5"), "impeller=2@30"],
    ):
        bare = CliRunner().invoke(main, [*call[:4], *wrong])
        assert bare.exit_code == 2 and "has no unit; write it as in" in bare.stderr
