"""Assumptions of H-infinity synthesis: each violated by construction, named in the message, mended
and announced.
"""

from __future__ import annotations

import numpy as np
import pytest

from ambrose.core.checks import InvalidInput
from ambrose.core.hinf_riccati import check_assumptions, normal_form, scale_plant, try_gamma
from ambrose.core.lft import GeneralizedPlant
from ambrose.core.statespace import StateSpace
from ambrose.synthesis.hinf import hinf_synthesis
from random_plants import KINDS, random_plant


def parted(A, B, C, D, m, p) -> GeneralizedPlant:
    s = StateSpace(A, B, C, D)
    return GeneralizedPlant(s, s.inputs[:-m], s.inputs[-m:], s.outputs[:-p], s.outputs[-p:])


def with_mode(block, B_u, C_y, scale: float, hide: bool = True) -> GeneralizedPlant:
    """A regular plant with one more mode ``block`` that w does not reach and z does not show; u and
    y as given.

    Rotated by an orthogonal matrix, then the states scaled by up to ``scale`` either way.
    """
    rng = np.random.default_rng(7)
    k = len(block)
    A = np.block(
        [[np.diag([-1.0, -2.0, -3.0]), np.zeros((3, k))], [np.zeros((k, 3)), np.array(block)]]
    )
    B, C = rng.standard_normal((3, 4)), rng.standard_normal((4, 3))
    B = np.vstack([B, np.hstack([np.zeros((k, 3)), np.reshape(B_u, (k, 1))])])
    C = np.hstack([C, np.vstack([np.zeros((3, k)), np.reshape(C_y, (1, k))])])
    D = rng.standard_normal((4, 4))
    Q = np.linalg.qr(rng.standard_normal(A.shape))[0] if hide else np.eye(len(A))
    t = 10 ** rng.uniform(-np.log10(scale), np.log10(scale), len(A))
    return parted(Q @ A @ Q.T * t / t[:, None], Q @ B / t[:, None], C @ Q.T * t, D, 1, 1)


OSCILLATOR = [[0.0, 2.0], [-2.0, 0.0]]


@pytest.mark.parametrize("scale", [1.0, 1e3])
@pytest.mark.parametrize(
    ("block", "text"),
    [
        ([[0.5]], "s = 0.5 rad/s is unstable"),
        ([[0.1, 3.0], [-3.0, 0.1]], r"s = 0.1 \+ 3j rad/s is unstable"),
    ],
)
def test_unreachable_and_hidden_unstable_modes_are_named(block, text, scale):
    k = len(block)
    with pytest.raises(
        InvalidInput,
        match=rf"\(A, B2\) is not stabilisable: the mode {text} and no control u reaches it",
    ):
        hinf_synthesis(with_mode(block, np.zeros(k), np.ones(k), scale))
    with pytest.raises(
        InvalidInput,
        match=rf"\(C2, A\) is not detectable: the mode {text} and no measurement y shows it",
    ):
        hinf_synthesis(with_mode(block, np.ones(k), np.zeros(k), scale))


def test_integrating_weight_is_named_with_its_remedy():
    """W_p = 1/s on the error of a stable plant: y does not show its state; a slow pole instead is
    accepted.
    """

    def problem(slow: float) -> GeneralizedPlant:
        A = [[-1.0, 0.0], [-1.0, -slow]]
        return parted(
            A,
            [[1, 0, 1], [0, 1, 0]],
            [[0, 1], [0, 0], [-1, 0]],
            [[0, 0, 0], [0, 0, 1], [0, 1, 0]],
            1,
            1,
        )

    with pytest.raises(
        InvalidInput,
        match=r"mode s = -?0 rad/s is on the imaginary axis .* slow pole instead of an integrator",
    ):
        hinf_synthesis(problem(0.0))
    for slow in (1e-2, 1e-5, 1e-8):
        assert hinf_synthesis(problem(slow)).status == "verified"


@pytest.mark.parametrize(
    ("column", "row", "words"),
    [
        (True, False, ["D12 has not full column rank"]),
        (False, True, ["D21 has not full row rank"]),
        (True, True, ["D12 has not full column rank", "D21 has not full row rank"]),
    ],
)
def test_rank_is_mended_and_announced(column, row, words):
    A, B, C, D, m, p = random_plant("stable", 9)
    D[:-p, -1] *= not column
    D[-1, :-m] *= not row
    lines: list[str] = []
    result = hinf_synthesis(parted(A, B, C, D, m, p), progress=lines.append)
    epsilon = result.certificate.margins["epsilon"]
    assert 0 < epsilon <= 1e-2
    assert [note.split(" (")[0] for note in result.notes[: len(words)]] == words
    assert all(f"epsilon = {epsilon:g}" in note for note in result.notes[: len(words)])
    assert all(any(line.startswith(word) for line in lines) for word in words)
    assert {row["epsilon"] for row in result.history} >= {1e-2, epsilon}


