"""Rewards of the tasks for real vehicles, written out once more in NumPy from the Aerial Gym Simulator 2.0.1."""

from collections.abc import Mapping

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from aerial_gym.rl_training import settings_for
from aerial_gym.robots import ROBOTS
from aerial_gym.task import task_registry
from tests.unit.task.hover import begin

Values = Mapping[str, np.ndarray]


def bell(x: np.ndarray, a: float, b: float) -> np.ndarray:
    return a * np.exp(-b * x**2)


def cusp(x: np.ndarray, a: float, b: float) -> np.ndarray:
    return a * np.exp(-b * np.abs(x))


def proximity_reward(d: np.ndarray) -> np.ndarray:
    return bell(d, 2, 1) + bell(d, 3, 10) + cusp(d, 3, 50)


def by_velocity(before: np.ndarray, now: Values) -> np.ndarray:
    d, speed = np.linalg.norm(now["p"], axis=1), np.linalg.norm(now["v"], axis=1)
    size = (cusp(now["u"], 0.2, 4) - 0.2).sum(1)
    change = (cusp(now["u"] - now["last"], 0.3, 6) - 0.3).sum(1)
    closer = 400 * (np.linalg.norm(before, axis=1) - d)
    there = proximity_reward(d) * (bell(speed, 1, 3) + size + change + closer / 10)
    return proximity_reward(d) + (20 - d) / 40 + there + size + change + closer + cusp(now["yaw"], 2, 3)


def by_acceleration(before: np.ndarray, now: Values) -> np.ndarray:
    d, speed = np.linalg.norm(now["p"], axis=1), bell(np.linalg.norm(now["v"], axis=1), 2, 2.5)
    size = (cusp(now["u"], 0.3, 4) - 0.3).sum(1)
    change = (cusp(now["u"] - now["last"], 0.4, 6) - 0.4).sum(1)
    gained = np.linalg.norm(before, axis=1) - d
    closer = np.where(gained > 0, 400, 1200) * gained
    there = proximity_reward(d) * (closer / 9 + size / 3 + speed / 1.5)
    return proximity_reward(d) + there + size + change + closer + cusp(now["yaw"], 3, 5) + bell(d, 2, 1) + 0.2 * speed


def by_motors(before: np.ndarray, now: Values) -> np.ndarray:
    stretched = now["p"] * [1.0, 1.0, 13.0]
    pos = bell(stretched, 10, 10).sum(1) + bell(stretched, 2, 2).sum(1)
    tilt, off = 1 - now["R"][:, 2, 2], 1 - now["R"][:, 0, 0]
    up, forward = bell(tilt, 2.5, 5) + bell(tilt, 2.5, 2), bell(off, 4, 5) + bell(off, 2, 2)
    spin, speed = bell(now["w"], 0.75, 10).sum(1), bell(now["v"], 1, 5).sum(1)
    size = (bell(now["u"] - 9.81 * 1.656 / 4, 0.01, 10) - 0.01).sum(1)
    change = (bell(now["u"] - now["last"], 0.5, 6) - 0.5).sum(1)
    gained = np.linalg.norm(before, axis=1) - np.linalg.norm(now["p"], axis=1)
    toward = np.where(gained > 0, 50, 100) * gained
    return toward + (pos * (forward + speed + spin + change) + spin + speed + up + pos + size) / 100


LIMITS = {by_velocity: (-1.0, 1.0), by_acceleration: ([-2.0, -2.0, -2.0, -1.0], [2.0, 2.0, 2.0, 1.0])}
LIMITS |= {by_motors: (0.0, 8.0)}
NAMES = ("sim2real", "acceleration_sim2real", "sim2real_px4")


