"""Settings of a training: task, trainer, limits, and the numbers of its learner.

Letters: E environments.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypeVar

from aerial_gym.config import CONFIG_DIR
from aerial_gym.config.checks import NO_SOURCE, refuse, require, require_count, require_positive
from aerial_gym.config.loader import convert, load_extended, mandatory_fields, read_yaml
from aerial_gym.errors import ConfigError
from aerial_gym.interop import resolve_device
from aerial_gym.rl_training.learner_settings import ApgCfg, DistillCfg, LearnerCfg, PpoCfg
from aerial_gym.rl_training.trainers.catalog import TRAINERS, trainers_with_feature

TRAINING_CONFIGS = CONFIG_DIR / "training"
"""Folder of the package's settings: ``TRAINER_TASK.yaml``, the task without its ``_task``. ``TRAINER_TASK_cpu.yaml`` is
for CPUs."""

Section = TypeVar("Section", bound=LearnerCfg)

ALIKE = {
    "dce_navigation_task": "navigation_task",
    "position_setpoint_task_acceleration_sim2real": "position_setpoint_task_sim2real",
    "position_setpoint_task_morphy_paper": "position_setpoint_task_morphy",
    "position_setpoint_task_morphy_stiff": "position_setpoint_task_morphy",
    "race_of_four_task": "racing_task",
    "radar_navigation_task": "lidar_navigation_task",
    "radar_navigation_task_held": "lidar_navigation_task",
    "racing_random_track_task": "racing_task",
    "team_payload_task": "formation_task",
    "tunnel_swap_task": "formation_task",
}
"""Tasks without settings of their own, and the task whose settings they use."""

SECTIONS = ("ppo", "apg", "distill", "numbers")  # Fields of `TrainingCfg` with the numbers of a learner, one each


@dataclass(frozen=True, kw_only=True)
class TrainingCfg:
    """One training. Its run folder holds it as ``config.yaml``, from which the run can be repeated."""

    summary: str = ""  # One line about the settings
    task: str  # Registered task
    trainer: str  # Registered trainer
    num_envs: int  # Number of environments in each process, >= 1
    device: str = "auto"  # Torch device; auto takes the GPU if there is one
    seed: int = 0  # Seed of the task and of the trainer, >= 0
    robot: str | None = None  # Registered robot, or a robot file, in place of the task's own
    controller: str | None = None  # Registered controller in place of the task's own
    backend: str | None = None  # Registered physics backend in place of the sim's own

    encoder: str | None = None
    """Encoder file, or name of one in the package, in place of the task's own. A run folder keeps a copy of a file."""

    torch_threads: int | None = None  # Threads of torch on the CPU, >= 1; None leaves torch's own choice
    max_time_s: float | None = None  # Time limit, start-up included [s], > 0
    max_env_steps: int | None = None  # Limit of environment steps, over all sessions and processes, >= 1
    checkpoint_every_s: float = 30.0  # Time between checkpoints [s], > 0
    settings: tuple[str, ...] = ()  # Changed settings of `task`, `robot`, `env` and `sim`: `robot.body.mass=0.3`
    teacher: str | None = None  # Run folder or checkpoint of the policy that `distill` imitates

    initial: str | None = None
    """Run folder or checkpoint of the initial networks of ``ppo``. Additional observations must follow those of that run;
    their first weights are zero."""

    ppo: PpoCfg | None = None  # Settings of a learner with PPO: `ppo`, `rl_games`, `sample_factory`
    apg: ApgCfg | None = None  # Settings of `apg`
    distill: DistillCfg | None = None  # Settings of `distill`
    numbers: Mapping[str, object] | None = None  # Settings of another trainer, by the fields of its `Trainer.settings`
    source: str = NO_SOURCE  # Source of the numbers

    @property
    def learner(self) -> LearnerCfg:
        """Settings of the learner."""
        trainer = TRAINERS.get(self.trainer)
        return convert(trainer.settings, getattr(self, trainer.section), trainer.section)

    def section(self, kind: type[Section]) -> Section:
        """Return the settings of the learner, which must be of class ``kind``."""
        settings = self.learner
        assert isinstance(settings, kind)
        return settings

    def __post_init__(self) -> None:
        require_positive(self, "checkpoint_every_s", "max_time_s", "max_env_steps", "torch_threads")
        trainer = TRAINERS.get(self.trainer)
        if self.max_time_s is None and self.max_env_steps is None:
            refuse("TrainingCfg: give max_time_s, max_env_steps or both, or the training never ends")
        require_count(self, "num_envs")
        require(self, "seed", 0 <= self.seed < 2**32, "must be >= 0 and less than 2**32")  # NumPy takes no larger one
        if [name for name in SECTIONS if getattr(self, name) is not None] != [trainer.section]:
            refuse(f"TrainingCfg: trainer {self.trainer} needs numbers under {trainer.section} alone")
        for name, feature, none in (
            ("teacher", "takes_teacher", "has none"),
            ("initial", "takes_initial", "takes no initial networks"),
        ):
            if getattr(self, name) is not None and not getattr(trainer, feature):
                rule = f"trainer {self.trainer} {none}. Use {trainers_with_feature(feature)}"
                refuse(f"TrainingCfg.{name} = {getattr(self, name)}: {rule}")
        learner = self.learner
        special = learner.memory or learner.critic_keys or learner.sets or learner.policy_keys != ("observations",)
        if (special or getattr(learner, "opponents", 0)) and not trainer.any_inputs:
            refuse(
                f"TrainingCfg: memory, policy_keys, critic_keys, sets and opponents need trainer ppo, not {self.trainer}"
            )
        if self.ppo is None:
            return
        samples, parts = self.num_envs * self.ppo.horizon, self.ppo.num_minibatches
        if samples % parts:
            refuse(
                f"TrainingCfg: num_envs * horizon = {samples} samples cannot be split into num_minibatches = {parts}"
            )


