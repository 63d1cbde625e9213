"""C code of a schedule with a fixed controller to fall back to: against its twin in Python, the
rig, and what is proved.
"""

from __future__ import annotations

import re
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import code_driver as driver
from ambrose import StateSpace
from ambrose.code.block.block import build_block
from ambrose.code.block.run import (
    LATCHED,
    REASON_AT,
    STATE_AT,
    run_of,
    vectors_of,
)
from ambrose.code.block.scheduled import build_scheduled_block, supervise, supervised_twin
from ambrose.code.c.code import generate
from ambrose.code.c.compiled import CompiledSchedule
from ambrose.code.pipeline import export, machine_limits
from ambrose.code.sampled import deploy, deploy_scheduled
from ambrose.core.checks import InvalidInput
from ambrose.core.scheduled import ScheduledSystem
from ambrose.law.pid import pid_controller
from ambrose.law.supervision import Fault, Limits, State
from ambrose.rig import virtual_rig
from ambrose.rig.scenario import PressureChange, PressureSensor, Pulse, Scenario
from coarse import coarse
from needs import needs
from schedule_driver import CURRENT, DT, ERROR, block_of, gain_schedule, pressure_schedule

compiler = needs("gcc or clang")
LOW, HIGH = 1e4, 6e4
WATCH = Limits(
    LOW, HIGH, 2e3, rate=2e6, noise=300.0, stuck=0.004, band=4e3, dwell=0.003, fade=0.002
)
CALM = Limits(LOW, HIGH, 2e3, band=4e3, dwell=0.001, fade=0.0)


def integrating():
    """Two errors, two currents, an integrator for each and a real pole."""
    A, B = np.diag([0.0, 0.0, -500.0]), [[30.0, 5.0], [0.0, 40.0], [2e3, 1e3]]
    return StateSpace(
        A,
        B,
        [[400.0, 20.0, 50.0], [0.0, 600.0, -30.0]],
        1.5e3 * np.eye(2),
        ["err_x", "err_y"],
        ["u_x", "u_y"],
    )


def gain():
    return StateSpace([], [], [], 2e3 * np.eye(2), ["err_x", "err_y"], ["u_x", "u_y"])


def small(watch=WATCH, schedule=None, fixed=None):
    fixed = build_block(deploy(fixed or integrating(), DT, DT, force=True), "lpv", ERROR, CURRENT)
    return supervise(block_of(schedule or pressure_schedule()), fixed, watch)


def over_pressure(schedule):
    return ScheduledSystem(100 * schedule.grid, schedule.systems, "pressure", "Pa")


