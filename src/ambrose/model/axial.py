"""The axis along the shaft: the lag of a thrust magnet's solid core."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
import scipy.linalg as sla
from numpy.typing import ArrayLike

from ambrose.core.checks import InvalidInput, check_positive
from ambrose.core.frequency import bracketed_root
from ambrose.core.statespace import StateSpace
from ambrose.machine.description import OperatingPoint, Tolerance
from ambrose.machine.machine import Condition, Machine
from ambrose.machine.thrust import Pair, ThrustBearing, ThrustStator
from ambrose.model.effects.rotor import finite_element_rotor, mass_properties
from ambrose.model.magnetics import VACUUM_PERMEABILITY

# The half-order lag of a solid core, and its passive rational model.
#
# Eddy currents hold the flux of a solid core in a skin, whose reluctance grows with the square root
# of the frequency (Zhu, Knospe and Maslen, IEEE Trans. Magn. 41(4) 2005):
#
#     R(s) = R_0 + c sqrt(s),    h(s) = R_0/R(s) = 1/(1 + tau sqrt(s)),    tau = c/R_0,
#     c = sqrt(sigma/mu) (L_i/(2 pi r_i) + 2 ln(r_o/r_i)/(2 pi) + L_o/(2 pi r_o)),
#
# inner cylinder, back wall and collar as two discs, outer cylinder. Force per current and negative
# stiffness both pass h. With u = tau sqrt(w), h = 1/(1 + u (1 + j)/sqrt(2)): the gain is -3 dB and
# the phase -15 deg where u^2 + sqrt(2) u = 1, u = (sqrt(6) - sqrt(2))/2; the phase never passes
# -45 deg.
#
# h is a Stieltjes function, h(s) = integral over p of rho(p)/(s + p) with rho = tau sqrt(p)/(pi (1
# + tau^2 p)) >= 0, so that a sum of real lags with positive weights, g_k/(1 + s/p_k), can come as
# close as it likes: such a model is passive whatever its weights.


CORNER = (math.sqrt(6) - math.sqrt(2)) / 2  # tau sqrt(w) at -3 dB and -15 deg
BAND = (0.1, 5000.0)  # [Hz]
WITHIN = (0.1, 1.0)  # [dB], [deg] over the band
_MOST = 8  # states
_POINTS = 160  # of the band, evenly by logarithm, at which the model is fitted and its error taken
_WIDE = 2.0  # decades beyond the band that the poles cover


def half_order(omega: ArrayLike, tau: float) -> np.ndarray:
    """h(j omega) (w,) at omega [rad/s], tau [sqrt(s)]."""
    return np.asarray(1 / (1 + tau * np.sqrt(1j * np.asarray(omega, dtype=float))))


@dataclass(frozen=True, slots=True, eq=False)
class Lags:
    """sum g_k/(1 + s/p_k): weights g (n,) > 0 of sum 1, poles p (n,) [rad/s].

    gain_error [dB] and phase_error [deg]: the largest over the band. rest: the largest |h - model|
    at all frequencies, what an unmodelled weight has to cover.
    """

    weights: np.ndarray
    poles: np.ndarray
    gain_error: float
    phase_error: float
    rest: float

    def response(self, omega: ArrayLike) -> np.ndarray:
        """(w,) at omega [rad/s]."""
        return _response(np.asarray(omega, dtype=float), self.weights, self.poles)

    def system(self, source: str, output: str, scale: float = 1.0) -> StateSpace:
        """x_k' = p_k (source/scale - x_k), output = scale g^T x; without lags output = source."""
        n = len(self.poles)
        return StateSpace(
            -np.diag(self.poles),
            self.poles[:, None] / scale,
            self.weights[None] * scale,
            np.full((1, 1), 0.0 if n else 1.0),
            [source],
            [output],
        )


def _response(omega: np.ndarray, weights: np.ndarray, poles: np.ndarray) -> np.ndarray:
    return np.asarray((weights / (1 + 1j * omega[:, None] / poles)).sum(axis=1))


@lru_cache(maxsize=32)
def lags(tau: float, states: int | None = None) -> Lags:
    """The rational model of tau [sqrt(s)] with the fewest states within 0.1 dB and 1 deg from 0.1
    Hz to 5 kHz; at most 8. states: so many, however close they come.

    Raises InvalidInput where 8 states do not come so close.
    """
    check_positive(tau, "tau [sqrt(s)] of the solid core", "leave the core laminated")
    numbers = range(2, _MOST + 1) if states is None else (states,)
    for n in numbers:
        found = _fitted(tau, n)
        if found.gain_error <= WITHIN[0] and found.phase_error <= WITHIN[1]:
            return found
    if states is not None:
        return found
    raise InvalidInput(
        f"the rational model of a solid core of tau = {tau:.3g} sqrt(s) is "
        f"{found.gain_error:.2g} dB and {found.phase_error:.2g} deg off with {_MOST} states, more "
        f"than {WITHIN[0]:g} dB and {WITHIN[1]:g} deg; correct the core's conductivity, "
        "permeability and radii"
    )


