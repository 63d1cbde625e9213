"""Drops, compiled: the classical Runge-Kutta method of order four over rotor, races and rings.

State z, in this order: modal displacements q (n,) and velocities (n,); per bearing, x and y each,
inner race (2b,), ring (2b,), their velocities (2b,) and (2b,); spins of the races (b,); speed and
angle of the rotor; magnet currents (2b,); then energies [J] lost so far: slip per bearing (b,),
contact damping, damping of the elements, mounts, the rotor's own (seals and couplings with it),
drag of the races, coast-down, and work of the magnets.

This module imports numba: import it only inside functions.
"""

import math
from typing import Any, NamedTuple

import numpy as np

from ambrose.model.effects import touchdown
from ambrose.rig.engine.products import OPTIONS, compile_kept, compiled, magnet_force

# What a drop is computed from and in, as the compiled kernel takes it.


class Rig(NamedTuple):
    """The rotor with its touchdown bearings as arrays, in n coordinates with b bearings.

    stiffness, damping, gyroscopic (n, n): M^-1 K and so on; rows (b, 2, n); answers (n, 2b): M^-1
    rows^T; weight (n,): M^-1 w; seals (s, 2, n) over their gaps; bearings (b, 21): of
    ``touchdown.Bearing``; inverse
    (b, 4): 1/mass of race, 1/inertia, 1/mass of ring, and mobility of the sliding [1/kg]; windage
    [N m s2]; flight: steps of free flight in one; loss (n, n): D; tally: whether its work is
    counted. axes (b, 2), magnets (b, 10), sensors (2b, n), bandwidth [rad/s]: of the magnets.
    """

    stiffness: np.ndarray
    damping: np.ndarray
    gyroscopic: np.ndarray
    rows: np.ndarray
    answers: np.ndarray
    weight: np.ndarray
    seals: np.ndarray
    bearings: np.ndarray
    inverse: np.ndarray
    polar_inertia: float
    windage: float
    flight: int
    loss: np.ndarray
    tally: bool
    axes: np.ndarray
    magnets: np.ndarray
    sensors: np.ndarray
    bandwidth: float


class SampledLaw(NamedTuple):
    """A controller between samples: A (s, s), B (s, a), C (a, s), D (a, a); slow: its first states
    that rest in contact; period: steps per sample; limit [A] of currents, reading [m] of sensors.
    """

    A: np.ndarray
    B: np.ndarray
    C: np.ndarray
    D: np.ndarray
    slow: int
    period: int
    limit: float
    reading: float


class Case(NamedTuple):
    """What differs from drop to drop: unbalance cosine, sine (n,) [m] times M^-1; factors on
    friction, mount stiffness and damping; brake [N m].
    """

    cosine: np.ndarray
    sine: np.ndarray
    friction: float
    mount_stiffness: float
    mount_damping: float
    brake: float


class Work(NamedTuple):
    """Room for one drop at a time."""

    slopes: np.ndarray
    turning: np.ndarray
    seen: np.ndarray
    place: np.ndarray
    turns: np.ndarray
    states: np.ndarray
    fresh: np.ndarray
    command: np.ndarray


_REST = 1.0  # [rad/s] below which drag and braking fade
_LOSSES = 7  # beside the bearings' slip
_NEAR = 1.5  # steps of free flight that must fit into the gap that is left

contact = compiled(touchdown.force)
elements = compiled(touchdown.elements)
mount = compiled(touchdown.mount)
race_drag = compiled(touchdown.race_drag)


