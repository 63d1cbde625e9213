"""What happens to plants that the Riccati equations do not like: the bound from below stays one,
and there is another way.
"""

from __future__ import annotations

import numpy as np
import pytest
import scipy.linalg as sla

from ambrose.core.checks import NumericalFailure
from ambrose.core.hinf_riccati import scale_plant, unavoidable
from ambrose.core.lft import GeneralizedPlant
from ambrose.core.statespace import StateSpace
from ambrose.synthesis import hinf as module
from ambrose.synthesis.hinf import hinf_synthesis
from random_plants import random_plant


def plant(kind, seed):
    A, B, C, D, m, p = random_plant(kind, seed)
    s = StateSpace(A, B, C, D)
    return GeneralizedPlant(s, s.inputs[:-m], s.inputs[-m:], s.outputs[:-p], s.outputs[-p:])


def without_direct_terms(seed):
    """D = 0: many of these reach any gamma, so that what is left is the regularisation's."""
    rng = np.random.default_rng([5, seed])
    n = int(rng.integers(2, 7))
    m = int(rng.integers(1, 3))
    p = int(rng.integers(1, 3))
    q, r = int(rng.integers(1, 4)), int(rng.integers(1, 4))
    A = rng.standard_normal((n, n)) - 0.3 * np.eye(n)
    B = rng.standard_normal((n, q + m))
    C = rng.standard_normal((r + p, n))
    s = StateSpace(A, B, C, np.zeros((r + p, q + m)))
    return GeneralizedPlant(s, s.inputs[:q], s.inputs[q:], s.outputs[:r], s.outputs[r:])


def gahinet(integrators):
    """Example 7.3 of P. Gahinet, INRIA report 1992; with two free integrators for the controller it
    is COMPleib's ROC6.
    """
    k = integrators
    A = sla.block_diag([[1.0, -1.0, 0.0], [1.0, 1.0, -1.0], [0.0, 1.0, -2.0]], np.zeros((k, k)))
    B1, B2 = [[1.0, 2, 0], [0, -1, 0], [1, 1, 0]], [[1.0], [0], [1]]
    C1, C2 = [[0.0, 0, 0], [1, 1, 0], [-1, 0, 1]], [[0.0, -1, 1]]
    B = np.block(
        [
            [np.array(B1), np.zeros((3, k)), np.array(B2)],
            [np.zeros((k, 3)), np.eye(k), np.zeros((k, 1))],
        ]
    )
    C = np.block(
        [
            [np.array(C1), np.zeros((3, k))],
            [np.zeros((k, 3)), np.eye(k)],
            [np.array(C2), np.zeros((1, k))],
        ]
    )
    D = np.zeros((4 + k, 4 + k))
    D[0, -1] = D[-1, 2] = 1.0
    s = StateSpace(A, B, C, D)
    return GeneralizedPlant(s, s.inputs[:3], s.inputs[3:], s.outputs[:3], s.outputs[3:])


def test_integrators_that_coincide_are_all_mended():
    """Zeros that coincide on the axis have several directions. An integrator more for the
    controller changes no optimum.
    """
    alone = hinf_synthesis(gahinet(0)).certificate.margins["gamma_optimal"]
    both = hinf_synthesis(gahinet(2))
    assert any("w = 0, 0 rad/s" in note for note in both.notes)
    assert both.certificate.margins["gamma_optimal"] == pytest.approx(alone, rel=2e-3)
    assert not any("matrix inequalities" in note for note in both.notes)


def refused(*arguments):
    raise NumericalFailure("no gamma passes")


def test_matrix_inequalities_take_over(monkeypatch):
    pytest.importorskip("clarabel")
    usual = hinf_synthesis(gahinet(0))
    monkeypatch.setattr(module, "search_gamma", refused)
    other = hinf_synthesis(gahinet(0))
    assert other.notes[0].startswith(
        "designed by matrix inequalities (method lmi), for the Riccati equations failed:"
    )
    assert other.status == "verified"
    assert other.gamma == pytest.approx(usual.gamma, rel=5e-3)
    monkeypatch.setattr(module, "_LARGEST_LMI", 2)
    with pytest.raises(NumericalFailure, match=r"no gamma passes$"):
        hinf_synthesis(gahinet(0))


def test_without_their_solver_the_refusal_names_it(monkeypatch):
    monkeypatch.setattr(module, "search_gamma", refused)
    monkeypatch.setattr(module, "find_spec", lambda name: None)
    with pytest.raises(NumericalFailure, match=r'no gamma passes.*pip install "ambrose\[lmi\]"'):
        hinf_synthesis(gahinet(0))


def check_lower(item, **options):
    found = hinf_synthesis(item, **options)
    margins = found.certificate.margins
    assert margins["gamma_lower"] <= found.gamma <= margins["gamma_designed"] * (1 + 1e-5)
    return margins


def test_the_bound_from_below_is_one_of_the_plant_as_given():
    """The optimum of the regularised plant may lie above what the controller does on this one."""
    for seed in (1, 6, 11):
        assert check_lower(without_direct_terms(seed))["epsilon"] > 0
    for seed in range(2):
        assert check_lower(plant("singular", seed), backoff=1.0005)["epsilon"] > 0
    for kind in ("plain", "weights", "rotor", "light"):
        item = plant(kind, 3)
        margins = check_lower(item)
        assert margins["epsilon"] == 0
        # holds for every controller
        assert unavoidable(scale_plant(item)) <= margins["gamma_optimal"] * (1 + 1e-9)


@pytest.mark.study
@pytest.mark.parametrize("kind", ["singular", "without direct terms"])
def test_the_bound_from_below_on_200_regularised_plants(kind):
    for seed in range(100):
        item = plant(kind, seed) if kind == "singular" else without_direct_terms(seed)
        margins = check_lower(item, backoff=(1.0005, 1.03)[seed % 2])
        assert margins["epsilon"] > 0
