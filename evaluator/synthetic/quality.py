"""How good an imaginary method is: what it finds, what it mistakes, how precisely it places boxes."""

from dataclasses import dataclass

import numpy as np

from evaluator.predictions import Float64Array


@dataclass(frozen=True, slots=True, kw_only=True)
class Quality:
    """The habits of one method. Errors are standard deviations; those of distance and angle grow with distance."""

    name: str
    title: str
    found_nearby: float
    """Probability of finding an unoccluded object right ahead."""
    range_m: float
    """At this distance the probability has fallen to 1/e of that."""
    lost_when_hidden: float
    """Share of that probability lost by an object occluded completely."""
    distance_error: float
    """Relative error of the distance at 60 m."""
    image_error_px: float
    """Error of the box centre seen in the image."""
    size_error: float
    """Relative error of each dimension."""
    yaw_error_rad: float
    """Error of the heading at 60 m."""
    tilt_error_rad: float
    """Error of pitch and of roll at 60 m."""
    turned_share: float
    """Share of boxes that face backwards."""
    confused_share: float
    """Share of boxes given another class."""
    duplicated_share: float
    """Share of boxes reported twice."""
    false_per_image: float
    """Mean number of boxes around nothing."""
    found_per_ignore_region: float
    """Mean number of boxes inside an ignore region."""
    score_noise: float
    """Noise of the score, in logits, around the probability of having found the object."""

    def detection_probability(self, distance_m: Float64Array, occlusion: Float64Array) -> Float64Array:
        """Return (N,) probabilities of finding objects at (N,) distances with (N,) occlusions in [0, 1]."""
        hidden = 1 - self.lost_when_hidden * occlusion
        return self.found_nearby * np.exp(-((distance_m / self.range_m) ** 2)) * hidden


def growth(distance_m: Float64Array) -> Float64Array:
    """Return (N,) factors by which errors grow with distance: 1 at 60 m, a quarter right ahead."""
    return 0.25 + 0.75 * distance_m / 60


QUALITIES = (
    Quality(
        name="orthoview-9dof",
        title="Orthoview 9-DoF",
        found_nearby=0.985,
        range_m=210.0,
        lost_when_hidden=0.45,
        distance_error=0.05,
        image_error_px=0.7,
        size_error=0.03,
        yaw_error_rad=0.05,
        tilt_error_rad=0.012,
        turned_share=0.01,
        confused_share=0.01,
        duplicated_share=0.02,
        false_per_image=0.8,
        found_per_ignore_region=1.5,
        score_noise=0.6,
    ),
    Quality(
        name="mono-lift",
        title="Mono Lift",
        found_nearby=0.95,
        range_m=150.0,
        lost_when_hidden=0.6,
        distance_error=0.1,
        image_error_px=1.3,
        size_error=0.06,
        yaw_error_rad=0.15,
        tilt_error_rad=0.03,
        turned_share=0.05,
        confused_share=0.04,
        duplicated_share=0.06,
        false_per_image=2.0,
        found_per_ignore_region=1.0,
        score_noise=0.9,
    ),
    Quality(
        name="prior-baseline",
        title="Prior Baseline",
        found_nearby=0.9,
        range_m=120.0,
        lost_when_hidden=0.75,
        distance_error=0.14,
        image_error_px=1.5,
        size_error=0.07,
        yaw_error_rad=0.3,
        tilt_error_rad=0.05,
        turned_share=0.15,
        confused_share=0.08,
        duplicated_share=0.12,
        false_per_image=3.0,
        found_per_ignore_region=0.7,
        score_noise=1.3,
    ),
)
"""Three imaginary methods, best first."""
