"""Magnets as networks: force against the co-energy, coefficients against closed forms and printed
figures.
"""

import numpy as np
import pytest

from ambrose.core.checks import InvalidInput
from ambrose.machine.part import Magnet
from ambrose.model.magnetics import (
    Branch,
    DrivenMagnet,
    Froehlich,
    MagneticNetwork,
    MeasuredCurve,
    bias_linearisation,
    heteropolar,
    linearity,
    magnet_of,
    thrust,
)

MU_0 = 4e-7 * np.pi
N, A, S, I_0 = 50, 4e-4, 0.5e-3, 4.0
IRON = {"iron_path": 0.03, "leakage": 0.05, "journal_radius": 0.03, "back_iron_area": 4e-4}
PM = {
    "bias": "permanent-magnet",
    "remanence": 1.1,
    "magnet_length": 0.01,
    "magnet_area": 1e-3,
    "leakage": 0.1,
}


def magnet(kind="heteropolar", **more):
    return magnet_of(Magnet(kind, N, A, S, **more))


def three_pole(turns, pole_area, gap):
    """Three poles at 90, 210 and 330 deg, one coil each, without another path for the flux.

    The force is the square of a single complex flux, so that it is linear about a static load
    only: bias currents (1, -1/2, -1/2) pull along +eta, f_eta = (9/16) mu_0 N^2 A i_0^2/s_0^2 2/3,
    and k_i is diagonal there. Source: Chen and Hsu, IEEE/ASME Trans. Mechatronics 7 (2002).
    """
    angles = np.pi / 2 + np.arange(3) * 2 * np.pi / 3
    branches = [
        Branch(0, 1, pole_area, gap, f"pole {k + 1}", (float(np.cos(a)), float(np.sin(a))))
        for k, a in enumerate(angles)
    ]
    network = MagneticNetwork(branches, turns * np.eye(3))
    # One complex flux phi = phi_zeta + j phi_eta makes the force f_zeta + j f_eta ~ -j conj(phi)^2.
    # Bias puts phi along eta; a small change d of it adds -2 j conj(phi) conj(d), so that currents
    # in the pattern -cos(a) add force along zeta, and sin(a) along eta.
    drive = np.column_stack([-np.cos(angles), np.sin(angles)])
    return DrivenMagnet(network, np.array([1.0, -0.5, -0.5]), drive)


MAGNETS = {
    "8 poles": magnet(),
    "8 poles NNSS with iron": magnet(polarity="NNSS", **IRON),
    "saturated": magnet(iron_path=0.03, iron_flux_density=0.6),
    "12 poles": magnet(poles=12, **IRON),
    "16 poles": magnet(poles=16, polarity="NNSS"),
    "E-core": magnet("e-core", **IRON),
    "homopolar": magnet("homopolar", bias_turns=100.0),
    "homopolar with a permanent magnet": magnet("homopolar", poles=3, iron_path=0.03, **PM),
    "three poles": three_pole(N, A, S),
    "thrust, unequal sides": thrust((100, 80), 1e-3, 1.2e-3, (0.5e-3, 0.6e-3)),
}


def off_centre(m):
    """A place and control currents away from the centre."""
    k = len(m.axes)
    return np.array([0.11, -0.07])[:k] * S, np.array([0.6, -0.4])[:k]


def difference(function, at, step):
    """Derivative (.., n) of sixth order by differences."""
    rows = []
    for k in range(len(at)):
        e = step * np.eye(len(at))[k]
        f = {n: np.asarray(function(at + n * e)) for n in (-3, -2, -1, 1, 2, 3)}
        rows.append((45 * (f[1] - f[-1]) - 9 * (f[2] - f[-2]) + f[3] - f[-3]) / (60 * step))
    return np.array(rows).T


