"""Common part of the libraries that train by themselves: arguments of a training, and its report after each update."""

from collections.abc import Callable, Iterable
from dataclasses import KW_ONLY, dataclass
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
class LibraryRun:
    """Arguments of ``Trainer.run``."""

    cfg: TrainingCfg
    task: Task
    folder: RunFolder
    progress: Progress
    _: KW_ONLY
    keeper: CheckpointKeeper
    interruption: Interruption
    ranks: Ranks

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
