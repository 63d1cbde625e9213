"""Beam elements against printed element matrices and closed-form beam frequencies, with the order
of convergence.

Without shear the order is 4. Nelson's Timoshenko element holds the shear strain constant, so that
its error, the shear part of the strain energy times (k h)^2/12 to first order, falls with order 2.
"""

import numpy as np
import pytest
import scipy.linalg as sla

from ambrose.core.checks import InvalidInput
from ambrose.machine.description import BEAM_THEORIES, Amplifier
from ambrose.machine.machine import Machine
from ambrose.machine.part import ShaftSection
from ambrose.model.effects.beam import (
    area,
    beam_element,
    conical_element,
    second_moment,
    shape,
    shear_coefficient,
)
from ambrose.model.effects.rotor import finite_element_rotor

RHO = 7850.0
E = 2.1e11
NU = 0.3
L, D = 1.0, 0.08  # a stubby beam: shear and rotary inertia matter
EI, KAG = E * second_moment(D, 0.0), shear_coefficient(NU) * E / (2 * (1 + NU)) * area(D, 0.0)
RHO_A, RHO_I = RHO * area(D, 0.0), RHO * second_moment(D, 0.0)


def element(length=0.2, outer=D, inner=0.0, theory="timoshenko", **changes):
    return beam_element(
        length,
        outer,
        inner,
        density=RHO,
        youngs_modulus=E,
        poisson_ratio=NU,
        theory=theory,
        **changes,
    )


def chain(n, theory, what):
    """A uniform beam of n elements in one plane: the assembled matrix, summed entry by entry."""
    matrix = getattr(element(L / n, theory=theory), what)
    whole = np.zeros((2 * n + 2, 2 * n + 2))
    for e in range(n):
        whole[2 * e : 2 * e + 4, 2 * e : 2 * e + 4] += matrix
    return whole


def pinned(matrix):
    keep = np.delete(np.arange(len(matrix)), [0, len(matrix) - 2])
    return matrix[np.ix_(keep, keep)]


def pinned_frequencies(theory, speed=0.0, modes=(1, 2, 3)):
    """Whirl frequencies [rad/s] of a pinned, spinning beam: w = sin(k x), theta = cos(k x) make the
    equations algebraic.

    Huang (1961) for the Timoshenko beam at standstill; forward whirl with speed > 0, backward with
    speed < 0.
    """
    result = []
    for mode in modes:
        k = mode * np.pi / L
        rotary = 0.0 if theory == "bernoulli-euler" else RHO_I
        mass = np.diag([RHO_A, rotary])
        gyroscopic = np.diag([0.0, 2 * RHO_I])
        if theory == "timoshenko":
            stiffness = np.array([[KAG * k**2, -KAG * k], [-KAG * k, EI * k**2 + KAG]])
        else:  # theta = k w: one coordinate
            T = np.array([[1.0], [k]])
            mass, gyroscopic = T.T @ mass @ T, T.T @ gyroscopic @ T
            stiffness = np.array([[EI * k**4]])
        n = len(mass)
        # w^2 M - w Omega G - K = 0
        whirl = sla.eigvals(
            np.block([[np.zeros((n, n)), np.eye(n)], [stiffness, speed * gyroscopic]]),
            sla.block_diag(np.eye(n), mass),
        )
        result.append(np.min(whirl.real[whirl.real > 0]))
    return np.array(result)


def whirl(M, G, K, speed, count):
    """The lowest positive whirl frequencies of w^2 M - w Omega G - K, through 1/w for accuracy."""
    n = len(M)
    KM, KG = np.linalg.solve(K, M), np.linalg.solve(K, G)
    inverse = np.linalg.eigvals(np.block([[-speed * KG, KM], [np.eye(n), np.zeros((n, n))]]))
    return np.sort(1 / inverse.real[inverse.real > 0])[:count]


def free_free_frequencies(count=3):
    """Bernoulli-Euler: cosh(a) cos(a) = 1."""
    a = np.array([4.730040744862704, 7.853204624095838, 10.995607838001671])[:count]
    return a**2 * np.sqrt(EI / (RHO_A * L**4))


def order_of(errors):
    """Observed order from the last two entries, each mesh twice as fine as the one before."""
    return np.log2(errors[-2] / errors[-1])


ORDER = {"bernoulli-euler": 4, "rayleigh": 4, "timoshenko": 2}


