"""The registry that builds tasks, with those of ``config/tasks``."""

import sys
from collections.abc import Sequence
from dataclasses import replace
from hashlib import sha256
from importlib import import_module
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any

from aerial_gym.config import family_files, read_summary
from aerial_gym.config.changes import Changes
from aerial_gym.config.loader import load_extended
from aerial_gym.config.task import TaskCfg
from aerial_gym.config.task_terms import ObservationCfg
from aerial_gym.errors import ConfigError, UnknownNameError
from aerial_gym.registry import Registry
from aerial_gym.registry.plugins import instance_converter
from aerial_gym.registry.registry import register_files
from aerial_gym.task.gymnasium_ids import register_task

if TYPE_CHECKING:
    import torch

    from aerial_gym.config.controller import ControllerCfg
    from aerial_gym.config.environment import EnvironmentCfg
    from aerial_gym.config.robot import RobotCfg
    from aerial_gym.config.sim import SimCfg
    from aerial_gym.task.task import Task


class TaskRegistry(Registry[TaskCfg]):
    """Tasks by name; ``make_task`` builds one."""

    def register(self, name: str, entry: TaskCfg) -> None:
        """Add an entry, with its id of Gymnasium; raise ``DuplicateNameError`` if the name is taken."""
        super().register(name, entry)
        register_task(name)

    def make_task(
        self, name: str, *, num_envs: int | None = None, device: "str | torch.device" = "auto", seed: int = 0,
        robot: str | None = None, controller: str | None = None, sim: str | None = None, env: str | None = None,
        level: int | None = None, capture: bool | None = None, first_env: int = 0, first_episode: int = 0,
        backend: str | None = None, differentiable: bool = False, dtype: "torch.dtype | None" = None,
        encoder: str | None = None, settings: Sequence[str] = (), firmware: str | None = None,
    ) -> "Task":  # fmt: skip
        """Return a task, built and not yet reset.

        Args:
            name: Registered task, a task file (``.yaml``), a level of lsy_drone_racing (``.toml``), or ``module:Name`` or
                ``file.py:Name`` of a ``TaskCfg`` or of a ``Task`` class that has one as ``cfg``.
            num_envs: Number of environments; the task's own default if not given. With several vehicles a task
                has a row for each of them.
            device: Torch device; ``auto`` takes the GPU if there is one.
            seed: Seed of every random number of this task.
            robot: Registered robot, or a robot file, in place of the task's own.
            controller: Registered controller in place of the task's own.
            sim: Registered sim in place of the task's own.
            env: Registered environment, or an environment file, in place of the task's own.
            level: Level at which the curriculum stays, in place of one that changes; within its limits.
            capture: Whether to hold the step in a CUDA graph; if not given, on CUDA devices.
            first_env: Number of the first environment: with ``num_envs=1`` that one alone, as it is in any larger batch.
            first_episode: Number of the first episode, likewise. Where there is a curriculum, ``level`` must be given with it:
                all environments together decide on that, and it says how many obstacles the episode had.
            backend: Registered physics backend in place of the sim's own.
            differentiable: Whether rewards and observations have gradients with respect to actions.
            dtype: Float type of gradients; float32 if not given.
            encoder: Encoder file, or one that comes with the package, in place of the task's own; where the task shows the
                nearest distances of 8 x 8 cells, its latents are shown instead.
            settings: Changed settings ``KEY=VALUE`` of ``task``, ``robot``, ``env``, ``sim`` and ``controller``, such as
                ``robot.body.mass=0.3``.
            firmware: Firmware that flies the vehicles in place of the controller here, for evaluation; see ``SimBuilder``.

        Raises:
            UnknownNameError: If a name is not registered.
            ConfigError: If a number is impossible.
            CapabilityError: If gradients are asked for and something has none.
        """
        import torch

        from aerial_gym.env_manager import SimBuilder
        from aerial_gym.interop import usual_settings
        from aerial_gym.task.task import Task

        changes, given = Changes(settings), {"robot": robot, "controller": controller, "sim": sim, "env": env}
        cfg, built_robot, built_env, built_sim, law = self.configurations(name, changes, num_envs=num_envs, **given)
        changes.finish()
        if encoder is not None:
            cfg = task_with_encoder(cfg, encoder)
        if level is not None:
            if cfg.curriculum is None:
                raise ConfigError(f"level = {level}: task {name} has no curriculum")
            cfg = replace(cfg, curriculum=replace(cfg.curriculum, start_level=level, raise_by=0, lower_by=0))
        elif first_episode and cfg.curriculum is not None:
            raise ConfigError(
                f"first_episode = {first_episode}: seed, environment and episode do not say which level of its curriculum "
                f'task {name} had then. Give level, which stood in gtd["curriculum_level"] when the episode began'
            )
        if built_env.robots:
            raise ConfigError(
                f"env of task {name}: it has robots. Leave them out, and give the task robot and num_vehicles"
            )
        flown: dict[str, Any] = {"robot_name": built_robot}
        if cfg.num_vehicles > 1:
            flown = {"robots": [{"name": built_robot, "count": cfg.num_vehicles}]}
        built = SimBuilder().build_env(
            sim_name=built_sim, env_name=built_env, **flown, controller_name=law,
            num_envs=cfg.num_envs, device=device, seed=seed, first_env=first_env, first_episode=first_episode,
            backend=backend, randomize=cfg.randomize, differentiable=differentiable, dtype=dtype or torch.float32,
            firmware=firmware,
        )  # fmt: skip
        make = import_object(name) if ":" in name else None
        made = make if isinstance(make, type) else Task
        return usual_settings(lambda: made(cfg, built, capture=capture))()  # also for a user's class

    def configurations(
        self, name: str, changes: Changes, **given: object
    ) -> "tuple[TaskCfg, RobotCfg, EnvironmentCfg, SimCfg, ControllerCfg]":
        """Return a task and its robot, environment, sim and controller, with changed settings and given fields of the task."""
        from aerial_gym.control import CONTROLLERS
        from aerial_gym.env_manager.catalog import SIMS
        from aerial_gym.env_manager.sim_builder import environment_by_name
        from aerial_gym.robots.catalog import robot_by_name

        given = {key: value for key, value in given.items() if value is not None}
        for key in given:
            changes.refuse(f"task.{key}", f"it is given as {key} already. Leave one out")
        cfg = replace(changes.apply("task", self.get(name)), **given)
        robot = robot_by_name(cfg.robot)
        robot = changes.apply("robot", robot if cfg.start is None else replace(robot, initial_state=cfg.start))
        env, sim = changes.apply("env", environment_by_name(cfg.env)), changes.apply("sim", SIMS.get(cfg.sim))
        return cfg, robot, env, sim, changes.apply("controller", CONTROLLERS.get(cfg.controller))

    def get(self, name: str) -> TaskCfg:
        """Return the configuration of a task: a registered one, that of a file, or that of ``module:Name``.

        Raises:
            UnknownNameError: If it does not exist.
            ConfigError: If the file or the object is no task.
        """
        if name.endswith((".yaml", ".yml")):
            cfg = load_task(name)
            for each in cfg.imports:
                _import_module(each, Path(name).parent)
            return cfg
        if name.endswith(".toml"):
            return _racing_level_task(name)
        if ":" not in name:
            return super().get(name)
        target = import_object(name)
        cfg = getattr(target, "cfg", None) if isinstance(target, type) else target
        if not isinstance(cfg, TaskCfg):
            raise ConfigError(f"task {name!r}: must be a TaskCfg, or a subclass of Task that has one as its cfg")
        return cfg


