"""Verdicts of a fleet from the results of its vehicles."""

import numpy as np
import pytest

pytest.importorskip("deltalake", reason="deltalake is not installed")

from aerial_gym.fleet.pass_two import PassTwoSettings, VehicleResult, decide
from aerial_gym.fleet.statistics import ChangeResult
from tests.unit.fleet.test_wording import THRUST


@pytest.mark.parametrize(("log_e", "verdict", "is_rejected"), [(30.0, "changed", True), (1.0, "campaign", False)])
def test_change_that_campaigns_may_explain_names_both(log_e: float, verdict: str, is_rejected: bool) -> None:
    change = ChangeResult(vehicle="17", flights=300, log_e=log_e, causes=(THRUST,))
    result = VehicleResult(
        vehicle="17", log_e=log_e, own_log_e=30.0, verdict={"verdict": "changed", "onset_flight": 212}, parameters=(),
        change=change, odd_logs=(), note="",
    )  # fmt: skip
    (row,) = decide([result], np.empty(0), PassTwoSettings())
    assert (row["verdict"], row["rejected"], row["log_e"]) == (verdict, is_rejected, log_e)
    assert row["text"].startswith("vehicle 17, rotor 3: -2.1 % thrust (± 0.3 %) since flight 212")
    assert ("or a campaign" in row["text"]) != is_rejected
    assert row["onset_flight"] == (212 if is_rejected else None)
