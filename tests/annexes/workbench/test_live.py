"""The live rig behind its socket: frames on confirmation, orders, refusals in words, a record."""

import asyncio
import json
import struct
import threading

import numpy as np
import pytest

pytest.importorskip("starlette", reason="no starlette: install the extra workbench")

from ambrose.annexes.workbench import live as viewers, server
from ambrose.annexes.workbench.live import SAMPLES, Clock, LiveRoom, LiveSession, _Viewer, packed
from ambrose.annexes.workbench.project import Project, begin
from ambrose.annexes.workbench.server import build
from ambrose.core.checks import InvalidInput
from ambrose.core.processes import listening, names_of
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


class Ticking(Clock):
    """Goes on by 20 ms from frame to frame; ``busy`` [s] of a processor were used."""

    def __init__(self):
        self.frames, self.busy = 0, 0.0

    def now(self):
        self.frames += 1
        return 0.02 * self.frames

    def used(self):
        return self.busy


@pytest.fixture
def clock():
    return Ticking()


@pytest.fixture(scope="module")
def lasting(project):
    """One that goes on from test to test."""
    made = LiveSession(project, clock=Ticking())
    made.frame()
    return made


@pytest.fixture
def session(project, clock):
    """A live rig whose clock goes on by 20 ms from frame to frame."""
    made = LiveSession(project, clock=clock)
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


def test_what_takes_long_is_shown_slower_and_not_in_jerks(session, clock, monkeypatch):
    """A rotor in its touchdown bearings takes two to three seconds of a processor for one."""
    cost = [3e-4]
    advance = session.rig.advance

    def slow(count):
        clock.busy += count * cost[0]
        return advance(count)

    monkeypatch.setattr(session.rig, "advance", slow)
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
        *({"do": word} for word in ("__init__", "describe", ["knock"], {"knock": 1}, None, 1)),
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
    assert len(opened(packed(*lasting.frame()))[1])


async def turns(count):
    """Others come to their turn, so many times."""
    for _ in range(count):
        await asyncio.sleep(0)


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
            await turns(3 if wait else 1)
        viewer.confirmed.set()
        await turns(3)
        sender.cancel()

    asyncio.run(watched())
    assert [head["of"] for head, _ in sent] == [3, 5]  # the newest only
    assert sent[1][1].tolist() == list(range(3, 14))  # and nothing between is lost


def test_a_page_gets_frames_and_refusals_over_the_socket(project):
    tokens = []
    browser = Client(build(project, [HOST], tokens.append))
    browser.enter(tokens[0])
    said = ["not a JSON", {"do": "knock", "station": "C", "x": 1, "y": 0}, "x" * 5000]
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
        def __init__(self, *given):
            super().__init__(*given)
            rooms.append(self)

    monkeypatch.setattr(server, "LiveRoom", Room)
    tokens = []
    browser = Client(build(project, [HOST], tokens.append, Desk()))
    browser.enter(tokens[0])

    may_end = threading.Event()

    def end_the_record():
        may_end.wait()
        done.append("ended")

    async def run():
        rooms[0]._thread.submit(end_the_record)
        asked = asyncio.create_task(browser.request("POST", "/api/screens/records", b"{}"))
        await turns(50)
        may_end.set()
        return await asked

    assert asyncio.run(run()).status == 200
    assert done == ["ended", "records"]


class Page:
    """A page of the tests' own: what it says, and what it was told since (frames by their head)."""

    def __init__(self):
        self.inbox = asyncio.Queue()
        self.told = []

    async def accept(self):
        pass

    async def receive(self):
        return await self.inbox.get()

    async def send_text(self, text):
        self.told.append(json.loads(text))

    async def send_bytes(self, message):
        self.told.append(opened(message)[0])
        self.inbox.put_nowait({"type": "websocket.receive", "text": "ok"})

    def say(self, **message):
        self.inbox.put_nowait({"type": "websocket.receive", "text": json.dumps(message)})

    def leave(self):
        self.inbox.put_nowait({"type": "websocket.disconnect"})


class Free(Clock):
    """Time that goes by as soon as all others had their turn."""

    async def until(self, due):
        await asyncio.sleep(0)


@pytest.fixture
def room(monkeypatch):
    """A live room whose rigs stand in for true ones: each is built, and does what it is told, when
    it may.
    """
    made = LiveRoom(None, Free())
    made.built, made.may_build, made.may_do = [], threading.Semaphore(1), threading.Semaphore(1000)

    class Rig:
        def __init__(self, project, controller, initial, clock):
            made.built.append(self)
            self.number, self.controller, self.done = len(made.built), controller, []
            made.may_build.acquire()

        def describe(self):
            return {"number": self.number}

        def frame(self):
            return {"of": self.number}, np.zeros((3, self.number))

        def do(self, message):
            self.done.append(message)
            made.may_do.acquire()

        def pause(self):
            pass

    monkeypatch.setattr(viewers, "LiveSession", Rig)
    monkeypatch.setattr(viewers, "starting_form", lambda project: {})
    return made


async def so(condition):
    while not condition():
        await asyncio.sleep(0.001)


