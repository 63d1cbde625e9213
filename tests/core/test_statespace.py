"""Interconnections against their algebra in the frequency domain, evaluated by plain dense
solves.
"""

import json
import pickle
from dataclasses import FrozenInstanceError, replace

import control
import numpy as np
import pytest
import scipy.signal
from hypothesis import given, settings, strategies as st

from ambrose.core.checks import InvalidInput, NumericalFailure
from ambrose.core.statespace import (
    StateSpace,
    append,
    as_statespace,
    close,
    connect,
    feedback,
    is_stable,
    match_signals,
    poles,
    rename,
    select,
    series,
    spectral_abscissa,
    static_gain,
    transfer_function,
)

POINTS = (0.3j, 2.0 + 1.5j, -0.1 + 7.0j)


def at(system, s):
    """G(s), by a dense solve."""
    return system.C @ np.linalg.solve(s * np.eye(len(system.A)) - system.A, system.B) + system.D


def same(system, values, rtol=1e-10):
    for s in POINTS:
        np.testing.assert_allclose(at(system, s), values(s), rtol=rtol, atol=rtol)


def random_system(seed, n=4, m=2, p=3, dt=None, through=True):
    rng = np.random.default_rng(seed)
    D = rng.standard_normal((p, m)) * through
    return StateSpace(
        rng.standard_normal((n, n)),
        rng.standard_normal((n, m)),
        rng.standard_normal((p, n)),
        D,
        dt=dt,
    )


class TestConstruction:
    def test_names_default_and_matrices_are_read_only_copies(self):
        A = np.array([[-1.0]])
        system = StateSpace(A, [[1, 2]], [[3]], [[0, 0]])
        assert system.inputs == ("u1", "u2") and system.outputs == ("y1",) and system.dt is None
        A[0, 0] = 7
        assert system.A[0, 0] == -1
        with pytest.raises(ValueError, match="read-only"):
            system.A[0, 0] = 1.0
        with pytest.raises(FrozenInstanceError):
            system.dt = 1.0
        assert repr(system) == "StateSpace(1 states, 2 inputs, 1 outputs, continuous)"

    def test_scalars_empty_lists_and_static_gains(self):
        assert StateSpace(-1, 2, 3, 0).A.shape == (1, 1)
        assert StateSpace([], [], [], [[1, 2]]).B.shape == (0, 2)
        assert StateSpace(
            np.zeros((0, 0)), np.zeros((0, 2)), np.zeros((3, 0)), np.zeros((3, 2))
        ).C.shape == (3, 0)
        assert static_gain(5.0).D.tolist() == [[5.0]]

    def test_replace_and_pickle(self):
        system = random_system(0, dt=0.1)
        assert replace(system, inputs=("a", "b")).inputs == ("a", "b")
        again = pickle.loads(pickle.dumps(system))
        assert (
            np.array_equal(again.A, system.A)
            and again.outputs == system.outputs
            and again.dt == 0.1
        )

    @pytest.mark.parametrize(
        ("arguments", "message"),
        [
            (([[1, 2]], [[1]], [[1]], [[0]]), "shape of A"),
            ((np.eye(2), [[1]], [[1, 0]], [[0]]), "shape of B"),
            ((np.eye(2), [[1], [0]], [[1]], [[0]]), "shape of C"),
            ((np.eye(2), [1, 0], [[1, 0]], [[0]]), "shape of B"),
            (([], [[1.0]], [], [[0]]), "shape of B"),
            (([], [], [[1.0]], [[0]]), "shape of C"),
            ((np.eye(1), [[1]], [[1]], np.zeros((1, 1, 1))), "shape of D"),
            (([[np.nan]], [[1]], [[1]], [[0]]), r"A\[0, 0\] is nan"),
            (([[1j]], [[1]], [[1]], [[0]]), "matrix A is complex"),
            (([[1]], [[1]], [[1]], [["0"]]), "D is not numeric"),
            (([[1]], [[1]], [[1]], [[0]], ["u", "v"]), "number of inputs names"),
            (([[1]], [[1, 1]], [[1]], [[0, 0]], ["u", "u"]), "repeating u"),
            (([[1]], [[1]], [[1]], [[0]], None, None, -0.1), "dt is -0.1"),
            (([[1]], [[1]], [[1]], [[0]], None, None, True), "dt is True"),
            (([[1]], [[1]], [[1]], [[0]], None, None, np.inf), "dt is inf"),
        ],
    )
    def test_refuses(self, arguments, message):
        with pytest.raises(InvalidInput, match=message):
            StateSpace(*arguments)


