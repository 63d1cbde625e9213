"""An analyser on the tests' own rig: the responses of a running loop with noise, and the truth."""

from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import block_diag, expm

from ambrose.machine.description import OperatingPoint
from ambrose.record.response import Path, Response
from independent_rig import Rig, numbers_of


@dataclass(frozen=True, eq=False)
class Truth:
    """A linear rig; held: A, B, C of the plant as its controller sees it, y per u.

    casing: (hertz, damping, part) of a mode that is no part of any machine file, beside the rotor
    at every axis; part: its peak over the plant's own size there.
    """

    rig: Rig
    held: tuple
    rate: float

    @staticmethod
    def of(file, rate, magnets=(0.0, 0.0), mode=0.0, casing=None, speed=0.0, modes=6):
        numbers = numbers_of(file)
        for bearing in numbers["bearings"]:
            for key, part in zip(("ki", "ks"), magnets, strict=True):
                bearing[key] = np.asarray(bearing[key]) * (1 + part)
        for section in numbers["shaft"]:
            section["youngs_modulus"] *= (1 + mode) ** 2
        rig = Rig(numbers, speed=speed, modes=modes, linear=True)
        A, B, C = rig.A, rig.Bv, rig.Cy
        a = len(rig.axes)
        if casing is not None:
            # x'' + 2 z w x' + w^2 x = w^2 gain i beside the rotor, y = y_rotor + x
            hertz, damping, part = casing
            w = 2 * np.pi * hertz
            own = np.array([[0.0, 1.0], [-(w**2), -2 * damping * w]])
            there = C @ np.linalg.solve(1j * w * np.eye(len(A)) - A, B)
            gain = 2 * damping * part * np.abs(np.diag(there)).max()
            A = block_diag(A, *[own] * a)
            B = np.vstack([B, np.kron(np.eye(a), [[0.0], [w**2 * gain]])])
            C = np.hstack([C, np.kron(np.eye(a), [[1.0, 0.0]])])
        n = len(A)
        big = np.zeros((n + a, n + a))
        big[:n, :n], big[:n, n:] = A, B
        big = expm(big / rate)
        return Truth(rig, (big[:n, :n], big[:n, n:], C), rate)

    def hertz(self, low=4.0, high=1600.0, lines=130, packed=9):
        """A sweep, with lines packed about every lightly damped mode of the plant."""
        s = np.log(np.linalg.eigvals(self.held[0]).astype(complex)) * self.rate
        light = s[(s.imag > 2 * np.pi * low) & (s.imag < 2 * np.pi * high)]
        light = light[-light.real < 0.1 * light.imag]
        found = [np.geomspace(low, high, lines)]
        for pole in light:
            width = max(-pole.real, 2e-3 * pole.imag)
            found.append((pole.imag + width * np.linspace(-6, 6, 4 * packed)) / (2 * np.pi))
        found = np.concatenate(found)
        return np.unique(found[(found >= low) & (found <= high)].round(3))

    def recommended(self, law, low, high):
        """The lines of docs/how-to/responses.md: ten per octave, from the first bending mode on
        twenty, and five within the half-power width of every lightly damped pole of the loop.
        """
        s = self.light_poles(law)
        s = s[(s.imag > 2 * np.pi * low) & (s.imag < 2 * np.pi * high) & (-s.real < 0.05 * s.imag)]
        first = s.imag[-s.real < 0.02 * s.imag].min() / (2 * np.pi)
        found = [
            np.geomspace(*ends, int(lines * np.log2(ends[1] / ends[0])))
            for ends, lines in (((low, first), 10), ((first, high), 20))
        ]
        found += [(p.imag + p.real * np.linspace(-1, 1, 5)) / (2 * np.pi) for p in s]
        found = np.sort(np.concatenate(found))
        apart = np.append(True, np.diff(found) > 1e-4 * found[1:])  # twins share their lines
        return found[apart & (found >= low) & (found <= high)]

    def poles(self, law):
        """Of the running loop, with its sample of delay, in z."""
        Ad, Bd, Cy = self.held
        A, B, C, D = law
        n, k, a = len(Ad), len(A), Bd.shape[1]
        loop = np.block(
            [
                [Ad, np.zeros((n, k)), Bd],
                [-B @ Cy, A, np.zeros((k, a))],
                [-D @ Cy, C, np.zeros((a, a))],
            ]
        )
        return np.linalg.eigvals(loop)

    def radius(self, law):
        """The largest modulus of these poles."""
        return np.abs(self.poles(law)).max()

    def light_poles(self, law):
        """Poles [rad/s] of the running loop that make resonances."""
        s = np.log(self.poles(law).astype(complex) + 1e-300) * self.rate
        return s[(s.imag > 0) & (np.abs(s.real) < 0.1 * np.abs(s))]

    def plant(self, hertz):
        """G (w, a, a)."""
        return response(*self.held, 0.0, hertz, self.rate)

    def controller(self, law, hertz):
        """K (w, a, a) of matrices A, B, C, D with a sample of delay."""
        z = np.exp(-2j * np.pi * hertz / self.rate)
        return z[:, None, None] * response(*law, hertz, self.rate)

    def sensitivity(self, law, hertz):
        """S (w, a, a)."""
        GK = self.plant(hertz) @ self.controller(law, hertz)
        return np.linalg.inv(np.eye(GK.shape[1]) + GK)

    def sweep(self, name, law, hertz, kind="T", noise=0.01, seed=1, stated=True, diagonal=False):
        """Responses of the running loop; kind: quantities with + between."""
        G, K = self.plant(hertz), self.controller(law, hertz)
        a = G.shape[1]
        S = np.linalg.inv(np.eye(a) + G @ K)
        values = {"S": S, "T": G @ K @ S, "motion": G @ np.linalg.inv(np.eye(a) + K @ G), "G": G}
        values["L"] = np.einsum("wi,ij->wij", 1 / np.einsum("wii->wi", S) - 1, np.eye(a))
        rng, paths = np.random.default_rng(seed), []
        for quantity in kind.split("+"):
            X = values[quantity]
            floor = 0.05 * np.median(np.abs(X[:, 0, 0]))
            for i, j in np.ndindex(a, a):
                if (diagonal or quantity == "L") and i != j:
                    continue
                size = noise * np.hypot(np.abs(X[:, i, j]), floor)
                error = rng.normal(size=(2, len(hertz))) * size / np.sqrt(2)
                value = X[:, i, j] + error[0] + 1j * error[1]
                axes = self.rig.axes[i], self.rig.axes[j]
                paths.append(Path(quantity, *axes, value, size**2 if stated else None))
        point = OperatingPoint(self.rig.speed, 0.0)
        omega = 2 * np.pi * hertz
        return Response(name, omega, tuple(paths), point, sample_rate_hz=self.rate)


