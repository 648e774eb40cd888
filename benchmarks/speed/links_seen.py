"""What links cost in sight: images per second of a camera on robots that are seen, rigid ones and such that bend.

    python -m benchmarks.speed.links_seen [--robots morphy_stiff morphy snakey6] [--num-envs 4096] [--device cuda]

Each environment has a camera of 64 by 64 ranges at its body, which sees the links of its own robot and the scene.
"""

import argparse
import time
from dataclasses import replace

import torch

from aerial_gym.assets import ENVIRONMENTS
from aerial_gym.config.sensor import CameraCfg
from aerial_gym.control import CONTROLLERS
from aerial_gym.env_manager import SIMS, EnvManager
from aerial_gym.interop import resolve_device
from aerial_gym.robots import ROBOTS
from aerial_gym.sensors import RayCaster, make_images

CAMERA = CameraCfg(
    summary="64 by 64 ranges", width=64, height=64, hfov_deg=90.0, min_range=0.0, max_range=20.0, kind="range",
    source="chosen for the comparison",
)  # fmt: skip
IMAGES, REPEATS = 50, 5


def images_per_second(robot: str, env: str, num_envs: int, device: torch.device) -> float:
    """Return how many images of all environments are made in a second, the best of some repeats."""
    manager = EnvManager(
        sim=SIMS.get("base_sim"), env=ENVIRONMENTS.get(env), robot=replace(ROBOTS.get(robot), visible=True),
        controller=CONTROLLERS.get("no_control"), num_envs=num_envs, device=device, seed=1,
    )  # fmt: skip
    manager.reset()
    gtd = manager.gtd
    caster = RayCaster(
        CAMERA, manager.asset_manager.scene, make_images(CAMERA, num_envs, device=device),
        position=gtd["robot_position"], attitude=gtd["robot_orientation"], lin_vel=gtd["robot_linvel"],
        ang_vel=gtd["robot_body_angvel"],
    )  # fmt: skip
    caster.cast()
    best = 0.0
    for _ in range(REPEATS):
        _wait(device)
        start = time.perf_counter()
        for _ in range(IMAGES):
            caster.cast()
        _wait(device)
        best = max(best, IMAGES * num_envs / (time.perf_counter() - start))
    return best


def _wait(device: torch.device) -> None:
    if device.type == "cuda":
        torch.cuda.synchronize(device)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--robots", nargs="+", default=["morphy_stiff", "morphy", "snakey6"])
    parser.add_argument("--envs", nargs="+", default=["empty_env", "env_with_obstacles"])
    parser.add_argument("--num-envs", type=int, default=4096)
    parser.add_argument("--device", default="cpu")
    args = parser.parse_args()
    for env in args.envs:
        for robot in args.robots:
            found = images_per_second(robot, env, args.num_envs, resolve_device(args.device))
            print(f"{env}, {robot}: {found:.3g} images per second", flush=True)


if __name__ == "__main__":
    main()
