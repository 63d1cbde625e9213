"""Attacks on the server, at the level of ASGI: none comes through."""

import asyncio
import gzip
import json
import os
import re
import zlib

import pytest

pytest.importorskip("starlette", reason="no starlette: install the extra workbench")

from ambrose.annexes.workbench import project as uploads
from ambrose.annexes.workbench.project import Project
from ambrose.annexes.workbench.screens import answer
from ambrose.annexes.workbench.server import build
from ambrose.core.checks import InvalidInput
from asgi_client import HOST, ORIGIN, Client

BEGIN = "/api/screens/machine/begin"


class Inline:
    """The screens in this process: nothing is started for a request."""

    def __init__(self, project):
        self.project = project

    async def ask(self, screen, action, given):
        return answer(self.project, screen, action, given)


@pytest.fixture
def place(tmp_path):
    """The server of a project, its tokens, and a browser that came with the first one."""
    tokens = []
    folder = tmp_path / "project"
    project = Project(folder)
    app = build(project, [HOST, "localhost:4000"], tokens.append, Inline(project))
    (folder / "controllers").mkdir()
    (folder / "controllers" / "mine.json").write_text("{}")
    (tmp_path / "secret.json").write_text("secret")
    (folder / "controllers" / "link.json").symlink_to(tmp_path / "secret.json")
    (folder / "records").symlink_to(tmp_path)
    (folder / "reports").mkdir()
    (folder / "reports" / "page.html").write_text("<script>alert(1)</script>")
    browser = Client(app)
    assert browser.enter(tokens[0]).status == 200
    return app, tokens, browser, folder


def test_the_owner_is_served(place):
    """What follows means something only if the same requests pass without the attack."""
    _, _, browser, _ = place
    assert browser.ask("GET", "/").status == 200
    assert browser.ask("GET", "/", headers={"origin": None}).status == 200
    state = browser.ask("GET", "/api/state").data
    assert state["files"]["controllers"] == ["mine.json"]
    assert browser.ask("GET", "/files/controllers/mine.json").body == b"{}"
    assert browser.ask("GET", "/static/live.js").status == 200
    begun = browser.ask("POST", BEGIN, b'{"machine": "two-disc-rotor"}')
    assert begun.status == 200


def test_a_token_is_good_once(place):
    app, tokens, browser, _ = place
    assert len(tokens) == 2
    assert Client(app).enter(tokens[0]).status == 401
    second = Client(app)
    assert second.enter(tokens[1]).status == 200
    # both browsers are served
    assert browser.ask("GET", "/api/state").status == second.ask("GET", "/api/state").status == 200
    cookie = browser.ask("GET", "/", query=f"token={tokens[2]}").headers["set-cookie"]
    assert "HttpOnly" in cookie and "SameSite=Strict" in cookie


TOKENS = {
    "twice": ("GET", "token={0}&token={0}"),
    "with another": ("GET", "token=guess&token={0}"),
    "of another spelling": ("GET", "Token={0}"),
    "with something behind it": ("GET", "token={0};"),
    "shortened": ("GET", "token={0:.20}"),
    "empty": ("GET", "token="),
    "by HEAD": ("HEAD", "token={0}"),
    "by POST": ("POST", "token={0}"),
}


@pytest.mark.parametrize("way", TOKENS)
def test_a_token_that_comes_another_way_is_neither_good_nor_used_up(place, way):
    app, tokens, _, _ = place
    method, query = TOKENS[way]
    answer = Client(app).ask(method, "/", query=query.format(tokens[1]))
    assert answer.status == 401 and "set-cookie" not in answer.headers
    assert Client(app).enter(tokens[1]).status == 200
    assert len(tokens) == 3


FOREIGN = {
    "no cookie": ({"cookie": None}, 401),
    "a guessed cookie": ({"cookie": "ambrose-4000=guess"}, 401),
    "an empty cookie": ({"cookie": "ambrose-4000="}, 401),
    "a broken cookie": ({"cookie": 'ambrose-4000="\\777; ;;=;'}, 401),
    "a cookie of another port": ({"cookie": "ambrose-4001=x"}, 401),
    "another host (DNS rebinding)": ({"host": "evil.example:4000"}, 421),
    "the host without its port": ({"host": "127.0.0.1"}, 421),
    "no host": ({"host": None}, 421),
    "a host that begins alike": ({"host": "127.0.0.1:4000.evil.example"}, 421),
    "another origin": ({"origin": "http://evil.example"}, 403),
    "an origin that begins alike": ({"origin": f"{ORIGIN}.evil.example"}, 403),
    "another port of this computer": ({"origin": "http://127.0.0.1:4001"}, 403),
    "https": ({"origin": f"https://{HOST}"}, 403),
    "a sandboxed page": ({"origin": "null"}, 403),
    "another site": ({"sec-fetch-site": "cross-site", "origin": None}, 403),
    "another port, no origin": ({"sec-fetch-site": "same-site", "origin": None}, 403),
}


