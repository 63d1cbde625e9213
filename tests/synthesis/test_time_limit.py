"""The time limit counts computing, not waiting; a synthesis that ended early says so wherever its
result is shown.
"""

from __future__ import annotations

import time
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from click.testing import CliRunner

from ambrose import load_machine
from ambrose.cli import main
from ambrose.core.checks import InvalidInput
from ambrose.core.lft import FullBlock, GeneralizedPlant
from ambrose.core.processes import REMEDY, TimeLimit
from ambrose.core.statespace import StateSpace
from ambrose.judge.result import pid_synthesis
from ambrose.model.assemble import assemble
from ambrose.synthesis import design, mu
from ambrose.synthesis.fixed_order import polish
from ambrose.synthesis.mu import mu_synthesis


@pytest.fixture
def skipped(monkeypatch):
    """Both clocks, which stand until a test puts them forward: {"computed": s, "wall": s}."""
    ahead = {"computed": 0.0, "wall": 0.0}
    monkeypatch.setattr(time, "thread_time", lambda: ahead["computed"])
    monkeypatch.setattr(time, "monotonic", lambda: ahead["wall"])
    return ahead


def test_waiting_does_not_count_but_five_times_the_limit_is_the_end(skipped):
    clock = TimeLimit(1e4)
    skipped["wall"] += 4.5e4
    assert (clock.left, clock.elapsed) == (5e3, 4.5e4)
    skipped["wall"] += 0.5e4
    assert clock.left <= 0 and "5 times the time limit of 10000 s" in clock.reached


def test_computing_counts(skipped):
    clock = TimeLimit(1e4)
    skipped["computed"] += 9e3
    assert clock.left == 1e3
    skipped["computed"] += 1e3
    assert clock.left <= 0 and clock.reached == f"the time limit of 10000 s was reached; {REMEDY}"


def test_computing_of_other_threads_does_not_count():
    """As a linear algebra library on many cores has them, or a server."""
    import threading

    clock = TimeLimit(1000.0)
    before = clock.left
    other = threading.Thread(
        target=lambda: np.linalg.eigvals(np.random.default_rng(0).standard_normal((200, 200)))
    )
    other.start()
    other.join()
    assert before - clock.left < 0.02


def test_a_limit_must_be_positive():
    with pytest.raises(InvalidInput, match=r"time_limit is 0\.0, but must be positive"):
        TimeLimit(0.0)


def problem() -> GeneralizedPlant:
    """An integrator-like plant with a gain that is uncertain by 30 %, and its error and input."""
    A, B = [[-0.1, 1.0], [0.0, -2.0]], [[0.0, 1.0, 0.0], [1.0, 0.0, 1.0]]
    C = [[0.0, 0.0], [1.0, 0.0], [0.0, 0.0], [-1.0, 0.0]]
    D = [[0.0, 0.0, 0.3], [0.0, 1.0, 0.0], [0.0, 0.0, 0.1], [0.0, -1.0, 0.0]]
    system = StateSpace(A, B, C, D, ["w", "r", "u"], ["z", "e", "v", "y"])
    return GeneralizedPlant(
        system, ["w", "r"], ["u"], ["z", "e", "v"], ["y"], [FullBlock("gain", 1, 1)]
    )


def test_mu_on_a_busy_machine_returns_what_it_returns_on_an_idle_one(skipped):
    """A wait of most of the limit at every line of progress; before, the iteration ended after its
    first controller.
    """

    def wait(text: str) -> None:
        skipped["wall"] += 15.0

    idle = mu_synthesis(problem(), iterations=1, time_limit=20.0)
    busy = mu_synthesis(problem(), iterations=1, time_limit=20.0, progress=wait)
    assert skipped["wall"] > 20.0
    assert busy.status == idle.status == "verified"
    assert len(busy.history) == len(idle.history) == 2
    np.testing.assert_array_equal(busy.controller.A, idle.controller.A)
    skipped["wall"] = 0.0
    # the outer guard, at 25 s
    late = mu_synthesis(problem(), iterations=4, time_limit=5.0, progress=wait)
    assert (
        "5 times the time limit of 5 s passed" in late.stopped_early and late.status == "verified"
    )


def stopped(result):
    return replace(
        result,
        stopped_early="after iteration 1, the time limit of 120 s was reached; take fewer states",
    )


def test_the_title_of_ambrose_synthesize_says_it_and_the_exit_status_stays(monkeypatch, tmp_path):
    monkeypatch.setattr(
        design,
        "design",
        lambda plant, method, **_: stopped(replace(pid_synthesis(plant), method=method.name)),
    )
    done = CliRunner().invoke(
        main, ["synthesize", "seal-rig", "--method", "mu", "-o", str(tmp_path / "c.json")]
    )
    assert done.exit_code == 0, done.stderr
    title = done.stdout.split("┏")[0]
    assert (
        "mu controller, STOPPED EARLY: verified, but stopped early: after iteration 1"
        in " ".join(title.split())
    )


def test_a_polished_controller_says_how_its_start_ended(monkeypatch):
    """Polishing hid it: only its own status was left."""
    plant = assemble(load_machine("seal-rig"))
    held = pid_synthesis(plant)
    ended = stopped(held)
    begun = SimpleNamespace(controller=held.controller, interrupted=False, certified=ended)
    monkeypatch.setattr(mu, "mu_iterates", lambda model, **_: begun)
    monkeypatch.setattr(polish, "polish_synthesis", lambda model, start, **_: held)
    found = design.design(plant, "polish", match_reference=False)
    assert found.status == "verified"
    assert found.stopped_early.startswith("its start, by mu: after iteration 1, the time limit")
