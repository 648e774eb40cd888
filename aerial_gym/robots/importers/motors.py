"""The motor model of Gazebo in SDF files, and in URDF files that are meant for Gazebo.

Thrust is ``motorConstant w²`` along the axis of the joint, drag torque ``momentConstant`` times the thrust against the turning.
The speed lags by ``timeConstantUp`` or ``timeConstantDown``. Sideways flow of velocity v gives ``-rotorDragCoefficient w v``.

Source: RotorS (Furrer et al., 2016), gazebo_motor_model.cpp, whose plugin PX4's models and Gazebo's own follow.
"""

import itertools
from collections.abc import Iterator
from dataclasses import dataclass
from xml.etree import ElementTree

from aerial_gym.config.robot import RotorCfg
from aerial_gym.errors import ConfigError

SPINS = {"ccw": 1, "cw": -1}
"""Of ``turningDirection``, about the axis."""


@dataclass(frozen=True, kw_only=True)
class Motor:
    """One motor plugin."""

    link: str
    joint: str
    number: int
    spin: int
    rotor: RotorCfg
    sideways_drag: float
    """[N s²/(m rad)]."""

    rolling_moment: float
    """[N s²/rad]."""


def motors_in(root: ElementTree.Element, where: str) -> list[Motor]:
    """Return the motors of a file in the order of their numbers, which is that of commands.

    Raises:
        ConfigError: If one lacks a number, turns in no known direction, or is not a plain speed-controlled one.
    """
    found = sorted((_motor(plugin, where) for plugin in _plugins(root)), key=lambda motor: motor.number)
    for one, other in itertools.pairwise(found):
        if one.number == other.number:
            raise ConfigError(
                f"{where}: motors of links {one.link!r} and {other.link!r} have the same motorNumber {one.number}"
            )
    return found


def _plugins(root: ElementTree.Element) -> Iterator[ElementTree.Element]:
    for plugin in root.iter("plugin"):
        if "motor_model" in plugin.get("filename", "") or "MulticopterMotorModel" in plugin.get("name", ""):
            yield plugin


def _motor(plugin: ElementTree.Element, where: str) -> Motor:
    link = (plugin.findtext("linkName") or "").strip()
    at = f"{where}: motor of link {link!r}"

    def number(name: str, default: float | None = None) -> float:
        text = plugin.findtext(name)
        if text is None and default is not None:
            return default
        try:
            return float(text or "")
        except ValueError:
            raise ConfigError(f"{at}: {name} = {text!r}: must be a number") from None

    kind = (plugin.findtext("motorType") or "velocity").strip()
    turning = (plugin.findtext("turningDirection") or "").strip()
    if kind != "velocity" or turning not in SPINS:
        raise ConfigError(
            f"{at}: motorType {kind!r}, turningDirection {turning!r}: only motors whose speed is commanded (velocity) and that "
            "turn one way (ccw or cw) can be imported. Write the robot file by hand (docs/rotors.md)"
        )
    constant, fastest = number("motorConstant"), number("maxRotVelocity")
    rotor = RotorCfg(
        thrust_map=(0.0, 0.0, constant),
        torque_ratio=number("momentConstant"),
        time_constant_up=number("timeConstantUp"),
        time_constant_down=number("timeConstantDown"),
        thrust_range=(0.0, constant * fastest**2),
        source=f"{where}: motorConstant, momentConstant, timeConstantUp, timeConstantDown, maxRotVelocity {fastest:g} rad/s",
    )
    return Motor(
        link=link,
        joint=(plugin.findtext("jointName") or "").strip(),
        number=int(number("motorNumber", 0.0)),
        spin=SPINS[turning],
        rotor=rotor,
        sideways_drag=number("rotorDragCoefficient", 0.0),
        rolling_moment=number("rollingMomentCoefficient", 0.0),
    )


def sideways_effects(motors: list[Motor]) -> dict[str, dict[str, float]]:
    """Return the effect of sideways flow on rotors, if all have the same coefficient."""
    drags = {motor.sideways_drag for motor in motors}
    if len(drags) != 1 or drags == {0.0}:
        return {}
    return {"h_force_flapping": {"kh": drags.pop(), "kf": 0.0}}


def notes_on(motors: list[Motor]) -> Iterator[str]:
    """Yield what of the motors is not taken over."""
    if any(motor.rolling_moment for motor in motors):
        yield "rollingMomentCoefficient, a torque along the sideways flow, is left out: no effect has that law"
    if len({motor.sideways_drag for motor in motors}) > 1:
        yield "rotorDragCoefficient is left out: it differs between rotors, and h_force_flapping has one for all"
