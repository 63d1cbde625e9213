"""A block that moves once a turn: its multipliers against a simulation, and against the small-gain
rate that it shares with a block that moves every sample.
"""

import numpy as np
import pytest

from ambrose.core.statespace import StateSpace
from ambrose.core.synchronous import largest_gain, largest_stable, turn_map_of

DT, N = 1e-3, 40
SPEED = 2 * np.pi / (N * DT)


def turn_map(system, T, speed):
    """The map of a sampled loop with one block, of the first harmonic."""
    return turn_map_of(system, [(T, 1)], speed)


def largest_turn_gain(system, T, speed, highest, tolerance=0.01):
    """The gain eps [1/s] up to which a block that moves once a turn is stable."""
    over = turn_map(system, T, speed)
    return largest_stable(
        lambda gain: bool(np.abs(over.multipliers(gain, 0.0)).max() < 1), highest, tolerance
    )


def loop(seed=3, states=5):
    rng = np.random.default_rng(seed)
    A = rng.standard_normal((states, states))
    A *= 0.8 / np.abs(np.linalg.eigvals(A)).max()
    B, C = rng.standard_normal((states, 2)), rng.standard_normal((2, states))
    return StateSpace(A, B, C, 0.3 * np.eye(2), ("c_x", "c_y"), ("e_x", "e_y"), DT)


def response(system, harmonic=1):
    z = np.exp(1j * harmonic * SPEED * DT)
    inner = np.linalg.solve(z * np.eye(len(system.A)) - system.A, system.B)
    return system.C @ inner + system.D


def simulated(system, T, gain, turns=60):
    """Size of a over turns by the equations of the block, sample by sample."""
    return simulated_blocks(system, [(T, 1)], [gain], turns)


def simulated_blocks(system, blocks, gains, turns):
    """The same of blocks (T, harmonic) beside each other."""
    rng = np.random.default_rng(0)
    x, size = np.zeros(len(system.A)), (len(blocks), 2)
    a = rng.standard_normal(size) + 1j * rng.standard_normal(size)
    m, sizes = np.zeros(size, complex), []
    for _ in range(turns):
        a = a + np.array(gains)[:, None] * N * DT * m
        total = np.zeros(size, complex)
        for k in range(N):
            turn = [np.exp(2j * np.pi * harmonic * k / N) for _, harmonic in blocks]
            c = sum((one * part).real for one, part in zip(turn, a, strict=True))
            e = system.C @ x + system.D @ c
            total += [T @ e * np.conj(one) for (T, _), one in zip(blocks, turn, strict=True)]
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


def test_two_blocks_that_move_once_a_turn_have_multipliers_of_their_own():
    """What each is alone says nothing of both: between the borders of either alone and both."""
    system = loop(4)
    blocks = [(-np.linalg.inv(response(system, n)), n) for n in (1, 2)]
    over = turn_map_of(system, blocks, SPEED)
    for gains in ([5.0, 3.0], [2.0, 8.0]):
        largest = np.abs(over.multipliers(gains)).max()
        sizes = simulated_blocks(system, blocks, gains, 60)
        assert largest < 1
        assert (sizes[-1] / sizes[30]) ** (1 / 29) == pytest.approx(largest, rel=2e-2)
