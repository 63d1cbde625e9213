"""Nothing depends on what bearings, seals and discs are called, on the end that positions are
counted from, or on units.
"""

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

import ambrose as amb
from ambrose.cli import main
from ambrose.core.frequency import frequency_response
from ambrose.law.loop import closed_loop
from ambrose.law.pid import pid_controller
from ambrose.machine.file.toml import dumps_machine, loads_machine, read_machine_text
from ambrose.machine.part import CasingMode, Support
from ambrose.model.assemble import assemble

NAMES = {"A": "DE", "B": "NDE", "center": "balance", "piston": "drum", "coupling": "quill"}
SAME = 1e-9


def call(*arguments):
    return CliRunner().invoke(main, [str(argument) for argument in arguments])


def renamed(name):
    """The text of a bundled machine file with other names of bearings, seals and couplings."""
    text = read_machine_text(name)
    for old, new in NAMES.items():
        text = re.sub(rf'^((?:name|bearing) = )"{old}"', rf'\1"{new}"', text, flags=re.MULTILINE)
        text = re.sub(rf'"(bearing|seal|coupling|sensor)\.{old}\.', rf'"\1.{new}.', text)
    return text


@pytest.fixture(
    scope="module", params=["seal-rig", pytest.param("turboexpander", marks=pytest.mark.study)]
)
def pair(request, tmp_path_factory):
    """A bundled machine, and the path of the same under other names."""
    path = tmp_path_factory.mktemp("renamed") / "machine.toml"
    path.write_text(renamed(request.param), encoding="utf-8")
    return amb.load_machine(request.param), path


def test_the_names_are_others(pair):
    machine, path = pair
    other = amb.load_machine(path)
    assert [bearing.name for bearing in other.bearings] == ["DE", "NDE"]
    assert not {seal.name for seal in machine.seals} & {seal.name for seal in other.seals}


def numbers(verification):
    """Every figure of a verification by point and check, without the names in it."""
    return [
        (label, check.value) for label, checks in verification.labelled for check in checks.checks
    ]


def test_verification_and_designs_do_not_depend_on_names(pair):
    machine, path = pair
    other = amb.load_machine(path)
    one, two = (amb.design(item, "pid") for item in (machine, other))
    np.testing.assert_array_equal(one.controller.A, two.controller.A)
    first, second = (
        numbers(amb.verify(item, made, points=item.operation.points[:1], tolerances=False))
        for item, made in ((machine, one), (other, two))
    )
    assert [label for label, _ in first] == [label for label, _ in second]
    np.testing.assert_allclose([v for _, v in second], [v for _, v in first], rtol=SAME, atol=0)


@pytest.mark.parametrize("method", ["hinf", pytest.param("mu", marks=pytest.mark.study)])
def test_robust_designs_do_not_depend_on_names(pair, method):
    machine, path = pair
    one, two = (amb.design(item, method) for item in (machine, amb.load_machine(path)))
    assert two.gamma == pytest.approx(one.gamma, rel=1e-6)
    peaks = [made.certificate.margins["full_sensitivity_peak"] for made in (one, two)]
    assert peaks[1] == pytest.approx(peaks[0], rel=1e-6)


CAMPAIGN = {"impulse-parallel"}


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(n, marks=[] if n in CAMPAIGN else pytest.mark.study)
        for n in amb.bundled_scenarios()
        if n not in {"five-axes", "surge", "thrust-step", "thrust-reversal"}  # along the shaft
    ],
)
def test_every_scenario_runs_alike_under_other_names(pair, name):
    machine, path = pair
    other, scenario = amb.load_machine(path), amb.load_scenario(name)
    scenario = (
        replace(scenario, duration=min(scenario.duration, 0.3))
        if name in {"impulse-parallel", "prbs"}
        else scenario
    )
    one, two = (
        amb.simulate(item, amb.design(item, "pid"), scenario, point=item.operation.points[-1].label)
        if name != "operating-cycle"
        else amb.simulate(item, amb.design(item, "pid"), scenario)
        for item in (machine, other)
    )
    assert two.outcome == one.outcome
    assert two.record.signals == tuple(
        re.sub(r"_(A|B|center|piston|coupling)(?=_|$)", lambda m: f"_{NAMES[m[1]]}", s)
        for s in one.record.signals
    )
    if one.outcome == "completed" and np.isfinite(one.record.values).all():
        np.testing.assert_allclose(
            two.record.values,
            one.record.values,
            rtol=0,
            atol=SAME * np.abs(one.record.values).max(),
        )


