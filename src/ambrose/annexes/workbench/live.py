"""A rig that lives in the page: it is advanced by the time that went by, and does what it is told.

A frame is one binary message: the length of its head [bytes, uint32, little endian], the head
(JSON, padded with spaces to a multiple of four), then samples (k, columns), float32 in SI:
displacements x, y of every station in the frame of the machine, then control and coil currents and
the sensors' signals of every axis. The head repeats the whole state of what can be turned and
pushed, so that a page which missed frames knows it all.
"""

from __future__ import annotations

import asyncio
import math
import struct
import time
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from datetime import datetime
from typing import TYPE_CHECKING, Any

import numpy as np
from starlette.websockets import WebSocket, WebSocketDisconnect

from ambrose.annexes.workbench import blocks
from ambrose.annexes.workbench.blocks import Block, number, word
from ambrose.annexes.workbench.project import Project, slug
from ambrose.core.checks import AmbroseError, InvalidInput
from ambrose.core.presentation import json_text
from ambrose.judge.plants import Stability, judge_stability
from ambrose.judge.result import Synthesis
from ambrose.law.loop import DEFAULT, timing_of
from ambrose.machine.criteria import CLEARANCE
from ambrose.machine.machine import Machine, require_magnets
from ambrose.machine.ordinary_file import parse_json
from ambrose.model.assemble import assemble
from ambrose.synthesis.design import design

if TYPE_CHECKING:
    from ambrose.annexes.workbench.rig import Frame


# The clock of a live rig and of the pages that look at it; a test has one that it advances.


class Clock:
    """Time that goes by, and what this computer uses of it."""

    def now(self) -> float:
        """Seconds since whenever."""
        return time.perf_counter()

    def used(self) -> float:
        """Seconds of a processor that the calling thread has used."""
        return time.thread_time()

    async def until(self, due: float) -> None:
        """Waits until it is ``due`` [s]; others come to their turn in any case."""
        await asyncio.sleep(max(due - self.now(), 0.0))


# A controller for a machine that has none yet and is to float on the rig at once.
#
# What is asked is the loop as the rig starts it: the full plant at the nominal operating point,
# sampled and late as the controller or else the machine file says.


def at_the_start(machine: Machine, controller: Synthesis) -> Stability:
    """What the judge says of the loop as the rig starts it. Raises InvalidInput where the
    controller is not one for the machine.
    """
    timing = timing_of(machine, controller) or DEFAULT
    return judge_stability(assemble(machine), controller, timing)


def first_controller(machine: Machine) -> Synthesis:
    """The PID of the machine file, or one tuned for the rig's rate where the PID does not hold the
    machine there. Raises InvalidInput and NumericalFailure.
    """
    plant = assemble(machine)
    made = design(plant, "pid")
    if at_the_start(machine, made).stable:
        return made
    timing = timing_of(machine, made) or DEFAULT
    return design(plant, "tuned", rate=timing.rate, delay_samples=timing.delay_samples)


def why_lost(name: str, machine: Machine, controller: Synthesis) -> str:
    """In words, what the judge says of a controller that does not hold the machine at the start; ""
    of one that does.
    """
    held = at_the_start(machine, controller)
    if held.stable:
        return ""
    return (
        f"{name} is unstable on this machine at {held.label}, {held.timing} "
        f"({held.abscissa:+.3g} 1/s); choose another one"
    )


SAMPLES = 2048  # of a message at most: a spectrum
_LATE = 0.1  # [s] that a frame makes up for at most; more is dropped
_BUSY = 0.02  # [s] of a processor in a frame; a rotor that touches is shown slower, not in jerks
_STEM = 40  # letters of a controller's name in a record's
_PACES = {"real": 1.0, "slow": 0.1, "fast": math.inf}
_SAME = """import ambrose as amb
from ambrose.annexes.workbench.rig import LiveRig
machine = amb.load_machine("machine.toml")
live = LiveRig(machine, amb.read_controller("controllers/pid.json"))
frame = live.advance(1000)"""


