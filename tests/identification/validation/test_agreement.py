"""Two methods' results beside each other: differences, what noise explains, and files that do not
belong together.
"""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from ambrose import load_machine
from ambrose.core.checks import InvalidInput
from ambrose.identification.validation.plausibility import compare
from ambrose.machine.description import OperatingPoint, Tolerance

K_I = "bearing.A.force_per_current.zeta"


STILL = OperatingPoint()


@dataclass
class Some:
    values: np.ndarray
    standard_deviations: np.ndarray
    paths: tuple = (K_I, "controller.delay")
    machine: str = "seal-rig"
    point: OperatingPoint = STILL


def other(value=150.0, **tolerance):
    machine = load_machine("seal-rig")
    first = replace(machine.bearings[0], force_per_current=(value, 140.0))
    tolerances = (Tolerance(K_I, **tolerance),) if tolerance else ()
    return replace(machine, bearings=(first, *machine.bearings[1:]), tolerances=tolerances)


def some(value=153.0, deviation=1.0):
    return Some(np.array([value, 1e-4]), np.array([deviation, 1e-7]))


def test_difference_and_what_noise_makes_of_it():
    (row,) = compare(some(), other(relative=0.01))  # the delay is nothing that a file holds
    assert (row.path, row.other, row.other_half_width) == (K_I, 150.0, pytest.approx(1.5))
    assert row.difference == pytest.approx(2.0) and row.half_width == pytest.approx(1.96)
    # first order
    assert row.difference_half_width == pytest.approx(100 * np.hypot(1.96 / 150, 153 / 150 * 0.01))
    assert row.agree is False
    (near,) = compare(some(deviation=2.0), other(absolute=1.5))
    assert near.agree and near.to_dict()["agree"] is True
    assert row.to_dict()["difference_percent"] == pytest.approx(2.0)
    (stated,) = compare(some(), other())
    assert stated.other_half_width == 0


def test_at_another_bias_the_other_file_speaks_of_that_bias():
    found = some()
    at_six = replace_point(found, OperatingPoint(bias_current=6.0))
    (row,) = compare(at_six, load_machine("seal-rig"))
    measured = next(
        item for item in load_machine("seal-rig").bearings[0].measured if item.bias_current == 6.0
    )
    assert row.other == pytest.approx(measured.force_per_current[0])


def replace_point(found, point):
    return Some(found.values, found.standard_deviations, point=point)


def test_files_that_do_not_belong_together():
    with pytest.raises(InvalidInput, match="the machine to compare with is 'turboexpander'"):
        compare(some(), load_machine("turboexpander"))
    only_delay = Some(np.array([1e-4]), np.array([1e-7]), paths=("controller.delay",))
    with pytest.raises(InvalidInput, match="only delays"):
        compare(only_delay, other())
