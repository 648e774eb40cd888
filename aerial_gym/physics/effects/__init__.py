"""Physical effects beyond rigid body and rotors, one file each; used by the simulator and by the identification."""

from aerial_gym.physics.effects.base import (
    Condition,
    Effect,
    ImuEffect,
    Parameter,
    RotorEffect,
    RotorSensorEffect,
    VehicleEffect,
    WindEffect,
    WrenchEffect,
)
from aerial_gym.physics.effects.catalog import EFFECTS

__all__ = [
    "EFFECTS",
    "Condition",
    "Effect",
    "ImuEffect",
    "Parameter",
    "RotorEffect",
    "RotorSensorEffect",
    "VehicleEffect",
    "WindEffect",
    "WrenchEffect",
]
