"""Training with analytic policy gradients."""

from aerial_gym.rl_training.learning.apg import Apg
from aerial_gym.rl_training.learning.network import make_network
from aerial_gym.rl_training.settings import TrainingCfg
from aerial_gym.rl_training.trainers.own import OwnTraining
from aerial_gym.task import Task


def make_training(cfg: TrainingCfg, task: Task) -> OwnTraining[Apg]:
    """Return a new training.

    Raises:
        CapabilityError: If the task has no gradients.
        ConfigError: If it does not have what the networks are to see.
    """
    return OwnTraining(cfg, task, Apg(cfg, task, make_network(cfg, task)))
