"""The lateral rows of a controller file with a synchronous block, against the converged loop of the
tests' own rotor (``own_rotor``): the block takes the place of the controller at 1x.

| mode | what is left at 1x |
|---|---|
| current-free | no current: the rotor on the magnets' negative stiffness alone |
| force-free | k_i i = -k_s y: the free rotor, but for the sensors' lag |
| vibration-free | the sensors' places do not move; the magnets pull as they must |
| damping | u = -K (1 - D) y |
"""

import math

import numpy as np
import pytest
from scipy.linalg import null_space

import ambrose as amb
from ambrose.annexes.rotordynamics import block_on
from ambrose.judge.controller_file import read_controller, write_controller
from ambrose.judge.result import Synthesis
from ambrose.law.pid import pid_controller
from ambrose.law.synchronous_table import BlockTable, block_of
from ambrose.machine.file.toml import loads_machine
from own_rotor import Magnet, OwnRotor, written

TOP, BAND, DAMPED = 900.0, (420.0, 900.0), 0.3 - 0.2j
PROBES = ((0.35, 0.4),)


def rotor_of(offset):
    """A rotor with a disc between two magnets and one beyond; sensors ``offset`` nodes outboard."""
    nodes = (0.0, 0.06, 0.12, 0.24, 0.35, 0.5, 0.6, 0.66, 0.8)
    mass = 7800 * math.pi / 4 * 0.06**2 * 0.8 + 9
    gain = (5e5 + 8e5) / 250
    T_d = 0.35 * mass * math.sqrt(1.6e6 / mass) / (250 * gain)
    magnets = tuple(
        Magnet(nodes[at], nodes[at + side * offset], 250.0, 5e5, gain, 0.5, T_d)
        for at, side in ((2, -1), (6, 1))
    )
    discs = (4, 7.0, 0.04, 0.022), (8, 2.0, 0.006, 0.0035)
    return OwnRotor(nodes, (0.06,) * 8, discs, magnets, 0.003)


def own_solution(rotor, mode):
    """(speed, forces (2 n, k)) to modal displacements with the block converged, and to the coil
    currents (magnets, 2, k) [A].
    """
    lag = {item: lambda s, w=item.sensor: 1 / (1 + s / w) for item in rotor.bearings}
    pulls = {
        "off": Magnet.pull,
        "current-free": lambda item, s: 0 * s,
        "force-free": lambda item, s: item.k_s * lag[item](s),
        "vibration-free": lambda item, s: 0 * s,
        "damping": lambda item, s: (1 - DAMPED) * item.pull(s),
    }
    pull, two = pulls[mode], np.eye(2)
    read = np.vstack([np.kron(two, rotor.row(item.sensor_at)) for item in rotor.bearings])
    push = np.vstack([np.kron(two, rotor.row(item.at)) for item in rotor.bearings])

    def solve(speed, forces):
        D = rotor.dynamic(np.array(1j * speed), speed, pull)
        if mode != "vibration-free":
            q = np.linalg.solve(D, forces)
            force = np.array([-pull(item, 1j * speed) * row @ q for item, row in
                              zip(rotor.bearings, read.reshape(2, 2, -1), strict=True)])
            return q, force / 250.0
        # D q = f + push^T k_i i, read q = 0
        k = len(read)
        whole = np.block([[D, -push.T], [read, np.zeros((k, k))]])
        both = np.linalg.solve(whole, np.vstack([forces, np.zeros((k, forces.shape[1]))]))
        return both[: len(D)], both[len(D) :].reshape(2, 2, -1) / 250.0

    return solve


def own_rows(rotor, mode, low, high):
    """Largest reading [um p-p] and bias over the largest current, over a fine grid."""
    solve = own_solution(rotor, mode)
    cases = rotor.placements(TOP)
    speeds = np.linspace(low, high, 2001)
    probes = [*PROBES, *((m.sensor_at, turn) for m in rotor.bearings for turn in (0, math.pi / 2))]
    motion = rotor.response(speeds, cases, lambda w, f: solve(w, f)[0])
    readings = rotor.readings(motion, probes)
    largest = max(float(y.max()) for name, y in readings.items() if "orbit" not in name)
    force = rotor.forces(cases)
    current = max(float(np.abs(solve(w, w**2 * force)[1]).max()) for w in speeds)
    return 2e6 * largest, 3.0 / current if current else math.inf


def with_block(rotor, mode, tmp_path):
    machine = loads_machine(written(rotor, (TOP,), (400.0, TOP), PROBES, TOP), "own")
    law = pid_controller(machine.reference, machine)
    made = {} if mode != "damping" else {"leak": 2.0}
    # c = eps/(2 leak) T y of a block that leaks
    T = (DAMPED * 2 * 2.0 * 0.1 / 2 if made else 1.0) * np.eye(4, dtype=complex)
    block = block_of(mode, BAND, 0.1, BlockTable(np.array(BAND), np.array([T, T])), **made)
    path = write_controller(tmp_path / "c.json", Synthesis(law, synchronous=(block,)))
    return machine, law, read_controller(path)


@pytest.mark.parametrize("mode", ["current-free", "force-free", "vibration-free", "damping"])
def test_rows_with_a_block_are_those_of_the_converged_loop(tmp_path, monkeypatch, mode):
    rotor = rotor_of(0 if mode == "force-free" else 1)
    machine, law, file = with_block(rotor, mode, tmp_path)
    monkeypatch.setattr(block_on, "_judged", lambda item, words, progress: iter(()))
    plain = {item.name: item for item in amb.lateral(machine, law).items}
    rows = {item.name: item for item in amb.lateral(machine, file).items}
    # off: as without a block; on: the same rows of the band beside them
    assert not any(name.startswith("synchronous") for name in plain)
    assert all(rows[name] == item for name, item in plain.items())
    reading, capacity = own_rows(rotor, "off", 400.0, TOP)
    assert rows["vibration"].value == pytest.approx(reading, rel=1e-3)
    reading, capacity = own_rows(rotor, mode, *BAND)
    on = rows["synchronous.1.vibration"]
    assert mode in on.title
    assert on.value == pytest.approx(reading, rel=1e-3, abs=1e-6)
    assert on.value != pytest.approx(rows["vibration"].value, rel=1e-2)
    load = rows["synchronous.1.capacity.unbalance"]
    if mode == "current-free":  # a capacity of 2e16 stood there: 3 A over rounding
        assert (load.value, load.limit, load.passed) == (None, None, True)
        assert "no current" in load.note
    else:
        assert load.value == pytest.approx(capacity, rel=1e-3)
        assert load.passed is (capacity >= 1)
