"""From a design to code on the machine: sampled, verified as it will run, written as C, compiled, and run by the virtual rig.

The rig knows nothing of the design: it hands the compiled code four displacements every 0.1 ms and applies the four currents
that come back one sample later. A controller whose sampled loop is unstable at some pressure gets no code.
"""

import ambrose as amb
from ambrose.core.sampling import delayed
from ambrose.deployment.block.fixed import build_block
from ambrose.deployment.c.code import generate
from ambrose.deployment.c.compiled import CompiledBlock, read_law
from ambrose.deployment.discretisation.deployment import deploy
from ambrose.deployment.pipeline import machine_limits

SAMPLE = 1e-4  # s
machine = amb.load_machine("seal-rig")
plants = [amb.assemble(machine, point) for point in machine.operation.points]  # nominal, zero, twice nominal seal pressure

# Designed for the delay of the loop that it will run in: one sample of computing and half a sample of holding.
synthesis = amb.design(plants[0], "hinf", rate=1 / SAMPLE)

# Sampled, and verified as it will run: late by one sample, on the full model, at every pressure and over k +-100 %.
deployment = deploy(synthesis, SAMPLE, SAMPLE, plants=plants)
block = build_block(deployment, "seal_rig", *machine_limits(machine))
files = generate(block, provenance=["Example 09."])  # the C code; write_code puts it into a directory

# Software in the loop: the same text, compiled, in this process. What is read back out of it is verified again.
code = CompiledBlock(block)
law = delayed(read_law(code), code.delay)
verdict = amb.verify(machine, law, tolerances=False)
runs = {point.label: amb.simulate(machine, code, "impulse-parallel", point=point) for point in machine.operation.points}

# The PID does not hold twice the nominal pressure, sampled or not: refused (one bending mode is enough to see it).
try:
    deploy(amb.design(plants[0], "pid"), SAMPLE, SAMPLE, plants=[amb.reduce(plant, 1) for plant in plants])
    refusal = ""
except amb.UnstableSystem as error:
    refusal = str(error)


def picture():
    return amb.plot(runs["twice nominal pressure"])


if __name__ == "__main__":
    print(
        f"{deployment.controller.n_states} states at {1 / SAMPLE:g} Hz, {len(files[f'{block.name}.c'].splitlines())} lines of C"
    )
    for checks in verdict.points:
        trace, peak = runs[checks.label], checks["sensitivity.output.max"]
        largest = max(abs(trace.record[name]).max() for name in plants[0].named("y"))
        meets = "meets" if peak.passed else "misses"
        print(
            f"{checks.label:22s} S_o {peak.value:.2f} {meets} {peak.limit:g}; on the rig {1e6 * largest:.2f} um, "
            f"{trace.outcome}"
        )
    print(f"PID: {refusal}")
