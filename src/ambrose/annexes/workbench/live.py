"""A rig that lives in the page: it is advanced by the time that went by, and does what it is told.

A frame is one binary message: the length of its head [bytes, uint32, little endian], the head
(JSON, padded with spaces to a multiple of four), then samples (k, columns), float32 in SI:
displacements x, y of every station in the frame of the machine, then control and coil currents and
the sensors' signals of every axis. The head repeats the whole state of what can be turned and
pushed, so that a page which missed frames knows it all.
"""

from __future__ import annotations

import json
import math
import struct
import time
from collections.abc import Callable, Mapping
from datetime import datetime
from typing import TYPE_CHECKING, Any

import numpy as np

from ambrose.annexes.workbench.project import Project, slug
from ambrose.core.checks import InvalidInput, invalid
from ambrose.machine.criteria import CLEARANCE

if TYPE_CHECKING:
    from ambrose.judge.result import Synthesis
    from ambrose.machine.machine import Machine

SAMPLES = 600  # of a frame at most: what a screen shows
_LATE = 0.1  # [s] that a frame makes up for at most; more is dropped
_BUSY = 0.02  # [s] of computing in a frame, as fast as it can
_PACES = {"real": 1.0, "slow": 0.1, "fast": math.inf}
_PUSH = 0.05  # a knock's first displacement over the gap, roughly
_SHAKE = 0.025  # excitation over the limit of the currents: far from it also on top of the weight
_GRADE = 2.5e-3  # [m/s], G2.5 of ISO 21940-11


