"""The modes of a machine above half its sample rate: nothing reads them as slow ones."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ambrose.annexes.rotordynamics.loop import shaft_loop
from ambrose.annexes.rotordynamics.placement import shaft_modes
from ambrose.annexes.rotordynamics.stations import lay_out
from ambrose.core.sampling import c2d
from ambrose.core.statespace import StateSpace
from ambrose.judge.campbell import campbell, modes, pole_checks
from ambrose.judge.exploration import pole_map
from ambrose.judge.nominal import check
from ambrose.law.loop import Timing, closed_loop, running_law
from ambrose.law.pid import pid_controller
from ambrose.machine.description import Requirements
from ambrose.machine.file.toml import load_machine
from ambrose.model.assemble import assemble

# sampled at 40 kHz its modes at 39 and 41 kHz stood at 0.9 to 1.4 kHz, with damping ratios of 0.15
SPINDLE = load_machine("high-speed-spindle")
POINT = SPINDLE.operation.envelope[0]
PLANT = assemble(SPINDLE, POINT)
LAW = pid_controller(SPINDLE.controller, SPINDLE)


def own_modes(rate: float) -> list[complex]:
    """Roots of the loop's characteristic equation in s up to 1.5 kHz, which have no aliases."""
    loop = shaft_loop(lay_out(SPINDLE), POINT, LAW, Timing(1 / rate))
    return [mode.pole for mode in shaft_modes(loop, 2 * np.pi * 1500)]


@pytest.mark.parametrize("rate", [36e3, 40e3, 44e3, 48e3])
def test_the_log_decrement_is_lateral_s_at_every_rate(rate):
    law = running_law(LAW, PLANT, Timing(1 / rate))
    found = {item.name: item for item in check(PLANT, law).checks}
    lowest = min(-2 * np.pi * pole.real / pole.imag for pole in own_modes(rate))
    assert found["poles.log_decrement.lowest"].value == pytest.approx(lowest, rel=1e-4)
    assert found["stability.abscissa"].passed


def test_maps_over_speed_hold_the_modes_of_the_machine_alone():
    timing = Timing(1 / 40e3)
    law = running_law(LAW, PLANT, timing)
    own = own_modes(40e3)
    highest = 2 * np.pi * 1500

    def plant_at(speed):
        return assemble(SPINDLE, replace(POINT, speed=speed))

    def loop_at(speed):
        plant = plant_at(speed)
        return closed_loop(plant, law), plant.system

    speeds = np.array([0.99, 1.0]) * POINT.speed
    along = pole_map(loop_at, "speed", "rad/s", speeds.tolist(), highest)
    light = [p for p in along.poles[1] if p.imag > 0 and -p.real < 0.5 * abs(p)]
    assert np.sort_complex(light) == pytest.approx(
        np.sort_complex([p for p in own if -p.real < 0.5 * abs(p)]), rel=1e-4
    )
    diagram = campbell(plant_at, speeds, 2, law)
    assert diagram.frequency[:, 1] == pytest.approx(sorted(p.imag for p in own), rel=1e-4)


def test_a_mode_above_half_the_rate_that_the_loop_loses_is_named():
    """Two masses on springs, the sensor on the wrong side of a node of their mode at 10.2 kHz."""
    T, mode = 1e-4, 2 * np.pi * 10_199.0
    A = np.zeros((4, 4))
    A[0, 1] = A[2, 3] = 1.0
    A[1, :2], A[3, 2:] = (-(2e2**2), -1e2), (-(mode**2), -2 * 1e-6 * mode)
    B = np.array([[0.0], [1.0], [0.0], [1.0]])
    C = np.array([[1.0, 0.0, -1.0, 0.0], [0.0, 0.0, 0.0, 0.0]])
    plant = StateSpace(A, B, C, np.zeros((2, 1)), outputs=["q_A_zeta", "q_A_eta"])
    d = c2d(plant, T)
    gain = 1e3 / T  # u = -gain (y - y before): velocity
    closed = np.block([[d.A - gain * d.B @ d.C[:1], gain * d.B], [d.C[:1], np.zeros((1, 1))]])
    system = StateSpace(
        closed, np.zeros((5, 1)), np.hstack([C, np.zeros((2, 1))]), np.zeros((2, 1)),
        outputs=plant.outputs, dt=T,
    )  # fmt: skip
    checks = pole_checks(modes(system, ("A_zeta", "A_eta"), plant), Requirements(), 0.0)
    assert checks[0].passed is False
    assert checks[0].detail.startswith("pole at 10.2 kHz planar, damping ratio -")
