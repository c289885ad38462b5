"""A report on a submission's bytes as plain text for the terminal."""

from collections.abc import Iterator

from evaluator.report import Problem, ProblemGroup, Report

LISTED_PROBLEMS = 20
"""Problems shown of each group; the rest are counted. As JSON a report has up to 1000."""


def report_text(report: Report) -> str:
    """Return the report as text: every group with its count, its fix and where it was found; "" when it is empty."""
    lines = [line for group in report.groups for line in _group_lines(group)]
    if report.groups and report.images_expected:
        lines.append(f"{amount(report)} were read.")
    return "\n".join(lines)


def amount(report: Report, *, images_known: bool = True) -> str:
    """Say how much was read: boxes and images, of how many when that is known."""
    boxes = "1 box" if report.boxes == 1 else f"{report.boxes} boxes"
    of = f" of {report.images_expected}" if images_known else ""
    one = (report.images_expected if images_known else report.images_found) == 1
    return f"{boxes} in {report.images_found}{of} {'image' if one else 'images'}"


def _group_lines(group: ProblemGroup) -> Iterator[str]:
    yield f"{group.severity}: {group.title} [{group.code}, {group.count}x]"
    shown = group.problems[:LISTED_PROBLEMS]
    yield from (f"    {problem_line(problem)}" for problem in shown)
    if group.count > len(shown):
        yield f"    and {group.count - len(shown)} more"
    yield f"    fix: {group.fix}"


def problem_line(problem: Problem) -> str:
    """Write one place on one line: where, found, expected, detail."""
    place = " ".join(part for part in (problem.file, problem.pointer) if part)
    found = problem.found and f"found {problem.found}"
    expected = problem.expected and f"expected {problem.expected}"
    what = ", ".join(part for part in (found, expected, problem.detail) if part)
    return ": ".join(part for part in (place, what) if part)