def watched(room, act, pages=1):
    """What ``act`` does with pages that look at the room's first rig."""

    async def run():
        looking = [Page() for _ in range(pages)]
        joined = [asyncio.create_task(room.join(page)) for page in looking]
        await so(lambda: all(any("of" in m for m in page.told) for page in looking))
        await act(*looking)
        for page in looking:
            page.leave()
        await asyncio.gather(*joined, return_exceptions=True)
        await room.close()

    asyncio.run(run())


@pytest.mark.parametrize("other", ["b.json", "a.json"])
def test_two_pages_that_start_again_within_one_build_see_the_rig_that_is_told(room, other):
    """Two rigs were driven, or one was driven and the other one knocked."""

    async def act(one, two):
        one.say(do="restart", controller="a.json")
        await so(lambda: len(room.built) == 2)
        two.say(do="restart", controller=other)
        await so(two.inbox.empty)
        await turns(20)
        for _ in range(4):
            room.may_build.release()
        newest = 2 + (other != "a.json")
        await so(lambda: {"rig": {"number": newest}} in two.told)
        await so(lambda: not room._build or room._build.done())
        one.told, two.told = [], []
        one.say(do="knock")
        await so(lambda: room.built[-1].done)
        await so(lambda: len(one.told) > 9 and len(two.told) > 9)
        assert len(room.built) == newest and room.built[-1].controller == other
        assert {m["of"] for m in one.told + two.told} == {newest}

    watched(room, act, pages=2)


def test_a_rig_that_cannot_be_built_by_a_mistake_leaves_the_one_before(room, monkeypatch):
    async def act(page):
        monkeypatch.setattr(viewers, "LiveSession", lambda *given: 1 / 0)
        page.say(do="restart", controller="a.json")
        await so(lambda: any("ZeroDivisionError" in m.get("failed", "") for m in page.told))
        page.told = []
        await so(lambda: {"of": 1} in page.told)

    watched(room, act)


def test_a_page_that_leaves_within_a_build_does_not_take_the_rig_along(room):
    async def act(one, two):
        one.say(do="restart")
        await so(lambda: len(room.built) == 2)
        one.leave()
        await so(lambda: len(room._viewers) == 1)
        room.may_build.release()
        await so(lambda: {"rig": {"number": 2}} in two.told)
        await so(lambda: {"of": 2} in two.told)

    watched(room, act, pages=2)


def test_what_is_forgotten_as_it_is_about_to_be_sent_ends_no_sender():
    """A rig that began anew between a frame and its sending: the page stood still for ever."""
    page = Page()

    async def run():
        viewer = _Viewer(page)
        sender = asyncio.create_task(viewer.send_frames())
        await turns(3)
        viewer.offer({"of": 1}, np.zeros((3, 1)))
        viewer.forget()
        await turns(3)
        viewer.offer({"of": 2}, np.zeros((3, 2)))
        await turns(3)
        sender.cancel()

    asyncio.run(run())
    assert [head["of"] for head in page.told] == [2]


def test_a_sender_that_fails_ends_the_socket_so_that_the_page_comes_back(room):
    async def run():
        page = Page()
        page.send_bytes = None  # no function: a mistake
        with pytest.raises(TypeError):
            await room.join(page)
        assert not room._viewers
        await room.close()

    asyncio.run(run())


def test_of_a_slider_the_newest_alone_is_done(room):
    """Each of hundred values was set, one after the other."""

    async def act(page):
        while room.may_do.acquire(blocking=False):
            pass
        page.say(do="speed", value=-1.0)
        await so(lambda: room.built[0].done)  # and lasts
        for value in range(100):
            page.say(do="speed", value=value)
            page.say(do="gain", value=value)
        page.say(do="knock")
        for value in range(200, 210):
            page.say(do="speed", value=value)
        await so(page.inbox.empty)
        room.may_do.release(1000)
        await so(lambda: len(room.built[0].done) >= 5)
        await turns(50)
        done = [(m["do"], m.get("value")) for m in room.built[0].done]
        assert done == [
            ("speed", -1.0),
            ("speed", 99),
            ("gain", 99),
            ("knock", None),
            ("speed", 209),
        ]

    watched(room, act)


def test_a_page_that_asks_for_too_much_at_once_is_told(room):
    async def act(page):
        while room.may_do.acquire(blocking=False):
            pass
        for _ in range(200):
            page.say(do="knock")
        await so(lambda: any("the rig is busy" in m.get("refused", "") for m in page.told))
        room.may_do.release(1000)
        page.told = []
        await so(lambda: {"of": 1} in page.told)
        assert len(room.built[0].done) < 100

    watched(room, act)


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

    monkeypatch.setattr("ambrose.annexes.workbench.live.design", designed)
    session = LiveSession(made)
    assert asked[1] == ("tuned", {"rate": 1e4, "delay_samples": 1})
    assert session.controller == "hinf.json" and not session._lost
    write_controller(made.path("controllers", "pid.json"), design(assemble(session.machine), "pid"))
    assert "pid.json is unstable on this machine" in LiveSession(made)._lost


def test_currents_are_those_of_the_coils(session):
    """4 A were drawn while every amplifier had failed: what the controller asked for."""
    view = session.describe()
    session.rig.drop()
    session.rig.advance(2000)
    log = session._shown(session.rig.advance(50).log)
    assert np.abs(log[:, view["currents"]]).max() < 1e-9
    assert np.abs(log[:, view["commands"]]).max() > 1.0
