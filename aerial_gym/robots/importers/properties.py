"""The element ``properties`` in URDF files of gym-pybullet-drones: rotor type and effects.

``kf`` [N/rpm²] and ``km`` [N m/rpm²] give thrust and torque, ``thrust2weight`` the largest thrust of all rotors per weight.
With speeds w in rad/s and velocities v in body axes that simulator adds:

- a force ``-drag_coeff_xy w v`` across each rotor and ``-drag_coeff_z w v`` along it: ``h_force_flapping``, ``axial_inflow``;
- a gain of thrust of ``gnd_eff_coeff (R / 4h)²`` near the ground, R being ``prop_radius``: ``ground_effect`` in first order;
- below another vehicle a force ``-dw_coeff_1 (R / 4z)² exp(-d² / 2 (dw_coeff_2 z + dw_coeff_3)²)``: ``downwash`` at one z.

Source: Panerati et al. (2021), Learning to fly; gym-pybullet-drones, BaseAviary.py (``_physics``, ``_groundEffect``,
``_drag``, ``_downwash_params``).
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from math import pi
from xml.etree.ElementTree import Element

from aerial_gym.config.robot import RotorCfg
from aerial_gym.config.sim import STANDARD_GRAVITY
from aerial_gym.errors import ConfigError
from aerial_gym.physics.effects import EFFECTS
from aerial_gym.robots.importers.file_vehicle import parse_numbers

BELOW = 1.0  # Distance to the vehicle above at which its downwash is taken [m]: the effect has no law of distance

_PER_RPM = (30.0 / pi) ** 2


@dataclass(frozen=True)
class Properties:
    """Content of the element."""

    rotor: RotorCfg | None = None
    effects: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    source: str = ""
    notes: tuple[str, ...] = ()
    assumed: tuple[str, ...] = ()


def read_properties(root: Element, mass: float, count: int, lag: float | None, where: str) -> Properties:
    """Return rotor type and effects of a URDF with ``count`` rotors and this lag [s]; nothing without thrust and torque."""
    element = root.find("properties")
    if element is None:
        return Properties()
    given = dict(element.attrib)
    if not count or any(given.get(name) is None for name in ("kf", "km", "thrust2weight")):
        return Properties(notes=_unread_properties(given, set()))
    known = {"kf", "km", "thrust2weight", *(name for _, needed, _ in _EFFECTS for name in needed)} & set(given)
    value = {name: parse_numbers(given[name], 1, f"{where}: properties: {name}")[0] for name in known}
    if lag is None:
        raise ConfigError(
            f"{where}: its properties tell thrust and torque of rotors, and no lag. Give one (--lag-s, lag of RotorHints), "
            "measured or that of a similar motor: 0.02 to 0.1 s"
        )
    rotor = RotorCfg(
        thrust_map=(0.0, 0.0, value["kf"] * _PER_RPM),
        torque_ratio=value["km"] / value["kf"],
        time_constant_up=lag,
        time_constant_down=lag,
        thrust_range=(0.0, value["thrust2weight"] * mass * STANDARD_GRAVITY / count),
        radius=value.get("prop_radius"),
        source=f"{where}, properties: kf, km, thrust2weight; lag of {lag:g} s: given when it was imported",
    )
    used, effects, refused = {"kf", "km", "thrust2weight", "prop_radius"}, {}, {}
    for name, needed, rule in _EFFECTS:
        if not all(one in value for one in needed):
            continue
        params = rule(value)
        used.update(needed)
        if problem := _range_problem(name, params):
            refused.setdefault(", ".join(needed), problem)
        elif any(params.values()):
            effects[name] = params
    far = f"downwash at every distance as at {BELOW:g} m below the other vehicle (dw_coeff_1 to dw_coeff_3)"
    source = f"{where}, properties, by the laws of gym-pybullet-drones" if effects else ""
    notes = [f"properties: {names}: {problem}" for names, problem in refused.items()]
    return Properties(
        rotor, effects, source, (*notes, *_unread_properties(given, used)), (far,) if "downwash" in effects else ()
    )


def _unread_properties(given: Mapping[str, str], used: set[str]) -> tuple[str, ...]:
    rest = [name for name in given if name not in used]
    return (f"properties: {', '.join(rest)}",) if rest else ()


def _range_problem(name: str, params: Mapping[str, float]) -> str | None:
    """Return the first parameter of an effect outside its bounds, as text; None if all are within."""
    for parameter in EFFECTS.get(name).parameters:
        value = params[parameter.name]
        if not parameter.low <= value <= parameter.high:
            return (
                f"{name}.{parameter.name} = {value:g}: must be {parameter.low:g} to {parameter.high:g} {parameter.unit}"
            )
    return None


def _downwash_params(value: Mapping[str, float]) -> dict[str, float]:
    near = (value["prop_radius"] / (4.0 * BELOW)) ** 2
    return {"force": value["dw_coeff_1"] * near, "sigma": value["dw_coeff_2"] * BELOW + value["dw_coeff_3"]}


_Rule = Callable[[Mapping[str, float]], dict[str, float]]

_EFFECTS: tuple[tuple[str, tuple[str, ...], _Rule], ...] = (
    ("ground_effect", ("gnd_eff_coeff", "prop_radius"), lambda value: {"k": value["gnd_eff_coeff"]}),
    ("h_force_flapping", ("drag_coeff_xy",), lambda value: {"kh": value["drag_coeff_xy"], "kf": 0.0}),
    ("axial_inflow", ("drag_coeff_z",), lambda value: {"ka": value["drag_coeff_z"]}),
    ("h_force_flapping", ("drag_coeff",), lambda value: {"kh": value["drag_coeff"], "kf": 0.0}),
    ("axial_inflow", ("drag_coeff",), lambda value: {"ka": value["drag_coeff"]}),
    ("downwash", ("dw_coeff_1", "dw_coeff_2", "dw_coeff_3", "prop_radius"), _downwash_params),
)
"""Effects, the attributes that each needs, and its parameters."""
