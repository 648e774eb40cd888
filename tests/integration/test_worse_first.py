"""What a correction makes worse on the test flights is what a reader is told first: in verdict.json, on both pages and on
the console."""

import json
import re
from collections import defaultdict
from contextlib import redirect_stdout
from io import StringIO
from typing import Any

import pytest

from aerial_gym.cli.main import main
from aerial_gym.config import dump_yaml
from tests.unit.sim2real.flat_flights import ROBOT, flight, write

FIRST = "worse on the test flights: "


@pytest.fixture(scope="module")
def told(tmp_path_factory: pytest.TempPathFactory) -> tuple[dict[str, Any], dict[str, str]]:
    """Return the verdict of a loop and, by where they stand, its texts.

    All flights have weak rotors, of which the torque tells beside the force. The air holds the training flights back and pushes
    the test flights on: their forces along x and y and their rollouts become worse by the correction.
    """
    folder, printed = tmp_path_factory.mktemp("worse"), StringIO()
    (folder / "robot.yaml").write_text(dump_yaml(ROBOT))
    for number, (drag, seconds) in enumerate(((0.25, 3.0), (0.25, 3.0), (-0.25, 4.0), (-0.25, 4.0))):
        table = flight(20 + number, drag=drag, thrust_scale=0.95, noise=1.0, seconds=seconds, rate=100.0)
        write(table, folder / f"f{number}.csv")
    logs = [str(folder / f"f{number}.csv") for number in range(4)]
    call = ["close-loop", "--robot", str(folder / "robot.yaml"), "--train", *logs[:2], "--test", *logs[2:]]
    with redirect_stdout(printed), pytest.MonkeyPatch.context() as patch:
        patch.setattr("aerial_gym.sim2real.report.report.figures", lambda *_: defaultdict(list))
        assert main([*call, "--out", str(folder / "out"), "--effects", "rotor_drag", "thrust_coefficient"]) == 0
    pages = {name: (folder / "out" / name).read_text() for name in ("verdict.json", "report.html", "report.md")}
    return json.loads(pages["verdict.json"]), {**pages, "console": " ".join(printed.getvalue().split())}


def test_the_reason_of_the_verdict_begins_with_what_gets_worse(told: tuple[dict, dict]) -> None:
    """The largest first, and every channel that gets worse is named in its meaning, before what is said of the rest."""
    verdict, _ = told
    became = {name: found["state"] for name, found in verdict["test_flights"].items()}
    assert {became["specific_force.x"], became["specific_force.y"]} == {"worse"}
    assert became["angular_acceleration.y"] == "better"
    assert any(state == "worse" for name, state in became.items() if name.startswith(("free.", "given_attitude.")))
    assert [effect["name"] for effect in verdict["effects"]] == ["rotor_drag", "thrust_coefficient"]
    assert next(iter(verdict)) == "verdict"
    assert list(verdict)[1] == "reason"
    assert verdict["reason"].startswith(FIRST)
    worst, _, rest = verdict["reason"].removeprefix(FIRST).partition("; ")
    assert rest.startswith("perhaps worse, these flights cannot tell: ")
    rises = [int(value) for value in re.findall(r"by (\d+) %", worst)]
    assert len(rises) > 1
    assert rises == sorted(rises, reverse=True)
    assert verdict["meaning"].startswith("The correction makes specific force x, specific force y, ")
    assert "The correction helps in angular acceleration" in verdict["meaning"]


@pytest.mark.parametrize(
    ("where", "start"),
    [
        ("verdict.json", '{ "verdict": "VERDICT", "reason": "'),
        ("report.html", '<div class="verdict VERDICT"><b>VERDICT</b><br>'),
        ("report.md", "# VERDICT: "),
        ("console", "VERDICT: "),
    ],
)
def test_nothing_is_told_before_what_gets_worse(told: tuple[dict, dict], where: str, start: str) -> None:
    """Behind the word of the verdict it is the first thing said: no effect, no change for the better and no note before it."""
    verdict, texts = told
    text = " ".join(texts[where].split())
    first = start.replace("VERDICT", verdict["verdict"])
    assert f"{first}{FIRST}" in text
    before, _, after = text.partition(FIRST)
    if where == "report.html":
        before = before.partition("</style>")[2]  # which has names of states
    for later in ("rotor_drag", "thrust_coefficient", "better", "helps", "specific force", "perhaps"):
        assert later not in before
        assert later in after
    worse = after.index("The correction makes specific force x, specific force y")
    assert worse < after.index("The correction helps in angular acceleration")
    if where != "verdict.json":
        assert worse < after.index("worse: specific force x") < after.index("better: angular acceleration")
    assert all(note[:40] not in before for note in verdict["notes"])
