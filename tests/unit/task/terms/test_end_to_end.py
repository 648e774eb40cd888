"""The reward of motor commands, eq. 10 of the appendix of the Aerial Gym Simulator, written out once more in NumPy."""

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from aerial_gym.task import task_registry

NAME = "position_setpoint_task_sim2real_end_to_end"


def bell(x: np.ndarray, a: float, b: float) -> np.ndarray:
    return a * np.exp(-b * x**2)


def equation_10(
    before: np.ndarray, e: np.ndarray, R: np.ndarray, v: np.ndarray, w: np.ndarray, u: np.ndarray, last: np.ndarray
) -> np.ndarray:
    """Reward of one step; ``before``: position error before it, u: thrusts [N]."""
    stretched = e * [1.0, 1.0, 11.0]
    pos = bell(stretched, 10, 10).sum(1) + bell(stretched, 2, 2).sum(1)
    up, forward = bell(1 - R[:, 2, 2], 2.5, 5), bell(1 - R[:, 0, 0], 6, 5)
    spin, speed = bell(w, 0.3, 10).sum(1), bell(v, 1, 5).sum(1)
    size = (bell(u - 9.81 * 0.372 / 4, 0.01, 10) - 0.01).sum(1)
    change = (bell(u - last, 1.3, 6) - 1.3).sum(1)
    closer = np.linalg.norm(before, axis=1) - np.linalg.norm(e, axis=1)
    toward = np.where(closer >= 0, 10 * closer, 15 * closer)
    return toward + (pos * (forward + speed + spin + change) + spin + speed + up + pos + size) / 100


def test_the_reward_is_that_of_equation_10() -> None:
    with task_registry.make_task(NAME, num_envs=64, device="cpu", seed=2) as task:
        gtd, generator = task.env.gtd, torch.Generator().manual_seed(0)
        task.reset()
        shown = 0
        for _ in range(25):
            before = -gtd["robot_position"].double().numpy().copy()
            last = gtd["robot_actions"].double().numpy().copy()
            actions = 2.0 * torch.rand(64, 4, generator=generator) - 1.0
            _, reward, terminated, truncated, _ = task.step(actions)
            flying = ~(terminated | truncated).numpy()
            position, velocity, rates = (
                gtd[key].double().numpy() for key in ("robot_position", "robot_linvel", "robot_body_angvel")
            )
            u = gtd["robot_actions"].double().numpy()
            np.testing.assert_allclose(u[flying], (0.2 + 0.5 * (actions.double().numpy() + 1.0))[flying], rtol=1e-6)
            R = Rotation.from_quat(gtd["robot_orientation"].double().numpy()).as_matrix()
            expected = equation_10(before, -position, R, velocity, rates, u, last)
            np.testing.assert_allclose(reward.numpy()[flying], expected[flying], rtol=1e-4, atol=1e-4)
            shown += int(flying.sum())
        assert shown > 500


def test_what_it_sees_is_that_of_table_6() -> None:
    task = task_registry.get(NAME)
    seen = ["position_error_world", "rotation_rows", "lin_vel_world", "ang_vel_body"]
    assert [entry.term for entry in task.observations["policy"]] == seen
    noise = [entry.noise_std for entry in task.observations["policy"]]
    assert noise == pytest.approx([1e-3, np.pi / 1032, 2e-3, 1e-3], rel=1e-5)
    with task_registry.make_task(NAME, num_envs=3, device="cpu", seed=0) as made:
        assert (made.num_observations, made.num_actions, made.cfg.episode_len_steps * made.env.dt) == (15, 4, 6.0)
        start = made.reset()[0]["observations"][:, :3]
        assert float(start.norm(dim=-1).max()) < 1.5
