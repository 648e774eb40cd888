"""``aerial-gym render-gallery``: a page with the pictures that were asked for.
Videos of flights: robot and shadow, sky and ground, the ring at the goal, and images of sensors.
"""

import base64
import re
import runpy
import sys
from io import BytesIO
from math import cos, hypot, radians, sin, sqrt, tan
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

from aerial_gym import task_registry
from aerial_gym.cli import film
from aerial_gym.cli.main import main
from aerial_gym.math.quaternion import yaw_from_quat
from aerial_gym.task import chase_view


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


def picture(made: film.Film, begins: bool = True) -> np.ndarray:
    """Return the next frame as numbers, (H, W, 3)."""
    made._steps = 0
    made.render_frame(torch.full((made._count,), begins))
    return np.asarray(made._frames[-1]).astype(int)


def test_a_film_shows_the_robot_its_shadow_and_a_ring_about_its_goal() -> None:
    """The goal is on the robot, then a body length to its left: f length / depth to the left in the picture."""
    with task_registry.make_task("position_setpoint_task", num_envs=2, device="cpu", seed=1) as task:
        made = film.Film(task)
        task.reset()
        position = task.env.gtd["robot_position"]
        yaw = float(yaw_from_quat(task.env.gtd["robot_orientation"])[0])
        left = torch.tensor([-sin(yaw), cos(yaw), 0.0])
        depth = made._size * (cos(chase_view.DOWN) * chase_view.BEHIND + sin(chase_view.DOWN) * chase_view.ABOVE)
        focal = chase_view.WIDTH / 2 / tan(radians(chase_view.VIEW_DEG / 2))
        drop = (
            focal
            * made._size
            * (cos(chase_view.DOWN) * chase_view.ABOVE - sin(chase_view.DOWN) * chase_view.BEHIND)
            / depth
        )
        for shift in (0.0, 0.9 * made._size):
            task.target_position.copy_(position + shift * left)
            pixels = picture(made)
            ring = (pixels[..., 1] > 90) & (pixels[..., 0] < 60) & (pixels[..., 2] < 90)
            rows, columns = np.nonzero(ring)
            top = rows < chase_view.HEIGHT / 2 + drop + 8  # the line to the ground is below
            spot = (chase_view.WIDTH / 2 - focal * shift / depth, chase_view.HEIGHT / 2 + drop)
            assert (columns[top].mean(), rows[top].mean()) == pytest.approx(spot, abs=1.5)
        red = (pixels[..., 0] > 120) & (pixels[..., 1] < 80)
        rows, columns = np.nonzero(red)
        assert len(rows) > 400  # the front rotors
        assert columns.mean() == pytest.approx(chase_view.WIDTH / 2, abs=25)
        assert pixels.shape == (chase_view.HEIGHT, chase_view.WIDTH, 3)
        sun = torch.tensor((-0.4, 0.3, 0.866))
        floor = position[0] - sun * (position[0, 2] - made._floor()[0]) / sun[2]
        column, row = (round(place) for place in made._project(0, floor.tolist()))
        ground = np.median(pixels[-60:].mean(axis=-1))
        assert (pixels[row - 1 : row + 2, column - 1 : column + 2].mean(axis=-1) < 0.6 * ground).all()  # the shadow


def test_a_film_has_a_sky_a_horizon_and_lines_on_the_ground() -> None:
    with task_registry.make_task("position_setpoint_task", num_envs=1, device="cpu", seed=1) as task:
        made = film.Film(task)
        task.reset()
        pixels = picture(made)
    focal = chase_view.WIDTH / 2 / tan(radians(chase_view.VIEW_DEG / 2))
    horizon = chase_view.HEIGHT / 2 - focal * tan(chase_view.DOWN)
    edge = pixels[:, 5]  # beside the robot
    blue = edge[:, 2] - edge[:, 0]
    assert (blue[20 : int(horizon) - 10] > 5).all()
    assert (blue[int(horizon) + 60 :] < 5).all()
    ground = pixels[int(horizon) + 60 :, :100].mean(axis=-1)
    assert 0.005 < (ground < 0.8 * np.median(ground)).mean() < 0.3  # lines


