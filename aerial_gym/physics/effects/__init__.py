"""Physical effects beyond rigid body and rotors, one class each; used by the simulator and by the identification."""

from typing import TYPE_CHECKING

from aerial_gym.lazy import exports

if TYPE_CHECKING:
    from aerial_gym.physics.effects.base import Effect, Parameter, SubstepStart
    from aerial_gym.physics.effects.by_kind import EffectParams, EffectsByKind
    from aerial_gym.physics.effects.catalog import EFFECTS
    from aerial_gym.physics.effects.condition import Condition
    from aerial_gym.physics.effects.kinds.command import CommandEffect, DelayEffect
    from aerial_gym.physics.effects.kinds.fluid import FluidEffect
    from aerial_gym.physics.effects.kinds.link import LinkEffect, LinkFluidEffect, LinkWrenchEffect
    from aerial_gym.physics.effects.kinds.load import LoadEffect, SuspensionMotion
    from aerial_gym.physics.effects.kinds.rotor import RotorEffect
    from aerial_gym.physics.effects.kinds.sensor import ImuEffect, RotorSensorEffect
    from aerial_gym.physics.effects.kinds.vehicle import VehicleEffect
    from aerial_gym.physics.effects.kinds.wind import WindEffect
    from aerial_gym.physics.effects.kinds.wrench import LinearWrenchEffect, WrenchEffect
    from aerial_gym.physics.effects.learned_residual import LearnedResidual

__all__ = [
    "EFFECTS",
    "CommandEffect",
    "Condition",
    "DelayEffect",
    "Effect",
    "EffectParams",
    "EffectsByKind",
    "FluidEffect",
    "ImuEffect",
    "LearnedResidual",
    "LinearWrenchEffect",
    "LinkEffect",
    "LinkFluidEffect",
    "LinkWrenchEffect",
    "LoadEffect",
    "Parameter",
    "RotorEffect",
    "RotorSensorEffect",
    "SubstepStart",
    "SuspensionMotion",
    "VehicleEffect",
    "WindEffect",
    "WrenchEffect",
]

__getattr__, __dir__ = exports(__name__, __file__)
