"""The ground in MuJoCo as a backend: the compliance that a robot's contact file asks for, in closed form and beside
torch. All in float64. K is the stiffness and zeta the damping ratio of a ``ContactCfg``, per mass of the robot."""

from dataclasses import replace
from math import asin, exp, pi, sqrt, tan

import pytest
import torch

from aerial_gym.config.environment import ContactCfg
from aerial_gym.control import CONTROLLERS, make_controller
from aerial_gym.math.quaternion import quat_from_euler, quat_rotate
from aerial_gym.physics import BACKENDS, EFFECTS, Ground, build_model, vehicle_from_config
from aerial_gym.physics.mujoco.mjcf import contact_softness
from tests.physics.contact_rig import BALL, FEET, GRAVITY, MASS, GroundRig, make_robot, start
from tests.physics.vehicles import F64, asymmetric_robot

pytest.importorskip("mujoco", reason="MuJoCo is not installed: pip install 'aerial-gym[mujoco]'")

ROUGH = ContactCfg(friction=0.5)


def on_ground(cfg: ContactCfg | None, state, **options) -> GroundRig:
    return GroundRig(BACKENDS.get("mujoco")(), cfg, state, **options)


@pytest.mark.parametrize("dt", [pytest.param(0.001, marks=pytest.mark.slow), 0.004, 0.02])
@pytest.mark.parametrize("spheres", [BALL, FEET])
def test_weight_presses_each_contact_as_deep_as_the_file_says(spheres, dt: float) -> None:
    """At rest m g = n K m depth for n contacts, at steps of any length; the ground's impulse is the change of momentum."""
    rig, lowest = on_ground(ROUGH, start(height=0.15), spheres=spheres), min(z - r for _, _, z, r in spheres)
    span = max(1.0, 100 * dt)
    rig.run(span, dt)
    depth = -(rig.state.position[0, 2].item() + lowest)
    assert depth == pytest.approx(ROUGH.sinking / len(spheres), rel=1e-4)  # float32 radii of 0.1 m, depths of 1 mm
    assert rig.state.lin_vel.norm() < 1e-9
    assert rig.impulse[0, 2].item() == pytest.approx(MASS * GRAVITY * span, rel=1e-9)


@pytest.mark.parametrize("damping_ratio", [*(pytest.param(z, marks=pytest.mark.slow) for z in (0.0, 0.1, 0.7)), 0.3])
def test_a_bounce_is_that_of_a_spring_and_a_damper_that_never_pull(damping_ratio: float) -> None:
    """Without gravity the speeds after and before are as ``exp(-tan(phi) (pi - 2 phi))``, ``sin(phi) = zeta``. A touch is
    noticed up to one step late: an error of less than ``dt sqrt(K)`` at each end."""
    dt, cfg = 1e-4, ContactCfg(friction=0.0, damping_ratio=damping_ratio)
    rig = on_ground(cfg, start(height=0.105, lin_vel=(0.0, 0.0, -1.0)), gravity=0.0)
    rig.run(0.06, dt)
    phi = asin(damping_ratio)
    expected = exp(-tan(phi) * (pi - 2.0 * phi))
    assert abs(rig.state.lin_vel[0, 2].item() - expected) < 2.0 * dt * sqrt(cfg.stiffness)


@pytest.mark.parametrize("dt", [pytest.param(0.002, marks=pytest.mark.slow), 0.02])
def test_a_tumbling_vehicle_comes_to_rest_without_gaining_energy(dt: float) -> None:
    """Feet far from the centre of mass, which make contacts hard: motion and height together never hold more than at first.
    Free flight of semi-implicit Euler keeps them to ``g dt v / 2`` per mass, here less than 2 %."""
    robot = asymmetric_robot()
    attitude = quat_from_euler(torch.tensor([[0.4, -0.3, 0.2]], dtype=F64))
    first = start(height=0.4, attitude=attitude, lin_vel=(0.5, 0.0, -1.0), ang_vel=(2.0, -1.0, 1.0))
    rig = on_ground(ROUGH, first, spheres=FEET, robot=robot)
    vehicle = vehicle_from_config(robot, num_envs=1, dtype=F64)
    energies = []
    for _ in range(round(2.0 / dt)):
        w, v, up = rig.state.ang_vel[0], rig.state.lin_vel[0], rig.state.position[0, 2]
        v = v + _rotate(rig.state.attitude, torch.linalg.cross(w, vehicle.com[0]))
        up = up + _rotate(rig.state.attitude, vehicle.com[0])[2]
        kinetic = 0.5 * vehicle.mass[0] * v.square().sum() + 0.5 * w @ vehicle.inertia[0] @ w
        energies.append((kinetic + vehicle.mass[0] * GRAVITY * up).item())
        rig.run(dt, dt)
    assert max(energies) < 1.02 * energies[0]
    assert rig.state.lin_vel.norm() < 1e-3
    assert rig.state.ang_vel.norm() < 1e-2


