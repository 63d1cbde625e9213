"""The assembled rotor: structure, mass properties, attachments between nodes, free modes,
gyroscopic splitting.
"""

from dataclasses import replace

import numpy as np
import pytest
import scipy.linalg as sla
from hypothesis import assume, given, settings, strategies as st

from ambrose import load_machine
from ambrose.core.checks import InvalidInput
from ambrose.machine.attachment import NEAR
from ambrose.machine.description import BEAM_THEORIES, Amplifier
from ambrose.machine.machine import Machine
from ambrose.machine.part import BendingMode, Disc, Material, ShaftSection
from ambrose.model.effects.rotor import (
    _strains,
    displacement_row,
    finite_element_rotor,
    free_bending_frequencies,
    free_modes,
    mass_properties,
    plane_rows,
)
from physical_numbers import physical

STEEL = Material(7850.0, 2.1e11, 0.3)


def machine(sections, discs=(), theory="rayleigh", material=STEEL, refine=1):
    """sections: (length, outer, inner, mass diameter, elements)."""
    shaft, z = [], 0.0
    for length, outer, inner, heavy, elements in sections:
        shaft.append(ShaftSection(z, length, outer, inner, heavy, elements * refine, material))
        z += length
    return Machine(
        "test", tuple(shaft), (), (), Amplifier("none"), discs=tuple(discs), beam_theory=theory
    )


STEPPED = [
    (0.15, 0.05, 0.0, None, 3),
    (0.25, 0.09, 0.03, 0.13, 4),
    (0.30, 0.07, 0.02, None, 4),
    (0.10, 0.04, 0.0, None, 2),
]
# both between nodes
DISCS = [Disc("wheel", 0.07, 5.0, 0.03, 0.018), Disc("thrust", 0.55, 3.0, 0.02, 0.011)]


def stepped(theory="rayleigh", refine=1, discs=DISCS):
    return finite_element_rotor(machine(STEPPED, discs, theory, refine=refine))


def in_rotor(x=0.0, y=0.0, alpha=0.0, beta=0.0, n=1):
    """Coordinates (4N,) from nodal values."""
    return (
        np.stack(np.broadcast_arrays(*(np.broadcast_to(a, n) for a in (x, y, alpha, beta))), axis=1)
        .ravel()
        .astype(float)
    )


@pytest.mark.parametrize("theory", BEAM_THEORIES)
def test_matrices_have_their_structure(theory):
    rotor = stepped(theory)
    M = rotor.mass
    G = rotor.gyroscopic
    K = rotor.stiffness
    n = 4 * rotor.n_nodes
    assert rotor.n_nodes == 3 + 4 + 4 + 2 + 1 + 1  # a disc stands inside an element
    assert M.shape == G.shape == K.shape == (n, n)
    for symmetric in (M, K, rotor.plane_mass, rotor.plane_gyroscopic, rotor.plane_stiffness):
        assert np.array_equal(symmetric, symmetric.T)
    assert np.array_equal(G, -G.T)
    assert np.abs(G).max() > 0
    scale = 1 / np.sqrt(np.diag(M))
    assert np.linalg.eigvalsh(M * scale * scale[:, None]).min() > 1e-4
    stiff = np.linalg.eigvalsh(K * scale * scale[:, None])
    assert np.abs(stiff[:4]).max() < 1e-12 * stiff[-1]
    assert stiff[4] > 1e-8 * stiff[-1]


@pytest.mark.parametrize("theory", BEAM_THEORIES)
def test_null_space_of_stiffness_is_the_rigid_motions(theory):
    rotor = stepped(theory)
    z = rotor.positions
    n = len(z)
    rigid = np.stack(
        [
            in_rotor(x=1, n=n),
            in_rotor(y=1, n=n),
            in_rotor(x=z, beta=1.0, n=n),
            in_rotor(y=z, alpha=-1.0, n=n),
        ],
        axis=1,
    )
    assert np.abs(rotor.stiffness @ rigid).max() < 1e-15 * np.abs(rotor.stiffness).max()
    assert (
        np.linalg.matrix_rank(
            rotor.stiffness, hermitian=True, tol=1e-12 * np.abs(rotor.stiffness).max()
        )
        == 4 * n - 4
    )


