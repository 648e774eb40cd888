"""Boxes and capsules on the ground: they rest, tip, roll and slide as closed forms say, in both backends, and as in MuJoCo.
Firm contact at speed: no crossing of a part is missed, and nothing passes through a thin wall or pole. The crossings
are those of ``test_sweep``: truth that shares no code with the package.
"""

from math import atan2, exp
from pathlib import Path

import numpy as np
import pytest
import torch

from aerial_gym.assets.cores import contact_points
from aerial_gym.config.environment import ContactCfg
from aerial_gym.config.robot import BoxCfg, CapsuleCfg, CollisionShape, SphereCfg
from aerial_gym.config.shape import ShapeCfg
from aerial_gym.math.quaternion import euler_from_quat, quat_from_euler, quat_rotate, quat_rotate_inverse
from aerial_gym.physics import TorchBackend, WarpBackend
from tests.physics.contact_rig import CPU, GRAVITY, INERTIA, MASS, GroundRig, ObstacleRig, make_robot, obstacle, start
from tests.physics.test_sweep import DT, HULLS, MESHES, PARTS, SweepMotion, crossings, make_shape
from tests.physics.vehicles import F64
from tests.repetitions import rare_values

F32 = torch.float32
BOTH = [(TorchBackend, F64), (WarpBackend, F32)]
WARP_SOONER = [pytest.param(TorchBackend, F64, marks=pytest.mark.slow), (WarpBackend, F32)]
"""Of flights of a thousand steps: in torch twenty seconds each."""

ROUGH = ContactCfg(friction=0.5)
CRATE = BoxCfg(size=(0.1, 0.3, 0.24))
LOG = CapsuleCfg(radius=0.04, height=0.3, euler=(0.0, 1.5707963267948966, 0.0))
"""Its long axis is the body's x."""


pytestmark = pytest.mark.usefixtures("single_thread")


def point_rows(*shapes: CollisionShape) -> tuple[tuple[float, ...], ...]:
    return tuple(tuple(row) for row in contact_points(shapes, device=CPU).tolist())


@pytest.mark.parametrize(("backend", "dtype"), WARP_SOONER)
def test_a_box_tips_when_its_centre_of_mass_passes_the_edge(backend, dtype: torch.dtype) -> None:
    """It leans over the edge at half width 0.05 m, 0.12 m below its centre, and falls back up to atan(0.05 / 0.12). Two
    degrees on either side, forward and backward; the edge gives way by a millimetre, which is 0.5 degrees."""
    edge = atan2(0.05, 0.12)
    lean = torch.tensor([edge - 0.035, edge + 0.035, -edge + 0.035, -edge - 0.035], dtype=dtype)
    euler = torch.stack((torch.zeros_like(lean), lean, torch.zeros_like(lean)), dim=-1)
    attitude = quat_from_euler(euler)
    corner = torch.tensor([0.05, 0.0, -0.12], dtype=dtype) * torch.stack((lean.sign(), lean * 0 + 1, lean * 0 + 1), -1)
    height = -quat_rotate(attitude, corner)[:, 2]
    friction = ContactCfg(friction=5.0)
    rig = GroundRig(
        backend(), friction, start(4, height=height, dtype=dtype, attitude=attitude), spheres=point_rows(CRATE)
    )
    rig.run(2.0, 0.002)
    up = quat_rotate(rig.state.attitude, torch.tensor([0.0, 0.0, 1.0], dtype=dtype).expand(4, 3))
    assert (up[[0, 2], 2] > 0.999).all()  # upright again
    assert (up[[1, 3], 2].abs() < 0.05).all()  # on its side
    assert up[1, 0] > 0.99  # a positive pitch leans to +x
    assert up[3, 0] < -0.99


@pytest.mark.parametrize(("backend", "dtype"), WARP_SOONER)
def test_a_capsule_rolls_about_its_long_axis_and_slides_along_it(backend, dtype: torch.dtype) -> None:
    """Pushed across, it ends up rolling at ``v / (1 + I / (m r²))``; pushed along, it stops after ``v² / (2 mu g)``."""
    v, r = 0.8, LOG.radius
    push = torch.tensor([[0.0, v, 0.0], [v, 0.0, 0.0]], dtype=dtype)
    rig = GroundRig(backend(), ROUGH, start(2, height=r - 0.5e-3, dtype=dtype, lin_vel=push), spheres=point_rows(LOG))
    rig.run(2.0, 0.002)
    rolling = v / (1.0 + INERTIA[0] / (MASS * r * r))
    assert rig.state.lin_vel[0, 1].item() == pytest.approx(rolling, rel=5e-3)
    assert rig.state.ang_vel[0, 0].item() == pytest.approx(-rolling / r, rel=2e-2)  # +y with the ground below: about -x
    assert rig.state.position[1, 0].item() == pytest.approx(v * v / (2.0 * 0.5 * GRAVITY), rel=2e-2)
    assert rig.state.lin_vel[1].abs().max() < 1e-4
    assert rig.state.ang_vel[1].abs().max() < 1e-3


