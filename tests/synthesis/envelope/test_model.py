"""Several operating points as one uncertain plant: closing its blocks gives the points back."""

from dataclasses import replace

import numpy as np
import pytest

import ambrose as amb
from ambrose.core.frequency import frequency_response
from ambrose.core.lft import close_uncertainty
from ambrose.machine.description import OperatingPoint, Tolerance
from ambrose.model.assemble import assemble
from ambrose.model.uncertainty import free_mode_reduction, perturbed
from ambrose.synthesis.order_selection import envelope_model

OMEGA = np.geomspace(10, 5000, 12)
POINTS = (OperatingPoint(label="rest"), OperatingPoint(600.0, 1.5e5, label="full"))


@pytest.fixture(scope="module")
def machine():
    m = amb.load_machine("seal-rig")
    return replace(m, operation=replace(m.operation, points=POINTS, design_point=""), tolerances=())


def reduced(machine, modes=1):
    return [
        free_mode_reduction(assemble(machine, point), modes) for point in machine.operation.points
    ]


def response(system, plant):
    part = amb.select(system, list(plant.named("u")), list(plant.named("y")))
    return frequency_response(part, OMEGA).values


def test_two_points_are_the_ends_of_one_parameter(machine):
    plants = reduced(machine)
    model = envelope_model(plants)
    (block,) = model.blocks
    assert block.name == "envelope 1"
    ends = [response(close_uncertainty(model, {block.name: end}), plants[0]) for end in (-1.0, 1.0)]
    wanted = [response(plant.system, plant) for plant in plants]
    scale = np.abs(wanted[0]).max()
    straight = max(np.abs(end - point).max() for end, point in zip(ends, wanted, strict=True))
    crossed = max(
        np.abs(end - point).max() for end, point in zip(reversed(ends), wanted, strict=True)
    )
    assert min(straight, crossed) < 1e-8 * scale
    assert max(straight, crossed) > 1e-3 * scale


def test_tolerances_keep_their_share_of_each_points_own_value(machine):
    """k is zero at rest: there its tolerance does nothing; under pressure it moves the plant as
    perturbed does.
    """
    k = Tolerance("seal.center.k", relative=0.5)
    plants = reduced(machine)
    model = envelope_model(plants, [k])
    assert [block.name for block in model.blocks] == ["envelope 1", "seal.center.k"]
    full = response(perturbed(plants[1], {k.parameter: 1.0}, [k]).system, plants[1])
    found = [
        response(close_uncertainty(model, {"envelope 1": end, k.parameter: 1.0}), plants[0])
        for end in (-1.0, 1.0)
    ]
    assert min(np.abs(item - full).max() for item in found) < 1e-7 * np.abs(full).max()


def test_refusals(machine):
    same = replace(machine, operation=replace(machine.operation, points=(POINTS[0],)))
    with pytest.raises(
        amb.InvalidInput,
        match="the same at every operating point of the machine; leave envelope out",
    ):
        envelope_model(reduced(same))
    with pytest.raises(amb.InvalidInput, match="left out with method pid; it goes with hinf or mu"):
        amb.design(machine, "pid", envelope=True)


@pytest.mark.study
def test_one_controller_of_the_turboexpander_holds_all_points_by_d_k_iteration():
    """At one point each method loses others (H-infinity four of six); over the envelope all six are
    held on the full plant.
    """
    single = amb.design("turboexpander", "hinf")
    whole = amb.design("turboexpander", "hinf", envelope=True)
    assert max(single.certificate.envelope.values()) > 0
    assert max(whole.certificate.envelope.values()) < 0
    assert len(whole.certificate.envelope) == 6
