"""The live rig behind its socket: frames on confirmation, orders, refusals in words, a record."""

import asyncio
import json
import struct
import time

import numpy as np
import pytest

pytest.importorskip("starlette", reason="the extra workbench is not installed")

from ambrose.annexes.workbench import server
from ambrose.annexes.workbench.live import SAMPLES, LiveSession, packed
from ambrose.annexes.workbench.project import Project, begin
from ambrose.annexes.workbench.server import build
from ambrose.annexes.workbench.viewers import _Viewer
from ambrose.core.checks import InvalidInput
from ambrose.core.listening import listening, names_of
from ambrose.judge.controller_file import write_controller
from ambrose.model.assemble import assemble
from ambrose.record.files import read_record
from ambrose.synthesis.design import design
from asgi_client import HOST, Client


def opened(frame):
    """Head and samples of a message, read as its description says."""
    (length,) = struct.unpack_from("<I", frame)
    head = json.loads(frame[4 : 4 + length])
    return head, np.frombuffer(frame, "<f4", offset=4 + length)


@pytest.fixture(scope="module")
def project(tmp_path_factory):
    made = Project(tmp_path_factory.mktemp("project"))
    begin(made, "seal-rig")
    return made


@pytest.fixture(scope="module")
def lasting(project):
    """One that goes on from test to test."""
    made = LiveSession(project)
    made.frame()
    return made


@pytest.fixture
def session(project, monkeypatch):
    """A live rig whose clock goes on by 20 ms from frame to frame."""
    clock = iter(np.arange(0.0, 1e6, 0.02))
    monkeypatch.setattr(time, "perf_counter", lambda: float(next(clock)))
    made = LiveSession(project)
    made.frame()
    return made


def test_a_frame_is_the_time_that_went_by_in_the_frame_of_the_machine(session):
    session.do({"do": "knock", "station": "A", "x": 0.05, "y": 0.0})
    head, samples = opened(packed(*session.frame()))
    rows = samples.reshape(-1, len(session.columns))
    assert len(rows) == 200  # 20 ms at 10 kHz
    assert head["time"] == pytest.approx(0.02 + session.rig.dt)  # the first sample compiles
    # it went where it was pushed, along x, and the sensors at 45 degrees see it alike
    x = rows[:, session.columns.index("x A")]
    y = rows[:, session.columns.index("y A")]
    assert x.max() > 1e-6 and np.abs(y).max() < 0.3 * x.max()
    sensed = rows[:, session.columns.index("y A_zeta")]
    assert sensed.max() == pytest.approx((x / np.sqrt(2)).max(), rel=0.3)


def test_it_goes_slower_and_as_fast_as_it_can(session):
    session.do({"do": "pace", "pace": "slow"})
    begun = opened(packed(*session.frame()))[0]["time"]
    assert opened(packed(*session.frame()))[0]["time"] - begun == pytest.approx(0.002)
    session.do({"do": "pace", "pace": "fast"})
    begun = opened(packed(*session.frame()))[0]["time"]
    for _ in range(8):
        head, samples = opened(packed(*session.frame()))
    assert head["time"] - begun > 8 * 0.02
    assert len(samples) <= SAMPLES * len(session.columns)


def test_what_takes_long_is_shown_slower_and_not_in_jerks(session, monkeypatch):
    """A rotor in its touchdown bearings takes two to three seconds of a processor for one."""
    used, cost = [0.0], [3e-4]
    advance = session.rig.advance

    def slow(count):
        used[0] += count * cost[0]
        return advance(count)

    monkeypatch.setattr(session.rig, "advance", slow)
    monkeypatch.setattr(time, "thread_time", lambda: used[0])
    rows = [len(session.frame()[1]) for _ in range(4)]
    assert rows == [200, 66, 66, 66]  # 20 ms of a processor each
    for _ in range(40):  # frames of 20 ms in which a third of that time passes
        head, _ = session.frame()
    # over about a second
    assert head["realtime"] == pytest.approx(0.33 + 0.67 * np.exp(-43 * 0.02), abs=0.01)
    cost[0] = 1e-6
    assert [len(session.frame()[1]) for _ in range(4)] == [66, 132, 200, 200]


