"""Compliant contact against closed forms: resting, landing, sliding, bouncing, toppling, in both backends and in a
scene. Step sizes are those of the registered sims unless an order is measured. Euler is of order 1: an error of ``C
dt`` is allowed where a closed form in continuous time is met, round-off where the discrete equations have that solution
exactly."""

import itertools
from dataclasses import replace
from math import atan, cos, exp, radians, sin, sqrt

import pytest
import torch
import warp as wp
from torch import Tensor

from aerial_gym.config.environment import ContactCfg
from aerial_gym.config.shape import ShapeCfg
from aerial_gym.errors import CapabilityError, ConfigError
from aerial_gym.interop import start_warp
from aerial_gym.math.quaternion import quat_from_euler, quat_normalize, quat_rotate
from aerial_gym.math.warp_functions import vector_type
from aerial_gym.physics import TorchBackend, WarpBackend
from aerial_gym.physics.contact import POSITION_SHARE, Contacts, _velocity_change
from aerial_gym.physics.fused.contact import ContactParameters, contact_parameters, make_velocity_change, rows_type
from aerial_gym.physics.rotor_maps import POLYNOMIAL
from aerial_gym.robots import ROBOTS
from tests.physics.contact_rig import (
    BALL,
    FEET,
    GRAVITY,
    INERTIA,
    MASS,
    GroundRig,
    ObstacleRig,
    make_robot,
    obstacle,
    start,
)
from tests.physics.vehicles import F64, asymmetric_robot

F32 = torch.float32
BOTH = [(TorchBackend, F64), (WarpBackend, F32)]
PLANE = ShapeCfg(kind="plane")
ROUGH, SMOOTH = ContactCfg(friction=0.5), ContactCfg(friction=0.0)
CLEAR = 0.02
"""Height of the body origin at which FEET just touch the ground [m]."""


pytestmark = pytest.mark.usefixtures("single_thread")


@pytest.mark.parametrize("integrator", ["euler", pytest.param("rk4", marks=pytest.mark.slow)])
@pytest.mark.parametrize(("spheres", "reach"), [(BALL, 0.1), (FEET, CLEAR)])
def test_rests_at_the_depth_of_its_weight_for_ten_seconds(spheres, reach: float, integrator: str) -> None:
    """n springs k carry m g at the depth ``m g / (n k) = sinking / n``; the force is m g; nothing creeps or turns."""
    state = start(height=reach + 0.01, dtype=F32, attitude=quat_from_euler(torch.tensor([0.02, -0.03, 0.4])))
    rig = GroundRig(
        WarpBackend(), ContactCfg(friction=0.5, sinking=2e-3), state, spheres=spheres, integrator=integrator
    )
    rig.run(1.0, 0.01)
    before = state.position.clone(), state.attitude.clone()
    rig.impulse.zero_()
    rig.run(10.0, 0.01)
    assert state.position[0, 2].item() == pytest.approx(reach - 2e-3 / len(spheres), abs=1e-6)
    if spheres is FEET:  # a ball keeps rolling
        torch.testing.assert_close(state.position, before[0], rtol=0.0, atol=1e-6)
        torch.testing.assert_close(state.attitude, before[1], rtol=0.0, atol=2e-6)
        assert state.lin_vel.abs().max() < 1e-5
        assert state.ang_vel.abs().max() < 1e-4
    torch.testing.assert_close(rig.impulse / 10.0, torch.tensor([[0.0, 0.0, MASS * GRAVITY]]), rtol=0.0, atol=1e-4)


@pytest.mark.parametrize(("backend", "dtype"), BOTH)
def test_an_offset_centre_of_mass_tilts_a_vehicle_at_rest(backend, dtype: torch.dtype) -> None:
    """Feet at +-a carry ``m g (1 +- c/a) / 2`` a pair: depths ``sinking (1 +- c/a) / 4``, so it pitches down in front."""
    c, a, sinking = 0.04, 0.1, 2e-3
    rig = GroundRig(
        backend(), ContactCfg(friction=0.5, sinking=sinking), start(height=CLEAR, dtype=dtype),
        spheres=FEET, robot=make_robot(com=(c, 0.0, 0.0)),
    )  # fmt: skip
    rig.run(1.0, 0.01)
    pitch = 2.0 * rig.state.attitude[0, 1].item()
    assert pitch == pytest.approx(sinking / 4.0 * (2.0 * c / a) / (2.0 * a), rel=1e-3)  # +y turns the nose down
    assert rig.state.position[0, 2].item() == pytest.approx(CLEAR - sinking / 4.0, abs=2e-6)


