"""A magnet with its drive: how bias and control currents reach the coils, and what the axes see."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from ambrose.core.checks import InvalidInput, check_positive
from ambrose.model.magnetics.network import MagneticNetwork, MagneticState

_POINTS = 11  # of a map, each way
_LEAN = 0.05


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
            f"the share of the gap is {share:g}, but must be below 1: the rotor stands in the "
            "magnet there; 0.25 is usual"
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
        found = least_squares(small, random.standard_normal(3 * len(kept)), max_nfev=100)
        found = least_squares(missing, found.x, xtol=1e-15, ftol=1e-15, gtol=1e-15, max_nfev=200)
        if np.abs(found.fun).max() > 1e-9:
            continue
        W = found.x.reshape(len(kept), 3)
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
