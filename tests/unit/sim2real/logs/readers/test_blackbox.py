"""Blackbox logs: frames of every encoding, damaged ones, several flights, units, and the logs of other people."""

from functools import partial

import numpy as np
import pytest
from scipy.signal import butter, lfilter

from aerial_gym.errors import DataError
from aerial_gym.sim2real.logs.raw_log import RawLog, Topic
from aerial_gym.sim2real.logs.readers.blackbox import BlackboxReader
from tests.unit.sim2real.logs.readers import blackbox_files as files
from tests.unit.sim2real.logs.readers.open_log_bytes import REAL_LOGS, first_channel, read_bytes

read = partial(read_bytes, kind=BlackboxReader)
channel = partial(first_channel, reader=BlackboxReader())


@pytest.mark.parametrize("seed", [0, 1])
def test_every_encoding_and_predictor_returns_the_written_numbers(tmp_path, seed) -> None:
    rows = files.random_rows(seed, 500)
    log = read(tmp_path, files.flight(rows))
    main = log.topics[0]
    assert log.notes == ()
    for i, name in enumerate(files.NAMES):
        np.testing.assert_array_equal(main.columns[name], rows[:, i], err_msg=name)
    np.testing.assert_allclose(main.time, 1e-6 * rows[:, 1], atol=0.0, rtol=1e-15)
    assert [message.text for message in log.messages] == ["end of the log"]
    assert log.topics[1].columns["rxSignalReceived"].tolist() == [1.0]


def test_a_gps_frame_is_relative_to_the_home_frame(tmp_path) -> None:
    frames = files.frames(files.random_rows(0, 40))
    home = b"H" + files.encode_signed(473_000_000) + files.encode_signed(-85_000_000)
    gps = b"G" + files.encode_unsigned(7) + files.encode_signed(-12) + files.encode_signed(34)
    log = read(tmp_path, files.header() + b"".join(frames[:20]) + home + gps + b"".join(frames[20:]))
    topic = log.topics[1]
    assert topic.name == "gps"
    assert [topic.columns[f"GPS_coord[{i}]"].item() for i in range(2)] == [472_999_988.0, -84_999_966.0]
    assert topic.columns["time"].item() == log.topics[0].columns["time"][19] + 7.0


def test_a_damaged_frame_loses_the_rows_up_to_the_next_intra_frame(tmp_path) -> None:
    rows = files.random_rows(3, 160)
    frames = files.frames(rows)
    frames[21] = b"P\x00"
    log = read(tmp_path, files.header() + b"".join(frames))
    kept = [*range(21), *range(32, 160)]
    np.testing.assert_array_equal(log.topics[0].columns["loopIteration"], rows[kept, 0])
    assert log.notes[0].code == "frames_damaged"


def test_a_clock_that_starts_anew_follows_the_first_flight(tmp_path) -> None:
    rows = files.random_rows(0, 64)
    log = read(tmp_path, files.flight(rows) + b"\xff" * 40 + files.flight(rows))
    time = log.topics[0].time
    assert time.size == 128
    assert time[64] - time[63] == pytest.approx(10.0)
    np.testing.assert_allclose(np.diff(time[64:]), np.diff(time[:64]), atol=1e-9)


def test_channels_have_si_units(tmp_path) -> None:
    """Gyro counts of 0.1 deg/s, eRPM in hundreds by 6 pole pairs, motor values of 48 to 2047, volts in hundredths."""
    rows = files.random_rows(0, 64)
    log = read(tmp_path, files.flight(rows))
    columns = {name: rows[:, i] for i, name in enumerate(files.NAMES)}
    gyro = np.stack([columns[f"gyroADC[{i}]"] for i in range(3)], axis=1)
    np.testing.assert_allclose(channel(log, "ang_vel").values, np.radians(0.1 * gyro))
    force = np.stack([columns[f"accSmooth[{i}]"] for i in range(3)], axis=1)
    np.testing.assert_allclose(channel(log, "specific_force").values, 9.80665 / 2048.0 * force)
    np.testing.assert_allclose(
        channel(log, "rotor_speed").values[:, 2], columns["eRPM[2]"] * 100.0 / 6.0 * np.pi / 30.0
    )
    expected = np.clip((columns["motor[1]"] - 48.0) / 1999.0, 0.0, 1.0)
    np.testing.assert_allclose(channel(log, "rotor_command").values[:, 1], expected)
    np.testing.assert_allclose(channel(log, "battery").values[:, 0], 0.01 * columns["vbatLatest"])


