"""Retuning on a small machine whose truth is known: what is found, changed, tried and accepted, how
a second run goes on, and what is refused.
"""

import json
import re
from dataclasses import replace
from functools import cache
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from click.testing import CliRunner

import ambrose as amb
from ambrose.annexes.site import retuning as chain
from ambrose.annexes.site.pages import retuning_page
from ambrose.annexes.site.retuning import (
    CODE,
    CONTROLLER,
    SAME_ORDER,
    STATE,
    Moved,
    _begun,
    method_like,
)
from ambrose.cli import main
from ambrose.code.sampled import checksum_of
from ambrose.core.checks import InvalidInput, NumericalFailure
from ambrose.identification.findings import Code
from ambrose.judge.controller_file import write_controller
from ambrose.law.loop import Timing
from ambrose.machine.description import Tolerance
from ambrose.report.page import render
from ambrose.rig.scenario import Prbs, Scenario
from ambrose.synthesis.fixed_order.job import with_states

RIG = Path(__file__).parents[3] / "benchmarks" / "snapshot_files" / "small-rig.toml"
RATE, UNKNOWN = 10_000.0, "bearing.*.force_per_current.*"


@cache
def machine():
    found = amb.load_machine(RIG)
    where = replace(found.operation, points=found.operation.points[:1], ranges=())
    asked = replace(found.requirements, log_decrement=0.05)
    return replace(found, operation=where, requirements=asked)


@cache
def law():
    return amb.design(machine(), "tuned", rate=RATE, delay_samples=1, order=8)


@cache
def record(scale, of_new=None, seconds=0.4, stiffer=1.0):
    """Binary sequences on every axis of the linear loop, all K_i times a factor, all K_s times
    another, 10 nm of noise; of_new: the folder whose controller ran.
    """
    true = replace(
        machine(),
        bearings=tuple(
            replace(
                b,
                force_per_current=tuple(scale * k for k in b.force_per_current),
                negative_stiffness=tuple(stiffer * k for k in b.negative_stiffness),
            )
            for b in machine().bearings
        ),
    )
    ran = law() if of_new is None else amb.read_controller(of_new / CONTROLLER)
    driven = tuple(
        Prbs(f"e_{axis}", 0.1, 2e-4, order=15, seed=i) for i, axis in enumerate(true.axes)
    )
    scenario = Scenario("s", seconds, sequences=driven)
    found = amb.simulate(true, ran, scenario, linear=True, rate=RATE).record
    found = found.select([name for name in found.signals if name[:2] in {"y_", "u_", "e_"}])
    shown = np.array([name[:2] == "y_" for name in found.signals])[:, None]
    noise = 1e-8 * np.random.default_rng(0).standard_normal(found.values.shape)
    return replace(found, values=found.values + shown * noise)


def retuned(folder, scale, **options):
    return amb.retune(machine(), record(scale), law(), folder, unknown=UNKNOWN, **options)


def test_nothing_to_change_is_an_answer_with_its_figures(tmp_path):
    done = retuned(tmp_path / "same", 1.0)
    assert done.outcome == "no change needed" and done.passed
    assert [step.name for step in done.steps] == ["identified", "changed", "running"]
    assert "proved at all frequencies" in done.steps[-1].words
    assert not (tmp_path / "same" / CODE).exists()
    assert not any(abs(item.change) > 0.002 for item in done.moved)


def test_a_change_beyond_the_file_s_tolerances_is_doubted_unless_it_is_known(tmp_path):
    narrow = replace(
        machine(),
        tolerances=tuple(
            Tolerance(f"bearing.{b.name}.force_per_current.{way}", relative=0.05)
            for b in machine().bearings
            for way in ("zeta", "eta")
        ),
    )
    given = (narrow, record(0.88), law())
    done = amb.retune(*given, tmp_path / "doubted", unknown=UNKNOWN)
    assert done.outcome == "stopped" and done.stopped_at.name == "identified"
    assert "beyond its tolerance" in done.text and "go on with --changed" in done.text
    done = amb.retune(*given, tmp_path / "known", unknown=UNKNOWN, changed=True)
    assert done.steps[0].passed and done.steps[1].name == "changed"
    assert all(item.beyond for item in done.moved)


