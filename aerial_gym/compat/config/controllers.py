"""Controllers: a class for the law and a flat class of gains as ranges: the middle is used, ``randomize_params`` draws."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

from aerial_gym.compat.config.fields import Changes, ConfigTable, Values, class_only_field, native_field, same_fields
from aerial_gym.config.checks import Vec3
from aerial_gym.config.controller import ControllerCfg, LeeGainsCfg
from aerial_gym.config.randomize import Randomize, RandomizeCfg
from aerial_gym.control.catalog import AERIAL_GYM_GAINS, CONTROLLERS
from aerial_gym.errors import ConfigError

Ends = tuple[Vec3, Vec3]  # Lowest and highest


@dataclass(frozen=True, kw_only=True)
class GainRanges:
    """Gain ranges of a configuration class."""

    gains: Mapping[str, Ends]  # By the names of `LeeGainsCfg`
    max_yaw_rate: float  # [rad/s]
    max_inclination: float  # [rad]
    randomize: bool = False  # Whether a reset draws between the ends; else the middle holds


_GAINS = {
    "position": ("K_pos_tensor", (0.5, 0.5, 0.5)), "velocity": ("K_vel_tensor", (0.5, 0.5, 0.5)),
    "attitude": ("K_rot_tensor", (0.2, 0.2, 0.1)), "rate": ("K_angvel_tensor", (0.05, 0.05, 0.05)),
}  # fmt: skip
"""Name there, and half width of the range around ``AERIAL_GYM_GAINS``. Source: Aerial Gym Simulator 2.0.1,
lee_controller_config."""


def _default_gain_range(name: str) -> Ends:
    pairs = list(zip(getattr(AERIAL_GYM_GAINS, name), _GAINS[name][1], strict=True))
    low, high = (tuple(round(middle + sign * width, 9) for middle, width in pairs) for sign in (-1.0, 1.0))
    return low, high  # pyright: ignore[reportReturnType] - as many as in Vec3


SHARED = GainRanges(
    gains={name: _default_gain_range(name) for name in _GAINS},
    max_yaw_rate=AERIAL_GYM_GAINS.max_yaw_rate,
    max_inclination=AERIAL_GYM_GAINS.max_inclination,
)
"""The one class of gains that all Lee controllers of that simulator share."""


def _gain_changes(script_name: str, native: str) -> Any:
    def changes(values: Values) -> Changes:
        pairs = zip(values[f"{script_name}_min"], values[f"{script_name}_max"], strict=True)
        return {f"gains.{native}": tuple(zip(*(sorted(map(float, pair)) for pair in pairs), strict=True))}

    return changes


TABLE = ConfigTable(
    kind="controller",
    fields=(
        *(
            native_field(f"{script_name}_{there}", f"gains.{native}", lambda c, name=native, end=end: list(c.gains[name][end]),
                    _gain_changes(script_name, native),
                    "the middle, or drawn; a minimum above its maximum, as some of theirs have it, is put in order")
            for native, (script_name, _) in _GAINS.items()
            for end, there in enumerate(("min", "max"))
        ),
        *same_fields("max_yaw_rate"),
        native_field("max_inclination_angle_rad", "max_inclination", lambda c: c.max_inclination, remark="never used there"),
        native_field("randomize_params", "randomize", lambda c: c.randomize,
                remark="draws `gains.position`, `gains.velocity`, `gains.attitude` and `gains.rate` from minimum to maximum"),
        class_only_field("num_actions", "-", lambda _: 4, "follows from the law"),
    ),
)  # fmt: skip
"""Translation of the attributes of a class of gains."""

control = TABLE.make_class("control", SHARED)  # Gains of that simulator's Lee controllers


class _Law:
    """Class of a control law of this package; register laws of your own in this package instead of a subclass."""

    name = ""


LAWS: dict[str, type[_Law]] = {
    cls: type(cls, (_Law,), {"name": name, "__doc__": f"The law of ``{name}``."})
    for cls, name in (
        ("NoControl", "no_control"), ("LeePositionController", "lee_position_control"),
        ("LeeVelocityController", "lee_velocity_control"), ("LeeAttitudeController", "lee_attitude_control"),
        ("LeeRatesController", "lee_rates_control"), ("LeeAccelerationController", "lee_acceleration_control"),
    )
}  # fmt: skip
"""Controller classes of that simulator that have the same law here, by class name."""


def translate_controller(law: Any, config: Any) -> ControllerCfg:
    """Return the translated controller of a controller class and its configuration class."""
    if law not in LAWS.values():
        raise ConfigError(
            f"controller class {getattr(law, '__name__', law)}: its own law cannot be run here. "
            f"Classes that can: {', '.join(LAWS)}; a law of your own is a torch function in aerial_gym.control.laws"
        )
    native, ranges = CONTROLLERS.get(law.name), _gain_ranges(law, config)
    if ranges is None:
        return native
    middle: dict[str, Any] = {
        name: tuple(0.5 * (a + b) for a, b in zip(*ends, strict=True)) for name, ends in ranges.gains.items()
    }
    gains = LeeGainsCfg(
        **middle, max_yaw_rate=ranges.max_yaw_rate, max_inclination=ranges.max_inclination,
        source=f"class {config.__name__}",
    )  # fmt: skip
    return replace(native, gains=gains, if_unstable="warn")  # as it flies there


def gain_randomization(law: Any, config: Any) -> Randomize:
    """Return the random gains of a controller class with its configuration class, by the names of ``randomize:``."""
    ranges = _gain_ranges(law, config)
    drawn = ranges.gains if ranges is not None and ranges.randomize else {}
    return {f"gains.{name}": RandomizeCfg(how="value", low=low, high=high) for name, (low, high) in drawn.items()}


def _gain_ranges(law: Any, config: Any) -> GainRanges | None:
    """Return the gain ranges of a class; None where the robot's own gains apply."""
    if law is LAWS["NoControl"] or (config is control and not control_is_changed()):
        return None
    return TABLE.translate(config, SHARED)


def control_is_changed() -> bool:
    """Return whether a script has changed the class of gains that all controllers of that simulator share."""
    return TABLE.translate(control, SHARED) != SHARED