def test_all_that_can_be_done_shows_in_the_head(session, project):
    orders = [
        {"do": "speed", "value": 30.0},
        {"do": "pressure", "value": 1e5},
        {"do": "unbalance", "station": "A", "value": 1e-5},
        {"do": "gain", "value": 1.1},
        {"do": "excite", "value": 0.1},
        {"do": "switch", "controller": "pid.json"},
        {"do": "record", "name": "mine"},
        {"do": "fail", "what": "sensor", "axis": "A_zeta"},
    ]
    for order in orders:
        session.do(order)
    head, _ = opened(packed(*session.frame()))
    now = head["set"]
    assert (now["speed"], now["pressure"], now["gain"]) == (30.0, 1e5, 1.1)
    assert (now["station"], now["unbalance"]) == ("A", 1e-5)
    assert (head["excited"], head["record"]) == (0.1, "mine.h5")
    assert head["failed"] == ["sensor A_zeta"]
    session.do({"do": "stop"})
    record = read_record(project.path("records", "mine.h5"))
    assert set(np.unique(np.abs(record["e_A_zeta"]))) == {0.1}
    session.do({"do": "drop"})
    session.do({"do": "lift"})
    assert opened(packed(*session.frame()))[0]["failed"] == []


@pytest.mark.parametrize(
    "order",
    [
        None,
        [],
        {"do": "__init__"},
        {"do": "describe"},
        {"do": "knock", "station": "nowhere", "x": 1, "y": 1},
        {"do": "knock", "station": "A", "x": "1", "y": 1},
        {"do": "knock", "station": "A", "x": float("nan"), "y": 1},
        {"do": "knock", "station": "A", "x": True, "y": 1},
        {"do": "speed", "value": -1},
        {"do": "gain", "value": 0},
        {"do": "unbalance", "station": "A", "value": 1e300},
        {"do": "switch", "controller": "../../secret.json"},
        {"do": "switch", "controller": "absent.json"},
        {"do": "record", "name": "../out"},
        {"do": "fail", "what": "sensor", "axis": "Z"},
        {"do": "fail", "what": "everything"},
        {"do": "pace", "pace": "backwards"},
    ],
)
def test_what_makes_no_sense_is_refused_and_it_lives_on(lasting, order):
    with pytest.raises(InvalidInput):
        lasting.do(order)
    time.sleep(0.002)
    assert len(opened(packed(*lasting.frame()))[1])


def test_what_was_sampled_in_frames_that_a_page_missed_comes_with_the_next():
    sent = []

    class Socket:
        async def send_bytes(self, message):
            sent.append(opened(message))

    async def watched():
        viewer = _Viewer(Socket())
        sender = asyncio.create_task(viewer.send_frames())
        rows = iter(np.arange(6000.0).reshape(-1, 1))
        for length, wait in ((3, True), (2, True), (4, False), (5, False)):
            viewer.offer({"of": length}, np.array([next(rows) for _ in range(length)]))
            await asyncio.sleep(0.01 if wait else 0)
        viewer.confirmed.set()
        await asyncio.sleep(0.01)
        sender.cancel()

    asyncio.run(watched())
    assert [head["of"] for head, _ in sent] == [3, 5]  # the newest only
    assert sent[1][1].tolist() == list(range(3, 14))  # and nothing between is lost


def test_a_page_gets_frames_and_refusals_over_the_socket(project):
    tokens = []
    browser = Client(build(project, [HOST], tokens.append))
    browser.enter(tokens[0])
    said = ["no JSON", {"do": "knock", "station": "C", "x": 1, "y": 0}, "x" * 5000]
    frames = []

    def enough(message):
        frames.append(message.get("bytes") is not None)
        return sum(frames) >= 12

    sent = asyncio.run(browser.socket("/live", said=said, until=enough))
    words = [json.loads(m["text"]) for m in sent if m.get("text")]
    assert words[0] == {"building": True}
    assert words[1]["rig"]["stations"][:2] == ["A", "B"]
    refused = [message["refused"] for message in words if "refused" in message]
    assert len(refused) == 3 and "no station 'C'" in refused[1]
    times = [opened(m["bytes"])[0]["time"] for m in sent if m.get("bytes")]
    assert times == sorted(times)


