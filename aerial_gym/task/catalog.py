"""Every task that comes with the package, and the registry that builds them."""

import sys
from dataclasses import replace
from functools import partial
from hashlib import sha256
from importlib import import_module
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING

from aerial_gym.config import CONFIG_DIR, load
from aerial_gym.config.task import CurriculumCfg, TaskCfg
from aerial_gym.config.task_terms import CommandCfg, ImageCfg, ObservationCfg, RewardCfg
from aerial_gym.errors import ConfigError, UnknownNameError
from aerial_gym.registry import Registry

if TYPE_CHECKING:
    import torch

    from aerial_gym.task.task import Task


class TaskRegistry(Registry[TaskCfg]):
    """Tasks by name; ``make_task`` builds one."""

    def make_task(
        self,
        name: str,
        *,
        num_envs: int | None = None,
        device: "str | torch.device" = "auto",
        seed: int = 0,
        robot: str | None = None,
        controller: str | None = None,
        sim: str | None = None,
        env: str | None = None,
        level: int | None = None,
        capture: bool | None = None,
        first_env: int = 0,
        first_episode: int = 0,
        backend: str | None = None,
        differentiable: bool = False,
        dtype: "torch.dtype | None" = None,
        encoder: str | None = None,
    ) -> "Task":
        """Return a task, built and not yet reset.

        Args:
            name: Registered task, a task file (``.yaml``), a level of lsy_drone_racing (``.toml``), or ``module:Name`` or
                ``file.py:Name`` of a ``TaskCfg`` or of a ``Task`` class that has one as ``cfg``.
            num_envs: Number of environments; the task's own default if not given.
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
            dtype: Float type of what has them; float32 if not given.
            encoder: Encoder file, or one that comes with the package, in place of the task's own; where the task shows the
                nearest distances of 8 x 8 cells, its latents are shown instead.

        Raises:
            UnknownNameError: If a name is not registered.
            ConfigError: If a number is impossible.
            CapabilityError: If gradients are asked for and something has none.
        """
        import torch

        from aerial_gym.env_manager import SimBuilder
        from aerial_gym.interop import usual_settings
        from aerial_gym.robots.catalog import robot_by_name
        from aerial_gym.task.task import Task

        cfg = self.get(name)
        changes = {"num_envs": num_envs, "robot": robot, "controller": controller, "sim": sim, "env": env}
        cfg = replace(cfg, **{key: value for key, value in changes.items() if value is not None})
        if encoder is not None:
            cfg = with_encoder(cfg, encoder)
        if level is not None:
            cfg = replace(cfg, curriculum=_held(cfg, name, level))
        elif first_episode and cfg.curriculum is not None:
            raise ConfigError(
                f"first_episode = {first_episode}: seed, environment and episode do not say which level of its curriculum "
                f'task {name} had then. Give level, which stood in gtd["curriculum_level"] when the episode began'
            )
        built = SimBuilder().build_env(
            sim_name=cfg.sim,
            env_name=cfg.env,
            robot_name=cfg.robot if cfg.start is None else replace(robot_by_name(cfg.robot), initial_state=cfg.start),
            controller_name=cfg.controller,
            num_envs=cfg.num_envs,
            device=device,
            seed=seed,
            first_env=first_env,
            first_episode=first_episode,
            backend=backend,
            randomize=cfg.randomize,
            differentiable=differentiable,
            dtype=dtype or torch.float32,
        )
        make = imported(name) if ":" in name else None
        made = make if isinstance(make, type) else Task
        return usual_settings(lambda: made(cfg, built, capture=capture))()  # also what a user's class makes

    def get(self, name: str) -> TaskCfg:
        """Return the configuration of a task: a registered one, that of a file, or that of ``module:Name``.

        Raises:
            UnknownNameError: If there is none.
            ConfigError: If the file or what the module holds is no task.
        """
        if name.endswith((".yaml", ".yml")):
            cfg = load(TaskCfg, name)
            for each in cfg.imports:
                _import(each, Path(name).parent)
            return cfg
        if name.endswith(".toml"):
            return _level(name)
        if ":" not in name:
            return super().get(name)
        found = imported(name)
        cfg = getattr(found, "cfg", None) if isinstance(found, type) else found
        if not isinstance(cfg, TaskCfg):
            raise ConfigError(f"task {name!r}: must be a TaskCfg, or a subclass of Task that has one as its cfg")
        return cfg


