"""Vehicle, firmware and start time from the metadata of each firmware."""

from pathlib import Path

import numpy as np
import pytest

from aerial_gym.sim2real.logs.identity import log_identity
from aerial_gym.sim2real.logs.raw_log import RawLog, Topic
from aerial_gym.sim2real.logs.readers.csv_log import FlightFacts, read_facts
from aerial_gym.sim2real.logs.recording import LogIdentity

UTC = 1764547200.0  # 1 December 2025, 00:00


def raw_log(metadata: dict[str, str], *topics: Topic) -> RawLog:
    """Return a log with metadata."""
    return RawLog(path="a.log", format="ulog", topics=topics, metadata=metadata)


@pytest.mark.parametrize(
    ("metadata", "airframe", "firmware"),
    [
        ({}, "", ""),
        (
            {"sys_uuid": "0010ab", "ver_uid": "old", "sys_name": "PX4", "ver_sw_release": "17695231"},
            "0010ab",
            "PX4 1.14.1",
        ),
        ({"ver_uid": "0042", "ver_sw": "deadbeef"}, "0042", "deadbeef"),
        (
            {"firmware": "ArduCopter V4.5.7 (2a3d)", "board": "CubeOrange 0038 34385113"},
            "CubeOrange 0038 34385113",
            "ArduCopter V4.5.7 (2a3d)",
        ),
        (
            {"Craft name": "RAZOR", "Firmware revision": "Betaflight 4.5.1 (77d0) STM32F7X2"},
            "RAZOR",
            "Betaflight 4.5.1 (77d0) STM32F7X2",
        ),
    ],
)
def test_metadata_of_each_firmware(metadata: dict[str, str], airframe: str, firmware: str) -> None:
    assert log_identity(raw_log(metadata), 0.0) == LogIdentity(airframe=airframe, firmware=firmware)


def test_the_start_is_the_first_row_on_the_clock_of_the_receiver() -> None:
    time = np.array([10.0, 11.0, 12.0])
    px4 = Topic(name="sensor_gps", time=time, columns={"time_utc_usec": np.array([0.0, UTC + 1.0, UTC + 2.0]) * 1e6})
    assert log_identity(raw_log({}, px4), 7.5).start_time == pytest.approx(UTC + 7.5 - 10.0)
    week, seconds = divmod(UTC - 315964800.0 + 18.0 + time - 10.0, 604800.0)
    ardupilot = Topic(name="GPS", time=time, columns={"GWk": week, "GMS": 1e3 * seconds})
    assert log_identity(raw_log({}, ardupilot), 7.5).start_time == pytest.approx(UTC + 7.5 - 10.0)


@pytest.mark.parametrize(
    ("text", "start"),
    [
        ("2025-12-01T01:00:00.000+01:00", UTC),
        ("2025-12-01T00:00:00", UTC),
        ("0000-01-01T00:00:00.000+00:00", None),
        ("?", None),
    ],
)
def test_the_start_of_a_blackbox_log(text: str, start: float | None) -> None:
    assert log_identity(raw_log({"Log start datetime": text}), 0.0).start_time == start


def test_a_converted_flight_keeps_its_identity(tmp_path: Path) -> None:
    identity = LogIdentity(airframe="0010ab", firmware="PX4 1.14.1", start_time=UTC)
    path = tmp_path / "flight.csv"
    path.write_text(FlightFacts(identity=identity).line())
    facts = read_facts(path)
    assert facts is not None
    assert facts.identity == identity
