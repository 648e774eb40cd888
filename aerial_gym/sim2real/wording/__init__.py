"""The wording: the sentence or sentences for each code of a finding. Only reports and commands use them."""

from collections.abc import Iterable, Mapping
from typing import Any

from aerial_gym.sim2real.findings import Finding
from aerial_gym.sim2real.json_values import finite_or_none, map_leaves
from aerial_gym.sim2real.wording.answer import ANSWER, TRUST
from aerial_gym.sim2real.wording.logs import LOGS
from aerial_gym.sim2real.wording.notes import NOTES, REASONS
from aerial_gym.sim2real.wording.pairs import PAIRS
from aerial_gym.sim2real.wording.preflight import PREFLIGHT
from aerial_gym.sim2real.wording.teststand import TESTSTAND
from aerial_gym.sim2real.wording.words import Template, template_sentence

TEMPLATES: dict[str, Template] = {
    **ANSWER,
    **TRUST,
    **NOTES,
    **REASONS,
    **LOGS,
    **PAIRS,
    **TESTSTAND,
    **PREFLIGHT,
}  # Template of each code

_WITH_SUBJECT = {*LOGS, "rows_without_speed", "thrust_from_gravity", "curvature_kept"}
"""Codes whose sentence starts with the subject and a colon."""


def text(finding: Finding) -> str:
    """Return the sentence of a finding."""
    sentence = template_sentence(TEMPLATES[finding.code], finding)
    return f"{finding.subject}: {sentence}" if finding.subject and finding.code in _WITH_SUBJECT else sentence


def join_texts(findings: Iterable[Finding]) -> str:
    """Return the sentences of findings as one text."""
    return " ".join(map(text, findings))


def answer_texts(parts: Mapping[str, Iterable[Finding]]) -> list[str]:
    """Return the non-empty parts of an answer as texts; the last part starts with ``Next:``."""
    texts = {name: join_texts(part) for name, part in parts.items()}
    step = texts["next"]
    texts["next"] = step and f"Next: {step[0].lower()}{step[1:]}"
    return [sentence for sentence in texts.values() if sentence]


def render_findings(content: Any) -> Any:
    """Return content for JSON with every finding replaced by its sentence."""
    return map_leaves(content, lambda value: text(value) if isinstance(value, Finding) else value)


def finding_rows(findings: Iterable[Finding]) -> list[dict[str, object]]:
    """Return findings for JSON: code, subject, values, severity and text; infinite and NaN values become null."""
    return [
        {
            "code": f.code,
            "subject": f.subject,
            "values": map_leaves(f.values, finite_or_none),
            "severity": f.severity,
            "text": text(f),
        }
        for f in findings
    ]