@pytest.mark.parametrize("theory", BEAM_THEORIES)
def test_planes_are_the_parts_of_the_whole(theory):
    rotor = stepped(theory)
    x, y = np.zeros((2, 2 * rotor.n_nodes, 4 * rotor.n_nodes))
    nodes = np.arange(rotor.n_nodes)
    x[2 * nodes, 4 * nodes] = x[2 * nodes + 1, 4 * nodes + 3] = 1.0  # w = x, theta = beta
    # w = y, theta = -alpha
    y[2 * nodes, 4 * nodes + 1], y[2 * nodes + 1, 4 * nodes + 2] = 1.0, -1.0
    for whole, plane in ((rotor.mass, rotor.plane_mass), (rotor.stiffness, rotor.plane_stiffness)):
        assert np.array_equal(x @ whole @ x.T, plane)
        assert np.array_equal(y @ whole @ y.T, plane)
        assert not (x @ whole @ y.T).any()
    assert np.array_equal(x @ rotor.gyroscopic @ y.T, rotor.plane_gyroscopic)
    assert not (x @ rotor.gyroscopic @ x.T).any()


def test_gyroscopic_moment_has_the_documented_sign():
    """A disc spinning from x to y and tilting about x (alpha' > 0): the moment -Omega G q' about y
    is +I_p Omega alpha'.
    """
    light = Material(1e-9, 2.1e11, 0.3)
    rotor = finite_element_rotor(
        machine([(1.0, 0.05, 0.0, None, 2)], [Disc("d", 0.5, 1.0, 0.4, 0.2)], material=light)
    )
    alpha, beta = 4 + 2, 4 + 3
    assert rotor.gyroscopic[alpha, beta] == pytest.approx(0.4, rel=1e-6)
    assert rotor.gyroscopic[beta, alpha] == pytest.approx(-0.4, rel=1e-6)


@pytest.mark.parametrize("theory", ["rayleigh", "timoshenko"])
def test_mass_properties_of_a_hollow_cylinder(theory):
    length = 0.7
    outer = 0.1
    inner = 0.04
    rotor = finite_element_rotor(machine([(length, outer, inner, None, 5)], theory=theory))
    mass = 7850.0 * np.pi / 4 * (outer**2 - inner**2) * length
    found = mass_properties(rotor)
    assert found.mass == pytest.approx(mass)
    assert found.centre == pytest.approx(length / 2)
    assert found.polar_inertia == pytest.approx(mass * (outer**2 + inner**2) / 8)
    assert found.diametral_inertia == pytest.approx(
        mass * ((outer**2 + inner**2) / 16 + length**2 / 12)
    )


def test_bernoulli_euler_leaves_out_rotary_inertia_only():
    euler, rayleigh = (
        mass_properties(stepped("bernoulli-euler")),
        mass_properties(stepped("rayleigh")),
    )
    assert euler.mass == pytest.approx(rayleigh.mass, rel=1e-14)
    assert euler.polar_inertia == pytest.approx(rayleigh.polar_inertia, rel=1e-14)
    discs = sum(disc.polar_inertia for disc in DISCS)
    difference = rayleigh.diametral_inertia - euler.diametral_inertia
    assert difference == pytest.approx((rayleigh.polar_inertia - discs) / 2)


def test_mass_properties_of_the_stepped_rotor_by_parts():
    parts, z = [], 0.0
    for length, outer, inner, heavy, _ in STEPPED:
        d = heavy or outer
        m = 7850.0 * np.pi / 4 * (d**2 - inner**2) * length
        parts.append(
            (
                m,
                z + length / 2,
                m * ((d**2 + inner**2) / 16 + length**2 / 12),
                m * (d**2 + inner**2) / 8,
            )
        )
        z += length
    parts += [(d.mass, d.position, d.diametral_inertia, d.polar_inertia) for d in DISCS]
    m, c, diametral, polar = np.array(parts).T
    centre = m @ c / m.sum()
    found = mass_properties(stepped())
    assert found.mass == pytest.approx(m.sum())
    assert found.centre == pytest.approx(centre)
    assert found.polar_inertia == pytest.approx(polar.sum())
    assert found.diametral_inertia == pytest.approx(diametral.sum() + m @ (c - centre) ** 2)


