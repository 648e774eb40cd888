"""Every set of measured flights goes through its mapping: replayed, or refused with the reason."""

from pathlib import Path

import pytest

from aerial_gym.errors import DataError
from aerial_gym.sim2real import find_mapping, read_flight_log, replay

DATA = Path(__file__).parents[2].parent / "shared" / "data"

pytestmark = pytest.mark.skipif(not DATA.is_dir(), reason=f"the measured flights are not on this machine: {DATA}")


@pytest.mark.parametrize(("robot", "flight", "bandwidth", "channels"), [
    ("crazyflie_21", "nanobench_cf21/B3_figure8_fast_rep1.csv", 4.0, 6),
    ("neural_fly_quad", "neural_fly/baseline_70wind.csv", 5.0, 3),
    ("crazyflie_21", "neural_swarm/takeoff_cf50.csv", 8.0, 6),
    pytest.param("crazyflie_2x_arpl", "arpl_crazyflie_imu/log15.csv", 10.0, 6, marks=pytest.mark.slow),
    ("crazyflie_21_brushless", "idsia_nanodrone/square_run2.csv", 10.0, 12),
])  # fmt: skip
def test_one_flight_of_each_set_is_replayed(robot: str, flight: str, bandwidth: float, channels: int) -> None:
    result = replay(robot, [DATA / flight], mapping=flight.split("/")[0], bandwidth=bandwidth)
    assert len(result.evaluation.channels) == channels
    assert all(rms.low <= rms.value <= rms.high for rms in result.evaluation.residual)


def test_neural_fly_before_any_fit_is_the_residual_of_the_study() -> None:
    """measured_data.md 3.5: 2.731 and 0.235 m/s² over four winds; the two flights of the middle winds lie around it."""
    flights = [DATA / "neural_fly" / f"NF_{wind}.csv" for wind in ("nowind", "35wind", "70wind", "100wind")]
    residual = replay("neural_fly_quad", flights, mapping="neural_fly", bandwidth=5.0).evaluation.residual
    assert residual[0].value == pytest.approx(2.731, rel=0.1)
    assert residual[1].value == pytest.approx(0.235, rel=0.2)


def test_crazypad_says_why_it_cannot_be_replayed() -> None:
    path = DATA / "crazypad" / "normal_flight_E9_log00.csv"
    with pytest.raises(DataError, match=r"has no attitude. No gyro and no full attitude .*cannot be replayed"):
        read_flight_log(path, mapping=find_mapping("crazypad"))


def test_the_passing_vehicle_is_found() -> None:
    log = read_flight_log(DATA / "neural_swarm" / "swap_ss_00_cf51.csv", mapping=find_mapping("neural_swarm"))
    assert log.other_position is not None
    assert log.battery is not None
