"""Rewards of the tasks with joints, written out once more in NumPy from the Aerial Gym Simulator 2.0.1."""

from collections.abc import Callable, Mapping
from inspect import signature

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from aerial_gym.task import task_registry
from aerial_gym.task.terms import rewards as terms
from tests.unit.task.hover import begin

Values = Mapping[str, np.ndarray]


def bell(x: np.ndarray, a: float, b: float) -> np.ndarray:
    return a * np.exp(-b * x**2)


def of_morphy(now: Values) -> np.ndarray:
    d = np.linalg.norm(now["p"], axis=1)
    pos = bell(d, 4, 12) + bell(d, 1, 3)
    up, spin = bell(1 - now["R"][:, 2, 2], 5, 25), bell(np.linalg.norm(now["w"], axis=1), 3, 10.5)
    change = (bell(now["u"] - now["last"], 0.2, 5) - 0.2).sum(1)
    size = -0.15 * ((now["u"] - 0.711225) ** 2).sum(1)
    joint = (bell(now["joint_vel"], 0.3, 30) - 0.3).sum(1)
    return pos + (20 - d) / 40 + pos * (up + spin) + change + change * pos + size + joint


def of_morphy_in_the_paper(now: Values) -> np.ndarray:
    d, before = np.linalg.norm(now["p"], axis=1), np.linalg.norm(now["p_before"], axis=1)
    thrust = (bell(now["u"] - 0.711225, 0.01, 10) - 0.01).sum(1)
    published = (20 - d) / 40 - 0.15 * ((now["u"] - 0.711225) ** 2).sum(1)
    return of_morphy(now) - published + 10 * (before - d) + thrust


def of_snake(now: Values) -> np.ndarray:
    d = np.linalg.norm(now["p"], axis=1)
    pos, yaw = bell(d, 3, 8) + bell(d, 0.5, 1), bell(now["w"][:, 2], 5, 20.5)
    up, spin = bell(now["euler"][:, :2], 3, 5).sum(1), bell(np.linalg.norm(now["w"], axis=1), 3, 10.5)
    return pos + (20 - d) / 40 + yaw + pos * (up + spin + yaw)


@pytest.mark.parametrize(
    ("name", "formula", "entries"),
    [
        ("position_setpoint_task_morphy", of_morphy, 33),
        ("position_setpoint_task_morphy_paper", of_morphy_in_the_paper, 33),
        pytest.param("position_setpoint_task_reconfigurable", of_snake, 49, marks=pytest.mark.slow),
    ],
)
def test_the_reward_is_what_is_coded_there(name: str, formula: Callable[[Values], np.ndarray], entries: int) -> None:
    with task_registry.make_task(name, num_envs=32, device="cpu", seed=2) as task:
        assert task.num_observations == entries
        assert task.cfg.episode_len_steps * task.env.dt == pytest.approx(5.0)
        gtd, generator = task.env.gtd, torch.Generator().manual_seed(0)
        task.reset()
        shown = 0
        for _ in range(12):
            last, before = (gtd[key].double().numpy().copy() for key in ("robot_actions", "robot_position"))
            actions = 2.0 * torch.rand(32, task.num_actions, generator=generator) - 1.0
            obs, reward, terminated, truncated, _ = task.step(actions)
            flying = ~(terminated | truncated).numpy()
            turn = Rotation.from_quat(gtd["robot_orientation"].double().numpy())
            now = {
                "p": gtd["robot_position"].double().numpy(),
                "w": gtd["robot_body_angvel"].double().numpy(),
                "u": gtd["robot_actions"].double().numpy(),
                "joint_vel": gtd["dof_velocity"].double().numpy(),
                "last": last,
                "p_before": before,
                "R": turn.as_matrix(),
                "euler": turn.as_euler("ZYX")[:, ::-1],
            }
            np.testing.assert_allclose(reward.numpy()[flying], formula(now)[flying], rtol=1e-4, atol=1e-5)
            joints = np.concatenate([gtd["dof_position"].numpy(), gtd["dof_velocity"].numpy()], axis=1)
            np.testing.assert_allclose(obs["observations"].numpy()[:, -joints.shape[1] :], joints, rtol=1e-6)
            shown += flying.sum()
        assert shown > 100


def test_a_crash_is_worth_what_it_is_there() -> None:
    with begin("position_setpoint_task_morphy", 8, seed=2) as task:
        for _ in range(200):
            _, reward, terminated, _, _ = task.step(-torch.ones(8, 4))
            if bool(terminated.any()):
                assert bool((reward[terminated] == -20.0).all())
                return
        raise AssertionError("nobody fell three metres")


def test_a_snake_starts_anywhere_in_its_bounds_heading_anywhere() -> None:
    """As there: places from all of the 2 m box, any yaw, up to 0.2 m/s and 0.2 rad/s on each axis; level, in a ring.

    Uniform draws of 400 starts fill more than 90 % of each range but for one in 1e17 tries (0.9^400 at either end).
    """
    with begin("position_setpoint_task_reconfigurable", 400, seed=3) as task:
        gtd = task.env.gtd
        euler = Rotation.from_quat(gtd["robot_orientation"].double().numpy()).as_euler("ZYX")
        speeds = ((gtd[key].numpy(), 0.2) for key in ("robot_linvel", "robot_body_angvel"))
        for seen, half in ((gtd["robot_position"].numpy(), 1.0), (euler[:, :1], np.pi), *speeds):
            assert np.all(np.abs(seen) <= half * (1.0 + 1e-6))
            assert np.all(seen.max(0) > 0.8 * half)
            assert np.all(seen.min(0) < -0.8 * half)
        np.testing.assert_allclose(euler[:, 1:], 0.0, atol=1e-6)


def test_the_two_rewards_of_morphy_differ_in_distance_and_thrust_as_worked_by_hand() -> None:
    """From 1.0 m to 0.9 m, each rotor 0.1 N above hover: 10 * 0.1 and 4 * 0.01 (exp(-0.1) - 1), or 19.1 / 40 and -0.006."""
    tensors = {
        "target_position": torch.zeros(1, 3),
        "robot_position": torch.tensor([[0.0, 0.9, 0.0]]),
        "previous_distance": torch.tensor([1.0]),
        "robot_actions": torch.full((1, 4), 0.811225),
    }
    result = {}
    for name in ("position_setpoint_task_morphy", "position_setpoint_task_morphy_paper"):
        rewards = task_registry.get(name).rewards
        for term in ("distance", "size"):
            function = getattr(terms, rewards[term].term)
            read = {key: tensors[key] for key in signature(function).parameters if key in tensors}
            result[name, term] = float(function(**read, **rewards[term].params))
    assert result["position_setpoint_task_morphy", "distance"] == pytest.approx(0.4775, rel=1e-5)
    assert result["position_setpoint_task_morphy", "size"] == pytest.approx(-0.006, rel=1e-4)
    assert result["position_setpoint_task_morphy_paper", "distance"] == pytest.approx(1.0, rel=1e-5)
    assert result["position_setpoint_task_morphy_paper", "size"] == pytest.approx(-0.00380650, rel=1e-4)
    published, paper = (
        task_registry.get(f"position_setpoint_task_{name}").rewards for name in ("morphy", "morphy_paper")
    )
    assert {name for name in published if published[name] != paper[name]} == {"distance", "size"}
