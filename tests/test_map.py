"""`ambrose map`: where stability ends against eigenvalues one by one, families against loops closed
one by one, page, JSON.
"""

import json
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from click.testing import CliRunner

import ambrose as amb
from ambrose.cli import main
from ambrose.core.checks import InvalidInput
from ambrose.core.frequency import frequency_response
from ambrose.core.sampling import c2d
from ambrose.core.statespace import poles, select
from ambrose.judge.exploration import explore, pole_map
from ambrose.law.loop import closed_loop, timing_of
from ambrose.model.static_load import residual_unbalance
from coarse import coarse, coarse_file

BAR = 1e5


def call(*arguments):
    return CliRunner().invoke(main, [str(argument) for argument in arguments])


@cache
def law(name):
    return amb.design(coarse(name), "pid")


@pytest.mark.parametrize("rate", [None, 1e4])
def test_where_stability_ends_over_pressure(rate):
    """Just below the end the loop is stable, just above it is not: eigenvalues of loops assembled
    here.
    """
    found = explore(coarse("seal-rig"), law("seal-rig"), parts=["poles"], rate=rate).maps[0]
    ((end, above),) = found.ends
    assert found.over == "pressure" and not above and 2.04 * BAR < end < 4.08 * BAR

    def abscissa(pressure):
        plant = amb.assemble(coarse("seal-rig"), seal_pressure=pressure)
        if rate is None:
            return poles(closed_loop(plant, law("seal-rig").law)).real.max()
        return (
            np.abs(
                poles(closed_loop(plant, c2d(law("seal-rig").law, 1e-4, "tustin", delay=1e-4)))
            ).max()
            - 1
        )

    step = found.values[1] - found.values[0]
    assert abscissa(end - step / 500) < 0 < abscissa(end + step / 500)
    assert (np.sign(found.abscissa) == np.sign([abscissa(p) for p in found.values])).all()


def test_sampled_poles_are_shown_as_continuous_ones():
    """At 10 kHz the slow poles of the sampled loop lie within some percent of those of the late
    continuous one.
    """
    slow = [
        explore(
            coarse("two-disc-rotor"),
            law("two-disc-rotor"),
            parts=["poles"],
            rate=r,
            speed=(0.0, 100.0),
        )
        .maps[0]
        .poles[0]
        for r in (2e4, 2e5)
    ]
    low = [np.sort_complex(p[(p.imag > 50) & (p.imag < 400)]) for p in slow]
    assert len(low[0]) and np.allclose(low[0].imag, low[1].imag, rtol=0.05)


def test_unbalance_over_the_tolerances_holds_the_nominal_and_its_own_members():
    machine = coarse("three-bearing-train")
    found = explore(machine, law("three-bearing-train"), parts=["pulses", "unbalance"], bound=True)
    worst, force = found.unbalance, residual_unbalance(machine)
    assert found.pulses.stable.all() and found.stable
    assert (worst.found >= worst.nominal * (1 - 1e-9)).all() and (
        worst.bound >= worst.found * (1 - 1e-6)
    ).all()
    plant = amb.assemble(machine)
    late = timing_of(machine, law("three-bearing-train")).late(law("three-bearing-train").law)
    k = int(worst.found.argmax())
    T = frequency_response(
        select(closed_loop(plant, late), plant.bearing_named("f"), plant.bearing_named("q")),
        worst.speeds[[k]],
    ).values[0]
    assert np.linalg.norm(T, 2) * force.force(worst.speeds[k]) == pytest.approx(
        worst.nominal[k], rel=0.02
    )


@pytest.mark.parametrize(
    "name", ["seal-rig", pytest.param("three-bearing-train", marks=pytest.mark.study)]
)
def test_command_and_page(name, tmp_path):
    made = call("synthesize", name, "--method", "pid", "-o", tmp_path / "pid.json", "--json")
    # the rig's own PID loses twice nominal pressure, which is told by the status
    assert made.exit_code == (1 if name == "seal-rig" else 0), made.stderr
    done = call(
        "map", name, "--controller", tmp_path / "pid.json", "-o", tmp_path / "map.html", "--json"
    )
    told = json.loads(done.stdout)
    assert (
        done.exit_code
        == (0 if told["stable"] else 1)
        == {"seal-rig": 1, "three-bearing-train": 0}[name]
    )
    assert {m["over"] for m in told["maps"]} == {
        "seal-rig": {"pressure"},
        "three-bearing-train": {"speed", "pressure"},
    }[name]
    assert ("unbalance" in told) == (name == "three-bearing-train")
    assert told["pulses"]["members"] >= told["pulses"]["stable"] > 10
    assert "The loop over its range" in (tmp_path / "map.html").read_text()
    words = call(
        "map",
        name,
        "--controller",
        tmp_path / "pid.json",
        "--what",
        "poles",
        "--pressure-bar",
        "0",
        "4",
    )
    assert ("loses stability at 2.9" in words.stdout) == (name == "seal-rig"), words.stdout


def test_refusals_and_what_there_is_not():
    machine = coarse("turbomolecular-pump")
    quiet = replace(machine, tolerances=())
    found = explore(quiet, law("turbomolecular-pump"), parts=["pulses"])
    assert found.pulses is None and "no tolerances" in " ".join(found.notes)
    with pytest.raises(InvalidInput, match="one of poles"):
        explore(machine, law("turbomolecular-pump"), parts=["poles", "zeros"])
    with pytest.raises(InvalidInput, match="the lower, then the higher"):
        explore(machine, law("turbomolecular-pump"), parts=["poles"], speed=(10.0, 1.0))
    with pytest.raises(InvalidInput, match="at least two"):
        pole_map(lambda value: None, "speed", "rad/s", [1.0], 1.0)


def test_what_only_a_continuous_loop_holds_is_not_stable(tmp_path):
    """The turboexpander's PID, of which nobody states a rate: lost at the one that others assume."""
    name = coarse_file("turboexpander", tolerances=False)
    call("synthesize", name, "--method", "pid", "-o", tmp_path / "pid.json")
    words = ["map", name, "--controller", tmp_path / "pid.json", "--what", "poles"]
    done = call(*words)
    assert done.exit_code == 1 and "As it would run" in done.stdout
    assert "10000 Hz and one sample late" in " ".join(done.stdout.split())
    told = json.loads(call(*words, "--json").stdout)
    assert not told["stable"] and all(item["stable"] for item in told["operating_points"])
    assert len(told["lost_at_the_assumed_rate"]) == 6
    fast = call(*words, "--rate-hz", 200_000, "--json")
    assert fast.exit_code == 0 and json.loads(fast.stdout)["lost_at_the_assumed_rate"] == []
