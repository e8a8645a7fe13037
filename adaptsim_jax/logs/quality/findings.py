"""What the checks of a recording say: records, and their words by code (`words.toml`)."""

import tomllib
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

WORDS: dict[str, Any] = tomllib.loads(
    Path(__file__).with_name("words.toml").read_text(encoding="utf-8")
)
"""`finding`, `hypothesis` and `difference` by code."""


@dataclass(frozen=True)
class AuditFinding:
    """One thing the audit saw. `severity`: `info`, `warn`, or `fault` (no diagnosis should be made
    of it).

    `where` names a channel, joint or time; `value` is the number that `message` explains.
    """

    kind: str
    severity: str
    trial: str
    where: str
    message: str
    value: float


Findings = list[AuditFinding]


def finding(code: str, trial: str, where: str, value: float, **facts: Any) -> AuditFinding:
    """A finding in the words of its code.

    Args:
        code: in `words.toml`.
        trial: its name, empty for the recording.
        where: channel, joint or time.
        value: the number that the words explain, which they call `value`.
        facts: what else the words name.
    """
    words = WORDS["finding"][code]
    text = words["text"].format(where=where, value=value, **facts)
    return AuditFinding(
        words.get("kind", code), words["severity"], trial, where, text, float(value)
    )


@dataclass(frozen=True)
class Audit:
    """Findings of all trials; `valid[name]: [T]` bool, the rows to use.

    - `exclude`: Trials not to use at all.
    - `quantisation`: Channel -> step (rad, rad/s, N m; 0 where none is seen).
    """

    findings: tuple[AuditFinding, ...]
    quantisation: dict[str, float] = field(default_factory=dict)
    valid: dict[str, np.ndarray] = field(default_factory=dict)
    exclude: tuple[str, ...] = ()

    @property
    def fault(self) -> bool:
        """Whether the data contradict themselves so far that no diagnosis should be made."""
        return any(f.severity == "fault" for f in self.findings)

    @property
    def message(self) -> str:
        """The faults, or the number of warnings, in one line."""
        faults = [f.message for f in self.findings if f.severity == "fault"]
        if faults:
            return "; ".join(faults)
        warnings = sum(f.severity == "warn" for f in self.findings)
        if warnings:
            return f"{warnings} warning(s), no fault"
        return "no fault found"

    @property
    def warnings(self) -> list[str]:
        """A sentence for each kind of warning and channel, and the trials left out."""
        if self.exclude:
            lines = [f"left out: {', '.join(self.exclude)}"]
        else:
            lines = []
        groups: dict[tuple[str, str], list[AuditFinding]] = {}
        for f in self.findings:
            if f.severity == "warn":
                groups.setdefault((f.kind, f.where if f.kind != "gap" else ""), []).append(f)
        for (_, where), group in groups.items():
            first = group[0]
            place = f"{first.trial}: " if first.trial else ""
            if len(group) > 1:
                others = f" (and so in {len(group) - 1} more trial{'s' if len(group) > 2 else ''})"
            else:
                others = ""
            if not where or first.message.startswith(where) or where in first.message:
                channel = ""
            else:
                channel = f"{where} "
            lines.append(f"{place}{channel}{first.message}{others}")
        return lines

    @property
    def limits(self) -> list[str]:
        """A sentence for each channel that rests at its largest values."""
        cut = sorted(
            {f.where for f in self.findings if f.kind == "saturation" and f.severity == "info"}
        )
        only = "where only its log is cut, and not the torque, what is named is wrong"
        return [f"{name} rests at its largest values: {only}" for name in cut]

    @property
    def rows(self) -> list[dict[str, str]]:
        """The findings as a page shows them; what is only information once for all trials."""
        out, shown = [], {}
        for f in self.findings:
            where = f"{f.trial} {f.where}".strip()
            if f.severity == "info" and (f.kind, f.where) in shown:
                shown[f.kind, f.where].append(f.trial)
                continue
            row = {"severity": f.severity, "where": where, "message": f.message}
            if f.severity == "info":
                shown[f.kind, f.where] = []
            out.append((row, shown.get((f.kind, f.where), [])))
        for row, others in out:
            if row["severity"] == "info" and others:
                row["message"] += f" (and so in {len(others)} more)"
        return [row for row, _ in out]

    def of(self, kind: str) -> tuple[AuditFinding, ...]:
        """Findings of one kind."""
        return tuple(f for f in self.findings if f.kind == kind)
