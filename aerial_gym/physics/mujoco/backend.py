"""The torch backend with MuJoCo as its integrator: an independent engine for rigid body and contact with the ground.

Control law, rotors, effects and their memory are the torch backend's code. The wrench is constant over a substep, as in
semi-implicit Euler, so MuJoCo's ``Euler`` equals the torch backend's ``euler`` to rounding without contact.
MuJoCo computes in float64, whatever the float type of the state.

MuJoCo's rollout distributes environments over torch's number of threads at the time of ``allocate``, without a loop in
Python. Environments with different parameters need a MuJoCo model each, some 0.1 MB.
Letters: E environments.
"""

from collections.abc import Callable
from dataclasses import replace

import torch
from torch import Tensor

from aerial_gym.config.environment import ContactCfg
from aerial_gym.config.rotor import ROTOR_TRAITS
from aerial_gym.math.quaternion import quat_rotate, quat_rotate_inverse
from aerial_gym.physics.articulated.motion import move_links, place_links
from aerial_gym.physics.articulated.tree import TreeState
from aerial_gym.physics.backend import Capabilities
from aerial_gym.physics.effects import FluidEffect, LoadEffect
from aerial_gym.physics.ground import Ground, detect_crash, ground_contacts, is_crash
from aerial_gym.physics.integrators import (
    MassState,
    Stepper,
    advance_load,
    coast,
    speeds_and_wrench_of_step,
    to_body_state,
    to_mass_state,
    wrench_of_coast,
)
from aerial_gym.physics.model import Model
from aerial_gym.physics.mujoco.bodies import Bodies, body_rows, import_optional
from aerial_gym.physics.mujoco.mjcf import Floor
from aerial_gym.physics.mujoco.rollouts import RolloutBodies, RolloutTrees
from aerial_gym.physics.mujoco.warp_engine import WarpBodies, WarpTrees
from aerial_gym.physics.rigid_body import angular_acceleration, com_acceleration, force_without_fluid, pull_of_load
from aerial_gym.physics.rotor_lag import RotorCommand
from aerial_gym.physics.state import ArticulatedState, BodyState
from aerial_gym.physics.torch_backend import TorchBackend


def sphere_gaps(ground: Ground, model: Model, state: ArticulatedState) -> tuple[Tensor, Tensor]:
    """Return the gaps of spheres to the ground [m], and the approach speeds of their lowest points [m/s], (E, C)."""
    articulation, spheres = model.articulation, ground.spheres.to(state.position.dtype)
    assert articulation is not None
    assert ground.on_links is not None
    on, tree = list(ground.on_links.links), articulation.tree
    places = place_links(tree, articulation.links(model.vehicle), state.joint_pos)
    moves = float(tree.floating)  # a stand is at rest, whatever its state
    body_vel = quat_rotate_inverse(state.attitude, moves * state.lin_vel)
    motion = move_links(tree, places, body_vel, moves * state.ang_vel, state.joint_vel)
    down = torch.zeros_like(state.position)
    down[:, 2] = -1.0
    down = quat_rotate_inverse(state.attitude, down).unsqueeze(1)
    lever = (places.rotation[:, on] @ spheres[:, :3, None]).squeeze(-1) + spheres[:, 3:] * down
    velocity = motion.lin_vel[:, on] + torch.linalg.cross(motion.ang_vel[:, on], lever)
    attitude = state.attitude.unsqueeze(1).expand(-1, len(on), -1)
    lowest = state.position[:, 2:] + quat_rotate(attitude, places.origin[:, on] + lever)[..., 2]
    return lowest - ground.height, (velocity * down).sum(-1)


