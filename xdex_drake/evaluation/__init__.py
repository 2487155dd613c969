"""Evaluation: the metrics of the paper and of the field."""
