"""Scores on logs as loggers write them: which cases are planned, and what is counted."""

from benchmarks.scores.score_loggers import LoggerScoreCmd, score_rows
from benchmarks.undeclared.evidence import SHOWN


def row(
    *effects: str, verdict: str, named: tuple[str, ...] = (), evidence: float = 2.0 * SHOWN, **other: object
) -> dict:
    return {
        "effects": list(effects), "verdict": verdict, "named": list(named), "material": list(named), "candidates": [],
        "evidence": {"nothing": 3.0 * SHOWN, "rival": evidence}, **other,
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
        row("gusts", verdict="ambiguous", named=("constant_wind",), candidates=["gusts"]),
        {"effects": ["gusts"], "error": "ValueError"},
    ]
    assert score_rows(rows) == {
        "false name": [1, 3], "false name beside an effect": [2, 4], "effects shown": [3, 4],
        "shown effects named": [2, 3], "named, or ambiguous with it": [3, 4], "open controls": [1, 3],
        "errors": [1, 8],
    }  # fmt: skip
