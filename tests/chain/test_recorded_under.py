"""Commissioning records the machine under a controller that holds it as the loop runs.

The turboexpander's PID was designed for a continuous loop and loses the rotor at the 10 kHz of the
rig; its study took it all the same, the record diverged, and nothing was commissioned.
"""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import expm

from ambrose import design, load_machine
from ambrose.chain.commissioning import as_recorded, commission, reference
from ambrose.core.checks import InvalidInput
from ambrose.core.statespace import select
from ambrose.judge.checks import Checks
from ambrose.judge.plants import full_plants
from ambrose.rig.trial import Candidate

T = 1e-4  # s, what the rig takes where no file says it


@pytest.fixture(scope="module")
def plant():
    return full_plants(load_machine("turboexpander"))[0]


@pytest.fixture(scope="module")
def made(plant):
    """Two controllers that are quickly designed: one is lost at 10 kHz, the other is not."""
    return [
        Candidate(name, design(plant, method), (Checks(plant.point.label, True, ()),))
        for name, method in (("PID", "pid"), ("H-infinity", "hinf"))
    ]


def growth(plant, synthesis):
    """The largest ln|z|/T of the loop: the plant held, the law by Tustin's map, one sample late."""
    law, system = synthesis.controller, select(plant.system, plant.named("u"), plant.named("y"))
    n, m = system.B.shape
    held = expm(T * np.block([[system.A, system.B], [np.zeros((m, n + m))]]))[:n]
    left = np.eye(len(law.A)) - T / 2 * law.A
    A = np.linalg.solve(left, np.eye(len(law.A)) + T / 2 * law.A)
    B = np.linalg.solve(left, T * law.B)
    C = np.linalg.solve(left.T, law.C.T).T
    D = law.D + T / 2 * C @ law.B
    # x+ = Ad x + Bd u,  w+ = A w - B C_p x,  u+ = C w - D C_p x
    y = system.C
    loop = np.block(
        [
            [held[:, :n], np.zeros((n, len(A))), held[:, n:]],
            [-B @ y, A, np.zeros((len(A), m))],
            [-D @ y, C, np.zeros((m, m))],
        ]
    )
    return np.log(np.abs(np.linalg.eigvals(loop)).max()) / T


def test_the_judge_is_asked_of_the_loop_that_is_recorded(plant, made):
    """The poles of the same loop put together by hand: the PID's grow, the other's do not."""
    for candidate, sign in zip(made, (1, -1), strict=True):
        held = as_recorded(plant, candidate.synthesis)
        assert held.abscissa == pytest.approx(growth(plant, candidate.synthesis), rel=1e-4)
        assert np.sign(held.abscissa) == sign


def test_one_that_holds_is_taken_in_place_of_the_pid(plant, made):
    chosen = reference(plant, made)
    assert chosen.candidate is made[1]
    assert chosen.words.startswith("H-infinity, because PID (+")
    assert "does not stabilise the machine at 140 Hz (P3), sampled at 10000 Hz" in chosen.words


def test_nothing_is_chosen_before_it_is_certain(plant, made):
    """The PID does not hold, so that the tuned one is waited for, then all others."""
    assert reference(plant, made[:1], ["tuned", "hinf"]) is None
    assert reference(plant, made[:1], ["hinf"]) is None
    rig = full_plants(load_machine("seal-rig"))[0]
    pid = Candidate("PID", design(rig, "pid"), (Checks("p", True, ()),))
    chosen = reference(rig, [pid], ["tuned", "hinf"])
    assert chosen.candidate is pid and not chosen.words


def test_where_none_holds_cause_and_remedy_are_said(plant, made, tmp_path):
    none = reference(plant, made[:1])
    assert none.candidate is None
    assert "PID (+" in none.words and "state [controller] sample_time" in none.words
    with pytest.raises(InvalidInput, match=r"sampled at 10000 Hz.*give one that does"):
        commission((plant,), made[0].synthesis, tmp_path / "none", lambda text: None)
    assert not (tmp_path / "none").exists()
