"""Soft joints at the roots of the rotor arms: the common model, one Kelvin-Voigt element in each arm.

An arm points from the vertical axis of the body to its hub, along the unit vector e, and bends at a hinge at the height of
the hub, the length l away from it, about ``t = e x z``: upwards by the angle h. The hub moves by
``l (e (cos h - 1) + z sin h)``, and the axis a of the rotor turns with the arm to
``a' = a cos h + (t x a) sin h + t (t . a) (1 - cos h)``: hub and thrust tilt inwards.
A thrust f has the moment ``f l a_z`` about the hinge at any h, because it turns with the arm. Spring and damper of the element
balance it: ``tau h' = compliance f l a_z - h``. This f is that of the thrust map; the contributions of inflow and surfaces act
along a' as well, but do not bend the arm.

Over a substep dt ``h = h_f + (h_0 - h_f) exp(-dt / tau)`` with the steady angle h_f, at most 1 rad, under the initial thrust,
which is exact for a constant thrust. During the substep the arm has the new angle, half a substep ahead, while the thrust is
half a substep behind. For a smooth thrust the angle is that of the middle, up to ``dt² / 12 tau`` times its rate; the start of
a motion comes half a substep early.

Elements in series add their angles, as in a Kelvin chain: ``joint_spring`` is the fast one, ``joint_creep`` the slow one. Each
adds its own wrench to that of the rigid arm; products of both angles are neglected (0.2 % of the thrust at 0.05 rad each).
Also neglected: the inertia J of an arm, so the model holds well below the arm's natural frequency
``1 / (2 pi sqrt(compliance J))`` (17 Hz on Morphy); its weight, a constant bend in the declared hubs; and the motion of mass
and hubs by the arms.
Source: Derived: balance of moments about the hinge. Elements: Tschoegl (1989), The Phenomenological Theory of Linear
Viscoelastic Behavior, section 3.4. Example: the Morphy quadrotor, whose joint on the bench fits best to a damped linear spring
with two creep elements, of 0.2 and 2.4 s (``aerial-gym identify joint``).
"""

import torch
from torch import Tensor

from aerial_gym.config.robot import RobotCfg
from aerial_gym.config.sim import STANDARD_GRAVITY
from aerial_gym.errors import ConfigError
from aerial_gym.physics.effects.base import ANY_ROTOR, Parameter, RotorSpeedsOfFlight, SubstepStart, relax
from aerial_gym.physics.effects.condition import Condition
from aerial_gym.physics.effects.kinds import WrenchEffect
from aerial_gym.physics.rotors import rotor_thrust
from aerial_gym.physics.vehicle import Vehicle, is_shared

LARGEST_ANGLE = 1.0  # Largest angle of one element [rad]: four times the range of Morphy's arms
SHORTEST_ARM = 1e-9  # Shortest arm [m]; a hub nearer to the vertical axis of the body has none
HINGE = 0.4  # Default position of the hinge between axis and hub; 0.42 on Morphy
COMPLIANCE, TAU, PLACE, ANGLES = 0, 1, 2, 3  # Indices of the parameters; the angles of the arms [rad] follow


def joint_parameters(*, fastest: float, slowest: float, tau_scale: float, tau: float) -> tuple[Parameter, ...]:
    """Return the parameters of an element with a time constant from ``fastest`` to ``slowest`` [s], initially ``tau``."""
    return (
        Parameter("compliance", "rad/(N m)", 0.0, 20.0, 0.1, "angle per moment at the hinge"),
        Parameter("tau", "s", fastest, slowest, tau_scale, "after which 63 % are reached", neutral=tau),
        Parameter(
            "hinge",
            "-",
            0.0,
            0.9,
            0.1,
            "where arms bend: share of the way from the body's vertical axis to the hub",
            neutral=HINGE,
            kind="convention",
        ),
    )


def arm_directions(vehicle: Vehicle) -> tuple[Tensor, Tensor]:
    """Return unit vectors e from the vertical axis to the hubs, body, (E, R, 3), and distances [m], (E, R); E = 1 if shared."""
    hubs = vehicle.rotor_position
    hubs = hubs[:1] if is_shared(hubs) else hubs
    flat = torch.cat((hubs[..., :2], torch.zeros_like(hubs[..., 2:])), dim=-1)
    distance = (flat.square().sum(-1) + SHORTEST_ARM**2).sqrt()
    return flat / distance.unsqueeze(-1), distance


