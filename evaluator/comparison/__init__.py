"""Comparison metrics: what KITTI, nuScenes, Waymo and Argoverse would say about the same boxes.

They never rank. Each benchmark has a module of its own with its source, its frozen parameters and what differs;
docs/comparison.md holds the formulas. `comparison_metrics` in `evaluator.comparison.summary` runs them all.
"""
