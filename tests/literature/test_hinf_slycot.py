"""Our H-infinity norms against those that SLICOT's AB13DD found for the same 264 random systems."""

import json
from pathlib import Path

import numpy as np
import pytest

from ambrose.core.norms import hinf_norm
from ambrose.core.statespace import StateSpace
from random_systems import KINDS, random_system

pytestmark = pytest.mark.literature
DATA = json.loads((Path(__file__).parent / "hinf_slycot.json").read_text(encoding="utf-8"))
TOLERANCE = 2e-6  # one for each side's bisection


def exact_gain(A, B, C, D, dt, omega):
    """sigma_max at omega; the solve is refined with residuals in extended precision."""
    s = 1j * omega if dt is None else np.exp(1j * omega * dt)
    t = np.sqrt(
        np.maximum(np.linalg.norm(B, axis=1), 1e-280)
        / np.maximum(np.linalg.norm(C, axis=0), 1e-280)
    )
    # exact: this system's norm moves by 1e-7 when its entries move by eps
    t = np.exp2(np.round(np.log2(t)))
    A = A * t / t[:, None]
    B = B / t[:, None]
    C = C * t
    matrix = s * np.eye(len(A)) - A
    X = np.linalg.solve(matrix, B.astype(complex))
    for _ in range(3):
        X = X + np.linalg.solve(matrix, (B - matrix.astype(np.clongdouble) @ X).astype(complex))
    return np.linalg.norm(C @ X + D, 2)


@pytest.mark.parametrize(
    "kind",
    KINDS,
)
def test_norms_agree_or_ours_is_attained(kind):
    """Where the two differ, evaluating G at our frequency must show that the larger norm is ours,
    and is right.
    """
    differ = []
    cases = [row for row in DATA["systems"] if row[0] == kind]
    assert len(cases) == 24
    for _, seed, states, theirs, _ in cases:
        A, B, C, D, dt = random_system(kind, seed)
        assert len(A) == states
        ours = hinf_norm(StateSpace(A, B, C, D, dt=dt))
        if abs(ours.value / theirs - 1) > TOLERANCE:
            assert ours.value > theirs
            assert exact_gain(A, B, C, D, dt, ours.frequency) == pytest.approx(ours.value, rel=1e-8)
            differ.append((seed, ours.value / theirs - 1))
    # AB13DD's value for one lightly damped rotor, seed 20, is 3.0e-6 too low
    assert [seed for seed, _ in differ] in ([], [20] if kind == "rotor" else [])
