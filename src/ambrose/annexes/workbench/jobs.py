"""Jobs: commands of the project as processes beside the page.

A job is a folder jobs/NAME with its state, job.json, and what it printed, log.txt. It outlives the
page, not the server: a server that starts finds what was finished, and calls stopped what was not.
What a job is, stands in KINDS; a page chooses among them and names files of the project.
"""

import asyncio
import os
import re
import shlex
import signal
import sys
import textwrap
import time
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from ambrose.annexes.workbench import blocks
from ambrose.annexes.workbench.project import KINDS as FOLDERS, MACHINE, Project
from ambrose.core.checks import AmbroseError, InvalidInput
from ambrose.machine.ordinary_file import make_folder, parse_json, write_json

# words of a command; what stands in braces the page names
KINDS: dict[str, tuple[str, ...]] = {
    "check": ("check", MACHINE),
    "design": ("synthesize", MACHINE, "--method", "{method}", "-o", "controllers/{method}.json"),
    "verify": (
        *("verify", MACHINE, "--controller", "{controller}", "--report", "reports/verify.html"),
        *("--pressure-rate", "{pressure_rate}", "--speed-rate", "{speed_rate}"),
    ),
    "map": ("map", MACHINE, "--controller", "{controller}", "-o", "reports/map.html"),
    "identify": (
        *("identify", MACHINE, "{record}", "--controller", "{controller}"),
        *("--unknown", "{unknown}"),
        *("-o", "machines/identified.toml", "--report", "reports/identify.html"),
    ),
    "accept": ("accept", MACHINE, "{controller}", "{record}", "-o", "reports/accept.html"),
    "export": (
        *("export", "{controller}", "--to", "{target}", "--arithmetic", "{arithmetic}"),
        *("--machine", MACHINE, "--rate-hz", "{rate}", "-o", "code/{target}-{arithmetic}"),
    ),
    "retune": (
        *("retune", MACHINE, "{record}", "--controller", "{controller}"),
        *("--unknown", "{unknown}", "--changed", "{changed}", "--anyway", "{anyway}"),
        *("-o", "retuning"),
    ),
    "size": (
        *("size", MACHINE, "--areas", "{areas}", "--biases", "{biases}", "--rate-hz", "{rate}"),
        *("-o", "reports/size.html", "--machine-out", "machines/sized.toml"),
    ),
    "campaign": ("campaign", "{plan}", "-o", "campaign"),
    "study": ("study", MACHINE, "-o", "study"),
}
# what a page may put into them: files of a folder, some words, what is left out where it is empty
_FOLDERS = {"controller": "controllers", "record": "records", "plan": "plans"}
_REMEDIES = {
    "controller": "save or design one on the screen Controllers",
    "record": "record one on the live rig, or drop its file on the screen Records",
    "plan": "write one",
}
CHOICES: dict[str, tuple[str, ...]] = {
    "method": ("pid", "tuned", "hinf", "mu"),
    "target": ("c", "mat", "fmu", "st"),
    "arithmetic": ("double", "float", "fixed32", "fixed16"),
}
_FREE = {
    "pressure_rate": r"\d[\d.eE+-]* *[A-Za-z/]*",
    "speed_rate": r"\d[\d.eE+-]*",
    "rate": r"\d[\d.eE+]*",
    "unknown": r"[A-Za-z*][\w.*-]*(?: +[A-Za-z*][\w.*-]*)*",
    "areas": r"\d[\d., ]*",
    "biases": r"\d[\d., ]*",
}
_FLAGS = ("changed", "anyway")
_PATIENCE = 0.6  # [s] from the request to end to the kill
_UNDER_WAY = ("waiting", "running")
_STATES = (*_UNDER_WAY, "done", "failed", "cancelled", "stopped")
_NAME = re.compile(r"[a-z]{1,20}-[0-9]{1,9}")
_STATE = 100_000  # bytes of a job's state
_SHOWN = 3  # of a screen's commands
_LONGEST = 200  # characters of a field
_TAIL = 20_000  # bytes of a log that the page shows: a table drawn with lines has three a sign
_LINE = 120  # characters of a line in it
_FRAME = "│┃┏└├┡"  # of tables
_CHILD = "ambrose.annexes.workbench.child"


