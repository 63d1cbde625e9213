"""One call wires a design: its options are checked before anything is computed, and are what the
file is keyed by.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from ambrose.annexes.scheduled.lpv.method import Lpv
from ambrose.annexes.scheduled.lpv.synthesis import lpv_synthesis
from ambrose.core.checks import InvalidInput, NumericalFailure
from ambrose.judge.result import pid_synthesis
from ambrose.law.loop import Timing
from ambrose.machine.file.toml import load_machine
from ambrose.model.assemble import assemble
from ambrose.model.uncertainty import reduce
from ambrose.synthesis.design import design
from ambrose.synthesis.fixed_order.polish import polish_synthesis
from ambrose.synthesis.hinf import hinf_synthesis
from ambrose.synthesis.methods import Pid, Tuned
from ambrose.synthesis.mu import mu_synthesis
from coarse import coarse


@pytest.fixture(scope="module")
def plant():
    return reduce(assemble(coarse("seal-rig")))


REFUSED = {
    "an unknown method": ("magic", {}, r"method is 'magic', but must be one of tuned, pid, hinf"),
    "a method that is no text": (None, {}, "method is None"),
    "an unknown option": ("mu", {"rates": 1e4}, r"no option 'rates'; did you mean \"rate\""),
    "a structure that only tuning chooses": (
        "pid",
        {"structure": "filters"},
        "structure is given, but must be left out with method pid; it goes with tuned",
    ),
    "a rate below zero": (
        "mu",
        {"rate": -1.0},
        "rate is -1.0, but must be positive; 10000 Hz is usual",
    ),
    "a rate as text": ("mu", {"rate": "fast"}, "rate is .fast., but must be a number"),
    "a delay below zero": (
        "mu",
        {"rate": 1e4, "delay_samples": -1},
        "computing delay .* is -1, but must be a whole number",
    ),
    "a loss without a rate": ("mu", {"loss": 0.05}, "rate is None, but must be given with a loss"),
    "a loss below zero": ("mu", {"loss": -0.05, "rate": 1e4}, "loss is -0.05"),
    "half a state": ("polish", {"order": 1.5}, "order is 1.5, but must be a whole number"),
    "an order of mu": ("mu", {"order": 12}, "it goes with tuned or polish"),
    "an order lowered twice": (
        "tuned",
        {"loss": 0.05, "rate": 1e4},
        "it goes with pid, hinf, mu or polish",
    ),
    "another structure": ("tuned", {"structure": "ring"}, "structure is 'ring'"),
    "half a bending mode": ("mu", {"bending_modes": 0.5}, "bending_modes is 0.5"),
    "speeds of a fixed controller": (
        "mu",
        {"speeds": (1.0, 2.0)},
        "speeds is given, but must be left out with method mu; it goes with lpv",
    ),
    "rate of a fixed controller": (
        "mu",
        {"speed_rate": 100.0},
        "speed_rate is given, but .* goes with lpv",
    ),
    "pressures of a fixed controller": (
        "hinf",
        {"pressures": (0.0, 1e5)},
        "pressures is given, but .* goes with lpv",
    ),
    "negative rate": ("lpv", {"speed_rate": -1.0}, "speed_rate"),
    "speeds exchanged": (
        "lpv",
        {"speeds": (2.0, 1.0)},
        "speeds is 2 and 1, but must be the lower, then the higher",
    ),
    "one speed": ("lpv", {"speeds": (2.0,)}, "speeds"),
    "gain matched perhaps": ("mu", {"match_reference": "perhaps"}, "match_reference is 'perhaps'"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_bad_arguments_are_named_in_one_sentence(name, plant):
    method, choices, message = REFUSED[name]
    with pytest.raises(InvalidInput, match=message) as caught:
        design(plant, method, **choices)
    assert "\n" not in str(caught.value)


def test_a_machine_is_no_plant():
    with pytest.raises(
        InvalidInput,
        match=r"plant is Machine, but must be a Plant; assemble\(machine, point\) gives one",
    ):
        design(coarse("seal-rig"), "pid")


@pytest.mark.parametrize(
    "call",
    [
        hinf_synthesis,
        mu_synthesis,
        lambda item: polish_synthesis(item, None),
        lambda item: lpv_synthesis([item, item], [0.0, 1.0]),
        lambda item: lpv_synthesis(lambda p: item, [0.0, 1.0]),
    ],
)
@pytest.mark.parametrize("item", [3, None, "seal-rig"])
def test_what_is_no_generalized_plant_is_named(call, item):
    """An AttributeError before."""
    with pytest.raises(
        InvalidInput, match=f"plant is {type(item).__name__}, but must be a GeneralizedPlant"
    ):
        call(item)


def test_plants_of_a_schedule_that_are_no_list():
    with pytest.raises(InvalidInput, match="plants is int, but must be a list, or a function"):
        lpv_synthesis(3, [0.0, 1.0])


def test_a_result_says_what_it_was_asked_for(plant):
    made = design(plant, "pid", rate=5e3).provenance
    assert (made.machine, made.settings["method"], made.settings["rate"]) == (
        "seal-rig",
        "pid",
        5e3,
    )
    assert (
        made.key
        == design(plant, Pid(rate=5e3)).provenance.key
        != design(plant, "pid").provenance.key
    )


def test_a_rate_wires_delay_judge_and_order(plant, monkeypatch):
    """What the command line and commissioning each put together by hand."""
    seen = {}

    def polished(problem, start, **options):
        seen.update(options, states=problem.system.n_states)
        return pid_synthesis(plant)

    synthesis = "ambrose.synthesis"
    monkeypatch.setattr(f"{synthesis}.mu.mu_synthesis", lambda problem, **_: pid_synthesis(plant))
    monkeypatch.setattr(f"{synthesis}.fixed_order.polish.polish_synthesis", polished)
    monkeypatch.setattr(
        f"{synthesis}.design.reduce_order",
        lambda plant, result, loss, *others: seen.update(loss=loss) or result,
    )
    design(plant, "polish", match_reference=False)
    states = seen["states"]
    assert seen["judge"] is None and "loss" not in seen
    design(plant, "polish", match_reference=False, rate=1e4, loss=0.05)
    # a Pade state per axis
    assert seen["states"] == states + 4 and callable(seen["judge"]) and seen["loss"] == 0.05
    assert Tuned(rate=1e4, delay_samples=2).timing() == Timing(1e-4, 2)
    assert Tuned().timing() is None
    runs = replace(
        plant,
        machine=replace(
            plant.machine, controller=replace(plant.machine.controller, sample_time=1e-4)
        ),
    )
    # it was called given
    assert "1 sample late (machine file)" in design(runs, "pid").certificate.plant


@pytest.fixture
def told(monkeypatch):
    """What ``design`` asks of the synthesis of a schedule: (parameters, ends of their grids, their
    rates).
    """
    heard: list[tuple[str, Any, tuple[float | None, ...]]] = []

    def listen(plant, grid, along, **given):
        heard.append(
            (
                along.name,
                None if grid is None else tuple((axis[0], axis[-1]) for axis in grid),
                given["rate"],
            )
        )
        raise NumericalFailure("far enough")

    monkeypatch.setattr("ambrose.annexes.scheduled.lpv.machine.design_schedule", listen)
    return heard


def test_what_is_scheduled_over_and_its_rate_reach_the_synthesis(told):
    """The option is the rate that the inequalities take; None stays: however fast."""
    plant = assemble(load_machine("turboexpander"))
    asked: list[dict[str, Any]] = [
        {"speeds": (700.0, 900.0), "speed_rate": 1760.0},
        {"speeds": (700.0, 900.0)},
        {"pressures": (0.0, 4e6), "pressure_rate": 2e6},
        {"pressure_rate": 2e6},
        {"speeds": (700.0, 900.0), "pressures": (0.0, 4e6), "pressure_rate": 2e6},
    ]
    for options in asked:
        with pytest.raises(NumericalFailure, match="far enough"):
            design(plant, "lpv", **options)
    speeds, pressures = (700.0, 900.0), (0.0, 4e6)
    expected = [
        ("speed", (speeds,), (1760.0,)),
        ("speed", (speeds,), (None,)),
        ("pressure", (pressures,), (2e6,)),
    ]
    assert told == [
        *expected,
        ("pressure", None, (2e6,)),
        ("speed and pressure", (speeds, pressures), (None, 2e6)),
    ]


@pytest.mark.parametrize(
    ("name", "over"),
    [("seal-rig", "pressure"), ("turboexpander", "speed"), ("three-bearing-train", "pressure")],
)
def test_a_machine_without_several_speeds_of_one_pressure_is_scheduled_over_its_pressures(
    told, name, over
):
    with pytest.raises(NumericalFailure, match="far enough"):
        design(assemble(load_machine(name)), "lpv")
    assert [parameter for parameter, _, _ in told] == [over]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (
            {"speeds": (1.0, 2.0), "pressure_rate": 1e5},
            "give the pressures, or leave pressure_rate out",
        ),
        ({"speed_rate": 1.0, "pressure_rate": 1e5}, "give the speeds, or leave speed_rate out"),
        ({"pressures": (2e5, 1e5)}, "the lower, then the higher"),
        ({"pressures": (-1e5, 1e5)}, "none negative"),
        ({"pressures": (float("nan"), 1e5)}, "finite"),
        ({"pressure_rate": 0.0}, "give it in Pa/s"),
    ],
)
def test_schedules_that_cannot_be_are_refused(options, message):
    with pytest.raises(InvalidInput, match=message):
        Lpv(**options)
