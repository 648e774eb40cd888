"""The answer leads in verdict.json, on both pages and on the console, and it states what the correction makes worse."""

import json
from collections import defaultdict
from contextlib import redirect_stdout
from io import StringIO
from typing import Any

import pytest

from aerial_gym.cli.main import main
from aerial_gym.config import dump_yaml
from tests.unit.sim2real.flat_flights import ROBOT, flight, write


@pytest.fixture(scope="module")
def verdict_texts(tmp_path_factory: pytest.TempPathFactory) -> tuple[dict[str, Any], dict[str, str]]:
    """Return the verdict of a loop and, by where they stand, its texts. All flights have weak rotors, of which the
    torque tells beside the force. The air holds the training flights back and pushes the test flights on: their forces
    along x and y and their rollouts become worse by the correction."""
    folder, printed = tmp_path_factory.mktemp("worse"), StringIO()
    (folder / "robot.yaml").write_text(dump_yaml(ROBOT))
    for number, (drag, seconds) in enumerate(((0.25, 3.0), (0.25, 3.0), (-0.25, 4.0), (-0.25, 4.0))):
        table = flight(20 + number, drag=drag, thrust_scale=0.95, noise=1.0, seconds=seconds, rate=100.0)
        write(table, folder / f"f{number}.csv")
    logs = [str(folder / f"f{number}.csv") for number in range(4)]
    call = ["close-loop", "--robot", str(folder / "robot.yaml"), "--train", *logs[:2], "--test", *logs[2:]]
    with redirect_stdout(printed), pytest.MonkeyPatch.context() as patch:
        patch.setattr("aerial_gym.sim2real.report.report.report_figures", lambda *_: defaultdict(list))
        assert main([*call, "--out", str(folder / "out"), "--effects", "rotor_drag", "thrust_coefficient"]) == 0
    pages = {name: (folder / "out" / name).read_text() for name in ("verdict.json", "report.html", "report.md")}
    return json.loads(pages["verdict.json"]), {**pages, "console": " ".join(printed.getvalue().split())}


def group_findings(verdict: dict) -> dict[str, list[dict]]:
    """Return the findings of the answer by part."""
    parts = {
        "found": {"effect_found"},
        "gain": {"errors_fall"},
        "open": {"error_rises", "error_may_rise", "remains_unexplained"},
        "next": {"inspect_rest", "fly_structure", "keep_declared_where"},
    }
    return {part: [one for one in verdict["findings"] if one["code"] in codes] for part, codes in parts.items()}


def test_the_findings_state_what_gets_worse_with_its_numbers(verdict_texts: tuple[dict, dict]) -> None:
    verdict, _ = verdict_texts
    became = verdict["test_flights"]
    assert {became[f"specific_force.{axis}"]["state"] for axis in "xy"} == {"worse"}
    assert became["angular_acceleration.y"]["state"] == "better"
    assert [effect["name"] for effect in verdict["effects"]] == ["rotor_drag", "thrust_coefficient"]
    assert list(verdict)[:3] == ["verdict", "reason", "meaning"]
    (rises,) = (one for one in verdict["findings"] if one["code"] == "error_rises")
    worse = {name: one["rises"] for name, one in became.items() if one["state"] == "worse"}
    assert rises["subject"] == max(worse, key=worse.__getitem__)
    assert rises["values"]["rise"] == max(worse.values())
    assert [rises["values"]["rise_low"], rises["values"]["rise_high"]] == became[rises["subject"]]["interval"]
    quantities = {".".join(name.split(".")[:2]) for name in worse}
    assert rises["values"]["more"] == len(quantities) - 1
    (harm,) = (one["values"]["errors"] for one in meaning_findings(verdict) if one["code"] == "correction_harms")
    assert {"specific_force.x", "specific_force.y"} <= set(harm)


def meaning_findings(verdict: dict) -> list[dict]:
    return [one for one in verdict["findings"] if one["code"].startswith(("correction_", "trust_"))]


@pytest.mark.parametrize("where", ["verdict.json", "report.html", "report.md", "console"])
def test_the_answer_comes_first_and_in_order(verdict_texts: tuple[dict, dict], where: str) -> None:
    verdict, texts = verdict_texts
    text = " ".join(texts[where].split())
    if where == "report.html":
        text = text.partition("</style>")[2].replace("&#39;", "'")
    places = [text.index(one["text"]) for part in ("found", "gain", "open") for one in group_findings(verdict)[part]]
    assert places == sorted(places)
    step = group_findings(verdict)["next"][0]["text"]
    assert places[-1] < text.index(step[1:])
    details = {"verdict.json": '"findings"', "console": "rotor_drag: dx"}.get(where, "<details>")
    assert text.index(step[1:]) < text.index(details)
