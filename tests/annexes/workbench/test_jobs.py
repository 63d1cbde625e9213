"""Jobs are processes that end when they are told, with their server, and are found again."""

import asyncio
import json
import os
import random
import shutil
import time
from dataclasses import asdict

import pytest

pytest.importorskip("starlette", reason="no starlette: install the extra workbench")

from ambrose.annexes.workbench import jobs as module
from ambrose.annexes.workbench.jobs import Jobs
from ambrose.annexes.workbench.project import Project, begin
from ambrose.annexes.workbench.server import serve
from ambrose.core.checks import InvalidInput
from ambrose.core.processes import listening
from ambrose.machine.ordinary_file import claimed

# a child that makes a child, both for an hour; no second command is compiled or computed for it
SLEEPER = """
import os, subprocess, sys, threading, time
from ambrose.annexes.workbench.child import _end_with_the_server
threading.Thread(target=_end_with_the_server, daemon=True).start()
other = subprocess.Popen(["sleep", "3600"])
print(os.getpid(), other.pid, flush=True)
time.sleep(3600)
"""


@pytest.fixture
def project(tmp_path):
    made = Project(tmp_path)
    begin(made, "two-disc-rotor")
    return made


@pytest.fixture
def sleeping(tmp_path_factory, monkeypatch):
    """Every job sleeps an hour with a child of its own."""
    folder = tmp_path_factory.mktemp("sleeper")
    (folder / "sleeper.py").write_text(SLEEPER)
    path = os.pathsep.join([str(folder), *os.environ.get("PYTHONPATH", "").split(os.pathsep)])
    monkeypatch.setenv("PYTHONPATH", path)
    monkeypatch.setattr(module, "_CHILD", "sleeper")


def alive(pid):
    """Whether a process runs; one that nobody has buried yet does not."""
    try:
        with open(f"/proc/{pid}/stat") as file:
            return file.read().rpartition(")")[2].split()[0] not in {"Z", "X"}
    except OSError:
        return False


async def until(condition, seconds=600.0):
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end
        await asyncio.sleep(0.02)


def listing(jobs):
    """All jobs, the newest first, each with the end of its log."""
    found = reversed(jobs._jobs.values())
    return [{**asdict(job), "log": jobs._log(job.name)} for job in found]


def states(jobs):
    return [job["state"] for job in listing(jobs)]


def test_a_command_runs_and_its_result_is_an_ordinary_file(project):
    async def run():
        jobs = Jobs(project)
        jobs.start({"kind": "check"})
        await until(lambda: states(jobs) == ["done"])
        return listing(jobs)[0]

    job = asyncio.run(run())
    assert job["status"] in {0, 1} and "two-disc-rotor" in job["log"]
    (kept,) = listing(Jobs(project))
    assert (kept["state"], kept["log"]) == ("done", job["log"])


def test_jobs_cancelled_at_random_leave_no_process(project, sleeping):
    draw = random.Random(4)

    async def run():
        jobs = Jobs(project, workers=4)
        for _ in range(20):
            jobs.start({"kind": "check"})
        pids = set()
        names = [job["name"] for job in listing(jobs)]
        draw.shuffle(names)
        for name in names:
            if draw.random() < 0.5:  # waiting, beginning or under way
                await until(
                    lambda: any(job["log"] and job["ended"] is None for job in listing(jobs))
                )
            pids |= {
                int(pid)
                for job in listing(jobs)
                for pid in job["log"].split()[:2]
                if pid.isdecimal()
            }
            await jobs.cancel(name)
        pids |= {
            int(pid) for job in listing(jobs) for pid in job["log"].split()[:2] if pid.isdecimal()
        }
        await until(lambda: not jobs._processes)
        await until(lambda: not any(map(alive, pids)))
        return jobs, pids

    jobs, pids = asyncio.run(run())
    assert set(states(jobs)) == {"cancelled"}
    assert len(pids) >= 2


def test_a_server_that_is_killed_takes_its_jobs_along_and_finds_them_again(
    project, sleeping, tmp_path_factory
):
    left = tmp_path_factory.mktemp("left") / "project"

    async def run():
        jobs = Jobs(project, workers=1)
        jobs.start({"kind": "check"})
        jobs.start({"kind": "check"})
        await until(lambda: listing(jobs)[1]["log"])
        pids = [int(pid) for pid in listing(jobs)[1]["log"].split()]
        # what a kill leaves on the disk, and what the system does for a process that is killed
        shutil.copytree(project.root, left)
        next(iter(jobs._processes.values())).stdin.close()
        await until(lambda: not any(map(alive, pids)))
        await jobs.close()

    asyncio.run(run())
    again = Jobs(Project(left))
    assert states(again) == ["stopped", "stopped"]
    assert listing(again)[1]["log"]


