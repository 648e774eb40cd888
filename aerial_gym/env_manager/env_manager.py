"""Environment manager: the order of a step.

``act -> [control -> allocate -> rotors -> effects -> integrate -> ground -> move obstacles -> obstacles push] x K -> collide
-> IMU -> clocks``, then, when the task has seen the result, ``reset by mask -> sense``. Obstacles that do not push move
with the collision test, which follows all K substeps. Letters: E environments, A obstacles, K substeps.
"""

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any, NoReturn

import torch
from numpy.typing import ArrayLike
from torch import Tensor

from aerial_gym.assets import AssetManager, Bounds
from aerial_gym.assets.cores import body_reach
from aerial_gym.config.checks import MAX_COUNT
from aerial_gym.config.controller import ControllerCfg
from aerial_gym.config.environment import EnvironmentCfg
from aerial_gym.config.randomize import Randomize
from aerial_gym.config.robot import RobotCfg
from aerial_gym.config.sim import SimCfg
from aerial_gym.control import CONTROL_LAWS, CONTROLLERS, check_closed_loop
from aerial_gym.control.upside_down import check_starts
from aerial_gym.env_manager.collision_tests import CollisionTests, make_trajectory
from aerial_gym.errors import ClosedError, ConfigError
from aerial_gym.interop import action_tensor, resolve_device, with_usual_settings
from aerial_gym.math.random import Randomness
from aerial_gym.physics import EFFECTS, ROTOR_MAPS
from aerial_gym.physics.state import ArticulatedState
from aerial_gym.registry import GlobalTensorDictionary, Registry, TensorSpec
from aerial_gym.registry.state import (
    add_prefix,
    check_state,
    config_digests,
    copy_tensors,
    describe_own_code,
    restore_tensors,
)
from aerial_gym.robots import ROBOTS, RobotManager, Surroundings
from aerial_gym.robots.differentiable import DifferentiableBackend
from aerial_gym.robots.joints.link_tensors import declare_links
from aerial_gym.robots.range_warnings import report_range_faults
from aerial_gym.sensors import ImuSet, SensorManager, mounted_sensors
from aerial_gym.sensors.mounts import Carrier

if TYPE_CHECKING:
    from aerial_gym.assets.height_probe import HeightProbe
    from aerial_gym.robots.joints.links import LinkPlaces


def _registry_name(registry: Registry[Any], entry: RobotCfg | ControllerCfg) -> str:
    """Return a configuration's registered name, else its summary."""
    return next((repr(name) for name in registry if registry.get(name) is entry), repr(entry.summary))


def _description_of_user_code(robot: RobotCfg, controller: ControllerCfg, random: Randomize) -> dict[str, object]:
    """Return the description of a user's effects, rotor map and law, ``own_code``; empty without any."""
    effects = {*robot.effects, *(name.split(".")[1] for name in random if name.startswith("effects."))}
    entries: dict[str, object] = {f"effect {name}": EFFECTS.get(name) for name in sorted(effects)}
    entries |= {f"rotor map {name}": ROTOR_MAPS.get(name) for name in {rotor.rotor_map for rotor in robot.rotor_types}}
    if controller.law in CONTROL_LAWS:
        entries[f"law {controller.law}"] = CONTROL_LAWS.get(controller.law)
    code = describe_own_code(entries)
    return {"own_code": code} if code else {}


def _check_gradients(env: EnvironmentCfg, *, differentiable: bool, dtype: torch.dtype) -> None:
    if not differentiable and dtype != torch.float32:
        raise ConfigError(
            f"dtype = {dtype}: the GTD is float32. Give differentiable=True, and read the states in env.gradient_tensors"
        )
    if differentiable and env.num_assets and env.contact is not None:
        raise ConfigError(
            "differentiable=True: the push of obstacles has no gradient. Leave contact out of the environment, or its obstacles"
        )


