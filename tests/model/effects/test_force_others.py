"""Force views of seal, coupling, sensor, unbalance and weight against their linear views and first
principles.
"""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given

from ambrose.machine.description import Coupling, OperatingPoint
from ambrose.machine.file.toml import load_machine
from ambrose.machine.part import Runout, SealTable, Sensor
from ambrose.model.effects import seal, sensor, stations as coupling, stations as unbalance
from ambrose.model.effects.rotor import (
    finite_element_rotor,
    free_modes,
    gravity_load,
    mass_properties,
)
from physical_numbers import physical

RIG = load_machine("seal-rig")
TABLE = SealTable(
    (("pressure", (0.0, 1e5, 3e5)),), (("k", (0.0, 1e6, 5e6)), ("C", (100.0, 300.0, 900.0)))
)


class TestSeal:
    def test_derivative_is_the_linear_view(self):
        coefficients = seal.SealCoefficients(K=4e5, k=3.2e6, C=2.5e3, c=-2.6e3, M=0.3)
        p = seal.parameters(coefficients)
        columns = np.array([seal.force(*row, p) for row in np.eye(6)]).T
        K, C, M = seal.matrices(coefficients)
        assert np.allclose(columns, -np.hstack([K, C, M]), rtol=1e-12, atol=0)

    def test_cross_coupling_drives_forward_whirl(self):
        """On a circle from x to y, power k r^2 Omega comes from k and -C (r Omega)^2 from C."""
        k = 3e6
        C = 2e3
        r = 1e-5
        w = 250.0
        fx, fy = seal.force(r, 0.0, 0.0, r * w, 0.0, 0.0, (0.0, k, C, 0.0, 0.0))
        assert fx * 0.0 + fy * r * w == pytest.approx(k * r**2 * w - C * (r * w) ** 2)


def test_coupling_is_its_matrices():
    item = Coupling("c", 0.0, (0.40e6, 0.42e6), (10.0, 20.0))
    k, d = coupling.matrices(item)
    block = coupling.COUPLING.reaction(item, OperatingPoint()).block()
    assert np.array_equal(block, -np.hstack([k, d]))
    assert np.array_equal(k, np.diag([0.40e6, 0.42e6]))


class TestUnbalance:
    @given(physical(-10, 10), physical(-2000, 2000), physical(-500, 500), physical(-4, 4))
    def test_is_minus_the_acceleration_of_the_mass(self, angle, speed, acceleration, phase):
        """Against the second derivative of m e exp(j theta(t)), with theta quadratic in time."""
        amount = 1e-4
        rotation = np.exp(1j * (angle + phase))
        expected = -amount * (1j * acceleration - speed**2) * rotation
        fx, fy = unbalance.force(angle, speed, acceleration, (amount, phase))
        assert fx + 1j * fy == pytest.approx(expected, rel=1e-9, abs=1e-12)

    def test_linear_view_at_constant_speed(self):
        phasor = unbalance.linearised(1e-4, 500.0)
        for angle in (0.0, 1.0, 4.0):
            fx, fy = unbalance.force(angle, 500.0, 0.0, (1e-4, 0.0))
            assert fx == pytest.approx((phasor * np.exp(1j * angle)).real)
            assert fy == pytest.approx((-1j * phasor * np.exp(1j * angle)).real)

    def test_published_size(self):
        """P5: G2.5 of the 69 kg rotor at 500 Hz is 541 N: m e = 69 * 2.5e-3/(2 pi 500)."""
        w = 1000 * math.pi
        assert math.hypot(*unbalance.force(0.3, w, 0.0, (69 * 2.5e-3 / w, 0.0))) == pytest.approx(
            541, rel=2e-3
        )


