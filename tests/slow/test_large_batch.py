"""Environment i of 4 is environment i of 8,192, bit for bit."""

import pytest

from tests.unit.env_manager.test_batch_independence import FEW, RANDOMIZE, assert_same, build, fly, snapshot

pytestmark = pytest.mark.slow


@pytest.mark.parametrize("backend", ["torch", "warp"])
@pytest.mark.parametrize(
    ("env", "robot"), [("env_with_obstacles", "base_quadrotor_with_imu"), ("empty_env", "tinyprop")]
)
def test_an_environment_is_the_same_among_few_and_8192(env: str, robot: str, backend: str) -> None:
    result = []
    for num_envs in (FEW, 8192):
        built = build(env, robot, num_envs, backend=backend, randomize=RANDOMIZE)
        fly(built)
        result.append(snapshot(built.gtd, slice(FEW)))
    assert_same(*result)
