"""Vehicles of one kind in all environments: their states, physics, controllers, sensors and collisions with obstacles.

Letters: E environments, V vehicles of the kind in each, B = E V bodies, A obstacles. Body b is vehicle ``b % V`` of environment
``b // V``. With one vehicle in each environment, the bodies are the environments.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import torch
from torch import Tensor

from aerial_gym.assets import AssetManager
from aerial_gym.config.controller import ControllerCfg
from aerial_gym.config.environment import EnvironmentCfg
from aerial_gym.config.randomize import Randomize
from aerial_gym.config.robot import RobotCfg
from aerial_gym.config.sim import SimCfg
from aerial_gym.control import CONTROLLERS, check_closed_loop
from aerial_gym.control.upside_down import check_starts
from aerial_gym.env_manager.collision_tests import CollisionTests
from aerial_gym.math.random import Randomness
from aerial_gym.physics import Trajectory
from aerial_gym.physics.effects.wakes import without_wakes
from aerial_gym.physics.state import ArticulatedState
from aerial_gym.registry import GlobalTensorDictionary, Registry, TensorSpec
from aerial_gym.registry.state import add_prefix
from aerial_gym.robots import ROBOTS, RobotManager, Surroundings
from aerial_gym.robots.joints.link_tensors import declare_links
from aerial_gym.robots.range_warnings import report_range_faults
from aerial_gym.sensors import ImuSet, SensorManager, mounted_sensors
from aerial_gym.sensors.mounts import Carrier, OwnLinks

if TYPE_CHECKING:
    from aerial_gym.assets.height_probe import HeightProbe
    from aerial_gym.robots.joints.links import LinkPlaces


def _registry_name(registry: Registry, entry: RobotCfg | ControllerCfg) -> str:
    """Return a configuration's registered name, else its summary."""
    return next((repr(name) for name in registry if registry.get(name) is entry), repr(entry.summary))


@dataclass(frozen=True, kw_only=True)
class VehicleKind:
    """A robot with its controller, and the number of such vehicles in every environment."""

    name: str
    robot: RobotCfg
    controller: ControllerCfg
    count: int = 1


