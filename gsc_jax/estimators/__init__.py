"""Estimators: from the evidence of all views and a prior to a score and a label per Gaussian."""
