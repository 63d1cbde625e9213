"""Maps and least values: what is found meets all, and a size smaller fails for the reason that is
told.
"""

import json
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from click.testing import CliRunner

import ambrose as amb
from ambrose import InvalidInput, NumericalFailure
from ambrose.annexes.sizing import least as guarantee, least as mapped
from ambrose.annexes.sizing.least import Least, Size, least, price
from ambrose.annexes.sizing.page import (
    contour_caption,
    contour_figure,
    cost_figure,
    costs_caption,
    sizing_page,
)
from ambrose.cli import main
from ambrose.report.page import render
from ambrose.synthesis.methods import Tuned
from coarse import coarse

FAST = Tuned(rate=10_000, order=8)


@cache
def rig():
    """The seal rig with k alone uncertain, at its nominal pressure."""
    found = coarse("seal-rig-k-only")
    point = found.operation.nominal
    return replace(
        found, operation=replace(found.operation, points=(point,), design_point=None, ranges=())
    )


@cache
def sizing():
    return amb.size(rig(), (0.4, 1.0), (1.0, 1.3), FAST)


def plain_trial():
    """The machine's own size."""
    return next(trial for trial in sizing().trials if trial.size == Size())


def test_what_is_taken_meets_all_and_verification_agrees():
    knee = sizing().knee
    assert plain_trial().met
    assert knee is not None and knee.met and knee.ratio == max(knee.ratios.values())
    verified = amb.verify(knee.machine, knee.synthesis, rate=10_000, tolerances=False)
    assert verified.stable
    assert not any(
        "sensitivity" in check.name for _, checks in verified.labelled for check in checks.failed
    )


def test_a_size_smaller_fails_for_its_weight(monkeypatch):
    small = {trial.size: trial for trial in sizing().trials}[Size(0.4, 1.0)]
    assert not small.met and small.binding.startswith("static load") and small.synthesis is None
    assert small in sizing().smaller or sizing().knee.size.bias == 1.3
    # with less reserve it is designed, however well
    monkeypatch.setattr("ambrose.synthesis.fixed_order.tuning._ITERATIONS", 3)
    assert amb.size(rig(), (0.4,), (1.0,), FAST, reserve=0.5).trials[0].synthesis is not None


def test_the_front_has_less_of_one_for_more_of_the_other():
    front = sizing().front
    assert front and all(trial.met for trial in front)
    volumes, losses = (
        [getattr(t.costs, name) for t in front] for name in ("volume", "copper_loss")
    )
    assert volumes == sorted(volumes) and losses == sorted(losses, reverse=True)


@pytest.mark.study
def test_the_least_gain_meets_all_with_less_than_a_plain_design():
    plain = plain_trial().synthesis
    found = least(rig(), "gain", FAST)
    assert np.isfinite(found.value) and found.synthesis.gamma <= 1.02
    omega = np.geomspace(1.0, 2e4, 300)
    gains = [largest_control(found.machine, made, omega) for made in (plain, found.synthesis)]
    assert gains[1] < 0.8 * gains[0] and gains[1] < 1.05 * found.value


def largest_control(machine, synthesis, omega):
    """The largest singular value of K S_o at the design point, continuous and on the full plant."""
    G = amb.assemble(machine)
    g = amb.frequency_response(amb.select(G.system, G.named("u"), G.named("y")), omega).values
    k = amb.frequency_response(synthesis.controller, omega).values
    return np.linalg.norm(k @ np.linalg.inv(np.eye(4) + g @ k), 2, axis=(1, 2)).max()


@pytest.mark.study
def test_more_robustness_costs_more_gain():
    found = price(rig(), "seal.center.k", (0.2, 2.0), "gain", FAST)
    assert found.found[0].value < found.found[1].value


def test_what_holds_a_wider_range_holds_the_narrower(monkeypatch):
    values = {0.5: 3.0, 1.0: 5.0, 1.5: 4.0}

    def found(machine, lever, *arguments, **options):
        (width,) = (
            item.relative for item in machine.tolerances if item.parameter == "seal.center.k"
        )
        return Least(lever, values[width], 0.0, f"{width}")

    monkeypatch.setattr("ambrose.annexes.sizing.least.least", found)
    assert [
        (item.value, item.binding)
        for item in price(rig(), "seal.center.k", (1.5, 0.5, 1.0), "gain", FAST).found
    ] == [
        (3.0, "0.5"),
        (4.0, "1.5"),
        (4.0, "1.5"),
    ]


