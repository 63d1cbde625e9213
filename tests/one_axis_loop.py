"""One levitated axis under a digital controller, many runs at once: a rig of the tests' own.

y'' = a y + b u(t - tau) + force, in exact steps from sample to sample; the controller is a PD with
a filtered derivative, which no method is told.
"""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import expm


@dataclass(frozen=True)
class Truth:
    """pole [rad/s], gain [m/s^2/A], delay [s], lag [s] of the plant; rate [Hz]."""

    pole: float = 80.0
    gain: float = 100.0
    delay: float = 7e-4
    lag: float = 0.0
    rate: float = 2000.0


def _step(F, G, time):
    n = len(F)
    block = np.zeros((n + 1, n + 1))
    block[:n, :n], block[:n, n] = F, G
    block = expm(block * time)
    return block[:n, :n], block[:n, n]


def excitation(kind, truth, n, runs, rng):
    """(n, runs), of size one."""
    time = np.arange(n) / truth.rate
    rough = truth.pole / (2 * np.pi)  # Hz
    if kind == "binary":
        hold = max(1, int(0.3 * truth.rate / truth.pole))
        return np.repeat(rng.choice([-1.0, 1.0], (n // hold + 1, runs)), hold, axis=0)[:n]
    if kind == "steps":
        hold = int(8 * truth.rate / truth.pole)
        return np.repeat(rng.uniform(-1.5, 1.5, (n // hold + 1, runs)), hold, axis=0)[:n]
    if kind == "sines":
        frequencies = np.geomspace(0.3 * rough, 4 * rough, 12)
        phases = rng.uniform(0, 2 * np.pi, (12, runs))
        waves = 2 * np.pi * frequencies * time[:, None]
        return sum(np.sin(waves[:, [j]] + phases[j]) for j in range(12)) / 3.5
    if kind == "chirp":
        rise = 3.8 * rough / time[-1]
        wave = np.sin(2 * np.pi * (0.2 * rough * time + rise * time**2 / 2))
        return np.repeat(wave[:, None], runs, axis=1)
    return np.zeros((n, runs))


def levitate(
    truth=None,
    runs=1,
    n=8000,
    kind="binary",
    size=1.0,
    sensor=1e-6,
    force=0.02,
    colour=0.0,
    step=0.0,
    drive_noise=0.0,
    mode=0.0,
    seed=0,
):
    """Times (n,), displacement [m], drive [A] and reference [A], each (n, runs).

    sensor [m], white; force [m/s^2 over sqrt(Hz)], white; colour [m/s^2]: of a force with a time
    constant of 50 samples; step [m]: of the displacement's converter; drive_noise [A]: of the
    record of u alone; mode [rad/s]: a bending mode, damped by 2 %, that the drive moves a tenth as
    much as the body, seen by the sensor.
    """
    truth = truth or Truth()
    rng = np.random.default_rng(seed)
    a, b, h = truth.pole**2, truth.gain, 1 / truth.rate
    if truth.lag:
        F = np.array([[0, 1, 0], [a, 0, b], [0, 0, -1 / truth.lag]])
        G = np.array([0, 0, 1 / truth.lag])
    else:
        F, G = np.array([[0.0, 1.0], [a, 0.0]]), np.array([0.0, b])
    if mode:
        n_body = len(F)
        F = np.block([[F, np.zeros((n_body, 2))], [np.zeros((2, n_body)), np.zeros((2, 2))]])
        F[-2:, -2:] = [[0, 1], [-(mode**2), -0.04 * mode]]
        if truth.lag:
            F[-1, 2] = 0.1 * b
        G = np.append(G, [0, 0 if truth.lag else 0.1 * b])
    whole = int(truth.delay * truth.rate)
    part = truth.delay - whole * h
    before, late = _step(F, G, part)
    after, early = _step(F, G, h - part)
    through, late = after @ before, after @ late
    unit = np.eye(len(F))[1]
    steady = _step(F, unit, h)[1]
    # covariance of white force over a sample, by the middle of 200 slices
    slices = [expm(F * h * (k + 0.5) / 200) @ unit * np.sqrt(h / 200) for k in range(200)]
    root = np.linalg.cholesky(sum(np.outer(v, v) for v in slices)[:2, :2] + 1e-40 * np.eye(2))
    proportional, rate = 2.5 * a / b, 1.2 * np.sqrt(1.5 * a) / b
    drive = excitation(kind, truth, n, runs, rng) * size * proportional * 5e-5
    memory = np.exp(-12 * truth.pole * h)
    x, queue = np.zeros((len(F), runs)), np.zeros((whole + 2, runs))
    slope, last, push = np.zeros(runs), np.zeros(runs), np.zeros(runs)
    y, u = np.empty((n, runs)), np.empty((n, runs))
    for k in range(n):
        seen = x[0] + (x[-2] if mode else 0.0) + sensor * rng.standard_normal(runs)
        if step:
            seen = np.round(seen / step) * step
        slope = memory * slope + (1 - memory) * (seen - last) / h
        last = seen
        queue = np.roll(queue, 1, axis=0)
        queue[0] = -(proportional * seen + rate * slope) + drive[k]
        y[k], u[k] = seen, queue[0]
        x = through @ x + np.outer(late, queue[whole + 1]) + np.outer(early, queue[whole])
        x[:2] += force * root @ rng.standard_normal((2, runs))
        if colour:
            push = 0.98 * push + 0.2 * colour * rng.standard_normal(runs)
            x += np.outer(steady, push)
    return np.arange(n) * h, y, u + drive_noise * rng.standard_normal(u.shape), drive


def hang(n=8000, rate=2000.0, gap=5e-3, mass=0.02, constant=1e-4, amplitude=3e-5, seed=0):
    """Times, distance [m], current [A], reference [m], each (n,): m y'' = m g - c (i/y)^2 under a PD
    with a binary reference, by leapfrog steps; noise of 1 um.
    """
    rng = np.random.default_rng(seed)
    fine, level = 10, gap * np.sqrt(9.81 * mass / constant)
    y, v, last, slope = gap, 0.0, gap, 0.0
    rows = []
    for k in range(n):
        if k % 8 == 0:
            aim = gap + amplitude * rng.choice([-1, 1])
        seen = y + 1e-6 * rng.standard_normal()
        slope = 0.5 * slope + 0.5 * (seen - last) * rate
        last = seen
        current = level * (1 + 600 * (seen - aim) + 6 * slope)
        rows.append((k / rate, seen, current, aim))
        for _ in range(fine):
            y += v / (2 * rate * fine)
            v += (9.81 - constant / mass * (current / y) ** 2) / (rate * fine)
            y += v / (2 * rate * fine)
    return np.array(rows).T
