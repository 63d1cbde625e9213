"""The workbench in a browser: a tour from lift-off to code, every screen at both widths, two
browsers, a server that is killed. With AMBROSE_PICTURES, a folder, the screens are left there.
"""

import json
import math
import os
import re
import signal
import subprocess
import sys
import threading
import time
import zipfile
from functools import partial
from pathlib import Path

import pytest

from needs import needs

pytest.importorskip("starlette", reason="no starlette: install the extra workbench")
pytest.importorskip("playwright", reason="no playwright: install the extra dev")

from playwright.sync_api import Error, sync_playwright

from ambrose.annexes.workbench import live as viewers
from ambrose.annexes.workbench.project import Project, begin
from ambrose.annexes.workbench.screens import TITLES
from ambrose.machine.file.toml import load_machine
from needs import CHROMIUM
from workbench_served import LIMIT, POLL, Served, eventually

# the clock that stands still while a test acts is the rig's; a hang is given up after LIMIT
pytestmark = [pytest.mark.timeout(4 * LIMIT), needs("browser")]
MACHINE = Path(__file__).parents[3] / "benchmarks" / "snapshot_files" / "small-rig.toml"
# words of a user's, which no page may take for more
HOSTILE = "<img src=x onerror=document.title=1></svg><script>document.title=2</script>"
PICTURES = os.environ.get("AMBROSE_PICTURES")
FACTS = "document.querySelector('.facts').textContent"
# the figure whose words begin so, as it is drawn
DRAWN = """(words) => document.querySelector(`svg[aria-label^="${words}" i]`)?.outerHTML"""


# what Ctrl+V hands to the page; the clipboard of a browser that nobody sees may never answer
PASTE = """(text) => {
  const data = new DataTransfer();
  data.setData("text/plain", text);
  const given = { clipboardData: data, bubbles: true, cancelable: true };
  document.activeElement.dispatchEvent(new ClipboardEvent("paste", given));
}"""


class Process:
    """`ambrose workbench` of a folder, and the addresses that it prints."""

    def __init__(self, folder):
        words = [sys.executable, "-m", "ambrose", "workbench", str(folder), "--no-browser"]
        self.process = subprocess.Popen(words, stdout=subprocess.PIPE, text=True)

    def address(self):
        """The next one."""
        while not (found := re.findall(r"http\S+", line := self.process.stdout.readline())):
            assert line
        return found[0]

    def end(self, number=signal.SIGINT):
        self.process.send_signal(number)
        status = self.process.wait(LIMIT)
        self.process.stdout.close()
        assert status == (0 if number == signal.SIGINT else -number)


def children(task):
    """Processes that a thread has started (Linux)."""
    return (task / "children").read_text().split()


def alive(pid):
    """Whether a process runs; one that nobody has buried yet does not."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] not in "ZX"
    except OSError:
        return False


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    made = tmp_path_factory.mktemp("tour") / "rig"
    made.mkdir()
    text = MACHINE.read_text().replace(
        'name = "small-rig"', f'name = "small-rig"\ndescription = {json.dumps(HOSTILE)}'
    )
    # designed as its code runs: what just holds as a continuous loop misses its limit once sampled
    text = text.replace("[controller]", '[controller]\nsample_time = "100 us"')
    (made / "machine.toml").write_text(text.replace('"twice nominal', f'"{HOSTILE} twice'))
    return made


@pytest.fixture(scope="module")
def server(folder):
    made = Served(Project(folder))
    yield made
    made.end()


@pytest.fixture(scope="module")
def chromium():
    with sync_playwright() as driver:
        words = ["--no-sandbox", "--disable-dev-shm-usage"]
        try:
            browser = driver.chromium.launch(executable_path=CHROMIUM, args=words)
        except Error as error:
            pytest.skip(f"no browser: it does not start here: {error.message.splitlines()[0]}")
        yield browser
        browser.close()


def new_page(chromium, width=1400, **options):
    """A page of a browser of its own, which fails the test that leaves a mistake in its console."""
    context = chromium.new_context(viewport={"width": width, "height": 900}, **options)
    page = context.new_page()
    page.set_default_timeout(1000 * LIMIT)
    page.mistakes = []
    page.on("pageerror", lambda error: page.mistakes.append(str(error)))
    page.on("console", lambda said: said.type == "error" and page.mistakes.append(f"{said.text}"))
    return page


def until(page, expression, arg=None):
    """Until a script says yes; asked again and again, for the page's own rules forbid more."""
    end = time.monotonic() + LIMIT
    while not page.evaluate(expression, arg):
        assert time.monotonic() < end, expression
        page.wait_for_timeout(1000 * POLL)


def runs_until(page, server, expression, most=20.0):
    """The rig runs until a script says yes, within ``most`` seconds of its clock."""
    for _ in range(round(most / 0.2)):
        server.clock.advance(0.2)  # words change so often
        if page.evaluate(expression):
            return
    raise AssertionError(f"not within {most} s of the rig: {expression}: {page.evaluate(FACTS)}")


def press(page, server, text):
    """A button of the rig, until it has done what that asks for."""
    server.obeyed(page.get_by_role("button", name=text, exact=True).click)


def choose(page, server, name, value):
    """An option that the rig is told of."""
    server.obeyed(lambda: page.locator(f"[name={name}]").select_option(value))


def go(page, screen):
    page.evaluate(f"location.hash = '#{screen}'")
    page.wait_for_selector(f"nav a[aria-current=page][href='#{screen}']")
    page.wait_for_selector("main .panel")


def job(page, button, command):
    """Start a job from its screen and wait until it is over; its log."""
    over = "([name]) => [...document.querySelectorAll('h2')].map((h) => h.textContent).find("
    over += "(text) => text.startsWith(name) && !/: (waiting|running)/.test(text))"
    assert page.evaluate(over, [f"{command}-"]) is None
    page.get_by_role("button", name=button, exact=True).click()
    until(page, over, [f"{command}-"])
    log = page.locator("section", has=page.locator("h2", has_text=f"{command}-")).first
    words = log.locator("pre").first.text_content()
    assert ": done" in page.evaluate(over, [f"{command}-"]), words
    return words


