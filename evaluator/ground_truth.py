"""Ground truth as arrays: cameras, boxes and ignore regions of a set of images."""

from dataclasses import dataclass

from evaluator.errors import DataError
from evaluator.predictions import Float64Array, IndexArray


class GroundTruthError(DataError):
    """The ground truth cannot be used; the message lists every file and place that is wrong."""

    code = "invalid_ground_truth"


@dataclass(frozen=True, slots=True, kw_only=True)
class GroundTruth:
    """Cameras, boxes and ignore regions of all images. Frame and box layout as in `Predictions`.

    Boxes are ordered by image, then as they stand in the image's file; likewise ignore regions.
    """

    images: tuple[str, ...]
    """Image names `<city>_<sequence>_<frame>`, sorted."""
    labels: tuple[str, ...]
    """What `label_index` refers to: every label that occurs in the files."""
    prototypes: tuple[str, ...]
    """What `prototype_index` refers to: the size prototypes of the paper's table (the files' `type`)."""

    intrinsics_px: Float64Array
    """(I, 4) fx, fy, u0, v0 of each image's camera."""
    sensor_from_vehicle: Float64Array
    """(I, 3, 4) `sensor_T_ISO_8855`: vehicle frame to camera frame (x forward, y left, z up)."""

    image_index: IndexArray
    """(N,) int32, ascending, index into `images`."""
    label_index: IndexArray
    """(N,) int32, index into `labels`."""
    prototype_index: IndexArray
    """(N,) int32, index into `prototypes`, -1 where the file names none."""
    center_m: Float64Array
    dimensions_m: Float64Array
    rotation: Float64Array
    amodal_px: Float64Array
    modal_px: Float64Array
    occlusion: Float64Array
    """(N,) in [0, 1], NaN where the file says nothing."""
    truncation: Float64Array
    """(N,) in [0, 1], NaN where the file says nothing."""

    ignore_image_index: IndexArray
    """(R,) int32, ascending, index into `images`."""
    ignore_px: Float64Array
    """(R, 4) ignore regions: x, y of the upper left corner, width, height."""

    def __len__(self) -> int:
        """Count the boxes."""
        return len(self.image_index)