@pytest.mark.slow
@pytest.mark.usefixtures("optimise_kernels")
@pytest.mark.parametrize("integrator", ["euler", "rk4"])
def test_a_tumbling_vehicle_comes_to_rest_and_never_gains_energy(integrator: str) -> None:
    g, count = torch.Generator().manual_seed(0), 256
    q = quat_normalize(torch.randn(count, 4, dtype=F64, generator=g))
    v, w = (torch.randn(count, 3, dtype=F64, generator=g) for _ in range(2))
    state = start(count, height=0.4, dtype=F32, attitude=q, lin_vel=v, ang_vel=4.0 * w)
    cage = (*FEET, *((x, y, 0.08, 0.02) for x in (0.1, -0.1) for y in (0.1, -0.1)))
    rig = GroundRig(WarpBackend(), ROUGH, state, spheres=cage, integrator=integrator)

    def energy() -> torch.Tensor:
        kinetic = 0.5 * MASS * state.lin_vel.square().sum(-1) + 0.5 * (torch.tensor(INERTIA) * state.ang_vel**2).sum(-1)
        return kinetic + MASS * GRAVITY * state.position[:, 2]

    first = last = energy()
    for _ in range(40):
        rig.run(0.05, 0.01)
        last = energy()
        assert (last <= 1.01 * first).all()  # free spin alone changes it by 0.3 % at this step
    rig.run(4.0, 0.01)
    assert energy().max() < 0.5 * first.min()
    assert state.lin_vel.abs().max() < 1e-3
    assert state.ang_vel.abs().max() < 1e-2
    upright = quat_rotate(state.attitude, torch.tensor([[0.0, 0.0, 1.0]]).expand(count, 3))[:, 2]
    assert ((upright.abs() - 1.0).abs().minimum(upright.abs()) < 0.03).all()  # on its feet, its head or a side


@pytest.mark.parametrize("integrator", ["euler", "rk4"])
def test_sliding_ends_after_the_stopping_distance(integrator: str) -> None:
    """Feet whose lowest points are level with the centre of mass: a = mu g from the first step, ``x = v² / (2 mu g)``. RK4
    moves with the mean velocity of a step and is exact but in the last step; Euler is ``v dt / 2`` short."""
    v, mu, dt = 1.0, 0.5, 0.01
    level = tuple((x, y, r, r) for x, y, _, r in FEET)
    depth = ROUGH.sinking / 4.0
    rig = GroundRig(
        TorchBackend(), ROUGH, start(height=-depth, lin_vel=(v, 0.0, 0.0)), spheres=level, integrator=integrator
    )
    for k in range(1, 20):
        rig.run(dt, dt)
        assert rig.state.lin_vel[0, 0].item() == pytest.approx(
            v - mu * GRAVITY * dt * k, abs=1e-4 * mu * GRAVITY * dt * k
        )
    rig.run(0.3, dt)
    short = 0.5 * v * dt if integrator == "euler" else 0.0
    assert rig.state.position[0, 0].item() == pytest.approx(
        v**2 / (2.0 * mu * GRAVITY) - short, abs=mu * GRAVITY * dt**2
    )
    assert rig.state.lin_vel.abs().max() < 1e-9


@pytest.mark.parametrize(("backend", "dtype"), BOTH)
def test_a_ball_with_friction_ends_up_rolling(backend, dtype: torch.dtype) -> None:
    """Angular momentum about the contact point is kept, whatever mu: ``v = v0 / (1 + J / (m r²))``, ``w_y = v / r``."""
    rig = GroundRig(backend(), ROUGH, start(height=0.099, dtype=dtype, lin_vel=(2.0, 0.0, 0.0)))
    rig.run(1.0, 0.01)
    rolling = 2.0 / (1.0 + INERTIA[1] / (MASS * 0.1**2))
    assert rig.state.lin_vel[0, 0].item() == pytest.approx(rolling, rel=1e-5)
    assert rig.state.ang_vel[0, 1].item() == pytest.approx(rolling / 0.1, rel=1e-5)


