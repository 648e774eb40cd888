"""Every sim that comes with the package: the files of ``config/sims``."""

from functools import partial

from aerial_gym.config import family_files, load
from aerial_gym.config.sim import SimCfg
from aerial_gym.registry import Registry

SIMS: Registry[SimCfg] = Registry("sim")

for _name, _path in family_files("sims").items():
    SIMS.register_later(_name, partial(load, SimCfg, _path))
