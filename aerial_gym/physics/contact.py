"""Compliant contact with friction, implicit in the velocity and therefore stable at every step size.

After a step without contact, each sphere that overlaps a surface gets an impulse along the outward normal n,

    p = dt max(0, -k g' - c v'),    g' = g + s dt n.du,    v' = v + n.du,

with its gap g < 0 and normal speed v before, and the change du of its contact point's velocity by all impulses. So spring and
damper act at the *end* of the step. Friction is the impulse that ends the slip, at most ``mu p`` (Coulomb). Position and
attitude follow by ``s dt`` times the change of velocity: s = 1 with semi-implicit Euler, which moves with the velocity at the
end of a step; s = 1/2 with RK4, and with Euler under added mass, which applies forces at the middle. A vehicle at rest
therefore stays in place. Spring, damper and gravity never add energy to a body that hits a plane without rotation, since the
potential is convex: ``V(g') - V(g) <= V'(g') (g' - g)``.

All contacts of a body are solved together. For fixed branches (pushing or not, sticking or sliding along a direction), the
impulses are linear in the six changes of velocity; after each solution the branches are chosen again. A sticking point has the
impulse ``q <- q - R slip``, a multiplier with the penalty R, so that it neither creeps nor depends on the order of contacts; it
slides if q exceeds ``mu p``. A sliding one has ``-mu p slip / |slip|``, linearised; it sticks if that reverses. These branches
can alternate for ever, mostly at fast impacts of several points. If the friction would add energy, the solution is replaced by
one with ``-min(R, mu p / |slip|) slip``, which cannot, with p and the factor of the previous solution.
Sources: Catto (2011), Soft Constraints, GDC; Alart and Curnier (1991), A mixed formulation for frictional contact problems
prone to Newton like solution methods, section 3, whose branches these are.
Frames: world, z up; spheres in the body frame. Letters: E environments, C contacts.
"""

from dataclasses import dataclass

import torch
from torch import Tensor

from aerial_gym.config.environment import ContactCfg
from aerial_gym.math import quaternion
from aerial_gym.math.rows import cross_product_matrix
from aerial_gym.physics.integrators import MassState
from aerial_gym.physics.model import Model

ITERATIONS = 6  # Solutions of the linear system; in the first all points stick
CAUTIOUS_ITERATIONS = 2  # Further solutions if friction would add energy
PENALTY = 100.0  # R per mass. A solution reduces the slip of a sticking point below 1 / PENALTY; more loses digits
POSITION_SHARE = {"euler": 1.0, "rk4": 0.5}  # s: displacement at the end of a step per `dt` and change of velocity


def displacement_per_velocity_change(integrator: str, *, in_fluid: bool) -> float:
    """Return s, the displacement of a step per ``dt`` and change of velocity; 1/2 with added mass (``euler_in_fluid``)."""
    return 0.5 if in_fluid else POSITION_SHARE[integrator]


@dataclass(frozen=True, kw_only=True)
class Contacts:
    """Possible contacts of a body with surfaces at rest, after a step without contact."""

    gap: Tensor  # Signed distance of the surfaces [m], (E, C); those < 0 push
    lever: Tensor  # Contact point from the centre of mass [m], world, (E, C, 3)
    normal: Tensor  # Unit normal of the touched surface, towards the body, world, (E, C, 3)


def apply_contact_impulses(
    contacts: Contacts, cfg: ContactCfg, model: Model, state: MassState, *, dt: float, share: float
) -> tuple[MassState, Tensor]:
    """Return the motion after the impulses of all contacts, and their sum [N s], world, (E, 3). Differentiable.

    Rows without contact are returned bit for bit.

    Args:
        contacts: Gaps, levers and normals in ``state``.
        state: Motion after a step of ``dt`` [s] without contact.
        share: From ``displacement_per_velocity_change``.
    """
    mass = model.vehicle.mass
    rotation = quaternion.quat_to_matrix(state.attitude)
    turn = quaternion.quat_rotate(state.attitude, state.ang_vel)
    inertia = torch.zeros(mass.shape[0], 6, 6, dtype=mass.dtype, device=mass.device)
    inertia[:, :3, :3] = mass[:, None, None] * torch.eye(3, dtype=mass.dtype, device=mass.device)
    inertia[:, 3:, 3:] = rotation @ model.vehicle.inertia @ rotation.mT
    delta = _velocity_change(contacts, cfg, mass[:, None], inertia, (state.lin_vel, turn), dt, share)
    after = MassState(
        position=state.position + share * dt * delta[:, :3],
        attitude=quaternion.quat_normalize(
            quaternion.quat_multiply(quaternion.quat_exp(share * dt * delta[:, 3:]), state.attitude)
        ),
        lin_vel=state.lin_vel + delta[:, :3],
        ang_vel=state.ang_vel + quaternion.quat_rotate_inverse(state.attitude, delta[:, 3:]),
        rotor_speed=state.rotor_speed,
        load=state.load,
    )
    touches = (contacts.gap < 0.0).any(dim=1, keepdim=True)
    kept = {name: torch.where(touches, new, getattr(state, name)) for name, new in vars(after).items()}
    return MassState(**kept), mass.unsqueeze(-1) * delta[:, :3]


