"""The loop on real flights: Crazyflie 2.1 Brushless with measured rotor speeds (Busetto et al., arXiv 2512.14450)."""

import json
from pathlib import Path

import pytest

from aerial_gym.sim2real import close_loop
from tests.builders import simulation

DATA = Path(__file__).parents[2].parent / "shared" / "data" / "idsia_nanodrone"

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not DATA.is_dir(), reason=f"the measured flights are not on this machine: {DATA}"),
]


HOVER_SUM = 4 * 1695.0  # Sum of the four rotor speeds in hover [rad/s]: 0.045 kg on the declared thrust map


def test_the_loop_names_flapping_and_takes_most_off_the_residuals(tmp_path: Path) -> None:
    train = sorted(path for pattern in ("square_*", "random*", "multisine_*") for path in DATA.glob(pattern))[::2]
    test = sorted(DATA.glob("melon_*"))
    assert (len(train), len(test)) == (6, 2)
    out = tmp_path / "out"
    close_loop("crazyflie_21_brushless", train, test, out, mapping="idsia_nanodrone")
    verdict = json.loads((out / "verdict.json").read_text())
    named = {effect["name"]: effect["params"] for effect in verdict["effects"]}
    # In which order effects are named is no evidence: alone, flapping raises the force along z by 2.1 %, 0.1 % more than is
    # allowed, and waits for another one. What counts is that the sideways force needs it.
    (flapping,) = (effect for effect in verdict["effects"] if effect["name"] == "h_force_flapping")
    worst = flapping["without_it"]["residual"]["channel"]
    assert worst in {f"{kind}.{axis}" for kind in ("specific_force", "angular_acceleration") for axis in "xy"}
    assert flapping["without_it"]["residual"]["interval"][0] > 1.0  # it more than doubles
    before, after = verdict["before"]["specific_force"], verdict["after"]["specific_force"]
    assert before["x"]["rms"] == pytest.approx(0.48, abs=0.02)
    assert before["y"]["rms"] == pytest.approx(0.39, abs=0.02)
    # The study fits all flights with the test in view: 0.116 and 0.108. Half of them are held to 20 % more.
    assert after["x"]["rms"] <= 1.2 * 0.116
    assert after["y"]["rms"] <= 1.2 * 0.108
    for horizon in ("0.1", "0.5", "1"):
        error = {when: verdict[when]["rollout_given_attitude"][horizon]["position"] for when in ("before", "after")}
        assert error["after"]["rms"] < error["before"]["rms"]
        low, high = error["after"]["interval"]
        assert low < error["after"]["rms"] < high
    # The moment that grows with speed: measured_data.md 3.2 takes 61 and 65 % off before any gain is fitted.
    for axis in "xy":
        turn = {when: verdict[when]["angular_acceleration"][axis]["rms"] for when in ("before", "after")}
        assert turn["after"] < 0.45 * turn["before"]
    # Other people found 0.0215 N s/m on other flights (drone-models); here it is shared by the rotors and the body.
    body = named.get("rotor_drag", {"dx": 0.0, "dy": 0.0})
    for axis in ("dx", "dy"):
        assert named["h_force_flapping"]["kh"] * HOVER_SUM + body[axis] == pytest.approx(0.0215, rel=0.15)
    for name in ("report.html", "report.md", "residuals.csv"):
        assert (out / name).stat().st_size > 1000
    env = simulation(out / "robot.yaml")
    env.reset()
    assert env.gtd["effect_h_force_flapping"][0, 1] == pytest.approx(named["h_force_flapping"]["kf"], rel=1e-5)
