"""Which file is for which image, and what a wrongly named file probably meant."""

import re
from collections.abc import Iterable, Iterator, Sequence

from evaluator.archive import is_passed_over
from evaluator.codes import Code
from evaluator.findings import Findings

_USUAL_NAME = re.compile(r"(?P<image>[^/]+_\d+_\d+)_[^/]*\.json")
_RESULTS_FILE = "results.json"
"""The name under which the reference puts its own output, by default beside the predictions."""
_LONGEST_COMPARED = 80
"""Characters; longer names are not searched for slips of the pen."""
_MOST_FORMS = 100_000
"""Forms filed, some 25 MB at most and enough for 4,000 names of usual length; further names are found by no slip."""


def assign_files(
    names: Sequence[str], images: Sequence[str] | None, findings: Findings
) -> tuple[tuple[str, ...], list[tuple[int, int]]]:
    """Find the file of every image.

    Args:
        names: file names with their folders.
        images: the images there must be, or None when they are unknown: then every file makes its own image.
        findings: receives missing, unknown, repeated and unexpected files.

    Returns:
        The images, and pairs of image number and file number in the order of the images.
    """
    wanted = None if images is None else frozenset(images)
    file_of: dict[str, int] = {}
    unknown: list[str] = []
    for number, name in enumerate(names):
        base = _base(name)
        if not _is_prediction(name, base, findings):
            continue
        image = _image_of(base, wanted)
        if image is None:
            unknown.append(name)
        elif image in file_of:
            findings.add(Code.DUPLICATE_IMAGE, file=name, found=f"{image} again", detail=names[file_of[image]])
        else:
            file_of[image] = number
    ordered = tuple(sorted(file_of)) if images is None else tuple(images)
    if file_of or unknown:  # without any prediction, a list of every image would bury that one fact
        missing = [image for image in ordered if image not in file_of]
        _report_names(missing, unknown, ordered, findings)
    return ordered, [(index, file_of[image]) for index, image in enumerate(ordered) if image in file_of]


def _base(name: str) -> str:
    """Take the name without its folders; pathlib would take a tenth of the whole reading's time."""
    return name.rpartition("/")[2]


def _stem(name: str) -> str:
    """Take the name without its folders and suffix."""
    base = _base(name)
    return base.rpartition(".")[0] or base


def _is_prediction(name: str, base: str, findings: Findings) -> bool:
    """Tell whether a file is to be read; say so of the others, except of what macOS leaves behind."""
    if is_passed_over(name):
        return False
    if base == _RESULTS_FILE:
        findings.add(Code.RESULTS_FILE_IGNORED, file=name)
        return False
    if not base.endswith(".json"):
        findings.add(Code.UNEXPECTED_FILE, file=name, expected="a name ending in .json")
        return False
    return True


def _image_of(base: str, wanted: frozenset[str] | None) -> str | None:
    """Find the image a file is for: the longest part before an underscore that names one."""
    if wanted is None:
        usual = _USUAL_NAME.fullmatch(base)
        return usual["image"] if usual else None
    image = base
    while image := image.rpartition("_")[0]:
        if image in wanted:
            return image
    return None


def _report_names(missing: list[str], unknown: list[str], images: Sequence[str], findings: Findings) -> None:
    """Report images without a file and files without an image, with the nearest name of the other kind."""
    if not missing and not unknown:
        return
    stems = {_stem(name): name for name in unknown}
    nearest_file = NearestName(stems)
    nearest_image = NearestName(images)
    for image in missing:
        stem = nearest_file.find(image) or nearest_file.find(f"{image}_pred")
        near = None if stem is None else f"perhaps {stems[stem]}"
        findings.add(Code.MISSING_IMAGE, expected=f"{image}_<anything>.json", detail=near)
    for name in unknown:
        near = _nearest_image(_stem(name), nearest_image)
        findings.add(Code.UNKNOWN_IMAGE, file=name, detail=near)


def _nearest_image(stem: str, nearest: "NearestName") -> str | None:
    """Say what a file's name may have meant."""
    image = nearest.find(stem) or nearest.find(stem.rpartition("_")[0])
    if image is None:
        return None
    if image == stem:
        return f"the name lacks a part after the image: {image}_<anything>.json"
    return f"perhaps the image {image}"


class NearestName:
    """Finds names that differ by one slip: a character dropped, added, changed or two swapped, or case and signs.

    Linear: each name is filed under its simplified form and under every form with one character left out, so two
    names one slip apart meet. Bounded in memory: hostile archives have many long names.
    """

    def __init__(self, names: Iterable[str]) -> None:
        """File the names."""
        self._filed: dict[str, str] = {}
        for name in names:
            if len(self._filed) >= _MOST_FORMS:
                break
            for form in _forms(name):
                self._filed.setdefault(form, name)

    def __len__(self) -> int:
        """Count the forms."""
        return len(self._filed)

    def find(self, name: str) -> str | None:
        """Find the first name close to this one."""
        return next((self._filed[form] for form in _forms(name) if form in self._filed), None)


def _forms(name: str) -> Iterator[str]:
    """Yield the forms a name is filed under, the closest first."""
    simple = re.sub(r"[^a-z0-9]+", "_", name[: _LONGEST_COMPARED + 1].lower()).strip("_")
    yield simple
    yield "_".join(part.lstrip("0") for part in simple.split("_"))
    if len(simple) <= _LONGEST_COMPARED:
        for at in range(len(simple)):
            yield simple[:at] + simple[at + 1 :]
