"""Reduction to rigid-body and a few bending modes, with real transforms and an error bound.

Route: the lowest mass-orthonormal modes of the free rotor (symmetric eigenproblem) give a small
intermediate model; an ordered real Schur form and one Sylvester equation then split off the slow
invariant subspace (Bavely & Stewart 1979). No mode is paired with another and nothing becomes
complex: the rigid-body poles on magnetic bearings are real or nearly repeated.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np
import scipy.linalg as sla

from ambrose.core.checks import NumericalFailure, check_shape, invalid, named_failure
from ambrose.core.frequency import largest_gain
from ambrose.core.mechanical import SecondOrder, project, to_statespace, velocity_scales
from ambrose.core.statespace import StateSpace, balance
from ambrose.machine.axial import AxialMachine
from ambrose.model.assemble import (
    attached_rotor,
    attached_statespace,
    mode_ports,
    part_states,
    state_scales,
    wire,
    with_states,
)
from ambrose.model.basis import bending_modes_of
from ambrose.model.effects.rotor import free_modes
from ambrose.model.effects.support import foundation
from ambrose.model.plant import Plant, top_speed
from ambrose.model.uncertainty import with_offsets_of

# bending modes per plane beyond those asked for: rigid-body poles good to 3e-4 rad/s, see tests
_EXTRA_MODES = 24


@dataclass(frozen=True, slots=True, eq=False)
class Reduction:
    """A reduced plant and how it came about.

    plant: same type as the full one. T_L (r, n), T_R (n, r): x_r = T_L x, x = T_R x_r, T_L T_R = I,
    for the rotor's state x of ``assemble``; states of seals are kept as they are. ``residual``:
    what was cut off the rotor (with the constants of such seals), in decoupled first-order form;
    see ``error_bound``.
    """

    plant: Plant
    T_L: np.ndarray
    T_R: np.ndarray
    residual: StateSpace
    static_correction: bool

    def error_bound(self, omega: np.ndarray) -> np.ndarray:
        """Bound (w,) on the largest singular value of the rotor's displacement error at omega (w,)
        [rad/s], in m/N.

        The sum of the cut-off modes' own contributions, each pair of conjugate poles taken
        together; modes beyond the intermediate model enter by their static compliance only
        (exactly, when the static correction is on).
        """
        omega = check_shape(omega, "omega", "(w,)")
        # without velocities and the ports of single modes: displacements per force
        mode_suffixes = tuple(f"_{name}" for name in mode_ports(self.plant.machine))
        keep, used = (
            [
                i
                for i, name in enumerate(names)
                if not name.startswith("qdot_")
                and not (mode_suffixes and name.endswith(mode_suffixes))
            ]
            for names in (self.residual.outputs, self.residual.inputs)
        )
        residual = self.residual
        return modal_sum_bound(
            residual.A, residual.B[:, used], residual.C[keep], omega, self.static_correction
        )


def reduce(plant: Plant, bending_modes: int = 0, static_correction: bool = True) -> Plant:
    """The plant with its rotor reduced to the rigid-body modes and ``bending_modes`` per plane; see
    ``modal_reduction``.
    """
    return modal_reduction(plant, bending_modes, static_correction).plant


def reduce_from(plant: Plant, bending_modes: int) -> Plant:
    """``reduce`` with so many bending modes per plane, or up to three more where that would part
    modes that coincide.
    """
    for count in range(bending_modes, min(bending_modes + 3, bending_modes_of(plant.rotor_model))):
        with suppress(NumericalFailure):
            return reduce(plant, count)
    return reduce(plant, min(bending_modes + 3, bending_modes_of(plant.rotor_model)))


def default_bending_modes(plant: Plant) -> int:
    """How many bending modes per plane matter: those up to twice the top speed or the amplifier's
    fastest lag, and one more.
    """
    if isinstance(plant.machine, AxialMachine):
        return 0
    amplifier = plant.machine.amplifier
    lags = [
        rate
        for rate in (amplifier.bandwidth, amplifier.eddy_bandwidth, amplifier.natural_frequency)
        if rate is not None
    ]
    highest = max(2 * top_speed(plant.machine), *lags, 0.0)
    available = bending_modes_of(plant.rotor_model)
    bending = free_modes(plant.rotor_model, available).frequencies[4::2]
    return min(int((bending <= highest).sum()) + 1, available)


@named_failure("the reduction of the plant")
def modal_reduction(
    plant: Plant, bending_modes: int = 0, static_correction: bool = True
) -> Reduction:
    """Split off the slow modes of the rotor on its bearings, seals and couplings: 8 + 4
    bending_modes states, and the seals'.

    One more for every pole of a support that is slower than the first bending mode that is cut off.

    Offsets of a perturbed plant are applied to the reduced one; transforms and residual are those
    of the nominal rotor. ``static_correction`` adds the static compliance of all that was cut off
    as a feedthrough from force to displacement. Raises InvalidInput for more bending modes than the
    mesh has, NumericalFailure when the poles to keep are not separated from the rest.
    """
    machine, point = plant.machine, plant.point
    if isinstance(machine, AxialMachine):
        return _whole(plant)
    rotor = plant.rotor_model
    available = bending_modes_of(rotor)
    if bending_modes not in range(available + 1):
        raise invalid(
            "bending_modes",
            bending_modes,
            f"a whole number from 0 to {available}",
            "refine the mesh or keep fewer modes",
        )

    # the lowest modes and the supports
    full = attached_rotor(machine, point, rotor)
    # all other modal coordinates are held at zero
    inner = 4 + 2 * min(available, bending_modes + _EXTRA_MODES)
    base = foundation(machine)
    kept = np.r_[:inner, full.n - len(base) : full.n]
    second_order = project(full, np.eye(full.n)[:, kept])
    small = to_statespace(second_order, point.speed)

    # A support's pole that is slower than the first mode cut off is kept: s^2 + d s + k = 0.
    fastest = (
        np.inf
        if bending_modes == available
        else free_modes(rotor, bending_modes + 1).frequencies[-1]
    )
    support_poles = [
        np.roots([1.0, d, k]) for d, k in zip(base.damping, base.stiffness, strict=True)
    ]
    slower = int((np.abs(support_poles) < fastest).sum())

    # slow and fast part, each x_r' = L A R x_r + L B u, y = C R x_r + D u
    T_L, T_R, L_res, R_res = split_slow(small.A, 8 + 4 * bending_modes + slower)
    slow, fast = (
        StateSpace(L @ small.A @ R, L @ small.B, small.C @ R, small.D, small.inputs, small.outputs)
        for L, R in ((T_L, T_R), (L_res, R_res))
    )
    reduced = with_static_correction(slow, full) if static_correction else slow

    # transforms from and to the full rotor's own states; those of seals and effects as they are
    lift_L, lift_R = _lift(second_order, full, state_scales(machine, rotor), kept)
    unchanged = np.eye(part_states(machine, point))
    left, right = sla.block_diag(T_L @ lift_L, unchanged), sla.block_diag(lift_R @ T_R, unchanged)
    reduced = with_states(machine, point, reduced)
    result = with_offsets_of(wire(machine, point, reduced, bending_modes), plant)
    return Reduction(result, left, right, fast, static_correction)


def _whole(plant: Plant) -> Reduction:
    """The plant of the axis along the shaft, of which nothing is cut off."""
    unchanged = np.eye(plant.rotor.n_states)
    nothing = StateSpace(
        np.zeros((0, 0)),
        np.zeros((0, len(plant.rotor.inputs))),
        np.zeros((len(plant.rotor.outputs), 0)),
        np.zeros(plant.rotor.D.shape),
        plant.rotor.inputs,
        plant.rotor.outputs,
    )
    return Reduction(replace(plant, bending_modes=0), unchanged, unchanged, nothing, True)


def with_static_correction(slow: StateSpace, full: SecondOrder) -> StateSpace:
    """``slow`` with the feedthrough that makes its displacement outputs exact at zero frequency."""
    D = slow.D.copy()
    count = len(full.outputs)
    # at s = 0 the full model has C K^-1 B, the slow one -C A^-1 B
    D[:count] += full.C @ np.linalg.solve(full.stiffness, full.B) + slow.C[
        :count
    ] @ np.linalg.solve(slow.A, slow.B)
    return StateSpace(slow.A, slow.B, slow.C, D, slow.inputs, slow.outputs)


def free_mode_reduction(plant: Plant, bending_modes: int = 0) -> Plant:
    """Galerkin projection on the free rotor's modes: states that depend on neither speed nor
    bearing nor seal (for scheduling).

    They are those of ``assemble``, see ``assemble.attached_statespace``, of the modes kept.
    """
    machine, point = plant.machine, plant.point
    if isinstance(machine, AxialMachine):
        return _whole(plant).plant
    closed = attached_statespace(machine, point, plant.rotor_model, bending_modes)
    return with_offsets_of(wire(machine, point, closed, bending_modes), plant)


def split_slow(A: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Real block-diagonalisation of A (n, n) into its ``count`` slowest poles (by modulus) and the
    rest.

    Returns T_L (count, n), T_R (n, count), L_res (n - count, n), R_res (n, n - count): ``[T_L;
    L_res] [T_R R_res] = I``.
    """
    n = A.shape[0]
    A, t = balance(A)
    modulus = np.sort(np.abs(np.linalg.eigvals(A)))
    if count < n and modulus[count] < 1.001 * modulus[count - 1]:
        raise NumericalFailure(
            f"poles {count} and {count + 1} have moduli {modulus[count - 1]:.6g} and "
            f"{modulus[count]:.6g} rad/s and cannot be "
            "parted; keep one bending mode more or fewer"
        )

    # Slow poles first: A = Q T Q^T, T = [T11, T12; 0, T22].
    threshold = np.inf if count == n else 0.5 * (modulus[count - 1] + modulus[count])
    T, Q, n_slow = sla.schur(A, sort=lambda re, im: np.hypot(re, im) < threshold)
    if n_slow != count:
        raise NumericalFailure(
            f"the ordered Schur form kept {n_slow} poles instead of {count}; keep another number "
            "of modes"
        )
    r = count

    # T11 X - X T22 = -T12: T [X; I] = [X; I] T22, so Q [I; 0] and Q [X; I] span the two invariant
    # subspaces and [I, -X; 0, I] Q^T is the inverse.
    X = sla.solve_sylvester(T[:r, :r], -T[r:, r:], -T[:r, r:]) if r < n else np.zeros((r, 0))
    T_R, R_res = Q[:, :r], Q[:, r:] + Q[:, :r] @ X
    T_L, L_res = (Q[:, :r] - Q[:, r:] @ X.T).T, Q[:, r:].T

    # states of the slow part of like size; both scalings undone in the transforms
    _, s = balance(T_L @ A @ T_R)
    return (T_L / s[:, None]) / t, (T_R * s) * t[:, None], L_res / t, R_res * t[:, None]


