"""Training with analytic policy gradients."""

from aerial_gym.rl_training.learning.apg import Apg
from aerial_gym.rl_training.learning.network import make_network
from aerial_gym.rl_training.run.interruption import Interruption
from aerial_gym.rl_training.run.keeper import Keeper
from aerial_gym.rl_training.run.progress import Progress
from aerial_gym.rl_training.run.run_folder import RunFolder
from aerial_gym.rl_training.settings import TrainingCfg
from aerial_gym.rl_training.trainers.own import OwnTraining, repeat
from aerial_gym.task import Task


def run(
    cfg: TrainingCfg, task: Task, folder: RunFolder, progress: Progress, *, keeper: Keeper, interruption: Interruption
) -> bool:
    """Train a task that was built with gradients, as ``own.repeat`` says."""
    return repeat(make_training(cfg, task), folder, progress, keeper=keeper, interruption=interruption)


def make_training(cfg: TrainingCfg, task: Task) -> OwnTraining[Apg]:
    """Return a new training.

    Raises:
        CapabilityError: If the task has no gradients.
        ConfigError: If it does not have what the networks are to see.
    """
    return OwnTraining(cfg, task, Apg(cfg, task, make_network(cfg, task)))
