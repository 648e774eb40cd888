"""Names of the Aerial Gym Simulator beside ours, from the tables by which ``aerial_gym.compat`` works."""

from aerial_gym.compat.config import assets, controllers, environments, imus, robots, sensors, sims, tasks
from aerial_gym.compat.config.fields import ConfigTable
from aerial_gym.compat.modules import GONE, MODULES
from aerial_gym.compat.tensors import KEYS
from docs.generate.markdown import table

TABLES: tuple[tuple[str, ConfigTable], ...] = (
    ("Sims", sims.TABLE),
    ("Environments", environments.TABLE),
    ("Obstacles", assets.TABLE),
    ("Robots", robots.TABLE),
    ("Cameras", sensors.CAMERA),
    ("Lidars", sensors.LIDAR),
    ("IMUs", imus.TABLE),
    ("Gains of controllers", controllers.TABLE),
    ("Tasks of this package", tasks.TABLE),
)
"""Every table of configuration classes."""

METHODS: dict[str, dict[str, tuple[str, str]]] = {
    "sim_builder:SimBuilder": {
        "build_env": (
            "SimBuilder().build_env(sim_name=..., ...)",
            "args, use_warp and headless are taken and mean nothing; "
            "the seed is that of torch.manual_seed unless seed= is given",
        ),
        "delete_env": ("env.close()", ""),
    },
    "env_manager:EnvManager": {
        "step": (
            "env.step(actions, env_actions)",
            "as many physics steps as the environment says; there the number could be drawn, and be 0",
        ),
        "reset": ("env.reset()", "no second placement with half the obstacles in 15 % of the rows"),
        "reset_idx": ("env.reset(mask)", "ids become a mask; other rows stay bit for bit"),
        "reset_terminated_and_truncated_envs": (
            'env.reset(gtd["crashes"] | gtd["truncations"])',
            "ids cost a wait for the GPU, a mask none",
        ),
        "post_reward_calculation_step": (
            'env.reset(gtd["crashes"] | gtd["truncations"]); env.render()',
            "images belong to the new episodes, as there",
        ),
        "render": ("env.render()", "an unknown component is an error, where there nothing happened"),
        "get_obs": ("env.gtd", ""),
        "delete_env": ("env.close()", "called by the tasks there, where it did not exist"),
        "sim_steps": ('gtd["sim_steps"]', "int32 (E,)"),
    },
    "env_manager:RobotManager": {
        "reset_idx": ("env.robot_manager.reset(mask)", ""),
    },
    "env_manager:Physics": {
        "write_to_sim": ('gtd["robot_position"][:] = ...', "takes rows that a script wrote into robot_state_tensor"),
    },
    "vae:VAEImageEncoder": {
        "encode": (
            "load_encoder(file)(images)",
            "files of aerial-gym train-encoder; weights of that simulator are not here",
        ),
        "decode": ("-", "refused: encoder files have no decoder"),
        "get_latent_dims_size": ("encoder.num_latents", ""),
    },
    "registries:SimConfigRegistry": {
        "register": ("SIMS.register(name, SimCfg(...))", "another class under a registered name is refused"),
        "get_sim_config": ("SIMS.get(name)", ""),
        "get_sim_names": ("SIMS.names()", ""),
        "make_sim": ("SIMS.get(name)", "builds nothing, as there"),
    },
    "registries:EnvConfigRegistry": {
        "register": ("ENVIRONMENTS.register(name, cfg), or a file as env_name", ""),
        "get_env_config": ("ENVIRONMENTS.get(name)", ""),
        "get_env_names": ("ENVIRONMENTS.names()", ""),
        "make_env": ("ENVIRONMENTS.get(name)", "builds nothing, as there"),
    },
    "registries:RobotRegistry": {
        "register": ("ROBOTS.register(name, cfg), or a file as robot_name", "the class is BaseMultirotor"),
        "get_robot_class": ("-", "robots have no code of their own"),
        "get_robot_config": ("ROBOTS.get(name)", ""),
        "get_robot_names": ("ROBOTS.names()", ""),
        "make_robot": ("SimBuilder().build_env", "refused: a robot is built with its environment"),
    },
    "registries:ControllerRegistry": {
        "register_controller": ("CONTROLLERS.register(name, ControllerCfg(...))", "laws of ours with gains"),
        "get_controller_class": ("CONTROLLERS.get(name).law", ""),
        "get_controller_config": ("CONTROLLERS.get(name)", ""),
        "get_controller_names": ("CONTROLLERS.names()", ""),
        "make_controller": ("SimBuilder().build_env", "refused: it is built with its robot"),
    },
    "registries:TaskRegistry": {
        "register_task": ("task_registry.register(name, TaskCfg(...))", ""),
        "get_task_class": ("aerial_gym.Task", "one class runs every task file"),
        "get_task_config": ("task_registry.get(name)", ""),
        "get_task_names": ("task_registry.names()", ""),
        "get_task_classes": ("-", ""),
        "get_task_configs": ("-", ""),
        "make_task": (
            "task_registry.make_task(name, ...)",
            "takes device= too; the class gets a configuration of its own, where there all tasks wrote into one",
        ),
    },
    "native_task:NativeTask": {
        "reset": ("obs, info = task.reset()", "five things, as there; it does reset, also for navigation"),
        "step": (
            "task.step(actions)",
            "infos has final_observation and time_outs; an episode has exactly episode_len_steps steps",
        ),
        "reset_idx": ("-", "refused: step resets what is done"),
        "render": ("env.render()", "shows nothing"),
        "close": ("task.close()", "works"),
    },
    "native_task:BaseTask": {
        "seed": ("make_task(seed=...)", "seeds Python, NumPy and torch, because such tasks draw from them"),
        "close": ("task.close()", ""),
    },
}
"""Methods that scripts call, by their class below ``aerial_gym.compat``: each with ours, and a remark."""

REGISTRY_NOTE = (
    "All sims, environments, robots, controllers and tasks of that simulator are registered here under their names "
    "(`aerial-gym list`), `base_sim_headless` among them."
)


def table_of_names() -> str:
    """Return all names side by side, in Markdown."""
    methods = (
        (f"`{place.partition(':')[2]}.{name}`", _code(native), remark)
        for place, methods in METHODS.items()
        for name, (native, remark) in methods.items()
    )
    keys = ((f"`{name}`", _code(key.native), key.remark) for name, key in KEYS.items())
    modules = (
        (f"`aerial_gym.{path}`", ", ".join(f"`{n}`" for n in names if n) or "-") for path, names in MODULES.items()
    )
    gone = ((f"`aerial_gym.{path}`", remedy) for path, remedy in GONE.items())
    parts = [
        "## Methods", table(("there", "here", "remark"), methods),
        "## Tensor keys", table(("key there", "here", "remark"), keys),
        "## Registered names", REGISTRY_NOTE,
        "## Module paths", table(("module", "names"), modules),
        "Without a counterpart; importing one says so:", table(("module", "way out"), gone),
        "## Configuration classes",
    ]  # fmt: skip
    for title, fields in TABLES:
        parts += [f"**{title}**", _table_of_fields(fields)]
    return "\n\n".join(parts)


def _table_of_fields(fields: ConfigTable) -> str:
    rows = [
        (f"`{f.script_name}`", _code(f.native), f"other values are refused: {f.remark}" if f.refused else f.remark)
        for f in fields.fields
    ]
    rows += [(f"`{section}.*`", "-", reason) for section, reason in fields.idle_sections.items()]
    return table(("attribute", "here", "remark"), rows)


def _code(text: str) -> str:
    return text if text in ("-", "the same") else f"`{text}`"
