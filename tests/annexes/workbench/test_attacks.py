"""Attacks on a server that runs, through its port: what clients send that no browser would, and
files that are another thing by the time they are sent. None comes through, and none ties it up.
"""

import json
import os
import re
import socket
import subprocess
import sys
import time

import pytest

pytest.importorskip("starlette", reason="no starlette: install the extra workbench")

from ambrose.annexes.workbench import server as served
from ambrose.annexes.workbench.project import Project
from asgi_client import HOST, Client

SOON = 300.0  # [s] for any answer: a hang, whatever else the computer does
HANDSHAKE = (
    "GET /live HTTP/1.1\r\nHost: {host}\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
    "Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\n"
)


class Running:
    """`ambrose workbench` of a folder, its port, and the cookie of its owner's browser."""

    def __init__(self, folder):
        words = [sys.executable, "-m", "ambrose", "workbench", str(folder), "--no-browser"]
        self.process = subprocess.Popen(words, stdout=subprocess.PIPE, text=True)
        said = ""
        while (found := re.search(r"(127\.0\.0\.1:(\d+))/(\?token=\S+)\s", said)) is None:
            line = self.process.stdout.readline()
            assert line, said
            said += line
        self.host, self.port = found.group(1), int(found.group(2))
        answer = self.ask(f"GET /{found.group(3)} HTTP/1.1\r\nHost: {self.host}\r\n\r\n".encode())
        self.cookie = re.search(rb"set-cookie: ([^;]+)", answer).group(1).decode()

    def ask(self, *parts, most=200_000):
        """What comes back for some bytes until the server says no more; b"" where it only left."""
        with socket.create_connection(("127.0.0.1", self.port), timeout=SOON) as wire:
            answer = b""
            try:
                for part in parts:
                    wire.sendall(part)
                while len(answer) < most and (read := wire.recv(65536)):
                    answer += read
                    head, gap, body = answer.partition(b"\r\n\r\n")
                    length = re.search(rb"content-length: (\d+)", head)
                    if gap and length is not None and len(body) >= int(length.group(1)):
                        break
                    if answer.startswith(b"HTTP/1.1 101"):
                        break
            except ConnectionError:
                pass  # it left while it was sent to; a TimeoutError fails the test
            return answer

    def own(self, method, path, *more):
        """The head of a request of the owner's own page."""
        lines = [f"{method} {path} HTTP/1.1", f"Host: {self.host}", f"Origin: http://{self.host}"]
        return "\r\n".join([*lines, f"Cookie: {self.cookie}", *more, "", ""]).encode("latin-1")

    def serves(self):
        """Whether its owner is served as before."""
        return b" 200 " in self.ask(self.own("GET", "/api/state"))[:20]


@pytest.fixture(scope="module")
def running(tmp_path_factory):
    outside = tmp_path_factory.mktemp("attacks")
    (outside / "secret.json").write_text("secret")
    folder = outside / "project"
    (folder / "controllers").mkdir(parents=True)
    (folder / "controllers" / "mine.json").write_text("{}")
    made = Running(folder)
    made.folder = folder
    yield made
    made.process.terminate()
    made.process.wait(SOON)
    made.process.stdout.close()


def test_connections_without_a_word_lock_nobody_out(running):
    """1,010 of them did: the oldest makes room for the newest."""
    idle = [socket.create_connection(("127.0.0.1", running.port), SOON) for _ in range(150)]
    try:
        assert running.serves()
        assert idle[0].recv(1) == b""  # closed by the server
        idle[-1].sendall(running.own("GET", "/api/state"))  # the newest is served
        assert b" 200 " in idle[-1].recv(15)
    finally:
        for wire in idle:
            wire.close()


# what a handshake with the owner's cookie must not hold
HANDSHAKES = {
    "a control character": "Origin: http://{host}\x01",
    "a control character in front": "Origin: \x1fhttp://{host}",
    "delete": "Origin: http://{host}\x7f",
    "nothing": "Origin: \0",
    "an escape": "X-Other: \x1b[2J",
    "a vertical tab": "Origin: a\x0bb",
    "letters of no alphabet": "Origin: \xff\xfe",
    "a long line": "Origin: http://{host}\r\nX-Long: " + "y" * 9000,
    "many lines": "Origin: http://{host}\r\n" + "\r\n".join(f"X-{i}: y" for i in range(140)),
    "another origin": "Origin: http://evil.example",
    "two origins": "Origin: http://{host}\r\nOrigin: http://evil.example",
    "two versions": "Origin: http://{host}\r\nSec-WebSocket-Version: 8",
    "no origin": "X-Other: y",
}


