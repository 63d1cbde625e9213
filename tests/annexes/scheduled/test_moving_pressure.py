"""Proofs while the seal pressure changes, on the rig by hand: against norms at rest, reduced plants
and a seal that bends.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from ambrose.annexes.scheduled.moving_model import (
    BentSeal,
    MovingModel,
    PressureSpan,
    pressure_spans,
)
from ambrose.annexes.scheduled.moving_proofs import check_pressure, pressure_loop
from ambrose.core.norms import hinf_norm
from ambrose.core.statespace import select, spectral_abscissa
from ambrose.judge.verdict import verify_controller
from ambrose.law.loop import Timing, closed_loop
from ambrose.law.pid import pid_controller
from ambrose.machine.description import OperatingPoint, Requirements
from ambrose.machine.machine import Machine
from ambrose.machine.part import SealTable
from ambrose.model.assemble import assemble
from ambrose.model.uncertainty import reduce
from judge.conftest import PID, make_rig

TIMING = Timing(1e-4, 1)


@pytest.fixture(scope="module")
def rig() -> Machine:
    """The rig at pressures that its PID holds."""
    machine = make_rig()
    points = (
        OperatingPoint(seal_pressure=1e4, label="low"),
        OperatingPoint(seal_pressure=3e4, label="high"),
    )
    return replace(
        machine,
        operation=replace(machine.operation, points=points, design_point=""),
        tolerances=(),
        requirements=Requirements(sensitivity_peak=4.5),
    )


@pytest.fixture(scope="module")
def span(rig: Machine) -> PressureSpan:
    (found,) = pressure_spans(rig)
    return found


@pytest.mark.parametrize("timing", [None, TIMING])
def test_the_loop_with_the_pressure_pulled_out_is_the_loop_at_each_pressure(
    rig, span, timing
) -> None:
    law = pid_controller(PID, rig)
    loop = pressure_loop(assemble(rig, span.middle), span, law, timing)
    for delta, pressure in ((-1.0, 1e4), (0.5, 2.5e4), (1.0, 3e4)):
        plant = assemble(rig, OperatingPoint(seal_pressure=pressure))
        running = law if timing is None else timing.in_loop(law)
        whole = closed_loop(plant, running)
        ours = loop.closed(np.array([delta]))
        assert spectral_abscissa(ours) == pytest.approx(spectral_abscissa(whole), rel=1e-4)
        inputs, outputs = ([f"{kind}_{axis}" for axis in plant.axes] for kind in "dy")
        assert hinf_norm(ours).value == pytest.approx(
            hinf_norm(select(whole, inputs, outputs)).value, rel=1e-6
        )


@pytest.mark.parametrize("timing", [pytest.param(None, marks=pytest.mark.study), TIMING])
def test_the_proof_is_just_above_rest_for_a_slow_change_and_above_that_for_any(
    rig, span, timing
) -> None:
    found = {
        c.name: c for c in check_pressure(rig, span, pid_controller(PID, rig), timing, 1e3).checks
    }
    rest, slow, fast = (
        found[f"moving.{name}"].value for name in ("frozen", "sensitivity.rate", "sensitivity.any")
    )
    assert rest <= slow < 1.02 * rest
    assert slow <= fast
    assert found["moving.sensitivity.rate"].limit is not None
    assert "full plant" in found["moving.sensitivity.rate"].detail


def test_verify_has_it_where_a_rate_is_known(rig) -> None:
    law = pid_controller(PID, rig)
    assert verify_controller(rig, law, tolerances=False).moving == ()
    result = verify_controller(rig, law, tolerances=False, pressure_rate=1e3)
    assert [checks.label for checks in result.moving] == [
        "while the pressure changes, 0.1 to 0.3 bar at 0 Hz"
    ]
    stated = replace(rig, operation=replace(rig.operation, pressure_rate=1e3))
    assert len(verify_controller(stated, law, tolerances=False).moving) == 1


def test_a_pressure_that_destabilises_at_rest_is_not_proved(rig) -> None:
    far = PressureSpan(rig.operation.points[0], 0.0, 4.08e5)
    found = check_pressure(rig, far, pid_controller(PID, rig), TIMING, 1e3)
    assert not found.stable
    assert not found.passed
    assert found.checks[-1].value == np.inf


def with_table(rig: Machine, values: tuple[float, ...], pressures: tuple[float, ...]) -> Machine:
    seal = rig.seals[0]
    letters = tuple((name, tuple(0.0 for _ in pressures)) for name in ("K", "C", "c"))
    table = SealTable((("pressure", pressures),), (("k", values), *letters))
    own = {name: 0.0 for name in ("K", "k", "C", "c", "M")}
    return replace(
        rig,
        seals=(
            replace(seal, table=table, reference_pressure=None, scales_with_pressure=(), **own),
        ),
    )


def test_a_table_with_a_corner_is_followed_on_both_sides_of_it(rig, span) -> None:
    """No polynomial goes around the corner: the cells beside it are halved until what is left does
    not matter.
    """
    corner = with_table(rig, (0.0, 1e4, 1e5), (0.0, 2.13e4, 4e4))
    law = pid_controller(PID, rig)
    with pytest.raises(BentSeal, match="from a polynomial of degree"):
        pressure_loop(assemble(corner, span.middle), span, law, None)
    checks = {
        check.name: check.value for check in check_pressure(corner, span, law, None, 1e3).checks
    }
    gains = []
    for pressure in (span.low, 2.13e4, span.high):
        plant = assemble(corner, OperatingPoint(seal_pressure=pressure))
        inputs, outputs = ([f"{kind}_{axis}" for axis in plant.axes] for kind in "dy")
        gains.append(hinf_norm(select(closed_loop(plant, law), inputs, outputs)).value)
    assert checks["moving.frozen"] == pytest.approx(max(gains), rel=1e-3)
    assert max(gains) < checks["moving.sensitivity.rate"] < 1.02 * max(gains)


def test_the_forces_of_the_cells_are_those_of_the_table(rig, span) -> None:
    corner = with_table(rig, (0.0, 1e4, 1e5), (0.0, 2.13e4, 4e4))
    model = MovingModel(
        reduce(assemble(corner, span.middle), 0, static_correction=False),
        span,
        pid_controller(PID, rig),
        0.0,
    )
    cells = model.cells(0.0)
    assert cells[0].p[0, 0] == -1 and cells[-1].p[-1, 0] == 1
    assert all(one.p[-1, 0] == other.p[0, 0] for one, other in pairwise(cells))
    largest = np.abs(model.frozen(span.high, 0.0).A - model.frozen(span.low, 0.0).A).max()
    for cell in cells:
        for end in (0, -1):
            pressure = span.low + (cell.p[end, 0] + 1) * span.half
            np.testing.assert_allclose(
                cell.A[end, 0], model.frozen(pressure, 0.0).A, atol=2e-3 * largest
            )