def _velocity_change(
    contacts: Contacts, cfg: ContactCfg, mass: Tensor, inertia: Tensor, velocity: tuple[Tensor, Tensor], dt: float,
    share: float,
) -> Tensor:  # fmt: skip
    """Return the changes of velocity and angular velocity, world, (E, 6), for mass (E, 1) and inertia (E, 6, 6)."""
    gap, lever, normal = contacts.gap, contacts.lever, contacts.normal
    to_point = torch.cat(
        (torch.eye(3, dtype=lever.dtype, device=lever.device).expand(*gap.shape, 3, 3), -cross_product_matrix(lever)),
        -1,
    )
    across = normal.unsqueeze(-1) * normal.unsqueeze(-2)
    along = torch.eye(3, dtype=lever.dtype, device=lever.device) - across
    start = _multiply(to_point, torch.cat(velocity, dim=-1).unsqueeze(1))
    slip_at_start, touch = _multiply(along, start), gap < 0.0
    load = dt * mass * (-cfg.stiffness * gap - cfg.damping * (normal * start).sum(-1))
    hardness = dt * mass * (share * dt * cfg.stiffness + cfg.damping)
    penalty = PENALTY * mass.unsqueeze(-1)
    pushes, base, heading = touch & (load > 0.0), torch.zeros_like(lever), torch.zeros_like(lever)
    grip, sticks = penalty * touch.unsqueeze(-1), touch.unsqueeze(-1)
    delta = torch.zeros_like(inertia[:, 0])
    gains = torch.zeros_like(gap[:, :1, None], dtype=torch.bool)
    for k in range(ITERATIONS + CAUTIOUS_ITERATIONS):
        if k > 0:
            change = _multiply(to_point, delta.unsqueeze(1))
            press = load - hardness * (normal * change).sum(-1)
            pushed = touch & (press > 0.0)
            limit = cfg.friction * (pushed * press).unsqueeze(-1)
            slip = slip_at_start + _multiply(along, change)
            rub = base - grip * _multiply(_remove_component(along, heading), slip)
            cautious = torch.minimum(limit / _length(slip), penalty)
            if k < ITERATIONS:
                pushes = pushed
                sticks = torch.where(sticks, _length(rub) <= limit, _dot(slip, heading) > 0.0) & pushes.unsqueeze(-1)
                backwards = torch.where(heading.any(-1, keepdim=True), -slip, rub)
                backwards = _multiply(
                    along, backwards
                )  # again, because of rounding along the normal at very small slip
                heading = torch.where(sticks, 0.0, backwards / _length(backwards))
                base = torch.where(sticks, rub, limit * heading)
                grip = torch.where(sticks, penalty, cautious)
            else:
                if k == ITERATIONS:
                    gains = _dot(rub, slip_at_start + slip).sum(1, keepdim=True) > 0.0
                pushes = torch.where(gains.squeeze(-1), pushed, pushes)
                heading, base = torch.where(gains, 0.0, heading), torch.where(gains, 0.0, base)
                grip = torch.where(gains, cautious, grip)
        held = _remove_component(along, heading)
        impulse = (pushes * load).unsqueeze(-1) * normal + base - grip * _multiply(held, slip_at_start)
        give = (pushes * hardness)[..., None, None] * across + grip.unsqueeze(-1) * held
        system = inertia + (to_point.mT @ give @ to_point).sum(1)
        delta = torch.linalg.solve_ex(system, _multiply(to_point.mT, impulse).sum(1)).result
    return delta


def _remove_component(matrix: Tensor, direction: Tensor) -> Tensor:
    return matrix - direction.unsqueeze(-1) * direction.unsqueeze(-2)


def _dot(a: Tensor, b: Tensor) -> Tensor:
    return (a * b).sum(-1, keepdim=True)


def _multiply(matrix: Tensor, vector: Tensor) -> Tensor:
    return (matrix @ vector.unsqueeze(-1)).squeeze(-1)


def _length(vector: Tensor) -> Tensor:
    """Return lengths (..., 1) with a finite gradient at zero."""
    return (vector * vector).sum(-1, keepdim=True).clamp(min=1e-30).sqrt()
