"""The two magnets of a thrust bearing: flux and force of each from its circuit, the pair at an
operating point, and what it can carry.

One stator: the coil's N I drives the flux phi through the inner pole's gap, the collar, the outer
pole's gap and the back wall,

    N I = rho g phi + R_f phi phi_s/(phi_s - phi) + (c sqrt(s)) phi,    rho = (1/A_i + 1/A_o)/mu_0,

air, iron (Froehlich's curve, flux phi_s never passed; a straight line without such a limit) and the
eddy currents of a solid core (``half_order``). It pulls with F = rho phi^2/2: Maxwell's stress
B^2/(2 mu_0) over both faces, and the derivative of the co-energy N int phi dI over the gap.

At rest, with R = rho g + R_f (phi_s/(phi_s - phi))^2 what the flux meets for small changes,

    dF/dI = rho phi N/R,    dF/dx = (rho phi)^2/R,    the one over the other rho phi/N.

Both come late by h = 1/(1 + tau sqrt(s)), tau = c/R. Leakage and fringing are left out.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from ambrose.core.bracketed_root import bracketed_root
from ambrose.core.checks import InvalidInput
from ambrose.machine.axial import AxialMachine, Condition
from ambrose.machine.description import OperatingPoint, Tolerance
from ambrose.machine.thrust import Pair, ThrustBearing, ThrustStator
from ambrose.model.axial.half_order import CORNER, Lags, core_constant, half_order, lags
from ambrose.model.magnetics.vacuum import VACUUM_PERMEABILITY

_LARGEST = 20.0  # times the bias: up to where the control current is looked for without a limit


@dataclass(frozen=True, slots=True)
class Side:
    """One stator with its collar's face: turns N, bias [A], gap g [m] at the centre, faces [m2],
    iron R_f [A/Wb], flux limit phi_s [Wb] (inf: none), solid core c [A sqrt(s)/Wb] (0: laminated).
    """

    turns: float
    bias: float
    gap: float
    inner_area: float
    outer_area: float
    iron: float
    flux_limit: float
    core: float

    @property
    def slope(self) -> float:
        """rho [A/(Wb m)]: reluctance per gap."""
        return (1 / self.inner_area + 1 / self.outer_area) / VACUUM_PERMEABILITY

    def flux(self, current: float, gap: float) -> float:
        """phi [Wb] at rest: the root below phi_s of rho g phi^2 - q phi + N I phi_s = 0."""
        drive, air = self.turns * max(current, 0.0), self.slope * gap
        if math.isinf(self.flux_limit):
            return drive / (air + self.iron)
        q = drive + (air + self.iron) * self.flux_limit
        root = math.sqrt(max(q * q - 4 * air * drive * self.flux_limit, 0.0))
        return 2 * drive * self.flux_limit / (q + root)

    def force(self, current: float, gap: float) -> float:
        """F [N] >= 0, towards this side."""
        return self.slope * self.flux(current, gap) ** 2 / 2

    def met(self, flux: float, gap: float) -> float:
        """R [A/Wb], what a small change of flux meets."""
        if math.isinf(self.flux_limit):
            return self.slope * gap + self.iron
        return self.slope * gap + self.iron * (self.flux_limit / (self.flux_limit - flux)) ** 2

    @property
    def tau(self) -> float:
        """tau [sqrt(s)] of the solid core, with the collar centred and iron that is not loaded."""
        return self.core / self.met(0.0, self.gap)


@dataclass(frozen=True, slots=True)
class AtPoint:
    """One side at an operating point: force per current [N/A] and per displacement [N/m] at rest,
    both positive; ratio: what the flux meets over what it meets at the centre, unloaded.
    """

    force_per_current: float
    stiffness: float
    ratio: float


@dataclass(frozen=True, slots=True)
class Loaded:
    """Both magnets at an operating point: sides (left, right), static control current [A], largest
    static forces (to the left, to the right) [N] there, load [N] and place [m].
    """

    left: AtPoint
    right: AtPoint
    current: float
    capacity: Pair
    load: float
    place: float

    @property
    def force_per_current(self) -> float:
        """k_i [N/A] of the pair."""
        return self.left.force_per_current + self.right.force_per_current

    @property
    def stiffness(self) -> float:
        """k_s [N/m] of the pair, positive where it destabilises."""
        return self.left.stiffness + self.right.stiffness


@lru_cache(maxsize=64)
def sides(part: ThrustBearing) -> tuple[Side, Side]:
    """The circuits of the left and the right magnet."""
    left, right = (
        _side(part, stator, gap, bias)
        for stator, gap, bias in zip(part.pair, part.gap, part.bias_current, strict=True)
    )
    return left, right


def _side(part: ThrustBearing, stator: ThrustStator, gap: float, bias: float) -> Side:
    inner, outer = stator.inner_pole, (stator.outer_pole[0], part.collar_radius)
    a_i, a_o = (part.face_scale * math.pi * (r[1] ** 2 - r[0] ** 2) for r in (inner, outer))
    gap *= part.gap_scale
    mu = VACUUM_PERMEABILITY * part.permeability
    # cylinders of the slot's depth, discs between the poles' middles: ln(r_o/r_i)/(2 pi mu t)
    disc = math.log((sum(outer) / 2) / (sum(inner) / 2)) / (2 * math.pi * mu)
    iron = stator.slot_depth / mu * (1 / a_i + 1 / a_o)
    iron += disc / stator.back_wall + disc / part.collar_thickness
    limit = math.inf
    if part.flux_density is not None:
        # the narrowest: a face, or wall or collar where the flux enters them, 2 pi r t
        around = 2 * math.pi * inner[1]
        narrow = min(a_i, a_o, around * stator.back_wall, around * part.collar_thickness)
        limit = part.flux_density * narrow
    side = Side(stator.turns, bias, gap, a_i, a_o, iron, limit, 0.0)
    if part.core == "laminated":
        return side
    if part.core_corner is not None:
        # tau sqrt(w) = (sqrt(6) - sqrt(2))/2 at the corner
        c = CORNER / math.sqrt(part.core_corner) * side.met(0.0, gap)
    else:
        c = core_constant(part.conductivity, part.permeability, inner, outer, stator.slot_depth)
    return Side(stator.turns, bias, gap, a_i, a_o, iron, limit, part.core_scale * c)


def force(part: ThrustBearing, current: float, place: float) -> float:
    """Force [N] along z at rest, at a control current [A] with the collar at a place [m]."""
    left, right = sides(part)
    return right.force(right.bias + current, right.gap - place) - left.force(
        left.bias - current, left.gap + place
    )


def capacity(part: ThrustBearing, place: float) -> Pair:
    """The largest static forces [N] to the left and to the right at a place [m]: at the largest
    control current (else the smaller bias), and within max_force.
    """
    most = part.max_current or min(part.bias_current)
    limit = math.inf if part.max_force is None else part.max_force
    return min(-force(part, -most, place), limit), min(force(part, most, place), limit)


@lru_cache(maxsize=256)
def loaded(part: ThrustBearing, load: float, place: float) -> Loaded:
    """Both magnets while they hold the collar at a place [m] against a load [N].

    Raises InvalidInput where no control current does.
    """
    largest = capacity(part, place)
    most = part.max_current or _LARGEST * max(part.bias_current)
    low, high = (force(part, i, place) + load for i in (-most, most))
    if not low < 0 < high:
        towards = "right" if load < 0 else "left"
        raise InvalidInput(
            f"[[thrust_bearing]] {part.name} reaches {largest[load < 0]:,.4g} N to the {towards}, "
            f"but the process thrust is {abs(load):,.4g} N: nothing holds the rotor; raise "
            "max_current or the poles' areas, or correct the load"
        )
    current = bracketed_root(lambda i: force(part, i, place) + load, -most, most, absolute=1e-14)
    left, right = sides(part)
    parts = []
    for side, coil, gap in (
        (left, left.bias - current, left.gap + place),
        (right, right.bias + current, right.gap - place),
    ):
        phi = side.flux(coil, gap)
        met = side.met(phi, gap)
        # dF/dI = rho phi N/R, dF/dx = (rho phi)^2/R; a coil without current makes no change
        per_current = side.slope * phi * side.turns / met if coil > 0 else 0.0
        parts.append(
            AtPoint(per_current, (side.slope * phi) ** 2 / met, met / side.met(0.0, side.gap))
        )
    return Loaded(parts[0], parts[1], current, largest, load, place)


def at_point(machine: AxialMachine, point: OperatingPoint) -> Loaded:
    """The magnets at an operating point of the axis. Raises InvalidInput as ``loaded`` does, with
    machine and point.
    """
    condition: Condition = machine.condition(point)
    try:
        return loaded(machine.thrust, condition.load, condition.place)
    except InvalidInput as error:
        label = point.label or condition.label
        raise InvalidInput(f"{machine.name}, operating point {label!r}: {error}") from None


def core_lags(part: ThrustBearing) -> tuple[Lags | None, Lags | None]:
    """The rational model of each side's solid core, (left, right); None of laminated ones."""
    left, right = (lags(side.tau) if side.core else None for side in sides(part))
    return left, right


