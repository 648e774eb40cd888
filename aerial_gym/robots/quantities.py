"""Vehicle quantities that can be randomised, by name, and the effect of a draw; torch functions shared by all backends.

Letters: E environments, R rotors.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Literal

import torch
from torch import Tensor

from aerial_gym.config.randomize import RandomizeCfg
from aerial_gym.physics import Vehicle

BATTERY = ("nominal_voltage", "full_voltage", "empty_voltage", "internal_resistance", "capacity", "efficiency")
"""Columns of ``Vehicle.battery``."""


def apply_draw(cfg: RandomizeCfg, declared: Tensor, draw: Tensor) -> Tensor:
    """Return a quantity from its declared value and its draw."""
    if cfg.how == "value":
        return draw + torch.zeros_like(declared)
    return declared * draw if cfg.how == "scale" else declared + draw


def scale_second_moments(inertia: Tensor, factor: Tensor) -> Tensor:
    """Return an inertia (E, 3, 3) with factors (E, 3) on the mass's second moments along the body axes.

    ``S = tr(J)/2 1 - J`` is the integral of ``x x^T dm``; stretched to ``D S D`` with ``D = diag(sqrt(factor))`` it is that of
    another body, so that the moments of ``J = tr(S) 1 - S`` keep the triangle inequality. The same factor on all axes
    is a factor on J.
    """
    stretch = factor.sqrt()
    trace = inertia.diagonal(dim1=1, dim2=2).sum(-1)[:, None, None]
    unit = torch.eye(3, dtype=inertia.dtype, device=inertia.device)
    moments = stretch.unsqueeze(-1) * (0.5 * trace * unit - inertia) * stretch.unsqueeze(-2)
    return moments.diagonal(dim1=1, dim2=2).sum(-1)[:, None, None] * unit - moments


Width = Literal["one", "vector", "rotor", "rotor_vector"]


@dataclass(frozen=True)
class Quantity:
    """A quantity of the vehicle."""

    unit: str  # SI unit
    width: Width  # One number, three components, a number for each rotor, or three components for each rotor
    apply: Callable[[Vehicle, RandomizeCfg, Tensor], Vehicle]  # Adds a draw: (E,), (E, 3), (E, R) or (E, R, 3)
    meaning: str  # One line
    declared: str | None = None  # Field of `Vehicle` with the declared value; None for factors
    how: tuple[str, ...] = ("scale", "offset", "value")  # Allowed draws of the quantity


def _set_mass(vehicle: Vehicle, cfg: RandomizeCfg, draw: Tensor) -> Vehicle:
    mass = apply_draw(cfg, vehicle.mass, draw)
    if cfg.keep_inertia:
        return replace(vehicle, mass=mass)
    return replace(vehicle, mass=mass, inertia=vehicle.inertia * (mass / vehicle.mass)[:, None, None])


def _scale_inertia(vehicle: Vehicle, cfg: RandomizeCfg, draw: Tensor) -> Vehicle:
    return replace(vehicle, inertia=scale_second_moments(vehicle.inertia, draw))


def _set_fields(names: tuple[str, ...], vehicle: Vehicle, cfg: RandomizeCfg, draw: Tensor) -> Vehicle:
    drawn: dict[int, Tensor] = {}
    for declared in (getattr(vehicle, name) for name in names):  # one tensor for all names stays one
        if id(declared) not in drawn:
            drawn[id(declared)] = apply_draw(cfg, declared, draw)
    return replace(vehicle, **{name: drawn[id(getattr(vehicle, name))] for name in names})


def _scale_maps(maps: tuple[str, ...], vehicle: Vehicle, cfg: RandomizeCfg, draw: Tensor) -> Vehicle:
    return vehicle.with_scaled_maps(**dict.fromkeys(maps, draw))


def _offset_axes(vehicle: Vehicle, cfg: RandomizeCfg, draw: Tensor) -> Vehicle:
    axis = apply_draw(cfg, vehicle.rotor_axis, draw)
    return replace(vehicle, rotor_axis=axis / axis.norm(dim=-1, keepdim=True))


def _set_battery(column: int, vehicle: Vehicle, cfg: RandomizeCfg, draw: Tensor) -> Vehicle:
    columns = list(vehicle.battery.unbind(-1))
    columns[column] = apply_draw(cfg, columns[column], draw)
    return replace(vehicle, battery=torch.stack(columns, dim=-1))


def _set_charge(vehicle: Vehicle, cfg: RandomizeCfg, draw: Tensor) -> Vehicle:
    """Begin on the line from full to empty at a share c of the charge: ``E0' = E1 + c (E0 - E1)``, ``Q' = c Q``."""
    nominal, full, empty, resistance, capacity, efficiency = vehicle.battery.unbind(-1)
    columns = (nominal, empty + draw * (full - empty), empty, resistance, draw * capacity, efficiency)
    return replace(vehicle, battery=torch.stack(columns, dim=-1))


def _quantity_of_fields(unit: str, width: Width, meaning: str, *fields: str) -> Quantity:
    return Quantity(unit, width, partial(_set_fields, fields), meaning, fields[0])


_set_maps, _set_torque_map = partial(_scale_maps, ("thrust", "torque")), partial(_scale_maps, ("torque",))
_both_lags = ("time_constant_up", "time_constant_down")

QUANTITIES: dict[str, Quantity] = {
    "body.mass": Quantity("kg", "one", _set_mass, "mass; the inertia grows with it (keep_inertia)", "mass"),
    "body.com": _quantity_of_fields("m", "vector", "centre of mass from the body origin, body", "com"),
    "body.inertia": Quantity(
        "-", "vector", _scale_inertia, "factors on the mass's second moments along the body axes: stays that of a body",
        how=("scale",),
    ),
    "rotor.thrust_map": Quantity("-", "rotor", _set_maps, "thrust and drag torque of a speed", how=("scale",)),
    "rotor.torque_map": Quantity("-", "rotor", _set_torque_map, "drag torque of a speed alone", how=("scale",)),
    "rotor.time_constant": _quantity_of_fields("s", "rotor", "lag, rising and falling", *_both_lags),
    "rotor.time_constant_up": _quantity_of_fields("s", "rotor", "lag of a speed that grows", "time_constant_up"),
    "rotor.time_constant_down": _quantity_of_fields("s", "rotor", "lag of a speed that falls", "time_constant_down"),
    "rotor.slew_rate": _quantity_of_fields(
        "rad/s² or N/s", "rotor", "largest rates of the rotor's state", "slew_rate", "slew_rate_down"
    ),
    "rotor.dead_band": _quantity_of_fields("rad/s or N", "rotor", "commands that stop the rotor", "dead_band"),
    "rotor.radius": _quantity_of_fields("m", "rotor", "radius of the propeller", "rotor_radius"),
    "mounts.*.position": _quantity_of_fields("m", "rotor_vector", "hubs from the body origin, body", "rotor_position"),
    "mounts.*.axis": Quantity(
        "-", "rotor_vector", _offset_axes, "directions of thrust, made unit length", "rotor_axis", how=("offset",)
    ),
    **{
        f"battery.{name}": Quantity("see BatteryCfg", "one", partial(_set_battery, column), f"{name} of the battery")
        for column, name in enumerate(BATTERY)
    },
    "battery.charge": Quantity(
        "-", "one", _set_charge, "share of the charge with which an episode begins", how=("value",)
    ),
}  # fmt: skip
"""Quantities of every vehicle; those of effects, gains and sensors depend on the robot."""


def quantity_table() -> str:
    """Return all names that ``randomize:`` knows as a table in Markdown; those of effects by effect."""
    from aerial_gym.physics import EFFECTS

    widths = {"one": "1", "vector": "3", "rotor": "1 or R", "rotor_vector": "3 or R x 3"}
    rows = ["| name | unit | numbers | how | what is drawn |", "| --- | --- | --- | --- | --- |"]
    for name, each in QUANTITIES.items():
        rows.append(f"| `{name}` | {each.unit} | {widths[each.width]} | {', '.join(each.how)} | {each.meaning} |")
    for name in EFFECTS.names():
        for each in EFFECTS.get(name).parameters:
            how = "value, integer" if each.kind == "rotor" else "scale, offset, value"
            rows.append(f"| `effects.{name}.{each.name}` | {each.unit} | 1 | {how} | {each.meaning} |")
    return "\n".join(rows)
