"""The metric core: bytes -> validated arrays -> matches -> scores.

Pure functions on arrays. Knows no web, no database and no queue. The way in, each of these a call:

    ground_truth.read_ground_truth          a folder or zip of ground truth
    intake.read_predictions                 a folder or zip of predictions, with a report of every problem
    evaluation.evaluate                     scores, matches and per-image statistics, by a protocol of protocol.py
    parallel.evaluate_file                  both of the last at once, over two processes with `split`
    parallel.TwoProcesses                   the same for many files on one ground truth, the second process kept
    uncertainty.intervals, compare          confidence intervals; two submissions on the same resamples
    diagnosis.diagnose.diagnose             why a submission scores what it scores
    comparison.summary.comparison_metrics   what other benchmarks would say about the same boxes
    cityscapes_format.cityscapes_results    scores in the layout of the reference's results.json
"""
