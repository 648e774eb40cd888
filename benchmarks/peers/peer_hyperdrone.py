# pyright: reportMissingImports=false
"""HyperDrone (rl-tools, C++ or CUDA, compiled at the first use): one step of one drone of ``dynamics.Sim``.

A step holds: four motor commands, first-order rotor lag, parameters per drone, rigid body, RK4. No drag, no controller, no
rendering. One call makes one step of all drones. Building needs cmake, a C++17 compiler (nvcc for ``cuda``) and the headers
of nlohmann json on CPATH; without network set HYPERLUX_OFFLINE=1 and keep its CMake from looking for CLI11
(``-DRL_TOOLS_DISABLE_CLI11=ON``) and, for the CPU, for CUDA (``-DRL_TOOLS_BACKEND_DISABLE_CUDA=ON``).
"""

from importlib.metadata import version

import numpy as np
from hyperdrone import dynamics

from benchmarks.peers.timing import StepBlock, parse_request, report_rates

STEPS = 20
HOVER = 0.58  # Motor command near hover of the model crazyflie, tried out


def main() -> None:
    request = parse_request(__doc__)
    parameters = {"dynamics": {"dynamics": {"model": "crazyflie"}}}
    sim = dynamics.Sim(request.num_envs, parameters=parameters, seed=0, device=request.device)
    action = np.full((request.num_envs, sim.action_dim), HOVER, np.float32)
    if request.device == "cuda":
        import torch

        action = torch.from_numpy(action).cuda()

    def run() -> None:
        for _ in range(STEPS):
            sim.step(action)

    batch = StepBlock(
        steps=STEPS, dt=float(sim.dt), run=run, restart=sim.reset, wait=sim.synchronize,
        heights=lambda: np.asarray(sim.state["position"])[:, 2].tolist(),
    )  # fmt: skip
    report_rates(request, batch, version=version("hyperdrone"), call="1")


if __name__ == "__main__":
    main()
