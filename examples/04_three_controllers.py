"""PID, H-infinity and mu of similar gain on the seal rig: which one holds over the whole pressure
range?
"""

import ambrose as amb

machine = amb.load_machine("seal-rig")
# designed on 8 rotor states ...
syntheses = {method: amb.design(machine, method) for method in ("pid", "hinf", "mu")}
# ... judged on 144
verdicts = {
    method: amb.verify(machine, result, points="nominal") for method, result in syntheses.items()
}


def picture():
    return amb.plot(verdicts["mu"])


if __name__ == "__main__":
    for method, verdict in verdicts.items():
        margin, worst = (
            verdict.tolerances["robust.stability.margin"],
            verdict.tolerances["robust.sensitivity.worst"],
        )
        states = syntheses[method].controller.n_states
        print(
            f"{method:5} {states:2} states, stable up to {margin.value:.2f} times the tolerance, "
            f"worst S_o {worst.value:.2f}"
        )
