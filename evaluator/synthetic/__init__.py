"""Synthetic benchmarks in the real file formats: ground truth with the paper's statistics, methods of a given quality.

For demonstrations, tests and measurements. Everything is a function of its seed; no file of the data set is needed.

    population.py    what stands in an image: classes, size prototypes, distances
    cameras.py       the usual Cityscapes camera and the 2D boxes it sees
    scenes.py        boxes placed on the road, visible and apart
    ground_truth.py  files `<city>_<sequence>_<frame>_gtBbox3d.json`
    quality.py       how good a method is, and three named ones
    detections.py    what a method of that quality makes of a scene
    predictions.py   files `<city>_<sequence>_<frame>_predBbox3d.json`
    file_format.py   the JSON of both, and zips of it
"""

from evaluator.synthetic.file_format import write_zip
from evaluator.synthetic.ground_truth import synthesize_ground_truth
from evaluator.synthetic.predictions import synthesize_predictions
from evaluator.synthetic.quality import QUALITIES, Quality

__all__ = ["QUALITIES", "Quality", "synthesize_ground_truth", "synthesize_predictions", "write_zip"]
