"""Debt of the language checks: counts of offences for each rule and file, in ``debt.json``, that may only fall. A file
with more offences than its debt fails. One with fewer fails until ``python -m tests.language`` lowers the debt, so that
no offence comes back. A rule without debt allows no offence."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path

FILE = Path(__file__).with_name("debt.json")

Offences = Mapping[str, Sequence[str]]
"""Offences of one rule: descriptions for each file or subject."""


def read() -> dict[str, dict[str, int]]:
    """Return the allowed offences by rule and subject."""
    return json.loads(FILE.read_text("utf-8")) if FILE.exists() else {}


def difference(offences: Offences, allowed: Mapping[str, int]) -> list[str]:
    """Return a line for each subject whose offences differ from the allowed number, with the offences."""
    lines = []
    for subject in sorted({*offences, *allowed}):
        texts, limit = offences.get(subject, ()), allowed.get(subject, 0)
        if len(texts) > limit:
            lines.append(f"{subject}: {len(texts)} offences, at most {limit} allowed: {'; '.join(texts)}")
        elif len(texts) < limit:
            lines.append(f"{subject}: {len(texts)} offences, {limit} allowed: lower it with `python -m tests.language`")
    return lines


def lower(rules: Mapping[str, Offences]) -> list[str]:
    """Write the present offences as the new debt; return the rules whose total would rise, which keep their debt."""
    before = read()
    now = {
        rule: {subject: len(texts) for subject, texts in sorted(offences.items())} for rule, offences in rules.items()
    }
    rises = [rule for rule in now if rule in before and sum(now[rule].values()) > sum(before[rule].values())]
    debt = {rule: before[rule] if rule in rises else counts for rule, counts in sorted(now.items())}
    FILE.write_text(json.dumps({rule: counts for rule, counts in debt.items() if counts}, indent=0) + "\n", "utf-8")
    return rises