def test_a_lever_is_stepped_down_to_what_fails(monkeypatch):
    """The search alone: a size is enough from 0.31 of the area on."""

    def attempt(machine, size, options, **rest):
        return guarantee.Trial(size, machine, None, 0.9 if size.area >= 0.31 else 1.2, "settling")

    monkeypatch.setattr("ambrose.annexes.sizing.least.attempt", attempt)
    found = least(rig(), "area", FAST)
    assert (
        0.31 <= found.value < 0.31 * 1.05 and found.refused < 0.31 and found.binding == "settling"
    )


def test_an_interrupt_keeps_what_is_done(monkeypatch):
    calls = []

    def attempt(machine, size, options, **rest):
        if len(calls) == 2:
            raise KeyboardInterrupt
        calls.append(size)
        return guarantee.Trial(size, machine, guarantee.costs(machine, size), 0.9, "settling")

    monkeypatch.setattr(mapped, "attempt", attempt)
    assert len(amb.size(rig(), (0.5, 1.0), (0.5, 1.0), FAST).trials) == 2
    assert calls[0] == Size(1.0, 1.0)  # from the machine file's own outwards


def test_a_failed_design_is_a_row_with_its_reason(monkeypatch):
    def fails(*arguments, **options):
        raise NumericalFailure("a pole stays at +3 rad/s; give more states")

    monkeypatch.setattr(guarantee, "tuned", fails)
    trial = guarantee.attempt(rig(), Size(), FAST)
    assert not trial.met and "give more states" in trial.binding


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"areas": ()}, "no areas were given"),
        ({"areas": (-1.0,)}, "one of the areas"),
        ({"reserve": -1.0}, "reserve"),
        ({"method": Tuned(structure="pid")}, "structure"),
        ({"areas": np.linspace(0.1, 1, 50), "biases": np.linspace(0.1, 1, 50)}, "at most 400"),
    ],
)
def test_refusals(arguments, words):
    with pytest.raises(InvalidInput, match=words):
        amb.size(rig(), **arguments)


@pytest.mark.parametrize(
    ("peaks", "promised"),
    [((1.5, 1.6, 1.7, 2.0), "its limit 3 is not reached"), ((2.0, 2.5, 3.5, 4.0), "in red")],
)
def test_the_figures_draw_what_their_captions_promise(peaks, promised):
    """Lines of S_o were drawn around the limit alone, also where no value was near it."""
    knee = sizing().knee
    trials = tuple(
        replace(trial, sensitivity=s, ratios={"sensitivity": s / 3}, synthesis=knee.synthesis)
        for trial, s in zip(sizing().trials, peaks, strict=True)
    )
    found = replace(sizing(), trials=trials)
    drawn = [
        t for t in contour_figure(found).data if t.type == "contour" and t.line.dash == "solid"
    ]
    inside = [t.contours.start for t in drawn]
    assert len(inside) >= 3 and all(min(peaks) < level < max(peaks) for level in inside)
    assert (3.0 in inside) == (promised == "in red")
    assert promised in contour_caption(found)
    kinds = {t.marker.symbol for t in cost_figure(found).data if t.mode == "markers" and len(t.x)}
    assert ("Cross" in costs_caption(found)) == ("x-thin" in kinds)
    lines = [t for t in cost_figure(found).data if t.mode == "lines"]
    assert ("The line" in costs_caption(found)) == bool(lines)


def test_the_page_and_the_command(tmp_path, monkeypatch):
    text = render(sizing_page(sizing()))
    assert (
        "Size of the magnetic bearings" in text
        and "one size smaller" in text
        and "static load" in text
    )
    monkeypatch.setattr(mapped, "attempt", lambda machine, size, options, **rest: _stored(size))
    call = [
        "size",
        "seal-rig-k-only",
        "--areas",
        "0.4, 100 %",
        "--biases",
        "1, 1.3",
        "--unverified",
    ]
    plain = CliRunner().invoke(
        main, [*call, "--json", "--machine-out", str(tmp_path / "knee.toml")]
    )
    assert plain.exit_code == 0, plain.output
    told = json.loads(plain.stdout)
    assert told["knee"]["met"] and len(told["rows"]) == 4 and told["verified"] is None
    assert amb.load_machine(tmp_path / "knee.toml").bearings[0].coefficients_at == "no-load"
    printed = CliRunner().invoke(main, call)
    assert "Least copper and iron" in printed.stdout and "One size smaller" in printed.stdout
    for wrong in (["--areas", "half"], ["--least", "gain", "--areas", "1"], ["--widths", "1"]):
        refused = CliRunner().invoke(main, ["size", "seal-rig-k-only", *wrong])
        assert refused.exit_code == 2 and ";" in refused.stderr


def _stored(size):
    return {trial.size: trial for trial in sizing().trials}[size]
