"""The loop on real flights: Crazyflie 2.1 Brushless with measured rotor speeds (Busetto et al., arXiv 2512.14450)."""

import json
from pathlib import Path

import pytest

from aerial_gym import SimBuilder
from aerial_gym.sim2real import close_loop

DATA = Path(__file__).parents[2].parent / "shared" / "data" / "idsia_nanodrone"

pytestmark = pytest.mark.skipif(not DATA.is_dir(), reason=f"the measured flights are not on this machine: {DATA}")


def test_the_loop_names_rotor_drag_first_and_takes_three_quarters_off_the_lateral_residual(tmp_path: Path) -> None:
    """Train on square, random and multisine flights; judged on the two melon flights, which no fit has seen."""
    train = sorted(path for pattern in ("square_*", "random*", "multisine_*") for path in DATA.glob(pattern))
    test = sorted(DATA.glob("melon_*"))
    assert (len(train), len(test)) == (12, 2)
    out = tmp_path / "out"
    close_loop("crazyflie_21_brushless", train, test, out, mapping="idsia_nanodrone")
    verdict = json.loads((out / "verdict.json").read_text())
    assert verdict["effects"][0]["name"] == "rotor_drag"
    before, after = verdict["before"]["specific_force"], verdict["after"]["specific_force"]
    assert before["x"]["rms"] == pytest.approx(0.48, abs=0.02)
    assert before["y"]["rms"] == pytest.approx(0.39, abs=0.02)
    assert after["x"]["rms"] <= 0.13
    assert after["y"]["rms"] <= 0.12
    for horizon in ("0.1", "0.5", "1"):
        error = {when: verdict[when]["rollout_given_attitude"][horizon]["position"] for when in ("before", "after")}
        assert error["after"]["rms"] < error["before"]["rms"]
        low, high = error["after"]["interval"]
        assert low < error["after"]["rms"] < high
    # The drag that other people found on other flights (drone-models, 0.0215 N s/m) lies in the interval.
    for axis in ("dx", "dy"):
        low, high = verdict["effects"][0]["interval"][axis]
        assert low < 0.0215 < high
    for name in ("report.html", "report.md", "residuals.csv"):
        assert (out / name).stat().st_size > 1000
    env = SimBuilder().build_env(
        sim_name="base_sim",
        env_name="empty_env",
        robot_name=out / "robot.yaml",
        controller_name="no_control",
        num_envs=2,
        device="cpu",
    )
    env.reset()
    assert env.gtd["effect_rotor_drag"][0, 0] == pytest.approx(verdict["effects"][0]["params"]["dx"], rel=1e-5)
