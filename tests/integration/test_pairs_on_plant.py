"""The whole loop on flights of two vehicles of the truth plant, which shares no code with the package."""

import pytest

from benchmarks.scores.score_pairs import PairJob, score_pair


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "seed"),
    [
        ("clocks apart", 24002),
        ("gusts on each", 24001),
        ("effect on one", 24002),
        ("downwash and ground effect", 24000),
    ],
)
def test_what_is_hidden_in_flights_of_two_vehicles_is_found(kind: str, seed: int) -> None:
    row = score_pair(PairJob(kind=kind, seed=seed, rate_hz=200))
    assert row["result"] == "right", {
        key: row.get(key) for key in ("verdict", "material", "candidates", "said", "error")
    }
