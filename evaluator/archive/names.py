"""Rules for the names of files in an archive or a folder, and which files are passed over."""

import re
import unicodedata
from collections.abc import Callable, Iterable, Sequence
from pathlib import PurePosixPath

from evaluator.codes import Code
from evaluator.findings import Findings
from evaluator.limits import Limits

_PLAIN = re.compile(r"(?:[A-Za-z0-9_+\-][A-Za-z0-9_+. \-]*/)*(?:[A-Za-z0-9_+\-][A-Za-z0-9_+. \-]*)?")
"""Names that need no closer look: printable ASCII, relative, no empty and no dot-only parts."""
_USUAL = re.compile(r"(?:[A-Za-z0-9_+\-][A-Za-z0-9_+. \-]*/)*[A-Za-z0-9_+\-][A-Za-z0-9_+. \-]*(?:/|\.json)")
"""Those of them that are folders or JSON files."""
_CONTROL = re.compile(r"[\x00-\x1f\x7f-\x9f]")
_DRIVE = re.compile(r"[A-Za-z]:")
_ARCHIVE_SUFFIXES = (".zip", ".tar", ".gz", ".tgz", ".bz2", ".tbz2", ".xz", ".txz", ".7z", ".rar", ".zst", ".jar")

_RULES: tuple[tuple[Code, Callable[[str], object]], ...] = (
    (Code.CONTROL_CHARACTER_NAME, _CONTROL.search),
    (Code.BACKSLASH_NAME, lambda name: "\\" in name),
    (Code.DRIVE_NAME, _DRIVE.match),
    (Code.ABSOLUTE_NAME, lambda name: name.startswith("/")),
    (Code.PARENT_NAME, lambda name: ".." in name.split("/")),
    (Code.EMPTY_NAME, lambda name: "" in name.removesuffix("/").split("/")),
)
"""Checked in this order; a name is reported once, under the first rule it breaks."""


def check_names(names: Iterable[str], limits: Limits, findings: Findings) -> None:
    """Refuse names that are unsafe, nested archives, and names that are or may become the same. Linear in them."""
    names = tuple(names)
    if _are_usual(names, limits):
        return
    seen: dict[str, str] = {}
    for name in names:
        _check_name(name, limits, findings)
        folded = _fold(name)
        other = seen.setdefault(folded, name)
        if other is name:
            continue
        code = Code.DUPLICATE_NAME if other == name else Code.COLLIDING_NAMES
        findings.add(code, file=name, detail=None if other == name else f"collides with {other[:200]!a}")


def _are_usual(names: Sequence[str], limits: Limits) -> bool:
    """Tell in half the time that there is nothing to say of any name."""
    return (
        all(map(_USUAL.fullmatch, names))
        and len(set(map(str.lower, names))) == len(names)
        and max(map(len, names), default=0) <= limits.name_bytes
    )


def _check_name(name: str, limits: Limits, findings: Findings) -> None:
    """Check one name by itself."""
    if len(name) * 4 > limits.name_bytes and len(name.encode("utf-8", "surrogatepass")) > limits.name_bytes:
        findings.add(Code.NAME_TOO_LONG, file=name, expected=f"at most {limits.name_bytes} bytes")
    if not name or not _PLAIN.fullmatch(name):
        broken = next((code for code, breaks in _RULES if breaks(name)), None)
        if broken is not None:
            findings.add(broken, file=name)
    if name.lower().endswith(_ARCHIVE_SUFFIXES) and not is_passed_over(name):
        findings.add(Code.NESTED_ARCHIVE, file=name)


def _fold(name: str) -> str:
    """Reduce a name to what a case-insensitive, normalising file system makes of it."""
    if name.isascii():
        return name.lower()
    return unicodedata.normalize("NFC", unicodedata.normalize("NFC", name).casefold())


def is_passed_over(name: str) -> bool:
    """Tell whether a file is what macOS leaves in archives and folders: `__MACOSX/`, `.DS_Store`, `._*`."""
    if "._" not in name and ".DS_Store" not in name and "__MACOSX" not in name:
        return False
    path = PurePosixPath(name)
    return "__MACOSX" in path.parts or path.name == ".DS_Store" or path.name.startswith("._")
