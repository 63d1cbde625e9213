"""Tuning of the control weight: on syntheses whose gain is known as a function of the weight, and
with H-infinity.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from benchmarks.published_p5 import (
    published_p5,
    published_p5_data,
    published_p5_pid,
    published_p5_weights,
)

from ambrose.core.checks import InvalidInput, NumericalFailure
from ambrose.core.lft import GeneralizedPlant
from ambrose.core.statespace import StateSpace, static_gain
from ambrose.judge.result import Certificate, Synthesis
from ambrose.law.pid import axes_controller
from ambrose.synthesis.hinf import direct_gain_mismatch, tune_control_weight

AXES = tuple(published_p5_data()["axes"])
REFERENCE = static_gain(np.diag([2.0, 2.0, 3.0, 3.0]))
LEVEL = 0.315


def fake(gain_of_level, calls=None, fails_above=np.inf):
    """A synthesis that returns gain_of_level(W_u) times REFERENCE; W_u is read from the problem's
    z2/u feedthrough.
    """

    def synthesize(problem: GeneralizedPlant) -> Synthesis:
        row, column = (
            problem.system.outputs.index("z2_A_zeta"),
            problem.system.inputs.index("u_A_zeta"),
        )
        level = float(problem.system.D[row, column])
        if calls is not None:
            calls.append(level)
        if level > fails_above:
            raise NumericalFailure("no controller; try another weight")
        controller = static_gain(gain_of_level(level) * REFERENCE.D)
        return Synthesis(controller, "fake", 1.0, "verified", Certificate(True, -1.0, 1.0, 0.0))

    return synthesize


def tune(synthesize, **options):
    return tune_control_weight(
        published_p5(), published_p5_weights(), REFERENCE, synthesize, **options
    )


@pytest.mark.parametrize(
    ("gain", "solution"),
    [
        (lambda level: 0.63 / level, 0.63),
        (lambda level: (0.02 / level) ** 2, 0.02),
        (lambda level: (5.0 / level) ** 0.3, 5.0),
        (lambda level: 3.0 / (1 + (level / 0.1) ** 3), 0.1 * 2 ** (1 / 3)),
    ],
    ids=["inverse", "steep", "flat", "saturating"],
)
def test_finds_the_level_at_which_the_gains_agree(gain, solution):
    calls: list[float] = []
    found = tune(fake(gain, calls), tolerance=1e-3)
    assert found.converged
    assert abs(found.mismatch) <= 1e-3
    assert np.log(gain(found.weights.control.D[0, 0])) == pytest.approx(found.mismatch, abs=1e-9)
    assert found.weights.control.D[0, 0] == pytest.approx(solution, rel=0.01)
    assert found.factor == pytest.approx(found.weights.control.D[0, 0] / LEVEL)
    assert calls[0] == pytest.approx(LEVEL)
    assert len(calls) == len(found.history) <= 10


def test_stops_at_once_when_the_gains_agree():
    calls: list[float] = []
    assert tune(fake(lambda level: 1.0, calls)).factor == 1.0
    assert len(calls) == 1


def test_says_when_the_gains_cannot_be_matched():
    """A gain that stays 20 % low whatever the weight: the nearest is returned, marked, within the
    allowed syntheses.
    """
    found = tune(fake(lambda level: 0.8 / (1 + level)), max_syntheses=6)
    assert not found.converged
    assert found.mismatch == max(row["mismatch"] for row in found.history) < np.log(0.8)
    assert len(found.history) == 6


def test_retries_nearer_after_a_failed_synthesis():
    found = tune(fake(lambda level: 0.6 / level, fails_above=0.61))
    assert found.converged
    assert found.weights.control.D[0, 0] == pytest.approx(0.6, rel=0.021)


def test_failure_of_the_first_synthesis_is_not_hidden():
    with pytest.raises(NumericalFailure, match="no controller"):
        tune(fake(lambda level: 1.0, fails_above=0.1))


@dataclass(frozen=True)
class Halted:
    """A design that has swallowed the interruption, as D-K iteration does: it keeps its best."""

    certified: Synthesis
    interrupted: bool = True

    @property
    def controller(self):
        return self.certified.controller


@pytest.mark.parametrize("swallowed", [True, False])
def test_ctrl_c_keeps_the_nearest_controller(swallowed):
    """Of the trials so far, that of the design that was interrupted included where it has one."""
    calls: list[float] = []
    through = fake(lambda level: 0.5 / level, calls)

    def synthesize(problem):
        if len(calls) < 1:
            return through(problem)
        if swallowed:
            return Halted(through(problem))
        raise KeyboardInterrupt

    found = tune(synthesize, tolerance=1e-6)
    assert len(found.history) == 1 + swallowed and not found.converged
    assert found.synthesis.stopped_early == "the search for its control weight was interrupted"
    assert abs(found.mismatch) == min(abs(row["mismatch"]) for row in found.history)


def test_ctrl_c_before_any_controller_ends_it():
    def synthesize(problem):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        tune(synthesize)


def test_mismatch_of_a_first_order_lag():
    """ln|1/(1 + jw/p)| has a mean and a mean square that the grid must give; axes count alike,
    cross terms not at all.
    """
    high, pole = 400.0, 80.0
    lag = StateSpace(-pole * np.eye(2), pole * np.eye(2), [[2.0, 0], [0.5, 1.0]], np.zeros((2, 2)))
    omega = np.geomspace(high / 200, high, 60)
    expected = -0.5 * np.log1p((omega / pole) ** 2)
    mean, spread = direct_gain_mismatch(lag, static_gain(np.diag([2.0, 1.0])), (0.0, high))
    assert mean == pytest.approx(expected.mean(), rel=1e-9)
    assert spread == pytest.approx(np.sqrt((expected**2).mean()), rel=1e-9)


def test_mismatch_of_scaled_pid_controllers():
    controllers = [axes_controller(published_p5_pid(gain), AXES) for gain in (18000.0, 36000.0)]
    assert direct_gain_mismatch(controllers[1], controllers[0]) == pytest.approx(
        (np.log(2), np.log(2))
    )


def test_refusals():
    with pytest.raises(InvalidInput, match="without direct gain"):
        direct_gain_mismatch(static_gain(np.eye(2)), static_gain([[0.0, 1.0], [1.0, 0.0]]))
    with pytest.raises(InvalidInput, match="the controller's size"):
        direct_gain_mismatch(static_gain(np.eye(2)), static_gain(np.eye(4)))
    with pytest.raises(InvalidInput, match="band"):
        direct_gain_mismatch(static_gain(np.eye(2)), static_gain(np.eye(2)), (3.0, 1.0))
