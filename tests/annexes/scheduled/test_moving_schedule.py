"""Proofs for a controller scheduled over pressure, on the rig by hand: against norms at rest, and
what is refused.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ambrose.annexes.scheduled.moving_model import (
    check_on_model,
    choose_model,
    moving_law,
    scheduled_spans,
    told_range,
)
from ambrose.core.checks import InvalidInput
from ambrose.core.norms import hinf_norm
from ambrose.core.scheduled import ScheduledSystem
from ambrose.core.statespace import StateSpace, select
from ambrose.judge.verdict import verify_controller
from ambrose.law.loop import Timing, closed_loop
from ambrose.law.pid import pid_controller
from ambrose.machine.description import OperatingPoint, Requirements
from ambrose.machine.machine import Machine
from ambrose.model.assemble import assemble
from judge.conftest import PID, make_rig

LOW, HIGH = 1e4, 3e4


@pytest.fixture(scope="module")
def rig() -> Machine:
    machine = make_rig()
    points = (
        OperatingPoint(seal_pressure=LOW, label="low"),
        OperatingPoint(seal_pressure=HIGH, label="high"),
    )
    return replace(
        machine,
        operation=replace(machine.operation, points=points, design_point=""),
        tolerances=(),
        requirements=Requirements(sensitivity_peak=4.5),
    )


def schedule(rig: Machine, change: float, grid=(LOW, 2e4, HIGH)) -> ScheduledSystem:
    """The PID with gains that rise by ``change`` over the range (fall, below zero)."""
    law = pid_controller(PID, rig)
    shares = [1 + change * (p - LOW) / (HIGH - LOW) for p in grid]
    systems = [
        StateSpace(law.A, law.B, k * law.C, k * law.D, law.inputs, law.outputs) for k in shares
    ]
    return ScheduledSystem(grid, systems, "pressure", "Pa")


def proved(
    rig: Machine, law: ScheduledSystem, error: float = 0.0, timing: Timing | None = None
) -> dict[str, float]:
    (span,) = scheduled_spans(rig, law)
    return {
        check.name: check.value
        for check in check_on_model(rig, span, law, timing, 1e3, error).checks
    }


def at_rest(rig: Machine, law: ScheduledSystem, pairs: list[tuple[float, float]]) -> float:
    """The largest sigma_max(S_o) of the full plant at pressures told as others."""
    found = []
    for pressure, told in pairs:
        plant = assemble(rig, OperatingPoint(seal_pressure=pressure))
        inputs, outputs = ([f"{kind}_{axis}" for axis in plant.axes] for kind in "dy")
        found.append(hinf_norm(select(closed_loop(plant, law.at(told)), inputs, outputs)).value)
    return max(found)


@pytest.mark.study
def test_the_proof_is_just_above_rest_and_an_error_costs(rig: Machine) -> None:
    law = schedule(rig, 0.15)
    exact, off = proved(rig, law), proved(rig, law, 5e3)
    rest = at_rest(rig, law, [(p, p) for p in np.linspace(LOW, HIGH, 5)])
    assert exact["moving.frozen"] == pytest.approx(rest, rel=2e-3)
    assert rest < exact["moving.sensitivity.rate"] < 1.015 * rest
    # on this rig the gain counts, not the seal
    apart = at_rest(rig, law, [(LOW, 1.5e4), (HIGH, 2.5e4), (HIGH, HIGH)])
    assert off["moving.frozen"] == pytest.approx(apart, rel=2e-3) == pytest.approx(rest, rel=2e-3)
    # the error may jump
    assert exact["moving.sensitivity.rate"] < off["moving.sensitivity.rate"] < 1.06 * apart


def test_the_model_is_as_good_where_the_pressure_is_misread(rig: Machine) -> None:
    """Compared where it is told exactly alone, the rigid rotor passed (0.33 % off) that is 0.9 %
    off where it is misread, and on the test rig 2.680 was called proved where the full plant had
    2.681 at rest.
    """
    law = schedule(rig, 0.3)
    (span,) = scheduled_spans(rig, law)
    plant = assemble(rig, span.middle)
    exact, misread = (choose_model(plant, span, law, 0.0, [(LOW, told)]) for told in (LOW, HIGH))
    assert (exact.modes, misread.modes) == (0, 2) and misread.off < 5e-3
    assert misread.held == (LOW, HIGH)
    assert misread.full_gain == pytest.approx(at_rest(rig, law, [(LOW, HIGH)]), rel=1e-6)


def test_rates_and_errors_that_no_schedule_reads_are_refused(rig: Machine) -> None:
    with pytest.raises(
        InvalidInput, match="only a controller scheduled over pressure is told of it"
    ):
        verify_controller(
            rig, pid_controller(PID, rig), tolerances=False, pressure_rate=1e3, pressure_error=1e3
        )


def test_a_sampled_schedule_and_an_unstable_one_have_no_proof(rig: Machine) -> None:
    law = schedule(rig, 0.15)
    (span,) = scheduled_spans(rig, law)
    sampled = ScheduledSystem(
        law.grid, [replace(s, dt=1e-4) for s in law.systems], "pressure", "Pa"
    )
    (row,) = check_on_model(rig, span, sampled, None, 1e3).checks
    assert not row.passed and "the continuous one that it was made of" in row.detail
    weak = schedule(rig, -0.9)
    found = check_on_model(rig, span, weak, None, 1e3)
    assert not found.passed and "unstable" in found.checks[-1].detail


def test_spans_end_where_the_schedule_ends_and_what_is_told_where_an_error_takes_it(
    rig: Machine,
) -> None:
    law = schedule(rig, 0.1, (1.5e4, 2e4, 5e4))
    (span,) = scheduled_spans(rig, law)
    moving = moving_law(law, assemble(rig, span.middle))
    assert (span.low, span.high) == (1.5e4, HIGH)
    assert told_range(span, moving, 5e3) == (1.5e4, HIGH + 5e3) and told_range(
        span, moving, 0.0
    ) == (
        1.5e4,
        HIGH,
    )
    assert scheduled_spans(rig, schedule(rig, 0.1, (4e4, 5e4))) == ()