@with_usual_settings
class EnvManager:
    """A batch of environments: obstacles, one robot each, sensors, and the Global Tensor Dictionary they share."""

    def __init__(
        self, *, sim: SimCfg, env: EnvironmentCfg, robot: RobotCfg, controller: ControllerCfg, num_envs: int,
        device: torch.device, seed: int, first_env: int = 0, first_episode: int = 0, differentiable: bool = False,
        dtype: torch.dtype = torch.float32, randomize: Randomize | None = None,
    ) -> None:  # fmt: skip
        """Build everything; call ``reset`` before the first ``step``. ``SimBuilder.build_env`` documents the arguments."""
        if not 1 <= num_envs <= MAX_COUNT:
            raise ConfigError(f"num_envs = {num_envs!r}: must be at least 1, and at most {MAX_COUNT:,}")
        _check_gradients(env, differentiable=differentiable, dtype=dtype)
        device = resolve_device(device)
        self.cfg, self.sim_cfg, self.num_envs, self.device, self.seed = env, sim, num_envs, device, seed
        self.random = Randomness(num_envs, device=device, seed=seed, first_env=first_env, first_episode=first_episode)
        sizes = {"E": num_envs, "A": env.num_assets, "R": robot.num_rotors}
        self.gtd = GlobalTensorDictionary(device=device, sizes=sizes)
        self._declare(env.num_assets)
        links = None if robot.joints is None else declare_links(self.gtd, robot.joints)
        root, bounds = self.gtd["vec_root_tensor"], (self.gtd["env_bounds_min"], self.gtd["env_bounds_max"])
        self._bounds = Bounds(env, lower=bounds[0], upper=bounds[1], random=self.random)
        self.asset_manager = AssetManager(
            env, self.gtd, num_envs=num_envs, device=device, random=self.random, bounds_min=bounds[0],
            bounds_max=bounds[1], asset_state=root[:, 1:], robot_radius=body_reach(robot.collision.shapes),
            robot_parts=robot.visible_parts, robot_state=root[:, 0] if links is None else links.state,
            robot_links=robot.link_names,
        )  # fmt: skip
        random = {**robot.randomize, **env.randomize, **(randomize or {})}
        places = {name: each for name, each in random.items() if name.startswith("sensors.")}
        names = (_registry_name(ROBOTS, robot), _registry_name(CONTROLLERS, controller))
        for check in (check_closed_loop, report_range_faults):
            check(
                robot, controller, gravity=sim.gravity, dt=sim.dt, integrator=sim.integrator, names=names,
                randomize=random,
            )  # fmt: skip
        check_starts(robot, controller, gravity=sim.gravity, dt=sim.dt, names=names)
        scene = self.asset_manager.scene
        trajectory = make_trajectory(env, robot, num_envs=num_envs, device=device, differentiable=differentiable)
        around = Surroundings(
            bounds=bounds, crashes=self.gtd["crashes"], ground_height=env.ground_height,
            ceiling_height=env.ceiling_height, contact=env.contact, scene=scene, moving=self.asset_manager.moving,
            links=links, hook=trajectory,
        )  # fmt: skip
        self.robot_manager = RobotManager(
            robot,
            controller,
            sim,
            self.gtd,
            around,
            root_state=root[:, 0],
            random=self.random,
            gradients=dtype if differentiable else None,
            randomize={name: each for name, each in random.items() if name not in places},
        )
        self._links: LinkPlaces | None = None
        if robot.joints is not None and links is not None:
            assert isinstance(self.robot_manager.tensors.state, ArticulatedState)
            self._links = links.make_launches(robot.joints, self.robot_manager.tensors.state, trajectory)
        surface = self.robot_manager.felt.surface_height
        self._below: HeightProbe | None = None
        if surface is not None:
            self._below = self.asset_manager.make_height_probe(self.gtd["robot_position"], height_out=surface)
        self.asset_manager.set_track_start(self.gtd["robot_position"])
        keys = ("robot_position", "robot_orientation", "robot_linvel", "robot_body_angvel")
        position, attitude, lin_vel, ang_vel = (self.gtd[key] for key in keys)
        body = Carrier(position=position, attitude=attitude, lin_vel=lin_vel, ang_vel=ang_vel)
        range_sensors, imus = mounted_sensors(robot.sensor_mounts, places)
        carriers = {} if links is None else links.link_of_sensors({**range_sensors, **imus})
        self.sensor_manager = SensorManager(
            {name: mounted.cfg for name, mounted in range_sensors.items()},
            self.gtd,
            scene,
            body,
            num_envs=num_envs,
            device=device,
            dt=self.dt,
            random=self.random,
            poses={name: mounted.pose for name, mounted in range_sensors.items()},
            carriers=carriers,
        )
        self.imus = ImuSet(
            imus, self.gtd, body, dt=self.dt, gravity=sim.gravity, random=self.random,
            errors=self.robot_manager.imu_errors, carriers=carriers,
        )  # fmt: skip
        self._move_links()
        self._collision = CollisionTests(
            robot, self.gtd, self.asset_manager, links=links, places=self._links, trajectory=trajectory, dt=sim.dt
        )
        self._identity = config_digests(
            sim=sim, environment=env, robot=robot, controller=controller, randomize=dict(randomize or {}),
            **_description_of_user_code(robot, controller, random),
        )  # fmt: skip
        self._all = torch.ones(num_envs, dtype=torch.bool, device=device)

    def _declare(self, num_assets: int) -> None:
        declare = self.gtd.declare
        declare(TensorSpec(
            key="vec_root_tensor", shape=("E", 1 + num_assets, 13), unit="m, -, m/s, rad/s", frame="world",
            owner="physics, assets", meaning="position, xyzw, velocity, angular velocity; row 0 is the robot",
        ))  # fmt: skip
        for key, meaning in (("env_bounds_min", "lower corner"), ("env_bounds_max", "upper corner")):
            declare(TensorSpec(key=key, shape=("E", 3), unit="m", frame="world", owner="env", meaning=meaning))
        declare(TensorSpec(
            key="robot_clearance", shape=("E",), unit="m", frame="-", owner="env",
            meaning="signed distance of the robot's collision shapes to obstacles and ground; inf where there is nothing",
        ))  # fmt: skip
        declare(TensorSpec(
            key="episodes", shape=("E",), dtype=torch.int32, unit="-", frame="-", owner="env",
            meaning="number of the present episode, from 0 on; -1 before the first reset",
        ), view=self.random.episode)  # fmt: skip
        for key, dtype, meaning in (
            (
                "crashes",
                torch.bool,
                "the robot touched something in this step (see contact), or the task calls it crashed",
            ),
            ("truncations", torch.bool, "the task ends the episode without a crash"),
            ("sim_steps", torch.int32, "environment steps since the last reset"),
            (
                "non_finite",
                torch.int32,
                "what was NaN or infinite in this step: 1 action, 2 state, 4 reward, 8 observation; such a row is a crash",
            ),
        ):
            declare(
                TensorSpec(key=key, shape=("E",), dtype=dtype, unit="-", frame="-", owner="env, task", meaning=meaning)
            )

    @property
    def gradient_tensors(self) -> Mapping[str, Tensor]:
        """The robots' motion and actions of this instant by the keys of the GTD, with gradients; of a ``differentiable`` one.

        The tensors are never overwritten, so that a loss may hold those of many steps. The GTD has float32 copies.
        """
        return self._gradient_backend().gradient_tensors

    def detach(self) -> None:
        """Cut the gradients at this instant: later losses are differentiated back to here, and no further."""
        self._gradient_backend().detach()

    def detach_in_place(self) -> None:
        """Detach in tensors that keep their memory, so that a later CUDA graph can be replayed from here.

        Earlier losses must have been differentiated already.
        """
        self._gradient_backend().detach_in_place()

    def _gradient_backend(self) -> DifferentiableBackend:
        simulation = self.robot_manager.differentiable
        if simulation is None:
            raise ConfigError("this simulation has no gradients: build it with differentiable=True")
        return simulation

    @property
    def dt(self) -> float:
        """Length of an environment step [s]."""
        return self.sim_cfg.dt * self.cfg.physics_steps_per_env_step

    def step(self, actions: Tensor | ArrayLike, env_actions: Tensor | ArrayLike | None = None) -> None:
        """Apply an action for one environment step, without resets or sensor readings.

        Args:
            actions: Of the robots, (E, U), a tensor or an array.
            env_actions: New twists of the obstacles that move by twist: velocity [m/s] and angular velocity [rad/s],
                world, (E, A, 6). Without them obstacles keep the twists they have.
        """
        self.robot_manager.act(action_tensor(actions, self.device))
        if env_actions is not None:
            self.asset_manager.take_actions(action_tensor(env_actions, self.device))
        self.fly()
        self.collide()
        self.robot_manager.refresh(self.dt)
        self.imus.measure()

    def fly(self, substeps: int | None = None) -> None:
        """Advance the physics by an environment step, or by ``substeps``, in one launch.

        It tests for ground contact after every substep; obstacles with ``contact`` move and exert forces between the
        substeps. Others move in ``collide``.
        """
        if self._below is not None:
            self._below.measure_heights()
        self.robot_manager.advance(substeps or self.cfg.physics_steps_per_env_step)
        self._move_links()
        if self._links is not None and self._links.trajectory is not None:
            self._links.trajectory.refresh()

    def _move_links(self) -> None:
        if self._links is not None:
            self._links.refresh()

    def collide(self) -> None:
        """Measure the clearance and find touches in one launch, while obstacles that do not push back move."""
        self._collision.step()

    def restart(self, seed: int) -> None:
        """Reseed all random numbers, as if the simulation were built with this seed; call ``reset`` next."""
        self.seed = seed
        self.random.restart(seed)
        self.asset_manager.restart()

    def reset(
        self, mask: Tensor | None = None, *, counted: bool = False, place: Callable[[Tensor], None] | None = None
    ) -> None:
        """Reset the environments in ``mask``, bool (E,), or all without a mask. Others stay bit for bit.

        With ``counted`` the mask is ``random.mask`` and ``random.episode`` already has its new episodes: a task writes both
        in the launch that detects ends. ``place`` may move robots of the mask, after the reset of robots and race track.
        """
        all_rows = mask is None
        if not counted:
            self.random.begin(self._all if mask is None else mask)
        mask = self.random.mask
        self._bounds.draw(mask)
        if self.cfg.num_assets:
            self.asset_manager.reset(mask)
        self.robot_manager.reset(mask)
        if all_rows and self.robot_manager.differentiable is not None:
            self.detach()  # all rows restart
        self.asset_manager.place_track(mask)
        if place is not None:
            place(mask)
        self._move_links()
        self.asset_manager.clear_start(mask, self.gtd["robot_position"])
        self.sensor_manager.reset(mask)
        self.imus.reset(mask)
        self._collision.measure()

    def clear_goal(self, mask: Tensor, position: Tensor) -> None:
        """Make room for a robot at a goal (E, 3) [m], world, of the environments in ``mask``, bool (E,), after a reset."""
        self.asset_manager.clear_goal(mask, position)
        if self.cfg.num_assets:
            self._collision.measure()

    def draws(self) -> dict[str, Tensor]:
        """Return the draws of the present episodes by quantity, (E, ...): factors, offsets or values."""
        return self.robot_manager.draws() | self.sensor_manager.draws() | self.imus.draws()

    def state_tensors(self) -> dict[str, Tensor]:
        """Return everything on which the future depends, by name: tensors that keep their places, and digests."""
        parts = {
            "random": self.random.state_tensors(),
            "gtd": self.gtd.state_tensors(),
            "robot": self.robot_manager.state_tensors(),
            "sensors": self.sensor_manager.state_tensors(),
            "imus": self.imus.state_tensors(),
        }
        return self._identity | {
            name: t for prefix, part in parts.items() for name, t in add_prefix(prefix, part).items()
        }

    def save_state(self) -> dict[str, Tensor]:
        """Return a copy of everything on which the future depends: after ``load_state`` the flight is the same, bit for bit.

        ``torch.save`` writes it; ``torch.load(path, weights_only=True)`` reads it.
        """
        return copy_tensors(self.state_tensors())

    def load_state(self, state: Mapping[str, Tensor]) -> None:
        """Restore a state saved by this or an equal simulation; raise ``ConfigError`` for another one. Waits for the device."""
        check_state(state, self.state_tensors())
        self.restore(state)

    def restore(self, state: Mapping[str, Tensor]) -> None:
        """Restore a checked state, which may hold further tensors."""
        for name, tensor in self.random.state_tensors().items():
            tensor.copy_(state[f"random.{name}"])
        self.seed = int(self.random.seed)
        self.asset_manager.draw_kinds()
        restore_tensors(state, self.state_tensors())
        self.robot_manager.refresh_model()
        restore_tensors(state, self.state_tensors())  # again, for tensors rebuilt above

    def render(self, mask: Tensor | None = None) -> None:
        """Read every sensor at the states of this instant; those of the environments in ``mask``, bool (E,), alone if given."""
        self.sensor_manager.capture(mask)

    def close(self) -> None:
        """Release device memory; a second call does nothing, other methods then raise ``ClosedError``."""
        for name in ("asset_manager", "robot_manager", "sensor_manager", "_collision"):
            vars(self).pop(name, None)

    def __repr__(self) -> str:
        head = f"EnvManager: {self.num_envs} environments on {self.device}"
        if "robot_manager" not in vars(self):
            return f"{head}, closed"
        action = f"action: {', '.join(self.robot_manager.action_names)}"
        lines = (
            f"{head}, steps of {self.dt:g} s",
            self.cfg.summary,
            repr(self.robot_manager.cfg),
            action,
            repr(self.gtd),
        )
        return "\n  ".join(lines)

    def __getattr__(self, name: str) -> NoReturn:
        """Raise ``ClosedError`` for attributes that ``close`` dropped."""
        if name in ("asset_manager", "robot_manager", "sensor_manager", "_collision") and "gtd" in vars(self):
            raise ClosedError("this simulation is closed. Build a new one")
        raise AttributeError(f"{type(self).__name__!r} object has no attribute {name!r}")