def test_a_frictionless_bounce_keeps_tangential_velocity_and_spin() -> None:
    spin = (3.0, -2.0, 5.0)
    state = start(height=0.3, lin_vel=(1.5, -0.7, -2.0), ang_vel=spin)
    ball = make_robot(inertia=(2e-3, 2e-3, 2e-3))
    rig = GroundRig(TorchBackend(), replace(SMOOTH, damping_ratio=0.1), state, robot=ball)
    rig.run(0.15, 0.002)
    assert rig.crashes.item()
    assert state.lin_vel[0, 2] > 0.5
    torch.testing.assert_close(state.lin_vel[0, :2], torch.tensor([1.5, -0.7], dtype=F64), rtol=0.0, atol=1e-12)
    torch.testing.assert_close(state.ang_vel[0], torch.tensor(spin, dtype=F64), rtol=0.0, atol=1e-12)
    torch.testing.assert_close(rig.impulse[0, :2], torch.zeros(2, dtype=F64), rtol=0.0, atol=1e-15)


@pytest.mark.parametrize("integrator", ["euler", pytest.param("rk4", marks=pytest.mark.slow)])
def test_motion_in_the_contact_converges_to_the_damped_spring_with_order_one(integrator: str) -> None:
    """``d'' = g - w² d - 2 z w d'`` from rest at 2 mm, always pressed: the closed form, steps halved twice."""
    ratio, omega, span = 0.2, sqrt(GRAVITY / 1e-2), 0.1
    rig_cfg, errors = ContactCfg(friction=0.0, sinking=1e-2, damping_ratio=ratio), []
    wd = omega * sqrt(1.0 - ratio**2)
    away = 2e-3 - 1e-2
    expected = 1e-2 + away * exp(-ratio * omega * span) * (cos(wd * span) + ratio * omega / wd * sin(wd * span))
    for dt in (4e-3, 2e-3, 1e-3):
        rig = GroundRig(TorchBackend(), rig_cfg, start(height=0.1 - 2e-3), integrator=integrator)
        rig.run(span, dt)
        errors.append(abs(0.1 - rig.state.position[0, 2].item() - expected))
    orders = [torch.log2(torch.tensor(a / b)).item() for a, b in itertools.pairwise(errors)]
    assert orders[-1] == pytest.approx(1.0, abs=0.1)


DIRECTIONS = torch.tensor([
    [1.0, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1], [0.6, 0, -0.8], [0.48, -0.6, 0.64]
])  # fmt: skip


@pytest.mark.parametrize(
    "shape", [PLANE, ShapeCfg(kind="box", size=(1.0, 1.0, 0.5)), ShapeCfg(kind="sphere", radius=0.25),
              ShapeCfg(kind="cylinder", radius=0.5, height=0.5), ShapeCfg(kind="capsule", radius=0.2, height=0.1)],
    ids=lambda s: s.kind,
)  # fmt: skip
def test_every_side_stops_what_comes_from_there(shape: ShapeCfg) -> None:
    """Walls on both sides, floor, ceiling and tilted ones: ``m v`` is taken along the outward normal, nothing across."""
    count = len(DIRECTIONS)
    turn = torch.linalg.cross(
        torch.tensor([[0.0, 0.0, 1.0]]).expand(count, 3), -DIRECTIONS
    )  # z of the shape: against us
    q = quat_normalize(torch.cat((turn, 1.0 - DIRECTIONS[:, 2:]), dim=-1))
    q[4] = torch.tensor([1.0, 0.0, 0.0, 0.0])  # half a turn
    face = 0.0 if shape.kind == "plane" else 0.25
    place = 0.3 * DIRECTIONS + face * DIRECTIONS
    state = start(count, dtype=F32, lin_vel=DIRECTIONS)
    rig = ObstacleRig([shape], obstacle(count, position=place, attitude=q), ROUGH, state, gravity=0.0, dt=0.002)
    rig.run(0.19)
    assert not rig.crashes.any()
    rig.run(0.06)
    assert rig.crashes.all()
    along = (state.position * DIRECTIONS).sum(-1)
    assert ((along > 0.19) & (along < 0.205)).all()  # the surface is 0.3 away, the radius 0.1
    speed = (state.lin_vel * DIRECTIONS).sum(-1)
    assert (speed.abs() < exp(-2.0)).all()  # what critical damping leaves
    torch.testing.assert_close(rig.impulse, MASS * (state.lin_vel - DIRECTIONS), rtol=0.0, atol=1e-6)
    across = state.lin_vel - speed[:, None] * DIRECTIONS
    assert across.abs().max() < 2e-5