def test_lines_cover_the_share_of_the_ground_that_they_have() -> None:
    """Pixels of 1 cm resolve lines of 2 cm; a pixel of 4 cm on a line has the root of 2 / 4 of it; wide ones have none."""

    def share(wide: float) -> torch.Tensor:
        x, y = torch.broadcast_tensors(wide * torch.arange(400.0)[None], torch.tensor([[0.5]]))
        return chase_view._line_shares(torch.stack((x, y), dim=-1)[None])[0, 0, 1:, 0]

    for wide, highest in ((0.01, 1.0), (0.04, sqrt(0.5) * 0.96), (2.0, 0.0)):
        assert float(share(wide).max()) == pytest.approx(highest, abs=0.02)
    assert float(share(0.01).mean()) == pytest.approx(chase_view.LINE_M / chase_view.GRID_M, rel=0.3)


def test_a_film_shows_environments_and_what_their_sensors_see_side_by_side() -> None:
    """Sensors see neither the robot nor the ground of the film."""
    with task_registry.make_task(
        "position_setpoint_task", num_envs=3, device="cpu", seed=1, robot="base_quadrotor_with_camera"
    ) as task:
        made = film.Film(task, 3)
        task.reset()
        pixels = picture(made)
        assert (task.env.gtd["depth_range_pixels"] == -1.0).all()
    assert pixels.shape == (2 * chase_view.HEIGHT, 2 * (chase_view.WIDTH + film.PANEL), 3)
    column = pixels[60:120, chase_view.WIDTH + 20 : chase_view.WIDTH + film.PANEL - 20]
    assert (abs(column - round(0.85 * 255)) <= 1).all()  # grey: nothing is measured


def test_a_camera_stays_in_front_of_the_wall_behind_the_robot() -> None:
    with task_registry.make_task(
        "position_setpoint_task", num_envs=1, device="cpu", seed=1, robot="base_quadrotor"
    ) as task:
        made = film.Film(task)
        task.reset()
        picture(made)
        free = (made._eye - made._robot).norm()
        assert float(free) == pytest.approx(made._size * hypot(chase_view.BEHIND, chase_view.ABOVE), rel=1e-4)
        made._probe.cast = lambda: None
        made._probe.images.distance.fill_(0.8)
        picture(made)
        assert float((made._eye - made._robot).norm()) == pytest.approx(
            0.8 - chase_view.WALL_MARGIN * made._size, rel=1e-4
        )


def test_frames_are_taken_25_times_a_second_for_known_kinds_of_file(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    with task_registry.make_task("position_setpoint_task", num_envs=1, device="cpu", seed=1) as task:
        made = film.Film(task)
        task.reset()
        for _ in range(9):
            made.render_frame(torch.zeros(1, dtype=torch.bool))
            task.step(torch.zeros(1, task.num_actions))
        made.save(tmp_path / "film.gif")
        shown = Image.open(tmp_path / "film.gif")
        assert (shown.n_frames, shown.info["duration"]) == (1 + int(8 * task.env.dt * 25), pytest.approx(40))
    play = ["play", "--policy", str(tmp_path)]
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    for options, message in (
        (["--video", "a.avi"], "--video a.avi: must end in .gif, .webp, .png, .mp4"),
        (["--video", "a.mp4"], "pip install imageio-ffmpeg"),
        (["--record", "a.bag"], "--record a.bag: must end in .mcap"),
        (["--video", "a.gif", "--video-envs", "9"], "--video-envs 9: must be 1 to 4"),
    ):
        assert main([*play, *options]) == 2
        assert message in capsys.readouterr().err


def test_a_film_can_be_an_mp4(tmp_path: Path) -> None:
    imageio_ffmpeg = pytest.importorskip("imageio_ffmpeg")
    with task_registry.make_task("position_setpoint_task", num_envs=1, device="cpu", seed=1) as task:
        made = film.Film(task)
        task.reset()
        for _ in range(5):
            picture(made)
        made.save(tmp_path / "film.mp4")
    facts, frames = next(reader := imageio_ffmpeg.read_frames(str(tmp_path / "film.mp4"))), len(list(reader))
    assert (facts["size"], facts["fps"], frames) == ((chase_view.WIDTH, chase_view.HEIGHT), 25.0, 5)
