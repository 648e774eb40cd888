"""Every environment that comes with the package, in one table."""

from aerial_gym.config import CONFIG_DIR
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
):
    ENVIRONMENTS.register(_name, load_environment(CONFIG_DIR / "environments" / f"{_name}.yaml"))
