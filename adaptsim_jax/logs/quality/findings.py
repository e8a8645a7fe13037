"""What the checks of a recording say, for whoever reads it: records alone."""

from dataclasses import dataclass, field

import numpy as np


@dataclass(frozen=True)
class Finding:
    """One thing the audit saw. `severity`: `info`, `warn`, or `fault` (no diagnosis should be made of it).

    `where` names a channel, joint or time; `value` is the number that `message` explains.
    """

    kind: str
    severity: str
    trial: str
    where: str
    message: str
    value: float


Findings = list[Finding]


@dataclass(frozen=True)
class Audit:
    """Findings of all trials; `valid[name]: [T]` bool, the rows to use; `exclude`: trials not to use at all.

    `quantisation`: channel -> step (rad, rad/s, N m; 0 where none is seen).
    """

    findings: tuple[Finding, ...]
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
        return f"{warnings} warning(s), no fault" if warnings else "no fault found"

    def of(self, kind: str) -> tuple[Finding, ...]:
        """Findings of one kind."""
        return tuple(f for f in self.findings if f.kind == kind)
