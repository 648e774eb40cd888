"""How far single precision is from double, of every registered vehicle with joints: one step and one second of the
fused backend beside the torch reference in float64, without effects, thrusts of hover, drives told to stay. Letters: E
environments, D joints, L links, N = 6 + D coordinates of motion (D on a stand)."""

from dataclasses import dataclass, replace

import pytest
import torch
from torch import Tensor

from aerial_gym.control import CONTROLLERS, make_controller
from aerial_gym.math.quaternion import quat_rotate, quat_rotate_inverse
from aerial_gym.math.random import Randomness
from aerial_gym.physics import TorchBackend, build_model, vehicle_from_config
from aerial_gym.physics.articulated.articulation import build_articulation
from aerial_gym.physics.articulated.dynamics import EquationsOfMotion, equations_of_motion
from aerial_gym.physics.articulated.flight import articulated_step
from aerial_gym.physics.articulated.joint_laws import Effort
from aerial_gym.physics.articulated.motion import angular_jacobian, point_jacobian
from aerial_gym.physics.articulated.steppers import _implicit_step, step_within_limits
from aerial_gym.physics.articulated.tree import TreeState
from aerial_gym.physics.model import Model
from aerial_gym.physics.rotors import state_for_thrust
from aerial_gym.physics.state import ArticulatedState
from aerial_gym.physics.warp_backend import WarpBackend
from aerial_gym.robots import ROBOTS
from tests.physics.vehicles import random_state
from tests.repetitions import frequent_values

UNIT = 2.0**-24
"""Of round-off in float32."""

NUM_ENVS, DT, G = 16, 0.002, 9.80665

SNAKES = tuple(f"snakey{rods}{mode}" for rods in ("", "5", "6") for mode in ("", "_position", "_effort"))

WITH_JOINTS = ("morphy", "morphy_creeping", "morphy_fixed_base", "tilt_tricopter", *SNAKES)

OFTEN = ("snakey",)


def test_these_are_all_that_have_joints() -> None:
    assert set(WITH_JOINTS) == {name for name in ROBOTS.names() if ROBOTS.get(name).joints is not None}


@dataclass(frozen=True)
class Start:
    """A vehicle in one precision, and its motion in numbers that float32 holds."""

    model: Model
    backend: TorchBackend | WarpBackend
    state: ArticulatedState
    action: Tensor  # Thrusts of hover, then commands of drives, (E, R + C)


def make_start(
    name: str, dtype: torch.dtype, *, spread: float, moves: float, backend: TorchBackend | None = None
) -> Start:
    """Return a vehicle off its reference pose.

    Args:
        name: Of the robot.
        dtype: Float32 flies on the fused backend, float64 on that of torch.
        spread: Joints are drawn to be off by so much either way [rad], and to turn [rad/s].
        moves: Share of the motion of ``random_state``, of the order of 1 m/s and 1 rad/s.
        backend: In place of these.
    """
    robot = ROBOTS.get(name)
    vehicle = vehicle_from_config(robot, num_envs=NUM_ENVS, dtype=dtype)
    bends = build_articulation(robot, like=vehicle.mass)
    law = make_controller(CONTROLLERS.get("no_control"), vehicle, G, dt=DT)
    backend = backend or (WarpBackend() if dtype == torch.float32 else TorchBackend())
    random = Randomness(NUM_ENVS)
    random.environment.copy_(torch.arange(NUM_ENVS, dtype=torch.int32))
    model = build_model(vehicle, [], articulation=bends)
    backend.allocate(model, law, integrator="euler", random=random)
    gen = torch.Generator().manual_seed(11)

    def draw() -> Tensor:
        return spread * (2.0 * torch.rand(NUM_ENVS, bends.num_joints, dtype=torch.float64, generator=gen) - 1.0)

    thrust = torch.full((NUM_ENVS, vehicle.num_rotors), robot.body.mass * G / vehicle.num_rotors, dtype=torch.float64)
    body = random_state(NUM_ENVS, seed=5, rotor_speed=1.0)
    still = robot.joints is not None and not robot.joints.floating
    state = ArticulatedState(
        position=body.position, attitude=body.attitude, lin_vel=(0.0 if still else moves) * body.lin_vel,
        ang_vel=(0.0 if still else moves) * body.ang_vel,
        rotor_speed=state_for_thrust(vehicle, thrust.to(dtype)).double().clamp_min(0.0),
        joint_pos=bends.reference.double() + draw(), joint_vel=draw(),
    )  # fmt: skip
    stay = [bends.reference[k] * (mode == "position") for k, mode in zip(bends.driven, bends.modes, strict=True)]
    held = torch.stack(stay).double().expand(NUM_ENVS, -1) if stay else thrust[:, :0]
    rows = {field: tensor.float().to(dtype) for field, tensor in vars(state).items()}
    return Start(model, backend, ArticulatedState(**rows), torch.cat((thrust, held), dim=1).float().to(dtype))