def load_task(path: str | Path) -> TaskCfg:
    """Return the task of a YAML file, which may extend another one (``config.loader``)."""
    return load_extended(TaskCfg, path, family="tasks")


def _racing_level_task(path: str) -> TaskCfg:
    """Return the task of a level of a racing benchmark."""
    from aerial_gym.robots.catalog import robot_by_name
    from aerial_gym.task.racing_level import load_level

    base = task_registry.get("racing_task")
    return load_level(path, base, robot_by_name(base.robot))


def import_object(name: str) -> object:
    """Return the object ``module:Name`` or ``file.py:Name``; the module may be in the current folder."""
    module, _, attribute = name.rpartition(":")
    kind = "file.py" if module.endswith(".py") else "module"
    try:
        return getattr(_import_module(module, Path()), attribute)
    except (UnknownNameError, AttributeError) as error:
        raise UnknownNameError(f"task {name!r}: {error}. Give it as {kind}:Name") from None


def _import_module(name: str, folder: Path) -> ModuleType:
    """Return the module of a name or file, relative to a folder; raise ``UnknownNameError`` if it does not exist."""
    here = str(folder.resolve())
    sys.path.append(here)
    try:
        return _load_module(folder / name) if name.endswith(".py") else import_module(name)
    except (FileNotFoundError, ModuleNotFoundError) as error:
        raise UnknownNameError(str(error)) from None
    finally:
        sys.path.remove(here)


def _load_module(path: Path) -> ModuleType:
    """Return the module of a file, run once per process so that it registers its entries once."""
    path = path.resolve()
    known = f"aerial_gym_task_{path.stem}_{sha256(str(path).encode()).hexdigest()[:8]}"
    if known in sys.modules:
        return sys.modules[known]
    if not path.is_file():
        raise FileNotFoundError(f"{path}: no such file")
    spec = spec_from_file_location(known, path)
    assert spec is not None
    assert spec.loader is not None
    module = sys.modules[known] = module_from_spec(spec)
    try:
        spec.loader.exec_module(module)
    except BaseException:
        del sys.modules[known]
        raise
    return module


CELL_TERMS = ("nearest_in_cells", "log_nearest_in_cells")  # Terms with 64 numbers by default, which latents can replace


def task_with_encoder(cfg: TaskCfg, encoder: str) -> TaskCfg:
    """Return a task with an encoder's latents in place of the nearest distances of 8 x 8 cells."""

    def use_latents(entry: ObservationCfg) -> ObservationCfg:
        return replace(entry, term="image_latents") if entry.term in CELL_TERMS and not entry.params else entry

    groups = {name: tuple(use_latents(entry) for entry in entries) for name, entries in cfg.observations.items()}
    if not any(entry.term == "image_latents" for entries in groups.values() for entry in entries):
        raise ConfigError(
            f"encoder {encoder}: this task has no image_latents and no {' or '.join(CELL_TERMS)} of 8 x 8 cells among its "
            "observations. Choose one that has, such as navigation_task"
        )
    return replace(cfg, observations=groups, encoder=encoder)


task_registry = TaskRegistry("task")
register_files(task_registry, family_files("tasks"), load_task, summary=read_summary)
task_registry.accept_plugins(task=instance_converter("aerial_gym.config.task:TaskCfg"))
