"""The lateral rows of a controller file with a synchronous block, against the converged loop of the
tests' own rotor (``own_rotor``): the block takes the place of the controller at 1x.

| mode | what is left at 1x |
|---|---|
| current-free | no current: the rotor on the magnets' negative stiffness alone |
| force-free | k_i i = -k_s y_b, y_b by the straight line through what the sensors read |
| vibration-free | the sensors' places do not move; the magnets pull as they must |
| damping | u = -K (1 - D) y |
"""

import math
from dataclasses import replace

import numpy as np
import pytest

import ambrose as amb
from ambrose.annexes.rotordynamics import analysis as block_on
from ambrose.annexes.rotordynamics.analysis import with_blocks
from ambrose.annexes.rotordynamics.loop import shaft_loop
from ambrose.annexes.rotordynamics.result import Item
from ambrose.annexes.synchronous.block_loop import BlockTable, block_of
from ambrose.judge.controller_file import read_controller, write_controller
from ambrose.judge.result import Synthesis
from ambrose.law.law import law_of
from ambrose.law.loop import timing_of
from ambrose.law.pid import pid_controller
from ambrose.machine.file.toml import loads_machine
from own_rotor import Magnet, OwnRotor, written

TOP, BAND, DAMPED = 900.0, (420.0, 900.0), 0.3 - 0.2j
PROBES = ((0.35, 0.4),)


def rotor_of():
    """A rotor with a disc between two magnets and one beyond; sensors outboard of the magnets."""
    nodes = (0.0, 0.06, 0.12, 0.24, 0.35, 0.5, 0.6, 0.66, 0.8)
    mass = 7800 * math.pi / 4 * 0.06**2 * 0.8 + 9
    gain = (5e5 + 8e5) / 250
    T_d = 0.35 * mass * math.sqrt(1.6e6 / mass) / (250 * gain)
    magnets = tuple(
        Magnet(nodes[at], nodes[at + side], 250.0, 5e5, gain, 0.5, T_d)
        for at, side in ((2, -1), (6, 1))
    )
    discs = (4, 7.0, 0.04, 0.022), (8, 2.0, 0.006, 0.0035)
    return OwnRotor(nodes, (0.06,) * 8, discs, magnets, 0.003)


def own_solution(rotor, mode):
    """(speed, forces (2 n, k)) to modal displacements with the block converged, and to the coil
    currents (axes, k) [A].
    """
    two = np.eye(2)
    read = np.vstack([np.kron(two, rotor.row(item.sensor_at)) for item in rotor.bearings])
    push = np.vstack([np.kron(two, rotor.row(item.at)) for item in rotor.bearings])
    # displacements at the magnets by the straight line through the sensors
    line = np.array([[item.sensor_at, 1.0] for item in rotor.bearings])
    places = np.array([[item.at, 1.0] for item in rotor.bearings])
    between = np.kron(places @ np.linalg.inv(line), two)

    def solve(speed, forces):
        s, k = np.array(1j * speed), len(read)
        free = rotor.dynamic(s, speed, lambda item, s: 0 * s)
        magnet = rotor.bearings[0]
        if mode == "vibration-free":
            # D q = f + push^T k_i i, read q = 0
            whole = np.block([[free, -push.T], [read, np.zeros((k, k))]])
            both = np.linalg.solve(whole, np.vstack([forces, np.zeros((k, forces.shape[1]))]))
            return both[: len(free)], both[len(free) :] / magnet.k_i
        # k_i i = -pull read q
        pull = {
            "off": magnet.pull(s) * np.eye(k),
            "current-free": np.zeros((k, k)),
            "force-free": magnet.k_s * between / (1 + s / magnet.sensor),
            "damping": (1 - DAMPED) * magnet.pull(s) * np.eye(k),
        }[mode]
        q = np.linalg.solve(free + push.T @ pull @ read, forces)
        return q, -pull @ read @ q / magnet.k_i

    return solve