def coordinates(state: ArticulatedState | TreeState) -> Tensor:
    """Return the coordinates of motion, (E, 6 + D): velocity and angular velocity in axes of the base, rates of joints."""
    lin_vel = quat_rotate_inverse(state.attitude, state.lin_vel)
    return torch.cat((lin_vel, state.ang_vel, state.joint_vel), dim=1)


@dataclass(frozen=True)
class Bound:
    """Of round-off in the rates of one step."""

    scale: Tensor
    """Root of the diagonal of the mass matrix, by which rates are measured, (E, N): their square is twice an energy."""

    condition: Tensor  # Of the mass matrix once it is scaled by that, (E,)
    largest: Tensor  # ``sqrt(kg) m/s``, (E,)


def step_bound(start: Start, first: int) -> Bound:
    """Return the bound, from the float64 equations of the step, with the numbers of ``test_one_step_...``.

    Args:
        start: In float64.
        first: First coordinate of motion that moves: 6 on a stand.
    """
    seen: list[Bound] = []

    def stepper(tree, links, laws, before, dt, *, gravity, drive, friction, wrench, damping, fluid, applied):
        assert damping is applied is None
        assert fluid is None
        used: list[tuple[Effort, EquationsOfMotion]] = []

        def step(acts: Effort, swings: TreeState) -> TreeState:
            used.append((acts, equations_of_motion(tree, links, swings, gravity=gravity, wrench=wrench)))
            return _implicit_step(tree, before, used[-1][1], acts, dt)

        after = step_within_limits(step, laws, drive, friction, before, dt)
        acts, result = used[-1]
        places = result.places
        mass = result.mass + torch.diag_embed(
            torch.nn.functional.pad(dt * (acts.damping + dt * acts.stiffness), (6, 0)).expand(NUM_ENVS, -1)
        )
        mass = mass[:, first:, first:]
        weight = links.mass.expand(NUM_ENVS, -1).unsqueeze(-1)
        push = weight * (gravity + result.motion.com_acc.norm(dim=-1, keepdim=True)) + wrench[..., :3].norm(
            dim=-1, keepdim=True
        )
        turn_rate = result.motion.ang_vel.norm(dim=-1, keepdim=True)
        size = places.inertia.norm(dim=(-2, -1)).unsqueeze(-1)
        twist = wrench[..., 3:].norm(dim=-1, keepdim=True)
        twist = twist + size * (result.motion.ang_acc.norm(dim=-1, keepdim=True) + turn_rate.square())
        moves, turns = point_jacobian(tree, places, places.com).norm(dim=2), angular_jacobian(tree, places).norm(dim=2)
        terms = (moves * push).sum(1) + (turns * twist).sum(1)
        joints = acts.value.abs() + 2.0 * acts.stiffness * before.joint_pos.abs()
        terms = terms + torch.nn.functional.pad(joints + 2.0 * acts.damping * before.joint_vel.abs(), (6, 0))
        scale = mass.diagonal(dim1=1, dim2=2).sqrt()
        moments = torch.linalg.eigvalsh(mass / (scale.unsqueeze(1) * scale.unsqueeze(2)))
        condition, weakest = moments[:, -1] / moments[:, 0], moments[:, 0]
        change = scale * (coordinates(after) - coordinates(before))[:, first:]
        rates = scale * coordinates(before)[:, first:]
        number = mass.shape[1]
        largest = condition * change.norm(dim=1) + dt * (terms[:, first:] / scale).norm(dim=1) / weakest
        largest = number * (3 * number + 1) * UNIT * (largest + rates.norm(dim=1))
        seen.append(Bound(scale, condition, largest))
        return after

    model, num_rotors = start.model, start.model.vehicle.num_rotors
    bends = model.articulation
    crept = bends.initialise_creep(bends.unset_dashpots(NUM_ENVS), start.state.joint_pos) if bends.num_creep else None
    speeds = state_for_thrust(model.vehicle, start.action[:, :num_rotors])
    articulated_step(model, start.state, speeds, start.action[:, num_rotors:], DT, crept=crept, stepper=stepper)
    return seen[0]


