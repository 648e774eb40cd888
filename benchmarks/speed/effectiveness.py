"""What an allocation in each environment costs: a reset of a share of the rows, and a step, with it and without.

    python -m benchmarks.speed.effectiveness [--device cpu] [--num-envs 4096] [--robot base_quadrotor]

Processor time on a CPU, time by the clock on a GPU (eager, waited for); the median of 9 rounds of both in turn [ms].
"""

import argparse
import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from statistics import median

import torch
import warp as wp

from aerial_gym import EnvManager, SimBuilder
from aerial_gym.config.controller import EFFECTIVENESS, ControlCfg
from aerial_gym.config.randomize import RandomizeCfg
from aerial_gym.robots import ROBOTS

DRAWN = {
    "body.mass": RandomizeCfg(low=0.8, high=1.2),
    "rotor.thrust_map": RandomizeCfg(each_rotor=True, low=0.9, high=1.1),
    "mounts.*.position": RandomizeCfg(each_rotor=True, how="offset", low=-0.02, high=0.02),
}
ROUNDS, CALLS = 9, 20


def build(args: argparse.Namespace, effectiveness: str) -> EnvManager:
    """Return a simulation of drawn vehicles, reset and warm."""
    robot = replace(ROBOTS.get(args.robot), control=ControlCfg(effectiveness=effectiveness))
    env = SimBuilder().build_env(
        sim_name="base_sim",
        env_name="empty_env",
        robot_name=robot,
        controller_name="lee_attitude_control",
        num_envs=args.num_envs,
        device=args.device,
        seed=0,
        randomize=DRAWN,
    )
    env.reset()
    env.step(torch.zeros(args.num_envs, 4, device=args.device))
    return env


def time_of(call: Callable[[], object], device: str) -> float:
    """Return the mean time of a call [ms]."""
    clock = time.process_time if device == "cpu" else time.perf_counter
    call()
    if device != "cpu":
        torch.cuda.synchronize()
    begin = clock()
    for _ in range(CALLS):
        call()
    if device != "cpu":
        torch.cuda.synchronize()
    return (clock() - begin) / CALLS * 1e3


def main() -> None:
    """Print a line for each of nominal and actual."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--num-envs", type=int, default=4096)
    parser.add_argument("--robot", default="base_quadrotor")
    args = parser.parse_args()
    torch.set_num_threads(1)
    share = torch.rand(args.num_envs, generator=torch.Generator().manual_seed(0)).to(args.device)
    zero = torch.zeros(args.num_envs, 4, device=args.device)
    envs = {name: build(args, name) for name in EFFECTIVENESS}
    found: dict[tuple[str, str], list[float]] = {}
    for _ in range(ROUNDS):
        for name, env in envs.items():
            calls = {f"reset {part:.0%}": partial(env.reset, share < part) for part in (0.01, 0.25, 1.0)}
            calls["step"] = partial(env.step, zero)
            for what, call in calls.items():
                found.setdefault((name, what), []).append(time_of(call, args.device))
    print(
        f"{args.robot}, {args.num_envs} environments, {args.device}, torch {torch.__version__}, Warp {wp.__version__}"
    )
    for name in envs:
        print(name, *(f"{what} {median(times):.3f} ms" for (of, what), times in found.items() if of == name), sep=", ")


if __name__ == "__main__":
    main()
