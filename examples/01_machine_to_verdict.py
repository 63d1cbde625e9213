"""From a bundled machine to a verdict: assemble, reduce, design the reference PID, verify on the full flexible model."""

from ambrose import load_machine
from ambrose.plant.assemble import assemble
from ambrose.plant.reduce import reduce
from ambrose.synthesis.pid import pid_synthesis
from ambrose.verification import nominal

machine = load_machine("seal-rig")
verdicts = {}
for point in machine.operation.points:
    plant = assemble(machine, point)  # 40 nodes, 320 rotor states and 8 amplifier states
    small = reduce(plant)  # 8 rotor states: what controllers are designed on
    controller = pid_synthesis(plant).controller
    verdicts[point.label] = nominal.check(plant, controller)  # proved on the full plant, bending modes included

if __name__ == "__main__":
    print(f"{machine.name}: {plant.rotor.n_states} rotor states, reduced to {small.rotor.n_states}")
    for label, checks in verdicts.items():
        if checks.stable:
            peak = checks["sensitivity.output.max"]
            print(f"{label}: stable, largest sensitivity {peak.value:.2f} {peak.detail}, zone {peak.zone}")
        else:
            print(f"{label}: {checks.checks[0].detail}")
