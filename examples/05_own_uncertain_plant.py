"""Robust control without a machine file: a levitated mass with uncertain stiffness, mu analysis and
D-K iteration.
"""

import numpy as np

import ambrose as amb

# x'' = (1 + 0.5 delta) x + u + w1, scaled: one unit of time is 1/sqrt(k_s/m), one of length the
# acceptable error.
mass = amb.StateSpace(
    [[0, 1], [1, 0]],
    [[0, 0, 0], [1, 1, 1]],
    [[0.5, 0], [1, 0]],
    np.zeros((2, 3)),
    ["w_k", "w1", "u"],
    ["z_k", "x"],
)
weight = amb.performance_weight(peak=3.0, bandwidth=0.05)  # input "err", output "z1" below
weight = amb.StateSpace(weight.A, weight.B, weight.C, weight.D, ["e"], ["z1"])
effort = amb.StateSpace([], np.zeros((0, 1)), np.zeros((1, 0)), [[0.2]], ["v"], ["z2"])
system = amb.connect(
    [mass, weight, effort],
    inputs=["w_k", "w1", "w2", "u"],
    outputs=["z_k", "z1", "z2", "err"],
    sums={"err": ["-x", "-w2"], "e": ["err"], "v": ["u"]},
)
problem = amb.GeneralizedPlant(
    system,
    w=["w_k", "w1", "w2"],
    u=["u"],
    z=["z_k", "z1", "z2"],
    y=["err"],
    blocks=[amb.RealBlock("stiffness")],
)

nominal = amb.GeneralizedPlant(system, w=["w1", "w2"], u=["u"], z=["z1", "z2"], y=["err"])
results = {"H-infinity": amb.hinf_synthesis(nominal), "mu": amb.mu_synthesis(problem, order=1)}
analysis = amb.with_performance_block(problem)
peaks = {
    name: amb.mu_peak(
        amb.lft(problem, result.controller), analysis.blocks, np.geomspace(1e-3, 1e3, 200)
    )
    for name, result in results.items()
}

if __name__ == "__main__":
    for name, peak in peaks.items():
        order = results[name].controller.n_states
        print(
            f"{name}: order {order}, robust performance mu {peak.lower:.3f} to {peak.upper:.3f} "
            f"at {peak.frequency:.2f} rad/s"
        )
