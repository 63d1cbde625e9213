"""The bundled turboexpander: every figure that papers P1 and P3 print holds, and its PID is a sound
reference.
"""

import math

import numpy as np
import pytest

from ambrose.law.loop import closed_loop
from ambrose.law.pid import pid_controller
from ambrose.machine.attachment import mesh
from ambrose.machine.file.toml import bundled_machines, load_machine
from ambrose.model.assemble import assemble
from ambrose.model.effects.rotor import (
    finite_element_rotor,
    free_bending_frequencies,
    mass_properties,
)

MACHINE = load_machine("turboexpander")
PISTON_DIAMETER, PISTON_LENGTH = 0.11474, 0.0857  # P3, fig. 2


@pytest.mark.literature
class TestPrinted:
    def test_finite_elements(self):
        """P1 section III, P3 section 2.2: 40 nodes of 4 coordinates, 320 states; first bending at
        about 1 kHz.
        """
        rotor = finite_element_rotor(MACHINE)
        nodes = len(mesh(MACHINE.shaft)) + 1  # of the paper; parts inside its elements add five
        assert (nodes, 2 * 4 * nodes) == (40, 320)
        assert rotor.n_nodes == nodes + 5
        assert free_bending_frequencies(rotor, 1)[0] / (2 * math.pi) == pytest.approx(
            1000.0, rel=0.02
        )

    def test_speeds(self):
        assert MACHINE.operation.nominal.speed == pytest.approx(31500 * math.pi / 30)
        speeds = {round(point.speed / (2 * math.pi), 6) for point in MACHINE.operation.points}
        assert {20.0, 140.0, 300.0, 525.0} <= speeds

    def test_actuators(self):
        """P3 (2): first order, 1.5 kHz; axes along the global x and y; +-5 A."""
        assert MACHINE.amplifier.order == "first"
        assert MACHINE.amplifier.bandwidth == pytest.approx(2 * math.pi * 1500)
        assert [bearing.angle for bearing in MACHINE.bearings] == [0.0, 0.0]
        assert [bearing.max_current for bearing in MACHINE.bearings] == [5.0, 5.0]

    def test_balance_piston_in_the_middle(self):
        piston = next(section for section in MACHINE.shaft if section.label == "balance piston")
        assert (piston.outer_diameter, piston.length) == (PISTON_DIAMETER, PISTON_LENGTH)
        assert piston.start + piston.length / 2 == pytest.approx(MACHINE.length / 2)
        assert MACHINE.seals[0].position == pytest.approx(MACHINE.length / 2)
        assert MACHINE.seals[0].reference_pressure == pytest.approx((70.0 - 31.5) * 1e5)

    def test_tolerances(self):
        """P3 section 3.1: eight independent coefficients, +-40 %."""
        entries = [
            f"seal.piston.{entry}"
            for entry in ["K_xx", "K_yy", "k_xy", "k_yx", "C_xx", "C_yy", "c_xy", "c_yx"]
        ]
        assert [tolerance.parameter for tolerance in MACHINE.tolerances] == entries
        assert {tolerance.relative for tolerance in MACHINE.tolerances} == {0.4}

    def test_requirements(self):
        demanded = MACHINE.requirements
        assert demanded.balance_grade == 2.5e-3
        assert demanded.unbalance_orbit == 1e-5
        assert demanded.settling_time == 0.02
        assert demanded.sensitivity_peak == 3.0
        assert demanded.max_current == 5.0


class TestChosen:
    def test_what_is_chosen_says_so(self):
        """Every table with a chosen figure is named among the assumptions."""
        named = {key.replace(" ", ".").split(".")[0] for key, _ in MACHINE.assumed}
        assert {
            "shaft",
            "disc",
            "bearing",
            "sensor",
            "seal",
            "controller",
            "modal_damping",
        } <= named

    def test_mass_is_plausible_for_the_power(self):
        assert 25 < mass_properties(finite_element_rotor(MACHINE)).mass < 40

    def test_magnets_carry_the_rotor_and_destabilise_it(self):
        weight = 9.81 * mass_properties(finite_element_rotor(MACHINE)).mass
        assert sum(b.force_per_current[0] * b.max_current for b in MACHINE.bearings) > 3 * weight
        for bearing in MACHINE.bearings:
            assert bearing.max_force == pytest.approx(
                bearing.force_per_current[0] * bearing.max_current
            )
            ratio = bearing.bias_current / bearing.gap  # k_s / k_i of an ideal magnet
            assert bearing.negative_stiffness[0] == pytest.approx(
                bearing.force_per_current[0] * ratio
            )
        poles = np.linalg.eigvals(assemble(MACHINE, MACHINE.operation.points[1]).system.A)
        assert (poles.real > 50).sum() == 4

    @pytest.mark.parametrize("point", MACHINE.operation.points, ids=lambda point: point.label)
    def test_the_pid_stabilises_the_full_rotor(self, point):
        plant = assemble(MACHINE, point)
        poles = np.linalg.eigvals(closed_loop(plant, pid_controller(MACHINE.controller, MACHINE)).A)
        assert poles.real.max() < -20


def test_the_file_carries_no_figure_without_unit_that_needs_one():
    text = bundled_machines()["turboexpander"].read_text()
    bare = [
        line
        for line in text.splitlines()
        if line.startswith(("length", "position", "mass", "speed =")) and '"' not in line
    ]
    assert [line for line in bare if not line.endswith("= 0")] == []
