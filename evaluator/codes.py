"""Every problem the intake can report: its stable code, its title and its fix.

Codes are part of the public interface: they are never renamed, and docs/errors.md lists each of them.
"""

from dataclasses import dataclass
from enum import StrEnum

from evaluator.report import Severity


class Code(StrEnum):
    """Stable codes, in the order in which a report shows them."""

    # the archive as a whole
    UNREADABLE = "unreadable"
    NOT_A_ZIP = "not_a_zip"
    TRUNCATED_ARCHIVE = "truncated_archive"
    EMPTY_ARCHIVE = "empty_archive"
    ARCHIVE_TOO_LARGE = "archive_too_large"
    TOO_MANY_ENTRIES = "too_many_entries"
    EXPANDED_TOO_LARGE = "expanded_too_large"
    RATIO_TOO_HIGH = "ratio_too_high"
    MULTI_DISK = "multi_disk"
    PREFIX_BYTES = "prefix_bytes"
    SUFFIX_BYTES = "suffix_bytes"
    DAMAGED_DIRECTORY = "damaged_directory"
    ENTRY_COUNT_MISMATCH = "entry_count_mismatch"
    ZIP64_MISMATCH = "zip64_mismatch"
    # one member's framing
    LOCAL_HEADER_MISMATCH = "local_header_mismatch"
    OVERLAPPING_MEMBERS = "overlapping_members"
    HIDDEN_BYTES = "hidden_bytes"
    ENCRYPTED = "encrypted"
    UNSUPPORTED_COMPRESSION = "unsupported_compression"
    LINK_OR_DEVICE = "link_or_device"
    ABSOLUTE_NAME = "absolute_name"
    PARENT_NAME = "parent_name"
    BACKSLASH_NAME = "backslash_name"
    DRIVE_NAME = "drive_name"
    CONTROL_CHARACTER_NAME = "control_character_name"
    UNDECODABLE_NAME = "undecodable_name"
    EMPTY_NAME = "empty_name"
    NAME_TOO_LONG = "name_too_long"
    DUPLICATE_NAME = "duplicate_name"
    COLLIDING_NAMES = "colliding_names"
    NESTED_ARCHIVE = "nested_archive"
    FOLDER_WITH_DATA = "folder_with_data"
    FILE_TOO_LARGE = "file_too_large"
    # one member's bytes
    DAMAGED_MEMBER = "damaged_member"
    SIZE_MISMATCH = "size_mismatch"
    CHECKSUM_MISMATCH = "checksum_mismatch"
    # which files there are
    MISSING_IMAGE = "missing_image"
    UNKNOWN_IMAGE = "unknown_image"
    DUPLICATE_IMAGE = "duplicate_image"
    UNEXPECTED_FILE = "unexpected_file"
    # JSON
    INVALID_UTF8 = "invalid_utf8"
    BYTE_ORDER_MARK = "byte_order_mark"
    INVALID_JSON = "invalid_json"
    NESTED_TOO_DEEPLY = "nested_too_deeply"
    DUPLICATE_KEY = "duplicate_key"
    NUMBER_NOT_FINITE = "number_not_finite"
    NUMBER_TOO_LONG = "number_too_long"
    NOT_EXPLAINED = "not_explained"
    # the predictions
    MISSING_KEY = "missing_key"
    WRONG_TYPE = "wrong_type"
    WRONG_LENGTH = "wrong_length"
    UNKNOWN_LABEL = "unknown_label"
    SCORE_OUT_OF_RANGE = "score_out_of_range"
    CENTER_OUT_OF_RANGE = "center_out_of_range"
    DIMENSION_OUT_OF_RANGE = "dimension_out_of_range"
    ROTATION_ZERO = "rotation_zero"
    ROTATION_OUT_OF_RANGE = "rotation_out_of_range"
    BOX_NEGATIVE_SIZE = "box_negative_size"
    BOX_OUT_OF_RANGE = "box_out_of_range"
    TOO_MANY_BOXES = "too_many_boxes"
    # warnings
    ROTATION_NOT_NORMALISED = "rotation_not_normalised"
    CITYPERSONS_KEYS = "citypersons_keys"
    NO_BOXES = "no_boxes"
    # recognised mistakes (evaluator/doctor)
    QUATERNION_XYZW = "quaternion_xyzw"
    ROTATION_IN_DEGREES = "rotation_in_degrees"
    YAW_OFF_BY_90 = "yaw_off_by_90"
    YAW_OFF_BY_180 = "yaw_off_by_180"
    DIMENSIONS_ORDER = "dimensions_order"
    CENTER_AT_BOTTOM = "center_at_bottom"
    CENTER_IN_CAMERA_FRAME = "center_in_camera_frame"
    SCORES_IN_PERCENT = "scores_in_percent"
    SCORES_ALL_EQUAL = "scores_all_equal"
    SCORES_BELOW_THRESHOLDS = "scores_below_thresholds"
    LABELS_CAPITALISED = "labels_capitalised"
    LABELS_NUMERIC = "labels_numeric"
    MODAL_OUTSIDE_AMODAL = "modal_outside_amodal"
    BOXES_AS_CORNERS = "boxes_as_corners"
    BOXES_FOR_OTHER_IMAGE_SIZE = "boxes_for_other_image_size"
    BOXES_FAR_FROM_PROJECTION = "boxes_far_from_projection"
    # notes
    UNEVALUATED_LABEL = "unevaluated_label"
    RESULTS_FILE_IGNORED = "results_file_ignored"
    # what the lenient reading skipped or let pass
    LENIENT_MISSING_IMAGE = "lenient_missing_image"
    LENIENT_EXTRA_FILE = "lenient_extra_file"
    LENIENT_REPLACED_FILE = "lenient_replaced_file"
    LENIENT_SKIPPED_LABEL = "lenient_skipped_label"
    LENIENT_SKIPPED_OBJECT = "lenient_skipped_object"
    LENIENT_SCORE = "lenient_score"