@compiled
def _slope(
    rig: Any, case: Any, work: Any, powered: bool, dt: float, c: float, s: float, z: Any, dz: Any
) -> None:
    """dz/dt; c, s: cosine and sine of the rotor's angle. work.turning (n, n): M^-1 (D + W G);
    work.seen (b, 3): normal force, load of the elements [N], depth [m].
    """
    turning, seen = work.turning, work.seen
    n, b = rig.stiffness.shape[0], rig.bearings.shape[0]
    race, ring = 2 * n, 2 * n + 2 * b
    race_v, ring_v = 2 * n + 4 * b, 2 * n + 6 * b
    spin = 2 * n + 8 * b
    W = z[spin + b]
    current, lost = spin + b + 2, spin + b + 2 + 2 * b
    for k in range(lost, z.shape[0]):
        dz[k] = 0.0

    # the rotor alone: q'' = w + W^2 (a cos + b sin) - M^-1 (D + W G) v - M^-1 K q
    own = 0.0
    for i in range(n):
        total = rig.weight[i] + W * W * (case.cosine[i] * c + case.sine[i] * s)
        for j in range(n):
            total -= turning[i, j] * z[n + j] + rig.stiffness[i, j] * z[j]
        dz[i] = z[n + i]
        dz[n + i] = total
        if rig.tally:
            for j in range(n):
                own += z[n + i] * rig.loss[i, j] * z[n + j]
    torque = -case.brake * W / (abs(W) + _REST) - rig.windage * W * abs(W)
    braked = -torque * W
    for k in range(b):
        p = rig.bearings[k]
        x, y = 0.0, 0.0
        vx, vy = 0.0, 0.0
        for j in range(n):
            x += rig.rows[k, 0, j] * z[j]
            y += rig.rows[k, 1, j] * z[j]
            vx += rig.rows[k, 0, j] * z[n + j]
            vy += rig.rows[k, 1, j] * z[n + j]
        has_race, has_ring = p[9] > 0.0, p[16] > 0.0
        # what the rotor meets: the race, else the ring, else the housing
        at, at_v = (race, race_v) if has_race else (ring, ring_v)
        moves = has_race or has_ring
        dx, dy = x, y
        ux, uy = vx, vy
        if moves:
            dx, dy = x - z[at + 2 * k], y - z[at + 2 * k + 1]
            ux, uy = vx - z[at_v + 2 * k], vy - z[at_v + 2 * k + 1]
        # the contact; friction fades no faster than a step can follow
        spun = W - z[spin + k] * has_race
        lag = 0.7 * dt * rig.inverse[k, 3]
        fx, fy, moment, normal = contact(dx, dy, ux, uy, spun, p, case.friction, lag)
        torque += moment
        r = math.sqrt(dx * dx + dy * dy)
        depth = r - p[0]
        dz[lost + k] = 0.0
        if depth > 0.0:
            dz[lost + k] = -moment * ((uy * dx - ux * dy) / (r * p[5]) + spun)
            # what is not its spring; where the damping would pull, the spring's energy goes too
            dz[lost + b] += (normal - p[1] * depth) * (ux * dx + uy * dy) / r
        load = 0.0
        dz[spin + k] = 0.0
        ring_x, ring_y = -fx, -fy  # on the ring
        if has_race:
            # rolling elements between race and ring (or housing)
            gx, gy = z[race + 2 * k], z[race + 2 * k + 1]
            hx, hy = z[race_v + 2 * k], z[race_v + 2 * k + 1]
            if has_ring:
                gx, gy = gx - z[ring + 2 * k], gy - z[ring + 2 * k + 1]
                hx, hy = hx - z[ring_v + 2 * k], hy - z[ring_v + 2 * k + 1]
            ring_x, ring_y, load = elements(gx, gy, hx, hy, p)
            dz[lost + b + 1] += p[13] * (hx * hx + hy * hy)
            dz[race + 2 * k] = z[race_v + 2 * k]
            dz[race + 2 * k + 1] = z[race_v + 2 * k + 1]
            dz[race_v + 2 * k] = (-fx - ring_x) * rig.inverse[k, 0]
            dz[race_v + 2 * k + 1] = (-fy - ring_y) * rig.inverse[k, 0]
            # spin of the race: I w' = -moment - drag
            drag = race_drag(z[spin + k], load, p)
            dz[spin + k] = (-moment - drag) * rig.inverse[k, 1]
            dz[lost + b + 4] += drag * z[spin + k]
        else:
            for j in range(2):
                dz[race + 2 * k + j] = dz[race_v + 2 * k + j] = 0.0
        if has_ring:
            tx, ty = z[ring_v + 2 * k], z[ring_v + 2 * k + 1]
            held_x, held_y = mount(
                z[ring + 2 * k],
                z[ring + 2 * k + 1],
                tx,
                ty,
                p,
                case.mount_stiffness,
                case.mount_damping,
            )
            dz[ring + 2 * k], dz[ring + 2 * k + 1] = tx, ty
            dz[ring_v + 2 * k] = (ring_x + held_x) * rig.inverse[k, 2]
            dz[ring_v + 2 * k + 1] = (ring_y + held_y) * rig.inverse[k, 2]
            dz[lost + b + 2] += case.mount_damping * p[18] * (tx * tx + ty * ty)
        else:
            for j in range(2):
                dz[ring + 2 * k + j] = dz[ring_v + 2 * k + j] = 0.0
        seen[k, 0], seen[k, 1] = normal, load
        seen[k, 2] = depth

        # magnets, once they are on again: along the bearing's axes
        if powered:
            for j in range(2):
                a = 2 * k + j
                dz[current + a] = rig.bandwidth * (work.command[a] - z[current + a])
            ca, sa = rig.axes[k, 0], rig.axes[k, 1]
            zeta, eta = ca * x + sa * y, ca * y - sa * x
            pulled = magnet_force(
                z[current + 2 * k], z[current + 2 * k + 1], zeta, eta, rig.magnets[k]
            )
            mx, my = ca * pulled[0] - sa * pulled[1], sa * pulled[0] + ca * pulled[1]
            fx, fy = fx + mx, fy + my
            dz[lost + b + 6] -= mx * vx + my * vy
        else:
            dz[current + 2 * k] = dz[current + 2 * k + 1] = 0.0
        if fx != 0.0 or fy != 0.0:
            for i in range(n):
                dz[n + i] += rig.answers[i, 2 * k] * fx + rig.answers[i, 2 * k + 1] * fy
    dz[spin + b] = torque / rig.polar_inertia
    dz[spin + b + 1] = W
    dz[lost + b + 3] = own
    dz[lost + b + 5] = braked


