"""docs/guides/own_backend.md: its table says what the backends say, and its example of a backend runs."""

import re
from pathlib import Path

import torch

from aerial_gym.physics import BACKENDS

PAGE = (Path(__file__).parents[3] / "docs" / "guides" / "own_backend.md").read_text(encoding="utf-8")


def test_the_table_is_that_of_the_code() -> None:
    rows = [
        [cell.strip() for cell in line.strip("|").split("|")] for line in PAGE.splitlines() if line.startswith("| `")
    ]
    told = {row[0].strip("`"): (*row[1:5], *row[6:8]) for row in rows if len(row) == 9}
    found = {}
    for name in BACKENDS.names():
        able = BACKENDS.get(name)().capabilities
        floats = ", ".join(str(dtype).removeprefix("torch.") for dtype in able.dtypes)
        yes_or_no = ("yes" if can else "no" for can in (able.differentiable, able.contact, able.joints))
        found[name] = (", ".join(able.devices), floats, ", ".join(able.integrators), *yes_or_no)
    assert told == found


def test_the_example_of_a_backend_moves_vehicles_along_their_wires() -> None:
    (code,) = re.findall(r"```python\n(.*?)```", PAGE, re.S)
    kept = dict(BACKENDS._entries)
    try:
        names: dict = {}
        exec(compile(code, "docs/guides/own_backend.md", "exec"), names)
    finally:
        BACKENDS._entries = kept
    velocity, turning = names["env"].gtd["robot_linvel"], names["env"].gtd["robot_body_angvel"]
    torch.testing.assert_close(velocity[:, :2], torch.zeros(4, 2))
    assert (velocity[:, 2].abs() > 1e-3).all()
    assert (turning.abs() > 1e-3).any()