def mirrored(machine):
    """The same machine with positions counted from the other end."""
    length = sum(section.length for section in machine.shaft)
    starts = [length - section.start - section.length for section in machine.shaft]
    moved = {
        name: tuple(
            replace(item, position=length - item.position)
            for item in reversed(getattr(machine, name))
        )
        for name in ("bearings", "sensors", "discs", "seals", "couplings")
    }
    shaft = [
        replace(section, start=start) for section, start in zip(machine.shaft, starts, strict=True)
    ]
    return replace(machine, shaft=tuple(sorted(shaft, key=lambda section: section.start)), **moved)


def test_the_other_end_gives_the_same_at_standstill_without_pressure():
    """Mirrored, a rotor that turns, or a seal that pushes it sideways, would go the other way
    round.
    """
    machine = amb.load_machine("seal-rig")
    points = ("zero pressure",)
    one, two = (
        amb.verify(item, amb.design(item, "pid"), points=points, tolerances=False)
        for item in (machine, mirrored(machine))
    )
    first, second = (
        {check.name: check.value for check in item.points[0].checks} for item in (one, two)
    )
    assert set(first) == set(second)
    np.testing.assert_allclose(
        [second[name] for name in first], list(first.values()), rtol=1e-7, atol=0
    )


def test_other_units_say_the_same(tmp_path):
    text = (
        read_machine_text("seal-rig")
        .replace('"80 mm"', '"8 cm"')
        .replace('"2.04 bar"', '"204 kPa"')
    )
    text = (
        text.replace('"500 Hz"', '"30000 rpm"')
        .replace("18250 A/m", "18.25 mA/um")
        .replace('"3.5 ms"', '"3500 us"')
    )
    assert text.count("kPa") == 2 and "mA/um" in text
    path = tmp_path / "units.toml"
    path.write_text(text, encoding="utf-8")
    machine, other = amb.load_machine("seal-rig"), amb.load_machine(path)
    first, second = (
        numbers(
            amb.verify(item, amb.design(item, "pid"), points=("nominal", "zero"), tolerances=False)
        )
        for item in (machine, other)
    )
    np.testing.assert_allclose([v for _, v in second], [v for _, v in first], rtol=1e-8, atol=0)


def test_commands_with_other_names(pair, tmp_path):
    machine, path = pair
    controller = tmp_path / "pid.json"
    assert call("check", path).exit_code == 0
    # a rig's own PID loses twice nominal pressure
    lost = any(point.label == "twice nominal pressure" for point in machine.operation.points)
    synthesized = call("synthesize", path, "--method", "pid", "-o", controller)
    assert synthesized.exit_code == int(lost)
    done = call(
        "simulate",
        path,
        "--controller",
        controller,
        "--scenario",
        "force-step",
        "--linear",
        "-o",
        tmp_path / "r.h5",
    )
    assert done.exit_code in {0, 1} and "Traceback" not in done.output
    wrong = call("verify", machine.name, "--controller", controller)
    assert wrong.stderr.startswith(
        f"note: {controller} was made for other numbers of {machine.name};"
    )
    assert (
        wrong.exit_code == 2
        and "this controller is for another machine" in wrong.stderr.splitlines()[-1]
    )
    assert json.loads(call("check", path, "--json").stdout)["mass_kg"] > 1
    assert Path(controller).exists()


def real(machine):
    """With what real machines have: two sensor pairs per bearing at angles of their own, supports,
    a mode of the casing.
    """
    pairs = tuple(
        replace(s, position=s.position + side * 0.01, angle=0.4 + 0.3 * side, weight=2.0 + side)
        for s in machine.sensors
        for side in (1, -1)
    )
    first, last = machine.bearings[0].name, machine.bearings[-1].name
    supports = (
        Support(first, (80.0, 95.0), (6e7, 9e7), (6e4, 8e4), seals=(machine.seals[0].name,)),
        Support(last, (120.0, 120.0), (2e8, 1.2e8), (9e4, 9e4), angle=0.3, sensor="ground"),
    )
    casing = (
        CasingMode(900.0, 900.0, (first, machine.seals[0].name), (1.0, 0.5), (0.0, 0.3), 0.05),
    )
    return replace(machine, sensors=pairs, supports=supports, casing_modes=casing)


def responses(machine, point, names=None):
    """The full loop's responses under the reference PID, by signal; names: this machine's names ->
    those to call them by.
    """
    loop = closed_loop(assemble(machine, point), pid_controller(machine.controller, machine))
    values = frequency_response(loop, np.geomspace(2.0, 3e3, 12)).values

    def called(signal):
        return re.sub(r"(?<=_)(\w+)(?=_\w+$)", lambda m: (names or {}).get(m[1], m[1]), signal)

    inputs, outputs = ([called(name) for name in side] for side in (loop.inputs, loop.outputs))
    return {(o, i): values[:, k, j] for k, o in enumerate(outputs) for j, i in enumerate(inputs)}


