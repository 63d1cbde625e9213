"""The bound on what the cut modes do, against the free rotor in all modes of its mesh: above the
error, and not far.
"""

import numpy as np
import pytest
import scipy.linalg as sla

import ambrose as amb
from ambrose.model.assemble import bending_modes_of, in_plane, modes_of, port_positions
from ambrose.model.effects.rotor import (
    finite_element_rotor,
    free_bending_frequencies,
    plane_rows,
    residual_modes,
)

# How far the modes that the full model leaves out can move the compliance of the free, turning
# rotor: a bound, derived.
#
# In one plane, z = x + j y, both senses of rotation being frequencies of either sign: (K - w^2 M +
# w Omega G + damping) q = f, all of it symmetric. q = Phi a + c, Phi the kept modes and c in the
# rest, whose modes are Lambda = diag(w_i^2), w_i >= w_c. The model holds c = V eta, V the residual
# modes, V^T Lambda V = diag(theta^2). A force on the ports, with the model's own a, is a load
#
#   l = Lambda^-1/2 (b_c - w Omega G_ca a) = Q l_1 + l_2,    Q = Lambda^1/2 V / theta (orthonormal),
#   l_2 orthogonal to Q,
#
# on the rest, which answers Lambda^1/2 c = (I - w^2 T - N)^-1 l, T = Lambda^-1 <= I / w_c^2, with r
# = (w / w_c)^2 and
#
#     |N| <= p = 2 zeta |w| / w_c + |Lambda^-1/2 G_cc Lambda^-1/2| |w Omega|,    n = r + p.
#
# Symmetry makes the error of the compliance l^T e, e that of Lambda^1/2 c, and one further term for
# what e moves the kept modes with, H_aa their own compliance in the model. In l_1 the model answers
# with the same to zeroth order, and with Q^T T Q = diag(1 / theta^2) exactly. So of the convex
# function 1 / (1 - w^2 T) no more can be missed than lies between it and its chord over 0 .. 1 /
# w_c^2 (Jensen's operator inequality), and of the modal damping, the concave sqrt(T), likewise:
#
#     E_11 = |l_1^* diag(2 zeta |w| / theta (1 - w_c / theta) + x (r - x) / ((1 - r) (1 - x))) l_1|,
#     x = (w / theta)^2.
#
# What N adds beyond its first order is at most s = p (1 / ((1 - r) (1 - n)) - 1), for rest and
# model each. Altogether
#
#     E_11 + 2 s |l_1|^2 + (r / (1 - r) + 2 (p + s)) |l_1| |l_2| + |l_2|^2 / (1 - n)
#     + k^2 |H_aa| / (1 - 2 |H_aa| h^2 / (1 - n)),    k = h (2 n |l_1| + |l_2|) / (1 - n),
#     h = |w Omega Lambda^-1/2 G_ca|.
#
# Where n is not small, damping holds |(I - w^2 T - N)^-1| <= 1 + (w^2 + g |w Omega|) / (2 zeta |w|
# w_c) instead (by its numerical range), g the largest eigenvalue of (G, M), for rest and model
# alike. The smaller of the two counts.


