"""Reading hostile zips and folders: framing, names and unpacking. What is inside the files is not its business."""

from evaluator.archive.framing import check_framing
from evaluator.archive.inflate import MemberError, unpack
from evaluator.archive.member import Member
from evaluator.archive.names import is_passed_over
from evaluator.archive.source import Source, digest, digest_of_files, open_archive, open_source

__all__ = [
    "Member",
    "MemberError",
    "Source",
    "check_framing",
    "digest",
    "digest_of_files",
    "is_passed_over",
    "open_archive",
    "open_source",
    "unpack",
]