@dataclass(frozen=True, slots=True)
class Job:
    """One job; said: the form that it was started with. state: "waiting", "running", "done",
    "failed", "cancelled" or "stopped" (the server ended first). status: of the command, None while
    it has none; times in seconds since 1970; why: it could not be run, in words.
    """

    name: str
    words: tuple[str, ...]
    said: Mapping[str, Any]
    state: str = "waiting"
    status: int | None = None
    begun: float | None = None
    ended: float | None = None
    why: str = ""


class Jobs:
    """The jobs of a project: as many at once as there are processors, the others in a queue."""

    def __init__(self, project: Project, workers: int | None = None) -> None:
        self._project = project
        self._workers = workers or os.cpu_count() or 1
        self._jobs: dict[str, Job] = {}
        self._processes: dict[str, asyncio.subprocess.Process] = {}
        self._tasks: set[asyncio.Task[None]] = set()
        self._unwritten: dict[str, str] = {}  # states that are on no disk yet, and why
        stored = []
        for path in project.root.glob("jobs/*/job.json"):
            with suppress(InvalidInput, OSError, ValueError, TypeError, KeyError, RecursionError):
                stored.append(_read(path))
        for job in sorted(stored, key=_number):
            self._jobs[job.name] = job
            if job.state in _UNDER_WAY:
                self._keep(replace(job, state="stopped"))

    def shown(self, of: object) -> list[blocks.Block]:
        """The jobs of some commands for a page, the newest first; "*": of all."""
        wanted = [word for word in of if isinstance(word, str)] if isinstance(of, list) else []
        every = "*" in wanted
        chosen = [job for job in reversed(self._jobs.values()) if every or job.words[0] in wanted]
        return [self._block(job) for job in chosen[: None if every else _SHOWN]]

    def verdict(self, of: list[str]) -> blocks.Block:
        """The newest result of some commands ("*": of all) in one sentence: a command's first."""
        for job in reversed(self._jobs.values()):
            if job.words[0] in of or "*" in of:
                said = [line for line in self._log(job.name).splitlines() if line.strip()]
                # stages are indented; a verdict is the first line that is not
                known = next((line for line in said if line[:1].strip()), "")
                if known and job.state not in _UNDER_WAY:
                    tone = "good" if job.status == 0 else "bad"
                    return blocks.words("verdict", f"{job.name}: {known}", tone=tone)
        return blocks.words("verdict", "No result yet.", tone="muted")

    def ended(self) -> int:
        """How many jobs are over."""
        return sum(job.state not in _UNDER_WAY for job in self._jobs.values())

    def _block(self, job: Job) -> blocks.Block:
        """One job: what it is and how far, its log, what can be done with it."""
        runs = job.state in _UNDER_WAY
        title = f"{job.name}: {job.state}"
        if job.begun is not None:
            title += f", {(job.ended or time.time()) - job.begun:.0f} s"
        if job.status is not None:
            title += f", status {job.status}"
            title += ": a requirement is not met" if job.state == "done" and job.status else ""
        way = (
            blocks.button("Cancel", "/api/jobs/cancel", name=job.name)
            if runs
            else blocks.button("Again", "/api/jobs/start", again=job.name)
        )
        command = f"ambrose {shlex.join(job.words)}"
        # 1: it was computed, and something that was asked does not hold
        tone = {"done": "bad" if job.status else "good", "failed": "bad", "stopped": "bad"}
        why = [text for text in (job.why, self._unwritten.get(job.name)) if text]
        log = "\n".join([_wrapped(self._log(job.name)), *why]).strip("\n")
        same = {"Command line": command}
        return blocks.form(
            f"job-{job.name}", (), [way], title, tone=tone.get(job.state, ""), log=log, same=same
        )

    def start(self, said: Mapping[str, Any]) -> None:
        """A job of a kind, or again one that is over. Raises InvalidInput."""
        again = said.get("again")
        said = self._named(again).said if again else said
        words = self._words(said)
        for folder in ("controllers", "machines", "reports", "code", words[-1]):
            if folder in FOLDERS:  # that leads out through no link
                self._project.folder(folder)
        for word in words:  # nor does what is read and written in them
            self._project.inside(self._project.root / word)
        number = 1 + max(map(_number, self._jobs.values()), default=0)
        while os.path.lexists(self._project.folder("jobs") / f"{words[0]}-{number}"):
            number += 1  # something of that name, but no job
        kept = {name: said[name] for name in _names(said["kind"]) if name in said}
        job = Job(f"{words[0]}-{number}", words, {"kind": said["kind"], **kept})
        self._write(job)
        self._jobs[job.name] = job
        self._fill()

    def _words(self, said: Mapping[str, Any]) -> tuple[str, ...]:
        """The words of a command with what the page says. Raises InvalidInput."""
        kind = said.get("kind")
        if not isinstance(kind, str) or kind not in KINDS:
            raise InvalidInput(f"there is no such job; choose one of {', '.join(KINDS)}")
        words: list[str] = []
        for word in KINDS[kind]:
            name = word.strip("{}")
            if word != f"{{{name}}}":
                given = {key: self._chosen(key, said) for key in CHOICES if f"{{{key}}}" in word}
                words.append(word.format(**given))
            elif name in _FOLDERS:
                words.append(self._file(name, said))
            elif name in CHOICES:
                words.append(self._chosen(name, said))
            elif name in _FLAGS:
                del words[len(words) - (said.get(name) is not True) :]
            else:
                # an option for each word; none where there is no word
                option = words.pop()
                words += [part for each in _free(name, said) for part in (option, each)]
        return tuple(words)

    def _file(self, field: str, said: Mapping[str, Any]) -> str:
        """A file of the project that is there, as a command line in its folder writes it."""
        if not said.get(field):
            raise InvalidInput(f"no {field} is chosen; {_REMEDIES[field]}, then choose it")
        path = self._project.path(_FOLDERS[field], said.get(field))
        if not path.is_file():
            raise InvalidInput(f"{path.name} is not in {_FOLDERS[field]}; choose one that is")
        return self._project.relative(path)

    def _chosen(self, field: str, said: Mapping[str, Any]) -> str:
        value = said.get(field)
        if not isinstance(value, str) or value not in CHOICES[field]:
            raise InvalidInput(f"the {field} must be one of {', '.join(CHOICES[field])}")
        return value

    async def cancel(self, name: object) -> None:
        """The job ends within a second, with all that it started. Raises InvalidInput."""
        job = self._named(name)
        process = self._processes.get(job.name)
        if job.state == "waiting":
            self._keep(replace(job, state="cancelled", ended=time.time()))
        elif job.state == "running":
            self._keep(replace(job, state="cancelled"))
            if process is not None:  # else it ends as soon as it begins
                await self._end(process)

    async def close(self) -> None:
        """The server ends: nothing runs on."""
        for job in list(self._jobs.values()):
            if job.state in _UNDER_WAY:
                self._keep(replace(job, state="stopped"))
        await asyncio.gather(*(self._end(process) for process in self._processes.values()))
        await asyncio.gather(*self._tasks)

    async def _end(self, process: asyncio.subprocess.Process) -> None:
        """Asked first, so that it takes its drafts away, then killed with its whole group."""
        with suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGINT)
            with suppress(TimeoutError):
                await asyncio.wait_for(process.wait(), _PATIENCE)
            os.killpg(process.pid, signal.SIGKILL)
        await process.wait()

    def _fill(self) -> None:
        """The next ones of the queue take the places that are free."""
        running = sum(job.state == "running" for job in self._jobs.values())
        waiting = [job for job in self._jobs.values() if job.state == "waiting"]
        for job in waiting[: max(self._workers - running, 0)]:
            self._keep(replace(job, state="running", begun=time.time()))
            task = asyncio.get_running_loop().create_task(self._run(job.name))
            self._tasks.add(task)
            task.add_done_callback(self._tasks.discard)

    async def _run(self, name: str) -> None:
        """A job from its start to its end; whatever becomes of it, the next one has its turn."""
        status, why = None, ""
        try:
            status = await self._executed(name)
        except (AmbroseError, OSError) as error:
            why = f"the job could not be run: {error}; start it again"
        job = self._jobs[name]
        if job.state == "running":
            job = replace(job, state="done" if status in {0, 1} else "failed")
        self._keep(replace(job, status=status, ended=time.time(), why=why))
        if job.state != "stopped":
            self._fill()

    async def _executed(self, name: str) -> int:
        """The exit status of a job's command. Raises InvalidInput and OSError where it cannot
        begin.
        """
        with (self._place(name) / "log.txt").open("wb") as log:
            process = await asyncio.create_subprocess_exec(
                *(sys.executable, "-m", _CHILD, *self._jobs[name].words),
                cwd=self._project.root,
                stdin=asyncio.subprocess.PIPE,
                stdout=log,
                stderr=log,
                start_new_session=True,
            )
        self._processes[name] = process
        if self._jobs[name].state != "running":  # cancelled before there was a process
            await self._end(process)
        status = await process.wait()
        with suppress(ProcessLookupError, PermissionError):
            os.killpg(process.pid, signal.SIGKILL)
        del self._processes[name]
        return status

    def _keep(self, job: Job) -> None:
        """A job's new state, onto the disk with those that found no room there before."""
        self._jobs[job.name] = job
        for name in (*self._unwritten, job.name):
            try:
                self._write(self._jobs[name])
            except InvalidInput as error:
                self._unwritten[name] = str(error)
            else:
                self._unwritten.pop(name, None)

    def _write(self, job: Job) -> None:
        """Raises InvalidInput."""
        write_json(self._place(job.name) / "job.json", asdict(job), "job's state")

    def _place(self, name: str) -> Path:
        """A job's folder, made anew where it disappeared. Raises InvalidInput."""
        return make_folder(self._project.inside(self._project.folder("jobs") / name))

    def _folder(self, name: str) -> Path:
        return self._project.root / "jobs" / name

    def _named(self, name: object) -> Job:
        if not isinstance(name, str) or name not in self._jobs:
            raise InvalidInput(f"there is no job {str(name)[:60]!r}; reload the page")
        return self._jobs[name]

    def _log(self, name: str) -> str:
        """The end of what a job printed."""
        path = self._folder(name) / "log.txt"
        try:
            if path.is_symlink() or not path.is_file():
                return ""
            with path.open("rb") as log:
                cut = os.fstat(log.fileno()).st_size - _TAIL
                log.seek(max(cut, 0))
                words = log.read().decode("utf-8", "replace")
                return words.partition("\n")[2] if cut > 0 else words
        except OSError:
            return ""