def _level(path: str) -> TaskCfg:
    """Return the task of a level of a racing benchmark."""
    from aerial_gym.robots.catalog import robot_by_name
    from aerial_gym.task.racing_level import load_level

    base = task_registry.get("racing_task")
    return load_level(path, base, robot_by_name(base.robot))


def imported(name: str) -> object:
    """Return what ``module:Name`` or ``file.py:Name`` names; the module may stand in the current folder.

    Raises:
        UnknownNameError: If there is no such module or file, or nothing of that name in it.
    """
    module, _, attribute = name.rpartition(":")
    kind = "file.py" if module.endswith(".py") else "module"
    try:
        return getattr(_import(module, Path()), attribute)
    except (UnknownNameError, AttributeError) as error:
        raise UnknownNameError(f"task {name!r}: {error}. Give it as {kind}:Name") from None


def _import(name: str, folder: Path) -> ModuleType:
    """Return a module by its name, or by that of its file, which may stand in a folder.

    Raises:
        UnknownNameError: If there is none.
    """
    here = str(folder.resolve())
    sys.path.append(here)
    try:
        return _module_of(folder / name) if name.endswith(".py") else import_module(name)
    except (FileNotFoundError, ModuleNotFoundError) as error:
        raise UnknownNameError(str(error)) from None
    finally:
        sys.path.remove(here)


def _module_of(path: Path) -> ModuleType:
    """Return the module of a file, run once in a process: what it registers, it registers once."""
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


CELL_TERMS = ("nearest_in_cells", "log_nearest_in_cells")
"""Terms in whose place latents may stand: 64 numbers of an image, unless their parameters say otherwise."""


def with_encoder(cfg: TaskCfg, encoder: str) -> TaskCfg:
    """Return a task that sees the latents of an encoder where it sees the nearest distances of 8 x 8 cells.

    Raises:
        ConfigError: If it sees neither these nor latents.
    """

    def seen(entry: ObservationCfg) -> ObservationCfg:
        return replace(entry, term="image_latents") if entry.term in CELL_TERMS and not entry.params else entry

    groups = {name: tuple(seen(entry) for entry in entries) for name, entries in cfg.observations.items()}
    if not any(entry.term == "image_latents" for entries in groups.values() for entry in entries):
        raise ConfigError(
            f"encoder {encoder}: this task has no image_latents and no {' or '.join(CELL_TERMS)} of 8 x 8 cells among its "
            "observations. Choose one that has, such as navigation_task"
        )
    return replace(cfg, observations=groups, encoder=encoder)


def _held(cfg: TaskCfg, name: str, level: int) -> CurriculumCfg:
    """Return the task's curriculum, held at a level."""
    if cfg.curriculum is None:
        raise ConfigError(f"level = {level}: task {name} has no curriculum")
    return replace(cfg.curriculum, start_level=level, raise_by=0, lower_by=0)


task_registry = TaskRegistry("task")

for _name in (
    "position_setpoint_task",
    "position_setpoint_task_sim2real",
    "position_setpoint_task_acceleration_sim2real",
    "position_setpoint_task_sim2real_end_to_end",
    "position_setpoint_task_sim2real_px4",
    "position_setpoint_task_morphy",
    "position_setpoint_task_reconfigurable",
    "navigation_task",
    "lidar_navigation_task",
    "tracking_task",
    "recovery_task",
    "agile_tracking_task",
    "gust_rejection_task",
    "any_quadrotor_task",
    "motor_failure_task",
    "platform_landing_task",
    "payload_task",
    "racing_split_s_task",
    "racing_task",
):
    task_registry.register_later(_name, partial(load, TaskCfg, CONFIG_DIR / "tasks" / f"{_name}.yaml"))


def _rigid_morphy() -> TaskCfg:
    """position_setpoint_task_morphy by a policy that knows no joints, learned on the rigid vehicle; flies others by --robot."""
    task = task_registry.get("position_setpoint_task_morphy")
    joints = ("dof_position", "dof_velocity")
    return replace(
        task,
        summary="position_setpoint_task_morphy on the vehicle with rigid arms, 17 observations without joints",
        robot="morphy_stiff",
        observations={"policy": tuple(each for each in task.observations["policy"] if each.term not in joints)},
        rewards={name: reward for name, reward in task.rewards.items() if name != "joints"},
    )


