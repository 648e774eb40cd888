"""Number of snakes with non-finite states under extreme random commands, and angular velocities of the others.

    python -m benchmarks.joints.random_commands [--robots snakey snakey6 ...] [--dt-ms 2 4 10] [--seeds 0 1] [--backend warp]

Thrusts of 0 to 15 N and the full range of the drives, drawn anew every quarter of a second for each environment; no episode
ends. Prints a line for each robot, step and seed. On a CPU.
"""

from dataclasses import replace
from itertools import product
from typing import Literal

import torch
import tyro
from torch import Tensor

from aerial_gym.assets import ENVIRONMENTS
from aerial_gym.control import CONTROLLERS
from aerial_gym.env_manager import SIMS, EnvManager
from aerial_gym.robots import ROBOTS

SNAKES = tuple(f"snakey{rods}{mode}" for mode in ("", "_position", "_effort") for rods in ("", "5", "6"))
SPAN, LARGEST_THRUST = 0.25, 15.0  # Between draws [s], and [N]


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


def main(
    *, robots: tuple[str, ...] = SNAKES, dt_ms: tuple[float, ...] = (2.0, 4.0, 10.0), seeds: tuple[int, ...] = (0, 1),
    num_envs: int = 256, seconds: float = 5.0, backend: Literal["warp", "torch", "mujoco"] = "warp",
) -> None:  # fmt: skip
    """Fly and print a line for each robot, step and seed."""
    for name, dt, seed in product(robots, dt_ms, seeds):
        turn, rates = fly(name, dt * 1e-3, seconds=seconds, num_envs=num_envs, seed=seed, backend=backend)
        fine = turn.isfinite().all(dim=1) & rates.isfinite().all(dim=1)
        speed = turn[fine].norm(dim=1)
        median, most = (f"{float(x):.3g}" for x in (speed.median(), speed.max())) if fine.any() else ("-", "-")
        lost = f"{name}, {dt:g} ms, seed {seed}: {int((~fine).sum())} of {num_envs} lost"
        print(f"{lost}; the others turn at {median} rad/s (median), {most} (fastest)", flush=True)


if __name__ == "__main__":
    tyro.cli(main, description=__doc__)
