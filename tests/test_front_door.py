"""``import ambrose as amb``: the chain through the front door, what its results show, what wrong
input is answered.
"""

import json
import subprocess
import sys
from dataclasses import replace

import control
import numpy as np
import pytest

import ambrose as amb
from ambrose.model.assemble import assemble as plant_assemble

POINT = "nominal pressure"


@pytest.fixture(scope="module")
def machine():
    return amb.load_machine("seal-rig")


@pytest.fixture(scope="module")
def plant(machine):
    return amb.assemble(machine, POINT)


@pytest.fixture(scope="module")
def pid(machine):
    return amb.design(machine, "pid")


@pytest.fixture(scope="module")
def verdict(machine, pid):
    return amb.verify(machine, pid, points=["zero", "nominal"], tolerances=False)


@pytest.fixture(scope="module")
def run(machine, pid):
    return amb.simulate(machine, pid, "impulse-parallel", linear=True)


def test_dir_lists_the_front_door_and_nothing_else():
    names = dir(amb)
    assert {
        "assemble",
        "design",
        "verify",
        "simulate",
        "identify",
        "export",
        "study",
        "plot",
        "Machine",
        "StateSpace",
    } <= set(names)
    for name in names:
        assert getattr(amb, name) is not None
        if callable(getattr(amb, name)):
            assert getattr(amb, name).__doc__, name


def test_import_is_light():
    code = (
        "import sys, ambrose; print([m for m in ('numpy', 'scipy', 'plotly', 'numba', 'pandas') if "
        "m in sys.modules])"
    )
    assert (
        subprocess.run(
            [sys.executable, "-c", code], capture_output=True, text=True, check=True
        ).stdout.strip()
        == "[]"
    )


