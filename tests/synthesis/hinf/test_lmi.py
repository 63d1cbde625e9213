"""Two ways to H-infinity control, Riccati equations and matrix inequalities, against each other."""

from __future__ import annotations

import sys

import numpy as np
import pytest

from ambrose.core.checks import InvalidInput
from ambrose.core.hinf_lmi import smallest_gamma
from ambrose.core.hinf_riccati import scale_plant
from ambrose.core.lft import GeneralizedPlant
from ambrose.core.matrix_inequalities import smat, svec
from ambrose.core.statespace import StateSpace
from ambrose.synthesis.hinf import hinf_synthesis
from random_plants import KINDS, random_plant


def plant(kind: str, seed: int) -> GeneralizedPlant:
    A, B, C, D, m, p = random_plant(kind, seed)
    s = StateSpace(A, B, C, D)
    return GeneralizedPlant(s, s.inputs[:-m], s.inputs[-m:], s.outputs[:-p], s.outputs[-p:])


def test_svec_keeps_inner_products():
    rng = np.random.default_rng(0)
    X, Y = (M + M.T for M in rng.standard_normal((2, 5, 5)))
    assert svec(X) @ svec(Y) == pytest.approx(np.trace(X @ Y))
    np.testing.assert_allclose(smat(svec(X)), X, rtol=1e-15)


@pytest.mark.parametrize(
    ("kind", "seed"),
    [
        (k, s) if (k, s) in {("plain", 1), ("units", 1), ("light", 1)} else pytest.param(k, s)
        for k in KINDS
        if k != "singular"
        for s in (1, 2)
    ],
)
def test_gamma_within_a_thousandth_or_better_than_the_inequalities(kind, seed):
    """Where the solver's gamma is the larger one, a verified controller below it shows which of the
    two is wrong.
    """
    item = plant(kind, seed)
    gamma = smallest_gamma(scale_plant(item), lambda: 60.0).gamma
    result = hinf_synthesis(item, backoff=1.0005, tolerance=1e-5)
    optimal = result.certificate.margins["gamma_optimal"]
    assert optimal <= 1.001 * gamma
    assert optimal >= 0.999 * gamma or result.gamma < gamma


@pytest.mark.parametrize(
    ("kind", "seed"), [("plain", 1), ("scaled", 4), ("light", 5), ("weights", 0), ("rotor", 2)]
)
def test_controller_of_the_inequalities(kind, seed):
    """Verified like the other, at the same gamma, of the same order."""
    item = plant(kind, seed)
    lmi, riccati = hinf_synthesis(item, method="lmi"), hinf_synthesis(item)
    assert lmi.status == "verified"
    assert lmi.notes == ()
    assert lmi.controller.n_states == item.system.n_states
    assert lmi.gamma <= lmi.certificate.margins["gamma_designed"]
    assert lmi.certificate.margins["gamma_optimal"] == pytest.approx(
        riccati.certificate.margins["gamma_optimal"], rel=2e-3
    )


@pytest.mark.parametrize("seed", [2, 3, 6, 9])
def test_singular_plants(seed):
    """Regularised Riccati equations come within 1 % of the inequalities, which need no assumption;
    both are verified.
    """
    item = plant("singular", seed)
    exact = smallest_gamma(scale_plant(item), lambda: 60.0).gamma
    riccati = hinf_synthesis(item)
    assert riccati.certificate.margins["gamma_optimal"] == pytest.approx(exact, rel=0.01)
    assert riccati.gamma >= exact * 0.998
    assert riccati.notes
    lmi = hinf_synthesis(item, method="lmi")
    assert lmi.status == "verified"
    assert lmi.notes


def test_without_the_solver_the_message_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "clarabel", None)
    with pytest.raises(InvalidInput, match=r'pip install "ambrose\[lmi\]"'):
        hinf_synthesis(plant("plain", 1), method="lmi")