task_registry.register_later("position_setpoint_task_morphy_stiff", _rigid_morphy)


def _morphy_of_the_paper() -> TaskCfg:
    """position_setpoint_task_morphy with a reward of the form of the paper's equation 8, where the published code differs.

    The distance counts as a potential: what a step gains. The thrust beyond hover counts by an exponential kernel.
    """
    task = task_registry.get("position_setpoint_task_morphy")
    gained = RewardCfg(term="progress", params={"closer": 10.0, "further": 10.0})
    thrust = RewardCfg(term="all_actions_size", params={"offset": 0.711225, "height": 0.01, "width": 10.0})
    return replace(
        task,
        summary="position_setpoint_task_morphy with a reward of the form of equation 8 of the paper's appendix",
        rewards=dict(task.rewards) | {"distance": gained, "size": thrust},
        source=(
            f"{task.source}. Form of 'distance' and 'size': equation 8 of the appendix. Their coefficients: those of the same "
            "two terms in equation 10, as coded in position_setpoint_task_sim2real_end_to_end"
        ),
    )


task_registry.register_later("position_setpoint_task_morphy_paper", _morphy_of_the_paper)


def _safe_navigation() -> TaskCfg:
    """navigation_task as an optimum of its reward would not fly it.

    There a step at the goal is worth 11 in the first rooms and 33 in the fullest, a second 110 to 330, and a crash costs 100
    beside what it ends: its optimum is in a hurry. A price that is high from the first room on can teach to stay at home; one
    that rises with the rooms falls again where they come too early.
    """
    task = task_registry.get("navigation_task")
    assert task.crash_reward is not None
    price = task.crash_reward.value
    seen = tuple(
        replace(entry, term="log_nearest_in_cells") if entry.term == "nearest_in_cells" else entry
        for entry in task.observations["policy"]
    )
    known = (ObservationCfg(term=key) for key in ("robot_clearance", "robot_position", "robot_orientation"))
    return replace(
        task,
        summary="navigation_task with a price of crashes that rises, logarithms of distances, and a critic that knows more",
        observations={"policy": seen, "critic": (*seen, *known)},
        crash_reward=replace(task.crash_reward, value=3.0 * price, difficulty_value=30.0 * price),
        source=f"{task.source}. Price of a crash, logarithms and what the critic sees: ours",
    )


task_registry.register_later("safe_navigation_task", _safe_navigation)


def _random_track() -> TaskCfg:
    """racing_task on tracks that are drawn, from starts anywhere within its safety limits, 5 m x 3 m."""
    task = task_registry.get("racing_task")
    assert task.start is not None
    low, high = (0.0833333, 0.25, 0.0), (0.9166667, 0.75, 0.008)
    return replace(
        task,
        summary="race through four gates and past poles of a track that every reset draws anew; thrust and body rates at 50 Hz",
        env="racing_random_track_env",
        start=replace(task.start, position_ratio_low=low, position_ratio_high=high),
        source=task.source.replace("level 2", "level 3"),
    )


task_registry.register_later("racing_random_track_task", _random_track)


def _polynomial_tracking() -> TaskCfg:
    """tracking_task on tracks that every reset draws in place of the figure eight."""
    task = task_registry.get("tracking_task")
    limits = {"max_speed": 2.5, "max_acceleration": 4.0}
    return replace(
        task,
        summary="follow a point on a smooth track of minimum snap through points that every reset draws; attitude commands",
        episode_len_steps=800,
        command=CommandCfg(generator="polynomial", params={"points": 5, "size": [1.5, 1.5, 0.5], **limits}),
        source=f"{task.source}. Tracks: Mellinger and Kumar (2011); limits about those of the figure eight",
    )


task_registry.register_later("polynomial_tracking_task", _polynomial_tracking)


def _pixel_navigation() -> TaskCfg:
    """navigation_task for a policy that finds out itself what an image shows."""
    task = task_registry.get("navigation_task")
    state = tuple(entry for entry in task.observations["policy"] if entry.term != "nearest_in_cells")
    return replace(
        task,
        summary="navigation_task with the image itself in place of the smallest distance in each of its cells",
        robot="base_quadrotor_with_coarse_camera",
        observations={"policy": state},
        images={"depth": ImageCfg(dtype="uint8")},
        source=f"{task.source}. Camera and image: ours",
    )


