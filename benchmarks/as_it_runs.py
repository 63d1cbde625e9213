"""The worst output sensitivity that verification states, against one measured on the nonlinear
virtual rig, for several rates.

python -m benchmarks.as_it_runs Per rate: sigma_max(S_o) at its peak of the continuous loop, of the
loop as it runs, and of the rig, where one sine of output disturbance per axis is taken through the
loop at that frequency and the four answers are put together.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ambrose import assemble, load_machine
from ambrose.core.frequency import frequency_response
from ambrose.core.statespace import StateSpace, select
from ambrose.law.loop import Timing, closed_loop
from ambrose.law.pid import pid_controller
from ambrose.model.plant import Plant
from ambrose.rig import virtual_rig
from ambrose.rig.scenario import Scenario, Sine

AMPLITUDE = 2e-7  # m: the magnets stay linear within 0.1 %
# evaluated periods; seconds before them (of the PID's slow integral pole little is left)
PERIODS, SETTLE = 40, 0.6


def sensitivity_peak(plant: Plant, law: StateSpace) -> tuple[float, float]:
    """sigma_max(S_o) [-] at its peak, and the frequency [rad/s]."""
    loop = select(
        closed_loop(plant, law), [f"d_{a}" for a in plant.axes], [f"y_{a}" for a in plant.axes]
    )
    omega = 2 * np.pi * np.geomspace(5, 500, 4000)
    gain = frequency_response(loop, omega).max_singular_value()
    return float(gain.max()), float(omega[gain.argmax()])


def measured(plant: Plant, law: StateSpace, timing: Timing, omega: float) -> float:
    """sigma_max of S_o at ``omega`` [rad/s] from four runs of the rig."""
    period = 2 * np.pi / omega
    columns = []
    for axis in plant.axes:
        scenario = Scenario(
            "sine",
            SETTLE + PERIODS * period,
            sines=(Sine(f"d_{axis}", AMPLITUDE, omega),),
            sample_time=timing.sample_time,
        )
        run = virtual_rig.run(
            plant.machine, law, scenario, point=plant.point, computing_delay=timing.delay_samples
        )
        record = run.record.select(list(plant.named("y")))
        inside = record.time >= record.time[-1] - PERIODS * period
        t, y = record.time[inside], record.values[:, inside]
        basis = np.vstack([np.sin(omega * t), np.cos(omega * t), np.ones_like(t), t - t.mean()])
        s, c = np.linalg.lstsq(basis.T, y.T, rcond=None)[0][:2]
        columns.append((s + 1j * c) / AMPLITUDE)
    return float(np.linalg.norm(np.array(columns).T, 2))


def main() -> None:
    machine = load_machine("seal-rig")
    sensors = tuple(replace(item, noise=0.0) for item in machine.sensors)
    machine = replace(machine, sensors=sensors)
    plant, law = assemble(machine, "zero pressure"), pid_controller(machine.controller, machine)
    print(
        "| rate, delay | continuous | as it runs | rig | continuous off | as it runs off "
        "|\n|---|---|---|---|---|---|"
    )
    for timing in (Timing(5e-5), Timing(1e-4), Timing(2e-4)):
        before = sensitivity_peak(plant, law)[0]
        running, omega = sensitivity_peak(plant, timing.in_loop(law))
        found = measured(plant, law, timing, omega)
        print(
            f"| {timing.rate:g} Hz, {timing.delay_samples} | {before:.3f} | {running:.3f} | "
            f"{found:.3f} "
            f"| {before / found - 1:+.1%} | {running / found - 1:+.2%} |"
        )


if __name__ == "__main__":
    main()
