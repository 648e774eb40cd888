"""Training with analytic policy gradients."""

import logging
from typing import TYPE_CHECKING

from aerial_gym.rl_training.learner_settings import ApgCfg
from aerial_gym.rl_training.settings import TrainingCfg
from aerial_gym.rl_training.trainers.trainer import NativeTrainer

if TYPE_CHECKING:
    from aerial_gym.rl_training.learning.apg import Apg
    from aerial_gym.rl_training.ranks import Ranks
    from aerial_gym.rl_training.trainers.native import NativeTraining
    from aerial_gym.task import Task

_log = logging.getLogger(__name__)


class ApgTrainer(NativeTrainer):
    """Analytic policy gradients of this package."""

    name = "apg"
    summary = "analytic policy gradients through the simulation, with a short-horizon critic"
    section, settings = "apg", ApgCfg
    differentiable = True

    def make_training(self, cfg: TrainingCfg, task: "Task", ranks: "Ranks | None" = None) -> "NativeTraining[Apg]":
        """Return a new training; warn if the task has a variant with a reward whose slope does not vanish."""
        from aerial_gym.rl_training.learning.apg import Apg
        from aerial_gym.rl_training.policies.load import make_network
        from aerial_gym.rl_training.trainers.native import NativeTraining
        from aerial_gym.task import task_registry

        del ranks
        smooth = f"smooth_{cfg.task}"
        if smooth in task_registry.names():
            _log.warning(
                "trainer apg: the reward of %s is flat far from its target. Train with task %s", cfg.task, smooth
            )
        return NativeTraining(cfg, task, Apg(cfg, task, make_network(cfg, task)))
