"""From a scheduled controller to code: verified at frozen speeds, refused, delivered, commanded,
and running the rig.
"""

import json
import re
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

import code_driver as driver
from ambrose import StateSpace, load_machine
from ambrose.cli import main
from ambrose.code import sampled as scheduled_deploy
from ambrose.code.block.run import run_of
from ambrose.code.block.scheduled import build_scheduled_block
from ambrose.code.c.code import write_code
from ambrose.code.c.compiled import CompiledSchedule, read_law
from ambrose.code.pipeline import export, machine_limits
from ambrose.code.sampled import deploy_scheduled, sensitivity_peak
from ambrose.core.checks import InvalidInput, UnstableSystem
from ambrose.core.scheduled import ScheduledSystem
from ambrose.judge import nominal
from ambrose.judge.checks import Check, Checks
from ambrose.judge.controller_file import read_controller, write_controller
from ambrose.judge.result import Certificate, Synthesis
from ambrose.law.law import ControlProgram, ScheduledProgram
from ambrose.model.assemble import assemble
from ambrose.rig import virtual_rig
from ambrose.rig.engine.controller import sample_time
from ambrose.rig.scenario import load_scenario
from ambrose.synthesis.design import design
from needs import needs
from schedule_driver import block_of, small_schedule

GUIDE = Path(__file__).parents[2] / "docs" / "reference" / "c-code.md"
DT = 1e-4
TOP = 300.0  # rad/s
compiler = needs("cc")


def gains(K, speeds, factors):
    """One controller over speed, its output gain differing from point to point."""
    systems = [StateSpace(K.A, K.B, f * K.C, f * K.D, K.inputs, K.outputs) for f in factors]
    return ScheduledSystem(np.array(speeds), systems)


def with_points(machine, *which):
    """The machine with some of its operating points: a verification of each takes half a second."""
    points = tuple(machine.operation.points[i] for i in which)
    return replace(machine, operation=replace(machine.operation, points=points))


@pytest.fixture(scope="module")
def rig():
    """The seal rig at nominal and twice the nominal pressure, and a fixed controller for it."""
    machine = with_points(replace(load_machine("seal-rig"), tolerances=()), 0, 2)
    return machine, design(assemble(load_machine("seal-rig")), "hinf").controller


@pytest.fixture(scope="module")
def deployment(rig):
    machine, K = rig
    return deploy_scheduled(gains(K, [0.0, TOP], [1.0, 1.1]), DT, DT, machine=machine)


@pytest.fixture(scope="module")
def file(rig, tmp_path_factory):
    """A controller file with a schedule, as the synthesis writes it."""
    machine, K = rig
    certificate = Certificate(True, -1.0, 1.0, 1e4, plant="by hand")
    result = Synthesis(
        K, "lpv", 1.0, "verified", certificate, scheduled=gains(K, [0.0, TOP], [1.0, 1.1])
    )
    path = tmp_path_factory.mktemp("lpv") / "lpv.json"
    return write_controller(path, result, machine, datetime(2026, 1, 1, tzinfo=UTC))


def call(*arguments):
    return CliRunner().invoke(main, ["export", *(str(argument) for argument in arguments)])


def test_the_sampled_loop_is_verified_at_the_grid_and_between(rig, deployment):
    machine, _ = rig
    assert deployment.verified
    assert deployment.values == [0.0, TOP / 2, TOP]
    assert [c.stable for c in deployment.checks] == [True] * 3
    assert [c.label for c in deployment.points] == [p.label for p in machine.operation.points]
    plant = assemble(machine, replace(machine.operation.points[0], speed=TOP / 2))
    meant = nominal.check(plant, deployment.in_loop(TOP / 2))
    assert deployment.checks[1]["sensitivity.output.max"].value == pytest.approx(
        meant["sensitivity.output.max"].value
    )
    peak, where = sensitivity_peak(deployment.checks)
    assert peak == max(c["sensitivity.output.max"].value for c in deployment.checks)
    assert where in {c.label for c in deployment.checks}


