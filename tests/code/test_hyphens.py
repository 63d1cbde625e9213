"""Names of a machine file may have hyphens; in generated code they are underscores."""

from dataclasses import replace

import numpy as np
import pytest

import ambrose as amb
from ambrose.core.checks import InvalidInput
from ambrose.core.statespace import StateSpace
from ambrose.law.loop import match_axes

OPTIONS = {"rate": 20e3, "error_limit": 1e-4, "current_limit": 2.0, "force": True}


def law(*bearings):
    """Proportional control of two axes each, with a lag."""
    axes = [f"{name}_{axis}" for name in bearings for axis in ("zeta", "eta")]
    one = np.eye(len(axes))
    return StateSpace(
        -5e3 * one, one, 1e8 * one, 0 * one, [f"err_{a}" for a in axes], [f"u_{a}" for a in axes]
    )


@pytest.mark.parametrize("to", ["c", "st"])
def test_a_bearing_with_a_hyphen_is_written(to, tmp_path):
    done = amb.export(law("high-vacuum", "NDE"), tmp_path / "code", to=to, **OPTIONS)
    text = "".join(path.read_text(encoding="utf-8") for path in done.paths)
    assert "err_high_vacuum_zeta" in text and "err_high-vacuum_zeta" not in text


def test_names_that_only_a_hyphen_tells_apart_are_refused(tmp_path):
    with pytest.raises(InvalidInput, match="unique"):
        amb.export(law("high-vacuum", "high_vacuum"), tmp_path / "code", to="c", **OPTIONS)


def test_a_law_named_as_in_the_code_is_matched_with_the_machine():
    axes = ("high-vacuum_zeta", "high-vacuum_eta")
    back = StateSpace(
        np.zeros((0, 0)),
        np.zeros((0, 2)),
        np.zeros((2, 0)),
        np.array([[0.0, 1.0], [2.0, 0.0]]),
        ("err_high_vacuum_eta", "err_high_vacuum_zeta"),
        ("u_high_vacuum_zeta", "u_high_vacuum_eta"),
    )
    np.testing.assert_allclose(match_axes(back, axes).D, [[1.0, 0.0], [0.0, 2.0]])
    # where both spellings are axes of a machine, each name is its own
    both = ("a-b_zeta", "a_b_zeta")
    own = replace(
        back, inputs=("err_a_b_zeta", "err_a-b_zeta"), outputs=("u_a-b_zeta", "u_a_b_zeta")
    )
    np.testing.assert_allclose(match_axes(own, both).D, [[1.0, 0.0], [0.0, 2.0]])