def test_the_attitude_of_newer_versions_is_read() -> None:
    """Since 2025.12 three components are logged, with w >= 0; a turn of 60 deg about y, nose down in FLU."""
    columns = {f"imuQuaternion[{i}]": np.full(3, value) for i, value in enumerate((0, round(0.5 * 0x7FFF), 0))}
    log = RawLog(path="a", format="blackbox", topics=(Topic(name="main", time=np.arange(3.0), columns=columns),))
    np.testing.assert_allclose(channel(log, "attitude").values[0], (0.0, 0.5, 0.0, 0.75**0.5), atol=1e-4)


def test_a_low_resolution_gyro_counts_whole_degrees_per_second(tmp_path) -> None:
    rows = files.random_rows(0, 32)
    log = read(tmp_path, files.flight(rows, files.HEADER | {"blackbox_high_resolution": "0"}))
    np.testing.assert_allclose(
        channel(log, "ang_vel").values[:, 0], np.radians(rows[:, files.NAMES.index("gyroADC[0]")])
    )


@pytest.mark.parametrize(("names", "counts"), [(("gyroADC",), 16.384), (("gyroADC", "gyroADCafterRpm"), 10.0)])
def test_only_the_raw_gyro_of_a_build_of_indiflight_has_its_own_scale(names: tuple[str, ...], counts: float) -> None:
    """Free flights conserve their momentum with 0.1 deg/s for the filtered gyro of this build."""
    parameters = {
        "Firmware revision": "Indiflight 5.0.0 (1a30175ae+dirty) STM32H743", "gyro_scale": "0x3f800000",
        "blackbox_high_resolution": 1.0,
    }  # fmt: skip
    columns = {f"{name}[{i}]": np.full(3, 100.0) for name in names for i in range(3)}
    topic = Topic(name="main", time=np.arange(3.0), columns=columns)
    log = RawLog(path="log", format="blackbox", topics=(topic,), parameters=parameters)
    np.testing.assert_allclose(channel(log, "ang_vel").values[:, 0], np.radians(100.0 / counts))


@pytest.mark.parametrize(("name", "cutoff"), [("accSmooth", 25.0), ("accSmooth", 0.0), ("accADCafterRpm", 25.0)])
def test_the_delay_of_the_low_pass_of_the_accelerometer_is_undone(name: str, cutoff: float) -> None:
    """A Butterworth filter of order 2 at 25 Hz, as the header states in hundredths, delays 5 Hz by 9 ms."""
    time = np.arange(0.0, 4.0, 1e-3)
    true = np.sin(2.0 * np.pi * 5.0 * time)
    late = lfilter(*butter(2, 25.0, fs=1e3), true) if cutoff and name == "accSmooth" else true
    topic = Topic(name="main", time=time, columns={f"{name}[{i}]": 2048.0 * late for i in range(3)})
    log = RawLog(path="log", format="blackbox", topics=(topic,), parameters={"acc_lpf_hz": 100.0 * cutoff})
    force = channel(log, "specific_force")
    error = np.interp(time, force.time, force.values[:, 0] / 9.80665)[1000:-100] - true[1000:-100]
    assert np.abs(error).max() < 0.01
    assert force.latency == (pytest.approx(0.009, abs=1e-5) if late is not true else None)


