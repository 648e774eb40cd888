"""Scripts without their ``isaacgym`` imports."""

from pathlib import Path

import pytest

from aerial_gym.compat.script import run_script, without_isaacgym


@pytest.mark.parametrize(
    ("before", "after"),
    [
        ("import isaacgym\nx = 1\n", "pass\nx = 1\n"),
        ("import isaacgym, torch as t\n", "import torch as t\n"),
        ("from isaacgym import (\n    gymapi,\n    gymutil,\n)\nx = 1\n", "pass\n\n\n\nx = 1\n"),
        ("from isaacgym.torch_utils import quat_mul; x = 1\n", "pass; x = 1\n"),
        ("if x:\n    import isaacgym  # first\n", "if x:\n    pass  # first\n"),
        ("from isaacgymenvs import tasks\nx = 'import isaacgym'\n", "from isaacgymenvs import tasks\nx = 'import isaacgym'\n"),
    ],
)  # fmt: skip
def test_imports_are_taken_out_and_lines_stay(before: str, after: str) -> None:
    assert without_isaacgym(before) == after


def test_a_script_is_main_with_its_arguments_and_folder(tmp_path: Path) -> None:
    import sys

    (tmp_path / "beside_the_script.py").write_text("value = 3\n")
    script = tmp_path / "script.py"
    script.write_text(
        "import isaacgym, sys\nfrom beside_the_script import value\nargv = sys.argv[1:]\nmain = __name__\n"
    )
    before = sys.modules["__main__"], sys.argv, list(sys.path)
    names = run_script(script, ["--a", "1"])
    assert (names["value"], names["main"], names["argv"]) == (3, "__main__", ["--a", "1"])
    assert (sys.modules["__main__"], sys.argv, sys.path) == before
