"""Firm contact at speed: no crossing of a part is missed, and nothing passes through a thin wall or pole. The crossings
are those of ``test_sweep``: truth that shares no code with the package."""

from pathlib import Path

import numpy as np
import pytest
import torch

from aerial_gym.assets.cores import contact_points
from aerial_gym.config.environment import ContactCfg
from aerial_gym.config.shape import ShapeCfg
from aerial_gym.math.quaternion import quat_rotate, quat_rotate_inverse
from aerial_gym.physics import TorchBackend, WarpBackend
from tests.physics.contact_rig import CPU, MASS, ObstacleRig, make_robot, obstacle, start
from tests.physics.test_sweep import DT, HULLS, MESHES, PARTS, SweepMotion, crossings, make_shape
from tests.repetitions import rare_values

F32 = torch.float32
ROUND = make_robot(inertia=(3e-3, 3e-3, 3e-3))
"""Its free rotation keeps its rate."""
FIRM = ContactCfg(friction=0.5)
BACKENDS = rare_values([WarpBackend, TorchBackend], [TorchBackend])
WALL = ShapeCfg(kind="box", size=(0.02, 50.0, 50.0))


pytestmark = pytest.mark.usefixtures("single_thread")


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