def test_a_speed_at_which_the_loop_is_unstable_refuses(rig, monkeypatch):
    machine, K = with_points(rig[0], 0), rig[1]
    weak = gains(K, [100.0, 200.0], [1.0, 0.01])
    found = deploy_scheduled(weak, DT, DT, machine=machine, between=0, force=True)
    assert found.problems == ("the sampled loop is unstable at 200 rad/s",)
    assert [c.label for c in found.outside] == ["nominal pressure"]  # at rest, below the range
    assert found.points == ()
    done = {c.label: c for c in (*found.checks, *found.outside)}
    monkeypatch.setattr(scheduled_deploy, "check_sampled", lambda plant, K: done[plant.point.label])
    with pytest.raises(
        UnstableSystem,
        match=r"the sampled loop is unstable at 200 rad/s; design or verify it again",
    ):
        deploy_scheduled(weak, DT, DT, machine=machine, between=0)


def test_tolerances_are_examined_at_the_ends_and_inside(rig, monkeypatch):
    speeds = []

    def box(plant, late, held):
        assert [item.parameter for item in held]
        speeds.append(plant.point.speed)
        unstable = float(plant.point.speed == TOP)
        check = Check(
            "sampled.stability.box", "", unstable, "-", 0.0, "<=", unstable == 0, detail="5 corners"
        )
        return Checks("", True, (check,))

    monkeypatch.setattr(scheduled_deploy, "check_over_box", box)
    monkeypatch.setattr(
        scheduled_deploy, "check_sampled", lambda plant, K: Checks(plant.point.label, True, ())
    )
    schedule = gains(rig[1], [0.0, 100.0, TOP], [1.0, 1.0, 1.0])
    with pytest.raises(
        UnstableSystem, match=r"unstable over the tolerances at 300 rad/s at 1 points \(5 corners\)"
    ):
        deploy_scheduled(schedule, DT, DT, machine=load_machine("seal-rig"))
    assert speeds == [0.0, 100.0, TOP]


@pytest.mark.parametrize(
    ("status", "message"),
    [
        ("unstable", "the controller's status is 'unstable', not 'verified'"),
        (None, "it carries no certificate|no certificate"),
    ],
)
def test_a_controller_that_was_not_verified_is_refused(rig, status, message):
    schedule = small_schedule()
    result = (
        schedule
        if status is None
        else Synthesis(
            schedule.at(100.0),
            "lpv",
            1.0,
            status,
            Certificate(False, 1.0, 1.0, 1.0),
            scheduled=schedule,
        )
    )
    with pytest.raises(UnstableSystem, match=message):
        deploy_scheduled(result, DT)


def test_the_files_are_delivered_with_what_was_verified(rig, file, tmp_path):
    done = export(
        read_controller(file),
        tmp_path / "code",
        to="c",
        machine=with_points(rig[0], 1),
        name="rig",
        speed_rate=500.0,
    )
    assert done.deployment.verified
    names = ["rig.c", "rig.h", "rig_report.md", "rig_test.c", "rig_vectors.csv"]
    assert (
        sorted(p.name for p in done.paths)
        == sorted(p.name for p in (tmp_path / "code").iterdir())
        == names
    )
    header = (tmp_path / "code" / "rig.h").read_text()
    for text in (
        "Controller lpv, written 2026-01-01",
        "stable at 3 of 3 frozen speeds from 0 to 300 rad/s, sensitivity peak",
        "Verified   twice nominal pressure: stable",
        "Between    grid points within",
        "#define RIG_SPEED_RATE 500",
        "RIG_ERR_B_ETA = 3 /* within +-0.0005 m */",
    ):
        assert text in header
    assert "Forced" not in header


