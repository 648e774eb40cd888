"""The contents of ``verdict.json``: the verdict with its findings in words."""

from aerial_gym.sim2real.judge.answer import answer, findings_of, meaning
from aerial_gym.sim2real.judge.verdict import Verdict
from aerial_gym.sim2real.wording import answer_texts, finding_rows, joined, rendered, text


def verdict_json(verdict: Verdict) -> dict[str, object]:
    """Return a verdict as ``verdict.json`` holds it (DESIGN.md, section 4)."""
    return {
        "verdict": verdict.verdict,
        "reason": " ".join(answer_texts(answer(verdict).parts)),
        "meaning": joined(meaning(verdict)),
        "findings": finding_rows(findings_of(verdict)),
        **{name: rendered(part) for name, part in verdict.as_mapping().items()},
        "not_testable_because": {name: text(reason) for name, reason in verdict.not_testable.items()},
        "learned_residual": None if verdict.learned is None else joined(verdict.learned.findings),
        "notes": [text(note) for note in verdict.notes],
    }