class MujocoBackend(TorchBackend):
    """MuJoCo on the CPU: an independent engine for the rigid body and its contact with the ground."""

    name = "mujoco"
    packages = ("mujoco",)  # Required packages; benchmarks report their versions

    capabilities = Capabilities(
        devices=("cpu",),
        dtypes=(torch.float32, torch.float64),
        integrators=("euler",),
        differentiable=False,
        effects=None,
        lacks=("link_added_mass",),  # MuJoCo's bodies have equal mass along all axes
        rotors=ROTOR_TRAITS,
        contact=True,
        joints=True,
        contact_of_links=True,
    )

    _engine: type[RolloutBodies] | type[WarpBodies] = RolloutBodies
    _bodies: Bodies | None = None
    _engine_of_trees: type[RolloutTrees] | type[WarpTrees] = RolloutTrees
    _trees: RolloutTrees | WarpTrees | None = None
    _start: MassState  # Motion at the start of MuJoCo's last step of a rigid vehicle
    _free_vel: Tensor  # Velocity after that step without contact [m/s], world, (E, 3)
    _end_vel: Tensor  # Velocity after that step with contact [m/s], world, (E, 3)

    def prepare(self, dt: float) -> None:
        """Allocate the memory of effects and control law, and MuJoCo's models."""
        super().prepare(dt)
        if self._model.articulation is None:
            self._update_bodies(self._model, dt)
        else:
            self.tree_stepper(self._model, dt)

    def make_stepper(self, integrator: str) -> Stepper:
        """Return the integrator that passes the wrench to MuJoCo; raise ``MissingDependencyError`` without MuJoCo."""
        del integrator  # MuJoCo has one
        for package in self.packages:
            import_optional(package.replace("-", "_"), backend=self.name)
        self._bodies = self._trees = None
        return self._advance_motion

    def tree_stepper(self, model: Model, dt: float) -> Callable[..., TreeState]:
        """Return MuJoCo's integrator of trees, with joint efforts at the end of a step as in ``implicit_euler``."""
        assert model.articulation is not None
        if self._trees is None or self._trees.dt != dt:
            floor, cfg = _make_floor(self._ground)
            tree, num_envs = model.articulation.tree, model.vehicle.num_envs
            self._trees = self._engine_of_trees(tree, num_envs, dt, floor=floor, cfg=cfg)
        return self._trees.move

    @torch.no_grad()
    def _advance_motion(self, model: Model, state: MassState, rotor_command: RotorCommand, dt: float) -> MassState:
        """Return the motion after ``dt`` [s]: a ``Stepper``.

        In a fluid, MuJoCo applies the impulses of forces and contact between two halves of ``coast``.
        """
        if not model.effects[FluidEffect]:
            return self._mujoco_step(model, state, rotor_command, dt)
        middle = coast(model, state, 0.5 * dt)
        end = self._mujoco_step(model, middle, rotor_command, dt)
        return coast(model, replace(end, position=middle.position, attitude=middle.attitude), 0.5 * dt)

    def _mujoco_step(self, model: Model, state: MassState, rotor_command: RotorCommand, dt: float) -> MassState:
        """Return the motion after MuJoCo's step; in a fluid only its velocities count, and a load is unchanged."""
        rotor_speed, (force, torque) = speeds_and_wrench_of_step(model, state, rotor_command, dt)
        load, fluid = state.load, bool(model.effects[FluidEffect])
        if model.effects[LoadEffect]:
            acc = com_acceleration(model, state.attitude, force)
            ang_acc = angular_acceleration(model, state.ang_vel, torque)
            pull, turn, swing = pull_of_load(model, state.attitude, state.ang_vel, load, acc, ang_acc)
            pull = force_without_fluid(model, state.attitude, pull)
            force, torque = force + quat_rotate_inverse(state.attitude, pull), torque + turn
            load = (
                torch.cat((load[:, :3], load[:, 3:] + dt * swing), dim=-1) if fluid else advance_load(load, swing, dt)
            )
        if fluid:
            free_force, free_torque = wrench_of_coast(model, state)
            force, torque = force - free_force, torque - free_torque
        self._start, self._free_vel = state, state.lin_vel + dt * com_acceleration(model, state.attitude, force)
        moved = self._update_bodies(model, dt).move(state, force, torque)
        self._end_vel = moved["lin_vel"]
        return MassState(**moved, rotor_speed=rotor_speed, load=load)

    def _update_bodies(self, model: Model, dt: float) -> Bodies:
        """Return the bodies with the parameters of a model, for steps of ``dt`` [s]."""
        rows, bodies = body_rows(model), self._bodies
        if bodies is None or bodies.dt != dt or bodies.num_rows != len(rows):
            floor, cfg = _make_floor(self._ground)
            bodies = self._bodies = self._engine(rows, model.vehicle.num_envs, dt, floor=floor, cfg=cfg)
        bodies.set_parameters(rows)
        return bodies

    def _advance_on_ground(
        self, ground: Ground, cfg: ContactCfg, state: BodyState, command: Tensor, dt: float
    ) -> tuple[MassState, BodyState, Tensor, Tensor]:
        """Return motion before and state after a substep, impulse of the ground (E, 3), and crash flags (E,).

        The impulse is ``m`` times the change of velocity by contact in MuJoCo's step; exactly zero without contact.
        """
        if self._model.articulation is not None:
            assert isinstance(state, ArticulatedState)
            return self._articulated_step_on_ground(ground, cfg, state, command, dt)
        before, after = self._free_substep(state, command, dt)
        mass = self._model.vehicle.mass.unsqueeze(-1)
        touches = (ground_contacts(ground, self._model, self._start).gap < 0.0).any(dim=1, keepdim=True)
        impulse = torch.where(touches, mass * (self._end_vel - self._free_vel), 0.0)
        crashes = detect_crash(ground_contacts(ground, self._model, after), cfg, before, after)
        return before, to_body_state(self._model, after), impulse, crashes

    def _articulated_step_on_ground(
        self, ground: Ground, cfg: ContactCfg, state: ArticulatedState, command: Tensor, dt: float
    ) -> tuple[MassState, BodyState, Tensor, Tensor]:
        """Return the same for an articulated vehicle, with the impulse of obstacles.

        A contact with the ground is a crash by the prior speed of the sphere's lowest point.
        """
        after = self._articulated_substep(state, command, dt)
        assert self._trees is not None
        _, approach = sphere_gaps(ground, self._model, state)
        gap, _ = sphere_gaps(ground, self._model, after)
        return to_mass_state(self._model, state), after, self._trees.impulse.to(gap.dtype), is_crash(gap, approach, cfg)


class MujocoWarpBackend(MujocoBackend):
    """MuJoCo Warp on the CPU, in float32: like backend ``mujoco``, with the engine for NVIDIA GPUs.

    It is untested on a GPU, hence not declared for it; see ``docs/guides/own_backend.md``.
    """

    name = "mujoco_warp"
    packages = ("mujoco-warp", "mujoco")
    capabilities = replace(MujocoBackend.capabilities, dtypes=(torch.float32,), contact_of_links=False)
    _engine, _engine_of_trees = WarpBodies, WarpTrees


def _make_floor(ground: Ground | None) -> tuple[Floor | None, ContactCfg | None]:
    """Return the ground for MuJoCo and its contact parameters; None and None for a ground without force."""
    if ground is None or ground.cfg is None:
        return None, None
    spheres = ground.spheres.double().tolist()
    floor = Floor(height=ground.height, spheres=spheres, friction=ground.cfg.friction, on_links=ground.on_links)
    return floor, ground.cfg
