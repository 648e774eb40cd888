"""Rewards of tasks, written out once more in NumPy: from the Aerial Gym Simulator 2.0.1, and eq. 10 of its appendix."""

from collections.abc import Callable, Mapping
from math import sqrt

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from aerial_gym.rl_training import settings_for
from aerial_gym.task import REWARDS, task_registry
from tests.repetitions import rare_values
from tests.unit.task.hover import begin, build_task, term_reward

KEYS = {"p": "robot_position", "v": "robot_linvel", "w": "robot_body_angvel", "u": "robot_actions"}
KEYS |= {"joint_vel": "dof_velocity"}

Values = Mapping[str, np.ndarray]
"""Of ``KEYS`` after a step; matrices ``R`` and angles ``euler``; actions ``last`` and ``p_before`` before the step."""


def bell(x: np.ndarray, a: float, b: float) -> np.ndarray:
    return a * np.exp(-b * x**2)


def cusp(x: np.ndarray, a: float, b: float) -> np.ndarray:
    return a * np.exp(-b * np.abs(x))


def norm(x: np.ndarray) -> np.ndarray:
    return np.linalg.norm(x, axis=1)


def proximity_reward(d: np.ndarray) -> np.ndarray:
    return bell(d, 2, 1) + bell(d, 3, 10) + cusp(d, 3, 50)


def by_velocity(now: Values) -> np.ndarray:
    d, yaw = norm(now["p"]), now["euler"][:, 2]
    size = (cusp(now["u"], 0.2, 4) - 0.2).sum(1)
    change = (cusp(now["u"] - now["last"], 0.3, 6) - 0.3).sum(1)
    closer = 400 * (norm(now["p_before"]) - d)
    there = proximity_reward(d) * (bell(norm(now["v"]), 1, 3) + size + change + closer / 10)
    return proximity_reward(d) + (20 - d) / 40 + there + size + change + closer + cusp(yaw, 2, 3)


def by_acceleration(now: Values) -> np.ndarray:
    d, speed, yaw = norm(now["p"]), bell(norm(now["v"]), 2, 2.5), now["euler"][:, 2]
    size = (cusp(now["u"], 0.3, 4) - 0.3).sum(1)
    change = (cusp(now["u"] - now["last"], 0.4, 6) - 0.4).sum(1)
    gained = norm(now["p_before"]) - d
    closer = np.where(gained > 0, 400, 1200) * gained
    there = proximity_reward(d) * (closer / 9 + size / 3 + speed / 1.5)
    return proximity_reward(d) + there + size + change + closer + cusp(yaw, 3, 5) + bell(d, 2, 1) + 0.2 * speed


def by_motors(now: Values) -> np.ndarray:
    stretched = now["p"] * [1.0, 1.0, 13.0]
    pos = bell(stretched, 10, 10).sum(1) + bell(stretched, 2, 2).sum(1)
    tilt, off = 1 - now["R"][:, 2, 2], 1 - now["R"][:, 0, 0]
    up, forward = bell(tilt, 2.5, 5) + bell(tilt, 2.5, 2), bell(off, 4, 5) + bell(off, 2, 2)
    spin, speed = bell(now["w"], 0.75, 10).sum(1), bell(now["v"], 1, 5).sum(1)
    size = (bell(now["u"] - 9.81 * 1.656 / 4, 0.01, 10) - 0.01).sum(1)
    change = (bell(now["u"] - now["last"], 0.5, 6) - 0.5).sum(1)
    gained = norm(now["p_before"]) - norm(now["p"])
    toward = np.where(gained > 0, 50, 100) * gained
    return toward + (pos * (forward + speed + spin + change) + spin + speed + up + pos + size) / 100


