"""Every environment that comes with the package, in one table."""

from functools import partial

from aerial_gym.config import CONFIG_DIR, summary_in
from aerial_gym.config.environment import EnvironmentCfg, load_environment
from aerial_gym.registry import Registry

ENVIRONMENTS: Registry[EnvironmentCfg] = Registry("environment")

for _name in (
    "empty_env",
    "empty_env_2ms",
    "env_with_obstacles",
    "env_with_lidar_nav_obstacles",
    "forest_env",
    "dynamic_env",
    "landing_env",
    "landing_platform_env",
    "racing_env",
    "racing_split_s_env",
    "racing_random_track_env",
):
    _path = CONFIG_DIR / "environments" / f"{_name}.yaml"
    ENVIRONMENTS.register_later(_name, partial(load_environment, _path), summary=partial(summary_in, _path))
