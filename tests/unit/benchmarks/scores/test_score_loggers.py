"""Scores on logs as loggers write them: which cases are planned, and what is counted."""

import pytest

from benchmarks.scores.score_loggers import LoggerScoreCmd, score_rows
from benchmarks.undeclared.evidence import SHOWN


def row(*effects: str, verdict: str, named: tuple[str, ...] = (), evidence: float = 2.0 * SHOWN, **ties: str) -> dict:
    """Return a result with named effects, each with the effect that it is tied with."""
    return {
        "effects": list(effects), "verdict": verdict, "named": list(named), "material": list(named),
        "candidates": [*named, *ties.values()], "evidence": {"nothing": 3.0 * SHOWN, "rival": evidence},
        "ties": {name: [ties[name]] if name in ties else [] for name in named},
    }  # fmt: skip


def test_each_logger_gets_controls_and_effects_that_its_file_can_hold() -> None:
    jobs = LoggerScoreCmd(loggers=("px4", "late"), cases=60).plan_jobs()
    assert [sum(job.logger == one and not job.hidden for job in jobs) for one in ("px4", "late")] == [60, 60]
    assert {job.hidden for job in jobs if job.logger == "late"} - {
        job.hidden for job in jobs if job.logger == "px4"
    } == {("ceiling_effect",), ("downwash",)}
    assert len({job.key for job in jobs}) == len(jobs)


def test_cases_of_other_laws_can_hover() -> None:
    jobs = LoggerScoreCmd(laws="other", hover_only=True, cases=20).plan_jobs()
    assert all("hover" in job.features for job in jobs)
    assert ("gusts/dryden",) in {job.hidden for job in jobs}


def test_scores_count_names_that_are_there() -> None:
    rows = [
        row(verdict="none"),
        row(verdict="unexplained"),
        row(verdict="explained", named=("payload_mass",)),
        row("ground_effect/loss", verdict="explained", named=("ground_effect",)),
        row("rotor_drag/thrust", verdict="unexplained", named=("h_force_flapping", "com_offset")),
        row("com_offset", verdict="none", evidence=0.5 * SHOWN),
        row("gusts", verdict="ambiguous", named=("constant_wind",), constant_wind="gusts"),
        {"effects": ["gusts"], "error": "ValueError"},
    ]
    assert score_rows(rows) == {
        "false name": [1, 3], "false name beside an effect": [1, 4], "false name, certain": [1, 4],
        "false name, ambiguous": [0, 4], "wrong name tied with the effect": [1, 4], "residual model": [0, 7],
        "effects shown": [3, 4], "shown effects named": [2, 3], "named, or ambiguous with it": [3, 4],
        "open controls": [1, 3], "errors": [1, 8],
    }  # fmt: skip


@pytest.mark.parametrize(
    ("case", "false", "certain", "tied", "model"),
    [
        (row("com_offset", verdict="explained", named=("motor_tilt",)), 1, 1, 0, 0),
        (row("com_offset", verdict="unexplained", named=("com_offset", "motor_tilt")), 1, 1, 0, 0),
        (row("com_offset", verdict="ambiguous", named=("motor_tilt",), motor_tilt="com_offset"), 0, 0, 1, 0),
        (row("com_offset", verdict="ambiguous", named=("motor_tilt",), motor_tilt="imu_bias"), 1, 0, 0, 0),
        # the hidden effect is named, but another name is tied only with a third one, or with none
        (row("com_offset", verdict="ambiguous", named=("com_offset", "motor_tilt"), motor_tilt="imu_bias"), 1, 0, 0, 0),
        (row("com_offset", verdict="ambiguous", named=("com_offset", "motor_tilt"), com_offset="imu_bias"), 1, 1, 0, 0),
        (row("com_offset", verdict="ambiguous", open="imu_bias"), 1, 0, 0, 0),
        (row("com_offset", verdict="ambiguous", open="com_offset"), 0, 0, 0, 0),
        (row("com_offset", verdict="unexplained", named=("learned_residual",)), 0, 0, 0, 1),
    ],
)
def test_a_wrong_name_counts_by_what_the_verdict_states(
    case: dict, false: int, certain: int, tied: int, model: int
) -> None:
    scores = score_rows([case])
    assert scores["false name beside an effect"] == [false, 1]
    assert scores["false name, certain"] == [certain, 1]
    assert scores["false name, ambiguous"] == [false - certain, 1]
    assert scores["wrong name tied with the effect"] == [tied, 1]
    assert scores["residual model"] == [model, 1]


def test_a_tied_name_of_a_control_is_false() -> None:
    """Nothing is there, so that no tie can hold the truth; a residual model names no cause."""
    assert score_rows([row(verdict="ambiguous", named=("gusts",), gusts="constant_wind")])["false name"] == [1, 1]
    scores = score_rows([row(verdict="unexplained", named=("learned_residual",))])
    assert (scores["false name"], scores["residual model"]) == ([0, 1], [1, 1])
