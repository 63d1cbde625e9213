"""P5.6, P5.10, P5.12 and thesis 7.2.2 on the rig where k alone follows the pressure (P5 section
4.1); ids as in the docs.

`pytest tests/literature/test_p5.py -s` prints the figures quoted in docs/research/reproduction.md.
"""

import numpy as np
import pytest

from ambrose import load_machine
from ambrose.judge.loop_response import loop_evaluator
from ambrose.law.loop import closed_loop
from ambrose.law.pid import pid_controller
from ambrose.model.assemble import assemble
from ambrose.rig import linear
from ambrose.rig.scenario import load_scenario
from ambrose.rig.trace import settling
from ambrose.synthesis.design import design

pytestmark = [pytest.mark.literature, pytest.mark.study]
HZ = 2 * np.pi


@pytest.fixture(scope="module")
def plants():
    """The full plants by the label of their operating point."""
    machine = load_machine("seal-rig-k-only")
    return {point.label: assemble(machine, point) for point in machine.operation.points}


@pytest.fixture(scope="module")
def designs(plants):
    return {method: design(plants["nominal pressure"], method) for method in ("hinf", "mu")}


@pytest.fixture(scope="module")
def laws(plants, designs):
    machine = plants["nominal pressure"].machine
    return {
        "pid": pid_controller(machine.controller, machine),
        **{name: made.controller for name, made in designs.items()},
    }


def summits(plant, controller):
    """(frequency [Hz], height [um/N]) of the local maxima of the compliance between the bearings,
    0.1 to 300 Hz.
    """
    omega = HZ * np.geomspace(0.1, 300, 2500)
    curve = 1e6 * np.linalg.norm(
        loop_evaluator(plant, controller)(omega).compliance(), 2, axis=(1, 2)
    )
    inside = np.flatnonzero((curve[1:-1] > curve[:-2]) & (curve[1:-1] >= curve[2:])) + 1
    return [(omega[k] / HZ, curve[k]) for k in inside]


def test_P5_6_compliance_peaks(plants, laws):
    """Printed: largest H-infinity peak about 50 Hz at low pressure, and a peak of H-infinity and mu
    near 2 Hz at low pressure.

    H-infinity has both, the second at 0.87 Hz (w_B decides: test_published_controller.py); mu has
    no peak below 9 Hz.
    """
    at = {(m, label): summits(plants[label], laws[m]) for m in ("hinf", "mu") for label in plants}
    for key, peaks in at.items():
        print(
            f"\nP5.6: {key}: "
            + ", ".join(f"{height:.3f} um/N at {hz:.2f} Hz" for hz, height in peaks),
            end="",
        )
    largest = {label: max(height for _, height in at["hinf", label]) for label in plants}
    assert max(largest, key=largest.get) == "zero pressure"
    low, high = at["hinf", "zero pressure"]
    assert low == pytest.approx((0.87, 0.439), rel=0.02)
    assert high == pytest.approx((50.5, 0.992), rel=0.02)
    assert [hz for hz, _ in at["mu", "zero pressure"]] == pytest.approx([9.6, 52.4], rel=0.03)


def settling_times(plant, controller, band, name="impulse-orthogonal"):
    return settling(
        linear.run(closed_loop(plant, controller), load_scenario(name)), band=band, start=0.05
    )


