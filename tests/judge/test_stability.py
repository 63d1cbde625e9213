"""One place says whether a law holds a plant: a map of whatever part is never green where it does
not hold.
"""

import numpy as np
import pytest

from ambrose.core.statespace import StateSpace
from ambrose.judge.exploration import PARTS, explore
from ambrose.judge.plants import describe, judge_points, judge_stability
from ambrose.law.pid import pid_controller
from ambrose.model.assemble import assemble
from ambrose.report.verification import exploration_page
from coarse import coarse

MACHINE = coarse("two-disc-rotor")
NOTHING = StateSpace(
    np.zeros((0, 0)), np.zeros((0, 4)), np.zeros((4, 0)), np.zeros((4, 4))
)  # the rotor falls


@pytest.mark.parametrize("part", PARTS)
def test_no_part_of_a_map_calls_an_unstable_loop_stable(part):
    """Before, a page of curves, orbits or pulses said "stable over the machine's own range"."""
    found = explore(MACHINE, NOTHING, parts=(part,))
    page = exploration_page(found)
    assert not found.stable
    assert page.result.passed is False
    assert "unstable at" in page.result.text
    assert "everywhere on the map" not in [verdict.text for verdict in page.verdicts]


def test_the_judge_agrees_with_eigenvalues_of_the_whole_loop():
    """The loop of plant and law written out as one matrix, by the test itself."""
    plant = assemble(MACHINE)
    law = pid_controller(MACHINE.reference, MACHINE)
    system = plant.system
    u = [system.inputs.index(name) for name in plant.named("u")]
    y = [system.outputs.index(name) for name in plant.named("y")]
    B, C = system.B[:, u], system.C[y]
    whole = np.block(
        [[system.A - B @ law.D @ C, B @ law.C], [-law.B @ C, law.A]]
    )  # x' = A x + B u, u = C_k x_k + D_k e, e = -y
    expected = np.linalg.eigvals(whole).real.max()
    found = judge_stability(plant, law, None)
    assert found.abscissa == pytest.approx(expected, rel=1e-6, abs=1e-6)
    assert found.stable == (expected < 0)
    assert "full plant" in found.model


def test_a_sentence_names_where_the_loop_is_lost():
    assert describe(()).startswith("not judged")
    held = judge_points(MACHINE, pid_controller(MACHINE.reference, MACHINE), None)
    assert describe(held).startswith("stable at all")
    lost = judge_points(MACHINE, NOTHING, None)
    assert describe(lost).startswith(f"unstable at {len(lost)} of {len(lost)}")
