"""Annular gas seals from geometry and operating condition: leakage and K, k, C, c against whirl
frequency.

The two-control-volume bulk-flow model of Kleynhans & Childs (1997, ASME J. Eng. Gas Turbines Power
119, 949-956) and of Ha & Childs (1994), isothermal; with holes of zero depth it is a smooth seal
(Nelson 1985). ``bulkflow_static`` has the zeroth-order flow, ``bulkflow_whirl`` the first-order
one. For the whirl x + j y = r e^{j w t} the clearance changes by -r e^{j(w t - theta)} and the
force on the rotor is

    f_x + j f_y = -pi R int p dz = -Z(w) r e^{j w t},   Z(w) = K + c w + j (C w - k),

so that forward and backward whirl, Z(w) and Z(-w), give the four coefficients. The shear on the
rotor is left out: it is smaller by the clearance over the radius.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from itertools import pairwise
from math import pi, sqrt

import numpy as np
from numpy.typing import ArrayLike

from ambrose.core.checks import NumericalFailure, check_positive, check_shape, invalid
from ambrose.core.frequency import bracketed_root
from ambrose.machine.part import SealTable

# Zeroth-order flow of an annular gas seal: leakage, pressure, swirl and axial velocity with the
# rotor in the centre.
#
# Isothermal ideal gas, p = rho a^2 with a^2 = Z R T; bulk velocities U around and W along the seal,
# clearance H(z):
#
#     G = rho W H = constant
#     G U' = -(tau_s U/V_s + tau_r (U - R Omega)/V_r)
#     G W' = -H p' - (tau_s W/V_s + tau_r W/V_r)
#
# with Blasius' friction at each wall, tau = 1/2 rho V^2 n (2 rho H V/mu)^m, V the speed relative to
# the wall (Hirs 1973; Nelson 1985; Kleynhans & Childs 1997). At the inlet p_in - p(0) = 1/2 (1 +
# inlet_loss) rho W^2, at the exit p_out - p(L) = 1/2 exit_recovery rho W^2. Where W reaches a the
# flow chokes.


_CHOKED = 1 - 1e-9  # squared Mach number from which a station counts as choked
_TOLERANCE = 1e-10  # of the inlet pressure
_HALVINGS = 30  # of the largest conceivable mass flow, in search of one that is too small


@dataclass(frozen=True, slots=True)
class Walls:
    """What both orders of the model need, in the letters of the equations.

    length L, radius R, clearances H_in, H_out, ``storage`` (cell volume per wall area) [m];
    friction (n, m) of stator and rotor [-]; inlet_loss, exit_recovery [-]; a2 = Z R T [m2/s2];
    viscosity mu [Pa s]; surface speed R Omega and inlet swirl [m/s]; p_in, p_out [Pa].
    """

    length: float
    radius: float
    H_in: float
    H_out: float
    storage: float
    stator: tuple[float, float]
    rotor: tuple[float, float]
    inlet_loss: float
    exit_recovery: float
    a2: float
    viscosity: float
    surface_speed: float
    inlet_swirl: float
    p_in: float
    p_out: float

    @property
    def taper(self) -> float:
        """dH/dz [-]."""
        return (self.H_out - self.H_in) / self.length


@dataclass(frozen=True, slots=True, eq=False)
class StaticFlow:
    """Zeroth-order solution at the grid's nodes and cell middles, all arrays (2 cells + 1,).

    z, H [m]; p [Pa]; U, W [m/s]; derivatives dp [Pa/m], swirl_slope U', axial_slope W' [1/s].
    G [kg/(m s)]: mass flow per circumference.
    """

    G: float
    z: np.ndarray
    H: np.ndarray
    p: np.ndarray
    U: np.ndarray
    W: np.ndarray
    dp: np.ndarray
    swirl_slope: np.ndarray
    axial_slope: np.ndarray


@lru_cache(maxsize=256)
def static_flow(walls: Walls, cells: int) -> StaticFlow:
    """The flow whose exit pressure is the given one, by bracketing on the mass flow; once for all
    whirl frequencies.

    Fourth-order Runge-Kutta with two steps per cell. Raises InvalidInput when the seal chokes
    before that exit pressure is reached, NumericalFailure when no mass flow fits.
    """
    if not walls.p_out < walls.p_in:
        raise invalid(
            "the exit pressure [Pa] of the seal",
            walls.p_out,
            f"below its inlet pressure {walls.p_in:g}",
            "swap the sides",
        )
    # beyond it no inlet pressure fits
    most = walls.p_in * walls.H_in / sqrt(2 * (1 + walls.inlet_loss) * walls.a2)

    # Less flow leaves at more pressure: ``least`` is too small a flow, twice that too large a one.
    try:
        least = next(
            g for i in range(1, _HALVINGS) if _excess(walls, g := most * 0.5**i, cells) > 0
        )
        G = bracketed_root(
            lambda g: _excess(walls, g, cells),
            least,
            2 * least,
            absolute=least * 1e-15,
            relative=1e-14,
        )
    except (StopIteration, ArithmeticError, ValueError) as error:
        raise NumericalFailure(
            f"no mass flow was found that leaves the seal at {walls.p_out:g} Pa; "
            "use more cells, or check clearances, viscosity and pressures for their units"
        ) from error

    # Where the flow chokes the excess jumps to -p_out: a bracket that closed on that jump is no
    # root.
    if abs(_excess(walls, G, cells)) > _TOLERANCE * walls.p_in:
        raise _choked(walls, G, cells)
    return _profile(walls, G, cells)


def slopes(walls: Walls, G, p, U, H):  # type: ignore[no-untyped-def]
    """(p', U', W, squared Mach number) where the pressure is p, the swirl U and the clearance H;
    floats or arrays.
    """
    rho = p / walls.a2
    W = G / (rho * H)

    # sums over the walls of tau W/V and tau (U - wall)/V
    axial, around = 0.0, 0.0
    for (n, m), wall_speed in ((walls.stator, 0.0), (walls.rotor, walls.surface_speed)):
        V2 = W * W + (U - wall_speed) ** 2
        # tau / V
        stress = 0.5 * n * (2 * H / walls.viscosity) ** m * rho ** (1 + m) * V2 ** (0.5 * (1 + m))
        axial = axial + stress * W
        around = around + stress * (U - wall_speed)

    # W = G a^2/(p H) gives W' = -W (p'/p + H'/H); G W/p = H W^2/a^2 turns G W' = -H p' - axial into
    # H (1 - M^2) p' = G W H'/H - axial.
    mach2 = W * W / walls.a2
    return (G * W * walls.taper / H - axial) / (H * (1 - mach2)), -around / G, W, mach2


def _stations(length: float, cells: int) -> np.ndarray:
    """Nodes and cell middles (2 cells + 1,) [m], denser towards the exit with the square root of
    the distance to it.

    Short of choking W rises like such a square root; in the nodes' index it is smooth.
    """
    nodes = length * (1 - (1 - np.linspace(0, 1, cells + 1)) ** 2)
    z = np.empty(2 * cells + 1)
    z[::2], z[1::2] = nodes, 0.5 * (nodes[1:] + nodes[:-1])
    return z


def _inlet(walls: Walls, G: float) -> float:
    """p(0) [Pa] from 1/2 (1 + loss) rho W^2 = p_in - p(0), the subsonic root."""
    # rho W^2 = a^2 (G/H)^2/p: p^2 - p_in p + head = 0
    head = 0.5 * (1 + walls.inlet_loss) * walls.a2 * (G / walls.H_in) ** 2
    return 0.5 * (walls.p_in + sqrt(max(walls.p_in**2 - 4 * head, 0.0)))


def _march(walls: Walls, G: float, cells: int) -> tuple[list[float], list[float]]:
    """p and U at the stations, ending early where the flow chokes. Integrates p^2, which falls
    nearly linearly.
    """
    # s = p^2, s' = 2 p p'
    s = _inlet(walls, G) ** 2
    U = walls.inlet_swirl
    H = walls.H_in
    pressures, swirls = [sqrt(s)], [U]
    stations = _stations(walls.length, cells).tolist()
    for here, there in pairwise(stations):
        step = there - here
        half = 0.5 * step * walls.taper
        ds, dU = 0.0, 0.0
        trial_s, trial_U = s, U
        # Classical Runge-Kutta: weight of a stage, how far from the start of the step the next
        # trial lies, and the clearance's change at the stage.
        for weight, back, dH in (
            (1 / 6, 0.5, 0.0),
            (1 / 3, 0.5, half),
            (1 / 3, 1.0, half),
            (1 / 6, 0.0, 2 * half),
        ):
            # A stage that chokes ends the march: the stations so far are fewer than 2 cells + 1.
            if trial_s <= 0:
                return pressures, swirls
            p = sqrt(trial_s)
            slope, swirl_slope, _, mach2 = slopes(walls, G, p, trial_U, H + dH)
            if mach2 >= _CHOKED:
                return pressures, swirls
            ds += weight * 2 * p * slope
            dU += weight * swirl_slope
            trial_s, trial_U = s + back * step * 2 * p * slope, U + back * step * swirl_slope
        s = s + step * ds
        U = U + step * dU
        H = walls.H_in + there * walls.taper
        if s <= 0 or slopes(walls, G, sqrt(s), U, H)[3] >= _CHOKED:
            return pressures, swirls
        pressures.append(sqrt(s))
        swirls.append(U)
    return pressures, swirls


def _exit_pressure(walls: Walls, G: float, cells: int) -> float | None:
    """Pressure [Pa] behind the exit for a mass flow, None where it chokes."""
    pressures, _ = _march(walls, G, cells)
    if len(pressures) < 2 * cells + 1:
        return None

    # p_out = p(L) + exit_recovery rho W^2/2, rho W^2 = a^2 (G/H)^2/p
    p = pressures[-1]
    return p + 0.5 * walls.exit_recovery * walls.a2 * (G / walls.H_out) ** 2 / p


def _excess(walls: Walls, G: float, cells: int) -> float:
    """Exit pressure of a mass flow less the wanted one [Pa]; a choked flow counts as far too
    large.
    """
    p = _exit_pressure(walls, G, cells)
    return -walls.p_out if p is None else p - walls.p_out


def _choked(walls: Walls, G: float, cells: int) -> Exception:
    """The complaint about a choked seal, with the lowest exit pressure that it can still follow."""
    # Exit pressure of a flow just short of choking: less by the smallest share, from 1e-15 to 1e-6,
    # that marches through.
    lowest = next(
        (
            p
            for i in range(6, 16)
            if (p := _exit_pressure(walls, G * (1 - 10.0 ** -(21 - i)), cells)) is not None
        ),
        walls.p_in,
    )
    flow = 2 * pi * walls.radius * G
    return invalid(
        "the exit pressure of the seal",
        f"{walls.p_out / 1e5:.6g} bar",
        f"above {lowest / 1e5:.5g} bar, where its flow chokes at {flow:.4g} kg/s",
        "raise the exit pressure, split the seal, or check its clearances, which are radial; a "
        "choked exit is not modelled",
    )


def _profile(walls: Walls, G: float, cells: int) -> StaticFlow:
    pressures, swirls = _march(walls, G, cells)
    z = _stations(walls.length, cells)
    H = walls.H_in + walls.taper * z
    p, U = np.array(pressures), np.array(swirls)

    # W' = -W (p'/p + H'/H), from rho W H = G
    dp, dU, W, _ = slopes(walls, G, p, U, H)
    return StaticFlow(G, z, H, p, U, W, dp, dU, -W * (dp / p + walls.taper / H))


# First-order flow of an annular gas seal: the pressure that a small whirl of the rotor raises.
#
# Two control volumes (Kleynhans & Childs 1997): the film of clearance H, and the cells of the
# stator, which hold gas at the film's pressure and carry no flow along the seal; their volume per
# wall area, ``storage``, enters as a capacitance:
#
#     d(rho (H + storage))/dt + d(rho U H)/(R dtheta) + d(rho W H)/dz = 0
#     rho H (dW/dt + U dW/(R dtheta) + W dW/dz) = -H dp/dz - tau_z
#     rho H (dU/dt + U dU/(R dtheta) + W dU/dz) = -H dp/(R dtheta) - tau_theta
#
# (gas enters and leaves a cell with the film's own velocity). With the clearance H + Re h e^{j(w t
# - n theta)}, n = 1 for a lateral whirl, p, U and W change by Re (p, u, w) e^{j(w t - n theta)}.
# The three linear equations q' = (M0 + j w M1) q + b0 + j w b1 in q = (p, u, w), with two
# conditions at the inlet and one at the exit, are solved by collocation at three Lobatto points per
# cell (Hermite-Simpson, fourth order) and one banded elimination per frequency.


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


_PRESWIRL = 2.0  # surface speeds; inlet swirl measured on test rigs stays below one
_GRID_ERROR = 1e-3  # between the grid and half of it


@dataclass(frozen=True, slots=True)
class Friction:
    """Blasius' law of a wall: Fanning factor f = coefficient Re^exponent, Re = 2 rho H V/mu, tau =
    f rho V^2/2.
    """

    coefficient: float = 0.079
    exponent: float = -0.25


@dataclass(frozen=True, slots=True)
class SealGeometry:
    """An annular seal: length, rotor diameter, radial clearances, hole_depth [m], hole_area_ratio
    of holes to stator wall [-].

    Friction of the walls (Blasius' smooth wall by default), inlet_loss [-] in p_in - p(0) = (1 +
    inlet_loss) rho W^2/2 and exit_recovery [-], the share of rho W^2/2 that becomes pressure again
    behind the exit.
    """

    length: float
    diameter: float
    inlet_clearance: float
    exit_clearance: float
    hole_depth: float = 0.0
    hole_area_ratio: float = 0.0
    rotor_friction: Friction = field(default_factory=Friction)
    stator_friction: Friction = field(default_factory=Friction)
    inlet_loss: float = 0.1
    exit_recovery: float = 0.0

    def __post_init__(self) -> None:
        for name in ("length", "diameter", "inlet_clearance", "exit_clearance"):
            check_positive(
                getattr(self, name),
                f"the {name} [m] of the seal",
                "give it in metres; clearances are radial",
            )
        for name in ("hole_depth", "hole_area_ratio", "inlet_loss", "exit_recovery"):
            check_positive(
                getattr(self, name),
                f"the {name} of the seal",
                "0 stands for none",
                zero_allowed=True,
            )
        for name in ("hole_area_ratio", "exit_recovery"):
            if getattr(self, name) > 1:
                raise invalid(
                    f"the {name} of the seal",
                    getattr(self, name),
                    "between 0 and 1",
                    "it is a share",
                )
        if 2 * max(self.inlet_clearance, self.exit_clearance) > 0.1 * self.diameter:
            clearance = max(self.inlet_clearance, self.exit_clearance)
            raise invalid(
                "the clearance [m] of the seal",
                clearance,
                "below 5 % of its diameter",
                "check its unit; it is radial",
            )
        for wall in ("rotor_friction", "stator_friction"):
            friction = getattr(self, wall)
            check_positive(
                friction.coefficient,
                f"the coefficient of the seal's {wall}",
                "Blasius' smooth wall has 0.079",
            )
            if not -1 <= friction.exponent <= 1:
                raise invalid(
                    f"the exponent of the seal's {wall}",
                    friction.exponent,
                    "within -1 to 1",
                    "-0.25 is Blasius'",
                )


@dataclass(frozen=True, slots=True)
class Gas:
    """gas_constant [J/(kg K)], viscosity [Pa s], compressibility Z [-]: p = Z gas_constant T
    rho.
    """

    gas_constant: float
    viscosity: float
    compressibility: float = 1.0

    def __post_init__(self) -> None:
        for name in ("gas_constant", "viscosity", "compressibility"):
            check_positive(getattr(self, name), f"the {name} of the gas", "give it in SI units")


def air(temperature: float, compressibility: float = 1.0) -> Gas:
    """Dry air at a temperature [K], viscosity by Sutherland's law (1.716e-5 Pa s at 273.15 K,
    constant 110.4 K).
    """
    T = check_positive(temperature, "the temperature [K] of the air", "give it in kelvin")
    return Gas(
        287.05, 1.716e-5 * (T / 273.15) ** 1.5 * (273.15 + 110.4) / (T + 110.4), compressibility
    )


@dataclass(frozen=True, slots=True)
class SealCondition:
    """Absolute pressures before and behind the seal [Pa], temperature [K], speed [rad/s], and the
    gas.

    preswirl [-]: circumferential velocity of the gas at the inlet over the rotor's surface speed,
    positive with the spin.
    """

    inlet_pressure: float
    exit_pressure: float
    temperature: float
    speed: float
    gas: Gas
    preswirl: float = 0.0

    def __post_init__(self) -> None:
        for name in ("inlet_pressure", "exit_pressure", "temperature"):
            check_positive(
                getattr(self, name), f"the {name} of the seal", "give an absolute value in SI units"
            )
        check_positive(
            self.speed,
            "the speed [rad/s] at the seal",
            "turn the frame so that the spin is positive",
            zero_allowed=True,
        )
        if not self.exit_pressure < self.inlet_pressure:
            required = f"below the inlet pressure {self.inlet_pressure:g}"
            raise invalid(
                "the exit_pressure [Pa] of the seal",
                self.exit_pressure,
                required,
                "swap the sides; the flow would reverse",
            )
        if not abs(self.preswirl) <= _PRESWIRL:
            required = f"within {-_PRESWIRL:g} to {_PRESWIRL:g}"
            raise invalid(
                "the preswirl [-] of the seal",
                self.preswirl,
                required,
                "divide the inlet swirl by the surface speed",
            )
        if self.preswirl and not self.speed:
            raise invalid(
                "the preswirl [-] of the seal",
                self.preswirl,
                "0 at rest",
                "it is a share of the surface speed",
            )


@dataclass(frozen=True, slots=True, eq=False)
class BulkFlow:
    """Coefficients (w,) at the frequencies (w,) [rad/s], K, k [N/m], C, c [N s/m], and the flow
    they belong to.

    f = -([[K, k], [-k, K]] x + [[C, c], [-c, C]] x'). leakage [kg/s]; profiles along z [m]:
    pressure [Pa], swirl and axial velocity [m/s], (s,). exit_mach [-]: isothermal Mach number at
    the exit. reynolds [-]: axial, 2 rho H W/mu. grid_error [-]: largest change of Z(w) from half as
    many cells, relative; the error itself is about a fifteenth of it.
    """

    frequencies: np.ndarray
    K: np.ndarray
    k: np.ndarray
    C: np.ndarray
    c: np.ndarray
    leakage: float
    z: np.ndarray
    pressure: np.ndarray
    swirl: np.ndarray
    axial_velocity: np.ndarray
    exit_mach: float
    reynolds: float
    grid_error: float

    @property
    def effective_damping(self) -> np.ndarray:
        """C - k/w (w,) [N s/m]: negative where the seal drives a forward whirl."""
        return self.C - self.k / self.frequencies

    @property
    def impedance(self) -> tuple[np.ndarray, np.ndarray]:
        """Direct K + j w C and cross-coupled k + j w c (w,) [N/m]."""
        return self.K + 1j * self.frequencies * self.C, self.k + 1j * self.frequencies * self.c


def bulk_flow(
    geometry: SealGeometry, condition: SealCondition, frequencies: ArrayLike, cells: int = 100
) -> BulkFlow:
    """Leakage and frequency-dependent coefficients of an annular gas seal.

    frequencies (w,) [rad/s]: whirl frequencies, positive. cells: of the axial grid, even; the
    result is checked against half of them. Raises InvalidInput (reverse or choked flow among
    others), NumericalFailure (no flow found, or the grid too coarse).
    """
    omega = check_shape(np.atleast_1d(frequencies), "frequencies", "(w,)").astype(float)
    if omega.size == 0 or omega.min() <= 0:
        value = omega.min() if omega.size else "empty"
        raise invalid(
            "the lowest whirl frequency [rad/s]",
            value,
            "positive",
            "take the limit from a low frequency, 1 rad/s say",
        )
    if cells < 4 or cells % 2:
        raise invalid("the number of cells", cells, "even and at least 4", "100 is the default")

    # on the grid and on half as many cells: what changes shows the grid's error
    walls = _walls(geometry, condition)
    flow, Z = _solve(walls, omega, cells)
    _, coarse = _solve(walls, omega, cells // 2)
    error = float(np.max(np.abs(Z - coarse) / np.abs(Z)))
    if not error < _GRID_ERROR:
        raise NumericalFailure(
            f"Z(w) of the seal changes by {error:.1e} from {cells // 2} to {cells} cells, more "
            f"than {_GRID_ERROR:g}; "
            f"use more cells, or stay away from choking (exit Mach number {_mach(walls, flow):.3f})"
        )

    # Z(+-w) = K +- c w + j (+-C w - k); leakage 2 pi R G; Re = 2 rho H W/mu = 2 G/mu
    forward, backward = Z
    return BulkFlow(
        frequencies=omega,
        K=(forward.real + backward.real) / 2,
        k=-(forward.imag + backward.imag) / 2,
        C=(forward.imag - backward.imag) / (2 * omega),
        c=(forward.real - backward.real) / (2 * omega),
        leakage=2 * pi * walls.radius * flow.G,
        z=flow.z,
        pressure=flow.p,
        swirl=flow.U,
        axial_velocity=flow.W,
        exit_mach=_mach(walls, flow),
        reynolds=2 * flow.G / walls.viscosity,
        grid_error=error,
    )


def seal_table(
    geometry: SealGeometry,
    condition: SealCondition,
    frequencies: Sequence[float],
    speeds: Sequence[float] | None = None,
    pressures: Sequence[float] | None = None,
) -> SealTable:
    """K, k, C, c over whirl frequencies [rad/s] and, where given, speeds [rad/s] and pressure drops
    [Pa], for a machine's seal.

    All ascending. A pressure drop is reached by the inlet pressure; the exit pressure stays the
    condition's. Raises as ``bulk_flow``.
    """
    axes: list[tuple[str, tuple[float, ...]]] = []
    for name, points in (("pressure", pressures), ("speed", speeds), ("frequency", frequencies)):
        if points is None:
            continue
        grid = check_shape(points, f"the {name} axis of the seal table", "(n,)").astype(float)
        if grid.size == 0 or (np.diff(grid) <= 0).any():
            raise invalid(
                f"the {name} axis of the seal table",
                grid.tolist(),
                "ascending",
                "sort it and drop repeated values",
            )
        axes.append((name, tuple(grid.tolist())))
    drops = [condition.inlet_pressure - condition.exit_pressure] if pressures is None else pressures
    grids: dict[str, list] = {name: [] for name in "KkCc"}
    for drop in drops:
        for speed in [condition.speed] if speeds is None else speeds:
            at = replace(condition, inlet_pressure=condition.exit_pressure + drop, speed=speed)
            result = bulk_flow(geometry, at, frequencies)
            for name, values in grids.items():
                values.append(getattr(result, name))
    shape = tuple(len(grid) for _, grid in axes)
    return SealTable(
        tuple(axes),
        tuple((name, np.reshape(values, shape).tolist()) for name, values in grids.items()),
    )


def _walls(geometry: SealGeometry, condition: SealCondition) -> Walls:
    surface_speed = 0.5 * geometry.diameter * condition.speed
    gas = condition.gas
    return Walls(
        length=geometry.length,
        radius=0.5 * geometry.diameter,
        H_in=geometry.inlet_clearance,
        H_out=geometry.exit_clearance,
        storage=geometry.hole_area_ratio * geometry.hole_depth,
        stator=(geometry.stator_friction.coefficient, geometry.stator_friction.exponent),
        rotor=(geometry.rotor_friction.coefficient, geometry.rotor_friction.exponent),
        inlet_loss=geometry.inlet_loss,
        exit_recovery=geometry.exit_recovery,
        a2=gas.compressibility * gas.gas_constant * condition.temperature,
        viscosity=gas.viscosity,
        surface_speed=surface_speed,
        inlet_swirl=condition.preswirl * surface_speed,
        p_in=condition.inlet_pressure,
        p_out=condition.exit_pressure,
    )


def _solve(walls: Walls, omega: np.ndarray, cells: int) -> tuple[StaticFlow, np.ndarray]:
    """Zeroth-order flow and Z (2, w) [N/m] for forward and backward whirl."""
    flow = static_flow(walls, cells)
    both = whirl_flow(walls, flow, np.concatenate([omega, -omega]))

    # pi R int p dz = Z r and p = -mean_p r
    return flow, -pi * walls.radius * both.mean_p.reshape(2, -1)  # h = -r


def _mach(walls: Walls, flow: StaticFlow) -> float:
    return float(flow.W[-1] / np.sqrt(walls.a2))