def equation_10(now: Values) -> np.ndarray:
    stretched = now["p"] * [1.0, 1.0, 11.0]
    pos = bell(stretched, 10, 10).sum(1) + bell(stretched, 2, 2).sum(1)
    up, forward = bell(1 - now["R"][:, 2, 2], 2.5, 5), bell(1 - now["R"][:, 0, 0], 6, 5)
    spin, speed = bell(now["w"], 0.3, 10).sum(1), bell(now["v"], 1, 5).sum(1)
    size = (bell(now["u"] - 9.81 * 0.372 / 4, 0.01, 10) - 0.01).sum(1)
    change = (bell(now["u"] - now["last"], 1.3, 6) - 1.3).sum(1)
    closer = norm(now["p_before"]) - norm(now["p"])
    toward = np.where(closer >= 0, 10 * closer, 15 * closer)
    return toward + (pos * (forward + speed + spin + change) + spin + speed + up + pos + size) / 100


def of_morphy(now: Values) -> np.ndarray:
    d = norm(now["p"])
    pos = bell(d, 4, 12) + bell(d, 1, 3)
    up, spin = bell(1 - now["R"][:, 2, 2], 5, 25), bell(norm(now["w"]), 3, 10.5)
    change = (bell(now["u"] - now["last"], 0.2, 5) - 0.2).sum(1)
    size = -0.15 * ((now["u"] - 0.711225) ** 2).sum(1)
    joint = (bell(now["joint_vel"], 0.3, 30) - 0.3).sum(1)
    return pos + (20 - d) / 40 + pos * (up + spin) + change + change * pos + size + joint


def of_morphy_in_the_paper(now: Values) -> np.ndarray:
    d = norm(now["p"])
    thrust = (bell(now["u"] - 0.711225, 0.01, 10) - 0.01).sum(1)
    published = (20 - d) / 40 - 0.15 * ((now["u"] - 0.711225) ** 2).sum(1)
    return of_morphy(now) - published + 10 * (norm(now["p_before"]) - d) + thrust


def of_snake(now: Values) -> np.ndarray:
    d = norm(now["p"])
    pos, yaw = bell(d, 3, 8) + bell(d, 0.5, 1), bell(now["w"][:, 2], 5, 20.5)
    up, spin = bell(now["euler"][:, :2], 3, 5).sum(1), bell(norm(now["w"]), 3, 10.5)
    return pos + (20 - d) / 40 + yaw + pos * (up + spin + yaw)


FULL = [2.0, 2.0, 2.0, 1.0]
TASKS: dict[str, tuple[Callable[[Values], np.ndarray], float, tuple | None, int, float]] = {
    "sim2real": (by_velocity, 2e-3, (-1.0, 1.0), 17, 8.0),
    "acceleration_sim2real": (by_acceleration, 2e-3, (np.negative(FULL), FULL), 17, 8.0),
    "sim2real_px4": (by_motors, 2e-3, (0.0, 8.0), 15, 5.0),
    "sim2real_end_to_end": (equation_10, 1e-4, (0.2, 1.2), 15, 6.0),
    "morphy": (of_morphy, 1e-5, None, 33, 5.0),
    "morphy_paper": (of_morphy_in_the_paper, 1e-5, None, 33, 5.0),
    "reconfigurable": (of_snake, 1e-5, None, 49, 5.0),
}
"""Formula and how near it is; limits of commands; entries of the observation; length of an episode [s]."""


@pytest.mark.parametrize("name", rare_values(TASKS, ("reconfigurable",)))
def test_the_reward_is_the_published_one(name: str) -> None:
    formula, atol, limits, entries, seconds = TASKS[name]
    with begin(f"position_setpoint_task_{name}", 40, seed=2) as task:
        assert task.num_observations == entries
        assert task.cfg.episode_len_steps * task.env.dt == pytest.approx(seconds)
        gtd, generator, shown = task.env.gtd, torch.Generator().manual_seed(0), 0

        def read(key: str) -> np.ndarray:
            return gtd[key].double().numpy().copy()

        for _ in range(20):
            now = {"last": read("robot_actions"), "p_before": read("robot_position")}
            actions = 2.0 * torch.rand(40, task.num_actions, generator=generator) - 1.0
            obs, reward, terminated, truncated, _ = task.step(actions)
            flying, turn = ~(terminated | truncated).numpy(), Rotation.from_quat(read("robot_orientation"))
            now |= {"R": turn.as_matrix(), "euler": turn.as_euler("ZYX")[:, ::-1]}
            now |= {letter: read(key) for letter, key in KEYS.items() if key in gtd}
            np.testing.assert_allclose(reward.numpy()[flying], formula(now)[flying], rtol=1e-4, atol=atol)
            if limits is None:
                joints = np.concatenate([gtd["dof_position"].numpy(), gtd["dof_velocity"].numpy()], axis=1)
                np.testing.assert_allclose(obs["observations"].numpy()[:, -joints.shape[1] :], joints, rtol=1e-6)
            else:
                wanted = np.add(limits[0], 0.5 * (actions.double().numpy() + 1.0) * np.subtract(limits[1], limits[0]))
                np.testing.assert_allclose(now["u"][flying], wanted[flying], rtol=1e-5, atol=1e-6)
            shown += int(flying.sum())
        assert shown > 300


