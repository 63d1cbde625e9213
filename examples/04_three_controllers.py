"""PID, H-infinity and mu of similar gain on the seal rig: which one holds over the whole pressure range?"""

from ambrose import load_machine
from ambrose.plant.assemble import assemble
from ambrose.synthesis.design import design
from ambrose.verification import robust

plant = assemble(load_machine("seal-rig"))
syntheses = {method: design(plant, method) for method in ("pid", "hinf", "mu")}  # designed on 8 rotor states ...
verdicts = {method: robust.check(plant, result.controller) for method, result in syntheses.items()}  # ... judged on 320

if __name__ == "__main__":
    for method, checks in verdicts.items():
        margin, worst = checks["robust.stability.margin"], checks["robust.sensitivity.worst"]
        states = syntheses[method].controller.n_states
        print(f"{method:5} {states:2} states, stable up to {margin.value:.2f} tolerances of k, worst S_o {worst.value:.2f}")