class LiveSession:
    """The live rig of a project's machine under one of its controllers.

    controller: a name of the project ("": its first one, or a PID made now and kept); initial:
    "levitated" or "resting". Raises InvalidInput and NumericalFailure. Not for several threads.
    """

    def __init__(self, project: Project, controller: str = "", initial: str = "levitated") -> None:
        from ambrose.machine.file.toml import load_machine
        from ambrose.machine.machine import require_magnets
        from ambrose.rig.live import LiveRig

        self._project = project
        self._stamp = _stamp(project)
        self.machine = load_machine(project.machine)
        require_magnets(self.machine)
        self.controller = controller or _first_controller(project, self.machine)
        law = _read(project, self.controller, self.machine)
        self.rig = LiveRig(self.machine, law, initial=initial)
        self.pace = "real"
        self.realtime = 1.0
        self._clock: float | None = None
        self._owed = 0.0  # samples, the part of one that is left
        self._burst = 100  # samples of a frame as fast as it can
        self._unbalance = ("", 0.0)
        self._excited = 0.0
        self._failed: list[str] = []
        self._recorded = ""
        nominal = self.machine.operation.nominal
        self._targets = {"speed": nominal.speed, "pressure": nominal.seal_pressure}
        directions = self.rig.direction
        # (S, 2, 2): rows give x and y of a station's displacements along its axes
        self._turn = np.stack([directions, directions[:, ::-1] * [-1.0, 1.0]], axis=1)
        self._turn = np.transpose(self._turn, (0, 2, 1))

    def describe(self) -> dict[str, Any]:
        """What does not change while it runs: names, places of columns, limits, ranges."""
        rig, machine = self.rig, self.machine
        stations = rig.stations
        b = len(machine.bearings)
        gaps = [float(gap) if np.isfinite(gap) else None for gap in rig.clearances]
        air = [bearing.gap for bearing in machine.bearings]
        smallest = min([gap for gap in (*gaps, *air) if gap], default=1e-4)
        points = machine.operation.points
        speed = max([*machine.operation.speed_range, *(p.speed for p in points), 100.0])
        mass = _mass(machine)
        return {
            "machine": machine.name,
            "stations": stations,
            "bearings": b,
            "gaps": [*gaps, *[None] * (len(stations) - b)],
            "scale": smallest,
            "zones": {limit.zone: limit.value for limit in CLEARANCE.limits},
            "columns": self.columns,
            "axes": rig.axes,
            "limits": [float(most) if np.isfinite(most) else None for most in rig.limits],
            "dt": rig.dt,
            "speed": 1.2 * speed,
            "pressure": 2.5 * max([p.seal_pressure for p in points], default=0.0),
            "seals": [seal.name for seal in machine.seals],
            # m e of the grade at the top speed
            "unbalance": 8 * mass * _GRADE / speed,
            "impulse": _PUSH * smallest * mass * 300.0,
            "excitation": _SHAKE
            * float(min([m for m in rig.limits if np.isfinite(m)], default=1.0)),
            "paces": list(_PACES),
        }

    @property
    def columns(self) -> list[str]:
        """Names of a frame's columns."""
        places = [f"{d} {station}" for station in self.rig.stations for d in ("x", "y")]
        kinds = [f"{kind} {axis}" for kind in ("u", "i", "y") for axis in self.rig.axes]
        return places + kinds

    def frame(self) -> bytes:
        """The rig advanced by what went by since the last frame, as one message."""
        begun = time.perf_counter()
        gone = 0.0 if self._clock is None else begun - self._clock
        self._clock = begun
        count = self._due(gone)
        told = self.rig.advance(count)
        spent = time.perf_counter() - begun
        if self.pace == "fast" and spent > 0:
            self._burst = int(min(max(self._burst * _BUSY / spent, 50), 2 * self._burst, 100_000))
        if gone > 0 and not told.ended:
            # over about a second
            share = min(gone, 1.0)
            self.realtime += share * (count * self.rig.dt / gone - self.realtime)
        head = {
            "time": self.rig.time,
            "speed": told.speed,
            "pressure": told.pressure,
            "contact": told.contact,
            "ended": told.ended,
            "pace": self.pace,
            "realtime": round(self.realtime, 3),
            "computing": round(1e3 * spent, 2),
            "controller": self.controller,
            "gain": self.rig.gain,
            "targets": self._targets,
            "unbalance": self._unbalance,
            "excited": self._excited,
            "failed": self._failed,
            "recorded": self.rig.recorded,
            "record": self._recorded,
            "stale": _stamp(self._project) != self._stamp,
        }
        return _packed(head, self._shown(told.log[-SAMPLES:]))

    def _due(self, gone: float) -> int:
        """Control samples until now; what is later than a frame makes up for is dropped."""
        if self.pace == "fast":
            return self._burst
        self._owed += min(gone, _LATE) * _PACES[self.pace] / self.rig.dt
        count = int(self._owed + 1e-6)
        self._owed -= count
        return count

    def _shown(self, log: np.ndarray) -> np.ndarray:
        """The columns of a frame from those of the rig's log: y, u, i, f, then stations."""
        a = len(self.rig.axes)
        places = log[:, 4 * a :].reshape(len(log), len(self.rig.stations), 2)
        xy = np.einsum("sij,ksj->ksi", self._turn, places).reshape(len(log), len(self.rig.ports))
        return np.hstack([xy, log[:, a : 3 * a], log[:, :a]])

    def pause(self) -> None:
        """Nobody looks: the time that passes until the next frame does not count."""
        self._clock = None
        self.stop()

    def do(self, message: Any) -> None:
        """What a page asks for, {"do": name, ...}. Raises InvalidInput."""
        if not isinstance(message, dict) or message.get("do") not in ACTIONS:
            known = ", ".join(ACTIONS)
            raise InvalidInput(f"the live rig cannot do that; it can do {known}")
        ACTIONS[message["do"]](self, message)

    # what can be done to it

    def knock(self, said: Mapping[str, Any]) -> None:
        """An impulse at a station."""
        self.rig.knock(_word(said, "station"), _number(said, "x"), _number(said, "y"))

    def speed(self, said: Mapping[str, Any]) -> None:
        """Another speed [rad/s], reached in about five seconds for the whole range."""
        value = _number(said, "value")
        self.rig.set_speed(value, rate=max(self.describe()["speed"] / 5.0, 1.0))
        self._targets = {**self._targets, "speed": value}

    def pressure(self, said: Mapping[str, Any]) -> None:
        """Another seal pressure [Pa]."""
        value = _number(said, "value")
        self.rig.set_pressure(value, rate=max(self.describe()["pressure"] / 5.0, 1e3))
        self._targets = {**self._targets, "pressure": value}

    def unbalance(self, said: Mapping[str, Any]) -> None:
        """An unbalance [kg m] at a station, in place of all others."""
        station, amount = _word(said, "station"), _number(said, "value")
        self.rig.set_unbalance(station, amount)
        self._unbalance = (station, amount)

    def gain(self, said: Mapping[str, Any]) -> None:
        """The controller's output times a number."""
        self.rig.set_gain(_number(said, "value"))

    def switch(self, said: Mapping[str, Any]) -> None:
        """Another controller of the project takes over."""
        name = _word(said, "controller")
        self.rig.switch(_read(self._project, name, self.machine))
        self.controller = name

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
        what = _word(said, "what")
        if what == "pressure":
            self.rig.fail_pressure_sensor("lost")
        elif what == "sensor":
            self.rig.fail_sensor(_word(said, "axis"))
        elif what == "amplifier":
            self.rig.fail_amplifier(_word(said, "axis"))
        else:
            raise InvalidInput("what fails is a sensor, an amplifier or the pressure sensor")
        name = what if what == "pressure" else f"{what} {said['axis']}"
        self._failed = [*self._failed, name]

    def excite(self, said: Mapping[str, Any]) -> None:
        """Binary sequences [A] for identification."""
        amplitude = _number(said, "value")
        self.rig.excite(amplitude)
        self._excited = amplitude

    def record(self, said: Mapping[str, Any]) -> None:
        """A record of the project from here on."""
        stem = said.get("name") or f"live-{datetime.now():%Y%m%d-%H%M%S}"
        path = self._project.free("records", slug(stem, "record"))
        self.rig.record(path)
        self._recorded = path.name

    def stop(self, said: Mapping[str, Any] | None = None) -> None:
        """The record is finished."""
        self.rig.stop_recording()

    def change_pace(self, said: Mapping[str, Any]) -> None:
        """Real time, ten times slower, or as fast as it can."""
        pace = _word(said, "pace")
        if pace not in _PACES:
            raise InvalidInput(f"the pace is {pace!r}, but must be one of {', '.join(_PACES)}")
        self.pace = pace


