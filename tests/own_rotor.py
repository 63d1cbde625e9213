"""A lateral analysis of the tests' own: a rotor in two planes on journals or magnets, its response
to API's unbalance at every speed of a fine grid, its critical speeds and their margins.

Nothing of the package is in it. The free rotor's modes are those of ``independent_rig`` (all of the
mesh), and in them

    (s^2 + 2 zeta w s + w^2 + s W [[0, g], [-g, 0]] + bearings(s)) q = f,    s = j W,

where a journal adds K + s C, a magnet -k_s and k_i H(s) from the sensor, with H the sampled PID by
Tustin's rule, its delay and hold, amplifier and sensor. API 617 as open code quotes it: twice
6350 W/N, placed by the shape of every forward mode; AF = N/(N2 - N1) at 0.707 of the peak.
"""

import math
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np
from scipy.optimize import brentq

from independent_rig import free_modes

RPM = math.pi / 30
STEEL = {"density": 7800.0, "youngs_modulus": 2.1e11, "poisson_ratio": 0.3}


HEAD = """
[machine]
schema = 1
name = "random-rotor"
beam_theory = "timoshenko"
modal_damping = {damping!r}
[machine.assumed]
"bearing" = "made up"
[material.steel]
density = 7800.0
youngs_modulus = "210 GPa"
poisson_ratio = 0.3
"""
SECTION = """
[[shaft]]
length = {length!r}
outer_diameter = {diameter!r}
elements = 1
material = "steel"
"""
DISC = """
[[disc]]
name = "disc-{k}"
position = {at!r}
mass = {mass!r}
polar_inertia = {polar!r}
diametral_inertia = {diametral!r}
"""
MAGNET = """
[[bearing]]
name = "{name}"
position = {at!r}
bias_current = "3 A"
force_per_current = {k_i!r}
negative_stiffness = {k_s!r}
gap = "0.8 mm"
touchdown_gap = "0.4 mm"
[[sensor]]
bearing = "{name}"
position = {sensor_at!r}
bandwidth = {sensor!r}
"""
CONTROL = """
[amplifier]
order = "first"
bandwidth = {amplifier!r}
[controller]
gain = {gain!r}
integral_time = {T_i!r}
derivative_time = {T_d!r}
derivative_filter = {eps!r}
sample_time = {dt!r}
"""
CLEARANCE = '[[clearance]]\nname = "lab"\nposition = {at!r}\ndiametral = "4 mm"\n'


@dataclass(frozen=True)
class Journal:
    """An oil film, K and C (2, 2), its table from ``speeds`` on (None: at any speed)."""

    at: float
    K: np.ndarray
    C: np.ndarray
    speeds: tuple | None = None


@dataclass(frozen=True)
class Magnet:
    """A magnet, its sensor and its sampled PID, alike in both axes."""

    at: float
    sensor_at: float
    k_i: float
    k_s: float
    gain: float
    T_i: float
    T_d: float
    eps: float = 0.05
    dt: float = 5e-5
    amplifier: float = 2 * np.pi * 3000
    sensor: float = 2 * np.pi * 15000

    def pull(self, s):
        """-k_i i per displacement at the sensor [N/m], over s."""
        z = np.exp(s * self.dt)
        p = 2 / self.dt * (z - 1) / (z + 1)
        law = self.gain * (1 + 1 / (self.T_i * p) + self.T_d * p / (1 + self.eps * self.T_d * p))
        hold = (1 - 1 / z) / (s * self.dt)
        return self.k_i * law / z * hold / ((1 + s / self.amplifier) * (1 + s / self.sensor))


@dataclass(frozen=True)
class Peak:
    """A peak in a reading: speed [rad/s], amplitude 0-p [m], amplification factor (nan: neither
    flank falls to half power).
    """

    speed: float
    amplitude: float
    factor: float


