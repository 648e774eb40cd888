import json
from pathlib import Path

import numpy as np
import pytest

from aerial_gym.sim2real.json_values import plain, select_fields, write_json
from aerial_gym.sim2real.statistics import Rms


def test_a_finding_is_plain_through_all_levels() -> None:
    result = {"error": Rms(value=1.0, low=0.5, high=2.0), "place": (np.array([1.0, 2.0]), None)}
    assert plain(result) == {"error": {"rms": 1.0, "interval": [0.5, 2.0]}, "place": [[1.0, 2.0], None]}


def test_fields_come_in_the_order_in_which_they_are_named() -> None:
    rms = Rms(value=1.0, low=0.5, high=2.0)
    assert list(select_fields(rms, "high", "value").items()) == [("high", 2.0), ("value", 1.0)]


def test_json_holds_signs_as_they_are_and_no_number_that_is_none(tmp_path: Path) -> None:
    write_json(tmp_path / "found.json", {"unit": "m/s²"})
    assert "m/s²" in (tmp_path / "found.json").read_text(encoding="utf-8")
    assert json.loads((tmp_path / "found.json").read_text(encoding="utf-8")) == {"unit": "m/s²"}
    with pytest.raises(ValueError, match="not JSON compliant"):
        write_json(tmp_path / "none.json", {"value": np.nan})
