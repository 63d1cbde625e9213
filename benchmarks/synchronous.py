"""Synchronous unbalance control against brute force, on the rig, and its code against its twin.

    python -m benchmarks.synchronous [--part borders|hold|code] [--machine flywheel ...]
                                     [--share 0.85]

borders: the speed from which the plain notch (T = 1) is stable for small gains, by the sign of
Re lambda(S), and by bisection on the poles of the sampled full plant with the block in it, put
together here from the matrices of plant and controller alone. hold: the rig at a constant speed,
with weight, noise and quantisation as the machine file has them, and without noise and
quantisation: 1x of the largest control current before and after, and what of the unbalance is told.
code: C beside the reference controller against its twin over a run-up with lost pulses.
"""

from __future__ import annotations

import argparse
import itertools
from dataclasses import replace

import numpy as np
import scipy.linalg as sla

from ambrose import load_machine
from ambrose.annexes.synchronous.block_code import RunUnit, run_unit
from ambrose.annexes.synchronous.block_design import design_synchronous
from ambrose.annexes.synchronous.block_loop import conditions, running_law, synchronous_loop
from ambrose.annexes.synchronous.running import synchronous_program
from ambrose.code.block.block import build_block
from ambrose.code.pipeline import machine_limits
from ambrose.code.sampled import deploy
from ambrose.core.statespace import StateSpace, select
from ambrose.core.synchronous import borders, convergence
from ambrose.law.pid import pid_controller
from ambrose.law.synchronous_block import key_phasor
from ambrose.machine.machine import Machine
from ambrose.model.assemble import assemble
from ambrose.model.plant import Plant
from ambrose.model.static_load import residual_unbalance
from ambrose.rig.scenario import Scenario, Unbalance
from ambrose.rig.virtual_rig import run
from benchmarks.compiled_synchronous import CompiledRun, CompiledSynchronous
from benchmarks.unbalance_estimate import unbalance_from_amplitudes

MACHINES = (
    "turboexpander",
    "flywheel",
    "overhung-blower",
    "turbomolecular-pump",
    "process-compressor",
)
_SMALL = 0.02  # 1/s: the gain of the brute-force search
_MODES = 12  # bending modes of the rig's rotor
_HOLD, _SETTLED = 3.5, 8.0  # s of a run on the rig, at least; time constants before its last second


def controlled(name: str) -> tuple[Machine, StateSpace]:
    """A bundled machine with the reference controller of its file."""
    machine = load_machine(name)
    return machine, pid_controller(machine.reference, machine)


def without_noise(machine: Machine) -> Machine:
    """A machine whose sensors neither scatter nor round."""
    silent = [replace(sensor, noise=0.0, resolution=0.0) for sensor in machine.sensors]
    return replace(machine, sensors=type(machine.sensors)(silent))


def growth(machine: Machine, K: StateSpace, speed: float, dt: float, eps: float = _SMALL) -> float:
    """``growth_of`` the full plant at a speed with the plain notch, T = 1."""
    point = replace(machine.operation.design, speed=speed, label="")
    return growth_of(assemble(machine, point), K, speed, dt, np.eye(len(machine.axes)), eps)


def growth_of(
    plant: Plant, K: StateSpace, speed: float, dt: float, T: np.ndarray, eps: float
) -> float:
    """ln|z|/dt [1/s] of the outermost pole of a sampled full plant under a continuous controller,
    one sample late, with the block of T (a, a) complex and eps [1/s] at a speed [rad/s].
    """
    return growth_with(held_plant(plant, dt), K, speed, dt, T, eps)


def held_plant(plant: Plant, dt: float) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """A, B of the plant from u to y under a zero-order hold, and its C, D."""
    G = select(plant.system, plant.named("u"), plant.named("y"))
    n, states = G.B.shape[1], G.n_states

    # exp of [[A, B], [0, 0]] dt
    held = sla.expm(np.block([[G.A, G.B], [np.zeros((n, states + n))]]) * dt)
    return held[:states, :states], held[:states, states:], G.C, G.D


