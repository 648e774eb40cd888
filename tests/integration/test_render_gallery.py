"""``aerial-gym render-gallery``: a page with the pictures that were asked for."""

from pathlib import Path

import pytest

from aerial_gym.cli.main import main


def test_the_page_holds_every_image_of_the_sensors(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    sensors = ["st_vl53l5cx", "base_normal_face_id_camera"]
    out = str(tmp_path / "gallery")
    status = main(["render-gallery", "--out", out, "--environments", "env_with_obstacles", "--sensors", *sensors])
    assert status == 0
    page = Path(capsys.readouterr().out.strip()).read_text(encoding="utf-8")
    assert "env_with_obstacles" in page
    assert all(sensor in page for sensor in sensors)
    assert page.count('src="data:image/png') == 4  # the range matrix; depth, faces and normals of the camera


def test_an_unknown_sensor_is_refused_before_anything_is_written(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "gallery"
    assert main(["render-gallery", "--out", str(out), "--sensors", "base_lida"]) == 2
    assert "Did you mean 'base_lidar'?" in capsys.readouterr().err
    assert not out.exists()
