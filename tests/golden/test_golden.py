"""We did not change: key figures of the bundled machines and controllers, as they were when last
looked at.

A difference is not an error by itself. Look at it, and if it is meant, `python
tests/golden/test_golden.py` writes the new figures; the commit says why they moved.
"""

import json
from pathlib import Path

import numpy as np
import pytest

from ambrose import load_machine
from ambrose.chain.check import facts
from ambrose.judge import nominal
from ambrose.model.assemble import assemble
from ambrose.synthesis.design import design

HERE = Path(__file__).with_name("golden.json")
CHECKS = (
    "sensitivity.output.max",
    "compliance.max",
    "unbalance.orbit_0p",
    "impulse.displacement_0p",
    "margin.disk.output",
)


GROUPS = ("seal-rig", "turboexpander", "seal-rig pid", "seal-rig hinf")


def figures(group):
    """The facts of a machine, or the nominal checks of its loop with the controller of a method."""
    name, _, method = group.partition(" ")
    if method:
        plant = assemble(load_machine(name))
        checks = nominal.check(plant, design(plant, method).controller)
        return {name: checks[name].value for name in CHECKS}
    plain = {
        key: value
        for key, value in facts(load_machine(name)).items()
        if isinstance(value, int | float | list) and value
    }
    return {
        key: value
        for key, value in plain.items()
        if not isinstance(value, list) or not isinstance(value[0], dict)
    }


@pytest.mark.parametrize("group", [*GROUPS[:2], *(name for name in GROUPS[2:])])
def test_figures_are_what_they_were(group):
    now, stored = figures(group), json.loads(HERE.read_text())
    then = stored[group]
    assert tuple(stored) == GROUPS and now.keys() == then.keys()
    for name, value in then.items():
        if isinstance(value, list) and value and isinstance(value[0], str):
            assert now[name] == value, name
        else:  # a controller of a gamma iteration moves within its tolerance
            scale = np.abs(np.ravel(value)).max()
            close = (2e-3 if "hinf" in group else 1e-5) * scale
            if name == "mesh_error":  # a relative difference of two frequencies: their rounding
                close += 1e-9
            difference = np.abs(np.sort(np.ravel(now[name])) - np.sort(np.ravel(value))).max()
            assert difference <= close, (name, value, now[name])


if __name__ == "__main__":
    HERE.write_text(json.dumps({group: figures(group) for group in GROUPS}, indent=1) + "\n")