@pytest.mark.parametrize("name", HANDSHAKES)
def test_a_handshake_that_is_none_is_answered_at_once(running, name):
    words = HANDSHAKE + HANDSHAKES[name] + "\r\nCookie: {cookie}\r\n\r\n"
    said = words.format(host=running.host, cookie=running.cookie)
    answer = running.ask(said.encode("latin-1"))
    assert re.match(rb"HTTP/1.1 4\d\d ", answer), answer[:80]
    assert running.serves()


def test_the_same_handshake_without_the_attack_opens_the_socket(running):
    words = HANDSHAKE + "Origin: http://{host}\r\nCookie: {cookie}\r\n\r\n"
    answer = running.ask(words.format(host=running.host, cookie=running.cookie).encode())
    assert answer.startswith(b"HTTP/1.1 101 ")


def _frame(data, code=1, masked=True, length=None):
    """A frame of a client; length: another one than it has."""
    size = len(data) if length is None else length
    mask = 0x80 if masked else 0
    head = bytes([0x80 | code])
    if size < 126:
        head += bytes([mask | size])
    elif size < 65536:
        head += bytes([mask | 126]) + size.to_bytes(2, "big")
    else:
        head += bytes([mask | 127]) + size.to_bytes(8, "big")
    return head + (b"\0\0\0\0" if masked else b"") + data


# frames, and how the socket ends: None: it stays open and the page is told in words
FRAMES = {
    "not a JSON": (_frame(b"{not json"), None),
    "a list": (_frame(b"[" * 3000), None),
    "no order": (_frame(b'{"do": "__class__"}'), None),
    "too many words": (_frame(b'"' + b"y" * 60_000 + b'"'), None),
    "huge": (_frame(b"y" * 70_000), 1009),
    "huge as it says": (_frame(b"", length=2**40), 1009),
    "without a mask": (_frame(b"ok", masked=False), 1002),
    "no such kind": (_frame(b"ok", code=5), 1002),
    "no text": (_frame(b"\xff\xfe\xfd"), 1007),
}


@pytest.mark.parametrize("name", FRAMES)
def test_a_frame_that_is_none_is_told_so(running, name):
    words = HANDSHAKE + "Origin: http://{host}\r\nCookie: {cookie}\r\n\r\n"
    said, code = FRAMES[name]
    with socket.create_connection(("127.0.0.1", running.port), timeout=SOON) as wire:
        wire.sendall(words.format(host=running.host, cookie=running.cookie).encode())
        answer, end = b"", time.monotonic() + SOON
        while b"\r\n\r\n" not in answer:
            answer += wire.recv(65536)
        wire.sendall(said)
        wanted = b"refused" if code is None else b"\x88"
        found = False
        while not found and time.monotonic() < end:
            read = wire.recv(65536)
            answer += read
            _, _, frames = answer.partition(b"\r\n\r\n")
            found = wanted in frames and (code is None or code.to_bytes(2, "big") in frames)
            assert read or found, answer[-200:]
    assert found and running.serves()


