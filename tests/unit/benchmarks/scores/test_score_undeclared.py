"""The scoring of cases: judgement, intervals, tables, and runs that go on after an interruption."""

import json
from pathlib import Path

import pytest
import tyro
from scipy.stats import binom

from benchmarks.scores import score_undeclared
from benchmarks.scores.score_table import clopper_pearson, share_text
from benchmarks.scores.score_undeclared import Job, ScoreCmd, judge_verdict, run_jobs

CLEAN = {"specific_force": {"unit": "m/s²", "x": {"rms": 3.0, "noise_floor": 2.0}}}


def verdict(kind: str, **params: dict[str, tuple[float, float]]) -> dict:
    """Return a verdict with effects given as name to parameter to value and standard deviation."""
    effects = []
    for name, own in params.items():
        values, deviations = ({key: pair[k] for key, pair in own.items()} for k in (0, 1))
        effects.append({"name": name, "params": values, "std": deviations, "material": True})
    return {"verdict": kind, "effects": effects, "candidates": [], "not_testable": [], "before": CLEAN, "after": CLEAN}


@pytest.mark.parametrize(("hidden", "kind", "named", "expected"), [
    (["com_offset"], "explained", ["com_offset"], "right"),
    (["com_offset"], "unexplained", ["com_offset"], "near"),
    (["com_offset"], "explained", ["com_offset", "motor_tilt"], "near"),
    (["com_offset"], "explained", ["actuation_delay"], "wrong"),
    (["com_offset"], "unexplained", [], "missed"),
    (["com_offset"], "unexplained", ["learned_residual"], "missed"),
    (["com_offset", "constant_wind"], "explained", ["constant_wind", "com_offset"], "right"),
    (["com_offset", "constant_wind"], "explained", ["com_offset"], "near"),
    ([], "none", [], "quiet"),
    ([], "explained", ["payload_mass"], "false alarm"),
    (["unknown_time"], "unexplained", ["learned_residual"], "held back"),
    (["unknown_time"], "explained", ["thrust_coefficient"], "given a name"),
])  # fmt: skip
def test_verdicts_are_judged(hidden: list[str], kind: str, named: list[str], expected: str) -> None:
    result = judge_verdict(verdict(kind, **{name: {} for name in named}), {name: {} for name in hidden})
    assert result["judgement"] == expected
    assert result["right"] == (expected in ("right", "quiet"))
    assert result["before_over_floor"] == 1.5


def test_an_ambiguous_verdict_that_offers_the_hidden_effect_is_close() -> None:
    for candidates, expected in ((["weak_motor", "com_offset"], "near"), (["weak_motor", "motor_tilt"], "missed")):
        result = judge_verdict({**verdict("ambiguous"), "candidates": candidates}, {"com_offset": {}})
        assert result["judgement"] == expected


@pytest.mark.parametrize(("hidden", "expected"), [("com_offset", "missed"), (None, "quiet")])
def test_an_effect_that_test_flights_do_not_show_is_not_named(hidden: str | None, expected: str) -> None:
    given = verdict("not shown", com_offset={})
    given["effects"][0]["material"] = None
    result = judge_verdict(given, {} if hidden is None else {hidden: {}})
    assert (result["judgement"], result["material"], result["named"]) == (expected, [], ["com_offset"])


def test_parameters_are_compared_in_standard_deviations() -> None:
    """1.0 and 3.0 standard deviations away: one of two inside; a parameter without a deviation does not count."""
    given = verdict("explained", com_offset={"x": (0.006, 0.001), "y": (0.002, 0.001), "z": (0.1, 0.0)})
    result = judge_verdict(given, {"com_offset": {"x": 0.007, "y": -0.001, "z": 0.0}})
    assert (result["inside"], result["intervals"]) == (1, 2)
    assert result["worst_z"] == pytest.approx(3.0)


