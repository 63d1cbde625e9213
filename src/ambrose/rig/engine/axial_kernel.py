"""The axis along the shaft, compiled: rotor mass, coupling and stops, amplifier, and both magnets
with the flux in their cores.

State z (6,): displacement [m], velocity [m/s], two amplifier states [A], the bias as a share of
itself, the sensor's lagged signal [m]; flux (2, n) [Wb] in the lags of the left and the right core.
The core's equation (R_0 + c sqrt(s)) phi = N I - (what the flux meets beyond R_0) phi becomes, with
h = R_0/(R_0 + c sqrt(s)) as lags of weights g and poles p,

    phi = sum g_k z_k,    z_k' = p_k (w - z_k),
    R_0 w = N I - (rho gap - R_0) phi - R_f phi phi_s/(phi_s - phi),

in which gap, current and iron are not linearised. A step takes the lags exactly for a constant w,
of the current and the place in its middle and of the flux at its end, which then solves a
quadratic. This module imports numba: import it only
inside functions.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from ambrose.rig.engine.cache import compile_kept
from ambrose.rig.engine.inlined import (
    OPTIONS,
    amplifier_derivative,
    coil_current,
    compiled,
    converted,
    effective_current,
    indicated,
)
from ambrose.rig.engine.sampled import command, control, run_program

if TYPE_CHECKING:
    from ambrose.rig.engine.controller import SampledLaw

_LEAST = 0.02  # of the gap: below it the collar is inside the magnet, its force is held


@compiled
def _flux(side: Any, current: float, gap: float, kept: float, taken: float) -> float:
    """phi [Wb] at the end of a step: kept = sum g_k a_k z_k of what was there, taken = sum g_k (1 -
    a_k) of what drives, a_k = exp(-p_k h); laminated 0 and 1.

    With R_0 phi = R_0 kept + taken R_0 w: the root below phi_s of A phi^2 - q phi + B phi_s = 0.
    """
    drive = side[0] * current
    gap = max(gap, _LEAST * side[2])
    A = side[6] + taken * (side[3] * gap - side[6])
    B = side[6] * kept + taken * drive
    iron = taken * side[4]
    limit = side[5]
    if limit <= 0.0 or B <= 0.0:
        return B / (A + iron)
    q = B + (A + iron) * limit
    return 2.0 * B * limit / (q + math.sqrt(max(q * q - 4.0 * A * B * limit, 0.0)))


@compiled
def _magnetise(c: Any, s: int, flux: Any, current: float, bias: float, x: float) -> None:
    """The lags of side s (0 left, 1 right) take one step, with the control current, the share of
    the bias and the place that it has in its middle.
    """
    way = 2.0 * s - 1.0
    side, n = c.side[s], c.decay.shape[1]
    kept, taken = 0.0, 0.0
    for k in range(n):
        kept += c.weight[s, k] * c.decay[s, k] * flux[s, k]
        taken += c.weight[s, k] * (1.0 - c.decay[s, k])
    if taken > 0.0:
        coil = max(bias * side[1] + way * current, 0.0)
        phi = _flux(side, coil, side[2] - way * x, kept, taken)
        # w from phi = kept + taken w
        w = (phi - kept) / taken
        for k in range(n):
            flux[s, k] = c.decay[s, k] * flux[s, k] + (1.0 - c.decay[s, k]) * w


@compiled
def _pull(c: Any, s: int, flux: Any, current: float, bias: float, x: float) -> float:
    """Force [N] along z of side s: rho phi^2/2 with the flux of its lags, laminated at once."""
    way = 2.0 * s - 1.0
    side, n = c.side[s], c.decay.shape[1]
    if n == 0:
        phi = _flux(side, max(bias * side[1] + way * current, 0.0), side[2] - way * x, 0.0, 1.0)
    else:
        phi = 0.0
        for k in range(n):
            phi += c.weight[s, k] * flux[s, k]
    return way * side[3] * phi * phi / 2.0


@compiled
def _stops(c: Any, x: float, v: float) -> float:
    """Force [N] of the axial stops: a spring and a damper that never pulls."""
    depth = max(x - c.body[5], 0.0) + min(x + c.body[4], 0.0)
    if depth == 0.0:
        return 0.0
    force = -c.body[6] * depth - c.body[7] * v
    return min(force, 0.0) if depth > 0.0 else max(force, 0.0)


@compiled
def _step(c: Any, z: Any, flux: Any, told: float, powered: float, pushed: float) -> float:
    """One step of h = c.body[8] [s]; returns the magnets' force [N] at its end."""
    h = c.body[8]
    p = c.amplifier
    # amplifier and bias: at the start, in the middle, at the end
    first = effective_current(told, z[2], z[3], p)
    bias = z[4]
    d_1, d_2 = amplifier_derivative(told, z[2], z[3], p, z[1])
    m_1, m_2 = z[2] + h / 2.0 * d_1, z[3] + h / 2.0 * d_2
    d_1, d_2 = amplifier_derivative(told, m_1, m_2, p, z[1])
    z[2] += h * d_1
    z[3] += h * d_2
    middle = effective_current(told, m_1, m_2, p)
    last = effective_current(told, z[2], z[3], p)
    z[4] = powered + (z[4] - powered) * c.body[9]

    # half a step of the rotor, the flux with what drives it in the middle, the other half:
    # m x'' = sum of forces
    outer = pushed - c.body[1] * z[0] - c.body[2] * z[1] + _stops(c, z[0], z[1])
    magnets = 0.0
    for s in range(2):
        magnets += _pull(c, s, flux, first, bias, z[0])
    z[1] += h / 2.0 * (outer + magnets) / c.body[0]
    z[0] += h * z[1]
    magnets = 0.0
    for s in range(2):
        _magnetise(c, s, flux, middle, (bias + z[4]) / 2.0, z[0] - h / 2.0 * z[1])
        magnets += _pull(c, s, flux, last, z[4], z[0])
    outer = pushed - c.body[1] * z[0] - c.body[2] * z[1] + _stops(c, z[0], z[1])
    z[1] += h / 2.0 * (outer + magnets) / c.body[0]

    # the sensor's lag
    if c.sensor[2] > 0.0:
        z[5] += h * c.sensor[2] * (indicated(z[0] - c.body[3], c.sensor) - z[5])
    return magnets


