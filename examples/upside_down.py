"""A quadrotor whose rotors push both ways turns over, and hovers upside down at its place: ``python examples/upside_down.py``.

Its robot file stands beside this one. The controller takes thrust [multiples of the weight, less 1], roll, pitch and yaw rate.
"""

from math import pi
from pathlib import Path

import torch

from aerial_gym import SimBuilder

ROBOT = Path(__file__).with_name("reversible_quadrotor.yaml")

GRAVITY, STIFFNESS, DAMPING = 9.81, 1.0, 2.0
"""[m/s²]; of the acceleration towards the place [1/s²] and against the velocity [1/s]."""

FLIP_S, SPAN_S = 0.6, 12.0


def main() -> None:
    """Fly, and print the final state."""
    env = SimBuilder().build_env(
        sim_name="base_sim", env_name="empty_env", robot_name=ROBOT, controller_name="lee_attitude_control",
        num_envs=4, device="cpu", seed=0,
    )  # fmt: skip
    env.reset()
    gtd, actions = env.gtd, torch.zeros(4, 4)
    place = gtd["robot_position"].clone()
    for step in range(round(SPAN_S / env.dt)):
        over = min(step * env.dt / FLIP_S, 1.0) * pi
        wanted = STIFFNESS * (place - gtd["robot_position"]) - DAMPING * gtd["robot_linvel"]
        force = wanted + torch.tensor([0.0, 0.0, GRAVITY])  # for each kilogram
        x, y, z, w = gtd["robot_orientation"].unbind(-1)
        body_z = torch.stack((2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y)), dim=-1)
        actions[:, 0] = (force * body_z).sum(-1) / GRAVITY - 1.0  # below -1: the rotors push along -z of the body
        yaw = gtd["robot_euler_angles"][:, 2]
        ahead = force[:, 0] * yaw.cos() + force[:, 1] * yaw.sin()
        left = force[:, 1] * yaw.cos() - force[:, 0] * yaw.sin()
        actions[:, 1] = over - torch.atan2(left, force[:, 2])
        actions[:, 2] = torch.atan2(ahead, force[:, 2])
        env.step(actions)
    away = (place - gtd["robot_position"]).norm(dim=-1).max()
    up, speed = body_z[:, 2].max(), gtd["rotor_speed"].max()
    print(f"body z points {up:.3f} up, {away:.3f} m from the place, rotors at {speed:.0f} rad/s at most")


if __name__ == "__main__":
    main()
