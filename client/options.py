"""Options that commands share: the parameters of a protocol, and how a bootstrap draws."""

import argparse
import math
import re
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:  # everything heavy is imported when a command runs
    from evaluator.protocol import Protocol
    from evaluator.resampling import Unit

_OPTIONS = {
    "min_iou": "--min-iou",
    "max_depth_m": "--max-depth",
    "depth_step_m": "--step-size",
    "working_point": "--cw",
    "modal": "--modal",
}
"""Parameter of a protocol -> the option that sets it."""
_AUTOMATIC_WORKING_POINT = -1.0
"""The reference's way to ask for the best working point of each class."""
MOST_RESAMPLES = 10_000
"""All are in memory at once: 0.4 GB for 1525 images."""
FEWEST_IN_TAIL = 5
"""Resamples beyond either bound of an interval; with fewer the bound is little more than the most extreme of them."""
_DRAWN = {"unit": "--unit", "resamples": "--resamples", "seed": "--seed", "level": "--level", "unproven": "--unproven"}


def add_protocol_options(parser: argparse.ArgumentParser) -> None:
    """Declare the options that change a protocol."""
    group = parser.add_argument_group("rules")
    group.add_argument("--labels", metavar="L", nargs="+", help="classes to evaluate (default: the six that rank)")
    group.add_argument("--min-iou", metavar="F", type=float, help="a match needs an IoU above this (default: 0.7)")
    group.add_argument("--max-depth", metavar="M", type=int, help="end of the last depth bin in metres (default: 100)")
    group.add_argument("--step-size", metavar="M", type=int, help="width of a depth bin in metres (default: 5)")
    group.add_argument("--cw", metavar="C", type=float, help="working point (default: the best of each class)")
    group.add_argument("--modal", action="store_true", help="match the submitted modal boxes")


def add_protocol_choice(parser: argparse.ArgumentParser) -> None:
    """Declare the option that names the protocol, where a command knows more than the one that ranks."""
    parser.add_argument("--protocol", choices=("cityscapes3d", "paper"), default="cityscapes3d", help="which rules")


def protocol_from(args: argparse.Namespace) -> "Protocol":
    """Return the protocol with the parameters given.

    Raises:
        UsageError: A parameter has no meaning.
    """
    from msgspec.structs import replace  # noqa: PLC0415 - keeps `cs3d --help` fast

    from evaluator.errors import UsageError  # noqa: PLC0415 - likewise
    from evaluator.protocol import CITYSCAPES3D, PROTOCOLS, require_usable  # noqa: PLC0415 - likewise

    given: dict[str, Any] = {
        "labels": args.labels and tuple(args.labels),
        "min_iou": args.min_iou,
        "max_depth_m": args.max_depth,
        "depth_step_m": args.step_size,
        "working_point": None if args.cw == _AUTOMATIC_WORKING_POINT else args.cw,
        "modal": args.modal,
    }
    named = PROTOCOLS[getattr(args, "protocol", CITYSCAPES3D.name)]
    protocol = replace(named, **{name: value for name, value in given.items() if value is not None})
    try:
        require_usable(protocol)
    except UsageError as error:
        raise UsageError(_by_option(str(error))) from error
    return protocol


def _by_option(message: str) -> str:
    """Name options where a message names parameters."""
    for parameter, option in _OPTIONS.items():
        message = re.sub(rf"\b{parameter}\b", option, message)
    return message


@dataclass(frozen=True, slots=True, kw_only=True)
class Draw:
    """What is drawn, and how sure an interval shall be: arguments of `intervals` and `compare` (evaluator.uncertainty)."""

    unit: "Unit"
    resamples: int
    seed: int
    level: float
    unproven: bool


def add_draw_options(parser: argparse.ArgumentParser) -> None:
    """Declare the options that say how the bootstrap draws."""
    group = parser.add_argument_group("confidence intervals")
    group.add_argument(
        "--unit",
        choices=("image", "sequence", "city"),
        help="what the bootstrap draws as a whole: images of one drive resemble each other (default: image)",
    )
    group.add_argument("--resamples", metavar="N", type=int, help="how many are drawn (default: 1000)")
    group.add_argument("--seed", metavar="N", type=int, help="another draw; the default is the same for everybody")
    group.add_argument("--level", metavar="F", type=float, help="confidence level (default: 0.95)")
    group.add_argument(
        "--unproven",
        action="store_true",
        default=None,
        help="also give intervals, marked ?, where too few images, sequences, cities or boxes are known for simulation to"
        " confirm their level; three cities, for example",
    )


def draw_options_given(args: argparse.Namespace) -> list[str]:
    """Name the options of the bootstrap that were given."""
    return [option for name, option in _DRAWN.items() if getattr(args, name) is not None]


def draw_from(args: argparse.Namespace) -> Draw:
    """Return what was asked for, with the defaults of the library.

    Raises:
        UsageError: The resamples are too few for the level or too many for the memory, or a value has no meaning.
    """
    from evaluator.confidence import LEVEL, require_level  # noqa: PLC0415 - keeps `cs3d --help` fast
    from evaluator.errors import UsageError  # noqa: PLC0415 - likewise
    from evaluator.uncertainty import RESAMPLES, SEED  # noqa: PLC0415 - likewise

    draw = Draw(
        unit=args.unit or "image",
        resamples=RESAMPLES if args.resamples is None else args.resamples,
        seed=SEED if args.seed is None else args.seed,
        level=LEVEL if args.level is None else args.level,
        unproven=bool(args.unproven),
    )
    require_level(draw.level)
    fewest = math.ceil(2 * FEWEST_IN_TAIL / (1 - draw.level) - _ROUNDING)
    if fewest > MOST_RESAMPLES:
        highest = 1 - 2 * FEWEST_IN_TAIL / MOST_RESAMPLES
        raise UsageError(f"--level must be at most {highest:g}: {MOST_RESAMPLES} resamples tell no more.")
    if not fewest <= draw.resamples <= MOST_RESAMPLES:
        raise UsageError(f"--resamples must be from {fewest} to {MOST_RESAMPLES} at --level {draw.level:g}.")
    return draw


_ROUNDING = 1e-6
"""Far above the rounding error of 1 - level, so that 0.95 needs 200 as on paper."""