def largest_difference(one, two):
    """Of every kind of response (y over f, ...) relative to the largest of its kind."""
    assert one.keys() == two.keys()
    worst = {}
    for (o, i), values in one.items():
        kind = (o.split("_")[0], i.split("_")[0])
        size, gap = worst.get(kind, (0.0, 0.0))
        worst[kind] = max(size, np.abs(values).max()), max(gap, np.abs(values - two[o, i]).max())
    return max(gap / size for size, gap in worst.values() if size)


def test_the_real_machine_does_not_depend_on_names_order_or_the_end_counted_from(tmp_path):
    machine = real(amb.load_machine("seal-rig"))
    point = machine.operation.points[0]
    base = responses(machine, point)
    text = dumps_machine(machine)
    for old, new in (("A", "DE"), ("B", "NDE"), ("center", "balance")):
        text = re.sub(rf'"{old}"', f'"{new}"', text)
        text = re.sub(rf'"(bearing|seal|coupling|sensor)\.{old}\.', rf'"\1.{new}.', text)
    back = {"DE": "A", "NDE": "B", "balance": "center"}
    assert largest_difference(base, responses(loads_machine(text), point, back)) < SAME
    still = replace(point, speed=0.0, seal_pressure=0.0)
    turned = replace(machine, supports=machine.supports[::-1])
    assert largest_difference(base, responses(turned, point)) < SAME
    # counted from the other end the second pair of every bearing comes first, along which y_ then
    # is; currents and motion stay
    one, two = (
        {
            key: v
            for key, v in responses(m, still).items()
            if key[0][0] in "uiq" and key[1][0] in "ef"
        }
        for m in (machine, mirrored(machine))
    )
    assert largest_difference(one, two) < 1e-7
    units = dumps_machine(machine).replace("mass = [80.0, 95.0]", 'mass = ["80 kg", "95000 g"]')
    units = units.replace(
        "stiffness = [60000000.0, 90000000.0]", 'stiffness = ["60 N/um", "90 kN/mm"]'
    )
    assert units.count("95000 g") == units.count("90 kN/mm") == 1
    assert largest_difference(base, responses(loads_machine(units), point)) < SAME


def test_turning_all_that_is_around_the_rotor_turns_nothing_at_rest():
    """Bearings, sensors, supports, couplings by one angle: in their own axes, the same (the seal is
    alike all round).
    """
    machine = real(amb.load_machine("seal-rig"))
    machine = replace(machine, casing_modes=(), supports=machine.supports[:1])
    by = 0.7
    turned = replace(
        machine,
        bearings=tuple(replace(b, angle=b.angle + by) for b in machine.bearings),
        sensors=tuple(replace(s, angle=s.angle + by) for s in machine.sensors),
        couplings=tuple(replace(c, angle=c.angle + by) for c in machine.couplings),
        supports=tuple(replace(s, angle=s.angle + by) for s in machine.supports),
    )
    point = machine.operation.points[0]
    one, two = (responses(item, point) for item in (machine, turned))
    axes = {
        key: value
        for key, value in one.items()
        if all(name.endswith(("_zeta", "_eta")) for name in key)
    }
    assert largest_difference(axes, {key: two[key] for key in axes}) < 1e-8


@pytest.mark.usefixtures("values_alone")
def test_commands_on_a_real_machine(tmp_path):
    path = tmp_path / "real.toml"
    controller = tmp_path / "pid.json"
    record = tmp_path / "run.h5"
    path.write_text(dumps_machine(real(amb.load_machine("seal-rig"))), encoding="utf-8")
    checked = call("check", path, "--details")
    assert checked.exit_code == 0 and "sensors of A, B at another angle" in checked.output
    # the rig's own PID loses twice nominal pressure
    assert call("synthesize", path, "--method", "pid", "-o", controller).exit_code == 1
    scenario = tmp_path / "short.toml"
    scenario.write_text(
        'name = "short"\nduration = "1.2 s"\n'
        + "".join(
            f'[[prbs]]\nsignal = "e_every_{axis}"\namplitude = "0.2 A"\nbit_time = "1 ms"\nseed = '
            f"{seed}\n"
            for axis, seed in (("zeta", 0), ("eta", 1))
        )
    )
    done = call("simulate", path, "--controller", controller, "--scenario", scenario, "-o", record)
    assert done.exit_code == 0, done.output
    machine = amb.load_machine(path)
    found = amb.identify(machine, amb.read_record(record), amb.read_controller(controller))
    values = {
        item.path: item.value / item.start
        for item in found.parameters
        if "force_per_current" in item.path
    }
    assert len(values) == 4 and all(0.95 < ratio < 1.02 for ratio in values.values())
