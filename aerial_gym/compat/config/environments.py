"""Environments: ``class env`` with bounds and steps, ``class env_config`` with the classes of its obstacles."""

from typing import Any

from aerial_gym.assets import ENVIRONMENTS
from aerial_gym.compat.config.assets import asset_class, translate_asset
from aerial_gym.compat.config.fields import (
    Changes,
    ConfigTable,
    Values,
    class_only_field,
    idle_field,
    native_field,
    replace_config_entries,
    unchangeable_field,
)
from aerial_gym.config.environment import EnvironmentCfg


def _asset_changes(values: Values) -> Changes:
    included, classes = values["env_config.include_asset_type"], values["env_config.asset_type_to_dict_map"]
    assets = (translate_asset(name, cls) for name, cls in classes.items() if included.get(name, False))
    return {"assets": tuple(asset for asset in assets if asset is not None)}


_DEAD = "read nowhere there either"

TABLE = ConfigTable(
    kind="environment",
    fields=(
        class_only_field("env.num_envs", "build_env(num_envs=...)", lambda _: 64, "the number where build_env is given none"),
        native_field("env.num_physics_steps_per_env_step_mean", "physics_steps_per_env_step",
                lambda c: c.physics_steps_per_env_step,
                lambda v: {"physics_steps_per_env_step": int(v["env.num_physics_steps_per_env_step_mean"])}),
        unchangeable_field("env.num_physics_steps_per_env_step_std", 0,
                "must be 0 here: there one number was drawn for all environments, and could be none. A delay is the effect "
                "actuation_delay of the robot"),
        class_only_field("env.reset_on_collision", "which rows post_reward_calculation_step resets", lambda _: True),
        native_field("env.create_ground_plane", "ground_height", lambda c: c.ground_height is not None,
                lambda v: {"ground_height": 0.0 if v["env.create_ground_plane"] else None}, "at z = 0"),
        *(native_field(f"env.{script_name}", native, lambda c, native=native: list(getattr(c, native)))
          for script_name, native in (
            ("lower_bound_min", "bounds_lower_low"), ("lower_bound_max", "bounds_lower_high"),
            ("upper_bound_min", "bounds_upper_low"), ("upper_bound_max", "bounds_upper_high"),
        )),
        native_field("env_config.include_asset_type", "assets", lambda c: {a.name: True for a in c.assets}, _asset_changes),
        native_field("env_config.asset_type_to_dict_map", "assets", lambda c: {a.name: asset_class(a) for a in c.assets},
                _asset_changes, "classes of obstacles, see assets"),
        idle_field("env.collision_force_threshold", 0.01,
             "every touch is a crash; with `contact:` of an environment file, crash_speed says which"),
        idle_field("env.num_env_actions", 4, "obstacles that move take (E, A, 6) twists"),
        idle_field("env.write_to_sim_at_every_timestep", False, "states are written where they are"),
        idle_field("env.render_viewer_every_n_steps", 1, "there is no viewer window"),
        idle_field("env.use_warp", True, "sensors always are Warp's"),
        *(idle_field(f"env.{name}", value, _DEAD) for name, value in (
            ("env_spacing", 5.0), ("sample_timestep_for_latency", False), ("perturb_observations", False),
            ("keep_same_env_for_num_episodes", 1), ("manual_camera_trigger", False),
        )),
    ),
)  # fmt: skip
"""Translation of the attributes of an environment class."""


def translate_environment(cls: Any) -> EnvironmentCfg:
    """Return the translated environment of an environment class. Asset classes are changed in place by scripts, so they are
    read at every call."""
    cfg = TABLE.translate(cls, ENVIRONMENTS.get("empty_env"))
    given = TABLE.values(cls)
    classes = given.get("env_config.asset_type_to_dict_map")
    if classes is None:
        return cfg
    return replace_config_entries(
        cfg, _asset_changes({"env_config.include_asset_type": dict.fromkeys(classes, True)} | given)
    )


def num_envs_and_crash_reset(cls: Any) -> tuple[int, bool]:
    """Return the number of environments of an environment class, and whether a crash resets."""
    given = TABLE.values(cls)
    return int(given.get("env.num_envs", 64)), bool(given.get("env.reset_on_collision", True))


EmptyEnvCfg = TABLE.make_class("EmptyEnvCfg", ENVIRONMENTS.get("empty_env"))

CLASSES: dict[str, type] = {"empty_env": EmptyEnvCfg} | {
    env: TABLE.make_class(name, ENVIRONMENTS.get(env))
    for name, env in (
        ("EnvCfg2Ms", "empty_env_2ms"), ("EnvWithObstaclesCfg", "env_with_obstacles"),
        ("EnvWithLidarNavObstaclesCfg", "env_with_lidar_nav_obstacles"), ("ForestEnvCfg", "forest_env"),
        ("DynamicEnvironmentCfg", "dynamic_env"),
    )
}  # fmt: skip
"""Classes by the names under which that simulator registers them."""