def _fitted(tau: float, n: int) -> Lags:
    """Least squares of gain and phase errors over their bounds, then of their higher powers, which
    levels them.
    """
    omega = 2 * np.pi * np.geomspace(*BAND, _POINTS)
    wanted = half_order(omega, tau)

    def unpacked(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        g = np.exp(x[:n] - x[:n].max())
        return g / g.sum(), np.exp(x[n:])

    def errors(x: np.ndarray) -> np.ndarray:
        ratio = np.log(_response(omega, *unpacked(x)) / wanted)
        # 20 log10 of the gain in dB, the angle in degrees
        gain = ratio.real * 20 / math.log(10) / WITHIN[0]
        return np.concatenate([gain, np.degrees(ratio.imag) / WITHIN[1]])

    low, high = 2 * np.pi * BAND[0] / 10**0.5, 2 * np.pi * BAND[1] * 10**_WIDE
    poles = np.geomspace(low, high, n)
    # rho dp at the nodes, over p for the gain of each lag
    rho = tau * np.sqrt(poles) / (np.pi * (1 + tau**2 * poles))
    start = np.concatenate([np.log(rho), np.log(poles)])
    from scipy.optimize import least_squares

    found = least_squares(errors, start, max_nfev=200).x
    for power in (2, 4):
        found = least_squares(
            lambda x, p=power: np.sign(errors(x)) * np.abs(errors(x)) ** p, found, max_nfev=60
        ).x
    weights, poles = unpacked(found)
    order = np.argsort(poles)
    weights, poles = weights[order], poles[order]
    fine = 2 * np.pi * np.geomspace(*BAND, 2000)
    ratio = np.log(_response(fine, weights, poles) / half_order(fine, tau))
    everywhere = np.geomspace(1e-6, 1e12, 4000)
    rest = np.abs(_response(everywhere, weights, poles) - half_order(everywhere, tau)).max()
    return Lags(
        weights,
        poles,
        float(np.abs(ratio.real).max() * 20 / math.log(10)),
        float(np.degrees(np.abs(ratio.imag)).max()),
        float(rest),
    )


def core_constant(
    conductivity: float,
    permeability: float,
    inner: tuple[float, float],
    outer: tuple[float, float],
    slot: float,
) -> float:
    """c [A sqrt(s)/Wb] of one side: conductivity [S/m], relative permeability, radii [m] of the
    inner and of the outer pole's face (inner, outer edge), depth of the coil's slot [m].

    The inner cylinder's flux runs in the skin at its outer edge, the outer cylinder's at its inner
    edge, back wall and collar as discs between the two.
    """
    mu = 4e-7 * math.pi * permeability
    r_i, r_o = inner[1], outer[0]
    surfaces = slot / r_i + 2 * math.log(r_o / r_i) + slot / r_o
    return math.sqrt(conductivity / mu) * surfaces / (2 * math.pi)


# The two magnets of a thrust bearing: flux and force of each from its circuit, the pair at an
# operating point, and what it can carry.
#
# One stator: the coil's N I drives the flux phi through the inner pole's gap, the collar, the outer
# pole's gap and the back wall,
#
#    N I = rho g phi + R_f phi phi_s/(phi_s - phi) + (c sqrt(s)) phi,    rho = (1/A_i + 1/A_o)/mu_0,
#
# air, iron (Froehlich's curve, flux phi_s never passed; a straight line without such a limit) and
# the eddy currents of a solid core (``half_order``). It pulls with F = rho phi^2/2: Maxwell's
# stress B^2/(2 mu_0) over both faces, and the derivative of the co-energy N int phi dI over the
# gap.
#
# At rest, with R = rho g + R_f (phi_s/(phi_s - phi))^2 what the flux meets for small changes,
#
#     dF/dI = rho phi N/R,    dF/dx = (rho phi)^2/R,    the one over the other rho phi/N.
#
# Both come late by h = 1/(1 + tau sqrt(s)), tau = c/R. Leakage and fringing are left out.


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
            f"but the process thrust is {abs(load):,.4g} N: the rotor cannot be levitated; "
            "raise max_current or the poles' areas, or correct the load"
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


def at_point(machine: Machine, point: OperatingPoint) -> Loaded:
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
    machine: Machine,
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


# What an identification found of the thrust magnets, as a thrust bearing that has it.


_CLOSE = 1e-6  # relative, of both coefficients
_BOUNDS = (0.2, 5.0)  # of the scales: beyond, the magnet is another one


def with_found(
    part: ThrustBearing, load: float, place: float, k_i: float, k_s: float
) -> ThrustBearing:
    """The bearing whose force per current [N/A] and negative stiffness [N/m] at an operating point
    are these: its faces and its air gaps scaled, all else as it is.

    k_i goes with the area over the gap squared, k_s with the area over its cube, so that two
    numbers say both. Raises InvalidInput where no such scales are found.
    """

    def scaled(x: np.ndarray) -> ThrustBearing:
        return replace(part, face_scale=float(np.exp(x[0])), gap_scale=float(np.exp(x[1])))

    def off(x: np.ndarray) -> np.ndarray:
        try:
            at = loaded(scaled(x), load, place)
        except InvalidInput:  # too weak for its load
            return np.full(2, 10.0)
        return np.log([at.force_per_current / k_i, at.stiffness / k_s])

    start = np.log([part.face_scale, part.gap_scale])
    from scipy.optimize import least_squares

    found = least_squares(
        off, start, bounds=np.log([[_BOUNDS[0]] * 2, [_BOUNDS[1]] * 2]), xtol=1e-15
    )
    if np.abs(found.fun).max() > _CLOSE:
        raise InvalidInput(
            f"no thrust magnet of {part.name}'s kind has {k_i:.4g} N/A and {k_s:.4g} N/m; check "
            "the record's signals and units, or identify one of the two alone"
        )
    return scaled(found.x)


# The plant of the axis along the shaft:
#
#     m x'' + d x' + k x = F + h_left v_left + h_right v_right,    v = k_i i + k_s x of each side,
#
# rotor mass, coupling to ground, external force, and both magnets' forces after their solid cores
# (none: at once). The signals are those of any plant (``model.plant``), its one port and axis
# called <thrust bearing>_z. f_left_<axis> and f_right_<axis> [N] are the forces before the cores.


_SCALE = 300.0  # [rad/s] of the velocity's state, as of the rigid modes of the radial plant
_SAME = 1e-12  # relative: cores that lag alike are one


def rotor_mass(machine: Machine) -> float:
    """The mass that moves along the axis [kg]: the whole rotor's."""
    return float(mass_properties(finite_element_rotor(machine)).mass)


def rotor_statespace(machine: Machine, point: OperatingPoint) -> StateSpace:
    """Inputs f_<axis>, f_left_<axis>, f_right_<axis> [N]; outputs q_<axis>, s_<axis> [m] and
    qdot_<axis> [m/s], and core_left_<axis> [N], what the eddy currents take of the left magnet's
    force, or of both where these are alike, else core_right_<axis> as well; the negative stiffness
    closed.

    States: x [m], x'/300 [m], then those of the cores [N]. Raises InvalidInput where the magnets
    cannot carry the point's load.
    """
    (axis,), part = machine.axes, machine.thrust
    mass, at = rotor_mass(machine), at_point(machine, point)
    models = core_lags(part)

    # banks: the lags of the left and of the right side, one where they are alike
    sizes: list[tuple[np.ndarray, np.ndarray, np.ndarray]] = []
    into: list[list[float]] = []
    direct = [0.0, 0.0]
    for number, (model, item) in enumerate(zip(models, (at.left, at.right), strict=True)):
        if model is None:
            direct[number] = 1.0
        elif sizes and _alike(sizes[0], closed_lags(model, item.ratio)):
            into[0][number] = 1.0
        else:
            sizes.append(closed_lags(model, item.ratio))
            into.append([float(number == k) for k in range(2)])

    # x' = _SCALE z, z' = (F + sum C z_k + direct v - k x - d _SCALE z)/(m _SCALE),
    # z_k' = A z_k + B v
    k_s = np.array([at.left.stiffness, at.right.stiffness])
    lags = sla.block_diag(*[A for A, *_ in sizes]) if sizes else np.zeros((0, 0))
    n = len(lags)
    drive = np.vstack(
        [np.outer(B, row) for (_, B, _), row in zip(sizes, into, strict=True)] or [np.zeros((0, 2))]
    )
    out = np.concatenate([C for *_, C in sizes]) if sizes else np.zeros(0)
    A = np.zeros((2 + n, 2 + n))
    A[0, 1] = _SCALE
    A[1, 0] = (np.dot(direct, k_s) - part.coupling_stiffness) / (mass * _SCALE)
    A[1, 1] = -part.coupling_damping / mass
    A[1, 2:] = out / (mass * _SCALE)
    A[2:, 0] = drive @ k_s
    A[2:, 2:] = lags
    B = np.zeros((2 + n, 3))
    B[1] = np.array([1.0, *direct]) / (mass * _SCALE)
    B[2:, 1:] = drive
    C, D = np.zeros((3 + len(sizes), 2 + n)), np.zeros((3 + len(sizes), 3))
    C[0, 0] = C[1, 0] = 1.0
    C[2, 1] = _SCALE

    # what the eddy currents of every bank take: v - C z, the force without them less that with them
    cores, at_state = [], 2
    for number, ((_, _, part_out), row) in enumerate(zip(sizes, into, strict=True)):
        C[3 + number, 0] = np.dot(row, k_s)
        C[3 + number, at_state : at_state + len(part_out)] = -part_out
        D[3 + number, 1:] = row
        at_state += len(part_out)
        cores.append(f"core_{machine.magnets[row.index(1.0)]}")
    return StateSpace(
        A,
        B,
        C,
        D,
        [f"f_{name}" for name in (axis, *machine.magnets)],
        [f"q_{axis}", f"s_{axis}", f"qdot_{axis}", *cores],
    )


def _alike(one: tuple[np.ndarray, ...], other: tuple[np.ndarray, ...]) -> bool:
    return all(
        a.shape == b.shape and np.allclose(a, b, rtol=_SAME, atol=0.0)
        for a, b in zip(one, other, strict=True)
    )
