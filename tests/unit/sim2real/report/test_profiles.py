"""What a residual depends on, against a closed form: rotors that give less than declared miss in proportion to the thrust."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from aerial_gym.sim2real.logs.flights import Flight
from aerial_gym.sim2real.predict.model_params import ModelParams
from aerial_gym.sim2real.report.profiles import mean_residual_profiles, write_profiles
from tests.unit.sim2real.flat_flights import ROBOT, flight, load_tables, make_predictor

SCALE = 0.9
TRUE = ModelParams(effects={"thrust_coefficient": np.array([SCALE])})


@pytest.fixture(scope="module")
def flights(tmp_path_factory: pytest.TempPathFactory) -> list[Flight]:
    tables = [flight(seed, thrust_scale=SCALE, noise=0.3, seconds=8.0, rate=100.0) for seed in (1, 2, 3)]
    return load_tables(tmp_path_factory.mktemp("flights"), (one.assign(vbat=15.0 - one["t"] / 8.0) for one in tables))


def test_the_mean_residual_lies_on_the_line_of_what_is_missing(flights: list[Flight]) -> None:
    """At a declared thrust T the force along z is 0.9 T / m: measured minus declared is -0.1 T / m."""
    test = make_predictor(flights)
    profiles = mean_residual_profiles(test, {"declared": ModelParams(), "corrected": TRUE})
    result = {profile.against: profile for profile in profiles}
    assert list(result) == ["thrust [N]", "speed [m/s]", "height [m]", "battery voltage [V]"]
    thrust, z = result["thrust [N]"], [channel.name for channel in test.channels].index("specific_force.z")
    declared, corrected = thrust.residual["declared"], thrust.residual["corrected"]
    line = (SCALE - 1.0) * thrust.middle / ROBOT.body.mass
    assert np.ptp(line) > 5.0 * declared.std_error[:, z].max()  # else any line would do
    assert (np.abs(declared.mean[:, z] - line) < 5.0 * declared.std_error[:, z]).all()
    assert (np.abs(corrected.mean[:, z]) < 5.0 * corrected.std_error[:, z]).all()
    assert declared.count.sum() == sum(time.size for time in test.times)
    for profile in result.values():
        assert ((profile.edges[:-1] <= profile.middle) & (profile.middle <= profile.edges[1:])).all()


def test_only_what_every_log_has_is_drawn(flights: list[Flight]) -> None:
    lost = [replace(flights[0], battery=None), replace(flights[1], position=None), flights[2]]
    told = mean_residual_profiles(make_predictor(lost), {"declared": ModelParams()})
    assert [profile.against for profile in told] == ["thrust [N]", "speed [m/s]"]
    commanded = [replace(one, rotor_command=one.rotor_speed, rotor_speed=None) for one in flights]
    (first, *_) = mean_residual_profiles(make_predictor(commanded), {"declared": ModelParams()})
    (same, *_) = mean_residual_profiles(make_predictor(flights), {"declared": ModelParams()})
    assert first.against == "thrust [N]"
    # Other rows are kept: commands need time to settle.
    assert first.middle[0] == pytest.approx(same.middle[0], rel=0.02)


def test_the_table_has_every_bin_of_every_channel(flights: list[Flight], tmp_path: Path) -> None:
    test = make_predictor(flights)
    result = mean_residual_profiles(test, {"declared": ModelParams(), "corrected": TRUE})
    write_profiles(tmp_path / "profiles.csv", result, test.channels)
    table = pd.read_csv(tmp_path / "profiles.csv")
    assert len(table) == sum(profile.middle.size for profile in result) * len(test.channels)
    own = table[(table["channel"] == "specific_force.z") & (table["against"] == "thrust [N]")]
    place = [channel.name for channel in test.channels].index("specific_force.z")
    np.testing.assert_allclose(own["before"], result[0].residual["declared"].mean[:, place], rtol=1e-5)
    np.testing.assert_allclose(own["after_std_error"], result[0].residual["corrected"].std_error[:, place], rtol=1e-5)