@pytest.mark.parametrize("theory", BEAM_THEORIES)
def test_pinned_beam_converges_to_closed_form(theory):
    exact = pinned_frequencies(theory)
    errors = []
    for n in (4, 8, 16, 32):
        K, M = pinned(chain(n, theory, "stiffness")), pinned(chain(n, theory, "mass"))
        frequencies = np.sqrt(sla.eigh(K, M, eigvals_only=True)[:3])
        errors.append(np.abs(frequencies / exact - 1))
    assert np.all(np.abs(order_of(errors) - ORDER[theory]) < 0.1)
    # The errors' constants as well; the shear part of the strain energy is E I k^2/(kappa G A + E I
    # k^2).
    k = np.arange(1, 4) * np.pi / L
    kh = k * L / 32
    predicted = (
        EI * k**2 / (KAG + EI * k**2) * kh**2 / 24 if theory == "timoshenko" else kh**4 / 1440
    )
    assert errors[-1] == pytest.approx(predicted, rel=0.1)


@pytest.mark.parametrize("speed", [3000.0, -3000.0])
@pytest.mark.parametrize("theory", BEAM_THEORIES)
def test_pinned_spinning_beam_converges_to_closed_form(theory, speed):
    exact = pinned_frequencies(theory, speed)
    errors = []
    for n in (4, 8, 16, 32):
        M, G, K = (pinned(chain(n, theory, what)) for what in ("mass", "gyroscopic", "stiffness"))
        errors.append(np.abs(whirl(M, G, K, speed, 3) / exact - 1))
    assert np.all(np.abs(order_of(errors) - ORDER[theory]) < 0.1)
    standstill = pinned_frequencies(theory)
    assert np.all((exact > standstill) == (speed > 0))  # forward whirl is stiffened
    assert np.abs(exact / standstill - 1).min() > 1e-3  # the effect is far above the error


def test_free_free_beam_converges_to_closed_form_with_order_four():
    exact = free_free_frequencies()
    errors = []
    for n in (4, 8, 16, 32):
        K, M = chain(n, "bernoulli-euler", "stiffness"), chain(n, "bernoulli-euler", "mass")
        errors.append(np.abs(np.sqrt(sla.eigh(K, M, eigvals_only=True)[2:5]) / exact - 1))
    assert np.all(np.abs(order_of(errors) - 4) < 0.1)


def test_theories_differ_in_the_known_order():
    euler, rayleigh, timoshenko = (pinned_frequencies(theory) for theory in BEAM_THEORIES)
    assert np.all(euler > rayleigh)
    assert np.all(rayleigh > timoshenko)
    k = np.arange(1, 4) * np.pi / L
    assert rayleigh == pytest.approx(np.sqrt(EI * k**4 / (RHO_A + RHO_I * k**2)))


def test_matrices_are_the_printed_ones():
    """Bernoulli-Euler and Rayleigh (Nelson & McVaugh 1976, appendix), in [w1, theta1, w2,
    theta2].
    """
    h = 0.2
    e = element(h, theory="rayleigh")
    translational = [
        [156, 22 * h, 54, -13 * h],
        [0, 4 * h**2, 13 * h, -3 * h**2],
        [0, 0, 156, -22 * h],
        [0, 0, 0, 4 * h**2],
    ]
    rotary = [
        [36, 3 * h, -36, 3 * h],
        [0, 4 * h**2, -3 * h, -(h**2)],
        [0, 0, 36, -3 * h],
        [0, 0, 0, 4 * h**2],
    ]
    stiffness = [
        [12, 6 * h, -12, 6 * h],
        [0, 4 * h**2, -6 * h, 2 * h**2],
        [0, 0, 12, -6 * h],
        [0, 0, 0, 4 * h**2],
    ]
    for matrix, printed, factor in (
        (e.translational, translational, RHO_A * h / 420),
        (e.rotary, rotary, RHO_I / (30 * h)),
        (e.gyroscopic, rotary, 2 * RHO_I / (30 * h)),
        (e.stiffness, stiffness, EI / h**3),
    ):
        upper = np.triu(printed) * factor
        assert matrix == pytest.approx(upper + np.triu(upper, 1).T, rel=1e-12)
    euler = element(h, theory="bernoulli-euler")
    assert np.array_equal(euler.mass, e.translational)
    assert np.array_equal(euler.gyroscopic, e.gyroscopic)