@pytest.mark.parametrize("name", frequent_values(WITH_JOINTS, OFTEN))
def test_one_step_is_off_by_no_more_than_the_condition_of_the_mass_matrix_allows(name: str) -> None:
    """Rates x after a step of dt, each times the root d of its own entry on the diagonal of M, D = diag(d), H = D⁻¹ M
    D⁻¹: ``|D dx| <= N (3 N + 1) u (k(H) |D (x - x0)| + dt |D⁻¹ F| / l(H) + |D x0|)`` with u = 2⁻²⁴, the condition k(H),
    its smallest eigenvalue l(H), and the sizes F of all terms of the forces. M has what an implicit step adds. Source:
    Higham (2002), Accuracy and Stability of Numerical Algorithms, theorem 10.6 (Demmel), for a factor of M; terms of
    the forces, off by as many units, go through ``M⁻¹ = D⁻¹ H⁻¹ D⁻¹``."""
    assert_one_step_within_bound(name)


def assert_one_step_within_bound(name: str, backend: WarpBackend | None = None) -> None:
    """Compare a step of a backend in float32, the fused one if none is given, with that of torch in float64."""
    exact = make_start(name, torch.float64, spread=0.3, moves=1.0)
    single = make_start(name, torch.float32, spread=0.3, moves=1.0, backend=backend)
    bound = step_bound(exact, 0 if exact.model.articulation.tree.floating else 6)
    for start in (exact, single):
        start.backend.step(start.state, start.action, DT, 1)
    width = bound.scale.shape[1]
    apart = (coordinates(exact.state) - coordinates(single.state).double())[:, -width:]
    away, units = (
        (bound.scale * apart).norm(dim=1),
        (bound.scale * coordinates(exact.state)[:, -width:]).norm(dim=1) * UNIT,
    )
    print(
        f"\n| `{name}` | {width} | {bound.condition.max():.1e} | {(away / units).median():.1f} | {(away / units).max():.1f} "
        f"| {(bound.largest / units).median():.1e} | {apart.abs().max():.1e} |"
    )
    assert bool((away <= bound.largest).all())


def perturb(start: Start, bound: Bound) -> Start:
    gen = torch.Generator().manual_seed(12)
    aside = torch.randn(bound.scale.shape, dtype=torch.float64, generator=gen)
    aside = bound.largest.unsqueeze(1) * torch.nn.functional.normalize(aside, dim=1) / bound.scale
    aside = torch.nn.functional.pad(aside, (6 + start.state.joint_vel.shape[1] - aside.shape[1], 0))
    state = start.state
    moved = replace(
        state, lin_vel=state.lin_vel + quat_rotate(state.attitude, aside[:, :3]),
        ang_vel=state.ang_vel + aside[:, 3:6], joint_vel=state.joint_vel + aside[:, 6:],
    )  # fmt: skip
    return replace(start, state=moved)


@pytest.mark.slow
@pytest.mark.parametrize("name", WITH_JOINTS)
def test_a_second_is_off_by_no_more_than_its_steps_together(name: str) -> None:
    """500 steps of 2 ms: the bound of a step each, grown as a start that is off by it grows in float64 until then."""
    exact, single = (make_start(name, dtype, spread=0.05, moves=0.1) for dtype in (torch.float64, torch.float32))
    other = make_start(name, torch.float64, spread=0.05, moves=0.1)
    bound = step_bound(exact, 0 if exact.model.articulation.tree.floating else 6)
    other = perturb(other, bound)
    for start in (exact, single, other):
        for _ in range(100):
            start.backend.step(start.state, start.action, DT, 5)
    width, right = bound.scale.shape[1], exact.state
    away, grown = (
        (bound.scale * (coordinates(each) - coordinates(right))[:, -width:]).norm(dim=1)
        for each in (
            ArticulatedState(**{field: rows.double() for field, rows in vars(single.state).items()}),
            other.state,
        )
    )
    growth = (grown / bound.largest).clamp_min(1.0)
    off = [
        float((getattr(right, field) - getattr(single.state, field).double()).abs().max())
        for field in ("position", "attitude", "lin_vel", "ang_vel", "joint_pos", "joint_vel")
    ]
    print(f"\n| `{name}` | " + " | ".join(f"{each:.0e}" for each in off) + f" | {growth.max():.1f} |")
    assert bool((away <= 500.0 * growth * bound.largest).all())