class TestMatchSignals:
    def test_the_same_names_in_another_order(self):
        system = rename(random_system(1), ["a", "b"], ["x", "y", "z"])
        turned = select(system, ["b", "a"], ["z", "x", "y"])
        back = match_signals(turned, ["a", "b"], ["x", "y", "z"])
        assert all(
            np.array_equal(getattr(back, letter), getattr(system, letter)) for letter in "ABCD"
        )
        assert (back.inputs, back.outputs) == (system.inputs, system.outputs)

    def test_other_names_go_by_place_each_side_for_itself(self):
        system = rename(random_system(1), ["b", "a"], ["y1", "y2", "y3"])
        back = match_signals(system, ["a", "b"], ["x", "y", "z"])
        assert (back.inputs, back.outputs) == (("a", "b"), ("x", "y", "z"))
        np.testing.assert_array_equal(back.D, system.D[:, ::-1])
        with pytest.raises(InvalidInput, match="number of inputs names"):
            match_signals(system, ["a"], ["x", "y", "z"])


def test_a_system_shows_itself_and_gives_plain_data():
    system = rename(random_system(1, dt=2e-4), ["a", "b"], ["x", "y", "z"])
    assert "<td>sampled, dt = 0.0002 s</td>" in system._repr_html_()
    plain = json.loads(json.dumps(system.to_dict()))
    again = StateSpace(**plain)
    assert all(np.array_equal(getattr(again, letter), getattr(system, letter)) for letter in "ABCD")
    assert (again.inputs, again.outputs, again.dt) == (system.inputs, system.outputs, system.dt)


class TestPythonControl:
    @pytest.mark.parametrize("dt", [None, 2e-4])
    def test_round_trip(self, dt):
        ours = rename(random_system(1, dt=dt), ["a", "b"], ["x", "y", "z"])
        theirs = ours.to_control()
        assert theirs.dt == (dt or 0)
        back = as_statespace(theirs)
        for letter in "ABCD":
            assert np.array_equal(getattr(back, letter), getattr(ours, letter))
        assert (back.inputs, back.outputs, back.dt) == (ours.inputs, ours.outputs, dt)

    def test_every_function_takes_their_systems(self):
        theirs = control.ss([[-1.0]], [[1.0]], [[1.0]], [[0.0]])
        assert poles(feedback(theirs, control.ss([], [], [], [[2.0]]))) == pytest.approx([-3.0])
        assert connect([theirs], ["u[0]"], ["y[0]"]).n_states == 1

    @pytest.mark.parametrize("dt", [None, 2e-4])
    def test_one_argument(self, dt):
        ours = rename(random_system(1, dt=dt), ["a", "b"], ["x", "y", "z"])
        for other in (ours, ours.to_control()):
            back = StateSpace(other)
            assert all(
                np.array_equal(getattr(back, letter), getattr(ours, letter)) for letter in "ABCD"
            )
            assert (back.inputs, back.outputs, back.dt) == (ours.inputs, ours.outputs, dt)
        renamed = StateSpace(ours.to_control(), inputs=["c", "d"], dt=1e-3)
        assert (renamed.inputs, renamed.outputs, renamed.dt) == (("c", "d"), ours.outputs, 1e-3)
        for lacking in ((3,), (np.eye(2), np.eye(2)), ("a string",)):
            with pytest.raises(InvalidInput, match="matrices A, B, C and D, or one system"):
                StateSpace(*lacking)

    def test_other_things(self):
        assert (
            as_statespace(scipy.signal.StateSpace([[-1.0]], [[1.0]], [[1.0]], [[0.0]])).dt is None
        )
        assert as_statespace([[1, 2]]).D.tolist() == [[1.0, 2.0]]
        with pytest.raises(InvalidInput, match="transfer function was given"):
            as_statespace(control.tf([1], [1, 1]))
        with pytest.raises(InvalidInput, match="dt is True"):
            as_statespace(control.ss([[0.5]], [[1.0]], [[1.0]], [[0.0]], True))
        with pytest.raises(
            InvalidInput, match="the system is 'a string', but must be something with matrices"
        ):
            as_statespace("a string")


