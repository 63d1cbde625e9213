"""The unbalance of a rotor from the amplitudes of a converged synchronous block: no trial weights.

Once a block of mode current-free has converged the control current has no 1x part, so that what is
measured is the rotor's own response, y = c = Re(exp(j theta) a):

    a(W) = sum_p G_p(W) W^2 U_p,    G_p: displacement per forward force in plane p   (1)

with the plant's G at the speed, magnets' negative stiffness included. Amplitudes of several speeds
are one linear least-squares problem in the complex U_p [kg m] (Fang et al., Sensors 13 (2013)
16000, balance from coil currents in one start-up). Run-out is in y as well: it does not grow with
W^2, and is solved for beside the unbalance where asked for.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ambrose.core.checks import check_shape, invalid
from ambrose.core.statespace import select
from ambrose.law.synchronous import Condition, SynchronousLoop, response_at


@dataclass(frozen=True, slots=True, eq=False)
class UnbalanceEstimate:
    """moments (planes,) complex [kg m], the angle that of the mass from x at the key phasor's
    pulse; planes: the ports; residual [-]: what is left of the amplitudes, as a share of their
    size; runout (a,) complex [m] (None: not asked).
    """

    moments: np.ndarray
    planes: tuple[str, ...]
    residual: float
    runout: np.ndarray | None = None

    def corrections(self, radius: Sequence[float]) -> tuple[tuple[float, float], ...]:
        """Mass [g] and angle [deg] to add in every plane at these radii [m], opposite to the
        unbalance.
        """
        if len(radius) != len(self.planes):
            raise invalid(
                "the number of radii",
                len(radius),
                f"one per plane, {len(self.planes)}",
                "give each its own",
            )
        added = -self.moments / np.asarray(radius, float)
        return tuple((float(1e3 * abs(m)), float(np.degrees(np.angle(m)) % 360)) for m in added)


def unbalance_from_amplitudes(
    loop: SynchronousLoop,
    condition: Condition,
    speeds: Sequence[float],
    amplitudes: np.ndarray,
    planes: Sequence[str] | None = None,
    *,
    runout: bool = False,
) -> UnbalanceEstimate:
    """The unbalance in each plane from amplitudes a (s, n) complex [m] at speeds (s,) [rad/s],
    block current-free.

    planes: ports with two directions (bearings, discs, seals; None: the bearings). runout: solve
    for a constant 1x run-out of every sensor as well. Raises InvalidInput where there are fewer
    equations than unknowns.
    """
    a = check_shape(
        np.asarray(amplitudes, complex), "amplitudes", "(s, n)", s=len(speeds), n=len(loop.axes)
    )
    names = (
        tuple(bearing.name for bearing in loop.machine.bearings)
        if planes is None
        else tuple(planes)
    )
    n, count = len(loop.axes), len(names)
    unknowns = count + n * runout
    if a.size < unknowns:
        raise invalid(
            "the number of speeds",
            len(speeds),
            f"enough for {unknowns} unknowns",
            "give more of them",
        )

    # rows: every speed's amplitudes; columns: U of the planes, then the run-out of the axes
    rows = np.zeros((len(speeds) * n, unknowns), complex)
    for k, speed in enumerate(speeds):
        plant = loop.plant(float(speed), condition)
        forces, patterns = [], []
        for name in names:
            pair = [port for port in plant.ports if port.rpartition("_")[0] == name]
            if len(pair) != 2:
                known = ", ".join(dict.fromkeys(port.rpartition("_")[0] for port in plant.ports))
                raise invalid(
                    "a balancing plane",
                    repr(name),
                    f"one of {known}",
                    "name a bearing, disc, seal or coupling",
                )

            # a forward force of phase zero at x is (1, -j) along x and y; along axes turned by b
            # it is exp(-j b) (1, -j)
            turned = next((b.angle for b in loop.machine.bearings if b.name == name), 0.0)
            forces += [f"f_{port}" for port in pair]
            patterns.append(np.exp(-1j * turned) * np.array([1.0, -1j]))

        # (1): W^2 G_p for plane p, columns 2p and 2p + 1 the forces along its two ports
        G = response_at(select(plant.system, forces, plant.named("y")), float(speed))
        for p, pattern in enumerate(patterns):
            rows[k * n : (k + 1) * n, p] = speed**2 * (G[:, 2 * p : 2 * p + 2] @ pattern)
        if runout:
            # run-out enters every speed as itself
            rows[k * n : (k + 1) * n, count:] = np.eye(n)
    # columns of one size, so that neither unbalance nor run-out is cut off
    scale: np.ndarray = np.linalg.norm(rows, axis=0)
    solution = np.linalg.lstsq(rows / scale, a.ravel(), rcond=1e-8)[0] / scale

    # residual as a share of the amplitudes
    left = float(np.linalg.norm(rows @ solution - a.ravel())) / max(
        float(np.linalg.norm(a)), 1e-300
    )
    return UnbalanceEstimate(solution[:count], names, left, solution[count:] if runout else None)