def compliance_error_bound(machine, speed, omega):
    """Bound (w,) [m/N] on the largest singular value of what all modes of the mesh add to the free
    rotor's compliance.

    From forces to displacements at all places of ports, in one plane; speed [rad/s]; omega (w,)
    [rad/s]: positive forward, negative backward. Zero for a rotor of which all modes are kept. All
    modes are to have the machine's ``modal_damping``.
    """
    rotor, zeta = finite_element_rotor(machine), machine.modal_damping
    modes, kept = modes_of(machine, rotor, None), 2 + bending_modes_of(rotor)
    Phi, frequency = in_plane(modes), modes.frequencies[0::2]
    if len(frequency) == kept == 2 * rotor.n_nodes:
        return np.zeros(len(omega))
    G = rotor.plane_gyroscopic

    # theta; w_c, the first bending mode cut off; |Lambda^-1/2 G_cc Lambda^-1/2|; g
    theta = frequency[kept:]
    lowest = free_bending_frequencies(rotor, kept - 1)[-1]
    turned = _gyroscopic_part(rotor, Phi[:, :kept], frequency[:kept], lowest)
    largest = float(sla.eigvalsh(G, rotor.plane_mass, subset_by_index=[len(G) - 1, len(G) - 1])[0])

    # G and ports in the modes of the model; residual modes for the loads G Phi_a
    turning, ports = Phi.T @ G @ Phi, plane_rows(rotor, port_positions(machine))[0] @ Phi
    frequencies, shapes = residual_modes(rotor, kept - 2, (G @ Phi[:, :kept]).T)
    # Lambda^-1/2 G_ca, whole and in Q
    loads, coupling = Phi[:, :kept].T @ G @ shapes / frequencies, turning[:kept, kept:] / theta

    # beside^T beside = loads loads^T - held held^T: |l_2| = |w Omega beside a|
    values, vectors = np.linalg.eigh(loads @ loads.T - coupling @ coupling.T)
    beside = (vectors * np.sqrt(np.maximum(values, 0.0))).T
    bound = np.empty(len(omega))
    for i, w in enumerate(omega):
        # the model's own a for unit forces on the ports, and |H_aa|
        Z = np.diag(frequency**2 - w**2 + 2j * zeta * frequency * w) + w * speed * turning
        a = np.linalg.solve(Z, np.hstack([ports.T, np.eye(len(Z))[:, :kept]]))[:kept]
        a, receptance = a[:, : len(ports)], np.linalg.norm(a[:, len(ports) :], 2)

        # l_1 = theta^-1 (V^T b - w Omega V^T G_ca a), and the norms of l_1, l_2
        first = (ports[:, kept:].T - w * speed * turning[kept:, :kept] @ a) / theta[:, None]
        l_1, l_2 = np.linalg.norm(first, 2), np.linalg.norm(w * speed * beside @ a, 2)

        # n = r + p, and the bound by damping where that is not small
        h, spin = abs(w * speed) * np.linalg.norm(loads, 2), largest * abs(w * speed)
        ratio = abs(w) / lowest
        n = ratio**2 + 2 * zeta * ratio + turned * abs(w * speed)
        most = 1 + (w**2 + spin) / (2 * zeta * abs(w) * lowest) if zeta * w else np.inf
        r, p = ratio**2, n - ratio**2

        # E_11: of damping, then (only for n < 1) of w^2 T; ``further`` is s
        x = (w / theta) ** 2
        missed = 2 * zeta * abs(w) / theta * (1 - lowest / theta)
        near = np.inf
        if n < 1:
            missed = missed + x * (r - x) / ((1 - r) * (1 - x))
            further = p * (1 / ((1 - r) * (1 - n)) - 1)
            near = (
                np.linalg.norm(first.conj().T @ (missed[:, None] * first), 2) + 2 * further * l_1**2
            )
            near += (r / (1 - r) + 2 * (p + further)) * l_1 * l_2 + l_2**2 / (1 - n)

        # what the error does to the kept modes: k^2 |H_aa|/(1 - 2 |H_aa| h^2 ...); the smaller
        # bound each time
        answer = min(1 / (1 - n), most) if n < 1 else most
        moved = h * min((2 * n * l_1 + l_2) * answer, 2 * most * (l_1 + l_2))
        loop = 2 * receptance * h**2 * answer
        bound[i] = min(near, 2 * most * (l_1 + l_2) ** 2) + (
            moved**2 * receptance / (1 - loop) if loop < 1 else np.inf
        )
    return bound


