"""Examples run as they stand, shortly."""

import runpy
from pathlib import Path

import pytest

EXAMPLES = Path(__file__).parents[3] / "examples"


@pytest.mark.slow
def test_motor_commands_become_c_code(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("sys.argv", ["motor_commands.py", str(tmp_path / "run"), "3"])
    runpy.run_path(str(EXAMPLES / "motor_commands.py"), run_name="__main__")
    assert "beside the target" in capsys.readouterr().out
    header = (tmp_path / "run" / "export" / "motors.h").read_text()
    assert "[N]" in header  # thrusts come out
    assert "rotation_rows: the first two rows of the rotation matrix body to world" in header


@pytest.mark.slow
def test_a_student_of_noisy_sensors_learns_from_its_teacher(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("sys.argv", ["student_of_noise.py", str(tmp_path), "2"])
    runpy.run_path(str(EXAMPLES / "student_of_noise.py"), run_name="__main__")
    told = capsys.readouterr().out
    assert all(f"{run}: " in told for run in ("teacher", "student", "forgetful"))
