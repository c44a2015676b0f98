"""Masks to evidence and back: detectors, lifting, observations of all views, masks of labels."""