@st.composite
def rotors(draw):
    sections = []
    for _ in range(draw(st.integers(1, 4))):
        outer = draw(st.floats(0.02, 0.2))
        inner = outer * draw(physical(0.0, 0.9))
        heavy = draw(st.sampled_from([None, 1.2 * outer]))
        sections.append((draw(st.floats(0.05, 0.5)), outer, inner, heavy, draw(st.integers(1, 4))))
    length = sum(s[0] for s in sections)
    discs = []
    for i in range(draw(st.integers(0, 3))):
        diametral = draw(physical(0.0, 0.1))
        polar = diametral * draw(physical(0.0, 2.0))
        discs.append(
            Disc(
                f"d{i}",
                length * draw(physical(0.0, 1.0)),
                draw(st.floats(0.1, 20.0)),
                polar,
                diametral,
            )
        )
    # as far from a node as makes it one of its own: rounding decides, otherwise for another size
    nodes = np.cumsum([0.0, *(s[0] / s[4] for s in sections for _ in range(s[4]))])
    room = [np.abs(nodes - disc.position).min() / length for disc in discs]
    assume(all(abs(each - NEAR) > 1e-9 for each in room))
    return sections, discs, draw(st.sampled_from(BEAM_THEORIES))


@settings(max_examples=40, deadline=None)
@given(rotors(), st.integers(2, 3))
def test_refinement_keeps_the_rigid_body(description, refine):
    sections, discs, theory = description
    coarse = mass_properties(finite_element_rotor(machine(sections, discs, theory)))
    fine = mass_properties(finite_element_rotor(machine(sections, discs, theory, refine=refine)))
    for name in ("mass", "centre", "diametral_inertia", "polar_inertia"):
        assert getattr(fine, name) == pytest.approx(getattr(coarse, name), rel=1e-9, abs=1e-12)


@settings(max_examples=40, deadline=None)
@given(rotors())
def test_a_mirrored_rotor_has_the_same_frequencies(description):
    sections, discs, theory = description
    one, other = mirrored_frequencies(sections, discs, theory)
    assert other == pytest.approx(one, rel=1e-6)


def mirrored_frequencies(sections, discs, theory):
    """The lowest two of a rotor and of its mirror image."""
    length = sum(s[0] for s in sections)
    mirrored_discs = [
        Disc(d.name, max(length - d.position, 0.0), d.mass, d.polar_inertia, d.diametral_inertia)
        for d in discs
    ]
    count = min(2, 2 * sum(s[4] for s in sections))
    return (
        free_bending_frequencies(finite_element_rotor(machine(*rotor, theory)), count)
        for rotor in ((sections, discs), (sections[::-1], mirrored_discs))
    )


@pytest.mark.parametrize("theory", BEAM_THEORIES)
@pytest.mark.parametrize("piece", [1.1e-4, 3e-4, 1e-3])
@pytest.mark.parametrize("inertia", [0.0, 0.02])
def test_a_disc_close_to_a_node_costs_no_accuracy(theory, piece, inertia):
    """A short piece is (L/l)^4 times as high in w^2 as the rotor: eigenvalues lost up to all digits
    of the first frequency to it (38 %), by other amounts on other processors.

    What remains is eps times the highest frequency, which is 1e7 to 1e9 times the first.
    """
    sections = [(0.1, 0.024, 0.0, None, 1), (0.5, 0.19, 0.0, None, 2), (0.4, 0.06, 0.0, None, 3)]
    places = (piece, 0.1 - piece, 0.6 + piece, 1.0)
    discs = [Disc(f"d{i}", z, 1.0 + i, inertia, inertia) for i, z in enumerate(places)]
    one, other = mirrored_frequencies(sections, discs, theory)
    assert other == pytest.approx(one, rel=2e-8)

    # the same shaft with the disc on the node itself: the place counts with about its distance
    near = [replace(d, position=round(d.position, 1)) for d in discs]
    on_node, _ = mirrored_frequencies(sections, near, theory)
    assert one == pytest.approx(on_node, rel=30 * piece)


