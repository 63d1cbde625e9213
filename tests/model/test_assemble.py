"""The assembled plant against hand calculations on the rigid seal rig."""

from dataclasses import replace

import numpy as np
import pytest

from ambrose import load_machine
from ambrose.core.frequency import frequency_response
from ambrose.core.statespace import poles, select
from ambrose.machine.description import Coupling, OperatingPoint
from ambrose.machine.file.toml import bundled_machines
from ambrose.model.assemble import assemble, attached_rotor
from ambrose.model.effects.rotor import finite_element_rotor
from coarse import coarse


@pytest.fixture(scope="module")
def machine():
    return load_machine("seal-rig")


@pytest.fixture(scope="module")
def plant(machine):
    return assemble(machine)


def test_full_size_and_names(machine, plant):
    every = assemble(machine, every_mode=True)
    # the thesis' 40 nodes, and five where parts stand inside an element
    assert every.rotor.n_states == 8 * (40 + 5)
    assert every.system.n_states == 368  # two amplifier states per axis
    # six places of ports and four gyroscopic moments
    assert plant.rotor.n_states == 4 * (2 + 24 + 10)
    assert plant.named("u") == ("u_A_zeta", "u_A_eta", "u_B_zeta", "u_B_eta")
    assert plant.bearing_named("q") == ("q_A_zeta", "q_A_eta", "q_B_zeta", "q_B_eta")
    assert set(plant.named("f")) <= set(plant.system.inputs)


def test_high_frequency_compliance_is_the_inverse_mass(machine, plant):
    """Far above the springs and far below bending, f -> q at a bearing is -1/(m_eff w^2) of the
    rigid rotor.

    1/m_eff = 1/m + l^2/J; J includes no rotary inertia of the sections in the Bernoulli-Euler
    model.
    """
    stiff = replace(machine, seals=(), tolerances=(), couplings=(), modal_damping=1e-6)
    stiff = replace(
        stiff, bearings=tuple(replace(b, negative_stiffness=(1.0, 1.0)) for b in machine.bearings)
    )
    w = 2 * np.pi * 20.0
    G = frequency_response(select(assemble(stiff).system, "f_A_zeta", "q_A_zeta"), [w]).values[
        0, 0, 0
    ]
    rotor = finite_element_rotor(machine)
    m = rotor.plane_mass
    x = rotor.positions - machine.bearings[0].position
    unit, tilt = np.ravel([np.ones_like(x), 0 * x], "F"), np.ravel([x, np.ones_like(x)], "F")
    generalized = np.array([[unit @ m @ unit, unit @ m @ tilt], [tilt @ m @ unit, tilt @ m @ tilt]])
    assert G.real == pytest.approx(-np.linalg.inv(generalized)[0, 0] / w**2, rel=5e-3)


def test_static_compliance_of_a_coupling(machine):
    """A coupling to ground at both bearings and no other spring: a unit force at A moves A by
    1/k.
    """
    held = replace(
        machine,
        seals=(),
        tolerances=(),
        couplings=(
            Coupling("left", 0.162, (1e5, 1e5), angle=0.7),
            Coupling("right", 0.698, (1e5, 1e5)),
        ),
        bearings=tuple(replace(b, negative_stiffness=(1e-6, 1e-6)) for b in machine.bearings),
    )
    G = frequency_response(
        select(assemble(held).system, ["f_A_zeta", "f_A_eta"], ["q_A_zeta", "q_A_eta"]), [1e-3]
    ).values[0]
    assert G.real == pytest.approx(np.eye(2) / 1e5, rel=1e-3, abs=1e-10)


def test_cross_coupling_drives_forward_whirl(plant):
    """k > 0: the unstable conjugate pair turns from x to y (y lags x by 90 degrees), DESIGN's
    sign.
    """
    A = plant.rotor.A
    values, vectors = np.linalg.eig(A)
    i = np.argmax(np.where(values.imag > 60, values.real, -np.inf))
    assert values[i].real > 0
    C = select(plant.rotor, outputs=["q_center_x", "q_center_y"]).C
    x, y = C @ vectors[:, i]
    assert y / x == pytest.approx(-1j, abs=0.05)  # e^{jwt}: x = cos, y = sin


def test_zero_pressure_removes_only_k():
    """P5: pressure changes k alone; at zero pressure the nominal K, C and c stay."""
    machine = load_machine("seal-rig-k-only")
    at_zero = assemble(machine, OperatingPoint(seal_pressure=0.0))
    without = replace(machine, seals=(replace(machine.seals[0], k=0.0),))
    assert poles(at_zero.rotor) == pytest.approx(poles(assemble(without).rotor), abs=1e-6)


