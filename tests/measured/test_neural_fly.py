"""The loop in known wind: a 2.6 kg quadrotor before a fan array (O'Connell et al., Science Robotics 2022)."""

import json
from pathlib import Path

import pytest

from aerial_gym.sim2real import close_loop

DATA = Path(__file__).parents[2].parent / "shared" / "data" / "neural_fly"

pytestmark = pytest.mark.skipif(not DATA.is_dir(), reason=f"the measured flights are not on this machine: {DATA}")


@pytest.mark.slow
def test_drag_learned_at_other_wind_speeds_holds_at_an_unseen_one(tmp_path: Path) -> None:
    """Trained at 0, 4.2 and 12.1 m/s, judged at 8.5 m/s; measured -85 %, -58 % and -80 % or more, held to 80 % of that.
    How the force is shared between drags that grow with the speed and with its square these flights hardly tell."""
    train = ("NF_nowind", "baseline_35wind", "indi_35wind", "baseline_100wind", "NF_100wind")
    test = ("NF_70wind", "baseline_70wind", "indi_70wind")
    logs = [[DATA / f"{name}.csv" for name in names] for names in (train, test)]
    out = tmp_path / "out"
    close_loop("neural_fly_quad", *logs, out, mapping="neural_fly", bandwidth=5.0)
    verdict = json.loads((out / "verdict.json").read_text())
    named = {effect["name"]: effect["params"] for effect in verdict["effects"]}
    assert {"rotor_drag", "quadratic_drag"} & set(named)
    before, after = verdict["before"]["specific_force"], verdict["after"]["specific_force"]
    assert before["x"]["rms"] == pytest.approx(2.82, abs=0.05)
    assert after["x"]["rms"] < (1.0 - 0.8 * 0.83) * before["x"]["rms"]
    assert after["z"]["rms"] < (1.0 - 0.8 * 0.57) * before["z"]["rms"]
    assert after["y"]["rms"] < 1.02 * before["y"]["rms"]
    for horizon in ("0.5", "1", "2"):
        error = [verdict[when]["rollout_given_attitude"][horizon]["position"]["rms"] for when in ("before", "after")]
        assert error[1] < (1.0 - 0.8 * 0.77) * error[0]
