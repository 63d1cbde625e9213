"""Second-order systems against the dynamic stiffness, closed forms and extended precision."""

import numpy as np
import pytest
import scipy.linalg as sla

from ambrose.core import mechanical
from ambrose.core.checks import InvalidInput
from ambrose.core.frequency import frequency_response
from ambrose.core.mechanical import (
    SecondOrder,
    project,
    to_common_statespace,
    to_statespace,
    undamped_modes,
)
from ambrose.core.statespace import poles


def random_system(seed=0, n=4):
    rng = np.random.default_rng(seed)
    V, G = rng.standard_normal((n, n)), rng.standard_normal((n, n))
    return SecondOrder(
        V @ V.T + np.eye(n),
        rng.standard_normal((n, n)),
        G - G.T,
        50 * rng.standard_normal((n, n)),
        rng.standard_normal((n, 2)),
        rng.standard_normal((3, n)),
        rng.standard_normal((1, n)),
        ("f1", "f2"),
        ("q1", "q2", "q3"),
        ("v1",),
    )


def free_beam(nodes, planes=2, length=1.2, diameter=0.06):
    """Mass and stiffness of a free Bernoulli-Euler steel shaft (Hermite elements) in one or two
    planes.
    """
    E = 2.1e11
    rho = 7850.0
    area = np.pi * diameter**2 / 4
    inertia = np.pi * diameter**4 / 64
    h = length / (nodes - 1)
    scale = np.outer([1, h, 1, h], [1, h, 1, h])
    k = (
        E
        * inertia
        / h**3
        * scale
        * np.array([[12, 6, -12, 6], [6, 4, -6, 2], [-12, -6, 12, -6], [6, 2, -6, 4]])
    )
    m = (
        rho
        * area
        * h
        / 420
        * scale
        * np.array([[156, 22, 54, -13], [22, 4, 13, -3], [54, 13, 156, -22], [-13, -3, -22, 4]])
    )
    M, K = np.zeros((2 * nodes, 2 * nodes)), np.zeros((2 * nodes, 2 * nodes))
    for e in range(nodes - 1):
        part = slice(2 * e, 2 * e + 4)
        M[part, part] += m
        K[part, part] += k
    theory = np.array([4.730040745, 7.853204624, 10.99560784]) ** 2 * np.sqrt(
        E * inertia / (rho * area * length**4)
    )
    return sla.block_diag(*[M] * planes), sla.block_diag(*[K] * planes), theory