class TestTransferFunction:
    @pytest.mark.parametrize(
        ("num", "den"),
        [
            ([1], [1, 1]),
            ([2, 0, 3], [4, 1, 1]),
            ([0, 0, 5], [1, 2, 3, 4]),
            ([0], [1, 1]),
            ([3], [2]),
            ([1e9], [1, 1e5, 1e9]),
            ([1, 2, 3], [1e-12, 1e-6, 1, 1e3]),
        ],
    )
    def test_against_polynomials(self, num, den):
        system = transfer_function(num, den, "u", "y")
        assert system.inputs == ("u",) and system.outputs == ("y",)
        same(system, lambda s: np.array([[np.polyval(num, s) / np.polyval(den, s)]]))

    def test_states_are_balanced(self):
        system = transfer_function([1e18], [1, 3e6, 3e12, 1e18])
        assert max(np.abs(system.A).max(), np.abs(system.B).max(), np.abs(system.C).max()) < 1e8

    @pytest.mark.parametrize(
        ("num", "den", "message"),
        [
            ([1, 0], [1], "numerator's order is 1"),
            ([1], [0, 1], "leading denominator"),
            ([1], [], "denominator"),
            ([1j], [1, 1], "numerator"),
            ([[1], [2]], [1, 1], "shape of numerator"),
        ],
    )
    def test_refuses(self, num, den, message):
        with pytest.raises(InvalidInput, match=message):
            transfer_function(num, den)


class TestPoles:
    def test_sorted_and_measured(self):
        system = StateSpace(np.diag([-3.0, -1.0, 2.0]), np.zeros((3, 1)), np.zeros((1, 3)), [[0]])
        assert poles(system).real.tolist() == [-1.0, 2.0, -3.0]
        assert spectral_abscissa(system) == 2.0 and not is_stable(system)
        assert spectral_abscissa(static_gain([[1]])) == -np.inf and is_stable(static_gain([[1]]))

    def test_sampled_abscissa_is_that_of_the_continuous_pole(self):
        sampled = StateSpace([[np.exp(-3 * 0.01)]], [[1]], [[1]], [[0]], dt=0.01)
        assert spectral_abscissa(sampled) == pytest.approx(-3.0, rel=1e-12)
        assert not is_stable(StateSpace([[1.0]], [[1]], [[1]], [[0]], dt=0.01))
        assert is_stable(StateSpace([[0.0]], [[1]], [[1]], [[0]], dt=0.01))


class TestNames:
    def test_select_orders_and_keeps_states(self):
        system = rename(random_system(2), ["a", "b"], ["x", "y", "z"])
        part = select(system, "b", ["z", "x"])
        same(part, lambda s: at(system, s)[np.ix_([2, 0], [1])])
        assert part.n_states == 4 and part.outputs == ("z", "x")
        with pytest.raises(InvalidInput, match="'q' is not a signal of this system; it has a, b"):
            select(system, "q")

    def test_rename_by_mapping(self):
        system = rename(random_system(2), {"u1": "a"}, {"y3": "z"})
        assert system.inputs == ("a", "u2") and system.outputs == ("y1", "y2", "z")
        with pytest.raises(InvalidInput, match="'nobody'"):
            rename(system, {"nobody": "a"})


