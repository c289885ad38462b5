"""What must hold for any bytes at all; both kinds of fuzzing check it."""

import io
import zipfile

import numpy as np

from evaluator.archive import MemberError, check_framing, unpack
from evaluator.columns import ColumnBuilder
from evaluator.decoding import box_decoder, count_colons, extra_keys_are_clean, keys_are_expected
from evaluator.explanation import explain
from evaluator.findings import Findings
from evaluator.limits import Limits
from evaluator.protocol import VEHICLE_LABELS

LIMITS = Limits(archive_bytes=1 << 20, entries=50, expanded_bytes=1 << 22, file_bytes=1 << 20)
DECODER = box_decoder(VEHICLE_LABELS)


def check_document(data: bytes) -> None:
    """The slow path has something to say of what cannot be decoded, and nothing of what the fast path finds clean."""
    findings = Findings()
    explain(data, file="fuzz.json", known_labels=frozenset(VEHICLE_LABELS), limits=LIMITS, findings=findings)
    report = findings.report(images_expected=1, images_found=1, boxes=0)
    if report.groups and _fast_path_is_content(data):
        raise AssertionError(f"the fast path is content, the slow path says {report.groups}")
    if report.accepted and DECODER.decode(data) is None:
        raise AssertionError("the file cannot be decoded, but nothing was said about it")


def _fast_path_is_content(data: bytes) -> bool:
    """Tell whether the fast path would ask for no explanation."""
    boxes = DECODER.decode(data)
    if boxes is None or len(boxes) > LIMITS.boxes_per_image:
        return False
    builder = ColumnBuilder()
    builder.add(boxes)
    columns, modal = builder.build(np.zeros(len(boxes), dtype=np.int32))
    expected = keys_are_expected(
        colons=count_colons([data]), files=1, boxes=len(boxes), modal=modal
    ) or extra_keys_are_clean(data, LIMITS.json_depth)
    return expected and not columns.rows_to_explain(len(VEHICLE_LABELS)).any()


def check_archive(data: bytes) -> None:
    """An archive that passes can be read, and the standard library reads the same from it."""
    findings = Findings()
    members = check_framing(data, LIMITS, findings)
    report = findings.report(images_expected=0, images_found=0, boxes=0)
    if not report.accepted:
        return
    try:
        archive = zipfile.ZipFile(io.BytesIO(data))
    except NotImplementedError:  # it believes the version a member says it needs; nothing here depends on it
        return
    with archive:
        files = [info for info in archive.infolist() if not info.is_dir()]
        if len(files) != len(members):
            raise AssertionError(f"{len(members)} members here, {len(files)} in the standard library")
        for member, info in zip(members, files, strict=True):
            try:
                ours = unpack(data, member)
            except MemberError:
                continue
            if ours != archive.read(info):
                raise AssertionError(f"other bytes than the standard library's in {member.name!r}")
