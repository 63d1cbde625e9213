"""Lauridsen (2017), paper P5: the printed plant (Appendix A), what its matrices imply, and the loop
with the PID of eq. (6).
"""

from __future__ import annotations

import numpy as np
import pytest
from benchmarks.published_p5 import published_p5, published_p5_data, published_p5_pid
from scipy.optimize import brentq

from ambrose.core.frequency import frequency_response
from ambrose.core.lft import close_uncertainty
from ambrose.core.norms import hinf_norm
from ambrose.core.statespace import StateSpace, connect, rename, select, spectral_abscissa
from ambrose.judge.result import certify
from ambrose.law.pid import axes_controller

pytestmark = pytest.mark.literature
DATA = published_p5_data()
AXES = tuple(DATA["axes"])
A, B, C, B_DELTA, C_DELTA = (np.array(DATA[key]) for key in ("A", "B", "C", "B_delta", "C_delta"))
ZETA, ETA = [0, 2], [1, 3]
PER_20_UM = 1 / 20e-6  # A/m in one A per 20 um


def half_digit(matrix: np.ndarray, digits: int) -> np.ndarray:
    """The largest error of numbers printed with so many significant digits."""
    exponent = np.floor(np.log10(np.abs(np.where(matrix == 0, 1, matrix))))
    return np.where(matrix == 0, 0, 0.5 * 10.0 ** (exponent - digits + 1))


def forces(delta: float) -> tuple[np.ndarray, np.ndarray]:
    """Force per displacement (4, 4) [N/m] and per velocity (4, 4) [N s/m] that the plant implies
    between the axes.

    With the states T = [C; C A], the accelerations are C A^2 T^-1 [y; y']; the inverse of C A B
    gives them as forces.
    """
    states = np.vstack([C, C @ A])
    perturbed = A + delta * B_DELTA @ C_DELTA
    acceleration = np.linalg.solve(states.T, (C @ perturbed @ perturbed).T).T
    both = np.linalg.solve(C @ A @ B, acceleration)
    return both[:, :4], both[:, 4:]


def plant(delta: float) -> StateSpace:
    item = published_p5()
    return close_uncertainty(item, {"seal.k": delta})


def pid(gain: float) -> StateSpace:
    return axes_controller(published_p5_pid(gain * PER_20_UM), AXES)


def loop(gain: float, delta: float) -> StateSpace:
    """Inputs d_<axis> [m] and f_<axis> [N], outputs y_<axis> [m], d included; K_p = gain A per 20
    um.
    """
    own = rename(plant(delta), None, {f"y_{a}": f"g_{a}" for a in AXES})
    controller = axes_controller(published_p5_pid(gain * PER_20_UM), AXES)
    y = {f"y_{a}": [f"g_{a}", f"d_{a}"] for a in AXES}
    inputs = [f"{kind}_{a}" for kind in "df" for a in AXES]
    return connect(
        [own, controller], inputs, list(y), {**y, **{f"err_{a}": [f"-y_{a}"] for a in AXES}}
    )


def abscissa(gain: float, delta: float) -> float:
    return spectral_abscissa(loop(gain, delta))


def peak(gain: float, delta: float, kind: str) -> tuple[float, float]:
    """H-infinity norm and its frequency [Hz]: of S_o for kind "d" [-], of the compliance for kind
    "f" [m/N].
    """
    norm = hinf_norm(select(loop(gain, delta), [f"{kind}_{a}" for a in AXES]))
    return norm.value, norm.frequency / (2 * np.pi)


def test_velocity_is_no_direct_effect_of_force_within_the_print():
    """C B = 0 and C B_delta = 0: every entry lies within the rounding of numbers printed with four
    digits.
    """
    for right in (B, B_DELTA):
        rounding = np.abs(C) @ half_digit(right, 4) + half_digit(C, 4) @ np.abs(right)
        assert (np.abs(C @ right) <= rounding).all()
    relative = np.abs(C @ B) / (np.abs(C) @ np.abs(B))
    assert relative.max() < 1.2e-4  # 1.13e-4; in the 2-norm 2.3e-5


def test_total_mass_is_68_kg():
    """The inverse of C A B is the mass matrix seen from the axes; a parallel motion meets the sum
    of its entries.
    """
    mass = np.linalg.inv(C @ A @ B)
    np.testing.assert_allclose(
        [mass[np.ix_(p, p)].sum() for p in (ZETA, ETA)], [67.97, 67.93], atol=0.01
    )
    np.testing.assert_allclose(mass[np.ix_(ZETA, ETA)], 0, atol=0.04)  # planes uncoupled, [kg]


