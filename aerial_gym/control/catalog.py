"""Every controller that comes with the package, in one table."""

from aerial_gym.config import CONFIG_DIR, load
from aerial_gym.config.controller import ControllerCfg, LeeGainsCfg
from aerial_gym.registry import Registry

CONTROLLERS: Registry[ControllerCfg] = Registry("controller")

_LEE = load(LeeGainsCfg, CONFIG_DIR / "controllers" / "lee_gains.yaml")

for _name, _law, _gains, _summary in (
    ("no_control", "thrust", None, "thrust of each rotor [N]"),
    ("rotor_speed_control", "rotor_speed", None, "speed of each rotor [rad/s]"),
    ("lee_position_control", "position", _LEE, "position [m] and yaw [rad], world"),
    ("lee_velocity_control", "velocity", _LEE, "velocity [m/s], vehicle frame, and yaw rate [rad/s]"),
    ("lee_acceleration_control", "acceleration", _LEE, "acceleration [m/s²], world, and yaw rate [rad/s]"),
    ("lee_attitude_control", "attitude", _LEE, "thrust (0 is hover), roll, pitch [rad], yaw rate [rad/s]"),
    ("lee_rates_control", "rates", _LEE, "thrust (0 is hover) and body rates [rad/s]"),
):
    CONTROLLERS.register(_name, ControllerCfg(summary=_summary, law=_law, gains=_gains))
