"""We did not change: key figures of the bundled machines and controllers, as they were when last looked at.

A difference is not an error by itself. Look at it, and if it is meant, `python tests/golden/test_golden.py` writes the new
figures; the commit says why they moved.
"""

import json
from pathlib import Path

import numpy as np

from ambrose import load_machine
from ambrose.plant.assemble import assemble
from ambrose.stages.plants import facts
from ambrose.synthesis.design import design
from ambrose.verification import nominal

HERE = Path(__file__).with_name("golden.json")
CHECKS = ("sensitivity.output.max", "compliance.max", "unbalance.orbit", "impulse.displacement", "margin.disk.output")


def figures():
    """Everything guarded: the facts of both machines, and the nominal checks of the seal rig's PID and H-infinity loops."""
    found = {}
    for name in ("seal-rig", "turboexpander"):
        known = facts(load_machine(name))
        plain = {key: value for key, value in known.items() if isinstance(value, int | float | list) and value}
        found[name] = {
            key: value for key, value in plain.items() if not isinstance(value, list) or not isinstance(value[0], dict)
        }
    plant = assemble(load_machine("seal-rig"))
    for method in ("pid", "hinf"):
        checks = nominal.check(plant, design(plant, method).controller)
        found[f"seal-rig {method}"] = {name: checks[name].value for name in CHECKS}
    return found


def test_figures_are_what_they_were():
    now, then = figures(), json.loads(HERE.read_text())
    assert now.keys() == then.keys()
    for group, values in then.items():
        assert now[group].keys() == values.keys(), group
        for name, value in values.items():
            if isinstance(value, list) and value and isinstance(value[0], str):
                assert now[group][name] == value, (group, name)
            else:  # a controller of a gamma iteration moves within its tolerance
                scale = np.abs(np.ravel(value)).max()
                close = (2e-3 if "hinf" in group else 1e-5) * scale
                difference = np.abs(np.sort(np.ravel(now[group][name])) - np.sort(np.ravel(value))).max()
                assert difference <= close, (group, name, value, now[group][name])


if __name__ == "__main__":
    HERE.write_text(json.dumps(figures(), indent=1) + "\n")