def test_one_factor_of_all_magnets_is_doubted_unless_it_is_known(tmp_path):
    """It may be the mass as well: the loop, and so the retuning, is the same, and the page says
    so.
    """
    given = (machine(), record(0.88, stiffer=0.88), law())
    magnets = {"unknown": (UNKNOWN, "bearing.*.negative_stiffness.*")}
    done = amb.retune(*given, tmp_path / "doubted", **magnets)
    assert done.outcome == "stopped" and done.stopped_at.name == "identified"
    assert {item.code for item in done.identification.findings} == {Code.COMMON_FACTOR}
    assert "weigh the rotor" in done.text and "go on with --changed" in done.text
    done = amb.retune(*given, tmp_path / "known", changed=True, **magnets)
    first = done.steps[0]
    assert first.passed and "as is known: " in first.words and "weigh the rotor" in first.words
    assert [step.name for step in done.steps][:3] == ["identified", "changed", "running"]
    assert all(abs(item.value / (0.88 * item.file) - 1) < 0.005 for item in done.moved)


@pytest.mark.study
def test_a_machine_that_changed_gets_a_controller_of_the_same_structure(tmp_path):
    folder = tmp_path / "change"
    done = retuned(folder, 0.75, anyway=True)
    assert done.outcome == "retuned", done.text
    assert done.text.startswith("retuned: largest output sensitivity: ")
    assert retuning_page(done).result.text.startswith("Retuned: largest output sensitivity: ")

    # the truth lies in the intervals, which are the box; the file's values do not
    for item in done.moved:
        assert item.certain and abs(item.value / (0.75 * item.file) - 1) < 0.002
    box = {item.parameter for item in done.machine.tolerances}
    assert box >= {item.path for item in done.moved}
    assert done.after is not None and done.after.passed
    assert "robust.sensitivity.bound" in {check.name for check in done.after.boxes[0].checks}

    # code: the difference leads from the tables that run to the new ones, and back
    assert done.delivery is not None and done.delivery.difference is not None
    change, source = done.delivery.difference, (folder / CODE / "controller.c").read_text()
    assert checksum_of(source) == change.checksum
    assert checksum_of(change.reversed().apply(source)) == change.checksum_before
    assert [run.forward for run in done.switches] == [True, False]
    assert all(run.trace.outcome == "completed" for run in done.switches)

    # the page has every step; a second run, on another day, takes its own controller up again
    text = render(retuning_page(done))
    assert all(step.title in text for step in done.steps)
    kept, told = (folder / CONTROLLER).read_bytes(), []
    after = record(0.75, folder, 4.0)
    again = retuned(folder, 0.75, anyway=True, accept_from=after, progress=told.append)
    assert (folder / CONTROLLER).read_bytes() == kept
    assert not any("taken up" in line or line.startswith("round ") for line in told)
    assert again.acceptance is not None and again.steps[-1].name == "accepted"
    assert again.passed, again.text


def test_a_later_day_is_no_other_machine(tmp_path):
    """The day stands in the identified machine, which the controller was designed for."""
    asked = (tmp_path, machine(), law(), [("r.h5", "abc")], ["4 modes"])
    first = _begun(*asked)
    for began, kept in (
        ({**first, "date": "2020-02-29"}, True),
        ({**first, "machine": "x"}, False),
    ):
        (tmp_path / STATE).write_text(json.dumps({"began": {**began, "date": "2020-02-29"}}))
        assert (_begun(*asked)["date"] == "2020-02-29") == kept
    for text in ("", "[]", '{"began": 1}', '{"began": {}}'):
        (tmp_path / STATE).write_text(text)
        assert _begun(*asked) == first


def test_it_stops_where_the_record_is_not_to_be_believed(tmp_path):
    """A sensor's gain that nobody told of: identified, but doubted, and nothing is designed."""
    given = record(1.0)
    values = given.values.copy()
    values[given.signals.index("y_A_zeta")] *= 1.3
    wrong = replace(given, values=values)
    folder = tmp_path / "doubted"
    try:
        done = amb.retune(machine(), wrong, law(), folder, unknown=UNKNOWN)
    except InvalidInput:
        pass
    else:
        assert done.outcome == "stopped" and done.steps[-1].name == "identified"
    assert not (folder / CONTROLLER).exists()