def test_the_end_to_end_policy_sees_what_table_6_says() -> None:
    entries = task_registry.get("position_setpoint_task_sim2real_end_to_end").observations["policy"]
    seen = ["position_error_world", "rotation_rows", "lin_vel_world", "ang_vel_body"]
    assert [entry.term for entry in entries] == seen
    noise = [entry.noise_std for entry in entries]
    assert noise == pytest.approx([1e-3, np.pi / 1032, 2e-3, 1e-3], rel=1e-5)
    with task_registry.make_task("position_setpoint_task_sim2real_end_to_end", num_envs=3, device="cpu") as made:
        start = made.reset()[0]["observations"][:, :3]
        assert float(start.norm(dim=-1).max()) < 1.5


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


F64 = torch.float64


def test_their_numbers_in_closed_form() -> None:
    """A robot at (3, 4, 0) from its target: 5 m; with 12 m of rounding 13. Squares of (1, 2, 2) are 9."""
    zero, there = torch.zeros(1, 3, dtype=F64), torch.tensor([[3.0, 4.0, 0.0]], dtype=F64)
    fast = torch.tensor([[1.0, 2.0, 2.0]], dtype=F64)

    def value(name: str, *read: torch.Tensor, **params: float) -> float:
        return float(REWARDS.get(name).value(*read, **params))

    assert value("distance_rounded", zero, there, offset=8.0, scale=2.0, width=12.0) == pytest.approx(-2.5)
    assert value("distance_rounded", zero, zero, offset=8.0, scale=1.0, width=0.5) == pytest.approx(7.5)
    assert value("speed_cost", fast, weight=0.1) == pytest.approx(-0.9)
    assert value("turning_cost", fast, weight=2.0) == pytest.approx(-18.0)
    assert value("velocity_error_cost", fast, 2.0 * fast, weight=1.0) == pytest.approx(-9.0)


@pytest.mark.parametrize("name", ["position_setpoint_task", "tracking_task"])
def test_a_smooth_task_draws_to_its_target_from_everywhere(name: str) -> None:
    """By 0.8 to 1 for a metre from 0.3 to 8 m, and by nothing that jumps at the target; the task itself by 0.1 beyond 3 m."""
    slopes = {}
    for task_name in (name, f"smooth_{name}"):
        task = build_task(task_registry.get(task_name), 1, gradients=F64)
        task.reset()
        reads = dict(task._judge.rows._reads)
        for distance in (0.0, 0.3, 3.0, 7.9):
            position = torch.tensor([[distance / sqrt(2.0), 0.0, distance / sqrt(2.0)]], dtype=F64, requires_grad=True)
            zeros = ("robot_linvel", "robot_body_angvel", "target_position", "target_velocity")
            now = {"robot_position": position} | dict.fromkeys(zeros, torch.zeros(1, 3, dtype=F64))
            now |= {"robot_orientation": torch.tensor([[0.0, 0.0, 0.0, 1.0]], dtype=F64)}
            reward = term_reward(task, reads | now)
            slopes[task_name, distance] = float(torch.autograd.grad(reward.sum(), position)[0].norm())
    assert slopes[f"smooth_{name}", 0.0] == 0.0
    assert all(0.8 < slopes[f"smooth_{name}", distance] <= 1.0 for distance in (0.3, 3.0, 7.9))
    assert all(slopes[name, distance] < 0.1 for distance in (3.0, 7.9))