def readings(count, seed=0):
    """Walks within the rate, jumps, losses, stuck and wild values; estimates near and far, sharp,
    wide and none.
    """
    rng = np.random.default_rng(seed)
    told = []
    at = 3e4
    while len(told) < count:
        kind, k = rng.integers(0, 7), int(rng.integers(5, 120))
        walk = np.clip(at + np.cumsum(rng.uniform(-150, 150, k)), LOW - 1e3, HIGH + 1e3)
        if kind == 4:
            walk = np.full(k, rng.choice([np.nan, np.inf, -np.inf, 1e300, HIGH + 5e3, 5e-324]))
        elif kind == 5:
            walk[:] = at
        elif kind == 6:
            walk += rng.uniform(-2e4, 2e4)
        told += walk.tolist()
        at = walk[-1] if LOW <= walk[-1] <= HIGH else at
    told = np.array(told[:count])
    estimate = np.where(
        rng.random(count) < 0.1, rng.uniform(LOW, HIGH, count), told + rng.uniform(-3e3, 3e3, count)
    )
    silent = np.repeat(rng.random(count // 50 + 1) < 0.5, 50)[:count]
    width = rng.choice([1e2, 3e3, 1e4, np.inf, -1.0, np.nan], count)
    return np.column_stack([told, np.where(silent, np.nan, estimate), width])


@compiler
@pytest.mark.parametrize(
    ("watch", "schedule", "fixed"),
    [
        (WATCH, None, None),
        (CALM, None, None),
        (WATCH, None, gain()),
        (WATCH, over_pressure(gain_schedule()), None),
    ],
    ids=["all watched", "little watched", "fixed without states", "schedule without states"],
)
def test_the_code_is_its_twin(watch, schedule, fixed):
    """Adversarial readings, estimates and errors; who is in charge and why is the same in every
    sample.
    """
    block, count = small(watch, schedule, fixed), 6000
    e = (
        np.random.default_rng(1).normal(0, 0.2 * ERROR, (count, 2))
        * np.repeat([1.0, 4.0, 0.01], count // 3)[:, None]
    )
    told = readings(count)
    twin, code = run_of(block, e, told), CompiledSchedule(block)
    currents, status = np.empty_like(twin.currents), np.empty(count, int)
    for k, (value, *estimate) in enumerate(told.tolist()):
        code.schedule(value)
        code.estimate = tuple(estimate)
        currents[k], status[k] = code.step(e[k]), code.status
    np.testing.assert_array_equal(status, twin.status)
    assert np.abs(currents - twin.currents).max() <= 1e-12 * CURRENT
    states, reasons = (
        set((status >> at & most).tolist()) for at, most in ((STATE_AT, 3), (REASON_AT, 7))
    )
    assert states == {0, 1, 2, 3} and reasons >= {Fault.NONE, Fault.LOST, Fault.RANGE}
    if watch is WATCH:
        assert reasons == set(Fault) and 0 < ((status & LATCHED) > 0).mean() < 1


@compiler
@pytest.mark.parametrize("arithmetic", ["double", "float"])
@pytest.mark.parametrize("watch", [WATCH, CALM], ids=["all watched", "little watched"])
def test_the_self_test_passes_and_meets_every_state_and_doubt(watch, arithmetic, tmp_path):
    block = small(watch)
    for name, text in generate(block, arithmetic).items():
        (tmp_path / name).write_text(text)
    for cc in driver.compilers():
        driver.build(
            cc,
            [
                *driver.sanitizers(cc),
                str(tmp_path / "lpv.c"),
                str(tmp_path / "lpv_test.c"),
                "-o",
                str(tmp_path / "t"),
            ],
        )
        done = subprocess.run([str(tmp_path / "t")], capture_output=True, text=True, check=False)
        assert done.returncode == 0 and " 0 wrong" in done.stdout, done.stdout
    status = vectors_of(block).status
    assert set((status >> STATE_AT & 3).tolist()) == set(State)
    assert set((status >> REASON_AT & 7).tolist()) == (
        set(Fault) if watch is WATCH else set(Fault) - {Fault.JUMP, Fault.STUCK}
    )
    text = (tmp_path / "lpv.c").read_text()
    assert "malloc" not in text
    # its own header, and some that a compiler brings without a library (C99, 4, paragraph 6)
    own, *others = re.findall(r"#include (\S+)", text)
    assert own == '"lpv.h"'
    assert others == ["<float.h>", "<limits.h>", "<stdbool.h>", "<stddef.h>"]


def test_states_stay_within_their_bounds_whoever_is_in_charge():
    """At frozen pressures, the largest errors by random signs, readings lost and found at
    random.
    """
    rng, block = np.random.default_rng(3), small(replace(WATCH, stuck=np.inf, rate=np.inf))
    for value in (LOW, 3.3e4, HIGH):
        twin, most = supervised_twin(block), 0.0
        for lost in np.repeat(rng.random(60) < 0.5, 50):
            twin.schedule(np.nan if lost else value)
            twin.step(rng.choice([-ERROR, ERROR], 2))
            most = max(most, *(np.abs(x).max() for x in twin._x))
        assert 0.05 < most <= 1.0
        assert len(twin.changes) > 20


@compiler
def test_a_transfer_goes_on_with_the_currents_given_whoever_is_in_charge():
    block = small(CALM)
    e = np.array([1e-5, -2e-5])
    given = np.array([0.7, -0.4])
    for told in (3e4, np.nan):
        code = CompiledSchedule(block)
        code.schedule(told)
        for _ in range(3):
            code.step(e)
        assert code.status >> STATE_AT & 3 == (0 if told == 3e4 else 2)
        code.track(e, given)
        np.testing.assert_allclose(code.step(e), given, atol=1e-9)


RIG = coarse("seal-rig")
PID = pid_controller(RIG.reference, RIG)
TOP = 4.08e5
SENSORS = {
    "late": (PressureSensor(lag=0.02),),
    "lost and back": (PressureSensor(0.02, fault="lost"), PressureSensor(0.025)),
    "beyond its range": (PressureSensor(0.02, gain=50.0),),
    "jumps": (PressureSensor(0.02, offset=0.3 * TOP),),
    "stuck": (PressureSensor(noise=100.0), PressureSensor(0.02, fault="stuck")),
}


@pytest.fixture(scope="module")
def blocks():
    louder = StateSpace(PID.A, PID.B, 1.5 * PID.C, 1.5 * PID.D, PID.inputs, PID.outputs)
    schedule = ScheduledSystem([0.0, TOP], [PID, louder], "pressure", "Pa")
    limits = machine_limits(RIG)
    fixed = build_block(deploy(PID, DT, DT, force=True), "rig", *limits)
    return build_scheduled_block(
        deploy_scheduled(schedule, DT, DT, force=True), "rig", *limits
    ), fixed


@compiler
def test_the_code_on_the_rig_is_the_program_on_the_rig(blocks):
    """With the rotor's weight, in the loop: every fault of the sensor, and an estimate that says
    the reading is off.
    """
    watch = Limits(
        0.0,
        TOP,
        0.05 * TOP,
        rate=80e5,
        noise=1e3,
        band=0.1 * TOP,
        stuck=0.01,
        dwell=0.01,
        fade=0.002,
    )
    code = None
    twin = None
    others = set()
    point = next(point for point in RIG.operation.points if point.seal_pressure == 0)
    for name, sensors in SENSORS.items():
        limits = watch if name == "stuck" else replace(watch, stuck=np.inf)
        block = supervise(*blocks, limits)
        code, twin = CompiledSchedule(block), supervised_twin(block)
        events = Scenario(
            "surge",
            0.045,
            pulses=(Pulse("f_center_x", 20.0, 0.005, 0.003),),
            pressures=(PressureChange(0.01, 1e5, 0.03),),
            pressure_sensors=sensors,
        )
        ran, meant = (virtual_rig.run(RIG, law, events, point=point) for law in (code, twin))
        assert ran.outcome == meant.outcome == "completed"
        for kind in "yu":
            a, b = (
                np.array([trace.record[f"{kind}_{axis}"] for axis in RIG.axes])
                for trace in (ran, meant)
            )
            assert np.abs(a - b).max() < 1e-11 * np.abs(b).max(), name  # 3e-13
        assert code.status >> STATE_AT & 3 == twin.supervisor.state
        others.add(twin.words().split("(")[-1])
    assert len(others) == 5  # schedule throughout, and four reasons


@compiler
def test_the_interrupt_of_the_page_compiles(blocks, tmp_path):
    page = (Path(__file__).parents[3] / "docs" / "reference" / "c-code.md").read_text()
    for name, text in generate(supervise(*blocks, Limits(0.0, TOP, 0.05 * TOP))).items():
        (tmp_path / name).write_text(text)
    (tmp_path / "main.c").write_text(
        next(text for text in re.findall(r"```c\n(.*?)```", page, re.DOTALL) if '"rig.h"' in text)
    )
    driver.build(driver.compilers()[0], ["-fsyntax-only", str(tmp_path / "main.c")])


def test_what_it_costs(blocks):
    watch = Limits(0.0, TOP, 0.05 * TOP)
    both = supervise(*blocks, watch).cost("double").multiplications
    alone = blocks[0].cost("double").multiplications + blocks[1].cost("double").multiplications
    assert alone < both < 1.4 * alone


def test_refusals(blocks, tmp_path):
    watch = Limits(0.0, TOP, 0.05 * TOP)
    with pytest.raises(InvalidInput, match="sample time of the fallback"):
        supervise(blocks[0], replace(blocks[1], sample_time=2e-4), watch)
    with pytest.raises(InvalidInput, match="inputs of the fallback"):
        supervise(blocks[0], replace(blocks[1], inputs=("err_x", "err_y", "err_z", "err_w")), watch)
    with pytest.raises(InvalidInput, match="rate_limit of a supervised block"):
        supervise(replace(blocks[0], rate_limits=(1e5,)), blocks[1], watch)
    schedule = ScheduledSystem([0.0, TOP], [PID, PID], "pressure", "Pa")

    def refused(match, law=schedule, to="c", fallback=PID, **options):
        with pytest.raises(InvalidInput, match=match):
            export(
                law,
                tmp_path / "x",
                to=to,
                machine=RIG,
                force=True,
                **options,
                fallback=fallback,
            )

    refused("scheduled itself", fallback=schedule)
    refused("--pressures-bar", law=PID)
    refused("--pressures-bar", law=ScheduledSystem([0.0, 100.0], [PID, PID]))
    refused("write C", to="st")
    refused("pressure_limit", pressure_limit=9e5)
    refused("it belongs to a fallback", fallback=None, stuck_after=0.01)
    refused("the controller's size", fallback=integrating())
    assert not (tmp_path / "x").exists()