def test_modal_damping_ratio(machine):
    """Every bending mode of the free rotor gets the stated ratio, rigid-body modes none."""
    free = replace(
        machine,
        seals=(),
        tolerances=(),
        couplings=(),
        bearings=tuple(replace(b, negative_stiffness=(1e-9, 1e-9)) for b in machine.bearings),
    )
    values = poles(assemble(free, every_mode=True).rotor)
    bending = values[np.abs(values) > 100.0]
    assert len(bending) == 8 * 44 - 8
    assert -bending.real / np.abs(bending) == pytest.approx(machine.modal_damping, rel=1e-6)


def test_bearing_angle_turns_the_signals_only(machine):
    """Turning bearings and coupling together turns the signals; singular values stay when the
    stiffness is isotropic.
    """
    isotropic = replace(
        machine,
        bearings=tuple(
            replace(b, negative_stiffness=(1e6, 1e6), force_per_current=(150.0, 150.0))
            for b in machine.bearings
        ),
        couplings=(),
    )
    turned = replace(
        isotropic, bearings=tuple(replace(b, angle=b.angle + 0.3) for b in isotropic.bearings)
    )
    w = np.array([10.0, 300.0, 3000.0])

    def sv(m):
        p = assemble(m)
        return np.linalg.svd(
            frequency_response(select(p.system, p.named("u"), p.named("y")), w).values,
            compute_uv=False,
        )

    assert sv(turned) == pytest.approx(sv(isotropic), rel=1e-8)


@pytest.mark.parametrize("added_mass", [0.0, 3.0])
@pytest.mark.parametrize("name", ["seal-rig", "turboexpander"])
def test_slow_poles_of_the_full_plant_keep_eight_digits_behind_the_point(name, added_mass):
    """METHODS asks for 1e-6 rad/s. Oracle: M s^2 + (D + W G) s + K, corrected in extended precision
    with both its vectors.
    """
    given = load_machine(name)
    given = replace(given, seals=(replace(given.seals[0], M=added_mass),))
    point = given.operation.nominal
    found = poles(assemble(given, point).rotor)
    system = attached_rotor(given, point, finite_element_rotor(given))
    M, D, K = (
        x.astype(np.longdouble)
        for x in (system.mass, system.damping + point.speed * system.gyroscopic, system.stiffness)
    )
    slow = found[np.abs(found) < 2000.0]
    assert len(slow) >= 8
    for pole in slow:
        s = np.clongdouble(pole)
        for _ in range(3):
            P = M * s * s + D * s + K
            size = 1 / np.sqrt(np.maximum(np.abs(np.diag(P)), 1e-3).astype(float))
            U, _, Vh = np.linalg.svd(P.astype(complex) * size[:, None] * size)
            x, y = (
                v.astype(np.clongdouble) for v in (Vh[-1].conj() * size, U[:, -1].conj() * size)
            )
            s -= (y @ P @ x) / (y @ (2 * s * M + D) @ x)
        assert abs(complex(s) - pole) < 2e-8


def test_states_mean_the_same_at_every_operating_point():
    """Displacements, velocities and the kinematic half of A do not move with speed or pressure; K
    and D do.
    """
    given = load_machine("turboexpander")
    point = given.operation.nominal
    first = assemble(given, point).rotor
    n = first.n_states // 2
    for change in ({"speed": 700.0}, {"seal_pressure": 5e5}, {"speed": 0.0, "seal_pressure": 0.0}):
        other = assemble(given, replace(point, **change)).rotor
        np.testing.assert_array_equal(other.C, first.C)
        np.testing.assert_array_equal(other.B, first.B)
        np.testing.assert_array_equal(other.A[:n], first.A[:n])
        assert np.abs(other.A[n:, :n] - first.A[n:, :n]).max() > 10.0


@pytest.mark.parametrize("name", bundled_machines())
def test_a_plant_beside_another_one_is_the_same(name):
    """At another speed, and at another pressure, current or machine, where nothing is taken."""
    machine = coarse(name)
    points = machine.operation.points
    first = assemble(machine, points[0])
    moved = [replace(points[0], speed=0.9 * points[0].speed), *points[1:]]
    for other in (machine, replace(machine, name="another")):
        for point in moved:
            found, expected = assemble(other, point, beside=first), assemble(other, point)
            assert found.point == point and found.machine is other
            for letter in "ABCD":
                one, same = (getattr(plant.system, letter) for plant in (found, expected))
                np.testing.assert_array_equal(one, same)
            assert found.system.inputs == expected.system.inputs
            np.testing.assert_array_equal(found.rotor.A, expected.rotor.A)
