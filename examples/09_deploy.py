"""From a design to code on the machine: sampled, verified as it will run, written as C, compiled,
and run by the virtual rig.

The rig knows nothing of the design: it hands the compiled code four displacements every 0.1 ms and
applies the four currents that come back one sample later. A controller whose sampled loop is
unstable at some pressure gets no code.
"""

import tempfile
from dataclasses import replace
from pathlib import Path

import ambrose as amb

SAMPLE = 1e-4  # s
machine = amb.load_machine("seal-rig")

# Designed for the delay of the loop that it will run in: one sample of computing and half a sample
# of holding.
synthesis = amb.design(machine, "hinf", rate=1 / SAMPLE)

# Sampled, and verified as it will run: late by one sample, on the full model, at every pressure and
# over k +-100 %.
target = amb.C(name="seal_rig", rate=1 / SAMPLE)
with tempfile.TemporaryDirectory() as folder:
    delivery = amb.export(synthesis, Path(folder, "code"), to=target, machine=machine)
    files = {path.name: path.read_text() for path in delivery.paths}
deployment = delivery.deployment

# Software in the loop: the same text, compiled, in this process. What is read back out of it is
# verified again.
code = amb.CompiledBlock(delivery.block)
law = amb.read_law(code)
verdict = amb.verify(machine, law, delay_samples=code.delay, tolerances=False)
runs = {
    point.label: amb.simulate(machine, code, "impulse-parallel", point=point)
    for point in machine.operation.points
}

# The PID does not hold twice the nominal pressure, sampled or not: refused (tolerances left out, to
# see it sooner).
try:
    amb.export(
        amb.design(machine, "pid"),
        "nowhere",
        to=target,
        machine=replace(machine, tolerances=()),
    )
    refusal = ""
except amb.UnstableSystem as error:
    refusal = str(error)


def picture():
    return amb.plot(runs["twice nominal pressure"])


if __name__ == "__main__":
    print(
        f"{deployment.controller.n_states} states at {1 / SAMPLE:g} Hz, "
        f"{len(files['seal_rig.c'].splitlines())} lines of C"
    )
    for checks in verdict.points:
        trace, peak = runs[checks.label], checks["sensitivity.output.max"]
        largest = max(
            abs(trace.record[name]).max() for name in (f"y_{axis}" for axis in machine.axes)
        )
        meets = "meets" if peak.passed else "misses"
        print(
            f"{checks.label:22s} S_o {peak.value:.2f} {meets} {peak.limit:g}; on the rig "
            f"{1e6 * largest:.2f} um, "
            f"{trace.outcome}"
        )
    print(f"PID: {refusal}")
