"""What a machine's file and a controller's do not state, on a rig that shares nothing with the package: no
identification from it is silent. Of issue 49; both ended with 0.
"""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from benchmarks.rig_cases import CASES, CONVERTERS, MACHINES, Rig, as_record, excited, told
from independent_rig import numbers_of

import ambrose as amb
from ambrose.identification.findings import Code
from ambrose.identification.output_error.problem import deployed_controller
from ambrose.model.assemble import assemble

pytestmark = pytest.mark.study
BY_NAME = {case.machine: case for case in CASES}


@cache
def recorded(name, kinds, method="tustin", **settings):
    """Three seconds of a standing machine, every number as its file has it, under its PID, sampled by a
    method.
    """
    case = BY_NAME[name]
    machine, point, law, K = told(case, False)
    if method != "tustin":
        continuous = law.controller
        K = sampled_by(method, continuous, assemble(machine, point), 1 / case.rate)
    rig = Rig(numbers_of(MACHINES / f"{name}.toml", case.pressure), case.rate, **settings, **CONVERTERS)
    found = rig.run(K, excited(case, rig, 3.0, 0.03, 4e-4, 1), seed=2)
    return machine, as_record(case, rig, found, kinds), law


