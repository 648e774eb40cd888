"""Preflight on public flights, where nothing may be contradicted that is not true of the vehicle or of its log.

True are: the inertia of the brushless Crazyflie, declared without the decks that it carries; the velocity of one flight 28 ms
behind its accelerometer on all axes; the thrust of commands whose speed follows from the motors of another vehicle.
"""

from pathlib import Path

import pytest

from aerial_gym.errors import DataError
from aerial_gym.sim2real import find_mapping
from aerial_gym.sim2real.preflight.check import preflight

DATA = Path(__file__).parents[2].parent / "shared" / "data"

pytestmark = pytest.mark.skipif(not DATA.is_dir(), reason=f"the measured flights are not on this machine: {DATA}")

SETS = {
    "idsia_nanodrone": "crazyflie_21_brushless", "nanobench_cf21": "crazyflie_21", "arpl_crazyflie_imu": "crazyflie_2x_arpl",
    "neural_swarm": "crazyflie_21",
}  # fmt: skip
"""Robot of each set, whose name is also that of its mapping."""


@pytest.mark.parametrize(
    ("flight", "true"),
    [
        ("idsia_nanodrone/square_run1", {"inertia_roll"}),
        ("idsia_nanodrone/square_run2", {"lin_vel_latency"}),
        ("idsia_nanodrone/random1_run1", set()),
        ("idsia_nanodrone/multisine_run1", set()),
        ("idsia_nanodrone/melon_run1", set()),
        ("nanobench_cf21/B5_helix_rep1", {"thrust_per_weight"}),
        ("nanobench_cf21/B8_star_fast_rep1", {"thrust_per_weight"}),
        ("arpl_crazyflie_imu/log10", {"thrust_per_weight"}),
        ("arpl_crazyflie_imu/log15", {"thrust_per_weight"}),
        ("neural_swarm/takeoff_cf50", set()),
    ],
)
def test_contradictions_are_true(flight: str, true: set[str]) -> None:
    folder = flight.partition("/")[0]
    result = preflight(SETS[folder], DATA / f"{flight}.csv", mapping=find_mapping(folder))
    assert {finding.subject for finding in result.contradictions} == true


def test_thrust_of_commands_is_tied_with_their_speed() -> None:
    result = preflight(
        "crazyflie_21", DATA / "nanobench_cf21" / "B5_helix_rep1.csv", mapping=find_mapping("nanobench_cf21")
    )
    assert result.contradictions[0].values["tied"] == ["mass", "speed_per_command"]


@pytest.mark.parametrize("flight", ["battery_brownout", "quad_hover_second_output_instance"])
def test_slow_logs_of_px4_leave_all_assumed(flight: str) -> None:
    (file,) = DATA.rglob(f"{flight}.ulg")
    assert preflight("x500", file).verdict == "ready"


def test_a_log_without_flight_is_refused() -> None:
    with pytest.raises(DataError, match=r"0\.0 s with all rotors turning"):
        preflight("x500", DATA / "px4_ulog" / "sample_log_small.ulg")
