"""A rig of the tests' own: rotor, magnets, converters and loop, nothing of the package in it.

Rotor: beam elements (Bernoulli and Euler, or Timoshenko; Przemieniecki 1968) with gyroscopic
moments, in free modes. Magnets: opposing horseshoes, f = c (a^2 - b^2) with a = (i_b + i)/(g - x)
and b = (i_b - i)/(g + x), levelling off towards a saturation. Between two samples the linear part
is exact (matrix exponential), and what the magnets bend from their slopes is taken by Heun's rule
in exponential form (ETD2RK; Cox & Matthews 2002). Converters: anti-alias filter, steps, computing
delay, hold.

Numbers are read from a machine's TOML file by ``numbers_of``, whose dict a test may edit.
"""

import re
import tomllib
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numba import njit
from scipy.linalg import block_diag, eigh, expm
from scipy.optimize import fsolve

PI2 = 2 * np.pi
UNITS = {
    "": 1.0, "m": 1.0, "mm": 1e-3, "um": 1e-6, "kg": 1.0, "A": 1.0, "A/m": 1.0, "A/mm": 1e3,
    "N/A": 1.0, "N/um": 1e6, "N/mm": 1e3, "N/m": 1.0, "deg": np.pi / 180, "rad/s": 1.0,
    "Hz": PI2, "kHz": PI2 * 1e3, "rpm": PI2 / 60, "bar": 1e5, "s": 1.0, "ms": 1e-3, "us": 1e-6,
    "N": 1.0, "mm^2": 1e-6, "kg m^2": 1.0, "Pa": 1.0, "MPa": 1e6, "GPa": 1e9, "kg/m^3": 1.0,
    "N s/m": 1.0, "g": 1e-3, "T": 1.0, "%": 0.01,
}  # fmt: skip
STEEL = {"density": 7850.0, "youngs_modulus": 2.1e11, "poisson_ratio": 0.3}
MU0 = 4e-7 * np.pi


def number(value, default=None):
    """A TOML value with its unit in SI; lists become arrays."""
    if value is None:
        return default
    if isinstance(value, list):
        return np.array([number(item) for item in value])
    if isinstance(value, str):
        text, unit = re.fullmatch(r"([-+.\deE]+)\s*(.*)", value.strip()).groups()
        return float(text) * UNITS[unit]
    return float(value)


def pair(value, default=0.0):
    return np.broadcast_to(number(value, default), 2).astype(float)


def numbers_of(path, pressure=0.0):
    """A machine's numbers in SI, plain; seals as they are at a pressure [Pa], those with a geometry
    without coefficients.
    """
    text = tomllib.loads(Path(path).read_text())
    about = text["machine"]
    materials = {
        k: {n: number(v) for n, v in row.items()} for k, row in text.get("material", {}).items()
    }
    shaft = []
    for row in text["shaft"]:
        outer = number(row["outer_diameter"])
        shaft.append(
            {
                "length": number(row["length"]),
                "outer": outer,
                "inner": number(row.get("inner_diameter"), 0.0),
                "mass": number(row.get("mass_diameter"), outer),
                "elements": int(row.get("elements", 1)),
                **STEEL,
                **materials.get(row.get("material"), {}),
            }
        )
    bearings = []
    for row, sensor in zip(text["bearing"], text["sensor"], strict=True):
        made = {
            "name": row["name"],
            "at": number(row["position"]),
            "sensor_at": number(sensor["position"]),
            "sensor_lag": number(sensor.get("bandwidth"), np.inf),
            "angle": number(row.get("angle"), 0.0),
            "bias": number(row["bias_current"]),
            "limit": number(row["max_current"]),
            "loaded": row.get("coefficients_at") == "static-load",
        }
        if "geometry" in row:
            # a horseshoe of N turns: f = mu0 N^2 A cos(alpha)/4 (i/g)^2
            g = {key: number(item) for key, item in row["geometry"].items()}
            c = MU0 * g["turns"] ** 2 * g["pole_area"] * np.cos(np.pi / 8) / 4
            made["ki"] = np.full(2, 4 * c * made["bias"] / g["gap"] ** 2)
            made["ks"] = np.full(2, 4 * c * made["bias"] ** 2 / g["gap"] ** 3)
        else:
            made["ki"], made["ks"] = pair(row["force_per_current"]), pair(row["negative_stiffness"])
        bearings.append(made)
    seals = []
    for row in text.get("seal", []):
        share = pressure / number(row["reference_pressure"]) if "reference_pressure" in row else 1.0
        scaled = row.get("scales_with_pressure", [])
        made = {"name": row["name"], "at": number(row["position"])}
        made |= {q: number(row.get(q), 0.0) * (share if q in scaled else 1.0) for q in "KkCcM"}
        seals.append(made)
    springs = [
        {
            "at": number(row["position"]),
            "angle": number(row.get("angle"), 0.0),
            "k": pair(row["stiffness"]),
            "d": pair(row.get("damping")),
        }
        for row in text.get("coupling", [])
    ]
    discs = [
        {
            "at": number(row["position"]),
            "mass": number(row["mass"]),
            "Ip": number(row.get("polar_inertia"), 0.0),
            "Id": number(row.get("diametral_inertia"), 0.0),
        }
        for row in text.get("disc", [])
    ]
    amplifier = {k: v if k == "order" else number(v) for k, v in text.get("amplifier", {}).items()}
    gravity = about.get("gravity_direction")
    return {
        "name": about["name"],
        "theory": about.get("beam_theory", "timoshenko"),
        "damping": number(about.get("modal_damping"), 0.0),
        "gravity": None if gravity is None else number(gravity),
        "shaft": shaft,
        "discs": discs,
        "bearings": bearings,
        "seals": seals,
        "springs": springs,
        "amplifier": amplifier,
    }


