"""Training with the library rl-games; its adapter is ``adapters.rl_games``."""

from collections.abc import Mapping
from typing import TYPE_CHECKING

from aerial_gym.rl_training.settings import TrainingCfg
from aerial_gym.rl_training.trainers.trainer import LibraryTrainer

if TYPE_CHECKING:
    import torch
    from torch import Tensor

    from aerial_gym.rl_training.policies.load import Weights
    from aerial_gym.rl_training.ranks import Ranks
    from aerial_gym.rl_training.run.interruption import Interruption
    from aerial_gym.rl_training.run.keeper import Keeper
    from aerial_gym.rl_training.run.progress import Progress
    from aerial_gym.rl_training.run.run_folder import RunFolder
    from aerial_gym.task import Task


class RlGamesTrainer(LibraryTrainer):
    """The library rl-games."""

    name = "rl_games"
    summary = "PPO of the library rl-games"
    package, distribution = "rl_games", "rl-games"
    several_processes = True
    earlier_checkpoints = ("rl_games/nn/*.pth",)

    def prepare(self, device: "torch.device") -> None:
        """Import the library."""
        import aerial_gym.rl_training.adapters.rl_games  # noqa: F401

        del device

    def run(
        self,
        cfg: TrainingCfg,
        task: "Task",
        folder: "RunFolder",
        progress: "Progress",
        *,
        keeper: "Keeper",
        interruption: "Interruption",
        ranks: "Ranks",
    ) -> bool:
        """Train with the runner of the library; return whether it was interrupted."""
        from aerial_gym.rl_training.adapters.rl_games import run

        return run(cfg, task, folder, progress, keeper=keeper, interruption=interruption, ranks=ranks)

    def weights(self, model: "Mapping[str, Tensor]", num_hidden: int) -> "Weights":
        """Return layers, mean and variance under the names of the library."""
        model = {key.removeprefix("_orig_mod."): value for key, value in model.items()}  # prefix of a compiled model
        names = [*(f"a2c_network.actor_mlp.{2 * i}" for i in range(num_hidden)), "a2c_network.mu"]
        layers = [(model[f"{name}.weight"], model[f"{name}.bias"]) for name in names]
        normalizer = "running_mean_std.running_"
        return layers, model.get(f"{normalizer}mean"), model.get(f"{normalizer}var")