def stepped(rig, law, hertz, amplitude, settle=0.25, least=0.06, periods=6, seed=0):
    """Displacement per excitation current (w, a, a) as an analyser measures it in time: a sine of
    ``amplitude`` [A] at one axis after the other, ``settle`` [s] and five periods waited at every
    line, then whole periods correlated, ``periods`` or ``least`` [s] of them. With what the rig has of noise, hum,
    converters' steps, run-out and bending magnets, and of the transient what is left.
    """
    a, found = len(rig.axes), []
    waits = [round((settle + 5 / f) * rig.rate) for f in hertz]
    counts = [round(max(periods, np.ceil(least * f)) / f * rig.rate) for f in hertz]
    waves = [
        np.sin(2 * np.pi * f / rig.rate * np.arange(wait + n))
        for f, wait, n in zip(hertz, waits, counts, strict=True)
    ]
    ends = np.cumsum([len(wave) for wave in waves])
    for axis in range(a):
        e = np.zeros((a, ends[-1]))
        e[axis] = amplitude * np.concatenate(waves)
        y = rig.run(law, e, seed=seed + axis)["y"]
        column = []
        for f, n, end in zip(hertz, counts, ends, strict=True):
            turn = np.exp(-2j * np.pi * f / rig.rate * np.arange(n))
            part = y[:, end - n : end]
            column.append(
                (part - part.mean(1, keepdims=True)) @ turn / (e[axis, end - n : end] @ turn)
            )
        found.append(column)
    return np.transpose(found, (1, 2, 0))


def response(A, B, C, D, hertz, rate):
    z = np.exp(2j * np.pi * hertz / rate)
    inner = z[:, None, None] * np.eye(len(A)) - A
    return C @ np.linalg.solve(inner, np.broadcast_to(B, (len(z), *B.shape))) + D


def matrices(law, rate):
    """A, B, C, D of a controller as it is sampled by Tustin's rule."""
    if law.dt is not None:
        return law.A, law.B, law.C, law.D
    eye, h = np.eye(len(law.A)), 1 / rate
    inner = np.linalg.inv(eye - h / 2 * law.A)
    A = inner @ (eye + h / 2 * law.A)
    B = inner @ law.B * h
    return A, B, law.C @ inner, law.D + law.C @ inner @ law.B * h / 2


__all__ = ["Truth", "matrices", "replace", "stepped"]
