"""``aerial-gym render-gallery``: a page with the pictures that were asked for."""

import base64
import re
import runpy
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from aerial_gym.cli.main import main


def test_the_page_holds_every_image_of_the_sensors(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    sensors = ["st_vl53l5cx", "base_normal_face_id_camera", "base_optical_flow_camera"]
    out = str(tmp_path / "gallery")
    status = main(["render-gallery", "--out", out, "--environments", "env_with_obstacles", "--sensors", *sensors])
    assert status == 0
    page = Path(capsys.readouterr().out.strip()).read_text(encoding="utf-8")
    assert "env_with_obstacles" in page
    assert all(sensor in page for sensor in sensors)
    assert page.count('src="data:image/png') == 6  # the range matrix; depth, faces and normals; depth and flow


def test_an_unknown_sensor_is_refused_before_anything_is_written(tmp_path, capsys) -> None:
    out = tmp_path / "gallery"
    assert main(["render-gallery", "--out", str(out), "--sensors", "base_lida"]) == 2
    assert "Did you mean 'base_lidar'?" in capsys.readouterr().err
    assert not out.exists()


def test_the_colour_camera_shows_obstacles_of_different_colours(tmp_path, capsys) -> None:
    out = str(tmp_path / "gallery")
    command = ["render-gallery", "--out", out, "--environments", "env_with_obstacles", "--sensors", "base_rgb_camera"]
    assert main(command) == 0
    page = Path(capsys.readouterr().out.strip()).read_text(encoding="utf-8")
    pictures = re.findall(r'src="data:image/png;base64,([^"]+)"', page)
    assert len(pictures) == 3
    colors = np.asarray(Image.open(BytesIO(base64.b64decode(pictures[2])))).reshape(-1, 3)
    hue, count = np.unique(colors // 32, axis=0, return_counts=True)
    assert len(hue) > 20
    assert count.max() < 0.5 * len(colors)
    assert (np.ptp(colors.astype(int), axis=1) > 40).mean() > 0.05


def test_the_example_shows_two_equal_cameras_apart(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    out = tmp_path / "two.png"
    monkeypatch.setattr("sys.argv", ["two_cameras.py", str(out)])
    runpy.run_path(str(Path(__file__).parents[2] / "examples" / "two_cameras.py"), run_name="__main__")
    picture = np.asarray(Image.open(out)).astype(int)
    assert picture.shape == (270, 480, 3)
    level, tilted = picture[:135, :240], picture[135:, :240]
    assert (np.abs(level - tilted).max(axis=-1) > 30).mean() > 0.2
    assert len(np.unique(tilted.reshape(-1, 3) // 32, axis=0)) > 10
