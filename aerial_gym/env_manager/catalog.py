"""Every sim that comes with the package, the files of ``config/sims``; firmware that can fly the vehicles."""

from functools import partial

from aerial_gym.config import family_files, load, read_summary
from aerial_gym.config.sim import SimCfg
from aerial_gym.lazy import ImportPath
from aerial_gym.registry import Registry
from aerial_gym.registry.plugins import instance_converter
from aerial_gym.registry.registry import register_files

SIMS: Registry[SimCfg] = Registry("sim")
register_files(SIMS, family_files("sims"), partial(load, SimCfg), summary=read_summary)
SIMS.accept_plugins(sim=instance_converter("aerial_gym.config.sim:SimCfg"))

FIRMWARES = {
    "betaflight": ImportPath("aerial_gym.firmware.betaflight.environment:BetaflightEnv"),
    "crazyflie": ImportPath("aerial_gym.firmware.crazyflie.environment:CrazyflieEnv"),
}
"""Subclasses of ``EnvManager`` whose vehicles are flown by the firmware of an autopilot, imported at first use."""
