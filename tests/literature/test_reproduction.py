"""The statements of the thesis that can be judged so far, on the bundled machines; each test
carries its id in the docs.

P5's are judged on both cases of the seal (P5.13): with k alone following the pressure, as in P5
section 4.1, and with all its coefficients, as in section 5.2. `pytest
tests/literature/test_reproduction.py -s` prints the figures quoted in docs/research/reproduction.md.
"""

from functools import cache

import numpy as np
import pytest

from ambrose import load_machine
from ambrose.core.frequency import frequency_response
from ambrose.core.statespace import StateSpace, poles, select
from ambrose.judge import nominal, robust
from ambrose.law.design_problem import design_plant, machine_weights, scale_control
from ambrose.law.loop import closed_loop
from ambrose.law.pid import pid_controller
from ambrose.machine.description import OperatingPoint
from ambrose.model.assemble import assemble
from ambrose.model.uncertainty import reduce
from ambrose.rig import linear
from ambrose.rig.scenario import load_scenario
from ambrose.rig.trace import settling
from ambrose.synthesis.design import design
from ambrose.synthesis.hinf import direct_gain_mismatch, hinf_synthesis

pytestmark = [pytest.mark.literature, pytest.mark.study]
HZ = 2 * np.pi


CONSISTENT, K_ONLY = "seal-rig", "seal-rig-k-only"


@cache
def over_pressure(name):
    """Plants, PID and its checks at nominal, zero and twice nominal pressure."""
    machine = load_machine(name)
    plants = {point.label: assemble(machine, point) for point in machine.operation.points}
    controller = pid_controller(machine.controller, machine)
    return (
        plants,
        controller,
        {label: nominal.check(plant, controller) for label, plant in plants.items()},
    )


@pytest.fixture(scope="module", params=[K_ONLY, CONSISTENT])
def rig(request):
    return over_pressure(request.param)


def test_P1_1_reduced_model_follows_up_to_the_first_bending_mode_only():
    """Printed: singular values agree up to 2e4 rad/s. With P3's first bending mode at 1 kHz (6.3e3
    rad/s) that cannot be.
    """
    machine = load_machine("turboexpander")
    plant = assemble(machine, OperatingPoint(speed=31500 * np.pi / 30))
    omega = np.geomspace(10, 1e5, 400)

    def singular_values(p):
        signals = [f"f_{a}" for a in p.axes], [f"s_{a}" for a in p.axes]
        return np.linalg.svd(
            frequency_response(select(p.rotor, *signals), omega).values, compute_uv=False
        )

    error = np.abs(
        singular_values(reduce(plant, 0, static_correction=False)) / singular_values(plant) - 1
    )
    all_valid, largest_valid = (
        omega[np.argmax(error.max(axis=1) > 0.1)],
        omega[np.argmax(error[:, 0] > 0.1)],
    )
    print(
        f"\nP1.1: within 10 % up to {all_valid:.3g} rad/s (all singular values), "
        f"{largest_valid:.3g} rad/s (the largest)"
    )
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
    print(
        f"\nP5.5: compliance peak {peak.value * 1e6:.3g} um/N {peak.detail}; twice nominal: "
        f"{unstable.detail}"
    )
    curve = checks["nominal pressure"].curve("compliance")
    assert curve.x[np.argmax(curve.y[0])] / HZ == pytest.approx(40, rel=0.1)
    assert checks["zero pressure"].stable
    assert not checks["twice nominal pressure"].stable
    for label, plant in plants.items():  # the reduced model gives the same verdict
        assert (poles(closed_loop(reduce(plant), controller)).real.max() < 0) == checks[
            label
        ].stable


def test_P5_7_unbalance_force(rig):
    """Printed: G2.5 at 500 Hz is 541 N (for 69 kg)."""
    check = rig[2]["nominal pressure"]["unbalance.orbit_0p"]
    print(f"\nP5.7 (PID): orbit {check.value * 1e6:.3g} um up to 200 Hz; {check.detail}")
    assert 69.0 * 2.5e-3 * 500 * HZ == pytest.approx(541, rel=2e-3)
    assert "541" in check.detail or "542" in check.detail


def test_P5_9_input_and_output_sensitivity_alike(rig):
    """Printed for H-infinity and mu controllers; a decentralised PID of equal gains makes them
    equal up to the axes' k_i.
    """
    for label in ("nominal pressure", "zero pressure"):
        found = rig[2][label]
        output, inside = found["sensitivity.output.max"].value, found["sensitivity.input.max"].value
        print(
            f"\nP5.9 (PID, {label}): largest sensitivity {output:.4g} at the output, {inside:.4g} "
            "at the input"
        )
        assert inside == pytest.approx(output, rel=0.02)