def closed_lags(model: Lags, ratio: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A (n, n) [1/s], B (n,) [1/s], C (n,): the core's lag where the flux meets ``ratio`` times the
    reluctance that the lags were fitted for, with unit gain at rest.

    (R_0 + c sqrt(s)) phi = v - (R - R_0) phi: around h = 1/(1 + tau sqrt(s)) the feedback
    ratio - 1, for v of ratio.
    """
    p, g = model.poles, model.weights
    A = -np.diag(p) - (ratio - 1) * np.outer(p, g)
    return A, ratio * p, g.copy()


def left_out(
    machine: AxialMachine,
    point: OperatingPoint,
    omega: np.ndarray,
    offsets: Sequence[tuple[Tolerance, float]] = (),
) -> np.ndarray:
    """What the exact half-order cores add to the plant's rational ones at omega (w,) [rad/s], (2,
    w): force per current [N/A], and per displacement [N/m]; offsets: as of the plant.
    """
    at = at_point(machine, point)

    # what tolerances make of both forces and of c, as factors
    factors = {
        "force_per_current": at.force_per_current,
        "negative_stiffness": at.stiffness,
        "core_scale": machine.thrust.core_scale,
    }
    for name, value in factors.items():
        factors[name] = 1.0 + sum(
            delta * ((item.relative or 0.0) + (item.absolute or 0.0) / value)
            for item, delta in offsets
            if item.parameter == f"thrust_bearing.{machine.thrust.name}.{name}"
        )
    by_current, by_place, by_core = factors.values()
    added = np.zeros((2, len(omega)), complex)
    for side, model, item in zip(
        sides(machine.thrust), core_lags(machine.thrust), (at.left, at.right), strict=True
    ):
        if model is None:
            continue
        # 1/h - 1 = tau sqrt(s), over the ratio of the reluctance that is met
        exact, fitted = (
            1 / (1 + (1 / h - 1) * by_core / item.ratio)
            for h in (half_order(omega, side.tau), model.response(omega))
        )
        forces = [by_current * item.force_per_current, by_place * item.stiffness]
        added += np.outer(forces, exact - fitted)
    return added


def tilt_stiffness(part: ThrustBearing) -> float:
    """The negative stiffness of the collar against tilting [N m/rad], positive where it
    destabilises, both sides, unloaded and centred.

    The gap under a face at (r, angle) becomes g + r sin(angle) phi_t. With the iron at one
    potential per face its permeance grows,

        P = P_0 (1 + <r^2> phi_t^2/(2 g^2)),    <r^2> = (r_1^2 + r_2^2)/2 of the ring,

    and the co-energy (N I)^2/(2 R) at constant current gives the moment k phi_t with

        k = phi^2 (R_i <r^2>_i + R_o <r^2>_o)/(2 g^2),    R_i and R_o of the two gaps.
    """
    total = 0.0
    for side, stator in zip(sides(part), part.pair, strict=True):
        phi = side.flux(side.bias, side.gap)
        for radii, area in (
            (stator.inner_pole, side.inner_area),
            ((stator.outer_pole[0], part.collar_radius), side.outer_area),
        ):
            reluctance = side.gap / (VACUUM_PERMEABILITY * area)
            square = (radii[0] ** 2 + radii[1] ** 2) / 2
            total += phi**2 * reluctance * square / (2 * side.gap**2)
    return total
