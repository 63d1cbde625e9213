"""From a bundled machine to a verdict: assemble, reduce, design the reference PID, verify on the
full flexible model.
"""

import ambrose as amb

machine = amb.load_machine("seal-rig")
# 40 nodes, 144 rotor states and 8 amplifier states
plant = amb.assemble(machine, "nominal pressure")
small = amb.reduce(plant, 0)  # 8 rotor states: what controllers are designed on
pid = amb.design(machine, "pid")
# on the full plant, bending modes included, at every operating point
verdict = amb.verify(machine, pid, tolerances=False)


def picture():
    return amb.plot(verdict)


if __name__ == "__main__":
    print(f"{machine.name}: {plant.rotor.n_states} rotor states, reduced to {small.rotor.n_states}")
    for checks in verdict.points:
        if checks.stable:
            peak = checks["sensitivity.output.max"]
            zones = {checks[f"sensitivity.output.{axis}"].zone for axis in machine.axes}
            print(
                f"{checks.label}: stable, largest sensitivity {peak.value:.2f} {peak.detail}, "
                f"worst zone of an axis {max(zones)}"
            )
        else:
            print(f"{checks.label}: {checks.checks[0].detail}")
