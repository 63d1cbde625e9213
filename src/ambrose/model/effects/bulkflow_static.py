"""Zeroth-order flow of an annular gas seal: leakage, pressure, swirl and axial velocity with the
rotor in the centre.

Isothermal ideal gas, p = rho a^2 with a^2 = Z R T; bulk velocities U around and W along the seal,
clearance H(z):

    G = rho W H = constant
    G U' = -(tau_s U/V_s + tau_r (U - R Omega)/V_r)
    G W' = -H p' - (tau_s W/V_s + tau_r W/V_r)

with Blasius' friction at each wall, tau = 1/2 rho V^2 n (2 rho H V/mu)^m, V the speed relative to
the wall (Hirs 1973; Nelson 1985; Kleynhans & Childs 1997). At the inlet p_in - p(0) = 1/2 (1 +
inlet_loss) rho W^2, at the exit p_out - p(L) = 1/2 exit_recovery rho W^2. Where W reaches a the
flow chokes.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise
from math import pi, sqrt

import numpy as np

from ambrose.core.bracketed_root import bracketed_root
from ambrose.core.checks import NumericalFailure, invalid

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