def _gyroscopic_part(rotor, Phi, frequency, lowest):
    """An upper bound on the norm of Lambda^-1/2 G_cc Lambda^-1/2 [s2], a hundredth above it.

    Phi (2N, k) and frequency (k,) [rad/s]: the kept modes; lowest [rad/s]: w_c. Of the largest
    x^T G x / x^T K x outside the kept modes; a shift of K makes it definite, and costs at most what
    it is of w_c^2.
    """
    # K + s M = L L^T; the kept modes are L^T Phi there, orthogonal to each other
    shift = 0.01 * lowest**2
    L = np.linalg.cholesky(rotor.plane_stiffness + shift * rotor.plane_mass)
    held = L.T @ Phi / np.sqrt(frequency**2 + shift)

    # P L^-1 G L^-T P, P = I - held held^T
    G = sla.solve_triangular(L, rotor.plane_gyroscopic, lower=True)
    G = sla.solve_triangular(L, G.T, lower=True)
    G -= held @ (held.T @ G)
    G -= (G @ held) @ held.T
    top = sla.eigvalsh((G + G.T) / 2, subset_by_index=[len(G) - 1, len(G) - 1])[0]
    return float(top) * (1 + shift / lowest**2)


def compliance(Phi, frequency, rotor, machine, speed, omega):
    """(w, p, p) [m/N] in the coordinates Phi, of which those with frequencies are damped."""
    rows, G = (
        plane_rows(rotor, port_positions(machine))[0] @ Phi,
        Phi.T @ rotor.plane_gyroscopic @ Phi,
    )
    own = frequency**2, 2j * machine.modal_damping * frequency
    return np.array(
        [
            rows @ np.linalg.solve(np.diag(own[0] - w**2 + w * own[1]) + w * speed * G, rows.T)
            for w in omega
        ]
    )


def every_mode(kept, frequency, rotor):
    """The kept modes and those of their complement, so that both models round alike in what they
    share.
    """
    M, K = rotor.plane_mass, rotor.plane_stiffness
    rest = sla.null_space(kept.T @ M)
    squares, mix = sla.eigh(rest.T @ K @ rest, rest.T @ M @ rest)
    return np.hstack([kept, rest @ mix]), np.concatenate([frequency, np.sqrt(squares)])


@pytest.mark.parametrize("name", ["seal-rig", "turboexpander", "process-compressor"])
@pytest.mark.parametrize("turns", [0.0, 1.0, 5.0])
def test_bound_holds_and_is_not_far(name, turns):
    machine = amb.load_machine(name)
    rotor, speed = (
        finite_element_rotor(machine),
        turns * (machine.operation.speed_range[1] or 600.0),
    )
    modes = modes_of(machine, rotor, None)
    Phi, frequency = in_plane(modes), modes.frequencies[0::2]
    kept = {"process-compressor": 66}.get(name, 26)
    whole, all_frequencies = every_mode(Phi[:, :kept], frequency[:kept], rotor)
    resonances = all_frequencies[2:10] * (1 + 1e-4)
    omega = np.concatenate([np.geomspace(30.0, 3 * all_frequencies[kept], 60), resonances])
    omega = np.concatenate([omega, -omega])
    ours = compliance(Phi, frequency, rotor, machine, speed, omega)
    exact = compliance(whole, all_frequencies, rotor, machine, speed, omega)
    error, size = (np.linalg.norm(part, 2, axis=(1, 2)) for part in (exact - ours, exact))
    bound = compliance_error_bound(machine, speed, omega)
    rounding = 2e-13 * size
    assert (error <= bound + rounding).all()
    told = (np.abs(omega) < all_frequencies[kept] / 10) & (error > 100 * rounding)
    # at a resonance that the rest could move there is no bound
    half, most, all_ = np.percentile(bound[told] / error[told], [50, 90, 100], method="nearest")
    print(f"{name}, {speed:.0f} rad/s: bound over error {half:.1f}, {most:.1f}, {all_:.1f}")
    assert half < 10 and most < 12


def test_rotors_in_all_their_modes_have_no_error():
    machine = amb.load_machine("flywheel")
    assert (compliance_error_bound(machine, 100.0, np.array([10.0, 1e4])) == 0).all()
