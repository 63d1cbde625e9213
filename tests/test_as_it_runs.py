"""One rate and one delay from the machine file to the verdict, and a box around every operating
point.
"""

import json
from dataclasses import replace

import numpy as np
import pytest
from click.testing import CliRunner

import ambrose as amb
from ambrose.cli import main
from ambrose.core.scheduled import ScheduledSystem
from ambrose.core.statespace import StateSpace, append, series, transfer_function
from ambrose.judge import nominal
from ambrose.judge.controller_file import read_controller
from ambrose.judge.plants import judge_stability, plants_along_speed, small_along_speed
from ambrose.judge.result import (
    Status,
    Synthesis,
    certify,
    certify_as_it_runs,
    pid_synthesis,
    sampled_margins,
    without_fast_poles,
)
from ambrose.judge.verdict import verify_controller, verify_points
from ambrose.law.design_problem import design_plant
from ambrose.law.loop import DEFAULT, Timing
from ambrose.machine.description import Tolerance
from ambrose.machine.file.toml import read_machine_text
from ambrose.model.assemble import assemble
from ambrose.model.uncertainty import reduce
from coarse import coarse


@pytest.fixture(scope="module")
def stating(tmp_path_factory):
    """A machine file with 50 us of sample time and of delay, on a coarse shaft and without
    pressure.
    """
    text = read_machine_text("seal-rig").replace(
        "derivative_filter = 0.1\n",
        'derivative_filter = 0.1\nsample_time = "50 us"\ndelay = "50 us"\n',
    )
    for count in (3, 4, 5):
        text = text.replace(f"elements = {count}\n", "elements = 1\n")
    first, rest = text.split("[[operation.point]]", 1)
    _, tolerances = rest.split("[[tolerance]]", 1)
    kept = '\nlabel = "zero pressure"\nspeed = 0\nseal_pressure = 0\n\n[[tolerance]]\n'
    kept += 'parameter = "bearing.A.negative_stiffness"\nrelative = 0.1\n\n[requirements]'
    path = tmp_path_factory.mktemp("stating") / "machine.toml"
    path.write_text(
        first + "[[operation.point]]" + kept + tolerances.split("[requirements]", 1)[1],
        encoding="utf-8",
    )
    return path


def call(*arguments):
    result = CliRunner().invoke(main, [str(argument) for argument in arguments])
    assert result.exception is None or isinstance(result.exception, SystemExit), result.output
    return result


def test_every_command_judges_the_loop_that_runs(stating, tmp_path):
    """The sampled sensitivity peak of design, verification and the code's header is one number; the
    rig runs at that rate.
    """
    controller = tmp_path / "controller.json"
    call("synthesize", stating, "--method", "pid", "-o", controller)
    designed = read_controller(controller).certificate.margins
    # the delay costs
    assert designed["sampled_sensitivity_peak"] > 1.01 * designed["sensitivity_peak"]
    verdict = json.loads(call("verify", stating, "--controller", controller, "--json").stdout)
    assert verdict["timing"].startswith("sampled at 20000 Hz, 1 sample late")
    checks = {check["name"]: check["value"] for check in verdict["points"][0]["checks"]}
    assert checks["sensitivity.output.max"] == pytest.approx(
        designed["sampled_sensitivity_peak"], rel=1e-3
    )
    (box,) = verdict["tolerances"]
    inside = {check["name"]: check for check in box["checks"]}
    assert (
        inside["sampled.sensitivity.box"]["value"]
        >= (1 - 1e-6) * designed["sampled_sensitivity_peak"]
    )
    assert inside["sampled.sensitivity.box"]["value"] == pytest.approx(
        inside["robust.sensitivity.worst"]["value"], rel=0.02
    )
    exported = call(
        "export", controller, "--to", "c", "-o", tmp_path / "code", "--machine", stating
    )
    missed = not verdict["passed"]
    assert (
        exported.exit_code == (1 if missed else 0)
        and ("misses a limit" in exported.stderr) == missed
    )
    header = (tmp_path / "code" / "controller.h").read_text()
    assert "20000 Hz" in header and f"{designed['sampled_sensitivity_peak']:.3g}"[:4] in header
    trace = amb.simulate(str(stating), controller, "impulse-parallel")
    assert trace.record.sample_rate_hz == pytest.approx(20000.0)
    linear = amb.simulate(str(stating), controller, "impulse-parallel", linear=True)
    assert linear.record.sample_rate_hz == pytest.approx(20000.0)
    given = amb.verify(str(stating), controller, tolerances=False, rate=5000.0)
    assert given.worst["sensitivity.output.max"].value > 1.05 * designed["sampled_sensitivity_peak"]