@pytest.mark.parametrize("attack", FOREIGN)
def test_a_stranger_reads_nothing(place, attack):
    _, _, browser, _ = place
    headers, status = FOREIGN[attack]
    for path in ("/", "/api/state", "/static/live.js", "/files/controllers/mine.json"):
        assert browser.ask("GET", path, headers=headers).status == status


@pytest.mark.parametrize("attack", [*FOREIGN, "no origin"])
def test_a_stranger_changes_nothing(place, attack):
    _, _, browser, folder = place
    headers, status = {**FOREIGN, "no origin": ({"origin": None}, 403)}[attack]
    body = b'{"machine": "seal-rig"}'
    status = 403 if headers.get("origin", ORIGIN) is None else status
    assert browser.ask("POST", BEGIN, body, headers).status == status
    assert not (folder / "machine.toml").exists()


@pytest.mark.parametrize("attack", [*FOREIGN, "no origin"])
def test_a_stranger_opens_no_socket(place, attack):
    _, _, browser, _ = place
    headers, _ = {**FOREIGN, "no origin": ({"origin": None}, 403)}[attack]
    (closed,) = asyncio.run(browser.socket("/live", headers))
    assert closed["type"] == "websocket.close"


@pytest.mark.parametrize("name", ["host", "origin", "cookie"])
def test_a_header_that_stands_twice_is_wrong(place, name):
    _, _, browser, _ = place
    again = dict(browser.own(None))[name.encode()]
    assert browser.ask("GET", "/api/state", more=[(name.encode(), again)]).status in {401, 403, 421}


@pytest.mark.parametrize("method", ["TRACE", "CONNECT", "OPTIONS", "PATCH", "get"])
def test_other_methods_are_refused(place, method):
    _, _, browser, _ = place
    assert browser.ask(method, "/api/state").status == 405


@pytest.mark.parametrize(
    "path",
    [
        "/files/controllers/../../secret.json",
        "/files/controllers/..%2f..%2fsecret.json",
        "/files/../secret.json",
        "/files/controllers/link.json",
        "/files/records/secret.json",
        "/files/controllers//etc/passwd",
        "/files/controllers/.hidden.json",
        "/files/controllers/mine.json\0.json",
        "/files/controllers/mine.json/",
        "/files/controllers/mine",
        "/files/jobs/mine.json",
        "/files/controllers/" + "a" * 61 + ".json",
        "/files/controllers/ｍine.json",
        "/files/controllers/con:.json",
        "/static/../server.py",
        "/static/..",
        "/static/",
        "/static/%2e%2e/" + "server.py",
        "//127.0.0.1/secret.json",
        "/files/controllers/..\\..\\secret.json",
        "/files/controllers%2f..%2fsecret.json",
        "/files/controllers/%6cink.json",
        "/files/controllers/mine.json\n",
        "/files/controllers/mine.json\r\nset-cookie: a=b",
        "/files/controllers/mine.json;.json",
        "/files/controllers/mine.json?/../x.json",
        "/files/controllers/.mine.json.0123abcd.tmp",
        "/files/controllers\n/mine.json",
    ],
)
def test_no_path_leads_out(place, path):
    _, _, browser, _ = place
    answer = browser.ask("GET", path)
    assert answer.status in {400, 404}
    assert b"secret" not in answer.body.replace(b"secret.json", b"")
    assert b"import" not in answer.body


def test_too_much_is_not_read(place):
    _, _, browser, folder = place
    told = browser.ask("POST", BEGIN, b"{}", {"content-length": "2000000"})
    assert told.status == 413
    assert browser.ask("POST", "/api/state", b"", {"content-length": "-1"}).status == 413
    # the same without a length
    parts = [b'{"machine": "seal-rig", "x": "', *[b"y" * 100_000] * 12, b'"}']
    assert browser.ask("POST", BEGIN, parts).status == 413
    assert not (folder / "machine.toml").exists()


