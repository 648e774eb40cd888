import numpy as np

from aerial_gym.sim2real.logs.flights import values_in_all_mappings
from aerial_gym.sim2real.logs.recording import FlightLog, take_rows


def test_what_one_flight_lacks_is_had_by_none() -> None:
    assert values_in_all_mappings([{"speed": 1, "height": 2}, {"speed": 3, "voltage": 4}]) == {"speed": [1, 3]}


def test_a_part_of_a_log_has_the_same_rows_of_everything() -> None:
    time = np.arange(4.0)
    log = FlightLog(path="a.csv", time=time, attitude=np.eye(4), battery=10.0 * time)
    for rows in (slice(1, 3), np.array([False, True, True, False])):
        part = take_rows(log, rows)
        assert (part.time.tolist(), part.attitude.tolist()) == ([1.0, 2.0], np.eye(4)[1:3].tolist())
        assert part.battery.tolist() == [10.0, 20.0]
