"""Names of a machine file may have hyphens; in generated code they are underscores."""

import numpy as np
import pytest

import ambrose as amb
from ambrose.core.checks import InvalidInput
from ambrose.core.statespace import StateSpace

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
