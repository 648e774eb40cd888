"""Training with proximal policy optimisation of our own."""

import logging

from aerial_gym.rl_training.learning.fused import FusedPpo, prepare, why_not_fused
from aerial_gym.rl_training.learning.network import make_network
from aerial_gym.rl_training.learning.ppo import Ppo
from aerial_gym.rl_training.ranks import ALONE, Ranks
from aerial_gym.rl_training.settings import PpoCfg, TrainingCfg
from aerial_gym.rl_training.trainers.own import OwnTraining
from aerial_gym.task import Task

__all__ = ["make_training", "prepare"]

_log = logging.getLogger(__name__)


def make_training(cfg: TrainingCfg, task: Task, *, fused: bool = True, ranks: Ranks = ALONE) -> OwnTraining[Ppo]:
    """Return a new training; its networks in kernels of their own where that can be, and unless not ``fused``.

    Raises:
        ConfigError: If the task does not have what the networks are to see.
    """
    network = make_network(cfg, task)
    reason = why_not_fused(cfg.section(PpoCfg), network, task.device) if fused else "asked for"
    if reason is not None and task.device.type == "cuda":
        _log.info("the networks run as torch operations: %s", reason)
    return OwnTraining(cfg, task, (FusedPpo if reason is None else Ppo)(cfg, task, network, ranks))
