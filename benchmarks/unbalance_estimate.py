"""The unbalance in every plane by least squares from amplitudes of converged current-free blocks."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ambrose.annexes.site.balancing_vectors import per_unbalance
from ambrose.annexes.synchronous.block_loop import Condition, SynchronousLoop
from ambrose.core.checks import check_shape, invalid


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
    block current-free; least squares without weights.

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
        part = slice(k * n, (k + 1) * n)
        rows[part, :count] = per_unbalance(loop.plant(float(speed), condition), names, float(speed))
        if runout:
            # run-out enters every speed as itself
            rows[part, count:] = np.eye(n)
    # columns of one size, so that neither unbalance nor run-out is cut off
    scale: np.ndarray = np.linalg.norm(rows, axis=0)
    solution = np.linalg.lstsq(rows / scale, a.ravel(), rcond=1e-8)[0] / scale

    # residual as a share of the amplitudes
    left = float(np.linalg.norm(rows @ solution - a.ravel())) / max(
        float(np.linalg.norm(a)), 1e-300
    )
    return UnbalanceEstimate(solution[:count], names, left, solution[count:] if runout else None)
