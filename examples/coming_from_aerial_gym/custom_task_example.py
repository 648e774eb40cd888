"""A task, a robot and a world of a user's own in the manner of the Aerial Gym Simulator, and a loop of random actions in it."""

import isaacgym
import numpy as np
import torch
from gymnasium.spaces import Box, Dict
from isaacgym import gymtorch

from aerial_gym.config.asset_config.env_object_config import panel_asset_params
from aerial_gym.config.env_config.env_with_obstacles import EnvWithObstaclesCfg
from aerial_gym.config.robot_config.base_quad_config import BaseQuadCfg
from aerial_gym.registry.env_registry import env_config_registry
from aerial_gym.registry.robot_registry import robot_registry
from aerial_gym.registry.task_registry import task_registry
from aerial_gym.robots.base_multirotor import BaseMultirotor
from aerial_gym.sim.sim_builder import SimBuilder
from aerial_gym.task.base_task import BaseTask
from aerial_gym.utils.helpers import get_args
from aerial_gym.utils.logging import CustomLogger
from aerial_gym.utils.math import quat_rotate_inverse, torch_interpolate_ratio, torch_rand_float_tensor

logger = CustomLogger("gate_task")


class two_panels(panel_asset_params):
    num_assets = 2
    min_state_ratio = [0.4, 0.1, 0.5, 0, 0, -np.pi / 6, 1.0, 0, 0, 0, 0, 0, 0]
    max_state_ratio = [0.6, 0.9, 0.5, 0, 0, np.pi / 6, 1.0, 0, 0, 0, 0, 0, 0]


class PanelHallCfg:
    class env(EnvWithObstaclesCfg.env):
        num_envs = 32
        num_physics_steps_per_env_step_mean = 5
        lower_bound_min = [-3.0, -2.0, 0.0]
        lower_bound_max = [-3.0, -2.0, 0.0]
        upper_bound_min = [3.0, 2.0, 3.0]
        upper_bound_max = [3.0, 2.0, 3.0]

    class env_config:
        include_asset_type = {"panels": True, "objects": False}
        asset_type_to_dict_map = {"panels": two_panels}


class NimbleQuadCfg(BaseQuadCfg):
    class init_config(BaseQuadCfg.init_config):
        min_init_state = [0.05, 0.4, 0.4, 0, 0, 0, 1.0, 0, 0, 0, 0, 0, 0]
        max_init_state = [0.10, 0.6, 0.6, 0, 0, 0, 1.0, 0, 0, 0, 0, 0, 0]

    class control_allocator_config(BaseQuadCfg.control_allocator_config):
        class motor_model_config(BaseQuadCfg.control_allocator_config.motor_model_config):
            motor_time_constant_increasing_min = 0.02
            motor_time_constant_increasing_max = 0.02


class task_config:
    seed = 10
    sim_name = "base_sim"
    env_name = "panel_hall"
    robot_name = "nimble_quad"
    controller_name = "lee_velocity_control"
    args = {}
    num_envs = 32
    use_warp = True
    headless = True
    device = "cuda:0"
    observation_space_dim = 10
    privileged_observation_space_dim = 0
    action_space_dim = 4
    episode_len_steps = 60
    return_state_before_reset = False
    reward_parameters = {"distance": 1.0, "collision": -10.0}
    target_min_ratio = [0.9, 0.4, 0.4]
    target_max_ratio = [0.95, 0.6, 0.6]

    def action_transformation_function(action):
        return torch.clamp(action, -1.0, 1.0) * torch.tensor([2.0, 2.0, 1.0, 0.5], device=action.device)


