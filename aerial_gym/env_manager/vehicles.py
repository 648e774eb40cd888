"""All vehicles of a simulation: one group for each kind, their mutual collisions, and their starts.

Letters: E environments, T vehicles of an environment over all kinds, V those of one kind, B = E V bodies of a kind, N = E T
rows over all kinds, kind by kind, K substeps.
"""

from collections.abc import Mapping, Sequence
from math import inf

import torch
from numpy.typing import ArrayLike
from torch import Tensor

from aerial_gym.assets import AssetManager
from aerial_gym.assets.scene import VisibleVehicle
from aerial_gym.assets.vehicle_collision import SlotTable, VehicleCollisionTest
from aerial_gym.config.environment import EnvironmentCfg
from aerial_gym.config.randomize import Randomize
from aerial_gym.config.sim import SimCfg
from aerial_gym.config.vehicles import MOST_CARRIERS, PayloadCfg
from aerial_gym.env_manager.vehicle_group import VehicleGroup, VehicleKind
from aerial_gym.env_manager.vehicle_starts import VehicleStarts
from aerial_gym.errors import ConfigError, ShapeError
from aerial_gym.interop import action_tensor
from aerial_gym.math.random import Randomness
from aerial_gym.physics import EFFECTS, Trajectory
from aerial_gym.physics.effects import FluidEffect, LoadEffect
from aerial_gym.registry import GlobalTensorDictionary, TensorSpec
from aerial_gym.registry.state import add_prefix
from aerial_gym.robots.groups.payload import PayloadOnCables
from aerial_gym.robots.groups.wakes import make_wakes
from aerial_gym.sensors.mounts import OwnLinks
from aerial_gym.sensors.vehicle_network import VehicleNetwork

Actions = Tensor | ArrayLike


