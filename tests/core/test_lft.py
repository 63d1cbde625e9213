"""Linear fractional transformations against their formulas, with random plants that feed through
everywhere.
"""

import numpy as np
import pytest

from ambrose.core.checks import InvalidInput, NumericalFailure
from ambrose.core.lft import (
    ComplexBlock,
    FullBlock,
    GeneralizedPlant,
    RealBlock,
    close_uncertainty,
    lft,
)
from ambrose.core.statespace import StateSpace, connect, rename, static_gain

POINTS = (0.4j, 1.5 + 2.0j)
BLOCKS = (RealBlock("k", 2), FullBlock("dynamics", 1, 2), ComplexBlock("gain"))


def at(system, s):
    return system.C @ np.linalg.solve(s * np.eye(len(system.A)) - system.A, system.B) + system.D


def random_plant(seed=0, blocks=BLOCKS, n=5):
    rng = np.random.default_rng(seed)
    inputs = ["w1", "w2", "w3", "w4", "dist", "u1", "u2"]
    outputs = ["z1", "z2", "z3", "z4", "z5", "perf1", "perf2", "y1"]
    A, B = rng.standard_normal((n, n)), rng.standard_normal((n, 7))
    system = StateSpace(
        A, B, rng.standard_normal((8, n)), 0.3 * rng.standard_normal((8, 7)), inputs, outputs
    )
    return GeneralizedPlant(system, inputs[:5], inputs[5:], outputs[:7], outputs[7:], blocks)


def random_controller(seed=1, n=3, dt=None):
    rng = np.random.default_rng(seed)
    return StateSpace(
        rng.standard_normal((n, n)),
        rng.standard_normal((n, 1)),
        rng.standard_normal((2, n)),
        0.3 * rng.standard_normal((2, 1)),
        dt=dt,
    )


@pytest.mark.parametrize("states", [0, 3])
@pytest.mark.parametrize("seed", range(4))
def test_lower_lft(seed, states):
    plant, K = random_plant(seed), random_controller(seed, states)
    closed = lft(plant, K)
    assert closed.inputs == plant.w and closed.outputs == plant.z and closed.n_states == 5 + states
    for s in POINTS:
        P, k = at(plant.system, s), at(K, s)
        P11 = P[:7, :5]
        P12 = P[:7, 5:]
        P21 = P[7:, :5]
        P22 = P[7:, 5:]
        assert np.abs(P22).max() > 0.05
        np.testing.assert_allclose(
            at(closed, s), P11 + P12 @ k @ np.linalg.solve(np.eye(1) - P22 @ k, P21), rtol=1e-10
        )


@pytest.mark.parametrize("seed", range(4))
def test_upper_lft(seed):
    plant = random_plant(seed)
    rng = np.random.default_rng(seed + 100)
    full = rng.uniform(-1, 1, (1, 2))
    closed = close_uncertainty(plant, {"k": 0.7, "dynamics": full, "gain": -0.4})
    delta = np.zeros((4, 5))
    delta[0, 0] = delta[1, 1] = 0.7
    delta[2, 2:4] = full
    delta[3, 4] = -0.4
    assert closed.inputs == ("dist", "u1", "u2") and closed.outputs == ("perf1", "perf2", "y1")
    for s in POINTS:
        M = at(plant.system, s)
        M11 = M[:5, :4]
        M12 = M[:5, 4:]
        M21 = M[5:, :4]
        M22 = M[5:, 4:]
        np.testing.assert_allclose(
            at(closed, s),
            M22 + M21 @ delta @ np.linalg.solve(np.eye(5) - M11 @ delta, M12),
            rtol=1e-10,
        )


def test_absent_blocks_are_zero_and_order_of_closing_does_not_matter():
    plant, K = random_plant(), random_controller()
    nominal = close_uncertainty(plant, {})
    for s in POINTS:
        np.testing.assert_allclose(at(nominal, s), at(plant.system, s)[5:, 4:], rtol=1e-12)
    delta = {"k": -0.3, "gain": 0.9}
    closed_first = lft(plant, K)
    again = GeneralizedPlant(closed_first, plant.w, [], plant.z, [], BLOCKS)
    perturbed_first = close_uncertainty(plant, delta)
    other = GeneralizedPlant(perturbed_first, ["dist"], plant.u, ["perf1", "perf2"], plant.y)
    for s in POINTS:
        np.testing.assert_allclose(
            at(close_uncertainty(again, delta), s), at(lft(other, K), s), rtol=1e-9
        )