QUICK = "print('done', flush=True)"


@pytest.fixture
def quick(tmp_path_factory, monkeypatch):
    """Every job is over at once."""
    folder = tmp_path_factory.mktemp("quick")
    (folder / "quick.py").write_text(QUICK)
    path = os.pathsep.join([str(folder), *os.environ.get("PYTHONPATH", "").split(os.pathsep)])
    monkeypatch.setenv("PYTHONPATH", path)
    monkeypatch.setattr(module, "_CHILD", "quick")


def test_a_folder_that_disappears_while_its_job_waits_holds_no_other_up(project, quick):
    """The queue was dead for good."""

    async def run():
        jobs = Jobs(project, workers=1)
        for _ in range(3):
            jobs.start({"kind": "check"})
        shutil.rmtree(project.root / "jobs" / "check-2")
        await until(lambda: states(jobs) == ["done"] * 3)
        return jobs

    jobs = asyncio.run(run())
    assert states(Jobs(project)) == ["done"] * 3 and not jobs._unwritten


def test_a_job_that_is_cancelled_as_it_begins_is_cancelled(project, sleeping):
    """Between its turn and its process nothing happened."""

    async def run():
        jobs = Jobs(project, workers=1)
        jobs.start({"kind": "check"})
        await jobs.cancel("check-1")
        await until(lambda: not jobs._tasks)
        return states(jobs)

    assert asyncio.run(run()) == ["cancelled"]


def test_a_place_that_cannot_be_is_told_and_the_next_job_runs(project, quick, tmp_path_factory):
    async def run():
        jobs = Jobs(project, workers=1)
        for _ in range(3):
            jobs.start({"kind": "check"})
        shutil.rmtree(project.root / "jobs" / "check-2")
        (project.root / "jobs" / "check-2").symlink_to(tmp_path_factory.mktemp("outside"))
        await until(lambda: states(jobs) == ["done", "failed", "done"])
        return jobs.shown(["*"])[1]["log"]

    assert "the job could not be run: check-2 leads out" in asyncio.run(run())


def test_a_disk_that_is_full_for_a_while_stalls_no_queue(project, quick, monkeypatch):
    """A state that could not be written was counted as running for ever."""
    write = module.write_json
    full = [False]

    def written(path, content, what):
        if full[0]:
            raise InvalidInput(f"cannot write the {what} {path}: No space left on device")
        write(path, content, what)

    monkeypatch.setattr(module, "write_json", written)

    async def run():
        jobs = Jobs(project, workers=1)
        for _ in range(2):
            jobs.start({"kind": "check"})
        full[0] = True
        await until(lambda: states(jobs) == ["done"] * 2)
        assert "No space left" in jobs.shown(["*"])[0]["log"]
        with pytest.raises(InvalidInput, match="No space left"):
            jobs.start({"kind": "check"})  # and none that nobody would find again
        full[0] = False
        jobs.start({"kind": "check"})
        await until(lambda: states(jobs) == ["done"] * 3)

    asyncio.run(run())
    assert states(Jobs(project)) == ["done"] * 3  # what was not written then was written with it


def test_a_process_that_cannot_be_started_is_told_and_the_next_job_runs(
    project, quick, monkeypatch
):
    start, tries = asyncio.create_subprocess_exec, []

    async def failing(*words, **options):
        tries.append(words)
        if len(tries) == 1:
            raise BlockingIOError(11, "Resource temporarily unavailable")
        return await start(*words, **options)

    monkeypatch.setattr(module.asyncio, "create_subprocess_exec", failing)

    async def run():
        jobs = Jobs(project, workers=1)
        for _ in range(2):
            jobs.start({"kind": "check"})
        await until(lambda: states(jobs) == ["done", "failed"])
        return jobs.shown(["*"])[1]["log"]

    assert "Resource temporarily unavailable" in asyncio.run(run())


def test_a_second_server_of_a_folder_is_refused_and_stops_no_job(project):
    """It called the first one's running jobs stopped."""
    state_of(project.root / "jobs" / "check-1", state="running", status=None, ended=None)
    refused = pytest.raises(InvalidInput, match="another workbench serves this folder")
    with claimed(project.root / "jobs", "jobs"), listening("127.0.0.1", 0) as listener, refused:
        serve(project, listener, pytest.fail)
    assert json.loads((project.root / "jobs/check-1/job.json").read_text())["state"] == "running"