def test_timoshenko_matrices_are_the_printed_ones():
    """Polynomials in phi of Nelson (1980), table 1."""
    h = 0.2
    e = element(h)
    p = float(e.shear)
    assert p == pytest.approx(12 * EI / (KAG * h**2))
    t1, t2 = 13 / 35 + 7 * p / 10 + p**2 / 3, (11 / 210 + 11 * p / 120 + p**2 / 24) * h
    t3, t4 = 9 / 70 + 3 * p / 10 + p**2 / 6, (13 / 420 + 3 * p / 40 + p**2 / 24) * h
    t5, t6 = (1 / 105 + p / 60 + p**2 / 120) * h**2, (1 / 140 + p / 60 + p**2 / 120) * h**2
    translational = np.array(
        [[t1, t2, t3, -t4], [t2, t5, t4, -t6], [t3, t4, t1, -t2], [-t4, -t6, -t2, t5]]
    )
    r1, r2 = 6 / 5, (1 / 10 - p / 2) * h
    r5, r6 = (2 / 15 + p / 6 + p**2 / 3) * h**2, (-1 / 30 - p / 6 + p**2 / 6) * h**2
    rotary = np.array(
        [[r1, r2, -r1, r2], [r2, r5, -r2, r6], [-r1, -r2, r1, -r2], [r2, r6, -r2, r5]]
    )
    k5, k6 = (4 + p) * h**2, (2 - p) * h**2
    stiffness = np.array(
        [
            [12, 6 * h, -12, 6 * h],
            [6 * h, k5, -6 * h, k6],
            [-12, -6 * h, 12, -6 * h],
            [6 * h, k6, -6 * h, k5],
        ]
    )
    assert e.translational == pytest.approx(translational * RHO_A * h / (1 + p) ** 2, rel=1e-12)
    assert e.rotary == pytest.approx(rotary * RHO_I / h / (1 + p) ** 2, rel=1e-12)
    assert e.gyroscopic == pytest.approx(2 * e.rotary, rel=1e-14)
    assert e.stiffness == pytest.approx(stiffness * EI / h**3 / (1 + p), rel=1e-12)


@pytest.mark.parametrize("phi", [0.0, 0.7])
def test_shape_functions_satisfy_the_static_beam(phi):
    h = 0.3
    xi = np.linspace(0, 1, 11)
    w, theta = shape(xi, h, phi)
    ends = np.stack([w[0], theta[0], w[-1], theta[-1]])
    assert ends == pytest.approx(np.eye(4), abs=1e-14)
    # Cubic in xi: four points give the exact derivatives.
    polynomial = np.polynomial.polynomial
    slope = (
        np.stack(
            [polynomial.polyval(xi, polynomial.polyder(c)) for c in polynomial.polyfit(xi, w, 3).T],
            axis=1,
        )
        / h
    )
    shear_strain = slope - theta
    assert shear_strain == pytest.approx(
        np.broadcast_to(shear_strain[0], shear_strain.shape), abs=1e-10
    )
    # Equilibrium: kappa G A (w' - theta) = -E I theta'' with phi = 12 E I/(kappa G A h^2)
    curvature_slope = np.array([2 * polynomial.polyfit(xi, theta, 2)[2]]) / h**2
    assert shear_strain[0] == pytest.approx(-phi * h**2 / 12 * curvature_slope[0], abs=1e-10)


def test_elements_of_a_batch_equal_single_elements():
    outer, length = np.array([0.05, 0.08]), np.array([0.1, 0.2])
    batch = element(length, outer, 0.02)
    for i in range(2):
        single = element(length[i], outer[i], 0.02)
        for name in ("mass", "gyroscopic", "stiffness", "shear"):
            assert np.array_equal(getattr(batch, name)[i], getattr(single, name))


def test_hollow_section_is_the_difference_of_two_solid_ones():
    outer, inner = 0.08, 0.05
    for theory in ("bernoulli-euler", "rayleigh"):
        tube = element(outer=outer, inner=inner, theory=theory)
        solid = element(theory=theory)
        core = element(outer=inner, theory=theory)
        for name in ("mass", "gyroscopic", "stiffness"):
            expected = getattr(solid, name) - getattr(core, name)
            assert getattr(tube, name) == pytest.approx(expected, rel=1e-12)


def test_shrunk_on_mass_adds_inertia_but_no_stiffness():
    plain = element()
    heavy = element(mass_diameter=0.12)
    thick = element(outer=0.12)
    assert np.array_equal(heavy.stiffness, plain.stiffness)
    assert np.array_equal(heavy.shear, plain.shear)
    rigid = np.array([1.0, 0.0, 1.0, 0.0])
    assert rigid @ heavy.mass @ rigid == pytest.approx(rigid @ thick.mass @ rigid)
    assert heavy.gyroscopic != pytest.approx(plain.gyroscopic, rel=0.1)