class TestAlgebra:
    def test_series(self):
        G, H = random_system(3, n=3), random_system(4, n=2, m=3, p=2)
        same(series(G, H), lambda s: at(H, s) @ at(G, s))
        with pytest.raises(InvalidInput, match="output count is 3"):
            series(G, G)

    def test_append(self):
        G, H = (
            rename(random_system(3), ["a", "b"], ["c", "d", "e"]),
            random_system(4, n=0, m=1, p=1),
        )
        both = append(G, H)
        assert both.inputs == ("a", "b", "u1")
        same(both, lambda s: np.block([[at(G, s), np.zeros((3, 1))], [np.zeros((1, 2)), at(H, s)]]))
        with pytest.raises(InvalidInput, match="repeating u1"):
            append(H, H)

    @pytest.mark.parametrize("sign", [-1, 1])
    @pytest.mark.parametrize("static", [False, True])
    def test_feedback(self, sign, static):
        G, K = random_system(6), random_system(7, n=0 if static else 3, m=3, p=2)
        loop = feedback(G, K, sign)
        same(loop, lambda s: np.linalg.solve(np.eye(3) - sign * at(G, s) @ at(K, s), at(G, s)))
        assert (loop.inputs, loop.outputs) == (G.inputs, G.outputs)

    @given(
        seed=st.integers(0, 10**6), n=st.integers(0, 5), m=st.integers(1, 3), p=st.integers(1, 3)
    )
    @settings(max_examples=30, deadline=None)
    def test_feedback_undoes_itself(self, seed, n, m, p):
        G, K = random_system(seed, n, m, p), random_system(seed + 1, 2, p, m, through=False)
        same(feedback(feedback(G, K), K, 1), lambda s: at(G, s), rtol=1e-7)

    def test_feedback_refuses(self):
        with pytest.raises(InvalidInput, match="feedback's size"):
            feedback(random_system(6), random_system(6))
        with pytest.raises(InvalidInput, match="sign is 2"):
            feedback(static_gain(1.0), static_gain(1.0), 2)

    def test_algebraic_loop(self):
        with pytest.raises(NumericalFailure, match="the loop is algebraic"):
            feedback(static_gain([[0.5, 0], [0, 2]]), static_gain([[0, 0], [0, -0.5]]))
        assert feedback(static_gain(2.0), static_gain(-0.4999999)).D[0, 0] == pytest.approx(
            1e7, rel=1e-6
        )

    def test_large_gains_in_a_chain_are_no_algebraic_loop(self):
        """k_s of 1e9 N/m beside unit gains: the matrix I - D L is triangular, however badly
        conditioned it looks.
        """
        chain = append(*(static_gain(1e9, [f"a{i}"], [f"b{i}"]) for i in range(4)))
        closed = close(chain, np.eye(4, k=-1))
        assert closed.D[3, 0] == pytest.approx(1e36, rel=1e-12)

    def test_sample_times(self):
        fast = random_system(8, n=1, m=1, p=1, dt=1e-4)
        assert series(fast, static_gain(2.0)).dt == 1e-4
        assert series(static_gain(2.0), static_gain(2.0)).dt is None
        assert series(fast, replace(fast, dt=1e-4 * (1 + 1e-12))).dt is not None
        with pytest.raises(InvalidInput, match="sample times"):
            series(fast, replace(fast, dt=2e-4))
        with pytest.raises(InvalidInput, match="sample times"):
            series(fast, random_system(8, n=1, m=1, p=1))