def test_a_file_is_taken_under_a_name_that_it_can_have(place):
    _, _, browser, folder = place
    (folder / "records").unlink()
    sent = browser.ask("PUT", "/api/files/records/My run (2).csv", [b"a,b", b"\n1,2\n"])
    assert sent.data == {"file": "My-run-2.csv"}
    again = browser.ask("PUT", "/api/files/records/My run (2).csv", b"other")
    assert again.data == {"file": "My-run-2-2.csv"}
    assert (folder / "records" / "My-run-2.csv").read_bytes() == b"a,b\n1,2\n"
    assert sorted(p.name for p in (folder / "records").iterdir()) == [
        "My-run-2-2.csv",
        "My-run-2.csv",
    ]


@pytest.mark.parametrize(
    "path",
    [
        "/api/files/records/x.exe",
        "/api/files/records/x",
        "/api/files/machines/x.html",
        "/api/files/reports/x.html",
        "/api/files/jobs/x.json",
        "/api/files/../x.h5",
        "/api/files/records/../../x.h5",
        "/api/files/records/a/b.h5",
        "/api/files/records/x.h5",  # the folder is a link that leads out
    ],
)
def test_no_other_file_is_taken(place, path):
    _, _, browser, folder = place
    answer = browser.ask("PUT", path, b"x" * 100)
    assert answer.status in {400, 404}
    assert sorted(p.name for p in folder.parent.iterdir()) == ["project", "secret.json"]


def test_names_of_uploads_stay_inside(place):
    _, _, browser, folder = place
    (folder / "records").unlink()
    for name in ("..%2f..%2fx.h5", "<img src=x>.h5", ".h5.h5", "\u202e.h5", "a" * 300 + ".h5"):
        assert browser.ask("PUT", f"/api/files/records/{name}", b"x").status == 200
    names = [p.name for p in (folder / "records").iterdir()]
    assert len(names) == 5
    assert all(re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9_-]{0,59}\.h5", name) for name in names)


def test_a_file_that_is_too_large_leaves_nothing(place, monkeypatch):
    _, _, browser, folder = place
    (folder / "records").unlink()
    monkeypatch.setitem(uploads.LIMITS, "records", 1000)
    for headers in ({"content-length": "1001"}, {}):
        sent = browser.ask("PUT", "/api/files/records/x.h5", [b"y" * 600] * 2, headers)
        assert sent.status == 413
    assert not list(folder.glob("records/*"))


@pytest.mark.parametrize("attack", [*FOREIGN, "no origin"])
def test_a_stranger_sends_no_file(place, attack):
    _, _, browser, folder = place
    (folder / "records").unlink()
    headers, _ = {**FOREIGN, "no origin": ({"origin": None}, 403)}[attack]
    for method, path in (("PUT", "/api/files/records/x.h5"), ("POST", "/api/screens/machine")):
        assert browser.ask(method, path, b"{}", headers).status in {401, 403, 421}
    assert not (folder / "records").exists()


@pytest.mark.parametrize(
    "body",
    [
        b"",
        b"[]",
        b"\xff",
        b"[" * 50_000,
        b'{"machine": "../secret"}',
        b'{"machine": ["seal-rig"]}',
        b'{"machine": null}',
        b'{"machine": "\\ud800"}',
        b'{"machine": ' + b"9" * 6000 + b"}",
        b'{"machine": 1e999}',
        b'{"machine": "seal-rig", "machine": "x"}',
        gzip.compress(b'{"machine": "seal-rig"}', mtime=0),
        gzip.compress(b'{"machine": "' + b"a" * 50_000_000 + b'"}', mtime=0),
        zlib.compress(b'{"machine": "seal-rig"}'),
    ],
)
def test_nonsense_is_refused_in_words(place, body):
    _, _, browser, folder = place
    answer = browser.ask("POST", BEGIN, body)
    assert answer.status == 400
    assert answer.data["error"]
    assert not (folder / "machine.toml").exists()


def test_two_files_of_one_name_at_once_are_both_told(place):
    """What came first stays, whole; the other is told, and leaves no draft."""
    _, _, _, folder = place
    path = folder / "controllers" / "both.json"

    async def body(text):
        yield text[:1]
        await asyncio.sleep(0)
        yield text[1:]

    async def both():
        ways = [uploads.receive(path, body(text)) for text in (b"first", b"other")]
        return await asyncio.gather(*ways, return_exceptions=True)

    one, other = asyncio.run(both())
    refused = one if isinstance(one, InvalidInput) else other
    assert isinstance(refused, InvalidInput) and "both.json was written by another" in str(refused)
    assert (one == path) != (other == path)
    assert path.read_bytes() == (b"first" if one == path else b"other")
    assert {p.name for p in path.parent.iterdir()} == {"both.json", "link.json", "mine.json"}


