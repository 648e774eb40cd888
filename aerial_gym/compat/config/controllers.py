"""Controllers: a class for the law and a flat class of gains as ranges: the middle is used, ``randomize_params`` draws."""

from dataclasses import dataclass, replace
from typing import Any

from aerial_gym.compat.config.fields import Changes, ConfigTable, Values, direct_field, lookup_field, same_fields
from aerial_gym.config.checks import Vec3
from aerial_gym.config.controller import ControllerCfg, LeeGainsCfg
from aerial_gym.config.randomize import Randomize, RandomizeCfg
from aerial_gym.control.catalog import AERIAL_GYM_GAINS, CONTROLLERS
from aerial_gym.control.gains import GAINS
from aerial_gym.errors import ConfigError

Ends = tuple[Vec3, Vec3]  # Lowest and highest


@dataclass(frozen=True, kw_only=True)
class GainRanges:
    """Gain ranges of a configuration class."""

    position: Ends  # [1/s²]
    velocity: Ends  # [1/s]
    attitude: Ends  # [N m/rad]
    rate: Ends  # [N m s/rad]
    max_yaw_rate: float  # [rad/s]
    max_inclination: float  # [rad]
    randomize: bool = False  # Whether a reset draws between the ends; else the middle holds

    def middle_gains(self, source: str) -> LeeGainsCfg:
        """Return the middle of each range."""
        return LeeGainsCfg(
            **{name: tuple(0.5 * (a + b) for a, b in zip(*getattr(self, name), strict=True)) for name in GAINS},
            max_yaw_rate=self.max_yaw_rate,
            max_inclination=self.max_inclination,
            source=source,
        )

    def randomization(self) -> Randomize:
        """Return the random gains, by the names of ``randomize:``."""
        if not self.randomize:
            return {}
        ends = {name: getattr(self, name) for name in GAINS}
        return {f"gains.{name}": RandomizeCfg(how="value", low=low, high=high) for name, (low, high) in ends.items()}


_HALF_WIDTH: dict[str, Vec3] = {
    "position": (0.5, 0.5, 0.5),
    "velocity": (0.5, 0.5, 0.5),
    "attitude": (0.2, 0.2, 0.1),
    "rate": (0.05, 0.05, 0.05),
}
"""Of the ranges around ``AERIAL_GYM_GAINS``. Source: Aerial Gym Simulator 2.0.1, lee_controller_config."""


def _gain_range(name: str) -> Ends:
    pairs = list(zip(getattr(AERIAL_GYM_GAINS, name), _HALF_WIDTH[name], strict=True))
    low, high = (tuple(round(middle + sign * width, 9) for middle, width in pairs) for sign in (-1.0, 1.0))
    return low, high  # pyright: ignore[reportReturnType] - as many as in Vec3


SHARED = GainRanges(
    position=_gain_range("position"), velocity=_gain_range("velocity"), attitude=_gain_range("attitude"),
    rate=_gain_range("rate"),
    max_yaw_rate=AERIAL_GYM_GAINS.max_yaw_rate,
    max_inclination=AERIAL_GYM_GAINS.max_inclination,
)  # fmt: skip
"""The one class of gains that all Lee controllers of that simulator share."""

_NAMES = (
    ("K_pos_tensor", "position"),
    ("K_vel_tensor", "velocity"),
    ("K_rot_tensor", "attitude"),
    ("K_angvel_tensor", "rate"),
)


def _gain_writer(script_name: str, native: str) -> Any:
    def write(values: Values) -> Changes:
        pairs = zip(values[f"{script_name}_min"], values[f"{script_name}_max"], strict=True)
        return {native: tuple(zip(*(sorted(map(float, pair)) for pair in pairs), strict=True))}

    return write


TABLE = ConfigTable(
    kind="controller",
    fields=(
        *(
            direct_field(f"{script_name}_{there}", f"gains.{native}",
                         lambda c, name=native, end=end: list(getattr(c, name)[end]),
                    _gain_writer(script_name, native),
                    "the middle, or drawn; a minimum above its maximum, as some of theirs have it, is put in order")
            for script_name, native in _NAMES
            for end, there in enumerate(("min", "max"))
        ),
        *same_fields("max_yaw_rate"),
        direct_field("max_inclination_angle_rad", "max_inclination", lambda c: c.max_inclination, remark="never used there"),
        direct_field("randomize_params", "randomize", lambda c: c.randomize,
                remark="draws `gains.position`, `gains.velocity`, `gains.attitude` and `gains.rate` from minimum to maximum"),
        lookup_field("num_actions", "-", lambda _: 4, "follows from the law"),
    ),
    idle_sections={},
)  # fmt: skip
"""Translation of the attributes of a class of gains."""

control = TABLE.make_class("control", SHARED)  # Gains of that simulator's Lee controllers


class _Law:
    """Class of a control law of this package; register laws of your own in this package instead of a subclass."""

    name = ""


LAWS: dict[str, type[_Law]] = {
    cls: type(cls, (_Law,), {"name": name, "__doc__": f"The law of ``{name}``."})
    for cls, name in (
        ("NoControl", "no_control"),
        ("LeePositionController", "lee_position_control"),
        ("LeeVelocityController", "lee_velocity_control"),
        ("LeeAttitudeController", "lee_attitude_control"),
        ("LeeRatesController", "lee_rates_control"),
        ("LeeAccelerationController", "lee_acceleration_control"),
    )
}
"""Controller classes of that simulator that have the same law here, by class name."""


def translate_controller(law: Any, config: Any) -> ControllerCfg:
    """Return the translated controller of a controller class and its configuration class."""
    if law not in LAWS.values():
        raise ConfigError(
            f"controller class {getattr(law, '__name__', law)}: its own law cannot be run here. "
            f"Classes that can: {', '.join(LAWS)}; a law of your own is a torch function in aerial_gym.control.laws"
        )
    native = CONTROLLERS.get(law.name)
    ranges = _gain_ranges(law, config)
    if ranges is None:
        return native
    return replace(
        native, gains=ranges.middle_gains(f"class {config.__name__}"), if_unstable="warn"
    )  # as it flies there


def gain_randomization(law: Any, config: Any) -> Randomize:
    """Return the random gains of a controller class with its configuration class."""
    ranges = _gain_ranges(law, config)
    return {} if ranges is None else ranges.randomization()


def _gain_ranges(law: Any, config: Any) -> GainRanges | None:
    """Return the gain ranges of a class; None where the robot's own gains apply."""
    if law is LAWS["NoControl"] or (config is control and not control_is_changed()):
        return None
    return TABLE.translate(config, SHARED)


def control_is_changed() -> bool:
    """Return whether a script has changed the class of gains that all controllers of that simulator share."""
    return TABLE.translate(control, SHARED) != SHARED