class Vehicles:
    """Several vehicles in every environment."""

    def __init__(
        self, kinds: Sequence[VehicleKind], gtd: GlobalTensorDictionary, env: EnvironmentCfg, *, random: Randomness,
        randomize: Randomize, sim: SimCfg,
    ) -> None:  # fmt: skip
        """Allocate the tensors of all kinds; ``build`` adds the physics once the scene exists."""
        check_kinds(kinds, env, randomize, sim)
        self._env, self._gtd, self._num_envs, self._random = env, gtd, random.num_envs, random
        device, num_envs = gtd.device, random.num_envs
        self.slots = SlotTable(
            collisions=[kind.robot.collision for kind in kinds], counts=[kind.count for kind in kinds],
            num_envs=num_envs,
        )  # fmt: skip
        total = self.slots.first_slot(len(kinds))
        self.states = torch.zeros(num_envs * total, 13, device=device)
        """Position, attitude, velocity and angular velocity of all vehicles, world, (N, 13)."""
        self._clearances = torch.full((num_envs * total,), inf, device=device)
        self._crashes, self._touches = torch.zeros(2, num_envs * total, dtype=torch.bool, device=device)
        self._followed = Trajectory.zeros(env.physics_steps_per_env_step, num_envs * total, device=device)
        self._bounds = gtd["env_bounds_min"], gtd["env_bounds_max"]
        self._starts = torch.zeros(num_envs, total, dtype=torch.bool, device=device)
        self._environments_stay = torch.zeros(num_envs, dtype=torch.bool, device=device)
        self.groups = [self._make_group(number, kind, total) for number, kind in enumerate(kinds)]
        self.visible = [
            VisibleVehicle(parts=kind.robot.appearance, links=kind.robot.link_names)
            for kind in kinds for _ in range(kind.count)
        ]  # fmt: skip
        """All vehicles of an environment as sensors see them."""
        self._link_states = [group.link_state.view(num_envs, -1, 13) for group in self.groups]
        self.link_state = self._link_states[0] if len(kinds) == 1 else torch.cat(self._link_states, dim=1)
        """States of their links, (E, L, 13), as ``render`` leaves them: position [m], xyzw, velocities, world."""

    def _make_group(self, number: int, kind: VehicleKind, total: int) -> VehicleGroup:
        gtd, rows, count = self._gtd, self.slots.rows(number), kind.count
        size = rows.stop - rows.start
        sizes = {"E": size, "A": self._env.num_assets, "R": kind.robot.num_rotors}
        bodies = GlobalTensorDictionary(device=gtd.device, sizes=sizes)
        corners = (torch.zeros(size, 3, device=gtd.device), torch.zeros(size, 3, device=gtd.device))
        group = VehicleGroup(
            kind, bodies, random=self._random.of_bodies(count, first=self.slots.first_slot(number), total=total),
            state=self.states[rows], bounds=corners,
            trajectory=Trajectory(position=self._followed.position[:, rows], attitude=self._followed.attitude[:, rows]),
            crashes=self._crashes[rows],
        )  # fmt: skip
        bodies.declare(TensorSpec(
            key="vehicle_clearance", shape=("E",), unit="m", frame="-", owner="env",
            meaning="signed distance of the collision shapes to those of the nearest other vehicle; inf without any",
        ), view=self._clearances[rows])  # fmt: skip
        bodies.declare(TensorSpec(
            key="vehicle_collisions", shape=("E",), dtype=torch.bool, unit="-", frame="-", owner="env",
            meaning="the robot touched another vehicle in this step",
        ), view=self._touches[rows])  # fmt: skip
        return group

    @property
    def positions(self) -> Tensor:
        """Positions of all vehicles, kind by kind, (E, T, 3) [m], world: a copy."""
        parts = (self.states[self.slots.rows(k), :3] for k in range(len(self.groups)))
        return torch.cat([part.unflatten(0, (self._num_envs, -1)) for part in parts], dim=1)

    def build(self, sim: SimCfg, assets: AssetManager, *, gradients: torch.dtype | None, randomize: Randomize) -> None:
        """Build physics, controllers, sensors and collisions of all kinds, and their views (E, V, ...)."""
        if gradients is not None:
            raise ConfigError("differentiable=True: one vehicle for each environment only. Leave robots out")
        self._copy_bounds()
        first_link = 0
        for group in self.groups:
            own = {**group.kind.robot.randomize, **self._env.randomize, **randomize}
            links = len(group.kind.robot.link_names)
            seen = OwnLinks(first=first_link, count=links, seen=group.kind.robot.visible)
            first_link += links * group.kind.count
            group.build(
                sim,
                self._env,
                assets,
                gradients=None,
                randomize=own,
                is_last=group is self.groups[-1],
                own=seen,
                several=True,
            )
        self._network = None
        if self._env.network is not None:
            self._network = VehicleNetwork(
                self._env.network, self.slots, [(group.bodies, group.random) for group in self.groups], assets.scene,
                states=self.states, starts=self._starts, dt=sim.dt * self._env.physics_steps_per_env_step,
            )  # fmt: skip
        for group in self.groups:
            gtd = self._gtd
            if len(self.groups) > 1:
                gtd = GlobalTensorDictionary(device=gtd.device, sizes={"E": self._num_envs})
            gtd.define_size("V", group.kind.count)
            gtd.adopt_bodies(group.bodies)
            group.gtd = gtd
        robots, names = [group.robot_manager for group in self.groups], [group.kind.name for group in self.groups]
        self._wakes = make_wakes(self.slots, robots, names)
        self._collision = VehicleCollisionTest(
            self.slots, states=self.states, position=self._followed.position, attitude=self._followed.attitude,
            distances_out=self._clearances, crashes_out=self._crashes, touches_out=self._touches,
        )  # fmt: skip
        self._payload = None if self._env.payload is None else self._make_payload(self._env.payload, sim)
        self._separation = VehicleStarts(
            self.slots, self.groups, self._env, assets, states=self.states, starts=self._starts,
            keeps_obstacles=self._environments_stay,
        )  # fmt: skip
        assets.set_track_start(self.states[self.slots.rows(0)].unflatten(0, (self._num_envs, -1))[:, 0, :3])

    def _make_payload(self, cfg: PayloadCfg, sim: SimCfg) -> PayloadOnCables:
        (group,), (hull,) = self.groups, self.slots.hulls
        apart, room = cfg.start_distance(group.kind.count), 2.0 * hull + self._env.vehicle_clearance
        if apart < room:
            raise ConfigError(
                f"payload: vehicles start {apart:.3g} m apart and need {room:.3g} m. Give it a larger angle or cable_length"
            )
        bodies = {key: group.bodies.plain(key) for key in group.bodies}
        return PayloadOnCables(
            cfg, self._gtd, bodies, self._followed, com=group.robot_manager.com, starts=group.random.mask,
            gravity=sim.gravity, dt=sim.dt, ground_height=self._env.ground_height,
        )  # fmt: skip

    def act(self, actions: Actions | Mapping[str, Actions]) -> None:
        """Begin a step with actions (E, V, U), those of several kinds by their names."""
        names = [group.kind.name for group in self.groups]
        given = actions if isinstance(actions, Mapping) else {names[0]: actions} if len(names) == 1 else {}
        if given.keys() != set(names):
            raise ShapeError(f"actions: give a mapping with those of {', '.join(names)}, each (E, V, U), no others")
        for group in self.groups:
            action, manager = action_tensor(given[group.kind.name], group.bodies.device), group.robot_manager
            shape = (self._num_envs, group.kind.count, manager.num_actions)
            if tuple(action.shape) != shape:
                raise ShapeError(
                    f"actions of {group.kind.name} has shape {tuple(action.shape)}, expected (E, V, U) = {shape}: "
                    f"{', '.join(manager.action_names)}"
                )
            manager.act(action.flatten(0, 1))

    def fly(self, substeps: int) -> None:
        """Advance the physics of each kind in one launch, in the wakes of the vehicles at its start.

        Cables of a payload pull between two substeps, each of which is then a launch.
        """
        self.measure_wakes()
        if self._payload is None:
            for group in self.groups:
                group.fly(substeps)
            return
        self._payload.begin(substeps)
        for k in range(substeps):
            self.groups[0].fly(1)
            self._payload.join(k)

    def measure_wakes(self) -> None:
        """Write the forces of all wakes at the present states, the last column of ``effect_downwash``."""
        if self._wakes is not None:
            self._wakes.measure()

    def move_links(self) -> None:
        """Write the poses of links of kinds with joints."""
        for group in self.groups:
            group.move_links()

    def collide(self) -> None:
        """Find touches of obstacles, ground and other vehicles; moving obstacles move with the last kind."""
        for group in self.groups:
            group.collide()
        self._collision.step()

    def refresh(self, span: float) -> None:
        """Update derived states and inertial sensors after a step of ``span`` [s]."""
        for group in self.groups:
            group.refresh(span)
        if self._network is not None:
            self._network.exchange()

    def render(self, mask: Tensor | None) -> None:
        """Read all range sensors, or those of environments (E,) or of vehicles (E, T) in a bool mask."""
        if len(self.groups) > 1:
            torch.cat(self._link_states, dim=1, out=self.link_state)
        for number, group in enumerate(self.groups):
            first, count = self.slots.first_slot(number), group.kind.count
            rows = None
            if mask is not None:
                rows = mask.unsqueeze(1).expand(-1, count) if mask.dim() == 1 else mask[:, first : first + count]
            group.sensor_manager.capture(None if rows is None else rows.flatten())

    def begin(self, mask: Tensor, *, counted: bool = False) -> None:
        """Begin episodes in environments (E,), or of vehicles (E, T) in environments that stay, by a bool mask; ``counted``:
        their episodes have been counted."""
        whole = mask.dim() == 1
        self._starts.copy_(mask.unsqueeze(1) if whole else mask)
        self._environments_stay.fill_(not whole)
        for number, group in enumerate(self.groups):
            first, random = self.slots.first_slot(number), group.random
            columns = slice(first, first + group.kind.count)
            random.mask.view(self._num_envs, -1).copy_(self._starts[:, columns])
            if not counted:
                random.begin(random.mask)
            random.shared.episode.view(self._num_envs, -1).copy_(self._random.episode.unsqueeze(1))

    def reset(self, mask: Tensor) -> None:
        """Draw the vehicles of the last ``begin`` in the bounds of their environments, and separate them."""
        if mask.dim() == 1:
            self._copy_bounds()
        for group in self.groups:
            group.robot_manager.reset(group.random.mask)
        self._separation.separate()
        if self._payload is not None:
            self._payload.hang()
            self.groups[0].robot_manager.tensors.derived.refresh()

    def after_scene(self) -> None:
        """Restart the sensors of the vehicles of the last ``begin``, and measure all distances."""
        self.move_links()
        for group in self.groups:
            group.robot_manager.refresh_load()
            group.sensor_manager.reset(group.random.mask)
            group.imus.reset(group.random.mask)
            group.collision.measure()
            group.bodies.plain("vehicle_collisions").masked_fill_(group.random.mask, False)
        self._collision.measure()
        if self._network is not None:
            self._network.exchange(begins=True)

    def check_mask(self, mask: Tensor) -> None:
        """Raise an error for a mask that is neither (E,) nor (E, T), and for single vehicles in shared gusts."""
        total = self._starts.shape[1]
        if tuple(mask.shape) not in ((self._num_envs,), (self._num_envs, total)) or mask.dtype != torch.bool:
            raise ShapeError(
                f"mask is {tuple(mask.shape)} {mask.dtype}, expected bool (E,) = {(self._num_envs,)} for environments, or "
                f"(E, V) = {(self._num_envs, total)} for vehicles"
            )
        if mask.dim() == 2 and self._env.reset_together:
            raise ConfigError("mask: reset_together is true in this environment. Give a mask (E,) of environments")

    def episode_ends(self) -> Tensor:
        """Return the vehicles that crashed or were truncated, bool (E, T); the environments (E,) with ``reset_together``."""
        ends = torch.cat([group.episode_ends() for group in self.groups], dim=1)
        return ends.any(dim=1) if self._env.reset_together else ends

    def restart(self) -> None:
        """Set all vehicles before their first episode."""
        for random in (random for group in self.groups for random in (group.random, group.random.shared)):
            random.restart_episodes()

    def draws(self) -> dict[str, Tensor]:
        """Return the draws of the present episodes by quantity, (E, V, ...); several kinds with ``KIND.`` in front."""
        if len(self.groups) == 1:
            return self.groups[0].draws()
        return {f"{g.kind.name}.{name}": each for g in self.groups for name, each in g.draws().items()}

    def state_tensors(self) -> dict[str, Tensor]:
        """Return the tensors of a saved state beside the GTD of the environments, by name."""
        tensors = {"states": self.states}
        if self._network is not None:
            tensors |= add_prefix("network", self._network.state_tensors())
        for group in self.groups:
            own = {"lower": group.bounds[0], "upper": group.bounds[1], "shared": group.random.shared.episode}
            own |= group.state_tensors() | add_prefix("random", group.random.state_tensors())
            if len(self.groups) > 1:
                own |= add_prefix("gtd", group.bodies.state_tensors())
            tensors |= add_prefix(group.kind.name, own)
        return tensors

    def _copy_bounds(self) -> None:
        for group in self.groups:
            for corner, source in zip(group.bounds, self._bounds, strict=True):
                corner.view(self._num_envs, -1, 3).copy_(source.unsqueeze(1))


