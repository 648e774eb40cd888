"""``aerial-gym render-gallery``: a page with the pictures that were asked for.
Videos of flights: the robot stands in the middle of the picture, the ring where its target is.
"""

import base64
import re
import runpy
from io import BytesIO
from math import cos, radians, sin, tan
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

from aerial_gym import task_registry
from aerial_gym.cli import film
from aerial_gym.cli.main import main


def test_the_page_holds_every_image_of_the_sensors(tmp_path: Path, capsys, monkeypatch) -> None:
    opened: list[str] = []
    monkeypatch.setattr("webbrowser.open", lambda address: not opened.append(address))
    sensors = ["st_vl53l5cx", "base_normal_face_id_camera", "base_optical_flow_camera"]
    out = str(tmp_path / "gallery")
    status = main(
        ["render-gallery", "--out", out, "--environments", "env_with_obstacles", "--open", "--sensors", *sensors]
    )
    assert status == 0
    path = Path(capsys.readouterr().out.strip())
    assert opened == [path.as_uri()]
    page = path.read_text(encoding="utf-8")
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


def test_a_film_shows_the_robot_and_a_ring_about_its_target(tmp_path: Path) -> None:
    """The target is put on the robot, then 0.5 m to its left: f 0.5 m / depth to the left in the picture."""
    robot = film.write_visible_robot("base_quadrotor", str(tmp_path))
    with task_registry.make_task("position_setpoint_task", num_envs=2, device="cpu", seed=1, robot=robot) as task:
        made = film.Film(task)
        task.reset()
        for shift in (0.0, 0.5):
            task.target_position.copy_(task.env.gtd["robot_position"] + torch.tensor([0.0, shift, 0.0]))
            made._steps = 0
            made.render_frame(begins=True)
        file = tmp_path / "film.gif"
        made.save(file)
    shown = Image.open(file)
    assert shown.size == (film.WIDTH, film.HEIGHT)
    depth = cos(film.DOWN) * film.BEHIND + sin(film.DOWN) * film.ABOVE
    focal = film.WIDTH / 2 / tan(radians(film.VIEW_DEG / 2))
    drop = focal * (cos(film.DOWN) * film.ABOVE - sin(film.DOWN) * film.BEHIND) / depth
    for frame, column in enumerate((film.WIDTH / 2, film.WIDTH / 2 - focal * 0.5 / depth)):
        shown.seek(frame)
        pixels = np.asarray(shown.convert("RGB")).astype(int)
        ring = (pixels[..., 1] > 90) & (pixels[..., 0] < 60) & (pixels[..., 2] < 90)
        rows, columns = np.nonzero(ring)
        assert (columns.mean(), rows.mean()) == pytest.approx((column, film.HEIGHT / 2 + drop), abs=1.5)
        body = (abs(pixels - pixels[0, 0]).sum(-1) > 60) & ~ring
        rows, columns = np.nonzero(body)
        assert (columns.mean(), rows.mean()) == pytest.approx((film.WIDTH / 2, film.HEIGHT / 2 + drop), abs=8.0)
        assert len(rows) > 2000  # a quadrotor 0.5 m wide at 1.7 m is 100 pixels wide


def test_frames_are_taken_25_times_a_second_for_known_kinds_of_file(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    robot = film.write_visible_robot("base_quadrotor", str(tmp_path))
    with task_registry.make_task("position_setpoint_task", num_envs=1, device="cpu", seed=1, robot=robot) as task:
        made = film.Film(task)
        task.reset()
        for _ in range(9):
            made.render_frame(begins=False)
            task.step(torch.zeros(1, task.num_actions))
        made.save(tmp_path / "film.gif")
        shown = Image.open(tmp_path / "film.gif")
        assert (shown.n_frames, shown.info["duration"]) == (1 + int(8 * task.env.dt * 25), pytest.approx(40))
    assert main(["play", "--policy", str(tmp_path), "--video", "a.mp4"]) == 2
    assert "--video a.mp4: must end in .gif, .webp, .png; ffmpeg -i FILE.gif FILE.mp4" in capsys.readouterr().err