def growth_with(
    held: tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray],
    K: StateSpace,
    speed: float,
    dt: float,
    T: np.ndarray,
    eps: float,
) -> float:
    """``growth_of`` a plant that is held already (``held_plant``)."""
    A, B, C, D = held
    n, states = len(T), len(A)

    # Tustin: x+ = (1 - A dt/2)^-1 ((1 + A dt/2) x + B dt e), output at (x + x+)/2
    half = np.eye(K.n_states) - K.A * dt / 2
    Ak = np.linalg.solve(half, np.eye(K.n_states) + K.A * dt / 2)
    Bk = np.linalg.solve(half, K.B * dt)
    Ck = K.C @ (np.eye(K.n_states) + Ak) / 2
    Dk = K.D + K.C @ Bk / 2

    # states x, x_k, the currents on their way v, and w = exp(j W k dt) a as Re w, Im w
    sizes = (states, K.n_states, n, n, n)
    ends = np.cumsum((0, *sizes))
    x, k, v, re, im = (slice(a, b) for a, b in itertools.pairwise(ends))
    M, one = np.zeros((ends[-1], ends[-1])), np.eye(n)
    y = np.zeros((n, ends[-1]))
    y[:, x], y[:, v] = C, D
    e = y.copy()  # what is measured less what the block adds, c = Re w
    e[:, re] -= one
    M[x, x], M[x, v] = A, B
    M[k] = -Bk @ e
    M[k, k] += Ak
    M[v] = -Dk @ e
    M[v, k] += Ck

    # w+ = exp(j W dt) (w + eps dt T e)
    learnt = eps * dt * np.real(T) @ e
    learnt[:, re] += one
    turn = eps * dt * np.imag(T) @ e
    turn[:, im] += one
    c, s = np.cos(speed * dt), np.sin(speed * dt)
    M[re], M[im] = c * learnt - s * turn, s * learnt + c * turn
    return float(np.log(np.abs(np.linalg.eigvals(M)).max()) / dt)


def border_of(name: str) -> tuple[float, float] | None:
    """The last border [rad/s] of the plain notch: by Re lambda(S), and by brute force near it;
    None where the sampled loop is unstable without a block.
    """
    machine, K = controlled(name)
    loop = synchronous_loop(machine, K)
    at, one = conditions(machine)[0], np.eye(len(machine.axes))
    top, dt = machine.operation.design.speed, loop.timing.sample_time
    assert loop.timing.delay_samples == 1

    def value(w: float) -> float:
        return float(convergence(one, loop.response("current-free", w, at)))

    border = borders(value, np.linspace(0.02, 1, 25) * top)[-1].value
    low, high = 0.9 * border, 1.1 * border
    if growth(machine, K, border, dt, 0.0) > _SMALL:
        return None
    assert growth(machine, K, low, dt) > 0 > growth(machine, K, high, dt)
    while high - low > 1e-3 * border:
        middle = (low + high) / 2
        if growth(machine, K, middle, dt) > 0:
            low = middle
        else:
            high = middle
    return border, (low + high) / 2