def test_a_screen_waits_for_what_the_rig_was_told(project, monkeypatch):
    """The screen of records was drawn before a record that had just been ended was a file."""
    done = []
    rooms = []

    class Desk:
        async def ask(self, screen, action, given):
            done.append(screen)
            return {"blocks": [], "jobs": [], "whole": False}

    class Room(server.LiveRoom):
        def __init__(self, at):
            super().__init__(at)
            rooms.append(self)

    monkeypatch.setattr(server, "LiveRoom", Room)
    tokens = []
    browser = Client(build(project, [HOST], tokens.append, Desk()))
    browser.enter(tokens[0])

    def end_the_record():
        time.sleep(0.3)
        done.append("ended")

    async def run():
        rooms[0]._thread.submit(end_the_record)
        return await browser.request("POST", "/api/screens/records", b"{}")

    assert asyncio.run(run()).status == 200
    assert done == ["ended", "records"]


KNOWN = ("machine.toml", "controllers", "pid.json", "records", "mine.h5", "live.h5")
SOCKET = [
    b"\0" * 100,
    b'{"do": "drop"}',
    "",
    "[" * 3900,
    "9" * 3900,
    '{"do": "speed", "value": 1e999}',
    '{"do": "speed", "value": NaN}',
    {"do": "speed", "value": 10**400},
    {"do": ["knock"]},
    {"do": "_clock"},
    {"do": "restart", "controller": "../../secret.json"},
    {"do": "restart", "controller": {"a": 1}},
    {"do": "restart", "initial": "__class__"},
    {"do": "record", "name": "/tmp/x"},
    {"do": "record", "name": ["x"]},
]


def test_nothing_that_is_said_on_the_socket_ends_the_rig(project):
    tokens = []
    browser = Client(build(project, [HOST], tokens.append))
    browser.enter(tokens[0])
    last = {"do": "knock", "station": "nowhere", "x": 1, "y": 0}  # answered after all others

    def enough(message):
        return "nowhere" in (message.get("text") or "")

    sent = asyncio.run(browser.socket("/live", said=[*SOCKET, last], until=enough))
    words = [json.loads(m["text"]) for m in sent if m.get("text")]
    refused = [m for m in words if "refused" in m or "failed" in m]
    assert len(refused) == len(SOCKET) + 1
    heads = [opened(m["bytes"])[0] for m in sent if m.get("bytes")]
    assert heads[-1]["time"] > heads[0]["time"] and not heads[-1]["failed"]
    assert not [at for at in project.root.rglob("*") if at.name not in KNOWN]


@pytest.mark.parametrize("address", ["0.0.0.0", "::", "example.org", "203.0.113.7"])
def test_it_listens_nowhere_by_mistake(address):
    with pytest.raises(InvalidInput):
        listening(address, 0)


def test_loopback_goes_by_two_names():
    with listening("127.0.0.1", 0) as listener:
        port = listener.getsockname()[1]
        assert names_of(listener) == [f"127.0.0.1:{port}", f"localhost:{port}"]


def test_a_pid_that_does_not_hold_the_rig_is_not_the_first_controller(tmp_path, monkeypatch):
    """The turboexpander's fell over in its first second; it is said where it is chosen."""
    made = Project(tmp_path)
    begin(made, "turboexpander")
    asked = []

    def designed(plant, method, **options):
        asked.append((method, options))
        return design(plant, "pid" if method == "pid" else "hinf")  # which is quicker, and holds

    monkeypatch.setattr("ambrose.chain.first_controller.design", designed)
    session = LiveSession(made)
    assert asked[1] == ("tuned", {"rate": 1e4, "delay_samples": 1})
    assert session.controller == "hinf.json" and not session._lost
    write_controller(made.path("controllers", "pid.json"), design(assemble(session.machine), "pid"))
    assert "pid.json does not hold the machine" in LiveSession(made)._lost


def test_currents_are_those_of_the_coils(session):
    """4 A were drawn while every amplifier had failed: what the controller asked for."""
    view = session.describe()
    session.rig.drop()
    session.rig.advance(2000)
    log = session._shown(session.rig.advance(50).log)
    assert np.abs(log[:, view["currents"]]).max() < 1e-9
    assert np.abs(log[:, view["commands"]]).max() > 1.0