@pytest.mark.parametrize("angle_deg", [20.0, 35.0])
def test_sticks_on_a_slope_below_atan_mu_and_slides_on_steeper_ones(angle_deg: float) -> None:
    """mu = 0.5 holds up to 26.6 deg; above it ``a = g (sin - mu cos)``. Displacement over 1 s; Euler: ``a t dt / 2`` more."""
    a, mu, dt, span = radians(angle_deg), 0.5, 0.01, 1.0
    q = quat_from_euler(torch.tensor([[0.0, a, 0.0]]))  # x axis points down the slope
    up = quat_rotate(q, torch.tensor([[0.0, 0.0, 1.0]]))
    feet = tuple((x, y, r, r) for x, y, _, r in FEET)
    state = start(dtype=F32, attitude=q, position=-ROUGH.sinking / 4.0 * cos(a) * up)
    before = state.position.clone()
    rig = ObstacleRig([PLANE], obstacle(1, attitude=q), ROUGH, state, spheres=feet, dt=dt)
    rig.run(span)
    moved = quat_rotate(q * torch.tensor([-1.0, -1.0, -1.0, 1.0]), state.position - before)[0]
    acc = GRAVITY * (sin(a) - mu * cos(a)) if a > atan(mu) else 0.0
    assert moved[0].item() == pytest.approx(0.5 * acc * span**2 + 0.5 * acc * span * dt, abs=2e-5 + 1e-4 * acc)
    assert moved[1:].abs().max() < 2e-5
    torch.testing.assert_close(state.attitude, q, rtol=0.0, atol=1e-4)


