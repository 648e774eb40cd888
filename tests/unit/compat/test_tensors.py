"""Tensor keys of the Aerial Gym Simulator: each one of the table is there or says what to do."""

from collections.abc import Iterator

import pytest
import torch

from aerial_gym.compat import EnvManager, SimBuilder
from aerial_gym.compat.tensors import KEYS
from aerial_gym.errors import OwnershipError, UnknownNameError

E, A = 3, 40


def make_env(env_name: str, robot: str = "base_quadrotor", *, num_envs: int) -> EnvManager:
    names = ("base_sim", env_name, robot, "lee_velocity_control", "cpu")
    return SimBuilder().build_env(*names, num_envs=num_envs, seed=0)


@pytest.fixture(scope="module")
def env() -> Iterator[EnvManager]:
    env = make_env("dynamic_env", "base_quadrotor_with_camera_imu", num_envs=E)
    env.reset()
    env.step(torch.zeros(E, 4))
    env.render("sensors")
    return env


SHAPES = {  # parity.md 1.5, with N = E, one body per actor
    "vec_root_tensor": (E, 1 + A, 13), "unfolded_env_asset_state_tensor": (E * (1 + A), 13), "robot_state_tensor": (E, 13),
    "env_asset_state_tensor": (E, A, 13), "rigid_body_state_tensor": (E * (1 + A), 13), "robot_position": (E, 3),
    "robot_orientation": (E, 4), "robot_linvel": (E, 3), "robot_angvel": (E, 3), "robot_body_linvel": (E, 3),
    "robot_body_angvel": (E, 3), "robot_vehicle_orientation": (E, 4), "robot_vehicle_linvel": (E, 3),
    "robot_euler_angles": (E, 3), "obstacle_position": (E, A, 3), "obstacle_orientation": (E, A, 4),
    "obstacle_linvel": (E, A, 3), "obstacle_angvel": (E, A, 3), "env_bounds_min": (E, 3), "env_bounds_max": (E, 3),
    "gravity": (E, 3), "robot_mass": (E,), "robot_inertia": (E, 3, 3), "robot_actions": (E, 4), "robot_prev_actions": (E, 4),
    "env_actions": (E, A, 6), "prev_env_actions": (E, A, 6), "crashes": (E,), "truncations": (E,),
    "depth_range_pixels": (E, 1, 135, 240), "segmentation_pixels": (E, 1, 135, 240), "imu_measurement": (E, 6),
}  # fmt: skip
NUMBERS = {
    "dt": 0.01, "num_obstacles_in_env": A, "num_robot_actions": 4, "num_env_actions": 6, "dof_control_mode": "none",
}  # fmt: skip
ELSEWHERE = {"robot_contact_force_tensor", "curriculum_level", "rgb_pixels"}
ELSEWHERE |= {"dof_state_tensor", "unfolded_dof_state_tensor"}
"""Keys of other environments, tasks, cameras and robots."""


@pytest.mark.parametrize("name", KEYS)
def test_every_key_is_there_or_says_what_to_do(env: EnvManager, name: str) -> None:
    tensors = env.get_obs()
    if name in SHAPES:
        assert tuple(tensors[name].shape) == SHAPES[name]
        assert name in tensors
    elif name in NUMBERS:
        assert tensors[name] == pytest.approx(NUMBERS[name])
    elif name in ELSEWHERE:
        with pytest.raises(KeyError, match="in this simulation"):
            tensors[name]
    else:
        assert KEYS[name].remark
        with pytest.raises(KeyError, match="has no counterpart here: "):
            tensors[name]
        assert tensors.get(name, "default") == "default"


def test_contact_and_colour_are_there_where_they_are_made() -> None:
    tensors = make_env("landing_env", num_envs=1).get_obs()
    assert tensors["robot_contact_force_tensor"].shape == (1, 3)


def test_keys_are_views_and_assignments_reach_the_simulation(env: EnvManager) -> None:
    tensors, crashes = env.get_obs(), env.env.gtd["crashes"]
    assert tensors["crashes"] is crashes
    tensors["crashes"] = torch.tensor([True, False, True])
    assert env.env.gtd["crashes"] is crashes
    assert crashes.tolist() == [True, False, True]
    tensors["crashes"] = torch.zeros(E, dtype=torch.bool)
    with pytest.raises(RuntimeError):
        tensors["crashes"] = torch.zeros(E + 2, dtype=torch.bool)
    with pytest.raises(OwnershipError, match="'gravity' = sim_cfg.gravity here: it follows from other keys"):
        tensors["gravity"] = torch.zeros(3)


def test_scripts_keep_things_of_their_own(env: EnvManager) -> None:
    tensors = env.get_obs()
    tensors["curriculum_level"] = 7
    assert tensors["curriculum_level"] == 7
    assert "curriculum_level" in list(tensors)
    del tensors["curriculum_level"]
    assert "curriculum_level" not in tensors
    with pytest.raises(OwnershipError, match="only keys that the script has added"):
        del tensors["robot_position"]


def test_number_of_obstacles_counts_those_that_are_kept() -> None:
    """15 rows in use: the 9 that are always kept and 6 others; the rest is parked at the next reset."""
    env = make_env("env_with_obstacles", num_envs=2)
    assert env.global_tensor_dict["num_obstacles_in_env"] == 44
    env.global_tensor_dict["num_obstacles_in_env"] = 15
    env.env.reset()
    present = env.global_tensor_dict["obstacle_position"][..., 2] > -500.0
    assert (present.sum(dim=1) <= 15).all()  # clearance around the start may park some more
    assert (present.sum(dim=1) > 9).all()
    assert env.asset_manager.num_keep_in_env == 9


def test_an_unknown_key_names_the_nearest(env: EnvManager) -> None:
    with pytest.raises(UnknownNameError, match="no tensor key 'robot_positon' .* mean 'robot_position'"):
        env.get_obs()["robot_positon"]
