"""What ``verify`` calls the largest sampled sensitivity over the tolerances, against members of the
box that are tried one by one.

    python -m benchmarks.box_attack [--members 10000] [--machine NAME ...]

Per machine, at its nominal point with the PID of its file: every corner of the tolerances (up to
1024) and random members, on the full plant, by code of this file. A member is the state space of
all modes, changed by its parameters at their ports, and behind the hold

    G_T(z) = sum_k H(j w_k) G(j w_k),    w_k = w + 2 pi k/T,  |k| <= 12,

on a grid of frequencies with points around the loop's resonances. Of the first 400 members (corners
before random ones) and of 400 drawn at random the whole grid is computed; of the others the
frequencies only at which one of these reaches 60 % of the largest value. The worst ten are sampled
exactly, by the matrix exponential of a plant that is assembled anew, and their peaks refined.
``above`` counts members above what ``verify`` says, by more than 1e-5 of it.
"""

from __future__ import annotations

import argparse
import itertools
import time
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.linalg as sla
import scipy.optimize as so

from ambrose import assemble, load_machine
from ambrose.core.statespace import StateSpace
from ambrose.judge.sampled import check_over_box
from ambrose.law.loop import Timing, machine_timing, match_controller
from ambrose.law.pid import pid_controller
from ambrose.model.plant import Plant
from ambrose.model.uncertainty import perturbed, tolerances_around, uncertain

MACHINES = (
    "seal-rig",
    "seal-rig-k-only",
    "turbomolecular-pump",
    "overhung-blower",
    "flywheel",
    "two-disc-rotor",
    "overhung-disc-rotor",
    "vertical-pump",
    "outboard-sensor-rotor",
    "three-bearing-train",
)
WITHOUT_RATE = Timing(1e-4)  # of machines that state none
ALIASES = 12
GRID, AROUND = 120, 40  # frequencies in all, and the resonances that have five of their own
MOST_CORNERS = 1024
EXACT = 10  # members that are sampled exactly
ROUNDING = 1e-5
PART = 400  # members at once
CALM = 0.6  # of the largest value: frequencies below it in two parts are left out of the others


@dataclass(frozen=True, eq=False)
class Ports:
    """The full plant from (w_delta, u) to (z_delta, y) as matrices, in modes; which parameter a
    channel belongs to.
    """

    names: tuple[str, ...]
    owner: np.ndarray
    poles: np.ndarray
    left: np.ndarray
    right: np.ndarray
    through: np.ndarray

    def at(self, s: np.ndarray) -> np.ndarray:
        """(w, outputs, inputs) at s (w,) [1/s]."""
        inner = 1 / (s[:, None] - self.poles)
        return np.einsum("on,wn,ni->woi", self.left, inner, self.right) + self.through


def ports(plant: Plant) -> Ports:
    """Of the tolerances around the plant's point."""
    model = uncertain(plant, tolerances_around(plant))
    system = model.system
    u = [system.inputs.index(name) for name in plant.named("u")]
    y = [system.outputs.index(name) for name in plant.named("y")]
    width = sum(block.repeat for block in model.blocks)
    into, out = [*range(width), *u], [*range(width), *y]
    values, vectors = np.linalg.eig(system.A)
    return Ports(
        tuple(block.name for block in model.blocks),
        np.repeat(np.arange(len(model.blocks)), [block.repeat for block in model.blocks]),
        values,
        system.C[out] @ vectors,
        np.linalg.solve(vectors, system.B[:, into]),
        system.D[np.ix_(out, into)],
    )


def response(law: StateSpace, omega: np.ndarray) -> np.ndarray:
    """K(e^{j w T}) (w, u, y)."""
    z = np.exp(1j * omega * law.dt)
    inner = np.linalg.inv(z[:, None, None] * np.eye(len(law.A)) - law.A)
    return law.C @ inner @ law.B + law.D


class Loop:
    """The sampled loop of any member at fixed frequencies."""

    def __init__(self, found: Ports, law: StateSpace, omega: np.ndarray) -> None:
        T = law.dt
        self.owner, self.law = found.owner, response(law, omega)
        self.terms = []
        for k in range(-ALIASES, ALIASES + 1):
            s = 1j * (omega + 2 * np.pi * k / T)
            self.terms.append((found.at(s), (1 - np.exp(-s * T)) / (s * T)))

    def gains(self, delta: np.ndarray) -> np.ndarray:
        """sigma_max(S_o) (d, w) of members (d, parameters)."""
        n = len(self.owner)
        moved = delta[:, self.owner]
        total = 0.0
        for M, hold in self.terms:
            # y = M22 u + M21 D (I - M11 D)^-1 M12 u
            loop = np.eye(n) - M[None, :, :n, :n] * moved[:, None, None, :]
            inner = np.linalg.solve(
                loop, np.broadcast_to(M[None, :, :n, n:], (*loop.shape[:3], M.shape[2] - n))
            )
            G = M[:, n:, n:] + (M[None, :, n:, :n] * moved[:, None, None, :]) @ inner
            total = total + G * hold[:, None, None]
        back = np.eye(total.shape[-1]) + total @ self.law  # S_o^-1
        # the least singular value: squares of back would round it away where the loop gain is 1e8
        return np.asarray(1 / np.linalg.svd(back, compute_uv=False)[..., -1])


