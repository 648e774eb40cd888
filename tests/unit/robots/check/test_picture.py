"""The picture of the rotors shows what the file says."""

from pathlib import Path

import pytest

from aerial_gym.robots import ROBOTS
from aerial_gym.robots.check import draw_rotors

pytest.importorskip("matplotlib", reason="matplotlib is not installed: pip install 'aerial-gym[sim2real]'")


@pytest.mark.parametrize("robot", ["tilted_hexarotor", "coaxial_octarotor", "base_random"])
def test_every_rotor_is_in_the_picture(robot: str, tmp_path: Path) -> None:
    path = tmp_path / "rotors.svg"
    draw_rotors(ROBOTS.get(robot), path, name=robot)
    text = path.read_text(encoding="utf-8")
    for number in range(1, ROBOTS.get(robot).num_rotors + 1):
        assert text.count(f"<!-- {number} -->") == 2
    assert f"<!-- {robot}: " in text