class LiveSession:
    """The live rig of a project's machine under one of its controllers.

    controller: a name of the project ("": its first one, or a PID made now and kept); initial:
    "levitated" or "resting"; clock: by which it is advanced (None: this computer's). Raises
    InvalidInput and NumericalFailure. Not for several threads.
    """

    def __init__(
        self,
        project: Project,
        controller: str = "",
        initial: str = "levitated",
        clock: Clock | None = None,
    ) -> None:
        from ambrose.annexes.workbench.rig import LiveRig, ranges_of
        from ambrose.judge.controller_file import read_controller
        from ambrose.machine.file.toml import load_machine

        self._project = project
        self._stamp = _stamp(project)
        self.machine = load_machine(project.machine)
        require_magnets(self.machine)
        self.controller = controller or _first_controller(project, self.machine)
        law = read_controller(project.path("controllers", self.controller), self.machine)
        self._lost = why_lost(self.controller, self.machine, law)
        self.rig = LiveRig(self.machine, law, initial=initial)
        self.rig.advance(1)  # compiles what a frame needs, while the page is told that it starts
        self.ranges = ranges_of(self.rig, self.machine)
        self.pace = "real"
        self.realtime = 1.0
        self._clock = clock or Clock()
        self._last: float | None = None  # of the clock, when the frame before began
        self._owed = 0.0  # samples, the part of one that is left
        self._able = 1000  # samples that are computed in that time
        self._unbalance = ("", 0.0)
        self._excited = 0.0
        self._failed: list[str] = []
        self._recorded = ""
        self._strength = self.ranges.impulse
        self._near = False
        nominal = self.machine.operation.nominal
        self._targets = {"speed": nominal.speed, "pressure": nominal.seal_pressure}

    def describe(self) -> dict[str, Any]:
        """What does not change while it runs: names, places of columns, limits, controls."""
        rig = self.rig
        gaps = [float(gap) if np.isfinite(gap) else None for gap in rig.clearances]
        b = len(self.machine.bearings)
        return {
            "machine": self.machine.name,
            "stations": rig.stations,
            "bearings": b,
            "gaps": [*gaps, *[None] * (len(rig.stations) - b)],
            "scale": self.ranges.gap,
            "zones": {limit.zone: limit.value for limit in CLEARANCE.limits},
            "columns": self.columns,
            "axes": rig.axes,
            # what flows in the coils, and what the controller asks for: not the same where an
            # amplifier has failed
            **{
                word: [self.columns.index(f"{kind} {axis}") for axis in rig.axes]
                for word, kind in (("currents", "i"), ("commands", "u"))
            },
            "limits": [float(most) if np.isfinite(most) else None for most in rig.limits],
            "dt": rig.dt,
            "speed": self.ranges.speed,
            "controls": self._controls(),
            "scope": _scope_form(self.columns, f"y {rig.axes[0]}"),
            "same": {"Python": _SAME},
        }

    def _controls(self) -> list[Block]:
        """What can be turned, pushed and broken, as forms."""
        turned = [_slider("speed", "Speed", 0, self.ranges.speed, "rpm", 30 / math.pi)]
        breaks = [blocks.button("Sensor fails", "fail", what="sensor")]
        breaks += [blocks.button("Amplifier fails", "fail", what="amplifier")]
        if self.machine.seals:
            top = self.ranges.pressure or 1.0
            turned.append(_slider("pressure", "Seal pressure", 0, top, "bar", 1e-5))
            lost = blocks.button("Pressure sensor fails", "fail", what="pressure")
            breaks.append(lost)
        where = blocks.choice("station", "Unbalance at", self.rig.stations)
        where["action"] = "unbalance"
        turned += [where, _slider("unbalance", "Unbalance", 0, self.ranges.unbalance, "g mm", 1e6)]
        turned.append(_slider("gain", "Gain of the controller", -1, 1, "×", 1, log=True))
        middle = math.log10(self.ranges.impulse)
        strength = ("strength", "Strength of a knock", middle - 1.5, middle + 1.5, "N s", 1)
        pace = {**blocks.choice("pace", "Time", list(_PACES), self.pace), "action": "pace"}
        near = blocks.field("near", "Zoom in", self._near, "check", action="near")
        controllers = self._project.names("controllers")
        chosen = blocks.choice("controller", "Controller", controllers, self.controller)
        axis = blocks.choice("axis", "Axis", self.rig.axes)
        return [
            blocks.form("turn", turned, title="Turn"),
            blocks.form(
                "push",
                [_slider(*strength, log=True), pace, near],
                [blocks.button("Drop", "drop"), blocks.button("Lift", "lift")],
                "Push",
            ),
            blocks.form("controller", [chosen], [blocks.button("Switch", "switch")], "Controller"),
            blocks.form(
                "record",
                (),
                [
                    blocks.button("Excite", "excite", value=self.ranges.excitation),
                    blocks.button("Stop exciting", "excite", value=0),
                    blocks.button("Record", "record"),
                    blocks.button("Stop recording", "stop"),
                ],
                "Record",
            ),
            blocks.form("break", [axis], breaks, "Break"),
            starting_form(self._project, self.controller),
        ]

    @property
    def columns(self) -> list[str]:
        """Names of a frame's columns."""
        places = [f"{d} {station}" for station in self.rig.stations for d in ("x", "y")]
        kinds = [f"{kind} {axis}" for kind in ("u", "i", "y") for axis in self.rig.axes]
        return places + kinds

    def frame(self) -> tuple[dict[str, Any], np.ndarray]:
        """The rig advanced by what went by since the last frame: head and samples of a message."""
        now, begun = self._clock.now(), self._clock.used()
        gone = 0.0 if self._last is None else now - self._last
        self._last = now
        count = self._due(gone)
        told = self.rig.advance(count)
        spent = self._clock.used() - begun
        if count:
            able = count * _BUSY / max(spent, 1e-6)
            self._able = int(min(max(able, 50), 2 * self._able, 100_000))
        if gone > 0 and not told.ended:
            # over about a second
            share = min(gone, 1.0)
            self.realtime += share * (count * self.rig.dt / gone - self.realtime)
        head = {
            "time": self.rig.time,
            "clock": round(now, 4),
            "speed": told.speed,
            "contact": told.contact,
            "ended": told.ended,
            "realtime": round(self.realtime, 3),
            "computing": round(1e3 * spent, 2),
            "excited": self._excited,
            "failed": self._failed,
            "recorded": self.rig.recorded,
            "record": self._recorded,
            "set": self._set(),
            "able": self._able_to(told),
            "facts": self._facts(told),
            "warnings": self._warnings(told),
        }
        return head, self._shown(told.log[-SAMPLES:])

    def _set(self) -> dict[str, Any]:
        """What the controls stand at."""
        station, unbalance = self._unbalance
        return {
            **self._targets,
            **({"station": station} if station else {}),
            "unbalance": unbalance,
            "gain": self.rig.gain,
            "pace": self.pace,
            "strength": self._strength,
            "near": self._near,
        }

    def _able_to(self, told: Frame) -> dict[str, bool]:
        """By the text of a button, whether it does anything now."""
        return {
            "Drop": "all amplifiers" not in self._failed,
            "Lift": bool(self._failed) or any(told.contact),
            "Stop exciting": self._excited > 0,
            "Record": self.rig.recorded is None,
            "Stop recording": self.rig.recorded is not None,
        }

    def _facts(self, told: Frame) -> dict[str, str]:
        """How it stands, in words."""
        facts = {
            "time": f"{self.rig.time:.1f} s",
            "speed": f"{told.speed * 30 / math.pi:.0f} rpm",
            "pressure": f"{told.pressure / 1e5:.2f} bar",
            "controller": self.controller,
            "real time": f"{self.realtime:.2f} ×",
        }
        if not self.machine.seals:
            del facts["pressure"]
        if self._excited:
            facts["excited with"] = f"{self._excited:.3g} A"
        if self._recorded:
            length = "" if self.rig.recorded is None else f": {self.rig.recorded:.1f} s"
            facts["record"] = f"records/{self._recorded}{length}"
        return facts

    def _warnings(self, told: Frame) -> str:
        """What is not as it should be, in words."""
        warnings = [told.ended] if told.ended else []
        if self._lost:
            warnings.append(self._lost)
        if any(told.contact):
            warnings.append("the rotor touches its touchdown bearings")
        if self._failed:
            warnings.append(f"failed: {', '.join(self._failed)}")
        if _stamp(self._project) != self._stamp:
            warnings.append("the machine file has changed: start again to see it")
        return "; ".join(warnings)

    def _due(self, gone: float) -> int:
        """Control samples until now; what is too late for a frame, or too much, is dropped."""
        if self.pace == "fast":
            return self._able
        self._owed += min(gone, _LATE) * _PACES[self.pace] / self.rig.dt
        count = int(self._owed + 1e-6)
        self._owed -= count
        return min(count, self._able)

    def _shown(self, log: np.ndarray) -> np.ndarray:
        """The columns of a frame from those of the rig's log: y, u, i, f, then stations."""
        a = len(self.rig.axes)
        places = self.rig.places(log).reshape(len(log), len(self.rig.ports))
        return np.hstack([places, log[:, a : 3 * a], log[:, :a]])

    def pause(self) -> None:
        """Nobody looks: the time that passes until the next frame does not count."""
        self._last = None
        self.stop()

    def do(self, message: Any) -> None:
        """What a page asks for, {"do": name, ...}. Raises InvalidInput."""
        wanted = message.get("do") if isinstance(message, dict) else None
        if not isinstance(wanted, str) or wanted not in ACTIONS:
            known = ", ".join(ACTIONS)
            raise InvalidInput(f"the live rig cannot do that; it can do {known}")
        ACTIONS[wanted](self, message)

    # what can be done to it

    def knock(self, said: Mapping[str, Any]) -> None:
        """An impulse at a station."""
        self.rig.knock(word(said, "station"), number(said, "x"), number(said, "y"))

    def speed(self, said: Mapping[str, Any]) -> None:
        """Another speed [rad/s], reached in about five seconds for the whole range."""
        value = number(said, "value")
        self.rig.set_speed(value, rate=max(self.ranges.speed / 5.0, 1.0))
        self._targets = {**self._targets, "speed": value}

    def pressure(self, said: Mapping[str, Any]) -> None:
        """Another seal pressure [Pa]."""
        value = number(said, "value")
        self.rig.set_pressure(value, rate=max(self.ranges.pressure / 5.0, 1e3))
        self._targets = {**self._targets, "pressure": value}

    def unbalance(self, said: Mapping[str, Any]) -> None:
        """An unbalance [kg m] at a station, in place of all others."""
        station, amount = word(said, "station"), number(said, "value")
        self.rig.set_unbalance(station, amount)
        self._unbalance = (station, amount)

    def gain(self, said: Mapping[str, Any]) -> None:
        """The controller's output times a number."""
        self.rig.set_gain(number(said, "value"))

    def switch(self, said: Mapping[str, Any]) -> None:
        """Another controller of the project takes over."""
        from ambrose.judge.controller_file import read_controller

        name = word(said, "controller")
        law = read_controller(self._project.path("controllers", name), self.machine)
        self.rig.switch(law)
        self.controller = name
        self._lost = why_lost(name, self.machine, law)

    def strength(self, said: Mapping[str, Any]) -> None:
        """The impulse of a knock at the edge of the picture [N s], which every page reads."""
        self._strength = number(said, "value")

    def near(self, said: Mapping[str, Any]) -> None:
        """Whether the pictures zoom in on the orbit."""
        self._near = bool(said.get("value"))

    def drop(self, said: Mapping[str, Any]) -> None:
        """No power any more."""
        self.rig.drop()
        self._failed = ["all amplifiers"]

    def lift(self, said: Mapping[str, Any]) -> None:
        """Power again, all whole."""
        self.rig.lift()
        self._failed = []

    def fail(self, said: Mapping[str, Any]) -> None:
        """A sensor, an amplifier or the pressure sensor."""
        what = word(said, "what")
        if what == "pressure":
            self.rig.fail_pressure_sensor("lost")
        elif what == "sensor":
            self.rig.fail_sensor(word(said, "axis"))
        elif what == "amplifier":
            self.rig.fail_amplifier(word(said, "axis"))
        else:
            raise InvalidInput("what fails is a sensor, an amplifier or the pressure sensor")
        name = what if what == "pressure" else f"{what} {said['axis']}"
        self._failed = [*self._failed, name]

    def excite(self, said: Mapping[str, Any]) -> None:
        """Binary sequences [A] for identification."""
        amplitude = number(said, "value")
        self.rig.excite(amplitude)
        self._excited = amplitude

    def record(self, said: Mapping[str, Any]) -> None:
        """A record of the project from here on."""
        # the name says which controller ran: other screens offer it with the record
        ran = self.controller.removesuffix(".json")[:_STEM]
        stem = said.get("name") or f"live-{ran}-{datetime.now():%Y%m%d-%H%M%S}"
        path = self._project.free("records", slug(stem, "record"))
        self.rig.record(path)
        self._recorded = path.name

    def stop(self, said: Mapping[str, Any] | None = None) -> None:
        """The record is finished."""
        self.rig.stop_recording()

    def change_pace(self, said: Mapping[str, Any]) -> None:
        """Real time, ten times slower, or as fast as it can."""
        pace = word(said, "pace")
        if pace not in _PACES:
            raise InvalidInput(f"the pace is {pace!r}, but must be one of {', '.join(_PACES)}")
        self.pace = pace


