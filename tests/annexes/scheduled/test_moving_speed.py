"""Proofs while the speed changes, of a fixed PID on a rig made by hand: against norms at rest,
corners, and what is refused.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ambrose.annexes.scheduled.moving_speed import check_speed, speed_spans
from ambrose.annexes.scheduled.varying_proof import sampled_closure
from ambrose.core.checks import InvalidInput
from ambrose.core.norms import hinf_norm
from ambrose.core.sampling import c2d, delayed
from ambrose.core.scheduled import ScheduledSystem
from ambrose.core.statespace import StateSpace, select
from ambrose.judge.verdict import verify_controller
from ambrose.law.loop import Timing, closed_loop
from ambrose.law.pid import pid_controller
from ambrose.machine.description import OperatingPoint, Requirements, Tolerance
from ambrose.machine.machine import Machine
from ambrose.model.assemble import assemble
from ambrose.model.uncertainty import perturbed
from judge.conftest import PID, make_rig

TOP = 2 * np.pi * 50
PRESSURE = 3e4
RATE = 100.0


@pytest.fixture(scope="module")
def rig() -> Machine:
    machine = make_rig()
    points = (
        OperatingPoint(speed=0.0, seal_pressure=PRESSURE, label="standstill"),
        OperatingPoint(speed=TOP, seal_pressure=PRESSURE, label="top speed"),
    )
    return replace(
        machine,
        operation=replace(
            machine.operation, points=points, design_point="", speed_range=(0.0, TOP)
        ),
        tolerances=(Tolerance("seal.center.k", relative=0.5),),
        requirements=Requirements(sensitivity_peak=4.5),
    )


def peak(machine: Machine, law: StateSpace, speed: float, k: float = 0.0) -> float:
    """sigma_max(S_o) of the full plant at a steady speed, k moved within its tolerance."""
    plant = perturbed(
        assemble(machine, OperatingPoint(speed=speed, seal_pressure=PRESSURE)), {"seal.center.k": k}
    )
    inputs, outputs = ([f"{kind}_{axis}" for axis in plant.axes] for kind in "dy")
    return hinf_norm(select(closed_loop(plant, law), inputs, outputs)).value


def test_the_proofs_are_just_above_steady_speeds_and_above_the_worst_corner(rig: Machine) -> None:
    law = pid_controller(PID, rig)
    (span,) = speed_spans(rig, law)
    checks = {check.name: check for check in check_speed(rig, span, law, None, RATE).checks}
    speeds = np.linspace(0.0, TOP, 5)
    rest = max(peak(rig, law, v) for v in speeds)
    corner = max(peak(rig, law, v, k) for v in speeds for k in (-1.0, 1.0))
    assert checks["moving.speed.frozen"].value == pytest.approx(rest, rel=1e-3)
    assert rest < checks["moving.speed.rate"].value < 1.03 * rest
    assert rest < corner < checks["moving.speed.tolerances"].value < 1.03 * corner
    assert "1 tolerances, standing still" in checks["moving.speed.tolerances"].detail


@pytest.mark.study
def test_a_sampled_loop_is_proved_as_it_runs(rig: Machine) -> None:
    """Against the loop from sample to sample put together here: hold, Tustin's map, a sample
    late.
    """
    law, timing = pid_controller(PID, rig), Timing(1e-4, 1)
    (span,) = speed_spans(rig, law)
    found = check_speed(rig, span, law, timing, RATE, tolerances=False)
    checks = {check.name: check for check in found.checks}
    rest = 0.0
    for speed in np.linspace(0.0, TOP, 5):
        plant = assemble(rig, OperatingPoint(speed=speed, seal_pressure=PRESSURE))
        part = c2d(select(plant.system, plant.named("u"), plant.named("y")), timing.sample_time)
        K = delayed(c2d(law, timing.sample_time, "tustin"), 1)
        A, B, C = sampled_closure(part.A, part.B, part.C, K)
        loop = StateSpace(A, B, C, np.eye(len(C)), dt=timing.sample_time)
        rest = max(rest, hinf_norm(loop).value)
    assert checks["moving.speed.frozen"].value == pytest.approx(rest, rel=1e-3)
    assert rest < checks["moving.speed.rate"].value < 1.12 * rest


def test_what_it_does_not_cover_is_refused(rig: Machine) -> None:
    law = pid_controller(PID, rig)
    along = ScheduledSystem((0.0, 6e4), (law, law), "pressure", "Pa")
    with pytest.raises(
        InvalidInput, match="scheduled over pressure is not proved while the speed changes"
    ):
        verify_controller(rig, along, tolerances=False, speed_rate=RATE)
    alone = replace(rig, operation=replace(rig.operation, points=rig.operation.points[:1]))
    with pytest.raises(InvalidInput, match="no two operating points differ in speed alone"):
        verify_controller(alone, law, tolerances=False, speed_rate=RATE)
