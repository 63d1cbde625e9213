"""Searches and bounds of worst cases against brute force: a few of the systems of benchmarks/worst_case_truth."""

from __future__ import annotations

import numpy as np
import pytest
from benchmarks import worst_case_truth


@pytest.mark.parametrize("seed", [27, 37, 47, 0, 5])
def test_between_search_and_bound_lies_the_truth(seed, monkeypatch):
    """27: crossings between the nominal poles' grid points; 37 and 47: poles that leave through zero."""
    monkeypatch.setattr(worst_case_truth, "_GRID", {1: 301, 2: 21})
    monkeypatch.setattr(worst_case_truth, "_POINTS", 200)
    row = worst_case_truth.compare(seed)
    assert row.proved <= row.margin_truth * (1 + 1e-9)
    assert row.margin_truth <= row.margin <= 1.01 * row.margin_truth
    assert 0.9 * row.margin_truth < row.proved
    assert row.worst >= 0.99 * row.gain_truth
    assert max(row.worst, row.gain_truth) <= row.bound * (1 + 1e-9)
    assert np.isfinite(row.bound)
