"""The tables of registered controllers and of control laws of other packages."""

from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING

from aerial_gym.config import CONFIG_DIR, autopilots, family_files, load
from aerial_gym.config.controller import ControllerCfg, LeeGainsCfg, RateLoopCfg
from aerial_gym.config.loader import build, read_yaml
from aerial_gym.registry import Registry
from aerial_gym.registry.plugins import class_converter, instance_converter

if TYPE_CHECKING:
    from aerial_gym.control.controllers import Controller

CONTROLLERS: Registry[ControllerCfg] = Registry("controller")

CONTROL_LAWS: "Registry[Callable[..., Controller]]" = Registry("control law")
"""Laws of other packages by their names in ``ControllerCfg.law``: classes, called like those of ``WITH_MEMORY``."""

CONTROL_LAWS.accept_plugins(control_law=class_converter())

AERIAL_GYM_GAINS = load(LeeGainsCfg, CONFIG_DIR / "controllers" / "lee_gains.yaml")
"""Explicit gains of the Aerial Gym Simulator, one set for every robot: ``replace(controller, gains=AERIAL_GYM_GAINS)``."""

for _name, _law, _summary in (
    ("no_control", "thrust", "thrust of each rotor [N]"),
    ("rotor_speed_control", "rotor_speed", "speed of each rotor [rad/s]"),
    ("lee_position_control", "position", "position [m] and yaw [rad], world"),
    ("lee_velocity_control", "velocity", "velocity [m/s], vehicle frame, and yaw rate [rad/s]"),
    ("lee_acceleration_control", "acceleration", "acceleration [m/s²], world, and yaw rate [rad/s]"),
    ("lee_attitude_control", "attitude", "thrust (0 is hover), roll, pitch [rad], yaw rate [rad/s]"),
    ("lee_rates_control", "rates", "thrust (0 is hover) and body rates [rad/s]"),
    ("lee_velocity_steering_angle_control", "steering", "velocity [m/s], vehicle frame, and yaw [rad]"),
    (
        "fully_actuated_control",
        "pose",
        "position [m] and attitude (xyzw), world, for rotors that push in every direction",
    ),
):
    CONTROLLERS.register(_name, ControllerCfg(summary=_summary, law=_law))

for _law in ("position", "velocity", "acceleration", "attitude", "rates"):
    _cfg = CONTROLLERS.get(f"lee_{_law}_control")
    CONTROLLERS.register(
        f"pid_{_law}_control",
        replace(_cfg, summary=f"{_cfg.summary}; over a rate loop with an integral", rate_loop=RateLoopCfg()),
    )


for _law, _name in (("position", "position"), ("velocity", "velocity"), ("attitude", "attitude"), ("rates", "rate")):
    _cfg = CONTROLLERS.get(f"lee_{_law}_control")
    CONTROLLERS.register(
        f"px4_{_name}_control", replace(_cfg, summary=f"{_cfg.summary}; the cascade of PX4", px4=autopilots.Px4Cfg())
    )

_cfg = CONTROLLERS.get("lee_rates_control")
CONTROLLERS.register(
    "betaflight_rate_control",
    replace(_cfg, summary=f"{_cfg.summary}; the rate loop of Betaflight", betaflight=autopilots.BetaflightCfg()),
)

_cfg = CONTROLLERS.get("lee_position_control")
for _name, _kind, _own in (
    ("mellinger", "Mellinger controller", {"mellinger": autopilots.MellingerCfg()}),
    ("pid", "PID cascade", {"crazyflie_pid": autopilots.CrazyfliePidCfg()}),
    ("lee", "Lee controller with integrals", {"crazyflie_lee": autopilots.CrazyflieLeeCfg()}),
    ("brescianini", "Brescianini controller", {"brescianini": autopilots.BrescianiniCfg()}),
):
    _summary = f"{_cfg.summary}; the {_kind} of the Crazyflie"
    CONTROLLERS.register(f"crazyflie_{_name}_control", replace(_cfg, summary=_summary, **_own))


def _read_gains(robot: str) -> LeeGainsCfg:
    """Read the published gains of a robot from its gains file, else from the robot file."""
    own = CONFIG_DIR / "controllers" / f"{robot}_gains.yaml"
    if own.is_file():
        return load(LeeGainsCfg, own)
    path = family_files("robots")[robot]
    control = read_yaml(path)["control"]
    return build(LeeGainsCfg, control["gains"], where=f"{path}: control: gains")  # type: ignore[index]


def _register_with_gains(name: str, base: str, summary: str, robot: str) -> None:
    """Register a controller with a robot's published gains; the file is read at first use."""
    CONTROLLERS.register_later(
        name, lambda: replace(CONTROLLERS.get(base), summary=summary, gains=_read_gains(robot)), summary=lambda: summary
    )


for _robot in ("lmf2", "magpie", "octarotor"):
    for _law in ("position", "velocity", "acceleration", "attitude", "rates"):
        _base = f"lee_{_law}_control"
        _summary = f"{CONTROLLERS.get(_base).summary}; with the published gains of the {_robot}"
        _register_with_gains(f"{_robot}_{_law}_control", _base, _summary, _robot)

_register_with_gains(
    "rov_fully_actuated_control",
    "fully_actuated_control",
    "position [m] and attitude (xyzw), world; with the published gains of the base_rov",
    "rov",
)


def _controller_of_law(name: str, law: Callable[..., "Controller"]) -> ControllerCfg:
    return ControllerCfg(summary=(law.__doc__ or "").partition("\n")[0], law=name)


CONTROLLERS.accept_plugins(
    controller=instance_converter("aerial_gym.config.controller:ControllerCfg"),
    control_law=_controller_of_law,  # a plug-in's law is flown under its own name
)
