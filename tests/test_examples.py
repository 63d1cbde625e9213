"""Every example runs, and says what its text promises."""

import runpy
from pathlib import Path

import numpy as np
import pytest

from ambrose.core.statespace import is_stable

pytestmark = pytest.mark.study  # minutes

EXAMPLES = Path(__file__).parents[1] / "examples"


@pytest.fixture
def example(capfd):
    """The names of an example after it ran as a program, which has to print something, and no
    warnings.
    """

    def run(name):
        names = runpy.run_path(str(EXAMPLES / name), run_name="__main__")
        printed, warned = capfd.readouterr()
        assert printed.strip() and not warned
        return names

    return run


def test_machine_to_verdict(example):
    verdict = example("01_machine_to_verdict.py")["verdict"]
    # nominal, zero, twice nominal pressure
    assert [checks.stable for checks in verdict.points] == [True, True, False]
    peak = verdict["nominal pressure"]["sensitivity.output.max"]
    assert peak.value > 5
    assert peak.zone is None  # ISO 14839-3 judges axes
    assert verdict["zero pressure"].passed


def test_own_rotor(example):
    found = example("02_own_rotor.py")
    assert found["mass"] == pytest.approx(8 + 7850 * np.pi / 4 * 0.04**2 * 0.6, rel=1e-9)
    assert found["result"].status == "verified"
    # Free-free beam with a mass in the middle: the first mode falls below that of the bare shaft,
    # 22.373 sqrt(EI/(rho A L^4)).
    bare = 22.373 / (2 * np.pi) * np.sqrt(2.1e11 * 0.04**2 / 16 / 7850) / 0.6**2
    assert 0.6 * bare < found["bending_hz"][0] < bare


def test_seal_pressure(example):
    found = example("03_seal_pressure.py")
    # P5.5: stable at nominal, unstable at twice the nominal stiffness
    assert 0 < found["limit_full"] < 1
    assert found["limit"] == pytest.approx(found["limit_full"], abs=1e-3)


def test_three_controllers(example):
    verdicts = example("04_three_controllers.py")["verdicts"]
    margin = {
        method: verdict.tolerances["robust.stability.margin"].value
        for method, verdict in verdicts.items()
    }
    assert margin["pid"] < 1 < margin["hinf"] < margin["mu"]
    worst = {
        method: verdict.tolerances["robust.sensitivity.worst"].value
        for method, verdict in verdicts.items()
    }
    assert worst["mu"] < worst["hinf"]


def test_own_uncertain_plant(example):
    peaks = example("05_own_uncertain_plant.py")["peaks"]
    for peak in peaks.values():
        assert peak.lower == pytest.approx(peak.upper, rel=1e-3)
    assert peaks["mu"].upper < 0.8 * peaks["H-infinity"].upper


def test_youla(example):
    found = example("07_youla.py")
    assert found["theta"] == pytest.approx(0.5, abs=3 * found["deviation"])
    assert found["deviation"] < 0.01
    assert not is_stable(found["real"]) and is_stable(found["S"])


def test_identify(example):
    found = example("06_identify.py")
    identification, machine = found["identification"], found["machine"]
    values = [parameter.value for parameter in identification.parameters]
    truth = [*machine.bearings[0].force_per_current, *machine.bearings[1].force_per_current]
    # the weight has moved the working point: K_i -2, K_s +14 %
    assert values[:4] == pytest.approx(truth, rel=0.03)
    assert values[-1] == pytest.approx(machine.seals[0].k, rel=0.01)
    assert len(identification.machine.tolerances) == 10
    assert found["refusal"].startswith("channels are mixed up: y_A_zeta and y_A_eta are swapped")


def test_lpv(example):
    found = example("08_lpv.py")
    margins = found["margins"]
    assert found["lpv"].status == "verified"
    assert 1 <= margins["gamma_optimal"] / margins["pointwise_largest"] < 1.1
    # zone A of ISO 14839-3 on the full plant at every speed
    assert margins["full_sensitivity_peak"] < 3
    assert max(window.settling for window in found["windows"]) < 0.02  # P3.7
    assert [trace.outcome for trace in found["traces"].values()] == ["completed", "diverged"]


def test_deploy(example):
    found = example("09_deploy.py")
    deployment, verdict = found["deployment"], found["verdict"]
    assert deployment.problems == ()
    # what was read back out of the running code is what was designed
    for designed in deployment.checks:
        peak = verdict[designed.label]["sensitivity.output.max"].value
        assert peak == pytest.approx(designed["sensitivity.output.max"].value, rel=1e-9)
    assert [checks["sensitivity.output.max"].passed for checks in verdict.points] == [
        True,
        False,
        False,
    ]
    assert [trace.outcome for trace in found["runs"].values()] == ["completed"] * 3
    assert "unstable at twice nominal pressure" in found["refusal"]
    assert "malloc" not in found["files"]["seal_rig.c"]


def test_every_example_is_tried_above():
    text = Path(__file__).read_text(encoding="utf-8")
    assert [
        path.name for path in EXAMPLES.glob("*.py") if f'example("{path.name}")' not in text
    ] == []
