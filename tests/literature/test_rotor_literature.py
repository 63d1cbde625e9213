"""The finite-element rotor against the literature and against an independent code.

1. Nelson & McVaugh (1976), The dynamics of rotor-bearing systems using finite elements, J. Eng.
   Ind. 98: critical speeds of an 18-element overhung rotor on isotropic bearings. Neither the
   speeds nor the shaft table were read in the paper: the table is that of public reproductions,
   with a total length of 35.5 cm. (One of them ends at 35.81 cm, which misses the second pair of
   speeds by 1.4 %; the disc's polar inertia is 0.00203 kg m2 there, and rounded to 0.0020
   elsewhere, which costs 0.2 % more at the last speed.)
2. ROSS 2.3.0 (ross-rotordynamics, run once in an environment of its own): eigenvalues of a stepped,
   partly hollow rotor with two discs, damped bearings, one of them anisotropic, and a cross-coupled
   spring, at standstill and at 2000 rad/s.
"""

import numpy as np
import pytest
import scipy.linalg as sla

import ambrose as amb
from ambrose.annexes.rotordynamics.critical_map import critical_map
from ambrose.annexes.rotordynamics.loop import shaft_loop
from ambrose.annexes.rotordynamics.stations import lay_out
from ambrose.core.mechanical import SecondOrder, to_statespace
from ambrose.core.statespace import poles
from ambrose.machine.description import Amplifier, MachineDescription
from ambrose.machine.file.toml import load_machine
from ambrose.machine.machine import Machine
from ambrose.machine.part import Disc, Material, ShaftSection
from ambrose.model.effects.rotor import (
    displacement_row,
    finite_element_rotor,
    mass_properties,
    plane_rows,
)
from ambrose.model.effects.stations import JournalBearing

pytestmark = pytest.mark.literature

NELSON_STATIONS_CM = (
    0.0,
    1.27,
    5.08,
    7.62,
    8.89,
    10.16,
    10.67,
    11.43,
    12.7,
    13.46,
    16.51,
    19.05,
    22.86,
    26.67,
    28.70,
    30.48,
    31.50,
    34.54,
    35.5,
)
NELSON_OUTER_RADII_CM = (
    0.51,
    1.02,
    0.76,
    2.03,
    2.03,
    3.30,
    3.30,
    2.54,
    2.54,
    1.27,
    1.27,
    1.52,
    1.52,
    1.27,
    1.27,
    3.81,
    2.03,
    2.03,
)
NELSON_INNER_RADII_CM = {6: 1.52, 7: 1.78, 17: 1.52}  # element (from 0): bore; the others are solid
NELSON_BEARINGS = (0.1651, 0.2870)  # stations 11 and 15 [m]
NELSON_STIFFNESS = 4.378e7  # [N/m], isotropic and undamped
# recalled, not read in the paper
NELSON_CRITICAL_RPM = {"backward": (15470, 46612, 64752), "forward": (17159, 49983, 96457)}


def nelson_rotor(theory, refine=1):
    material = Material(density=7806.0, youngs_modulus=2.078e11)
    ends = np.array(NELSON_STATIONS_CM) / 100
    outer = 2 * np.array(NELSON_OUTER_RADII_CM) / 100
    inner = 2 * np.array([NELSON_INNER_RADII_CM.get(i, 0.0) for i in range(18)]) / 100
    shaft = tuple(
        ShaftSection(
            float(z), float(length), float(do), float(di), elements=refine, material=material
        )
        for z, length, do, di in zip(ends, np.diff(ends), outer, inner, strict=False)
    )
    disc = Disc("disc", 0.0889, mass=1.401, polar_inertia=0.00203, diametral_inertia=0.00136)
    return finite_element_rotor(
        Machine("Nelson", shaft, (), (), Amplifier("none"), discs=(disc,), beam_theory=theory)
    )


def critical_speeds(rotor, direction):
    """Speeds [rpm] at which the rotor whirls once per turn: omega = +-Omega in -omega^2 M + Omega
    omega G + K.
    """
    K = rotor.plane_stiffness.copy()
    for row in plane_rows(rotor, NELSON_BEARINGS)[0]:
        K += NELSON_STIFFNESS * np.outer(row, row)
    inertia = rotor.plane_mass - (1 if direction == "forward" else -1) * rotor.plane_gyroscopic
    inverse_squares = sla.eigh(inertia, K, eigvals_only=True)
    return np.sort(inverse_squares[inverse_squares > 0] ** -0.5)[:3] * 30 / np.pi


@pytest.mark.parametrize("direction", ["backward", "forward"])
def test_nelson_mcvaugh_critical_speeds(direction):
    """The paper's element (rotary inertia, no shear): within 0.5 %; found +0.04, +0.29, +0.01 % and
    0.00, +0.29, -0.37 %.
    """
    rotor = nelson_rotor("rayleigh")
    assert rotor.n_nodes == 19
    assert critical_speeds(rotor, direction) == pytest.approx(
        NELSON_CRITICAL_RPM[direction], rel=5e-3
    )