TURNED = ["speed", "pressure", "unbalance", "gain", "strength", "near"]
_DONE = ["knock", "switch", "drop", "lift", "fail", "excite", "record", "stop"]
ACTIONS: dict[str, Callable[[LiveSession, Mapping[str, Any]], None]] = {
    **{name: getattr(LiveSession, name) for name in (*TURNED, *_DONE)},
    "pace": LiveSession.change_pace,
}


def packed(head: Mapping[str, Any], samples: np.ndarray) -> bytes:
    """One message: see the top of this file."""
    text = json_text(head).encode()
    text += b" " * (-len(text) % 4)
    return struct.pack("<I", len(text)) + text + np.ascontiguousarray(samples, "<f4").tobytes()


def _stamp(project: Project) -> tuple[int, int]:
    """What changes when the machine file does, also where it is gone."""
    try:
        status = project.machine.stat()
    except OSError:
        return 0, 0
    return status.st_mtime_ns, status.st_size


def starting_form(project: Project, controller: str = "") -> Block:
    """How a rig begins anew."""
    names = project.names("controllers") or ["pid.json"]
    ways = {"levitated": "Start levitated", "resting": "Start on the touchdown bearings"}
    buttons = [blocks.button(text, "restart", initial=initial) for initial, text in ways.items()]
    chosen = blocks.choice("controller", "Controller", names, controller)
    return blocks.form("start", [chosen], buttons, "Start again")


