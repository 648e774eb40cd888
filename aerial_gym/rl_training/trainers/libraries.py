"""Training with libraries that train by themselves, each through its module of ``adapters``."""

from collections.abc import Mapping
from typing import TYPE_CHECKING

from aerial_gym.errors import ConfigError
from aerial_gym.rl_training.learner_settings import LearnerCfg
from aerial_gym.rl_training.settings import TrainingCfg
from aerial_gym.rl_training.trainers.trainer import LibraryTrainer, Trainer

if TYPE_CHECKING:
    from torch import Tensor

    from aerial_gym.rl_training.policies.load import Weights


class RlGamesTrainer(LibraryTrainer):
    """The library rl-games."""

    name = "rl_games"
    summary = "PPO of the library rl-games"
    adapter = "aerial_gym.rl_training.adapters.rl_games"
    package, distribution = "rl_games", "rl-games"
    several_processes = True
    earlier_checkpoints = ("rl_games/nn/*.pth",)

    def weights(self, model: "Mapping[str, Tensor]", num_hidden: int) -> "Weights":
        """Return layers, mean and variance under the names of the library."""
        model = {key.removeprefix("_orig_mod."): value for key, value in model.items()}  # prefix of a compiled model
        names = [*(f"a2c_network.actor_mlp.{2 * i}" for i in range(num_hidden)), "a2c_network.mu"]
        layers = [(model[f"{name}.weight"], model[f"{name}.bias"]) for name in names]
        normalizer = "running_mean_std.running_"
        return layers, model.get(f"{normalizer}mean"), model.get(f"{normalizer}var")


class SampleFactoryTrainer(LibraryTrainer):
    """The library Sample Factory."""

    name = "sample_factory"
    summary = "PPO of the library Sample Factory (APPO, synchronous)"
    adapter = "aerial_gym.rl_training.adapters.sample_factory"
    package, distribution = "sample_factory", "sample-factory"
    earlier_checkpoints = ("sample_factory/checkpoint_p0/checkpoint_*.pth",)

    def weights(self, model: "Mapping[str, Tensor]", num_hidden: int) -> "Weights":
        """Return layers, mean and variance under the names of the library."""
        encoder = "actor_encoder" if any(key.startswith("actor_encoder.") for key in model) else "encoder"
        names = [f"{encoder}.encoders.obs.mlp_head.{2 * i}" for i in range(num_hidden)]
        names.append("action_parameterization.distribution_linear")
        layers = [(model[f"{name}.weight"], model[f"{name}.bias"]) for name in names]
        normalizer = "obs_normalizer.running_mean_std.running_mean_std.obs.running_"
        return layers, model.get(f"{normalizer}mean"), model.get(f"{normalizer}var")


class OtherLibrary(Trainer):
    """A library that trains in a user's own script, which saves its policy with ``save_policy``."""

    name = "other_library"
    summary = "policies of Stable-Baselines3, skrl and rsl_rl, saved with save_policy; it trains nothing itself"
    section, settings = "numbers", LearnerCfg

    def check(self, cfg: TrainingCfg) -> None:
        """Raise ``ConfigError``: the script of the library trains."""
        raise ConfigError(
            "trainer other_library: trains nothing. Run the script of the library (examples/other_libraries)"
        )

    run = check  # pyright: ignore[reportAssignmentType]
