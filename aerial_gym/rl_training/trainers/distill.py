"""Training a student on what a trained policy does."""

from aerial_gym.rl_training.learning.distill import Distill
from aerial_gym.rl_training.learning.network import make_network
from aerial_gym.rl_training.policies.load import check_fits, load_policy
from aerial_gym.rl_training.settings import TrainingCfg
from aerial_gym.rl_training.trainers.own import OwnTraining
from aerial_gym.task import Task


def make_training(cfg: TrainingCfg, task: Task) -> OwnTraining[Distill]:
    """Return a new training.

    Raises:
        ConfigError: If the teacher cannot be read, or the task does not have what it or the student sees.
    """
    assert cfg.teacher is not None
    teacher, its_cfg = load_policy(cfg.teacher, device=task.device)
    check_fits(teacher, task, its_cfg.task)
    return OwnTraining(cfg, task, Distill(cfg, task, make_network(cfg, task), teacher))