@pytest.mark.parametrize(
    "said",
    [
        {},
        {"kind": "rm"},
        {"kind": ["check"]},
        {"kind": "verify", "controller": "absent.json"},
        {"kind": "verify", "controller": "--help"},
        {"kind": "verify", "controller": "../machine.toml"},
        {"kind": "identify", "controller": "pid.json", "record": "x.h5"},
        {"kind": "identify", "controller": "mine.json", "record": ""},
        {"again": "check-1"},
        {"kind": "design", "method": "--help"},
        {"kind": "design", "method": ["pid"]},
        {"kind": "verify", "controller": "mine.json", "pressure_rate": "--help"},
        {"kind": "verify", "controller": "mine.json", "speed_rate": "1; rm"},
        {"kind": "export", "controller": "mine.json", "target": "../c", "arithmetic": "double"},
        {"kind": "size", "areas": "--help"},
        {"kind": "campaign", "plan": "../machine.toml"},
        {"kind": "campaign", "plan": "absent.toml"},
        {"kind": "retune", "controller": "mine.json", "record": "/etc/passwd"},
    ],
)
def test_what_is_no_job_is_refused(project, said):
    jobs = Jobs(project)
    project.path("controllers", "mine.json").write_text("{}")
    with pytest.raises(InvalidInput):
        jobs.start(said)
    assert listing(jobs) == []


def test_what_a_page_says_stands_in_the_command(project):
    jobs = Jobs(project, workers=0)
    project.path("controllers", "mine.json").write_text("{}")
    project.path("records", "run.csv").write_text("")
    said = {"controller": "mine.json", "record": "run.csv", "unknown": " bearing.*.x  seal.k "}
    assert jobs._words({"kind": "identify", **said})[2:9] == (
        *("records/run.csv", "--controller", "controllers/mine.json"),
        *("--unknown", "bearing.*.x", "--unknown", "seal.k"),
    )
    words = jobs._words({"kind": "verify", **said, "pressure_rate": "", "speed_rate": "20"})
    assert words[-4:] == ("--report", "reports/verify.html", "--speed-rate", "20")
    export = {"kind": "export", **said, "target": "c", "arithmetic": "float"}
    assert jobs._words(export)[-2:] == ("-o", "code/c-float")
    retune = jobs._words({"kind": "retune", **said, "changed": True, "anyway": "yes"})
    assert retune[-3:] == ("--changed", "-o", "retuning")
    project.path("plans", "mine.toml").write_text("")
    campaign = jobs._words({"kind": "campaign", "plan": "mine.toml"})
    assert campaign == ("campaign", "plans/mine.toml", "-o", "campaign")
    assert jobs._words({"kind": "size", "areas": "0.5, 1"})[2:4] == ("--areas", "0.5, 1")


def test_every_job_is_a_command_that_takes_its_options(project):
    from ambrose.cli import main

    for words in module.KINDS.values():
        command = main.commands[words[0]]
        known = {name for option in command.params for name in option.opts}
        assert {word for word in words if word.startswith("-")} <= known


def idle(project):
    """Jobs that all wait."""
    jobs = Jobs(project)
    jobs._workers = 0
    return jobs


def state_of(folder, **other):
    """A job's state as it is written, but for what is given."""
    name = folder.name
    words, said = ["check", "machine.toml"], {"kind": "check"}
    kept = {"name": name, "words": words, "said": said, "state": "done", "status": 0}
    folder.mkdir(parents=True)
    (folder / "job.json").write_text(json.dumps({**kept, "begun": 1.0, "ended": 2.0, **other}))


@pytest.mark.parametrize(
    "other",
    [
        {"words": []},
        {"words": [["check"]]},
        {"words": None},
        {"said": None},
        {"said": ["check"]},
        {"state": "finished"},
        {"state": ["done"]},
        {"status": "0"},
        {"begun": "yesterday"},
        {"ended": {}},
        {"why": 3},
        {"name": "check-2"},
        {"more": 1},
        {"said": {"kind": "x" * 200_000}},
    ],
)
def test_a_state_that_only_looks_like_one_is_left_alone(project, other):
    state_of(project.root / "jobs" / "check-1", **other)
    jobs = idle(project)
    assert listing(jobs) == [] and jobs.shown(["*"]) == []
    jobs.start({"kind": "check"})  # beside it
    assert [job["name"] for job in listing(jobs)] == ["check-2"]


@pytest.mark.parametrize("name", ["check", "check-", "Check-1", "check-1-", "check-\n1", "-1"])
def test_a_folder_with_another_name_is_no_job(project, name):
    state_of(project.root / "jobs" / name)
    jobs = idle(project)
    assert listing(jobs) == []
    jobs.start({"kind": "check"})


