"""From a record to the machine: identify magnets and seal from two seconds in closed loop, and see a swapped channel refused.

The virtual rig plays the machine: nonlinear magnets, its weight on them, sensors at other places than the magnets. The record
holds what a controller logs: displacements, its output, the excitation that was added. No force is measured.
"""

from dataclasses import replace

from ambrose import load_machine
from ambrose.core.checks import InvalidInput
from ambrose.identification.pipeline import identify
from ambrose.plant.assemble import assemble
from ambrose.simulation import virtual_rig
from ambrose.simulation.scenario import Prbs, Scenario
from ambrose.synthesis.pid import pid_synthesis

machine = load_machine("seal-rig")
controller = pid_synthesis(assemble(machine)).controller

# The experiment: a binary sequence on each axis, the four nearly uncorrelated.
sequences = tuple(Prbs(f"e_{axis}", amplitude=0.1, bit_time=1e-3, order=9, seed=n) for n, axis in enumerate(machine.axes))
record = virtual_rig.run(machine, controller, Scenario("experiment", 2.0, sequences=sequences)).record

# K_i and K_s of every axis, the amplifiers' lag and the seal's cross-coupled stiffness; the record is checked first.
result = identify(machine, record, controller)

# The machine with these values, their uncertainty as tolerances: what a robust controller is designed on next.
identified = result.machine

# A record with two cables exchanged is no number, but a message.
values = record.values.copy()
values[[0, 1]] = values[[1, 0]]
try:
    identify(machine, replace(record, values=values), controller)
    refusal = ""
except InvalidInput as error:
    refusal = str(error)

if __name__ == "__main__":
    for row in result.parameters:
        print(f"{row.path:36s} {row.start:12.5g} -> {row.value:12.5g}  +- {row.interval[1] - row.value:.2g}")
    print(result.verdict)
    print(f"{len(identified.tolerances)} tolerances in the identified machine")
    print(f"two channels exchanged: {refusal}")