def check_kinds(
    kinds: Sequence[VehicleKind], env: EnvironmentCfg, randomize: Randomize, sim: SimCfg
) -> None:  # fmt: skip
    """Raise one error with everything that several vehicles in an environment cannot have yet."""
    faults = []
    names = [kind.name for kind in kinds]
    for name in {name for name in names if names.count(name) > 1}:
        faults.append(f"robots: two kinds are called {name!r}. Give each a kind of its own: kind: NAME")
    if env.contact is not None and env.num_assets:
        faults.append("contact: obstacles push one vehicle in an environment only. Leave contact or obstacles out")
    for kind in kinds:
        robot = kind.robot
        if robot.collides_with_links:
            faults.append(f"robot {kind.name}: collision shapes on links are for one vehicle only. Leave them out")
        drawn = {**robot.randomize, **env.randomize, **randomize}
        effects = {*robot.effects, *(name.split(".")[1] for name in drawn if name.startswith("effects."))}
        shared = [EFFECTS.get(name) for name in sorted(effects) if name in EFFECTS]
        moving = [effect.name for effect in shared if effect.acts_on == "environment" and effect.random]
        if moving and not env.reset_together:
            faults.append(
                f"robot {kind.name}: all vehicles of an environment share its {', '.join(moving)}, which start with the "
                "episode. Give the environment reset_together: true"
            )
    if env.payload is not None:
        faults += payload_faults(kinds, env, sim, {**env.randomize, **randomize})
    if faults:
        raise ConfigError(*faults)