def settings_for(trainer: str, task: str, *, device: str = "auto") -> Path:
    """Return the file of settings of a trainer for a task and a device.

    A task without settings of its own uses those of the task in ``ALIKE``, else of the position task; a race level (``.toml``)
    those of ``racing_task``. On a CPU, settings for CPUs come first.

    Raises:
        UnknownNameError: If there is no such trainer.
        ConfigError: If it has no settings.
    """
    file = _nearest_settings(trainer, task, device)
    if not file.exists():
        raise ConfigError(f"trainer {trainer}: has no settings for {task}. Give a file of settings (--config)")
    return file


def _nearest_settings(trainer: str, task: str, device: str) -> Path:
    folder = TRAINERS.get(trainer).settings_folder
    like = "racing_task" if task.endswith(".toml") else ALIKE.get(task, task)
    tasks = (task, like, "position_setpoint_task")
    files = [folder / f"{trainer}_{name.removesuffix('_task')}.yaml" for name in tasks]
    own = next((path for path in files if path.exists()), files[-1])
    for_cpu = [path.with_name(f"{path.stem}_cpu.yaml") for path in (own, *files[:2])]
    on_cpu = next((path for path in for_cpu if path.exists()), None)
    return own if on_cpu is None or resolve_device(device).type != "cpu" else on_cpu


TASK, TRAINER = "position_setpoint_task", "ppo"  # Default task and trainer


def load_task_settings(
    file: Path | None, *, trainer: str | None = None, task: str | None = None, device: str = "auto"
) -> TrainingCfg:
    """Return the training in a file, or that of the package, for a task.

    A file without required fields and without ``extends`` extends the settings of the package (``settings_for``).

    Raises:
        ConfigError: If the file is of another trainer.
    """
    given = {} if file is None else read_yaml(file)
    task, own = task or str(given.get("task", TASK)), given.get("trainer")
    name = str(own or trainer or TRAINER)
    package = _nearest_settings(name, task, device)
    file = file or settings_for(name, task, device=device)
    base = package if package.exists() and _is_partial(given) else None
    cfg = replace(load_extended(TrainingCfg, file, family="training", base=base), task=task)
    if trainer not in (None, cfg.trainer):
        raise ConfigError(f"--trainer {trainer}: settings in {file} are of {cfg.trainer}. Leave one out")
    return cfg


def _is_partial(given: Mapping[str, object]) -> bool:
    """Return whether a file has content, but lacks required fields of a training or of its learner."""
    if not given or "extends" in given or "trainer" not in given:
        return bool(given) and "extends" not in given
    trainer = TRAINERS.get(str(given["trainer"]))
    numbers = given.get(trainer.section)
    parts = ((TrainingCfg, given), (trainer.settings, numbers if isinstance(numbers, Mapping) else {}))
    return any(set(mandatory_fields(cls)) - part.keys() for cls, part in parts)


def load_settings(path: str | Path) -> TrainingCfg:
    """Return the training in a YAML file, which may extend another (``config.loader``)."""
    return load_extended(TrainingCfg, path, family="training")