def element(section, length, theory):
    """Translational and rotary mass and stiffness (4, 4) of a beam element in one plane: v, v' at
    both ends.
    """
    outer, inner, heavy = section["outer"], section["inner"], section["mass"]
    E, nu, L = section["youngs_modulus"], section["poisson_ratio"], length
    inertia = np.pi * (outer**4 - inner**4) / 64
    mass = section["density"] * np.pi * (heavy**2 - inner**2) / 4
    rotary = section["density"] * np.pi * (heavy**4 - inner**4) / 64
    s = 0.0
    if theory == "timoshenko":
        area, m2 = np.pi * (outer**2 - inner**2) / 4, (inner / outer) ** 2

        # shear coefficient of a tube (Cowper 1966)
        kappa = 6 * (1 + nu) * (1 + m2) ** 2
        kappa /= (7 + 6 * nu) * (1 + m2) ** 2 + (20 + 12 * nu) * m2
        s = 12 * E * inertia / (kappa * E / (2 * (1 + nu)) * area * L**2)
    K = (
        E
        * inertia
        / ((1 + s) * L**3)
        * np.array(
            [
                [12, 6 * L, -12, 6 * L],
                [6 * L, (4 + s) * L**2, -6 * L, (2 - s) * L**2],
                [-12, -6 * L, 12, -6 * L],
                [6 * L, (2 - s) * L**2, -6 * L, (4 + s) * L**2],
            ]
        )
    )

    # consistent masses from the shapes themselves, by Gauss' rule: v and the section's rotation
    x, weight = np.polynomial.legendre.leggauss(6)
    z, weight = (x + 1) / 2, weight / 2
    v = np.array(
        [
            1 - 3 * z**2 + 2 * z**3 + s * (1 - z),
            L * (z - 2 * z**2 + z**3 + s * (z - z**2) / 2),
            3 * z**2 - 2 * z**3 + s * z,
            L * (-(z**2) + z**3 + s * (z**2 - z) / 2),
        ]
    ) / (1 + s)
    turn = np.array(
        [
            6 * (z**2 - z) / L,
            1 - 4 * z + 3 * z**2 + s * (1 - z),
            6 * (z - z**2) / L,
            3 * z**2 - 2 * z + s * z,
        ]
    ) / (1 + s)
    T = mass * L * (v * weight) @ v.T
    R = rotary * L * (turn * weight) @ turn.T
    return T, R, K


