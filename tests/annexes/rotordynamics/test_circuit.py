"""What the report says of the amplifier as a circuit is what the machine with that circuit has."""

from dataclasses import replace

import numpy as np
import pytest

import ambrose as amb
from ambrose.annexes.rotordynamics.capacity import circuit_change
from ambrose.annexes.rotordynamics.items import circuit
from ambrose.annexes.rotordynamics.loop import shaft_loop
from ambrose.annexes.rotordynamics.placement import shaft_modes
from ambrose.annexes.rotordynamics.stations import lay_out
from ambrose.law.loop import closed_loop
from ambrose.machine.description import Amplifier
from ambrose.model.assemble import assemble


def test_the_mode_that_moves_most_is_that_of_the_machine_with_the_circuit():
    machine = amb.load_machine("turboexpander")
    controller = amb.design(machine, "pid")
    point = machine.operation.nominal
    loop = shaft_loop(lay_out(machine), point, controller, None)
    modes = shaft_modes(loop, 1600.0)
    found = circuit_change(machine, point, controller, None, modes)
    assert not found.stated
    drive = Amplifier(
        "current-loop",
        bandwidth=machine.amplifier.bandwidth,
        inductance=found.inductance,
        resistance=found.inductance / 0.03,
    )
    plant = assemble(replace(machine, amplifier=drive), point)
    poles = np.linalg.eigvals(closed_loop(plant, controller.controller).A)
    ratios = -poles.real / abs(poles)
    assert abs(ratios - found.after).min() < 1e-7
    before = [-m.pole.real / abs(m.pole) for m in modes]
    assert min(abs(b - found.before) for b in before) < 1e-12
    assert 0.01 < found.change < 0.1
    (row,) = circuit(found)
    assert "current-loop" not in row.note
    (row,) = circuit(replace(found, after=1.2 * found.before))
    assert row.value == pytest.approx(20) and 'order = "current-loop"' in row.note


def test_other_amplifiers_are_not_compared():
    machine = amb.load_machine("turboexpander")
    drive = Amplifier("second", natural_frequency=9000.0, damping=9000.0)
    slow = replace(machine, amplifier=drive)
    assert circuit_change(slow, machine.operation.nominal, object(), None, ()) is None
    assert circuit_change(machine, machine.operation.nominal, None, None, ()) is None