def test_two_discs_closer_than_a_piece_share_the_outer_ones_node():
    """In a rotor and in its mirror image: the inner one is read by the element's shape."""
    sections = [(0.3, 0.04, 0.0, None, 2), (0.7, 0.05, 0.0, None, 3)]
    discs = [Disc("a", 0.1, 3.0, 0.0, 0.0), Disc("b", 0.10008, 1.0, 0.0, 0.0)]
    one, other = mirrored_frequencies(sections, discs, "rayleigh")
    assert other == pytest.approx(one, rel=1e-9)


def test_measured_frequencies_are_the_corrected_modes(theory="rayleigh"):
    """Exactly, beside a piece whose rounding hid them, and the others keep theirs."""
    sections = [(0.1, 0.024, 0.0, None, 1), (0.5, 0.19, 0.0, None, 2), (0.4, 0.06, 0.0, None, 3)]
    bare = machine(sections, [Disc("d", 0.6002, 2.0, 0.0, 0.0)], theory)
    own = free_bending_frequencies(finite_element_rotor(bare), 4)
    wanted = (1.1 * own[0], 0.8 * own[1])
    modes = tuple(BendingMode(i + 1, frequency) for i, frequency in enumerate(wanted))
    found = free_bending_frequencies(finite_element_rotor(replace(bare, bending_modes=modes)), 4)
    assert found == pytest.approx([*wanted, *own[2:]], rel=1e-8)


@settings(max_examples=25, deadline=None)
@given(rotors(), st.floats(0.1, 10.0))
def test_frequencies_scale_with_size(description, scale):
    """Every length times s, disc masses times s^3, inertias times s^5: frequencies divide by s."""
    sections, discs, theory = description
    count = min(2, 2 * sum(s[4] for s in sections))
    big_sections = [
        (s * length, s * outer, s * inner, heavy and s * heavy, n)
        for s in [scale]
        for length, outer, inner, heavy, n in sections
    ]
    big_discs = [
        Disc(
            d.name,
            scale * d.position,
            scale**3 * d.mass,
            scale**5 * d.polar_inertia,
            scale**5 * d.diametral_inertia,
        )
        for d in discs
    ]
    one = free_bending_frequencies(finite_element_rotor(machine(sections, discs, theory)), count)
    other = free_bending_frequencies(
        finite_element_rotor(machine(big_sections, big_discs, theory)), count
    )
    assert other * scale == pytest.approx(one, rel=1e-6)


@pytest.mark.parametrize("theory", BEAM_THEORIES)
def test_splitting_a_section_changes_nothing(theory):
    whole = finite_element_rotor(machine([(0.6, 0.05, 0.01, None, 6)], DISCS, theory))
    parts = finite_element_rotor(
        machine([(0.2, 0.05, 0.01, None, 2), (0.4, 0.05, 0.01, None, 4)], DISCS, theory)
    )
    for name in ("positions", "mass", "gyroscopic", "stiffness"):
        a, b = getattr(whole, name), getattr(parts, name)
        assert a == pytest.approx(b, rel=1e-9, abs=1e-12 * np.abs(b).max())


@pytest.mark.parametrize("theory", BEAM_THEORIES)
def test_displacement_row_is_exact_for_cubic_fields(theory):
    """A cubic w, with theta = w' + (phi h^2/12) w''' (constant shear strain), is in the elements'
    space of a uniform shaft.
    """
    rotor = finite_element_rotor(machine([(0.9, 0.1, 0.02, None, 7)], theory=theory))
    z = rotor.positions
    lag = rotor.shear[0] * (z[1] - z[0]) ** 2 / 12
    cx, cy = (
        np.polynomial.Polynomial([0.3, -1.0, 2.0, 5.0]),
        np.polynomial.Polynomial([-0.2, 0.7, -3.0, 4.0]),
    )
    slope = [c.deriv()(z) + lag * c.deriv(3)(z) for c in (cx, cy)]
    q = in_rotor(cx(z), cy(z), -slope[1], slope[0], n=len(z))
    for at in (0.0, 0.0123, 0.4, 0.637, 0.9):
        for angle in (0.0, np.pi / 4, 2.0, -np.pi / 2):
            expected = np.cos(angle) * cx(at) + np.sin(angle) * cy(at)
            assert displacement_row(rotor, at, angle) @ q == pytest.approx(expected, abs=1e-13)
    theta = plane_rows(rotor, [0.637])[1] @ np.stack([cx(z), slope[0]], axis=1).ravel()
    assert theta[0] == pytest.approx(cx.deriv()(0.637) + lag * cx.deriv(3)(0.637), abs=1e-12)