def test_axis_zeros_are_found_at_their_frequency():
    """A mode at +-2j that w does not reach and z does not show is a zero of P12 and P21 there."""
    for scale in (1.0, 1e3):
        found = check_assumptions(scale_plant(with_mode(OSCILLATOR, [1.0, 0.5], [0.3, 1.0], scale)))
        assert [text.split(";")[0] for text in found.findings] == [
            "P12 has a zero on the imaginary axis, w = 2 rad/s",
            "P21 has a zero on the imaginary axis, w = 2 rad/s",
        ]
    result = hinf_synthesis(with_mode(OSCILLATOR, [1.0, 0.5], [0.3, 1.0], 1.0))
    assert result.status == "verified"
    assert "w = 2 rad/s" in result.notes[0]


@pytest.mark.parametrize("coupling", [1e-3, 1e-8])
def test_weakly_reached_modes_are_not_refused(coupling):
    """The same modes, reached and shown a little: regular, whatever gamma that costs."""
    for block in ([[0.5]], OSCILLATOR):
        weak = [coupling] * len(block)
        assert (
            check_assumptions(
                scale_plant(with_mode(block, weak, weak, 1.0, hide=False))
            ).rows.shape[0]
            <= 2
        )


@pytest.mark.parametrize("kind", [k for k in KINDS if k != "singular"])
def test_no_false_alarm(kind):
    """None of 40 plants of any regular kind is found wanting, slow weight poles and 1e-9 .. 1e9
    units included.
    """
    for seed in range(40):
        assert check_assumptions(scale_plant(parted(*random_plant(kind, seed)))).findings == ()


def test_extension_only_adds():
    """Mending outputs and inputs can only raise what a controller achieves: rho(X Y) at one gamma
    grows with epsilon.
    """
    scaled = scale_plant(parted(*random_plant("stable", 3)))
    n = len(scaled.A)
    m = scaled.B2.shape[1]
    p = len(scaled.C2)
    rho = [
        try_gamma(
            normal_form(scaled.extended(np.eye(n + m), np.eye(n + p), epsilon))[0], np.inf
        ).rho
        for epsilon in (0.0, 0.01, 0.1, 1.0)
    ]
    assert rho == sorted(rho)
    assert rho[-1] > 1.1 * rho[0]


def wide(seed: int, hidden: bool) -> GeneralizedPlant:
    """x' = A x + b u with poles 0, 3 and -1 to -2e8 rad/s in hidden states of any scale; ``hidden``:
    without a part of u in the mode of 3 rad/s.

    The fast states' input is 1e12 times that of the slow ones, and u in units from 1e-10 to 1e10.
    """
    rng = np.random.default_rng(seed)
    poles = np.array([0.0, 3.0, -1.0, -40.0, -(10 ** rng.uniform(5, 8.3))])
    b = np.array([1.0, 0.0 if hidden else rng.uniform(0.5, 2.0), 1.0, 1.0, -poles[-1] * 1e5])
    # slow states in hidden combinations, the fast one coupled into them
    Q = np.linalg.qr(rng.standard_normal((4, 4)))[0]
    T = np.block([[Q, rng.uniform(-1e-9, 1e-9, (4, 1))], [np.zeros((1, 4)), np.ones((1, 1))]])
    t = 10 ** rng.uniform(-6, 6, 5)
    A = T * poles @ np.linalg.inv(T) / t[:, None] * t
    B = np.c_[rng.standard_normal((5, 1)), np.zeros(5), T @ b * 10 ** rng.uniform(-10, 10)]
    C = np.vstack([rng.standard_normal((1, 5)) * t, np.zeros((1, 5)), T.sum(0) * t])
    D = np.array([[0.0, 0, 0], [0, 0, 1], [0, 1, 0]])
    return parted(A, B / t[:, None], C, D, 1, 1)


@pytest.mark.parametrize("seed", range(6))
def test_reach_is_told_mode_by_mode_whatever_the_scales(seed):
    """One smallest singular value for all modes: the fast rows decided, and a plant that had just
    been stabilised was refused.
    """
    check_assumptions(scale_plant(wide(seed, hidden=False)))
    with pytest.raises(InvalidInput, match=r"not stabilisable: the mode s = 3 rad/s is unstable"):
        check_assumptions(scale_plant(wide(seed, hidden=True)))


def test_two_equal_modes_need_two_controls():
    """Both axes of a rotor: the same poles twice, each reached by its own magnet."""
    A = np.kron(np.eye(2), [[0.0, 1.0], [9.0, 0.0]])
    B = np.kron(np.eye(2), [[0.0], [1.0]])
    C = np.kron(np.eye(2), [[1.0, 0.0]])

    def plant(B):
        m = B.shape[1]
        D = np.block(
            [
                [np.zeros((2, 6)), np.zeros((2, m))],
                [np.zeros((m, 6)), np.eye(m)],
                [np.zeros((2, 4)), np.eye(2), np.zeros((2, m))],
            ]
        )
        whole = np.hstack([np.eye(4), np.zeros((4, 2)), B])
        return parted(A, whole, np.vstack([C, np.zeros((m, 4)), C]), D, m, 2)

    check_assumptions(scale_plant(plant(B)))
    for one in (B[:, :1], B.sum(1, keepdims=True)):
        with pytest.raises(InvalidInput, match="not stabilisable: the mode s = 3 rad/s is unst"):
            check_assumptions(scale_plant(plant(one)))
