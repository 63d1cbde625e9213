"""A loop at a glance says what the whole verdict says, on the same plant."""

import numpy as np
import pytest

from ambrose.annexes.workbench.screens.controllers import glance
from ambrose.judge.nominal import check
from ambrose.judge.plants import full_plants
from ambrose.law.loop import running_law, timing_of
from ambrose.law.pid import pid_controller
from ambrose.machine.file.toml import load_machine
from ambrose.model.uncertainty import default_bending_modes, reduce


@pytest.mark.parametrize("name", ["seal-rig", "flywheel"])
def test_it_agrees_with_the_verdict(name):
    machine = load_machine(name)
    law = pid_controller(machine.controller, machine)
    timing = timing_of(machine, law)
    seen = []
    for full in full_plants(machine):
        plant = reduce(full, default_bending_modes(full))
        look = glance(plant, law, timing)
        whole = check(plant, running_law(law, plant, timing))
        assert look.stability.stable == whole.stable
        seen.append(whole.stable)
        if not whole.stable:
            assert look.peak == np.inf
            continue
        axes = [c for c in whole.checks if c.name.startswith("sensitivity.output.")]
        worst = max(item.value for item in axes if not item.name.endswith(".max"))
        # the verdict refines its peaks between the points of a grid
        assert look.peak == pytest.approx(worst, rel=0.03)
        # one letter, of the axes, and the verdict of the same limits
        own, together = look.checks
        axis = max(axes[1:], key=lambda item: item.value)
        assert (own.zone, own.limit, own.passed) == (axis.zone, axis.limit, axis.passed)
        assert together.zone is None
        assert together.value == pytest.approx(axes[0].value, rel=0.03)
        assert (together.limit, together.passed) == (axes[0].limit, axes[0].passed)
        # S_ii = 1/(1 + L_i)
        assert 1 / np.abs(1 + look.loci).min() == pytest.approx(look.peak, rel=1e-9)
    assert seen[0]
    assert (False in seen) == (name == "seal-rig")
