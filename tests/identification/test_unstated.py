"""What neither the machine's file nor the controller's states, on a rig that shares nothing with the package:
no identification from it is silent. Of issue 49; both ended with 0.
"""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from benchmarks.rig_cases import CASES, CONVERTERS, MACHINES, Rig, as_record, excited, told

import ambrose as amb
from ambrose.core.sampling import c2d
from ambrose.identification.findings import Code
from ambrose.law.loop import match_controller
from ambrose.model.assemble import assemble
from independent_rig import numbers_of

pytestmark = pytest.mark.study
BY_NAME = {case.machine: case for case in CASES}
OFF = 3.0  # standard deviations beyond the 95 % interval: a value that is not said to be doubtful


@cache
def setting(name, method):
    """A machine, its continuous PID, and that sampled by a method."""
    case = BY_NAME[name]
    machine, point, _, _ = told(case, False)
    machine = replace(machine, controller=replace(machine.controller, sample_time=None, delay=None))
    law = amb.design(replace(machine, tolerances=()), "pid")
    plant = assemble(machine, point)
    K = c2d(match_controller(law, plant), 1 / case.rate, method=method)
    return machine, law, (K.A, K.B, K.C, K.D)


def run(name, kinds, method="tustin", **settings):
    """Three seconds of the standing machine with the numbers of its file; what identify says, with the
    slopes of the magnets by path.
    """
    case = BY_NAME[name]
    machine, law, K = setting(name, method)
    numbers = numbers_of(MACHINES / f"{name}.toml", case.pressure)
    rig = Rig(numbers, case.rate, **settings, **CONVERTERS)
    found = rig.run(K, excited(case, rig, 3.0, 0.03, 4e-4, 1), seed=2)
    truth = {}
    for quantity, slopes in zip(
        ("force_per_current", "negative_stiffness"), rig.slopes(K), strict=True
    ):
        for axis, value in zip(rig.axes, slopes, strict=True):
            bearing, _, way = axis.rpartition("_")
            truth[f"bearing.{bearing}.{quantity}.{way}"] = float(value)
    try:
        return amb.identify(machine, as_record(case, rig, found, kinds), law), truth
    except amb.InvalidInput as refused:
        return str(refused), truth


@pytest.mark.parametrize("kinds", ["yue", "ye"])
@pytest.mark.parametrize("name", BY_NAME)
def test_a_filter_of_2_khz_that_the_file_lacks_is_not_silent(name, kinds):
    """It took the bandwidth 38 to 49 % down, some 200 deviations, with status 0."""
    done, _ = run(name, kinds, anti_alias=2 * np.pi * 2000)
    assert not done.passed
    far = [str(item) for item in done.findings if item.code == Code.FAR_FROM_FILE]
    lag = done.parameters[[p.path.startswith("amplifier.") for p in done.parameters].index(True)]
    if not 2 / 3 < lag.value / lag.start < 1.5:
        assert any("anti-alias" in line and "bandwidth of every [[sensor]]" in line for line in far)


@pytest.mark.parametrize("delay", [0, 1, 2])
@pytest.mark.parametrize("method", ["tustin", "zoh", "backward-euler", "matched"])
@pytest.mark.parametrize("name", ["flywheel", "seal-rig"])
def test_a_continuous_file_where_a_digital_one_ran_is_not_silent(name, method, delay):
    """Without u: K_s was 10 deviations off, the bandwidth 16, with status 0 and not a word."""
    done, truth = run(name, "ye", method, delay=delay)
    if isinstance(done, str):
        assert "; " in done
        return
    assert any("was not checked against what ran" in note for note in done.remarks)
    assert any("nor how it is sampled: taken as by Tustin's rule" in note for note in done.remarks)
    off = [
        abs(row.value - truth.get(row.path, row.start)) / row.standard_deviation
        for row in done.parameters
    ]
    assert not done.passed or max(off) < 2 + OFF, (max(off), done.findings)
