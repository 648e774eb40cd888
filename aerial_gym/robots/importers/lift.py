"""Weightless masses of a file as upward forces: ``buoyancy``, or ``link_buoyancy`` of vehicles with joints.

A body of mass m with gravity compensation c feels ``c m g`` upwards at its centre of mass. Parallel forces act like their sum
at their weighted centre.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from aerial_gym.config.shape import BASE
from aerial_gym.errors import ConfigError
from aerial_gym.robots.importers.file_vehicle import FileVehicle


@dataclass(frozen=True)
class Lift:
    """Upward forces on a vehicle."""

    force: float = 0.0  # All of them [N]
    effects: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    source: str = ""


def lift_forces(vehicle: FileVehicle, gravity: float) -> Lift:
    """Return the upward forces that cancel the weight of weightless masses; raise ``ConfigError`` for added weight."""
    params: dict[str, float] = {}
    total = 0.0
    for link in dict.fromkeys(part.link for part in vehicle.weightless):
        parts = [part for part in vehicle.weightless if part.link == link and part.mass]
        mass = sum(part.mass for part in parts)
        if not parts:
            continue
        if not mass > 0.0:
            raise ConfigError(
                f"link {link}: its gravity compensation adds {-mass:.3g} kg of weight: must be >= 0 kg in all"
            )
        place = sum((part.mass * part.position for part in parts), np.zeros(3)) / mass
        own = place - _centre(vehicle, link) if vehicle.joints else place
        prefix = f"{link}." if vehicle.joints else ""
        force = mass * gravity
        params |= {
            f"{prefix}{name}": float(value) for name, value in zip(("force", *"xyz"), (force, *own), strict=True)
        }
        total += force
    if not params:
        return Lift()
    kind = "link_buoyancy" if vehicle.joints else "buoyancy"
    return Lift(total, {kind: params}, f"{total / gravity:.6g} kg without weight in the file, at g = {gravity:g} m/s²")


def _centre(vehicle: FileVehicle, link: str) -> np.ndarray:
    """Return the centre of mass of a link of a vehicle with joints [m], (3,)."""
    moving = [(joint.name, joint.link) for joint in vehicle.joints if joint.link is not None]
    if link != BASE:
        return np.array(next(own.com for name, own in moving if name == link))
    rest = vehicle.body.mass - sum(own.mass for _, own in moving)
    moment = vehicle.body.mass * vehicle.body.com - sum(
        (own.mass * np.array(own.com) for _, own in moving), np.zeros(3)
    )
    return moment / rest