def test_clopper_pearson_has_its_closed_forms() -> None:
    """No hit of n: up to 1 - (a/2)^(1/n); all: mirrored; its own definition as binomial tails for 7 of 10."""
    assert clopper_pearson(0, 20) == pytest.approx((0.0, 1.0 - 0.025 ** (1 / 20)))
    assert clopper_pearson(20, 20) == pytest.approx((0.025 ** (1 / 20), 1.0))
    low, high = clopper_pearson(7, 10)
    assert binom.sf(6, 10, low) == pytest.approx(0.025)
    assert binom.cdf(7, 10, high) == pytest.approx(0.025)
    assert share_text(19, 20).startswith("19 of 20 (95 %, 75 to 100)")


def plan_jobs(**flags: object) -> list[Job]:
    return ScoreCmd(**{"seeds": (1, 2)} | flags).plan_jobs()


def fake_row(job: Job) -> dict[str, object]:
    truth = {name: {"a": 1.0} for name in job.hidden}
    given = verdict("explained" if truth else "none", **{name: {"a": (1.1, 0.1)} for name in truth})
    row = {"hidden": "+".join(job.hidden) or "nothing", "effects": list(job.hidden), "size": job.size, "seed": job.seed}
    return {**row, "features": list(job.features), **judge_verdict(given, truth), "fly_s": 1.0, "loop_s": 2.0}


def test_an_interrupted_run_continues(tmp_path: Path) -> None:
    jobs, made = plan_jobs(effects=["rotor_drag"], seeds=[1, 2]), []

    def score_job(job: Job) -> dict[str, object]:
        made.append(job)
        if len(made) == 3:
            raise KeyboardInterrupt
        return {**fake_row(job), **({"error": "DataError: x", "right": False} if len(made) == 2 else {})}

    with pytest.raises(KeyboardInterrupt):
        list(run_jobs(jobs, processes=1, out=tmp_path, score=score_job))
    assert [path.name for path in tmp_path.iterdir()] == [f"{jobs[0].key}.json"]
    assert len(list(run_jobs(jobs, processes=1, out=tmp_path, score=score_job))) == len(jobs) == 4
    assert made[3:] == jobs[1:]
    assert json.loads((tmp_path / f"{jobs[3].key}.json").read_text())["hidden"] == "rotor_drag"


def test_the_command_prints_the_tables(monkeypatch, capsys) -> None:
    monkeypatch.setattr(score_undeclared, "score_case", fake_row)
    monkeypatch.setattr("sys.argv", ["score", "--seeds", "205"])
    assert tyro.cli(ScoreCmd).run() == 0
    shown = capsys.readouterr().out
    assert "right 7 of 7; true value inside 6 of 6 intervals" in shown
    assert shown.count("| rotor_drag |") == 4  # names, parameters, hidden and named
    monkeypatch.setattr("sys.argv", ["score", "--seeds", "205", "--effects", "drag"])
    assert tyro.cli(ScoreCmd).run() == 2
    assert "no effect ['drag']" in capsys.readouterr().err


def test_a_sheared_wind_is_compared_at_one_height() -> None:
    """3 m/s at 2 m with an exponent of 0.25 are 3 x 5^0.25 = 4.486 m/s at 10 m; an exponent off by 0.01 moves that by 1.6 %."""
    result = verdict("explained", wind_shear={"x": (3.0, 0.0), "y": (0.0, 0.1), "exponent": (0.25, 0.01)})
    result["effects"][0]["params"]["z_ref"] = 2.0
    truth = {"wind_shear": {"x": 4.486, "y": 0.0, "z_ref": 10.0, "exponent": 0.24}}
    rows = {row["name"]: row for row in judge_verdict(result, truth)["parameters"]}
    assert rows["x"]["value"] == pytest.approx(4.486, abs=1e-3)
    assert rows["x"]["std"] == pytest.approx(4.486 * 0.01609, rel=1e-3)
    assert rows["y"]["std"] == pytest.approx(0.1 * 5.0**0.25, rel=1e-3)
    assert rows["exponent"]["value"] == 0.25