def test_without_commands_another_controller_is_named_among_the_causes(tmp_path):
    """A loop whose gain is 1.3 times the given controller's looks like a wrong scale of e."""
    given = law().controller
    stronger = replace(given, C=1.3 * given.C, D=1.3 * given.D)
    with_u = record(1.0)
    blind = with_u.select([name for name in with_u.signals if name[:2] != "u_"])
    done = amb.retune(machine(), blind, stronger, tmp_path / "blind", unknown=UNKNOWN)
    assert done.outcome == "stopped"
    assert "no record holds u_<axis>, so that another controller" in done.steps[-1].words


@pytest.mark.parametrize("last", ["designed", "proved", "coded"])
def test_it_stops_at_the_first_step_that_does_not_hold(tmp_path, monkeypatch, last):
    """Every step but the one in question is a stand-in that holds; what follows it is never come
    to, and what went before stays in the folder.
    """

    def identified(made, *given, **options):
        made.made |= {"identification": SimpleNamespace(machine=machine()), "before": held}
        made.say("identified", "identified", True, "as it is")

    def refused(*given, **options):
        raise NumericalFailure("nothing holds") if last == "designed" else InvalidInput("no room")

    held = SimpleNamespace(passed=last != "proved", points=(), boxes=(), left_out=("cold",))
    held.labelled, held.facts = (), dict
    monkeypatch.setattr(chain, "_identified", identified)
    monkeypatch.setattr(chain, "_needed", lambda *given: True)
    monkeypatch.setattr(chain, "_beside", lambda *given: "alike")
    monkeypatch.setattr(chain, "_verified", lambda *given: held)
    monkeypatch.setattr(chain, "resume_or_design", lambda *given: law())
    monkeypatch.setattr(chain, "write_code", refused)
    if last == "designed":
        monkeypatch.setattr(chain, "resume_or_design", refused)
    monkeypatch.setattr(chain, "_switched", lambda *given: pytest.fail("came to the rig"))
    monkeypatch.setattr(chain, "_accepted", lambda *given: pytest.fail("came to the acceptance"))
    done = amb.retune(machine(), record(1.0), law(), tmp_path, accept_from=["after.h5"])
    assert done.outcome == "stopped" and done.stopped_at.name == done.steps[-1].name == last
    kept = json.loads((tmp_path / STATE).read_text())
    assert [step["name"] for step in kept["steps"]] == [step.name for step in done.steps]
    assert kept["outcome"] == "stopped"


def test_what_was_done_survives_a_kill(tmp_path, monkeypatch):
    """The state after every step, with the day of the beginning, which a later run takes over."""

    def killed(made, *given, **options):
        made.say("identified", "identified", True, "as it is")
        made.began["date"] = "2020-02-29"
        made.say("changed", "changed", None, "nothing")
        raise KeyboardInterrupt

    monkeypatch.setattr(chain, "_identified", killed)
    given = (machine(), record(1.0), law(), tmp_path)
    with pytest.raises(KeyboardInterrupt):
        amb.retune(*given)
    kept = json.loads((tmp_path / STATE).read_text())
    assert [step["name"] for step in kept["steps"]] == ["identified", "changed"]
    assert kept["outcome"] == "under way"

    def later(made, *given, **options):
        assert made.began["date"] == "2020-02-29"
        made.say("identified", "identified", False, "doubted")

    monkeypatch.setattr(chain, "_identified", later)
    assert amb.retune(*given).outcome == "stopped"


def test_refusals(tmp_path):
    with pytest.raises(InvalidInput, match="no record was given"):
        amb.retune(machine(), [], law(), tmp_path)
    slow = replace(record(1.0), sample_rate_hz=8000.0)
    with pytest.raises(InvalidInput, match=r"record 1 is 8000 Hz.* record every sample, or give"):
        amb.retune(machine(), slow, law(), tmp_path)
    fast = replace(record(1.0), sample_rate_hz=20000.0)
    with pytest.raises(InvalidInput, match=r"10000 Hz; give the controller that ran") as told:
        amb.retune(machine(), fast, law(), tmp_path)
    assert "every sample" not in str(told.value)
    # another machine's record runs at another rate, too: it is the machine that is wrong
    other = replace(fast, machine="another")
    with pytest.raises(InvalidInput, match="the machine of record 1 is 'another'"):
        amb.retune(machine(), other, law(), tmp_path)
    assert not list(tmp_path.iterdir())
    result = CliRunner().invoke(main, ["retune", "--help"])
    assert result.exit_code == 0 and "--accept" in result.output


