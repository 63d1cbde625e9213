"""A bearing that lost half its stiffness, found in closed loop: the Youla residual of the
turboexpander (thesis, paper P1).
"""

import numpy as np

import ambrose as amb

STIFFNESS = "bearing.B.negative_stiffness.eta"
machine = amb.load_machine("turboexpander")
plant = amb.free_mode_reduction(amb.assemble(machine, "nominal speed without seal"))
currents, displacements = plant.named("u"), plant.named("y")

# Two observers: the machine's, and that of its controller u = F x^ + alpha. Together they are the
# coprime factors.
G = amb.select(plant.system, currents, displacements)
F, L = amb.injection_gain(G.A.T, G.B.T)[0].T, amb.injection_gain(G.A, G.C)[0]
factors = amb.coprime_factors(G, amb.observer_controller(G, F, L), L, -G.B)

# The real machine has half the negative stiffness in one axis: G is unstable, what the loop says
# about it is not.
real = amb.select(
    amb.perturbed(plant, {STIFFNESS: -0.5}, [amb.Tolerance(STIFFNESS, relative=1.0)]).system,
    currents,
    displacements,
)
S = amb.minimal(amb.residual_system(factors, real))

# 0.5 s of random binary current at 1 ms, fed into the controller; eps is what its observer did not
# expect, and noise.
rng = np.random.default_rng(7)
alpha = 0.1 * np.sign(rng.standard_normal((4, 500)))
eps = amb.time_response(S, alpha, 1e-3) + 1e-7 * rng.standard_normal((4, 500))
found = amb.identify_residual(plant, factors, [STIFFNESS], alpha, eps, 1e-3)
nominal = machine.bearings[1].negative_stiffness[1]
theta, deviation = 1 - found.values[0] / nominal, found.standard_deviations[0] / nominal


def picture():
    return amb.plot({"G(theta)": real, "S(theta)": S})


if __name__ == "__main__":
    for name, system in (("G(theta)", real), ("S(theta)", S)):
        right = int((amb.poles(system).real > 0).sum())
        print(f"{name}: {system.n_states} states, {right} of its poles right of the imaginary axis")
    print(f"theta = {theta:.4f} +- {deviation:.4f} (true 0.5), {found.iterations} iterations")
