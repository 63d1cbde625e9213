"""The virtual rig's compiled part: one function per stage of the machine, and a fixed-step
Runge-Kutta method around them.

State z (n,): displacements - the rotor's modal ones, x and y in turn (q_1x, q_1y, q_2x, ...), then
those of the supports -, their velocities, then two amplifier states [A] per axis, the bias currents
[A], the sensors' lagged signals [m], the seals' lagged displacements x, y [m], the states of
registered effects. The forces are those of ``model.effects``, compiled as they stand. This module
imports numba: import it only inside functions. What the arrays hold is said in state.py and
inputs.py.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from ambrose.rig.engine.axial_kernel import measured, move, write_down
from ambrose.rig.engine.controller import command, control, run_program
from ambrose.rig.engine.exponential import propagate, settled
from ambrose.rig.engine.products import (
    OPTIONS,
    amplifier_derivative,
    by_address,
    coil_current,
    compile_kept,
    compiled,
    contact_force,
    converted,
    coordinates,
    effective_current,
    element_forces,
    indicated,
    lag as sensor_lag,
    magnet_force,
    merged,
    mount_force,
    race_drag,
    rotating_force,
    runout,
    seal_force,
    seal_lag,
    state_force,
    stops,
    turning_force,
)

if TYPE_CHECKING:
    from ambrose.rig.engine.controller import SampledLaw

_FAR_OUT = 0.4  # of the clearance: where magnets bend much
_DENSE = 32  # integration steps far out and near contact for each of the others
# of a step in which a contact begins or ends or a stop is reached, and of the part in which it is
_PARTS = 32
_FEWER = 4  # where race and ring set the step
# [m] and, times a pace [1/s], [m/s] within which race and ring stand
_STILL, _PACE = 1e-9, 1e3
_STOPPED = 1 - 1e-12  # of a stop: from where on it is reached
# of a depth and the rounding of the damping's onset: by how much a step may change that depth
_BEND = 0.25


@compiled
def _move(rig: Any, work: Any, z: Any) -> None:
    """Displacements and velocities of the stations, relative to what they stand on."""
    p, n = rig.stiffness.shape[0], coordinates(rig)
    for s in range(work.place.shape[0]):
        x = 0.0
        y = 0.0
        vx = 0.0
        vy = 0.0
        for j in range(p):
            shape = rig.shape[s, j]
            x += shape * z[2 * j]
            y += shape * z[2 * j + 1]
            vx += shape * z[n + 2 * j]
            vy += shape * z[n + 2 * j + 1]
        # less what the supports move under the station
        for i in range(rig.support.shape[0]):
            a, b = rig.support_shape[s, 0, i], rig.support_shape[s, 1, i]
            x, y = x - a * z[2 * p + i], y - b * z[2 * p + i]
            vx, vy = vx - a * z[n + 2 * p + i], vy - b * z[n + 2 * p + i]
        work.place[s, 0], work.place[s, 1] = x, y
        work.velocity[s, 0], work.velocity[s, 1] = vx, vy
        work.force[s, 0] = work.force[s, 1] = 0.0


@compiled
def _magnetise(rig: Any, work: Any, z: Any) -> None:
    """Magnet forces in the bearings' axes, from the currents that make force."""
    amp = 2 * coordinates(rig)
    bias = amp + 2 * rig.amplifier.shape[0]
    for b in range(rig.magnet.shape[0]):
        # x, y in the bearing's axes: zeta = c x + s y, eta = c y - s x
        c = rig.direction[b, 0]
        s = rig.direction[b, 1]
        p = rig.magnet[b]
        x, y = work.place[b, 0], work.place[b, 1]
        i, j = 2 * b, 2 * b + 1
        first = effective_current(
            work.command[i], z[amp + 2 * i], z[amp + 2 * i + 1], rig.amplifier[i]
        )
        second = effective_current(
            work.command[j], z[amp + 2 * j], z[amp + 2 * j + 1], rig.amplifier[j]
        )

        # parameters with the bias current as it is now in place of i_0
        known = (z[bias + i], p[1], p[2], p[3], p[4], p[5], p[6], p[7], p[8], p[9])
        f_zeta, f_eta = magnet_force(first, second, c * x + s * y, c * y - s * x, known)
        if z[bias + j] != z[bias + i]:  # one of the axes has failed
            other = (z[bias + j], p[1], p[2], p[3], p[4], p[5], p[6], p[7], p[8], p[9])
            _, f_eta = magnet_force(first, second, c * x + s * y, c * y - s * x, other)

        # back to x and y
        work.magnet[i], work.magnet[j] = f_zeta, f_eta
        work.force[b, 0] += c * f_zeta - s * f_eta
        work.force[b, 1] += s * f_zeta + c * f_eta