# requests of a client of its own, with the owner's cookie where {cookie} stands
REQUESTS = {
    "no host": b"GET /api/state HTTP/1.1\r\nCookie: {cookie}\r\n\r\n",
    "a foreign host (DNS rebinding)": (
        b"GET /api/state HTTP/1.1\r\nHost: evil.example\r\nCookie: {cookie}\r\n\r\n"
    ),
    "two hosts": (
        b"GET /api/state HTTP/1.1\r\nHost: {host}\r\nHost: evil.example\r\nCookie: {cookie}\r\n\r\n"
    ),
    "a whole address": (
        b"GET http://evil.example/api/state HTTP/1.1\r\nHost: evil.example\r\n"
        b"Cookie: {cookie}\r\n\r\n"
    ),
    "a post of another site": (
        b"POST /api/jobs/start HTTP/1.1\r\nHost: {host}\r\nOrigin: http://evil.example\r\n"
        b"Content-Type: text/plain\r\nContent-Length: 17\r\nCookie: {cookie}\r\n\r\n"
        b'{"kind": "check"}'
    ),
    "a post of a form": (
        b"POST /api/jobs/start HTTP/1.1\r\nHost: {host}\r\nSec-Fetch-Site: cross-site\r\n"
        b"Content-Length: 17\r\nCookie: {cookie}\r\n\r\n"
        b'{"kind": "check"}'
    ),
    "two lengths": (
        b"POST /api/jobs HTTP/1.1\r\nHost: {host}\r\nOrigin: http://{host}\r\n"
        b"Content-Length: 2\r\nContent-Length: 40\r\nCookie: {cookie}\r\n\r\n{}"
    ),
    "a length that is none": (
        b"POST /api/jobs HTTP/1.1\r\nHost: {host}\r\nOrigin: http://{host}\r\n"
        b"Content-Length: 0x10\r\nCookie: {cookie}\r\n\r\n{}"
    ),
    "a length of many digits": (
        b"POST /api/jobs HTTP/1.1\r\nHost: {host}\r\nOrigin: http://{host}\r\n"
        b"Content-Length: " + b"9" * 60 + b"\r\nCookie: {cookie}\r\n\r\n{}"
    ),
    "chunks that are none": (
        b"POST /api/jobs HTTP/1.1\r\nHost: {host}\r\nOrigin: http://{host}\r\n"
        b"Transfer-Encoding: chunked\r\nCookie: {cookie}\r\n\r\nzz\r\n{}\r\n0\r\n\r\n"
    ),
    "another coding": (
        b"POST /api/jobs HTTP/1.1\r\nHost: {host}\r\nOrigin: http://{host}\r\n"
        b"Transfer-Encoding: gzip, chunked\r\nCookie: {cookie}\r\n\r\n2\r\n{}\r\n0\r\n\r\n"
    ),
    "a head without an end": b"GET / HTTP/1.1\r\nHost: {host}\r\nX: " + b"y" * 200_000,
    "a header with a line break": (
        b"GET /api/state HTTP/1.1\r\nHost: {host}\r\n Folded: {cookie}\r\n\r\n"
    ),
    "no HTTP": b"\x16\x03\x01\x02\x00\x01\x00\x01\xfc\x03\x03 hello tls\r\n\r\n",
    "an empty cookie": b"GET /api/state HTTP/1.1\r\nHost: {host}\r\nCookie: \r\n\r\n",
    "two cookies": (
        b"GET /api/state HTTP/1.1\r\nHost: {host}\r\nCookie: {cookie}\r\nCookie: a=b\r\n\r\n"
    ),
}


@pytest.mark.parametrize("name", REQUESTS)
def test_a_request_that_no_browser_sends_is_refused(running, name):
    said = REQUESTS[name].replace(b"{host}", running.host.encode())
    answer = running.ask(said.replace(b"{cookie}", running.cookie.encode()))
    assert re.match(rb"HTTP/1.1 4\d\d ", answer) or not answer, answer[:80]
    assert b"mine.json" not in answer and not (running.folder / "jobs").exists()
    assert running.serves()


# ways out of the project as they stand on the wire
PATHS = [
    "/files/controllers/%2e%2e/%2e%2e/secret.json",
    "/files/controllers/..%2f..%2fsecret.json",
    "/files/controllers/%252e%252e%252fsecret.json",
    "/files/controllers/..%5c..%5csecret.json",
    "/files/controllers/..%c0%af..%c0%afsecret.json",
    "/files/controllers/%ef%bc%8e%ef%bc%8e/secret.json",
    "/files/controllers/mine.json%00.html",
    "/files/controllers/mine.json%0d%0aset-cookie:%20a=b",
    "/files/controllers/" + "a" * 5000 + ".json",
    "/files/%2e%2e/secret.json",
    "/files/controllers/../../secret.json",
    "/files//etc/passwd",
    "/static/%2e%2e/server%2epy",
    "/static/..%2fserver%2epy",
]


@pytest.mark.parametrize("path", PATHS)
def test_no_spelling_leads_out(running, path):
    answer = running.ask(running.own("GET", path))
    assert re.match(rb"HTTP/1.1 4\d\d ", answer), answer[:80]
    head, _, body = answer.partition(b"\r\n\r\n")
    assert body.strip() != b"secret" and b"import" not in body and b"set-cookie" not in head


