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

from ambrose.rig.engine.controller import command, control, run_program
from ambrose.rig.engine.products import (
    OPTIONS,
    amplifier_derivative,
    coil_current,
    compile_kept,
    compiled,
    converted,
    effective_current,
    indicated,
)

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
def _side(c: Any, s: int) -> tuple[float, float, float, float, float, float, float]:
    """A row of ``Constants.side`` as scalars: kept in registers through the steps of a sample."""
    side = c.side
    return side[s, 0], side[s, 1], side[s, 2], side[s, 3], side[s, 4], side[s, 5], side[s, 6]


@compiled
def _of_lags(c: Any, s: int, flux: Any) -> tuple[float, float, float]:
    """phi = sum g_k z_k [Wb] of side s, and what one step and two leave of it: sum g_k a_k z_k, sum
    g_k a_k^2 z_k.
    """
    phi, kept = 0.0, 0.0
    rest = 0.0
    for k in range(flux.shape[1]):
        phi += c.weight[s, k] * flux[s, k]
        kept += c.weight[s, k] * c.decay[s, k] * flux[s, k]
        rest += c.rest[s, k] * flux[s, k]
    return phi, kept, rest


@compiled
def _follow(c: Any, s: int, flux: Any, w: float) -> float:
    """The lags of side s take the step that w drives, z_k = a_k z_k + (1 - a_k) w; returns what two
    more steps leave of them, sum g_k a_k^2 z_k.
    """
    rest = 0.0
    for k in range(flux.shape[1]):
        a = c.decay[s, k]
        z = a * flux[s, k] + (1.0 - a) * w
        flux[s, k] = z
        rest += c.rest[s, k] * z
    return rest


@compiled
def _driven(
    side: Any, s: int, current: float, bias: float, x: float, kept: float, taken: float
) -> float:
    """Flux [Wb] of side s (0 left, 1 right) at the end of a step (``_flux``) with the control
    current, the share of the bias and the place that it has in its middle; laminated kept 0, taken
    1: at once.
    """
    way = 2.0 * s - 1.0
    if taken == 0.0:  # no lag at all on this side
        return kept
    coil = max(bias * side[1] + way * current, 0.0)
    return _flux(side, coil, side[2] - way * x, kept, taken)


@compiled
def _stops(body: Any, x: float, v: float) -> float:
    """Force [N] of the axial stops: a spring and a damper that never pulls."""
    depth = max(x - body[5], 0.0) + min(x + body[4], 0.0)
    if depth == 0.0:
        return 0.0
    force = -body[6] * depth - body[7] * v
    return min(force, 0.0) if depth > 0.0 else max(force, 0.0)


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
    """One control sample.

    What a step hands to the next one stays in scalars, the magnets' force with it. Nor does a step
    wait for its lags' sum: with z_k = a_k z'_k + (1 - a_k) w, sum g_k a_k z_k is
    sum g_k a_k^2 z'_k, there before w is, and w sum g_k a_k (1 - a_k).
    """
    c, drive = along.constants, along.drive
    z, flux = along.z, along.flux
    body, sensor = c.body, c.sensor
    amp = c.amplifier
    b = (body[0], body[1], body[2], body[3], body[4], body[5], body[6], body[7])
    h, decay = body[8], body[9]
    kick = h / (2.0 * body[0])  # half a step over the mass
    p = (amp[0], amp[1], amp[2], amp[3], amp[4], amp[5])
    left, right = _side(c, 0), _side(c, 1)
    lagged = flux.shape[1] > 0
    told, powered = command[command.shape[0] - 1], drive.powered[0, k]
    f_0, f_1 = drive.force[0, k], drive.force[1, k]
    f_2, f_3 = drive.force[2, k], drive.force[3, k]
    x, v = z[0], z[1]
    s_1, s_2 = z[2], z[3]
    bias, reading = z[4], z[5]

    taken_left, taken_right = c.share[0, 0], c.share[1, 0]
    now = effective_current(told, s_1, s_2, p)
    kept_left, rest_left = 0.0, 0.0
    kept_right, rest_right = 0.0, 0.0
    if lagged:
        phi_left, kept_left, rest_left = _of_lags(c, 0, flux)
        phi_right, kept_right, rest_right = _of_lags(c, 1, flux)
    else:
        phi_left = _driven(left, 0, now, bias, x, 0.0, 1.0)
        phi_right = _driven(right, 1, now, bias, x, 0.0, 1.0)
    pull = (right[3] * phi_right * phi_right - left[3] * phi_left * phi_left) / 2.0
    width = 1.0 / c.steps
    for i in range(c.steps):
        # the driven force as a cubic of tau from sample to sample, and the process thrust
        tau = (i + 0.5) * width
        pushed = c.load + (f_0 + tau * (f_1 + tau * (f_2 + tau * f_3)))

        # amplifier and bias: at the start, in the middle, at the end
        d_1, d_2 = amplifier_derivative(told, s_1, s_2, p, v)
        m_1, m_2 = s_1 + h / 2.0 * d_1, s_2 + h / 2.0 * d_2
        d_1, d_2 = amplifier_derivative(told, m_1, m_2, p, v)
        s_1, s_2 = s_1 + h * d_1, s_2 + h * d_2
        middle = effective_current(told, m_1, m_2, p)
        last = effective_current(told, s_1, s_2, p)
        ending = powered + (bias - powered) * decay
        share = (bias + ending) / 2.0
        bias = ending

        # half a step of the rotor, the flux with what drives it in the middle, the other half:
        # m x'' = sum of forces
        outer = pushed - b[1] * x - b[2] * v + _stops(b, x, v)
        v += kick * (outer + pull)
        x += h * v
        between = x - h / 2.0 * v
        if lagged:
            phi_left = _driven(left, 0, middle, share, between, kept_left, taken_left)
            phi_right = _driven(right, 1, middle, share, between, kept_right, taken_right)
            # w from phi = kept + taken w
            w_left = (phi_left - kept_left) * c.share[0, 2]
            w_right = (phi_right - kept_right) * c.share[1, 2]
            kept_left = rest_left + c.share[0, 1] * w_left
            kept_right = rest_right + c.share[1, 1] * w_right
            rest_left = _follow(c, 0, flux, w_left)
            rest_right = _follow(c, 1, flux, w_right)
        else:
            phi_left = _driven(left, 0, last, bias, x, 0.0, 1.0)
            phi_right = _driven(right, 1, last, bias, x, 0.0, 1.0)
        pull = (right[3] * phi_right * phi_right - left[3] * phi_left * phi_left) / 2.0
        outer = pushed - b[1] * x - b[2] * v + _stops(b, x, v)
        v += kick * (outer + pull)

        # the sensor's lag
        if sensor[2] > 0.0:
            reading += h * sensor[2] * (indicated(x - b[3], sensor) - reading)
    z[0], z[1] = x, v
    z[2], z[3] = s_1, s_2
    z[4], z[5] = bias, reading
    along.force[0] = pull


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