class PanelTask(BaseTask):
    def __init__(self, task_config, seed=None, num_envs=None, headless=None, device=None, use_warp=None):
        for name, value in (("seed", seed), ("num_envs", num_envs), ("headless", headless), ("device", device)):
            if value is not None:
                setattr(task_config, name, value)
        super().__init__(task_config)
        self.device = task_config.device
        for key, value in task_config.reward_parameters.items():
            task_config.reward_parameters[key] = torch.tensor(value, device=self.device)
        self.sim_env = SimBuilder().build_env(
            sim_name=task_config.sim_name,
            env_name=task_config.env_name,
            robot_name=task_config.robot_name,
            controller_name=task_config.controller_name,
            args=task_config.args,
            device=self.device,
            num_envs=task_config.num_envs,
            use_warp=task_config.use_warp,
            headless=task_config.headless,
        )
        self.num_envs = self.sim_env.num_envs
        self.obs_dict = self.sim_env.get_obs()
        self.obs_dict["num_obstacles_in_env"] = 2
        self.terminations, self.truncations = self.obs_dict["crashes"], self.obs_dict["truncations"]
        self.rewards = torch.zeros(self.num_envs, device=self.device)
        self.target_position = torch.zeros((self.num_envs, 3), device=self.device)
        ratios = (task_config.target_min_ratio, task_config.target_max_ratio)
        self.target_ratios = [torch.tensor(ratio, device=self.device).expand(self.num_envs, 3) for ratio in ratios]
        self.observation_space = Dict({"observations": Box(-np.inf, np.inf, (task_config.observation_space_dim,))})
        self.action_space = Box(-1.0, 1.0, (task_config.action_space_dim,))
        self.task_obs = {
            "observations": torch.zeros((self.num_envs, task_config.observation_space_dim), device=self.device)
        }
        self.infos = {}

    def reset(self):
        self.sim_env.reset()
        self.reset_idx(torch.arange(self.num_envs, device=self.device))
        return self.get_return_tuple()

    def reset_idx(self, env_ids):
        drawn = torch_rand_float_tensor(*self.target_ratios)
        low, high = self.obs_dict["env_bounds_min"], self.obs_dict["env_bounds_max"]
        self.target_position[env_ids] = torch_interpolate_ratio(low, high, drawn)[env_ids]

    def step(self, actions):
        self.sim_env.step(actions=self.task_config.action_transformation_function(actions))
        self.rewards[:], self.terminations[:] = self.compute_rewards_and_crashes()
        self.truncations[:] = self.sim_env.sim_steps > self.task_config.episode_len_steps
        reset_envs = self.sim_env.post_reward_calculation_step()
        if len(reset_envs) > 0:
            self.reset_idx(reset_envs)
        return self.get_return_tuple()

    def compute_rewards_and_crashes(self):
        distance = (self.target_position - self.obs_dict["robot_position"]).norm(dim=1)
        outside = (self.obs_dict["robot_position"] < self.obs_dict["env_bounds_min"]).any(dim=1)
        crashes = self.obs_dict["crashes"] | outside
        parameters = self.task_config.reward_parameters
        return torch.where(crashes, parameters["collision"], -parameters["distance"] * distance), crashes

    def get_return_tuple(self):
        obs, tensors = self.task_obs["observations"], self.obs_dict
        attitude = tensors["robot_vehicle_orientation"]
        obs[:, 0:3] = quat_rotate_inverse(attitude, self.target_position - tensors["robot_position"])
        obs[:, 3] = tensors["robot_euler_angles"][:, 2]
        obs[:, 4:7] = tensors["robot_body_linvel"]
        obs[:, 7:10] = tensors["robot_body_angvel"]
        return self.task_obs, self.rewards, self.terminations, self.truncations, self.infos

    def render(self):
        return None


if __name__ == "__main__":
    args = get_args([{"name": "--num_steps", "type": int, "default": 200, "help": "steps of the task"}])
    env_config_registry.register("panel_hall", PanelHallCfg)
    robot_registry.register("nimble_quad", BaseMultirotor, NimbleQuadCfg)
    task_registry.register_task("panel_task", PanelTask, task_config)
    task_config.device = args.sim_device
    task = task_registry.make_task("panel_task", num_envs=args.num_envs, headless=args.headless)
    task.reset()
    ended = {"terminations": 0, "truncations": 0}
    for _ in range(args.num_steps):
        obs, rewards, terminations, truncations, infos = task.step(
            2.0 * torch.rand((task.num_envs, 4), device=args.sim_device) - 1.0
        )
        ended["terminations"] += terminations.sum().item()
        ended["truncations"] += truncations.sum().item()
    logger.warning(f"{args.num_steps} steps of {task.num_envs} environments: {ended}")
    task.close()