@pytest.fixture(scope="module")
def tour(chromium, server):
    """From lift-off to code, as a new user would; the page stays open."""
    page = new_page(chromium)
    building = threading.Event()
    with pytest.MonkeyPatch.context() as patch:
        made = viewers.LiveSession

        def held(*given):
            building.wait(LIMIT)
            return made(*given)

        patch.setattr(viewers, "LiveSession", held)
        page.goto(server.address())
        starts = "document.querySelector('#note').textContent.includes('it is compiled')"
        until(page, f"{starts} || document.querySelector('canvas') !== null")
        first = page.locator("nav a").count(), page.locator("canvas").count()
        building.set()
        page.wait_for_selector("canvas")
    return page, first


def test_the_first_page_comes_while_the_rig_is_built(tour):
    """What is compiled or designed takes a minute, and no page waits for it."""
    assert tour[1] == (len(TITLES), 0)


def record(page, server, seconds):
    """A record of at least so many seconds of the rig, as quickly as it can be computed."""
    press(page, server, "Record")
    runs_until(page, server, f"Number(/h5: ([\\d.]+) s/.exec({FACTS})?.[1]) > {seconds}")
    press(page, server, "Stop recording")


def test_a_record_a_wrong_value_and_a_controller_by_keyboard(tour, server, folder):
    """What the tour of the page leaves out."""
    page = tour[0]
    # knock it, and record it while it is shaken
    server.obeyed(lambda: page.locator("canvas").first.click(position={"x": 150, "y": 60}))
    if PICTURES:
        server.clock.advance(0.2)
        page.screenshot(path=f"{PICTURES}/tour-live.png")
    choose(page, server, "pace", "fast")
    press(page, server, "Excite")
    record(page, server, 1)
    press(page, server, "Stop exciting")
    choose(page, server, "pace", "real")
    runs_until(page, server, f"!{FACTS}.includes('excited')")
    (made,) = (folder / "records").glob("live-*.h5")
    # see and judge it
    go(page, "records")
    page.wait_for_selector("td.pass")
    assert made.name in page.locator("select").first.text_content()
    # the machine's own sentence beside a field
    go(page, "machine")
    page.wait_for_selector("figure svg")
    page.locator("summary", has_text="[[bearing]]").first.click()
    gap = page.locator("[name='bearing.0.gap']")
    gap.fill("3 kg")
    kept = (folder / "machine.toml").read_bytes()
    page.locator("details[open]").get_by_role("button", name="Save").first.click()
    page.wait_for_selector("small.bad:not(:empty)")
    assert "must be a length" in page.locator("small.bad:not(:empty)").first.text_content()
    assert (folder / "machine.toml").read_bytes() == kept
    # turn the PID by keyboard, keep what comes
    go(page, "controllers")
    page.wait_for_selector("figure svg")
    was = page.evaluate(DRAWN, "sensitivity")
    page.locator(".handle").first.press("ArrowUp")
    until(page, f"(was) => ({DRAWN})('sensitivity') !== was", arg=was)
    page.locator("[name=name]").fill("mine")
    page.get_by_role("button", name="Save as controller").click()
    mine = folder / "controllers" / "mine.json"  # the note may be followed by another one
    eventually(mine.exists)
    saved = json.loads(mine.read_text())
    assert saved["status"] == "verified"
    # but for the field that was refused
    assert [words for words in page.mistakes if "status of 400" not in words] == []


def test_the_tour_of_the_page(chromium, server, folder):
    """docs/how-to/workbench.md step by step, with its names of screens and buttons: from lift-off
    to a page that may be signed and code that is downloaded, every verdict good. A small machine:
    the same steps and verdicts, but for the PID, which holds it at every pressure.
    """
    _follow(chromium, server, folder, True)


@pytest.mark.study
def test_the_tour_of_the_page_on_its_machine(chromium, tmp_path):
    project = Project(tmp_path / "seal-rig-demo")
    begin(project, "seal-rig")
    server = Served(project)
    try:
        _follow(chromium, server, project.root, False)
    finally:
        server.end()


