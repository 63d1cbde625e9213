"""Nothing depends on what bearings, seals and discs are called, on the end that positions are counted from, or on units."""

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

import ambrose as amb
from ambrose.cli import main
from ambrose.machine.file.toml import read_machine_text

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


@pytest.fixture(scope="module", params=["seal-rig", pytest.param("turboexpander", marks=pytest.mark.study)])
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
    return [(label, check.value) for label, checks in verification.labelled for check in checks.checks]


@pytest.mark.campaign
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


@pytest.mark.campaign
@pytest.mark.parametrize("method", ["hinf", pytest.param("mu", marks=pytest.mark.study)])
def test_robust_designs_do_not_depend_on_names(pair, method):
    machine, path = pair
    one, two = (amb.design(item, method) for item in (machine, amb.load_machine(path)))
    assert two.gamma == pytest.approx(one.gamma, rel=1e-6)
    peaks = [made.certificate.margins["full_sensitivity_peak"] for made in (one, two)]
    assert peaks[1] == pytest.approx(peaks[0], rel=1e-6)


CAMPAIGN = {"impulse-parallel", "operating-cycle"}


@pytest.mark.parametrize(
    "name",
    [pytest.param(n, marks=pytest.mark.campaign if n in CAMPAIGN else pytest.mark.study) for n in amb.bundled_scenarios()],
)
def test_every_scenario_runs_alike_under_other_names(pair, name):
    machine, path = pair
    other, scenario = amb.load_machine(path), amb.load_scenario(name)
    scenario = replace(scenario, duration=min(scenario.duration, 0.3)) if name in {"impulse-parallel", "prbs"} else scenario
    one, two = (amb.simulate(item, amb.design(item, "pid"), scenario, point=item.operation.points[-1].label)
                if name != "operating-cycle" else amb.simulate(item, amb.design(item, "pid"), scenario)
                for item in (machine, other))  # fmt: skip
    assert two.outcome == one.outcome
    assert two.record.signals == tuple(
        re.sub(r"_(A|B|center|piston|coupling)(?=_|$)", lambda m: f"_{NAMES[m[1]]}", s) for s in one.record.signals
    )
    if one.outcome == "completed" and np.isfinite(one.record.values).all():
        np.testing.assert_allclose(two.record.values, one.record.values, rtol=0, atol=SAME * np.abs(one.record.values).max())


def mirrored(machine):
    """The same machine with positions counted from the other end."""
    length = sum(section.length for section in machine.shaft)
    starts = [length - section.start - section.length for section in machine.shaft]
    moved = {
        name: tuple(replace(item, position=length - item.position) for item in reversed(getattr(machine, name)))
        for name in ("bearings", "sensors", "discs", "seals", "couplings")
    }
    shaft = [replace(section, start=start) for section, start in zip(machine.shaft, starts, strict=True)]
    return replace(machine, shaft=tuple(sorted(shaft, key=lambda section: section.start)), **moved)


@pytest.mark.campaign
def test_the_other_end_gives_the_same_at_standstill_without_pressure():
    """Mirrored, a rotor that turns, or a seal that pushes it sideways, would go the other way round."""
    machine = amb.load_machine("seal-rig")
    points = ("zero pressure",)
    one, two = (
        amb.verify(item, amb.design(item, "pid"), points=points, tolerances=False) for item in (machine, mirrored(machine))
    )
    first, second = ({check.name: check.value for check in item.points[0].checks} for item in (one, two))
    assert set(first) == set(second)
    np.testing.assert_allclose([second[name] for name in first], list(first.values()), rtol=1e-7, atol=0)


@pytest.mark.campaign
def test_other_units_say_the_same(tmp_path):
    text = read_machine_text("seal-rig").replace('"80 mm"', '"8 cm"').replace('"2.04 bar"', '"204 kPa"')
    text = text.replace('"500 Hz"', '"30000 rpm"').replace("18250 A/m", "18.25 mA/um").replace('"3.5 ms"', '"3500 us"')
    assert text.count("kPa") == 2 and "mA/um" in text
    path = tmp_path / "units.toml"
    path.write_text(text, encoding="utf-8")
    machine, other = amb.load_machine("seal-rig"), amb.load_machine(path)
    first, second = (
        numbers(amb.verify(item, amb.design(item, "pid"), points=("nominal", "zero"), tolerances=False))
        for item in (machine, other)
    )
    np.testing.assert_allclose([v for _, v in second], [v for _, v in first], rtol=1e-8, atol=0)


def test_commands_with_other_names(pair, tmp_path):
    machine, path = pair
    controller = tmp_path / "pid.json"
    assert call("check", path).exit_code == 0
    assert call("synthesize", path, "--method", "pid", "-o", controller).exit_code == 0
    done = call("simulate", path, "--controller", controller, "--scenario", "force-step", "--linear", "-o", tmp_path / "r.h5")
    assert done.exit_code in {0, 1} and "Traceback" not in done.output
    wrong = call("verify", machine.name, "--controller", controller)
    assert wrong.stderr.startswith(f"note: {controller} was made for other numbers of {machine.name};")
    assert wrong.exit_code == 2 and "this controller is for another machine" in wrong.stderr.splitlines()[-1]
    assert json.loads(call("check", path, "--json").stdout)["mass_kg"] > 1
    assert Path(controller).exists()