@pytest.mark.parametrize("speed", [0.5, 1.5])
def test_a_flat_landing_takes_its_friction_of_the_impact(speed: float) -> None:
    """Falling h it meets the ground at ``v_z = sqrt(2 g h)`` and loses ``mu v_z`` of its speed at once, then slides to rest.
    Without a bounce the path is ``v sqrt(2 h / g) + (v - mu v_z)² / (2 mu g)``; the impact lasts about sqrt(sinking / g) =
    10 ms with the speed between those before and after it, which displaces the end by at most ``mu v_z`` times that."""
    h, mu = 0.03, 0.5
    state = start(height=0.02 + h, dtype=F32, lin_vel=(speed, 0.0, 0.0))
    rig = GroundRig(WarpBackend(), ROUGH, state, spheres=point_rows(BoxCfg(size=(0.4, 0.4, 0.04))))
    rig.run(1.5, 0.001)
    impact = (2.0 * GRAVITY * h) ** 0.5
    expected = speed * (2.0 * h / GRAVITY) ** 0.5 + (speed - mu * impact) ** 2 / (2.0 * mu * GRAVITY)
    assert rig.state.position[0, 0].item() == pytest.approx(expected, abs=0.01 * mu * impact)
    torch.testing.assert_close(euler_from_quat(rig.state.attitude), torch.zeros(1, 3), rtol=0.0, atol=1e-4)


