"""Controllers: a class for the law and a flat class of gains as ranges; the middle is used unless ``randomize_params``."""

from dataclasses import replace
from typing import Any

from aerial_gym.compat.config.fields import Changes, Table, Values, carried, kept
from aerial_gym.config.controller import ControllerCfg
from aerial_gym.control.catalog import AERIAL_GYM_GAINS, CONTROLLERS
from aerial_gym.errors import ConfigError

_GAINS = (
    ("K_pos_tensor", "position_gain"),
    ("K_vel_tensor", "velocity_gain"),
    ("K_rot_tensor", "attitude_gain"),
    ("K_angvel_tensor", "rate_gain"),
)


def _gain(theirs: str, ours: str) -> Any:
    def write(values: Values) -> Changes:
        pairs = [
            sorted(map(float, pair)) for pair in zip(values[f"{theirs}_min"], values[f"{theirs}_max"], strict=True)
        ]
        return {f"{ours}_low": tuple(low for low, _ in pairs), f"{ours}_high": tuple(high for _, high in pairs)}

    return write


TABLE = Table(
    kind="controller",
    fields=(
        *(
            carried(f"{theirs}_{there}", f"{ours}_{here}", lambda c, name=f"{ours}_{here}": list(getattr(c, name)),
                    _gain(theirs, ours), "a minimum above its maximum, as some of theirs have it, is put in order")
            for theirs, ours in _GAINS
            for there, here in (("min", "low"), ("max", "high"))
        ),
        carried("max_yaw_rate", "max_yaw_rate", lambda c: c.max_yaw_rate),
        carried("max_inclination_angle_rad", "max_inclination", lambda c: c.max_inclination, remark="never used there"),
        carried("randomize_params", "randomize", lambda c: c.randomize),
        kept("num_actions", "-", lambda _: 4, "follows from the law"),
    ),
    idle_sections={},
)  # fmt: skip
"""What becomes of the attributes of a class of gains."""

control = TABLE.class_of("control", AERIAL_GYM_GAINS)
"""Gains of that simulator's Lee controllers."""


class _Law:
    """Stands for the law of one of our controllers; not to be derived: a law of your own is registered in this package."""

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


def controller_of(law: Any, config: Any) -> ControllerCfg:
    """Return our controller for a controller class and its configuration class.

    Raises:
        ConfigError: If the class has a law of its own.
    """
    if law not in LAWS.values():
        raise ConfigError(
            f"controller class {getattr(law, '__name__', law)}: its own law cannot be run here. "
            f"Classes that can: {', '.join(LAWS)}; a law of your own is a torch function in aerial_gym.control.laws"
        )
    ours = CONTROLLERS.get(law.name)
    if law is LAWS["NoControl"] or (config is control and not control_is_changed()):
        return ours
    return replace(ours, gains=replace(TABLE.translate(config, AERIAL_GYM_GAINS), source=f"class {config.__name__}"))


def control_is_changed() -> bool:
    """Return whether a script has changed the class of gains that all controllers of that simulator share."""
    return TABLE.translate(control, AERIAL_GYM_GAINS) != AERIAL_GYM_GAINS