def test_friction_slows_a_vehicle_pressed_along_a_wall() -> None:
    """Rotors press with N against a wall at +x, without gravity: it slows down by ``mu N / m`` and the wall pushes with -N."""
    robot, speed, mu, dt = make_robot(), 400.0, 0.3, 0.002
    level = replace(robot, mounts=replace(robot.mounts, layout=tuple(
        replace(m, axis=(0.0, 0.0, 1.0), position=(0.1 * (-1) ** (i // 2), 0.1 * (-1) ** ((i + 1) // 2), 0.0))
        for i, m in enumerate(robot.mounts.layout)
    )))  # fmt: skip
    thrust = 4.0 * (1e-4 * speed + 3e-6 * speed**2)
    coefficients = torch.tensor([0.0, 1e-4, 3e-6])
    assert POLYNOMIAL.speed_for_thrust(coefficients, torch.tensor(thrust / 4.0)).item() == pytest.approx(speed)
    q = quat_from_euler(torch.tensor([[0.0, torch.pi / 2.0, 0.0]]))  # body z along world x
    head = tuple((x, y, -r, r) for x, y, _, r in FEET)  # tops level with the origin
    wall = obstacle(1, position=(0.0, 0.0, 0.0), attitude=quat_from_euler(torch.tensor([[0.0, -torch.pi / 2.0, 0.0]])))
    state = start(dtype=F32, attitude=q, lin_vel=(0.0, 1.2, 1.6), rotor_speed=speed)
    cfg = ContactCfg(friction=mu)
    state.position[:, 0] = thrust / MASS / cfg.stiffness / 4.0
    rig = ObstacleRig([PLANE], wall, cfg, state, spheres=head, robot=level, gravity=0.0, dt=dt)
    rig._still.fill_(speed)
    rig.run(0.1)
    expected = 2.0 - mu * thrust / MASS * 0.1
    torch.testing.assert_close(
        state.lin_vel, torch.tensor([[0.0, 0.6, 0.8]]) * expected, rtol=0.0, atol=1e-3 * (2.0 - expected)
    )
    assert rig.impulse[0, 0].item() / 0.1 == pytest.approx(-thrust, rel=1e-3)


def test_a_vehicle_over_an_edge_topples_towards_it() -> None:
    """Two feet stand on a box, the centre of mass is beside it: it turns about +y about the feet with
    ``m g a / (J + m l²)``. The mean over 0.1 to 0.15 s, when spring and damper have settled (1 / omega = 10 ms) and the turn
    is below 0.5 rad."""
    state = start(dtype=F32, height=CLEAR - 5e-4)
    box = ShapeCfg(kind="box", size=(1.0, 1.0, 0.4))
    rig = ObstacleRig(
        [box], obstacle(1, position=(-0.55, 0.0, -0.2)), ContactCfg(friction=1.0), state, spheres=FEET, dt=0.002
    )
    rig.run(0.05)
    first = state.ang_vel[0, 1].item()
    rig.run(0.05)
    arm = 0.1**2 + CLEAR**2
    assert (state.ang_vel[0, 1].item() - first) / 0.05 == pytest.approx(
        MASS * GRAVITY * 0.1 / (INERTIA[1] + MASS * arm), rel=0.1
    )
    assert state.ang_vel[0, [0, 2]].abs().max() < 1e-3
    rig.run(0.2)
    assert state.attitude[0, 1] > 0.3
    assert state.position[0, 2] < -0.02


def test_a_moving_wall_pushes_a_vehicle() -> None:
    """A wall that comes at 0.5 m/s leaves a vehicle at rest with that speed, no less and no more than the damper allows."""
    wall = obstacle(1, position=(-0.4, 0.0, 0.0), lin_vel=(0.5, 0.0, 0.0))
    state = start(dtype=F32)
    rig = ObstacleRig([ShapeCfg(kind="box", size=(0.2, 1.0, 1.0))], wall, ROUGH, state, gravity=0.0)
    rig.run(0.3)
    assert not rig.crashes.any()
    rig.run(0.7)
    assert rig.crashes.all()
    assert 0.5 <= state.lin_vel[0, 0].item() < 0.5 * (1.0 + exp(-2.0))
    torch.testing.assert_close(rig.impulse, MASS * state.lin_vel)


def test_a_conveyor_and_a_turntable_drag_what_stands_on_them() -> None:
    """On a plane with velocity u feet end with u; on one that turns with w about its origin, a vehicle above that turns too."""
    still = (0.0,) * 3
    assets = torch.cat((obstacle(1, lin_vel=(0.3, -0.2, 0.0)), obstacle(1, ang_vel=(0.0, 0.0, 0.5))))
    state = start(2, height=CLEAR, dtype=F32)
    rig = ObstacleRig([PLANE], assets, ROUGH, state, spheres=FEET)
    rig.run(1.0)
    expected = torch.tensor([[0.3, -0.2, 0.0], still])
    torch.testing.assert_close(state.lin_vel, expected, rtol=0.0, atol=2e-4)
    torch.testing.assert_close(state.ang_vel, torch.tensor([still, [0.0, 0.0, 0.5]]), rtol=0.0, atol=2e-3)


def test_a_corner_holds_from_both_sides() -> None:
    """A ball in the edge between floor and wall, both of one scene, is carried by one and stopped by the other."""
    wall = obstacle(1, position=(0.1, 0.0, 0.0), attitude=quat_from_euler(torch.tensor([[0.0, -torch.pi / 2.0, 0.0]])))
    state = start(height=0.1, dtype=F32, lin_vel=(1.0, 0.0, 0.0))
    rig = ObstacleRig([PLANE, PLANE], torch.cat((obstacle(1), wall), dim=1), ROUGH, state)
    rig.run(3.0)
    assert -1.0 < state.position[0, 0] <= 1e-3
    assert state.position[0, 2].item() == pytest.approx(0.099, abs=1e-5)


def test_more_overlaps_than_there_is_room_for_leave_the_deepest() -> None:
    """Twelve plates stand in each other: the highest of them, listed last, carries the weight."""
    shapes = [PLANE] * 12
    heights = torch.linspace(-0.011, 0.0, 12)
    assets = torch.cat([obstacle(1, position=(0.0, 0.0, h)) for h in heights.tolist()], dim=1)
    deep = ObstacleRig(shapes, assets, SMOOTH, start(height=0.09, dtype=F32), dt=0.002)
    deep.run(0.5)
    one = ObstacleRig([PLANE], obstacle(1), SMOOTH, start(height=0.09, dtype=F32), dt=0.002)
    one.run(0.5)
    assert one.state.position[0, 2].item() == pytest.approx(0.099, abs=1e-6)
    assert deep.state.position[0, 2].item() == pytest.approx(0.099, abs=2e-6)


@pytest.mark.parametrize("integrator", ["euler", pytest.param("rk4", marks=pytest.mark.slow)])
def test_what_touches_nothing_flies_as_without_contact_bit_for_bit(integrator: str) -> None:
    """Every second vehicle of a batch lands; the others are compared with the plant that knows no ground or scene."""
    height = torch.where(torch.arange(32) % 2 == 0, 5.0, 0.15)
    ends = []
    for kind in ("none", "ground", "scene"):
        state = start(32, height=height, dtype=F32, lin_vel=(1.0, 0.2, -0.3), ang_vel=(1.0, -2.0, 3.0))
        if kind == "scene":
            ObstacleRig([PLANE], obstacle(32), ROUGH, state, integrator=integrator).run(0.5)
        else:
            rig = GroundRig(WarpBackend(), ROUGH, state, integrator=integrator)
            if kind == "none":
                rig.backend.allocate(rig.backend._model, rig.backend._control, integrator=integrator)
            rig.run(0.5, 0.01)
        ends.append(torch.cat(state.tensors(), dim=-1))
    for end in ends[1:]:
        assert torch.equal(end[::2], ends[0][::2])
        assert (end[1::2] != ends[0][1::2]).any(dim=1).all()


@pytest.mark.parametrize("where", ["torch", "warp", "scene"])
def test_only_a_touch_at_the_crash_speed_is_a_crash(where: str) -> None:
    """Falling from h ends at ``sqrt(2 g h)``: 0.8 and 1.2 m/s against limits of 0 (every touch), 1 and inf (none). An
    explicit step tells the speed to ``g dt``. Resting afterwards adds no crash."""
    speeds = torch.tensor([0.8, 1.2, 0.0])
    dtype = F64 if where == "torch" else F32
    for limit, expected in ((0.0, [True, True, True]), (1.0, [False, True, False]), (float("inf"), [False] * 3)):
        cfg = ContactCfg(friction=0.5, crash_speed=limit)
        state = start(3, height=0.1 + speeds**2 / (2.0 * GRAVITY), dtype=dtype)
        if where == "scene":
            rig = ObstacleRig([PLANE], obstacle(3), cfg, state)
            rig.run(0.2)
        else:
            rig = GroundRig({"torch": TorchBackend, "warp": WarpBackend}[where](), cfg, state)
            rig.run(0.2, 0.01)
        assert rig.crashes.tolist() == expected


@pytest.mark.parametrize("backend", [pytest.param(TorchBackend, marks=pytest.mark.slow), WarpBackend])
def test_a_touch_comes_when_the_lowest_sphere_has_fallen_to_the_ground(backend) -> None:
    """From height h the body falls ``g t²/2``; turned over, a sphere at body z = 0.3 of radius 0.1 hangs 0.4 m below it."""
    spheres, heights = ((0.0, 0.0, 0.0, 0.05), (0.0, 0.0, 0.3, 0.1)), torch.tensor([1.0, 2.0, 5.0])
    for height in heights.tolist():
        landing = sqrt(2.0 * (height - 0.4) / GRAVITY)
        for share, touched in ((0.98, heights < height), (1.02, heights <= height)):
            state = start(3, height=heights, dtype=F32, attitude=(1.0, 0.0, 0.0, 0.0))
            rig = GroundRig(backend(), None, state, spheres=spheres, integrator="rk4")
            rig.run(share * landing, share * landing / 100.0)
            assert rig.crashes.tolist() == touched.tolist()


@pytest.mark.parametrize("backend", [TorchBackend, WarpBackend])
def test_a_touch_within_a_step_is_kept_though_the_body_is_free_at_its_end(backend) -> None:
    state = start(dtype=F32, height=0.11, lin_vel=(0.0, 0.0, -1.0), rotor_speed=1300.0)
    rig = GroundRig(backend(), None, state, robot=ROBOTS.get("base_quadrotor"))
    rig.backend.step(state, torch.full((1, 4), 2400.0), 0.005, 100)
    assert state.position[0, 2] > 0.2
    assert rig.crashes.all()


@pytest.mark.slow
def test_gradients_through_landing_and_sliding() -> None:
    """gradcheck of the state after a touchdown with friction, for initial motion and commands, away from its kinks."""
    robot = asymmetric_robot()
    first = start(2, height=0.13, lin_vel=(1.0, 0.3, -1.0), ang_vel=(0.3, -0.2, 0.5), rotor_speed=300.0)
    rig = GroundRig(TorchBackend(), ROUGH, first, spheres=((0.05, 0.02, -0.05, 0.06),), robot=robot)
    velocity, command = first.lin_vel.clone().requires_grad_(), torch.full((2, 4), 250.0, dtype=F64, requires_grad=True)

    def final(velocity: torch.Tensor, command: torch.Tensor) -> torch.Tensor:
        end = rig.backend.advance(replace(first, lin_vel=velocity), command, 0.005, 4)
        return torch.cat(end.tensors(), dim=-1)

    assert final(velocity, command)[:, 9].min() > -0.7  # -1.2 without contact
    assert torch.autograd.gradcheck(final, (velocity, command), eps=1e-6, atol=1e-5, rtol=1e-4)


def test_impossible_requests_are_refused_by_name() -> None:
    with pytest.raises(CapabilityError, match="a differentiable rollout knows no ground. Use backend 'torch'"):
        GroundRig(WarpBackend(differentiable=True), ROUGH, start(dtype=F32))
    for name, value in (("friction", -0.1), ("friction", float("nan")), ("damping_ratio", float("inf"))):
        with pytest.raises(ConfigError, match=rf"ContactCfg.{name} = .*: must be >= 0 and finite"):
            ContactCfg(**{"friction": 0.5, name: value})
    with pytest.raises(ConfigError, match=r"ContactCfg.sinking = 0.0: must be > 0"):
        ContactCfg(friction=0.5, sinking=0.0)
    with pytest.raises(ConfigError, match=r"ContactCfg.crash_speed = nan: must be >= 0; .inf for no crash at all"):
        ContactCfg(friction=0.5, crash_speed=float("nan"))


COUNT, TOUCHES, DT, LIGHT_MASS, MOMENTS = 3, 50_000, 0.01, 0.25, (4.0e-4, 4.0e-4, 8.0e-4)
LAW = ContactCfg(friction=0.6)
_gaps_type, _rows_type, _change = vector_type(COUNT), rows_type(COUNT), make_velocity_change(COUNT)


@wp.kernel(module="unique", enable_backward=False)
def _push(
    law: ContactParameters, mass: float, inertia: wp.mat33, dt: float, lin_vel: wp.array[wp.vec3], turn: wp.array[wp.vec3],
    gaps: wp.array[_gaps_type], levers: wp.array[_rows_type], normals: wp.array[_rows_type],
    change_out: wp.array2d[wp.vec3],
):  # fmt: skip
    e = wp.tid()
    straight, turned = _change(
        law, dt, mass, inertia, wp.quat_identity(), lin_vel[e], turn[e], gaps[e], levers[e], normals[e], _rows_type()
    )
    change_out[e, 0] = straight
    change_out[e, 1] = turned


def random_contacts() -> tuple[Contacts, Tensor, Tensor]:
    """Return contacts all round a small quadrotor, up to 6 cm deep, at up to 3 m/s and 10 rad/s; each is missing with 30 %."""
    g = torch.Generator().manual_seed(5)

    def draw_uniform(*shape: int) -> Tensor:
        return 2.0 * torch.rand(*shape, generator=g) - 1.0

    gap = -0.06 * torch.rand(TOUCHES, COUNT, generator=g) * (torch.rand(TOUCHES, COUNT, generator=g) > 0.3)
    normal = torch.randn(TOUCHES, COUNT, 3, generator=g)
    upright = torch.eye(3)[torch.randint(3, (TOUCHES, COUNT), generator=g)]
    normal = torch.where(torch.rand(TOUCHES, COUNT, 1, generator=g) > 0.5, normal, upright)
    contacts = Contacts(
        gap=gap, lever=0.2 * draw_uniform(TOUCHES, COUNT, 3), normal=normal / normal.norm(dim=-1, keepdim=True)
    )
    return contacts, 3.0 * draw_uniform(TOUCHES, 3), 10.0 * draw_uniform(TOUCHES, 3)


def warp_change(contacts: Contacts, lin_vel: Tensor, turn: Tensor) -> Tensor:
    """Return the changes of velocity and angular velocity, (E, 6)."""
    start_warp()
    out = torch.zeros(TOUCHES, 2, 3)
    inertia = wp.mat33(*torch.tensor(MOMENTS).diag().flatten().tolist())
    vectors = [wp.from_torch(value, dtype=wp.vec3) for value in (lin_vel, turn)]
    rows = [wp.from_torch(value.contiguous(), dtype=_rows_type) for value in (contacts.lever, contacts.normal)]
    inputs = [contact_parameters(LAW, POSITION_SHARE["euler"]), LIGHT_MASS, inertia, DT, *vectors]
    inputs += [wp.from_torch(contacts.gap, dtype=_gaps_type), *rows, wp.from_torch(out, dtype=wp.vec3)]
    wp.launch(_push, dim=TOUCHES, inputs=inputs, device="cpu")
    return out.flatten(1)


def torch_change(contacts: Contacts, lin_vel: Tensor, turn: Tensor) -> Tensor:
    inertia = torch.diag(torch.tensor((LIGHT_MASS, LIGHT_MASS, LIGHT_MASS, *MOMENTS), dtype=turn.dtype)).expand(
        TOUCHES, 6, 6
    )
    mass = turn.new_full((TOUCHES, 1), LIGHT_MASS)
    return _velocity_change(contacts, LAW, mass, inertia, (lin_vel, turn), DT, POSITION_SHARE["euler"])


@pytest.mark.parametrize("change", [warp_change, torch_change])
def test_no_touch_adds_more_energy_than_its_springs_hold(change) -> None:
    """In float32. Springs and dampers act at the end of a step: they give no more than was pressed, and friction takes. What
    was pressed is counted where the points were a step before, or are, whichever is deeper. At most 5 of 50,000 touches,
    whose branches alternate to the end, may gain more than round-off allows; none more than the energy of its motion. Where
    the direction of a slip that was nearly none was not tangential, 34 did, and the worst gained 49,000 times that
    energy."""
    contacts, lin_vel, turn = random_contacts()
    delta = change(contacts, lin_vel, turn)
    moments = torch.tensor((LIGHT_MASS, LIGHT_MASS, LIGHT_MASS, *MOMENTS))
    before = torch.cat((lin_vel, turn), -1)
    gained = 0.5 * (moments * ((before + delta).square() - before.square())).sum(-1)
    speed = (contacts.normal * (lin_vel.unsqueeze(1) + turn.unsqueeze(1).cross(contacts.lever, dim=-1))).sum(-1)
    depth = (contacts.gap < 0.0) * torch.minimum(contacts.gap - DT * speed, contacts.gap)
    held = 0.5 * LIGHT_MASS * LAW.stiffness * depth.square().sum(-1)
    kinetic = 0.5 * (moments * before.square()).sum(-1)
    beyond = (gained - held) / kinetic
    assert (beyond > 1e-3).sum() <= 5
    assert beyond.max() < 1.0
    assert (contacts.gap.amin(-1) < 0.0).sum() > 0.9 * TOUCHES
    assert torch.equal(delta[contacts.gap.amin(-1) >= 0.0], torch.zeros_like(delta[contacts.gap.amin(-1) >= 0.0]))
