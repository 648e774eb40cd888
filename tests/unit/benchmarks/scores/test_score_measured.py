"""Rows of the scores on measured flights."""

from benchmarks.scores.score_measured import row_text


def test_a_row_shows_ties_of_named_effects_and_a_residual_model_without_any() -> None:
    named = {"name": "payload_mass", "params": {"dm": 0.02}, "std": {"dm": 0.01}, "confidence": 0.9, "ties": ["wind"]}
    learned = {"name": "learned_residual", "params": {}, "std": {}, "confidence": 0.99}
    row = {"set": "a", "verdict": "unexplained", "elapsed_s": 1.0, "processor_s": 1.0, "most_memory_gb": 0.5,
           "effects": [named, learned], "before": {}, "after": {}, "test_flights": {}}  # fmt: skip
    _, first, second, last = row_text(row)
    assert first.endswith("may as well be wind")
    assert second.endswith("confidence 0.99")
    assert last == "  worse: nothing"