RANGES = {
    "many": ",".join(f"{i}-{i}" for i in range(5000)),
    "overlapping": ",".join(["0-"] * 500),
    "backwards": "5-1",
    "beyond": "999999-",
    "negative": "--5",
    "digits": "0-" + "9" * 3000,
    "no number": "a-b",
    "spaces": "0-0" + " " * 20_000 + ",1-1",
}


@pytest.mark.parametrize("name", RANGES)
def test_parts_of_a_file_are_no_way_to_more_than_the_file(place, name):
    _, _, browser, folder = place
    path = folder / "controllers" / "long.json"
    path.write_text("x" * 20_000)
    for address in ("/files/controllers/long.json", "/files/controllers/link.json"):
        answer = browser.ask("GET", address, headers={"range": f"bytes={RANGES[name]}"})
        assert answer.status in {200, 206, 400, 416} and b"secret" not in answer.body[:400]
        # nothing is sent five thousand times
        assert len(answer.body) < 21_000


@pytest.mark.parametrize("method", ["HEAD", "OPTIONS", "TRACE", "DELETE", "PROPFIND"])
@pytest.mark.parametrize("path", ["/files/controllers/mine.json", "/api/jobs/start", "/live"])
def test_no_other_method_does_or_tells_anything(place, method, path):
    _, _, browser, folder = place
    body = b'{"kind": "check"}'
    answer = browser.ask(method, path, body)
    assert answer.status in {404, 405} or (method, path) == ("HEAD", "/files/controllers/mine.json")
    assert b"{}" not in answer.body and body not in answer.body
    assert "access-control-allow-origin" not in answer.headers
    assert (folder / "controllers" / "mine.json").exists() and not (folder / "jobs").exists()


def test_a_body_that_never_ends_holds_nobody_up(place):
    """One that sends a byte now and then, beside others that are served."""
    app, _, browser, folder = place
    (folder / "records").unlink()

    async def slow():
        scope_of = browser.own(None)
        sent = []

        async def receive():
            await asyncio.sleep(0.001)
            return {"type": "http.request", "body": b"x", "more_body": True}

        async def send(message):
            sent.append(message)

        path = "/api/files/records/slow.h5"
        scope = {"type": "http", "method": "PUT", "path": path, "raw_path": path.encode()}
        scope |= {"query_string": b"", "headers": scope_of, "root_path": "", "http_version": "1.1"}
        others = [asyncio.create_task(app(dict(scope), receive, send)) for _ in range(50)]
        while len(list((folder / "records").glob("*"))) < 50:  # all have begun
            await asyncio.sleep(0.001)
        answer = await browser.request("GET", "/api/state")
        for other in others:
            other.cancel()
        await asyncio.gather(*others, return_exceptions=True)
        return answer, sent

    answer, sent = asyncio.run(slow())
    assert answer.status == 200 and answer.data["files"]["records"] == []
    assert sent == [] and not list((folder / "records").iterdir())


def test_what_goes_out_forbids_scripts_in_text(place):
    _, _, browser, _ = place
    for path in ("/", "/api/state", "/static/live.js", "/nothing"):
        headers = browser.ask("GET", path).headers
        policy = headers["content-security-policy"]
        assert "default-src 'none'" in policy and "script-src 'self';" in policy
        assert "unsafe" not in policy and "frame-ancestors 'none'" in policy
        assert headers["x-content-type-options"] == "nosniff"
        assert headers["cache-control"] == "no-store"
    # a page of results has its scripts, but no address of its own
    page = browser.ask("GET", "/files/reports/page.html").headers["content-security-policy"]
    assert page.startswith("sandbox allow-scripts;") and "connect-src" not in page
    # a file of the project is no page here
    file = browser.ask("GET", "/files/controllers/mine.json").headers
    assert file["content-disposition"].startswith("attachment")
    assert file["content-type"] == "application/octet-stream"