def hold(
    name: str, share: float = 0.85, *, quiet: bool = False, modes: int = _MODES
) -> tuple[float, float, float]:
    """On the rig at a share of the design speed: the largest 1x control current of an axis after
    over before [dB], the smallest one after over the same [dB], and the share of the unbalance that
    is told from the amplitudes.

    quiet: without noise and quantisation; modes: bending modes of the rig's rotor, as many as it
    takes for its static bending to be that of the full plant.
    """
    machine, law = controlled(name)
    if quiet:
        machine = without_noise(machine)
    loop, speed = synchronous_loop(machine, law), share * machine.operation.design.speed
    design = design_synchronous(machine, law, band=(0.95 * speed, 1.05 * speed))
    blocks = running_law(design.blocks, loop)
    first, last = machine.bearings[0].name, machine.bearings[-1].name
    residual = residual_unbalance(machine)
    assert residual is not None
    size = float(residual.moment)  # what the balance grade leaves, in the first bearing's plane
    weights = (Unbalance(first, size), Unbalance(last, 0.7 * size, phase=1.0))
    sampled = loop.controller(loop.plant(speed, conditions(machine)[0]))
    counts = max(_HOLD - 1, _SETTLED * design.blocks[0].time_constant)
    until = counts + 1
    scenario = Scenario("hold", until, unbalances=weights, speed=speed)
    block = CompiledSynchronous(blocks)
    program = synchronous_program(machine, sampled, blocks, scenario, block=block)
    trace = run(machine, program, scenario, every=5, bending_modes=modes)
    time = trace.record.time

    def tones(start: float, end: float) -> np.ndarray:
        turns = int((end - start) * speed / (2 * np.pi))
        inside = (time >= start) & (time < start + turns * 2 * np.pi / speed)
        wave = np.exp(-1j * speed * time[inside])
        return np.array(
            [abs(2 * np.mean(trace.record[f"u_{a}"][inside] * wave)) for a in machine.axes]
        )

    turn = 2 * np.pi / speed
    before, after = tones(0.5 * turn, 4.5 * turn).max(), tones(counts, until).max()
    beside = max(tones(counts, until).min(), 1e-12)
    late = np.mean([a[0] for k, _, a, _ in program.history if k * sampled.dt > counts], axis=0)
    found = unbalance_from_amplitudes(loop, conditions(machine)[0], [speed], late[None])
    # a scenario's phases count from the bearing's own first axis
    turned = np.exp(1j * np.array([machine.bearings[0].angle, machine.bearings[-1].angle]))
    true = np.array([size, 0.7 * size * np.exp(1j)]) * turned
    told = 1 - float(np.linalg.norm(found.moments - true) / np.linalg.norm(true))
    return 20 * np.log10(after / before), 20 * np.log10(beside / before), told


def code_beside(name: str, count: int = 4000) -> float:
    """The largest difference of currents of C and twin over a run-up, of the largest current."""
    machine, law = controlled(name)
    loop, top = synchronous_loop(machine, law), machine.operation.design.speed
    dt = loop.timing.sample_time
    design = design_synchronous(machine, law, band=(0.8 * top, 0.9 * top))
    base = build_block(deploy(law, dt, dt, force=True), "unit", *machine_limits(machine))
    unit = RunUnit(base, running_law(design.blocks, loop))
    end = count * dt
    pulses = key_phasor([0.0, end], [0.78 * top, 0.92 * top], dt, count)
    pulses[count // 2 : int(0.6 * count)] = -1.0
    theta = np.cumsum(np.linspace(0.78, 0.92, count) * top) * dt
    size = 0.1 * float(np.min(base.error_limit))
    errors = size * np.cos(theta[:, None] + np.arange(len(machine.axes)))
    twin, code = run_unit(unit, pulses, errors), CompiledRun(unit).run(pulses, errors)
    return float(np.abs(twin.currents - code.currents).max() / np.abs(twin.currents).max())


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--part", choices=("borders", "hold", "code"), default="borders")
    parser.add_argument("--machine", nargs="*", default=MACHINES)
    parser.add_argument("--share", type=float, default=0.85, help="of the top speed, of hold")
    options = parser.parse_args()
    for name in options.machine:
        if options.part == "borders":
            found = border_of(name)
            if found is None:
                print(f"{name}: the sampled loop is unstable without a block")
                continue
            proof, brute = found
            off = 100 * abs(proof / brute - 1)
            print(f"{name}: {proof:.1f} rad/s, brute force {brute:.1f}, {off:.2f} % apart")
        elif options.part == "hold":
            for quiet in (False, True):
                change, beside, told = hold(name, options.share, quiet=quiet)
                words = "without noise" if quiet else "as the file has it"
                print(f"{name}, {words}: {change:.1f} dB, {beside:.1f} dB, {told:.1%} told")
        else:
            print(f"{name}: {code_beside(name):.1e}")


if __name__ == "__main__":
    main()