def _scope_form(columns: list[str], signal: str) -> Block:
    """What the scope shows."""
    fields = [
        blocks.choice("signal", "Signal", columns, signal),
        blocks.choice("span", "Seconds", ["0.02", "0.1", "0.4"], "0.1"),
        blocks.choice("trigger", "Trigger", ["rising", "free"]),
    ]
    return blocks.form("scope", fields, title="Scope", live="scope")


def _slider(
    name: str, label: str, low: float, high: float, unit: str, factor: float, log: bool = False
) -> Block:
    """A slider that asks for the action of its name; log: low and high are exponents of ten."""
    more = {"low": low, "high": high, "unit": unit, "factor": factor, "log": log, "action": name}
    return blocks.field(name, label, 10**low if log else low, "slider", **more)


def _first_controller(project: Project, machine: Machine) -> str:
    """A controller of the project, the PID before others; where there is none one that holds the
    machine, written as `ambrose synthesize` writes it.
    """
    names = project.names("controllers")
    if names:
        return "pid.json" if "pid.json" in names else names[0]
    from ambrose.judge.controller_file import write_controller

    made = first_controller(machine)
    path = project.path("controllers", f"{made.method}.json")
    write_controller(path, made)
    return path.name


# Who looks at the live rig: one rig, any number of pages, each at the pace that it can take.
#
# A page confirms a frame before it gets the next one, which is then the newest there is: late
# frames are dropped and never queued; what was sampled in them goes with the next, up to a
# spectrum's length. With the last page the rig stands still; it goes on from there when a page
# comes back.