def test_nelson_mcvaugh_is_not_met_by_the_other_theories():
    """The comparison can fail: leaving rotary inertia out, or adding shear, misses some speed by
    more than 0.5 %.
    """
    for theory in ("bernoulli-euler", "timoshenko"):
        rotor = nelson_rotor(theory)
        errors = [
            critical_speeds(rotor, d) / NELSON_CRITICAL_RPM[d] - 1 for d in ("backward", "forward")
        ]
        assert np.abs(errors).max() > 5e-3


def test_nelson_mcvaugh_mesh_is_converged():
    for direction in ("backward", "forward"):
        coarse, fine = (
            critical_speeds(nelson_rotor("rayleigh", refine), direction) for refine in (1, 4)
        )
        assert coarse == pytest.approx(fine, rel=2e-3)


def test_the_bundled_machine_is_this_rotor():
    machine = load_machine("nelson-mcvaugh-rotor")
    # without the parts on magnets, which have nodes of their own
    shaft = MachineDescription(
        machine.name, machine.shaft, (), (), discs=machine.discs, beam_theory=machine.beam_theory
    )
    bundled, other = finite_element_rotor(shaft), nelson_rotor("rayleigh")
    for name in ("positions", "mass", "gyroscopic", "stiffness"):
        one, two = getattr(bundled, name), getattr(other, name)
        np.testing.assert_allclose(one, two, rtol=1e-9, atol=1e-9 * np.abs(two).max())


# Model given to ROSS: section length, outer and inner diameter [m], elements; rho = 7850, E =
# 2.1e11, nu = 0.3 (Cowper's shear coefficient); discs at the nodes 2 and 9; bearings as (node, kxx,
# kyy, kxy = -kyx, cxx = cyy); rotary_inertia and shear_effects switched per theory, gyroscopic
# always on.
ROSS_SECTIONS = (
    (0.15, 0.04, 0.0, 2),
    (0.20, 0.06, 0.02, 3),
    (0.30, 0.08, 0.03, 4),
    (0.20, 0.05, 0.02, 3),
    (0.10, 0.035, 0.0, 2),
)
ROSS_DISCS = (Disc("one", 0.15, 6.0, 0.035, 0.02), Disc("two", 0.65, 10.0, 0.09, 0.05))
ROSS_BEARINGS = ((1, 2e7, 3e7, 0.0, 500.0), (13, 1.5e7, 1.5e7, 0.0, 800.0), (6, 0.0, 0.0, 8e5, 0.0))
ROSS_MASS = 34.94311647775348  # [kg]
# theory -> speed [rad/s] -> the ten lateral eigenvalues of lowest positive imaginary part [rad/s],
# as run_modal gives them
ROSS_EIGENVALUES = {
    "bernoulli-euler": {
        0.0: (
            (-21.703293, 674.495469),
            (13.666420, 674.701352),
            (-27.686331, 1532.626472),
            (-25.523284, 1723.732811),
            (-89.994198, 3534.188331),
            (-96.328722, 3684.645015),
            (-267.361678, 5249.745082),
            (-261.843912, 5285.249401),
            (-53.345282, 7842.284203),
            (-53.231020, 7893.566522),
        ),
        2000.0: (
            (-22.092880, 664.304514),
            (13.850639, 684.219103),
            (-27.980818, 1504.351325),
            (-25.458409, 1743.052995),
            (-67.717385, 3184.613877),
            (-136.686290, 4026.235197),
            (-271.580067, 5120.177273),
            (-231.605068, 5456.813041),
            (-63.829075, 7199.012573),
            (-47.622813, 8422.602190),
        ),
    },
    "rayleigh": {
        0.0: (
            (-21.702572, 674.362298),
            (13.671678, 674.567866),
            (-27.555204, 1529.706459),
            (-25.380330, 1720.088863),
            (-88.799850, 3518.587741),
            (-95.100535, 3669.487025),
            (-265.466181, 5218.044349),
            (-260.000561, 5253.106352),
            (-52.450317, 7770.108436),
            (-52.355138, 7821.068989),
        ),
        2000.0: (
            (-22.090266, 664.174371),
            (13.854525, 684.082934),
            (-27.856487, 1501.491894),
            (-25.310428, 1739.380629),
            (-67.066785, 3173.164373),
            (-134.562407, 4007.598207),
            (-269.353882, 5091.515409),
            (-230.509776, 5419.763339),
            (-63.040381, 7143.737319),
            (-46.561668, 8333.821829),
        ),
    },
    "timoshenko": {
        0.0: (
            (-21.854761, 669.252058),
            (14.068060, 669.455627),
            (-26.747016, 1519.329324),
            (-24.450281, 1705.719698),
            (-86.771775, 3494.587900),
            (-92.791829, 3642.196587),
            (-261.439371, 5150.025386),
            (-256.047136, 5185.770420),
            (-54.216501, 7564.629073),
            (-53.985576, 7621.159787),
        ),
        2000.0: (
            (-22.196761, 659.335466),
            (14.218959, 678.707796),
            (-27.108096, 1491.004121),
            (-24.333634, 1724.907280),
            (-65.921602, 3157.754391),
            (-129.730376, 3966.974284),
            (-263.169228, 5025.648839),
            (-229.027258, 5341.761974),
            (-65.690347, 6965.368702),
            (-48.429005, 8089.995272),
        ),
    },
}