def _wrapped(log: str) -> str:
    """What a job printed, its long sentences in lines of a screen; tables as they are."""
    lines: list[str] = []
    for line in log.splitlines():
        long = len(line) > _LINE and not any(mark in line for mark in _FRAME)
        lines += textwrap.wrap(line, _LINE) if long else [line]
    return "\n".join(lines)


def _read(path: Path) -> Job:
    """A job as it was written here. Raises InvalidInput and others for what only looks like one."""
    if path.resolve() != path or not path.is_file() or path.stat().st_size > _STATE:
        raise InvalidInput(f"{path.name} is not the state of a job")
    content = parse_json(path.read_text(encoding="utf-8"), "start the job again")
    job = Job(**{**content, "words": tuple(content["words"])})
    numbers = [n for n in (job.status, job.begun, job.ended) if n is not None]
    known = job.name == path.parent.name and _NAME.fullmatch(job.name) and job.state in _STATES
    if not known or not job.words or not all(isinstance(word, str) for word in job.words):
        raise InvalidInput(f"{path.name} is not the state of a job")
    known = isinstance(job.said, dict) and isinstance(job.why, str)
    if not known or not all(isinstance(n, int | float) for n in numbers):
        raise InvalidInput(f"{path.name} is not the state of a job")
    return job


def _number(job: Job) -> int:
    return int(job.name.rpartition("-")[2])


def _names(kind: str) -> set[str]:
    """What a form of a kind gives."""
    return {name for word in KINDS[kind] for name in re.findall(r"{(\w+)}", word)}


def _free(field: str, said: Mapping[str, Any]) -> list[str]:
    """What was written into a field, none where it is empty; no word that looks like an option."""
    value = said.get(field, "")
    text = value.strip() if isinstance(value, str) else "?"
    if not text:
        return []
    if len(text) > _LONGEST or not re.fullmatch(_FREE[field], text):
        raise InvalidInput(
            f"{field.replace('_', ' ')} is {text[:40]!r}, which cannot be read; correct it or "
            "leave it empty"
        )
    return text.split() if field == "unknown" else [text]