def test_the_command_forces_and_says_so(file, tmp_path):
    """Without the machine, which has changed since, nothing can be examined."""
    options = [
        file,
        "--to",
        "c",
        "-o",
        tmp_path / "code",
        "--error-limit",
        5e-4,
        "--current-limit",
        4.0,
        "--name",
        "rig",
    ]
    done = call(*options)
    assert done.exit_code == 2
    assert "its sampled loop was not examined: no machine was given" in done.stderr
    assert not (tmp_path / "code").exists()
    done = call(*options, "--force", "--json", "--arithmetic", "float", "--speed-limit", 400)
    assert done.exit_code == 1, done.stderr
    assert not json.loads(done.stdout)["verified"]
    header = (tmp_path / "code" / "rig.h").read_text()
    for text in (
        "Verified   NOT",
        "Forced     although its sampled loop was not examined",
        "RIG_SPEED_LIMIT 400.0f",
    ):
        assert text in header


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (
            ["--to", "st", "--arithmetic", "fixed32"],
            "--arithmetic is 'fixed32'",
        ),
        (
            ["--to", "fmu", "--arithmetic", "fixed16"],
            "arithmetic of a scheduled controller is 'fixed16'",
        ),
        (
            ["--to", "c", "--arithmetic", "fixed32"],
            "arithmetic of a scheduled controller is 'fixed32'",
        ),
        (
            ["--to", "c", "--speed-limit", 200],
            "speed_limit is 200 rad/s, but must be at least 300 rad/s",
        ),
        (["--to", "c", "--speed-rate", 0], "speed_rate is 0.0, but must be positive"),
        (["--to", "c", "--rate-hz", 3000], "the sample rate is 3000 Hz"),
    ],
)
def test_what_a_schedule_cannot_be(file, tmp_path, options, message):
    done = call(
        file,
        *options,
        "-o",
        tmp_path / "code",
        "--error-limit",
        5e-4,
        "--current-limit",
        4.0,
        "--force",
    )
    assert done.exit_code == 2
    assert message in done.stderr
    assert not (tmp_path / "code").exists()


@pytest.mark.parametrize("matrix", ["A", "B", "C"])
def test_numbers_that_overflow_are_refused_in_a_sentence(file, tmp_path, matrix):
    """Of a damaged file, at one point of the schedule."""
    document = json.loads(file.read_text())
    rows = document["scheduling"]["points"][0][matrix]
    document["scheduling"]["points"][0][matrix] = [[1.7e308] * len(row) for row in rows]
    damaged = tmp_path / "lpv.json"
    damaged.write_text(json.dumps(document))
    limits = ["--error-limit", 5e-4, "--current-limit", 4.0, "--force"]
    done = call(damaged, "--to", "c", "-o", tmp_path / "code", *limits)
    assert done.exit_code == 2 and "cannot be computed to any accuracy" in done.stderr
    assert not (tmp_path / "code").exists()


@compiler
def test_the_guides_example_compiles(tmp_path):
    write_code(tmp_path, block_of(small_schedule(), "turbo"))
    example = re.findall(r"```c\n(.*?)```", GUIDE.read_text(), re.DOTALL)[1]
    assert "turbo_step" in example
    (tmp_path / "example.c").write_text(example)
    driver.build("gcc", ["-c", str(tmp_path / "example.c"), "-o", str(tmp_path / "example.o")])


def test_speeds_mean_nothing_to_a_fixed_controller(rig, tmp_path):
    path = write_controller(tmp_path / "k.json", rig[1])
    with pytest.raises(InvalidInput, match="this controller is not scheduled over speed"):
        export(
            read_controller(path),
            tmp_path / "code",
            to="c",
            machine=rig[0],
            speed_rate=1.0,
        )


@compiler
def test_the_running_code_follows_the_block():
    block = block_of(small_schedule(), rate_limit=1e5)
    code = CompiledSchedule(block)
    e = np.random.default_rng(3).normal(0, 3e-4, (500, 2))
    v = np.linspace(0.0, 700.0, 500)
    v[100:150] = np.nan
    expected = run_of(block, e, v)
    assert np.abs(code.run(e, v) - expected.currents).max() <= 1e-12 * block.current_limit.max()
    np.testing.assert_allclose(code.states(), expected.states, rtol=1e-9, atol=1e-15)
    assert code.status == expected.status[-1]


@compiler
@pytest.mark.parametrize(("arithmetic", "apart"), [("double", 1e-12), ("float", 1e-5)])
def test_the_law_is_read_back_out_of_the_running_code(arithmetic, apart):
    block = block_of(small_schedule())
    code = CompiledSchedule(block, arithmetic)
    for speed in (100.0, 175.0, 300.0, 599.0):
        found, meant = read_law(code, speed), block.at(speed)
        for letter in "ABCD":
            assert (
                np.abs(getattr(found, letter) - getattr(meant, letter)).max()
                <= apart * np.abs(getattr(meant, letter)).max()
            )
    with pytest.raises(InvalidInput, match="clamps its readings"):
        read_law(code, 700.0)


