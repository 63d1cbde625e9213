"""From a design to code on the machine: sampled, verified as it will run, written as C, compiled, and run by the virtual rig.

The rig knows nothing of the design: it hands the compiled code four displacements every 0.1 ms and applies the four currents
that come back one sample later. A controller whose sampled loop is unstable at some pressure gets no code.
"""

from ambrose import load_machine
from ambrose.core.checks import UnstableSystem
from ambrose.core.sampling import delayed
from ambrose.deployment.block.fixed import build_block
from ambrose.deployment.c.code import generate
from ambrose.deployment.c.compiled import CompiledBlock, read_law
from ambrose.deployment.discretisation.deployment import deploy
from ambrose.deployment.pipeline import machine_limits
from ambrose.plant.assemble import assemble
from ambrose.plant.reduce import reduce
from ambrose.simulation import virtual_rig
from ambrose.simulation.scenario import load_scenario
from ambrose.synthesis.design import design
from ambrose.verification import nominal

SAMPLE = 1e-4  # s
machine = load_machine("seal-rig")
plants = [assemble(machine, point) for point in machine.operation.points]  # nominal, zero, twice nominal seal pressure

# Designed for the delay of the loop that it will run in: one sample of computing and half a sample of holding.
synthesis = design(plants[0], "hinf", rate=1 / SAMPLE)

# Sampled, and verified as it will run: late by one sample, on the full model, at every pressure and over k +-100 %.
deployment = deploy(synthesis, SAMPLE, SAMPLE, plants=plants)
block = build_block(deployment, "seal_rig", *machine_limits(machine))
files = generate(block, provenance=["Example 09."])  # the C code; write_code puts it into a directory

# Software in the loop: the same text, compiled, in this process. What is read back out of it is verified again.
code = CompiledBlock(block)
verdicts = {plant.point.label: nominal.check(plant, delayed(read_law(code), code.delay)) for plant in plants}
runs = {p.point.label: virtual_rig.run(machine, code, load_scenario("impulse-parallel"), point=p.point) for p in plants}

# The PID does not hold twice the nominal pressure, sampled or not: refused (one bending mode is enough to see it).
try:
    deploy(design(plants[0], "pid"), SAMPLE, SAMPLE, plants=[reduce(plant, 1) for plant in plants])
    refusal = ""
except UnstableSystem as error:
    refusal = str(error)

if __name__ == "__main__":
    print(
        f"{deployment.controller.n_states} states at {1 / SAMPLE:g} Hz, {len(files[f'{block.name}.c'].splitlines())} lines of C"
    )
    for label, checks in verdicts.items():
        trace, peak = runs[label], checks["sensitivity.output.max"]
        largest = max(abs(trace.record[name]).max() for name in plants[0].named("y"))
        verdict = "meets" if peak.passed else "misses"
        print(f"{label:22s} S_o {peak.value:.2f} {verdict} {peak.limit:g}; on the rig {1e6 * largest:.2f} um, {trace.outcome}")
    print(f"PID: {refusal}")
