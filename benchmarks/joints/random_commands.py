"""Number of snakes with non-finite states under extreme random commands, and angular velocities of the others.

    python -m benchmarks.joints.random_commands [--robots snakey snakey6 ...] [--dt-ms 2 4 10] [--seeds 0 1] [--backend warp]

Thrusts of 0 to 15 N and the full range of the drives, drawn anew every quarter of a second for each environment; no episode
ends. Prints a line for each robot, step and seed. On a CPU.
"""

import argparse
from dataclasses import replace

import torch
from torch import Tensor

from aerial_gym.assets import ENVIRONMENTS
from aerial_gym.control import CONTROLLERS
from aerial_gym.env_manager import SIMS, EnvManager
from aerial_gym.robots import ROBOTS

SNAKES = [f"snakey{rods}{mode}" for mode in ("", "_position", "_effort") for rods in ("", "5", "6")]
SPAN, LARGEST_THRUST = 0.25, 15.0
"""Between draws [s], and [N]."""


def fly(
    name: str, dt: float, *, seconds: float, num_envs: int, seed: int = 0, backend: str = "warp"
) -> tuple[Tensor, Tensor]:
    """Return the angular velocities of the bodies [rad/s], (E, 3), and the rates of joints [rad/s], (E, D), at the end.

    A motion that was ever not finite is not so at the end.
    """
    robot = ROBOTS.get(name)
    env = EnvManager(
        sim=replace(SIMS.get("base_sim_2ms"), dt=dt, backend=backend), env=ENVIRONMENTS.get("empty_env_2ms"), robot=robot,
        controller=CONTROLLERS.get("no_control"), num_envs=num_envs, device=torch.device("cpu"), seed=seed,
    )  # fmt: skip
    env.reset()
    assert robot.joints is not None
    ranges = [joint.drive.command_range for joint in robot.joints.layout if joint.drive is not None]
    low, high = torch.tensor([*[(0.0, LARGEST_THRUST)] * robot.num_rotors, *ranges]).unbind(1)
    generator = torch.Generator().manual_seed(seed)
    for _ in range(round(seconds / SPAN)):
        command = low + (high - low) * torch.rand(num_envs, len(low), generator=generator)
        for _ in range(round(SPAN / env.dt)):
            env.step(command)
    return env.gtd["robot_body_angvel"].clone(), env.gtd["dof_velocity"].clone()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--robots", nargs="+", choices=SNAKES, default=SNAKES, metavar="ROBOT", help=", ".join(SNAKES))
    parser.add_argument("--dt-ms", nargs="+", type=float, default=[2.0, 4.0, 10.0])
    parser.add_argument("--seeds", nargs="+", type=int, default=[0, 1])
    parser.add_argument("--num-envs", type=int, default=256)
    parser.add_argument("--seconds", type=float, default=5.0)
    parser.add_argument("--backend", choices=("warp", "torch", "mujoco"), default="warp")
    args = parser.parse_args()
    for name in args.robots:
        for dt in args.dt_ms:
            for seed in args.seeds:
                turn, rates = fly(
                    name, dt * 1e-3, seconds=args.seconds, num_envs=args.num_envs, seed=seed, backend=args.backend
                )
                fine = turn.isfinite().all(dim=1) & rates.isfinite().all(dim=1)
                speed = turn[fine].norm(dim=1)
                median, most = (f"{float(x):.3g}" for x in (speed.median(), speed.max())) if fine.any() else ("-", "-")
                print(
                    f"{name}, {dt:g} ms, seed {seed}: {int((~fine).sum())} of {args.num_envs} lost; the others turn at "
                    f"{median} rad/s (median), {most} (fastest)",
                    flush=True,
                )


if __name__ == "__main__":
    main()