def free_modes(m, count):
    """Natural frequencies (n,), polar gyroscopic matrix (n, n) and shapes at any place: n free
    modes of one plane, two rigid and ``count`` of bending, of unit modal mass.
    """
    places = [item["at"] for key in ("discs", "seals", "springs", "bearings") for item in m[key]]
    places += [item["sensor_at"] for item in m["bearings"]]
    nodes, sections, start = [0.0], [], 0.0
    for row in m["shaft"]:
        end = start + row["length"]
        cuts = [
            *np.linspace(start, end, row["elements"] + 1),
            *(p for p in places if start < p < end),
        ]
        for cut in sorted(cuts):
            if cut - nodes[-1] > 1e-9:
                nodes.append(float(cut))
                sections.append(row)
        start = end
    n = 2 * len(nodes)
    M, K, G = (np.zeros((n, n)) for _ in range(3))
    for k, row in enumerate(sections):
        T, R, stiff = element(row, nodes[k + 1] - nodes[k], m["theory"])
        part = np.s_[2 * k : 2 * k + 4]
        M[part, part] += T if m["theory"] == "bernoulli-euler" else T + R
        K[part, part] += stiff
        G[part, part] += 2 * R
    at = {round(node, 9): 2 * k for k, node in enumerate(nodes)}
    for disc in m["discs"]:
        k = at[round(disc["at"], 9)]
        M[k, k] += disc["mass"]
        M[k + 1, k + 1] += disc["Id"]
        G[k + 1, k + 1] += disc["Ip"]
    square, V = eigh(K, M, subset_by_index=(0, 1 + count))
    square[:2] = 0.0
    weight = np.tile([1.0, 0.0], len(nodes)) @ M
    return np.sqrt(np.abs(square)), V.T @ G @ V, lambda p: V[at[round(p, 9)]], weight @ V


def turned(angle):
    """Rows zeta and eta in x, y."""
    return np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])


@njit(cache=True)
def pull(i, x, c, gap, bias, sat):
    a, b = (bias + i) / (gap - x), (bias - i) / (gap + x)
    if sat > 0:
        a, b = a / (1 + (a / sat) ** 4) ** 0.25, b / (1 + (b / sat) ** 4) ** 0.25
    return c * (a * abs(a) - b * abs(b))


@njit(cache=True)
def steps_of(value, step):
    return np.round(value / step) * step if step > 0 else value


@njit(cache=True)
def march(
    E, P0, P1, Bv, g0, Cx, Ci, Cy, mag, cross, K, e, seen, gains, conv, delay, wave, w, x, held
):
    """Samples of y, u and i (k, a): ``mag`` (a, 8) c, gap, bias, saturation, k_i, k_s (the slopes
    within E), 1 where it bends, centre; wave: speed, angle at first, substep.
    """
    a, k = len(mag), e.shape[0]
    Ak, Bk, Ck, Dk = K
    log = np.empty((3, k, a))
    substeps = int(wave[3])
    F, G = np.zeros(a + 2), np.zeros(a + 2)
    u, y, v = np.zeros(a), np.zeros(a), np.zeros(a)
    for t in range(k):
        y[:] = gains * (Cy @ w) + seen[t]
        for j in range(a):
            y[j] = steps_of(y[j], conv[0])
        u[:] = -(Dk @ y)
        if len(x):
            u += Ck @ x
            x[:] = Ak @ x - Bk @ y
        for j in range(a):
            u[j] = steps_of(min(max(u[j], -conv[2]), conv[2]), conv[1])
        if delay > 0:
            now = held[t % delay].copy()
            held[t % delay] = u
        else:
            now = u.copy()
        log[0, t], log[1, t], log[2, t] = y, now, Ci @ w
        v[:] = now + e[t]
        push = Bv @ v + g0
        for s in range(substeps):
            angle = wave[1] + wave[0] * (t * substeps + s) * wave[2]
            bent(F, w, Cx, Ci, mag, cross)
            F[a], F[a + 1] = np.cos(angle), np.sin(angle)
            half = E @ w + P0 @ F + push
            bent(G, half, Cx, Ci, mag, cross)
            angle += wave[0] * wave[2]
            G[a], G[a + 1] = np.cos(angle), np.sin(angle)
            w[:] = half + P1 @ (G - F)
    return log


@njit(cache=True)
def bent(F, w, Cx, Ci, mag, cross):
    """What the magnets' forces are beside their slopes."""
    i, x = Ci @ w, Cx @ w
    for j in range(len(mag)):
        both = i[j] + cross * i[j ^ 1]
        if mag[j, 6] > 0:
            F[j] = pull(both, x[j] - mag[j, 7], mag[j, 0], mag[j, 1], mag[j, 2], mag[j, 3])
            F[j] -= mag[j, 4] * i[j] + mag[j, 5] * x[j]
        else:
            F[j] = mag[j, 4] * (both - i[j]) - mag[j, 5] * mag[j, 7]