@pytest.mark.parametrize(("name", "formula"), zip(NAMES, LIMITS, strict=True))
def test_the_reward_is_what_is_coded_there(name: str, formula) -> None:
    low, high = LIMITS[formula]
    with begin(f"position_setpoint_task_{name}", 64, seed=2) as task:
        gtd, generator = task.env.gtd, torch.Generator().manual_seed(0)
        shown = 0
        for _ in range(25):
            before, last = (gtd[key].double().numpy().copy() for key in ("robot_position", "robot_actions"))
            actions = 2.0 * torch.rand(64, 4, generator=generator) - 1.0
            _, reward, terminated, truncated, _ = task.step(actions)
            flying = ~(terminated | truncated).numpy()
            turn = Rotation.from_quat(gtd["robot_orientation"].double().numpy())
            now = {
                "p": gtd["robot_position"].double().numpy(),
                "v": gtd["robot_linvel"].double().numpy(),
                "w": gtd["robot_body_angvel"].double().numpy(),
                "u": gtd["robot_actions"].double().numpy(),
                "last": last,
                "R": turn.as_matrix(),
                "yaw": turn.as_euler("ZYX")[:, 0],
            }
            wanted = np.add(low, 0.5 * (actions.double().numpy() + 1.0) * np.subtract(high, low))
            np.testing.assert_allclose(now["u"][flying], wanted[flying], rtol=1e-5, atol=1e-6)
            np.testing.assert_allclose(reward.numpy()[flying], formula(before, now)[flying], rtol=1e-4, atol=2e-3)
            shown += int(flying.sum())
        assert shown > 500


@pytest.mark.parametrize(("name", "entries", "seconds"), zip(NAMES, (17, 17, 15), (8.0, 8.0, 5.0), strict=True))
def test_what_is_seen_and_how_long(name: str, entries: int, seconds: float) -> None:
    with begin(f"position_setpoint_task_{name}", 3) as task:
        assert (task.num_observations, task.num_actions) == (entries, 4)
        assert task.cfg.episode_len_steps * task.env.dt == pytest.approx(seconds)


@pytest.mark.parametrize("name", ["position_setpoint_task_sim2real", "position_setpoint_task_acceleration_sim2real"])
def test_a_critic_sees_the_same_without_noise(name: str) -> None:
    """The policy sees it with the noise of the task file: 0.03 m, 0.01 of the attitude, 0.02 m/s, 0.02 rad/s."""
    assert settings_for("ppo", name, device="cpu").name == "ppo_position_setpoint_task_sim2real_cpu.yaml"
    with task_registry.make_task(name, num_envs=4096, device="cpu", seed=2) as task:
        obs, _ = task.reset()
        gtd = task.env.gtd
        position, attitude, speed, rates = obs["critic"].split([3, 4, 3, 3], dim=1)
        assert torch.equal(position, -gtd["robot_position"])
        assert torch.equal(attitude.abs(), gtd["robot_orientation"].abs())
        assert torch.equal(speed, gtd["robot_body_linvel"])
        assert torch.equal(rates, gtd["robot_body_angvel"])
        noise = (obs["observations"][:, :13] - obs["critic"]).std(0)
        stated = torch.tensor([0.03] * 3 + [0.01] * 4 + [0.02] * 6)
        torch.testing.assert_close(noise, stated, rtol=0.05, atol=0.0)  # 4.5 standard deviations of 4,096 draws


def test_the_rotors_of_the_vehicles_hover_as_their_files_say() -> None:
    """And stand in PX4's order on the X500: front right and back left turn counter-clockwise."""
    mounts = ROBOTS.get("x500").mounts.layout
    places = np.array([mount.position for mount in mounts])
    assert np.sign(places[:, :2]).tolist() == [[1, -1], [-1, 1], [1, 1], [-1, -1]]
    assert [mount.spin for mount in mounts] == [1, 1, -1, -1]
    for robot, rate in (("x500", 689.0), ("lmf2", 470.0 * 2.0 * np.pi)):
        cfg = ROBOTS.get(robot)
        rotor = cfg.the_rotor("the test")
        assert np.sqrt(cfg.body.mass * 9.81 / 4.0 / rotor.thrust_map[2]) == pytest.approx(rate, rel=1e-3)