def _follow(chromium, server, folder, brief):
    seconds = 2 if brief else 5
    page = new_page(chromium)
    page.goto(server.address())
    page.wait_for_selector("canvas")
    # down, up again, and knocked
    press(page, server, "Drop")
    runs_until(page, server, f"/touches/.test({FACTS})")
    press(page, server, "Lift")
    runs_until(page, server, f"!/touches|failed/.test({FACTS})")
    server.clock.advance(2.5)  # until it stands in the middle
    server.obeyed(lambda: page.locator("canvas").first.click(position={"x": 150, "y": 60}))
    if PICTURES:
        server.clock.advance(0.1)
        page.screenshot(path=f"{PICTURES}/live.png")
    # a person sees it come back before the next press
    server.clock.advance(3.0)
    assert "touches" not in page.evaluate(FACTS)
    if not brief:  # as the page does not: quicker, and a record of half a minute
        choose(page, server, "pace", "fast")
    press(page, server, "Excite")
    record(page, server, seconds)
    go(page, "identification")
    assert page.locator("[name=record]").input_value().startswith("live-pid-")
    assert page.locator("[name=controller]").input_value() == "pid.json"
    assert "Verdict: " in job(page, "Identify", "identify")
    before = (folder / "machine.toml").read_text()
    page.get_by_role("button", name="Write back").click()
    until(page, "document.querySelector('#note').textContent.includes('before.toml')")
    assert (folder / "machines" / "before.toml").read_text() == before
    assert (folder / "machine.toml").read_text() != before
    go(page, "controllers")
    page.wait_for_selector("figure svg")
    if not brief:  # the one of the machine file does not hold it at every pressure
        assert page.locator("td.fail", has_text="unstable").count()
    assert page.locator("[name=method]").input_value() == "tuned"
    job(page, "Design", "synthesize")
    page.locator("[name='with.tuned.json']").check()
    page.wait_for_selector("td:text-is('tuned.json')")
    row = page.locator("tr", has=page.locator("td:text-is('tuned.json')"))
    assert row.locator("td.fail").count() == 0 and row.locator("td.pass").count() == 3
    if PICTURES:
        page.screenshot(path=f"{PICTURES}/controllers.png", full_page=True)
    go(page, "live")
    page.wait_for_selector("canvas")
    page.locator("[name=controller]").first.select_option("tuned.json")
    press(page, server, "Switch")
    runs_until(page, server, f"{FACTS}.includes('tuned.json') && {FACTS}.includes('excited')")
    assert "touches" not in page.evaluate(FACTS)
    record(page, server, seconds)
    press(page, server, "Stop exciting")
    go(page, "envelope")
    assert "PASSED: " in job(page, "Verify", "verify")
    go(page, "acceptance")
    assert page.locator("[name=record]").input_value().startswith("live-tuned-")
    assert page.locator("[name=controller]").input_value() == "tuned.json"
    job(page, "Measure and check", "accept")
    page.wait_for_selector("h2.good:has-text('accept-')")
    with page.context.expect_page() as alone:
        page.get_by_role("link", name="Open it alone").click()
    signed = alone.value
    signed.wait_for_load_state()
    words = signed.evaluate("document.body.innerText")
    assert "PASSED: 1 operating point" in words and "signature" in words
    if PICTURES:
        signed.screenshot(path=f"{PICTURES}/acceptance.png", full_page=True)
    signed.close()
    go(page, "deploy")
    assert page.locator("[name=controller]").input_value() == "tuned.json"
    log = job(page, "Export", "export")
    assert "misses" not in log
    page.get_by_role("button", name="Self test").click()
    page.wait_for_selector("h2.good:has-text('Self test')")
    page.get_by_role("button", name="Pack").click()
    with page.expect_download() as download:
        page.get_by_role("link", name="Download").click()
    names = zipfile.ZipFile(download.value.path()).namelist()
    assert "c-double/controller.c" in names
    if PICTURES:
        page.screenshot(path=f"{PICTURES}/deploy.png", full_page=True)
    # the rig of the machine as it is now
    go(page, "live")
    page.wait_for_selector("canvas")
    runs_until(page, server, f"{FACTS}.includes('machine file has changed: start again')")
    page.locator("[name=controller]").last.select_option("pid.json")
    page.get_by_role("button", name="Start levitated", exact=True).click()
    until(page, f"{FACTS} !== '' && !{FACTS}.includes('tuned.json')")
    runs_until(page, server, f"!/has changed|tuned/.test({FACTS})")
    assert page.mistakes == []
    # every verdict good: the record's beginning, when the rotor has just been knocked, is left out
    states = [json.loads(path.read_text()) for path in folder.glob("jobs/*/job.json")]
    assert [(s["words"][0], s["status"]) for s in states if s["status"] != 0] == []
    page.context.close()


LATE = """async ([action, say]) => {
  const own = window.fetch;
  const form = (await (await own("/api/screens/controllers", { method: "POST", body: "{}" })).json())
    .blocks.find((block) => block.key === "bench");
  window.fetch = async (path, ...more) => {
    const answer = await own(path, ...more);
    if (!path.endsWith(action)) return answer;
    const told = await answer.json();
    while (!window.typed) await new Promise((done) => setTimeout(done, 10));
    told.blocks.unshift({ ...form, hint: say }); // as where a controller was written meanwhile
    return new Response(JSON.stringify(told));
  };
  const gain = document.querySelector("[name='channel.0.gain']");
  gain.value = 1.02 * Number(gain.value);
  gain.dispatchEvent(new Event("change"));
}"""


def test_a_name_that_is_typed_while_an_answer_is_late_stays(chromium, server):
    """The answer to a number draws the whole form anew, once the name is written."""
    page = new_page(chromium)
    page.goto(server.address() + "#controllers")
    page.wait_for_selector("figure svg")
    page.evaluate(LATE, ["look", "as it is now"])
    name = page.locator("[name=name]")
    name.fill("a-name-of-mine")
    name.evaluate("(e) => e.setSelectionRange(2, 6)")
    at = page.locator("[name='channel.0.gain']").input_value()
    page.evaluate("window.typed = true")
    until(page, "document.body.textContent.includes('as it is now')")
    assert name.input_value() == "a-name-of-mine"
    caret = "(e) => [document.activeElement === e, e.selectionStart, e.selectionEnd]"
    assert name.evaluate(caret) == [True, 2, 6]
    assert page.locator("[name='channel.0.gain']").input_value() == at
    assert page.mistakes == []
    page.context.close()


@pytest.mark.parametrize("width, scheme", [(1400, "light"), (400, "dark")])
def test_every_screen_fits(tour, server, chromium, width, scheme):
    page = new_page(chromium, width, color_scheme=scheme, reduced_motion="reduce")
    page.goto(server.address() + "#machine")
    for screen in TITLES:
        go(page, screen)
        until(page, "!document.querySelector('main').textContent.includes('Looking')")
        if screen == "live":
            page.wait_for_selector("canvas")
            server.clock.advance(0.2)
        # nothing sticks out, what is wide scrolls in itself
        assert page.evaluate("document.documentElement.scrollWidth") <= width
        if screen != "live":
            said = page.locator("summary, pre", has_text="ambrose").first
            said.wait_for(state="attached")
        # every field can be reached and has a name
        nameless = page.evaluate(
            "[...document.querySelectorAll('input, select, textarea, button')].filter((e) =>"
            " !e.labels?.length && !e.ariaLabel && !e.textContent).length"
        )
        assert nameless == 0
        assert page.title().endswith("Ambrose")
        if PICTURES:
            page.screenshot(path=f"{PICTURES}/{screen}-{width}-{scheme}.png", full_page=True)
    assert page.mistakes == []
    page.context.close()