@compiled
def _met(rig: Any, work: Any, b: int, z: Any) -> tuple[float, float, float, float]:
    """Place and velocity of the rotor in touchdown bearing b, against what it meets: the race, else
    the ring, else the housing.
    """
    x, y = work.place[b, 0], work.place[b, 1]
    vx, vy = work.velocity[b, 0], work.velocity[b, 1]
    if rig.behind > 0:
        at = z.shape[0] - rig.behind * (rig.touchdown.shape[0] - b)
        if rig.stator[b, 0] == 0.0:
            at += 2
        x, y = x - z[at], y - z[at + 1]
        vx, vy = vx - z[at + 4], vy - z[at + 5]
    return x, y, vx, vy


@compiled
def _touch(rig: Any, work: Any, speed: float, z: Any, dz: Any) -> None:
    """Touchdown bearings, with race and ring behind the contact."""
    for b in range(rig.touchdown.shape[0]):
        p = rig.touchdown[b]
        x, y, vx, vy = _met(rig, work, b, z)
        at = z.shape[0] - rig.behind * (rig.touchdown.shape[0] - b)
        fx, fy = 0.0, 0.0
        moment = 0.0
        if x * x + y * y > p[0] * p[0]:
            spun = speed
            lag = 0.0
            if rig.behind > 0:
                spun -= z[at + 8]
                lag = 0.7 * rig.contact_step * rig.stator[b, 3]
            fx, fy, moment, _ = contact_force(x, y, vx, vy, spun, p, 1.0, lag)
            work.force[b, 0] += fx
            work.force[b, 1] += fy
        if rig.behind > 0:
            _yield(rig, b, fx, fy, moment, z[at : at + 9], dz[at : at + 9])


@compiled
def _yield(rig: Any, b: int, fx: float, fy: float, moment: float, s: Any, ds: Any) -> None:
    """Race and ring of touchdown bearing b under the contact's force on the rotor; s, ds (9,): race
    x, y, ring x, y, their velocities, spin of the race.
    """
    p = rig.touchdown[b]
    race, ring = rig.stator[b, 0], rig.stator[b, 2]
    spin = rig.stator[b, 1]
    for j in range(9):
        ds[j] = 0.0
    gx, gy = -fx, -fy  # on the ring
    if race > 0.0:
        gx, gy, load = element_forces(s[0] - s[2], s[1] - s[3], s[4] - s[6], s[5] - s[7], p)
        ds[0], ds[1] = s[4], s[5]
        ds[4], ds[5] = (-fx - gx) * race, (-fy - gy) * race
        ds[8] = (-moment - race_drag(s[8], load, p)) * spin
    if ring > 0.0:
        hx, hy = mount_force(s[2], s[3], s[6], s[7], p, 1.0, 1.0)
        ds[2], ds[3] = s[6], s[7]
        ds[6], ds[7] = (gx + hx) * ring, (gy + hy) * ring


