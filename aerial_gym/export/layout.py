"""Inputs and outputs of an exported policy, entry by entry: the file ``policy.json``.

Letters: O entries of an observation, V of an action, U of a command, M numbers of memory.
"""

import json
import re
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from aerial_gym.config.robot import RobotCfg
from aerial_gym.config.storage import write_atomic
from aerial_gym.config.task_terms import fewest_and_most_steps
from aerial_gym.errors import ConfigError
from aerial_gym.rl_training.policies.policy import Policy
from aerial_gym.rl_training.settings import TrainingCfg
from aerial_gym.task import Task
from aerial_gym.task.images import image_scale

LAYOUT_FILE = "policy.json"  # Beside every exported policy


@dataclass(frozen=True, kw_only=True)
class ObservationTerm:
    """One term of the observation."""

    key: str  # Key of the task's observation to which it belongs
    term: str
    meaning: str  # Meaning with unit and frame
    first: int  # Its first entry in the exported observation
    count: int  # Its entries; those of `history` steps side by side, oldest first
    history: int
    scale: float  # Factor by which the policy multiplies it: the exported one does so itself
    noise_std: float  # Standard deviation of the noise that it was trained with, in the unit of the term
    delay_steps: tuple[int, int]  # Fewest and most steps by which it was late in training
    dropout: float = 0.0  # Probability with which an entry was dropped in training
    dropout_value: float = 0.0  # Value of a dropped entry, in the unit of the term; use it for a missing measurement
    hold_steps: int = 0  # Steps for which a dropped entry held its last value before that: feed it so


@dataclass(frozen=True, kw_only=True)
class ObservationImage:
    """One image of the observation: numbers as the task gives them, (C, H, W)."""

    key: str  # Of the task's observation, and of the input
    meaning: str  # Meaning of a pixel
    shape: tuple[int, int, int]  # Channels, rows, columns; channels are `history` images of each sensor, oldest first
    dtype: str  # `uint8`: `floor(255 share + 0.5)`; `float16`, `float32`: the share itself, 0 to 1
    largest: float  # Value with the share 1, in `unit`; larger ones are clamped
    unit: str
    without: float  # Share of a pixel that has nothing (is negative)
    history: int


@dataclass(frozen=True, kw_only=True)
class LayoutRotor:
    """One rotor of the vehicle."""

    position: tuple[float, float, float]  # Hub from the body origin [m], body axes
    spin: int  # 1: counterclockwise from above; -1: clockwise
    mode: str  # State: `speed` [rad/s] or `force` [N]
    rotor_map: str  # Name of the thrust curve
    thrust_map: tuple[float, float, float]  # Its coefficients: thrust [N] of the state
    thrust_range: tuple[float, float]  # Lowest and highest thrust [N]


@dataclass(frozen=True, kw_only=True)
class Layout:
    """Inputs and outputs of a policy."""

    name: str  # A name that C allows
    task: str
    robot: str
    controller: str
    rate_hz: float  # Rate of the policy in training [1/s]
    observation: tuple[ObservationTerm, ...]  # Terms in order, in their own units, before `scale`
    images: tuple[ObservationImage, ...] = ()  # Images, in the order of the inputs
    command: tuple[str, ...]  # Entries of the controller command, with units
    num_actions: int  # V: entries of the action behind the command, each -1 to 1; fed back where observed
    transform: str  # From action to command (`aerial_gym.task.ACTIONS`)
    params: Mapping[str, Any]  # Numbers of the transform
    action_delay_steps: tuple[int, int]  # Fewest and most steps by which commands were late in training; not exported
    filter_time_s: float  # Time constant of the low pass behind the command in training [s]; not part of the export
    memory: int  # M: numbers that it remembers from step to step, 0 where an episode begins
    source: str  # Checkpoint
    encoder: str | None = None  # Encoder of `image_latents` in the observation, if any; not exported
    settings: tuple[str, ...] = ()  # Changed settings of task, robot, env and sim in training
    rotors: tuple[LayoutRotor, ...] = ()  # Rotors of the vehicle, in the order of its commands
    preflight: Mapping[str, str] | None = None  # Verdict, robot, log and SHA-256 of an `aerial-gym preflight`
    version: str  # Of this package

    @property
    def num_observations(self) -> int:
        """O."""
        return sum(seen.count for seen in self.observation)

    def write(self, folder: Path) -> Path:
        """Write ``policy.json``; return its path."""
        write_atomic(folder / LAYOUT_FILE, json.dumps(asdict(self), indent=2) + "\n")
        return folder / LAYOUT_FILE

    @classmethod
    def read(cls, folder: Path) -> "Layout":
        """Return the layout in the folder of an exported policy.

        Raises:
            ConfigError: If the file is missing or no layout.
        """
        try:
            spec = json.loads((folder / LAYOUT_FILE).read_text(encoding="utf-8"))
            seen = tuple(
                ObservationTerm(**each | {"delay_steps": tuple(each["delay_steps"])}) for each in spec["observation"]
            )
            images = [ObservationImage(**each | {"shape": tuple(each["shape"])}) for each in spec.get("images", ())]
            more = {"images": tuple(images), "command": tuple(spec["command"])}
            rotors: list[dict[str, Any]] = spec.get("rotors", [])
            for each in rotors:
                each.update({key: tuple(each[key]) for key in ("position", "thrust_map", "thrust_range")})
            more["rotors"] = tuple(LayoutRotor(**each) for each in rotors)
            more |= {
                "settings": tuple(spec.get("settings", ())),
                "action_delay_steps": tuple(spec["action_delay_steps"]),
            }
            return cls(**spec | {"observation": seen} | more)
        except FileNotFoundError:
            raise ConfigError(f"{folder}: no {LAYOUT_FILE} in it. Make it with aerial-gym export") from None
        except (KeyError, TypeError, ValueError) as error:
            raise ConfigError(f"{folder / LAYOUT_FILE}: is no layout of a policy ({error}). Export it again") from None