@compiled
def measured(along: Any, k: int) -> float:
    """What the controller reads [m] at the start of sample k."""
    c, z = along.constants, along.z
    drive = along.drive
    signal = z[5] if c.sensor[2] > 0.0 else indicated(z[0] - c.body[3], c.sensor)
    reading: float = converted(signal + drive.noise[0, k], c.sensor) + drive.disturbance[0, k]
    return reading


@compiled
def write_down(along: Any, k: int, y: float, u: float, command: Any) -> None:
    """One row of the log: measurement [m], acting output [A], coil current [A], magnets' force [N],
    displacement [m]; command (a,) [A]: the axis' is the last one.
    """
    z, log = along.z, along.log
    told = command[command.shape[0] - 1]
    log[k, 0], log[k, 1] = y, u
    log[k, 2] = coil_current(told, z[2], z[3], along.constants.amplifier)
    log[k, 3] = along.force[0]
    log[k, 4] = z[0]


@compiled
def move(along: Any, k: int, command: Any) -> None:
    """One control sample."""
    c, drive = along.constants, along.drive
    told = command[command.shape[0] - 1]
    for i in range(c.steps):
        # the driven force as a cubic of tau from sample to sample, and the process thrust
        tau = (i + 0.5) / c.steps
        pushed = drive.force[0, k] + tau * (
            drive.force[1, k] + tau * (drive.force[2, k] + tau * drive.force[3, k])
        )
        along.force[0] = _step(c, along.z, along.flux, told, drive.powered[0, k], c.load + pushed)


def entry_point(fingerprint: int) -> Any:
    """``advance``, compiled and kept; fingerprint: of the sources that it is made of."""

    def advance(
        along: Any, law: SampledLaw, code: Any, work: Any, x: Any, held: Any, seen: Any
    ) -> int:
        """A stretch of K control samples of the axis by itself; what moves in along, x and held
        (1,) end as the state after it. seen (K, 1) [m]: the errors. Returns how many samples were
        done.
        """
        assert fingerprint  # part of the cached function's identity
        y, u = work.sampled[0], work.sampled[1]
        for k in range(seen.shape[0]):
            y[0] = measured(along, k)
            if code.address == 0:
                control(law, along.drive, k, y, x, held, u, seen[k], work.ahead)
            elif run_program(law, code, along.drive, k, y, held, u, seen[k]) < 0:
                return k
            command(along.drive, work, k, u)
            write_down(along, k, y[0], u[0], work.command)
            move(along, k, work.command)
            if not math.isfinite(along.z[0] + along.z[1]):
                return k
        return seen.shape[0]

    (advanced,) = compile_kept((advance,), **OPTIONS)
    return advanced
