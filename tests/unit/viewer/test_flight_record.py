"""Recorded flights: predictions, residuals and events from small logs."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from aerial_gym.config import dump_yaml
from aerial_gym.errors import ConfigError, DataError
from aerial_gym.viewer.flight_record import (
    FlightRecord,
    load_logs,
    load_vehicles,
    record_flight,
    with_rollouts,
)
from tests.unit.sim2real.flat_flights import ROBOT, flight, write
from tests.unit.sim2real.ulog_files import topics, write_ulog

DRAG = 0.25
DRAGGED = replace(ROBOT, effects={"rotor_drag": {"dx": DRAG, "dy": DRAG, "dz": DRAG}})


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with a robot file, a ``close-loop`` folder ``out`` and the log of a vehicle with drag."""
    place = tmp_path_factory.mktemp("view")
    (place / "out").mkdir()
    (place / "robot.yaml").write_text(dump_yaml(ROBOT), encoding="utf-8")
    (place / "out" / "robot.yaml").write_text(dump_yaml(DRAGGED), encoding="utf-8")
    write(flight(3, drag=DRAG), place / "log.csv")
    return place


def open_record(path: Path, robot: Path | None = None, corrected: Path | None = None) -> FlightRecord:
    robots = load_vehicles(None if robot is None else str(robot), corrected)
    (log,), notes = load_logs([path], robots)
    return with_rollouts(record_flight(log, robots, notes), 0.5)


@pytest.fixture(scope="module")
def record(folder: Path) -> FlightRecord:
    return open_record(folder / "log.csv", folder / "robot.yaml", folder / "out")


def rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.nanmean(values**2)))


def test_the_corrected_vehicle_predicts_the_drag_that_the_declared_one_lacks(record: FlightRecord) -> None:
    """The log is exact, so the corrected residual is what filters leave, and the declared one is ``-d v / m``."""
    velocity = record.log.lin_vel
    assert velocity is not None
    expected = DRAG * rms(np.linalg.norm(velocity, axis=1)) / ROBOT.body.mass
    panels = record.plots()["residual of specific force"]
    size = {name: rms(np.linalg.norm([one.lines[name] for one in panels], axis=0)) for name in panels[0].lines}
    assert size["declared"] == pytest.approx(expected, rel=0.1)
    assert size["corrected"] < 0.02 * expected
    errors = {name: rms(track.errors["position"]) for name, track in record.tracks.items()}
    assert errors["corrected"] < 0.1 * errors["declared"]


def test_rows_of_the_page_are_100_hz_and_views_of_the_log(record: FlightRecord) -> None:
    assert np.diff(record.time) == pytest.approx(0.01)
    assert np.shares_memory(record.position, record.log.position)
    assert np.shares_memory(record.attitude, record.log.attitude)
    assert [record.row_of_time(time) for time in (0.0, 0.0149, 0.02, 99.0)] == [0, 1, 2, record.time.size - 1]
    for name, panels in record.plots().items():
        for panel in panels:
            assert panel.title.endswith("]") or name == "measured attitude"
            assert all(line.shape == panel.time.shape for line in panel.lines.values()), name


def test_the_same_log_gives_the_same_bits(folder: Path, record: FlightRecord) -> None:
    again = open_record(folder / "log.csv", folder / "robot.yaml", folder / "out")
    for name, track in record.tracks.items():
        np.testing.assert_array_equal(track.position, again.tracks[name].position)
    for name, panels in record.plots().items():
        for one, two in zip(panels, again.plots()[name], strict=True):
            assert one.lines.keys() == two.lines.keys()
            np.testing.assert_array_equal(list(one.lines.values()), list(two.lines.values()))


def test_a_log_without_robot_file_shows_what_was_measured(folder: Path) -> None:
    record = open_record(folder / "log.csv")
    assert record.has_position
    assert not record.tracks
    assert list(record.plots()) == [
        f"measured {name}"
        for name in ("attitude", "angular velocity", "specific force", "velocity", "position", "rotor speed")
    ]


def test_a_log_without_position_turns_in_place(folder: Path, tmp_path: Path) -> None:
    """No rollout can start without a velocity, but residuals need none."""
    table = flight(3)
    blind = table.drop(columns=[name for name in table if name[:2] in ("p_", "v_")])
    record = open_record(write(blind, tmp_path / "blind.csv"), folder / "robot.yaml")
    assert not record.has_position
    assert not record.position.any()
    np.testing.assert_allclose(record.attitude[100], table.loc[200, "q_x":"q_w"].astype(float), atol=1e-9)
    assert "residual of angular acceleration" in record.plots()
    assert not record.tracks


def test_a_log_without_attitude_is_refused(tmp_path: Path) -> None:
    table = flight(3)
    lacking = table.drop(columns=[name for name in table if name[:2] == "q_"])
    with pytest.raises(DataError, match="q_x.*--draft-mapping"):
        load_logs([write(lacking, tmp_path / "lacking.csv")], {})


def test_a_log_that_no_comparison_can_use_is_shown_without_predictions(folder: Path, tmp_path: Path) -> None:
    """Rotors that give four times the weight of the declared robot belong to another vehicle."""
    table = flight(3)
    table.loc[:, "rotor_1":"rotor_4"] *= 2.0
    record = open_record(write(table, tmp_path / "fast.csv"), folder / "robot.yaml")
    assert not record.robots
    assert not record.tracks
    assert "rotor_1..4" in record.notes[0]


def test_a_ulog_is_shown(tmp_path: Path) -> None:
    table = flight(3)
    for n in range(1, 5):
        table[f"cmd_{n}"] = table[f"rotor_{n}"]
    record = open_record(write_ulog(tmp_path / "a.ulg", topics(table)))
    assert record.log.log_format == "ulog"
    assert "measured angular velocity" in record.plots()


def test_ground_contacts_and_gaps_are_events(folder: Path, tmp_path: Path) -> None:
    """The vehicle stands for 2 s with its rotors off before it flies; 40 ms of the log are lost at 8 s."""
    flown = flight(3)
    stood = pd.concat([flown.iloc[:1]] * 400, ignore_index=True)
    stood.loc[:, "q_x":"q_w"], stood.loc[:, "v_x":"omega_z"] = [0.0, 0.0, 0.0, 1.0], 0.0
    stood.loc[:, "acc_x":"acc_z"], stood.loc[:, "rotor_1":"rotor_4"] = [0.0, 0.0, 9.81], 0.0
    table = pd.concat([stood, flown], ignore_index=True)
    table["t"] = np.arange(len(table)) / 200.0
    table = table.drop(index=range(1600, 1608))
    record = open_record(write(table, tmp_path / "stands.csv"), folder / "robot.yaml")
    events = {words: at for at, words in record.events}
    assert events["on the ground"] == 0.0
    assert events["in the air"] == pytest.approx(2.0, abs=0.1)
    assert [at for words, at in events.items() if "gap" in words] == [pytest.approx(8.0, abs=0.011)]
    assert np.isnan(record.tracks["declared"].position[record.time < 1.9]).all()


def test_a_corrected_robot_needs_a_declared_one_with_as_many_rotors(folder: Path) -> None:
    with pytest.raises(ConfigError, match="--robot"):
        load_vehicles(None, folder / "out")
    with pytest.raises(ConfigError, match="rotors"):
        load_vehicles(str(folder / "robot.yaml"), "base_octarotor")