def own_rows(rotor, mode, low, high):
    """Largest reading [um p-p] and bias over the largest current, over a fine grid."""
    solve, cases = own_solution(rotor, mode), rotor.placements(TOP)
    speeds = np.linspace(low, high, 401)
    probes = [*PROBES, *((m.sensor_at, turn) for m in rotor.bearings for turn in (0, math.pi / 2))]
    motion = rotor.response(speeds, cases, lambda w, f: solve(w, f)[0])
    readings = rotor.readings(motion, probes)
    largest = max(float(y.max()) for name, y in readings.items() if "orbit" not in name)
    force = rotor.forces(cases)
    current = max(float(np.abs(solve(w, w**2 * force)[1]).max()) for w in speeds)
    return 2e6 * largest, 3.0 / current if current else math.inf


def block_for(mode):
    made = {} if mode != "damping" else {"leak": 2.0}
    # c = eps/(2 leak) T y of a block that leaks
    T = (DAMPED * 2 * made["leak"] * 0.1 / 2 if made else 1.0) * np.eye(4, dtype=complex)
    return block_of(mode, BAND, 0.1, BlockTable(np.array(BAND), np.array([T, T])), **made)


@pytest.fixture(scope="module")
def plain():
    """Rotor, machine, law and its analysis without a block."""
    rotor = rotor_of()
    machine = loads_machine(written(rotor, (TOP,), (400.0, TOP), PROBES, TOP), "own")
    law = pid_controller(machine.reference, machine)
    return rotor, machine, law, amb.lateral(machine, law, tolerances=False)


def of_file(path, law, mode):
    """A controller as its file has it, with a block."""
    return read_controller(
        write_controller(path / "c.json", Synthesis(law, synchronous=(block_for(mode),)))
    )


def test_a_block_in_the_controller_file_adds_its_rows(plain, tmp_path, monkeypatch):
    """All 27 rows were the same with and without it."""
    _, machine, law, off = plain
    said = Item("gain", "what verify says", "Ambrose", "", "own", 1.0, "-", "<=", 0.0, False)
    monkeypatch.setattr(block_on, "_judged", lambda item, words, progress: iter((said,)))
    with_block = amb.lateral(machine, of_file(tmp_path, law, "vibration-free"), tolerances=False)
    rows = {item.name: item for item in with_block.items}
    # off: as without a block; on: the same quantities beside them, and what verify says of it
    assert not any(item.name.startswith("synchronous") for item in off.items)
    assert all(rows.pop(item.name) == item for item in off.items)
    assert {"synchronous.1.vibration", "synchronous.1.capacity.unbalance"} <= set(rows)
    assert "synchronous.1.gain" in with_block.failed and not with_block.passed
    before = {item.name: item for item in off.items}
    for name, item in rows.items():
        alone = before.get(name.removeprefix("synchronous.1."))
        assert alone is None or item.value != pytest.approx(alone.value, rel=1e-2)


@pytest.mark.parametrize("mode", ["off", "current-free", "force-free", "vibration-free", "damping"])
def test_rows_are_those_of_the_converged_loop(plain, tmp_path, monkeypatch, mode):
    rotor, machine, law, off = plain
    if mode == "off":
        reading, _ = own_rows(rotor, mode, 400.0, TOP)
        (row,) = [item for item in off.items if item.name == "vibration"]
        assert row.value == pytest.approx(reading, rel=1e-3)
        return
    monkeypatch.setattr(block_on, "_judged", lambda item, words, progress: iter(()))
    file = law_of(of_file(tmp_path, law, mode))
    timing, top = timing_of(machine, file), machine.operation.nominal
    found = with_blocks(
        machine,
        file,
        (None, None),
        off.response,
        lambda speed: shaft_loop(off.layout, replace(top, speed=speed, label=""), file, timing),
        off.speeds,
        off.scale[0],
        (),
        lambda text: None,
    )
    rows = {item.name: item for item in found}
    reading, capacity = own_rows(rotor, mode, *BAND)
    row = rows["synchronous.1.vibration"]
    assert mode in row.title
    assert row.value == pytest.approx(reading, rel=1e-3, abs=1e-6)
    load = rows["synchronous.1.capacity.unbalance"]
    if mode == "current-free":  # a capacity of 2e16 stood there: 3 A over rounding
        assert (load.value, load.limit, load.passed) == (None, None, True)
        assert "no current" in load.note
    else:
        assert load.value == pytest.approx(capacity, rel=1e-3)
        assert load.passed is (capacity >= 1)
