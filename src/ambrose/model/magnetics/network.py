"""A magnetic network: branches between nodes, solved for their fluxes; forces, inductances and
stiffnesses by derivative.

The fluxes phi of the branches have no sources: phi = Z y, with Z the loops of the graph. They
minimise the convex function

    Psi(y) = sum_b W_b(phi_b, x) - (N i + F_m)^T phi,      phi = Z y,

W_b being the energy of a branch, N the turns, i the currents, F_m the magnetomotive force of the
permanent magnets. Its minimum is minus the co-energy. W of a gap s = s_0 - n.x with area A is phi^2
s/(2 mu_0 A), and everything else follows by derivative of the same function:

    force            f = -dW/dx = sum phi^2/(2 mu_0 A) n            (Maxwell's stress B^2/(2 mu_0))
    flux linkage     lambda = N^T phi
    with H = Z^T W'' Z, S = Z H^-1 Z^T and the gaps' G = phi n/(mu_0 A):
    inductance       dlambda/di = N^T S N
    force by current df/di = G^T S N = (dlambda/dx)^T, the back-EMF per velocity
    stiffness        df/dx = G^T S G, positive: it destabilises (Earnshaw)
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import cho_factor, cho_solve, null_space

from ambrose.core.checks import InvalidInput, check_positive, check_shape, invalid
from ambrose.model.magnetics.iron import IronCurve
from ambrose.model.magnetics.vacuum import VACUUM_PERMEABILITY

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
                "the rotor stands in the magnet: correct its place, or the gap",
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