def test_displacement_row_at_a_node_reads_the_node():
    rotor = stepped()
    for node in (0, 3, 7, rotor.n_nodes - 1):
        row = displacement_row(rotor, rotor.positions[node], np.pi / 2)
        expected = np.zeros(4 * rotor.n_nodes)
        expected[4 * node + 1] = 1.0
        assert row == pytest.approx(expected, abs=1e-12)


@pytest.mark.parametrize("theory", BEAM_THEORIES)
def test_static_deflection_of_a_stepped_cantilever(theory):
    """Tip force on a clamped, stepped, hollow shaft: exact at and between nodes, whatever the
    mesh.
    """
    l1 = 0.4
    l2 = 0.5
    force = 1000.0
    d1 = 0.08
    d2 = 0.05
    bore = 0.02
    rotor = finite_element_rotor(
        machine([(l1, d1, bore, 0.1, 3), (l2, d2, bore, None, 2)], theory=theory)
    )
    free = slice(4, None)
    row = displacement_row(rotor, l1 + l2, 0.3)
    q = np.zeros(4 * rotor.n_nodes)
    q[free] = np.linalg.solve(rotor.stiffness[free, free], force * row[free])
    i1, i2 = (np.pi / 64 * (d**4 - bore**4) for d in (d1, d2))
    E, G = 2.1e11, 2.1e11 / 2.6

    def shear_flexibility(d):
        if theory != "timoshenko":
            return 0.0
        m2 = (bore / d) ** 2
        kappa = 6 * 1.3 * (1 + m2) ** 2 / ((7 + 1.8) * (1 + m2) ** 2 + 23.6 * m2)
        return 1 / (kappa * G * np.pi / 4 * (d**2 - bore**2))

    tip = force * (((l1 + l2) ** 3 - l2**3) / (3 * E * i1) + l2**3 / (3 * E * i2))
    tip += force * (l1 * shear_flexibility(d1) + l2 * shear_flexibility(d2))
    assert row @ q == pytest.approx(tip, rel=1e-9)
    at = 0.17  # inside an element of the first section: w = F a^2 (3 (l1 + l2) - a)/(6 E I) + shear
    inside = force * (at**2 * (3 * (l1 + l2) - at) / (6 * E * i1) + at * shear_flexibility(d1))
    assert displacement_row(rotor, at, 0.3) @ q == pytest.approx(inside, rel=1e-9)
    assert displacement_row(rotor, at, 0.3 + np.pi / 2) @ q == pytest.approx(0.0, abs=1e-12 * tip)


def receptance(rotor, springs, drive, read, frequency):
    """Plane receptance [m/N] at a frequency [rad/s] between two positions of a rotor on springs
    [(position, N/m)].
    """
    w, _ = plane_rows(rotor, [drive, read])
    K = rotor.plane_stiffness.copy()
    for position, stiffness in springs:
        s = plane_rows(rotor, [position])[0][0]
        K += stiffness * np.outer(s, s)
    return w[1] @ np.linalg.solve(K - frequency**2 * rotor.plane_mass, w[0])


def test_receptance_does_not_depend_on_where_the_nodes_are():
    """The same physical rotor on meshes whose nodes hit, or miss, the attachments."""
    springs = [(0.13, 2e6), (0.71, 2e6)]
    drive = 0.31
    read = 0.53
    hit = finite_element_rotor(machine([(0.9, 0.06, 0.0, None, 90)]))
    exact = receptance(hit, springs, drive, read, 1500.0)
    # no attachment lies on a node of these
    for elements, tolerance in ((8, 5e-4), (16, 5e-5), (32, 5e-6)):
        miss = finite_element_rotor(machine([(0.9, 0.06, 0.0, None, elements)]))
        assert np.abs(miss.positions[:, None] - [0.13, 0.71, 0.31, 0.53]).min() > 1e-4
        assert receptance(miss, springs, drive, read, 1500.0) == pytest.approx(exact, rel=tolerance)
    reciprocal = receptance(hit, springs, read, drive, 1500.0)
    assert reciprocal == pytest.approx(exact, rel=1e-9)


