"""First-order flow of an annular gas seal: the pressure that a small whirl of the rotor raises.

Two control volumes (Kleynhans & Childs 1997): the film of clearance H, and the cells of the stator,
which hold gas at the film's pressure and carry no flow along the seal; their volume per wall area,
``storage``, enters as a capacitance:

    d(rho (H + storage))/dt + d(rho U H)/(R dtheta) + d(rho W H)/dz = 0
    rho H (dW/dt + U dW/(R dtheta) + W dW/dz) = -H dp/dz - tau_z
    rho H (dU/dt + U dU/(R dtheta) + W dU/dz) = -H dp/(R dtheta) - tau_theta

(gas enters and leaves a cell with the film's own velocity). With the clearance H + Re h e^{j(w t -
n theta)}, n = 1 for a lateral whirl, p, U and W change by Re (p, u, w) e^{j(w t - n theta)}. The
three linear equations q' = (M0 + j w M1) q + b0 + j w b1 in q = (p, u, w), with two conditions at
the inlet and one at the exit, are solved by collocation at three Lobatto points per cell
(Hermite-Simpson, fourth order) and one banded elimination per frequency.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ambrose.core.checks import NumericalFailure
from ambrose.model.effects.bulkflow_static import StaticFlow, Walls


@dataclass(frozen=True, slots=True, eq=False)
class WhirlFlow:
    """Amplitudes per metre of clearance, (w, 2 cells + 1): p [Pa/m], u, w [1/s]; ``mean_p`` (w,)
    [Pa], p integrated along z.
    """

    p: np.ndarray
    u: np.ndarray
    w: np.ndarray
    mean_p: np.ndarray


def whirl_flow(walls: Walls, flow: StaticFlow, omega: np.ndarray, harmonic: int = 1) -> WhirlFlow:
    """First-order flow for clearance amplitude h = 1 at whirl frequencies omega (w,) [rad/s],
    positive, zero or negative.

    harmonic n: waves around the circumference; 1 is the lateral whirl, 0 a breathing clearance.
    Raises NumericalFailure.
    """
    M0, M1, b0, b1 = _equations(walls, flow, harmonic)
    inlet, leave = _boundary(walls, flow)

    # In q/scale, M/scale: p over p_in, u and w over a; the unknowns and the rows are then of one
    # size.
    scale = np.array([walls.p_in, np.sqrt(walls.a2), np.sqrt(walls.a2)])
    M0, M1 = (M * (scale[None, :] / scale[:, None]) for M in (M0, M1))
    b0, b1 = b0 / scale, b1 / scale
    inlet, leave = inlet * scale, leave * scale
    inlet, leave = inlet / np.abs(inlet).max(axis=1, keepdims=True), leave / np.abs(leave).max()
    step = np.diff(flow.z[::2])

    # q' = (M0 + j w M1) q + b0 + j w b1, a whirl frequency at a time
    q = np.stack(
        [_collocate(M0 + 1j * x * M1, b0 + 1j * x * b1, inlet, leave, step) for x in omega]
    )
    if not np.isfinite(q).all():
        raise NumericalFailure(
            "the first-order flow of the seal is not finite; use more cells or a lower exit Mach "
            "number"
        )

    # Back in Pa and m/s; p integrated by Simpson's rule over node, middle, node of every cell.
    q = q * scale
    p = q[..., 0]
    mean = (p[:, :-1:2] + 4 * p[:, 1::2] + p[:, 2::2]) @ step / 6
    return WhirlFlow(p, q[..., 1], q[..., 2], mean)


def _friction(walls: Walls, flow: StaticFlow) -> np.ndarray:
    """Derivatives of (tau_z, tau_theta) (2, 4, s) by (p, u, w, h)."""
    rho = flow.p / walls.a2
    slope = np.zeros((2, 4, len(flow.z)))
    for (n, m), wall_speed in ((walls.stator, 0.0), (walls.rotor, walls.surface_speed)):
        U, W = flow.U - wall_speed, flow.W
        V2 = U**2 + W**2
        # tau/V = 1/2 n (2 H/mu)^m rho^(1+m) V^(1+m);
        # tau_z = (tau/V) W, tau_theta = (tau/V) U
        stress = (
            0.5 * n * (2 * flow.H / walls.viscosity) ** m * rho ** (1 + m) * V2 ** (0.5 * (1 + m))
        )

        # d tau_z/du = d tau_theta/dw = (1+m) (tau/V) U W/V^2
        across = (1 + m) * stress * U * W / V2
        # by p: rho^(1+m) with rho = p/a^2
        slope[:, 0] += (1 + m) / flow.p * stress * np.array([W, U])
        # by u, then w: V^(1+m) and, of the stress in its own direction, the factor U or W
        slope[:, 1] += np.array([across, stress * (1 + (1 + m) * U**2 / V2)])
        slope[:, 2] += np.array([stress * (1 + (1 + m) * W**2 / V2), across])
        # by h: H^m
        slope[:, 3] += m / flow.H * stress * np.array([W, U])
    return slope


def _equations(
    walls: Walls, flow: StaticFlow, n: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """M0, M1 (s, 3, 3) and b0, b1 (s, 3) at the s stations, unit clearance amplitude."""
    H = flow.H
    U = flow.U
    W = flow.W
    dp = flow.dp
    dU = flow.swirl_slope
    dW = flow.axial_slope
    G = flow.G
    rho = flow.p / walls.a2
    taper = walls.taper
    a2 = walls.a2
    mass = rho * H
    tau = _friction(walls, flow)
    around = -1j * n / walls.radius  # d/(R dtheta)
    carried = around * U  # of d/dt + U d/(R dtheta), the part without frequency

    # left q' = (right[0] + j w right[1]) q + forced[0] + j w forced[1]; rows: continuity, momentum
    # along, momentum around; columns (p, u, w). The gas of the film changes by p/a^2.
    s = len(H)
    left = np.zeros((s, 3, 3))
    right = np.zeros((2, s, 3, 3), dtype=complex)
    forced = np.zeros((2, s, 3), dtype=complex)

    # W H/a^2 p' + rho H w' = -((W H)' + U H d/(R dtheta))/a^2 p - rho H du/(R dtheta) - (rho H)' w
    #     - ((rho W)' + rho U d/(R dtheta)) h - j w ((H + storage)/a^2 p + rho h),
    # with (rho W)' = (G/H)' = -G H'/H^2
    left[:, 0, 0], left[:, 0, 2] = W * H / a2, mass  # continuity
    right[0, :, 0] = -np.stack(
        [(dW * H + W * taper + carried * H) / a2, around * mass, (dp * H / a2 + rho * taper) + 0j],
        axis=1,
    )
    right[1, :, 0, 0] = -(H + walls.storage) / a2
    forced[0, :, 0], forced[1, :, 0] = G * taper / H**2 - carried * rho, -rho

    # H p' + rho H W w' = -(H W W'/a^2) p - rho H (U d/(R dtheta) + W') w - tau_z1
    #     - (p0' + rho W W') h - j w rho H w
    left[:, 1, 0], left[:, 1, 2] = H, mass * W  # along
    right[0, :, 1] = -np.stack(
        [H * W * dW / a2 + tau[0, 0], tau[0, 1], mass * (carried + dW) + tau[0, 2]], axis=1
    )
    right[1, :, 1, 2] = -mass
    forced[0, :, 1] = -(dp + rho * W * dW + tau[0, 3])

    # rho H W u' = -(H W U'/a^2 + H d/(R dtheta)) p - rho H U du/(R dtheta) - rho H U' w
    #     - tau_theta1 - rho W U' h - j w rho H u; the steady pressure is the same all around
    left[:, 2, 1] = mass * W  # around
    right[0, :, 2] = -np.stack(
        [
            H * W * dU / a2 + around * H + tau[1, 0],
            mass * carried + tau[1, 1],
            mass * dU + tau[1, 2],
        ],
        axis=1,
    )
    right[1, :, 2, 1] = -mass
    forced[0, :, 2] = -(rho * W * dU + tau[1, 3])

    # solved for q'
    inverse = np.linalg.inv(left)
    M, b = inverse @ right, (inverse @ forced[..., None])[..., 0]
    return M[0], M[1], b[0], b[1]


def _boundary(walls: Walls, flow: StaticFlow) -> tuple[np.ndarray, np.ndarray]:
    """Rows (2, 3) at the inlet and (1, 3) at the exit that q must make zero: the pressure losses,
    and swirl unchanged.
    """
    rows = []
    for i, factor in ((0, 1 + walls.inlet_loss), (-1, walls.exit_recovery)):
        # p_0 - p = factor rho W^2/2, p_0 fixed: p + factor (W^2/a^2 p/2 + rho W w) = 0
        W, rho = flow.W[i], flow.p[i] / walls.a2
        rows.append([1 + 0.5 * factor * W**2 / walls.a2, 0.0, factor * rho * W])
    return np.array([rows[0], [0.0, 1.0, 0.0]]), np.array([rows[1]])


def _collocate(
    M: np.ndarray, b: np.ndarray, inlet: np.ndarray, leave: np.ndarray, step: np.ndarray
) -> np.ndarray:
    """q (s, 3) at nodes and middles of q' = M q + b, (s, 3, 3) and (s, 3), with inlet q(0) = 0 and
    leave q(L) = 0.

    step (cells,) [m].
    """
    from scipy.linalg import LinAlgError, solve_banded

    # A, f at the left node of every cell, Am, fm in its middle, B, g at the right node.
    eye = np.eye(3)
    A = M[:-2:2]
    Am = M[1::2]
    B = M[2::2]
    f = b[:-2:2]
    fm = b[1::2]
    g = b[2::2]
    cells = len(A)
    h = step[:, None, None]

    # Simpson: q_1 - q_0 = h/6 (q_0' + 4 q_m' + q_1'); Hermite: q_m = (q_0 + q_1)/2 + h/8 (q_0' -
    # q_1'). With q' = M q + b this is L q_0 + R q_1 = r.
    L = -eye - h / 6 * (A + 4 * Am @ (0.5 * eye + h / 8 * A))
    R = eye - h / 6 * (B + 4 * Am @ (0.5 * eye - h / 8 * B))
    r = (h / 6)[..., 0] * (f + 4 * fm + g) + (h**2 / 12 * Am @ (f - g)[..., None])[..., 0]
    # LAPACK storage: 4 below, 3 above the diagonal
    band = np.zeros((8, 3 * cells + 3), dtype=complex)

    # Unknowns node by node. Rows: two of the inlet, three of every cell, one of the exit. Of entry
    # (row, column) the band's row is 3 + row - column.
    first = 3 * np.arange(cells)
    for i in range(3):
        for k in range(3):
            band[5 + i - k, first + k] = L[:, i, k]  # row 2 + 3c + i, column 3c + k
            band[2 + i - k, first + 3 + k] = R[:, i, k]
            if i < 2:
                band[3 + i - k, k] = inlet[i, k]
    for k in range(3):
        band[5 - k, 3 * cells + k] = leave[0, k]
    rhs = np.concatenate([np.zeros(2), r.ravel(), np.zeros(1)])
    try:
        q = solve_banded((4, 3), band, rhs).reshape(-1, 3)
    except LinAlgError as error:
        raise NumericalFailure(
            f"the first-order flow of the seal has no unique solution ({error}); change the grid"
        ) from error

    # Hermite's q_m in the middles
    slope_left, slope_right = (A @ q[:-1, :, None])[..., 0] + f, (B @ q[1:, :, None])[..., 0] + g
    result = np.empty((2 * cells + 1, 3), dtype=complex)
    result[::2] = q
    result[1::2] = 0.5 * (q[:-1] + q[1:]) + h[..., 0] / 8 * (slope_left - slope_right)
    return result
