"""Construction of a simulation from registered names or files."""

import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from math import inf
from pathlib import Path
from typing import Any

import torch

from aerial_gym.assets import ENVIRONMENTS
from aerial_gym.config import build
from aerial_gym.config.checks import MAX_COUNT
from aerial_gym.config.controller import ControllerCfg
from aerial_gym.config.environment import EnvironmentCfg, load_environment
from aerial_gym.config.randomize import Randomize
from aerial_gym.config.robot import RobotCfg
from aerial_gym.config.sim import SimCfg
from aerial_gym.config.vehicles import VehiclesCfg
from aerial_gym.control import CONTROLLERS
from aerial_gym.env_manager.catalog import FIRMWARES, SIMS
from aerial_gym.env_manager.env_manager import EnvManager
from aerial_gym.env_manager.vehicle_group import VehicleKind
from aerial_gym.errors import AerialGymError, CapabilityError, ConfigError, UnknownNameError, suggest_name
from aerial_gym.interop import resolve_device, with_usual_settings
from aerial_gym.robots.catalog import robot_by_name

OUT_OF_MEMORY = ("allocate memory", "out of memory", "not enough memory", "overflow", "Failed to allocate", "too large")
"""Parts of out-of-memory messages of torch and Warp."""

LEAST_BYTES = 100  # Of an environment without anything around it: pose, twist, four rotors and a target take more


def environment_by_name(name: str | Path | EnvironmentCfg) -> EnvironmentCfg:
    """Return a registered environment, or the one in a file if ``name`` ends in ``.yaml``; configurations pass unchanged."""
    if isinstance(name, EnvironmentCfg):
        return name
    if str(name).endswith((".yaml", ".yml")):
        return load_environment(name)
    return ENVIRONMENTS.get(str(name))


def firmware_by_name(name: str) -> type[EnvManager]:
    """Return the environments that a firmware flies; raise ``UnknownNameError`` if there is none of that name."""
    if name not in FIRMWARES:
        raise UnknownNameError(f"no firmware {name!r}.{suggest_name(name, FIRMWARES)} Known: {', '.join(FIRMWARES)}")
    return FIRMWARES[name].load()


@contextmanager
def explain_memory_errors(num_envs: int, device: torch.device) -> Iterator[None]:
    """Convert out-of-memory errors into a ``CapabilityError``, and that of a singular matrix into a ``ConfigError``."""
    too_large = f"{num_envs:,} environments do not fit in the memory of {device} ({{}}). Take fewer, or smaller images"
    held = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") if hasattr(os, "sysconf") else inf
    if device.type == "cpu" and held < num_envs * LEAST_BYTES <= MAX_COUNT * LEAST_BYTES:  # filling it takes a minute
        raise CapabilityError(too_large.format(f"of {held / 2**30:.0f} GiB"))
    try:
        yield
    except torch.linalg.LinAlgError:  # pyright: ignore[reportPrivateImportUsage]
        raise ConfigError("the robot's numbers are too far apart to be computed with in float32") from None
    except (MemoryError, OverflowError):
        reason = "it is larger than can be counted"
    except RuntimeError as error:
        text = str(error)
        if isinstance(error, AerialGymError) or not any(sign in text for sign in OUT_OF_MEMORY):
            raise
        reason = " ".join(text.split())[:160]
    else:
        return
    raise CapabilityError(too_large.format(reason))


def vehicle_kinds(
    robots: Sequence[VehiclesCfg | Mapping[str, Any]], robot: str | Path | RobotCfg | None,
    controller: str | ControllerCfg | None,
) -> tuple[VehicleKind, ...]:  # fmt: skip
    """Return the kinds of vehicles of ``robots``, or the one of ``robot`` without any.

    Raises:
        ConfigError: If both or neither are given, or a field is wrong.
    """
    if bool(robots) == (robot is not None):
        raise ConfigError(
            "give either robot_name, or robots: [{name: ..., count: ...}] here or in the environment file"
        )
    entries = [{"name": robot}] if robot is not None else robots
    return tuple(_vehicle_kind(entry, number, controller) for number, entry in enumerate(entries, 1))


