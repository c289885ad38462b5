"""Collects problems while a submission is read, and turns them into its report."""

from collections import Counter

from evaluator.codes import MEANINGS, Code
from evaluator.report import MAX_LOCATED_PROBLEMS, Problem, ProblemGroup, Report, Severity

_SEVERITIES: tuple[Severity, ...] = ("error", "warning", "note")
_LONGEST_QUOTE = 120


def quote(text: str) -> str:
    """Make hostile text safe and short enough for a report: printable, on one line, at most 120 characters."""
    if len(text) <= _LONGEST_QUOTE and text.isprintable():
        return str(text)  # a plain one, should it be a subclass
    head = text[: _LONGEST_QUOTE + 1]
    safe = "".join(char if char.isprintable() else char.encode("unicode_escape").decode() for char in head)
    return safe if len(head) <= _LONGEST_QUOTE and len(safe) <= _LONGEST_QUOTE else f"{safe[: _LONGEST_QUOTE - 3]}..."


class Findings:
    """Problems by code: the first ones located, all of them counted."""

    def __init__(self) -> None:
        """Start without any."""
        self._located: dict[Code, list[Problem]] = {}
        self._counts: Counter[Code] = Counter()
        self._confidence: dict[Code, float] = {}

    def add(
        self,
        code: Code,
        *,
        file: str | None = None,
        pointer: str | None = None,
        found: str | None = None,
        expected: str | None = None,
        detail: str | None = None,
        count: int = 1,
    ) -> None:
        """Note a problem; one located entry may stand for `count` places."""
        self._counts[code] += count
        located = self._located.setdefault(code, [])
        if len(located) < MAX_LOCATED_PROBLEMS:
            name = None if file is None else quote(file)
            located.append(Problem(file=name, pointer=pointer, found=found, expected=expected, detail=detail))

    def trust(self, code: Code, confidence: float) -> None:
        """State how sure a recognised mistake is, in [0, 1]; the highest statement counts."""
        self._confidence[code] = max(confidence, self._confidence.get(code, 0.0))

    def found(self, code: Code, pointer_end: str = "") -> list[str]:
        """List what was found at the located places of a code whose pointers end in a certain way."""
        located = self._located.get(code, ())
        return [one.found for one in located if one.found is not None and (one.pointer or "").endswith(pointer_end)]

    @property
    def error_count(self) -> int:
        """Count the problems that reject the submission."""
        return sum(n for code, n in self._counts.items() if MEANINGS[code].severity == "error")

    def __contains__(self, code: Code) -> bool:
        """Tell whether the code was found."""
        return code in self._counts

    def report(self, *, images_expected: int, images_found: int, boxes: int) -> Report:
        """Group what was found, errors first, sharing the room for located problems fairly between the groups."""
        room = _fair_shares({code: len(problems) for code, problems in self._located.items()}, MAX_LOCATED_PROBLEMS)
        groups = [self._group(code, room[code]) for code in Code if code in self._counts]
        groups.sort(key=lambda group: _SEVERITIES.index(group.severity))
        return Report(groups=tuple(groups), images_expected=images_expected, images_found=images_found, boxes=boxes)

    def _group(self, code: Code, room: int) -> ProblemGroup:
        """Make the group of one code with its first `room` located problems."""
        meaning = MEANINGS[code]
        return ProblemGroup(
            code=code.value,
            severity=meaning.severity,
            title=meaning.title,
            fix=meaning.fix,
            count=self._counts[code],
            problems=tuple(self._located[code][:room]),
            confidence=self._confidence.get(code),
        )


def _fair_shares(wanted: dict[Code, int], room: int) -> dict[Code, int]:
    """Share `room` between the codes: small wants are met in full, the rest is split evenly."""
    shares: dict[Code, int] = {}
    left = len(wanted)
    for code, want in sorted(wanted.items(), key=lambda item: item[1]):
        shares[code] = min(want, room // left)
        room -= shares[code]
        left -= 1
    return shares