class TestStateSpace:
    @pytest.mark.parametrize("speed", [0.0, 40.0])
    def test_against_the_dynamic_stiffness(self, speed):
        s = random_system()
        omega = np.linspace(0.5, 20, 9)
        response = frequency_response(to_statespace(s, speed), omega)
        assert (response.inputs, response.outputs) == (("f1", "f2"), ("q1", "q2", "q3", "v1"))
        for w, value in zip(omega, response.values, strict=True):
            Z = -(w**2) * s.mass + 1j * w * (s.damping + speed * s.gyroscopic) + s.stiffness
            q = np.linalg.solve(Z, s.B)
            np.testing.assert_allclose(value, np.vstack([s.C @ q, 1j * w * s.Cv @ q]), rtol=1e-10)

    def test_spinning_disc_by_hand(self):
        """J q'' + Omega J_p [[0, 1], [-1, 0]] q' + k q = 0: whirl frequencies -+ g/2 + sqrt((g/2)^2
        + k/J), g = Omega J_p/J.
        """
        J = 2.0
        Jp = 3.0
        k = 800.0
        speed = 30.0
        system = SecondOrder(
            J * np.eye(2),
            np.zeros((2, 2)),
            Jp * np.array([[0, 1], [-1, 0]]),
            k * np.eye(2),
            np.eye(2),
            np.eye(2),
            np.zeros((0, 2)),
            ("a", "b"),
            ("x", "y"),
        )
        g = speed * Jp / J
        expected = np.sqrt(g**2 / 4 + k / J) + np.array([-g / 2, g / 2])
        found = np.sort(poles(to_statespace(system, speed)).imag)[2:]
        np.testing.assert_allclose(found, expected, rtol=1e-12)

    def test_rigid_poles_of_a_stiff_rotor_keep_six_digits_behind_the_point(self):
        """In physical coordinates M^-1 K has the norm 1e14; the rigid poles on negative springs: a
        few hundred rad/s.
        """
        M, K, _ = free_beam(40)
        springs = np.zeros(len(M))
        springs[[4, 70, 84, 150]] = -4.0e5
        K = K + np.diag(springs)
        assert np.linalg.norm(np.linalg.solve(M, K), 2) > 1e14
        n = len(M)
        zero = np.zeros((n, n))
        system = SecondOrder(
            M, zero, zero, K, np.eye(n, 1), np.eye(1, n), np.zeros((0, n)), ("f",), ("q",)
        )
        found = poles(to_statespace(system))
        rigid = np.sort(found[np.abs(found) < 600].real)
        # oracle: Rayleigh quotients of refined vectors, in extended precision
        vectors = sla.eigh(K, M, subset_by_index=[0, 3])[1]
        vectors = vectors @ sla.eigh(vectors.T @ K @ vectors, vectors.T @ M @ vectors)[1]
        for _ in range(3):
            vectors = np.linalg.solve(K - 1e3 * M, M @ vectors)
            vectors = vectors @ sla.eigh(vectors.T @ K @ vectors, vectors.T @ M @ vectors)[1]
        wide = vectors.astype(np.longdouble)
        squares = np.array([-(v @ K @ v) / (v @ M @ v) for v in wide.T], dtype=float)
        expected = np.sort(np.concatenate([np.sqrt(squares), -np.sqrt(squares)]))
        assert len(rigid) == 8 and squares.min() > 1e4
        np.testing.assert_allclose(rigid, expected, atol=1e-6)
        # double poles split by the root of rounding at most
        assert np.abs(found[np.abs(found) < 600].imag).max() < 1e-3

    def test_project_on_a_full_basis_changes_nothing(self):
        s = random_system(3)
        T = np.random.default_rng(4).standard_normal((4, 4))
        omega = [0.3, 4.0]
        before = frequency_response(to_statespace(s, 10.0), omega).values
        np.testing.assert_allclose(
            frequency_response(to_statespace(project(s, T), 10.0), omega).values, before, rtol=1e-9
        )
        assert project(s, T[:, :2]).n == 2

    @pytest.mark.parametrize(
        ("change", "message"),
        [
            ({"mass": np.eye(3)}, "shape of mass|shape of damping"),
            ({"stiffness": np.ones((4, 3))}, "shape of stiffness"),
            ({"B": np.ones((4, 3))}, "shape of B"),
            ({"C": np.ones((2, 4))}, "shape of C"),
            ({"Cv": np.ones((1, 3))}, "shape of Cv"),
            ({"gyroscopic": np.ones((4, 4))}, "gyroscopic is not skew"),
            ({"mass": np.eye(4) + np.eye(4, k=1)}, "mass matrix is not symmetric"),
            ({"damping": np.full((4, 4), np.nan)}, r"damping\[0, 0\] is nan"),
            ({"mass": 3.0}, "shape of mass"),
        ],
    )
    def test_refuses(self, change, message):
        s = random_system()
        names = (
            "mass",
            "damping",
            "gyroscopic",
            "stiffness",
            "B",
            "C",
            "Cv",
            "inputs",
            "outputs",
            "velocity_outputs",
        )
        with pytest.raises(InvalidInput, match=message):
            SecondOrder(**{name: getattr(s, name) for name in names} | change)

    def test_refuses_a_massless_coordinate_and_a_wild_speed(self):
        s = SecondOrder(
            np.diag([1.0, 0.0]),
            *[np.zeros((2, 2))] * 3,
            np.eye(2),
            np.eye(2),
            np.zeros((0, 2)),
            ("a", "b"),
            ("x", "y"),
        )
        with pytest.raises(InvalidInput, match="mass matrix is not positive definite"):
            to_statespace(s)
        with pytest.raises(InvalidInput, match="speed is nan"):
            to_statespace(random_system(), np.nan)

    def test_lists_will_do(self):
        s = SecondOrder([[2]], [[0]], [[0]], [[8]], [[1]], [[1]], np.zeros((0, 1)), ("f",), ("q",))
        assert poles(to_statespace(s)).imag == pytest.approx([-2.0, 2.0])


