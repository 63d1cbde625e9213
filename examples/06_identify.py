"""From a record to the machine: identify magnets and seal from two seconds in closed loop, and see
a swapped channel refused.

The virtual rig plays the machine: nonlinear magnets, its weight on them, sensors at other places
than the magnets. The record holds what a controller logs: displacements, its output, the excitation
that was added. No force is measured.
"""

from dataclasses import replace

import ambrose as amb

machine = amb.load_machine("seal-rig")
controller = amb.design(machine, "pid")

# The experiment: a binary sequence on each axis, the four nearly uncorrelated; half as loud as the
# bundled one, and shorter.
scenario = amb.load_scenario("prbs")
sequences = tuple(replace(sequence, amplitude=0.1) for sequence in scenario.sequences)
record = amb.simulate(
    machine, controller, replace(scenario, duration=2.0, sequences=sequences)
).record

# K_i and K_s of every axis, the amplifiers' lag and the seal's cross-coupled stiffness; the record
# is checked first.
# The machine that comes back has these values, their uncertainty as tolerances: what a robust
# controller is designed on next.
identification = amb.identify(machine, record, controller)

# A record with two cables exchanged is no number, but a message.
values = record.values.copy()
values[[0, 1]] = values[[1, 0]]
try:
    amb.identify(machine, replace(record, values=values), controller)
    refusal = ""
except amb.InvalidInput as error:
    refusal = str(error)


def picture():
    return amb.plot(identification)


if __name__ == "__main__":
    for parameter in identification.parameters:
        half = parameter.interval[1] - parameter.value
        print(
            f"{parameter.path:36s} {parameter.start:12.5g} -> {parameter.value:12.5g}  +- "
            f"{half:.2g} {parameter.unit}"
        )
    for finding in identification.findings:
        print(finding)
    print(f"{len(identification.machine.tolerances)} tolerances in the identified machine")
    print(f"two channels exchanged: {refusal}")
