"""Made scenes, simulated detectors and metrics with exact truth."""