@pytest.mark.parametrize("width", [1400, 400])
def test_every_screen_says_where_one_is_and_its_verdict_first(tour, server, chromium, width):
    page = new_page(chromium, width)
    page.goto(server.address() + "#machine")
    chain = [name for name in TITLES if name not in {"studies", "jobs"}]
    for screen in TITLES:
        go(page, screen)
        if screen == "live":
            page.wait_for_selector("canvas")
            server.clock.advance(0.4)
        where, step, following = page.locator("main > p"), "", []
        if screen in chain:
            place = chain.index(screen)
            step = f"Step {place + 1} of {len(chain)}: {TITLES[screen]}. "
            following = [f"#{name}" for name in chain[place + 1 : place + 2]]
        assert where.text_content().startswith(step) and bool(step) == bool(where.text_content())
        assert [link.get_attribute("href") for link in where.locator("a").all()] == following
        verdict = page.locator(".facts b" if screen == "live" else ".blocks .panel").first
        assert re.search(
            r"PASSED|FAILED|IMPLAUSIBLE|levitates|No result yet|The run |\d: ",
            verdict.text_content(),
        )
        box = verdict.bounding_box()
        # whole, also a sentence of two clauses, in the upper half of a telephone's 800 pixels
        lowest = 300 if width > 400 else 400
        assert box["y"] + box["height"] < lowest, (screen, verdict.text_content())
    page.context.close()


@pytest.mark.parametrize("width", [1400, 900, 400])
def test_curves_stay_in_sight_of_what_turns_them(tour, server, chromium, width):
    page = new_page(chromium, width)
    seen = "([kind]) => { const box = document.querySelector(kind).getBoundingClientRect();"
    seen += " return box.top >= 0 && box.bottom <= innerHeight; }"
    turned = {"controllers": "[name='channel.0.gain']", "live": "input[type=range]"}
    for screen, drawn in (("controllers", "figure svg"), ("live", "canvas")):
        page.goto(server.address() + f"#{screen}")
        page.wait_for_selector(drawn)
        page.evaluate(
            "([kind]) => { const figure = document.querySelector(kind);"
            " scrollTo(0, figure.getBoundingClientRect().top + scrollY - 10); }",
            [drawn],
        )
        assert page.evaluate(seen, [turned[screen]])
        figure = page.locator(drawn).first.bounding_box()
        slider = page.locator(turned[screen]).first.bounding_box()
        apart = (
            slider["x"] + slider["width"] <= figure["x"]
            or figure["x"] + figure["width"] <= slider["x"]
        )
        assert apart == (width > 640)
        assert apart or slider["y"] - figure["y"] > 300  # what is drawn above the sliders
    page.context.close()


def test_a_check_does_not_move_the_rows(tour, server, chromium):
    """Its tables came above them."""
    page = new_page(chromium)
    page.goto(server.address() + "#controllers")
    page.wait_for_selector("figure svg")
    gain = page.locator("[name='channel.0.gain']")
    check = page.get_by_role("button", name="Check on the full plant")
    check.scroll_into_view_if_needed()
    before = gain.bounding_box(), gain.input_value()
    check.click()
    page.wait_for_selector("h2:has-text('Full plant:')")
    assert (gain.bounding_box(), gain.input_value()) == before
    page.context.close()


def test_a_notch_is_dragged_undone_saved_and_judged(server, chromium, folder, request):
    """The row, the handle under the hand and the sensitivity follow; undo brings back."""
    page = new_page(chromium)
    page.goto(server.address() + "#controllers")
    page.wait_for_selector("figure svg")
    page.get_by_label("Add a filter to").first.select_option("notch")
    handle = page.get_by_role("button", name=re.compile("^notch .*: centre and depth")).first
    handle.wait_for()
    row = page.locator("section:has(> .buttons > b:text-matches('^notch'))").last
    numbers = [row.locator(f"[name$={key}]") for key in ("zero_frequency", "zero_damping")]

    def values():
        return [float(number.input_value()) for number in numbers]

    began, drawn = values(), page.evaluate(DRAWN, "sensitivity")
    handle.scroll_into_view_if_needed()
    box = handle.bounding_box()
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    page.mouse.move(x, y)
    page.mouse.down()
    for share in (0.2, 0.6, 1.0):
        page.mouse.move(x + 30 * share, y + 12 * share)
    page.mouse.up()
    until(page, f"(was) => ({DRAWN})('sensitivity') !== was", arg=drawn)
    frequency, damping = values()
    assert frequency > 1.05 * began[0] and damping < 0.98 * began[1]
    # drawn anew, it is where the hand left it; its words say the row's frequency
    until(
        page,
        "(hertz) => [...document.querySelectorAll('.handle')].some((e) =>"
        " e.ariaLabel.startsWith('notch') && e.ariaLabel.endsWith(hertz))",
        arg=f" {frequency:.4g} Hz",
    )
    box = handle.bounding_box()
    assert abs(box["x"] + box["width"] / 2 - x - 30) < 3
    handle.press("ArrowRight")
    assert handle.evaluate("(e) => document.activeElement.ariaLabel.startsWith('notch')")
    assert values()[0] > frequency
    for _ in range(2):  # the key, and the drag as one
        page.get_by_role("button", name="Undo", exact=True).click()
    assert values() == began
    until(page, f"(was) => ({DRAWN})('sensitivity') === was", arg=drawn)
    page.get_by_role("button", name="Redo", exact=True).click()
    assert values() == [frequency, damping]
    # what is kept is what is drawn
    page.locator("[name=name]").fill("notched")
    page.get_by_role("button", name="Save as controller").click()
    file = folder / "controllers" / "notched.json"
    eventually(file.exists)
    request.addfinalizer(file.unlink)
    section = json.loads(file.read_text())["filters"]["channel"][0]["section"][-1]
    assert section["zero_frequency"] / (2 * math.pi) == pytest.approx(frequency, rel=1e-6)
    page.get_by_role("button", name="Check on the full plant").click()
    page.wait_for_selector("h2:has-text('Full plant:')")
    # one that does not hold the rotor: said at once, and nothing of the stable one is left
    gain = page.locator("[name='channel.0.gain']")
    gain.fill("0.001")
    gain.press("Tab")
    page.wait_for_selector("p.bad:has-text('FAILED: the loop is unstable at')")
    until(page, f"() => !({DRAWN})('sensitivity') && Boolean(({DRAWN})('open loop'))")
    assert page.locator("h2:has-text('Full plant:')").count() == 0
    assert page.mistakes == []
    page.context.close()