def _rotate(attitude: torch.Tensor, vector: torch.Tensor) -> torch.Tensor:
    return quat_rotate(attitude, vector.unsqueeze(0))[0]


def test_a_sliding_vehicle_stops_where_coulomb_says() -> None:
    """From 1 m/s after ``v² / (2 mu g)``; one per cent for the millimetres in which contacts give way."""
    level = tuple((x, y, r, r) for x, y, _, r in FEET)
    rig = on_ground(ROUGH, start(height=-ROUGH.sinking / 4, lin_vel=(0.8, 0.6, 0.0)), spheres=level)
    rig.run(0.5, 0.001)
    expected = 1.0 / (2.0 * ROUGH.friction * GRAVITY)
    assert rig.state.position[0, :2].norm().item() == pytest.approx(expected, rel=0.01)
    assert (rig.state.position[0, 0] / rig.state.position[0, 1]).item() == pytest.approx(0.8 / 0.6, rel=1e-3)


def test_what_sticks_creeps_as_slowly_as_the_impedance_ratio_says() -> None:
    """A force F on n contacts moves them at ``F / m / (n r 2 zeta sqrt(K / s))``, r = 100, s the softening of the step."""
    dt, wind, drag = 0.002, 4.0, 0.3
    vehicle = vehicle_from_config(make_robot(), num_envs=1, dtype=F64)
    rows = [(EFFECTS.get("constant_wind"), (wind, 0.0, 0.0)), (EFFECTS.get("rotor_drag"), (drag, drag, drag))]
    model = build_model(vehicle, [(effect, torch.tensor([row], dtype=F64)) for effect, row in rows])
    level = torch.tensor([(x, y, r, r) for x, y, _, r in FEET])
    ground = Ground(height=0.0, spheres=level, contact=torch.zeros(1, dtype=torch.bool), cfg=ROUGH)
    backend, state = BACKENDS.get("mujoco")(), start(height=-ROUGH.sinking / 4)
    law = make_controller(CONTROLLERS.get("rotor_speed_control"), vehicle, GRAVITY)
    backend.allocate(model, law, integrator="euler", ground=ground)
    backend.step(state, torch.zeros(1, 4, dtype=F64), dt, 500)
    expected = wind * drag / MASS / (4 * 100.0 * 2.0 * sqrt(ROUGH.stiffness / contact_softness(ROUGH, dt)))
    assert 0.2 < wind * drag / (MASS * GRAVITY) < ROUGH.friction
    assert state.lin_vel[0, 0].item() == pytest.approx(expected, rel=0.01)


def test_only_a_fast_touch_is_a_crash() -> None:
    cfg = replace(ROUGH, crash_speed=0.5)
    rig = on_ground(cfg, start(2, height=0.101, lin_vel=((0.0, 0.0, -0.3), (0.0, 0.0, -0.8))))
    rig.run(0.1, 0.001)
    assert rig.crashes.tolist() == [False, True]
    assert (rig.impulse[:, 2] > 0.0).all()


def test_a_ground_that_does_not_push_is_reported_and_passed() -> None:
    rig = on_ground(None, start(2, height=torch.tensor((0.3, 5.0), dtype=F64)))
    rig.run(0.5, 0.01)
    assert rig.crashes.tolist() == [True, False]
    assert rig.state.position[0, 2] < -0.5
    assert not rig.impulse.any()


def test_environments_touch_alone_as_in_a_batch_and_centres_of_mass_move_their_feet() -> None:
    """Bit for bit; with an offset centre of mass the level feet still stand at the height at which the plane holds them."""
    robot = make_robot(com=(0.03, -0.02, 0.05))
    heights = (0.03, 0.05, 0.2)
    batch = on_ground(ROUGH, start(3, height=torch.tensor(heights, dtype=F64)), spheres=FEET, robot=robot)
    batch.run(0.8, 0.002)
    for env, height in enumerate(heights):
        alone = on_ground(ROUGH, start(height=height), spheres=FEET, robot=robot)
        alone.run(0.8, 0.002)
        assert torch.equal(alone.state.position[0], batch.state.position[env])
        assert torch.equal(alone.impulse[0], batch.impulse[env])
    feet = [
        (batch.state.position[0] + _rotate(batch.state.attitude[:1], torch.tensor((x, y, z), dtype=F64)))[2] - r
        for x, y, z, r in FEET
    ]
    loads = -ROUGH.stiffness * MASS * torch.stack(feet)
    assert loads.sum().item() == pytest.approx(MASS * GRAVITY, rel=1e-3)
    lever = sum(load * x for load, (x, *_) in zip(loads, FEET, strict=True))
    assert lever.item() == pytest.approx(
        MASS * GRAVITY * 0.03, rel=0.02
    )  # the feet under the centre of mass carry more