FRAMES = 40.0  # a second
THREAD = "live-rig"
_LONGEST = 4000  # characters of what a page says
_WAITING = 64  # orders of a page that are not done yet
_UNSENT = 20  # frames of which samples are kept for a page that is late


class _Viewer:
    """One page: the newest frame waits until the page has confirmed the one before, and what it
    asks for until the rig has time.
    """

    def __init__(self, socket: WebSocket) -> None:
        self.socket = socket
        self.confirmed = asyncio.Event()
        self.confirmed.set()
        self.fresh = asyncio.Event()
        self.head: Mapping[str, Any] = {}
        self.samples: list[np.ndarray] = []
        self.orders: list[Any] = []
        self.ordered = asyncio.Event()

    def offer(self, head: Mapping[str, Any], samples: np.ndarray) -> None:
        """A frame in place of one that was not sent yet, whose samples go with it."""
        self.head = head
        self.samples = [*self.samples[-_UNSENT:], samples]
        self.fresh.set()

    def forget(self) -> None:
        """What was not sent yet is of another rig."""
        self.samples = []
        self.fresh.clear()

    async def send_frames(self) -> None:
        """Until the socket breaks."""
        while True:
            await self.confirmed.wait()
            await self.fresh.wait()
            if not self.samples:  # forgotten since it was called
                continue
            head, samples = self.head, np.concatenate(self.samples)[-SAMPLES:]
            self.forget()
            self.confirmed.clear()
            await self.socket.send_bytes(packed(head, samples))

    async def tell(self, **content: Any) -> None:
        """A message in words or data, beside the frames."""
        await self.socket.send_text(json_text(content))

    async def listen(self) -> None:
        """Until the page leaves: what it says is written down, of a slider the newest alone."""
        while True:
            said = await self.socket.receive()
            if said["type"] == "websocket.disconnect":
                return
            text = said.get("text") or ""
            if text == "ok":
                self.confirmed.set()
            elif len(self.orders) < _WAITING:
                self._write_down(_read(text))
            else:
                await self.tell(refused="the rig is busy; wait for the last command")

    def _write_down(self, message: Any) -> None:
        """An order behind the others; a slider's replaces the one before it, unless something else
        was asked for in between.
        """
        name = _wish(message)
        for i in range(len(self.orders) - 1, -1, -1):
            before = _wish(self.orders[i])
            if name not in TURNED or before not in TURNED:
                break
            if before == name:
                del self.orders[i]
                break
        self.orders.append(message)
        self.ordered.set()

    async def next_order(self) -> Any:
        """What the page asked for first of what is not done yet; None: no message of this page."""
        while not self.orders:
            self.ordered.clear()
            await self.ordered.wait()
        return self.orders.pop(0)