def test_a_rotor_is_edited_as_a_spreadsheet(chromium, tmp_path):
    """Drawing and modes follow every cell, what is wrong is told below its row, Save writes what is
    typed and nothing else.
    """
    project = Project(tmp_path)
    begin(project, "two-disc-rotor")
    server = Served(project)
    text = project.machine.read_text("utf-8")
    try:
        page = new_page(chromium)
        page.goto(server.address() + "#machine")
        page.wait_for_selector("figure svg")
        drawn, modes = page.evaluate(DRAWN, "the rotor"), page.locator("td:has-text('Hz')").first

        def cell(place):
            return page.locator(f"[name='{place}']")

        first = modes.text_content()
        cell("shaft.1.outer_diameter").click()
        page.keyboard.type("60")
        page.keyboard.press("Enter")
        assert page.evaluate("document.activeElement.name") == "shaft.2.outer_diameter"
        until(page, f"(was) => ({DRAWN})('the rotor') !== was", arg=drawn)
        page.wait_for_selector("p.muted:has-text('No result yet')")
        assert modes.text_content() != first
        assert float(page.locator("#screen [data-computing]").get_attribute("data-computing")) > 0
        page.keyboard.press("Control+z")
        until(page, f"(was) => ({DRAWN})('the rotor') === was", arg=drawn)
        assert modes.text_content() == first
        page.keyboard.press("Control+y")
        last = text.count("[[shaft]]") - 1
        lengths = page.locator("[name^='shaft.'][name$='.length']")

        def rows():
            return [one.input_value() for one in lengths.all()], cell("shaft.1.label").input_value()

        began = rows()
        cell("shaft.0.length").focus()
        for words in (
            "Copy",
            "Move up",
            "Delete",
            "Move down",
        ):  # the copy goes to the top, and away
            page.get_by_role("button", name=f"{words} shaft row").click()
        assert rows()[0] == began[0] and rows()[1] == "left end"
        for _ in range(4):
            page.get_by_role("button", name="Undo", exact=True).click()
        assert rows() == began
        # a whole table with its names, then two rows of a spreadsheet, the second behind the end
        cell("shaft.0.length").focus()
        whole = "length [mm]\tod [mm]\tod right [mm]\n500\t40\t\n500\t50\t60\n500\t40\t"
        page.evaluate(PASTE, whole)
        until(page, "document.querySelectorAll(`[name^='shaft.'][name$='.length']`).length === 3")
        assert cell("shaft.1.end_outer_diameter").input_value() == "60"
        page.locator("summary", has_text="[machine]").first.click()  # another table is saved
        page.locator("details[open]").get_by_role("button", name="Save").first.click()
        until(page, "document.querySelector('#note').textContent.includes('is saved')")
        assert lengths.count() == 3
        page.get_by_role("button", name="Undo", exact=True).click()
        assert rows() == began
        cell(f"shaft.{last}.length").focus()
        page.evaluate(PASTE, "250\t30\r\n25\t20,5\r\n")
        wrong = page.locator("tr.bad")
        wrong.wait_for()
        assert 'write "20.5 mm"' in wrong.text_content()
        assert cell(f"shaft.{last + 1}.outer_diameter").get_attribute("aria-invalid") == "true"
        until(page, "document.querySelector('#note').textContent.includes('decimal mark')")
        # Save is refused after its cause was corrected: the row is right all the same
        late = []

        def hold(route):  # a method of a list is no handler here
            late.append(route)

        page.route("**/screens/machine/rows", hold)
        page.get_by_role("button", name="Save", exact=True).first.click()
        while not late:
            page.wait_for_timeout(1000 * POLL)
        cell(f"shaft.{last + 1}.outer_diameter").fill("20.5")
        page.keyboard.press("Tab")
        with page.expect_response("**/screens/machine/rows") as refused:
            late[0].continue_()
        assert refused.value.status == 400
        page.unroute("**/screens/machine/rows")
        wrong.wait_for(state="detached")
        assert project.machine.read_text("utf-8") == text
        page.get_by_role("button", name="Save", exact=True).first.click()
        until(page, "document.querySelector('#note').textContent.includes('is saved')")
        shaft = load_machine(project.machine).shaft
        assert [(s.length, s.outer_diameter) for s in shaft[last:]] == [
            (0.25, 0.03),
            (0.025, 0.0205),
        ]
        assert shaft[1].outer_diameter == 0.06
        kept = [line for line in text.splitlines() if "#" in line]
        assert [
            line for line in project.machine.read_text("utf-8").splitlines() if "#" in line
        ] == kept
        assert [words for words in page.mistakes if "status of 400" not in words] == []
        page.context.close()
    finally:
        server.end()


