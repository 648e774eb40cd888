"""Every environment that comes with the package: the files of ``config/environments``."""

from functools import partial

from aerial_gym.config import family_files, read_summary
from aerial_gym.config.environment import EnvironmentCfg, load_environment
from aerial_gym.registry import Registry

ENVIRONMENTS: Registry[EnvironmentCfg] = Registry("environment")

for _name, _path in family_files("environments").items():
    ENVIRONMENTS.register_later(_name, partial(load_environment, _path), summary=partial(read_summary, _path))