@compiled
def _control(rig: Any, law: SampledLaw, z: Any, work: Any, touching: bool) -> None:
    """One sample: e = -y into x+ = A x + B e, u = C x + D e; slow states (the first ones) rest in
    contact, what is read and set stops at its limits.
    """
    n, axes = rig.stiffness.shape[0], law.C.shape[0]
    x, fresh = work.states, work.fresh
    for a in range(axes):
        y = 0.0
        for j in range(n):
            y += rig.sensors[a, j] * z[j]
        fresh[a] = -min(max(y, -law.reading), law.reading)
    for a in range(axes):
        u = 0.0
        for j in range(x.shape[1]):
            u += law.C[a, j] * x[0, j]
        for j in range(axes):
            u += law.D[a, j] * fresh[j]
        work.command[a] = min(max(u, -law.limit), law.limit)
    for i in range(x.shape[1]):
        total = 0.0
        for j in range(x.shape[1]):
            total += law.A[i, j] * x[0, j]
        for j in range(axes):
            total += law.B[i, j] * fresh[j]
        x[1, i] = x[0, i] if touching and i < law.slow else total
    for i in range(x.shape[1]):
        x[0, i] = x[1, i]


def entry_point(fingerprint: int) -> Any:
    """``fall``, compiled; kept on disk for the next process under a fingerprint of what it
    contains.
    """

    def fall(
        rig: Any,
        law: SampledLaw,
        case: Any,
        z: Any,
        steps: int,
        dt: float,
        start: int,
        every: int,
        work: Any,
        figures: Any,
        places: Any,
        log: Any,
    ) -> int:
        """One drop of ``steps`` steps of dt [s]; z ends as its last state. start: step at which the
        magnets are on again. every: steps per row of log (0: none).

        figures (b, 14): first contact [s], first force peak [N], largest force [N], largest load of
        the elements, time in contact [s], largest displacement [m], turns against the spin and with
        it without going back, fastest and last whole turn against the spin [s], largest spin of
        the race [rad/s], largest displacement of the ring [m], last contact [s], largest force [N]
        with the magnets on. places (s,): largest displacement at
        the seals over their gap. Returns the steps done: fewer where the state overflowed.
        """
        assert fingerprint
        n, b = rig.stiffness.shape[0], rig.bearings.shape[0]
        size = z.shape[0]
        speed = 2 * n + 9 * b
        ring = 2 * n + 2 * b
        dz = work.slopes[0]
        trial, total = work.slopes[1], work.slopes[2]
        turning, seen = work.turning, work.seen
        step, row = 0, 0
        next_sample = start
        touching, powered = False, False
        while step < steps:
            # free flight goes in longer steps, as long as nothing can be met within one
            long = rig.flight
            for k in range(b):
                x, y = work.place[k, 0], work.place[k, 1]
                gap = rig.bearings[k, 0] - math.sqrt(x * x + y * y)
                vx, vy = work.place[k, 4], work.place[k, 5]
                if gap < _NEAR * long * dt * math.sqrt(vx * vx + vy * vy) + 1e-7:
                    long = 1
                    break
            if every and long > 1:
                long = min(long, every - step % every)
            if step < start < step + long:
                long = start - step
            if powered:
                long = max(min(long, next_sample - step), 1)
            h = min(long, steps - step) * dt
            if step >= next_sample:
                powered = True
                _control(rig, law, z, work, touching)
                next_sample += law.period
            W = z[speed]
            for i in range(n):
                for j in range(n):
                    turning[i, j] = rig.damping[i, j] + W * rig.gyroscopic[i, j]
            if every and step % every == 0 and row < log.shape[0]:
                log[row, 0] = step * dt
                log[row, 1] = W
                for k in range(b):
                    at = 2 + 8 * k
                    log[row, at], log[row, at + 1] = work.place[k, 0], work.place[k, 1]
                    log[row, at + 2] = seen[k, 0]
                    log[row, at + 3] = z[2 * n + 8 * b + k]
                    met = (2 * n if rig.bearings[k, 9] > 0.0 else ring) + 2 * k
                    log[row, at + 4], log[row, at + 5] = z[met], z[met + 1]
                    log[row, at + 6] = z[speed + 2 + 2 * b + k]
                    log[row, at + 7] = seen[k, 1]
                row += 1
            for i in range(size):
                trial[i] = total[i] = z[i]
            c, s = math.cos(z[speed + 1]), math.sin(z[speed + 1])
            # half a step turns by so little that three terms of the series are exact
            a = 0.5 * h * W
            turn_c, turn_s = 1.0 - a * a / 2 + a**4 / 24, a - a**3 / 6 + a**5 / 120
            for stage in range(4):
                if stage % 2 == 1:  # at the half step, and at the end
                    c, s = c * turn_c - s * turn_s, s * turn_c + c * turn_s
                _slope(rig, case, work, powered, h, c, s, trial, dz)
                weight = h / 6 if stage % 3 == 0 else h / 3
                ahead = h if stage == 2 else h / 2
                for i in range(size):
                    total[i] += weight * dz[i]
                    trial[i] = z[i] + ahead * dz[i]
            check = 0.0
            for i in range(size):
                z[i] = total[i]
            for i in range(2 * n):
                check += z[i]
            if not np.isfinite(check):
                return step
            step += max(round(h / dt), 1)

            # figures of the step
            now = step * dt
            touching = False
            for k in range(b):
                x, y = 0.0, 0.0
                vx, vy = 0.0, 0.0
                for j in range(n):
                    x += rig.rows[k, 0, j] * z[j]
                    y += rig.rows[k, 1, j] * z[j]
                    vx += rig.rows[k, 0, j] * z[n + j]
                    vy += rig.rows[k, 1, j] * z[n + j]
                last_x, last_y = work.place[k, 0], work.place[k, 1]
                r2 = x * x + y * y
                N = seen[k, 0]
                if N > 0.0:
                    touching = True
                    if figures[k, 0] < 0.0:
                        figures[k, 0] = now - h
                    figures[k, 4] += h
                    figures[k, 12] = now
                    if powered:
                        figures[k, 13] = max(figures[k, 13], N)
                    figures[k, 2] = max(figures[k, 2], N)
                    if work.place[k, 3] == 0.0:
                        figures[k, 1] = max(figures[k, 1], N)
                elif figures[k, 0] >= 0.0:
                    work.place[k, 3] = 1.0  # it has left the bearing once
                figures[k, 3] = max(figures[k, 3], seen[k, 1])
                figures[k, 5] = max(figures[k, 5], r2)
                w = z[2 * n + 8 * b + k]
                figures[k, 10] = max(figures[k, 10], w)
                sx, sy = z[ring + 2 * k], z[ring + 2 * k + 1]
                figures[k, 11] = max(figures[k, 11], sx * sx + sy * sy)
                # angle gone around the housing, where the rotor is off its centre
                if r2 > 0.09 * rig.bearings[k, 0] ** 2:
                    work.place[k, 2] += (last_x * y - last_y * x) / r2
                theta = work.place[k, 2]
                # furthest against the spin since the furthest with it, and the other way round
                work.turns[k, 0] = max(work.turns[k, 0], theta)
                work.turns[k, 1] = min(work.turns[k, 1], theta)
                figures[k, 6] = max(figures[k, 6], work.turns[k, 0] - theta)
                figures[k, 7] = max(figures[k, 7], theta - work.turns[k, 1])
                # whole turns against the spin, timed
                if theta > work.turns[k, 2] + 2 * math.pi:
                    work.turns[k, 2], work.turns[k, 3] = theta - 2 * math.pi, now
                elif theta < work.turns[k, 2] - 2 * math.pi:
                    turn = now - work.turns[k, 3]
                    if figures[k, 8] == 0.0 or turn < figures[k, 8]:
                        figures[k, 8] = turn
                    figures[k, 9] = turn
                    work.turns[k, 2] -= 2 * math.pi
                    work.turns[k, 3] = now
                work.place[k, 0], work.place[k, 1] = x, y
                work.place[k, 4], work.place[k, 5] = vx, vy
            for seal in range(rig.seals.shape[0]):
                x, y = 0.0, 0.0
                for j in range(n):
                    x += rig.seals[seal, 0, j] * z[j]
                    y += rig.seals[seal, 1, j] * z[j]
                places[seal] = max(places[seal], x * x + y * y)
        return step

    (compiled_fall,) = compile_kept((fall,), nogil=True, **OPTIONS)
    return compiled_fall
