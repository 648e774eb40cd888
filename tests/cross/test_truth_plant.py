"""The plant of ``benchmarks.undeclared`` and this package, which share no code, give the same accelerations for each
effect. Random states in float64. ``tests/physics`` compares the effects of the package with closed forms and signed
cases."""

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation
from torch import Tensor

from aerial_gym.config import build
from aerial_gym.config.robot import RobotCfg
from aerial_gym.physics import BodyState, accelerations, build_model, vehicle_from_config
from benchmarks.undeclared.dynamics import POS, RATE, ROT, ROTOR, VEL, rotation_matrices
from benchmarks.undeclared.effects import effect_parameters, split_vehicles
from benchmarks.undeclared.full_dynamics import CABLE, CABLE_RATE, FullPlant
from benchmarks.undeclared.logs import robot_document
from benchmarks.undeclared.surroundings import PlantSurroundings
from benchmarks.undeclared.vehicle import DECLARED, Array
from tests.physics.vehicles import F64, make_effects

COUNT, CEILING = 16, 2.0
OTHER_VEHICLE = (0.1, 0.2, 2.5)
ARMS = slice(CABLE.start, CABLE.start + 4)
"""Angles of the arms in a state of the plant, where no load hangs on it."""

EFFECTS = (
    "rotor_drag", "quadratic_drag", "thrust_coefficient", "com_offset", "constant_wind", "h_force_flapping",
    "axial_inflow", "translational_lift", "weak_motor", "torque_ratio", "rotor_inertia", "motor_tilt", "payload_mass",
    "inertia_error", "wind_shear", "ground_effect", "ceiling_effect", "downwash", "slung_payload", "joint_spring",
    "thrust_curve",
)  # fmt: skip
DRAG = dict(zip(("dx", "dy", "dz"), DECLARED.linear_drag.tolist(), strict=True))
OTHER_LAWS: dict[str, tuple[dict[str, float], dict[str, dict[str, float]]]] = {
    "rotor_drag/thrust": (
        {"dx": 0.4, "dy": 0.4, "dz": 0.0},
        {"rotor_drag": dict.fromkeys(("dx", "dy", "dz"), 0.0), "rotor_drag_of_thrust": {**DRAG, "k": 0.4}},
    ),
    "quadratic_drag/plate": (
        {"dx": 0.1, "dy": 0.11, "dz": 0.12}, {"quadratic_drag_of_axes": {"dx": 0.1, "dy": 0.11, "dz": 0.12}}
    ),
    "slung_payload/rod": (
        {"mass": 0.12, "length": 0.8, "damping": 0.03},
        {"slung_payload_rod": {"mass": 0.12, "length": 0.8, "damping": 0.03}},
    ),
    "downwash/jet": ({"force": 1.2, "spread": 0.25}, {"downwash_jet": {"force": 1.2 * 1.5**2, "spread": 0.25}}),
}  # fmt: skip
"""Laws of the plant that the package has too, with the numbers of both."""

TOGETHER = tuple(
    name
    for name in EFFECTS
    if name not in ("slung_payload", "joint_spring", "ground_effect", "ceiling_effect", "thrust_curve")
)
"""Effects at once. Surfaces are not among them: with an inflow the two codes multiply and add in another order."""


def random_states(rng: np.random.Generator, plant: FullPlant) -> Array:
    state = np.zeros((COUNT, ROTOR.stop))
    state[:, POS] = rng.uniform((-0.5, -0.5, 0.7), (0.5, 0.5, 1.7), (COUNT, 3))
    state[:, VEL], state[:, RATE] = 2.0 * rng.normal(size=(COUNT, 3)), 3.0 * rng.normal(size=(COUNT, 3))
    state[:, ROT] = Rotation.from_rotvec(0.4 * rng.normal(size=(COUNT, 3))).as_matrix().reshape(COUNT, 9)
    state[:, ROTOR] = rng.uniform(700.0, 1300.0, (COUNT, 4))
    return plant.states_at_rest(state)


def tensor(values: Array) -> Tensor:
    return torch.tensor(np.ascontiguousarray(values), dtype=F64)


@pytest.mark.parametrize("names", [(), *((name,) for name in (*EFFECTS, *OTHER_LAWS)), TOGETHER], ids="+".join)
def test_accelerations_agree(names: tuple[str, ...]) -> None:
    """Angular acceleration while rotors change their speed, and specific force at the body origin while they do not."""
    rng = np.random.default_rng(0)
    params = effect_parameters(
        {name: OTHER_LAWS[name][0] if name in OTHER_LAWS else "large" for name in names}, declared=DECLARED, seed=1
    )
    around = PlantSurroundings(ceiling=CEILING, other=np.tile(OTHER_VEHICLE, (1, COUNT, 1)))
    plant = FullPlant(split_vehicles(DECLARED, params)[1], around)
    state = random_states(rng, plant)
    given = {}
    if names == ("joint_spring",):
        state[:, ARMS] += rng.uniform(-0.2, 0.2, (COUNT, 4))
        given["remembered"] = {"joint_spring": tensor(state[:, ARMS])}
    if names in (("slung_payload",), ("slung_payload/rod",)):
        given["load"] = tensor(np.hstack((state[:, CABLE], state[:, CABLE_RATE])))
    slope = plant.derivative(state, state[:, ROTOR] + rng.uniform(-50.0, 50.0, (COUNT, 4)))
    robot = build(RobotCfg, robot_document(DECLARED, radius=True), where="plant")
    own = params if not OTHER_LAWS.keys() & params.keys() else OTHER_LAWS[names[0]][1]
    model = build_model(
        vehicle_from_config(robot, num_envs=COUNT, dtype=F64), make_effects({**robot.effects, **own}, COUNT),
        ceiling_height=CEILING, other_position=tensor(np.tile(OTHER_VEHICLE, (COUNT, 1))),
    )  # fmt: skip
    body = BodyState(
        position=tensor(plant.origin_position(state)),
        attitude=tensor(Rotation.from_matrix(rotation_matrices(state)).as_quat()),
        lin_vel=tensor(plant.origin_velocity(state)),
        ang_vel=tensor(state[:, RATE]),
        rotor_speed=tensor(state[:, ROTOR]),
    )
    ang_acc = accelerations(model, body, tensor(slope[:, ROTOR]), **given).ang_acc
    specific_force = accelerations(model, body, **given).specific_force
    torch.testing.assert_close(ang_acc, tensor(slope[:, RATE]), rtol=0.0, atol=1e-12)
    torch.testing.assert_close(specific_force, tensor(plant.specific_force(state)), rtol=0.0, atol=1e-12)
