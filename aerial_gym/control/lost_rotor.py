"""Hover at a point without a rotor: a linear-quadratic regulator (LQR) about the relaxed hover of what is left.

In the source the regulator is of attitude alone, and a loop of position around it tilts the axis. Here all that is constant
seen from the body is in one regulator, place, velocity, spin and the lag of the rotors too.

Frames: world z up; body x forward, y left, z up. Letters: E environments, R rotors, M = 12 + R entries of a motion.
Source: Mueller, D'Andrea (2014), Stability and control of a quadrocopter despite the complete loss of one, two, or three
propellers, ICRA.
"""

from dataclasses import dataclass

import torch
from torch import Tensor

from aerial_gym.config.checks import require_positive
from aerial_gym.config.robot import RobotCfg
from aerial_gym.control.relaxed_hover import (
    PLACE,
    ROTORS,
    TURN,
    UP,
    VELOCITY,
    linearised,
    motion_from_body,
    relaxed_hover,
)
from aerial_gym.physics.model import Model, build_model, robot_effects
from aerial_gym.physics.state import BodyState
from aerial_gym.physics.vehicle import vehicle_from_config


@dataclass(frozen=True, kw_only=True)
class Tolerances:
    """Deviations that weigh alike (Bryson's rule: weights are their inverse squares). Chosen, not derived from a vehicle."""

    place: float = 0.5
    """Distance [m], > 0."""

    velocity: float = 1.0
    """[m/s], > 0."""

    up: float = 0.5
    """Of the direction of up [rad], > 0."""

    turn: float = 5.0
    """Angular velocity [rad/s], > 0."""

    rotors: float = 0.2
    """Commanded speed per largest speed [-], > 0."""

    def __post_init__(self) -> None:
        """Refuse what has no inverse square."""
        require_positive(self, *vars(self))


def hover_gain(model: Model, motion: Tensor, lost: int, tolerances: Tolerances | None = None) -> Tensor:
    """Return the gain (R, M) of ``command = speed - gain (motion - hover)``; the row of the lost rotor is zero.

    Args:
        model: One environment in float64.
        motion: That of ``relaxed_hover``, (M,).
        lost: Which rotor, from 0 on.
        tolerances: What weighs alike.
    """
    from scipy.linalg import solve_continuous_are  # of the extra ``sim2real``

    allowed = Tolerances() if tolerances is None else tolerances
    a, b, basis = linearised(model, motion, lost)
    weight = torch.zeros_like(motion)  # rotors may turn as they do
    for part, size in ((PLACE, allowed.place), (VELOCITY, allowed.velocity), (UP, allowed.up), (TURN, allowed.turn)):
        weight[part] = size**-2
    kept = [i for i in range(4) if i != lost]
    effort = (allowed.rotors * model.vehicle.speed_high[0, kept]) ** 2  # inverse of the weight of commands
    cost = basis @ weight.diag() @ basis.T
    found = torch.from_numpy(solve_continuous_are(a.numpy(), b.numpy(), cost.numpy(), (1.0 / effort).diag().numpy()))
    gain = torch.zeros(4, len(motion), dtype=motion.dtype)
    gain[kept] = effort.diag() @ b.T @ found @ basis
    return gain


@dataclass(frozen=True, kw_only=True)
class LostRotorLaw:
    """Hover at a target without a rotor, whichever it is."""

    hover: Tensor
    """Motions by lost rotor, (R, M)."""

    gain: Tensor
    """Gains by lost rotor, (R, R, M)."""

    reach: float
    """Targets further away [m] count as this far in their direction, as velocities beyond twice that in 1 s do."""

    def rotor_command(self, state: BodyState, target: Tensor, lost: Tensor) -> Tensor:
        """Return commanded rotor speeds [rad/s], (E, R), before limits; zero of the lost one.

        Args:
            state: Motion of the vehicle.
            target: Where to be [m], world, (E, 3).
            lost: Which rotor, from 0 on, int64, (E,).
        """
        hover, gain = self.hover[lost], self.gain[lost]
        off = motion_from_body(state, target) - hover
        off = torch.cat(
            (_limit(off[:, PLACE], self.reach), _limit(off[:, VELOCITY], 2.0 * self.reach), off[:, 6:]), dim=-1
        )
        return (hover[:, ROTORS] - (gain @ off.unsqueeze(-1)).squeeze(-1)).clamp_min(0.0)


def lost_rotor_law(
    robot: RobotCfg, gravity: float, *, share: float, tolerances: Tolerances | None = None, reach: float = 1.0
) -> LostRotorLaw:
    """Return the law of a quadrotor as its file has it, in float32.

    Args:
        robot: With its effects: what brakes the spin decides how fast it is.
        gravity: Downward acceleration of free fall [m/s²].
        share: Of ``relaxed_hover``.
        tolerances: What weighs alike.
        reach: Of ``LostRotorLaw`` [m].

    Raises:
        ConfigError: If the vehicle is no quadrotor of plain rotors, or one of them cannot be done without.
    """
    model = declared_model(robot, gravity)
    hover = [relaxed_hover(model, lost, share) for lost in range(model.vehicle.num_rotors)]
    gain = [hover_gain(model, motion, lost, tolerances) for lost, motion in enumerate(hover)]
    return LostRotorLaw(hover=torch.stack(hover).float(), gain=torch.stack(gain).float(), reach=reach)


def declared_model(robot: RobotCfg, gravity: float, *, num_envs: int = 1) -> Model:
    """Return the model of a robot as its file has it, effects and all, in float64 on the CPU."""
    device, dtype = torch.device("cpu"), torch.float64
    vehicle = vehicle_from_config(robot, num_envs=num_envs, device=device, dtype=dtype)
    effects = robot_effects(robot, num_envs=num_envs, device=device, dtype=dtype)
    return build_model(vehicle, effects, gravity=gravity)


def _limit(vector: Tensor, size: float) -> Tensor:
    return vector * (size / vector.norm(dim=-1, keepdim=True).clamp_min(size))