@dataclass(frozen=True, slots=True)
class Meaning:
    """What a code says to the uploader."""

    severity: Severity
    title: str
    fix: str


def _error(title: str, fix: str) -> Meaning:
    """Write an error down."""
    return Meaning("error", title, fix)


def _warning(title: str, fix: str) -> Meaning:
    """Write a warning down."""
    return Meaning("warning", title, fix)


_REPACK = "Pack the folder again with an ordinary zip program."
_RENAME = "Use plain relative names such as predictions/berlin_000000_000019_pred.json."

MEANINGS: dict[Code, Meaning] = {
    Code.UNREADABLE: _error("The file or folder cannot be read.", "Check the path and its permissions."),
    Code.NOT_A_ZIP: _error(
        "The file is not a zip archive.", "Upload a .zip file (not tar, rar or 7z) with one JSON file per image."
    ),
    Code.TRUNCATED_ARCHIVE: _error("The zip archive ends too early.", "Upload it again; the transfer was cut short."),
    Code.EMPTY_ARCHIVE: _error(
        "There is not a single prediction file.",
        "Put one JSON file per image into the archive, named <city>_<sequence>_<frame>_<anything>.json.",
    ),
    Code.ARCHIVE_TOO_LARGE: _error(
        "The archive is larger than allowed.", "Write fewer digits and drop boxes of very low score."
    ),
    Code.TOO_MANY_ENTRIES: _error("There are too many files.", "Pack one JSON file per image and nothing else."),
    Code.EXPANDED_TOO_LARGE: _error(
        "The files are larger than allowed once unpacked.", "Write fewer digits and drop boxes of very low score."
    ),
    Code.RATIO_TOO_HIGH: _error(
        "The archive unpacks to implausibly much more than its own size.", "Remove repeated boxes and white space."
    ),
    Code.MULTI_DISK: _error("The archive is split over several files.", "Pack everything into one zip file."),
    Code.PREFIX_BYTES: _error("There are bytes before the first member of the archive.", _REPACK),
    Code.SUFFIX_BYTES: _error("There are bytes after the end of the archive.", _REPACK),
    Code.DAMAGED_DIRECTORY: _error("The table of contents of the archive is damaged.", _REPACK),
    Code.ENTRY_COUNT_MISMATCH: _error("The archive does not hold as many members as it says.", _REPACK),
    Code.ZIP64_MISMATCH: _error("The ZIP64 fields of the archive contradict the others.", _REPACK),
    Code.LOCAL_HEADER_MISMATCH: _error("A member's own header contradicts the table of contents.", _REPACK),
    Code.OVERLAPPING_MEMBERS: _error("Members of the archive share bytes.", _REPACK),
    Code.HIDDEN_BYTES: _error("There are bytes between members that belong to none of them.", _REPACK),
    Code.ENCRYPTED: _error("A member is encrypted.", "Pack the archive without a password."),
    Code.UNSUPPORTED_COMPRESSION: _error(
        "A member is compressed with an unsupported method.", "Use the method deflate (the default) or store."
    ),
    Code.LINK_OR_DEVICE: _error(
        "There is a link, a device or another special file.", "Replace it with a copy of the regular file."
    ),
    Code.ABSOLUTE_NAME: _error("A member's name is an absolute path.", _RENAME),
    Code.PARENT_NAME: _error("A member's name leaves its folder with '..'.", _RENAME),
    Code.BACKSLASH_NAME: _error("A member's name contains a backslash.", "Use forward slashes between folders."),
    Code.DRIVE_NAME: _error("A member's name begins with a drive letter.", _RENAME),
    Code.CONTROL_CHARACTER_NAME: _error("A member's name contains a control character.", _RENAME),
    Code.UNDECODABLE_NAME: _error("A member's name is not the UTF-8 it claims to be.", _RENAME),
    Code.EMPTY_NAME: _error("A member's name is empty or has an empty part.", _RENAME),
    Code.NAME_TOO_LONG: _error("A member's name is too long.", _RENAME),
    Code.DUPLICATE_NAME: _error("Two members have the same name.", "Keep one of them."),
    Code.COLLIDING_NAMES: _error(
        "Two members' names differ only in upper and lower case or in how accents are encoded.", "Keep one of them."
    ),
    Code.NESTED_ARCHIVE: _error("There is an archive inside the archive.", "Pack the JSON files directly."),
    Code.FOLDER_WITH_DATA: _error("A folder entry carries data.", _REPACK),
    Code.FILE_TOO_LARGE: _error("A file is larger than allowed.", "Write fewer digits and drop boxes of low score."),
    Code.DAMAGED_MEMBER: _error("A member's compressed data is damaged.", "Pack and upload it again."),
    Code.SIZE_MISMATCH: _error("A member does not unpack to the size the archive states.", _REPACK),
    Code.CHECKSUM_MISMATCH: _error("A member's checksum is wrong.", "Pack and upload it again."),
    Code.MISSING_IMAGE: _error(
        "An image has no prediction file.", 'Add a file for it; an image without boxes needs {"objects": []}.'
    ),
    Code.UNKNOWN_IMAGE: _error(
        "A file belongs to no image of this phase.",
        "Name it <city>_<sequence>_<frame>_<anything>.json after one of the phase's images, or remove it.",
    ),
    Code.DUPLICATE_IMAGE: _error("Two files are for the same image.", "Keep one file per image."),
    Code.UNEXPECTED_FILE: _error(
        "A file is neither a prediction nor a known system file.", "Remove it; prediction files end in .json."
    ),
    Code.INVALID_UTF8: _error("A file is not encoded in UTF-8.", "Write the JSON files in UTF-8."),
    Code.BYTE_ORDER_MARK: _error(
        "A file starts with a byte order mark.", "Write UTF-8 without one (in Python: encoding='utf-8')."
    ),
    Code.INVALID_JSON: _error("A file is not valid JSON.", "Write it with a JSON library, such as Python's json.dump."),
    Code.NESTED_TOO_DEEPLY: _error("Arrays and objects are nested too deeply.", "Remove the extra data."),
    Code.DUPLICATE_KEY: _error("A key stands twice in one object.", "Keep one of them."),
    Code.NUMBER_NOT_FINITE: _error(
        "A number is NaN, infinite or too large for a float.", "Write finite numbers only; drop broken boxes."
    ),
    Code.NUMBER_TOO_LONG: _error("An integer has implausibly many digits.", "Write it as an ordinary number."),
    Code.NOT_EXPLAINED: _error(
        "There is something wrong with a file, and so much wrong before that it was not looked at closely.",
        "Correct the other problems first.",
    ),
    Code.MISSING_KEY: _error("A required key is missing.", "Add it as docs/submission_format.md shows."),
    Code.WRONG_TYPE: _error("A value has the wrong type.", "Write the type that docs/submission_format.md shows."),
    Code.WRONG_LENGTH: _error("An array has the wrong length.", "Write exactly as many numbers as expected."),
    Code.UNKNOWN_LABEL: _error(
        "A label is not one of the data set's classes.", "Use the class names exactly, in lower case."
    ),
    Code.SCORE_OUT_OF_RANGE: _error("A score is outside [0, 1].", "Scale the scores to lie from 0 to 1."),
    Code.CENTER_OUT_OF_RANGE: _error(
        "A box centre is more than 10 km away.", "Give centres in metres in the ISO 8855 vehicle frame."
    ),
    Code.DIMENSION_OUT_OF_RANGE: _error(
        "A dimension is not between 1 cm and 100 m.", "Give length, width and height in metres, all positive."
    ),
    Code.ROTATION_ZERO: _error("A quaternion has length zero.", "Give unit quaternions w, x, y, z."),
    Code.ROTATION_OUT_OF_RANGE: _error("A quaternion is implausibly large.", "Give unit quaternions w, x, y, z."),
    Code.BOX_NEGATIVE_SIZE: _error(
        "A 2D box has a negative size.", "Give 2D boxes as x, y of the upper left corner, width, height."
    ),
    Code.BOX_OUT_OF_RANGE: _error(
        "A 2D box lies implausibly far outside of the image.", "Give 2D boxes in pixels of the 2048 x 1024 image."
    ),
    Code.TOO_MANY_BOXES: _error("An image has more boxes than allowed.", "Keep the boxes of highest score."),
    Code.ROTATION_NOT_NORMALISED: _warning(
        "A quaternion is not of unit length.", "Normalise it; the evaluation does so before use."
    ),
    Code.CITYPERSONS_KEYS: _warning(
        "The keys bbox and bboxVis are ignored here, while cityscapesScripts reads them instead of amodal and modal.",
        "Remove them.",
    ),
    Code.NO_BOXES: _warning(
        "No file has a box of an evaluated class.",
        "Look whether the detector's output was written: every object found is an entry of `objects`.",
    ),
    Code.QUATERNION_XYZW: _warning(
        "The quaternions seem to be in the order x, y, z, w.", "Write them as w, x, y, z: put the last number first."
    ),
    Code.ROTATION_IN_DEGREES: _warning(
        "The rotations seem to be angles in degrees, or quaternions made from them as if they were radians.",
        "Convert angles to radians, then to quaternions w, x, y, z.",
    ),
    Code.YAW_OFF_BY_90: _warning(
        "The boxes seem to be turned by 90 degrees.", "Measure yaw from the x axis (forward) to the y axis (left)."
    ),
    Code.YAW_OFF_BY_180: _warning(
        "Vehicles in and beside the own lane seem to face backwards.",
        "Let the box's x axis point to its front; check the sign of the yaw.",
    ),
    Code.DIMENSIONS_ORDER: _warning(
        "The dimensions seem to be in another order.", "Write them as length, width, height."
    ),
    Code.CENTER_AT_BOTTOM: _warning(
        "The centres seem to be those of the bottom faces, as in KITTI.", "Add half of the height to z."
    ),
    Code.CENTER_IN_CAMERA_FRAME: _warning(
        "The centres seem to be in a camera frame.",
        "Transform centres and rotations to the ISO 8855 vehicle frame with the inverse of sensor_T_ISO_8855.",
    ),
    Code.SCORES_IN_PERCENT: _warning("The scores seem to be in percent.", "Divide them by 100."),
    Code.SCORES_ALL_EQUAL: _warning(
        "All scores are equal, so there is only one point on the precision-recall curve.",
        "Write the detector's confidence.",
    ),
    Code.SCORES_BELOW_THRESHOLDS: _warning(
        "The scores are below the lowest score threshold above zero, 0.02, so they cannot be told apart.",
        "Scale the scores to spread over 0 to 1; only 51 thresholds in steps of 0.02 are looked at.",
    ),
    Code.LABELS_CAPITALISED: _warning(
        "Labels seem to be class names in another spelling.", "Write the class names in lower case."
    ),
    Code.LABELS_NUMERIC: _warning(
        "Labels seem to be class numbers.", "Write class names: car, truck, bus, train, motorcycle, bicycle."
    ),
    Code.MODAL_OUTSIDE_AMODAL: _warning(
        "Modal boxes reach out of their amodal boxes.",
        "The modal box is the visible part of the amodal one; leave it out if you do not predict it.",
    ),
    Code.BOXES_AS_CORNERS: _warning(
        "The 2D boxes seem to be two corners.", "Write x, y of the upper left corner, then width and height."
    ),
    Code.BOXES_FOR_OTHER_IMAGE_SIZE: _warning(
        "The 2D boxes seem to be for an image of 1242 x 375 pixels.", "Scale them to the image of 2048 x 1024 pixels."
    ),
    Code.BOXES_FAR_FROM_PROJECTION: _warning(
        "The 2D boxes are far from where the 3D boxes project to.",
        "Check the frame of the centres, the camera of each image and the 2D boxes.",
    ),
    Code.UNEVALUATED_LABEL: Meaning(
        "note", "Boxes of classes that are not evaluated were left out.", "Nothing needs to be done."
    ),
    Code.RESULTS_FILE_IGNORED: Meaning(
        "note", "A file named results.json was ignored.", "Nothing needs to be done; it may be removed."
    ),
    Code.LENIENT_MISSING_IMAGE: Meaning(
        "note", "An image without a file was taken as empty.", 'Add a file with {"objects": []}.'
    ),
    Code.LENIENT_EXTRA_FILE: Meaning("note", "A file that belongs to no image was ignored.", "Remove or rename it."),
    Code.LENIENT_REPLACED_FILE: Meaning(
        "note", "Of two files for one image the last in sorted order was taken.", "Keep one file per image."
    ),
    Code.LENIENT_SKIPPED_LABEL: Meaning(
        "note", "A box whose label is missing or not evaluated was skipped.", "Use the class names exactly."
    ),
    Code.LENIENT_SKIPPED_OBJECT: Meaning(
        "note", "A malformed box was skipped.", "Give every box its label, score, 2d and 3d entries."
    ),
    Code.LENIENT_SCORE: Meaning(
        "note", "A score outside [0, 1] was taken as it is.", "Scale the scores to lie from 0 to 1."
    ),
}
