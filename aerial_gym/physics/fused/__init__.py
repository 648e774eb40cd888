"""The fused backend: control, rotors, effects and integration of all substeps in one Warp launch."""

from aerial_gym.physics.fused.law import FusedLaw

__all__ = ["FusedLaw"]