class TestUndampedModes:
    @pytest.mark.parametrize("nodes", [20, 80])
    @pytest.mark.parametrize("path", ["dense", "sparse"])
    def test_free_shaft(self, nodes, path, monkeypatch):
        """Four rigid modes that are zero exactly, then pairs of equal bending modes at the textbook
        frequencies.
        """
        monkeypatch.setattr(mechanical, "_DENSE_LIMIT", 10**6 if path == "dense" else 0)
        M, K, theory = free_beam(nodes)
        count = 10 if nodes > 20 else 4 + 2 * path.count("dense")
        omega, shapes = undamped_modes(M, K, count)
        assert omega[:4].tolist() == [0.0] * 4
        np.testing.assert_allclose(
            omega[4:], np.repeat(theory, 2)[: count - 4], rtol=1e-4 if nodes < 80 else 1e-6
        )
        np.testing.assert_allclose(shapes.T @ M @ shapes, np.eye(count), atol=1e-12)

    def test_sparse_equals_dense(self, monkeypatch):
        M, K, _ = free_beam(90)
        dense = sla.eigh(K, M, subset_by_index=[0, 15])
        monkeypatch.setattr(mechanical, "_DENSE_LIMIT", 0)
        called = []
        original = mechanical._subspace_iteration
        monkeypatch.setattr(
            mechanical, "_subspace_iteration", lambda *a: called.append(original(*a)) or called[-1]
        )
        omega, shapes = undamped_modes(M, K, 16)
        # the iteration converged; nothing fell back to the dense solver
        assert called[0] is not None
        np.testing.assert_allclose(omega[4:], np.sqrt(dense[0][4:]), rtol=1e-7)
        np.testing.assert_allclose(np.sin(sla.subspace_angles(shapes, dense[1])), 0, atol=1e-6)

    def test_only_rigid_modes_asked_for(self):
        """The threshold for zero must not come from the modes asked for, which are all zero
        here.
        """
        M, K, _ = free_beam(100)
        assert undamped_modes(M, K, 4)[0].tolist() == [0.0] * 4
        assert undamped_modes(M, K, 1)[0].tolist() == [0.0]

    def test_soft_suspension_is_not_taken_for_rigid(self):
        M, K, _ = free_beam(40, planes=1)
        soft = np.zeros(len(M))
        soft[[0, -2]] = 10.0  # N/m at both ends, under 22 kg or so: bounce well below 1 Hz
        omega, _ = undamped_modes(M, K + np.diag(soft), 3)
        mass = np.ones(len(M)) * (np.arange(len(M)) % 2 == 0) @ M @ (np.arange(len(M)) % 2 == 0)
        assert omega[0] == pytest.approx(np.sqrt(20.0 / mass), rel=1e-4)
        # rod rocking on its ends
        assert omega[1] == pytest.approx(np.sqrt(3 * 20.0 / mass), rel=1e-4)

    def test_two_masses_by_hand(self):
        omega, shapes = undamped_modes(np.diag([1.0, 2.0]), np.array([[6.0, -6.0], [-6.0, 6.0]]), 2)
        assert omega[0] == 0.0 and omega[1] == pytest.approx(3.0, rel=1e-14)
        assert np.abs(shapes[:, 0]) == pytest.approx(np.full(2, 1 / np.sqrt(3)))

    @pytest.mark.parametrize(
        ("mass", "stiffness", "count", "message"),
        [
            (np.eye(2), np.diag([1.0, -2.0]), 1, "negative mode"),
            (np.eye(2), np.eye(2), 3, "number of modes is 3"),
            (np.eye(2), np.eye(2), 0, "number of modes is 0"),
            (np.diag([1.0, -1.0]), np.eye(2), 1, "mass matrix is not positive"),
            (np.eye(2), np.array([[1.0, 2.0], [0, 1.0]]), 1, "stiffness matrix is not symmetric"),
            (np.eye(2), np.eye(3), 1, "shape of stiffness"),
            (np.eye(2), np.diag([np.inf, 1]), 1, "inf"),
        ],
    )
    def test_refuses(self, mass, stiffness, count, message):
        with pytest.raises(InvalidInput, match=message):
            undamped_modes(mass, stiffness, count)


def test_common_states_answer_like_the_scaled_ones_and_mean_the_same_for_other_matrices():
    rng = np.random.default_rng(4)
    n = 4
    M, K = (X @ X.T + n * np.eye(n) for X in rng.standard_normal((2, n, n)))
    G = rng.standard_normal((n, n))
    B, C = rng.standard_normal((n, 2)), rng.standard_normal((3, n))
    scales = np.array([1.0, 2.0, 5.0, 30.0])

    def system(stiffness):
        return SecondOrder(
            M, 0.1 * K, G - G.T, stiffness, B, C, C[:1], ("f1", "f2"), ("a", "b", "c"), ("va",)
        )

    first, second = to_statespace(system(K), 3.0), to_common_statespace(system(K), 3.0, scales)
    for s in (0.5j, 2j, 1 + 3j):
        values = [
            x.C @ np.linalg.solve(s * np.eye(2 * n) - x.A, x.B) + x.D for x in (first, second)
        ]
        np.testing.assert_allclose(values[0], values[1], rtol=1e-10)
    other = to_common_statespace(system(K - 40 * np.eye(n)), -2.0, scales)
    np.testing.assert_array_equal(other.C, second.C)
    np.testing.assert_array_equal(other.A[:n], second.A[:n])
