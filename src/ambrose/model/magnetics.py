"""Magnets from their geometry: a network of gaps, iron, coils and permanent magnets."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import cho_factor, cho_solve, null_space

from ambrose.core.checks import InvalidInput, check_positive, check_shape, invalid
from ambrose.machine.part import Magnet

# The permeability of vacuum.


VACUUM_PERMEABILITY = 4e-7 * math.pi  # mu_0 [V s/(A m)]; the measured value differs by 1e-10


# The curve of iron, H over B, with its derivative and the energy below it.


@dataclass(frozen=True, slots=True)
class Froehlich:
    """H = B/(mu_0 mu_r (1 - |B|/B_s)): permeability mu_r without field, and a flux density B_s [T]
    that is never reached (Froehlich's hyperbola). Raises InvalidInput where one is not positive.
    """

    permeability: float
    flux_density: float

    def __post_init__(self) -> None:
        check_positive(self.permeability, "the relative permeability of iron", "3000 is usual")
        check_positive(self.flux_density, "the saturation [T] of iron", "1.8 T is usual")

    @property
    def limit(self) -> float:
        """The flux density [T] that the iron never reaches."""
        return self.flux_density

    def field(self, flux_density: ArrayLike) -> np.ndarray:
        """H [A/m] at B [T] of any shape."""
        b = np.asarray(flux_density, dtype=float)
        return b / (self._initial * (1 - np.abs(b) / self.flux_density))

    def slope(self, flux_density: ArrayLike) -> np.ndarray:
        """dH/dB [A/(T m)] at B [T]."""
        b = np.abs(np.asarray(flux_density, dtype=float)) / self.flux_density
        return 1 / (self._initial * (1 - b) ** 2)

    def energy(self, flux_density: ArrayLike) -> np.ndarray:
        """Integral of H over B from 0 [J/m3]: B_s^2/(mu_0 mu_r) (-ln(1 - b) - b), b = |B|/B_s."""
        b = np.abs(np.asarray(flux_density, dtype=float)) / self.flux_density
        return self.flux_density**2 / self._initial * (-np.log1p(-b) - b)

    @property
    def _initial(self) -> float:
        return VACUUM_PERMEABILITY * self.permeability


@dataclass(frozen=True, slots=True)
class MeasuredCurve:
    """A measured curve: field H [A/m] at rising flux densities B [T], both without their origin.

    Between the points a monotone cubic; beyond the last one the slope of vacuum, 1/mu_0. Raises
    InvalidInput where either does not rise.
    """

    flux_densities: tuple[float, ...]
    fields: tuple[float, ...]

    def __post_init__(self) -> None:
        b = np.concatenate([[0.0], check_shape(self.flux_densities, "B of a curve [T]", "(n)")])
        h = np.concatenate([[0.0], check_shape(self.fields, "H of a curve [A/m]", "(n)")])
        if len(b) != len(h) or len(b) < 3 or np.diff(b).min() <= 0 or np.diff(h).min() <= 0:
            raise invalid(
                "the B-H curve of iron",
                f"{len(b) - 1} flux densities and {len(h) - 1} fields",
                "two or more pairs of B and H, both rising from zero",
                "sort the points and leave out the origin",
            )

    @property
    def limit(self) -> float:
        """There is none: beyond the curve iron is vacuum."""
        return np.inf

    def field(self, flux_density: ArrayLike) -> np.ndarray:
        """H [A/m] at B [T] of any shape."""
        b, beyond = self._split(flux_density)
        return np.sign(flux_density) * (self._curve()(b) + beyond / VACUUM_PERMEABILITY)

    def slope(self, flux_density: ArrayLike) -> np.ndarray:
        """dH/dB [A/(T m)] at B [T]."""
        b, beyond = self._split(flux_density)
        return np.where(beyond > 0, 1 / VACUUM_PERMEABILITY, self._curve().derivative()(b))

    def energy(self, flux_density: ArrayLike) -> np.ndarray:
        """Integral of H over B from 0 [J/m3]."""
        b, beyond = self._split(flux_density)
        last = float(self.fields[-1])
        return np.asarray(
            self._curve().antiderivative()(b)
            + last * beyond
            + beyond**2 / (2 * VACUUM_PERMEABILITY)
        )

    def _split(self, flux_density: ArrayLike) -> tuple[np.ndarray, np.ndarray]:
        """|B| on the curve, and what is beyond its end."""
        b = np.abs(np.asarray(flux_density, dtype=float))
        last = self.flux_densities[-1]
        return np.minimum(b, last), np.maximum(b - last, 0.0)

    def _curve(self) -> Any:
        from scipy.interpolate import PchipInterpolator

        return PchipInterpolator((0.0, *self.flux_densities), (0.0, *self.fields))


IronCurve = Froehlich | MeasuredCurve


# A magnetic network: branches between nodes, solved for their fluxes; forces, inductances and
# stiffnesses by derivative.
#
# The fluxes phi of the branches have no sources: phi = Z y, with Z the loops of the graph. They
# minimise the convex function
#
#     Psi(y) = sum_b W_b(phi_b, x) - (N i + F_m)^T phi,      phi = Z y,
#
# W_b being the energy of a branch, N the turns, i the currents, F_m the magnetomotive force of the
# permanent magnets. Its minimum is minus the co-energy. W of a gap s = s_0 - n.x with area A is
# phi^2 s/(2 mu_0 A), and everything else follows by derivative of the same function:
#
#    force            f = -dW/dx = sum phi^2/(2 mu_0 A) n            (Maxwell's stress B^2/(2 mu_0))
#    flux linkage     lambda = N^T phi
#    with H = Z^T W'' Z, S = Z H^-1 Z^T and the gaps' G = phi n/(mu_0 A):
#    inductance       dlambda/di = N^T S N
#    force by current df/di = G^T S N = (dlambda/dx)^T, the back-EMF per velocity
#    stiffness        df/dx = G^T S G, positive: it destabilises (Earnshaw)


_ITERATIONS = 200  # of Newton's method, at most; assumed
_CLOSE = 1e-12  # Newton's decrement over the energy


@dataclass(frozen=True, slots=True)
class Branch:
    """One flux tube from node to node, of an area [m2] and a length [m] along the flux.

    curve: its iron; None: air. normal (k,): of an air gap, the direction in which the rotor's
    motion closes it (its length is then the gap's at the centre); () where it does not move.
    remanence [T] and permeability: of a permanent magnet whose field points from start to end.
    """

    start: int
    end: int
    area: float
    length: float
    name: str = ""
    normal: tuple[float, ...] = ()
    curve: IronCurve | None = None
    remanence: float = 0.0
    permeability: float = 1.0

    def __post_init__(self) -> None:
        where = f"magnetic branch {self.name or f'{self.start}-{self.end}'}"
        check_positive(self.area, f"the area [m2] of {where}", "give the section of the flux")
        check_positive(self.length, f"the length [m] of {where}", "give the path of the flux")
        check_positive(self.permeability, f"the permeability of {where}", "1.05 is usual")


@dataclass(frozen=True, slots=True, eq=False)
class MagneticState:
    """flux (b,) [Wb] and flux_density (b,) [T] of the branches; force (k,) [N] on the rotor;
    linkage (c,) [Wb] of the coils; inductance (c, c) [H]; force_per_current (k, c) [N/A], whose
    transpose is the back-EMF per velocity [V s/m]; stiffness (k, k) [N/m], positive where it
    destabilises; coenergy [J].
    """

    flux: np.ndarray
    flux_density: np.ndarray
    force: np.ndarray
    linkage: np.ndarray
    inductance: np.ndarray
    force_per_current: np.ndarray
    stiffness: np.ndarray
    coenergy: float


class MagneticNetwork:
    """Branches and the turns (b, c) of every coil on them; places have k coordinates.

    Raises InvalidInput where the branches form no loop, or the shapes do not fit.
    """

    def __init__(self, branches: Sequence[Branch], turns: ArrayLike, coordinates: int = 2) -> None:
        self.branches = tuple(branches)
        b = len(self.branches)
        self.turns = check_shape(turns, "the turns of a magnetic network", f"({b}, c)").astype(
            float
        )
        self.coordinates = coordinates
        nodes = {node for item in self.branches for node in (item.start, item.end)}
        order = {node: i for i, node in enumerate(sorted(nodes))}
        incidence = np.zeros((len(nodes), b))
        self.normals = np.zeros((b, coordinates))
        for j, item in enumerate(self.branches):
            incidence[order[item.start], j] += 1
            incidence[order[item.end], j] -= 1
            if item.normal:
                self.normals[j] = check_shape(
                    item.normal, f"the normal of {item.name}", f"({coordinates})"
                )
        self.loops = null_space(incidence)
        if self.loops.shape[1] == 0:
            raise InvalidInput(
                "the magnetic network has no closed path for its flux; connect its branches to "
                "loops"
            )
        self.area = np.array([item.area for item in self.branches])
        self.length = np.array([item.length for item in self.branches])
        permeability = np.array([item.permeability for item in self.branches])
        # reluctance of the linear branches at the centre, and the magnets' B_r l/(mu_0 mu_r)
        iron = np.array([item.curve is not None for item in self.branches])
        self._linear = np.where(
            iron, 0.0, self.length / (VACUUM_PERMEABILITY * permeability * self.area)
        )
        self._magnets = (
            np.array([item.remanence for item in self.branches])
            * self.length
            / (VACUUM_PERMEABILITY * permeability)
        )
        curves = {item.curve for item in self.branches if item.curve is not None}
        self._iron = [
            (curve, np.array([j for j, item in enumerate(self.branches) if item.curve == curve]))
            for curve in curves
        ]

    @property
    def coils(self) -> int:
        return self.turns.shape[1]

    def solve(self, currents: ArrayLike, place: ArrayLike | None = None) -> MagneticState:
        """The state at coil currents (c,) [A] and a place (k,) [m] of the rotor (None: the centre).

        Raises InvalidInput where a gap is closed or the iteration does not end.
        """
        i = check_shape(currents, "the coil currents [A]", f"({self.coils})").astype(float)
        x = (
            np.zeros(self.coordinates)
            if place is None
            else check_shape(place, "the place [m]", f"({self.coordinates})").astype(float)
        )
        closing = self.normals @ x
        if (closing >= self.length).any():
            at = int(np.argmax(closing - self.length))
            raise invalid(
                f"the gap of {self.branches[at].name}",
                f"{1e3 * (self.length[at] - closing[at]):.4g} mm",
                "open",
                "the rotor overlaps the magnet; correct its position, or the gap",
            )
        reluctance = self._linear - closing / (VACUUM_PERMEABILITY * self.area)
        drive = self.turns @ i + self._magnets
        flux = self.loops @ self._minimum(reluctance, drive)
        stress = flux / (VACUUM_PERMEABILITY * self.area)

        # S = Z H^-1 Z^T at the solution
        Z = self.loops
        factor = cho_factor(Z.T @ (self._slopes(reluctance, flux)[:, None] * Z))
        G = stress[:, None] * self.normals
        S_N = Z @ cho_solve(factor, Z.T @ self.turns)
        S_G = Z @ cho_solve(factor, Z.T @ G)
        return MagneticState(
            flux,
            flux / self.area,
            self.normals.T @ (flux * stress) / 2,
            self.turns.T @ flux,
            self.turns.T @ S_N,
            G.T @ S_N,
            G.T @ S_G,
            -self._psi(reluctance, drive, flux),
        )

    def _minimum(self, reluctance: np.ndarray, drive: np.ndarray) -> np.ndarray:
        """Newton's method on Psi with halved steps: y of the least Psi."""
        y, value = np.zeros(self.loops.shape[1]), 0.0
        for _ in range(_ITERATIONS):
            step, decrement = self._newton(reluctance, drive, y)
            if decrement <= _CLOSE * abs(value) or decrement == 0:
                # so close that Psi itself is level: plain steps end it, quadratically
                y = y + step
                return y + self._newton(reluctance, drive, y)[0]
            share = 1.0
            there = self._psi(reluctance, drive, self.loops @ (y + step))
            while there > value - 0.25 * share * decrement and share > 1e-12:
                share /= 2
                there = self._psi(reluctance, drive, self.loops @ (y + share * step))
            y, value = y + share * step, there
        raise InvalidInput(
            "the fluxes of the magnetic network were not found; correct currents, areas and the "
            "iron's curve: the flux is far beyond its saturation"
        )

    def _newton(
        self, reluctance: np.ndarray, drive: np.ndarray, y: np.ndarray
    ) -> tuple[np.ndarray, float]:
        """Newton's step at y, and its decrement -g^T step [J]."""
        Z, flux = self.loops, self.loops @ y
        gradient = Z.T @ (self._potentials(reluctance, flux) - drive)
        hessian = Z.T @ (self._slopes(reluctance, flux)[:, None] * Z)
        step = -cho_solve(cho_factor(hessian), gradient)
        return step, -float(gradient @ step)

    def _potentials(self, reluctance: np.ndarray, flux: np.ndarray) -> np.ndarray:
        """dW/dphi (b,) [A]."""
        drop = reluctance * flux
        for curve, at in self._iron:
            drop[at] = self.length[at] * curve.field(flux[at] / self.area[at])
        return drop

    def _slopes(self, reluctance: np.ndarray, flux: np.ndarray) -> np.ndarray:
        """d2W/dphi2 (b,) [A/Wb]."""
        slope = reluctance.copy()
        for curve, at in self._iron:
            slope[at] = self.length[at] / self.area[at] * curve.slope(flux[at] / self.area[at])
        return slope

    def _psi(self, reluctance: np.ndarray, drive: np.ndarray, flux: np.ndarray) -> float:
        """Psi [J]; infinite beyond what the iron can carry."""
        energy = reluctance * flux**2 / 2
        for curve, at in self._iron:
            density = flux[at] / self.area[at]
            if (np.abs(density) >= curve.limit).any():
                return np.inf
            energy[at] = self.length[at] * self.area[at] * curve.energy(density)
        return float(energy.sum() - drive @ flux)


# A magnet with its drive: how bias and control currents reach the coils, and what the axes see.


_POINTS = 11  # of a map, each way
_LEAN = 0.05  # weight of the norm of W while its distribution is sought; assumed


@dataclass(frozen=True, slots=True, eq=False)
class DrivenMagnet:
    """A network whose coil currents are bias i_0 + drive i: bias (c,) [A/A], drive (c, a) [A/A].

    axes: names of the control axes, which are the coordinates of the network, too.
    """

    network: MagneticNetwork
    bias: np.ndarray
    drive: np.ndarray
    axes: tuple[str, ...] = ("zeta", "eta")

    def at(
        self, bias: float, control: ArrayLike | None = None, place: ArrayLike | None = None
    ) -> MagneticState:
        """The state at a bias current [A], control currents (a,) [A] and a place (k,) [m]."""
        i = np.zeros(len(self.axes)) if control is None else np.asarray(control, dtype=float)
        return self.network.solve(self.bias * bias + self.drive @ i, place)

    def coefficients(
        self, bias: float, control: ArrayLike | None = None, place: ArrayLike | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """k_i (k, a) [N/A] and k_s (k, k) [N/m], positive where it destabilises."""
        state = self.at(bias, control, place)
        return state.force_per_current @ self.drive, state.stiffness

    def inductance(self, bias: float) -> float:
        """What a control current of the first axis sees in one of its coils [H]: its own linkage
        and those that the other coils induce, the largest of its coils.
        """
        state = self.at(bias)
        seen = np.abs(state.inductance @ self.drive[:, 0])
        return float(seen.max())

    def without(self, coil: int) -> DrivenMagnet:
        """The magnet with an open coil: no current in it. Raises InvalidInput."""
        if not 0 <= coil < self.network.coils:
            raise InvalidInput(
                f"there is no coil {coil}; the magnet has 0 to {self.network.coils - 1}"
            )
        bias = self.bias.copy()
        drive = self.drive.copy()
        bias[coil] = 0.0
        drive[coil] = 0.0
        return replace(self, bias=bias, drive=drive)


@dataclass(frozen=True, slots=True, eq=False)
class LinearityMap:
    """Force along an axis over its place and its control current, and how far the straight law is
    from it.

    places (p,) [m], currents (n,) [A]; force (n, p) [N]; error (n, p), the linear law's over k_i
    times the bias current, the force that the law would have at full modulation; force_per_current
    and negative_stiffness: (lowest, highest) over the map, relative to those at the centre.
    """

    places: np.ndarray
    currents: np.ndarray
    force: np.ndarray
    error: np.ndarray
    force_per_current: tuple[float, float]
    negative_stiffness: tuple[float, float]

    @property
    def worst(self) -> float:
        """The largest error."""
        return float(np.abs(self.error).max())


def linearity(
    magnet: DrivenMagnet,
    bias: float,
    gap: float,
    axis: int = 0,
    share: float = 0.25,
    full: float | None = None,
) -> LinearityMap:
    """The map over +-``share`` of the gap [m] and +-``share`` of the full control current [A]
    (None: the bias current). Raises InvalidInput.
    """
    check_positive(share, "the share of the gap", "0.25 is usual")
    if share >= 1:
        raise InvalidInput(
            f"the share of the gap is {share:g}, but must be below 1, where the rotor touches "
            "the magnet; 0.25 is usual"
        )
    full = bias if full is None else full
    x = np.linspace(-share, share, _POINTS) * gap
    i = np.linspace(-share, share, _POINTS) * full
    k_i, k_s = (matrix[axis, axis] for matrix in magnet.coefficients(bias))
    force, slopes = np.zeros((len(i), len(x))), np.zeros((2, len(i), len(x)))
    unit = np.eye(len(magnet.axes))[axis]
    for row, current in enumerate(i):
        for column, place in enumerate(x):
            state = magnet.at(bias, current * unit, place * unit)
            force[row, column] = state.force[axis]
            slopes[0, row, column] = (state.force_per_current @ magnet.drive)[axis, axis] / k_i
            slopes[1, row, column] = state.stiffness[axis, axis] / k_s
    error = (force - k_i * i[:, None] - k_s * x) / (k_i * full)
    return LinearityMap(
        x,
        i,
        force,
        error,
        (float(slopes[0].min()), float(slopes[0].max())),
        (float(slopes[1].min()), float(slopes[1].max())),
    )


def bias_linearisation(
    network: MagneticNetwork,
    lost: Sequence[int] = (),
    starts: int = 12,
    seed: int = 0,
) -> tuple[np.ndarray, float]:
    """A distribution W (c, 3) of currents W (i_0, i_zeta, i_eta) over single coils that makes the
    force linear, f = k i_0 (i_zeta, i_eta), without the coils ``lost``; and its k [N/A2].

    Without iron's curve the force is quadratic, f_d = i^T Q_d i with Q_d = (S N)^T n_d/(2 mu_0 A)
    S N; W solves W^T Q_zeta W = k/2 (e_0 e_1^T + e_1 e_0^T), W^T Q_eta W = k/2 (e_0 e_2^T + e_2
    e_0^T). Largest entry of W: 1. Source: Meeker and Maslen's generalised bias linearisation
    (IEEE Trans. Magn. 1995); here by least squares from several starts, the largest k found wins;
    it is not proved to be the largest.

    Raises InvalidInput where no distribution is found: too few coils are left.
    """
    from scipy.optimize import least_squares

    if any(item.curve is not None or item.remanence for item in network.branches):
        raise InvalidInput(
            "the bias linearisation needs coils, gaps and ideal iron; leave iron's curve and "
            "permanent magnets out"
        )
    c = network.coils
    kept = [coil for coil in range(c) if coil not in set(lost)]
    # fluxes per coil current, from unit currents: the network is linear
    phi = np.column_stack([network.solve(unit).flux for unit in np.eye(c)])[:, kept]
    tension = network.normals / (8e-7 * np.pi * network.area[:, None])
    Q = [phi.T @ (tension[:, d, None] * phi) for d in range(2)]
    size = max(np.abs(matrix).max() for matrix in Q)
    Q = [matrix / size for matrix in Q]
    wanted = np.zeros((2, 3, 3))
    for d in range(2):
        wanted[d, 0, d + 1] = wanted[d, d + 1, 0] = 0.5

    upper = np.triu_indices(3)

    def missing(w: np.ndarray) -> np.ndarray:
        W = w.reshape(len(kept), 3)
        return np.concatenate([(W.T @ Q[d] @ W - wanted[d])[upper] for d in range(2)])

    def small(w: np.ndarray) -> np.ndarray:
        # large W is small k: lean towards the least norm before the exact solution
        return np.concatenate([missing(w), _LEAN * w])

    random = np.random.default_rng(seed)
    best, k = None, 0.0
    for _ in range(starts):
        fit = least_squares(small, random.standard_normal(3 * len(kept)), max_nfev=100)
        fit = least_squares(missing, fit.x, xtol=1e-15, ftol=1e-15, gtol=1e-15, max_nfev=200)
        if np.abs(fit.fun).max() > 1e-9:
            continue
        W = fit.x.reshape(len(kept), 3)
        # columns may be scaled apart: W diag(a, b, b) makes k a b; the largest entries become 1
        a, b = np.abs(W[:, 0]).max(), np.abs(W[:, 1:]).max()
        if size / (a * b) > k:
            best, k = W / np.array([a, b, b]), size / (a * b)
    if best is None:
        raise InvalidInput(
            f"no distribution of currents makes the force linear with {len(kept)} of {c} coils; "
            "keep more of them"
        )
    whole = np.zeros((c, 3))
    whole[kept] = best
    return whole, k


# The kinds of magnets as networks with their drive.


_QUADRANTS = np.array([[1.0, 0.0], [0.0, 1.0], [-1.0, 0.0], [0.0, -1.0]])
# mean radius of the flux's way through the journal over the journal's (assumed: laminations from
# half the radius outwards)
_JOURNAL = 0.75
# first numbers of the network's nodes: stator (yoke), rotor (journal), pole tips; numbers only tell
# nodes apart, and magnets have fewer than 1,000 poles
_S, _R = 0, 1000
_TIP = 2000
_ZERO = 1e-12  # sine or cosine of a right angle, whose rounding is taken off


def magnet_of(part: Magnet) -> DrivenMagnet:
    """The magnet of a [bearing.magnet]."""
    return homopolar(part) if part.kind == "homopolar" else heteropolar(part)


def heteropolar(part: Magnet, *, separate: bool = False) -> DrivenMagnet:
    """Poles around the journal; coils: one per half-axis (zeta, eta, -zeta, -eta), all its poles in
    series; ``separate``: one per pole.

    With 8 poles at +-22.5 deg, ideal iron and N turns on each pole: k_i = 4 mu_0 N^2 A i_0
    cos(a)/s_0^2 and k_s = 4 mu_0 N^2 A i_0^2/s_0^3. The horseshoe alone would have cos(a)^2 of
    that, k_i^2/(2 L_0); the rest, sin(a)^2, is of the neighbours across the motion, whose poles
    share the journal: the sum over all poles does not depend on the direction.
    """
    p = part.pole_count
    m = p // 4
    within = (np.arange(m) - (m - 1) / 2) * 2 * np.pi / p
    angles = (np.arange(4)[:, None] * np.pi / 2 + within).ravel()
    share = np.ones(m)
    if part.kind == "e-core":
        # the middle pole alone carries turns, and has twice the face
        areas, signs = np.array([1.0, 2.0, 1.0]), np.array([0.0, 1.0, 0.0])
    else:
        areas, signs = share, _signs(m, part.polarity)
    # sense of every pole's coil (+1: flux into the journal): the signs of a half-axis, turned over
    # from one to the next for E-cores, and for two poles each in the order NNSS
    turned = np.array([1.0, -1.0, 1.0, -1.0])
    alternate = m == 3 or (m == 2 and part.polarity == "NNSS")
    sense = np.outer(turned if alternate else np.ones(4), signs).ravel()
    areas = np.tile(areas, 4) * part.pole_area

    branches: list[Branch] = []
    coils: list[int] = []
    _ring(part, branches, coils, angles, areas)
    turns = np.zeros((len(branches), p))
    for pole, branch in enumerate(coils):
        turns[branch, pole] = part.turns * sense[pole]
    series = np.kron(np.eye(4), np.ones((m, 1)))
    if separate:
        drive = series @ _QUADRANTS
        return DrivenMagnet(MagneticNetwork(branches, turns), np.ones(p), drive)
    return DrivenMagnet(MagneticNetwork(branches, turns @ series), np.ones(4), _QUADRANTS.copy())


def _signs(m: int, polarity: str) -> np.ndarray:
    """Senses (m,), +1 or -1, of the m poles of one half-axis: in turn, but N S S N for four with
    ``polarity`` "NNSS".
    """
    if m == 4 and polarity == "NNSS":
        return np.array([1.0, -1.0, -1.0, 1.0])
    return np.where(np.arange(m) % 2 == 0, 1.0, -1.0)


def _ring(
    part: Magnet,
    branches: list[Branch],
    coils: list[int],
    angles: np.ndarray,
    areas: np.ndarray,
) -> None:
    """Poles between a yoke and a journal; ``coils`` receives the branch of every pole's coil."""
    p = len(angles)
    iron = Froehlich(part.iron_permeability, part.iron_flux_density)
    rings = part.back_iron_area is not None
    for k, (angle, area) in enumerate(zip(angles, areas, strict=True)):
        yoke, journal = (_S + k * rings, _R + k * rings)
        tip = yoke
        coils.append(len(branches))
        if part.iron_path is not None:
            tip = _TIP + k
            branches.append(Branch(yoke, tip, area, part.iron_path, f"pole {k + 1}", curve=iron))
        normal = (float(np.cos(angle)), float(np.sin(angle)))
        branches.append(Branch(tip, journal, area, part.gap, f"pole {k + 1}", normal))
        if part.leakage > 0 and part.iron_path is not None:
            branches.append(Branch(tip, journal, part.leakage * area, part.gap, f"leakage {k + 1}"))
    if part.back_iron_area is not None:
        assert part.journal_radius is not None and part.iron_path is not None
        outer = part.journal_radius + part.gap + part.iron_path
        for first, radius, name in (
            (_S, outer, "yoke"),
            (_R, _JOURNAL * part.journal_radius, "journal"),
        ):
            for k in range(p):
                along = Branch(
                    first + k,
                    first + (k + 1) % p,
                    part.back_iron_area,
                    2 * np.pi * radius / p,
                    f"{name} {k + 1}",
                    curve=iron,
                )
                branches.append(along)


def homopolar(part: Magnet) -> DrivenMagnet:
    """Two planes of p poles; coils: one per pole of a plane, in series with the other plane's, and
    the bias coil around the shaft where there is one, last.

    Pole k at the angle a_k gets i_zeta cos(a_k) + i_eta sin(a_k). With 4 poles and ideal iron, per
    plane k_i = 2 N A B_0/s_0, k_s = 2 A B_0^2/(mu_0 s_0).
    """
    p = part.pole_count
    angles = np.arange(p) * 2 * np.pi / p
    iron = Froehlich(part.iron_permeability, part.iron_flux_density)
    permanent = part.bias == "permanent-magnet"
    branches: list[Branch] = []
    columns: list[np.ndarray] = []
    for plane, sense in enumerate((1.0, -1.0)):
        stator = _S + plane * permanent
        for k, angle in enumerate(angles):
            # the bias flux leaves the stator in one plane and enters it in the other: the control
            # coils are wound so that it is raised on the same side
            coil = np.zeros(p + 1)
            coil[k] = sense * part.turns
            coil[p] = 0.0 if permanent or plane else float(part.bias_turns or 0.0)
            normal = (float(np.cos(angle)), float(np.sin(angle)))
            name = f"pole {k + 1} of plane {plane + 1}"
            tip = stator
            if part.iron_path is not None:
                tip = _TIP + plane * p + k
                branches.append(
                    Branch(stator, tip, part.pole_area, part.iron_path, name, curve=iron)
                )
                columns.append(coil)
            branches.append(Branch(tip, _R, part.pole_area, part.gap, name, normal))
            columns.append(np.zeros(p + 1) if part.iron_path is not None else coil)
            if part.leakage > 0 and not permanent and part.iron_path is not None:
                area = part.leakage * part.pole_area
                branches.append(Branch(tip, _R, area, part.gap, f"leakage of {name}"))
                columns.append(np.zeros(p + 1))
    if permanent:
        assert part.magnet_area is not None and part.magnet_length is not None
        source = Branch(
            _S + 1,
            _S,
            part.magnet_area,
            part.magnet_length,
            "permanent magnet",
            remanence=float(part.remanence or 0.0),
            permeability=part.magnet_permeability,
        )
        branches.append(source)
        columns.append(np.zeros(p + 1))
        if part.leakage > 0:
            area = part.leakage * part.magnet_area
            branches.append(Branch(_S, _S + 1, area, part.magnet_length, "leakage"))
            columns.append(np.zeros(p + 1))
    drive = np.column_stack([np.cos(angles), np.sin(angles)])
    drive[np.abs(drive) < _ZERO] = 0.0
    turns = np.array(columns)
    if permanent:
        return DrivenMagnet(MagneticNetwork(branches, turns[:, :p]), np.zeros(p), drive)
    bias = np.zeros(p + 1)
    bias[p] = 1.0
    return DrivenMagnet(
        MagneticNetwork(branches, turns), bias, np.vstack([drive, np.zeros((1, 2))])
    )


def thrust(
    turns: tuple[float, float],
    inner_area: float,
    outer_area: float,
    gaps: tuple[float, float],
    outer_gap_share: float = 1.0,
) -> DrivenMagnet:
    """A collar between two ring magnets (towards +z, towards -z), each with an inner and an outer
    pole in series; turns and gaps [m] of the two sides may differ.

    With equal sides, areas A_1 and A_2: k_i = 4 i_0 N^2/(R_0^2 mu_0) (1/A_1 + 1/A_2)/2 with R_0 =
    s/(mu_0 A_1) + s/(mu_0 A_2), and k_s = k_i^2/(2 L_0), L_0 = N^2/R_0.
    """
    check_positive(outer_gap_share, "the outer gap over the inner one", "1 is usual")
    branches: list[Branch] = []
    coils = np.zeros((4, 2))
    for side, (gap, way) in enumerate(zip(gaps, (1.0, -1.0), strict=True)):
        word = "+z" if side == 0 else "-z"
        branches.append(Branch(side, _R, inner_area, gap, f"inner pole of {word}", (way,)))
        outer = outer_gap_share * gap
        branches.append(Branch(_R, side, outer_area, outer, f"outer pole of {word}", (way,)))
        coils[2 * side, side] = turns[side]
    network = MagneticNetwork(branches, coils, 1)
    return DrivenMagnet(network, np.ones(2), np.array([[1.0], [-1.0]]), ("z",))


# The coefficients of a bearing from its magnetic network.


_OFF = 0.05  # of the stated bias current from the one that a permanent magnet is worth


@lru_cache(maxsize=64)
def coefficients_of(
    magnet: Magnet, bias: float, name: str
) -> tuple[tuple[float, float], tuple[float, float], float]:
    """k_i (zeta, eta) [N/A], k_s (zeta, eta) [N/m], and the bias current [A] of an opposing pair of
    the same: that of a heteropolar magnet, k_s s_0/k_i of a homopolar one.

    name: of the bearing. Raises InvalidInput where a permanent magnet is stated with a bias current
    that differs from the pair's by more than 5 %: the control current at which one gap has no flux.
    """
    k_i, k_s = (np.diag(matrix) for matrix in magnet_of(magnet).coefficients(bias))
    pair = bias if magnet.kind != "homopolar" else float(k_s[0] * magnet.gap / k_i[0])
    if magnet.bias == "permanent-magnet" and abs(bias - pair) > _OFF * pair:
        raise invalid(
            f"bias_current of bearing {name}",
            f"{bias:.4g} A",
            f"{pair:.4g} A, the control current that takes the permanent magnet's flux out of one "
            "gap",
            f"write bias_current = {pair:.4g}",
        )
    return _pair(k_i), _pair(k_s), pair


def _pair(values: np.ndarray) -> tuple[float, float]:
    return float(values[0]), float(values[1])
