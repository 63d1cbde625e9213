"""The thesis' statements that the foundation can judge, on the bundled machines; each test carries its id in CLAIMS.

`pytest tests/literature/test_reproduction.py -s` prints the figures quoted in docs/reproduction.md.
"""

import numpy as np
import pytest

from ambrose import load_machine
from ambrose.core.frequency import frequency_response
from ambrose.core.statespace import poles, select
from ambrose.machine.description import OperatingPoint
from ambrose.plant.assemble import assemble
from ambrose.plant.loop import closed_loop
from ambrose.plant.reduce import reduce
from ambrose.simulate import linear
from ambrose.simulate.scenario import load_scenario
from ambrose.simulate.trace import settling
from ambrose.synthesis import pid
from ambrose.verify import nominal

pytestmark = pytest.mark.literature
HZ = 2 * np.pi


@pytest.fixture(scope="module")
def rig():
    """Plants, controller and checks at nominal, zero and twice nominal pressure."""
    machine = load_machine("seal-rig")
    plants = {point.label: assemble(machine, point) for point in machine.operation.points}
    controller = pid.controller(machine.controller, machine)
    return plants, controller, {label: nominal.check(plant, controller) for label, plant in plants.items()}


def test_P1_1_reduced_model_follows_up_to_the_first_bending_mode_only():
    """Printed: singular values agree up to 2e4 rad/s. With P3's first bending mode at 1 kHz (6.3e3 rad/s) that cannot be."""
    machine = load_machine("turboexpander")
    plant = assemble(machine, OperatingPoint(speed=31500 * np.pi / 30))
    omega = np.geomspace(10, 1e5, 400)

    def singular_values(p):
        signals = [f"f_{a}" for a in p.axes], [f"s_{a}" for a in p.axes]
        return np.linalg.svd(frequency_response(select(p.rotor, *signals), omega).values, compute_uv=False)

    error = np.abs(singular_values(reduce(plant, 0, static_correction=False)) / singular_values(plant) - 1)
    all_valid, largest_valid = omega[np.argmax(error.max(axis=1) > 0.1)], omega[np.argmax(error[:, 0] > 0.1)]
    print(f"\nP1.1: within 10 % up to {all_valid:.3g} rad/s (all singular values), {largest_valid:.3g} rad/s (the largest)")
    assert 2e3 < all_valid < 6.3e3
    assert largest_valid < 1e4


def test_P1_2_the_plant_has_poles_in_the_right_half_plane():
    machine = load_machine("turboexpander")
    values = poles(assemble(machine, OperatingPoint(speed=31500 * np.pi / 30)).rotor)
    print(f"\nP1.2: unstable poles {np.round(values[values.real > 0], 1)}")
    assert (values.real > 0).sum() == 4


def test_P5_5_PID_over_pressure(rig):
    """Printed: 40 Hz compliance peak at nominal k, unstable at +100 %."""
    plants, controller, checks = rig
    peak = checks["nominal pressure"]["compliance.max"]
    unstable = checks["twice nominal pressure"].checks[0]
    print(f"\nP5.5: compliance peak {peak.value * 1e6:.3g} um/N {peak.detail}; twice nominal: {unstable.detail}")
    curve = checks["nominal pressure"].curve("compliance")
    assert curve.x[np.argmax(curve.y[0])] / HZ == pytest.approx(40, rel=0.1)
    assert checks["zero pressure"].stable
    assert not checks["twice nominal pressure"].stable
    for label, plant in plants.items():  # the reduced model gives the same verdict
        assert (poles(closed_loop(reduce(plant), controller)).real.max() < 0) == checks[label].stable


def test_P5_7_unbalance_force(rig):
    """Printed: G2.5 at 500 Hz is 541 N (for 69 kg)."""
    check = rig[2]["nominal pressure"]["unbalance.orbit"]
    print(f"\nP5.7 (PID): orbit {check.value * 1e6:.3g} um up to 200 Hz; {check.detail}")
    assert 69.0 * 2.5e-3 * 500 * HZ == pytest.approx(541, rel=2e-3)
    assert "541" in check.detail or "542" in check.detail


def test_P5_9_input_and_output_sensitivity_alike(rig):
    """Printed for H-infinity and mu controllers; a decentralised PID of equal gains makes them equal up to the axes' k_i."""
    for label in ("nominal pressure", "zero pressure"):
        found = rig[2][label]
        output, inside = found["sensitivity.output.max"].value, found["sensitivity.input.max"].value
        print(f"\nP5.9 (PID, {label}): largest sensitivity {output:.4g} at the output, {inside:.4g} at the input")
        assert inside == pytest.approx(output, rel=0.02)


def test_P5_10_settling_of_the_PID_at_zero_pressure(rig):
    """Printed: about 0.03 s. That is the time to 10 % of the peak; to 5 % the slow integral pole (-5 rad/s) counts."""
    plants, controller, _ = rig
    loop = closed_loop(plants["zero pressure"], controller)
    for name in ("impulse-orthogonal", "impulse-parallel"):
        trace = linear.run(loop, load_scenario(name), point=plants["zero pressure"].point)
        times = [settling(trace, band=band, start=0.05) for band in (0.10, 0.05)]
        print(f"\nP5.10 (PID, {name}): settles to 10 % in {times[0]:.3f} s, to 5 % in {times[1]:.3f} s")
        assert times[0] == pytest.approx(0.03, abs=0.005)
