"""Every term that comes with the package: the registries, with all modules that fill them."""

from aerial_gym.task.terms import heading
from aerial_gym.task.terms.observations import OBSERVATIONS
from aerial_gym.task.terms.rewards import REWARDS
from aerial_gym.task.terms.terminations import TERMINATIONS

__all__ = ["OBSERVATIONS", "REWARDS", "TERMINATIONS", "heading"]