@compiled
def _stands(rig: Any, drive: Any, z: Any) -> bool:
    """Whether races and rings stand still in the middle, and are then put there; their spins fall
    by the drag of a sample.
    """
    count = rig.touchdown.shape[0]
    first = z.shape[0] - rig.behind * count
    for b in range(count if rig.behind > 0 else 0):
        at = first + rig.behind * b
        for j in range(4):
            if abs(z[at + j]) > _STILL or abs(z[at + 4 + j]) > _STILL * _PACE:
                return False
    for b in range(count if rig.behind > 0 else 0):
        at = first + rig.behind * b
        for j in range(8):
            z[at + j] = 0.0
        z[at + 8] -= drive.dt * race_drag(z[at + 8], 0.0, rig.touchdown[b]) * rig.stator[b, 1]
    return True


@compiled
def _attach(
    rig: Any, work: Any, drive: Any, k: int, tau: float, speed: float, z: Any, dz: Any
) -> None:
    """Registered effects: [f; x'] = block [q; q'; x] in their axes, the block linear within a
    sample; or the force at an address.
    """
    # count: stations of effects, after the bearings' ``first``
    count, first = rig.force_at.shape[0], rig.magnet.shape[0]
    if count == 0:
        return

    # their states follow those of the seals' lags
    states = 2 * coordinates(rig) + 3 * rig.amplifier.shape[0] + rig.sensor.shape[0]
    states += 2 * rig.seal_lags.shape[0] * rig.seal_lags.shape[1]

    # the columns (q, q', x): displacements, then velocities in the effects' axes, then states
    for i in range(count):
        c, s = rig.direction[first + i, 0], rig.direction[first + i, 1]
        x, y = work.place[first + i, 0], work.place[first + i, 1]
        vx, vy = work.velocity[first + i, 0], work.velocity[first + i, 1]
        work.attached[2 * i], work.attached[2 * i + 1] = c * x + s * y, c * y - s * x
        at = 2 * (count + i)
        work.attached[at], work.attached[at + 1] = c * vx + s * vy, c * vy - s * vx
    rows = drive.reaction.shape[1]
    for j in range(rows - 2 * count):
        work.attached[4 * count + j] = z[states + j]

    # [f; x'] with the block linear between the samples k and k + 1
    varying = drive.reaction.shape[0] > 1
    here, ahead = drive.reaction[k if varying else 0], drive.reaction[k + 1 if varying else 0]
    t = tau if varying else 0.0
    for r in range(rows):
        value = 0.0
        for j in range(work.attached.shape[0]):
            value += (here[r, j] + t * (ahead[r, j] - here[r, j])) * work.attached[j]
        if r < 2 * count:
            work.pull[r] = value
        else:
            dz[states + r - 2 * count] = value
    for i in range(count):
        c, s = rig.direction[first + i, 0], rig.direction[first + i, 1]
        f, g = work.pull[2 * i], work.pull[2 * i + 1]
        # a force that is not linear: asked (x, y, vx, vy, speed), answered behind these five
        if rig.force_at[i, 0] != 0:
            for j in range(2):
                work.asked[j] = work.attached[2 * i + j]
                work.asked[2 + j] = work.attached[2 * (count + i) + j]
            work.asked[4] = speed
            asked = work.asked_at[0]
            by_address(rig.force_at[i, 0], rig.force_at[i, 1], asked, asked, asked + 5 * 8)
            f, g = work.asked[5], work.asked[6]
        work.force[first + i, 0] += c * f - s * g
        work.force[first + i, 1] += s * f + c * g


