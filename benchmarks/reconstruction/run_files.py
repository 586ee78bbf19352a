"""Names of the files in the folder of a training, ``train --out``, which other programs read."""

REPORT = "report.json"
"""Mean scores, options, and hashes of the data."""
SCORES = "scores.csv"
"""A row of scores for each test garment."""
EVALUATION = "evaluation.json"
"""Scores of the evaluator, those of drapes among them."""
