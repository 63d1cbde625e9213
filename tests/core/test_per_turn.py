"""A block that moves once a turn: its multipliers against a simulation, and against the small-gain
rate that it shares with a block that moves every sample.
"""

import numpy as np
import pytest

from ambrose.core.per_turn import largest_turn_gain, turn_map
from ambrose.core.statespace import StateSpace
from ambrose.core.synchronous import largest_gain

DT, N = 1e-3, 40
SPEED = 2 * np.pi / (N * DT)


def loop(seed=3, states=5):
    rng = np.random.default_rng(seed)
    A = rng.standard_normal((states, states))
    A *= 0.8 / np.abs(np.linalg.eigvals(A)).max()
    B, C = rng.standard_normal((states, 2)), rng.standard_normal((2, states))
    return StateSpace(A, B, C, 0.3 * np.eye(2), ("c_x", "c_y"), ("e_x", "e_y"), DT)


def response(system):
    z = np.exp(1j * SPEED * DT)
    inner = np.linalg.solve(z * np.eye(len(system.A)) - system.A, system.B)
    return system.C @ inner + system.D


def simulated(system, T, gain, turns=60, harmonic=1):
    """Size of a over turns by the equations of the block, sample by sample."""
    rng = np.random.default_rng(0)
    x, a = np.zeros(len(system.A)), rng.standard_normal(2) + 1j * rng.standard_normal(2)
    m, sizes = np.zeros(2, complex), []
    for _ in range(turns):
        a = a + gain * N * DT * m
        total = np.zeros(2, complex)
        for k in range(N):
            turn = np.exp(2j * np.pi * harmonic * k / N)
            c = (turn * a).real
            total += T @ (system.C @ x + system.D @ c) * turn.conjugate()
            x = system.A @ x + system.B @ c
        m = total / N
        sizes.append(np.linalg.norm(a))
    return np.array(sizes)


def test_multipliers_are_what_a_simulation_decays_by():
    system = loop()
    T = -np.linalg.inv(response(system))
    gain = 5.0
    largest = np.abs(turn_map(system, T, SPEED).multipliers(gain)).max()
    sizes = simulated(system, T, gain)
    assert largest < 1
    assert (sizes[-1] / sizes[30]) ** (1 / 29) == pytest.approx(largest, rel=2e-3)


def test_the_border_of_stability_is_where_a_simulation_begins_to_grow():
    system = loop(4)
    T = -np.linalg.inv(response(system))
    border = largest_turn_gain(system, T, SPEED, 1e3, 1e-4)
    assert 0 < border < 1e3
    below, above = (
        simulated(system, T, 0.97 * border, 400),
        simulated(system, T, 1.03 * border, 400),
    )
    assert below[-1] < below[100] and above[-1] > above[100]


def test_for_small_gains_both_ways_converge_alike():
    """1 - rho = (eps/2) t Re lambda(T R), with T = -R^-1 e^{j b}: cos(b)."""
    system, b, eps = loop(), 0.4, 1e-3
    T = -np.linalg.inv(response(system)) * np.exp(1j * b)
    largest = np.abs(turn_map(system, T, SPEED).multipliers(eps)).max()
    assert (1 - largest) / (N * DT) == pytest.approx(eps / 2 * np.cos(b), rel=1e-3)


def test_a_leak_and_a_wrong_phase():
    system = loop()
    turned = np.linalg.inv(response(system))  # the wrong sign: grows for every gain
    over = turn_map(system, turned, SPEED)
    assert np.abs(over.multipliers(1e-2)).max() > 1
    assert largest_turn_gain(system, turned, SPEED, 100.0) == 0.0
    assert largest_gain(system, turned, SPEED, 100.0) == 0.0
    assert np.abs(over.multipliers(1e-2, leak=1.0)).max() < 1
