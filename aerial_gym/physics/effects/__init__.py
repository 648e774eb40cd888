"""Physical effects beyond rigid body and rotors, one file each; used by the simulator and by the identification."""

from typing import TYPE_CHECKING

from aerial_gym.lazy import exports

if TYPE_CHECKING:
    from aerial_gym.physics.effects.base import (
        CommandEffect,
        Condition,
        DelayEffect,
        Effect,
        FluidEffect,
        ImuEffect,
        LinearWrenchEffect,
        LoadEffect,
        Moment,
        Parameter,
        RotorEffect,
        RotorSensorEffect,
        Suspension,
        VehicleEffect,
        WindEffect,
        WrenchEffect,
    )
    from aerial_gym.physics.effects.by_kind import STEP_KINDS, EffectParams, EffectsByKind
    from aerial_gym.physics.effects.catalog import EFFECTS
    from aerial_gym.physics.effects.learned_residual import LearnedResidual
    from aerial_gym.physics.effects.on_links import LinkEffect, LinkFluidEffect, LinkWrenchEffect

__all__ = [
    "EFFECTS",
    "STEP_KINDS",
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
    "Moment",
    "Parameter",
    "RotorEffect",
    "RotorSensorEffect",
    "Suspension",
    "VehicleEffect",
    "WindEffect",
    "WrenchEffect",
]

__getattr__, __dir__ = exports(__name__, __file__)