def payload_faults(kinds: Sequence[VehicleKind], env: EnvironmentCfg, sim: SimCfg, randomize: Randomize) -> list[str]:
    """Return the reasons against a payload of these vehicles, one sentence each."""
    faults, count = [], sum(kind.count for kind in kinds)
    if len(kinds) > 1 or count > MOST_CARRIERS:
        faults.append(
            f"payload: up to {MOST_CARRIERS} vehicles of one kind carry it, not {count} of {len(kinds)} kinds"
        )
    if not env.reset_together:
        faults.append("payload: it begins an episode with all vehicles. Give the environment reset_together: true")
    if env.contact is not None:
        faults.append("payload: it has no contact forces. Leave contact or payload out")
    if sim.integrator != "euler":
        faults.append(f"payload: its cables need integrator euler, not {sim.integrator}")
    for kind in kinds:
        if kind.robot.joints is not None:
            faults.append(f"robot {kind.name}: a vehicle with joints carries no payload of the environment")
        drawn = (name.split(".")[1] for name in {**kind.robot.randomize, **randomize} if name.startswith("effects."))
        given = sorted(name for name in {*kind.robot.effects, *drawn} if name in EFFECTS)
        effects = (name for name in given if isinstance(EFFECTS.get(name), LoadEffect | FluidEffect))
        faults += [f"robot {kind.name}: effect {name} does not go with payload. Leave one out" for name in effects]
    return faults