class TestSensor:
    ITEM = Sensor(
        "A",
        0.1,
        gain=(1.02, 0.97),
        bandwidth=6e4,
        offset=(3e-6, -2e-6),
        noise=1e-7,
        resolution=0.5e-6,
        runout=(Runout(1, 2e-6, 0.4), Runout(3, 1e-6)),
    )

    @pytest.mark.parametrize("direction", ["zeta", "eta"])
    def test_small_signals_are_the_linear_view(self, direction):
        p = sensor.parameters(self.ITEM, ("zeta", "eta").index(direction))
        system = sensor.linearised([self.ITEM], ["A_zeta", "A_eta"])
        k = ("zeta", "eta").index(direction)
        slope = (sensor.indicated(1e-6, p) - sensor.indicated(-1e-6, p)) / 2e-6
        assert sensor.lag(slope, 0.0, p) == pytest.approx(system.B[k, k], rel=1e-9)
        assert sensor.lag(0.0, 1.0, p) == pytest.approx(system.A[k, k], rel=1e-12)
        assert sensor.indicated(0.0, p) == self.ITEM.offset[k]

    def test_runout_is_one_surface_seen_from_two_sides(self):
        profile = sensor.harmonics(self.ITEM)
        zeta, eta = (sensor.parameters(self.ITEM, d) for d in (0, 1))
        for angle in np.linspace(0, 7, 15):
            assert sensor.runout(angle, profile, zeta) == pytest.approx(
                sensor.runout(angle + np.pi / 2, profile, eta)
            )
        assert sensor.runout(0.0, profile, zeta) == pytest.approx(2e-6 * math.cos(0.4) + 1e-6)

    def test_first_harmonic_looks_like_forward_whirl(self):
        """A bent track turns with the rotor: eta lags zeta by a quarter turn."""
        item = Sensor("A", 0.1, runout=(Runout(1, 2e-6),))
        profile = sensor.harmonics(item)
        at = [sensor.runout(0.7, profile, sensor.parameters(item, d)) for d in (0, 1)]
        assert at == pytest.approx([2e-6 * math.cos(0.7), 2e-6 * math.sin(0.7)])

    @given(physical(-1e-3, 1e-3))
    def test_quantisation_is_the_nearest_step(self, value):
        p = sensor.parameters(self.ITEM, 0)
        found = sensor.sampled(value, p)
        assert abs(found - value) <= 0.25e-6 * (1 + 1e-9)
        assert found / 0.5e-6 == pytest.approx(round(found / 0.5e-6), abs=1e-6)

    def test_a_perfect_sensor_changes_nothing(self):
        p = sensor.parameters(Sensor("A", 0.1), 1)
        assert sensor.harmonics(Sensor("A", 0.1)).shape == (0, 3)
        assert sensor.runout(1.0, np.zeros((0, 3)), p) == 0.0
        assert sensor.sampled(sensor.indicated(1.234e-6, p), p) == 1.234e-6


class TestWeight:
    ROTOR = finite_element_rotor(RIG)

    def test_total_and_direction(self):
        load = gravity_load(self.ROTOR, -math.pi / 2)
        assert load[1::4].sum() == pytest.approx(
            -mass_properties(self.ROTOR).mass * 9.80665, rel=1e-12
        )
        assert np.abs(load[0::4]).max() < 1e-12
        assert not gravity_load(self.ROTOR, None).any()

    def test_it_lifts_no_tilting_and_no_bending(self):
        """Uniform acceleration is a rigid translation: modes other than that see no work from
        it.
        """
        modal = free_modes(self.ROTOR, 3).shapes.T @ gravity_load(self.ROTOR, -math.pi / 2)
        translation = np.sqrt(mass_properties(self.ROTOR).mass) * 9.80665
        assert modal[1] == pytest.approx(-translation, rel=1e-9)
        assert np.abs(np.delete(modal, 1)).max() < 1e-6 * translation


def test_every_force_function_compiles_as_it_stands():
    """The contract with the virtual rig: scalars, tuples and arrays only; compiled and plain give
    the same.
    """
    numba = pytest.importorskip("numba")
    from ambrose.model.effects import amplifier, magnet, touchdown

    bearing = replace(RIG.bearings[0], cross_coupling=0.02)
    item = TestSensor.ITEM
    amp, sens = parameters_of = (
        amplifier.parameters(RIG.amplifier, 4.0),
        sensor.parameters(item, 1),
    )
    assert all(isinstance(value, float) for p in parameters_of for value in p)
    cases = [
        (magnet.force, (0.3, -0.2, 1e-5, 2e-5, magnet.parameters(bearing))),
        (magnet.force, (0.3, -0.2, 1e-5, 2e-5, np.array(magnet.parameters(bearing)))),
        (amplifier.derivative, (1.0, 0.3, 0.1, amp)),
        (amplifier.coil_current, (1.0, 0.3, 0.1, amp)),
        (amplifier.effective_current, (1.0, 0.3, 0.1, amp)),
        (sensor.runout, (0.3, sensor.harmonics(item), sens)),
        (sensor.indicated, (1e-6, sens)),
        (sensor.lag, (1e-6, 0.0, sens)),
        (sensor.sampled, (1.2345e-6, sens)),
        (seal.force, (1e-5, 2e-5, 1e-3, 2e-3, 0.1, 0.2, np.array([4e5, 3e6, 2e3, -2e3, 0.1]))),
        (unbalance.force, (0.3, 100.0, 5.0, (1e-4, 0.2))),
        (touchdown.force, (3e-4, 1e-5, 0.1, 0.2, 100.0, touchdown.parameters(RIG, bearing))),
    ]
    for function, arguments in cases:
        assert numba.njit(function)(*arguments) == pytest.approx(function(*arguments), rel=1e-12), (
            function
        )
