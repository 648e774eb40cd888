"""Bits for quantities of an environment that are NaN or infinite; a row with any bit ends in that step.

Letters: E environments.
"""

from enum import IntFlag


class NonFinite(IntFlag):
    """Quantities that were NaN or infinite in a step; they are bits of ``gtd["non_finite"]``, int32 (E,)."""

    ACTION = 1  # Action. The physics may clamp it and continue.
    STATE = 2  # Position, attitude, velocities or rotor speeds after the physics
    REWARD = 4  # Reward of the task
    OBSERVATION = 8  # Observation term of the task

    def names(self) -> str:
        """Return the quantities in words."""
        return " and ".join(str(flag.name).lower() for flag in NonFinite if flag in self)
