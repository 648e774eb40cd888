"""Physical effects beyond rigid body and rotors, one class each; used by the simulator and by the identification."""

from typing import TYPE_CHECKING

from aerial_gym.lazy import exports

if TYPE_CHECKING:
    from aerial_gym.physics.effects.base import Effect, Parameter, SubstepStart
    from aerial_gym.physics.effects.by_kind import EffectParams, EffectsByKind
    from aerial_gym.physics.effects.catalog import EFFECTS
    from aerial_gym.physics.effects.condition import Condition
    from aerial_gym.physics.effects.kinds import (
        AttitudeSensorEffect,
        CommandEffect,
        DelayEffect,
        FluidEffect,
        ImuEffect,
        LinearWrenchEffect,
        LinkEffect,
        LinkFluidEffect,
        LinkWrenchEffect,
        LoadEffect,
        RotorEffect,
        RotorSensorEffect,
        SuspensionMotion,
        VehicleEffect,
        WindEffect,
        WrenchEffect,
    )
    from aerial_gym.physics.effects.learned_residual import LearnedResidual

__all__ = [
    "EFFECTS", "AttitudeSensorEffect", "CommandEffect", "Condition", "DelayEffect", "Effect", "EffectParams",
    "EffectsByKind", "FluidEffect", "ImuEffect", "LearnedResidual", "LinearWrenchEffect", "LinkEffect",
    "LinkFluidEffect", "LinkWrenchEffect", "LoadEffect", "Parameter", "RotorEffect", "RotorSensorEffect",
    "SubstepStart", "SuspensionMotion", "VehicleEffect", "WindEffect", "WrenchEffect",
]  # fmt: skip

__getattr__, __dir__ = exports(__name__, __file__)