def test_the_pages_hold_no_script_and_no_markup_from_names():
    """What the browser runs comes in files, and puts words into the page as text."""
    from importlib.resources import files

    static = files("ambrose.annexes.workbench").joinpath("static")
    texts = {item.name: item.read_text("utf-8") for item in static.iterdir()}
    for words in (
        "innerHTML",
        "outerHTML",
        "insertAdjacent",
        "document.write",
        "eval(",
        "Function(",
    ):
        assert not [name for name, text in texts.items() if words in text]
    assert "<script>" not in texts["index.html"] and "style=" not in texts["index.html"]
    script = [text for name, text in texts.items() if name.endswith(".js")]
    lines = [line for text in script for line in text.splitlines() if line.strip()]
    # code, without air and comments; the editor of the filters took it from 620, the grid from 770
    assert len([line for line in lines if not line.lstrip().startswith("//")]) < 890
    assert max(map(len, lines)) <= 112


def test_names_of_files_that_are_no_slugs_do_not_appear(place):
    _, _, browser, folder = place
    (folder / "controllers" / "<img src=x onerror=alert(1)>.json").write_text("{}")
    (folder / "controllers" / "..json").write_text("{}")
    os.mkfifo(folder / "controllers" / "pipe.json")
    assert browser.ask("GET", "/api/state").data["files"]["controllers"] == ["mine.json"]
    assert json.loads(browser.ask("GET", "/api/state").body)["files"]["records"] == []


LONG = "y" * 1_200_000
# what the owner's own browser is made to ask for; "mine.json", "run.h5" and "plan.toml" are there
RUN = {"controller": "mine.json", "record": "run.h5"}
JOBS = [
    {"kind": "retune", **RUN, "record": "../secret.json"},
    {"kind": "retune", **RUN, "record": "link.h5"},
    {"kind": "retune", **RUN, "record": ["run.h5"]},
    {"kind": "retune", **RUN, "controller": "link.json"},
    {"kind": "retune", **RUN, "unknown": "--report=/tmp/x"},
    {"kind": "retune", **RUN, "unknown": "seal.k --anyway"},
    {"kind": "retune", **RUN, "unknown": "seal.k\n--anyway"},
    {"kind": "size", "areas": "--help"},
    {"kind": "size", "areas": "0.5 --listen 0.0.0.0"},
    {"kind": "size", "areas": "0.5, " * 50},
    {"kind": "size", "areas": [0.5]},
    {"kind": "size", "biases": "$(touch x)"},
    {"kind": "size", "biases": "../../secret.json"},
    {"kind": "size", "rate": "1e4; rm"},
    {"kind": "size", "rate": {"a": 1}},
    {"kind": "campaign", "plan": "../machine.toml"},
    {"kind": "campaign", "plan": "/etc/passwd"},
    {"kind": "campaign", "plan": "link.toml"},
    {"kind": "campaign", "plan": "plan.toml\0.toml"},
    {"kind": "campaign", "plan": "--help"},
    {"kind": "campaign", "plan": {"campaign": {}}},
    {"kind": "study --help"},
    {"kind": "__class__"},
    {"again": "../../study-1"},
    {"again": ["study-1"]},
]


@pytest.mark.parametrize("said", JOBS, ids=range(len(JOBS)))
def test_no_job_is_started_by_words_that_are_none(place, said):
    _, _, browser, folder = place
    (folder / "records").unlink()
    for name in ("plans", "records"):
        (folder / name).mkdir()
    (folder / "records" / "run.h5").write_text("")
    (folder / "plans" / "plan.toml").write_text("")
    (folder / "records" / "link.h5").symlink_to(folder.parent / "secret.json")
    (folder / "plans" / "link.toml").symlink_to(folder.parent / "secret.json")
    told = browser.ask("POST", "/api/jobs/start", json.dumps(said).encode())
    assert told.status == 400 and told.data["error"]
    assert not (folder / "jobs").exists()


@pytest.mark.parametrize(
    "kind, place_of_results",
    [
        *(("study", "study"), ("size", "reports"), ("size", "machines"), ("retune", "retuning")),
        ("campaign", "campaign"),
    ],
)
def test_no_job_writes_where_a_link_leads(place, tmp_path_factory, kind, place_of_results):
    _, _, browser, folder = place
    outside = tmp_path_factory.mktemp("outside")
    for name in ("records", place_of_results):
        where = folder / name
        if where.is_symlink():
            where.unlink()
        elif where.exists():
            where.rename(folder / "moved")
    (folder / place_of_results).symlink_to(outside)
    for name, file in {"plans": "plan.toml", "records": "run.h5"}.items():
        (folder / name).mkdir()
        (folder / name / file).write_text("")
    said = {"kind": kind, **RUN, "plan": "plan.toml"}
    told = browser.ask("POST", "/api/jobs/start", json.dumps(said).encode())
    assert told.status == 400 and "leads out" in told.data["error"]
    assert not (folder / "jobs").exists() and not list(outside.iterdir())


