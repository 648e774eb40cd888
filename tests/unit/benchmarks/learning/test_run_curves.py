"""Curves of trainings, drawn from what run folders keep."""

from pathlib import Path

from benchmarks.learning import run_curves

ROWS = """time_s,env_steps,reward_per_step,episode_return,episode_length,env_steps_per_s
1.0,1000000,,,,0
2.0,2000000,0.1,5.5,50,10
3.0,4000000,0.1,7.5,50,10
"""


def test_a_curve_begins_with_the_first_episode_that_ended(tmp_path: Path) -> None:
    (tmp_path / "curve.csv").write_text(ROWS)
    assert run_curves.curve(tmp_path) == ([2.0, 4.0], [5.5, 7.5])


def test_every_name_gets_a_panel(tmp_path: Path) -> None:
    (tmp_path / "curve.csv").write_text(ROWS)
    run_curves.main(str(tmp_path / "out.png"), *(f"{name}={tmp_path} {tmp_path}" for name in "abcd"))
    assert (tmp_path / "out.png").read_bytes().startswith(b"\x89PNG")


def test_a_return_far_from_all_others_does_not_set_the_scale() -> None:
    rising = [-20.0 + 0.1 * step for step in range(401)]
    assert run_curves.span(rising) == (rising[0], rising[-1])
    assert run_curves.span([*rising, -2400.0]) == (rising[0], rising[-1])
