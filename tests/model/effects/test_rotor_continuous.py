"""The finite-element rotor against the exact solution of the beam equations by transfer matrices.

State along the shaft for whirl z = w exp(j omega t): [w, theta, moment, shear force], E I theta' =
moment, kappa G A (w' - theta) = shear, moment' = -shear - rho I (omega^2 - 2 Omega omega) theta,
shear' = -rho A omega^2 w. Each uniform piece is a matrix exponential; discs and springs are jumps;
free ends make a 2 x 2 determinant vanish. Nothing is shared with the elements, so that steps,
bores, shrunk-on mass, discs, springs and gyroscopics are checked at once.
"""

import numpy as np
import pytest
import scipy.linalg as sla
from scipy.optimize import brentq

from ambrose.machine.description import BEAM_THEORIES, Amplifier
from ambrose.machine.machine import Machine
from ambrose.machine.part import Disc, Material, ShaftSection
from ambrose.model.effects.rotor import finite_element_rotor, free_bending_frequencies, plane_rows

RHO = 7850.0
E = 2.1e11
NU = 0.3
# length, outer, inner and mass diameter [m], elements of the coarsest mesh
PIECES = [
    (0.15, 0.05, 0.0, 0.05, 2),
    (0.25, 0.09, 0.03, 0.12, 3),
    (0.30, 0.07, 0.02, 0.07, 4),
    (0.10, 0.04, 0.0, 0.04, 2),
]
STATIONS = [0.0, 0.15, 0.40, 0.70, 0.80]
DISC = Disc("wheel", 0.15, 6.0, 0.04, 0.022)
SPRINGS = ((0.40, 3e7), (0.70, 2e7))


def rotor(theory, refine=1, discs=(DISC,)):
    shaft = tuple(
        ShaftSection(z, length, outer, inner, heavy, n * refine, Material(RHO, E, NU))
        for z, (length, outer, inner, heavy, n) in zip(STATIONS, PIECES, strict=False)
    )
    return finite_element_rotor(
        Machine("stepped", shaft, (), (), Amplifier("none"), discs=tuple(discs), beam_theory=theory)
    )


def cowper(bore_ratio):
    m2 = bore_ratio**2
    return 6 * (1 + NU) * (1 + m2) ** 2 / ((7 + 6 * NU) * (1 + m2) ** 2 + (20 + 12 * NU) * m2)


def determinant(omega, theory, speed, discs, springs):
    """Free-end determinant of the whole shaft at a whirl frequency [rad/s], spin speed [rad/s]."""
    through = np.eye(4)
    for z, (length, outer, inner, heavy, _) in zip(STATIONS, PIECES, strict=False):
        through = jump(z, omega, speed, discs, springs) @ through
        area, heavy_area = (np.pi / 4 * (d**2 - inner**2) for d in (outer, heavy))
        inertia, heavy_inertia = (np.pi / 64 * (d**4 - inner**4) for d in (outer, heavy))
        shear = (
            0.0
            if theory != "timoshenko"
            else 1 / (cowper(inner / outer) * E / (2 * (1 + NU)) * area)
        )
        rotary = -2 * speed * omega + (0.0 if theory == "bernoulli-euler" else omega**2)
        A = np.zeros((4, 4))
        A[0, 1], A[0, 3] = 1.0, shear
        A[1, 2] = 1 / (E * inertia)
        A[2, 1], A[2, 3] = -RHO * heavy_inertia * rotary, -1.0
        A[3, 0] = -RHO * heavy_area * omega**2
        through = sla.expm(A * length) @ through
    through = jump(STATIONS[-1], omega, speed, discs, springs) @ through
    return np.linalg.det(through[2:, :2])


def jump(z, omega, speed, discs, springs):
    J = np.eye(4)
    for disc in discs:
        if disc.position == z:
            J[3, 0] -= disc.mass * omega**2
            J[2, 1] -= disc.diametral_inertia * omega**2 - disc.polar_inertia * speed * omega
    for position, stiffness in springs:
        if position == z:
            J[3, 0] += stiffness
    return J


def exact(near, theory, speed=0.0, discs=(DISC,), springs=()):
    """The roots next to approximate ones."""
    return np.array(
        [
            brentq(
                determinant,
                0.995 * w,
                1.005 * w,
                (theory, speed, discs, springs),
                xtol=1e-9,
                rtol=1e-13,
            )
            for w in near
        ]
    )


def whirl(theory, refine, speed, count):
    """Whirl frequencies of the finite-element rotor on its springs, forward for speed > 0."""
    r = rotor(theory, refine)
    K = r.plane_stiffness.copy()
    for position, stiffness in SPRINGS:
        row = plane_rows(r, [position])[0][0]
        K += stiffness * np.outer(row, row)
    n = len(K)
    KM, KG = np.linalg.solve(K, r.plane_mass), np.linalg.solve(K, r.plane_gyroscopic)
    inverse = np.linalg.eigvals(np.block([[-speed * KG, KM], [np.eye(n), np.zeros((n, n))]]))
    return np.sort(1 / inverse.real[inverse.real > 0])[:count]


@pytest.mark.parametrize("theory", BEAM_THEORIES)
def test_free_stepped_rotor_with_disc(theory):
    reference = exact(free_bending_frequencies(rotor(theory, 8), 3), theory)
    errors = [
        np.abs(free_bending_frequencies(rotor(theory, refine), 3) / reference - 1)
        for refine in (1, 2, 4)
    ]
    order = np.log2(errors[1] / errors[2])
    assert np.all(np.abs(order - (2 if theory == "timoshenko" else 4)) < 0.25)
    assert errors[2].max() < (2e-3 if theory == "timoshenko" else 2e-5)


@pytest.mark.parametrize("speed", [0.0, 4000.0, -4000.0])
@pytest.mark.parametrize("theory", BEAM_THEORIES)
def test_spinning_stepped_rotor_on_springs(theory, speed):
    reference = exact(whirl(theory, 8, speed, 4), theory, speed, springs=SPRINGS)
    errors = [np.abs(whirl(theory, refine, speed, 4) / reference - 1) for refine in (1, 2, 4)]
    order = np.log2(errors[1] / errors[2])
    assert np.all(np.abs(order - (2 if theory == "timoshenko" else 4)) < 0.3)
    if speed:  # the spin moves these frequencies far more than the error
        standstill = exact(whirl(theory, 8, 0.0, 4), theory, springs=SPRINGS)
        assert np.all((reference > standstill) == (speed > 0))
        assert np.abs(reference / standstill - 1).max() > 0.05
