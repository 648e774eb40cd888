"""Every term that comes with the package: the registries, with all modules that fill them."""

from aerial_gym.task.terms import heading
from aerial_gym.task.terms.observations import OBSERVATIONS
from aerial_gym.task.terms.rewards import REWARDS
from aerial_gym.task.terms.term import term_from_function
from aerial_gym.task.terms.terminations import TERMINATIONS

__all__ = ["OBSERVATIONS", "REWARDS", "TERMINATIONS", "heading"]

OBSERVATIONS.accept_plugins(observation=term_from_function)
REWARDS.accept_plugins(reward=term_from_function)
TERMINATIONS.accept_plugins(termination=term_from_function)
