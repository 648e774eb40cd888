"""Environment manager: the order of a step.

``act -> [control -> allocate -> rotors -> effects -> integrate -> ground -> move obstacles -> obstacles push] x K -> collide
-> IMU -> clocks``, then, when the task has seen the result, ``reset by mask -> sense``. Obstacles that do not push move
with the collision test, which follows all K substeps. Letters: E environments, A obstacles, K substeps.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, NoReturn

import torch
from numpy.typing import ArrayLike
from torch import Tensor

from aerial_gym.assets import AssetManager, Bounds
from aerial_gym.assets.cores import body_reach
from aerial_gym.assets.scene import VisibleVehicle
from aerial_gym.config.checks import MAX_COUNT
from aerial_gym.config.controller import ControllerCfg
from aerial_gym.config.environment import EnvironmentCfg
from aerial_gym.config.randomize import Randomize
from aerial_gym.config.robot import RobotCfg
from aerial_gym.config.sim import SimCfg
from aerial_gym.control import CONTROL_LAWS
from aerial_gym.env_manager.collision_tests import make_trajectory
from aerial_gym.env_manager.vehicle_group import VehicleGroup, VehicleKind
from aerial_gym.errors import CapabilityError, ClosedError, ConfigError, ShapeError
from aerial_gym.interop import action_tensor, resolve_device, with_usual_settings
from aerial_gym.math.random import Randomness
from aerial_gym.physics import EFFECTS, ROTOR_MAPS
from aerial_gym.registry import GlobalTensorDictionary, TensorSpec
from aerial_gym.registry.state import (
    add_prefix,
    check_state,
    config_digests,
    copy_tensors,
    describe_own_code,
    restore_tensors,
)
from aerial_gym.robots.differentiable import DifferentiableBackend

if TYPE_CHECKING:
    from aerial_gym.env_manager.vehicles import Vehicles

CLOSED = ("asset_manager", "robot_manager", "sensor_manager", "imus", "vehicles", "_collision", "_group")
"""Attributes that ``EnvManager.close`` drops."""


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
    """A batch of environments: obstacles, vehicles, sensors, and the Global Tensor Dictionary they share."""

    vehicles: "Vehicles | None" = None
    """Several vehicles in each environment; None for one."""

    def __init__(
        self, *, sim: SimCfg, env: EnvironmentCfg, robot: RobotCfg | None = None,
        controller: ControllerCfg | None = None, num_envs: int, device: torch.device, seed: int, first_env: int = 0,
        first_episode: int = 0, differentiable: bool = False, dtype: torch.dtype = torch.float32,
        randomize: Randomize | None = None, kinds: Sequence[VehicleKind] = (),
    ) -> None:  # fmt: skip
        """Build everything; call ``reset`` before the first ``step``. ``SimBuilder.build_env`` documents the arguments.

        Args:
            kinds: Kinds of vehicles, in place of one ``robot`` with its ``controller``.
        """
        if not 1 <= num_envs <= MAX_COUNT:
            raise ConfigError(f"num_envs = {num_envs!r}: must be at least 1, and at most {MAX_COUNT:,}")
        _check_gradients(env, differentiable=differentiable, dtype=dtype)
        if not kinds:
            assert robot is not None
            assert controller is not None
            kinds = (VehicleKind(name="robot", robot=robot, controller=controller),)
        device = resolve_device(device)
        self.cfg, self.sim_cfg, self.num_envs, self.device, self.seed = env, sim, num_envs, device, seed
        self.random = Randomness(num_envs, device=device, seed=seed, first_env=first_env, first_episode=first_episode)
        single = len(kinds) == 1 and kinds[0].count == 1
        if single and env.payload is not None:
            raise ConfigError("payload: several vehicles carry it. Give a single one the effect slung_payload")
        if single and env.network is not None:
            raise ConfigError("network: it joins several vehicles. Give the environment robots, or leave network out")
        sizes = {"E": num_envs, "A": env.num_assets} | ({"R": kinds[0].robot.num_rotors} if single else {})
        self.gtd = GlobalTensorDictionary(device=device, sizes=sizes)
        bounds = self._declare_bounds(root=single)
        self._bounds = Bounds(env, lower=bounds[0], upper=bounds[1], random=self.random)
        self._group: VehicleGroup | None = None
        if single:  # tensors of the vehicles are those of the environments
            robot, batch = kinds[0].robot, {"num_envs": num_envs, "device": device}
            self._group = VehicleGroup(
                kinds[0], self.gtd, random=self.random, state=self.gtd["vec_root_tensor"][:, 0], bounds=bounds,
                trajectory=make_trajectory(env, robot, **batch, differentiable=differentiable),
            )  # fmt: skip
        else:
            from aerial_gym.env_manager.vehicles import Vehicles  # local, as its Warp functions take long

            self.vehicles = Vehicles(kinds, self.gtd, env, random=self.random, randomize=randomize or {}, sim=sim)
        self.asset_manager = self._make_assets(kinds, bounds)
        self._build(randomize or {}, gradients=dtype if differentiable else None)
        identity: dict[str, object] = (
            {} if single else {"vehicles": (env.vehicle_clearance, env.reset_together, env.network, env.payload)}
        )
        for kind in kinds:
            name = "" if single else f"{kind.name} x {kind.count}: "
            identity |= {f"{name}robot": kind.robot, f"{name}controller": kind.controller}
            random = {**kind.robot.randomize, **env.randomize, **(randomize or {})}
            code = _description_of_user_code(kind.robot, kind.controller, random)
            identity |= {f"{name}{key}": value for key, value in code.items()}
        self._identity = config_digests(sim=sim, environment=env, randomize=dict(randomize or {}), **identity)
        self._all = torch.ones(num_envs, dtype=torch.bool, device=device)

    def _make_assets(self, kinds: Sequence[VehicleKind], bounds: tuple[Tensor, Tensor]) -> AssetManager:
        vehicles = self.vehicles
        if vehicles is None:
            assert self._group is not None
            root, robot = self.gtd["vec_root_tensor"], self._group.kind.robot
            seen = VisibleVehicle(parts=robot.visible_parts, links=robot.link_names)
            options: dict[str, Any] = {
                "asset_state": root[:, 1:], "vehicles": [seen], "link_state": self._group.link_state,
            }  # fmt: skip
        else:
            options = {"vehicles": vehicles.visible, "link_state": vehicles.link_state}
        return AssetManager(
            self.cfg, self.gtd, num_envs=self.num_envs, device=self.device, random=self.random, bounds_min=bounds[0],
            bounds_max=bounds[1], robot_radius=max(body_reach(kind.robot.collision.shapes) for kind in kinds), **options,
        )  # fmt: skip

    def _build(self, randomize: Randomize, *, gradients: torch.dtype | None) -> None:
        """Build the physics of the vehicles, and name the parts of a single kind."""
        group = self._group
        if self.vehicles is not None:
            self.vehicles.build(self.sim_cfg, self.asset_manager, gradients=gradients, randomize=randomize)
            if len(self.vehicles.groups) > 1:
                return
            group = self.vehicles.groups[0]
        assert group is not None
        if self._group is not None:
            own = {**group.kind.robot.randomize, **self.cfg.randomize, **randomize}
            group.build(self.sim_cfg, self.cfg, self.asset_manager, gradients=gradients, randomize=own)
            self.asset_manager.set_track_start(self.gtd["robot_position"])
        self.robot_manager, self.sensor_manager, self.imus = group.robot_manager, group.sensor_manager, group.imus
        self._collision = group.collision

    def _declare_bounds(self, *, root: bool) -> tuple[Tensor, Tensor]:
        """Declare the corners of the bounds, with ``root`` the states of one robot and the obstacles before them."""
        if root:
            self.gtd.declare(TensorSpec(
                key="vec_root_tensor", shape=("E", 1 + self.cfg.num_assets, 13), unit="m, -, m/s, rad/s", frame="world",
                owner="physics, assets",
                meaning="position, xyzw, velocity, angular velocity; row 0 is the robot",
            ))  # fmt: skip
        for key, meaning in (("env_bounds_min", "lower corner"), ("env_bounds_max", "upper corner")):
            self.gtd.declare(TensorSpec(key=key, shape=("E", 3), unit="m", frame="world", owner="env", meaning=meaning))
        return self.gtd["env_bounds_min"], self.gtd["env_bounds_max"]

    @property
    def _all_vehicles(self) -> "Vehicles | VehicleGroup":
        """All vehicles."""
        flown = self._group if self.vehicles is None else self.vehicles
        assert flown is not None
        return flown

    @property
    def kinds(self) -> dict[str, VehicleGroup]:
        """The vehicles by kind; ``kinds[name].gtd`` has their tensors (E, V, ...)."""
        groups = [self._group] if self._group is not None else [] if self.vehicles is None else self.vehicles.groups
        return {group.kind.name: group for group in groups}

    @property
    def rows(self) -> VehicleGroup:
        """The vehicles of the only kind, one in each row of a task; raise ``CapabilityError`` if there are several kinds."""
        if len(self.kinds) > 1:
            raise CapabilityError(
                f"task: its rows are vehicles of one kind; here are {', '.join(self.kinds)}. Leave one in the environment"
            )
        return next(iter(self.kinds.values()))

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

    def step(
        self, actions: Tensor | ArrayLike | Mapping[str, Tensor | ArrayLike],
        env_actions: Tensor | ArrayLike | None = None,
    ) -> None:  # fmt: skip
        """Apply an action for one environment step, without resets or sensor readings.

        Args:
            actions: Of the robots, (E, U), a tensor or an array; of several vehicles (E, V, U), of several kinds a mapping
                from their names.
            env_actions: New twists of the obstacles that move by twist: velocity [m/s] and angular velocity [rad/s],
                world, (E, A, 6). Without them obstacles keep the twists they have.
        """
        if self.vehicles is not None:
            self.vehicles.act(actions)
        elif isinstance(actions, Mapping):
            raise ShapeError("actions: a mapping is for several kinds of vehicles. Give a tensor (E, U)")
        else:
            self.robot_manager.act(action_tensor(actions, self.device))
        if env_actions is not None:
            self.asset_manager.take_actions(action_tensor(env_actions, self.device))
        self.fly()
        self.collide()
        self._all_vehicles.refresh(self.dt)

    def fly(self, substeps: int | None = None) -> None:
        """Advance the physics by an environment step, or by ``substeps``, in one launch for each kind of vehicle.

        It tests for ground contact after every substep; obstacles with ``contact`` move and exert forces between the
        substeps. Others move in ``collide``.
        """
        self._all_vehicles.fly(substeps or self.cfg.physics_steps_per_env_step)

    def collide(self) -> None:
        """Measure the clearance and find touches in one launch, while obstacles that do not push back move."""
        self._all_vehicles.collide()

    def episode_ends(self) -> Tensor:
        """Return the mask of crashed and truncated vehicles for ``reset``; see ``reset_together`` of the environment."""
        return self._all_vehicles.episode_ends()

    def restart(self, seed: int) -> None:
        """Reseed all random numbers, as if the simulation were built with this seed; call ``reset`` next."""
        self.seed = seed
        self.random.restart(seed)
        if self.vehicles is not None:
            self.vehicles.restart()
        self.asset_manager.restart()

    def reset(
        self, mask: Tensor | None = None, *, counted: bool = False, place: Callable[[Tensor], None] | None = None
    ) -> None:
        """Reset the environments in ``mask``, bool (E,), or all without a mask. Others stay bit for bit.

        A mask (E, V) resets vehicles of environments that stay as they are; the columns are those of all kinds.
        With ``counted`` the mask is ``rows.random.mask`` and ``rows.random.episode`` already has its new episodes: a task
        writes both in the launch that detects ends. ``place`` may move robots of the mask, after the reset of robots and race
        track.
        """
        if self.vehicles is not None:
            self._reset_vehicles(self._all if mask is None else mask, place, counted=counted)
            return
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
        self._all_vehicles.move_links()
        self.asset_manager.clear_start(mask, self.gtd["robot_position"])
        self.sensor_manager.reset(mask)
        self.imus.reset(mask)
        self._collision.measure()

    def _reset_vehicles(self, mask: Tensor, place: Callable[[Tensor], None] | None, *, counted: bool) -> None:
        """Reset environments (E,), or vehicles (E, V) of environments that stay."""
        vehicles, whole = self.vehicles, mask.dim() == 1
        assert vehicles is not None
        vehicles.check_mask(mask)
        if whole:
            self.random.begin(mask)
            self._bounds.draw(mask)
            if self.cfg.num_assets:
                self.asset_manager.reset(self.random.mask)
        vehicles.begin(mask, counted=counted)
        vehicles.reset(mask)
        if whole:
            self.asset_manager.place_track(self.random.mask)
        if place is not None:
            place(mask)
        if whole:
            self.asset_manager.clear_start(self.random.mask, vehicles.positions)
        vehicles.after_scene()

    def clear_goal(self, mask: Tensor, position: Tensor) -> None:
        """Make room at goals (E, 3) or (E, V, 3) [m], world, of the environments in ``mask``, bool (E,), after a reset."""
        self.asset_manager.clear_goal(mask, position)
        if self.cfg.num_assets:
            self._collision.measure()

    def draws(self) -> dict[str, Tensor]:
        """Return the draws of the present episodes by quantity, (E, ...): factors, offsets or values."""
        return self._all_vehicles.draws()

    def state_tensors(self) -> dict[str, Tensor]:
        """Return everything on which the future depends, by name: tensors that keep their places, and digests."""
        parts = {
            "random": self.random.state_tensors(),
            "gtd": self.gtd.state_tensors(),
        }
        if self.vehicles is not None:
            parts["vehicles"] = self.vehicles.state_tensors()
        tensors = {name: t for prefix, part in parts.items() for name, t in add_prefix(prefix, part).items()}
        return self._identity | tensors | ({} if self._group is None else self._group.state_tensors())

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
        for group in self.kinds.values():
            group.robot_manager.refresh_model()
        restore_tensors(state, self.state_tensors())  # again, for tensors rebuilt above

    def render(self, mask: Tensor | None = None) -> None:
        """Read every range sensor at the states of this instant; with ``mask`` only those of environments, bool (E,), or of
        vehicles, bool (E, V), as in ``reset``."""
        if self.vehicles is None:
            self.sensor_manager.capture(mask)
        else:
            self.vehicles.render(mask)

    def close(self) -> None:
        """Release device memory; a second call does nothing, other methods then raise ``ClosedError``."""
        for name in CLOSED:
            vars(self).pop(name, None)

    def __repr__(self) -> str:
        head = f"EnvManager: {self.num_envs} environments on {self.device}"
        if "asset_manager" not in vars(self):
            return f"{head}, closed"
        lines = [f"{head}, steps of {self.dt:g} s", self.cfg.summary]
        for group in self.kinds.values():
            count = "" if self.vehicles is None else f"{group.kind.count} x {group.kind.name}: "
            lines += [f"{count}{group.kind.robot!r}", f"action: {', '.join(group.robot_manager.action_names)}"]
        return "\n  ".join([*lines, repr(self.gtd)])

    def __getattr__(self, name: str) -> NoReturn:
        """Raise ``ClosedError`` for attributes that ``close`` dropped, and name the place of those of several kinds."""
        if name in ("robot_manager", "sensor_manager", "imus") and vars(self).get("vehicles") is not None:
            raise AttributeError(f"{name}: there are several kinds of vehicles. Take env.kinds[NAME].{name}")
        if name in CLOSED and "gtd" in vars(self):
            raise ClosedError("this simulation is closed. Build a new one")
        raise AttributeError(f"{type(self).__name__!r} object has no attribute {name!r}")
