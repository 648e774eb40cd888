"""Training a student that imitates a trained policy."""

from typing import TYPE_CHECKING

from aerial_gym.errors import ConfigError
from aerial_gym.rl_training.learner_settings import DistillCfg
from aerial_gym.rl_training.settings import TrainingCfg
from aerial_gym.rl_training.trainers.trainer import NativeTrainer

if TYPE_CHECKING:
    from aerial_gym.rl_training.learning.distill import Distill
    from aerial_gym.rl_training.ranks import Ranks
    from aerial_gym.rl_training.trainers.native import NativeTraining
    from aerial_gym.task import Task


class DistillTrainer(NativeTrainer):
    """Distillation of this package."""

    name = "distill"
    summary = "a student learns the actions of a trained policy"
    section, settings = "distill", DistillCfg
    takes_teacher = True

    def check(self, cfg: TrainingCfg) -> None:
        """Raise ``ConfigError`` if the teacher is missing or cannot be read."""
        from aerial_gym.rl_training.policies.load import load_policy

        if cfg.teacher is None:
            raise ConfigError(
                "trainer distill needs a policy to hand on: --teacher RUN, the run folder of its training"
            )
        load_policy(cfg.teacher)

    def make_training(self, cfg: TrainingCfg, task: "Task", ranks: "Ranks | None" = None) -> "NativeTraining[Distill]":
        """Return a new training; raise ``ConfigError`` if the teacher does not fit the task."""
        from aerial_gym.rl_training.learning.distill import Distill
        from aerial_gym.rl_training.policies.load import check_fits, load_policy, make_network
        from aerial_gym.rl_training.trainers.native import NativeTraining

        del ranks
        assert cfg.teacher is not None
        teacher, teacher_cfg = load_policy(cfg.teacher, device=task.device)
        check_fits(teacher, task, teacher_cfg.task)
        return NativeTraining(cfg, task, Distill(cfg, task, make_network(cfg, task), teacher))