@compiled
def _whirl(rig: Any, work: Any, drive: Any, k: int, tau: float, z: Any, dz: Any) -> None:
    """Seals and their lags, coefficients linear within a sample; their added mass is in the mass
    matrix.
    """
    lag = 2 * coordinates(rig) + 3 * rig.amplifier.shape[0] + rig.sensor.shape[0]
    first = rig.magnet.shape[0] + rig.force_at.shape[0]
    varying = drive.seal.shape[0] > 1
    for i in range(drive.seal.shape[1]):
        # K, k, C, c, M, then direct and cross of every state; linear within the sample
        at, to = drive.seal[k if varying else 0, i], drive.seal[k + 1 if varying else 0, i]
        t = tau if varying else 0.0
        stiffness, cross = at[0] + t * (to[0] - at[0]), at[1] + t * (to[1] - at[1])
        damping, across = at[2] + t * (to[2] - at[2]), at[3] + t * (to[3] - at[3])
        x, y = work.place[first + i, 0], work.place[first + i, 1]
        vx, vy = work.velocity[first + i, 0], work.velocity[first + i, 1]
        fx, fy = seal_force(x, y, vx, vy, 0.0, 0.0, (stiffness, cross, damping, across, 0.0))
        count = rig.seal_lags.shape[1]
        end = lag + 2 * count
        # states' forces, and their lags behind the displacements
        for m in range(count):
            direct = at[5 + 2 * m] + t * (to[5 + 2 * m] - at[5 + 2 * m])
            cross = at[6 + 2 * m] + t * (to[6 + 2 * m] - at[6 + 2 * m])
            gx, gy = state_force(z[lag + 2 * m], z[lag + 2 * m + 1], direct, cross)
            fx, fy = fx + gx, fy + gy
            row = rig.seal_lags[i, m]
            dz[lag + 2 * m] = seal_lag(x, z[lag:end:2], row)
            dz[lag + 2 * m + 1] = seal_lag(y, z[lag + 1 : end : 2], row)
        lag = end
        work.force[first + i, 0] += fx
        work.force[first + i, 1] += fy


@compiled
def _disturb(rig: Any, work: Any, drive: Any, k: int, tau: float, speed: float) -> None:
    """The scenario's forces, weight and unbalance, on the rotor alone."""
    for j in range(rig.weight.shape[0]):
        work.modal[j] = rig.weight[j]

    # forces: cubics in tau along an axis of their station
    for m in range(drive.force_at.shape[0]):
        value = drive.force[0, m, k] + tau * (
            drive.force[1, m, k] + tau * (drive.force[2, m, k] + tau * drive.force[3, m, k])
        )
        s, axis = drive.force_at[m, 0], drive.force_at[m, 1]
        c, d = rig.direction[s, 0], rig.direction[s, 1]
        fx, fy = value * (c if axis == 0 else -d), value * (d if axis == 0 else c)
        for j in range(rig.stiffness.shape[0]):
            work.modal[2 * j] += rig.shape[s, j] * fx
            work.modal[2 * j + 1] += rig.shape[s, j] * fy

    # unbalance; the angle is the integral of a speed linear in the sample
    acceleration = (drive.speed[k + 1] - drive.speed[k]) / drive.dt
    if drive.unbalance.shape[0] and (speed != 0.0 or acceleration != 0.0):
        angle = drive.angle[k] + tau * drive.dt * (drive.speed[k] + speed) / 2
        fx, fy = turning_force(angle, speed, acceleration, (1.0, 0.0))
        for j in range(drive.unbalance.shape[0]):
            a, b = drive.unbalance[j, 0], drive.unbalance[j, 1]
            work.modal[2 * j] += a * fx - b * fy
            work.modal[2 * j + 1] += a * fy + b * fx