def ross_model(theory):
    shaft, z = [], 0.0
    for length, outer, inner, elements in ROSS_SECTIONS:
        shaft.append(
            ShaftSection(
                z, length, outer, inner, elements=elements, material=Material(7850.0, 2.1e11, 0.3)
            )
        )
        z += length
    machine = Machine(
        "ROSS", tuple(shaft), (), (), Amplifier("none"), discs=ROSS_DISCS, beam_theory=theory
    )
    rotor = finite_element_rotor(machine)
    stiffness, damping = rotor.stiffness.copy(), np.zeros_like(rotor.stiffness)
    for node, kxx, kyy, kxy, c in ROSS_BEARINGS:
        x, y = (displacement_row(rotor, rotor.positions[node], angle) for angle in (0.0, np.pi / 2))
        stiffness += (
            kxx * np.outer(x, x) + kyy * np.outer(y, y) + kxy * (np.outer(x, y) - np.outer(y, x))
        )
        damping += c * (np.outer(x, x) + np.outer(y, y))
    n = len(stiffness)
    none = np.zeros((0, n))
    return rotor, SecondOrder(
        rotor.mass, damping, rotor.gyroscopic, stiffness, none.T, none, none, (), ()
    )


@pytest.mark.parametrize("speed", [0.0, 2000.0])
@pytest.mark.parametrize("theory", list(ROSS_EIGENVALUES))
def test_ross_eigenvalues(theory, speed):
    """Frequencies, damping and the direction of whirl that the cross-coupled spring drives: equal
    to all printed digits.
    """
    rotor, system = ross_model(theory)
    assert mass_properties(rotor).mass == pytest.approx(ROSS_MASS, rel=1e-12)
    values = poles(to_statespace(system, speed))
    values = values[values.imag > 0]
    values = values[np.argsort(values.imag)][:10]
    expected = np.array([complex(*pair) for pair in ROSS_EIGENVALUES[theory][speed]])
    assert np.abs(values - expected).max() < 1e-5


ROSS_STIFFNESS = (1e5, 1e6, 1e7, 1e8, 1e9)  # [N/m]
ROSS_MAP = {  # run_ucs(synchronous=True): [rad/s], a row per forward critical speed
    "timoshenko": (
        (75.24212304, 231.4342178, 581.18024183, 819.40769481, 859.46132336),
        (139.47626143, 433.9591074, 1227.08504615, 2490.81483399, 2949.91345757),
        (2844.35183385, 2950.28807297, 3841.21414983, 6247.320238, 7421.11169178),
    ),
    "rayleigh": (
        (75.24827388, 231.61757095, 584.42831975, 829.09079826, 870.67761226),
        (139.48660247, 434.26281129, 1232.93613852, 2540.15737281, 3033.59335329),
        (2890.366532, 2995.99058258, 3895.18036886, 6552.60103429, 8010.16857128),
    ),
}


@pytest.mark.parametrize("theory", list(ROSS_MAP))
def test_the_undamped_critical_speeds_over_the_support_are_ross_s(theory):
    """ROSS takes every element's polar inertia off its diametral one and solves at rest, Ambrose has
    one pencil with M - G; decades are values of the map. Found within 2e-9.
    """
    shaft, z, nodes = [], 0.0, [0.0]
    for length, outer, inner, elements in ROSS_SECTIONS:
        material = Material(7850.0, 2.1e11, 0.3)
        shaft.append(ShaftSection(z, length, outer, inner, elements=elements, material=material))
        nodes += [z + length * (k + 1) / elements for k in range(elements)]
        z += length
    films = tuple(
        JournalBearing(f"b{node}", nodes[node], (1e7,), (1e7,), (0.0,), (0.0,))
        for node, *_ in ROSS_BEARINGS[:2]
    )
    machine = Machine(
        "ROSS",
        tuple(shaft),
        (),
        (),
        Amplifier("none"),
        discs=ROSS_DISCS,
        beam_theory=theory,
        effects=films,
    )
    layout = lay_out(machine)
    loop = shaft_loop(layout, amb.OperatingPoint(2000.0), None, None)
    found = critical_map(layout, loop, lambda speed: loop, None, (100.0, 3000.0))
    for number, row in enumerate(ROSS_MAP[theory]):
        ours = np.exp(
            np.interp(np.log(ROSS_STIFFNESS), np.log(found.stiffness), np.log(found.speeds[number]))
        )
        assert ours == pytest.approx(row, rel=1e-8)