@pytest.mark.parametrize(
    "words, said",
    [
        (["check", "../../secret.toml"], {"kind": "check"}),
        (["verify", "machine.toml", "--report=/tmp/x.html"], {}),
        (["verify", "machine.toml", "-o/tmp/x"], {"kind": ["verify"]}),
        (["verify", "x"], {"kind": "verify", "controller": "../../secret.json"}),
        (["export", "x"], {"kind": "export", "controller": "a", "target": "-o/tmp/x"}),
    ],
)
def test_again_takes_the_way_of_every_start(project, words, said):
    """Words that a stranger left in a folder are shown at most; what was chosen is looked at."""
    state_of(project.root / "jobs" / "check-1", words=words, said=said)
    jobs = idle(project)
    try:
        jobs.start({"again": "check-1"})
    except InvalidInput:
        assert len(listing(jobs)) == 1
    else:
        assert listing(jobs)[0]["words"] == ("check", "machine.toml")


def test_again_repeats_what_was_chosen(project):
    project.path("controllers", "mine.json").write_text("{}")
    jobs = idle(project)
    jobs.start({"kind": "verify", "controller": "mine.json", "speed_rate": "20", "width": 1e9})
    again = idle(project)
    again.start({"again": "verify-1"})
    second, first = listing(again)
    assert (first["state"], second["name"]) == ("stopped", "verify-2")
    assert first["words"] == second["words"] and "width" not in second["said"]


def test_the_newest_stays_first_after_a_restart(project):
    for number in range(1, 12):
        state_of(project.root / "jobs" / f"{'verify' if number % 2 else 'check'}-{number}")
    names = [job["name"] for job in listing(Jobs(project))]
    assert names[:3] == ["verify-11", "check-10", "verify-9"] and len(names) == 11


def test_links_and_pipes_among_jobs_are_not_followed(project, tmp_path_factory):
    outside = tmp_path_factory.mktemp("outside")
    (outside / "log.txt").write_text("secret")
    folder = project.root / "jobs"
    state_of(outside / "check-1")
    folder.mkdir()
    (folder / "check-1").symlink_to(outside / "check-1")  # a whole job
    (folder / "check-2").symlink_to(outside / "nothing")
    for number in (3, 4):
        state_of(folder / f"check-{number}")
    (folder / "check-3" / "log.txt").symlink_to(outside / "log.txt")
    os.mkfifo(folder / "check-4" / "log.txt")
    (folder / "check-5").mkdir()
    os.mkfifo(folder / "check-5" / "job.json")
    jobs = idle(project)
    assert [(job["name"], job["log"]) for job in listing(jobs)] == [
        ("check-4", ""),
        ("check-3", ""),
    ]
    before = sorted(outside.rglob("*"))
    jobs.start({"kind": "check"})  # nor is one begun where a link stands
    assert listing(jobs)[0]["name"] == "check-6"
    assert sorted(outside.rglob("*")) == before


@pytest.mark.parametrize("link", ["code/c-double", "reports/accept.html", "controllers/pid.json"])
def test_no_result_is_written_where_a_link_leads(project, tmp_path_factory, link):
    outside = tmp_path_factory.mktemp("outside")
    project.path("controllers", "mine.json").write_text("{}")
    project.path("records", "run.h5").write_text("")
    (project.root / link).parent.mkdir(exist_ok=True)
    (project.root / link).symlink_to(outside)
    files = {"controller": "mine.json", "record": "run.h5"}
    said = {
        "code/c-double": {"kind": "export", **files, "target": "c", "arithmetic": "double"},
        "reports/accept.html": {"kind": "accept", **files},
        "controllers/pid.json": {"kind": "design", "method": "pid"},
    }[link]
    jobs = idle(project)
    with pytest.raises(InvalidInput, match="leads out"):
        jobs.start(said)
    assert listing(jobs) == [] and not list(outside.iterdir())


def test_no_job_writes_through_a_link_that_leads_out(project, tmp_path_factory):
    (project.root / "study").symlink_to(tmp_path_factory.mktemp("elsewhere"))
    with pytest.raises(InvalidInput, match="leads out"):
        idle(project).start({"kind": "study"})


def test_states_of_strangers_are_not_read(project):
    for name, content in {"a": "[]", "b": "{", "c": '{"name": "../x", "words": []}'}.items():
        (project.root / "jobs" / name).mkdir(parents=True)
        (project.root / "jobs" / name / "job.json").write_text(content)
    assert listing(Jobs(project)) == []
