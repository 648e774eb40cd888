"""A policy of others in this simulator: ``python examples/outside_policy.py [ROBOT ...]`` (``pip install foundation-policy``).

RAPTOR (Eschmann, Albani, Loianno 2025, "RAPTOR: A Foundation Policy for Quadrotor Control") was trained on a thousand
vehicles and has a memory, by which it finds out which one it flies. Its rotors: front right, back right, back left, front left.
"""

import sys

import numpy as np
import torch
from foundation_policy import Raptor

from aerial_gym import SimBuilder
from aerial_gym.math.quaternion import quat_to_matrix
from aerial_gym.physics import rotor_state_for_thrust
from aerial_gym.robots import ROBOTS

PLACES = ((1, -1), (-1, -1), (-1, 1), (1, 1))
"""Signs of x and y of its rotors."""


def hover_errors(robot: str, *, num_envs: int = 64, seconds: float = 10.0) -> np.ndarray:
    """Return the mean distance to the origin in the last second [m], (E,), started within half a metre; inf: lost."""
    cfg = ROBOTS.get(robot)
    order = [PLACES.index((int(np.sign(m.position[0])), int(np.sign(m.position[1])))) for m in cfg.mounts.layout]
    rotor = cfg.the_rotor("this policy")
    low, high = (rotor_state_for_thrust(rotor, max(force, 0.0)) for force in rotor.thrust_range)
    env = SimBuilder().build_env(
        sim_name="base_sim",
        env_name="empty_env",
        robot_name=robot,
        controller_name="rotor_speed_control",
        num_envs=num_envs,
        device="cpu",
        seed=0,
    )
    env.reset()
    gtd, policy, action, distances = env.gtd, Raptor(), np.zeros((num_envs, 4), dtype=np.float32), []
    policy.reset()
    gtd["robot_position"][:] *= 0.3
    for _ in range(round(seconds / env.dt)):
        turn = quat_to_matrix(gtd["robot_orientation"]).flatten(1)
        parts = (gtd["robot_position"], turn, gtd["robot_linvel"], gtd["robot_body_angvel"], torch.from_numpy(action))
        action = np.clip(policy.evaluate_step(torch.cat(parts, dim=1).numpy()), -1.0, 1.0).astype(np.float32)
        env.step(torch.from_numpy(low + 0.5 * (action[:, order] + 1.0) * (high - low)))
        distances.append(gtd["robot_position"].norm(dim=1).numpy().copy())
    errors = np.stack(distances[-round(1.0 / env.dt) :]).mean(axis=0)
    return np.where(errors < 1.0, errors, np.inf)


if __name__ == "__main__":
    for name in sys.argv[1:] or (
        "base_quadrotor",
        "crazyflie_21",
        "crazyflie_21_brushless",
        "x500",
        "lmf2",
        "tinyprop",
    ):
        errors = hover_errors(name)
        stayed = errors < np.inf
        told = f"{np.median(errors[stayed]):.3f} m beside the target (median)" if stayed.any() else "nowhere"
        print(f"{name}: {stayed.mean():.0%} stayed, {told}")