ACTIONS: dict[str, Callable[[LiveSession, Mapping[str, Any]], None]] = {
    "knock": LiveSession.knock,
    "speed": LiveSession.speed,
    "pressure": LiveSession.pressure,
    "unbalance": LiveSession.unbalance,
    "gain": LiveSession.gain,
    "switch": LiveSession.switch,
    "drop": LiveSession.drop,
    "lift": LiveSession.lift,
    "fail": LiveSession.fail,
    "excite": LiveSession.excite,
    "record": LiveSession.record,
    "stop": LiveSession.stop,
    "pace": LiveSession.change_pace,
}


def _packed(head: Mapping[str, Any], samples: np.ndarray) -> bytes:
    """One message: see the top of this file."""
    text = json.dumps(head).encode()
    text += b" " * (-len(text) % 4)
    return struct.pack("<I", len(text)) + text + np.ascontiguousarray(samples, "<f4").tobytes()


def _number(said: Mapping[str, Any], name: str) -> float:
    value = said.get(name)
    if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) < 1e12:
        raise invalid(name, str(value)[:40], "a finite number", "give it in SI units")
    return float(value)


def _word(said: Mapping[str, Any], name: str) -> str:
    value = said.get(name)
    if not isinstance(value, str) or len(value) > 100:
        raise invalid(name, str(value)[:40], "a name", "choose one that the page shows")
    return value


def _stamp(project: Project) -> tuple[int, int]:
    """What changes when the machine file does."""
    status = project.machine.stat()
    return status.st_mtime_ns, status.st_size


def _mass(machine: Machine) -> float:
    """Of the rotor [kg]."""
    from ambrose.model.effects.rotor import finite_element_rotor, mass_properties

    return mass_properties(finite_element_rotor(machine)).mass


def _first_controller(project: Project, machine: Machine) -> str:
    """The first controller that a live rig can run; a PID of the machine file where there is none,
    written as `ambrose synthesize --method pid` writes it.
    """
    names = project.names("controllers")
    if names:
        return "pid.json" if "pid.json" in names else names[0]
    from ambrose.judge.controller_file import write_controller
    from ambrose.model.assemble import assemble
    from ambrose.synthesis.design import design

    path = project.path("controllers", "pid.json")
    write_controller(path, design(assemble(machine), "pid"))
    return path.name


def _read(project: Project, name: str, machine: Machine) -> Synthesis:
    from ambrose.judge.controller_file import read_controller

    return read_controller(project.path("controllers", name))