def test_shear_coefficient_of_cowper():
    assert shear_coefficient(0.3) == pytest.approx(6 * 1.3 / (7 + 1.8))  # solid: 0.886
    assert shear_coefficient(0.3, 1.0) == pytest.approx(2 * 1.3 / (4 + 0.9))  # thin tube: 0.531
    assert shear_coefficient(0.0) == pytest.approx(6 / 7)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"length": 0.0}, "element length.*positive"),
        ({"inner": 0.08}, "bore"),
        ({"inner": -0.01}, "bore"),
        ({"mass_diameter": 0.01, "inner": 0.02}, "mass diameter"),
        ({"outer": np.nan}, "outer diameter"),
        ({"theory": "euler"}, "bernoulli-euler, rayleigh, timoshenko"),
    ],
)
def test_impossible_sections_are_refused(arguments, message):
    with pytest.raises(InvalidInput, match=message):
        element(**arguments)


@pytest.mark.parametrize(
    ("name", "value"), [("density", 0.0), ("youngs_modulus", -1.0), ("poisson_ratio", 0.6)]
)
def test_impossible_materials_are_refused(name, value):
    material = {"density": RHO, "youngs_modulus": E, "poisson_ratio": NU} | {name: value}
    with pytest.raises(
        InvalidInput,
        match=name.replace("_", ".*").replace("youngs", "Young's").replace("poisson", "Poisson's"),
    ):
        beam_element(0.1, 0.05, **material)


MATERIAL = {"density": RHO, "youngs_modulus": E, "poisson_ratio": NU}


def assembled(elements, what):
    """The matrix of elements in a row, in one plane."""
    whole = np.zeros((2 * len(elements) + 2, 2 * len(elements) + 2))
    for e, item in enumerate(elements):
        whole[2 * e : 2 * e + 4, 2 * e : 2 * e + 4] += getattr(item, what)
    return whole


def cone(n, left, right, length, theory, bore=(0.0, 0.0)):
    outer, inner = np.linspace(left, right, n + 1), np.linspace(*bore, n + 1)
    ends = [((outer[i], outer[i + 1]), (inner[i], inner[i + 1])) for i in range(n)]
    return [conical_element(length / n, do, di, do, theory=theory, **MATERIAL) for do, di in ends]


def staircase(n, left, right, length, theory, bore=(0.0, 0.0)):
    """n cylinders of the cone's mean diameters."""
    middle = (np.arange(n) + 0.5) / n
    outer, inner = left + (right - left) * middle, bore[0] + (bore[1] - bore[0]) * middle
    return [
        beam_element(length / n, do, di, theory=theory, **MATERIAL)
        for do, di in zip(outer, inner, strict=True)
    ]


def frequencies(elements, keep=slice(None)):
    M, K = assembled(elements, "mass")[keep, keep], assembled(elements, "stiffness")[keep, keep]
    return np.sqrt(np.abs(sla.eigh(K, M, eigvals_only=True)))


@pytest.mark.parametrize("theory", BEAM_THEORIES)
def test_a_cone_of_equal_diameters_is_a_cylinder(theory):
    heavy = conical_element(0.2, (D, D), (0.02, 0.02), (0.1, 0.1), theory=theory, **MATERIAL)
    other = element(0.2, D, 0.02, theory, mass_diameter=0.1)
    for what in ("translational", "rotary", "gyroscopic", "stiffness", "shear"):
        one, two = getattr(heavy, what), getattr(other, what)
        np.testing.assert_allclose(one, two, rtol=1e-11, atol=1e-12 * np.abs(two).max())


@pytest.mark.parametrize("theory", BEAM_THEORIES)
def test_one_cone_has_the_flexibility_of_many_steps(theory):
    """Static end loads: one conical element is exact; 64 steps come within 0.05 %, 8 steps miss by
    more than 0.3 %.
    """
    shape_of = {"left": 0.06, "right": 0.12, "length": 0.3, "theory": theory, "bore": (0.02, 0.05)}
    held = slice(2, None)

    def flexibility(elements):
        return np.linalg.inv(assembled(elements, "stiffness")[held, held])[-2:, -2:]

    exact = flexibility(cone(1, **shape_of))
    np.testing.assert_allclose(flexibility(cone(5, **shape_of)), exact, rtol=1e-9)
    np.testing.assert_allclose(flexibility(staircase(512, **shape_of)), exact, rtol=2e-5)
    np.testing.assert_allclose(flexibility(staircase(64, **shape_of)), exact, rtol=5e-4)
    assert np.abs(flexibility(staircase(8, **shape_of)) / exact - 1).max() > 3e-3


