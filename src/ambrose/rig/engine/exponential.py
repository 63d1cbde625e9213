"""The virtual rig's fast step: an exponential Runge-Kutta method of third order, exact in all that
is linear.

z' = L z + B_u u + w + B F(y, t), y = C z + D u: the propagator (equilibrium.py) moves the linear
part exactly; F is what the magnets' force is beyond its linear part, and what a change of speed or
pressure within the stretch adds. Weight, driven forces and unbalance at the propagator's speed are
exact as well. This module imports numba: import it only in functions.
"""

import math
from typing import Any

from ambrose.rig.engine.products import (
    compiled,
    coordinates,
    magnet_force,
    merged,
    products,
    rotating_force,
    seal_force,
    state_force,
    turning_force,
)

_OFF = 1e-7  # rad
fill, add = products()


@compiled
def settled(rig: Any, work: Any, drive: Any, k: int, z: Any) -> bool:
    """Whether no amplifier can come to one of its limits within sample k, and the bias stays as it
    is.

    Without limits a command is approached with u - s_1 (and (u - s_1)^2 + s_2^2 of order "second")
    falling all the time, and neither state moves farther than at its largest slope.
    """
    count = rig.amplifier.shape[0]
    amp = 2 * coordinates(rig)
    bias = amp + 2 * count
    for a in range(count):
        p = rig.amplifier[a]
        s_1 = z[amp + 2 * a]
        s_2 = z[amp + 2 * a + 1]
        if (
            drive.powered[a, k] == 0.0
            or abs(z[bias + a] - rig.magnet[a // 2, 0]) > 1e-13 * rig.magnet[a // 2, 0]
        ):
            return False

        # "second": s_1' = p_1 s_2, s_2' = p_1 (u - s_1) - p_2 s_2; reach falls all the time, so
        # |s_2| <= reach, and within the sample |s_1'| <= p_1 reach and |s_2'| <= (p_1 + p_2) reach.
        u = min(max(work.command[a], -p[4]), p[4])
        if p[0] == 3.0:
            reach = math.sqrt((u - s_1) * (u - s_1) + s_2 * s_2)
            moved = p[1] * reach * drive.dt
            if p[1] * min(reach, abs(s_2) + moved + p[2] * reach * drive.dt) >= p[3]:
                return False
            if min(abs(u) + reach, abs(s_1) + moved) >= p[4]:
                return False
        elif p[0] == 4.0:
            # v/L = w (u - s_1) + R/L s_2: motion changes s_1 within the sample, by far less than
            # the fifth of the voltage that is kept free
            if p[1] * abs(u - s_1) + p[2] * abs(s_2) >= 0.8 * p[3]:
                return False
        elif p[0] > 0.0 and p[1] * abs(u - s_1) >= p[3]:
            return False
    return True


@compiled
def _add_force(rig: Any, drive: Any, P: Any, k: int, tau: float, start: Any, F: Any) -> None:
    """F (nF,) at the outputs P.y and the fraction tau of sample k; start: unbalance at its speed,
    turned to tau.
    """
    b, y = rig.magnet.shape[0], P.y
    for i in range(b):
        c = rig.direction[i, 0]
        s = rig.direction[i, 1]
        p = rig.magnet[i]
        x = y[2 * i : 2 * i + 2]
        first, second = y[2 * b + 2 * i], y[2 * b + 2 * i + 1]
        known = (p[0], p[1], p[2], p[3], p[4], p[5], p[6], p[7], p[8], p[9])

        # the magnet's force in its axes, turned to x and y, less its linear part
        f, g = magnet_force(first, second, c * x[0] + s * x[1], c * x[1] - s * x[0], known)
        by = P.magnet[i]
        F[2 * i] = (
            c * f - s * g - by[0, 0] * x[0] - by[0, 1] * x[1] - by[0, 2] * first - by[0, 3] * second
        )
        F[2 * i + 1] = (
            s * f + c * g - by[1, 0] * x[0] - by[1, 1] * x[1] - by[1, 2] * first - by[1, 3] * second
        )

    # at, out: where the next of F and of y are; b bearings have 2 b displacements and 2 b currents
    at, out = 2 * b, 4 * b
    speed = drive.speed[k] + tau * (drive.speed[k + 1] - drive.speed[k])
    if drive.unbalance.shape[0] and P.turns:
        angle = drive.angle[k] + tau * drive.dt * (drive.speed[k] + speed) / 2
        fx, fy = turning_force(
            angle, speed, (drive.speed[k + 1] - drive.speed[k]) / drive.dt, (1.0, 0.0)
        )
        F[at], F[at + 1] = fx - start[0], fy - start[1]
        at += 2
    if P.turns:
        # gyroscopic moments and rotating damping of the speed beyond the propagator's
        p, over = rig.stiffness.shape[0], speed - P.speed
        for j in range(p):
            gx, gy = 0.0, 0.0
            for m in range(p):
                gx += rig.gyroscopic[j, m] * y[out + 2 * m]
                gy += rig.gyroscopic[j, m] * y[out + 2 * m + 1]
            F[at + 2 * j], F[at + 2 * j + 1] = -over * gy, over * gx
        for j in range(rig.rotating.shape[0]):
            v, q = out + 2 * j, out + 2 * p + 2 * j
            turning = (rig.rotating[j, 0], rig.rotating[j, 1])
            w = math.sqrt(rig.stiffness[j])
            fx, fy = rotating_force((y[q], y[q + 1]), (y[v], y[v + 1]), speed, w, turning)
            gx, gy = rotating_force((y[q], y[q + 1]), (y[v], y[v + 1]), P.speed, w, turning)
            F[at + 2 * j] += fx - gx
            F[at + 2 * j + 1] += fy - gy
        at, out = at + 2 * p, out + 2 * p + 2 * rig.rotating.shape[0]
    if P.seals:
        lags, long = rig.seal_lags.shape[1], drive.seal.shape[0] > 1
        for i in range(drive.seal.shape[1]):
            # coefficients beyond the propagator's, linear within the sample
            row, ref = P.seal[1, i], P.seal[0, i]
            for m in range(row.shape[0]):
                here, next_ = (
                    drive.seal[k if long else 0, i, m],
                    drive.seal[k + 1 if long else 0, i, m],
                )
                row[m] = here + tau * (next_ - here) - ref[m]
            row_values = (row[0], row[1], row[2], row[3], 0.0)
            fx, fy = seal_force(y[out], y[out + 1], y[out + 2], y[out + 3], 0.0, 0.0, row_values)
            out += 4
            for m in range(lags):
                gx, gy = state_force(y[out], y[out + 1], row[5 + 2 * m], row[6 + 2 * m])
                fx = fx + gx
                fy = fy + gy
                out = out + 2
            F[at], F[at + 1], at = fx, fy, at + 2


@compiled
def _show_runout(rig: Any, drive: Any, k: int, tau: float, step: float, z: Any) -> None:
    """What the run-out adds to the sensors' lagged signals within a step [s] from tau on.

    Exact at constant speed; else in pieces so short that a harmonic at their mean speed is off by
    _OFF [rad] at most.
    """
    start = 2 * coordinates(rig) + 3 * rig.amplifier.shape[0]
    rise = (drive.speed[k + 1] - drive.speed[k]) / drive.dt
    before = drive.speed[k] + tau * drive.dt * rise
    angle = drive.angle[k] + tau * drive.dt * (drive.speed[k] + before) / 2
    for a in range(rig.sensor.shape[0]):
        w = rig.sensor[a, 2]
        if w > 0.0:
            for h in range(rig.runout_start[a // 2], rig.runout_start[a // 2 + 1]):
                order = rig.runout[h, 0]
                pieces = 1 + int(step * math.sqrt(order * abs(rise) / (8.0 * _OFF)))
                piece = step / pieces

                # A lag at rate w of cos(phase + turn t) over a piece d adds
                # w Re (e^(j ahead) - e^(-w d) e^(j phase))/(w + j turn); what was there before
                # decays by e^(-w d). Within a piece the phase at its mean speed is off by
                # order |rise| d^2/8 at most.
                left, total = math.exp(-w * piece), 0.0
                phase = (
                    order * (angle - rig.sensor_angle[a // 2] - rig.sensor[a, 5]) + rig.runout[h, 2]
                )
                for i in range(pieces):
                    turn = order * (before + rise * piece * (i + 0.5))
                    ahead = phase + turn * piece
                    real = math.cos(ahead) - left * math.cos(phase)
                    imaginary = math.sin(ahead) - left * math.sin(phase)
                    total = left * total + (w * real + turn * imaginary) / (w * w + turn * turn)
                    phase = ahead
                z[start + a] += rig.sensor[a, 0] * rig.runout[h, 1] * w * total


@merged
def _enter(rig: Any, work: Any, drive: Any, P: Any, k: int, tau: float, z: Any) -> None:
    """P.known: states in use, commands within their limits, 1, unbalance, driven forces'
    derivatives over the step.
    """
    known = P.known
    n = P.states.shape[0]
    a = rig.amplifier.shape[0]
    for i in range(n):
        known[i] = z[P.states[i]]
    for i in range(a):
        known[n + i] = min(max(work.command[i], -rig.amplifier[i, 4]), rig.amplifier[i, 4])
    known[n + a] = 1.0

    # unbalance at the step's start; the propagator turns it on at this speed
    at, step = n + a + 1, 1.0 / P.steps
    if drive.unbalance.shape[0]:
        speed = drive.speed[k] + tau * (drive.speed[k + 1] - drive.speed[k])
        angle = drive.angle[k] + tau * drive.dt * (drive.speed[k] + speed) / 2
        known[at], known[at + 1] = turning_force(
            angle, speed, (drive.speed[k + 1] - drive.speed[k]) / drive.dt, (1.0, 0.0)
        )
        at += 2
    for m in range(drive.force_at.shape[0]):
        # cubic in tau; derivatives by the step's own time, ``step`` of a sample
        c = drive.force[:, m, k]
        known[at] = c[0] + tau * (c[1] + tau * (c[2] + tau * c[3]))
        known[at + 1] = step * (c[1] + tau * (2.0 * c[2] + 3.0 * tau * c[3]))
        known[at + 2] = step * step * (2.0 * c[2] + 6.0 * tau * c[3])
        known[at + 3] = step * step * step * 6.0 * c[3]
        at += 4


@merged
def propagate(rig: Any, work: Any, drive: Any, P: Any, k: int, z: Any) -> None:
    """Control sample k in the propagator's steps; three evaluations of F each."""
    n, outputs = P.states.shape[0], P.y.shape[0]
    first = P.out.shape[0] - 3 * outputs  # of the outputs, behind the states
    turned = n + rig.amplifier.shape[0] + 1
    for step in range(P.steps):
        tau, width = step / P.steps, 1.0 / P.steps
        _enter(rig, work, drive, P, k, tau, z)

        # all that is linear: states after the step, y at start, middle and end
        fill(P.linear, P.known, P.out)
        for stage in range(3):
            # y in the middle with F_0 held, at the end with 2 F_m - F_0 held (Cox & Matthews 2002,
            # ETD3RK)
            if stage == 0:
                for i in range(outputs):
                    P.y[i] = P.out[first + i]
            elif stage == 1:
                add(P.half, P.F[0], P.out, first + outputs, P.y)
            else:
                for j in range(P.F.shape[1]):
                    P.F[2, j] = 2.0 * P.F[1, j] - P.F[0, j]
                add(P.whole, P.F[2], P.out, first + 2 * outputs, P.y)

            # unbalance at the propagator's speed, turned to the stage; F has what is beyond it
            if P.turns and drive.unbalance.shape[0]:
                c, s = P.turn[stage, 0], P.turn[stage, 1]
                P.start[0] = c * P.known[turned] - s * P.known[turned + 1]
                P.start[1] = s * P.known[turned] + c * P.known[turned + 1]
            _add_force(rig, drive, P, k, tau + stage * width / 2, P.start, P.F[stage])

        # states: linear part plus the weights of F_0, F_m, F_1
        add(P.weights, P.F, P.out, 0, P.out)
        for i in range(n):
            z[P.states[i]] = P.out[i]
        if rig.runout.shape[0]:
            _show_runout(rig, drive, k, tau, drive.dt * width, z)