def _vehicle_kind(
    entry: VehiclesCfg | Mapping[str, Any], number: int, default: str | ControllerCfg | None
) -> VehicleKind:
    """Return the kind of vehicles of one entry."""
    given: Mapping[str, Any] = vars(entry) if isinstance(entry, VehiclesCfg) else entry
    if not isinstance(given, Mapping):
        raise ConfigError(f"robots, entry {number}: found {given!r}, expected {{name: ..., count: ...}}")
    robot, law = given.get("name", ""), given.get("controller") or default
    texts = {key: value for key, value in given.items() if key not in ("name", "controller")}
    named = "robot" if isinstance(robot, RobotCfg) else str(robot)
    cfg = build(VehiclesCfg, {"name": named} | texts, where=f"robots, entry {number}")
    if law is None:
        raise ConfigError(f"robots, entry {number}: give a controller, there or as controller_name")
    name = cfg.kind or (Path(named).stem if named.endswith((".yaml", ".yml")) else named)
    return VehicleKind(
        name=name, robot=robot_by_name(robot), count=cfg.count,
        controller=law if isinstance(law, ControllerCfg) else CONTROLLERS.get(str(law)),
    )  # fmt: skip


@with_usual_settings
class SimBuilder:
    """Builds an ``EnvManager`` from names, or from configurations."""

    def build_env(
        self, *, sim_name: str | SimCfg, env_name: str | Path | EnvironmentCfg,
        robot_name: str | Path | RobotCfg | None = None, controller_name: str | ControllerCfg | None = None,
        num_envs: int, device: str | torch.device = "auto", seed: int = 0, first_env: int = 0, first_episode: int = 0,
        backend: str | None = None, differentiable: bool = False, dtype: torch.dtype = torch.float32,
        randomize: Randomize | None = None, firmware: str | None = None,
        robots: Sequence[VehiclesCfg | Mapping[str, Any]] | None = None,
    ) -> EnvManager:  # fmt: skip
        """Return a simulation, built and not yet reset. Unregistered configurations can replace names.

        Args:
            env_name: Registered environment, or path of an environment file; see ``EnvironmentCfg`` for its fields.
            robot_name: Registered robot, or path of a robot file (``close-loop`` writes such files); one vehicle for each
                environment.
            controller_name: Registered controller, also of ``robots`` that name none.
            device: Torch device; ``auto`` takes the GPU if there is one.
            first_env: Number of the first environment. What is drawn for an environment depends on the seed, its number and its
                episode alone: ``num_envs=1, first_env=17`` flies environment 17 of any larger batch with that seed.
            first_episode: Number of the first episode, likewise.
            backend: Registered physics backend in place of the sim's own; ``auto`` takes the fastest.
            differentiable: Whether gradients flow from actions through ``step`` to the states in ``env.gradient_tensors``;
                on backend ``torch``. ``env.detach()`` ends them.
            dtype: Float type of those states; the GTD shows them in float32.
            randomize: Quantities drawn at resets, by name, in addition to those of robot and environment; the same names
                replace it.
            firmware: Firmware that flies the vehicles in place of the controller here: ``betaflight``, where the controller
                takes body rates, or ``crazyflie``, where it takes positions.
            robots: Vehicles of each environment in place of ``robot_name`` and of those in the environment file, such as
                ``[{"name": "lmf2", "count": 3}]``; see ``VehiclesCfg`` for the fields. ``name`` and ``controller`` may be
                configurations.

        Raises:
            UnknownNameError: If a name is not registered; the message lists the registered ones.
            ConfigError: If a number is impossible.
            CapabilityError: If the backend cannot do what is asked, with the name of one that can, or it does not
                fit into memory.
        """
        sim = sim_name if isinstance(sim_name, SimCfg) else SIMS.get(sim_name)
        where = resolve_device(device)
        with explain_memory_errors(num_envs, where):
            env = environment_by_name(env_name)
            kinds = vehicle_kinds(robots if robots is not None else env.robots, robot_name, controller_name)
            if firmware is not None and sum(kind.count for kind in kinds) > 1:
                raise ConfigError(f"firmware = {firmware!r}: one vehicle for each environment only. Leave robots out")
            make = EnvManager if firmware is None else firmware_by_name(firmware)
            flown: dict[str, Any] = {"kinds": kinds}
            if firmware is not None:
                flown = {"robot": kinds[0].robot, "controller": kinds[0].controller}
            return make(
                sim=sim if backend is None else replace(sim, backend=backend),
                env=env,
                **flown,
                num_envs=num_envs,
                device=where,
                seed=seed,
                first_env=first_env,
                first_episode=first_episode,
                differentiable=differentiable,
                dtype=dtype,
                randomize=randomize,
            )
