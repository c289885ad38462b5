"""Random damage that the reference passes over or takes without a word, done to the oracle's prediction files."""

import json
import random
from collections.abc import Callable
from pathlib import Path
from typing import Any

Box = dict[str, Any]


def _lose_a_key(box: Box, chance: random.Random) -> None:
    box.pop(chance.choice(list(box)))


def _lose_modal(box: Box, _: random.Random) -> None:
    box["2d"].pop("modal", None)


def _lose_amodal(box: Box, _: random.Random) -> None:
    box["2d"].pop("amodal", None)


def _odd_label(box: Box, chance: random.Random) -> None:
    box["label"] = chance.choice(["Car", "caravan", None, 3, ["car"]])


def _odd_score(box: Box, chance: random.Random) -> None:
    box["score"] = chance.choice([1.7, -0.1, float("nan"), float("inf"), True, [0.6], 10**30, -5])


def _scaled_rotation(box: Box, chance: random.Random) -> None:
    factor = chance.choice([3, 0.01, -1])
    box["3d"]["rotation"] = [number * factor for number in box["3d"]["rotation"]]


def _rotation_as_text(box: Box, _: random.Random) -> None:
    box["3d"]["rotation"] = [str(number) for number in box["3d"]["rotation"]]


def _citypersons_keys(box: Box, chance: random.Random) -> None:
    box["2d"]["bbox"] = box["2d"]["amodal"]
    box["2d"]["bboxVis"] = [number + chance.randint(-500, 500) for number in box["2d"]["modal"]]


def _amodal_as_text(box: Box, _: random.Random) -> None:
    box["2d"]["amodal"] = "none"


def _long_modal(box: Box, _: random.Random) -> None:
    box["2d"]["modal"] = [*box["2d"]["modal"], 9]


def _no_2d(box: Box, _: random.Random) -> None:
    box["2d"] = None


def _odd_3d(box: Box, _: random.Random) -> None:
    box["3d"] = [1]


def _whole_metres(box: Box, _: random.Random) -> None:
    box["3d"]["center"] = [int(number) for number in box["3d"]["center"]]


_DAMAGE: tuple[Callable[[Box, random.Random], None], ...] = (
    _lose_a_key,
    _lose_modal,
    _lose_amodal,
    _odd_label,
    _odd_score,
    _scaled_rotation,
    _rotation_as_text,
    _citypersons_keys,
    _amodal_as_text,
    _long_modal,
    _no_2d,
    _odd_3d,
    _whole_metres,
)


def write_sloppy_predictions(source: Path, target: Path, seed: int) -> None:
    """Write damaged copies of prediction files: a third of the boxes, missing, renamed and replaced files.

    Args:
        source: folder of sound prediction files.
        target: folder to write, in sub folders too.
        seed: draws everything.
    """
    chance = random.Random(seed)  # noqa: S311 -- test data
    for path in sorted(source.glob("*.json")):
        document = json.loads(path.read_bytes())
        for box in document["objects"]:
            if chance.random() < 1 / 3:
                chance.choice(_DAMAGE)(box, chance)
        fate = chance.random()
        if fate < 0.1:
            continue
        folder = target / chance.choice(["", "a", "b/c"])
        folder.mkdir(parents=True, exist_ok=True)
        name = path.name.replace("predBbox3d", chance.choice(["x", "pred-2", ""]))
        (folder / name).write_text(json.dumps(document), encoding="utf-8")
        if fate < 0.3:
            (target / "z").mkdir(exist_ok=True)
            (target / "z" / path.name).write_text(json.dumps({"objects": document["objects"][:3]}), encoding="utf-8")
    (target / "bonn_9_9_x.json").write_text('{"objects": []}', encoding="utf-8")
    (target / "results.json").write_text("nothing", encoding="utf-8")
