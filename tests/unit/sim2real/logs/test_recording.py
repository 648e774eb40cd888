"""Text of a flight log."""

from pathlib import Path

from aerial_gym.sim2real import read_flight_log
from tests.unit.sim2real.flat_flights import flight, write


def test_text_of_a_log_states_rows_rate_and_quantities(tmp_path: Path) -> None:
    log = read_flight_log(write(flight(1, seconds=2.0, rate=100.0), tmp_path / "hover.csv"))
    assert repr(log).startswith("FlightLog hover: 200 rows in 2.0 s at 100 Hz; csv, 4 rotors; attitude, ")
    assert "rotor_speed" in repr(log)