def test_a_body_beyond_its_limit_is_not_taken_in_chunks_either(running):
    head = running.own("PUT", "/api/files/machines/big.toml", "Transfer-Encoding: chunked")
    part = b"f4240\r\n" + b"#" * 1_000_000 + b"\r\n"
    answer = running.ask(head, part, part, b"0\r\n\r\n")
    # it may have left before it read all
    assert not answer or re.match(rb"HTTP/1.1 413 ", answer), answer[:80]
    assert not list(running.folder.glob("machines/*")) and running.serves()


def test_a_body_that_ends_early_leaves_no_file(running):
    head = running.own("PUT", "/api/files/machines/half.toml", "Content-Length: 1000")
    with socket.create_connection(("127.0.0.1", running.port), timeout=SOON) as wire:
        wire.sendall(head + b"[machine]")
    assert running.serves() and running.serves()
    end = time.monotonic() + SOON
    while left := list(running.folder.glob("machines/*")):
        assert time.monotonic() < end, left
        time.sleep(0.02)


@pytest.fixture
def place(tmp_path):
    """A project's server without a port, its owner's browser, and its folder."""
    tokens = []
    folder = tmp_path / "project"
    project = Project(folder)
    app = served.build(project, [HOST], tokens.append, object())
    (tmp_path / "outside").mkdir()
    for where in (folder / "controllers", tmp_path / "outside"):
        where.mkdir(exist_ok=True)
        (where / "mine.json").write_text("secret" if where.name == "outside" else "mine")
    browser = Client(app)
    assert browser.enter(tokens[0]).status == 200
    return browser, folder, tmp_path / "outside"


def _file_by_link(folder, outside):
    (folder / "controllers" / "mine.json").unlink()
    (folder / "controllers" / "mine.json").symlink_to(outside / "mine.json")


def _folder_by_link(folder, outside):
    (folder / "controllers").rename(folder / "moved")
    (folder / "controllers").symlink_to(outside)


def _pipe(folder, outside):
    (folder / "controllers" / "mine.json").unlink()
    os.mkfifo(folder / "controllers" / "mine.json")


def _folder_in_its_place(folder, outside):
    (folder / "controllers" / "mine.json").unlink()
    (folder / "controllers" / "mine.json").mkdir()


SWAPS = [_file_by_link, _folder_by_link, _pipe, _folder_in_its_place]


@pytest.mark.parametrize("swap", SWAPS)
def test_a_file_that_is_swapped_after_it_was_looked_at_is_not_sent(place, monkeypatch, swap):
    browser, folder, outside = place
    assert browser.ask("GET", "/files/controllers/mine.json").body == b"mine"
    inside = Project.inside

    def then_swapped(project, path):
        found = inside(project, path)
        if path.name == "mine.json":
            swap(folder, outside)
        return found

    monkeypatch.setattr(Project, "inside", then_swapped)
    assert browser.ask("GET", "/files/controllers/mine.json").status == 404


@pytest.mark.parametrize("swap", SWAPS)
def test_what_was_opened_is_what_is_sent(place, monkeypatch, swap):
    browser, folder, outside = place
    opened = served._open

    def then_swapped(path):
        file = opened(path)
        swap(folder, outside)
        return file

    before = set(os.listdir("/dev/fd"))
    assert browser.ask("HEAD", "/files/controllers/mine.json").body == b""
    monkeypatch.setattr(served, "_open", then_swapped)
    answer = browser.ask("GET", "/files/controllers/mine.json")
    assert answer.status == 200 and answer.body == b"mine"
    assert set(os.listdir("/dev/fd")) == before  # none is left open


def test_names_of_channels_that_are_markup_stay_words(place):
    """The record's own page: a picture of every channel, its name as text."""
    from ambrose.annexes.workbench.project import begin
    from ambrose.annexes.workbench.screens import answer

    _, folder, _ = place
    begin(Project(folder), "two-disc-rotor")
    (folder / "records").mkdir()
    hostile = "<img src=x onerror=alert(1)>"
    rows = "\n".join(f"{i / 1e3},{i % 7},{i % 5}" for i in range(2000))
    (folder / "records" / "bad.csv").write_text(f"t,{hostile},</svg><script>y\n{rows}\n")
    told = answer(Project(folder), "records", "look", {"file": "bad.csv"})
    assert hostile in json.dumps(told)
    for block in told["blocks"]:
        assert "<img" not in block.get("svg", "") and "<script" not in block.get("svg", "")
