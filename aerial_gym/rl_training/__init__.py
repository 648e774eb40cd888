"""Learning: adapters to Gymnasium, rl-games and Sample Factory, training runs, policies and their evaluation."""

from typing import TYPE_CHECKING

from aerial_gym.lazy import exports

if TYPE_CHECKING:
    from aerial_gym.rl_training.evaluation import Evaluation, evaluate
    from aerial_gym.rl_training.gymnasium import GymnasiumEnv, GymnasiumVectorEnv
    from aerial_gym.rl_training.learner_settings import ApgCfg, PpoCfg
    from aerial_gym.rl_training.policies.load import load_policy
    from aerial_gym.rl_training.policies.policy import Policy
    from aerial_gym.rl_training.policies.save import save_policy
    from aerial_gym.rl_training.settings import TrainingCfg, load_settings, settings_for
    from aerial_gym.rl_training.trainers.catalog import TRAINERS
    from aerial_gym.rl_training.trainers.trainer import Trainer
    from aerial_gym.rl_training.training import TrainingResult, train

__all__ = [
    "TRAINERS", "ApgCfg", "Evaluation", "GymnasiumEnv", "GymnasiumVectorEnv", "Policy", "PpoCfg", "Trainer", "TrainingCfg",
    "TrainingResult", "evaluate", "load_policy", "load_settings", "save_policy", "settings_for", "train",
]  # fmt: skip

__getattr__, __dir__ = exports(__name__, __file__)