PLAN = {"task": "screen", "controller": "pid", "name": "plan", "vary": ""}
SCREENS = [
    ("studies/plan", {**PLAN, "name": "../../plan"}),
    ("studies/plan", {**PLAN, "name": "<script>alert(1)</script>"}),
    ("studies/plan", {**PLAN, "name": "-o"}),
    ("studies/plan", {**PLAN, "vary": 'machine = ["../../secret.toml"]'}),
    ("studies/plan", {**PLAN, "vary": 'controller = ["../../secret.json"]'}),
    ("studies/plan", {**PLAN, "vary": "scenario.x = 1"}),
    ("studies/plan", {**PLAN, "vary": "a = " + "[" * 3000}),
    ("studies/plan", {**PLAN, "vary": "a = 1\n" * 2000}),
    ("studies/plan", {**PLAN, "vary": LONG}),
    ("studies/__init__", {}),
    ("retuning/take", {}),
    ("retuning/_take", {}),
    ("identification/back", {}),
    ("deploy/test", {"code": "../.."}),
    ("deploy/pack", {"code": "/etc"}),
    ("deploy/pack", {"code": "linked"}),
    ("controllers/save", {"name": "../../evil"}),
    ("records/map", {"source": "../secret.json"}),
    ("machine/take", {"source": "../secret.toml"}),
    ("machine/write", {"text": "[machine]", "stamp": "0" * 16}),
    ("../studies", {}),
    ("campaigns.plan", {}),
]


@pytest.mark.parametrize("path, said", SCREENS, ids=range(len(SCREENS)))
def test_no_screen_is_led_astray(place, path, said):
    _, _, browser, folder = place
    uploads.begin(Project(folder), "flywheel")  # without the screen that answers
    secret = folder.parent / "secret.json"
    for name in ("retuning", "machines", "code"):
        (folder / name).mkdir(exist_ok=True)
    (folder / "retuning" / "controller.json").symlink_to(secret)
    (folder / "machines" / "identified.toml").symlink_to(secret)
    (folder / "code" / "linked").symlink_to(folder.parent)
    before = {at: at.stat().st_mtime_ns for at in folder.parent.rglob("*")}
    told = browser.ask("POST", f"/api/screens/{path}", json.dumps(said).encode())
    assert told.status in {400, 404, 413}
    assert b"secret</" not in told.body
    # a folder may be made; nothing is written
    after = {at: at.stat().st_mtime_ns for at in folder.parent.rglob("*") if not at.is_dir()}
    assert after.items() <= before.items()


NEW = ["campaign/../x.csv", "campaign/link.csv", "study/.hidden.html", "retuning/link.html"]
NEW += ["plans/plan.toml.bak", "study/report.html/..", "campaign/campaign.lock"]


@pytest.mark.parametrize("name", NEW)
def test_no_file_of_a_result_leads_out(place, name):
    _, _, browser, folder = place
    for made, file in {"campaign": "link.csv", "retuning": "link.html"}.items():
        (folder / made).mkdir()
        (folder / made / file).symlink_to(folder.parent / "secret.json")
    (folder / "campaign" / "campaign.lock").write_text("secret")
    answer = browser.ask("GET", f"/files/{name}")
    assert answer.status in {400, 404} and answer.body != b"secret"


@pytest.mark.parametrize("kind", ["plans", "campaign", "study", "retuning", "runs", "code"])
def test_no_result_is_sent_in(place, kind):
    _, _, browser, folder = place
    for ending in ("html", "toml", "json", "h5", "zip"):
        assert browser.ask("PUT", f"/api/files/{kind}/x.{ending}", b"x").status == 400
    assert not (folder / kind).exists()


def test_orders_are_of_limited_size(place):
    _, _, browser, folder = place
    body = json.dumps({"kind": "size", "areas": LONG}).encode()
    for path in ("/api/jobs", "/api/jobs/start", "/api/jobs/cancel", "/api/screens/studies"):
        assert browser.ask("POST", path, body).status == 413
        assert browser.ask("POST", path, [body[:600_000], body[600_000:]]).status == 413
    assert not (folder / "jobs").exists()