def test_a_loop_that_is_unstable_as_it_runs_is_never_verified(stating, tmp_path):
    """Held continuously, lost at 2 kHz: each command says so by its exit status, none calls it
    completed without a word.
    """
    slow = tmp_path / "slow.toml"
    slow.write_text(
        stating.read_text(encoding="utf-8").replace('"50 us"', '"1.5 ms"'), encoding="utf-8"
    )
    controller = tmp_path / "controller.json"
    assert call("synthesize", slow, "--method", "pid", "-o", controller).exit_code == 1
    file = read_controller(controller)
    assert (
        file.status is Status.UNSTABLE and file.certificate.margins["sampled_spectral_abscissa"] > 0
    )
    # without its timing it would pass
    assert certify(assemble(amb.load_machine(str(slow))), file.controller).stable
    assert call("verify", slow, "--controller", controller).exit_code == 1
    scenario = tmp_path / "short.toml"
    scenario.write_text('name = "short"\nduration = "3 ms"\n', encoding="utf-8")
    run = call(
        "simulate",
        slow,
        "--controller",
        controller,
        "--scenario",
        scenario,
        "-o",
        tmp_path / "r.h5",
        "--json",
    )
    said = json.loads(run.stdout)
    assert run.exit_code == 1 and not said["stable"]
    assert said["outcome"] != "completed" or "unstable as it runs" in said["text"]
    assert (
        call(
            "export", controller, "--to", "c", "-o", tmp_path / "code", "--machine", slow
        ).exit_code
        == 2
    )


def test_a_loop_that_no_rate_is_known_of_and_that_the_assumed_one_would_lose_is_not_passed():
    """The turboexpander's own PID held all limits of stability as a continuous loop; rig and code
    run it at 10 kHz and one sample late, where it grows. One that holds there gets no check.
    """
    machine = coarse("turboexpander")
    plant = assemble(machine)
    law = pid_synthesis(plant).controller
    (checks,) = verify_points([plant], law)
    growth = checks["timing.assumed"]
    grown = judge_stability(plant, law, DEFAULT).abscissa
    assert checks.stable and growth.passed is False and growth.value == grown > 0
    assert "sample_time in [controller] or --rate-hz" in growth.detail
    verdict = amb.verify(machine, law, points=[plant.point], tolerances=False)
    assert "timing.assumed" in verdict.worst and not verdict.passed
    quiet = assemble(coarse("seal-rig"))
    # a known rate, or one at which it holds: nothing is assumed
    for found in (
        verify_points([plant], law, timing=Timing(1e-5, 1)),
        verify_points([quiet], pid_synthesis(quiet).controller),
    ):
        assert not [check for item in found for check in item.checks if "timing" in check.name]


def test_the_box_goes_around_every_operating_point():
    """One tolerance holds everywhere, one of the seal vanishes without pressure, one is for a
    single point.
    """
    machine = coarse("seal-rig")
    tolerances = (
        Tolerance("bearing.A.negative_stiffness", relative=0.1),
        Tolerance("seal.center.k", relative=0.1),
        Tolerance("coupling.coupling.stiffness", relative=0.1, around=("zero pressure",)),
    )
    machine = replace(machine, tolerances=tolerances)
    plants = [
        reduce(amb.assemble(machine, label), 0)
        for label in ("zero pressure", "nominal pressure", "twice nominal pressure")
    ]
    verdict = verify_controller(plants, pid_synthesis(plants[0]).controller)
    stable = [checks.label for checks in verdict.points if checks.stable]
    # the PID does not hold twice the pressure
    assert stable == ["zero pressure", "nominal pressure"]
    assert [box.label for box in verdict.boxes] == [
        f"over all tolerances around {label}" for label in stable
    ]
    assert [len(box.found[0]) if box.found else None for box in verdict.boxes] == [2, 2]
    assert {"bearing.A.negative_stiffness", "coupling.coupling.stiffness"} == set(
        verdict.boxes[0].found[0]
    )
    assert {"bearing.A.negative_stiffness", "seal.center.k"} == set(verdict.boxes[1].found[0])
    assert verdict.not_varied[:2] == (
        "zero pressure: seal.center.k (zero here)",
        "nominal pressure: coupling.coupling.stiffness (given for zero pressure only)",
    )
    assert verdict.to_dict()["not_varied"] == list(verdict.not_varied)