def test_a_button_that_cannot_act_is_grey(tour, server, chromium, tmp_path):
    page = new_page(chromium)
    page.goto(server.address() + "#live")
    page.wait_for_selector("canvas")
    server.clock.advance(0.4)

    def grey():
        names = ("Drop", "Lift", "Record", "Stop recording", "Stop exciting")
        buttons = {name: page.get_by_role("button", name=name, exact=True) for name in names}
        return {name for name, button in buttons.items() if button.is_disabled()}

    assert grey() == {"Lift", "Stop recording", "Stop exciting"}
    press(page, server, "Record")
    server.clock.advance(0.4)
    assert grey() == {"Lift", "Record", "Stop exciting"}
    press(page, server, "Stop recording")
    server.clock.advance(0.4)
    page.context.close()
    # nor one that needs a file where there is none
    project = Project(tmp_path / "bare")
    begin(project, "flywheel")
    own = Served(project)
    try:
        page = new_page(chromium)
        page.goto(own.address() + "#envelope")
        button = page.get_by_role("button", name="Verify", exact=True)
        assert button.is_disabled()
        assert button.get_attribute("title") == "There is no controller yet"
        page.context.close()
    finally:
        own.end()


TEXTS = """() => {
  window.texts = new Map();
  const own = CanvasRenderingContext2D.prototype.fillText;
  CanvasRenderingContext2D.prototype.fillText = function (text, ...more) {
    if (!window.texts.has(this.canvas)) window.texts.set(this.canvas, new Set());
    window.texts.get(this.canvas).add(text);
    return own.call(this, text, ...more);
  };
}"""


@pytest.mark.parametrize("width", [1400, 400])
def test_a_rig_shows_its_bearings_a_scale_and_units_at_once(chromium, server, width):
    """Four empty squares, and an axis of time on which 10 m was 10 ms."""
    page = new_page(chromium, width)
    page.goto(server.address() + "#live")
    page.wait_for_selector("canvas")
    page.evaluate(TEXTS)
    page.locator("canvas").last.scroll_into_view_if_needed()
    server.clock.advance(1.0)
    page.locator("canvas").first.scroll_into_view_if_needed()
    server.clock.advance(0.4)
    drawn = page.evaluate(
        "[...document.querySelectorAll('canvas')].map((c) => [...window.texts.get(c) || []])"
    )
    stations = page.locator("figcaption").all_text_contents()
    length = re.compile(r"[\d.]+ [nµm]m")
    for texts, caption in zip(drawn, stations, strict=False):
        assert any(length.fullmatch(text) for text in texts)  # of its own scale
        assert ("touchdown gap" in caption) == ("A" in texts)  # zones and ring, of bearings
    assert sum("touchdown gap" in caption for caption in stations) == 2
    time, spectrum = drawn[len(stations) + 1 :][:2]
    assert any(re.fullmatch(r"\d+ ms", text) for text in time)
    assert any(re.fullmatch(r"[\d.]+ k?Hz", text) for text in spectrum)
    assert not [t for t in (*time, *spectrum) if re.fullmatch(r"-?[\d.]+( [nµkM])?", t)]
    assert {t for t in (*time, *spectrum) if re.fullmatch(r"-?[\d.]+ m", t)} <= {"0 m"}
    page.context.close()


# what a hand does to every field, and what it finds there afterwards
FILL = """() => {
  for (const e of document.querySelectorAll("main details")) e.open = true;
  for (const e of document.querySelectorAll("main [name]")) {
    if (e.type === "checkbox") e.checked = !e.checked;
    else if (e.options) e.selectedIndex = e.options.length - 1;
    else if (e.type === "range") e.value = Number(e.value) + 0.01 * (e.max - e.min);
    else if (e.type !== "file") e.value = `by hand ${e.name}`;
  }
  for (const e of document.querySelectorAll("main .wide, main textarea")) e.scrollTo(25, 30);
  const last = [...document.querySelectorAll("main [type=text], main button")].pop();
  last?.focus();
  last?.setSelectionRange?.(3, 5);
  for (const e of document.querySelectorAll("main .panel:not(:has(.chains, .cells))")) e.dataset.old = "";
}"""
FOUND = """() => {
  const [all, held] = [(what) => [...document.querySelectorAll(`main ${what}`)], document.activeElement];
  return {
    typed: all("[name]").map((e) => [e.name, e.value, e.checked]),
    open: all("details").map((e) => e.open),
    scroll: all(".wide, textarea").map((e) => [e.scrollLeft, e.scrollTop]),
    focus: [held.name || held.textContent, held.selectionStart, held.selectionEnd],
  };
}"""


@pytest.mark.parametrize("screen", [name for name in TITLES if name != "live"])
def test_a_redraw_keeps_what_a_hand_did(chromium, server, folder, screen, request):
    page = new_page(chromium, 400)
    if screen == "records":  # one whose columns are asked for
        table = folder / "records" / "table.csv"
        table.parent.mkdir(exist_ok=True)
        for other in table.parent.iterdir():  # of other tests: the form would choose among them
            hidden = other.rename(folder / f"hidden-{other.name}")
            request.addfinalizer(partial(hidden.rename, other))
        table.write_text("a,b\n1,2\n")
        request.addfinalizer(table.unlink)
    redrawn = []

    def changed(route):
        """Every block otherwise than the time before, on a screen that asks for its jobs."""
        answer = route.fetch()
        told = answer.json()
        redrawn.append(len(redrawn))
        blocks = [{**block, "title": f"{block['title']} {redrawn[-1]}"} for block in told["blocks"]]
        route.fulfill(response=answer, json={**told, "blocks": blocks, "jobs": ["*"], "ended": 0})

    page.route(f"**/api/screens/{screen}", changed)
    ended = [0]
    page.route("**/api/jobs", lambda route: route.fulfill(json={"blocks": [], "ended": ended[0]}))
    page.goto(server.address() + f"#{screen}")
    page.wait_for_selector("main .panel")
    page.evaluate("document.getElementById('note').textContent = 'said before'")
    page.evaluate(FILL)
    before = page.evaluate(FOUND)
    ended[0] = 1
    until(page, "!document.querySelector('main [data-old]')")
    ended[0] = 0
    after = page.evaluate(FOUND)
    if screen == "jobs":  # nothing to hold there yet
        del after["focus"], before["focus"]
    assert after == before
    assert before["typed"] or screen in {"jobs"}
    assert page.locator("#note").text_content() == "said before"
    assert page.mistakes == []
    page.unroute_all(behavior="ignoreErrors")
    page.context.close()


