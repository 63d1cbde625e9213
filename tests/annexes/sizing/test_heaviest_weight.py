"""Bisection over the control weight, with mu given in closed form."""

from types import SimpleNamespace

import pytest

import ambrose as amb


@pytest.fixture
def mu_of(monkeypatch):
    """mu as a function of the factor on control_level."""
    machine = amb.load_machine("seal-rig")
    level = machine.weights.control_level

    def set_to(mu):
        monkeypatch.setattr(
            "ambrose.annexes.sizing.least.design",
            lambda plant, method: SimpleNamespace(
                gamma=mu(plant.machine.weights.control_level / level)
            ),
        )
        return amb.least(machine, "weight")

    return set_to


@pytest.mark.parametrize("border", [0.3, 1.0, 1.7, 11.0])
def test_the_border_lies_between_what_met_and_what_did_not(mu_of, border):
    found = mu_of(lambda factor: factor / border)
    assert found.value <= border * (1 + 1e-12) < found.refused <= 1.06 * found.value
    assert found.binding == "mu"


def test_where_every_weight_met_none_is_called_refused(mu_of):
    found = mu_of(lambda factor: 0.5)
    assert found.value >= 50 and found.refused == 0
    assert found.binding == "the largest that is tried"


def test_where_none_met_there_is_no_weight(mu_of):
    found = mu_of(lambda factor: 2.0)
    assert found.value == 0 and found.refused > 0
