"""Training with analytic policy gradients."""

import logging

from aerial_gym.rl_training.learning.apg import Apg
from aerial_gym.rl_training.learning.network import make_network
from aerial_gym.rl_training.settings import TrainingCfg
from aerial_gym.rl_training.trainers.own import OwnTraining
from aerial_gym.task import Task, task_registry

_log = logging.getLogger(__name__)


def make_training(cfg: TrainingCfg, task: Task) -> OwnTraining[Apg]:
    """Return a new training; warn of a task whose reward is known to have no slope where the robot comes to.

    Raises:
        CapabilityError: If the task has no gradients.
        ConfigError: If it does not have what the networks are to see.
    """
    smooth = f"smooth_{cfg.task}"
    if smooth in task_registry.names():
        _log.warning("trainer apg: the reward of %s is flat far from its target. Train with task %s", cfg.task, smooth)
    return OwnTraining(cfg, task, Apg(cfg, task, make_network(cfg, task)))