def test_a_box_that_fails_at_another_point_fails_the_verification():
    """Around zero pressure the PID bears 30 % of k_s, around the nominal point it does not: the
    first box alone would pass.
    """
    machine = replace(coarse("seal-rig"), tolerances=(Tolerance("seal.center.k", absolute=1.6e6),))
    plants = [
        reduce(amb.assemble(machine, label), 0) for label in ("zero pressure", "nominal pressure")
    ]
    verdict = verify_controller(plants, pid_synthesis(plants[0]).controller)
    first, second = (box["robust.stability.box"] for box in verdict.boxes)
    assert first.passed and second.passed is False and not verdict.passed


def test_a_schedule_is_judged_as_it_runs_at_every_speed_of_its_grid():
    """At 1 kHz it loses the shaft that it holds continuously; the verification says which loop it
    judged.
    """
    machine = replace(coarse("turboexpander"), tolerances=())
    plant = amb.assemble(machine, "140 Hz")
    K = pid_synthesis(plant).controller
    law = ScheduledSystem([plant.point.speed / 2, plant.point.speed], [K, K])
    quick, slow = (sampled_margins(plant, law, Timing(dt)) for dt in (1e-5, 1e-3))
    assert quick["sampled_spectral_abscissa"] < 0 < slow["sampled_spectral_abscissa"]
    verdict = verify_controller(plant, law, rate=1e3)
    assert not verdict.stable and verdict.timing == "sampled at 1000 Hz, 1 sample late (given)"
    speeds = plant.point.speed / 2, plant.point.speed
    found = verify_controller(plant, law, rate=1e5).points[0]
    own = nominal.check(
        plant,
        Timing(1e-5).in_loop(K),
        plant_at=plants_along_speed(plant),
        small_at=small_along_speed(plant),
        covered=speeds,
    )
    # between two equal controllers a third one rounds
    assert [(check.name, check.passed, check.limit) for check in found.checks] == [
        (check.name, check.passed, check.limit) for check in own.checks
    ]
    assert [check.value for check in found.checks] == pytest.approx(
        [check.value for check in own.checks], rel=1e-12
    )


def fast(controller, pole):
    """The controller behind a low-pass at ``pole`` [rad/s] on every axis."""
    lags = [transfer_function([1.0], [1 / pole, 1.0], name, name) for name in controller.inputs]
    return series(append(*lags), controller)


def test_poles_beyond_half_the_rate_are_replaced_and_the_rest_is_certified_anew():
    plant = reduce(assemble(coarse("seal-rig")), 0)
    base, timing = pid_synthesis(plant), Timing(1e-4)
    made = replace(base, controller=fast(base.controller, 7.8e4), gamma=1.0)
    problem = design_plant(plant, uncertain=False)
    slow = without_fast_poles(made, timing, problem)
    assert slow.controller.n_states == made.controller.n_states - 4 and np.isnan(slow.gamma)
    assert (
        certify(plant, slow.controller).fastest_pole
        <= np.pi / 1e-4
        < certify(plant, made.controller).fastest_pole
    )
    assert slow.certificate.stable and "4 states beyond half the sample rate" in slow.notes[-1]
    assert without_fast_poles(base, timing, problem) is base


def test_a_controller_that_is_unstable_by_itself_is_said_at_the_design():
    plant = reduce(assemble(coarse("seal-rig")), 0)
    base = pid_synthesis(plant)
    K = base.controller
    n, m = K.n_states, len(K.inputs)
    # an unreachable state that runs away: the loop is judged unstable, the note says why
    away = StateSpace(
        np.block([[K.A, np.zeros((n, 1))], [np.zeros((1, n)), np.array([[13.0]])]]),
        np.vstack([K.B, np.zeros((1, m))]),
        np.hstack([K.C, np.zeros((m, 1))]),
        K.D,
        K.inputs,
        K.outputs,
    )
    judged = certify_as_it_runs(
        plant, Synthesis(away, certificate=certify(plant, away)), Timing(1e-4)
    )
    assert "+13 rad/s" in judged.notes[-1] and "force" in judged.notes[-1]
    assert certify_as_it_runs(plant, base, Timing(1e-4)).notes == ()
