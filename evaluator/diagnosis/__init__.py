"""Why a submission scores what it scores. Nothing here ranks; everything comes from the matches that rank.

    working_point.py     what was found, missed, false and discarded at each class's c_w
    errors.py            errors in metres and degrees against distance
    annotator_noise.py   the paper's annotation errors, to read those curves against
    subsets.py           recall and errors by occlusion, truncation, prototype, image region, size, crowding
    nearest.py           what each prediction comes nearest to in the image
    causes.py            false positives and misses by cause, and what each cause costs
    loss.py              the points missing from a detection score, split exactly
    oracles.py           what the score would be if one thing were perfect
    calibration.py       what scores mean, where c_w lies, how fine scores are
    difference.py        the difference of two submissions, split exactly
    diagnose.py          all of it for one evaluation

docs/diagnosis.md holds every definition.
"""