class TestConnect:
    def test_first_order_loop_by_hand(self):
        plant = StateSpace([[-1.0]], [[1.0]], [[1.0]], [[0.0]], ["v"], ["y"])
        controller = static_gain(2.0, ["e_y"], ["u"])
        loop = connect(
            [plant, controller],
            ["r", "e", "d"],
            ["y", "u", "meas"],
            {"v": ["u", "e"], "e_y": ["r", "-meas"], "meas": ["y", "d"]},
        )
        assert loop.A.tolist() == [[-3.0]]
        assert loop.B.tolist() == [[2.0, 1.0, -2.0]]
        assert loop.C.tolist() == [[1.0], [-2.0], [1.0]]
        assert loop.D.tolist() == [[0, 0, 0], [2.0, 0, -2.0], [0, 0, 1.0]]

    def test_the_loop_diagram_with_feedthrough(self):
        """core/lft.py's drawing: r, e, d -> y, u, v with random G and K that both feed through."""
        G = rename(random_system(10, m=2, p=3), ["v1", "v2"], ["g1", "g2", "g3"])
        K = rename(random_system(11, n=3, m=3, p=2), ["err1", "err2", "err3"], ["u1", "u2"])
        sums = {f"v{i}": [f"u{i}", f"e{i}"] for i in (1, 2)}
        sums |= {f"y{i}": [f"g{i}", f"d{i}"] for i in (1, 2, 3)} | {
            f"err{i}": [f"r{i}", f"-y{i}"] for i in (1, 2, 3)
        }
        loop = connect(
            [G, K],
            ["r1", "r2", "r3", "e1", "e2", "d1", "d2", "d3"],
            ["y1", "y2", "y3", "u1", "u2", "v1", "v2"],
            sums,
        )

        def by_hand(s):
            g, k = at(G, s), at(K, s)
            S = np.linalg.inv(np.eye(3) + g @ k)
            y = np.hstack([S @ g @ k, S @ g, S])  # y = G v + d, v = K (r - y) + e
            u = np.hstack([k, np.zeros((2, 5))]) - k @ y
            return np.vstack([y, u, u + np.hstack([np.zeros((2, 3)), np.eye(2), np.zeros((2, 3))])])

        same(loop, by_hand)

    def test_a_sum_may_have_the_name_of_an_output(self):
        """Input u of the amplifier = the controller's output u plus e; the OUTPUT u stays the
        controller's.
        """
        amplifier, controller = static_gain(10.0, ["u"], ["i"]), static_gain(3.0, ["r"], ["u"])
        loop = connect([amplifier, controller], ["r", "e"], ["i", "u"], {"u": ["u", "e"]})
        assert loop.D.tolist() == [[30.0, 10.0], [3.0, 0.0]]

    def test_empty_sum_is_zero_and_sums_nest(self):
        gain = static_gain([[1.0, 10.0]], ["a", "b"], ["y"])
        assert connect(
            [gain], ["x"], ["y"], {"a": [], "b": ["-half"], "half": ["x", "x"]}
        ).D.tolist() == [[-20.0]]
        assert connect([gain], ["a", "b"], ["a", "y"]).D.tolist() == [[1, 0], [1, 10]]

    @pytest.mark.parametrize(
        ("inputs", "outputs", "sums", "message"),
        [
            (["a"], ["y"], {}, "'b'"),
            (["a", "b"], ["z"], {}, "'z' is neither a system's output"),
            (["a", "b", "y"], ["y"], {}, "external inputs"),
            (["a", "b"], ["y"], {"typo": ["a"]}, "'typo' is not used"),
            (["a"], ["y"], {"b": ["p"], "p": ["q"], "q": ["-p"]}, "need each other"),
            (["a"], ["y"], {"b": ["nobody"]}, "'nobody' \\(wanted by 'b'\\)"),
            (["a"], ["y"], {"b": ["b"]}, "need each other"),
            (["a", "a"], ["y"], {"b": []}, "repeating a"),
        ],
    )
    def test_refuses(self, inputs, outputs, sums, message):
        with pytest.raises(InvalidInput, match=message):
            connect([static_gain([[1.0, 10.0]], ["a", "b"], ["y"])], inputs, outputs, sums)
