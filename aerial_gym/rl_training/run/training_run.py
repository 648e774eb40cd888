"""Arguments of one session of a training, which every trainer takes."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from math import log

from aerial_gym.rl_training.learner_settings import PpoCfg
from aerial_gym.rl_training.ranks import Ranks
from aerial_gym.rl_training.run.checkpoint_keeper import CheckpointKeeper, Interruption
from aerial_gym.rl_training.run.progress import Progress, Report
from aerial_gym.rl_training.run.run_folder import RunFolder
from aerial_gym.rl_training.settings import TrainingCfg
from aerial_gym.rl_training.trainers.summaries import SafeEvents
from aerial_gym.task import Task


@dataclass(frozen=True)
class TrainingRun:
    """Arguments of ``Trainer.run``."""

    cfg: TrainingCfg  # Settings
    task: Task  # Built task, reset by the trainer
    folder: RunFolder  # Receives TensorBoard files
    progress: Progress  # Updated after every update of the policy
    keeper: CheckpointKeeper  # Writes checkpoints, and holds the one to resume from
    interruption: Interruption  # Whether the user asked to end
    ranks: Ranks  # The processes that learn together

    def report_update(self, report: Report, summaries: Iterable[SafeEvents], save: Callable[[], object]) -> bool:
        """Record an update, and save if a checkpoint is due; return whether the training must end."""
        self.interruption.check()
        for events in summaries:
            events.check()
        ends = self.progress.update(report)
        if not ends and self.keeper.due:
            save()
        return ends

    @property
    def learning_rate_and_std_limits(self) -> tuple[float, float]:
        """Upper bound of the learning rate at this share of the training; lower bound of the actions' log deviation."""
        ppo = self.cfg.section(PpoCfg)
        return ppo.learning_rate_limit(self.progress.share), log(ppo.min_std)