MUJOCO_CASES = {
    "ball": (
        SphereCfg(center=(0.0, 0.0, 0.0), radius=0.1), '<geom type="sphere" size="0.1" mass="0"/>', (1.0, 0.4, 0.0), 0.15,
    ),
    "chest": (
        BoxCfg(size=(0.3, 0.3, 0.1)), '<geom type="box" size="0.15 0.15 0.05" mass="0"/>', (0.6, 0.25, 0.0), 0.05,
    ),
    "log": (LOG, '<geom type="capsule" size="0.04 0.15" euler="0 90 0" mass="0"/>', (0.3, 0.6, 0.0), 0.04),
    "dropped": (
        BoxCfg(size=(0.4, 0.4, 0.04)), '<geom type="box" size="0.2 0.2 0.02" mass="0"/>', (1.5, 0.0, 0.0), 0.05,
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", MUJOCO_CASES)
def test_sliding_rolling_and_landing_agree_with_mujoco(case: str) -> None:
    """Where and how a dropped ball, a pushed chest, a pushed log and a dropped plate are after 0.6 s. Both engines have
    compliances of about 1 mm and 10 ms. None of them tips: how far a box rocks on its edge depends on the compliance of
    either engine (``CRATE``, whose edge is within the friction cone, goes 24 to 30 mm for ``sinking`` of 4 to 0.25 mm
    here, 33 to 36 mm there)."""
    mujoco = pytest.importorskip("mujoco", reason="MuJoCo is not installed: pip install 'aerial-gym[dev]'")
    shape, geom, velocity, height = MUJOCO_CASES[case]
    model = mujoco.MjModel.from_xml_string(f"""
      <mujoco><compiler angle="degree"/>
      <option timestep="2e-4" gravity="0 0 {-GRAVITY}" cone="elliptic" impratio="50"/>
      <default><geom friction="0.5 0 0" condim="3" solref="0.01 1" solimp="0.99 0.99 0.001"/></default>
      <worldbody><geom type="plane" size="9 9 1"/><body pos="0 0 {height}"><freejoint/>
        <inertial pos="0 0 0" mass="{MASS}" diaginertia="{" ".join(map(str, INERTIA))}"/>{geom}
      </body></worldbody></mujoco>""")
    data = mujoco.MjData(model)
    data.qvel[:3] = velocity
    for _ in range(3000):
        mujoco.mj_step(model, data)
    state = start(height=height, dtype=F32, lin_vel=velocity)
    rig = GroundRig(WarpBackend(), ROUGH, state, spheres=point_rows(shape))
    rig.run(0.6, 0.002)
    reference = torch.tensor(data.qpos[:3])
    assert (rig.state.position[0].double() - reference)[:2].norm() < 0.02 * reference[:2].norm()
    assert abs(rig.state.position[0, 2].item() - reference[2].item()) < 2e-3
    torch.testing.assert_close(rig.state.lin_vel[0].double(), torch.tensor(data.qvel[:3]), rtol=0.0, atol=0.03)
    torch.testing.assert_close(rig.state.ang_vel[0].double(), torch.tensor(data.qvel[3:]), rtol=0.05, atol=0.05)


PLATE = BoxCfg(size=(0.4, 0.4, 0.04))


@pytest.mark.slow
def test_a_plate_rests_on_a_block_that_no_corner_of_it_touches() -> None:
    """Four corners of the block carry it: depth ``sinking / 4``, level, in both backends' ways to contact."""
    for backend in (WarpBackend(), TorchBackend()):
        state = start(height=0.1 + 0.02 + 0.005, dtype=F32, attitude=quat_from_euler(torch.tensor([0.0, 0.0, 0.3])))
        block = ShapeCfg(kind="box", size=(0.2, 0.2, 0.2))
        rig = ObstacleRig([block], obstacle(1), ROUGH, state, body=(PLATE,), backend=backend)
        rig.run(2.0)
        assert state.position[0, 2].item() == pytest.approx(0.12 - 0.25e-3, abs=5e-6)
        torch.testing.assert_close(euler_from_quat(state.attitude)[:, :2], torch.zeros(1, 2), rtol=0.0, atol=1e-5)
        assert state.lin_vel.abs().max() < 1e-4


def test_a_pole_stops_the_middle_of_an_edge() -> None:
    """A plate flies at a thin pole far from its corners, without gravity, and does not turn. With the critical damping of
    one contact ``x = v t exp(-w t)``, and the push ``w² x + 2 w x'`` ends at ``w t = 2``: it leaves with ``-v exp(-2)``, to
    which the speeds of two step sizes extrapolate (order 1). A ball that reaches as far leaves like it at each of them. The
    middle of the edge is found to 2^-15 of its length, a lever by which the impulse may turn it."""
    pole, v, speeds = ShapeCfg(kind="cylinder", radius=0.01, height=2.0), 0.5, []
    for dt in (2e-4, 1e-4):
        for shape in ({"body": (PLATE,)}, {"spheres": ((0.0, 0.0, 0.0, 0.2),)}):
            state = start(height=0.0, dtype=F32, lin_vel=(v, 0.0, 0.0))
            rig = ObstacleRig([pole], obstacle(1, position=(0.25, 0.0, 0.0)), ROUGH, state, gravity=0.0, dt=dt, **shape)
            rig.run(0.2)
            speeds.append(state.lin_vel[0, 0].item())
            turn = MASS * v * (1.0 + exp(-2.0)) * 0.4 * 2.0**-15 / INERTIA[2]
            assert state.ang_vel.abs().max() < turn
            assert state.lin_vel[0, 1:].abs().max() < 0.2 * turn
            assert rig.impulse[0, 0].item() == pytest.approx(MASS * (speeds[-1] - v), rel=1e-4)
    assert speeds[0] == pytest.approx(speeds[1], rel=5e-3)
    assert speeds[2] == pytest.approx(speeds[3], rel=5e-3)
    assert 2.0 * speeds[2] - speeds[0] == pytest.approx(-v * exp(-2.0), rel=0.01)


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_pole_beside_the_middle_turns_a_plate_the_right_way(side: float) -> None:
    """Hit at y = 0.1 m ahead the plate is held back on its left and turns left; hit on its right it turns right."""
    pole = ShapeCfg(kind="cylinder", radius=0.01, height=2.0)
    state = start(height=0.0, dtype=F32, lin_vel=(0.5, 0.0, 0.0))
    rig = ObstacleRig(
        [pole], obstacle(1, position=(0.25, 0.1 * side, 0.0)), ContactCfg(friction=0.0), state, body=(PLATE,),
        gravity=0.0, dt=0.002,
    )  # fmt: skip
    rig.run(0.15)
    assert side * state.ang_vel[0, 2] > 0.5
    assert state.lin_vel[0, 0] < 0.45


def test_two_crossed_rods_hold_each_other() -> None:
    """A capsule falls across another one, middle on middle, and stays there: neither has an end near."""
    rod = CapsuleCfg(radius=0.02, height=0.6, euler=(1.5707963267948966, 0.0, 0.0))  # along y
    lying = ShapeCfg(kind="capsule", radius=0.05, height=2.0)
    place = obstacle(1, attitude=quat_from_euler(torch.tensor([0.0, 1.5707963267948966, 0.0])))  # along x
    state = start(height=0.08, dtype=F32)
    rig = ObstacleRig([lying], place, ContactCfg(friction=0.5), state, body=(rod,), dt=0.005)
    rig.run(0.5)
    assert state.position[0, 2].item() == pytest.approx(0.07 - 1e-3, abs=1e-4)  # one contact: the whole sinking
    assert state.lin_vel.abs().max() < 1e-2
    assert rig.impulse[0, 2] > 0.0


ROUND = make_robot(inertia=(3e-3, 3e-3, 3e-3))
"""Its free rotation keeps its rate."""
FIRM = ContactCfg(friction=0.5)
BACKENDS = rare_values([WarpBackend, TorchBackend], [TorchBackend])
WALL = ShapeCfg(kind="box", size=(0.02, 50.0, 50.0))


def tensor(values: np.ndarray) -> torch.Tensor:
    return torch.as_tensor(values, dtype=F32)


def in_flight(
    hull: str, shape: ShapeCfg, robot: SweepMotion, other: SweepMotion, backend=WarpBackend, *, moves: bool
) -> ObstacleRig:
    attitude = tensor(robot.attitude.as_quat())
    turn = tensor(robot.turns[0] / DT)
    state = start(
        len(attitude), dtype=F32, position=tensor(robot.start), attitude=attitude,
        lin_vel=tensor(robot.shifts[0] / DT), ang_vel=quat_rotate_inverse(attitude, turn),
    )  # fmt: skip
    columns = (other.start, other.attitude.as_quat(), other.shifts[0] / DT, other.turns[0] / DT)
    parts = tensor(np.concatenate(columns, axis=1)).unsqueeze(1)
    return ObstacleRig(
        [shape], parts, FIRM, state, body=(HULLS[hull],), robot=ROUND, dt=DT, gravity=0.0, backend=backend(),
        moves=moves,
    )  # fmt: skip


@pytest.mark.parametrize("moves", rare_values([True, False], [False]))
@pytest.mark.parametrize("name", [*(name for name in PARTS if name != "plane"), *MESHES])
@pytest.mark.parametrize("hull", HULLS)
@pytest.mark.parametrize("flights", rare_values([300, 100_000], [100_000]))
def test_no_crossing_is_missed(hull: str, name: str, moves: bool, flights: int, tmp_path: Path) -> None:
    """At 5 to 40 m/s, up to 30 rad/s, parts at up to 20 m/s and 20 rad/s, in one substep of 10 ms."""
    shape, part = make_shape(name, tmp_path)
    flights = 15 if flights == 300 and name in MESHES else flights
    robot, other = crossings(HULLS[hull], part, flights, moves=moves, k=1)
    rig = in_flight(hull, shape, robot, other, moves=moves)
    rig.run(DT)
    assert np.flatnonzero(~rig.crashes.numpy()).tolist() == []


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("hull", HULLS)
@pytest.mark.parametrize("flights", rare_values([24, 10_000], [10_000]))
def test_nothing_passes_through_a_thin_wall(hull: str, backend, flights: int) -> None:
    """A wall of 2 cm, at rest or coming at up to 20 m/s, met at 5 to 40 m/s and up to 30 rad/s, for half a second."""
    rng = np.random.default_rng(3)
    size = (flights, 3)
    speed = rng.uniform(5.0, 40.0, size=flights)
    lin_vel = np.stack((speed, *rng.uniform(-0.5, 0.5, size=(2, flights)) * speed), axis=1)
    position = np.stack((rng.uniform(-1.0, -0.5, size=flights), *np.zeros((2, flights))), axis=1)
    coming = np.zeros(size)
    coming[::2, 0] = -rng.uniform(0.0, 20.0, size=len(coming[::2]))
    state = start(
        flights, dtype=F32, position=tensor(position), lin_vel=tensor(lin_vel),
        ang_vel=tensor(rng.uniform(-17.0, 17.0, size=size)),
    )  # fmt: skip
    parts = obstacle(flights, lin_vel=tensor(coming))
    before = state.lin_vel.norm(dim=1)
    points = contact_points([HULLS[hull]], device=CPU)[:, :3]
    rig = ObstacleRig(
        [WALL], parts, FIRM, state, body=(HULLS[hull],), robot=ROUND, dt=DT, gravity=0.0, backend=backend()
    )
    for _ in range(25):
        rig.run(2 * DT)
        ends = [state.position + quat_rotate(state.attitude, point.expand(flights, 3)) for point in points]
        beyond = torch.stack(ends)[..., 0] - parts[:, 0, 0]
        assert beyond.max() < 0.0
    assert rig.crashes.all()
    still = torch.arange(flights) % 2 == 1
    assert (state.lin_vel.norm(dim=1) <= before)[still].all()  # nothing is fed
    assert (state.lin_vel[:, 0] - parts[:, 0, 7]).abs().max() < 30.0


@pytest.mark.parametrize("backend", BACKENDS)
def test_a_pole_met_at_its_middle_stops_a_ball(backend) -> None:
    speed = torch.linspace(5.0, 40.0, 8)
    state = start(8, dtype=F32, position=(-0.73, 0.0, 0.0))
    state.lin_vel[:, 0] = speed
    pole = ShapeCfg(kind="cylinder", radius=0.01, height=2.0)
    rig = ObstacleRig(
        [pole], obstacle(8), FIRM, state, spheres=((0.0, 0.0, 0.0, 0.05),), robot=ROUND, dt=DT, gravity=0.0,
        backend=backend(),
    )  # fmt: skip
    rig.run(0.5)
    assert state.position[:, 0].max() < -0.03
    assert state.lin_vel.norm(dim=1).max() < 0.5
    assert rig.crashes.all()
    torch.testing.assert_close(rig.impulse[:, 0], MASS * (state.lin_vel[:, 0] - speed), rtol=1e-4, atol=0.0)


def test_a_room_of_thin_walls_holds_what_flies_in_it() -> None:
    rng = np.random.default_rng(4)
    flat = [ShapeCfg(kind="box", size=tuple(np.where(np.eye(3)[axis] > 0, 0.02, 1.2).tolist())) for axis in range(3)]
    parts = torch.zeros(60, 6, 13)
    parts[..., 6] = 1.0
    for axis in range(3):
        parts[:, 2 * axis, axis], parts[:, 2 * axis + 1, axis] = -0.5, 0.5
    velocity = rng.normal(size=(60, 3))
    state = start(60, dtype=F32, lin_vel=tensor(40.0 * velocity / np.linalg.norm(velocity, axis=1, keepdims=True)))
    walls = [flat[0], flat[0], flat[1], flat[1], flat[2], flat[2]]
    law = ContactCfg(friction=0.0, damping_ratio=0.0)
    rig = ObstacleRig(
        walls, parts, law, state, spheres=((0.0, 0.0, 0.0, 0.05),), robot=ROUND, dt=DT, gravity=0.0, moves=False
    )
    for _ in range(100):
        rig.run(DT)
        assert state.position.abs().max() < 0.5


@pytest.mark.parametrize(("crash_speed", "crashes"), [(0.0, True), (19.0, True), (21.0, False)])
def test_a_crossing_is_a_crash_by_its_speed_of_approach(crash_speed: float, crashes: bool) -> None:
    state = start(1, dtype=F32, position=(-0.1, 0.0, 0.0), lin_vel=(20.0, 15.0, 0.0))
    law = ContactCfg(friction=0.5, crash_speed=crash_speed)
    rig = ObstacleRig(
        [WALL], obstacle(1), law, state, spheres=((0.0, 0.0, 0.0, 0.05),), robot=ROUND, dt=DT, gravity=0.0
    )
    rig.run(DT)
    assert rig.crashes.tolist() == [crashes]


@pytest.mark.parametrize("coming", [0.0, -20.0])
@pytest.mark.parametrize("name", ["slab", "sheet"])
def test_no_ball_passes_through_a_thin_mesh(name: str, coming: float, tmp_path: Path) -> None:
    """A closed mesh of 2 cm, and an open sheet, met at 5 to 40 m/s; at rest or coming."""
    shape, axis = make_shape(name, tmp_path)[0], 0 if name == "slab" else 2
    ahead = torch.eye(3)[axis]
    speed = torch.linspace(5.0, 40.0, 30)[:, None]
    place = -ahead * (0.1 + 0.03 * speed * (7.0 * speed % 1.0)) + 0.05 * (1.0 - ahead)
    state = start(30, dtype=F32, position=place, lin_vel=ahead * speed)
    parts = obstacle(30, lin_vel=coming * ahead)
    ball = ((0.0, 0.0, 0.0, 0.04),)
    rig = ObstacleRig([shape], parts, FIRM, state, spheres=ball, robot=ROUND, dt=DT, gravity=0.0)
    for _ in range(12):
        rig.run(DT)
        assert ((state.position - parts[:, 0, :3])[:, axis] < 0.0).all()
    assert rig.crashes.all()
