"""Effects under water: the fused backend against the torch reference."""

from itertools import product

import pytest
import torch

from aerial_gym.config.environment import ContactCfg
from aerial_gym.control import CONTROLLERS, make_controller
from aerial_gym.physics import BACKENDS, PhysicsBackend, TorchBackend, build_model, vehicle_from_config
from aerial_gym.physics.ground import Ground
from aerial_gym.physics.warp_backend import WarpBackend
from aerial_gym.robots import ROBOTS
from tests.cross.test_backends import as_type, assert_same_flight
from tests.physics.test_water import tumble_state, without_drag
from tests.physics.vehicles import asymmetric_robot, make_effects
from tests.repetitions import frequent_values

WATER = ("buoyancy", "hull_drag", "added_mass", "added_inertia", "constant_wind")
LOADED = ("added_mass", "slung_payload")


@pytest.mark.parametrize(
    ("integrator", "effects"),
    frequent_values(
        product(("euler", "rk4"), (("added_mass",), WATER, LOADED)),
        [("euler", ("added_mass",)), ("rk4", WATER), ("euler", LOADED)],
    ),
)
def test_a_hull_moves_like_torch(integrator: str, effects: tuple[str, ...]) -> None:
    assert_same_flight(asymmetric_robot(), CONTROLLERS.get("no_control"), integrator, effects=effects)


def test_a_vehicle_in_water_moves_like_torch() -> None:
    assert_same_flight(ROBOTS.get("base_octarotor"), CONTROLLERS.get("no_control"), "euler", effects=WATER)


def engine(name: str) -> tuple[PhysicsBackend, torch.dtype]:
    if name == "mujoco":
        pytest.importorskip("mujoco", reason="MuJoCo is not installed: pip install 'aerial-gym[mujoco]'")
        return BACKENDS.get("mujoco")(), torch.float64
    return (WarpBackend(), torch.float32) if name == "warp" else (TorchBackend(), torch.float64)


@pytest.mark.parametrize("name", ["torch", "warp", "mujoco"])
def test_a_hull_rests_on_the_ground(name: str) -> None:
    """Let down from 1 mm above it, a hull that sinks comes to rest and stays: the pose moves with half of each impulse."""
    backend, dtype = engine(name)
    robot = without_drag("bluerov2_heavy")
    vehicle = vehicle_from_config(robot, num_envs=1, dtype=dtype)
    effects = {**robot.effects, "buoyancy": {"force": 100.0, "x": 0.0, "y": 0.0, "z": 0.01}}
    model = build_model(vehicle, [(effect, rows.to(dtype)) for effect, rows in make_effects(effects, 1)])
    corners = [[x, y, -0.19, 0.0] for x in (-0.2, 0.2) for y in (-0.2, 0.2)]
    ground = Ground(
        height=0.0, spheres=torch.tensor(corners), contact=torch.zeros(1, dtype=torch.bool),
        cfg=ContactCfg(friction=0.5), impulse=torch.zeros(1, 3),
    )  # fmt: skip
    law = make_controller(CONTROLLERS.get("no_control"), vehicle, 9.81)
    backend.allocate(model, law, integrator="euler", ground=ground)
    state = as_type(tumble_state(8, seed=0, speed=0.0, rate=0.0, envs=1), dtype)
    state.position.copy_(torch.tensor([[0.0, 0.0, 0.191]]))
    state.attitude.copy_(torch.tensor([[0.0, 0.0, 0.0, 1.0]]))
    heights = []
    for _ in range(200):
        backend.step(state, torch.zeros(1, 8, dtype=dtype), 0.01, 1)
        heights.append(float(state.position[0, 2]))
    assert abs(heights[-1] - heights[-50]) < 1e-6
    assert abs(float(state.lin_vel[0, 2])) < 1e-5
    assert -2e-3 < heights[-1] - 0.19 < 0.0