@compiled
def _accelerate(rig: Any, work: Any, drive: Any, k: int, speed: float, z: Any, dz: Any) -> None:
    """Rotor and supports: accelerations from modal and station forces, gyroscopic moments, added
    mass.
    """
    p, n = rig.stiffness.shape[0], coordinates(rig)

    # q'' = f - omega^2 q - 2 zeta omega q'
    for j in range(p):
        fx, fy = work.modal[2 * j], work.modal[2 * j + 1]
        for s in range(work.force.shape[0]):
            fx += rig.shape[s, j] * work.force[s, 0]
            fy += rig.shape[s, j] * work.force[s, 1]
        vx, vy = z[n + 2 * j], z[n + 2 * j + 1]
        dz[2 * j], dz[2 * j + 1] = vx, vy
        dz[n + 2 * j] = fx - rig.stiffness[j] * z[2 * j] - rig.damping[j] * vx
        dz[n + 2 * j + 1] = fy - rig.stiffness[j] * z[2 * j + 1] - rig.damping[j] * vy

    # supports: the reaction to the stations' forces
    for i in range(rig.support.shape[0]):
        f, v = 0.0, z[n + 2 * p + i]
        for s in range(work.force.shape[0]):
            f -= (
                rig.support_shape[s, 0, i] * work.force[s, 0]
                + rig.support_shape[s, 1, i] * work.force[s, 1]
            )
        dz[2 * p + i] = v
        dz[n + 2 * p + i] = f - rig.support[i, 0] * z[2 * p + i] - rig.support[i, 1] * v

    # -Omega G q', G = g (x) [[0, 1], [-1, 0]]
    if speed != 0.0:
        for j in range(p):
            gx, gy = 0.0, 0.0
            for m in range(p):
                gx += rig.gyroscopic[j, m] * z[n + 2 * m]
                gy += rig.gyroscopic[j, m] * z[n + 2 * m + 1]
            dz[n + 2 * j] -= speed * gy
            dz[n + 2 * j + 1] += speed * gx
        # damping that turns with the rotor
        for j in range(rig.rotating.shape[0]):
            a, b = n + 2 * j, n + 2 * j + 1
            known = (rig.rotating[j, 0], rig.rotating[j, 1])
            w = math.sqrt(rig.stiffness[j])
            fx, fy = rotating_force((z[2 * j], z[2 * j + 1]), (z[a], z[b]), speed, w, known)
            dz[a] += fx
            dz[b] += fy

    # added mass M of seals and effects: (I + M)^-1 times the accelerations so far
    if drive.mass_inverse.shape[0]:
        inverse = drive.mass_inverse[k if drive.mass_inverse.shape[0] > 1 else 0]
        for j in range(n):
            work.modal[j] = dz[n + j]

        # over all coordinates, or over those of one plane, the same in x and y
        if inverse.shape[0] == n:  # a seal with added mass on a support
            for j in range(n):
                total = 0.0
                for m in range(n):
                    total += inverse[j, m] * work.modal[m]
                dz[n + j] = total
            return
        for j in range(p):
            ax, ay = 0.0, 0.0
            for m in range(p):
                ax += inverse[j, m] * work.modal[2 * m]
                ay += inverse[j, m] * work.modal[2 * m + 1]
            dz[n + 2 * j], dz[n + 2 * j + 1] = ax, ay