def test_the_loop_diagram_as_generalized_plant():
    """r - y goes to K inside P: the lower LFT from d to y is S_o, from r to u is K S_o."""
    rng = np.random.default_rng(5)
    G = StateSpace(
        rng.standard_normal((3, 3)),
        rng.standard_normal((3, 2)),
        rng.standard_normal((2, 3)),
        np.zeros((2, 2)),
        ["u1", "u2"],
        ["g1", "g2"],
    )
    K = StateSpace(
        rng.standard_normal((2, 2)),
        rng.standard_normal((2, 2)),
        rng.standard_normal((2, 2)),
        rng.standard_normal((2, 2)),
    )
    sums = {f"y{i}": [f"g{i}", f"d{i}"] for i in (1, 2)} | {
        f"e{i}": [f"r{i}", f"-y{i}"] for i in (1, 2)
    }
    system = connect(
        [G], ["d1", "d2", "r1", "r2", "u1", "u2"], ["y1", "y2", "u1", "u2", "e1", "e2"], sums
    )
    system = rename(system, outputs={"u1": "zu1", "u2": "zu2"})
    plant = GeneralizedPlant(
        system, ["d1", "d2", "r1", "r2"], ["u1", "u2"], ["y1", "y2", "zu1", "zu2"], ["e1", "e2"]
    )
    closed = lft(plant, K)
    for s in POINTS:
        g, k = at(G, s), at(K, s)
        S = np.linalg.inv(np.eye(2) + g @ k)
        expected = np.block([[S, S @ g @ k], [-k @ S, k @ S]])
        np.testing.assert_allclose(at(closed, s), expected, rtol=1e-9)


def test_signals_are_reordered_and_single_names_accepted():
    system = random_plant().system
    plant = GeneralizedPlant(system, "dist", ["u2", "u1"], ["perf2"], "y1")
    assert plant.system.inputs == ("dist", "u2", "u1") and plant.system.outputs == ("perf2", "y1")
    assert (plant.n_w_blocks, plant.n_z_blocks) == (0, 0)
    assert (random_plant().n_w_blocks, random_plant().n_z_blocks) == (4, 5)


def test_sampled_controller_needs_a_sampled_plant():
    with pytest.raises(InvalidInput, match="sample times"):
        lft(random_plant(), random_controller(dt=0.1))


def test_algebraic_loop():
    system = StateSpace([], [], [], [[0, 1.0], [1.0, 0.5]], ["w", "u"], ["z", "y"])
    plant = GeneralizedPlant(system, ["w"], ["u"], ["z"], ["y"])
    with pytest.raises(NumericalFailure, match="algebraic"):
        lft(plant, static_gain(2.0))
    assert lft(plant, static_gain(1.0)).D.tolist() == [[2.0]]


@pytest.mark.parametrize(
    ("delta", "message"),
    [
        ({"nobody": 1.0}, "'nobody' is unknown; the plant has k, dynamics, gain"),
        ({"k": [0.1, 0.2]}, "delta of k is .* one number"),
        ({"gain": 0.5j}, "delta of gain is .* but must be real"),
        ({"dynamics": np.ones((2, 1))}, "shape of delta of dynamics"),
        ({"k": np.nan}, "delta of k is nan"),
    ],
)
def test_bad_perturbations(delta, message):
    with pytest.raises(InvalidInput, match=message):
        close_uncertainty(random_plant(), delta)


@pytest.mark.parametrize(
    "block",
    [lambda: RealBlock("a", 0), lambda: ComplexBlock("a", 1.5), lambda: FullBlock("a", 1, -1)],
)
def test_bad_blocks(block):
    with pytest.raises(InvalidInput, match="block 'a'"):
        block()


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"w": ["nobody"]}, "'nobody'"),
        ({"w": ["dist", "u1"]}, "repeating u1"),
        ({"blocks": [RealBlock("k", 2)]}, "blocks' w count is 2"),
        (
            {"blocks": [RealBlock("k"), RealBlock("k")], "w": ["w1", "w2"], "z": ["z1", "z2"]},
            "block names",
        ),
    ],
)
def test_bad_plants(changes, message):
    arguments = {"w": ["dist"], "u": ["u1"], "z": ["perf1"], "y": ["y1"], "blocks": []} | changes
    with pytest.raises(InvalidInput, match=message):
        GeneralizedPlant(random_plant().system, **arguments)


def test_controller_size():
    with pytest.raises(InvalidInput, match="controller's size"):
        lft(random_plant(), static_gain([[1.0]]))
