"""The motor model of Gazebo in SDF files, and in URDF files that are meant for Gazebo.

Thrust is ``motorConstant w²`` along z of the rotor's link, at its centre of mass, whichever way the axis of its joint points.
The drag torque is ``momentConstant`` times the thrust, against ``turningDirection`` about the same z. The speed lags by
``timeConstantUp`` or ``timeConstantDown``. Sideways flow of velocity v gives ``-rotorDragCoefficient w v``.

Source: gz-sim, MulticopterMotorModel.cc, with its defaults; RotorS (Furrer et al., 2016), gazebo_motor_model.cpp, from which
that plugin and PX4's come.
"""

import itertools
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from xml.etree import ElementTree

from aerial_gym.config.robot import RotorCfg
from aerial_gym.errors import ConfigError
from aerial_gym.robots.importers.file_vehicle import Tags, group_lines_by_kind, parse_number

SPINS = {"ccw": 1, "cw": -1}  # Of `turningDirection`, about z of the link

DEFAULTS = {
    "motorConstant": 8.54858e-06, "momentConstant": 0.016, "maxRotVelocity": 838.0, "timeConstantUp": 1.0 / 80.0,
    "timeConstantDown": 1.0 / 40.0, "rotorDragCoefficient": 1e-4, "rollingMomentCoefficient": 1e-6,
}  # fmt: skip
"""Default values of the plugin."""

_NAMES = ("jointName", "linkName", "motorNumber", "turningDirection", "motorType")

MOTOR_TAGS: Tags = {name: {} for name in (*_NAMES, *DEFAULTS)}  # Elements of a motor plugin that are read

AERODYNAMICS = {
    "liftdrag": "wings or blades", "fwdynamics": "wings", "fixedwing": "wings", "underwaterobject": "water",
    "thruster": "thruster", "lighterthanair": "envelope of a blimp", "hydrodynamics": "water", "buoyancy": "buoyancy",
}  # fmt: skip
"""Plugins without a counterpart by a part of their names, with the source of their forces."""


@dataclass(frozen=True, kw_only=True)
class Motor:
    """One motor plugin; its link and joint by their scoped names."""

    link: str
    joint: str
    number: int
    spin: int
    rotor: RotorCfg
    silent: tuple[str, ...]  # Names of `DEFAULTS` for which the plugin's own value is taken
    sideways_drag: float  # [N s²/(m rad)]
    rolling_moment: float  # [N s²/rad]


def is_motor(plugin: ElementTree.Element) -> bool:
    """Return whether a plugin is a motor model."""
    return "motor_model" in plugin.get("filename", "").replace("-", "_") or "MulticopterMotorModel" in plugin.get(
        "name", ""
    )


def force_source_to_omit(plugin: ElementTree.Element) -> str | None:
    """Return the source of a plugin's force that the import leaves out, None for other plugins."""
    name = f"{plugin.get('name', '')} {plugin.get('filename', '')}".lower().replace("_", "").replace("-", "")
    kind = next((hint for part, hint in AERODYNAMICS.items() if part in name), None)
    at = next(filter(None, map(plugin.findtext, ("link_name", "linkName", "joint_name"))), None)
    return None if kind is None else f"{kind} (plugin {plugin.get('name')}, {(at or 'no link named').strip()})"


def read_motors(plugins: Iterable[tuple[str, ElementTree.Element]], where: str) -> list[Motor]:
    """Return the motors among plugins, each with the scope of its names, in the order of numbers and commands."""
    motors = [_read_motor(plugin, scope, where) for scope, plugin in plugins if is_motor(plugin)]
    ordered = sorted(motors, key=lambda motor: motor.number)
    for one, other in itertools.pairwise(ordered):
        if one.number == other.number:
            raise ConfigError(
                f"{where}: motors of links {one.link!r} and {other.link!r} have the same motorNumber {one.number}"
            )
    return ordered


def _read_motor(plugin: ElementTree.Element, scope: str, where: str) -> Motor:
    link = scope + (plugin.findtext("linkName") or "").strip()
    at = f"{where}: motor of link {link!r}"
    kind = (plugin.findtext("motorType") or "velocity").strip()
    turning = (plugin.findtext("turningDirection") or "").strip()
    if kind != "velocity" or turning not in SPINS:
        raise ConfigError(
            f"{at}: motorType {kind!r}, turningDirection {turning!r}: only motors whose speed is commanded (velocity) and that "
            "turn one way (ccw or cw) can be imported. Write the robot file by hand (docs/concepts/rotors.md)"
        )
    order = parse_number(plugin.findtext("motorNumber"), 0.0, f"{at}: motorNumber")
    if not order.is_integer():
        raise ConfigError(f"{at}: motorNumber = {order:g}: must be a whole number")
    value = {name: parse_number(plugin.findtext(name), default, f"{at}: {name}") for name, default in DEFAULTS.items()}
    silent = [name for name in DEFAULTS if not (plugin.findtext(name) or "").strip()]
    rotor = RotorCfg(
        thrust_map=(0.0, 0.0, value["motorConstant"]),
        torque_ratio=value["momentConstant"],
        time_constant_up=value["timeConstantUp"],
        time_constant_down=value["timeConstantDown"],
        thrust_range=(0.0, value["motorConstant"] * value["maxRotVelocity"] ** 2),
        source=f"{where}: motorConstant, momentConstant, timeConstantUp, timeConstantDown, maxRotVelocity "
        f"{value['maxRotVelocity']:g} rad/s",
    )
    return Motor(
        link=link, joint=scope + (plugin.findtext("jointName") or "").strip(), number=int(order), spin=SPINS[turning],
        rotor=rotor, silent=tuple(silent), sideways_drag=value["rotorDragCoefficient"],
        rolling_moment=value["rollingMomentCoefficient"],
    )  # fmt: skip


def motor_assumptions(motors: Sequence[Motor]) -> Iterator[str]:
    """Yield the numbers that are the plugin's own."""
    pairs = ((name, m.link) for m in motors for name in m.silent if name != "rollingMomentCoefficient")  # is left out
    yield from group_lines_by_kind((f"{name} = {DEFAULTS[name]:g}, the plugin's own", link) for name, link in pairs)


def sideways_drag_effect(motors: Sequence[Motor]) -> dict[str, dict[str, float]]:
    """Return the effect of sideways flow on rotors, if all have the same coefficient."""
    drags = {motor.sideways_drag for motor in motors}
    if len(drags) != 1 or drags == {0.0}:
        return {}
    return {"h_force_flapping": {"kh": drags.pop(), "kf": 0.0}}


def motor_notes(motors: Sequence[Motor]) -> Iterator[str]:
    """Yield the unused coefficients of motors."""
    if any(motor.rolling_moment for motor in motors):
        yield "rollingMomentCoefficient, a torque along the sideways flow: no effect has that law"
    if len({motor.sideways_drag for motor in motors}) > 1:
        yield "rotorDragCoefficient: it differs between rotors, and h_force_flapping has one for all"
