"""The loop with the motion of the whole shaft: responses, and modes as roots of

    T(s) x = 0,    T(s) = s I - A + B K(s) C,

with the plant x' = A x + B u, y = C x at one operating point and K(s) the law as it runs: a sampled
one with its delay acts through the base band of its hold, K(e^{s T}) (1 - e^{-s T})/(s T), exact
but for aliasing. The rotor's modal displacements are the plant's first states, so that any place
of the shaft can be read, and pulled at, without a port there.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import lu_factor, lu_solve

from ambrose.annexes.rotordynamics.stations import Layout
from ambrose.core.aliasing import continuous_poles
from ambrose.core.checks import NumericalFailure
from ambrose.core.statespace import StateSpace
from ambrose.law.law import LawLike, law_of
from ambrose.law.loop import closed_loop, running_law
from ambrose.law.timing import Timing
from ambrose.machine.description import OperatingPoint
from ambrose.model.assemble import assemble, attached_rotor, state_scales
from ambrose.model.basis import modes_of, rows_in
from ambrose.model.plant import Plant
from ambrose.model.ports import Port

_STEPS = 30  # of the iteration for a mode
_CLOSE = 1e-10  # of |s|: where it ends
_TURNS = 4  # of inverse iteration at a fixed shift, for a mode whose shape is not known yet
_NUDGE = 1e-6  # of |s|: the step of K's derivative


@dataclass(frozen=True, slots=True, eq=False)
class ShaftLoop:
    """The loop at one operating point.

    A (n, n), B (n, a), C (a, n): the plant from currents [A] to measured displacements [m];
    D (a, a) its direct part. read (2 s, n): states -> displacements of the stations in x and y [m],
    station after station. pull (n, 2 s): forces [N] there -> state rates. current (a, n) and
    direct (a, a): states and commands -> coil currents [A]. law: None without magnets.
    """

    plant: Plant
    A: np.ndarray
    B: np.ndarray
    C: np.ndarray
    D: np.ndarray
    read: np.ndarray
    pull: np.ndarray
    law: StateSpace | None

    @property
    def point(self) -> OperatingPoint:
        return self.plant.point

    def gain(self, s: complex) -> np.ndarray:
        """K(s) (a, a) [A/m] as it acts in the loop; u = -K y."""
        law = self.law
        if law is None:
            return np.zeros((0, 0), complex)
        z = s if law.dt is None else np.exp(s * law.dt)
        inner = np.linalg.solve(z * np.eye(law.n_states) - law.A, law.B.astype(complex))
        K = law.C @ inner + law.D
        if law.dt is None:
            return np.asarray(K)
        x = s * law.dt
        return np.asarray(K * (-np.expm1(-x) / x if x else 1.0))

    def matrix(self, s: complex) -> np.ndarray:
        """T(s) (n, n)."""
        n = len(self.A)
        T = s * np.eye(n) - self.A.astype(complex)
        if self.law is not None:
            # u = -K (C x + D u)
            K = self.gain(s)
            T += self.B @ np.linalg.solve(np.eye(len(K)) + K @ self.D, K @ self.C)
        return T

    def states(self, s: complex, forces: np.ndarray) -> np.ndarray:
        """States (n,) or (n, k) under forces (2 s,) or (2 s, k) [N] at the stations, at s."""
        return np.linalg.solve(self.matrix(s), self.pull @ forces)

    def currents(self, s: complex, states: np.ndarray) -> np.ndarray:
        """Coil currents (a,) or (a, k) [A] that belong to states."""
        K = self.gain(s)
        return self.coil(
            states, -np.linalg.solve(np.eye(len(K)) + K @ self.D, K @ (self.C @ states))
        )

    def coil(self, states: np.ndarray, u: np.ndarray) -> np.ndarray:
        """Coil currents (a,) or (a, k) [A] of states and control currents u (a,) or (a, k) [A]."""
        system = self.plant.system
        rows = [system.outputs.index(name) for name in self.plant.named("i")]
        columns = [system.inputs.index(name) for name in self.plant.named("u")]
        return np.asarray(system.C[rows] @ states + system.D[np.ix_(rows, columns)] @ u)

    def coupled(self, station: int, q: float) -> ShaftLoop:
        """With a cross-coupled stiffness q [N/m] at a station: f_x = -q y, f_y = +q x."""
        x, y = 2 * station, 2 * station + 1
        extra = -np.outer(self.pull[:, x], self.read[y]) + np.outer(self.pull[:, y], self.read[x])
        return replace(self, A=self.A + q * extra)

    def mode_near(
        self, s: complex, x: np.ndarray | None = None, turn: complex = -1j
    ) -> tuple[complex, np.ndarray]:
        """The root s [1/s] of T nearest along Newton's path, and its states x (n,).

        x: states to begin with; without them forces along the shaft begin, y over x being ``turn``:
        -j forward, +j backward.

        Inverse iteration of the nonlinear eigenvalue problem (Unger 1950; Mehrmann & Voss 2004,
        sec. 4): T(s) w = T'(s) x, s <- s - (v^H x)/(v^H w), x <- w/|w|. Raises NumericalFailure
        where it does not settle.
        """
        if x is None:
            # the vector first, with the shift held: w = T(s)^-1 x turns towards the nearest mode
            factors = lu_factor(self.matrix(s))
            x = self.pull[:, 0::2].sum(axis=1) + turn * self.pull[:, 1::2].sum(axis=1)
            for _ in range(_TURNS):
                x = lu_solve(factors, x / np.linalg.norm(x))
        x = x / np.linalg.norm(x)
        for _ in range(_STEPS):
            v = x
            step = _NUDGE * abs(s)
            # T'(s) x by a central difference: only the pace of the iteration depends on it
            slope = (self.matrix(s + step) - self.matrix(s - step)) @ x / (2 * step)
            w = lu_solve(lu_factor(self.matrix(s)), slope)
            change = (v.conj() @ x) / (v.conj() @ w)
            s, x = s - change, w / np.linalg.norm(w)
            if abs(change) < _CLOSE * abs(s):
                return complex(s), x
        raise NumericalFailure(
            f"the mode near {abs(s):.4g} rad/s could not be followed within {_STEPS} steps; "
            "take a finer sweep, or check that the mode exists at both ends"
        )

    def all_modes(self) -> np.ndarray:
        """Poles (m,) [1/s] with Im >= 0 of the loop as it runs, by ascending modulus."""
        if self.law is None:
            values = np.linalg.eigvals(self.A)
        else:
            system = replace_system(self.plant.system, self.A)
            loop = closed_loop(replace(self.plant, system=system), self.law)
            values = continuous_poles(loop.A, loop.dt, system.A)[0]
        kept = values[values.imag >= 0]
        return kept[np.argsort(np.abs(kept))]


def replace_system(system: StateSpace, A: np.ndarray) -> StateSpace:
    """The same signals around other dynamics."""
    return StateSpace(A, system.B, system.C, system.D, system.inputs, system.outputs, system.dt)


LoopAt = Callable[[OperatingPoint], ShaftLoop]


def shaft_loop(
    layout: Layout, point: OperatingPoint, given: LawLike | None, timing: Timing | None
) -> ShaftLoop:
    """The loop at an operating point. Raises InvalidInput where a seal's or bearing's table does
    not reach the point, and where the law is not one for the machine.
    """
    machine = layout.machine
    plant = assemble(machine, point)
    rotor = plant.rotor_model
    modes = modes_of(machine, rotor, None)
    places = tuple(
        Port(f"s{k}_{axis}", float(x), turn)
        for k, x in enumerate(layout.positions)
        for axis, turn in (("x", 0.0), ("y", np.pi / 2))
    )
    rows = rows_in(rotor, modes, places)

    # M q'' = ... + N^T f in the states q and q'/s: B = [0; diag(1/s) M^-1 N^T]
    attached = attached_rotor(machine, point, rotor)
    scales = state_scales(machine, rotor)
    count = len(attached.mass)
    N = np.hstack([rows, np.zeros((len(rows), count - rows.shape[1]))])
    system = plant.system
    read = np.zeros((len(rows), system.n_states))
    read[:, :count] = N
    pull = np.zeros((system.n_states, len(rows)))
    pull[count : 2 * count] = np.linalg.solve(attached.mass, N.T) / scales[:, None]

    u = [system.inputs.index(name) for name in plant.named("u")]
    y = [system.outputs.index(name) for name in plant.named("y")]
    law = None if given is None or not u else running_law(law_of(given), plant, timing)
    return ShaftLoop(
        plant, system.A, system.B[:, u], system.C[y], system.D[np.ix_(y, u)], read, pull, law
    )