class ArmJoint(WrenchEffect):
    """Rotor arms that bend under thrust, with equal joints. Its memory is the angle of each arm [rad], positive upwards.

    Arms are straight after a reset, as before take-off.
    """

    rotor_memory = (0.0,)
    rotors = ANY_ROTOR
    at_hubs = True
    on_joints = False

    def check(self, robot: RobotCfg) -> None:
        """Raise ``ConfigError`` if no rotor has an arm."""
        if all(max(abs(x), abs(y)) < SHORTEST_ARM for x, y, _ in (m.position for m in robot.mounts.layout)):
            raise ConfigError(f"effect {self.name}: all rotors are on the vertical axis of the body: no arm can bend")

    def deflection(self, vehicle: Vehicle, rotor_speed: Tensor, params: Tensor) -> Tensor:
        """Return the steady angles [rad] of arms under the thrust of rotor speeds [rad/s], both (E, R)."""
        length = (1.0 - params[:, PLACE, None]) * arm_directions(vehicle)[1]
        moment = rotor_thrust(vehicle, rotor_speed) * length * vehicle.rotor_axis[..., 2]
        limit = LARGEST_ANGLE
        return (params[:, COMPLIANCE, None] * moment).clamp(-limit, limit)

    def remember(self, moment: SubstepStart, values: Tensor) -> Tensor:
        """Return the angles at the end of the substep, (E, R)."""
        decay = torch.exp(-moment.dt / values[:, TAU, None])
        rest = self.deflection(moment.vehicle, moment.rotor_speed, values)
        return rest + (values[:, ANGLES:] - rest) * decay

    def replay(self, track: RotorSpeedsOfFlight, params: Tensor) -> Tensor:
        """Return the angles in every row of a flight, (T, R).

        Between rows the steady angle is linear, with an exact solution of the element. Logs do not give the thrust before the
        start: the initial angle is that of hover, shared among the rotors as over the flight, or that of the first row if the
        vehicle is on the ground.
        """
        rest = self.deflection(track.vehicle, track.rotor_speed, params).numpy()
        if track.begins_on_ground:
            start = rest[0]
        else:
            vehicle = track.vehicle
            lift = (rotor_thrust(vehicle, track.rotor_speed) * vehicle.rotor_axis[..., 2]).sum(dim=1).mean()
            start = track.settled * float(vehicle.mass[0] * STANDARD_GRAVITY / lift) * rest.mean(axis=0)
        return torch.from_numpy(relax(rest, start, tau=float(params[0, TAU]), step=track.step))

    def wrench(self, condition: Condition, params: Tensor) -> Tensor:
        """Return the change of force and torque by bent arms, (E, 6); the angles follow the parameters."""
        vehicle, angle = condition.vehicle, params[:, ANGLES:].unsqueeze(-1)
        out, distance = arm_directions(vehicle)
        sine, fall = angle.sin(), 2.0 * (0.5 * angle).sin().square()  # fall: 1 - cos
        zero = torch.zeros_like(distance)
        up = torch.stack((zero, zero, torch.ones_like(distance)), dim=-1)
        across = torch.linalg.cross(out, up)
        axis = condition.axis
        leaning = sine * torch.linalg.cross(across, axis, dim=-1)
        leaning = leaning - fall * (axis - (across * axis).sum(-1, keepdim=True) * across)
        moved = ((1.0 - params[:, PLACE, None]) * distance).unsqueeze(-1) * (sine * up - fall * out)
        thrust = condition.rotor_thrust.unsqueeze(-1)
        force = thrust * leaning
        torque = torch.linalg.cross(condition.lever.expand_as(force), force)
        torque = torque + torch.linalg.cross(moved, thrust * axis + force)
        drag = vehicle.rotor_spin * condition.rotor_drag_torque
        return torch.cat((force, torque - drag.unsqueeze(-1) * leaning), dim=-1).sum(1)


class JointSpring(ArmJoint):
    """Soft arms that follow the thrust quickly, with elastic, damped joints.

    One Kelvin-Voigt element in each arm, ``tau h' = compliance f l a_z - h``, with the geometry of ``arm_joint``.
    """

    name = "joint_spring"
    summary = "rotor arms bend up under their thrust, within tenths of a second"
    parameters = joint_parameters(fastest=0.001, slowest=0.3, tau_scale=0.02, tau=0.02)
    excitation = "differences in thrust between rotors, at high and at low thrust"
    confused_with = ("joint_creep", "com_offset", "motor_tilt", "imu_misalignment")


class JointCreep(ArmJoint):
    """Soft arms that continue to bend for seconds, as viscoelastic materials do.

    One slow Kelvin-Voigt element in each arm, ``tau h' = compliance f l a_z - h``, with the geometry of ``arm_joint``.
    """

    name = "joint_creep"
    summary = "rotor arms continue to bend up under their thrust for seconds"
    parameters = joint_parameters(fastest=0.3, slowest=60.0, tau_scale=1.0, tau=3.0)
    excitation = "differences in thrust between rotors, and a mean thrust that changes for seconds"
    confused_with = ("joint_spring", "com_offset", "motor_tilt", "imu_misalignment")