class VehicleGroup:
    """Everything of the vehicles of one kind; ``build`` adds the physics once the scene exists."""

    def __init__(
        self, kind: VehicleKind, bodies: GlobalTensorDictionary, *, random: Randomness, state: Tensor,
        bounds: tuple[Tensor, Tensor], trajectory: Trajectory | None, crashes: Tensor | None = None,
    ) -> None:  # fmt: skip
        """Declare the tensors of the bodies that the scene reads.

        Args:
            bodies: Receives all tensors (B, ...).
            random: Of the bodies.
            state: Receives position, attitude, velocity and angular velocity, (B, 13).
            bounds: Lower and upper corner of the environment of each body [m], world, (B, 3).
            trajectory: Record of the poses of a step; None where nothing is swept.
            crashes: Memory of the crashes, (B,), where the vehicles of an environment can touch.
        """
        self.kind, self.bodies, self.gtd, self.random = kind, bodies, bodies, random
        self.bounds, self.trajectory, self.state = bounds, trajectory, state
        self._declare(crashes)
        self.links = None if kind.robot.joints is None else declare_links(bodies, kind.robot.joints)
        self.link_state = self.state if self.links is None else self.links.state
        """States of the links, (B, L, 13), or (B, 13) of one: position [m], xyzw, velocities, world."""

    def _declare(self, crashes: Tensor | None) -> None:
        declare = self.bodies.declare
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
                TensorSpec(key=key, shape=("E",), dtype=dtype, unit="-", frame="-", owner="env, task", meaning=meaning),
                view=crashes if key == "crashes" else None,
            )

    def build(
        self, sim: SimCfg, env: EnvironmentCfg, assets: AssetManager, *, gradients: torch.dtype | None,
        randomize: Randomize, is_last: bool = True, own: OwnLinks | None = None, several: bool = False,
    ) -> None:  # fmt: skip
        """Build physics, controllers, sensors and collision tests.

        Args:
            several: Whether an environment holds other vehicles.
            is_last: Whether moving obstacles move with the collision test of this kind.
            own: Links of these vehicles, among those that the scene shows.
        """
        robot, controller, bodies, device = self.kind.robot, self.kind.controller, self.bodies, self.bodies.device
        random, count, dt = self.random, self.random.num_envs, sim.dt * env.physics_steps_per_env_step
        places = {name: each for name, each in randomize.items() if name.startswith("sensors.")}
        names = (_registry_name(ROBOTS, robot), _registry_name(CONTROLLERS, controller))
        checked, drawn = without_wakes(robot, randomize) if several else (robot, randomize)
        for check in (check_closed_loop, report_range_faults):
            check(
                checked, controller, gravity=sim.gravity, dt=sim.dt, integrator=sim.integrator, names=names,
                randomize=drawn,
            )  # fmt: skip
        check_starts(checked, controller, gravity=sim.gravity, dt=sim.dt, names=names)
        around = Surroundings(
            bounds=self.bounds, crashes=bodies["crashes"], ground_height=env.ground_height,
            ceiling_height=env.ceiling_height, contact=env.contact, scene=assets.scene, moving=assets.moving,
            links=self.links, hook=self.trajectory if env.payload is None else None, several_vehicles=several,
        )  # fmt: skip
        self.robot_manager = RobotManager(
            robot,
            controller,
            sim,
            bodies,
            around,
            root_state=self.state,
            random=random,
            gradients=gradients,
            randomize={name: each for name, each in randomize.items() if name not in places},
        )
        self._places: LinkPlaces | None = None
        if robot.joints is not None and self.links is not None:
            assert isinstance(self.robot_manager.tensors.state, ArticulatedState)
            self._places = self.links.make_launches(robot.joints, self.robot_manager.tensors.state, self.trajectory)
        surface = self.robot_manager.felt.surface_height
        self._below: HeightProbe | None = None
        if surface is not None:
            self._below = assets.make_height_probe(bodies["robot_position"], height_out=surface)
        keys = ("robot_position", "robot_orientation", "robot_linvel", "robot_body_angvel")
        position, attitude, lin_vel, ang_vel = (bodies[key] for key in keys)
        body = Carrier(position=position, attitude=attitude, lin_vel=lin_vel, ang_vel=ang_vel)
        range_sensors, imus = mounted_sensors(robot.sensor_mounts, places)
        carriers = {} if self.links is None else self.links.link_of_sensors({**range_sensors, **imus})
        self.sensor_manager = SensorManager(
            {name: mounted.cfg for name, mounted in range_sensors.items()},
            bodies,
            assets.scene,
            body,
            num_envs=count,
            device=device,
            dt=dt,
            random=random,
            poses={name: mounted.pose for name, mounted in range_sensors.items()},
            carriers=carriers,
            own=own,
        )
        self.imus = ImuSet(
            imus, bodies, body, dt=dt, gravity=sim.gravity, random=random, errors=self.robot_manager.imu_errors,
            carriers=carriers,
        )  # fmt: skip
        self.move_links()
        swept = self.trajectory if env.contact is None else None
        self.collision = CollisionTests(
            robot, bodies, assets, links=self.links, places=self._places, trajectory=swept, dt=sim.dt, is_last=is_last
        )

    def fly(self, substeps: int) -> None:
        """Advance the physics by ``substeps`` in one launch."""
        if self._below is not None:
            self._below.measure_heights()
        self.robot_manager.advance(substeps)
        self.move_links()
        if self._places is not None and self._places.trajectory is not None:
            self._places.trajectory.refresh()

    def move_links(self) -> None:
        """Write the poses of links, if there are joints."""
        if self._places is not None:
            self._places.refresh()

    def collide(self) -> None:
        """Measure the clearance and find touches in one launch."""
        self.collision.step()

    def refresh(self, span: float) -> None:
        """Update derived states and inertial sensors after a step of ``span`` [s]."""
        self.robot_manager.refresh(span)
        self.imus.measure()

    def episode_ends(self) -> Tensor:
        """Return the mask of crashed and truncated vehicles, in rows as in ``gtd``."""
        return self.gtd.plain("crashes") | self.gtd.plain("truncations")

    def draws(self) -> dict[str, Tensor]:
        """Return the draws of the present episodes by quantity, in rows as in ``gtd``."""
        drawn = self.robot_manager.draws() | self.sensor_manager.draws() | self.imus.draws()
        if self.gtd is self.bodies:
            return drawn
        rows = self.gtd["episodes"].shape
        return {name: each.unflatten(0, rows) for name, each in drawn.items()}

    def state_tensors(self) -> dict[str, Tensor]:
        """Return the tensors of a saved state beside the GTD, by name."""
        parts = {"robot": self.robot_manager, "sensors": self.sensor_manager, "imus": self.imus}
        return {
            name: t for prefix, part in parts.items() for name, t in add_prefix(prefix, part.state_tensors()).items()
        }