def test_P5_10_settling_of_the_PID_at_zero_pressure(rig):
    """Printed: about 0.03 s. That is the time to 10 % of the peak; to 5 % the slow integral pole
    (-5 rad/s) counts.
    """
    plants, controller, _ = rig
    loop = closed_loop(plants["zero pressure"], controller)
    for name in ("impulse-orthogonal", "impulse-parallel"):
        trace = linear.run(loop, load_scenario(name), point=plants["zero pressure"].point)
        times = [settling(trace, band=band, start=0.05) for band in (0.10, 0.05)]
        print(
            f"\nP5.10 (PID, {name}): settles to 10 % in {times[0]:.3f} s, to 5 % in "
            f"{times[1]:.3f} s"
        )
        assert times[0] == pytest.approx(0.03, abs=0.005)


@pytest.fixture(scope="module", params=[K_ONLY, pytest.param(CONSISTENT, marks=pytest.mark.study)])
def three(request):
    """PID, H-infinity and mu controllers of similar direct gain, each with its checks at the three
    pressures and over them.
    """
    return three_controllers(request.param)


@cache
def three_controllers(name):
    plants, reference, checks = over_pressure(name)
    full = plants["nominal pressure"]
    found = {"pid": (reference, checks)}
    for method in ("hinf", "mu"):
        controller = design(full, method).controller
        found[method] = (
            controller,
            {label: nominal.check(plant, controller) for label, plant in plants.items()},
        )
    over_box = {method: robust.check(full, controller) for method, (controller, _) in found.items()}
    return found, over_box, name


def test_P5_3_orders(three):
    """Printed: order 20 for H-infinity, 24 for mu."""
    found, *_ = three
    print(f"\nP5.3: orders {found['hinf'][0].n_states} and {found['mu'][0].n_states}")
    assert found["hinf"][0].n_states == 20
    assert found["mu"][0].n_states == 24


def test_P5_4_direct_gains_alike_cross_gains_not(three):
    """Printed: direct gains alike to 200 Hz, cross gains such as (1, 3) quite different between
    H-infinity and mu.
    """
    found, *_ = three
    omega = HZ * np.geomspace(1, 200, 60)
    gains = {m: np.abs(frequency_response(k, omega).values) for m, (k, _) in found.items()}
    for method in ("hinf", "mu"):
        mean, spread = direct_gain_mismatch(found[method][0], found["pid"][0])
        print(
            f"\nP5.4: {method} direct gains {100 * mean:+.1f} % of the PID's (rms "
            f"{100 * spread:.0f} %)",
            end="",
        )
        assert abs(mean) < 0.02
        assert spread < 0.2
    factor = np.exp(np.abs(np.log(gains["mu"][:, 0] / gains["hinf"][:, 0])).max(axis=0))
    print(
        f"\nP5.4: mu and H-infinity differ in (1,1) .. (1,4) by factors up to {np.round(factor, 2)}"
    )
    assert factor[0] < 1.1
    assert factor[2] > 2


def test_P5_6_compliance_peaks(three):
    """Printed: largest H-infinity peak about 50 Hz at low pressure. The low-frequency peaks are in
    test_p5.py.
    """
    found, *_ = three
    peaks = {
        (m, label): (c["compliance.max"].value, c["compliance.max"].detail)
        for m, (_, checks) in found.items()
        for label, c in checks.items()
        if c.stable
    }
    for key, (value, detail) in peaks.items():
        print(f"\nP5.6: {key}: {value * 1e6:.3g} um/N {detail}", end="")
    hinf_peaks = {label: value for (m, label), (value, _) in peaks.items() if m == "hinf"}
    assert max(hinf_peaks, key=hinf_peaks.get) == "zero pressure"
    curve = found["hinf"][1]["zero pressure"].curve("compliance")
    assert curve.x[np.argmax(curve.y[0])] / HZ == pytest.approx(50, rel=0.2)


def test_P5_7_orbits_of_the_robust_controllers(three):
    """Printed: below 8 um to 200 Hz for both. With K, C and c gone as well, H-infinity's is 12.5 um
    at zero pressure.
    """
    found, _, name = three
    for method in ("hinf", "mu"):
        orbits = {
            label: checks["unbalance.orbit_0p"].value for label, checks in found[method][1].items()
        }
        print(
            f"\nP5.7: {method} "
            + ", ".join(f"{label} {value * 1e6:.2f} um" for label, value in orbits.items()),
            end="",
        )
        beyond = [label for label, value in orbits.items() if value > 8e-6]
        assert beyond == (["zero pressure"] if (method, name) == ("hinf", CONSISTENT) else [])


