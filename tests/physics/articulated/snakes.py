"""Snakes in hover: what their joints must bear, and commands that hold a shape in each mode of the drives. Letters: D
joints, R rods with a rotor each."""

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from aerial_gym.config.robot import RobotCfg
from aerial_gym.config.sim import STANDARD_GRAVITY as G
from aerial_gym.physics.articulated.articulation import Articulation, build_articulation
from aerial_gym.physics.articulated.dynamics import equations_of_motion
from aerial_gym.physics.articulated.flight import link_wrenches
from aerial_gym.physics.articulated.tree import TreeState
from aerial_gym.physics.model import Model, build_model
from aerial_gym.physics.vehicle import vehicle_from_config

F64 = torch.float64

STIFFNESS, DAMPING = 50.0, 10.0
"""Of the drives [N m/rad], [N m s/rad]."""

EFFORT_BANDWIDTH = 20.0
"""Of the loop that stands for a drive where commands are efforts [1/s]: a fifth of the 100 Hz at which it is closed."""


@dataclass(frozen=True)
class SnakeHover:
    """A snake that is level and at rest, each rotor carrying the rod that it sits on."""

    model: Model
    articulation: Articulation

    @classmethod
    def from_robot(cls, robot: RobotCfg) -> "SnakeHover":
        vehicle = vehicle_from_config(robot, num_envs=1, dtype=F64)
        articulation = build_articulation(robot, like=vehicle.mass)
        return cls(build_model(vehicle, [], articulation=articulation), articulation)

    @property
    def share(self) -> float:
        """Weight of a rod [N]."""
        vehicle = self.model.vehicle
        return float(vehicle.mass[0]) * G / vehicle.num_rotors

    def on_joints(
        self, joint_pos: Tensor, thrust: Tensor, *, spin: float = 0.0, floating: bool = True
    ) -> tuple[Tensor, Tensor, Tensor]:
        """Return the joint torques except those of the drives [N m], (D,), the inertia about the joints [kg m²], (D, D), and
        force and torque on the whole [N], [N m], axes of the base, (6,).

        Derived: of ``M a = f`` with a base that follows (is held), ``M_jj - M_jb M_bb⁻¹ M_bj`` and ``f_j - M_jb M_bb⁻¹ f_b``
        (``M_jj`` and ``f_j``).

        Args:
            joint_pos: Shape [rad], (D,).
            thrust: Of the rotors [N], (R,).
            spin: Angular velocity of the whole about z [rad/s].
            floating: Whether the base follows; else it stands.
        """
        still = TreeState.at_rest(1, self.articulation.num_joints, like=thrust)
        turning = still.ang_vel + thrust.new_tensor((0.0, 0.0, spin))
        state, at_rest = replace(still, joint_pos=joint_pos[None], ang_vel=turning), torch.zeros_like(thrust)[None]
        result = equations_of_motion(
            self.articulation.tree, self.articulation.links(self.model.vehicle), state, gravity=G,
            wrench=link_wrenches(self.model, self.articulation, state, thrust[None], at_rest),
        )  # fmt: skip
        mass, force = result.mass[0], result.force[0]
        if not floating:
            return force[6:], mass[6:, 6:], force[:6]
        follows = torch.linalg.solve(mass[:6, :6], mass[:6, 6:]).T
        return force[6:] - follows @ force[:6], mass[6:, 6:] - follows @ mass[:6, 6:], force[:6]

    @property
    def equal_thrusts(self) -> Tensor:
        """Thrusts that carry each rod [N], (R,)."""
        return torch.full((self.model.vehicle.num_rotors,), self.share, dtype=F64)

    def drive_command(self, wanted: Tensor, joint_pos: Tensor, joint_vel: Tensor) -> Tensor:
        """Return the drive commands that hold the joint angles ``wanted`` [rad]; all (E, D) and of one float type. Drives to
        angles are told these. Drives to rates are told ``k (q_wanted - q) / c``, which makes them the same law. Efforts are
        those under which each mode of the snake comes as an oscillator of ``EFFORT_BANDWIDTH``, critically damped: the
        stiffness of the drives would swing a rod about itself at 900 rad/s, which no loop of 100 Hz holds."""
        mode = self.articulation.modes[0]
        if mode == "position":
            return wanted
        if mode == "velocity":
            return STIFFNESS / DAMPING * (wanted - joint_pos)
        inertia = self.on_joints(self.articulation.reference, self.equal_thrusts)[1].to(joint_pos)
        pull = EFFORT_BANDWIDTH**2 * (wanted - joint_pos) - 2.0 * EFFORT_BANDWIDTH * joint_vel
        return pull @ inertia

    def rest(self, spin: float = 0.0) -> Tensor:
        """Return the static joint deflection from the commanded reference pose [rad], (D,): load over stiffness."""
        load, inertia, _ = self.on_joints(self.articulation.reference, self.equal_thrusts, spin=spin)
        if self.articulation.modes[0] == "effort":
            return torch.linalg.solve(inertia, load) / EFFORT_BANDWIDTH**2
        return load / STIFFNESS

    def lag(self, rate: Tensor, time: Tensor) -> Tensor:
        """Return the lag of the joints behind a ramp command that starts at t = 0 [rad], (T, D).

        Derived: ``S e'' + C e' + K e = C rate``, ``e(0) = 0``, ``e'(0) = rate``; C and K of drives, or of the loop of efforts.

        Args:
            rate: Of the command [rad/s], (D,).
            time: [s], (T,).
        """
        _, inertia, _ = self.on_joints(self.articulation.reference, self.equal_thrusts)
        size = len(rate)
        eye, empty = torch.eye(size, dtype=F64), torch.zeros(size, size, dtype=F64)
        stiff, damps = STIFFNESS * torch.linalg.inv(inertia), DAMPING * torch.linalg.inv(inertia)
        if self.articulation.modes[0] == "effort":
            stiff, damps = EFFORT_BANDWIDTH**2 * eye, 2.0 * EFFORT_BANDWIDTH * eye
        system = torch.cat((torch.cat((empty, eye), dim=1), torch.cat((-stiff, -damps), dim=1)))
        settled = torch.cat((torch.linalg.solve(stiff, damps @ rate), torch.zeros_like(rate)))
        start = torch.cat((torch.zeros_like(rate), rate)) - settled
        return (settled + torch.linalg.matrix_exp(system * time[:, None, None]) @ start)[:, :size]