def _lift(
    small: SecondOrder, full: SecondOrder, scales: np.ndarray, kept: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """From ``assemble``'s rotor state (q, q'/s) with scales s (n,) to the state of
    ``to_statespace(small)``, and back.

    The latter is z = L^T q of the k coordinates kept, M = L L^T, and z' in scales of its own.
    Orthogonal in the full mass.
    """
    k, n = small.n, full.n

    # M = L L^T; K = L^-1 k L^-T, of which to_statespace takes its scales
    L = sla.cholesky(small.mass, lower=True)
    K = sla.solve_triangular(L, sla.solve_triangular(L, small.stiffness, lower=True).T, lower=True)
    velocity_scale = velocity_scales(K)[:, None]

    # q = L^-T z at the kept coordinates, zero elsewhere; z = L^-1 M q, its inverse in the full mass
    up, down = np.zeros((n, k)), sla.solve_triangular(L, full.mass[kept], lower=True)
    up[kept] = sla.solve_triangular(L, np.eye(k), lower=True).T

    # velocity states q'/s and z'/own
    return (
        sla.block_diag(down, down * scales / velocity_scale),
        sla.block_diag(up, up * velocity_scale.T / scales[:, None]),
    )


def modal_sum_bound(
    A: np.ndarray, B: np.ndarray, C: np.ndarray, omega: np.ndarray, static: bool
) -> np.ndarray:
    """Sum over the modes of A of the norm of their contributions to C (j omega - A)^-1 B (minus its
    value at 0), (w,).
    """
    # C (s - A)^-1 B = sum over the poles of residue/(s - pole)
    values, V = np.linalg.eig(A)
    W = np.linalg.solve(V, B)
    CV = C @ V
    bound = np.zeros(len(omega))
    s = 1j * omega
    for i in np.flatnonzero(values.imag >= 0):
        residue = np.outer(CV[:, i], W[i])
        part = residue[None] / (s - values[i])[:, None, None]
        at_zero = -residue / values[i]

        # the conjugate pole with it, so that the two count as one mode
        if values[i].imag > 0:
            conjugate = residue.conj()
            part = part + conjugate[None] / (s - values[i].conj())[:, None, None]
            at_zero = 2 * at_zero.real
        bound += largest_gain(part - (at_zero if static else 0))
    return bound
