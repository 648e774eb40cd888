"""Robot files with the values that flights ask for."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from aerial_gym.config import dump_yaml
from aerial_gym.config.robot import RobotCfg, load_robot
from aerial_gym.physics import vehicle_from_config
from aerial_gym.physics.effects.vehicle_errors import InertiaError
from aerial_gym.sim2real.predict.redeclare import deviation_of_vehicle, deviations_beyond_tolerance, redeclare
from aerial_gym.sim2real.predict.tolerances import Tolerances, vehicle_with_deviations
from tests.physics.rotor_types import three_type_robot
from tests.physics.vehicles import F64, asymmetric_robot

TOLERANCES = Tolerances()


def make_deviation(robot: RobotCfg, **sizes: float) -> np.ndarray:
    return np.array([sizes.get(name, 0.0) for name in TOLERANCES.names(robot.num_rotors)])


@pytest.mark.parametrize("robot", [asymmetric_robot(), three_type_robot()], ids=["one type", "three types"])
@pytest.mark.parametrize("own", [{}, {"thrust_1": 4.0, "thrust_4": -5.0}], ids=["alike", "own thrusts"])
def test_a_redeclared_robot_is_the_vehicle_of_the_prediction(robot, own, tmp_path) -> None:
    sizes = {
        "mass": 4.0,
        "inertia_x": -3.5,
        "com_y": 2.0,
        "products_xz": 4.0,
        "time_constant": 5.0,
        "nominal_voltage": 1.0,
    }
    sizes |= own
    deviation = deviation_of_vehicle(make_deviation(robot, **sizes), robot)
    (tmp_path / "r.yaml").write_text(dump_yaml(redeclare(robot, TOLERANCES, deviation, "test")), encoding="utf-8")
    written = vehicle_from_config(load_robot(tmp_path / "r.yaml"), num_envs=1, dtype=F64)
    declared = vehicle_from_config(robot, num_envs=1, dtype=F64)
    predicted = vehicle_with_deviations(declared, TOLERANCES, torch.from_numpy(deviation))
    for name, values in predicted.tensors_by_name().items():
        torch.testing.assert_close(written.tensors_by_name()[name], values, rtol=1e-5, atol=1e-9, equal_nan=True)


def test_one_wrong_moment_leaves_products_within_their_tolerance() -> None:
    """A roll inertia declared 30 % too large, with products of 1 %: its factor moves the products too, by 0.12 %."""
    true = np.diag([2.3e-3, 2.6e-3, 4.4e-3]) + 3.2e-5 * (np.ones((3, 3)) - np.eye(3))
    declared = true + np.diag([0.3 * true[0, 0], 0.0, 0.0])
    robot = asymmetric_robot()
    body = replace(robot.body, inertia=tuple(map(tuple, declared.tolist())))
    vehicle = vehicle_from_config(replace(robot, body=body), num_envs=1, dtype=F64)
    factors = torch.tensor([[1.0 / 1.3, 1.0, 1.0]], dtype=F64)
    scaled = InertiaError().adjust(vehicle, factors).inertia[0].numpy()
    wrong = (true - scaled) / np.sqrt(np.outer(np.diag(true), np.diag(true)))
    assert 1e-3 < np.abs(wrong).max() < 0.5 * TOLERANCES.products
    sizes = {
        name: wrong[place] / TOLERANCES.products for name, place in (("products_xy", (0, 1)), ("products_xz", (0, 2)))
    }
    deviation = torch.from_numpy(make_deviation(robot, **sizes))
    moved = vehicle_with_deviations(replace(vehicle, inertia=torch.from_numpy(scaled)[None]), TOLERANCES, deviation)
    np.testing.assert_allclose(moved.inertia[0].numpy(), true, rtol=1e-12)


@pytest.mark.parametrize(("third", "strained"), [(2.2, True), (2.0, False)])
def test_a_place_is_strained_by_its_distance(third: float, strained: bool) -> None:
    """2.2 deviations along each axis have a chi-squared sum of 14.5, less probable than 3 of one; 13.7 is not."""
    robot = asymmetric_robot()
    deviation = make_deviation(
        robot, imu_place_x=2.2, imu_place_y=-2.2, imu_place_z=third, inertia_x=2.9, inertia_y=2.9
    )
    deviations = deviations_beyond_tolerance(TOLERANCES, deviation, robot)
    assert set(deviations) == ({"imu_place_x", "imu_place_y", "imu_place_z"} if strained else set())
    assert redeclare(robot, TOLERANCES, deviation, "test").body.accelerometer == pytest.approx(
        (0.011, -0.011, 0.005 * third)
    )


def test_only_values_of_the_robot_file_count() -> None:
    robot = replace(asymmetric_robot(), battery=None)
    deviation = make_deviation(robot, mass=3.5, gyro_bias_x=9.0, com_x=-2.9)
    assert deviations_beyond_tolerance(TOLERANCES, deviation, robot) == {"mass": 3.5}
    assert np.array_equal(deviation_of_vehicle(deviation, robot), make_deviation(robot, mass=3.5, com_x=-2.9))


def test_predictions_with_a_new_place_of_the_accelerometer_take_the_point_of_the_velocity_too() -> None:
    """Both are those of one estimator, 2 cm ahead: kinematics show no lever between them. A file holds only the first."""
    robot = asymmetric_robot()
    deviation = make_deviation(robot, imu_place_x=4.0, velocity_place_x=4.0, velocity_place_y=-3.5, gyro_bias_x=9.0)
    kept = make_deviation(robot, imu_place_x=4.0, velocity_place_x=4.0, velocity_place_y=-3.5)
    np.testing.assert_array_equal(deviation_of_vehicle(deviation, robot), kept)
    new = deviations_beyond_tolerance(TOLERANCES, deviation, robot)
    assert new == {"imu_place_x": 4.0, "imu_place_y": 0.0, "imu_place_z": 0.0}
    assert redeclare(robot, TOLERANCES, kept, "test").body.accelerometer == pytest.approx((0.02, 0.0, 0.0))


def test_no_moment_of_a_redeclared_robot_exceeds_the_sum_of_the_others() -> None:
    """A flat body declared at the limit, whose flights ask for 10 % more about z: no rigid body is like that."""
    robot = asymmetric_robot()
    flat = replace(robot, body=replace(robot.body, inertia=((2e-3, 0.0, 0.0), (0.0, 3e-3, 0.0), (0.0, 0.0, 5e-3))))
    deviation = make_deviation(flat, inertia_z=5.0)
    moments = np.linalg.eigvalsh(redeclare(flat, TOLERANCES, deviation, "test").body.inertia)
    np.testing.assert_allclose(moments, (2e-3, 3e-3, 5e-3), rtol=1e-4)
