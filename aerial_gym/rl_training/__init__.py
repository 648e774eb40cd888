"""Learning: adapters to Gymnasium, rl-games and Sample Factory, training runs, policies and their evaluation."""

from aerial_gym.rl_training.evaluate import Evaluation, evaluate
from aerial_gym.rl_training.gymnasium import GymnasiumVectorEnv
from aerial_gym.rl_training.policies.load import load_policy
from aerial_gym.rl_training.policies.policy import Policy
from aerial_gym.rl_training.settings import ApgCfg, PpoCfg, TrainingCfg, load_settings, settings_for
from aerial_gym.rl_training.training import TrainingResult, train

__all__ = [
    "ApgCfg",
    "Evaluation",
    "GymnasiumVectorEnv",
    "Policy",
    "PpoCfg",
    "TrainingCfg",
    "TrainingResult",
    "evaluate",
    "load_policy",
    "load_settings",
    "settings_for",
    "train",
]