def test_a_design_without_a_synchronous_block_passes_none_of_its_files():
    """Nor does its verdict: the extension's table of plain data is all that the registry reads."""
    code = (
        "import sys, ambrose as amb; machine = amb.load_machine('seal-rig');"
        "law = amb.design(machine, 'pid'); amb.verify(machine, law, tolerances=False);"
        "table = 'ambrose.annexes.synchronous';"
        "named = {m for m in sys.modules if 'ambrose' in m and 'synchronous' in m} - {table};"
        "sys.exit(', '.join(named) or 0)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_operating_points_by_label_by_noun_and_by_keyword(machine):
    by_label = amb.assemble(machine, "twice")
    noun = next(
        point for point in machine.operation.points if point.label == "twice nominal pressure"
    )
    by_keyword = amb.assemble(machine, POINT, seal_pressure=noun.seal_pressure)
    for other in (amb.assemble(machine, noun), by_keyword, plant_assemble(machine, "twice")):
        np.testing.assert_array_equal(by_label.system.A, other.system.A)


def test_chain(machine, plant, pid, verdict, run):
    assert pid.status == "verified"
    assert [checks.label for checks in verdict.points] == ["zero pressure", POINT]
    worst = verdict.worst["sensitivity.output.max"]
    assert worst.value == max(checks["sensitivity.output.max"].value for checks in verdict.points)
    assert run.outcome == "completed"
    assert amb.reduce(plant).bending_modes >= 1
    assert amb.reduce(plant, 0).bending_modes == 0


def test_a_control_system_goes_in_and_out(machine, pid):
    theirs = pid.controller.to_control()
    assert isinstance(theirs, control.StateSpace)
    np.testing.assert_array_equal(amb.StateSpace(theirs).A, pid.controller.A)
    ours, back = (amb.verify(machine, law, points=POINT, tolerances=False) for law in (pid, theirs))
    one, other = back.to_dict(), ours.to_dict()
    assert one.pop("controller") == "not from a controller file"
    assert "pid, SHA-256" in other.pop("controller")
    assert one == other


def test_order_of_the_signals_does_not_matter(machine, pid):
    K, turned = pid.controller, [2, 0, 3, 1]
    other = amb.StateSpace(
        K.A,
        K.B[:, turned],
        K.C[turned],
        K.D[np.ix_(turned, turned)],
        inputs=[K.inputs[i] for i in turned],
        outputs=[K.outputs[i] for i in turned],
        dt=K.dt,
    )
    first, second = (amb.verify(machine, law, points=POINT, tolerances=False) for law in (K, other))
    assert second.passed == first.passed
    value = first.worst["sensitivity.output.max"].value
    assert second.worst["sensitivity.output.max"].value == pytest.approx(value, rel=1e-9)


@pytest.mark.parametrize("name", ["machine", "plant", "pid", "verdict", "run"])
def test_results_show_themselves(name, request):
    item = request.getfixturevalue(name)
    assert len(repr(item)) < 200
    assert "\n" not in repr(item)
    assert "<table" in item._repr_html_()
    if hasattr(item, "to_dict"):
        json.dumps(item.to_dict())
    figure = amb.plot(item)
    assert figure.data


def test_frames(verdict, run):
    pandas = pytest.importorskip("pandas")
    assert isinstance(verdict.to_frame(), pandas.DataFrame)
    assert len(run.to_frame()) == run.record.values.shape[1]


WRONG = [
    (lambda m, c: amb.load_machine("seal-rigg"), "seal-rig"),
    (lambda m, c: amb.load_machine(3), "machine"),
    (lambda m, c: amb.assemble(m, "no such point"), "nominal pressure"),
    (lambda m, c: amb.assemble(m, 7), "operating point"),
    (lambda m, c: amb.assemble(m, speeed=3.0), "speed"),
    (lambda m, c: amb.reduce(m), "assemble"),
    (lambda m, c: amb.reduce(amb.assemble(m), 1.5), "whole number"),
    (lambda m, c: amb.assemble(m, seal_pressure="2 bar"), "Pa"),
    (lambda m, c: amb.OperatingPoint(speed="3000 rpm"), "number in SI"),
    (lambda m, c: amb.design(m, "PID"), "pid"),
    (lambda m, c: amb.verify(m, control.tf([1], [1, 1])), "transfer function"),
    (lambda m, c: amb.verify(m, lambda speed: speed), "system"),
    (lambda m, c: amb.write_record(3, "x.h5"), "Record"),
    (lambda m, c: amb.design(m, "pidd"), "pid"),
    (lambda m, c: amb.design(m, 3), "method"),
    (lambda m, c: amb.verify(m, "no-such.json"), "no-such.json"),
    (lambda m, c: amb.verify(m, 3), "controller"),
    (lambda m, c: amb.verify(m, control.ss([], [], [], np.eye(3))), "(4, 4)"),
    (lambda m, c: amb.verify(m, c, points="elsewhere"), "nominal pressure"),
    (lambda m, c: amb.simulate(m, c, "levitatoin"), "levitation"),
    (lambda m, c: amb.simulate(m, 3), "controller"),
    (lambda m, c: amb.identify(m, [], c), "record"),
    (lambda m, c: amb.identify(m, 3, c), "record"),
    (lambda m, c: amb.identify(m, "no-such.h5", c), "no-such.h5"),
    (lambda m, c: amb.export(c, "somewhere", to="fortran"), "c"),
    (lambda m, c: amb.plot(3), "plot"),
    (lambda m, c: amb.StateSpace(3), "A"),
    (lambda m, c: amb.read_record(3), "record"),
    (lambda m, c: amb.read_controller(3), "controller"),
    (lambda m, c: amb.save_machine(3, "m.toml"), "machine"),
    (lambda m, c: amb.write_controller("c.json", 3), "controller"),
    (lambda m, c: amb.study(3), "machine"),
    (lambda m, c: amb.hinf_synthesis(3), "plant"),
    (lambda m, c: amb.mu_bounds("x", [amb.RealBlock("k")]), "M"),
    (lambda m, c: amb.hinf_norm("x"), "system"),
    (lambda m, c: amb.run_up_steps(3, 4, ["y"]), "see help(run_up_steps)"),
    (lambda m, c: amb.hinf_norm(10**400), "the constant gain is not numeric"),
    (lambda m, c: amb.mu_bounds([[1.0]], [amb.RealBlock("k")], seed=-1), "seed"),
    (lambda m, c: amb.study(m, 3), "directory is 3"),
    (lambda m, c: amb.study(m, progress="x"), "progress is 'x'"),
    (lambda m, c: amb.export(c, None, to="c"), "directory is None"),
    (lambda m, c: amb.export(c, "code", to=[]), "target is [], but must be one of c, mat"),
    (lambda m, c: amb.export(c, "code", to="c", options={}), "there is no option 'options'"),
    (lambda m, c: amb.export("a\0b", "code", to="c"), "null"),
    (lambda m, c: amb.simulate(m, c, 3), "scenario"),
    (lambda m, c: amb.load_scenario(None), "path of the scenario is NoneType"),
    (lambda m, c: amb.Record("m", 1e3, 3, ("m",), np.zeros((1, 4))), "signals is 3"),
    (lambda m, c: amb.Record("m", 1e3, ("y_A",), ("m",), "loud"), "values is"),
    (lambda m, c: amb.Record("m", 1e3, ("y_A",), ("m",), np.zeros((1, 4)), notes=7), "notes is 7"),
    (lambda m, c: amb.identify(m, "r.csv", c, unknown=3), "unknown is 3"),
    (lambda m, c: amb.verify(m, c, points=[1.5]), "operating point is 1.5"),
    (lambda m, c: amb.verify(m, c, points=POINT, tolerances=False, progress=3), "progress is 3"),
    (lambda m, c: amb.reduce(amb.assemble(m), np.zeros(3)), "bending_modes is of type ndarray"),
    (lambda m, c: amb.write_controller("c.json", c, "machine"), "machine is 'machine'"),
    (lambda m, c: amb.write_controller(3, c), "path"),
    (
        lambda m, c: amb.Plant(m, "nominal", c.controller, c.controller, ()),
        "point is 'nominal', but must be an OperatingPoint",
    ),
    (lambda m, c: amb.Verification(("x",)), "points[0] is 'x', but must be a Checks"),
    (
        lambda m, c: amb.Trace(None, "s", True, "completed", ""),
        "record is None, but must be a Record",
    ),
    (lambda m, c: amb.Scenario("s", 1.0, pulses=("x",)), "pulses[0] is 'x'"),
    (lambda m, c: amb.StateSpace([[0.0]], [[0.0]], [[0.0]], [[0.0]], 3), "inputs is 3"),
    (lambda m, c: amb.GeneralizedPlant(c.controller, 3, [], [], []), "w is 3"),
    (lambda m, c: replace(m, shaft=(3,)), "shaft[0] is 3"),
    (lambda m, c: replace(m, operation=None), "operation is None"),
    (lambda m, c: plant_assemble(m, "nominel"), "nominal pressure"),
    (lambda m, c: plant_assemble(m, 3), "operating point is 3"),
]


@pytest.mark.parametrize("number", range(len(WRONG)))
def test_wrong_input_is_answered_in_one_sentence(number, machine, pid, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    call, word = WRONG[number]
    with pytest.raises(amb.InvalidInput) as refusal:
        call(machine, pid)
    message = str(refusal.value)
    assert word in message
    assert "\n" not in message
    assert len(message) < 500