def test_P5_8_sensitivity_over_the_pressure_range(three):
    """Printed: mu nearly keeps sigma_max(S_o) below 3; H-infinity exceeds 3 but stays stable; the
    PID does not hold.

    With all coefficients on the pressure mu keeps 3 over three quarters of the range and has 3.80
    at zero pressure.
    """
    _, over_box, name = three
    worst = {
        method: checks["robust.sensitivity.worst"].value for method, checks in over_box.items()
    }
    margin = {
        method: checks["robust.stability.margin"].value for method, checks in over_box.items()
    }
    print(f"\nP5.8: worst sigma_max(S_o) {worst}; stable up to {margin} tolerances")
    assert margin["pid"] < 1 < margin["hinf"] < margin["mu"]
    low, high = {K_ONLY: (3.5, 3.3), CONSISTENT: (9.0, 3.9)}[name]
    assert worst["hinf"] > low
    assert 3.0 < worst["mu"] < high
    assert (
        over_box["mu"]["robust.sensitivity.at-0.5"].value < 3
        and over_box["mu"]["robust.sensitivity.at+0.5"].value < 3
    )
    assert over_box["mu"]["robust.sensitivity.bound"].value >= worst["mu"]


def test_P5_9_input_and_output_sensitivity_of_the_robust_controllers(three):
    _, over_box, _ = three
    for method in ("hinf", "mu"):
        output, inside = (
            over_box[method][f"robust.sensitivity.{side}"].value for side in ("worst", "input")
        )
        print(
            f"\nP5.9: {method} worst {output:.4g} at the output, {inside:.4g} at the input", end=""
        )
        assert inside == pytest.approx(output, rel=0.02)


def test_P5_10_settling_of_the_robust_controllers(three):
    """Printed: about 0.03 s at nominal pressure; ours settle in 0.017 s (10 %), the 10 ms pulse
    included.

    At zero pressure mu is better damped than H-infinity, as printed: 0.026 s against 0.030 s with k
    alone, 0.031 s against 0.073 s with all coefficients on the pressure.
    """
    found, _, name = three
    times = {}
    for label in ("nominal pressure", "zero pressure"):
        for method in ("hinf", "mu"):
            trace = linear.run(
                closed_loop(over_pressure(name)[0][label], found[method][0]),
                load_scenario("impulse-orthogonal"),
            )
            times[method, label] = settling(trace, band=0.10, start=0.05)
    print(f"\nP5.10: {times}")
    assert times["hinf", "nominal pressure"] < 0.03
    assert times["mu", "nominal pressure"] < 0.03
    assert times["mu", "zero pressure"] < times["hinf", "zero pressure"]
    assert (times["hinf", "zero pressure"] > 0.06) == (name == CONSISTENT)


def test_P5_13_a_controller_for_k_alone_against_one_for_all_that_follows_the_pressure():
    """Printed: section 4.1 varies k alone, section 5.2 uses the coefficients identified at each
    pressure.

    The mu controller for k alone loses most where K, C and c vanish too; the one for all of them is
    no worse on k alone.
    """
    found = {
        (made, on): robust.check(
            over_pressure(on)[0]["nominal pressure"], three_controllers(made)[0]["mu"][0]
        )
        for made, on in ((K_ONLY, CONSISTENT), (CONSISTENT, K_ONLY))
    }
    worst = {key: checks["robust.sensitivity.worst"].value for key, checks in found.items()}
    own = {
        name: three_controllers(name)[1]["mu"]["robust.sensitivity.worst"].value
        for name in (K_ONLY, CONSISTENT)
    }
    print(f"\nP5.13: worst sigma_max(S_o) of mu (made for, on) {worst}; on their own case {own}")
    assert worst[K_ONLY, CONSISTENT] > 1.2 * own[CONSISTENT]
    assert worst[CONSISTENT, K_ONLY] < 1.02 * own[K_ONLY]


def test_P5_11_more_gain_more_robustness(rig):
    """Printed: larger direct stiffness and damping raise the robustness of all three (here: PID and
    H-infinity, gain +15 %).
    """
    plants, reference, _ = rig
    small = reduce(plants["nominal pressure"])
    weights = machine_weights(small.machine)

    def h_infinity(factor):
        return hinf_synthesis(
            design_plant(small, scale_control(weights, factor), uncertain=False)
        ).controller

    def stiffer(factor):
        return StateSpace(reference.A, reference.B, reference.C * factor, reference.D * factor)

    for name, pair in {
        "PID": (reference, stiffer(1.15)),
        "H-infinity": (h_infinity(1.0), h_infinity(0.7)),
    }.items():
        low, high = (robust.check(small, k)["robust.stability.margin"].value for k in pair)
        print(f"\nP5.11: {name} margin {low:.3f} -> {high:.3f} tolerances", end="")
        assert high > low
