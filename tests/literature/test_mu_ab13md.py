"""The mixed upper bound against SLICOT's AB13MD, where that applies: reals not repeated, square
complex full blocks.

The numbers and the recipe of the matrices are in mu_ab13md.json. AB13MD minimises the same (D, G)
bound by another algorithm.
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from ambrose.core.lft import FullBlock, RealBlock
from ambrose.core.mu.bounds import mu_bounds

REFERENCE = json.loads(Path(__file__).with_name("mu_ab13md.json").read_text(encoding="utf-8"))


@pytest.mark.literature
@pytest.mark.parametrize("case", REFERENCE["cases"], ids=lambda case: case["name"])
def test_upper_bound_equals_ab13md(case):
    rng = np.random.default_rng(case["seed"])
    n = sum(case["sizes"])
    M = rng.standard_normal((case["count"], n, n)) + 1j * rng.standard_normal((case["count"], n, n))
    # the same matrices
    assert [M[0, 0, 0].real, M[0, 0, 0].imag] == pytest.approx(case["first"], rel=1e-12)
    blocks = [
        RealBlock(f"d{i}") if kind == 1 else FullBlock(f"f{i}", size, size)
        for i, (size, kind) in enumerate(zip(case["sizes"], case["types"], strict=True))
    ]
    result = mu_bounds(M, blocks, tolerance=1e-6)
    assert result.upper == pytest.approx(case["mu"], rel=1e-6)
    assert (result.lower <= np.array(case["mu"]) * (1 + 1e-9)).all()
