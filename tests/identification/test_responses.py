"""Parameters from frequency responses; the responses are those of the tests' own rig."""

from dataclasses import replace
from functools import cache
from pathlib import Path as FilePath

import numpy as np
import pytest
from independent_rig import Rig, numbers_of

import ambrose as amb
from ambrose.core.checks import InvalidInput
from ambrose.core.sampling import c2d
from ambrose.identification.findings import Code
from ambrose.machine.description import OperatingPoint
from ambrose.record.response import Path, Response

MACHINE = "seal-rig"
FILE = FilePath(amb.__file__).parent / "machines" / f"{MACHINE}.toml"
HERTZ = np.geomspace(5, 1500, 80)
UNKNOWN = ["bearing.*.force_per_current.*", "bearing.*.negative_stiffness.*"]


@cache
def machine():
    return amb.load_machine(MACHINE)


@cache
def controller():
    return amb.design(machine(), "pid").controller


@cache
def truth(factor=1.0):
    """S_o, T_o, S_i, G, K (w, a, a) and the values that are true, of the tests' own rig."""
    numbers = numbers_of(FILE)
    values = {}
    for k, bearing in enumerate(numbers["bearings"]):
        for quantity, key in (("force_per_current", "ki"), ("negative_stiffness", "ks")):
            bearing[key] = bearing[key] * (1 + factor * np.array([0.1, -0.08]) * (1 - 1.5 * k))
            for axis, value in zip(("zeta", "eta"), bearing[key], strict=True):
                values[f"bearing.{bearing['name']}.{quantity}.{axis}"] = value
    rig = Rig(numbers, linear=True)
    law = c2d(controller(), 1e-4, "tustin")
    G, K = rig.responses((law.A, law.B, law.C, law.D), 2 * np.pi * HERTZ)
    eye = np.eye(4)
    S, inner = np.linalg.inv(eye + G @ K), np.linalg.inv(eye + K @ G)
    return {"S": S, "T": G @ K @ S, "inner": inner, "motion": G @ inner, "G": G, "K": K}, values


def measured(quantities="ST", *, noise=0.01, seed=1, stated=True, diagonal=False, edit=None):
    found, _ = truth()
    rng = np.random.default_rng(seed)
    axes, paths = machine().axes, []
    for quantity in quantities.split() if " " in quantities else quantities:
        for i, j in np.ndindex(4, 4):
            if diagonal and i != j:
                continue
            value = found[quantity][:, i, j] if quantity != "L" else 1 / found["S"][:, i, i] - 1
            if quantity == "a":
                value = found["motion"][:, i, i] / found["inner"][:, i, i]
            floor = 0.1 * np.median(np.abs(found[quantity][:, 0, 0])) if quantity != "L" else 0.0
            size = noise * np.hypot(np.abs(value), floor)
            error = rng.normal(size=(2, len(HERTZ))) * size / np.sqrt(2)
            value = value + error[0] + 1j * error[1]
            variance = size**2 if stated and noise else None
            paths.append(Path(quantity, axes[i], axes[j], value, variance))
    paths = [edit(path) for path in paths] if edit else paths
    point = OperatingPoint(0.0, 0.0)
    return Response(machine().name, 2 * np.pi * HERTZ, tuple(paths), point, sample_rate_hz=1e4)


def identify(response, **options):
    return amb.identify(machine(), response, controller(), unknown=UNKNOWN, **options)


def off(done):
    _, values = truth()
    return {row.path: (row.value / values[row.path] - 1, row) for row in done.parameters}


@pytest.mark.parametrize(
    "how",
    [{}, {"quantities": "S"}, {"quantities": "L", "diagonal": True}, {"quantities": "G"},
     {"quantities": "motion "}, {"diagonal": True}, {"stated": False}],
)  # fmt: skip
def test_magnets_from_responses_with_one_percent_noise(how):
    done = identify(measured(**how))
    errors = off(done)
    limit = 0.01 if how.get("diagonal") else 0.004
    assert max(abs(error) for error, _ in errors.values()) < limit, errors
    for path, (error, row) in errors.items():
        assert abs(error * row.value) < 4 * row.standard_deviation, path
    assert not [finding for finding in done.findings if finding.code == Code.RESIDUALS]