def test_the_method_keeps_the_structure():
    method = method_like(law(), Timing(1e-4, 2), machine())
    assert (method.order, method.structure) == (8, "free")
    assert (method.rate, method.delay_samples) == (10_000.0, 2)
    assert method_like(amb.design(machine(), "pid"), Timing(1e-4), machine()).order == 8
    # what a design takes by itself may grow where a limit needs it
    wide = with_states(law().controller, 4, ((0, 1, 2, 3),))
    assert method_like(replace(law(), controller=wide), Timing(1e-4), machine()).order is None


def designed(monkeypatch, folder, made):
    """The steps up to the proof, which fails at the points; made: {order asked for: its gamma}, of
    which None is one of 12 states; and the orders that were asked for.
    """
    asked = []

    def design(plant, method, path, progress):
        asked.append(method.order)
        more = with_states(law().controller, 4 if method.order is None else 0, ((0, 1, 2, 3),))
        gamma = made[method.order]
        margins = law().certificate.margins | {"ratio_sensitivity": gamma}
        shown = replace(law().certificate, margins=margins)
        found = replace(law(), controller=more, gamma=gamma, certificate=shown)
        return amb.read_controller(write_controller(path, found))

    def identified(made, *given, **options):
        made.made |= {"identification": SimpleNamespace(machine=machine()), "before": None}
        made.say("identified", "identified", True, "as it is")

    judged = []

    def verified(*given, tolerances=True):
        judged.append(tolerances)
        return SimpleNamespace(
            passed=False, points=(), boxes=(), left_out=("cold",), labelled=(), facts=dict
        )

    monkeypatch.setattr(chain, "_identified", identified)
    monkeypatch.setattr(chain, "_needed", lambda *given: True)
    monkeypatch.setattr(chain, "_verified", verified)
    monkeypatch.setattr(chain, "resume_or_design", design)
    done = amb.retune(machine(), record(1.0), law(), folder)
    return {step.name: step for step in done.steps}, done.new, asked, judged


def test_more_states_where_as_many_as_before_miss_a_limit(tmp_path, monkeypatch):
    """What exceeds a limit 1.54 times was "verified" in a green step: it was shown stable alone."""
    steps, new, asked, _ = designed(monkeypatch, tmp_path / "met", {8: 0.9})
    assert (
        asked == [8]
        and steps["designed"].passed
        and "8 states as before" in steps["designed"].words
    )
    folder = tmp_path / "grown"
    steps, new, asked, judged = designed(monkeypatch, folder, {8: 1.54, None: 0.9})
    assert asked == [8, None] and new.controller.n_states == 12 and judged == [True]
    assert steps["designed"].passed and "12 states in place of 8" in steps["designed"].words
    assert amb.read_controller(folder / CONTROLLER).controller.n_states == 12
    assert amb.read_controller(folder / SAME_ORDER).controller.n_states == 8

    # an earlier run's attempt is taken up from where it stands, and returns where it now does
    designed(monkeypatch, folder, {8: 0.9})
    assert amb.read_controller(folder / CONTROLLER).controller.n_states == 8
    assert not (folder / SAME_ORDER).exists()


def test_a_design_that_misses_a_limit_says_so_and_is_not_proved(tmp_path, monkeypatch):
    steps, _, _, judged = designed(monkeypatch, tmp_path, {8: 1.54, None: 1.2})
    assert steps["designed"].passed is None and steps["proved"].passed is False
    assert "ended at 1.2 of its aims; the limits are judged next" in steps["designed"].words
    assert not re.search(r"\bverified\b", steps["designed"].words)
    assert judged == [False]  # nothing between the points where these miss already


def test_what_moved():
    still = Moved("a", "N/A", 100.0, 101.0, 2.0, 5.0)
    assert not still.certain and not still.beyond and still.change == pytest.approx(0.01)
    assert Moved("a", "N/A", 100.0, 104.0, 2.0, 5.0).certain
    assert Moved("a", "N/A", 100.0, 108.0, 2.0, 5.0).beyond
    assert np.isnan(Moved("a", "N/m", 0.0, 1.0, 2.0, None).change)
