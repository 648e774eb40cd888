"""Two equal cameras on one robot, one level and one tilted to the left: ``python examples/two_cameras.py OUT.png``.

Each camera is a row of the picture: what it sees in colour, and its distances (near is dark, nothing is grey).
"""

import sys
from dataclasses import replace

import numpy as np
from matplotlib import colormaps
from PIL import Image

from aerial_gym import SimBuilder
from aerial_gym.config.robot import SensorMountCfg
from aerial_gym.robots import ROBOTS
from aerial_gym.sensors import SENSORS

CAMERA = "base_rgb_camera"
MOUNTS = (
    SensorMountCfg(sensor=CAMERA, position=(0.1, 0.0, 0.03)),
    SensorMountCfg(sensor=CAMERA, name="tilted", position=(0.1, 0.05, 0.03), euler=(0.5, 0.2, 0.4)),
)


def main(out: str) -> None:
    """Write the picture."""
    env = SimBuilder().build_env(
        sim_name="base_sim",
        env_name="forest_env",
        robot_name=replace(ROBOTS.get("base_quadrotor"), sensors=MOUNTS),
        controller_name="lee_velocity_control",
        num_envs=1,
        device="cpu",
        seed=0,
    )
    env.reset()
    env.render()
    rows = []
    for camera in ("", "tilted_"):
        color = env.gtd[f"{camera}rgb_pixels"][0, 0].numpy()
        depth = env.gtd[f"{camera}depth_range_pixels"][0, 0].numpy()
        share = colormaps["viridis"](depth / SENSORS.get(CAMERA).max_range)[..., :3]
        share[depth < 0.0] = 0.85
        rows.append(np.concatenate((color, share), axis=1))
    picture = np.concatenate(rows)
    Image.fromarray((255.0 * picture.clip(0.0, 1.0)).astype(np.uint8)).save(out, optimize=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
