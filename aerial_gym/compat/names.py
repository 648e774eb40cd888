"""Methods of the Aerial Gym Simulator and ours side by side."""

from dataclasses import dataclass


@dataclass(frozen=True)
class MethodName:
    """A name of that simulator with its counterpart in this package."""

    script_name: str  # Name in scripts
    native: str  # Counterpart in this package
    remark: str = ""  # Differences and corrected defects


METHODS: tuple[MethodName, ...] = (
    MethodName(
        "sim_builder:SimBuilder.build_env",
        "SimBuilder().build_env(sim_name=..., ...)",
        "args, use_warp and headless are taken and mean nothing; the seed is that of torch.manual_seed unless seed= is given",
    ),
    MethodName("sim_builder:SimBuilder.delete_env", "env.close()"),
    MethodName(
        "env_manager:EnvManager.step",
        "env.step(actions, env_actions)",
        "as many physics steps as the environment says; there the number could be drawn, and be 0",
    ),
    MethodName(
        "env_manager:EnvManager.reset", "env.reset()", "no second placement with half the obstacles in 15 % of the rows"
    ),
    MethodName("env_manager:EnvManager.reset_idx", "env.reset(mask)", "ids become a mask; other rows stay bit for bit"),
    MethodName(
        "env_manager:EnvManager.reset_terminated_and_truncated_envs",
        'env.reset(gtd["crashes"] | gtd["truncations"])',
        "ids cost a wait for the GPU, a mask none",
    ),
    MethodName(
        "env_manager:EnvManager.post_reward_calculation_step",
        'env.reset(gtd["crashes"] | gtd["truncations"]); env.render()',
        "images belong to the new episodes, as there",
    ),
    MethodName(
        "env_manager:EnvManager.render",
        "env.render()",
        "an unknown component is an error, where there nothing happened",
    ),
    MethodName("env_manager:EnvManager.get_obs", "env.gtd"),
    MethodName("env_manager:EnvManager.delete_env", "env.close()", "called by the tasks there, where it did not exist"),
    MethodName("env_manager:EnvManager.sim_steps", 'gtd["sim_steps"]', "int32 (E,)"),
    MethodName("env_manager:RobotManager.reset_idx", "env.robot_manager.reset(mask)"),
    MethodName(
        "env_manager:Physics.write_to_sim",
        'gtd["robot_position"][:] = ...',
        "takes rows that a script wrote into robot_state_tensor",
    ),
    MethodName(
        "registries:SimConfigRegistry.register",
        "SIMS.register(name, SimCfg(...))",
        "another class under a registered name is refused",
    ),
    MethodName("registries:SimConfigRegistry.get_sim_config", "SIMS.get(name)"),
    MethodName("registries:SimConfigRegistry.get_sim_names", "SIMS.names()"),
    MethodName("registries:SimConfigRegistry.make_sim", "SIMS.get(name)", "builds nothing, as there"),
    MethodName("registries:EnvConfigRegistry.register", "ENVIRONMENTS.register(name, cfg), or a file as env_name"),
    MethodName("registries:EnvConfigRegistry.get_env_config", "ENVIRONMENTS.get(name)"),
    MethodName("registries:EnvConfigRegistry.get_env_names", "ENVIRONMENTS.names()"),
    MethodName("registries:EnvConfigRegistry.make_env", "ENVIRONMENTS.get(name)", "builds nothing, as there"),
    MethodName(
        "registries:RobotRegistry.register",
        "ROBOTS.register(name, cfg), or a file as robot_name",
        "the class is BaseMultirotor",
    ),
    MethodName("registries:RobotRegistry.get_robot_class", "-", "robots have no code of their own"),
    MethodName("registries:RobotRegistry.get_robot_config", "ROBOTS.get(name)"),
    MethodName("registries:RobotRegistry.get_robot_names", "ROBOTS.names()"),
    MethodName(
        "registries:RobotRegistry.make_robot",
        "SimBuilder().build_env",
        "refused: a robot is built with its environment",
    ),
    MethodName(
        "registries:ControllerRegistry.register_controller",
        "CONTROLLERS.register(name, ControllerCfg(...))",
        "laws of ours with gains",
    ),
    MethodName("registries:ControllerRegistry.get_controller_class", "CONTROLLERS.get(name).law"),
    MethodName("registries:ControllerRegistry.get_controller_config", "CONTROLLERS.get(name)"),
    MethodName("registries:ControllerRegistry.get_controller_names", "CONTROLLERS.names()"),
    MethodName(
        "registries:ControllerRegistry.make_controller", "SimBuilder().build_env", "refused: it is built with its robot"
    ),
    MethodName("registries:TaskRegistry.register_task", "task_registry.register(name, TaskCfg(...))"),
    MethodName("registries:TaskRegistry.get_task_class", "aerial_gym.Task", "one class runs every task file"),
    MethodName("registries:TaskRegistry.get_task_config", "task_registry.get(name)"),
    MethodName("registries:TaskRegistry.get_task_names", "task_registry.names()"),
    MethodName("registries:TaskRegistry.get_task_classes", "-"),
    MethodName("registries:TaskRegistry.get_task_configs", "-"),
    MethodName(
        "registries:TaskRegistry.make_task",
        "task_registry.make_task(name, ...)",
        "takes device= too; the class gets a configuration of its own, where there all tasks wrote into one",
    ),
    MethodName(
        "native_task:NativeTask.reset",
        "obs, info = task.reset()",
        "five things, as there; it does reset, also for navigation",
    ),
    MethodName(
        "native_task:NativeTask.step",
        "task.step(actions)",
        "infos has final_observation and time_outs; an episode has exactly episode_len_steps steps",
    ),
    MethodName("native_task:NativeTask.reset_idx", "-", "refused: step resets what is done"),
    MethodName("native_task:NativeTask.render", "env.render()", "shows nothing"),
    MethodName("native_task:NativeTask.close", "task.close()", "works"),
    MethodName(
        "base_task:BaseTask.seed",
        "make_task(seed=...)",
        "seeds Python, NumPy and torch, because such tasks draw from them",
    ),
    MethodName("base_task:BaseTask.close", "task.close()"),
)
"""Methods that scripts call: the place below ``aerial_gym.compat``, and ours."""
