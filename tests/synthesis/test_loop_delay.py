"""The delay of the sampled loop in the design model: exact at low frequency, and worth designing
for.
"""

import numpy as np
import pytest

from ambrose import load_machine
from ambrose.core.checks import InvalidInput
from ambrose.core.frequency import frequency_response
from ambrose.core.sampling import c2d, delayed
from ambrose.core.statespace import select
from ambrose.judge.sampled import check_over_box
from ambrose.law.design_problem import apply_delay, open_model
from ambrose.law.loop import Timing
from ambrose.model.assemble import assemble
from ambrose.model.uncertainty import reduce
from ambrose.synthesis.design import design

pytestmark = pytest.mark.study  # minutes

SAMPLE = 1e-4


@pytest.fixture(scope="module")
def plant():
    return assemble(load_machine("seal-rig"))


def test_the_delay_counts_computing_and_half_a_sample_of_holding():
    assert Timing(1e-4).lag == pytest.approx(1.5e-4)
    assert Timing(1e-4, 0).lag == pytest.approx(0.5e-4)
    with pytest.raises(InvalidInput, match="sample time"):
        Timing(0.0)
    with pytest.raises(InvalidInput, match="computing delay"):
        Timing(1e-4, -1)


def test_only_the_currents_are_late(plant):
    model = open_model(reduce(plant), None, True)
    delay = 1.5e-4
    omega = 2 * np.pi * np.array([1.0, 30.0, 100.0])
    before, after = (
        frequency_response(select(item.system, item.u, item.y), omega).values
        for item in (model, apply_delay(model, delay))
    )
    turned = before * np.exp(-1j * omega * delay)[:, None, None]
    assert np.abs(after - turned).max() <= 1e-4 * np.abs(before).max()  # 0.004 degrees at 100 Hz
    same = [
        frequency_response(select(item.system, item.w, item.z), omega).values
        for item in (model, apply_delay(model, delay))
    ]
    np.testing.assert_allclose(same[1], same[0], rtol=1e-9)
    assert apply_delay(model, 0.0) is model


def test_a_controller_designed_for_its_delay_is_better_in_the_sampled_loop(plant):
    worst = []
    for rate in (None, 1 / SAMPLE):
        controller = design(plant, "mu", rate=rate).controller
        found = check_over_box(plant, delayed(c2d(controller, SAMPLE, "tustin"), 1))
        assert found.checks[0].value == 0
        worst.append(found["sampled.sensitivity.box"].value)
    assert worst[1] < 0.9 * worst[0]  # 3.32 against 3.91