def test_seal_coefficients_that_the_matrices_imply():
    """The seal sits in the middle, so that each of the four entries of a plane pair is a quarter of
    its coefficient.
    """
    for delta, k in ((-1, 0.0), (0, 3.2e6), (1, 6.4e6)):
        stiffness, _ = forces(delta)
        np.testing.assert_allclose(-stiffness[np.ix_(ZETA, ETA)], k / 4, atol=6e3)
        np.testing.assert_allclose(stiffness[np.ix_(ETA, ZETA)], k / 4, atol=6e3)
    _, damping = forces(0)
    for planes in (ZETA, ETA):
        np.testing.assert_allclose(-4 * damping[np.ix_(planes, planes)], 2.5e3, rtol=0.015)  # C
    np.testing.assert_allclose(-4 * damping[np.ix_(ZETA, ETA)], -2.55e3, rtol=0.01)  # c
    np.testing.assert_allclose(4 * damping[np.ix_(ETA, ZETA)], -2.55e3, rtol=0.01)


def test_net_stiffness_at_the_bearings():
    """k_s less coupling and seal K, force at a bearing per displacement at its sensor; coupling and
    seal weaken A more.
    """
    stiffness, _ = forces(-1)
    np.testing.assert_allclose(
        np.diag(stiffness), [0.081e6, 0.049e6, 0.969e6, 0.947e6], atol=0.003e6
    )


def test_uncertainty_is_one_parameter_of_rank_two():
    """B_delta C_delta changes forces by -+3.2e6 N/m across the planes in the rotor's middle, and
    nothing else.
    """
    change = forces(1)[0] - forces(0)[0]
    wanted = np.zeros((4, 4))
    wanted[np.ix_(ZETA, ETA)], wanted[np.ix_(ETA, ZETA)] = -0.8e6, 0.8e6
    np.testing.assert_allclose(change, wanted, atol=0.0015e6)


def test_generalized_plant_is_the_printed_one():
    item = published_p5()
    assert (item.blocks[0].name, item.blocks[0].repeat, item.system.n_states) == ("seal.k", 2, 16)
    omega = np.array([10.0, 250.0, 2000.0])
    s = 1j * omega[:, None, None]
    wn, d = DATA["actuator"]["natural_frequency"], DATA["actuator"]["damping"]
    for delta in (-1.0, 0.0, 0.7):
        rotor = C @ np.linalg.solve(s * np.eye(8) - A - delta * B_DELTA @ C_DELTA, B)
        driven = rotor @ np.diag(DATA["force_per_current"]) * wn**2 / (s**2 + d * s + wn**2)
        values = frequency_response(plant(delta), omega)
        for kind, wanted in (("f", rotor), ("u", driven)):
            found = values.select([f"{kind}_{a}" for a in AXES]).values
            np.testing.assert_allclose(found, wanted, atol=1e-11 * np.abs(wanted).max())


@pytest.mark.parametrize("gain", [0.35, 0.36, 0.38])
def test_the_printed_pattern_with_pid(gain):
    """Stable without pressure and at nominal, there with a resonance about 40 Hz; unstable at twice
    nominal.
    """
    assert abscissa(gain, -1) < 0
    assert abscissa(gain, 0) < 0
    assert abscissa(gain, 1) > 0
    height, hertz = peak(gain, 0, "f")
    calm, _ = peak(gain, -1, "f")
    assert 40 < hertz < 43
    assert height > 2.5 * calm
    sensitivity, hertz = peak(gain, 0, "d")
    assert 5 < sensitivity < 9
    assert 40 < hertz < 45


def test_range_of_gains_with_the_printed_stability():
    """Stable, stable, unstable holds between 0.297 and 0.457 A per 20 um."""
    low = brentq(lambda gain: abscissa(gain, 0), 0.25, 0.32, xtol=1e-5)
    high = brentq(lambda gain: abscissa(gain, 1), 0.42, 0.5, xtol=1e-5)
    np.testing.assert_allclose([low, high], [0.297, 0.457], atol=0.001)
    for gain in np.linspace(0.30, 0.45, 7):
        assert abscissa(gain, -1) < 0
        assert abscissa(gain, 0) < 0
        assert abscissa(gain, 1) > 0


def test_certificate_agrees():
    """The certificate of the nominal loop reports the same verdicts and the same peak."""
    controller = axes_controller(published_p5_pid(), AXES)
    for delta, stable in ((-1, True), (0, True), (1, False)):
        item = select(plant(delta), [f"u_{a}" for a in AXES], [f"y_{a}" for a in AXES])
        certificate = certify(item, controller)
        assert certificate.stable is stable
        np.testing.assert_allclose(certificate.spectral_abscissa, abscissa(0.36, delta), rtol=1e-6)
        if stable:
            np.testing.assert_allclose(
                certificate.closed_loop_norm, peak(0.36, delta, "d")[0], rtol=1e-5
            )