@pytest.mark.parametrize(
    ("parameters", "gyro", "volts"),
    [
        ({"Firmware revision": "Betaflight 2025.12.1 (a) X", "gyro_scale": "0x3f800000"}, 1.0, 0.01),
        ({"Firmware revision": "Betaflight 3.5.7 (a) X", "gyro_scale": "0x3f800000"}, 1.0, 0.1),
        ({"Firmware revision": "Betaflight 3.0.1 (a) X", "gyro.scale": "0x3d79c190"}, 0.06098, None),  # 1 / 16.4
        ({"Firmware revision": "INAV 7.1.0 (a) X", "gyro_scale": "0x3f800000"}, 1.0, 0.01),
        ({"Firmware type": "Baseflight", "gyro.scale": "0x308eda7a"}, 0.05956, None),  # 1.0394e-9 rad/us
    ],
)
def test_units_follow_the_firmware(parameters: dict[str, str], gyro: float, volts: float | None) -> None:
    name = "vbat" if "INAV" in str(parameters) else "vbatLatest"
    columns = {f"gyroADC[{i}]": np.full(3, 100.0) for i in range(3)} | {name: np.full(3, 1500.0)}
    topic = Topic(name="main", time=np.arange(3.0), columns=columns)
    log = RawLog(path="log", format="blackbox", topics=(topic,), parameters=parameters)
    np.testing.assert_allclose(channel(log, "ang_vel").values, np.radians(100.0 * gyro), rtol=1e-3)
    voltages = [one.values[0, 0] for one in BlackboxReader().channels(log) if one.quantity == "battery"]
    np.testing.assert_allclose(voltages, [] if volts is None else [1500.0 * volts])


@pytest.mark.parametrize(
    ("old", "new"),
    [
        (b"Data version:2", b"Data version:1"),
        (b"Field I name:loopIteration,", b"Field I name:"),
        (b"Field I encoding:1,1", b"Field I encoding:4,1"),
        (b"Field P predictor:6,2", b"Field P predictor:"),
        (b"\nH Field I name:", b"\nH Field I name:" + b"x," * 1001),
        (b"Field P encoding:9,0", b"Field P encoding:9,99999999999"),
    ],
)
def test_a_header_without_a_usable_definition_is_refused(tmp_path, old, new) -> None:
    data = files.flight(files.random_rows(0, 20))
    assert old in data
    with pytest.raises(DataError):
        read(tmp_path, data.replace(old, new))


def test_a_vector_with_a_damaged_name_is_left_out(tmp_path) -> None:
    log = read(tmp_path, files.flight(files.random_rows(0, 20)).replace(b"accSmooth[0]", b"accSmooth[9]"))
    assert "specific_force" not in {one.quantity for one in BlackboxReader().channels(log)}


def test_rows_that_would_fill_the_memory_are_refused(tmp_path) -> None:
    """A frame of no bytes but its letter and 990 empty fields."""
    fields = [*files.FIELDS[:2], *((f"x{i}", 0, 0, 9, 0, 9) for i in range(988))]
    with pytest.raises(DataError, match="no log of a flight"):
        read(tmp_path, files.header(fields=fields) + b"I" * 1_000_000)


def test_a_log_without_frames_is_refused(tmp_path) -> None:
    with pytest.raises(DataError, match="no flight"):
        read(tmp_path, files.header() + bytes(1000))


@pytest.mark.skipif(not REAL_LOGS.exists(), reason="needs the logs of other people")
@pytest.mark.parametrize(
    ("name", "rows", "speed"),
    [("betaflight/bf451_erpm_5inch.BFL", 35915, 2633.0), ("betaflight/indiflight_LOG00257.BFL", 5667, 4028.0)],
)
def test_logs_of_other_people_are_read(name, rows, speed) -> None:
    """Numbers of rows by orangebox 0.4.0, which decodes all values alike."""
    log = BlackboxReader().read(REAL_LOGS / name)
    assert log.topics[0].time.size == rows
    assert channel(log, "rotor_speed").values.max() == pytest.approx(speed, abs=1.0)
