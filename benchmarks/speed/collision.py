"""``python -m benchmarks.speed.collision --device cuda``: times of a step among obstacles and of its collision test.

Robots fly ten environment steps from one saved state in ``env_with_obstacles``, with all obstacles, towards random
velocities. On a GPU the ten steps are one CUDA graph. Each number is the median of 60 repeats for one step.
"""

import argparse
import json
import time
from collections.abc import Callable
from statistics import median

import torch

from aerial_gym import EnvManager, SimBuilder
from aerial_gym.interop.streams import record_graph

STEPS, REPEATS, WARM_UP = 10, 60, 5
NUM_OBSTACLES = 35
SPEED = 4.0  # Standard deviation of the commanded velocity along each axis [m/s]


def build(robot: str, num_envs: int, device: str) -> EnvManager:
    """Return the simulation of the benchmark."""
    env = SimBuilder().build_env(
        sim_name="base_sim",
        env_name="env_with_obstacles",
        robot_name=robot,
        controller_name="lee_velocity_control",
        num_envs=num_envs,
        device=device,
        seed=0,
    )
    env.asset_manager.set_num_obstacles(NUM_OBSTACLES)
    return env


def step_timer(call: Callable[[], None], device: torch.device) -> Callable[[], float]:
    """Return a function that makes ``STEPS`` calls and returns the time of one [s]."""
    for _ in range(WARM_UP):
        call()
    if device.type != "cuda":

        def on_cpu() -> float:
            begin = time.perf_counter()
            for _ in range(STEPS):
                call()
            return (time.perf_counter() - begin) / STEPS

        return on_cpu
    graph = torch.cuda.CUDAGraph()
    with record_graph(graph, device):
        for _ in range(STEPS):
            call()

    def on_gpu() -> float:
        begin, end = torch.cuda.Event(enable_timing=True), torch.cuda.Event(enable_timing=True)
        torch.cuda.synchronize()
        begin.record()
        graph.replay()
        end.record()
        torch.cuda.synchronize()
        return 1e-3 * begin.elapsed_time(end) / STEPS

    return on_gpu


def main() -> None:
    """Print one JSON object."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--num-envs", type=int, default=4096)
    parser.add_argument("--robot", default="base_quadrotor")
    asked = parser.parse_args()
    env = build(asked.robot, asked.num_envs, asked.device)
    velocity = SPEED * torch.randn(asked.num_envs, 3, generator=torch.Generator().manual_seed(0))
    actions = torch.nn.functional.pad(velocity, (0, 1)).to(env.device)
    env.reset()
    for _ in range(WARM_UP):
        env.step(actions)
    state, result = env.save_state(), {}
    for name, call in (("physics", env.fly), ("collision", env.collide), ("step", lambda: env.step(actions))):
        run, times = step_timer(call, env.device), []
        for _ in range(REPEATS):
            env.load_state(state)
            times.append(run())
        result[f"{name}_us"] = round(1e6 * median(times), 1)
    crashed = float(env.gtd["crashes"].float().mean())
    row = {"robot": asked.robot, "num_envs": asked.num_envs, "device": str(env.device), **result}
    print(json.dumps(row | {"crashed_share": round(crashed, 3)}))


if __name__ == "__main__":
    main()