def policy_layout(policy: Policy, cfg: TrainingCfg, task: Task, *, name: str, source: str) -> Layout:
    """Return the layout of a policy that flies a task."""
    from aerial_gym import __version__

    if not re.fullmatch(r"[A-Za-z_][A-Za-z0-9_]*", name):
        raise ConfigError(f"name {name!r}: C allows letters, digits and _, no digit first")
    learners = [one for one in (cfg.ppo, cfg.apg, cfg.distill) if one is not None]
    if sets := [key for one in learners for key in one.sets if key in policy.shapes]:
        raise ConfigError(f"policy of {cfg.task}: attends to {', '.join(sets)} (sets), which export cannot write")
    seen: list[ObservationTerm] = []
    first = 0
    images = tuple(_image_description(key, shape, task) for key, shape in policy.shapes.items() if len(shape) == 3)
    if len(images) == len(policy.shapes):
        raise ConfigError(
            f"policy of {cfg.task}: sees nothing but {', '.join(policy.shapes)}; what is exported takes a vector as well. "
            "Let it see observations too (policy_keys)"
        )
    for key, shape in policy.shapes.items():
        if len(shape) == 3:
            continue
        for entry in task.observation_terms[key]:
            count = entry.width * entry.cfg.history
            seen.append(
                ObservationTerm(
                    key=key, term=entry.cfg.term, meaning=_meaning_of_term(entry.term.term.summary), first=first,
                    count=count, history=entry.cfg.history, scale=entry.cfg.scale, noise_std=entry.cfg.noise_std,
                    delay_steps=fewest_and_most_steps(entry.cfg.delay_steps), dropout=entry.cfg.dropout,
                    dropout_value=entry.cfg.dropout_value, hold_steps=entry.cfg.hold_steps,
                )
            )  # fmt: skip
            first += count
    action = task.cfg.action
    manager = task.env.robot_manager
    return Layout(
        name=name, task=cfg.task, robot=cfg.robot or task.cfg.robot, controller=cfg.controller or task.cfg.controller,
        rate_hz=1.0 / task.env.dt, observation=tuple(seen), images=images, command=tuple(manager.action_names),
        num_actions=policy.num_actions, transform=action.transform, params=dict(action.params),
        action_delay_steps=fewest_and_most_steps(action.delay_steps), filter_time_s=action.filter_time_s,
        memory=policy.body.memory_size, source=source, encoder=cfg.encoder or task.cfg.encoder,
        settings=cfg.settings, rotors=layout_rotors(manager.cfg), version=__version__,
    )  # fmt: skip


def layout_rotors(robot: RobotCfg) -> tuple[LayoutRotor, ...]:
    """Return the rotors of a robot."""
    pairs = zip(robot.mounts.layout, robot.rotor_types, strict=True)
    return tuple(
        LayoutRotor(
            position=mount.position, spin=mount.spin, mode=rotor.mode, rotor_map=rotor.rotor_map,
            thrust_map=rotor.thrust_coefficients, thrust_range=rotor.thrust_range,
        )
        for mount, rotor in pairs
    )  # fmt: skip


def _image_description(key: str, shape: tuple[int, ...], task: Task) -> ObservationImage:
    """Return the description of an image observation."""
    cfg = task.cfg.images[key]
    spec = task.env.gtd.spec(cfg.key)
    largest, without = image_scale(task.env.gtd[cfg.key], cfg, task.env.sensor_manager)
    return ObservationImage(
        key=key, meaning=spec.meaning, shape=(shape[0], shape[1], shape[2]), dtype=cfg.dtype, largest=largest,
        unit=spec.unit, without=without, history=cfg.history,
    )  # fmt: skip


def _meaning_of_term(summary: str) -> str:
    """Return a term's summary without batch dimensions."""
    return re.sub(r",? \(E, [^)]*\)", "", summary).removeprefix("Return ").rstrip(".")
