"""Jobs are processes that end when they are told, with their server, and are found again."""

import asyncio
import json
import os
import random
import shutil
import time

import pytest

pytest.importorskip("starlette", reason="the extra workbench is not installed")

from ambrose.annexes.workbench import jobs as module
from ambrose.annexes.workbench.jobs import Jobs
from ambrose.annexes.workbench.project import Project, begin
from ambrose.core.checks import InvalidInput

# a child that makes a child, both for a minute; no second command is compiled or computed for it
SLEEPER = """
import os, subprocess, sys, threading, time
from ambrose.annexes.workbench.child import _end_with_the_server
threading.Thread(target=_end_with_the_server, daemon=True).start()
other = subprocess.Popen(["sleep", "60"])
print(os.getpid(), other.pid, flush=True)
time.sleep(60)
"""


@pytest.fixture
def project(tmp_path):
    made = Project(tmp_path)
    begin(made, "two-disc-rotor")
    return made


@pytest.fixture
def sleeping(tmp_path_factory, monkeypatch):
    """Every job sleeps a minute with a child of its own."""
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


async def until(condition, seconds=20.0):
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end
        await asyncio.sleep(0.02)


def states(jobs):
    return [job["state"] for job in jobs.listing()]


def test_a_command_runs_and_its_result_is_an_ordinary_file(project):
    async def run():
        jobs = Jobs(project)
        jobs.start({"kind": "check"})
        await until(lambda: states(jobs) == ["done"])
        return jobs.listing()[0]

    job = asyncio.run(run())
    assert job["status"] in {0, 1} and "two-disc-rotor" in job["log"]
    (kept,) = Jobs(project).listing()
    assert (kept["state"], kept["log"]) == ("done", job["log"])


def test_jobs_cancelled_at_random_leave_no_process(project, sleeping):
    draw = random.Random(4)

    async def run():
        jobs = Jobs(project, workers=4)
        for _ in range(8):
            jobs.start({"kind": "check"})
        pids, longest = set(), 0.0
        names = [job["name"] for job in jobs.listing()]
        draw.shuffle(names)
        for name in names:
            await asyncio.sleep(draw.uniform(0.0, 0.4))
            pids |= {
                int(pid)
                for job in jobs.listing()
                for pid in job["log"].split()[:2]
                if pid.isdecimal()
            }
            begun = time.monotonic()
            await jobs.cancel(name)
            longest = max(longest, time.monotonic() - begun)
        pids |= {
            int(pid) for job in jobs.listing() for pid in job["log"].split()[:2] if pid.isdecimal()
        }
        await until(lambda: not jobs._processes)
        await until(lambda: not any(map(alive, pids)))
        return jobs, longest, pids

    jobs, longest, pids = asyncio.run(run())
    assert set(states(jobs)) == {"cancelled"}
    assert longest < 1.0
    assert len(pids) >= 2


def test_a_server_that_is_killed_takes_its_jobs_along_and_finds_them_again(
    project, sleeping, tmp_path_factory
):
    left = tmp_path_factory.mktemp("left") / "project"

    async def run():
        jobs = Jobs(project, workers=1)
        jobs.start({"kind": "check"})
        jobs.start({"kind": "check"})
        await until(lambda: jobs.listing()[1]["log"])
        pids = [int(pid) for pid in jobs.listing()[1]["log"].split()]
        # what a kill leaves on the disk, and what the system does for a process that is killed
        shutil.copytree(project.root, left)
        next(iter(jobs._processes.values())).stdin.close()
        await until(lambda: not any(map(alive, pids)))
        await jobs.close()

    asyncio.run(run())
    again = Jobs(Project(left))
    assert states(again) == ["stopped", "stopped"]
    assert again.listing()[1]["log"]


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
    assert jobs.listing() == []


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


def test_a_job_whose_words_lead_out_of_the_folder_is_none_of_ours(project):
    for number, word in enumerate(["../other.toml", "/etc/passwd", "machine.toml"]):
        kept = {"name": f"check-{number}", "words": ["check", word], "state": "done"}
        folder = project.folder("jobs") / f"check-{number}"
        folder.mkdir()
        (folder / "job.json").write_text(json.dumps(kept))
    assert [job["name"] for job in Jobs(project).listing()] == ["check-2"]


def test_no_job_writes_through_a_link_that_leads_out(project, tmp_path_factory):
    (project.root / "study").symlink_to(tmp_path_factory.mktemp("elsewhere"))
    with pytest.raises(InvalidInput, match="leads out"):
        Jobs(project, workers=0).start({"kind": "study"})


def test_states_of_strangers_are_not_read(project):
    for name, content in {"a": "[]", "b": "{", "c": '{"name": "../x", "words": []}'}.items():
        (project.root / "jobs" / name).mkdir(parents=True)
        (project.root / "jobs" / name / "job.json").write_text(content)
    assert Jobs(project).listing() == []
