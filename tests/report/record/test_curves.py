"""Traces become curves of displacement and current with the machine's limits."""

from __future__ import annotations

import numpy as np

from ambrose.machine.machine import Machine
from ambrose.record.record import Record
from ambrose.report.record import trace_curves
from ambrose.rig.trace import Trace


def trace() -> Trace:
    signals = ("i_A_zeta", "y_B_zeta", "y_A_zeta", "f_A_zeta")
    values = np.arange(12.0).reshape(4, 3) * 1e-6
    return Trace(
        Record("rig", 1000.0, signals, ("A", "m", "m", "N"), values), "push", True, "completed", ""
    )


def test_signals_are_grouped_by_kind_in_the_order_of_the_axes(machine: Machine) -> None:
    displacement, current = trace_curves(trace(), machine)
    assert (displacement.name, displacement.y_unit, displacement.labels) == (
        "push.displacement",
        "m",
        ("A_zeta", "B_zeta"),
    )
    np.testing.assert_allclose(displacement.y, [[6e-6, 7e-6, 8e-6], [3e-6, 4e-6, 5e-6]])
    np.testing.assert_allclose(displacement.x, [0.0, 1e-3, 2e-3])
    assert displacement.limits == ()  # the machine has no touchdown gap
    assert (current.name, current.labels) == ("push.current", ("A_zeta",))
    assert current.limits == (("largest control current", 4.0), ("largest control current", -4.0))