@compiled
def _amplify(rig: Any, work: Any, drive: Any, k: int, z: Any, dz: Any) -> None:
    """Amplifiers and bias currents, both within the slope that the voltage allows."""
    count = rig.amplifier.shape[0]
    amp = 2 * coordinates(rig)
    for a in range(count):
        i = amp + 2 * a
        j = amp + 2 * count + a
        p = rig.amplifier[a]
        # the rotor's velocity along the axis, for the back-EMF
        c, s = rig.direction[a // 2, 0], rig.direction[a // 2, 1]
        vx, vy = work.velocity[a // 2, 0], work.velocity[a // 2, 1]
        v = c * vx + s * vy if a % 2 == 0 else c * vy - s * vx
        dz[i], dz[i + 1] = amplifier_derivative(work.command[a], z[i], z[i + 1], p, v)
        # bias current, off without power
        target = rig.magnet[a // 2, 0] * drive.powered[a, k]
        dz[j] = min(max(rig.bias_rate * (target - z[j]), -p[3]), p[3])


@compiled
def _signal(rig: Any, z: Any, a: int, angle: float) -> float:
    """The signal [m] of sensor a before its lag."""
    b = a // 2
    c, s = rig.sensor_direction[b, 0], rig.sensor_direction[b, 1]
    x = 0.0
    y = 0.0
    p = rig.stiffness.shape[0]
    for j in range(p):
        x += rig.sensor_shape[b, j] * z[2 * j]
        y += rig.sensor_shape[b, j] * z[2 * j + 1]
    for i in range(rig.support.shape[0]):
        x -= rig.sensor_support[b, 0, i] * z[2 * p + i]
        y -= rig.sensor_support[b, 1, i] * z[2 * p + i]

    # the sensor's own direction, then run-out, then gain, offset
    value = c * x + s * y if a % 2 == 0 else c * y - s * x
    track = rig.runout[rig.runout_start[b] : rig.runout_start[b + 1]]
    if track.shape[0]:
        value += runout(angle - rig.sensor_angle[b], track, rig.sensor[a])
    return indicated(value, rig.sensor[a])


@compiled
def _sense(rig: Any, drive: Any, k: int, tau: float, speed: float, z: Any, dz: Any) -> None:
    """Lags of the sensors."""
    start = 2 * coordinates(rig) + 3 * rig.amplifier.shape[0]
    for a in range(rig.sensor.shape[0]):
        dz[start + a] = 0.0
        if rig.sensor[a, 2] > 0.0:
            angle = drive.angle[k] + tau * drive.dt * (drive.speed[k] + speed) / 2
            dz[start + a] = sensor_lag(_signal(rig, z, a, angle), z[start + a], rig.sensor[a])


@merged
def _derivative(rig: Any, work: Any, drive: Any, k: int, tau: float, z: Any, dz: Any) -> None:
    """dz/dt at the fraction tau of control sample k: the machine, stage by stage."""
    speed = drive.speed[k] + tau * (drive.speed[k + 1] - drive.speed[k])
    _move(rig, work, z)
    _magnetise(rig, work, z)
    _touch(rig, work, speed, z, dz)
    _attach(rig, work, drive, k, tau, speed, z, dz)
    _whirl(rig, work, drive, k, tau, z, dz)
    _disturb(rig, work, drive, k, tau, speed)
    _accelerate(rig, work, drive, k, speed, z, dz)
    _amplify(rig, work, drive, k, z, dz)
    _sense(rig, drive, k, tau, speed, z, dz)


@compiled
def _farthest(rig: Any, work: Any, dt: float) -> float:
    """How far the rotor may get within dt [s], as it moves now, of a touchdown bearing's
    clearance.
    """
    farthest = 0.0
    for b in range(rig.touchdown.shape[0]):
        x = work.place[b, 0]
        y = work.place[b, 1]
        vx = work.velocity[b, 0]
        vy = work.velocity[b, 1]
        farthest = max(
            farthest,
            (np.sqrt(x * x + y * y) + np.sqrt(vx * vx + vy * vy) * dt) / rig.touchdown[b, 0],
        )
    return farthest


@compiled
def _regime(rig: Any, work: Any, z: Any, depth: Any) -> int:
    """A number that changes where a contact begins, ends, pushes or no longer does, and where an
    amplifier of order two reaches or leaves a stop; depth (b,) [m]: how far the rotor is in its
    touchdown bearings, 0 where it is free.
    """
    _move(rig, work, z)
    amp, number = 2 * coordinates(rig), 0
    for b in range(rig.touchdown.shape[0]):
        x, y, vx, vy = _met(rig, work, b, z)
        # 0 free, 1 in contact and pushed, 2 in contact with no force: the damping outweighs the
        # spring
        depth[b], kind = max(np.sqrt(x * x + y * y) - rig.touchdown[b, 0], 0.0), 0
        if depth[b] > 0.0:
            normal = contact_force(x, y, vx, vy, 0.0, rig.touchdown[b], 1.0, 0.0)[3]
            kind = 1 if normal > 0.0 else 2
        number = 5 * number + kind
    for a in range(rig.amplifier.shape[0]):
        # 0 to 3: either state at its stop, or both
        first, second = stops(rig.amplifier[a])
        at, slope_at = (
            abs(z[amp + 2 * a]) >= first * _STOPPED,
            abs(z[amp + 2 * a + 1]) >= second * _STOPPED,
        )
        number = 5 * number + at + 2 * slope_at
    return number


@compiled
def _smooth(work: Any, onset: Any) -> bool:
    """Whether a step changes depths by little where damping sets in; onset: touchdown (b, 21)."""
    smooth = True
    for b in range(onset.shape[0]):
        old, new = work.depth[0, b], work.depth[1, b]
        smooth = smooth and abs(new - old) <= _BEND * (min(old, new) + onset[b, 6])
    return smooth


@merged
def _step(rig: Any, work: Any, drive: Any, k: int, tau: float, width: float, z: Any) -> None:
    """One step of the classical fourth-order Runge-Kutta method from the fraction tau of sample k
    on, a fraction ``width`` long, into work.slopes[1].
    """
    n, h = z.shape[0], width * drive.dt
    dz = work.slopes[0]
    total = work.slopes[1]
    trial = work.slopes[2]
    for i in range(n):
        trial[i] = total[i] = z[i]
    for stage in range(4):
        # weights 1/6, 1/3, 1/3, 1/6; the next stage lies h/2, h/2, h from z
        inner = 0.0 if stage == 0 else (1.0 if stage == 3 else 0.5)
        _derivative(rig, work, drive, k, tau + inner * width, trial, dz)
        weight = h / 3 if inner == 0.5 else h / 6
        ahead = h if stage == 2 else h / 2
        for i in range(n):
            total[i] += weight * dz[i]
            trial[i] = z[i] + ahead * dz[i]

    # a state may not end beyond its stop
    for a in range(rig.amplifier.shape[0]):
        i, (first, second) = 2 * coordinates(rig) + 2 * a, stops(rig.amplifier[a])
        total[i], total[i + 1] = (
            min(max(total[i], -first), first),
            min(max(total[i + 1], -second), second),
        )


@merged
def _integrate(rig: Any, work: Any, drive: Any, k: int, steps: int, z: Any) -> None:
    """One control sample in ``steps`` steps.

    The order is lost in a step in which a contact begins or ends, an amplifier reaches or leaves a
    stop, or that is too long for the damping's onset: such a step is done again in parts, and parts
    like it once more, so that what changes there does so within nanoseconds of where it should.
    """
    # level 0: steps, 1: parts of a step, 2: pieces of a part. One place calls each stage: a second
    # one would be compiled again, for all stages are inlined.
    regime = _regime(rig, work, z, work.depth[0])
    parts = _PARTS if rig.behind == 0 else _FEWER
    step, level = 0, 0
    part, piece = 0, 0
    width = 1.0 / steps
    while step < steps:
        start, share = step / steps, width
        if level == 1:
            start, share = start + part * width / parts, width / parts
        elif level == 2:
            start += (part + piece / parts) * width / parts
            share = width / parts**2
        _step(rig, work, drive, k, start, share, z)
        now = _regime(rig, work, work.slopes[1], work.depth[1])
        if level < 2 and not (now == regime and _smooth(work, rig.touchdown)):
            level += 1
            continue

        # pieces are taken as they come, and their last one says what regime follows
        _accept(work, z)
        if level == 2:
            piece += 1
            if piece < parts:
                continue
            piece, level = 0, 1
            regime = now
        if level == 1:
            part += 1
            if part < parts:
                continue
            part, level = 0, 0
        step += 1


@merged
def _accept(work: Any, z: Any) -> None:
    """The step's end becomes the state."""
    for i in range(z.shape[0]):
        z[i] = work.slopes[1, i]
    for b in range(work.depth.shape[1]):
        work.depth[0, b] = work.depth[1, b]


@compiled
def _measure(rig: Any, drive: Any, k: int, z: Any, y: Any) -> None:
    """What the controller reads at the start of sample k."""
    start = 2 * coordinates(rig) + 3 * rig.amplifier.shape[0]
    count = rig.mean.shape[0]
    for a in range(count):
        y[a] = 0.0

    # single sensors, lagged or immediate, with noise, through the converter; y = mean @ these
    for c in range(rig.sensor.shape[0]):
        value = z[start + c] if rig.sensor[c, 2] > 0.0 else _signal(rig, z, c, drive.angle[k])
        value = converted(value + drive.noise[c, k], rig.sensor[c])
        for a in range(count):
            y[a] += rig.mean[a, c] * value


@compiled
def _log(rig: Any, work: Any, z: Any, y: Any, u: Any, row: Any) -> None:
    """One row: y, u, coil currents, magnet forces (axes), displacements of the stations in their
    axes.
    """
    count = rig.amplifier.shape[0]
    amp = 2 * coordinates(rig)
    _move(rig, work, z)
    _magnetise(rig, work, z)

    # columns: y, u, coil currents, magnet forces (count each), then two per station
    for a in range(count):
        row[a], row[count + a], row[3 * count + a] = y[a], u[a], work.magnet[a]
        row[2 * count + a] = coil_current(
            work.command[a], z[amp + 2 * a], z[amp + 2 * a + 1], rig.amplifier[a]
        )
    for s in range(work.place.shape[0]):
        c, d = rig.direction[s, 0], rig.direction[s, 1]
        row[4 * count + 2 * s] = c * work.place[s, 0] + d * work.place[s, 1]
        row[4 * count + 2 * s + 1] = c * work.place[s, 1] - d * work.place[s, 0]


def entry_points(fingerprint: int) -> tuple[Any, Any]:
    """``advance`` and ``slopes``, compiled; kept on disk for the next process under a fingerprint
    of all that they contain.

    Numba's own cache sees changes of this file only, and not of the force functions that are
    compiled into it.
    """

    def advance(
        rig: Any,
        law: SampledLaw,
        code: Any,
        drive: Any,
        P: Any,
        steps: int,
        z: Any,
        x: Any,
        held: Any,
        work: Any,
        log: Any,
        seen: Any,
        along: Any = None,
    ) -> int:
        """A stretch of K control samples; z, x and held (a,) end as the state after it.

        code: what runs in place of the law, address 0: nothing. P: the propagator; samples that it
        cannot do (contact near, an amplifier at its limits, a bias that moves) take ``steps``
        Runge-Kutta steps, more far out. log (K, columns): see ``_log``. seen (K, a) [m]: what the
        controller saw. along (None: there is none; then none of it is compiled): the axis along
        the shaft, the last of the a axes, moved beside the others (``axial_kernel.Along``).
        Returns how many samples were done: fewer than K where the state overflowed or the code
        gave up.
        """
        assert fingerprint  # part of the cached function's identity
        y, u = work.sampled[0], work.sampled[1]
        for k in range(seen.shape[0]):
            _measure(rig, drive, k, z, y)
            if along is not None:
                y[y.shape[0] - 1] = measured(along, k)
            if code.address == 0:
                control(law, drive, k, y, x, held, u, seen[k], work.ahead)
            elif run_program(law, code, drive, k, y, held, u, seen[k]) < 0:
                return k
            command(drive, work, k, u)
            _log(rig, work, z, y, u, log[k])
            if along is not None:
                write_down(along, k, y[y.shape[0] - 1], u[y.shape[0] - 1], work.command)
                move(along, k, work.command)
            away = _farthest(rig, work, drive.dt)
            calm = P.usable and away < _FAR_OUT and settled(rig, work, drive, k, z)
            if calm and _stands(rig, drive, z):
                propagate(rig, work, drive, P, k, z)
            else:
                count = steps
                if rig.behind > 0:
                    count = max(steps, int(np.ceil(drive.dt / rig.contact_step)))
                elif away > _FAR_OUT:
                    count = steps * _DENSE
                _integrate(rig, work, drive, k, count, z)
            if not np.isfinite(z.sum()):
                return k
            if along is not None and not np.isfinite(along.z.sum()):
                return k
        return seen.shape[0]

    def slopes(rig: Any, drive: Any, k: int, u: Any, z: Any, work: Any, dz: Any) -> None:
        """dz/dt (p, n) of p states z with the amplifiers told u (p, a), at the start of sample k.

        k is given: a literal 0 would be a type of its own, and all stages compiled once more for
        it.
        """
        assert fingerprint
        for p in range(z.shape[0]):
            for a in range(u.shape[1]):
                work.command[a] = u[p, a]
            _derivative(rig, work, drive, k, 0.0, z[p], dz[p])

    advanced, sloped = compile_kept((advance, slopes), **OPTIONS)
    return advanced, sloped