def exact_peak(plant: Plant, law: StateSpace, delta: dict[str, float], near: float) -> float:
    """The peak of one member around a frequency [rad/s]: sampled by the matrix exponential."""
    member = perturbed(plant, delta, tolerances_around(plant)).system
    into = [member.inputs.index(name) for name in plant.named("u")]
    out = [member.outputs.index(name) for name in plant.named("y")]
    n, m = len(member.A), len(into)
    whole = np.zeros((n + m, n + m))
    whole[:n, :n], whole[:n, n:] = member.A, member.B[:, into]
    held = sla.expm(whole * law.dt)
    values, vectors = np.linalg.eig(held[:n, :n])
    left, right = member.C[out] @ vectors, np.linalg.solve(vectors, held[:n, n:])
    D = member.D[np.ix_(out, into)]

    def gain(w: float) -> float:
        G = (left / (np.exp(1j * w * law.dt) - values)) @ right + D
        K = response(law, np.array([w]))[0]
        return float(1 / np.linalg.svd(np.eye(len(out)) + G @ K, compute_uv=False)[-1])

    top = np.pi / law.dt
    grid = np.clip(near * np.linspace(0.97, 1.03, 61), None, 0.999 * top)
    best = grid[int(np.argmax([gain(w) for w in grid]))]
    step = 0.0011 * near
    found = so.minimize_scalar(
        lambda w: -gain(w), bounds=(best - step, min(best + step, 0.9995 * top)), method="bounded"
    )
    return max(-float(found.fun), gain(best))


def frequencies(plant: Plant, law: StateSpace) -> np.ndarray:
    """A grid [rad/s] up to the Nyquist frequency, and five points around every light resonance."""
    top = 0.999 * np.pi / law.dt
    own = np.linalg.eigvals(plant.system.A)
    light = own[(own.imag > 0) & (own.imag < top) & (-own.real < 0.3 * np.abs(own))]
    light = light[np.argsort(light.imag)][:AROUND]
    around = np.outer(light.imag, 1 + np.array([-0.02, -0.005, 0.0, 0.005, 0.02])).ravel()
    grid = np.geomspace(3.0, top, GRID)
    return np.unique(np.concatenate([grid, around[around < top]]))


def in_parts(rows: np.ndarray) -> list[np.ndarray]:
    """Rows (r,) in parts that fit the memory."""
    return np.array_split(rows, max(1, -(-len(rows) // PART)))


def attack(name: str, members: int, seed: int = 0) -> dict[str, Any]:
    """One machine: what verify says, the worst member tried, how many lie above."""
    machine = load_machine(name)
    plant = assemble(machine)
    timing = machine_timing(machine) or WITHOUT_RATE
    controller = machine.reference
    assert controller is not None
    law = timing.in_loop(match_controller(pid_controller(controller, machine), plant))
    begun = time.process_time()
    check = check_over_box(plant, law, tolerances_around(plant))["sampled.sensitivity.box"]
    said, took = float(check.value), time.process_time() - begun

    found = ports(plant)
    k = len(found.names)
    rng = np.random.default_rng(seed)
    corners = np.array(
        list(itertools.islice(itertools.product((-1.0, 1.0), repeat=k), MOST_CORNERS))
    )
    tried = np.vstack([np.zeros((1, k)), corners, rng.uniform(-1, 1, (members, k))])
    omega = frequencies(plant, law)
    loop = Loop(found, law, omega)
    peaks, where = np.empty(len(tried)), np.empty(len(tried), int)
    # the whole grid of the first part and of as many random members as a part holds
    sample = np.union1d(np.arange(min(PART, len(tried))), rng.integers(len(tried), size=PART))
    whole = np.concatenate([loop.gains(tried[part]) for part in in_parts(sample)])
    peaks[sample], where[sample] = whole.max(axis=1), whole.argmax(axis=1)
    # of the others, the frequencies that decide
    busy = np.flatnonzero(whole.max(axis=0) > CALM * whole.max())
    loop = Loop(found, law, omega[busy])
    for part in in_parts(np.setdiff1d(np.arange(len(tried)), sample)):
        gains = loop.gains(tried[part])
        peaks[part], where[part] = gains.max(axis=1), busy[gains.argmax(axis=1)]
    order = np.argsort(-peaks)[:EXACT]
    exact = [
        exact_peak(
            plant, law, dict(zip(found.names, tried[i].tolist(), strict=True)), omega[where[i]]
        )
        for i in order
    ]
    worst = max(peaks.max(), *exact)
    above = int((peaks > said * (1 + ROUNDING)).sum())
    above += sum(a > said * (1 + ROUNDING) >= peaks[i] for a, i in zip(exact, order, strict=True))
    return {
        "machine": name,
        "parameters": k,
        "states": plant.system.n_states,
        "members": len(tried),
        "frequencies": len(omega),
        "decisive": len(busy),
        "nominal": float(peaks[0]),
        "worst": float(worst),
        "box": said,
        "above": above,
        "verify_s": took,
        "attack_s": time.process_time() - begun - took,
    }


def rows(machines: tuple[str, ...] = MACHINES, members: int = 10_000) -> Iterator[dict[str, Any]]:
    for name in machines:
        yield attack(name, members)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="The box of the tolerances, attacked.")
    parser.add_argument("--members", type=int, default=10_000)
    parser.add_argument("--machine", nargs="*", default=MACHINES)
    asked = parser.parse_args()
    print("| machine | parameters | states | members | nominal | worst member | box says | above |")
    print("|---|---|---|---|---|---|---|---|")
    for row in rows(tuple(asked.machine), asked.members):
        print(
            f"| `{row['machine']}` | {row['parameters']} | {row['states']} | {row['members']:,} | "
            f"{row['nominal']:.4f} | {row['worst']:.4f} | {row['box']:.4f} | {row['above']} |",
            f"  {row['verify_s']:.0f} s, {row['attack_s']:.0f} s",
            flush=True,
        )
