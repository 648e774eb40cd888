"""The curriculum: difficulty and number of obstacles, decided on the device from the share of episodes that succeed.

Letters: E environments.
"""

from collections.abc import Callable

import torch
from torch import Tensor

from aerial_gym.assets import AssetManager
from aerial_gym.config.environment import EnvironmentCfg
from aerial_gym.config.task import CurriculumCfg
from aerial_gym.errors import ConfigError
from aerial_gym.registry import GlobalTensorDictionary, TensorSpec
from aerial_gym.task.step.row_kernels import RowKernel


def next_level(level: Tensor, finished: Tensor, succeeded: Tensor, cfg: CurriculumCfg) -> tuple[Tensor, Tensor, Tensor]:
    """Return level, finished and successful episodes after the decision on the level.

    Args:
        level: Obstacle rows in use, integer, (1,).
        finished: Episodes that ended since the last decision, integer, (1,).
        succeeded: How many of them succeeded, (1,).

    Returns:
        The three after it: where ``check_after`` episodes have ended, the level may be another and the counts are 0.
    """
    due = finished >= cfg.check_after
    share = succeeded / torch.maximum(finished, torch.ones_like(finished))
    change = cfg.raise_by * (share > cfg.raise_above).to(level.dtype) - cfg.lower_by * (share < cfg.lower_below).to(
        level.dtype
    )
    level = torch.where(due, (level + change).clamp(cfg.min_level, cfg.max_level), level)
    return level, torch.where(due, 0, finished), torch.where(due, 0, succeeded)


class Curriculum:
    """Owner of the level. Only ``state`` and ``load`` wait for the device."""

    def __init__(
        self, cfg: CurriculumCfg, env: EnvironmentCfg, assets: AssetManager, gtd: GlobalTensorDictionary
    ) -> None:
        """Declare ``curriculum_level`` in the GTD and set the first level."""
        if env.num_assets and cfg.max_level > env.num_assets:
            raise ConfigError(
                f"CurriculumCfg.max_level = {cfg.max_level}: this environment has {env.num_assets} obstacle rows. Lower it"
            )
        if cfg.min_level < env.num_kept:
            raise ConfigError(
                f"CurriculumCfg.min_level = {cfg.min_level}: this environment always keeps {env.num_kept} obstacle rows. "
                "Raise it"
            )
        self.cfg, self._num_kept = cfg, env.num_kept
        self._assets = assets if env.num_assets else None  # without obstacles the level is the difficulty alone
        self.level = gtd.declare(TensorSpec(
            key="curriculum_level", shape=(1,), dtype=torch.int32, unit="-", frame="-", owner="task",
            meaning="obstacle rows in use from the next reset on, those always kept included",
        ))  # fmt: skip
        self._finished, self._succeeded = torch.zeros_like(self.level), torch.zeros_like(self.level)
        self.difficulty = torch.zeros((), device=self.level.device)
        self.of_all: Callable[[Tensor], Tensor] | None = None
        """Sums counts, (2,), over the processes of a training, in each of which the level is then the same."""
        self._decide = RowKernel(self._next_level_and_difficulty, "the curriculum")
        self.restart()

    def restart(self) -> None:
        """Restart at the first level, with zero counts."""
        self.load({"level": self.cfg.first_level, "finished": 0, "succeeded": 0})

    def count(self, ended: Tensor, success: Tensor) -> None:
        """Count the ended and the successful episodes of this step, each bool (E,), and decide on the level."""
        finished, succeeded = ended.sum(), success.sum()
        if self.of_all is not None:
            finished, succeeded = self.of_all(torch.stack((finished, succeeded)))
        self._finished.add_(finished)
        self._succeeded.add_(succeeded)
        kept = (self.level, self._finished, self._succeeded)
        *_, count = self._decide(*kept, out=(*kept, self.difficulty.view(1)))
        if self._assets is not None:
            self._assets.take_num_obstacles(count)

    def state(self) -> dict[str, int]:
        """Return level and counts of a saved state; waits for the device."""
        return {"level": int(self.level), "finished": int(self._finished), "succeeded": int(self._succeeded)}

    def state_tensors(self) -> dict[str, Tensor]:
        """Return the tensors of a saved state beside level and difficulty, by name."""
        return {"finished": self._finished, "succeeded": self._succeeded}

    def load(self, state: dict[str, int]) -> None:
        """Continue from a state; raise ``ConfigError`` if its level is not one of this curriculum."""
        if not self.cfg.min_level <= state["level"] <= self.cfg.max_level:
            raise ConfigError(
                f"curriculum level {state['level']}: must lie in {self.cfg.min_level} to {self.cfg.max_level}"
            )
        self.level.fill_(state["level"])
        self._finished.fill_(state["finished"])
        self._succeeded.fill_(state["succeeded"])
        difficulty, count = self._difficulty_and_obstacles(self.level)
        self.difficulty.copy_(difficulty.squeeze(0))
        if self._assets is not None:
            self._assets.take_num_obstacles(count)

    def _next_level_and_difficulty(self, level: Tensor, finished: Tensor, succeeded: Tensor) -> tuple[Tensor, ...]:
        """Return level and counts after the decision, the difficulty and the number of obstacles, each (1,)."""
        level, finished, succeeded = next_level(level, finished, succeeded, self.cfg)
        return level, finished, succeeded, *self._difficulty_and_obstacles(level)

    def _difficulty_and_obstacles(self, level: Tensor) -> tuple[Tensor, Tensor]:
        """Return the difficulty and the number of obstacles, each (1,)."""
        span = self.cfg.max_level - self.cfg.min_level
        return (level - self.cfg.min_level) / span, level - self._num_kept
