"""A bearing that lost half its stiffness, found in closed loop: the Youla residual of the turboexpander (thesis, paper P1)."""

import numpy as np

import ambrose as amb
from ambrose.core.realisation.coprime import coprime_factors, injection_gain, observer_controller, residual_system
from ambrose.core.realisation.zeros import minimal
from ambrose.core.response import simulate
from ambrose.core.statespace import select
from ambrose.identification.youla import identify as youla
from ambrose.machine.description import Tolerance
from ambrose.plant.reduce import free_mode_reduction
from ambrose.report.figures.pole_map import describe, pole_zero_map

STIFFNESS = "bearing.B.negative_stiffness.eta"
machine = amb.load_machine("turboexpander")
plant = free_mode_reduction(amb.assemble(machine, "nominal speed without seal"))
currents, displacements = plant.named("u"), plant.named("y")

# Two observers: the machine's, and that of its controller u = F x^ + alpha. Together they are the coprime factors.
G = select(plant.system, currents, displacements)
F, L = injection_gain(G.A.T, G.B.T)[0].T, injection_gain(G.A, G.C)[0]
factors = coprime_factors(G, observer_controller(G, F, L), L, -G.B)

# The real machine has half the negative stiffness in one axis: G is unstable, what the loop says about it is not.
real = select(amb.perturbed(plant, {STIFFNESS: -0.5}, [Tolerance(STIFFNESS, relative=1.0)]).system, currents, displacements)
S = minimal(residual_system(factors, real))

# 0.5 s of random binary current at 1 ms, fed into the controller; eps is what its observer did not expect, and noise.
rng = np.random.default_rng(7)
alpha = 0.1 * np.sign(rng.standard_normal((4, 500)))
eps = simulate(S, alpha, 1e-3) + 1e-7 * rng.standard_normal((4, 500))
found = youla.identify_injected(plant, factors, [STIFFNESS], alpha, eps, 1e-3)
nominal = machine.bearings[1].negative_stiffness[1]
theta, deviation = 1 - found.values[0] / nominal, found.standard_deviations[0] / nominal


def picture():
    return pole_zero_map({"G(theta)": real, "S(theta)": S})


if __name__ == "__main__":
    print(describe("G(theta)", real))
    print(describe("S(theta)", S))
    print(f"theta = {theta:.4f} +- {deviation:.4f} (true 0.5), {found.iterations} iterations")