# a scope that hears one tone after the other; what its waterfall then shows, row by row from the top:
# the middle of what is marked [Hz] and how wide it is [Hz]
FALL = """async (tones) => {
  const { scope } = await import("/static/scope.js");
  const signal = { name: "signal", label: "Signal", kind: "choice", options: ["y A"], value: "y A" };
  const span = { name: "span", label: "Seconds", kind: "choice", options: ["0.1"], value: "0.1" };
  const trigger = { name: "trigger", label: "Trigger", kind: "choice", options: ["free"], value: "free" };
  const form = { fields: [signal, span, trigger], buttons: [], live: "", hint: "", title: "Scope" };
  const dt = 1e-4;
  const watch = scope({ columns: ["x A", "y A"], dt, speed: 2000, scope: form });
  document.querySelector("main").replaceChildren(watch.panel);
  const fall = [...document.querySelectorAll("canvas")].pop();
  while (!fall.room) await new Promise((done) => setTimeout(done, 20));
  let time = 0;
  for (const [tone, size] of tones) {
    const samples = new Float32Array(2 * 4096);
    for (let k = 0; k < 4096; k += 1) {
      samples[2 * k] = Math.sin(2 * Math.PI * 77 * k * dt); // of another column
      samples[2 * k + 1] = 1e-6 * size * Math.sin(2 * Math.PI * tone * k * dt);
    }
    time += 4096 * dt;
    const head = { time, clock: time, speed: 100 };
    watch.add(head, samples);
    watch.draw(head); // a line at most four times a second
  }
  const { data, width } = fall.getContext("2d").getImageData(0, 0, fall.width, fall.height);
  // as the spectrum above it: three times the top speed, 62 px to the left of it and 8 to the right
  const top = (Math.round((2048 * dt * 3 * 2000) / 6) - 1) / (2048 * dt);
  return Array.from({ length: 3 * tones.length + 3 }, (_, row) => {
    const marked = [];
    for (let p = 0; p < width; p += 1) if (data[4 * (row * width + p) + 3] > 40) marked.push(p);
    const middle = (marked[0] + marked[marked.length - 1] + 1) / 2;
    const hertz = top / (width - 70);
    const wide = marked[marked.length - 1] + 1 - marked[0];
    return marked.length ? [(middle - 62) * hertz, wide * hertz, 2 * hertz] : null;
  });
}"""


@pytest.mark.parametrize("width", [1400, 400])
def test_the_waterfall_shows_every_tone_at_its_frequency_the_newest_on_top(chromium, server, width):
    page = new_page(chromium, width)
    page.goto(server.address() + "#jobs")
    page.wait_for_selector("main .panel")
    tones = [(150.0, 1.0), (400.0, 1e-4), (700.0, 1.0)]  # the small one is marked as well
    rows = page.evaluate(FALL, tones)
    assert rows[9:] == [None] * 3  # nothing is older
    step = 1e4 / 2048  # [Hz] between two lines
    for i, (tone, _) in enumerate(reversed(tones)):
        for middle, wide, mark in rows[3 * i : 3 * i + 3]:
            assert middle == pytest.approx(tone, abs=0.5 * step + mark)
            # Hann's window: side lobes above 0.3 % of the peak, five lines to each side
            assert wide < 2 * (5 * step + mark)
    assert page.mistakes == []
    page.context.close()


WRITTEN = """() => {
  window.written = {};
  const own = CanvasRenderingContext2D.prototype.fillText;
  CanvasRenderingContext2D.prototype.fillText = function (text, ...more) {
    const axis = /^(\\w+): (.*) A /.exec(text);
    if (axis) window.written[axis[1]] = axis[2];
    return own.call(this, text, ...more);
  };
}"""


def test_what_is_drawn_of_an_amplifier_flows_in_its_coil(chromium, server):
    """Commands of 4 A were drawn while all amplifiers had failed."""
    page = new_page(chromium)
    page.goto(server.address() + "#live")
    page.wait_for_selector("canvas")
    page.evaluate(WRITTEN)
    page.get_by_role("heading", name="Control currents").scroll_into_view_if_needed()
    press(page, server, "Drop")
    server.clock.advance(1.0)
    told = page.evaluate("window.written")
    assert told and set(told.values()) <= {"0.00 to 0.00", "-0.00 to 0.00", "-0.00 to -0.00"}
    press(page, server, "Lift")
    server.clock.advance(1.0)
    press(page, server, "Excite")
    server.clock.advance(0.2)
    assert not set(page.evaluate("window.written").values()) & set(told.values())
    press(page, server, "Stop exciting")
    assert page.mistakes == []
    page.context.close()


LIVE = """() => {
  const chosen = {};
  for (const e of document.querySelectorAll("main select")) {
    if (["pace"].includes(e.name)) continue; // of the rig, which says where it stands
    const others = [...e.options].filter((option) => option.value !== e.value);
    if (others.length) e.value = others.pop().value; // by hand
    chosen[e.name] = e.value;
  }
  for (const e of document.querySelectorAll("main details")) e.open = true;
  document.querySelector("main [name=signal]").focus();
  for (const e of document.querySelectorAll("main .panel")) e.dataset.old = "";
  const other = new WebSocket(`ws://${location.host}/live`); // another page starts the rig again
  other.onopen = () => other.send('{"do": "restart"}');
  other.onmessage = (event) => typeof event.data === "string" || other.send("ok");
  return chosen;
}"""


def test_a_rig_that_begins_anew_keeps_what_was_chosen_on_its_page(chromium, server):
    page = new_page(chromium)
    page.goto(server.address() + "#live")
    page.wait_for_selector("canvas")
    before = page.evaluate(LIVE)
    assert {"station", "axis", "signal", "span", "trigger", "controller"} <= before.keys()
    until(page, "!document.querySelector('main [data-old]')")
    server.clock.advance(0.4)  # words and places of sliders come five times a second
    after = page.evaluate(
        "() => Object.fromEntries([...document.querySelectorAll('main select')]"
        ".filter((e) => e.name !== 'pace').map((e) => [e.name, e.value]))"
    )
    assert after == before
    assert page.evaluate("document.activeElement.name") == "signal"
    assert page.evaluate("[...document.querySelectorAll('main details')].every((e) => e.open)")
    assert page.mistakes == []
    page.context.close()