def test_a_few_cones_bend_like_hundreds_of_steps():
    """First free-free frequency without shear: four conical elements within 0.2 % of 256 steps,
    four steps miss by 4 %.
    """
    shape_of = {"left": 0.05, "right": 0.12, "length": 0.8, "theory": "rayleigh"}
    true = frequencies(staircase(256, **shape_of))[2]
    assert frequencies(cone(4, **shape_of))[2] == pytest.approx(true, rel=2e-3)
    assert abs(frequencies(staircase(4, **shape_of))[2] / true - 1) > 4e-2


def test_kirchhoff_s_cone():
    """A cantilever that runs out to a point, Kirchhoff (1879): w L^2 sqrt(rho A/(E I)) = 8.719,
    21.15, 38.45 at the root.

    The last hundredth is left out: what is that thin has no mass. The first two frequencies change
    by 3e-4, the third by 1e-3.
    """
    root = 0.08
    found = frequencies(cone(48, root, 0.01 * root, 0.99, "bernoulli-euler"), slice(2, None))[:3]
    scale = np.sqrt(RHO * area(root, 0.0) / (E * second_moment(root, 0.0)))
    assert found[:2] * scale == pytest.approx((8.719, 21.15), rel=5e-4)
    assert found[2] * scale == pytest.approx(38.45, rel=1.5e-3)


def test_a_cone_has_its_mass_and_no_stiffness_against_rigid_motion():
    item = conical_element(
        0.3, (0.06, 0.12), (0.02, 0.05), (0.06, 0.12), theory="timoshenko", **MATERIAL
    )
    shift, tilt = np.array([1.0, 0, 1, 0]), np.array([0.0, 1, 0.3, 1])
    volume = (
        np.pi / 12 * 0.3 * ((0.06**2 + 0.06 * 0.12 + 0.12**2) - (0.02**2 + 0.02 * 0.05 + 0.05**2))
    )
    assert shift @ item.translational @ shift == pytest.approx(RHO * volume, rel=1e-12)
    for motion in (shift, tilt):
        np.testing.assert_allclose(
            item.stiffness @ motion, 0, atol=1e-9 * np.abs(item.stiffness).max()
        )


@pytest.mark.parametrize(("right", "bore"), [(0.01, (0.0, 0.0)), (0.1, (0.02, 0.099))])
def test_steep_cones_and_thin_walls_are_integrated_to_rounding(right, bore):
    """The flexibility of one element is that of twenty in a row, which are ten times less steep."""
    one, many = (
        np.linalg.inv(assembled(cone(n, 0.1, right, 0.3, "timoshenko", bore), "stiffness")[2:, 2:])[
            -2:, -2:
        ]
        for n in (1, 20)
    )
    np.testing.assert_allclose(one, many, rtol=1e-8)


def test_a_section_of_two_diameters_is_such_a_chain():
    section = ShaftSection(
        0.0, 0.3, 0.06, 0.02, elements=3, end_outer_diameter=0.12, end_inner_diameter=0.05
    )
    machine = Machine("cone", (section,), (), (), Amplifier("none"), beam_theory="timoshenko")
    chain_of = cone(3, 0.06, 0.12, 0.3, "timoshenko", bore=(0.02, 0.05))
    rotor = finite_element_rotor(machine)
    for whole, what in ((rotor.plane_mass, "mass"), (rotor.plane_stiffness, "stiffness")):
        expected = assembled(chain_of, what)
        np.testing.assert_allclose(whole, expected, rtol=1e-9, atol=1e-12 * np.abs(expected).max())


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"end_outer_diameter": 0.0}, "end_outer_diameter is 0 m"),
        (
            {"end_outer_diameter": 0.01},
            "inner_diameter is 0.02 m, but must be below the outer diameter at the right end, "
            "0.01 m",
        ),
        (
            {"end_inner_diameter": 0.07},
            "end_inner_diameter is 0.07 m, but must be below the outer diameter at the right end",
        ),
        ({"end_inner_diameter": -0.01}, "end_inner_diameter is -0.01 m"),
    ],
)
def test_impossible_cones_are_refused(changes, message):
    with pytest.raises(InvalidInput, match=message):
        Machine("cone", (ShaftSection(0.0, 0.3, 0.06, 0.02, **changes),), (), (), Amplifier("none"))
