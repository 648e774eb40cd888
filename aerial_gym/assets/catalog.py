"""Every environment that comes with the package: the files of ``config/environments``."""

from aerial_gym.config import family_files, read_summary
from aerial_gym.config.environment import EnvironmentCfg, load_environment
from aerial_gym.registry import Registry
from aerial_gym.registry.plugins import instance_converter
from aerial_gym.registry.registry import register_files

ENVIRONMENTS: Registry[EnvironmentCfg] = Registry("environment")
register_files(ENVIRONMENTS, family_files("environments"), load_environment, summary=read_summary)
ENVIRONMENTS.accept_plugins(environment=instance_converter("aerial_gym.config.environment:EnvironmentCfg"))
