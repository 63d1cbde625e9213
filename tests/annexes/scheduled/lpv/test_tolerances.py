"""LPV with the tolerances inside: the constant scaling, the corners, and the turboexpander over
speed and +-40 %.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np
import pytest

from ambrose import load_machine
from ambrose.annexes.scheduled.lpv.machine import (
    Worst,
    constant_scaling,
    plants_along,
    tolerant_lpv,
    worst_corners,
)
from ambrose.core.checks import InvalidInput
from ambrose.core.frequency import frequency_response
from ambrose.core.lft import close_uncertainty, lft
from ambrose.core.mu.bounds import mu_bounds
from ambrose.core.scheduled import ScheduledSystem
from ambrose.judge.result import certify
from ambrose.law.design_problem import (
    design_plant,
    open_model,
    unit_problem,
    with_performance_block,
)
from ambrose.model.assemble import assemble
from ambrose.model.uncertainty import free_mode_reduction
from ambrose.synthesis.design import design
from ambrose.synthesis.hinf import hinf_synthesis

HZ = 2 * np.pi


@pytest.fixture(scope="module")
def plant():
    machine = load_machine("turboexpander")
    return assemble(machine, next(p for p in machine.operation.envelope if "140 Hz" in p.label))


@pytest.fixture(scope="module")
def few(plant):
    """The plant with five of its tolerances and a controller for it without any."""
    machine = replace(plant.machine, tolerances=plant.machine.tolerances[:5])
    plant = assemble(machine, replace(plant.point, speed=20 * HZ))
    small = free_mode_reduction(plant, 0)
    return plant, hinf_synthesis(design_plant(small, uncertain=False), backoff=1.1).controller


def test_constant_scaling_is_the_bound_of_mu_at_one_frequency(few):
    """With one frequency nothing forbids the best D there, which mu's own upper bound finds by
    other means.
    """
    plant, law = few
    problem = with_performance_block(
        plants_along(plant, tolerances=plant.machine.tolerances)(plant.point.speed)
    )
    M = frequency_response(lft(problem, law), [2 * np.pi * 60]).values
    log_d = constant_scaling(problem, M, np.zeros(len(problem.blocks)))
    assert log_d[-1] == 0.0
    d = np.exp(log_d)
    d_z = np.repeat(d, [block.n_z for block in problem.blocks])
    d_w = np.repeat(d, [block.n_w for block in problem.blocks])
    scaled = np.linalg.svd(M[0] * d_z[:, None] / d_w, compute_uv=False)[0]
    upper = mu_bounds(M, problem.blocks, g_scaling=False, lower=False).upper[0]
    assert (
        scaled == pytest.approx(upper, rel=2e-3)
        and np.linalg.svd(M[0], compute_uv=False)[0] > 1.05 * upper
    )


def test_worst_corner_is_that_of_the_loops_closed_one_by_one(few):
    plant, law = few
    schedule = ScheduledSystem([0.0, 1e4], [law, law], "speed", "rad/s")
    speed, small = plant.point.speed, free_mode_reduction(plant, 0)
    found = worst_corners({speed: unit_problem(small)}, schedule)
    model, peaks = open_model(small, None, True), []
    for signs in product((-1.0, 1.0), repeat=5):
        member = close_uncertainty(
            model, dict(zip([block.name for block in model.blocks], signs, strict=True))
        )
        closed = certify(member, law, margins=False)
        assert closed.stable
        peaks.append(closed.closed_loop_norm)
    assert (found.unstable, found.members) == (0, 32)
    assert found.sensitivity == pytest.approx(max(peaks), rel=5e-3) and max(peaks) > 1.02 * min(
        peaks
    )


def test_an_interrupted_design_keeps_its_best_turn(few):
    plant, law = few
    speed, turns = plant.point.speed, []
    designed = hinf_synthesis(
        design_plant(free_mode_reduction(plant, 0), uncertain=False), backoff=1.1
    )

    def turn(plants, backoff):
        turns.append(plants(speed).blocks)
        if len(turns) > 1:
            raise KeyboardInterrupt
        return replace(
            designed, scheduled=ScheduledSystem([speed, 2 * speed], [law, law], "speed", "rad/s")
        )

    plants = [plants_along(plant, tolerances=plant.machine.tolerances)]
    best, worst, place, scaled = tolerant_lpv(
        plants, (np.array([speed, 2 * speed]),), turn, lambda law: Worst(5.0, 0, 4), 3.0
    )
    assert best.stopped_early == "interrupted" and (
        worst.sensitivity,
        place,
        scaled,
        len(turns),
    ) == (5.0, 0, False, 2)


def test_tolerances_are_refused_where_they_say_nothing(plant):
    with pytest.raises(InvalidInput, match=r"tolerances is given, but .* goes with lpv"):
        design(plant, "hinf", tolerances=True)
    bare = replace(plant, machine=replace(plant.machine, tolerances=()))
    with pytest.raises(InvalidInput, match="has no tolerances; add"):
        design(bare, "lpv", tolerances=True, speeds=(20 * HZ, 300 * HZ))


@pytest.mark.study
def test_turboexpander_over_speed_and_its_tolerances(plant):
    """Nominal LPV has unstable corners at 300 Hz; with the tolerances inside none, and S_o stays
    below the limit of 3.
    """
    found = design(plant, "lpv", speeds=(20 * HZ, 300 * HZ), tolerances=True)
    assert found.status == "verified" and found.weights.control_factor < 1
    margins = found.certificate.margins
    assert margins["unstable_corners"] == 0 and margins["corner_sensitivity"] < 3.0
    for hertz in (20, 100, 300):  # on the full plant, beside the model that was judged
        full = assemble(plant.machine, replace(plant.point, speed=hertz * HZ))
        held = certify(full, found.scheduled.at(hertz * HZ), margins=False)
        assert held.stable and held.closed_loop_norm < margins["corner_sensitivity"]