def test_attachments_off_the_shaft_are_refused():
    rotor = stepped()
    for position in (-0.01, 0.81, np.nan):
        with pytest.raises(InvalidInput, match="axial position"):
            displacement_row(rotor, position, 0.0)
    with pytest.raises(InvalidInput, match=r"0\.9 m, but must be on the shaft, from 0 to 0\.8 m"):
        plane_rows(rotor, [0.4, 0.9])


@pytest.mark.parametrize("theory", BEAM_THEORIES)
def test_free_modes_are_those_of_the_whole_matrices(theory):
    rotor = stepped(theory)
    modes = free_modes(rotor, 5)
    n_modes = 4 + 2 * 5
    assert modes.shapes.shape == (4 * rotor.n_nodes, n_modes)
    gram = modes.shapes.T @ rotor.mass @ modes.shapes
    assert gram == pytest.approx(np.eye(n_modes), abs=1e-12)
    stiffness = modes.shapes.T @ rotor.stiffness @ modes.shapes
    assert stiffness == pytest.approx(
        np.diag(modes.frequencies**2), abs=1e-6 * modes.frequencies[4] ** 2
    )
    values = sla.eigh(rotor.stiffness, rotor.mass, eigvals_only=True)
    assert modes.frequencies[4:] == pytest.approx(np.sqrt(values[4:n_modes]), rel=1e-7)
    assert not modes.frequencies[:4].any()
    assert np.array_equal(free_bending_frequencies(rotor, 5), modes.frequencies[4::2])
    assert np.all(modes.shapes[0, 4::2] > 0)  # the left end moves along x in the first of each pair
    assert np.all(modes.shapes[1, 5::2] > 0)
    assert not modes.shapes[1, 4::2].any()


def test_rigid_modes_are_exact():
    rotor = stepped()
    properties = mass_properties(rotor)
    shapes = free_modes(rotor, 0).shapes
    n, z = rotor.n_nodes, rotor.positions
    m, d = np.sqrt(properties.mass), np.sqrt(properties.diametral_inertia)
    lever = (z - properties.centre) / d
    expected = [
        in_rotor(x=1 / m, n=n),
        in_rotor(y=1 / m, n=n),
        in_rotor(x=lever, beta=1 / d, n=n),
        in_rotor(y=lever, alpha=-1 / d, n=n),
    ]
    assert np.array_equal(shapes, np.array(expected).T)


def test_many_nodes_keep_the_accuracy():
    """400 elements take the sparse route; closed form cosh(a) cos(a) = 1 to 1e-7."""
    rotor = finite_element_rotor(machine([(1.0, 0.05, 0.0, None, 400)], theory="bernoulli-euler"))
    a = np.array([4.730040744862704, 7.853204624095838, 10.995607838001671])
    exact = a**2 * np.sqrt(2.1e11 * 0.05**2 / 16 / 7850.0)
    modes = free_modes(rotor, 3)
    assert modes.frequencies[4::2] == pytest.approx(exact, rel=1e-7)
    assert modes.shapes.T @ rotor.mass @ modes.shapes == pytest.approx(np.eye(10), abs=1e-10)


def test_all_bending_modes_of_a_small_mesh_can_be_asked_for():
    rotor = finite_element_rotor(machine([(1.0, 0.05, 0.0, None, 2)]))
    modes = free_modes(rotor, 4)
    assert modes.shapes.T @ rotor.mass @ modes.shapes == pytest.approx(np.eye(12), abs=1e-10)
    for count in (0, 5, -1):
        with pytest.raises(InvalidInput, match="number of bending modes"):
            free_bending_frequencies(rotor, count)


