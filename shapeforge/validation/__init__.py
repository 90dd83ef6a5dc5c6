"""How right and how plausible the results are (§6): correspondence, segmentation, classes, plausibility, baselines."""
