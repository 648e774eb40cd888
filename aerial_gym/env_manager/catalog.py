"""Every sim that comes with the package, in one table."""

from functools import partial

from aerial_gym.config import CONFIG_DIR, load
from aerial_gym.config.sim import SimCfg
from aerial_gym.registry import Registry

SIMS: Registry[SimCfg] = Registry("sim")

for _name in ("base_sim", "base_sim_headless", "base_sim_2ms", "base_sim_4ms"):
    SIMS.register_later(_name, partial(load, SimCfg, CONFIG_DIR / "sims" / f"{_name}.yaml"))