@pytest.mark.parametrize("name", MAGNETS)
def test_the_stress_is_the_derivative_of_the_co_energy(name):
    m = MAGNETS[name]
    x, i = off_centre(m)
    state = m.at(I_0, i, x)
    force = difference(lambda place: m.at(I_0, i, place).coenergy, x, 2e-3 * S)
    assert force == pytest.approx(state.force, rel=1e-9, abs=1e-9 * np.abs(state.force).max())
    currents = m.bias * I_0 + m.drive @ i
    linkage = difference(lambda c: m.network.solve(c, x).coenergy, currents, 5e-3)
    assert linkage == pytest.approx(state.linkage, rel=1e-8, abs=1e-8 * state.linkage.max())


@pytest.mark.parametrize("name", MAGNETS)
def test_coefficients_are_derivatives_of_force_and_linkage(name):
    m = MAGNETS[name]
    x, i = off_centre(m)
    state = m.at(I_0, i, x)
    k_i, k_s = m.coefficients(I_0, i, x)
    currents = m.bias * I_0 + m.drive @ i
    by_current = difference(lambda c: m.network.solve(c, x).force, currents, 2e-3)
    by_place = difference(lambda place: m.at(I_0, i, place).force, x, 2e-3 * S)
    emf = difference(lambda place: m.at(I_0, i, place).linkage, x, 2e-3 * S)
    inductance = difference(lambda c: m.network.solve(c, x).linkage, currents, 2e-3)
    big = np.abs(by_current).max()
    assert state.force_per_current == pytest.approx(by_current, rel=1e-7, abs=1e-8 * big)
    assert emf.T == pytest.approx(by_current, rel=1e-6, abs=1e-7 * big)  # reciprocity
    assert k_s == pytest.approx(by_place, rel=1e-7, abs=1e-8 * np.abs(by_place).max())
    assert state.inductance == pytest.approx(inductance, rel=1e-7, abs=1e-9)
    assert k_i == pytest.approx(by_current @ m.drive, rel=1e-7, abs=1e-8 * big)
    assert (np.linalg.eigvalsh(k_s) > 0).all()  # Earnshaw: there is no stable direction


