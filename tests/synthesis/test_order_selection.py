"""The lowest order at a stated loss: judged in the sampled loop, never by Hankel values alone."""

from dataclasses import replace

import numpy as np
import pytest

from ambrose import load_machine
from ambrose.core.checks import InvalidInput, UnstableSystem
from ambrose.law.design_problem import apply_delay, design_plant, machine_weights, open_model
from ambrose.law.loop import Timing
from ambrose.model.assemble import assemble
from ambrose.model.uncertainty import reduce
from ambrose.synthesis.hinf import hinf_synthesis
from ambrose.synthesis.order_selection import find_lowest_order, sampled_sensitivity

pytestmark = pytest.mark.study  # minutes

SAMPLE = 1e-4


@pytest.fixture(scope="module")
def task():
    """Problem with the sampled loop's delay, an H-infinity controller of it, the measure."""
    plant = assemble(load_machine("seal-rig"))
    weights = machine_weights(plant.machine)
    problem, nominal = (
        design_plant(
            apply_delay(open_model(reduce(plant), None, flag), Timing(SAMPLE).lag),
            weights,
            uncertain=flag,
        )
        for flag in (True, False)
    )
    return (
        problem,
        hinf_synthesis(nominal).controller,
        sampled_sensitivity(reduce(plant, 1), Timing(SAMPLE)),
    )


def test_reduction_stays_within_the_stated_loss(task):
    problem, controller, measure = task
    orders = []
    for loss in (0.01, 0.2):
        found = find_lowest_order(problem, controller, measure, loss, polishing=False)
        assert found.reference == measure(controller)
        assert found.measure == measure(found.controller) <= (1 + loss) * found.reference
        orders.append(found.controller.n_states)
        beyond = [value for order, _, value in found.tried if order < found.controller.n_states]
        assert beyond  # it went on until the loss was passed
        assert min(beyond) > (1 + loss) * found.reference
    assert orders[1] <= orders[0] < controller.n_states


def test_polishing_reaches_orders_that_reduction_does_not(task):
    problem, controller, measure = task
    reduced = find_lowest_order(problem, controller, measure, 0.0, polishing=False)
    polished = find_lowest_order(problem, controller, measure, 0.0, rounds=1)
    assert polished.controller.n_states < reduced.controller.n_states
    assert polished.measure <= polished.reference


def test_refusals(task):
    problem, controller, measure = task
    with pytest.raises(InvalidInput, match="loss"):
        find_lowest_order(problem, controller, measure, -0.1)
    wrong = replace(controller, B=-controller.B)
    with pytest.raises(UnstableSystem, match="unstable in its loop"):
        find_lowest_order(problem, wrong, measure, 0.1)
    machine = replace(load_machine("seal-rig"), tolerances=())
    with pytest.raises(InvalidInput, match="tolerances"):
        sampled_sensitivity(reduce(assemble(machine)), Timing(SAMPLE))
    assert np.isinf(measure(wrong))