task_registry.register_later("pixel_navigation_task", _pixel_navigation)


def _dce_navigation() -> TaskCfg:
    """navigation_task by the latents of an encoder that tells collisions, in the fullest rooms, without noise."""
    task = task_registry.get("navigation_task")
    assert task.curriculum is not None
    seen = tuple(
        replace(entry, noise_std=0.0, scale=0.2 if entry.term == "distance" else 1.0)
        for entry in task.observations["policy"]
    )
    return replace(
        with_encoder(replace(task, observations={"policy": seen}), "collision_40x24"),
        summary="navigation_task among 36 obstacles and more, by 64 latents that tell where the robot would collide",
        robot="base_quadrotor_with_coarse_camera",
        action=replace(task.action, transform="forward_flight_3"),
        curriculum=replace(task.curriculum, min_level=36),
        source=(
            f"{task.source}. Aerial Gym Simulator, commit f0d0f05, DCE example: three actions, level, no noise, a "
            "fifth of the distance; camera and encoder: ours"
        ),
    )


task_registry.register_later("dce_navigation_task", _dce_navigation)


def _radar_navigation() -> TaskCfg:
    """lidar_navigation_task for a vehicle that looks ahead, and whose radar gives no return in most cells.

    So flight backwards is penalised where that task penalises flight ahead.
    """
    task = task_registry.get("lidar_navigation_task")
    unseen = task.rewards["unseen"]
    assert task.curriculum is not None
    seen = tuple(
        replace(entry, dropout=0.8, dropout_value=-1.0) if entry.term == "inverse_nearest" else entry
        for entry in task.observations["policy"]
    )
    return replace(
        task,
        summary="fly through obstacles to a point and a heading; accelerations and yaw rate, 337 observations with a radar",
        env="env_with_obstacles",
        robot="lmf2_radar",
        start=None,
        observations={"policy": seen},
        rewards={**task.rewards, "unseen": replace(unseen, params={**unseen.params, "looks": 1.0})},
        curriculum=replace(task.curriculum, max_level=44),  # there 70, of which 44 exist
        source=(
            f"{task.source}. Aerial Gym Simulator, commit 49598dc, radar_navigation_task: environment, vehicle, start, flight "
            "backwards, and 80 % of cells at -1; there 3 % of cells are too far by up to 10 m as well"
        ),
    )


task_registry.register_later("radar_navigation_task", _radar_navigation)

HOLD_STEPS = 20
"""Steps for which a cell of the radar is held: a share of 0.8^20 = 1 % of the cells is lost for longer [2 s]."""


def _held_radar_navigation() -> TaskCfg:
    """radar_navigation_task with what each cell returned last, for a picture that no single step gives."""
    task = task_registry.get("radar_navigation_task")
    seen = tuple(
        replace(entry, hold_steps=HOLD_STEPS) if entry.dropout else entry for entry in task.observations["policy"]
    )
    return replace(
        task,
        summary="radar_navigation_task where a cell that gives no return shows its last one, for 2 s at most",
        observations={"policy": seen},
        source=f"{task.source}. What is held: ours",
    )


task_registry.register_later("radar_navigation_task_held", _held_radar_navigation)


def _smooth(name: str, *, width: float, velocity: str, weight: float) -> TaskCfg:
    """A task that learners by gradients can follow: its reward has a slope wherever the robot comes to.

    The bells of the others are flat beyond two metres. The distance is worth up to 8, as episodes end beyond 8 m: nobody gains
    by a crash.
    """
    task = task_registry.get(name)
    return replace(
        task,
        summary=f"{task.summary}; with a reward that has a slope everywhere",
        rewards={
            "distance": RewardCfg(term="distance_rounded", params={"offset": 8.0, "scale": 1.0, "width": width}),
            "velocity": RewardCfg(term=velocity, params={"weight": weight}),
            "turning": RewardCfg(term="turning_cost", params={"weight": 0.01}),
        },
        source=f"{name}; weights from trials with trainer apg (docs/results/training.md)",
    )


for _name, _velocity, _width, _weight in (
    ("position_setpoint_task", "speed_cost", 0.05, 0.05),
    ("tracking_task", "velocity_error_cost", 0.2, 0.1),
):
    task_registry.register_later(
        f"smooth_{_name}", partial(_smooth, _name, width=_width, velocity=_velocity, weight=_weight)
    )