def _read(text: str) -> Any:
    """A message of a page, None where it is none."""
    try:
        return parse_json(text, "reload the page") if len(text) <= _LONGEST else None
    except (ValueError, RecursionError):
        return None


def _wish(message: Any) -> str:
    """The name of what a page asks for, "" where it has none."""
    wanted = message.get("do") if isinstance(message, dict) else None
    return wanted if isinstance(wanted, str) else ""


class LiveRoom:
    """The one live rig of a server and the pages that look at it, by a clock (None: this
    computer's).
    """

    def __init__(self, project: Project, clock: Clock | None = None) -> None:
        self._project = project
        self._clock = clock or Clock()
        self._viewers: list[_Viewer] = []
        self._session: LiveSession | None = None
        # the rig is no matter for several threads: one thread builds it, advances it, knocks it
        self._thread = ThreadPoolExecutor(1, thread_name_prefix=THREAD)
        self._drive: asyncio.Task[None] | None = None
        # controller and beginning of the rig that is built, and of the one that is built after it
        self._underway: tuple[str, str] | None = None
        self._wanted: tuple[str, str] | None = None
        self._build: asyncio.Task[None] | None = None

    async def join(self, socket: WebSocket) -> None:
        """A page looks on until it leaves."""
        await socket.accept()
        viewer = _Viewer(socket)
        self._viewers.append(viewer)
        parts = (viewer.send_frames(), viewer.listen(), self._obey(viewer))
        tasks = [asyncio.create_task(part) for part in parts]
        try:
            await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
        finally:
            self._viewers.remove(viewer)
            for task in tasks:
                task.cancel()
            ended = await asyncio.gather(*tasks, return_exceptions=True)
            if not self._viewers:
                await self._stop_driving()
        # it left, also while it was told something; else the socket ends with a mistake of ours,
        # and the page comes back
        left = (WebSocketDisconnect, RuntimeError, asyncio.CancelledError)
        for error in ended:
            if isinstance(error, Exception) and not isinstance(error, left):
                raise error

    async def close(self) -> None:
        """The server ends: the rig stops, a record is finished; a first rig is not waited for."""
        if self._build is not None:
            self._build.cancel()
        await self._stop_driving()
        self._thread.shutdown(wait=self._session is not None)

    async def settled(self) -> None:
        """Once a rig that is there has done what it was told, and its record is a file."""
        if self._build is None or self._build.done():
            await self._in_thread(int)

    async def _obey(self, viewer: _Viewer) -> None:
        """The page is shown the rig, and what it asks for is done, one after the other."""
        if self._underway is not None:
            await viewer.tell(building=True)
        if self._session is not None:
            await viewer.tell(**await self._in_thread(self._described))
            self._ensure_driven()
        else:
            await self._start(self._underway or ("", "levitated"))
        while True:
            message = await viewer.next_order()
            if message is None:
                await viewer.tell(refused="that is no message of this page; reload it")
            elif _wish(message) == "restart":
                given = (message.get("controller", ""), message.get("initial", "levitated"))
                await self._start((str(given[0]), str(given[1])))
            else:
                await self._do(viewer, message)

    async def _do(self, viewer: _Viewer, message: Any) -> None:
        session = self._session
        if session is None:
            await viewer.tell(refused="there is no rig yet; start it first")
            return
        try:
            await self._in_thread(session.do, message)
        except AmbroseError as error:
            await viewer.tell(refused=str(error))

    async def _start(self, wanted: tuple[str, str]) -> None:
        """Once there is a new rig with a controller and a beginning, or a reason why not. What is
        asked for while one is built, is built after it, the newest alone; the same is not built
        twice.
        """
        self._wanted = None if wanted == self._underway else wanted
        if self._build is None or self._build.done():
            self._build = asyncio.create_task(self._build_rigs())
        await asyncio.shield(self._build)  # also for others than the page that asked

    async def _build_rigs(self) -> None:
        while self._wanted is not None:
            self._underway, self._wanted = self._wanted, None
            try:
                await self._build_rig(*self._underway)
            finally:
                self._underway = None
        self._ensure_driven()

    async def _build_rig(self, controller: str, initial: str) -> None:
        """A new rig in place of the one that was there, or the reason why there is none."""
        await self._stop_driving()
        await self._tell_all(building=True)
        make = (LiveSession, self._project, controller, initial, self._clock)
        try:
            self._session = await self._in_thread(*make)
            described = await self._in_thread(self._described)
        except Exception as error:  # the one before goes on
            known = isinstance(error, AmbroseError)
            words = str(error) if known else f"no rig, by a mistake of the program: {error!r}"
            await self._tell_all(failed=words, start=starting_form(self._project))
        else:
            for viewer in self._viewers:
                viewer.forget()
            await self._tell_all(**described)

    def _described(self) -> dict[str, Any]:
        return {} if self._session is None else {"rig": self._session.describe()}

    async def _tell_all(self, **content: Any) -> None:
        for viewer in list(self._viewers):
            with suppress(WebSocketDisconnect, RuntimeError):
                await viewer.tell(**content)

    def _ensure_driven(self) -> None:
        """The rig goes on where somebody looks, unless another one is built."""
        driven = self._drive is not None and not self._drive.done()
        if not driven and self._underway is None and self._session is not None and self._viewers:
            self._drive = asyncio.create_task(self._advance(self._session))

    async def _stop_driving(self) -> None:
        drive, self._drive = self._drive, None
        if drive is not None:
            drive.cancel()
            await asyncio.wait([drive])
        if self._session is not None:
            try:
                await self._in_thread(self._session.pause)
            except AmbroseError as error:  # the record cannot be finished
                await self._tell_all(refused=str(error))

    async def _advance(self, session: LiveSession) -> None:
        """Frame after frame; what took too long is not made up for."""
        due = self._clock.now()
        while True:
            try:
                frame = await self._in_thread(session.frame)
            except AmbroseError as error:
                await self._tell_all(failed=str(error))
                return
            except Exception as error:
                await self._tell_all(failed=f"the rig stopped by a mistake of its own: {error!r}")
                raise
            for viewer in self._viewers:
                viewer.offer(*frame)
            due = max(due + 1.0 / FRAMES, self._clock.now())
            await self._clock.until(due)

    async def _in_thread(self, function: Callable[..., Any], *arguments: Any) -> Any:
        return await asyncio.get_running_loop().run_in_executor(self._thread, function, *arguments)