@compiler
def test_a_running_code_takes_over_without_a_bump():
    block = block_of(small_schedule())
    code = CompiledSchedule(block)
    code.schedule(420.0)
    code.track(np.array([1e-5, 0.0]), np.array([0.5, -1.0]))
    assert np.abs(code.step(np.array([1e-5, 0.0])) - [0.5, -1.0]).max() < 1e-12


class Listening:
    """The law in Python as a program, which notes the speeds it is told."""

    def __init__(self, block):
        self.block, self.told = block, []

    sample_time, delay = DT, 1

    @property
    def system(self):
        return self.block.at(0.0)

    def __call__(self, speed):
        return self.block.at(speed)

    def schedule(self, speed):
        self.told.append(speed)

    def begin(self, states):
        self.x = states

    def step(self, errors):
        K = self.block.at(self.told[-1])
        u = K.C @ self.x + K.D @ errors
        self.x = K.A @ self.x + K.B @ errors
        return u


@pytest.fixture(scope="module")
def running(rig, deployment):
    """Machine, block and a short run-up through the range with steps of force."""
    machine, _ = rig
    errors, currents = machine_limits(machine)
    block = build_scheduled_block(deployment, "rig", errors, currents)
    scenario = replace(load_scenario("impulse-parallel"), duration=0.06, speed=10.0, to_speed=290.0)
    return machine, block, scenario


@compiler
def test_the_code_runs_the_rig_through_a_run_up(running):
    machine, block, scenario = running
    point = machine.operation.points[0]
    code = CompiledSchedule(block)
    assert isinstance(code, ScheduledProgram)
    assert isinstance(code, ControlProgram)
    ran = virtual_rig.run(machine, code, scenario, point=point)
    law = virtual_rig.run(machine, Listening(block), scenario, point=point)
    # the same law, for 50 samples each
    held = virtual_rig.run(machine, block.at, scenario, point=point)
    assert ran.outcome == law.outcome == "completed"
    names = [f"y_{axis}" for axis in machine.axes]
    size = max(np.ptp(law.record[name]) for name in names)
    assert size > 1e-6
    assert max(np.abs(ran.record[name] - law.record[name]).max() for name in names) < 1e-9 * size
    assert max(np.abs(ran.record[name] - held.record[name]).max() for name in names) < 0.02 * size
    assert ran.pole == pytest.approx(held.pole)
    assert code.told == pytest.approx(290.0, rel=0.01)


def test_the_rig_runs_a_sampled_schedule_at_its_own_rate(rig, deployment):
    assert sample_time(deployment.sampled, rig[0], None) == DT
    with pytest.raises(InvalidInput, match=r"the sample time is 0\.0002 s"):
        sample_time(deployment.sampled, rig[0], 2e-4)


@compiler
def test_at_a_constant_speed_the_rig_cannot_tell_the_code_from_the_law(running):
    machine, block, scenario = running
    point, scenario = machine.operation.points[0], replace(scenario, to_speed=None, speed=130.0)
    ran = virtual_rig.run(machine, CompiledSchedule(block), scenario, point=point)
    law = virtual_rig.run(machine, block.at(130.0), scenario, point=point)
    names = [f"y_{axis}" for axis in machine.axes]
    size = max(np.ptp(law.record[name]) for name in names)
    # both sum the same products in another order, so that currents differ by rounding
    assert max(np.abs(ran.record[name] - law.record[name]).max() for name in names) < 1e-9 * size


def test_the_rig_tells_a_program_the_speed_of_every_sample(running):
    machine, block, scenario = running
    program = Listening(block)
    trace = virtual_rig.run(machine, program, scenario, point=machine.operation.points[0])
    assert trace.outcome == "completed"
    assert program.told == pytest.approx(trace.record["speed"], rel=1e-12)
    with pytest.raises(InvalidInput, match="the sample time"):
        virtual_rig.run(
            machine, program, replace(scenario, sample_time=2e-4), point=machine.operation.points[0]
        )
