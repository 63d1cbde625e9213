"""The loop's responses from every kind of excitation against the loop's own, which is known
exactly; what cannot be told.
"""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

import ambrose as amb
from ambrose.core.checks import InvalidInput
from ambrose.core.frequency import frequency_response
from ambrose.core.response import simulate
from ambrose.core.sampling import c2d
from ambrose.core.statespace import select
from ambrose.identification.frf import measure
from ambrose.law.loop import closed_loop
from ambrose.machine.description import OperatingPoint
from ambrose.record.record import Record
from ambrose.rig.scenario import Chirp, Prbs, Scenario, SteppedSine

HZ = 2 * np.pi
NOISE = 2e-8
DT = 1e-4
POINT = OperatingPoint()
BIT = {"bit_time": 1e-3, "order": 9}


@cache
def machine(name):
    return replace(amb.load_machine(name), tolerances=())


@cache
def law(name):
    return amb.design(machine(name), "pid")


@cache
def loop_of(name):
    """The sampled loop, exactly: what is added to the controller's output is held for a sample."""
    return closed_loop(
        amb.assemble(machine(name), POINT), c2d(law(name).law, DT, "tustin", delay=DT)
    )


def record(name, duration, **disturbances):
    """The sampled loop of a machine under a scenario's excitations, with noise of the sensors going
    around it.
    """
    wanted = amb.simulate(
        machine(name),
        law(name),
        Scenario("test", duration, **disturbances),
        linear=True,
        point=POINT,
        rate=1e4,
    )
    e = [one for one in wanted.record.signals if one[:2] == "e_"]
    axes, found = machine(name).axes, wanted.record.select(e or wanted.record.signals[:1])
    outputs = [f"{kind}_{axis}" for kind in "yu" for axis in axes]
    noise = NOISE * np.random.default_rng(1).standard_normal((len(axes), found.values.shape[1]))
    driven = np.vstack([*(found[one][None] for one in e), noise])
    values = simulate(select(loop_of(name), [*e, *(f"d_{axis}" for axis in axes)], outputs), driven)
    units = (*("m" for _ in axes), *("A" for _ in axes), *("A" for _ in e))
    return Record(
        machine(name).name,
        1 / DT,
        (*outputs, *e),
        units,
        np.vstack([values, driven[: len(e)]]),
        POINT,
    )


def truth(name, loop, inputs, outputs):
    """The loop's own responses and, for v_, one more for an excitation of the same axis."""
    asked = [n.replace("v_", "u_") for n in outputs]
    values = frequency_response(select(loop_of(name), inputs, asked), loop.closed.omega).values
    for i, target in enumerate(outputs):
        for j, source in enumerate(inputs):
            values[:, i, j] += target.startswith("v_") and target[2:] == source[2:]
    return values


def inside(found, want):
    return np.mean(np.abs(found.values - want) <= found.radius())


@pytest.mark.parametrize(
    "name", ["seal-rig", pytest.param("three-bearing-train", marks=pytest.mark.study)]
)
def test_a_chirp_on_one_axis_tells_its_column(name):
    axis = machine(name).axes[0]
    loop = measure(
        [record(name, 8.0, chirps=(Chirp(f"e_{axis}", 0.05, 5 * HZ, 300 * HZ),))],
        machine(name).axes,
    )
    assert loop.method == "polynomials" and loop.plant is None
    assert 20 * HZ > loop.closed.omega[0] and 290 * HZ < loop.closed.omega[-1] < 320 * HZ
    want = truth(name, loop, [f"e_{axis}"], loop.closed.outputs)
    own = [loop.closed.outputs.index(f"{kind}_{axis}") for kind in "yv"]
    assert (
        np.median(np.abs(loop.closed.values - want)[:, own] / np.abs(want)[:, own]) < 0.035
    )  # measured 0.023, 0.027: the noise
    assert inside(loop.closed, want) > 0.9
    assert np.median(loop.motion.coherence[:, 0]) > 0.98


def test_sequences_that_repeat_are_averaged_and_give_the_plant():
    name = "seal-rig"
    axes = machine(name).axes
    loop = measure(
        [
            record(
                name,
                6.0,
                sequences=tuple(Prbs(f"e_{a}", 0.05, seed=i, **BIT) for i, a in enumerate(axes)),
            )
        ],
        axes,
    )
    assert (loop.method, loop.periods) == ("periods", 10)
    assert loop.together == tuple((f"e_{axis}",) for axis in axes)
    outputs = [f"y_{a}" for a in axes]
    assert inside(loop.motion, truth(name, loop, [f"e_{a}" for a in axes], outputs)) > 0.85
    plant = c2d(
        select(amb.assemble(machine(name), POINT).system, [f"u_{a}" for a in axes], outputs), DT
    )
    want = frequency_response(plant, loop.plant.omega).values
    assert inside(loop.plant, want) > 0.85
    off = np.linalg.norm(loop.plant.values - want, axis=(1, 2)) / np.linalg.norm(want, axis=(1, 2))
    assert off[loop.plant.omega < 100 * HZ].max() < 0.05


def test_sines_along_both_directions_in_one_record_on_all_bearings_alike():
    name = "three-bearing-train"
    axes = machine(name).axes
    zeta, eta = ([axis for axis in axes if axis.endswith(way)] for way in ("_zeta", "_eta"))
    frequencies = (20 * HZ, 45 * HZ, 90 * HZ)
    sines = tuple(
        SteppedSine(f"e_{axis}", 0.05, frequencies, 1.0, start=start)
        for way, start in ((zeta, 0.0), (eta, 3.0))
        for axis in way
    )
    loop = measure([record(name, 6.0, stepped_sines=sines)], axes)
    assert loop.method == "sines"
    assert loop.together == (tuple(f"e_{a}" for a in zeta), tuple(f"e_{a}" for a in eta))
    np.testing.assert_allclose(loop.closed.omega, frequencies, rtol=1e-4)
    every = truth(name, loop, [f"e_{a}" for a in (*zeta, *eta)], loop.motion.outputs)
    want = np.stack([every[:, :, :3].sum(axis=2), every[:, :, 3:].sum(axis=2)], axis=2)
    assert np.abs(loop.motion.values - want).max() < 0.02 * np.abs(want).max()


def test_short_sines_settle_as_long_as_they_can():
    name = "seal-rig"
    axis = machine(name).axes[0]
    sines = (SteppedSine(f"e_{axis}", 0.05, (10 * HZ, 40 * HZ), 0.5),)
    loop = measure([record(name, 1.0, stepped_sines=sines)], machine(name).axes)
    assert loop.method == "sines" and len(loop.closed.omega) == 2


def test_what_cannot_be_told():
    name = "seal-rig"
    axes = machine(name).axes
    silent = record(name, 1.0)
    with pytest.raises(InvalidInput, match="have no excitation"):
        measure([silent], axes)
    chirp = record(name, 4.0, chirps=(Chirp(f"e_{axes[0]}", 0.05, 5 * HZ, 300 * HZ),))
    with pytest.raises(InvalidInput, match="does not repeat"):
        measure([chirp], axes, method="periods")
    with pytest.raises(InvalidInput, match="sines or periods or polynomials"):
        measure([chirp], axes, method="guess")
    without = chirp.select([one for one in chirp.signals if one[:2] != "u_"])
    assert isinstance(without, Record)
    loop = measure([without], axes)
    assert not loop.commanded and loop.plant is None