def test_a_job_that_ends_while_one_types_changes_nothing_but_what_it_made(
    chromium, server, folder, request
):
    page = new_page(chromium)
    page.clock.install()
    page.goto(server.address() + "#controllers")
    page.wait_for_selector("figure svg")
    gain, name = page.locator("[name='channel.0.gain']"), page.locator("[name=name]")
    gain.fill(str(1.02 * float(gain.input_value())))
    gain.press("Tab")
    page.get_by_role("button", name="Check on the full plant").click()
    until(page, "document.querySelector('#note').textContent.includes('on the full plant')")
    turned = "() => ({ at: document.querySelector('[name=\"channel.0.gain\"]').value,"
    turned += " peaks: document.querySelector('td.pass, td.fail').closest('tr').textContent,"
    turned += " said: document.querySelector('#note').textContent })"
    before = page.evaluate(turned)
    name.fill("half written")
    name.evaluate("(e) => e.setSelectionRange(4, 4)")
    late = folder / "controllers" / "late.json"
    late.parent.mkdir(exist_ok=True)
    late.write_text("{}")
    request.addfinalizer(late.unlink)
    start = "fetch('/api/jobs/start', { method: 'POST', body: '{\"kind\": \"check\"}' })"
    page.evaluate(start)
    page.wait_for_selector("[name='with.late.json']")
    assert page.evaluate(turned) == before
    assert name.input_value() == "half written"
    assert name.evaluate("(e) => [document.activeElement === e, e.selectionStart]") == [True, 4]
    page.context.close()


def test_what_is_typed_over_a_value_that_changed_is_neither_lost_nor_written(
    chromium, server, folder
):
    page = new_page(chromium)
    page.goto(server.address() + "#machine")
    page.wait_for_selector("figure svg")
    for title in ("[operation]", "The whole file"):
        page.locator("summary", has_text=title).first.click()
    text = page.locator("textarea")
    mine = f"# mine\n{text.input_value()}"
    text.fill(mine)
    # the same page saves a table of the file
    gap = page.locator("[name='machine.name'], [name='name']").first
    page.locator("summary", has_text="[machine]").first.click()
    gap.fill("renamed")
    page.locator("details[open]").get_by_role("button", name="Save").first.click()
    until(page, "document.querySelector('#note').textContent.includes('is saved')")
    kept = (folder / "machine.toml").read_text()
    assert "renamed" in kept and text.input_value() == mine
    page.locator("details[open]").get_by_role("button", name="Save").last.click()
    until(page, "document.querySelector('#note').textContent.includes('has changed since')")
    assert (folder / "machine.toml").read_text() == kept and text.input_value() == mine
    page.get_by_role("button", name="Reload").click()
    until(page, "(text) => document.querySelector('textarea').value === text", arg=kept)
    page.context.close()


def test_two_browsers_see_one_project(tour, server, chromium, folder):
    one, other = tour[0], new_page(chromium)
    other.goto(server.address() + "#machine")
    go(one, "machine")
    for page in (one, other):
        page.wait_for_selector("figure svg")
        page.locator("summary", has_text="The whole file").click()
    texts = [page.locator("textarea") for page in (one, other)]
    text = texts[0].input_value()
    texts[0].fill("# by the first\n" + text)
    texts[1].fill("# by the second\n" + text)
    for page, word in ((one, "is saved"), (other, "has changed since")):
        page.locator("details[open]").get_by_role("button", name="Save").click()
        until(
            page, "(word) => document.querySelector('#note').textContent.includes(word)", arg=word
        )
    assert (folder / "machine.toml").read_text().startswith("# by the first")
    assert texts[1].input_value().startswith("# by the second")  # nothing lost
    other.get_by_role("button", name="Reload").click()
    until(other, "document.querySelector('textarea').value.startsWith('# by the first')")
    # one rig for both: what one turns, the other sees
    for page in (one, other):
        go(page, "live")
        page.wait_for_selector("canvas")
    server.obeyed(lambda: one.locator("[name=gain]").press("ArrowRight"))
    server.clock.advance(0.4)
    values = other.locator(".value").all_text_contents()
    assert [value for value in values if re.match(r"1\.0[1-9]", value)]
    other.context.close()


def test_a_server_that_is_killed_comes_back_with_what_there_was(chromium, tmp_path, request):
    begin(Project(tmp_path), "turboexpander")
    server = Process(tmp_path)
    page = new_page(chromium)
    page.goto(server.address() + "#jobs")
    start = "(said) => fetch('/api/jobs/start', { method: 'POST', body: JSON.stringify(said) })"
    page.wait_for_selector("main .panel")
    page.evaluate(start, {"kind": "check"})
    page.wait_for_selector("h2:text-matches('^check-.*: done')")
    # half a minute's work: it is not over by itself before the kill
    page.evaluate(start, {"kind": "study"})
    page.wait_for_selector("h2:text-matches('^study-.*: running')")
    left = [
        pid for task in Path(f"/proc/{server.process.pid}/task").iterdir() for pid in children(task)
    ]
    assert len(left) >= 2  # the desk and the job
    server.end(signal.SIGKILL)
    eventually(lambda: not any(map(alive, left)))
    again = Process(tmp_path)
    request.addfinalizer(again.end)
    page.goto(again.address() + "#jobs")
    page.reload()
    page.wait_for_selector("h2:has-text('study-')")
    words = page.locator("h2").all_text_contents()
    assert [w for w in words if w.startswith("study-") and ": stopped" in w], words
    assert [w for w in words if w.startswith("check-") and ": done" in w], words
    page.context.close()