def test_one_horseshoe_pair_has_the_square_of_the_cosine():
    """Alone on its journal: k_i = 4 mu_0 N^2 A i_0 cos a/s^2 and k_s = k_i^2/(2 L_0), with cos^2
    a.
    """
    a = np.pi / 8
    branches, turns = [], np.zeros((4, 2))
    for k, angle in enumerate((-a, a, np.pi - a, np.pi + a)):
        # each pair of poles with a journal of its own
        ends = (k // 2, 10 + k // 2)
        normal = (np.cos(angle), np.sin(angle))
        branches.append(Branch(*(ends if k % 2 else ends[::-1]), A, S, f"{k}", normal))
        turns[k, k // 2] = N
    state = MagneticNetwork(branches, turns).solve([I_0, I_0])
    k_i = state.force_per_current[0] @ [1, -1]
    k_s = state.stiffness[0, 0]
    assert k_i == pytest.approx(4 * MU_0 * N**2 * A * I_0 * np.cos(a) / S**2, rel=1e-12)
    assert k_s == pytest.approx(4 * MU_0 * N**2 * A * I_0**2 * np.cos(a) ** 2 / S**3, rel=1e-12)
    assert k_s == pytest.approx(k_i**2 / (2 * state.inductance[0, 0]), rel=1e-12)


def test_eight_poles_on_one_journal():
    """The neighbours add sin^2 a: the stiffness does not depend on the direction."""
    k_i, k_s = MAGNETS["8 poles"].coefficients(I_0)
    expected = 4 * MU_0 * N**2 * A * I_0 * np.cos(np.pi / 8) / S**2
    assert k_i == pytest.approx(expected * np.eye(2), rel=1e-12, abs=1e-9)
    square = 4 * MU_0 * N**2 * A * I_0**2 / S**3
    assert k_s == pytest.approx(square * np.eye(2), rel=1e-12, abs=1e-4)


def test_permanent_magnet_homopolar():
    """k_i = 2 N A B_0/s and k_s = 2 A B_0^2/(mu_0 s) per plane; B_0 by the magnet's own circuit."""
    m = magnet("homopolar", **PM)
    k_i, k_s = m.coefficients(0.0)
    # F = phi (R_m || R_leak + 2 s/(4 mu_0 A)): two planes of four gaps in series
    R_m = 0.01 / (MU_0 * 1.05 * 1e-3)
    R_leak = 0.01 / (MU_0 * 0.1 * 1e-3)
    R_gaps = 2 * S / (4 * MU_0 * A)
    source = 1.1 * 0.01 / (MU_0 * 1.05)
    B_0 = source / R_m / (1 / R_m + 1 / R_leak + 1 / R_gaps) / R_gaps / (4 * A)
    assert m.at(0.0).flux_density[0] == pytest.approx(B_0, rel=1e-12)
    assert k_i == pytest.approx(2 * 2 * N * A * B_0 / S * np.eye(2), rel=1e-12, abs=1e-9)
    assert k_s == pytest.approx(2 * 2 * A * B_0**2 / (MU_0 * S) * np.eye(2), rel=1e-12, abs=1e-4)


def test_thrust_and_three_poles():
    m = thrust((100, 100), 1e-3, 1.2e-3, (S, S))
    k_i, k_s = m.coefficients(I_0)
    R_0 = S / MU_0 * (1 / 1e-3 + 1 / 1.2e-3)
    L_0 = 100**2 / R_0
    by_hand = 4 * I_0 * 100**2 / R_0**2 / MU_0 * (1 / 1e-3 + 1 / 1.2e-3) / 2
    assert k_i[0, 0] == pytest.approx(by_hand, rel=1e-12)
    assert k_s[0, 0] == pytest.approx(k_i[0, 0] ** 2 / (2 * L_0), rel=1e-12)
    three = MAGNETS["three poles"]
    pull = (9 / 16) * (2 / 3) * MU_0 * N**2 * A * I_0**2 / S**2
    assert three.at(I_0).force == pytest.approx([0.0, pull], rel=1e-12, abs=1e-12)
    k_i, _ = three.coefficients(I_0)
    assert k_i == pytest.approx(2 * pull / I_0 * np.eye(2), rel=1e-12, abs=1e-9)


def test_a_lost_coil_and_what_makes_up_for_it():
    single = heteropolar(Magnet("heteropolar", N, A, S), separate=True)
    assert single.without(0).at(I_0).force[0] < -10  # the opposite side pulls at once
    whole, k = bias_linearisation(single.network, lost=(0,), starts=4)
    assert not whole[0].any() and k > 5
    for i in ((4.0, 1.0, -0.5), (2.0, -3.0, 1.5)):
        force = single.network.solve(whole @ i).force
        assert force == pytest.approx(k * i[0] * np.array(i[1:]), rel=1e-7)
    with pytest.raises(InvalidInput, match="keep more of them"):
        bias_linearisation(single.network, lost=(0, 1, 2, 3, 4, 5), starts=1)
    with pytest.raises(InvalidInput, match="there is no coil 9"):
        single.without(9)


def test_the_map_of_the_straight_law():
    """One pair alone, by hand: c ((i_0 + i)^2/(s - x)^2 - (i_0 - i)^2/(s + x)^2)."""
    m = thrust((100, 100), 1e-3, 1e-3, (S, S))
    found = linearity(m, I_0, S)
    k = found.force[-1, -1] / ((1.25 / 0.75) ** 2 - (0.75 / 1.25) ** 2)
    share = np.array([-1.0, 1.0]) * 0.25
    i, x = np.meshgrid(share, share, indexing="ij")
    by_hand = k * (((1 + i) / (1 - x)) ** 2 - ((1 - i) / (1 + x)) ** 2)
    assert found.force[np.ix_([0, -1], [0, -1])] == pytest.approx(by_hand, rel=1e-9)
    assert found.worst == pytest.approx(abs(by_hand[1, 1] / k - 4 * 0.5) / 4, rel=1e-9)
    with pytest.raises(InvalidInput, match="below 1"):
        linearity(m, I_0, S, share=1.2)


def test_a_measured_curve_is_the_curve_it_was_taken_from():
    froehlich = Froehlich(3000, 1.9)
    b = np.linspace(0.02, 1.7, 85)
    curve = MeasuredCurve(tuple(b), tuple(froehlich.field(b)))
    at = np.array([-1.51, 0.333, 1.2])
    assert curve.field(at) == pytest.approx(froehlich.field(at), rel=2e-3)
    assert curve.energy(at) == pytest.approx(froehlich.energy(at), rel=2e-3)
    assert curve.slope(2.5) == pytest.approx(1 / MU_0)  # vacuum beyond its end
    with pytest.raises(InvalidInput, match="rising from zero"):
        MeasuredCurve((0.5, 0.4), (10.0, 20.0))


def test_refusals():
    with pytest.raises(InvalidInput, match="the rotor overlaps the magnet"):
        MAGNETS["8 poles"].at(I_0, place=[0.6e-3, 0.0])
    with pytest.raises(InvalidInput, match="no closed path"):
        MagneticNetwork([Branch(0, 1, A, S)], [[1.0]])


def test_measured_magnet_of_darmstadt():
    """Force constant k of the magnets of TU Darmstadt's rig: 3.63e-6 N m2/A2 measured (K. Baumann),
    as noted with turns, face and gap in AppliedMechanics/AMrotor, Config_Sim_Mag1.m.
    """
    m = magnet_of(Magnet("heteropolar", 104, 2.9e-4, 780e-6))
    k_i = m.coefficients(2.5)[0][0, 0]
    assert k_i * 780e-6**2 / (4 * 2.5) == pytest.approx(3.63e-6, rel=5e-3)


def test_printed_saturation_of_the_seal_rig():
    """K_s of bearing A at 8 and 10 A over that at 6 A, as P2 prints them (zeta, eta): 1.711, 1.715
    and 2.381, 2.386. Without iron these would be 1.78 and 2.78.
    """
    m = magnet_of(Magnet("heteropolar", 36, 24e-4, 0.5e-3, iron_path=0.18, iron_flux_density=1.73))
    k_s = [m.coefficients(bias)[1][0, 0] for bias in (6.0, 8.0, 10.0)]
    assert k_s[1] / k_s[0] == pytest.approx(1.713, rel=0.05)
    assert k_s[2] / k_s[0] == pytest.approx(2.384, rel=0.05)


def test_textbook_magnet_as_ross_prints_it():
    """Schweitzer and Maslen, Magnetic Bearings, pages 69 to 80, as ROSS' MagneticBearingElement
    takes them: 200 turns on both poles, A = 1e-4 m2, gap 1 mm, 1 A, poles at 0.392 rad; k_i - k_s =
    -4640.623377181318 in its documentation (gains of one).

    Its k_s is k_i i_0/s_0, one axis alone with the cosine of the pole angle once. A pole's gap
    opens by that cosine, too, and the other axis' poles pull sideways: cos^2 + sin^2 = 1.
    """
    printed_k_i = 4640.623377181318 / (1 / 1e-3 - 1)
    found = magnet_of(Magnet("heteropolar", 100, 1e-4, 1e-3)).coefficients(1.0)
    k_i, k_s = (item[0, 0] for item in found)
    # 22.5 degrees are 0.3927 rad
    assert k_i == pytest.approx(printed_k_i, rel=4e-4)
    assert k_s == pytest.approx(printed_k_i / 1e-3 / np.cos(np.pi / 8), rel=4e-4)
