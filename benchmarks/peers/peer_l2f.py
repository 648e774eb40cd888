# pyright: reportMissingImports=false
"""L2F (rl-tools, C++ with OpenMP): one step of one quadrotor is 0.01 s, on the CPU only.

A step holds: four motor commands, first-order rotor lag, a constant random force and torque, rigid body, RK4 (four
derivative evaluations) and the action history. No drag and no controller. One call of the binding makes one step of all
quadrotors. Batch sizes are fixed when it is compiled: powers of two up to 8192.
"""

from importlib.metadata import version

import l2f
import numpy as np

from benchmarks.peers.timing import StepBlock, parse_request, report_rates

STEPS = 20
HOVER = 0.58  # Motor command near hover of its default quadrotor, tried out


def main() -> None:
    request = parse_request(__doc__)
    if not hasattr(l2f, f"vector{request.num_envs}"):
        raise SystemExit(f"l2f has no batch of {request.num_envs}: take a power of two up to 8192")
    vector, device = getattr(l2f, f"vector{request.num_envs}"), l2f.Device()
    rng, env, parameters = vector.VectorRng(), vector.VectorEnvironment(), vector.VectorParameters()
    states = [vector.VectorState(), vector.VectorState()]
    vector.initialize_rng(device, rng, 0)
    vector.initialize_environment(device, env)
    vector.initial_parameters(device, env, parameters)
    action = np.full((request.num_envs, env.ACTION_DIM), HOVER, dtype=np.float32)

    def restart() -> None:
        for state in states:
            vector.initial_state(device, env, parameters, state)

    def run() -> None:
        for _ in range(STEPS):
            vector.step(device, env, parameters, states[0], action, states[1], rng)
            states.reverse()

    restart()
    dt = float(np.ravel(vector.step(device, env, parameters, states[0], action, states[1], rng))[0])
    batch = StepBlock(
        steps=STEPS,
        dt=dt,
        run=run,
        restart=restart,
        wait=lambda: None,
        heights=lambda: [float(state.position[2]) for state in states[0].states],
    )
    report_rates(request, batch, version=version("l2f"), call="1")


if __name__ == "__main__":
    main()