@dataclass
class Rig:
    """A machine's ``numbers`` at a speed [rad/s], sampled at a ``rate`` [Hz].

    linear: magnets with the slopes at their load. saturation: of the horseshoes' flux, over that of
    the bias. anti_alias: corner of a second-order Butterworth filter before the converters [rad/s].
    gains (a,): indicated over true. runout: (order, amplitude [m], phase) of every track; hum [m]
    at 50 and 150 Hz; noise [m]; steps of the converters of y [m] and u [A]. unbalance: {place from
    the left end: complex [kg m]}. cross: part of the other axis' current. offset, centre (a,) [m]:
    of the sensors, of the magnets.
    """

    numbers: dict
    rate: float = 1e4
    speed: float = 0.0
    modes: int = 6
    linear: bool = False
    saturation: float = 0.0
    anti_alias: float = np.inf
    gains: object = 1.0
    runout: tuple = ()
    hum: float = 0.0
    noise: float = 0.0
    step_y: float = 0.0
    step_u: float = 0.0
    delay: int = 1
    unbalance: dict = field(default_factory=dict)
    cross: float = 0.0
    offset: object = 0.0
    centre: object = 0.0
    substeps: int = 4

    def __post_init__(self):
        m = self.numbers
        self.axes = [f"{b['name']}_{way}" for b in m["bearings"] for way in ("zeta", "eta")]
        a, frequency = len(self.axes), None
        frequency, G, at, heavy = free_modes(m, self.modes)
        n = len(frequency)

        # modal coordinates of x, then y: q'' + (2 zeta w + Omega G) q' + w^2 q = forces
        D = np.diag(2 * m["damping"] * frequency)
        damp = np.block([[D, self.speed * G], [-self.speed * G, D]])
        stiff, mass = block_diag(*2 * [np.diag(frequency**2)]), np.eye(2 * n)

        def place(z, turn=None):
            both = np.kron(np.eye(2), at(z))
            return both if turn is None else turn @ both

        for seal in m["seals"]:
            P = place(seal["at"])
            stiff = stiff + P.T @ np.array([[seal["K"], seal["k"]], [-seal["k"], seal["K"]]]) @ P
            damp = damp + P.T @ np.array([[seal["C"], seal["c"]], [-seal["c"], seal["C"]]]) @ P
            mass = mass + seal["M"] * P.T @ P
        for spring in m["springs"]:
            P = place(spring["at"], turned(spring["angle"]))
            stiff, damp = (
                stiff + P.T @ np.diag(spring["k"]) @ P,
                damp + P.T @ np.diag(spring["d"]) @ P,
            )
        turns = [turned(b["angle"]) for b in m["bearings"]]
        X = np.vstack([place(b["at"], T) for b, T in zip(m["bearings"], turns, strict=True)])
        Y = np.vstack([place(b["sensor_at"], T) for b, T in zip(m["bearings"], turns, strict=True)])
        inverse = np.linalg.inv(mass)

        # weight along gravity, unbalance U W^2 (cos, sin) turning from x to y
        weight = np.zeros(2 * n)
        if m["gravity"] is not None:
            along = np.array([np.cos(m["gravity"]), np.sin(m["gravity"])])
            weight = 9.80665 * np.kron(along, heavy)
        turning = np.zeros((2 * n, 2))
        for z, U in self.unbalance.items():
            both = self.speed**2 * np.array([[U.real, -U.imag], [U.imag, U.real]])
            turning += place(z).T @ both
        self.load = -np.linalg.lstsq(X.T[np.r_[0, 1, n, n + 1]], weight[np.r_[0, 1, n, n + 1]])[0]
        self._magnets()

        # states: q, q', currents (and their slopes), lags of sensors, filters
        order = m["amplifier"].get("order", "none")
        stages = [b["sensor_lag"] for b in m["bearings"] for _ in range(2)]
        A = np.block([[np.zeros_like(stiff), np.eye(2 * n)], [-inverse @ stiff, -inverse @ damp]])
        current, drive = self._amplifier(order)
        c, size, Ia = len(current), 4 * n, np.eye(a)
        A = block_diag(A, current)
        Cx, Ci = np.zeros((a, size + c)), np.zeros((a, size + c))
        Cx[:, : 2 * n], Ci[:, size : size + a] = X, Ia
        Bf = np.zeros((size + c, a + 2))
        Bf[2 * n : 4 * n] = inverse @ np.hstack([X.T, turning])
        Bv, g = np.zeros((size + c, a)), np.zeros(size + c)
        Bv[size:], g[2 * n : 4 * n] = drive, inverse @ weight
        A = A + Bf[:, :a] @ (np.diag(self.mag[:, 4]) @ Ci + np.diag(self.mag[:, 5]) @ Cx)
        Cy = np.zeros((a, size + c))
        Cy[:, : 2 * n] = Y
        lag = np.array(stages)
        filters = [(lag, None)] if np.isfinite(lag).any() else []
        filters += [(self.anti_alias, 2)] if np.isfinite(self.anti_alias) else []
        for corner, second in filters:
            if second is None:
                W = np.diag(np.where(np.isfinite(corner), corner, PI2 * 1e6))
                block, into, out = -W, W, Ia
            else:
                w2, d = corner**2 * Ia, np.sqrt(2) * corner * Ia
                block = np.block([[np.zeros((a, a)), Ia], [-w2, -d]])
                into, out = np.vstack([np.zeros((a, a)), w2]), np.hstack([Ia, np.zeros((a, a))])
            k = len(block)
            A = np.block([[A, np.zeros((len(A), k))], [into @ Cy, block]])
            Cx, Ci = (np.hstack([C, np.zeros((a, k))]) for C in (Cx, Ci))
            Cy = np.hstack([np.zeros((a, len(A) - k)), out])
            Bf, Bv = (np.vstack([B, np.zeros((k, B.shape[1]))]) for B in (Bf, Bv))
            g = np.append(g, np.zeros(k))
        self.A, self.Bf, self.Bv, self.g, self.Cx, self.Ci, self.Cy = A, Bf, Bv, g, Cx, Ci, Cy

    def _magnets(self):
        """c, gap, bias, saturation, k_i, k_s and whether it bends, centre (a, 8): a horseshoe that has the
        file's slopes, at its load or without.
        """
        rows, k = [], 0
        for b in self.numbers["bearings"]:
            for ki, ks in zip(b["ki"], b["ks"], strict=True):
                load, bias = float(self.load[k]), b["bias"]
                at = load if b["loaded"] else 0.0
                start = np.array([ki * (ki * bias / ks) ** 2 / (4 * bias), ki * bias / ks])

                def force(i, x, c, gap, bias=bias):
                    sat = self.saturation * bias / gap
                    return pull(i, x, c, gap, bias, sat)

                def slopes(i, c, gap, bias=bias, force=force):
                    di, dx = 1e-4 * bias, 1e-4 * gap
                    by_i = (force(i + di, 0.0, c, gap) - force(i - di, 0.0, c, gap)) / (2 * di)
                    return by_i, (force(i, dx, c, gap) - force(i, -dx, c, gap)) / (2 * dx)

                def off(z, start=start, at=at, ki=ki, ks=ks, bias=bias, force=force, slopes=slopes):
                    c, gap, i = start[0] * z[0], start[1] * z[1], bias * z[2]
                    by_i, by_x = slopes(i, c, gap)
                    return [by_i / ki - 1, by_x / ks - 1, (force(i, 0.0, c, gap) - at) / ki / bias]

                z, _, found, text = fsolve(
                    off, [1.0, 1.0, at / ki / bias], full_output=True, xtol=1e-12
                )
                assert found == 1 or max(map(abs, off(z))) < 1e-9, text
                c, gap, i = start[0] * z[0], start[1] * z[1], bias * z[2]
                if not b["loaded"]:  # now the current that carries the rotor
                    i = fsolve(
                        lambda i, c=c, gap=gap, F=force, f=load: F(i[0], 0.0, c, gap) - f, load / ki
                    )[0]
                by_i, by_x = slopes(i, c, gap)
                rows.append(
                    [c, gap, bias, self.saturation * bias / gap, by_i, by_x, float(not self.linear)]
                )
                k += 1
        middle = np.broadcast_to(np.asarray(self.centre, float), len(rows))
        self.mag = np.column_stack([rows, middle])

    def _amplifier(self, order):
        a, m = len(self.axes), self.numbers["amplifier"]
        Ia, zero = np.eye(a), np.zeros((a, a))
        fast = {"none": PI2 * 1e5}.get(order, m.get("bandwidth"))
        if order in ("none", "first"):
            return -fast * Ia, fast * Ia
        if order == "twice-first":
            slow = m["eddy_bandwidth"]
            return np.block([[-slow * Ia, slow * Ia], [zero, -fast * Ia]]), np.vstack(
                [zero, fast * Ia]
            )
        w2, d = m["natural_frequency"] ** 2 * Ia, m["damping"] * Ia
        return np.block([[zero, Ia], [-w2, -d]]), np.vstack([zero, w2])

    def _run(self, law, e, seen, start, angle=0.0):
        n, a, h = len(self.A), len(self.axes), 1 / self.rate / self.substeps
        if not hasattr(self, "_steps"):
            # held input and one that rises over the step, by one exponential
            B = np.hstack([self.Bf, self.Bv, self.g[:, None]])
            k = B.shape[1]
            big = np.zeros((n + 2 * k, n + 2 * k))
            big[:n, :n], big[:n, n : n + k], big[n : n + k, n + k :] = self.A, B, np.eye(k) / h
            big = expm(big * h)
            P = [np.ascontiguousarray(big[:n, n : n + k]), np.ascontiguousarray(big[:n, n + k :])]
            f = a + 2
            parts = big[:n, :n], P[0][:, :f], P[1][:, :f], P[0][:, f : f + a], P[0][:, -1]
            self._steps = [np.ascontiguousarray(p) for p in parts]
        w, x, held = start
        wave = np.array([self.speed, angle, h, self.substeps])
        conv = np.array(
            [self.step_y, self.step_u, min(b["limit"] for b in self.numbers["bearings"])]
        )
        C = [np.ascontiguousarray(M) for M in (self.Cx, self.Ci, self.Cy)]
        gains = np.broadcast_to(np.asarray(self.gains, float), a).copy()
        return march(
            *self._steps,
            *C,
            self.mag,
            self.cross,
            law,
            e,
            seen,
            gains,
            conv,
            self.delay,
            wave,
            w,
            x,
            held,
        )

    def equilibrium(self, law):
        """States of machine, controller and delay at which nothing moves, by Newton."""
        Ak, Bk, Ck, Dk = law
        n, s, a = len(self.A), len(Ak), len(self.axes)
        gains = np.broadcast_to(np.asarray(self.gains, float), a)[:, None]
        seen, push = gains * self.Cy, self.Bf[:, :a]
        w, x, shift = np.zeros(n), np.zeros(s), np.broadcast_to(np.asarray(self.offset, float), a)
        for _ in range(30):
            # A w + B f(w) + B_v u + g = 0 and x = A_k x - B_k y with u = C_k x - D_k y, y = gains C w + offset
            F = np.zeros(a)
            bent(F, w, self.Cx, self.Ci, self.mag, self.cross)
            y = seen @ w + shift
            u = Ck @ x - Dk @ y
            off = np.append(
                self.A @ w + push @ F + self.Bv @ u + self.g, (Ak - np.eye(s)) @ x - Bk @ (seen @ w)
            )
            J = np.block(
                [
                    [self.A + push @ self._bend(w) - self.Bv @ Dk @ seen, self.Bv @ Ck],
                    [-Bk @ seen, Ak - np.eye(s)],
                ]
            )
            rows = 1 / np.abs(J).max(axis=1)
            columns = 1 / np.abs(rows[:, None] * J).max(axis=0)
            step = columns * np.linalg.solve(rows[:, None] * J * columns, rows * off)
            w, x = w - step[:n], x - step[n:]
            if (
                np.abs(self.Cx @ step[:n]).max() < 1e-14
                and np.abs(self.Ci @ step[:n]).max() < 1e-11
            ):
                break
        u = Ck @ x - Dk @ (seen @ w + shift)
        return w, x, np.tile(u, (max(self.delay, 1), 1))

    def _bend(self, w):
        """What is left of the magnets' slopes at w: (a, n)."""
        i, x = self.Ci @ w, self.Cx @ w
        a = len(i)
        by_i, by_x = np.zeros(a), np.zeros(a)
        for k, (c, gap, bias, sat, ki, ks, bends, middle) in enumerate(self.mag):
            di, dx = 1e-4 * bias, 1e-4 * gap
            both, x_k = i[k] + self.cross * i[k ^ 1], x[k] - middle
            by_i[k], by_x[k] = ki, ks
            if bends:
                far = (
                    pull(both + di, x_k, c, gap, bias, sat),
                    pull(both, x_k + dx, c, gap, bias, sat),
                )
                near = (
                    pull(both - di, x_k, c, gap, bias, sat),
                    pull(both, x_k - dx, c, gap, bias, sat),
                )
                by_i[k], by_x[k] = (far[0] - near[0]) / 2 / di, (far[1] - near[1]) / 2 / dx
        swap = np.eye(a) + self.cross * np.kron(np.eye(a // 2), [[0, 1], [1, 0]])
        here = np.diag(by_i) @ swap @ self.Ci + np.diag(by_x) @ self.Cx
        return here - np.diag(self.mag[:, 4]) @ self.Ci - np.diag(self.mag[:, 5]) @ self.Cx

    def run(self, law, e, seed=0, settle=0.5):
        """y, u, e, i, each (a, k): ``law`` A, B, C, D from errors to currents, sampled; e (a, k) or
        seconds; settle [s]: run before.
        """
        law = tuple(np.ascontiguousarray(M, dtype=float) for M in law)
        a, rng = len(self.axes), np.random.default_rng(seed)
        e = np.zeros((a, round(e * self.rate))) if np.isscalar(e) else np.asarray(e, float)
        before, k = round(settle * self.rate), e.shape[1]
        time = np.arange(before + k) / self.rate
        seen = self.noise * rng.standard_normal((before + k, a)) + np.asarray(self.offset)
        for f in (50.0, 150.0):
            seen += self.hum * np.cos(PI2 * f * time[:, None] + PI2 * rng.random(a))
        directions = [b["angle"] + way for b in self.numbers["bearings"] for way in (0, np.pi / 2)]
        turn = -self.speed * before / self.rate  # the key mark passes at the first sample
        for order, amplitude, phase in self.runout if self.speed else ():
            spin = self.speed * time[:, None] + turn - np.array(directions)
            seen += np.asarray(self.gains) * amplitude * np.cos(order * spin + phase)
        state = [part.copy() for part in self.equilibrium(law)]
        driven = np.vstack([np.zeros((before, a)), e.T])
        y, u, i = self._run(law, driven, seen, state, turn)[:, before:]
        if not np.isfinite(y).all() or np.abs(y).max() > self.mag[:, 1].min():
            raise ArithmeticError("the rotor touched")
        return {"y": y.T.copy(), "u": u.T.copy(), "e": e, "i": i.T.copy()}

    def slopes(self, law):
        """k_i, k_s (a,) where the rotor stands."""
        w = self.equilibrium(law)[0]
        bend, a = self._bend(w), len(self.axes)
        by_x = np.linalg.lstsq(self.Cx.T, (bend + np.diag(self.mag[:, 5]) @ self.Cx).T)[0]
        by_i = np.linalg.lstsq(self.Ci.T, (bend + np.diag(self.mag[:, 4]) @ self.Ci).T)[0]
        return np.diag(by_i)[:a], np.diag(by_x)[:a]

    def responses(self, law, omega):
        """G from u to y, held and sampled, and K with its delay, each (w, a, a)."""
        a, dt, n = len(self.axes), 1 / self.rate, len(self.A)
        A = self.A + self.Bf[:, :a] @ self._bend(self.equilibrium(law)[0])
        big = np.zeros((n + a, n + a))
        big[:n, :n], big[:n, n:] = A, self.Bv
        big = expm(big * dt)
        gains = np.broadcast_to(np.asarray(self.gains, float), a)[:, None]
        z = np.exp(1j * np.asarray(omega) * dt)
        G = np.array(
            [
                gains * (self.Cy @ np.linalg.solve(q * np.eye(n) - big[:n, :n], big[:n, n:]))
                for q in z
            ]
        )
        Ak, Bk, Ck, Dk = (np.asarray(M, float) for M in law)
        unit = np.eye(len(Ak))
        K = np.array([q**-self.delay * (Ck @ np.linalg.solve(q * unit - Ak, Bk) + Dk) for q in z])
        return G, K

    def sensitivity(self, law, omega):
        """S_o = (I + G K)^-1 (w, a, a) at the outputs."""
        G, K = self.responses(law, omega)
        return np.linalg.inv(np.eye(len(self.axes)) + G @ K)


def binary(a, k, amplitude, hold, rng):
    """Independent random binary sequences (a, k), each value held for ``hold`` samples."""
    bits = rng.choice([-amplitude, amplitude], (a, -(-k // hold)))
    return np.repeat(bits, hold, axis=1)[:, :k]
