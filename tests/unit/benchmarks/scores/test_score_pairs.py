"""Scores of flights of two vehicles: what counts as right, ambiguous, missed and false."""

import json

import pytest

from benchmarks.scores import score_pairs
from benchmarks.scores.score_pairs import pair_result
from benchmarks.undeclared.__main__ import main


def result(
    kind: str, hidden: tuple[str, ...], verdict: str, names: tuple[str, ...] = (), *findings: dict, **more
) -> str:
    judged = {"verdict": verdict, "named": list(names), "material": list(names), "candidates": list(names)}
    judged |= {"ties": {name: [] for name in names}} | more
    return pair_result(kind, hidden, 0.2, judged, findings)


def finding(code: str, subject: str = "", **values: object) -> dict:
    return {"code": code, "subject": subject, "values": values}


SECOND = finding("vehicle_alone", "second", verdict="explained", effects=["payload_mass"])
FIRST = finding("vehicle_alone", "first", verdict="none", effects=[])
SHARED, SEPARATE = finding("gusts_shared"), finding("gusts_separate")


@pytest.mark.parametrize(
    ("case", "expected"),
    [
        (("control", (), "none"), "right"),
        (("control", (), "unexplained"), "ambiguous"),
        (("control", (), "explained", ("rotor_drag",)), "false"),
        (("downwash", ("downwash/jet",), "explained", ("downwash",)), "right"),
        (("downwash", ("downwash",), "ambiguous", ("downwash",)), "ambiguous"),
        (("downwash", ("downwash",), "explained", ("ground_effect",)), "false"),
        (("downwash", ("downwash",), "none"), "missed"),
        (("downwash", ("downwash",), "explained", ("downwash",), finding("clock_contradicted", offset_s=0.3)), "false"),
        (("gusts on both", ("gusts",), "explained", ("gusts",), SHARED), "right"),
        (("gusts on both", ("gusts",), "explained", ("gusts",), SEPARATE), "false"),
        (("gusts on each", ("gusts",), "explained", ("gusts",), SEPARATE), "right"),
        (("gusts on each", ("gusts",), "ambiguous", ("gusts",), finding("gusts_undecided")), "ambiguous"),
        (("effect on one", ("payload_mass",), "ambiguous", (), FIRST, SECOND), "right"),
        (("effect on one", ("com_offset",), "ambiguous", (), FIRST, SECOND), "false"),
        (("effect on one", ("payload_mass",), "ambiguous", ("rotor_drag",), FIRST, SECOND), "false"),
        (("effect on one", ("payload_mass",), "explained", ("payload_mass",)), "false"),
        (("effect on one", ("payload_mass",), "unexplained"), "missed"),
        (
            ("clocks apart", ("downwash",), "ambiguous", ("downwash",), finding("clock_contradicted", offset_s=0.22)),
            "right",
        ),
        (
            ("clocks apart", ("downwash",), "ambiguous", ("downwash",), finding("clock_contradicted", offset_s=-0.2)),
            "false",
        ),
        (("clocks apart", ("downwash",), "explained", ("downwash",)), "false"),
    ],
)
def test_results(case: tuple, expected: str) -> None:
    assert result(*case) == expected


def test_the_command_counts_each_kind(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    def score(job: score_pairs.PairJob) -> dict[str, object]:
        return {"kind": job.kind, "seed": job.seed, "result": "right" if job.seed == 7 else "missed", "verdict": "none"}

    monkeypatch.setattr(score_pairs, "score_pair", score)
    assert main(["--pairs", "--cases", "2", "--seed", "7", "--kinds", "control", "downwash", "--json"]) == 0
    last = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert last["downwash"] == {"right": 1, "ambiguous": 0, "missed": 1, "false": 0, "error": 0}
    assert main(["--pairs", "--cases", "2", "--seed", "7"]) == 0
    assert "| gusts on each | 8 | missed |" in capsys.readouterr().out
