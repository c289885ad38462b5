"""What passes between a worker and its scoring process: jobs one way, events the other. JSON, told apart by a tag."""

from typing import Literal

import msgspec


class _Limits(msgspec.Struct, frozen=True, kw_only=True):
    """What every job has."""

    folder: str
    """Where results are written."""
    memory_bytes: int
    time_s: float


class Job(_Limits, frozen=True, kw_only=True, tag="whole"):
    """Validate and score a submission; gives `report.json`, then all that `Reduction` gives."""

    predictions: str
    """Path of the uploaded zip."""
    ground_truth: str
    """Path of the prepared ground truth."""
    image_list: str
    """Path of the public image list, JSON."""
    predictions_sha256: str
    ground_truth_sha256: str
    protocol: str

    @property
    def inputs(self) -> tuple[str, ...]:
        """Files to read."""
        return (self.predictions, self.ground_truth, self.image_list)


class Preparation(_Limits, frozen=True, kw_only=True, tag="preparation"):
    """Validate a submission that is scored in shards; gives `report.json` and `predictions`, arrays for the shards."""

    predictions: str
    """Path of the uploaded zip."""
    image_list: str
    """Path of the public image list, JSON."""

    @property
    def inputs(self) -> tuple[str, ...]:
        """Files to read."""
        return (self.predictions, self.image_list)


class ShardJob(_Limits, frozen=True, kw_only=True, tag="shard"):
    """Match a range of the images; gives `shard`."""

    predictions: str
    """Path of the arrays that `Preparation` gave."""
    ground_truth: str
    """Path of the prepared ground truth."""
    protocol: str
    first_image: int
    end_image: int
    """The first that is not in the range."""

    @property
    def inputs(self) -> tuple[str, ...]:
        """Files to read."""
        return (self.predictions, self.ground_truth)


class Reduction(_Limits, frozen=True, kw_only=True, tag="reduction"):
    """Join all shards; gives `scores.json`, `statistics` and `integrity.json`."""

    shards: tuple[str, ...]
    """Paths of what `ShardJob` gave, in the order of the images."""
    predictions: str
    """Path of the arrays that `Preparation` gave."""
    predictions_sha256: str
    """Of the uploaded zip."""
    ground_truth_sha256: str
    protocol: str

    @property
    def inputs(self) -> tuple[str, ...]:
        """Files to read."""
        return (*self.shards, self.predictions)


class Resampling(_Limits, frozen=True, kw_only=True, tag="resampling"):
    """Resample the images of a score; gives `replicates`, empty when there are too few images."""

    statistics: str
    """Path of the statistics that `Job` or `Reduction` gave."""

    @property
    def inputs(self) -> tuple[str, ...]:
        """Files to read."""
        return (self.statistics,)


AnyJob = Job | Preparation | ShardJob | Reduction | Resampling


class Ready(msgspec.Struct, frozen=True, tag="ready"):
    """Jobs are taken from now on."""

    has_network: bool
    has_files: bool
    """True where a job could open more files than its own."""


class Progress(msgspec.Struct, frozen=True, tag="progress"):
    """How far the job is."""

    stage: Literal["validating", "scoring"]
    done: int
    total: int


class Validated(msgspec.Struct, frozen=True, tag="validated"):
    """The report is written; the predictions have no errors; what follows comes next."""


class Rejected(msgspec.Struct, frozen=True, tag="rejected"):
    """The report is written; the predictions have errors."""


class Prepared(msgspec.Struct, frozen=True, tag="prepared"):
    """The arrays for the shards are written."""

    images: int


class Matched(msgspec.Struct, frozen=True, tag="matched"):
    """The shard's result is written."""


class Scored(msgspec.Struct, frozen=True, tag="scored"):
    """Scores, statistics and integrity audit are written."""


class Resampled(msgspec.Struct, frozen=True, tag="resampled"):
    """The replicates are written."""


class Broken(msgspec.Struct, frozen=True, tag="broken"):
    """The evaluator itself failed; trying again would not help."""

    detail: str


class Exit(msgspec.Struct, frozen=True, tag="exit"):
    """The job's process ended: 0, an exit status, or minus a signal's number."""

    status: int


Event = Ready | Progress | Validated | Rejected | Prepared | Matched | Scored | Resampled | Broken | Exit
