"""``aerial-gym robot``: output, pictures, files and exit status of its verbs."""

import json
import re
from dataclasses import replace
from pathlib import Path

import pytest

from aerial_gym import CONTROLLERS, ROBOTS
from aerial_gym.cli.main import main
from aerial_gym.config.loader import dump_yaml
from aerial_gym.control.stability import ClosedLoop
from aerial_gym.errors import ConfigError
from aerial_gym.interop.warp_start import KernelLog
from aerial_gym.robots.check import flights
from aerial_gym.sensors import SENSORS
from tests.unit.robots.importers.files import x500


def test_a_robot_by_name_as_json(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["robot", "check", "lmf1", "x500", "--controllers", "lee_rates_control", "no_control", "--json"]) == 0
    first, second = map(json.loads, capsys.readouterr().out.splitlines())
    assert (first["name"], second["name"]) == ("lmf1", "x500")
    assert first["thrust_to_weight"] == pytest.approx(80.0 / (1.235 * 9.81))
    flown, refused = first["stable_steps"]
    assert (flown["controller"], flown["largest_s"], flown["at_least"]) == ("lee_rates_control", 0.1, True)
    assert refused["refused"] == "commands rotors, and holds nothing"


def test_the_time_step_that_is_named_has_the_gain_margin(monkeypatch: pytest.MonkeyPatch) -> None:
    """Whatever flights say: the gain margin of 6 dB is gone beyond 5.5 ms."""
    robot, controller = ROBOTS.get("crazyflie_2x_arpl"), CONTROLLERS.get("crazyflie_mellinger_control")
    monkeypatch.setattr(flights.RestFlights, "end_at_rest", lambda _: True)
    result = flights.largest_stable_step(robot, controller, name="mellinger")
    loop = ClosedLoop(robot, controller, gravity=9.81, integrator="euler", names=("it", "mellinger"))
    assert not result.little_margin
    assert loop.is_stable_with_margin(result.largest_s)
    assert not loop.is_stable_with_margin(1.02 * result.largest_s)


def test_a_file_with_a_picture(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    path, picture = tmp_path / "mine.yaml", tmp_path / "rotors.png"
    path.write_text(dump_yaml(ROBOTS.get("neural_fly_quad")), encoding="utf-8")
    assert main(["robot", "check", str(path), "--no-fly", "--picture", str(picture)]) == 0
    out = capsys.readouterr().out
    assert "note: nothing turns it about z at hover" in out
    assert "thrust to weight" in out
    assert picture.read_bytes()[:4] == b"\x89PNG"


def test_the_page_shows_every_robot_and_opens(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """--open opens a temporary page without --page; on a machine without a browser that is no failure."""
    opened: list[str] = []
    monkeypatch.setattr("webbrowser.open", opened.append)
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    assert main(["robot", "check", "lmf1", "x500", "--no-fly", "--open"]) == 0
    (path,) = tmp_path.rglob("check.html")
    assert opened == [path.as_uri()]
    text = path.read_text(encoding="utf-8")
    assert text.count('<figure class="drawing" role="img"') == 4
    assert "<h2>x500</h2>" in text


def test_one_that_cannot_hover_ends_with_status_1(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    robot, path = ROBOTS.get("lmf1"), tmp_path / "heavy.yaml"
    path.write_text(dump_yaml(replace(robot, body=replace(robot.body, mass=9.0))), encoding="utf-8")
    assert main(["robot", "check", str(path)]) == 1
    assert "problem: to hover, rotor 1 must give 22.1 N" in " ".join(capsys.readouterr().out.split())


@pytest.mark.parametrize(("sensor", "message"), [
    ("cam.yaml", "sensor cam: .*cam.yaml: unknown field 'wide'. Did you mean 'width'"),
    ("none.yaml", "sensor none: .*none.yaml: no such file"),
    ("velodyne", "sensor velodyne: no sensor 'velodyne'"),
])  # fmt: skip
def test_a_broken_sensor_ends_with_status_1(sensor, message, capsys, tmp_path) -> None:
    cam = dump_yaml(SENSORS.get("base_depth_camera")).replace("width:", "wide:", 1)
    (tmp_path / "cam.yaml").write_text(f"kind: camera\n{cam}", encoding="utf-8")
    path = tmp_path / "mine.yaml"
    path.write_text(f"summary: mine\nextends: lmf1\nsensors: [{sensor}]\n", encoding="utf-8")
    assert main(["robot", "check", str(path), "--json"]) == 1
    (problem,) = json.loads(capsys.readouterr().out)["problems"]
    assert re.search(message, problem, re.DOTALL)


def test_the_check_of_a_new_robot_prints_no_compilations(monkeypatch, capsys, caplog) -> None:
    def check(robot: object, **_: object) -> None:
        KernelLog().info("Module it 0123 load on device 'cpu' took 12.00 ms  (compiled)")
        raise ConfigError("stopped here")

    monkeypatch.setattr("aerial_gym.robots.check.report.check_robot", check)
    monkeypatch.setattr("aerial_gym.robots.check.check_robot", check)
    assert main(["robot", "check", "lmf1"]) == 2
    assert not caplog.records
    KernelLog().info("Module it 0123 load on device 'cpu' took 12.00 ms  (compiled)")
    assert "compiled it for cpu" in caplog.text


def test_wrong_files_and_requests_end_with_status_2(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    path = tmp_path / "impossible.yaml"
    path.write_text(dump_yaml(ROBOTS.get("lmf1")).replace("0.013804", "0.1"), encoding="utf-8")
    assert main(["robot", "check", str(path)]) == 2
    assert "check digits and units" in capsys.readouterr().err
    assert main(["robot", "check", "lmf1", "x500", "--picture", "both.png"]) == 2
    assert "--picture takes one robot" in capsys.readouterr().err
    path = tmp_path / "page.xml"
    path.write_text("<html/>", encoding="utf-8")
    assert main(["robot", "import", str(path), "--out", str(tmp_path / "out.yaml")]) == 2
    assert "must be <robot> (URDF), <mujoco> (MJCF) or <sdf> (SDF)" in capsys.readouterr().err


def test_a_model_of_gazebo_becomes_a_file_that_can_be_checked(capsys, tmp_path) -> None:
    model, out = x500(tmp_path), tmp_path / "mine.yaml"
    assert main(["robot", "import", str(model), "--out", str(out), "--summary", "mine"]) == 0
    captured = capsys.readouterr()
    assert captured.out == f"{out}\n"
    assert captured.err.startswith("left out: rollingMomentCoefficient")
    assert main(["robot", "check", str(out), "--no-fly", "--json"]) == 0
    report = json.loads(capsys.readouterr().out)
    assert report["summary"] == "mine"
    assert report["thrust_to_weight"] == pytest.approx(4.0 * 8.54858 / (2.0643076923 * 9.81))


def test_a_vehicle_that_bends_is_said_to_be_taken_as_rigid(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["robot", "check", "morphy", "--no-fly"]) == 0
    out = " ".join(capsys.readouterr().out.split())
    assert "note: its joints (elevation_1, azimuth_1" in out
    assert "hover, authority and time steps are those of a vehicle that does not bend" in out
    assert main(["robot", "tune", "morphy", "--attitude-hz", "1", "--position-hz", "0.2"]) == 0
    assert "# its joints (elevation_1" in capsys.readouterr().out
    assert main(["robot", "check", "morphy_stiff", "--no-fly"]) == 0
    assert "joints" not in capsys.readouterr().out
