"""A rig that lives in the page: it is advanced by the time that went by, and does what it is told.

A frame is one binary message: the length of its head [bytes, uint32, little endian], the head
(JSON, padded with spaces to a multiple of four), then samples (k, columns), float32 in SI:
displacements x, y of every station in the frame of the machine, then control and coil currents and
the sensors' signals of every axis. The head repeats the whole state of what can be turned and
pushed, so that a page which missed frames knows it all.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Mapping
from datetime import datetime
from typing import TYPE_CHECKING, Any

import numpy as np

from ambrose.annexes.workbench import blocks
from ambrose.annexes.workbench.blocks import Block
from ambrose.annexes.workbench.clock import Clock
from ambrose.annexes.workbench.given import number, word
from ambrose.annexes.workbench.project import Project, slug
from ambrose.core.checks import InvalidInput
from ambrose.core.presentation import json_text
from ambrose.machine.criteria import CLEARANCE

if TYPE_CHECKING:
    from ambrose.machine.machine import Machine
    from ambrose.rig.live import Frame

SAMPLES = 2048  # of a message at most: a spectrum
_LATE = 0.1  # [s] that a frame makes up for at most; more is dropped
_BUSY = 0.02  # [s] of a processor in a frame; a rotor that touches is shown slower, not in jerks
_STEM = 40  # letters of a controller's name in a record's
_PACES = {"real": 1.0, "slow": 0.1, "fast": math.inf}
_SAME = """import ambrose as amb
from ambrose.rig.live import LiveRig
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
        from ambrose.chain.first_controller import why_lost
        from ambrose.judge.controller_file import read_controller
        from ambrose.machine.file.toml import load_machine
        from ambrose.machine.machine import require_magnets
        from ambrose.rig.live import LiveRig
        from ambrose.rig.live_ranges import ranges_of

        self._project = project
        self._stamp = _stamp(project)
        self.machine = load_machine(project.machine)
        require_magnets(self.machine)
        self.controller = controller or _first_controller(project, self.machine)
        law = read_controller(project.path("controllers", self.controller))
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
        self._near = True
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
        near = blocks.field("near", "Zoom in", True, "check", action="near")
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
        from ambrose.chain.first_controller import why_lost
        from ambrose.judge.controller_file import read_controller

        name = word(said, "controller")
        law = read_controller(self._project.path("controllers", name))
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
    from ambrose.chain.first_controller import first_controller
    from ambrose.judge.controller_file import write_controller

    made = first_controller(machine)
    path = project.path("controllers", f"{made.method}.json")
    write_controller(path, made)
    return path.name
