"""Robot files with the values that flights ask for."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from aerial_gym.config import dump_yaml
from aerial_gym.config.robot import RobotCfg, load_robot
from aerial_gym.physics import vehicle_from_config
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
    sizes = {"mass": 4.0, "inertia_x": -3.5, "com_y": 2.0, "time_constant": 5.0, "nominal_voltage": 1.0, **own}
    deviation = deviation_of_vehicle(make_deviation(robot, **sizes), robot)
    (tmp_path / "r.yaml").write_text(dump_yaml(redeclare(robot, TOLERANCES, deviation, "test")), encoding="utf-8")
    written = vehicle_from_config(load_robot(tmp_path / "r.yaml"), num_envs=1, dtype=F64)
    declared = vehicle_from_config(robot, num_envs=1, dtype=F64)
    predicted = vehicle_with_deviations(declared, TOLERANCES, torch.from_numpy(deviation))
    for name, values in predicted.tensors_by_name().items():
        torch.testing.assert_close(written.tensors_by_name()[name], values, rtol=1e-5, atol=1e-9, equal_nan=True)


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


def test_no_moment_of_a_redeclared_robot_exceeds_the_sum_of_the_others() -> None:
    """A flat body declared at the limit, whose flights ask for 10 % more about z: no rigid body is like that."""
    robot = asymmetric_robot()
    flat = replace(robot, body=replace(robot.body, inertia=((2e-3, 0.0, 0.0), (0.0, 3e-3, 0.0), (0.0, 0.0, 5e-3))))
    deviation = make_deviation(flat, inertia_z=5.0)
    moments = np.linalg.eigvalsh(redeclare(flat, TOLERANCES, deviation, "test").body.inertia)
    np.testing.assert_allclose(moments, (2e-3, 3e-3, 5e-3), rtol=1e-4)