@dataclass(frozen=True)
class OwnRotor:
    """nodes (N,) [m], diameters (N - 1,) [m] between them, discs: (node, mass, I_p, I_d)."""

    nodes: tuple
    diameters: tuple
    discs: tuple
    bearings: tuple
    damping: float

    @cached_property
    def modes(self):
        places = [{"at": x} for x in self.nodes]
        shaft = [
            {"length": b - a, "outer": d, "inner": 0.0, "mass": d, "elements": 1, **STEEL}
            for a, b, d in zip(self.nodes[:-1], self.nodes[1:], self.diameters, strict=True)
        ]
        discs = [
            {"at": self.nodes[k], "mass": m, "Ip": polar, "Id": diametral}
            for k, m, polar, diametral in self.discs
        ]
        parts = {"theory": "timoshenko", "shaft": shaft, "discs": discs, "springs": places}
        count = 2 * len(self.nodes) - 2
        w, g, shape, weight = free_modes(parts | {"seals": [], "bearings": []}, count)
        return w, g, np.array([shape(x) for x in self.nodes]), weight

    def row(self, at):
        """The modal row (n,) of the node at a place."""
        return self.modes[2][int(np.argmin(np.abs(np.array(self.nodes) - at)))]

    # weights, all in kg ------------------------------------------------------------------------

    @cached_property
    def masses(self):
        """(place, mass) of every shaft section and disc."""
        rows = [
            (0.5 * (a + b), STEEL["density"] * np.pi / 4 * d**2 * (b - a))
            for a, b, d in zip(self.nodes[:-1], self.nodes[1:], self.diameters, strict=True)
        ]
        return [*rows, *((self.nodes[k], m) for k, m, *_ in self.discs)]

    @property
    def mass(self):
        return sum(m for _, m in self.masses)

    def carried(self):
        """What each of the two bearings carries, by the lever."""
        a, b = (item.at for item in self.bearings)
        second = sum(m * (x - a) for x, m in self.masses) / (b - a)
        return self.mass - second, second

    # dynamics ----------------------------------------------------------------------------------

    def dynamic(self, s, speed, pull=Magnet.pull):
        """Dynamic stiffness (..., 2 n, 2 n) [1/s^2] at s (...,) and speed (...,); pull: (magnet, s)
        to what it pulls per displacement at its sensor [N/m].
        """
        w, g, _, _ = self.modes
        s, speed = np.broadcast_arrays(np.asarray(s, complex), speed)
        s, speed = s[..., None, None], speed[..., None, None]
        free = np.diag(np.tile(w**2, 2)) + s * np.diag(np.tile(2 * self.damping * w, 2))
        D = s**2 * np.eye(2 * len(w)) + free + s * speed * np.kron([[0, 1], [-1, 0]], g)
        for item in self.bearings:
            row = self.row(item.at)
            if isinstance(item, Journal):
                film = np.kron(item.K, np.outer(row, row)), np.kron(item.C, np.outer(row, row))
                D = D + film[0] + s * film[1]
                continue
            D = D - item.k_s * np.kron(np.eye(2), np.outer(row, row))
            D = D + pull(item, s) * np.kron(np.eye(2), np.outer(row, self.row(item.sensor_at)))
        return D

    def poles(self, speed):
        """Poles (p,) with Im > 0 and shapes (p, 2, N) in x and y; the delay as a Pade of order 1."""
        w, g, shapes, _ = self.modes
        n = len(w)
        K = np.diag(np.tile(w**2, 2))
        C = np.diag(np.tile(2 * self.damping * w, 2)) + speed * np.kron([[0, 1], [-1, 0]], g)
        magnets = [item for item in self.bearings if isinstance(item, Magnet)]
        size = 4 * n + 10 * len(magnets)
        A = np.zeros((size, size))
        for item in self.bearings:
            row = self.row(item.at)
            if isinstance(item, Journal):
                K = K + np.kron(item.K, np.outer(row, row))
                C = C + np.kron(item.C, np.outer(row, row))
            else:
                K = K - item.k_s * np.kron(np.eye(2), np.outer(row, row))
        A[: 2 * n, 2 * n : 4 * n] = np.eye(2 * n)
        A[2 * n : 4 * n, : 2 * n], A[2 * n : 4 * n, 2 * n : 4 * n] = -K, -C
        at = 4 * n
        for item in magnets:
            corner, late = 1 / (item.eps * item.T_d), 1.5 * item.dt
            for plane in (0, 1):
                y, integral, slow, delay, i = range(at, at + 5)
                q = slice(plane * n, (plane + 1) * n)
                A[y, q], A[y, y] = item.sensor * self.row(item.sensor_at), -item.sensor
                A[integral, y] = 1 / item.T_i
                A[slow, y], A[slow, slow] = corner, -corner
                # u = gain (y + integral + (y - slow)/eps), late: v = -u + 2 d, d' = 2 (u - d)/late
                u = np.zeros(size)
                u[[y, integral, slow]] = item.gain * np.array([1 + 1 / item.eps, 1, -1 / item.eps])
                A[delay] = 2 / late * u
                A[delay, delay] -= 2 / late
                A[i] = -item.amplifier * u
                A[i, delay] += 2 * item.amplifier
                A[i, i] -= item.amplifier
                A[2 * n + plane * n : 2 * n + (plane + 1) * n, i] = -item.k_i * self.row(item.at)
                at += 5
        values, vectors = np.linalg.eig(A)
        kept = values.imag > 1e-6
        planes = vectors[: 2 * n, kept].T.reshape(-1, 2, n)
        return values[kept], planes @ shapes.T, float(values.real.max())

    def border(self, speed):
        """The first cross-coupling Q [N/m] at the node half way between the bearings, f_x = -Q y,
        f_y = Q x, with which the loop is unstable; inf: none up to 1e11.
        """
        middle = 0.5 * sum(item.at for item in self.bearings)

        def worst(q):
            cross = Journal(middle, q * np.array([[0.0, 1.0], [-1.0, 0.0]]), np.zeros((2, 2)))
            return replace(self, bearings=(*self.bearings, cross)).poles(speed)[2]

        grid = np.geomspace(1e3, 1e11, 97)
        for low, high in pairwise(map(float, grid)):
            if worst(high) >= 0:
                return float(brentq(worst, low, high, rtol=1e-6))
        return math.inf

    def stable(self, speeds):
        return all(self.poles(w)[2] < 0 for w in speeds)

    # unbalance ---------------------------------------------------------------------------------

    def placements(self, speed):
        """Sets of (node, amount [kg m] signed) of every forward mode up to 1.3125 times a speed."""
        values, shapes, _ = self.poles(speed)
        found = []
        for k in np.argsort(values.imag):
            s, (x, y) = values[k], shapes[k]
            ahead, behind = (float((np.abs(part) ** 2).sum()) for part in (x + 1j * y, x - 1j * y))
            whirl = (ahead - behind) / (ahead + behind)
            if s.imag > 1.3125 * speed or -s.real > 0.7 * abs(s) or whirl <= -0.25:
                continue
            z = x + 1j * y
            for case in self.placed((z / z[np.argmax(np.abs(z))]).real, speed):
                if case not in found:
                    found.append(case)
        if not found:  # no mode rings: the rigid rotor in parallel and tilting
            arm = np.array(self.nodes) - 0.5 * sum(item.at for item in self.bearings)
            for line in (np.ones_like(arm), arm):
                found += self.placed(line, speed)
        return found

    def placed(self, line, speed):
        nodes = np.array(self.nodes)
        a, b = (int(np.argmin(np.abs(nodes - item.at))) for item in self.bearings)
        ends = [(0, a), (len(nodes) - 1, b)]
        ends = [(end, at) for end, at in ends if abs(line[end]) > abs(line[at])]
        inner = []
        for stretch in np.split(
            np.arange(a, b + 1), np.flatnonzero(np.diff(np.sign(line[a : b + 1]))) + 1
        ):
            size = np.abs(line[stretch])
            # where it is largest, or of a plateau that reaches an end the middle
            clear = 0.95 * size.max() > max(size[0], size[-1])
            flat = nodes[stretch[size >= (1.0 if clear else 0.95) * size.max()]]
            inner.append(int(np.argmin(np.abs(nodes - 0.5 * (flat[0] + flat[-1])))))
        largest = max(abs(line[k]) for k in (*inner, *(end for end, _ in ends)))
        inner = [k for k in inner if abs(line[k]) >= 0.1 * largest]
        # twice 6350 W/N in g mm
        per_kg = 2 * 6350 / min(speed / RPM, 25000.0) * 1e-6
        sets = []
        outer = [(end, at) for end, at in ends if abs(line[end]) >= 0.5 * largest]
        if outer:
            outboard = [
                (
                    end,
                    sum(
                        m for x, m in self.masses if (x < nodes[at] if end == 0 else x > nodes[at])
                    ),
                )
                for end, at in outer
            ]
            sets.append(outboard)
        if len(inner) == 1:
            sets.append([(inner[0], self.mass)])
        elif inner:
            carried = self.carried()
            near = [int(abs(nodes[k] - nodes[b]) < abs(nodes[k] - nodes[a])) for k in inner]
            sets.append([(k, carried[j]) for k, j in zip(inner, near, strict=True)])
        return [
            tuple((k, float(np.sign(line[k]) * per_kg * kg)) for k, kg in chosen) for chosen in sets
        ]

    def forces(self, cases):
        """Modal forces per square of the speed (2 n, k): forward circles."""
        shapes = self.modes[2]
        rows = [sum(amount * shapes[k] for k, amount in case) for case in cases]
        return np.array([np.concatenate([row, -1j * row]) for row in rows]).T

    def response(self, speeds, cases, solve=None):
        """x and y of the nodes (w, k, 2, N) [m] over speeds (w,); solve: in place of the loop."""
        n, shapes = len(self.modes[0]), self.modes[2]
        force = self.forces(cases)
        parts = []
        for some in np.array_split(speeds, max(1, len(speeds) // 400)):
            if solve is None:
                q = np.linalg.solve(self.dynamic(1j * some, some), some[:, None, None] ** 2 * force)
            else:
                q = np.array([solve(w, w**2 * force) for w in some])
            parts.append(np.swapaxes(q, 1, 2).reshape(len(some), len(cases), 2, n) @ shapes.T)
        return np.concatenate(parts)

    def readings(self, motion, probes):
        """Amplitudes (w, k) [m] by name: probes (place, direction) and the major axis at each
        plane, or at the bearings.
        """
        nodes = np.array(self.nodes)
        found = {}
        for at, direction in probes:
            x, y = np.moveaxis(motion[..., int(np.argmin(np.abs(nodes - at)))], -1, 0)
            found[f"{at:.4g} {direction:.3g}"] = np.abs(
                math.cos(direction) * x + math.sin(direction) * y
            )
        for at in {at for at, _ in probes} or {item.at for item in self.bearings}:
            x, y = np.moveaxis(motion[..., int(np.argmin(np.abs(nodes - at)))], -1, 0)
            found[f"orbit {at:.4g}"] = 0.5 * (np.abs(x + 1j * y) + np.abs(x - 1j * y))
        return found


def peaks(speeds, curve):
    """All peaks of amplitudes (w,). A side that rises above the peak, or ends, before it falls to
    half power is as wide as it lies between, and as the other: the factor is at least what is told.
    """
    found = []
    for k in np.flatnonzero((curve[1:-1] > curve[:-2]) & (curve[1:-1] >= curve[2:])) + 1:
        half, flanks, known = curve[k] / math.sqrt(2), [], []
        for side in (slice(k, None, -1), slice(k, None)):
            x, y = speeds[side], curve[side]
            outside = (y < half) | (y > curve[k])
            j = int(np.argmax(outside)) if outside.any() else len(y) - 1
            flanks.append(abs(x[j] - speeds[k]))
            if y[j] < half:
                at = x[j] + (half - y[j]) * (x[j - 1] - x[j]) / (y[j - 1] - y[j])
                flanks[-1] = abs(at - speeds[k])
                known.append(flanks[-1])
        band = max(sum(flanks), 2 * min(known)) if known else math.nan
        found.append(Peak(float(speeds[k]), float(curve[k]), float(speeds[k] / band)))
    return found


def margins(speed, factor, lowest, highest):
    """Separation margin and what API 617 asks for [%]."""
    share = 17 * (1 - 1 / (factor - 1.5)) if factor >= 2.5 else -math.inf
    if speed < lowest:
        return 100 * (lowest - speed) / lowest, min(16, share)
    if speed > highest:
        return 100 * (speed - highest) / highest, min(26, 10 + share)
    return 0.0, min(26, 10 + share)


@dataclass(frozen=True)
class Findings:
    """sized: all peaks of 0.9 % of the vibration limit and more; criticals: those of 2 % with AF of
    2.5 and more that no reading dwarfs; violated: those of them that miss their margin, by half a
    per cent and more.
    """

    sized: list
    criticals: list
    violated: list


def judge(rotor, probes, lowest, highest, count=4001, most=2.0):
    """Every critical speed up to 1.3 times the highest running speed, on ``count`` speeds."""
    speeds = np.linspace(0.0525 * highest, most * highest, count)
    motion = rotor.response(speeds, rotor.placements(highest))
    limit = min(25.4, 25.4 * math.sqrt(12000 / (highest / RPM))) * 1e-6
    found = [
        peak
        for amplitudes in rotor.readings(motion, probes).values()
        for column in amplitudes.T
        for peak in peaks(speeds, column)
    ]

    def counts(peak):
        beside = [p.amplitude for p in found if abs(p.speed - peak.speed) < 0.035 * peak.speed]
        # twice what is left out as too small by the package's rules
        return 2 * peak.amplitude >= 0.02 * limit and peak.amplitude >= 0.2 * max(beside)

    criticals = [p for p in found if p.factor >= 2.55 and p.speed <= 1.3 * highest and counts(p)]
    violated = []
    for peak in criticals:
        margin, asked = margins(peak.speed, peak.factor, lowest, highest)
        if margin < asked - 0.5:
            violated.append(peak)
    return Findings([p for p in found if 2 * p.amplitude >= 0.009 * limit], criticals, violated)


def written(rotor, points, running, probes, top):
    """The machine file of a rotor that runs at ``points`` [rad/s], as text."""
    text = HEAD.format(damping=rotor.damping)
    for a, b, d in zip(rotor.nodes[:-1], rotor.nodes[1:], rotor.diameters, strict=True):
        text += SECTION.format(length=b - a, diameter=d)
    for k, (node, mass, polar, diametral) in enumerate(rotor.discs):
        at = rotor.nodes[node]
        text += DISC.format(k=k, at=at, mass=mass, polar=polar, diametral=diametral)
    for name, item in zip("AB", rotor.bearings, strict=True):
        if isinstance(item, Magnet):
            text += MAGNET.format(name=name, **vars(item))
            continue
        rows = 1 if item.speeds is None else 2
        text += f'[[journal_bearing]]\nname = "{name}"\nposition = {item.at!r}\n'
        text += "" if item.speeds is None else f"speed = {list(item.speeds)!r}\n"
        for letter, matrix in (("K", item.K), ("C", item.C)):
            for i, j in np.ndindex(2, 2):
                text += f"{letter}_{'xy'[i]}{'xy'[j]} = {rows * [float(matrix[i, j])]!r}\n"
    if isinstance(rotor.bearings[0], Magnet):
        text += CONTROL.format(**vars(rotor.bearings[0]))
    text += CLEARANCE.format(at=rotor.nodes[len(rotor.nodes) // 2])
    for k, (at, direction) in enumerate(probes):
        text += f'[[probe]]\nname = "P{k}"\nposition = {at!r}\ndirection = {direction!r}\n'
    text += f"[operation]\nspeed_range = [0.0, {top!r}]\n"
    for k, speed in enumerate(points):
        text += f'[[operation.point]]\nlabel = "{k}"\nspeed = {speed!r}\n'
    if running is not None:
        text += f"[requirements]\nrunning_speeds = {list(running)!r}\n"
    return text
