"""Every trainer that comes with the package, in one table. A new trainer is one class and one line here.

Its module is imported when the trainer is first used. It imports its library only in ``prepare`` and ``run``.
"""

from typing import TYPE_CHECKING

from aerial_gym.lazy import ImportPath
from aerial_gym.registry import Registry
from aerial_gym.registry.plugins import instance_converter

if TYPE_CHECKING:
    from aerial_gym.rl_training.trainers.trainer import Trainer

TRAINERS: "Registry[Trainer]" = Registry("trainer")

for _name, _class in (
    ("ppo", "learners:PpoTrainer"),
    ("apg", "learners:ApgTrainer"),
    ("distill", "learners:DistillTrainer"),
    ("rl_games", "libraries:RlGamesTrainer"),
    ("sample_factory", "libraries:SampleFactoryTrainer"),
    ("other_library", "libraries:OtherLibrary"),
):
    _home = ImportPath(f"aerial_gym.rl_training.trainers.{_class}")
    TRAINERS.register_later(_name, _home.make, summary=_home.summary)

TRAINERS.accept_plugins(trainer=instance_converter("aerial_gym.rl_training.trainers.trainer:Trainer"))


def trainers_with_feature(feature: str) -> str:
    """Return the names of the trainers with a feature, a class variable of ``Trainer``, joined by 'or'."""
    return " or ".join(name for name in TRAINERS if getattr(TRAINERS.get(name), feature))