@pytest.mark.parametrize("theory", BEAM_THEORIES)
def test_rigid_rotor_on_springs_splits_as_in_closed_form(theory):
    """A symmetric rigid rotor: translation sqrt(2 k/m) stays; tilting I_d w^2 - I_p Omega w - k
    l^2/2 = 0 splits.
    """
    stiff = Material(7850.0, 1e19, 0.3)
    length = 0.6
    k = 1e6
    speed = 2000.0
    rotor = finite_element_rotor(
        machine(
            [(length, 0.05, 0.0, None, 2)], [Disc("d", length / 2, 10.0, 0.2, 0.11)], theory, stiff
        )
    )
    body = mass_properties(rotor)
    K = rotor.stiffness.copy()
    for position in (0.0, length):
        for angle in (0.0, np.pi / 2):
            row = displacement_row(rotor, position, angle)
            K += k * np.outer(row, row)
    rigid = free_modes(rotor, 0).shapes
    M, G, K = (rigid.T @ X @ rigid for X in (rotor.mass, rotor.gyroscopic, K))
    values, vectors = np.linalg.eig(
        np.block(
            [
                [np.zeros((4, 4)), np.eye(4)],
                [-np.linalg.solve(M, K), -speed * np.linalg.solve(M, G)],
            ]
        )
    )
    assert np.abs(values.real).max() < 1e-6
    up = values.imag > 0
    frequencies, shapes = values[up].imag, rigid @ vectors[:4, up]
    order = np.argsort(frequencies)
    frequencies, shapes = frequencies[order], shapes[:, order]
    Id = body.diametral_inertia
    Ip = body.polar_inertia
    c = k * length**2 / 2
    root = np.sqrt((Ip * speed) ** 2 + 4 * Id * c)
    backward, forward = (-Ip * speed + root) / (2 * Id), (Ip * speed + root) / (2 * Id)
    bounce = np.sqrt(2 * k / body.mass)
    assert np.sort([backward, forward, bounce, bounce]) == pytest.approx(frequencies, rel=1e-6)
    # forward: y follows x by a quarter turn
    for frequency, direction in ((backward, 1j), (forward, -1j)):
        column = np.argmin(np.abs(frequencies - frequency))
        assert shapes[1, column] / shapes[0, column] == pytest.approx(direction, abs=1e-6)


def test_whirl_of_the_plane_equals_the_whole():
    """z = w_x + j w_y: M z'' - j Omega G z' + K z = 0 has the eigenvalues of the rotor in x and
    y.
    """
    rotor, speed = stepped("timoshenko"), 1500.0
    basis = free_modes(rotor, 4)
    V, n = basis.shapes, basis.shapes.shape[1]
    G = V.T @ rotor.gyroscopic @ V
    Kd = np.diag(basis.frequencies**2 + 1e4)
    whole = np.linalg.eigvals(np.block([[np.zeros((n, n)), np.eye(n)], [-Kd, -speed * G]]))
    U = V[:, 0::2]
    plane = np.zeros((2 * rotor.n_nodes, n // 2))
    plane[0::2], plane[1::2] = U[0::4], U[3::4]
    Gp, k = plane.T @ rotor.plane_gyroscopic @ plane, n // 2
    half = np.linalg.eigvals(
        np.block([[np.zeros((k, k)), np.eye(k)], [-Kd[::2, ::2], 1j * speed * Gp]])
    )
    both = np.concatenate([half, half.conj()])
    assert np.sort(both.imag) == pytest.approx(np.sort(whole.imag), rel=1e-6)


@pytest.mark.parametrize("theory", ["bernoulli-euler", "rayleigh", "timoshenko"])
def test_strains_of_the_elements_have_the_energy_of_the_stiffness(theory):
    """Of any motion, cones and discs included: what differs is rounding alone."""
    machine = replace(load_machine("seal-rig"), beam_theory=theory)
    cone = replace(machine.shaft[1], end_outer_diameter=0.7 * machine.shaft[1].outer_diameter)
    rotor = finite_element_rotor(
        replace(machine, shaft=(machine.shaft[0], cone, *machine.shaft[2:]))
    )
    motion = np.random.default_rng(1).standard_normal((2 * rotor.n_nodes, 3))
    strains = _strains(rotor, motion)
    assert strains.T @ strains == pytest.approx(
        motion.T @ rotor.plane_stiffness @ motion, rel=1e-12
    )
