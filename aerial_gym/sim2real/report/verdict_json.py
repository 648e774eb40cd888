"""Content of ``verdict.json``: the verdict with its findings in words."""

from aerial_gym.sim2real.judge.answer import all_findings, answer_parts, trust_findings
from aerial_gym.sim2real.judge.verdict import Verdict
from aerial_gym.sim2real.wording import answer_texts, finding_rows, join_texts, render_findings, text


def verdict_json(verdict: Verdict) -> dict[str, object]:
    """Return the content of ``verdict.json`` (DESIGN.md, section 4)."""
    return {
        "verdict": verdict.verdict,
        "reason": " ".join(answer_texts(answer_parts(verdict))),
        "meaning": join_texts(trust_findings(verdict)),
        "findings": finding_rows(all_findings(verdict)),
        **{name: render_findings(part) for name, part in verdict.as_mapping().items()},
        "not_testable_because": {name: text(reason) for name, reason in verdict.not_testable.items()},
        "learned_residual": None if verdict.learned is None else join_texts(verdict.learned.findings),
        "notes": [text(note) for note in verdict.notes],
    }