def test_P5_10_settling_of_the_robust_controllers(plants, laws):
    """Printed: about 0.03 s at nominal pressure, as the PID at zero pressure; the 10 ms pulse
    included.

    To 5 % H-infinity and mu need 26 and 23 ms, to 10 % the PID needs 30: no one band makes them
    alike, for to 5 % the PID needs 83 ms and to 10 % they need 17. At zero pressure mu is better
    damped than H-infinity, as printed, in either band.
    """
    calm, nominal_plant = plants["zero pressure"], plants["nominal pressure"]
    times = {
        (m, band): settling_times(nominal_plant, laws[m], band)
        for m in ("hinf", "mu")
        for band in (0.10, 0.05)
    }
    times |= {("pid", band): settling_times(calm, laws["pid"], band) for band in (0.10, 0.05)}
    low = {
        (m, band): settling_times(calm, laws[m], band)
        for m in ("hinf", "mu")
        for band in (0.10, 0.05)
    }
    print(f"\nP5.10: nominal (PID: zero pressure) {times}; zero pressure {low}")
    assert [times[m, 0.05] for m in ("hinf", "mu")] == pytest.approx([0.026, 0.0233], abs=1e-3)
    assert [times[m, 0.10] for m in ("hinf", "mu")] == pytest.approx([0.0174, 0.0174], abs=1e-3)
    assert [times["pid", band] for band in (0.10, 0.05)] == pytest.approx(
        [0.0297, 0.0829], abs=2e-3
    )
    assert all(low["mu", band] < 0.9 * low["hinf", band] for band in (0.10, 0.05))


def test_P5_12_how_the_responses_begin(plants, laws):
    """Printed: the currents of H-infinity and mu at A_eta start in opposite directions; with
    H-infinity A and B move alike at nominal pressure, with the PID at zero pressure they do not,
    and there it has no response across.

    The last holds exactly when c goes with the pressure (P5 section 5.2); with k alone (section
    4.1) a tenth is left.
    """
    nominal_plant, calm = plants["nominal pressure"], plants["zero pressure"]
    starts = {}
    for method in ("hinf", "mu"):
        record = linear.run(
            closed_loop(nominal_plant, laws[method]), load_scenario("impulse-orthogonal")
        ).record
        starts[method] = (
            1e3 * record["u_A_eta"][(record.time > 0.0505) & (record.time < 0.0525)].mean()
        )

    def peaks(plant, method):
        record = linear.run(
            closed_loop(plant, laws[method]), load_scenario("impulse-parallel")
        ).record
        return {axis: np.abs(record[f"y_{axis}"]).max() for axis in plant.axes}

    hinf, pid = peaks(nominal_plant, "hinf"), peaks(calm, "pid")
    without = peaks(assemble(load_machine("seal-rig"), calm.point), "pid")
    print(
        f"\nP5.12: A_eta begins with {starts} mA; B/A {hinf['B_zeta'] / hinf['A_zeta']:.3f} "
        "(H-infinity), "
        f"{pid['B_zeta'] / pid['A_zeta']:.3f} (PID); across/along "
        f"{pid['A_eta'] / pid['A_zeta']:.3f}"
    )
    assert starts["hinf"] > 1 and starts["mu"] < -1
    assert hinf["B_zeta"] / hinf["A_zeta"] == pytest.approx(1, abs=0.03)
    assert pid["B_zeta"] / pid["A_zeta"] == pytest.approx(1.31, abs=0.03)
    assert pid["A_eta"] / pid["A_zeta"] == pytest.approx(0.105, abs=0.01)
    assert without["A_eta"] < 1e-6 * without["A_zeta"]


def test_7_2_2_robust_performance_is_not_guaranteed(designs):
    """Claimed: mu synthesis guarantees robust performance over the range. With the weights of this
    page mu is 1.78: 0.56 of box and weights. The nominal H-infinity problem has gamma 1.30 already,
    and no controller does better on it.
    """
    margins = designs["mu"].certificate.margins
    print(
        f"\n7.2.2: mu {margins['mu_mixed']:.3f} (from below {margins['mu_mixed_lower']:.3f}), "
        f"gamma {designs['hinf'].gamma:.3f}"
    )
    assert 1.77 < margins["mu_mixed_lower"] <= margins["mu_mixed"] < 1.79
    assert designs["hinf"].certificate.margins["gamma_lower"] > 1.25
    assert designs["hinf"].gamma == pytest.approx(1.304, abs=0.005)
